"""The compiled loops that form a picture without gradients.

Pixels are computed in tiles of `TILE` px of one row, counted from its left edge, so that their bits
depend neither on threads nor on strips. The rows of a tile, some 20, stay in the first cache.
(More arithmetic in one loop, two rates or four pairs of taps, is no faster.)

Slices are taken before a loop, so that no index can be negative: numba would otherwise test each,
and no loop would be vectorised. Arrays are copied by loops, too: `d[:n] = s` of two arrays would
take a quarter of the time of compiling.

numba has no vector functions of 2^x, log2 and sRGB. Those here are relatively right within 1e-7 for
2^x, 2e-7 for log2, 3e-7 for sRGB of 0…1. They stand in this file, as numba looks at no other to see
if a kernel that it keeps on disk is out of date.
"""

from typing import Any

import numpy as np

from uwaug.blur.kernels import HALVING
from uwaug.fast.gate import inner, kernel
from uwaug.fast.tables import (
    ENTRY_BITS,
    Bytes,
    CoarseTable,
    DevelopmentTable,
    DistanceTable,
    Floats,
    Indices,
    RaysTable,
    StackTable,
    WaterTable,
)

# ------------------------------------------------------------------------------ functions

f32, i32 = np.float32, np.int32
_0, _1 = f32(0), f32(1)
_LOG2E = np.log2(np.e)
_ROUNDING = f32(1.5 * 2**23)  # a sum with it has the nearest whole number in its last bits
_ROUNDING_BITS = int(np.float32(1.5 * 2**23).view(np.int32))
_ROOT_HALF_BITS = int(np.float32(0.5**0.5).view(np.int32))
_MIN_EXPONENT, _MAX_EXPONENT = f32(-100), f32(126)  # e^x of less gives slow subnormals


def _constants(values: str) -> tuple[np.float32, ...]:
    return tuple(f32(value) for value in values.split())


# all are Chebyshev fits: (2^f − 1)/f for |f| ≤ ½
_E0, _E1, _E2, _E3, _E4, _E5 = _constants(
    "0.693147188 0.240226509 0.0555035710 9.61805667e-3 1.33908674e-3 1.54614475e-4"
)
# log2(1 + f)/f for 1 + f from √½ to √2
_L0, _L1, _L2, _L3, _L4, _L5, _L6, _L7, _L8 = _constants(
    "1.44269500 -0.72134733 0.48091061 -0.36070483 0.28791832 -0.23892034 0.21566986 -0.20742104"
    " 0.12614847"
)
# ((x + .055)/1.055)^2.4, between the knee and 1 as v = −1…1; errors are weighed by what `encode`
# makes of them
_D0, _D1, _D2, _D3, _D4, _D5, _D6, _D7, _D8, _D9, _D10, _D11 = _constants(
    "0.233239993 0.466890424 0.272594959 0.0303321686 -0.00380271254 0.000905357068"
    " -0.000353941054 0.000425769365 -5.84588051e-05 -0.000261950219 -5.44070936e-05"
    " 0.000142998673"
)
# y^(1/2.4) for y from √½ to √2 as v = −1…1
_P0, _P1, _P2, _P3, _P4, _P5, _P6, _P7 = _constants(
    "1.02484167 0.142339051 -0.0138392113 0.00243530166 -0.000520724338 0.000123142119"
    " -3.71033384e-05 1.05816562e-05"
)
# 1.055·2^(n/2.4) for n = −8, …, 0 as u = −1…1
_G0, _G1, _G2, _G3, _G4, _G5, _G6, _G7 = _constants(
    "0.33230409 0.383892804 0.221749201 0.0853907168 0.0246360358 0.00569438841 0.00114529859"
    " 0.00018745441"
)
_SRGB_KNEE, _LINEAR_KNEE = f32(0.0404482362771076), f32(0.0404482362771076 / 12.92)  # see colour
_SLOPE, _UNSLOPE, _SCALE, _SHIFT = f32(12.92), f32(1 / 12.92), f32(1 / 1.055), f32(0.055)
_GAMMA, _UNGAMMA, _MAX_VALUE = f32(2.4), f32(1 / 2.4), f32(1e30)
_D_SCALE, _D_SHIFT = f32(2 / (1 - 0.0404482362771076)), f32(1.0404482362771076 / 0.9595517637228924)
_P_SCALE, _P_SHIFT = f32(8**0.5), f32(3)


@inner
def exp2_parts(x: Any) -> Any:
    """2^x as 2^n and 2^x − 2^n, so that 2^x − 1 can be had without cancellation."""
    x = min(max(x, _MIN_EXPONENT), _MAX_EXPONENT)
    shifted = x + _ROUNDING
    n = i32(f32(shifted).view(i32) - _ROUNDING_BITS)
    f = x - (shifted - _ROUNDING)
    p = f * (_E0 + f * (_E1 + f * (_E2 + f * (_E3 + f * (_E4 + f * _E5)))))
    power = i32(i32(n + 127) << 23).view(f32)
    return power, power * p


@inner
def exp2(x: Any) -> Any:
    """2^x, with x held at −100…126."""
    power, rest = exp2_parts(x)
    return power + rest


@inner
def _split(y: Any) -> Any:
    """Split y = 2^e·m, m from √½ to √2, into e and m."""
    bits = f32(y).view(i32)
    # numba's sums of 32 bits have 64, of which half as many fit into a register
    e = i32(i32(bits - _ROOT_HALF_BITS) >> 23)
    return e, i32(bits - i32(e << 23)).view(f32)


