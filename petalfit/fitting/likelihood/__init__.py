"""Likelihoods of observations, given a surface."""
