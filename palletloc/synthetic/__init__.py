"""Synthetic scenes: recordings of aisles that never were, with exact truth."""
