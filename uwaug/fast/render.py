"""Image formation by the compiled loops, from the stored picture to the stored picture."""

import os
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache, lru_cache, partial
from threading import Lock
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import get_worker_info

from uwaug._support.checks import extent
from uwaug._support.types import Array, ColorSpace
from uwaug.blur.plan import BlurPlan
from uwaug.fast import kernels
from uwaug.fast.tables import (
    DevelopmentTable,
    DistanceTable,
    Floats,
    Indices,
    LampsTable,
    MediumTable,
    PlanTable,
    lamps_table,
    medium_table,
    places_table,
    plan_table,
    rise_table,
    terms_table,
)
from uwaug.formation.colour import LUMINANCE, headroom
from uwaug.formation.demand import Weights, blurred_between, plan_between
from uwaug.formation.development import (
    BURNT,
    METERED,
    Development,
    gain_at,
    metering_points,
    tone_offset,
)
from uwaug.formation.sensor import standard_normals
from uwaug.light import Light
from uwaug.light.snow import flakes
from uwaug.optics.medium import Medium

_NO_FLOATS, _NO_BYTES = np.zeros((3, 1, 0), np.float32), np.zeros((3, 1, 0), np.uint8)

_LUMINANCE = np.array(LUMINANCE)

_BAND = 1 << 20
"""Pixels whose coarse grids are held at a time: up to 24 MiB."""


