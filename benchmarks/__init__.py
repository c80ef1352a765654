"""Benchmarks: each runs its baselines in the same process and reports ratios."""
