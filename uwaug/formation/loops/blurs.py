"""All blurs of a plan for pictures with gradients, and their transpose, as compiled loops.

The blurs are kept for the backward, where each has a gradient. Their transposes are added up into
one picture: Σ_k B_kᵀ g_k. A narrow blur is its own transpose, edges and all (see
`uwaug.blur.operators.operator`). That of one on a coarse grid goes the same way back: see
`uwaug.formation.loops.transposed` for its tables.
"""

import numpy as np

from uwaug.formation.loops.compiling import kernel
from uwaug.formation.loops.grids import LANES, _add_rows, _extend, _gather, _to_columns, _to_lines
from uwaug.formation.loops.pixels import TILE, _add_enlarged, _add_line, _blur_rows
from uwaug.formation.loops.tables import Floats, Stack
from uwaug.formation.loops.transposed import Back, Cells

__all__ = ["blurred_rows", "cell_lines", "gathered_rows"]

_NONE = np.float32(0)

_BLOCK = 32
"""Rows to which one transpose after the other is added."""


@kernel
def blurred_rows(
    light: Floats, stack: Stack, grid: Floats, out: Floats, start: int, stop: int
) -> None:
    """Rows of all blurs of a picture.

    Args:
        light (3xHxW): of the scene.
        stack: tables.
        grid (NxW): the lines of all coarse grids, from `uwaug.formation.loops.grids.coarse_lines`.
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
                out[0, y, c, :] = light[c, y]
            for k in range(narrow):
                _blur_rows(inside, light[c], stack.rows, margin + y, stack.taps[k], stack.pairs[k])
                _extend(line, stack.columns, margin, width, 1)
                d = out[sharp + k, y, c]
                for left in range(0, width, TILE):
                    tile[:] = _NONE
                    _add_line(tile, whole, line, margin + left, stack.taps[k], stack.pairs[k])
                    part = d[left : min(left + TILE, width)]
                    for x in range(part.size):
                        part[x] = tile[x]
            for k in range(wide):
                first = stack.starts[k] + 3 * stack.back_first[k, y] + c
                d = out[sharp + narrow + k, y, c]
                d[:] = _NONE
                _add_enlarged(d, whole, grid, first, 0, width, stack.back[k, y])


@kernel
def cell_lines(by: Floats, grid: Floats, cells: Cells, start: int, stop: int) -> None:
    """The transpose of one blur on a coarse grid, up to its last step, along columns.

    Args:
        by (3HxW): gradient of the blur; line 3y + c is of row y and channel c.
        grid (3hxW): the result; line 3r + c is of row r of the grid.
        cells: tables.
        start, stop: lines.
    """
    width = by.shape[1]
    count = cells.across.shape[0]
    # columns of a power of two would share few places of the cache, see `grids`
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
            line[:] = _NONE
            _add_rows(line, by, cells.rows[row], c, cells.down[row])
        _to_columns(whole, lines, width)
        _gather(inside, flat, cells.across_first, cells.across)
        _gather(whole, small, cells.along_first, cells.along)
        _to_lines(grid, top, together, whole)


@kernel
def gathered_rows(
    by: Floats, stack: Stack, grid: Floats, back: Back, out: Floats, start: int, stop: int
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
            totals[:] = _NONE
            for k in range(sharp + narrow):
                for j in range(count):
                    total, y = totals[j], top + j
                    if k < sharp:
                        total[:width] = by[k, 3 * y + c]
                        continue
                    taps, pairs = stack.taps[k - sharp], stack.pairs[k - sharp]
                    _blur_rows(inside, by[k], back.folds[c], margin + y, taps, pairs)
                    _extend(line, stack.columns, margin, width, 1)
                    for left in range(0, width, TILE):
                        part = total[left : left + TILE]
                        _add_line(part, whole, line, margin + left, taps, pairs)
            for j in range(count):
                d, y = out[c, top + j], top + j
                for k in range(wide):
                    _add_rows(totals[j, :width], grid, back.rows[k, y], c, back.up[k, y])
                for x in range(width):
                    d[x] += totals[j, x]
