"""Starts that any family may use."""
