"""Decoding, and all that is done for each pixel but the coarse grids, as compiled loops.

They stand in one file, see `grids`. Pixels are computed in tiles of `TILE` px of one row, counted
from its left edge, so that their bits depend neither on threads nor on strips. numba brings no
vector exp2 and log2: both are polynomials here, within 1e-8 and 5e-8 of themselves.
"""

from typing import Any

import numpy as np

from uwaug.fused.compiling import inner, kernel
from uwaug.fused.tables import Bytes, Floats, Stack, Water

__all__ = ["TILE", "decode_rows", "form_rows", "look_up"]

TILE = 256
"""px. (128: 2 to 10 % longer; 512: as fast, but half as long again at 256 px; 1024: half again.)"""

f32, i32 = np.float32, np.int32
_0, _1, _2, _255 = f32(0), f32(1), f32(2), f32(255)
_WHOLE = f32(1.5 * 2**23)  # added to a number, it leaves the nearest whole one in the last bits
_WHOLE_BITS = int(np.float32(1.5 * 2**23).view(np.int32))
_ROOT_HALF_BITS = int(np.float32(0.5**0.5).view(np.int32))
_SPENT, _MOST = f32(-100), f32(126)  # of exponents; e^−x of any less would make slow subnormals
# (2^f − 1)/f for |f| ≤ ½, and log2(1 + f)/f for 1 + f from √½ to √2: Chebyshev fits
_EXP = tuple(
    map(f32, (0.693147188, 0.240226509, 0.0555035710, 9.61805667e-3, 1.33908674e-3, 1.54614475e-4))
)
_LOG = tuple(
    map(
        f32,
        (
            1.44269500,
            -0.72134733,
            0.48091061,
            -0.36070483,
            0.28791832,
            -0.23892034,
            0.21566986,
            -0.20742104,
            0.12614847,
        ),
    )
)
_E0, _E1, _E2, _E3, _E4, _E5 = _EXP
_L0, _L1, _L2, _L3, _L4, _L5, _L6, _L7, _L8 = _LOG


@inner
def _exp2_parts(x: Any) -> Any:
    """2^x as 2^n and 2^x − 2^n, so that 2^x − 1 can be had without cancellation."""
    x = min(max(x, _SPENT), _MOST)
    shifted = x + _WHOLE
    n = i32(f32(shifted).view(i32) - _WHOLE_BITS)
    f = x - (shifted - _WHOLE)
    p = f * (_E0 + f * (_E1 + f * (_E2 + f * (_E3 + f * (_E4 + f * _E5)))))
    power = i32(i32(n + 127) << 23).view(f32)
    return power, power * p


@inner
def _exp2(x: Any) -> Any:
    power, rest = _exp2_parts(x)
    return power + rest


@inner
def _log2_sum(e: Any, f: Any) -> Any:
    """log2(2^e·(1 + f))."""
    p = _L4 + f * (_L5 + f * (_L6 + f * (_L7 + f * _L8)))
    return f32(e) + f * (_L0 + f * (_L1 + f * (_L2 + f * (_L3 + f * p))))


@inner
def _log2(y: Any) -> Any:
    bits = f32(y).view(i32)
    # numba's sums of 32 bits have 64, of which half as many fit into a register
    e = i32(i32(bits - _ROOT_HALF_BITS) >> 23)
    return _log2_sum(e, i32(bits - i32(e << 23)).view(f32) - _1)


@inner
def _log2_1p(x: Any) -> Any:
    """log2(1 + x), with what rounding leaves out of the sum."""
    y = _1 + x
    bits = f32(y).view(i32)
    e = i32(i32(bits - _ROOT_HALF_BITS) >> 23)
    late = (x - (y - _1)) * i32(i32(127 - e) << 23).view(f32)
    return _log2_sum(e, (i32(bits - i32(e << 23)).view(f32) - _1) + late)


_SRGB_KNEE, _LINEAR_KNEE = f32(0.0404482362771076), f32(0.0404482362771076 / 12.92)  # see colour
_SLOPE, _UNSLOPE, _SCALE, _SHIFT = f32(12.92), f32(1 / 12.92), f32(1 / 1.055), f32(0.055)
_GAMMA, _UNGAMMA, _LARGEST = f32(2.4), f32(1 / 2.4), f32(1e30)


