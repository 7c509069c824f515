"""Measured poses against the truth: surveys, pairing, errors, and their summary."""
