"""Peony petals."""
