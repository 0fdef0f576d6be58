"""Spline sheets."""
