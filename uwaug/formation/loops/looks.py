"""Light at some pixels of a picture in its water, as compiled loops: what an exposure measures."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uwaug.formation.loops.compiling import inner, kernel
from uwaug.formation.loops.polynomials import exp2
from uwaug.formation.loops.tables import Floats, Indices

__all__ = ["add_up"]

_TILE = 256
"""Pixels side by side; each place of a tile has sums of its own."""


@inner
def _add(sums: Any, light: Any, left: Any, count: int) -> None:
    """Add what is left of the light of three channels, and what is left of 1."""
    s0, s1, s2, s3 = sums[0], sums[1], sums[2], sums[3]
    j0, j1, j2 = light[0], light[1], light[2]
    for i in range(count):
        s0[i] += left[i] * j0[i]
        s1[i] += left[i] * j1[i]
        s2[i] += left[i] * j2[i]
        s3[i] += left[i]


@kernel
def add_up(
    light: Floats, z: Floats, pixels: Indices, rates: Floats, sums: NDArray[np.float64]
) -> None:
    """Sums over some pixels of e^(−rate·z)·J and of e^(−rate·z).

    Args:
        light (3xP): J of all pixels.
        z (P): their effective distances, m.
        pixels (N): which of them are looked at.
        rates (L): times −log2(e), ≤ 0.
        sums (Lx4): where the sums of three channels, and that of the exponentials, are put.
    """
    parts = np.zeros((rates.size, 4, _TILE), np.float32)
    tile, metres, left = (
        np.empty((3, _TILE), np.float32),
        np.empty(_TILE, np.float32),
        np.empty(_TILE, np.float32),
    )
    for first in range(0, pixels.size, _TILE):
        count = min(_TILE, pixels.size - first)
        for i in range(count):
            pixel = pixels[first + i]
            metres[i] = z[pixel]
            tile[0, i], tile[1, i], tile[2, i] = light[0, pixel], light[1, pixel], light[2, pixel]
        for k in range(rates.size):
            rate = rates[k]
            for i in range(count):
                left[i] = exp2(rate * metres[i])
            _add(parts[k], tile, left, count)
    for k in range(rates.size):
        for c in range(4):
            total = 0.0
            for i in range(_TILE):
                total += parts[k, c, i]
            sums[k, c] = total