@inner
def log2(y: Any) -> Any:
    """Logarithm to base 2 of positive y."""
    e, m = _split(y)
    f = m - _1
    p = _L4 + f * (_L5 + f * (_L6 + f * (_L7 + f * _L8)))
    return f32(e) + f * (_L0 + f * (_L1 + f * (_L2 + f * (_L3 + f * p))))


@inner
def decode_unit(x: Any) -> Any:
    """Decode sRGB from 0 to 1. (By `log2` and `exp2` it takes twice as long.)"""
    v = max(x, _SRGB_KNEE) * _D_SCALE - _D_SHIFT
    p = _D5 + v * (_D6 + v * (_D7 + v * (_D8 + v * (_D9 + v * (_D10 + v * _D11)))))
    p = _D0 + v * (_D1 + v * (_D2 + v * (_D3 + v * (_D4 + v * p))))
    return x * _UNSLOPE if x < _SRGB_KNEE else min(p, _1)


@inner
def decode(x: Any) -> Any:
    """Decode any sRGB."""
    a = abs(x)
    m = min(max(a, _SRGB_KNEE), _MAX_VALUE)
    power = exp2(_GAMMA * log2(_1 + (m - _1) * _SCALE))
    value = a * _UNSLOPE if a < _SRGB_KNEE else power
    return -value if x < _0 else value


@inner
def encode_unit(x: Any) -> Any:
    """Encode linear light as sRGB, clipped to 0…1. (2.5 times as fast as by `log2`.)"""
    a = max(x, _0)
    e, m = _split(min(max(a, _LINEAR_KNEE), _1))
    v, u = m * _P_SCALE - _P_SHIFT, f32(e) * f32(0.25) + _1
    p = _P4 + v * (_P5 + v * (_P6 + v * _P7))
    p = _P0 + v * (_P1 + v * (_P2 + v * (_P3 + v * p)))
    g = _G4 + u * (_G5 + u * (_G6 + u * _G7))
    g = _G0 + u * (_G1 + u * (_G2 + u * (_G3 + u * g)))
    return a * _SLOPE if a < _LINEAR_KNEE else min(p * g - _SHIFT, _1)


@inner
def encode(x: Any) -> Any:
    """Encode any linear light."""
    a = abs(x)
    m = min(max(a, _LINEAR_KNEE), _MAX_VALUE)
    power = exp2(_UNGAMMA * log2(m))
    value = a * _SLOPE if a < _LINEAR_KNEE else power + _SHIFT * (power - _1)
    return -value if x < _0 else value


@inner
def nearest(x: Any) -> Any:
    """The nearest whole number, for |x| < 2^22; the even one of two as near."""
    return f32(x + _ROUNDING).view(i32) - _ROUNDING_BITS


# ------------------------------------------------------------------------------ tiles

TILE = 256  # px, width of a tile; others take up to half as long again
# Pixels of which a tile has a multiple; and lines that go through a coarse grid side by side. (16
# takes 10 to 80 % longer, 64 takes 20 to 40 %.)
LANES = 32
_HALVING = (f32(HALVING[0]), f32(HALVING[1]), f32(HALVING[2]))  # which is symmetric
# of the development's curves, see `uwaug.formation.development`
GAMUT_FROM, BEYOND, DARK, TOE = f32(0.75), f32(4), f32(1e-8), f32(1e-4)
_2, _255 = f32(2), f32(255)
_FRACTION_BITS, _FRACTION_UNIT = i32((1 << ENTRY_BITS) - 1), f32(1 / (1 << ENTRY_BITS))


@inner
def tile_row(t: Any, row: int) -> Any:
    """A row of a tile's memory."""
    return t[row * TILE : (row + 1) * TILE]


@inner
def tile_rows(t: Any, first: int, count: int) -> Any:
    """Rows of a tile's memory, one after another."""
    return t[first * TILE : (first + count) * TILE]


@inner
def clear(t: Any, first: int, count: int, n: int) -> None:
    """Set `n` pixels of rows of a tile's memory to 0."""
    for row in range(first, first + count):
        d = tile_row(t, row)
        for x in range(n):
            d[x] = _0


@inner
def copy(d: Any, s: Any) -> None:
    """Copy the values of `s` to the front of `d`."""
    for x in range(s.size):
        d[x] = s[x]


# ------------------------------------------------------------------------------ coarse grids


@inner
def add_rows(d: Any, plane: Any, rows: Any, w: Any) -> None:
    """Add Σ w[i]·plane[rows[i]] to `d`; there are 4, 8, … weights."""
    for i in range(0, w.size, 4):
        w0, w1, w2, w3 = w[i], w[i + 1], w[i + 2], w[i + 3]
        r0, r1, r2, r3 = plane[rows[i]], plane[rows[i + 1]], plane[rows[i + 2]], plane[rows[i + 3]]
        for x in range(d.size):
            d[x] += (w0 * r0[x] + w1 * r1[x]) + (w2 * r2[x] + w3 * r3[x])


@inner
def to_columns(columns: Any, lines: Any, width: int) -> None:
    """Write lines as columns of `LANES` samples, so that the next loops need no shuffling."""
    for x in range(width):
        column = columns[x * LANES : (x + 1) * LANES]
        for j in range(LANES):
            column[j] = lines[j, x]


@inner
def to_lines(grid: Any, top: int, count: int, columns: Any) -> None:
    """Write columns of `LANES` samples as lines of a grid."""
    for j in range(count):
        line = grid[top + j]
        for x in range(line.size):
            line[x] = columns[x * LANES + j]


