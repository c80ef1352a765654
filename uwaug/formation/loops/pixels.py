"""Decoding, and all that is done for each pixel but the coarse grids, as compiled loops.

Pixels are computed in tiles of `TILE` px of one row, counted from its left edge, so that their bits
depend neither on threads nor on strips. What a tile needs, some 20 rows, stays in the first cache.
(More arithmetic in one loop, two rates or four pairs of taps, is no faster.)
"""

from typing import Any

import numpy as np

from uwaug.formation.loops.compiling import inner, kernel
from uwaug.formation.loops.grids import _extend
from uwaug.formation.loops.polynomials import (
    decode,
    decode_unit,
    encode,
    encode_unit,
    exp2,
    exp2_parts,
    log2,
    log2_1p,
    nearest,
)
from uwaug.formation.loops.tables import Bytes, Floats, Stack, Water

__all__ = ["TILE", "decode_rows", "form_rows", "look_up"]

TILE = 256
"""px. (128: 2 to 10 % longer; 512: as fast, but half as long again at 256 px; 1024: half again.)"""

f32 = np.float32
_0, _1, _2, _255 = f32(0), f32(1), f32(2), f32(255)


@kernel
def decode_rows(image: Floats, light: Floats, beyond: bool, start: int, stop: int) -> None:
    """Linear light of rows (NxW) of sRGB values; `beyond`: some may not lie in 0…1."""
    for y in range(start, stop):
        given, made = image[y], light[y]
        for x in range(made.size):
            made[x] = decode_unit(given[x])
        if beyond:
            for x in range(made.size):
                value = given[x]
                made[x] = made[x] if _0 <= value <= _1 else decode(value)


@kernel
def look_up(image: Bytes, table: Floats, light: Floats, start: int, stop: int) -> None:
    """The same of bytes, from a table of all of them."""
    for y in range(start, stop):
        given, made = image[y], light[y]
        for x in range(made.size):
            made[x] = table[given[x]]


@inner
def _blur_rows(d: Any, plane: Any, fold: Any, middle: int, w: Any, pairs: int) -> None:
    """Into d: w[0]·(row fold[middle]) + Σ w[i]·(both rows i away); there are 2, 4, … pairs."""
    m = plane[fold[middle]]
    a, b = plane[fold[middle - 1]], plane[fold[middle + 1]]
    p, q = plane[fold[middle - 2]], plane[fold[middle + 2]]
    w0, w1, w2 = w[0], w[1], w[2]
    for x in range(d.size):
        d[x] = w0 * m[x] + w1 * (a[x] + b[x]) + w2 * (p[x] + q[x])
    for i in range(3, pairs, 2):
        a, b = plane[fold[middle - i]], plane[fold[middle + i]]
        p, q = plane[fold[middle - i - 1]], plane[fold[middle + i + 1]]
        w1, w2 = w[i], w[i + 1]
        for x in range(d.size):
            d[x] += w1 * (a[x] + b[x]) + w2 * (p[x] + q[x])


@inner
def _add_line(d: Any, share: Any, line: Any, at: int, w: Any, pairs: int) -> None:
    """Add a share of the same along a line, for the tile that begins there."""
    near = line[at - 2 : at + TILE + 2]
    w0, w1, w2 = w[0], w[1], w[2]
    for x in range(TILE):
        one, two = near[x + 1] + near[x + 3], near[x] + near[x + 4]
        d[x] += share[x] * (w0 * near[x + 2] + w1 * one + w2 * two)
    for i in range(3, pairs, 2):
        left, right = line[at - i - 1 : at - i + TILE], line[at + i : at + i + TILE + 1]
        w1, w2 = w[i], w[i + 1]
        for x in range(TILE):
            d[x] += share[x] * (w1 * (left[x + 1] + right[x]) + w2 * (left[x] + right[x + 1]))


@inner
def _add_enlarged(d: Any, share: Any, grid: Any, n: int, left: int, right: int, w: Any) -> None:
    """Add a share of lines n, n + 3, … of a grid, those of one channel, weighed."""
    w0, w1, w2, w3 = w[0], w[1], w[2], w[3]
    # one by one: of a block of lines, numba does not know that each is dense
    a, b = grid[n, left:right], grid[n + 3, left:right]
    p, q = grid[n + 6, left:right], grid[n + 9, left:right]
    for x in range(a.size):
        d[x] += share[x] * ((w0 * a[x] + w1 * b[x]) + (w2 * p[x] + w3 * q[x]))


