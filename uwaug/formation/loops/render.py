"""Pictures by the compiled loops: decoding, and all from light to the encoded picture."""

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from threading import Lock

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import get_worker_info

from uwaug._support.tiles import RowSource
from uwaug.blur.plan import BlurPlan
from uwaug.blur.tiled import PartBlur, keep_coarse
from uwaug.formation.loops.backend import loaded
from uwaug.formation.loops.tables import (
    Floats,
    Indices,
    MediumTable,
    PlanTable,
    coarse_nodes,
    medium_tables,
    plan_table,
)
from uwaug.optics.medium import Medium

_NO_FLOATS, _NO_BYTES = np.zeros((3, 1, 0), np.float32), np.zeros((3, 1, 0), np.uint8)

NO_LOOK = torch.tensor([[0.0, 1.0, 0.0, 1.0, 0.0]], dtype=torch.float32, device="cpu")
"""Of a development that is linear, see `uwaug.formation.development.look_of`."""

_BAND = 1 << 20
"""Pixels whose coarse grids are held at a time: of all together, up to 24 MiB."""


def decode(image: Tensor, srgb: bool, beyond: bool = False) -> Tensor:
    """Linear light of a picture of bytes, or of sRGB values in float32.

    Args:
        srgb: whether bytes are sRGB.
        beyond: whether some values may lie outside of 0…1.
    """
    kernels, width = loaded("kernels"), image.shape[-1]
    light = torch.empty(image.shape, dtype=torch.float32, device="cpu")
    values = image.detach().contiguous().numpy().reshape(-1, width)
    rows = light.numpy().reshape(-1, width)
    if image.dtype == torch.uint8:
        # by the same arithmetic as floating point, so that both give one picture
        unit = np.arange(256, dtype=np.float32)[None] / np.float32(255)
        table = unit.copy()
        if srgb:
            kernels.decode_rows(unit, table, False, 0, 1)
        run = partial(kernels.look_up, values, table[0], rows)
    else:
        run = partial(kernels.decode_rows, values, rows, beyond)
    in_bands(run, range(len(values)), width)
    return light


