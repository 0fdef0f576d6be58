"""The family of blades."""
