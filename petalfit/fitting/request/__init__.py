"""What a fit is asked for."""