@inner
def _rows(t: Any, first: int, count: int) -> Any:
    """So many rows of a tile."""
    return t[first * TILE : (first + count) * TILE]


@inner
def _places(t: Any, z: int, to: int, law: Any) -> None:
    """Where widths lie in a plan, −1…1, from the distances in row `z`."""
    far, v = _rows(t, z, 1), _rows(t, to, 1)
    b_mean, scale, exponent = law[0], law[1], law[2]
    for x in range(TILE):
        v[x] = min(max(b_mean * far[x], f32(1e-6)), f32(1e4))
    if exponent != _1:
        for x in range(TILE):
            v[x] = exp2(exponent * log2(v[x]))
    linear, square, slope, offset = law[3] * scale, law[4] * scale * scale, law[5], law[6]
    for x in range(TILE):
        place = slope * log2_1p(v[x] * (linear + square * v[x])) + offset
        v[x] = min(max(place, -_1), _1)


@inner
def _terms(t: Any, place: int, count: int) -> None:
    """Chebyshev polynomials of the place, those from 2 on in the rows after it: two at a time."""
    v, s = _rows(t, place, 1), _rows(t, place + 1, 2)
    for x in range(TILE):
        s[x] = _2 * v[x] * v[x] - _1
        s[x + TILE] = _2 * v[x] * s[x] - v[x]
    for n in range(4, count, 2):
        s = _rows(t, place + n - 3, 4)
        for x in range(TILE):
            twice, last = _2 * v[x], s[x + TILE]
            one = twice * last - s[x]
            s[x + 2 * TILE] = one
            s[x + 3 * TILE] = twice * one - last


@inner
def _series(t: Any, to: int, first: int, w: Any) -> None:
    """Row `to` = w[0] + Σ w[i]·(row first + i − 1); there are 4, 6, … weights."""
    d, i = _rows(t, to, 1), 4
    w0, w1, w2, w3 = w[0], w[1], w[2], w[3]
    if w.size > 4:
        s, w4, w5, i = _rows(t, first, 5), w[4], w[5], 6
        for x in range(TILE):
            near = w0 + w1 * s[x] + w2 * s[x + TILE]
            far = w3 * s[x + 2 * TILE] + w4 * s[x + 3 * TILE] + w5 * s[x + 4 * TILE]
            d[x] = near + far
    else:
        s = _rows(t, first, 3)
        for x in range(TILE):
            d[x] = w0 + w1 * s[x] + (w2 * s[x + TILE] + w3 * s[x + 2 * TILE])
    while i < w.size:
        s, w0, w1 = _rows(t, first + i - 1, 2), w[i], w[i + 1]
        for x in range(TILE):
            d[x] += w0 * s[x] + w1 * s[x + TILE]
        i += 2


@inner
def _shares(t: Any, place: int, to: int, series: Any) -> None:
    """The weights of the blurs, from the places; the rows after those are to work in."""
    _terms(t, place, series.shape[1])
    for k in range(series.shape[0]):
        _series(t, to + k, place, series[k])


@inner
def _curves(t: Any, z: int, to: int, water: Any) -> None:
    """T_β, T_G − T_β and V(0) − V of three channels in turn, from the distances in row z."""
    far, rates, direct = _rows(t, z, 1), water.rates, water.direct.shape[1]
    d = _rows(t, to, 9)
    d[:] = _0
    for r in range(direct):
        rate = rates[r]
        a0, a1, a2 = water.direct[0, r], water.direct[1, r], water.direct[2, r]
        b0, b1, b2 = water.scatter[0, r], water.scatter[1, r], water.scatter[2, r]
        for x in range(TILE):
            e = exp2(rate * far[x])
            d[x] += a0 * e
            d[x + TILE] += b0 * e
            d[x + 3 * TILE] += a1 * e
            d[x + 4 * TILE] += b1 * e
            d[x + 6 * TILE] += a2 * e
            d[x + 7 * TILE] += b2 * e
    for r in range(direct, rates.size):
        rate = rates[r]
        a0, a1, a2 = water.veil[0, r - direct], water.veil[1, r - direct], water.veil[2, r - direct]
        b0, b1, b2 = water.scatter[0, r], water.scatter[1, r], water.scatter[2, r]
        for x in range(TILE):
            power, rest = exp2_parts(rate * far[x])
            e, less = power + rest, (power - _1) + rest
            d[x + TILE] += b0 * e
            d[x + 2 * TILE] += a0 * less
            d[x + 4 * TILE] += b1 * e
            d[x + 5 * TILE] += a1 * less
            d[x + 7 * TILE] += b2 * e
            d[x + 8 * TILE] += a2 * less


