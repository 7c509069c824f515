"""Speed, measured as ratios within one process: ``python -m benchmarks``."""
