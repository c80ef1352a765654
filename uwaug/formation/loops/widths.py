"""The width of the blur at each pixel and its slopes, as compiled loops. (By PyTorch, bits depend
on the number of threads: powers at the ends of what each gets are others.)
"""

from typing import Any

import numpy as np

from uwaug.formation.loops.compiling import inner, kernel
from uwaug.formation.loops.pixels import TILE
from uwaug.formation.loops.polynomials import exp2, log2
from uwaug.formation.loops.tables import Floats

__all__ = ["width_rows", "width_slope_rows"]

_0, _1, _LN2 = np.float32(0), np.float32(1), np.float32(np.log(2))
_LEAST, _MOST = np.float32(1e-6), np.float32(1e4)  # scattering lengths


@inner
def _powers(d: Any, z: Any, law: Any) -> None:
    """Into d: (b̄·z)^exponent."""
    b_mean, exponent = law[0], law[2]
    for x in range(z.size):
        d[x] = min(max(b_mean * z[x], _LEAST), _MOST)
    if exponent != _1:
        for x in range(z.size):
            d[x] = exp2(exponent * log2(d[x]))


@kernel
def width_rows(z: Floats, law: Floats, sigma: Floats, start: int, stop: int) -> None:
    """Rows of widths.

    Args:
        z, sigma (HxW): effective distances, m; the result, px.
        law: b̄, scale and exponent first, as `uwaug.formation.loops.tables.Water` has it.
        start, stop: rows.
    """
    scale = law[1]
    for y in range(start, stop):
        d = sigma[y]
        _powers(d, z[y], law)
        for x in range(d.size):
            d[x] *= scale


@kernel
def width_slope_rows(
    by_sigma: Floats,
    z: Floats,
    law: Floats,
    to_z: Floats,
    all_sums: Floats,
    each: int,
    start: int,
    stop: int,
) -> None:
    """Backward of `width_rows`.

    Args:
        by_sigma (HxW): gradient of the widths.
        z, law: as there.
        to_z (HxW): gradient of z, to which these slopes are added.
        all_sums (H/each, 3·TILE): sums that give the gradients of b̄, scale and exponent.
        each: rows whose slopes are added up together.
        start, stop: rows.
    """
    width = z.shape[1]
    b_mean, scale, exponent = law[0], law[1], law[2]
    steep = scale * exponent
    p = np.zeros(TILE, np.float32)
    for y in range(start, stop):
        sums = all_sums[y // each]
        by_b, by_scale, by_exponent = sums[:TILE], sums[TILE : 2 * TILE], sums[2 * TILE :]
        for left in range(0, width, TILE):
            right = min(left + TILE, width)
            metres, g, d = z[y, left:right], by_sigma[y, left:right], to_z[y, left:right]
            _powers(p, metres, law)
            for x in range(metres.size):
                p[x] *= g[x]
                by_scale[x] += p[x]
            for x in range(metres.size):
                length = b_mean * metres[x]
                within = min(max(length, _LEAST), _MOST)
                by_exponent[x] += scale * p[x] * (_LN2 * log2(within))
                slope = steep * p[x] / within if within == length else _0
                d[x] += b_mean * slope
                by_b[x] += metres[x] * slope