@inner
def _mix_columns(d: Any, s: Any, w: Any, i: int) -> None:
    """Add a sum of four columns of `LANES` samples to `d`, with the weights from w[i] on."""
    w0, w1, w2, w3 = w[i], w[i + 1], w[i + 2], w[i + 3]
    for j in range(LANES):
        s01 = w0 * s[j] + w1 * s[j + LANES]
        d[j] += s01 + (w2 * s[j + 2 * LANES] + w3 * s[j + 3 * LANES])


@inner
def gather(to: Any, source: Any, first: Any, weights: Any) -> None:
    """Write columns of `LANES` samples, each a weighed sum of others."""
    to[:] = _0
    count, taps = weights.shape
    for k in range(count):
        column, begin = to[k * LANES : (k + 1) * LANES], first[k] * LANES
        for i in range(0, taps, 4):
            four = source[begin + i * LANES : begin + (i + 4) * LANES]
            _mix_columns(column, four, weights[k], i)


@inner
def extend(line: Any, fold: Any, margin: int, width: int, each: int) -> None:
    """Fill both margins of a line of `width` columns of `each` samples, mirrored."""
    for x in range(margin):
        left, right = (margin + fold[x]) * each, (margin + fold[margin + width + x]) * each
        for j in range(each):
            line[x * each + j] = line[left + j]
            line[(margin + width + x) * each + j] = line[right + j]


@kernel
def halve(
    light: Floats, rows: Indices, columns: Indices, half: Floats, start: int, stop: int
) -> None:
    """Make rows `start` to `stop` of the half picture of a picture (3xHxW), whose mirrored `rows`
    and `columns` begin three before the first.
    """
    _, _, width = light.shape
    line = np.zeros(width + 6, np.float32)
    inside, s = line[3 : 3 + width], line[1:]
    for c in range(3):
        plane = light[c]
        for y in range(start, stop):
            inside[:] = _0
            for i in range(3):
                w, first, last = _HALVING[i], 2 * y + 1 + i, 2 * y + 6 - i
                above, below = plane[rows[first]], plane[rows[last]]
                for x in range(width):
                    inside[x] += w * (above[x] + below[x])
            extend(line, columns, 3, width, 1)
            d, (w0, w1, w2) = half[c, y], _HALVING
            for x in range(d.size):
                outer, inner = s[2 * x] + s[2 * x + 5], s[2 * x + 1] + s[2 * x + 4]
                d[x] = w0 * outer + w1 * inner + w2 * (s[2 * x + 2] + s[2 * x + 3])


@kernel
def coarse_lines(
    half: Floats, grid: Floats, c: CoarseTable, origin: int, start: int, stop: int
) -> None:
    """Make lines `start` to `stop`, counted from `origin`, of a coarse grid (NxW): shrunk along
    both axes, and enlarged again along rows; `add_enlarged` enlarges them along columns. Line n of
    the whole grid is row n // 3 of channel n % 3.
    """
    channels, _, width = half.shape
    cells, taps = c.across.shape[0], c.down.shape[1]
    # a power of two would share few places of the cache: half as long again at 1024 px
    lines = np.zeros((LANES, width + 24), np.float32)
    flat = np.zeros((width + 2 * c.column_margin) * LANES, np.float32)
    small, wide = np.zeros(cells * LANES, np.float32), np.zeros(grid.shape[1] * LANES, np.float32)
    inside = flat[c.column_margin * LANES : (c.column_margin + width) * LANES]
    for top in range(start, stop, LANES):
        count = min(LANES, stop - top)
        for j in range(count):
            row, channel = (origin + top + j) // channels, (origin + top + j) % channels
            rows = c.rows[c.down_first[row] : c.down_first[row] + taps]
            line = lines[j, :width]
            line[:] = _0
            add_rows(line, half[channel], rows, c.down[row])
        to_columns(inside, lines, width)
        extend(flat, c.columns, c.column_margin, width, LANES)
        gather(small, flat, c.across_first, c.across)
        gather(wide, small, c.back_first, c.back)
        to_lines(grid, top, count, wide)


# ------------------------------------------------------------------------------ lamps

# First rows, in the memory of a tile, of: three channels of the scene, before three of sums;
# factors of daylight's veil; and what rays and lamps need. Row 0 holds the distances.
LIGHT, FACTOR, AT_LAMPS = 1, 7, 8
# First rows, from `AT_LAMPS` on, of: the distance without the field; three channels that surfaces
# send; three that arrive; one row for each rate. Rows 0 and 1 hold tangents to the right and down.
METRES, SURFACE, ARRIVAL, LAMP_ROWS = 2, 3, 6, 19
_HALF, _3 = f32(0.5), f32(3)
_MIN_M, _MIN_LENGTH, _MIN_LIGHT, _MAX_TANGENT = f32(1e-6), f32(1e-6), f32(1e-30), f32(1 - 1e-6)


@inner
def _send(t: Any, z: int, sharp: int, blurred: int, at: int, lamps: Any, n: int) -> None:
    """Light of surfaces under lamps: J for the share that comes straight, its blur for the rest."""
    distances, e = tile_row(t, z), tile_row(t, at + 9)
    count, direct = lamps.straight.shape[0], lamps.straight_rates.size
    sums = tile_rows(t, at + 10, 6)
    clear(sums, 0, 2 * count, n)
    for r in range(direct + lamps.rates.size):
        is_direct = r < direct
        rate = lamps.straight_rates[r] if is_direct else lamps.rates[r - direct]
        for x in range(n):
            e[x] = exp2(rate * distances[x])
        for c in range(count):
            w = lamps.straight[c, r] if is_direct else lamps.signal[c, r - direct]
            total = tile_row(sums, c if is_direct else count + c)
            for x in range(n):
                total[x] += w * e[x]
    for c in range(3):
        part = min(c, count - 1)
        straight, signal = tile_row(sums, part), tile_row(sums, count + part)
        J, B, d = tile_row(t, sharp + c), tile_row(t, blurred + c), tile_row(t, at + SURFACE + c)
        for x in range(n):
            share = min(straight[x] / max(signal[x], _MIN_LIGHT), _1)
            d[x] = B[x] + share * (J[x] - B[x])