def form(
    image: Tensor,
    z: Tensor,
    medium: Medium,
    development: Development,
    color_space: ColorSpace,
    plan: BlurPlan | None,
    tolerance: float,
    light: Light | None = None,
    metres: Tensor | None = None,
) -> Tensor:
    """D + F + B as the camera stores it, see `uwaug.formation.image.form`."""
    srgb, size = color_space == "srgb", (z.shape[-2], z.shape[-1])
    low, high = (0.0, 1.0) if image.dtype == torch.uint8 else extent(image)
    J = _decoded(image, srgb, low < 0 or high > 1)
    rise = rise_table(light, size)
    batch = max(len(J), len(z), len(medium), len(rise))
    scenes, z_maps = J.contiguous().numpy(), z.detach().contiguous().numpy()
    metre_maps = z_maps if metres is None else metres.detach().contiguous().numpy()
    weights = brightest = Weights.of(medium)
    if light is not None:
        brightest = Weights.of(light.planned(medium))
        weights = weights.seen_by(np.full((1, 3), light.daylight))
    media = [medium] if len(medium) == 1 else [medium[n] for n in range(len(medium))]
    ends = blurred_between(z, brightest)
    rows = range(max(len(medium), len(rise)))
    tables = [
        (
            medium_table(weights, n % len(medium)),
            rise[n % len(rise)],
            terms_table(media[n % len(media)], z_maps),
            lamps_table(light, brightest, size, n % len(medium)),
        )
        for n in rows
    ]
    gains = _gains(scenes, z_maps, metre_maps, tables, development, light is not None)
    if plan is None:
        plan = plan_between(ends, medium, size, tolerance, brightest.seen_by(gains))
    blurs = plan_table(plan, size)
    widths = [places_table(row, plan, size, ends) for row in media]
    normals, begins, developments = _camera(development, gains, batch, size)
    highest = np.ones(batch, np.float32)
    if srgb and high > 1:
        highest *= torch.as_tensor(headroom(image)).float().flatten().numpy()
    kind = torch.uint8 if image.dtype == torch.uint8 else torch.float32
    result = torch.empty(batch, 3, *size, dtype=kind, device="cpu")
    step = max(_BAND // size[1], 64)
    for i, scene in enumerate(scenes):
        # one picture in several waters is blurred once
        samples = range(batch) if len(scenes) == 1 else (i,)
        for first in range(0, size[0], step):
            lines = range(first, min(first + step, size[0]))
            grid, starts = _coarse_grids(scene, blurs, lines)
            for n in samples:
                out = result[n].numpy()
                arguments: Any = (
                    scene,
                    z_maps[n % len(z_maps), 0],
                    metre_maps[n % len(metre_maps), 0],
                    _snow(medium, light, z, metres, n),
                    *tables[n % len(tables)],
                    widths[n % len(widths)],
                    blurs.stack,
                    grid,
                    starts,
                    normals,
                    begins[n],
                    developments[n % len(developments)],
                    srgb,
                    highest[n],
                    *((_NO_FLOATS, out) if out.dtype == np.uint8 else (out, _NO_BYTES)),
                )
                _in_bands(partial(kernels.render_rows, *arguments), lines, size[1])
    return result.to(image.dtype)


def _snow(medium: Medium, light: Light | None, z: Tensor, metres: Tensor | None, n: int) -> Floats:
    """Light (3xHxW, or 3x1x0 for none) of the particles before a picture of a batch."""
    particles = flakes(medium, light, z, metres, n) if medium.snow else None
    if particles is None:
        return _NO_FLOATS
    places, sent = (values.numpy() for values in particles)
    scene = (z if metres is None else metres)[n % len(z), 0].contiguous().numpy()
    layer = np.zeros((3, *scene.shape), np.float32)
    kernels.splat(np.ascontiguousarray(places), sent.astype(np.float32), scene, layer)
    return layer


def _gains(
    scenes: Floats,
    z: Floats,
    metres: Floats,
    tables: Sequence[tuple[MediumTable, Floats, DistanceTable, LampsTable]],
    development: Development,
    has_light: bool,
) -> Array:
    """Gains (B or 1, 3), or (B or 1, 3, 3), as of `Development.gain`."""
    factors, balance = np.ones(3), 0.0
    if isinstance(development.white_balance, tuple):
        factors = np.array(development.white_balance)
    else:
        balance = float(development.white_balance)
    saturation, stops = float(development.saturation), float(development.exposure)
    camera = stops, bool(development.metered), balance, factors, saturation
    if not development.measures:
        matrices = gain_at(np.zeros((3, 3)), 0.0, *camera)[None]
    else:
        height, width = z.shape[-2:]
        points = _points(height, width)
        lights = scenes.reshape(len(scenes), 3, -1)
        z, metres = z.reshape(len(z), -1), metres.reshape(len(metres), -1)
        matrices = np.empty((max(len(lights), len(z), len(tables)), 3, 3))
        brightness = np.empty(len(points) if has_light else 0, np.float32)
        for n in range(len(matrices)):
            light, row = lights[n % len(lights)], tables[n % len(tables)]
            maps = z[n % len(z)], metres[n % len(metres)]
            farthest = float(maps[0].max())
            view = width, farthest, points
            arguments: Any = (light, *maps, *view, *row, _LUMINANCE, brightness)
            means, veil = kernels.meter(*arguments)
            if has_light:
                burnt = round(BURNT * METERED)
                veil = float(np.partition(brightness, -burnt)[-burnt])
            matrices[n] = gain_at(means, veil, *camera)
    return matrices if saturation != 1 else np.diagonal(matrices, 0, 1, 2)


@lru_cache(maxsize=8)
def _points(height: int, width: int) -> NDArray[np.uint32]:
    """Flat indices of the metered pixels, sorted, as that is fast to read."""
    points = metering_points(height, width, torch.device("cpu")).numpy()
    return np.sort(points).astype(np.uint32)


def _camera(
    development: Development, gains: Array, batch: int, size: tuple[int, int]
) -> tuple[Floats, Indices, list[DevelopmentTable]]:
    """The sensor's normals; the index of the first for each row of each channel (Bx3xH); the tables
    of developments.
    """
    sensor, normals, begins = development.noise, _NO_FLOATS[0, 0], np.zeros((batch, 3, 0), np.int64)
    variance = 0.0, 0.0
    if sensor is not None:
        normals = standard_normals(torch.device("cpu")).numpy()
        begins, variance = sensor.starts(batch, size).numpy(), sensor.variance
    shape = development.gamut, development.tone, tone_offset(float(development.tone))
    dark, photons, gamut, tone, offset = np.array([*variance, *shape], np.float32)
    if gains.ndim == 2:
        gains = gains[:, None] * np.eye(3)
    flat = gains.reshape(-1, 9).astype(np.float32)
    tables = [DevelopmentTable(dark, photons, gain, gamut, tone, offset) for gain in flat]
    return normals, begins, tables


def _decoded(image: Tensor, srgb: bool, beyond: bool) -> Tensor:
    """Linear light of a picture of bytes or floating point; `beyond` if not all is in 0…1."""
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
    """Light of each byte (256), by the same arithmetic as for floating point."""
    unit = np.arange(256, dtype=np.float32)[None] / np.float32(255)
    table = unit.copy()
    if srgb:
        kernels.decode_rows(unit, table, False, 0, 1)
    return np.asarray(table[0])


def _coarse_grids(light: Floats, table: PlanTable, rows: range) -> tuple[Floats, Indices]:
    """Lines of all coarse grids that some rows of a picture need, and the index at which those of
    each grid would start if they were whole.
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
"""Least number of pixels for each thread: with fewer, waking it takes longer than it saves. (With
half as many, a default picture of 256 px takes as long by two threads as by one, or longer beside
other work.)
"""

_pool: ThreadPoolExecutor | None = None
_workers = 0
_lock = Lock()


def _in_bands(run: Callable[[int, int], None], lines: range, width: int, multiple: int = 1) -> None:
    """Call `run(start, stop)` for bands of lines of `width` px, with a multiple of `multiple` lines
    each: on as many threads as torch may use; in a DataLoader's worker, on this one.
    """
    threads = 1 if get_worker_info() else torch.get_num_threads()
    threads = min(threads, len(lines) * width // _LEAST)
    if threads < 2:
        run(lines.start, lines.stop)
        return
    # several bands for each thread: one that is held up does not hold up all
    count = multiple * -(-len(lines) // (4 * threads * multiple))
    starts = deque(lines[::count])

    def work() -> None:
        while starts:
            try:
                start = starts.popleft()
            except IndexError:  # another thread has taken the last
                return
            run(start, min(start + count, lines.stop))

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
    """Forget the threads, which a child does not have after a fork."""
    global _pool, _lock
    _pool, _lock = None, Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
