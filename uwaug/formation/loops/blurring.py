"""All blurs of a picture by the compiled loops, kept for the backward, and their transposes."""

from functools import partial

import numpy as np

from uwaug.blur.plan import BlurPlan
from uwaug.formation.loops import loops
from uwaug.formation.loops.picture import coarse_grids
from uwaug.formation.loops.tables import Floats, plan_tables
from uwaug.formation.loops.threads import in_bands
from uwaug.formation.loops.transposed import transposed_tables

__all__ = ["add_transposed", "blur_all"]


def blur_all(light: Floats, plan: BlurPlan, out: Floats) -> None:
    """Into out (KxHx3xW): the plan's blurs of a picture (3xHxW), in the order of `Stack`."""
    _, height, width = light.shape
    tables = plan_tables(plan, (height, width))
    grid, starts = coarse_grids(light, tables, range(height))
    stack = tables.stack._replace(starts=starts)
    in_bands(partial(loops.get().blurs.blurred_rows, light, stack, grid, out), height, width)


def add_transposed(by: Floats, plan: BlurPlan, out: Floats) -> None:
    """To out (3xHxW), add Σ_k B_kᵀ by_k, for by (KxHx3xW) in the order of `Stack`."""
    _, height, width = out.shape
    size, loop = (height, width), loops.get()
    stack, tables = plan_tables(plan, size).stack, transposed_tables(plan, size)
    lines = by.reshape(len(by), 3 * height, width)
    counts = [3 * len(cells.rows) for cells in tables.cells]
    grid = np.empty((sum(counts), width), np.float32)
    wide = lines[len(lines) - len(counts) :]
    for one, start, count, cells in zip(wide, stack.starts, counts, tables.cells, strict=True):
        run = partial(loop.blurs.cell_lines, one, grid[start : start + count], cells)
        in_bands(run, count, width, loop.grids.LANES)
    run = partial(loop.blurs.gathered_rows, lines, stack, grid, tables.back, out)
    in_bands(run, height, width)
