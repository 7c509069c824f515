"""Speed as ratios within one process, accuracy and consistency: ``python -m benchmarks``."""
