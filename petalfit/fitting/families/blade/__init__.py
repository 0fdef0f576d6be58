"""Blades."""
