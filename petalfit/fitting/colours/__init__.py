"""Patterns of colours."""