@inner
def _faded(toward: Any, inner_edge: Any, outer_edge: Any) -> Any:
    """Share of a cone's light at an angle whose cosine is `toward`."""
    s = min(max((toward - outer_edge) / (inner_edge - outer_edge), _0), _1)
    return s * s * (_3 - _2 * s)


@inner
def _half_angle(sine: Any, cosine: Any, side: Any) -> Any:
    """tan(θ/2) of an end of a cone, held at −1…1."""
    return sine / (_1 + max(cosine, _0)) if cosine > _0 else side


@inner
def _shine(t: Any, z: int, at: int, lamp: Any, lamps: Any, n: int) -> None:
    """Geometry of a lamp of power 1 and of the rays, see `uwaug.light`. Row 9 becomes its light on
    the surface; 10 the way through the water; 11 and 12 (optical) nearest point and height of the
    ray; 13 and 14 the axis across and along it; 15 and 16 the middle and the half of its lit part;
    17 the factor of the fog.
    """
    px, py, pz, ax, ay, az = lamp[0], lamp[1], lamp[2], lamp[3], lamp[4], lamp[5]
    inner_edge, outer_edge, wide = lamp[6], lamp[7], lamp[8] > _0
    before = px * ax + py * ay + pz * az
    radius, phase = lamps.radius, _HALF * (_1 - lamps.asymmetry * lamps.asymmetry)
    distances, s, d = tile_row(t, z), tile_rows(t, at, 3), tile_rows(t, at + 9, 9)
    for x in range(n):
        X, Y, metres = s[x], s[x + TILE], s[x + METRES * TILE]
        shortening = _1 / np.sqrt(_1 + X * X + Y * Y)
        nearest = (X * px + (Y * py + pz)) * shortening
        u, v, w = py - pz * Y, pz * X - px, X * py - Y * px
        squared = (u * u + v * v + w * w) * (shortening * shortening) + radius
        height = np.sqrt(squared)
        beyond = metres - nearest
        one_over = _1 / np.sqrt(beyond * beyond + squared)
        along = (X * ax + (Y * ay + az)) * shortening
        across = (nearest * along - before) / height
        density = distances[x] / metres if metres > _MIN_M else _1
        toward = (across * height + along * beyond) * one_over
        share = _1 if wide else _faded(toward, inner_edge, outer_edge)
        d[x] = share * one_over * one_over
        d[x + TILE] = density * (metres + _1 / one_over)
        d[x + 2 * TILE], d[x + 3 * TILE] = density * nearest, density * height
        d[x + 4 * TILE], d[x + 5 * TILE] = across, along
        # the lit part: of the ray, and of the cone
        q = -nearest / height
        low = q / (_1 + np.sqrt(_1 + q * q))
        q = beyond / height
        high = q / (_1 + np.sqrt(_1 + q * q))
        size = max(np.sqrt(across * across + along * along), _MIN_LENGTH)
        c, k = along / size, across / size
        cosine = min(outer_edge / size, _1)
        sine = np.sqrt(_1 - cosine * cosine)
        side = _1 if along > _0 else -_1
        begin = _half_angle(c * cosine - k * sine, k * cosine + c * sine, side)
        end = _half_angle(c * cosine + k * sine, k * cosine - c * sine, side)
        low, high = (low, high) if wide else (max(low, begin), min(high, end))
        half = max(_HALF * (high - low), _0)
        d[x + 6 * TILE], d[x + 7 * TILE] = low + half, half
        d[x + 8 * TILE] = density * half / height * phase


@inner
def _scatter(t: Any, at: int, lamp: Any, lamps: Any, n: int) -> None:
    """Sum the fog of a lamp along each ray, for each rate: see `uwaug.light.backscatter`."""
    inner_edge, outer_edge, wide = lamp[6], lamp[7], lamp[8] > _0
    g = lamps.asymmetry
    least, twice = (_1 - g) * (_1 - g), _2 * g
    s = tile_rows(t, at + 9, 9)
    way, light = tile_row(t, at + 9), tile_row(t, at + 18)
    clear(t, at + LAMP_ROWS, lamps.rates.size, n)
    for q in range(lamps.nodes.shape[1]):
        node, weight = lamps.nodes[0, q], lamps.nodes[1, q]
        for x in range(n):
            v = min(s[x + 6 * TILE] + node * s[x + 7 * TILE], _MAX_TANGENT)
            above, below = _1 + v, _1 - v
            share = _1 / (_1 + v * v)
            raised = above * above * share
            narrow = least + twice * raised
            scattered = share * weight / (narrow * np.sqrt(narrow))
            toward = s[x + 4 * TILE] * (above * below * share) + s[x + 5 * TILE] * (raised - _1)
            faded = _1 if wide else _faded(toward, inner_edge, outer_edge)
            light[x] = scattered * faded
            way[x] = s[x + 2 * TILE] + s[x + 3 * TILE] * above / below
        for r in range(lamps.rates.size):
            rate, total = lamps.rates[r], tile_row(t, at + LAMP_ROWS + r)
            for x in range(n):
                total[x] += light[x] * exp2(rate * way[x])