@inner
def _decode(x: Any) -> Any:
    a = abs(x)
    m = min(max(a, _SRGB_KNEE), _LARGEST)
    power = _exp2(_GAMMA * _log2(_1 + (m - _1) * _SCALE))
    value = a * _UNSLOPE if a < _SRGB_KNEE else power
    return -value if x < _0 else value


@inner
def _encode(x: Any) -> Any:
    a = abs(x)
    m = min(max(a, _LINEAR_KNEE), _LARGEST)
    power = _exp2(_UNGAMMA * _log2(m))
    value = a * _SLOPE if a < _LINEAR_KNEE else power + _SHIFT * (power - _1)
    return -value if x < _0 else value


@kernel
def decode_rows(image: Floats, light: Floats, start: int, stop: int) -> None:
    """Linear light of rows (NxW) of sRGB values."""
    for y in range(start, stop):
        given, made = image[y], light[y]
        for x in range(made.size):
            made[x] = _decode(given[x])


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
def _blur_line(d: Any, line: Any, at: int, w: Any, pairs: int) -> None:
    """The same along a line, for the tile that begins there."""
    near = line[at - 2 : at + TILE + 2]
    w0, w1, w2 = w[0], w[1], w[2]
    for x in range(TILE):
        one, two = near[x + 1] + near[x + 3], near[x] + near[x + 4]
        d[x] = w0 * near[x + 2] + w1 * one + w2 * two
    for i in range(3, pairs, 2):
        left, right = line[at - i - 1 : at - i + TILE], line[at + i : at + i + TILE + 1]
        w1, w2 = w[i], w[i + 1]
        for x in range(TILE):
            d[x] += w1 * (left[x + 1] + right[x]) + w2 * (left[x] + right[x + 1])


@inner
def _enlarged(d: Any, grid: Any, n: int, left: int, right: int, w: Any) -> None:
    """Into d: lines n, n + 3, … of a grid, those of one channel, weighed."""
    w0, w1, w2, w3 = w[0], w[1], w[2], w[3]
    # one by one: of a block of lines, numba does not know that each is dense
    a, b = grid[n, left:right], grid[n + 3, left:right]
    p, q = grid[n + 6, left:right], grid[n + 9, left:right]
    for x in range(a.size):
        d[x] = (w0 * a[x] + w1 * b[x]) + (w2 * p[x] + w3 * q[x])


@inner
def _rows(t: Any, first: int, count: int) -> Any:
    """So many rows of a tile."""
    return t[first * TILE : (first + count) * TILE]


@inner
def _weighed(t: Any, to: int, first: int, w: Any) -> None:
    """Row `to` of a tile = Σ w[i]·(row first + i)."""
    d = _rows(t, to, 1)
    d[:] = _0
    i = 0
    while i + 2 < w.size:
        s, w0, w1, w2 = _rows(t, first + i, 3), w[i], w[i + 1], w[i + 2]
        for x in range(TILE):
            d[x] += w0 * s[x] + w1 * s[x + TILE] + w2 * s[x + 2 * TILE]
        i += 3
    while i < w.size:
        s, w0 = _rows(t, first + i, 1), w[i]
        for x in range(TILE):
            d[x] += w0 * s[x]
        i += 1


@inner
def _shares(t: Any, terms: int, to: int, water: Any, series: Any) -> None:
    """The weights of the blurs, from the distances in row 0; `terms` are rows to work in."""
    z, v, law = _rows(t, 0, 1), _rows(t, 1, 1), water.law
    count = series.shape[1]
    _rows(t, terms, 1)[:] = _1
    if count > 1:
        b_mean, scale, exponent = law[0], law[1], law[2]
        for x in range(TILE):
            v[x] = min(max(b_mean * z[x], f32(1e-6)), f32(1e4))
        if exponent != _1:
            for x in range(TILE):
                v[x] = _exp2(exponent * _log2(v[x]))
        linear, square, slope, offset = law[3] * scale, law[4] * scale * scale, law[5], law[6]
        for x in range(TILE):
            place = slope * _log2_1p(v[x] * (linear + square * v[x])) + offset
            v[x] = min(max(place, -_1), _1)
        _rows(t, terms + 1, 1)[:] = v
    for n in range(2, count):
        s = _rows(t, terms + n - 2, 3)
        for x in range(TILE):
            s[x + 2 * TILE] = _2 * v[x] * s[x + TILE] - s[x]
    for k in range(series.shape[0]):
        _weighed(t, to + k, terms, series[k])


