"""Measured poses against the truth: pairing, errors, and their summary."""