@inner
def lamplight(t: Any, z: int, sharp: int, blurred: int, at: int, lamps: Any, n: int) -> None:
    """Light that arrives under lamps, in three rows from `at` + ARRIVAL on: from surfaces, whose
    light and its blur stand in rows from `sharp` and `blurred` on, and from the fog before them.
    """
    _send(t, z, sharp, blurred, at, lamps, n)
    d, surface = tile_rows(t, at + ARRIVAL, 3), tile_rows(t, at + SURFACE, 3)
    clear(d, 0, 3, n)
    s = tile_rows(t, at + 9, 9)
    for k in range(lamps.places.shape[0]):
        _shine(t, z, at, lamps.places[k], lamps, n)
        w, fog = lamps.arriving[k], lamps.fog[k]
        for r in range(lamps.rates.size):
            rate = lamps.rates[r]
            a0, a1, a2 = w[0, r], w[1, r], w[2, r]
            b0, b1, b2 = w[3, r], w[4, r], w[5, r]
            c0, c1, c2 = w[6, r], w[7, r], w[8, r]
            for x in range(n):
                e = s[x] * exp2(rate * s[x + TILE])
                red, green, blue = surface[x], surface[x + TILE], surface[x + 2 * TILE]
                d[x] += e * (a0 * red + a1 * green + a2 * blue)
                d[x + TILE] += e * (b0 * red + b1 * green + b2 * blue)
                d[x + 2 * TILE] += e * (c0 * red + c1 * green + c2 * blue)
        _scatter(t, at, lamps.places[k], lamps, n)
        strength = tile_row(t, at + 17)
        for r in range(lamps.rates.size):
            total, a0, a1, a2 = tile_row(t, at + LAMP_ROWS + r), fog[0, r], fog[1, r], fog[2, r]
            for x in range(n):
                light = strength[x] * total[x]
                d[x] += a0 * light
                d[x + TILE] += a1 * light
                d[x + 2 * TILE] += a2 * light


# ------------------------------------------------------------------------------ pixels


@kernel
def decode_rows(image: Floats, light: Floats, beyond: bool, start: int, stop: int) -> None:
    """Linear light of rows (NxW) of sRGB values; `beyond` if some may not lie in 0…1."""
    for y in range(start, stop):
        values, decoded = image[y], light[y]
        for x in range(decoded.size):
            decoded[x] = decode_unit(values[x])
        if beyond:
            for x in range(decoded.size):
                value = values[x]
                decoded[x] = decoded[x] if _0 <= value <= _1 else decode(value)


@kernel
def look_up(image: Bytes, table: Floats, light: Floats, start: int, stop: int) -> None:
    """Linear light of rows (NxW) of bytes, from a table of all bytes."""
    for y in range(start, stop):
        values, decoded = image[y], light[y]
        for x in range(decoded.size):
            decoded[x] = table[values[x]]


