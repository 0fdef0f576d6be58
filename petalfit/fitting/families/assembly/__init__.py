"""Organs of several surfaces."""
