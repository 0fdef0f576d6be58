"""Minimisation of a cost, from a start to an end without bias."""
