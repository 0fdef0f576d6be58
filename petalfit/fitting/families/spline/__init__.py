"""The family of spline surfaces."""