def render(
    light: Tensor,
    z: Tensor,
    medium: Medium,
    plan: BlurPlan,
    *,
    srgb: bool = False,
    largest: float | Tensor = 1.0,
    look: Tensor = NO_LOOK,
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """D + F + B of a batch of pictures, in the line of sight, developed and encoded.

    Args:
        light (Bx3xHxW tensor), z (Bx1xHxW tensor): of the scene; effective distances, m; float32.
        medium: of any number of rows.
        plan: of the blur.
        srgb: encode; otherwise the result is linear light.
        largest: sRGB value of the result, ≥ 1, one or (B, …).
        look (B or 1, 5): from `uwaug.formation.development.look_of`.
        dtype: of the result; uint8 is rounded and clipped.
    """
    size = (light.shape[-2], light.shape[-1])
    batch = max(len(light), len(z), len(medium))
    kind = torch.uint8 if dtype == torch.uint8 else torch.float32
    result = torch.empty(batch, 3, *size, dtype=kind, device="cpu")
    largest = torch.as_tensor(largest, dtype=torch.float32, device="cpu")
    largest = largest.reshape(-1).expand(batch)
    looks = np.array(look.expand(batch, -1).numpy(), np.float32, order="C")
    media = medium_tables(medium, plan, size)
    render_into(result, light, z, plan, media, srgb, largest.numpy(), looks)
    return result.to(dtype)


def render_into(
    result: Tensor,
    light: Tensor,
    z: Tensor,
    plan: BlurPlan,
    media: Sequence[MediumTable],
    srgb: bool,
    largest: Floats,
    looks: Floats,
) -> None:
    """Render a batch; `media` are for this plan and size, `largest` and `looks` have a row for each
    result.
    """
    scenes, metres = light.detach().contiguous().numpy(), z.detach().contiguous().numpy()
    size, results = (light.shape[-2], light.shape[-1]), result.numpy()
    table, kernel = plan_table(plan, size), loaded("kernels").render_rows
    for i, scene in enumerate(scenes):
        # one picture in several waters is blurred once
        samples = range(len(results)) if len(scenes) == 1 else (i,)
        for rows in _bands(size):
            grid, starts = coarse_grids(scene, table, rows)
            stack = table.stack._replace(starts=starts)
            for n in samples:
                out = results[n]
                outs = (_NO_FLOATS, out) if out.dtype == np.uint8 else (out, _NO_BYTES)
                maps = (scene, metres[n % len(metres), 0], media[n % len(media)])
                run = partial(kernel, *maps, stack, grid, srgb, largest[n], looks[n], *outs)
                in_bands(run, rows, size[1])


def render_in_rows(
    light: RowSource,
    z: RowSource,
    medium: Medium,
    plan: BlurPlan,
    *,
    srgb: bool = False,
    largest: float | Tensor = 1.0,
    look: Tensor = NO_LOOK,
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """`render` of one large picture (1x3xHxW), whose light and distances are made a band of rows at
    a time. Blurs on the coarsest grids are made first, by `uwaug.blur.tiled`, and kept, as they
    reach far beyond a band.
    """
    height, width = light.size
    table, kernel = plan_table(plan, light.size), loaded("kernels").render_rows
    (numbers,) = medium_tables(medium, plan, light.size)
    blurs = [PartBlur(node, light.size, light.like) for node in coarse_nodes(plan)]
    keep_coarse(blurs, light.rows, height)
    largest = torch.as_tensor(largest, dtype=torch.float32, device="cpu")
    (largest,) = largest.reshape(-1).numpy()
    developing = np.array(look[0].numpy(), np.float32)
    in_bytes = dtype == torch.uint8
    result = torch.empty(1, 3, height, width, dtype=dtype, device="cpu")
    window, first = np.empty((3, 0, width), np.float32), 0
    for rows in _bands(light.size):
        low, high = _reached(table, rows, blurs)
        # rows that the band before had are there
        overlap = window[:, max(low - first, 0) :]
        first, begin = low, max(low, low + overlap.shape[1])
        fresh = [light.rows(begin, high).numpy()] if begin < high else []
        window = np.concatenate([overlap, *fresh], 1)
        inside = range(rows.start - low, rows.stop - low)
        part = _cut(table, low, high)
        grid, starts = coarse_grids(window, part, inside, blurs)
        # of what is empty, pages that are not touched take no memory
        metres = np.empty((high - low, width), np.float32)
        metres[inside.start : inside.stop] = z.rows(rows.start, rows.stop)[0].numpy()
        out = np.empty((3, high - low, width), np.uint8 if in_bytes else np.float32)
        outs = (_NO_FLOATS, out) if in_bytes else (out, _NO_BYTES)
        stack = part.stack._replace(starts=starts)
        maps = window, metres, numbers, stack, grid
        run = partial(kernel, *maps, srgb, largest, developing, *outs)
        in_bands(run, inside, width)
        band = torch.from_numpy(out[:, inside.start : inside.stop])
        result[0, :, rows.start : rows.stop] = band.to(dtype)
    return result


def _reached(table: PlanTable, rows: range, blurs: Sequence[PartBlur]) -> tuple[int, int]:
    """The first row of a picture that the blurs of some rows reach, and the end; without those
    whose grids are kept.
    """
    stack = table.stack
    reached = [stack.rows[rows.start : rows.stop + 2 * stack.margin]]
    for grid, first, blur in zip(table.coarse, stack.back_first, blurs, strict=True):
        if blur.kept is None:
            cells = grid.down_first[first[rows.start] : first[rows.stop - 1] + 4]
            reached.append(grid.rows[cells.min() : cells.max() + grid.down.shape[1]])
    return min(int(r.min()) for r in reached), max(int(r.max()) for r in reached) + 1


def _cut(table: PlanTable, low: int, high: int) -> PlanTable:
    """A plan for rows `low` to `high` of a picture, counted from `low`."""
    stack = table.stack
    part = stack._replace(
        rows=stack.rows[low : high + 2 * stack.margin] - low,
        back_first=np.ascontiguousarray(stack.back_first[:, low:high]),
        back=np.ascontiguousarray(stack.back[:, low:high]),
    )
    return table._replace(
        stack=part, coarse=tuple(grid._replace(rows=grid.rows - low) for grid in table.coarse)
    )


def _bands(size: tuple[int, int]) -> Iterator[range]:
    """Rows whose coarse grids are held at a time."""
    height, width = size
    step = max(_BAND // width, 64)
    return (range(first, min(first + step, height)) for first in range(0, height, step))


def coarse_grids(
    light: Floats, table: PlanTable, rows: range, blurs: Sequence[PartBlur] = ()
) -> tuple[Floats, Indices]:
    """The lines of all coarse grids that some rows of a picture need, and where those of each would
    start if they were whole; `blurs` may have kept some of them.
    """
    kernels, width, first = loaded("kernels"), light.shape[-1], table.stack.back_first
    low, high = 3 * first[:, rows.start], 3 * (first[:, rows.stop - 1] + 4)
    counts = high - low
    places = np.cumsum(counts) - counts
    grid = np.empty((int(counts.sum()), width), np.float32)
    for k, (origin, count, place) in enumerate(zip(low, counts, places, strict=True)):
        lines, coarse = grid[place : place + count], table.coarse[k]
        if blurs and blurs[k].kept is not None:
            cells = blurs[k].lines(int(origin) // 3, int(origin + count) // 3)
            lines[:] = cells.reshape(-1, width).numpy()
            continue
        run = partial(kernels.coarse_lines, light, lines, coarse, int(origin))
        in_bands(run, range(count), width, kernels.LANES)
    return grid, places - low


# ------------------------------------------------------------------------------ threads

_LEAST = 1 << 15
"""Pixels for each thread: with fewer, to wake one takes longer than it saves."""

_pool: ThreadPoolExecutor | None = None
_workers = 0
_lock = Lock()


def in_bands(run: Callable[[int, int], None], lines: range, width: int, multiple: int = 1) -> None:
    """Call `run(start, stop)` for lines of `width` px, in bands on as many threads as torch may
    use; in a DataLoader's worker, on this one.

    Args:
        multiple: bands hold multiples of so many lines.
    """
    threads = 1 if get_worker_info() else torch.get_num_threads()
    threads = min(threads, len(lines) * width // _LEAST)
    if threads < 2:
        run(lines.start, lines.stop)
        return
    # several for each thread: one that is held up does not hold up all
    each = multiple * -(-len(lines) // (4 * threads * multiple))
    bands = deque(lines[::each])

    def work() -> None:
        while bands:
            try:
                start = bands.popleft()
            except IndexError:  # another thread has taken the last
                return
            run(start, min(start + each, lines.stop))

    pool = _executor(threads - 1)
    helpers = [pool.submit(work) for _ in range(threads - 1)]
    work()  # this thread need not wait for the others to wake
    for helper in helpers:
        if not helper.cancel():
            helper.result()


def _executor(threads: int) -> ThreadPoolExecutor:
    global _pool, _workers
    with _lock:
        if _pool is None or _workers < threads:
            # the smaller one ends with its last task
            _pool, _workers = ThreadPoolExecutor(threads, "uwaug"), threads
        return _pool


def _forget() -> None:
    """In a child process there are no threads but its own."""
    global _pool, _lock
    _pool, _lock = None, Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
