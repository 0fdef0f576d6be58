"""Methods that find starts, for use by any family."""
