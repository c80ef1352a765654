"""The compiled loops that take gradients of a picture back to scene, distances and medium.

All blurs of a picture are made anew (`blurred_rows`). `slope_rows` goes through the pixels once:
it leaves the gradient of each blur in its place, and adds up what belongs to the medium. The
transposes of the blurs are then added up into one picture, Σ_k B_kᵀ g_k (`cell_lines`,
`gathered_rows`). A narrow blur is its own transpose, edges and all (see
`uwaug.blur.banded.operator`).
"""

from typing import Any

import numpy as np

from uwaug.formation.loops.approx import exp2_parts, log2
from uwaug.formation.loops.backend import inner, kernel
from uwaug.formation.loops.kernels import (
    LANES,
    TILE,
    add_enlarged,
    add_line,
    add_rows,
    blur_rows,
    blur_weights,
    copy,
    curves,
    extend,
    gather,
    powers,
    tile_row,
    to_columns,
    to_lines,
    weigh_series,
    width_places,
)
from uwaug.formation.loops.tables import BackTable, CellTable, Floats, MediumTable, StackTable

ROWS = 64
"""Rows of a picture whose slopes are added up together, so that sums do not depend on threads."""

_0, _1, _LN2 = np.float32(0), np.float32(1), np.float32(np.log(2))

_BLOCK = 32
"""Rows to which one transpose after the other is added."""

# ------------------------------------------------------------------------------ blurs