@inner
def _store(
    total: Any, curves: Any, light: Any, srgb: bool, most: Any, out: Any, out_bytes: Any
) -> None:
    """D + F + B of a tile, encoded, to where there is room: into one of the two."""
    for x in range(light.size):
        near = curves[x + 2 * TILE] + curves[x] * light[x]
        total[x] = near + curves[x + TILE] * total[x]
    if srgb and most > _1:
        for x in range(TILE):
            value = total[x]
            total[x] = encode_unit(value) if value <= _1 else min(encode(value), most)
    elif srgb:
        for x in range(TILE):
            total[x] = encode_unit(total[x])
    for x in range(out.size):
        out[x] = total[x]
    for x in range(out_bytes.size):
        out_bytes[x] = np.uint8(nearest(min(max(total[x] * _255, _0), _255)))


@kernel
def form_rows(
    light: Floats,
    z: Floats,
    water: Water,
    stack: Stack,
    grid: Floats,
    srgb: bool,
    most: Any,
    out: Floats,
    out_bytes: Bytes,
    start: int,
    stop: int,
) -> None:
    """Rows of a picture.

    Args:
        light (3xHxW), z (HxW): of the scene; effective distance, m.
        water, stack: tables.
        grid (NxW): the lines of all coarse grids.
        srgb, most: whether to encode, and the largest value then.
        out, out_bytes (3xHxW): the result, one of them; the other is 3x1x0.
        start, stop: rows.
    """
    _, _, width = light.shape
    count, terms = stack.series.shape
    narrow, wide, margin = stack.taps.shape[0], stack.back.shape[0], stack.margin
    padded = -(-width // TILE) * TILE + 2 * margin + 2
    lines = np.zeros((narrow * 3 + 1, padded), np.float32)
    # rows of a tile: distance, curves, shares, total, and place and terms to work in
    shares = 10
    total = shares + count
    t = np.zeros((total + terms) * TILE, np.float32)
    _rows(t, shares, 1)[:] = _1  # if there is one
    sharp = count - narrow - wide
    z_row, total_row = _rows(t, 0, 1), _rows(t, total, 1)
    for y in range(start, stop):
        for c in range(3):
            for k in range(narrow):
                line = lines[k * 3 + c]
                inside = line[margin : margin + width]
                _blur_rows(inside, light[c], stack.rows, margin + y, stack.taps[k], stack.pairs[k])
                _extend(line, stack.columns, margin, width, 1)
        for left in range(0, width, TILE):
            right = min(left + TILE, width)
            z_row[: right - left] = z[y, left:right]
            if count > 1:
                _places(t, 0, total + 1, water.law)
                _shares(t, total + 1, shares, stack.series)
            _curves(t, 0, 1, water)
            for c in range(3):
                seen = light[c, y, left:right]
                total_row[:] = _0
                if sharp:
                    share = _rows(t, shares, 1)
                    for x in range(seen.size):
                        total_row[x] = share[x] * seen[x]
                for k in range(narrow):
                    share, line = _rows(t, shares + sharp + k, 1), lines[k * 3 + c]
                    _add_line(total_row, share, line, margin + left, stack.taps[k], stack.pairs[k])
                for k in range(wide):
                    share = _rows(t, shares + sharp + narrow + k, 1)
                    first = stack.starts[k] + 3 * stack.back_first[k, y] + c
                    _add_enlarged(total_row, share, grid, first, left, right, stack.back[k, y])
                _store(
                    total_row,
                    _rows(t, 1 + 3 * c, 3),
                    seen,
                    srgb,
                    most,
                    out[c, y % out.shape[1], left:right],
                    out_bytes[c, y % out_bytes.shape[1], left:right],
                )
