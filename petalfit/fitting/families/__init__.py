"""Families of models, and how the members of each are found."""