@kernel
def blurred_rows(
    light: Floats, stack: StackTable, grid: Floats, out: Floats, start: int, stop: int
) -> None:
    """Rows of all blurs of a picture.

    Args:
        light (3xHxW): of the scene.
        stack: tables.
        grid (NxW): the lines of all coarse grids, of `uwaug.formation.loops.kernels.coarse_lines`.
        out (KxHx3xW): the blurs, in the order of the stack.
        start, stop: rows.
    """
    _, _, width = light.shape
    narrow, wide, margin = stack.taps.shape[0], stack.back.shape[0], stack.margin
    sharp = stack.series.shape[0] - narrow - wide
    line = np.zeros(-(-width // TILE) * TILE + 2 * margin + 2, np.float32)
    inside = line[margin : margin + width]
    tile, whole = np.zeros(TILE, np.float32), np.ones(max(TILE, width), np.float32)
    for y in range(start, stop):
        for c in range(3):
            if sharp:
                copy(out[0, y, c], light[c, y])
            for k in range(narrow):
                blur_rows(inside, light[c], stack.rows, margin + y, stack.taps[k], stack.pairs[k])
                extend(line, stack.columns, margin, width, 1)
                d = out[sharp + k, y, c]
                for left in range(0, width, TILE):
                    tile[:] = _0
                    add_line(tile, whole, line, margin + left, stack.taps[k], stack.pairs[k])
                    part = d[left : min(left + TILE, width)]
                    copy(part, tile[: part.size])
            for k in range(wide):
                first = stack.starts[k] + 3 * stack.back_first[k, y] + c
                d = out[sharp + narrow + k, y, c]
                d[:] = _0
                add_enlarged(d, whole, grid, first, 0, width, stack.back[k, y])


@kernel
def cell_lines(by: Floats, grid: Floats, cells: CellTable, start: int, stop: int) -> None:
    """The transpose of one blur on a coarse grid, up to its last step, along columns.

    Args:
        by (3HxW): gradient of the blur; line 3y + c is of row y and channel c.
        grid (3hxW): the result; line 3r + c is of row r of the grid.
        cells: tables.
        start, stop: lines.
    """
    width = by.shape[1]
    count = cells.across.shape[0]
    # columns of a power of two would share few places of the cache, see `kernels.coarse_lines`
    lines = np.zeros((LANES, width + 24), np.float32)
    # what a kernel reaches beyond the end has no weight
    flat = np.zeros((width + cells.across.shape[1]) * LANES, np.float32)
    small = np.zeros((count + cells.along.shape[1]) * LANES, np.float32)
    whole, inside = flat[: width * LANES], small[: count * LANES]
    for top in range(start, stop, LANES):
        together = min(LANES, stop - top)
        for j in range(together):
            row, c = (top + j) // 3, (top + j) % 3
            line = lines[j, :width]
            line[:] = _0
            add_rows(line, by, cells.rows[row], c, cells.down[row])
        to_columns(whole, lines, width)
        gather(inside, flat, cells.across_first, cells.across)
        gather(whole, small, cells.along_first, cells.along)
        to_lines(grid, top, together, whole)


@kernel
def gathered_rows(
    by: Floats, stack: StackTable, grid: Floats, back: BackTable, out: Floats, start: int, stop: int
) -> None:
    """Add to rows of a picture the transposes of all blurs.

    Args:
        by (Kx3HxW): gradients of the blurs, in the order of the stack; lines as for `cell_lines`.
        stack: tables.
        grid (NxW): the lines that `cell_lines` makes of all coarse grids.
        back: tables.
        out (3xHxW): gradient of the picture, to which they are added.
        start, stop: rows.
    """
    _, _, width = out.shape
    narrow, wide, margin = stack.taps.shape[0], stack.back.shape[0], stack.margin
    sharp = stack.series.shape[0] - narrow - wide
    padded = -(-width // TILE) * TILE
    line = np.zeros(padded + 2 * margin + 2, np.float32)
    inside = line[margin : margin + width]
    whole, totals = np.ones(TILE, np.float32), np.zeros((_BLOCK, padded), np.float32)
    for top in range(start, stop, _BLOCK):
        count = min(_BLOCK, stop - top)
        for c in range(3):
            totals[:] = _0
            for k in range(sharp + narrow):
                for j in range(count):
                    total, y = totals[j], top + j
                    if k < sharp:
                        copy(total, by[k, 3 * y + c])
                        continue
                    taps, pairs = stack.taps[k - sharp], stack.pairs[k - sharp]
                    blur_rows(inside, by[k], back.folds[c], margin + y, taps, pairs)
                    extend(line, stack.columns, margin, width, 1)
                    for left in range(0, width, TILE):
                        part = total[left : left + TILE]
                        add_line(part, whole, line, margin + left, taps, pairs)
            for j in range(count):
                d, y = out[c, top + j], top + j
                for k in range(wide):
                    add_rows(totals[j, :width], grid, back.rows[k, y], c, back.up[k, y])
                for x in range(width):
                    d[x] += totals[j, x]


# ------------------------------------------------------------------------------ pixels


@inner
def _fill(t: Any, row: int, values: Any) -> None:
    """A row of a tile, with zeros behind what there is."""
    d = tile_row(t, row)
    copy(d, values)
    d[values.size :] = _0


@inner
def _add_product(sums: Any, row: int, t: Any, first: int, second: int) -> None:
    d, a, b = tile_row(sums, row), tile_row(t, first), tile_row(t, second)
    for x in range(TILE):
        d[x] += a[x] * b[x]


@inner
def _by_blur(
    t: Any, through: int, share: int, steep: int, work: int, by_width: int, to: Any
) -> None:
    """Gradient of a blur of one channel, and its part of the mixture and of the slope by its place
    in the plan.
    """
    mixture, blur = tile_row(t, work), tile_row(t, work + 1)
    by_place = tile_row(t, by_width)
    g, w, slope = tile_row(t, through), tile_row(t, share), tile_row(t, steep)
    # one loop for both would need more tests of overlap than LLVM allows, and not be vectorised
    for x in range(TILE):
        mixture[x] += w[x] * blur[x]
    for x in range(TILE):
        by_place[x] += g[x] * (slope[x] * blur[x])
    for x in range(to.size):
        to[x] = w[x] * g[x]


@inner
def _by_rates(t: Any, sums: Any, by: int, work: int, medium: MediumTable) -> None:
    """Add up slopes of weights and rates; into row work + 1, those of distances. From `by` on,
    slopes of the nine curves.
    """
    direct, rates = medium.direct.shape[1], medium.rates.size
    z, g, by_z = tile_row(t, 0), tile_row(t, work), tile_row(t, work + 1)
    e, less = tile_row(t, work + 2), tile_row(t, work + 3)
    by_z[:] = _0
    for r in range(rates):
        rate = medium.rates[r]
        for x in range(TILE):
            power, rest = exp2_parts(rate * z[x])
            e[x] = power + rest
            less[x] = (power - _1) + rest
        g[:] = _0
        for c in range(3):
            s, w = tile_row(t, by + 3 + c), medium.scatter[c, r]
            other, v = tile_row(t, by + c), medium.direct[c, r] if r < direct else _0
            if r >= direct:
                other, v = tile_row(t, by + 6 + c), medium.veil[c, r - direct]
            for x in range(TILE):
                g[x] += w * s[x] + v * other[x]
            _add_product(sums, 7 * r + c, t, by + 3 + c, work + 2)
            if r < direct:
                _add_product(sums, 7 * r + 3 + c, t, by + c, work + 2)
            else:
                _add_product(sums, 7 * r + 3 + c, t, by + 6 + c, work + 3)
        steepness, d = rate * _LN2, tile_row(sums, 7 * r + 6)
        for x in range(TILE):
            fallen = g[x] * e[x]
            by_z[x] += steepness * fallen
            d[x] += z[x] * fallen


@inner
def _by_widths(t: Any, sums: Any, place: int, by_width: int, power: int, law: Any) -> None:
    """Add up slopes of b̄, scale and exponent; into row `by_width`, those of distances, in place of
    those by ln(1 + x), x = 2σ or 2σ². `power` is the row of (b̄·z)^exponent.
    """
    b_mean, scale, exponent, linear, square = law[0], law[1], law[2], law[3], law[4]
    least, most = law[7], law[8]
    z, v = tile_row(t, 0), tile_row(t, place)
    g, p = tile_row(t, by_width), tile_row(t, power)
    by_b, by_scale, by_exponent = tile_row(sums, 0), tile_row(sums, 1), tile_row(sums, 2)
    for x in range(TILE):
        s = scale * p[x]
        slope = (linear + (square + square) * s) / (_1 + s * (linear + square * s))
        p[x] *= g[x] * slope if abs(v[x]) < _1 else _0
        by_scale[x] += p[x]
    for x in range(TILE):
        length = b_mean * z[x]
        within = min(max(length, least), most)
        by_exponent[x] += scale * p[x] * (_LN2 * log2(within))
        by_length = scale * exponent * p[x] / within if within == length else _0
        by_b[x] += z[x] * by_length
        g[x] = b_mean * by_length


@kernel
def slope_rows(
    gradient: Floats,
    light: Floats,
    z: Floats,
    medium: MediumTable,
    stack: StackTable,
    steeper: Floats,
    blurs: Floats,
    to_light: Floats,
    to_z: Floats,
    all_sums: Floats,
    start: int,
    stop: int,
) -> None:
    """Gradients of rows of a picture, D + F + B, before the blurs are transposed.

    Args:
        gradient (3xHxW): of the result.
        light (3xHxW), z (HxW): of the scene; effective distance, m.
        medium, stack: tables; of the stack, the series.
        steeper (K, N): series of the slopes of the weights by ln(1 + x), x = 2σ or 2σ².
        blurs (KxHx3xW): of the scene, in the order of the series; their gradients take their place.
        to_light (3xHxW), to_z (HxW): gradients of light, without what has been blurred, and of z.
        all_sums (H/ROWS, (3 + 7R)·TILE): gradients of b̄, scale and exponent; and for each rate the
            products of curves' slopes with what falls: of T_G − T_β, of T_β or V, and of the rate.
        start, stop: rows.
    """
    _, _, width = light.shape
    count, terms = stack.series.shape
    # rows of a tile as in `render_rows`, slopes of weights and of curves, and room
    shares = 10
    steep = shares + count
    by = steep + count
    place = by + 9
    work = place + terms
    power = work + 4
    by_width = power + 1
    t = np.zeros((by_width + 1) * TILE, np.float32)
    for y in range(start, stop):
        sums = all_sums[y // ROWS]
        for left in range(0, width, TILE):
            right = min(left + TILE, width)
            _fill(t, 0, z[y, left:right])
            powers(t, 0, power, medium.law)
            copy(tile_row(t, place), tile_row(t, power))
            width_places(t, place, medium.law)
            blur_weights(t, place, shares, stack.series)
            for k in range(count):
                weigh_series(t, steep + k, place, steeper[k])
            curves(t, 0, 1, medium)
            tile_row(t, by_width)[:] = _0
            for c in range(3):
                _fill(t, by + 6 + c, gradient[c, y, left:right])
                _fill(t, by + c, light[c, y, left:right])
                g, by_direct = tile_row(t, by + 6 + c), tile_row(t, by + c)
                through = tile_row(t, by + 3 + c)
                direct, scatter = tile_row(t, 1 + 3 * c), tile_row(t, 2 + 3 * c)
                for x in range(TILE):
                    through[x] = g[x] * scatter[x]
                    by_direct[x] *= g[x]
                d = to_light[c, y, left:right]
                for x in range(d.size):
                    d[x] = g[x] * direct[x]
                mixture = tile_row(t, work)
                mixture[:] = _0
                for k in range(count):
                    blur = blurs[k, y, c, left:right]
                    _fill(t, work + 1, blur)
                    _by_blur(t, by + 3 + c, shares + k, steep + k, work, by_width, blur)
                for x in range(TILE):
                    through[x] = g[x] * mixture[x]
            _by_widths(t, sums[: 3 * TILE], place, by_width, power, medium.law)
            _by_rates(t, sums[3 * TILE :], by, work, medium)
            by_curves, by_blur = tile_row(t, work + 1), tile_row(t, by_width)
            d = to_z[y, left:right]
            for x in range(d.size):
                d[x] = by_curves[x] + by_blur[x]
