"""The blurs on coarse grids, as compiled loops: all but the last step, the enlarging along columns.

Slices are taken before a loop, so that no index can be negative: numba would otherwise test each,
and no loop would be vectorised.
"""

from typing import Any

import numpy as np

from uwaug.formation.loops.compiling import inner, kernel
from uwaug.formation.loops.tables import Coarse, Floats

__all__ = ["LANES", "coarse_lines"]

LANES = 32
"""Lines that go through a grid side by side. (16: 10 to 80 % longer; 64: 20 to 40 %.)"""

_NONE = np.float32(0)


@inner
def _add_rows(d: Any, plane: Any, rows: Any, c: int, w: Any) -> None:
    """Add to d: Σ w[i]·(row rows[i] + c); there are 4, 8, … weights."""
    for i in range(0, w.size, 4):
        w0, w1, w2, w3 = w[i], w[i + 1], w[i + 2], w[i + 3]
        r0, r1 = plane[rows[i] + c], plane[rows[i + 1] + c]
        r2, r3 = plane[rows[i + 2] + c], plane[rows[i + 3] + c]
        for x in range(d.size):
            d[x] += (w0 * r0[x] + w1 * r1[x]) + (w2 * r2[x] + w3 * r3[x])


@inner
def _to_columns(columns: Any, lines: Any, width: int) -> None:
    """Lines as columns of `LANES` samples, so that what follows needs no shuffling."""
    for x in range(width):
        column = columns[x * LANES : (x + 1) * LANES]
        for j in range(LANES):
            column[j] = lines[j, x]


@inner
def _to_lines(grid: Any, top: int, count: int, columns: Any) -> None:
    """Back again, into so many lines of a grid."""
    for j in range(count):
        line = grid[top + j]
        for x in range(line.size):
            line[x] = columns[x * LANES + j]


@inner
def _mix_columns(d: Any, s: Any, w: Any, i: int) -> None:
    """Add to d: Σ of four weights from w[i] on times columns of `LANES` samples."""
    w0, w1, w2, w3 = w[i], w[i + 1], w[i + 2], w[i + 3]
    for j in range(LANES):
        s01 = w0 * s[j] + w1 * s[j + LANES]
        d[j] += s01 + (w2 * s[j + 2 * LANES] + w3 * s[j + 3 * LANES])


@inner
def _gather(to: Any, source: Any, first: Any, weights: Any) -> None:
    """Columns of `LANES` samples, each a weighed sum of others."""
    to[:] = _NONE
    count, taps = weights.shape
    for k in range(count):
        column, begin = to[k * LANES : (k + 1) * LANES], first[k] * LANES
        for i in range(0, taps, 4):
            four = source[begin + i * LANES : begin + (i + 4) * LANES]
            _mix_columns(column, four, weights[k], i)


@inner
def _extend(line: Any, fold: Any, margin: int, width: int, each: int) -> None:
    """Fill both margins of a line of `width` columns of `each` samples, mirrored."""
    for x in range(margin):
        left, right = (margin + fold[x]) * each, (margin + fold[margin + width + x]) * each
        for j in range(each):
            line[x * each + j] = line[left + j]
            line[(margin + width + x) * each + j] = line[right + j]


@kernel
def coarse_lines(
    light: Floats, grid: Floats, c: Coarse, origin: int, start: int, stop: int
) -> None:
    """Lines of a coarse grid, shrunk along both axes and enlarged again along rows.

    Args:
        light (3xHxW): of the scene.
        grid (NxW): lines from `origin` on; n is of channel n % 3, of row n // 3 of the whole grid.
        c: tables of the grid.
        start, stop: lines, counted from `origin`.
    """
    channels, _, width = light.shape
    cells, taps = c.across.shape
    # columns of a power of two would share few places of the cache: half as long again at 1024 px
    lines = np.zeros((LANES, width + 24), np.float32)
    flat = np.zeros((width + 2 * c.column_margin) * LANES, np.float32)
    small = np.zeros(cells * LANES, np.float32)
    inside = flat[c.column_margin * LANES : (c.column_margin + width) * LANES]
    for top in range(start, stop, LANES):
        count = min(LANES, stop - top)
        for j in range(count):
            row, channel = (origin + top + j) // channels, (origin + top + j) % channels
            rows = c.rows[c.down_first[row] : c.down_first[row] + taps]
            line = lines[j, :width]
            line[:] = _NONE
            _add_rows(line, light[channel], rows, 0, c.down[row])
        _to_columns(inside, lines, width)
        _extend(flat, c.columns, c.column_margin, width, LANES)
        _gather(small, flat, c.across_first, c.across)
        _gather(inside, small, c.back_first, c.back)
        _to_lines(grid, top, count, inside)
