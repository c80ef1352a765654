"""Pictures by the compiled loops: decoding, and all from light to the encoded picture."""

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from threading import Lock
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import get_worker_info

from uwaug._support.checks import extent
from uwaug._support.types import Array, ColorSpace
from uwaug.blur.plan import BlurPlan
from uwaug.fast import kernels
from uwaug.fast.tables import (
    Floats,
    Indices,
    MediumTable,
    PlanTable,
    law_of,
    medium_tables,
    plan_table,
)
from uwaug.formation.colour import LUMINANCE, headroom
from uwaug.formation.demand import plan_for
from uwaug.formation.development import (
    GAINS,
    MOST,
    Development,
    metering_points,
    tone_offset,
)
from uwaug.formation.sensor import standard_normals
from uwaug.optics.medium import Medium

_NO_FLOATS, _NO_BYTES = np.zeros((3, 1, 0), np.float32), np.zeros((3, 1, 0), np.uint8)

_BAND = 1 << 20
"""Pixels whose coarse grids are held at a time: of all together, up to 24 MiB."""


def form(
    image: Tensor,
    z: Tensor,
    medium: Medium,
    development: Development,
    color_space: ColorSpace,
    plan: BlurPlan | None,
    tolerance: float,
) -> Tensor:
    """D + F + B as the camera stores it, see `uwaug.formation.image.form`."""
    srgb, size = color_space == "srgb", (z.shape[-2], z.shape[-1])
    low, high = (0.0, 1.0) if image.dtype == torch.uint8 else extent(image)
    J = _decoded(image, srgb, low < 0 or high > 1)
    tables = medium_tables(medium)
    gain = _gain(J, z, tables, development)
    plan = plan or plan_for(z, medium, size, tolerance, gain)
    laws = [law_of(medium, n, plan, size) for n in range(len(medium))]
    media = [
        tables[n % len(medium)]._replace(law=laws[n % len(medium)])
        for n in range(max(len(gain), len(medium)))
    ]
    batch, sensor, normals = max(len(J), len(z), len(medium)), development.noise, _NO_FLOATS[0, 0]
    begins, dark, photons = np.zeros((batch, 3, 0), np.int64), 0.0, 0.0
    if sensor is None:
        # the gain in the medium costs nothing
        media = [media[n].brightened(gain[n % len(gain)]) for n in range(len(media))]
    else:
        normals = standard_normals(torch.device("cpu")).numpy()
        begins, (dark, photons) = sensor.starts(batch, size).numpy(), map(float, sensor.variance)
        gain = gain if gain.ndim == 3 else gain[:, None] * np.eye(3)
    gain = gain.astype(np.float32)
    table = plan_table(plan, size)
    tone = float(development.tone)
    look = np.array([dark, photons, development.gamut, tone, tone_offset(tone)], np.float32)
    largest = headroom(image) if srgb and high > 1 else 1.0
    largest = torch.as_tensor(largest, dtype=torch.float32, device="cpu")
    highest = largest.reshape(-1).expand(batch).numpy()
    kind = torch.uint8 if image.dtype == torch.uint8 else torch.float32
    result = torch.empty(batch, 3, *size, dtype=kind, device="cpu")
    scenes, metres = J.detach().contiguous().numpy(), z.detach().contiguous().numpy()
    step = max(_BAND // size[1], 64)
    for i, scene in enumerate(scenes):
        # one picture in several waters is blurred once
        samples = range(batch) if len(scenes) == 1 else (i,)
        for first in range(0, size[0], step):
            rows = range(first, min(first + step, size[0]))
            grid, starts = _coarse_grids(scene, table, rows)
            for n in samples:
                out = result[n].numpy()
                outs = (_NO_FLOATS, out) if out.dtype == np.uint8 else (out, _NO_BYTES)
                maps = scene, metres[n % len(metres), 0], media[n % len(media)]
                blurs, encoding = (table.stack, grid, starts), (srgb, highest[n])
                camera = normals, begins[n], gain[n % len(gain)].reshape(-1), look
                arguments: Any = (*maps, *blurs, *camera, *encoding, *outs)
                run = partial(kernels.render_rows, *arguments)
                _in_bands(run, rows, size[1])
    return result.to(image.dtype)


def _gain(J: Tensor, z: Tensor, tables: list[MediumTable], development: Development) -> Array:
    """As `Development.gain`: (B or 1, 3), or (B or 1, 3, 3)."""
    balance, saturation = development.white_balance, float(development.saturation)
    gains = np.full((1, 3), 2.0 ** float(development.exposure))
    white_balance = 0.0
    if isinstance(balance, tuple):
        gains *= balance
    else:
        white_balance = float(balance)
    if development.measures:
        points = metering_points(z.shape[-2], z.shape[-1], z.device).numpy()
        lights, maps = J.flatten(2).numpy(), z.flatten(1).numpy()
        batch, far = max(len(J), len(z), len(tables)), maps.max(1)
        gains = gains.repeat(batch, 0)
        for n in range(batch):
            i, table = n % len(z), tables[n % len(tables)]
            scene, arriving, positive = kernels.meter(lights[n % len(J)], maps[i], points, table)
            if development.metered:
                veil = max(float(table.veil_at(far[i]).max()), 1 / GAINS[1])
                before, after = scene @ LUMINANCE, arriving @ LUMINANCE
                automatic = before / after if after > 0 else 1.0
                gains[n] *= min(max(automatic, GAINS[0]), GAINS[1], 1 / veil)
            before = positive @ LUMINANCE
            if white_balance > 0 and before > 0:
                factors = (before / np.maximum(positive, before / MOST)) ** white_balance
                gains[n] *= factors * before / ((factors * positive) @ LUMINANCE or before)
    if saturation == 1:
        return gains
    grey = np.tile(LUMINANCE, (3, 1))
    mixing: Array = (grey + saturation * (np.eye(3) - grey)) * gains[:, None]
    return mixing


def _decoded(image: Tensor, srgb: bool, beyond: bool) -> Tensor:
    """Linear light of a picture of bytes, or of floating point; `beyond`: not all of it in 0…1."""
    width = image.shape[-1]
    if image.dtype != torch.uint8:
        image = image.to(torch.float32)
        if not srgb:
            return image
    light = torch.empty(image.shape, dtype=torch.float32, device="cpu")
    values = image.detach().contiguous().numpy().reshape(-1, width)
    rows = light.numpy().reshape(-1, width)
    if image.dtype == torch.uint8:
        run = partial(kernels.look_up, values, _light_of_bytes(srgb), rows)
    else:
        run = partial(kernels.decode_rows, values, rows, beyond)
    _in_bands(run, range(len(values)), width)
    return light


@cache
def _light_of_bytes(srgb: bool) -> Floats:
    """The light of each byte (256), by the same arithmetic as floating point."""
    unit = np.arange(256, dtype=np.float32)[None] / np.float32(255)
    table = unit.copy()
    if srgb:
        kernels.decode_rows(unit, table, False, 0, 1)
    return np.asarray(table[0])


def _coarse_grids(light: Floats, table: PlanTable, rows: range) -> tuple[Floats, Indices]:
    """The lines of all coarse grids that some rows of a picture need, and where those of each would
    start if they were whole.
    """
    width, first = light.shape[-1], table.stack.back_first
    low, high = 3 * first[:, rows.start], 3 * (first[:, rows.stop - 1] + 4)
    counts = high - low
    places = np.cumsum(counts) - counts
    grid = np.empty((int(counts.sum()), width), np.float32)
    for k, (origin, count, place) in enumerate(zip(low, counts, places, strict=True)):
        lines, coarse = grid[place : place + count], table.coarse[k]
        run = partial(kernels.coarse_lines, light, lines, coarse, int(origin))
        _in_bands(run, range(count), width, kernels.LANES)
    return grid, places - low


# ------------------------------------------------------------------------------ threads

_LEAST = 1 << 17
"""Pixels for each thread: with fewer, to wake one takes longer than it saves. (Half as many: a
default picture of 256 px takes as long by two threads as by one, or longer beside other work.)
"""

_pool: ThreadPoolExecutor | None = None
_workers = 0
_lock = Lock()


def _in_bands(run: Callable[[int, int], None], lines: range, width: int, multiple: int = 1) -> None:
    """Call `run(start, stop)` for lines of `width` px, in bands of multiples of so many lines, on
    as many threads as torch may use; in a DataLoader's worker, on this one.
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
    """After a fork, as a child has no threads but its own."""
    global _pool, _lock
    _pool, _lock = None, Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
