"""The backward of what is done at each pixel of a picture whose blurs are there, as compiled loops.
Autograd would write every intermediate to memory, and read it back.
"""

from typing import Any

import numpy as np

from uwaug.formation.loops.compiling import inner, kernel
from uwaug.formation.loops.pixels import TILE, _curves, _places, _rows, _series, _shares
from uwaug.formation.loops.polynomials import exp2_parts
from uwaug.formation.loops.tables import Floats, Stack, Water

__all__ = ["ROWS", "slope_rows"]

ROWS = 64
"""Rows of a picture whose slopes are added up together, so that sums do not depend on threads."""

_0, _1, _LN2 = np.float32(0), np.float32(1), np.float32(np.log(2))


@inner
def _fill(t: Any, row: int, values: Any) -> None:
    """A row of a tile, with zeros behind what there is."""
    d = _rows(t, row, 1)
    d[: values.size] = values
    d[values.size :] = _0


@inner
def _add_product(sums: Any, row: int, t: Any, one: int, other: int) -> None:
    d, a, b = _rows(sums, row, 1), _rows(t, one, 1), _rows(t, other, 1)
    for x in range(TILE):
        d[x] += a[x] * b[x]


@inner
def _by_blur(t: Any, through: int, share: int, steep: int, work: int, to: Any) -> None:
    """Slopes of a blur of one channel, and its part of the mixture and of the slope by width."""
    mixture, by_width, blur = _rows(t, work, 1), _rows(t, work + 1, 1), _rows(t, work + 2, 1)
    g, w, slope = _rows(t, through, 1), _rows(t, share, 1), _rows(t, steep, 1)
    # one loop for both would need more tests of overlap than LLVM allows, and not be vectorised
    for x in range(TILE):
        mixture[x] += w[x] * blur[x]
    for x in range(TILE):
        by_width[x] += g[x] * (slope[x] * blur[x])
    for x in range(to.size):
        to[x] = w[x] * g[x]


@inner
def _by_rates(t: Any, sums: Any, by: int, work: int, water: Water) -> None:
    """Add up slopes of weights and rates; into row work + 1, those of distances. From `by` on,
    slopes of the nine curves.
    """
    direct, rates = water.direct.shape[1], water.rates.size
    z, g, by_z = _rows(t, 0, 1), _rows(t, work, 1), _rows(t, work + 1, 1)
    e, less = _rows(t, work + 2, 1), _rows(t, work + 3, 1)
    by_z[:] = _0
    for r in range(rates):
        rate = water.rates[r]
        for x in range(TILE):
            power, rest = exp2_parts(rate * z[x])
            e[x] = power + rest
            less[x] = (power - _1) + rest
        g[:] = _0
        for c in range(3):
            s, w = _rows(t, by + 3 + c, 1), water.scatter[c, r]
            other, v = _rows(t, by + c, 1), water.direct[c, r] if r < direct else _0
            if r >= direct:
                other, v = _rows(t, by + 6 + c, 1), water.veil[c, r - direct]
            for x in range(TILE):
                g[x] += w * s[x] + v * other[x]
            _add_product(sums, 7 * r + c, t, by + 3 + c, work + 2)
            if r < direct:
                _add_product(sums, 7 * r + 3 + c, t, by + c, work + 2)
            else:
                _add_product(sums, 7 * r + 3 + c, t, by + 6 + c, work + 3)
        steepness, d = rate * _LN2, _rows(sums, 7 * r + 6, 1)
        for x in range(TILE):
            fallen = g[x] * e[x]
            by_z[x] += steepness * fallen
            d[x] += z[x] * fallen


@kernel
def slope_rows(
    gradient: Floats,
    light: Floats,
    z: Floats,
    sigma: Floats,
    water: Water,
    stack: Stack,
    steeper: Floats,
    blurs: Floats,
    outs: tuple[Floats, Floats, Floats, Floats],
    start: int,
    stop: int,
) -> None:
    """Slopes of rows of a picture, D + F + B.

    Args:
        gradient (3xHxW): of the result.
        light (3xHxW), z, sigma (HxW): of the scene; effective distance, m; widths, px.
        water, stack: tables; of the stack, the series.
        steeper (K, N): series of the slopes of the weights by ln(1 + x), x = 2σ or 2σ².
        blurs (KxHx3xW): of the scene, in the order of the series; their gradients take their place.
        outs: gradients of light (3xHxW), z, sigma (HxW); and sums (H/ROWS, 7R, TILE), for each rate
            the products of curves' slopes with what falls: of T_G − T_β, of T_β or V, and of the
            rate.
        start, stop: rows.
    """
    to_light, to_z, to_sigma, all_sums = outs
    _, _, width = light.shape
    count, terms = stack.series.shape
    # rows of a tile as in `form_rows`, slopes of weights and of curves, and room
    shares = 10
    steep = shares + count
    by = steep + count
    place = by + 9
    work = place + terms
    t = np.zeros((work + 4) * TILE, np.float32)
    for y in range(start, stop):
        sums = all_sums[y // ROWS]
        for left in range(0, width, TILE):
            right = min(left + TILE, width)
            n = right - left
            widths = sigma[y, left:right]
            _fill(t, 0, widths)
            _places(t, 0, place, water.law)
            _shares(t, place, shares, stack.series)
            for k in range(count):
                _series(t, steep + k, place, steeper[k])
            places, by_width = _rows(t, place, 1), _rows(t, work + 1, 1)
            _fill(t, 0, z[y, left:right])
            _curves(t, 0, 1, water)
            by_width[:] = _0
            for c in range(3):
                _fill(t, by + 6 + c, gradient[c, y, left:right])
                _fill(t, by + c, light[c, y, left:right])
                g, seen = _rows(t, by + 6 + c, 1), _rows(t, by + c, 1)
                through = _rows(t, by + 3 + c, 1)
                direct, scatter = _rows(t, 1 + 3 * c, 1), _rows(t, 2 + 3 * c, 1)
                for x in range(TILE):
                    through[x] = g[x] * scatter[x]
                    seen[x] *= g[x]
                d = to_light[c, y, left:right]
                for x in range(n):
                    d[x] = g[x] * direct[x]
                mixture = _rows(t, work, 1)
                mixture[:] = _0
                for k in range(count):
                    blur = blurs[k, y, c, left:right]
                    _fill(t, work + 2, blur)
                    _by_blur(t, by + 3 + c, shares + k, steep + k, work, blur)
                for x in range(TILE):
                    through[x] = g[x] * mixture[x]
            linear, square = water.law[3], water.law[4]
            d = to_sigma[y, left:right]
            for x in range(n):
                s = widths[x]
                slope = (linear + (square + square) * s) / (_1 + s * (linear + square * s))
                d[x] = by_width[x] * slope if abs(places[x]) < _1 else _0
            _by_rates(t, sums, by, work, water)
            to_z[y, left:right] = by_width[:n]
