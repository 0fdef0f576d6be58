"""Likelihoods: an observation beside a surface."""