@kernel
def meter(
    light: Floats,
    z: Floats,
    metres: Floats,
    width: int,
    points: Any,
    water: WaterTable,
    rays: RaysTable,
    arriving: Floats,
) -> None:
    """Fill `arriving` (3xM) with the light that arrives without the blur at some pixels of a
    picture of light (3xN), z and metres (N). The indices `points` (M) have no sign, which numba
    would test.
    """
    totals = rows_before(water)
    t, entries = np.zeros((totals + 4) * TILE, f32), np.zeros(TILE, i32)
    for first in range(0, points.size, TILE):
        some = points[first : first + TILE]
        n = some.size
        distances, way = tile_row(t, 0), tile_row(t, AT_LAMPS + METRES)
        right, down = tile_row(t, AT_LAMPS), tile_row(t, AT_LAMPS + 1)
        for x in range(n):
            distances[x], way[x] = z[some[x]], metres[some[x]]
            right[x] = (f32(some[x] % width) - rays.middle[0]) * rays.tangent
            down[x] = (f32(some[x] // width) - rays.middle[1]) * rays.tangent
        for c in range(3):
            J, total, plane = tile_row(t, LIGHT + c), tile_row(t, totals + c), light[c]
            for x in range(n):
                J[x] = total[x] = plane[some[x]]
        arrive(t, totals, water, rays, totals + 3, entries, n)
        for c in range(3):
            copy(arriving[c, first : first + n], tile_row(t, totals + c)[:n])


@inner
def blur_rows(d: Any, plane: Any, fold: Any, middle: int, w: Any, pairs: int) -> None:
    """Blur across rows into `d`: Σ w[i]·(both rows i away from fold[middle]), of 2, 4, … pairs."""
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
def add_line(d: Any, share: Any, line: Any, at: int, w: Any, pairs: int, n: int) -> None:
    """Add a share of a line blurred along itself, for the tile that begins at `at`."""
    window = line[at - 2 : at + n + 2]
    w0, w1, w2 = w[0], w[1], w[2]
    for x in range(n):
        first, second = window[x + 1] + window[x + 3], window[x] + window[x + 4]
        d[x] += share[x] * (w0 * window[x + 2] + w1 * first + w2 * second)
    for i in range(3, pairs, 2):
        before, after = line[at - i - 1 : at - i + n], line[at + i : at + i + n + 1]
        w1, w2 = w[i], w[i + 1]
        for x in range(n):
            d[x] += share[x] * (w1 * (before[x + 1] + after[x]) + w2 * (before[x] + after[x + 1]))


@inner
def add_enlarged(d: Any, share: Any, grid: Any, n: int, left: int, right: int, w: Any) -> None:
    """Add a share of the weighed sum of lines n, n + 3, n + 6 and n + 9 of a grid."""
    w0, w1, w2, w3 = w[0], w[1], w[2], w[3]
    # one by one: of a block of lines, numba does not know that each is dense
    a, b = grid[n, left:right], grid[n + 3, left:right]
    p, q = grid[n + 6, left:right], grid[n + 9, left:right]
    for x in range(a.size):
        d[x] += share[x] * ((w0 * a[x] + w1 * b[x]) + (w2 * p[x] + w3 * q[x]))


@inner
def find_entries(t: Any, z: int, fraction: int, entries: Any, table: Any, n: int) -> None:
    """Find the entry of a table below each distance in row `z`, and the fraction to the next."""
    distances, s, first = tile_row(t, z), tile_row(t, fraction), i32(table.first)
    last = i32(first + ((table.rows.shape[1] - 1) << ENTRY_BITS) - 1)
    for x in range(n):
        bits = min(max(f32(distances[x]).view(i32), first), last)
        entries[x] = i32(i32(bits - first) >> ENTRY_BITS)
        s[x] = f32(i32(bits & _FRACTION_BITS)) * _FRACTION_UNIT


@inner
def interpolated(column: Any, entry: Any, fraction: Any) -> Any:
    """Value of a table at a fraction of the way from one entry to the next."""
    # without a sign, as numba would test an index that has one
    index = np.uint32(entry)
    low = column[index]
    return low + fraction * (column[index + np.uint32(1)] - low)


@inner
def width_places(t: Any, z: int, to: int, fraction: int, entries: Any, table: Any, n: int) -> None:
    """Places (−1…1) in a plan of the widths at the distances in row `z`."""
    find_entries(t, z, fraction, entries, table, n)
    s, d, places = tile_row(t, fraction), tile_row(t, to), table.rows[0]
    for x in range(n):
        d[x] = min(max(interpolated(places, entries[x], s[x]), -_1), _1)


@inner
def add_terms(t: Any, z: int, to: int, fraction: int, entries: Any, table: Any, n: int) -> None:
    """Add the light of further terms to three rows."""
    find_entries(t, z, fraction, entries, table, n)
    s = tile_row(t, fraction)
    for c in range(3):
        d, light = tile_row(t, to + c), table.rows[c]
        for x in range(n):
            d[x] += interpolated(light, entries[x], s[x])


@inner
def blur_weights(t: Any, place: int, to: int, series: Any, n: int) -> None:
    """Weights of the blurs, from the places; the rows after those take Chebyshev polynomials from
    T2 on, two at a time.
    """
    v, s = tile_row(t, place), tile_rows(t, place + 1, 2)
    for x in range(n):
        s[x] = _2 * v[x] * v[x] - _1
        s[x + TILE] = _2 * v[x] * s[x] - v[x]
    for term in range(4, series.shape[1], 2):
        s = tile_rows(t, place + term - 3, 4)
        for x in range(n):
            twice, last = _2 * v[x], s[x + TILE]
            even = twice * last - s[x]
            s[x + 2 * TILE] = even
            s[x + 3 * TILE] = twice * even - last
    for k in range(series.shape[0]):
        weigh_series(t, to + k, place, series[k], n)


@inner
def weigh_series(t: Any, to: int, first: int, w: Any, n: int) -> None:
    """Write w[0] + Σ w[i]·row[first + i − 1] into row `to`; there are 4, 6, … weights."""
    d, i = tile_row(t, to), 4
    w0, w1, w2, w3 = w[0], w[1], w[2], w[3]
    if w.size > 4:
        s, w4, w5, i = tile_rows(t, first, 5), w[4], w[5], 6
        for x in range(n):
            low = w0 + w1 * s[x] + w2 * s[x + TILE]
            high = w3 * s[x + 2 * TILE] + w4 * s[x + 3 * TILE] + w5 * s[x + 4 * TILE]
            d[x] = low + high
    else:
        s = tile_rows(t, first, 3)
        for x in range(n):
            d[x] = w0 + w1 * s[x] + (w2 * s[x + TILE] + w3 * s[x + 2 * TILE])
    while i < w.size:
        s, w0, w1 = tile_rows(t, first + i - 1, 2), w[i], w[i + 1]
        for x in range(n):
            d[x] += w0 * s[x] + w1 * s[x + TILE]
        i += 2


@inner
def rows_before(water: Any) -> int:
    """Rows of a tile's memory that distances, light, rays and lamps take."""
    lamps = water.lamps
    return AT_LAMPS + (LAMP_ROWS + lamps.rates.size if lamps.places.shape[0] > 0 else 3)


@inner
def arrive(t: Any, total: int, water: Any, rays: Any, fraction: int, entries: Any, n: int) -> None:
    """D + F + B and further light, in place of the blurred light in three rows from `total` on."""
    is_lit = water.lamps.places.shape[0] > 0
    _rise(t, rays, n)
    if is_lit:
        lamplight(t, 0, LIGHT, total, AT_LAMPS, water.lamps, n)
    _mix(t, 0, LIGHT, total, water.medium, n)
    if water.further.rows.shape[1] > 0:
        add_terms(t, 0, total, fraction, entries, water.further, n)
    for c in range(3 * is_lit):
        d, arrival = tile_row(t, total + c), tile_row(t, AT_LAMPS + ARRIVAL + c)
        for x in range(n):
            d[x] += arrival[x]


@inner
def _rise(t: Any, rays: Any, n: int) -> None:
    """Factors of daylight's veil on rays, see `uwaug.light.direction`."""
    factors, s = tile_row(t, FACTOR), tile_rows(t, AT_LAMPS, 2)
    if not rays.directed:
        for x in range(n):
            factors[x] = _1
        return
    for x in range(n):
        X, Y = s[x], s[x + TILE]
        rise = (rays.sine - Y * rays.cosine) / np.sqrt(_1 + X * X + Y * Y)
        less = _1 - rays.rise * min(rise, rays.most)
        factors[x] = _1 / (less * less)


@inner
def _mix(t: Any, z: int, sharp: int, total: int, medium: Any, n: int) -> None:
    """D + F + B in place of blurred light B in three rows from `total` on: Σ T_β·(J − B) + T_G·B
    and the veil times its factors, for J in three rows from `sharp` on. (Sums of 21 curves before
    the products take twice as long.)
    """
    distances, rates, direct = tile_row(t, z), medium.rates, medium.direct.shape[1]
    X, B, factors = tile_rows(t, sharp, 3), tile_rows(t, total, 3), tile_row(t, FACTOR)
    d = tile_rows(t, sharp + 3, 3)
    clear(d, 0, 3, n)
    for c in range(3):
        sharper, blurred = tile_row(X, c), tile_row(B, c)
        for x in range(n):
            sharper[x] -= blurred[x]
    for r in range(direct):
        rate, w = rates[r], medium.direct
        a0, a1, a2 = w[0, r], w[1, r], w[2, r]
        b0, b1, b2 = w[3, r], w[4, r], w[5, r]
        c0, c1, c2 = w[6, r], w[7, r], w[8, r]
        for x in range(n):
            e, red, green, blue = exp2(rate * distances[x]), X[x], X[x + TILE], X[x + 2 * TILE]
            d[x] += e * (a0 * red + a1 * green + a2 * blue)
            d[x + TILE] += e * (b0 * red + b1 * green + b2 * blue)
            d[x + 2 * TILE] += e * (c0 * red + c1 * green + c2 * blue)
    for r in range(direct, rates.size):
        rate, w, v = rates[r], medium.signal[:, r - direct], medium.veil[:, r - direct]
        a0, a1, a2, a3 = w[0], w[1], w[2], v[0]
        b0, b1, b2, b3 = w[3], w[4], w[5], v[1]
        c0, c1, c2, c3 = w[6], w[7], w[8], v[2]
        for x in range(n):
            power, rest = exp2_parts(rate * distances[x])
            e, less = power + rest, ((power - _1) + rest) * factors[x]
            red, green, blue = B[x], B[x + TILE], B[x + 2 * TILE]
            d[x] += e * (a0 * red + a1 * green + a2 * blue) + less * a3
            d[x + TILE] += e * (b0 * red + b1 * green + b2 * blue) + less * b3
            d[x + 2 * TILE] += e * (c0 * red + c1 * green + c2 * blue) + less * c3
    for c in range(3):
        copy(tile_row(B, c), tile_row(d, c)[:n])


@inner
def _add_noise(
    t: Any, total: int, at: int, normals: Any, begins: Any, development: Any, n: int
) -> None:
    """Add the sensor's noise to the light in three rows, see `uwaug.formation.sensor`."""
    for c in range(3):
        light, noise = tile_row(t, total + c), normals[begins[c] + at :]
        for x in range(min(n, noise.size)):
            variance = max(light[x], _0) * development.photons + development.dark
            light[x] += np.sqrt(variance) * noise[x]


@inner
def _develop(t: Any, total: int, table: Any, n: int) -> None:
    """Gain, gamut and tone of the light in three rows, see `uwaug.formation.development`."""
    share, contrast, offset, m = table.gamut, table.tone, table.tone_offset, table.gain
    d = tile_rows(t, total, 3)
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    for x in range(n):
        R, G, B = d[x], d[x + TILE], d[x + 2 * TILE]
        red = m0 * R + m1 * G + m2 * B
        green = m3 * R + m4 * G + m5 * B
        blue = m6 * R + m7 * G + m8 * B
        if share > _0:  # of all pixels or none
            brightest = max(red, green, blue, DARK)
            inverse, less = _1 / brightest, share * brightest
            red += less * _compression(_1 - red * inverse)
            green += less * _compression(_1 - green * inverse)
            blue += less * _compression(_1 - blue * inverse)
        d[x], d[x + TILE], d[x + 2 * TILE] = red, green, blue
    if contrast != _1:
        slope = contrast * offset / (_1 + offset)
        for c in range(3):
            light = tile_row(d, c)
            for x in range(n):
                size = max(abs(light[x]), TOE)
                inside = min(size, _1)
                power = exp2(contrast * log2(inside))
                curve = (_1 + offset) * power / (power + offset) + slope * (size - inside)
                light[x] *= curve / size


@inner
def _compression(distance: Any) -> Any:
    """Amount by which a distance from grey is made less."""
    beyond = max(distance - GAMUT_FROM, _0) * BEYOND
    return (beyond - beyond / np.sqrt(_1 + beyond * beyond)) * (_1 - GAMUT_FROM)


@inner
def _store(total: Any, highest: Any, out: Any, out_bytes: Any, n: int) -> None:
    """Encode the light of a tile, and write it to the one of two outputs that has room."""
    if highest > _1:
        for x in range(n):
            value = total[x]
            total[x] = encode_unit(value) if value <= _1 else min(encode(value), highest)
    elif highest > _0:
        for x in range(n):
            total[x] = encode_unit(total[x])
    copy(out, total[: out.size])
    for x in range(out_bytes.size):
        out_bytes[x] = np.uint8(nearest(min(max(total[x] * _255, _0), _255)))


@kernel
def splat(places: Floats, light: Floats, scene: Floats, layer: Floats) -> None:
    """Add the light of particles to a layer (3xHxW), see `uwaug.light.snow.splat`."""
    height, width = scene.shape
    for i in range(places.shape[1]):
        column, row, inner, outer = places[0, i], places[1, i], places[2, i], places[3, i]
        across, mixed, down, metres = places[4, i], places[5, i], places[6, i], places[7, i]
        reach = int(np.ceil(outer))
        left, top = int(np.rint(column)) - reach, int(np.rint(row)) - reach
        if left >= width or top >= height or left + 2 * reach < 0 or top + 2 * reach < 0:
            continue
        slope, total = _1 / (outer - inner), _0
        # first the sum of all weights, then each pixel's share
        for is_share in range(2):
            for y in range(top, top + 2 * reach + 1):
                for x in range(left, left + 2 * reach + 1):
                    dx, dy = f32(x) - column, f32(y) - row
                    squared = across * dx * dx + mixed * dx * dy + down * dy * dy
                    weight = min(max((outer - np.sqrt(max(squared, _0))) * slope, _0), _1)
                    if not is_share:
                        total += weight
                    elif 0 <= x < width and 0 <= y < height and scene[y, x] > metres:
                        for c in range(3):
                            layer[c, y, x] += light[c, i] * (weight / total)


@kernel
def render_rows(
    light: Floats,
    z: Floats,
    metres: Floats,
    snow: Floats,
    water: WaterTable,
    rays: RaysTable,
    widths: DistanceTable,
    stack: StackTable,
    grid: Floats,
    starts: Indices,
    normals: Floats,
    begins: Indices,
    development: DevelopmentTable,
    highest: Any,
    out: Floats,
    out_bytes: Bytes,
    start: int,
    stop: int,
) -> None:
    """Form rows `start` to `stop` of a picture.

    Args:
        light (3xHxW), z, metres (HxW): of the scene; effective distance, and without the field, m.
        snow (3xHxW, or 3x1x0): light of particles.
        water, rays, widths, stack, development: tables.
        grid (NxW), starts (m): lines of all coarse grids; the index at which those of each would
            start if they were whole.
        normals (N or 0), begins (3xH): of the sensor's noise; index of the first for each row.
        highest: largest sRGB value; 0 for linear light.
        out, out_bytes (3xHxW): one takes the result; the other is 3x1x0.
    """
    _, _, width = light.shape
    count, terms = stack.series.shape
    narrow, wide, margin = stack.taps.shape[0], stack.back.shape[0], stack.taps.shape[1] - 1
    padded = -(-width // TILE) * TILE + 2 * margin + 2
    lines = np.zeros((narrow * 3 + 1, padded), np.float32)
    # rows of a tile: shares, totals, place and terms of a series, fractions between entries of a
    # table
    shares = rows_before(water)
    totals = shares + count
    fractions = totals + 3 + max(terms, 1)
    t, entries = np.zeros((fractions + 1) * TILE, np.float32), np.zeros(TILE, np.int32)
    tile_row(t, shares)[:] = _1  # if there is one
    sharp = count - narrow - wide
    z_row, way = tile_row(t, 0), tile_row(t, AT_LAMPS + METRES)
    right_of, down = tile_row(t, AT_LAMPS), tile_row(t, AT_LAMPS + 1)
    for y in range(start, stop):
        for c in range(3):
            for k in range(narrow):
                line = lines[k * 3 + c]
                inside = line[margin : margin + width]
                blur_rows(inside, light[c], stack.rows, margin + y, stack.taps[k], stack.pairs[k])
                extend(line, stack.columns, margin, width, 1)
        for left in range(0, width, TILE):
            right = min(left + TILE, width)
            # whole registers, whatever their size: a rest would be computed by other instructions
            n = min(TILE, -(-(right - left) // LANES) * LANES)
            copy(z_row, z[y, left:right])
            copy(way, metres[y, left:right])
            for x in range(n):
                right_of[x] = (f32(left + x) - rays.middle[0]) * rays.tangent
                down[x] = (f32(y) - rays.middle[1]) * rays.tangent
            if count > 1:
                width_places(t, 0, totals + 3, fractions, entries, widths, n)
                blur_weights(t, totals + 3, shares, stack.series, n)
            for c in range(3):
                J, total_row = light[c, y, left:right], tile_row(t, totals + c)
                copy(tile_row(t, LIGHT + c), J)
                total_row[:] = _0
                if sharp:
                    share = tile_row(t, shares)
                    for x in range(J.size):
                        total_row[x] = share[x] * J[x]
                for k in range(narrow):
                    share, line = tile_row(t, shares + sharp + k), lines[k * 3 + c]
                    taps, pairs = stack.taps[k], stack.pairs[k]
                    add_line(total_row, share, line, margin + left, taps, pairs, n)
                for k in range(wide):
                    share = tile_row(t, shares + sharp + narrow + k)
                    first = starts[k] + 3 * stack.back_first[k, y] + c
                    add_enlarged(total_row, share, grid, first, left, right, stack.back[k, y])
            arrive(t, totals, water, rays, fractions, entries, n)
            for c in range(3 * min(1, snow.size)):
                total_row, layer = tile_row(t, totals + c), snow[c, y, left:right]
                for x in range(layer.size):
                    total_row[x] += layer[x]
            if normals.size > 0:
                _add_noise(t, totals, left, normals, begins[:, y], development, n)
            _develop(t, totals, development, n)
            for c in range(3):
                floats = out[c, y % out.shape[1], left:right]
                whole = out_bytes[c, y % out_bytes.shape[1], left:right]
                _store(tile_row(t, totals + c), highest, floats, whole, n)