@inner
def _curves(t: Any, decays: int, to: int, water: Any) -> None:
    """T_β, T_G − T_β and V(0) − V of three channels, from the distances in row 0."""
    z, rates, direct = _rows(t, 0, 1), water.rates, water.direct.shape[1]
    for r in range(direct):
        e, rate = _rows(t, decays + r, 1), rates[r]
        for x in range(TILE):
            e[x] = _exp2(rate * z[x])
    fallen = decays + rates.size
    for r in range(rates.size - direct):
        e, rate = _rows(t, decays + direct + r, 1), rates[direct + r]
        less = _rows(t, fallen + r, 1)
        for x in range(TILE):
            power, rest = _exp2_parts(rate * z[x])
            e[x] = power + rest
            less[x] = (power - _1) + rest
    for c in range(3):
        _weighed(t, to + c, decays, water.direct[c])
        _weighed(t, to + 3 + c, decays, water.scatter[c])
        _weighed(t, to + 6 + c, fallen, water.veil[c])


@inner
def _summed(t: Any, curves: int, shares: int, blurs: int, count: int, light: Any) -> Any:
    """D + F + B of one channel, into the row after its blurs."""
    total, blur, share = _rows(t, blurs + count, 1), _rows(t, blurs, 1), _rows(t, shares, 1)
    for x in range(TILE):
        total[x] = blur[x] * share[x]
    for k in range(1, count - 1, 2):
        b, w = _rows(t, blurs + k, 2), _rows(t, shares + k, 2)
        for x in range(TILE):
            total[x] += b[x] * w[x] + b[x + TILE] * w[x + TILE]
    if count % 2 == 0:
        blur, share = _rows(t, blurs + count - 1, 1), _rows(t, shares + count - 1, 1)
        for x in range(TILE):
            total[x] += blur[x] * share[x]
    direct, scatter, veil = _rows(t, curves, 1), _rows(t, curves + 3, 1), _rows(t, curves + 6, 1)
    for x in range(light.size):
        total[x] = veil[x] + direct[x] * light[x] + scatter[x] * total[x]
    return total


@inner
def _store(values: Any, srgb: bool, most: Any, out: Any, out_bytes: Any) -> None:
    """Encode a tile, and put it where there is room: into one of the two."""
    if srgb:
        for x in range(TILE):
            values[x] = min(max(_encode(values[x]), _0), most)
    for x in range(out.size):
        out[x] = values[x]
    for x in range(out_bytes.size):
        shifted = min(max(values[x] * _255, _0), _255) + _WHOLE
        out_bytes[x] = np.uint8(f32(shifted).view(i32) - _WHOLE_BITS)


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
    # rows of a tile: distance, place, terms, decays, decays less 1, curves, shares, blurs
    decays = 2 + terms
    curves = decays + 2 * water.rates.size
    shares = curves + 9
    blurs = shares + count
    t = np.zeros((blurs + count + 1) * TILE, np.float32)
    sharp = count - narrow - wide
    for y in range(start, stop):
        for k in range(narrow):
            for c in range(3):
                line = lines[k * 3 + c]
                inside = line[margin : margin + width]
                _blur_rows(inside, light[c], stack.rows, margin + y, stack.taps[k], stack.pairs[k])
                for x in range(margin):
                    line[x] = inside[stack.columns[x]]
                    line[margin + width + x] = inside[stack.columns[margin + width + x]]
        for left in range(0, width, TILE):
            right = min(left + TILE, width)
            _rows(t, 0, 1)[: right - left] = z[y, left:right]
            _shares(t, 2, shares, water, stack.series)
            _curves(t, decays, curves, water)
            for c in range(3):
                seen = light[c, y, left:right]
                if sharp:
                    _rows(t, blurs, 1)[: right - left] = seen
                for k in range(narrow):
                    d = _rows(t, blurs + sharp + k, 1)
                    _blur_line(d, lines[k * 3 + c], margin + left, stack.taps[k], stack.pairs[k])
                for k in range(wide):
                    d = _rows(t, blurs + sharp + narrow + k, 1)
                    first = stack.starts[k] + 3 * stack.back_first[k, y] + c
                    _enlarged(d, grid, first, left, right, stack.back[k, y])
                total = _summed(t, curves + c, shares, blurs, count, seen)
                bytes_row = out_bytes[c, y % out_bytes.shape[1], left:right]
                _store(total, srgb, most, out[c, y % out.shape[1], left:right], bytes_row)
