"""The family of peony petals."""
