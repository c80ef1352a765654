"""The model as compiled loops, with gradients and without, on a CPU in float32.

Eager PyTorch writes every intermediate to memory; these loops keep a few rows of a picture in the
cache and go through them once. They need numba (`pip install ".[fast]"` in a checkout); without it,
and for all that they do not take, PyTorch computes the same to 2e-6.
"""

from uwaug.formation.loops.backend import path, use, warm_up

__all__ = ["path", "use", "warm_up"]
