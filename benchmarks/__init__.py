"""Benchmarks: each runs its baselines in the same process and reports ratios."""

import sys
from pathlib import Path

# the referees, which share nothing with the package, serve tests and benchmarks
sys.path.append(str(Path(__file__).parent.parent / "tests"))
