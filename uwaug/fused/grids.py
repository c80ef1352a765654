"""The blurs on coarse grids, as compiled loops: all but the last step, the enlarging along columns.

numba compiles anew when the file of a function changes, and does not look at the files of what it
calls: what belongs together stands in one file. Slices are taken before a loop, so that no index
can be negative: numba would otherwise test each, and no loop would be vectorised.
"""

from typing import Any

import numpy as np

from uwaug.fused.compiling import inner, kernel
from uwaug.fused.tables import Coarse, Floats

__all__ = ["LANES", "coarse_lines"]

LANES = 32
"""Lines that go through a grid side by side. (16: 10 to 80 % longer; 64: 20 to 40 %.)"""

_NONE = np.float32(0)


@inner
def _shrink_rows(d: Any, plane: Any, fold: Any, w: Any) -> None:
    """Into d: Σ w[i]·(row fold[i]); there are 4, 8, … weights."""
    d[:] = _NONE
    for i in range(0, w.size, 4):
        w0, w1, w2, w3 = w[i], w[i + 1], w[i + 2], w[i + 3]
        r0, r1, r2, r3 = plane[fold[i]], plane[fold[i + 1]], plane[fold[i + 2]], plane[fold[i + 3]]
        for x in range(d.size):
            d[x] += (w0 * r0[x] + w1 * r1[x]) + (w2 * r2[x] + w3 * r3[x])


@inner
def _mix_columns(d: Any, s: Any, w: Any, i: int) -> None:
    """Add to d: Σ of four weights from w[i] on times columns of `LANES` samples."""
    w0, w1, w2, w3 = w[i], w[i + 1], w[i + 2], w[i + 3]
    for j in range(LANES):
        s01 = w0 * s[j] + w1 * s[j + LANES]
        d[j] += s01 + (w2 * s[j + 2 * LANES] + w3 * s[j + 3 * LANES])


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
    # columns of LANES samples, so that what follows needs no shuffling
    flat = np.zeros((width + 2 * c.column_margin) * LANES, np.float32)
    small = np.zeros(cells * LANES, np.float32)
    for top in range(start, stop, LANES):
        count = min(LANES, stop - top)
        for j in range(count):
            row, channel = (origin + top + j) // channels, (origin + top + j) % channels
            first = c.row_margin + c.down_first[row]
            _shrink_rows(
                lines[j, :width], light[channel], c.rows[first : first + taps], c.down[row]
            )
        inside = flat[c.column_margin * LANES :]
        for x in range(width):
            column = inside[x * LANES : (x + 1) * LANES]
            for j in range(LANES):
                column[j] = lines[j, x]
        _extend(flat, c.columns, c.column_margin, width, LANES)
        small[:] = _NONE
        for k in range(cells):
            first = (c.column_margin + c.across_first[k]) * LANES
            cell, weights = small[k * LANES : (k + 1) * LANES], c.across[k]
            for i in range(0, taps, 4):
                _mix_columns(cell, flat[first + i * LANES : first + (i + 4) * LANES], weights, i)
        inside[: width * LANES] = _NONE
        for x in range(width):
            first = c.back_first[x] * LANES
            column = inside[x * LANES : (x + 1) * LANES]
            _mix_columns(column, small[first : first + 4 * LANES], c.back[x], 0)
        for j in range(count):
            line = grid[top + j]
            for x in range(width):
                line[x] = inside[x * LANES + j]
