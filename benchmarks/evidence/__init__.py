"""Does training with uwaug help on real underwater pictures? `python -m benchmarks.evidence`."""
