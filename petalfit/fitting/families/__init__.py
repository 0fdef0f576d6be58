"""Families of models, and how the models of each are fitted."""
