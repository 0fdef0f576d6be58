"""Inference: which parameters the data determine, with which errors, and how far to trust the fit."""
