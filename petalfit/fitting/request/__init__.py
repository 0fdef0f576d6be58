"""The request that a fit answers: its options, targets and checks."""
