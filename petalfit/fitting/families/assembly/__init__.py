"""The family of organs of several surfaces."""
