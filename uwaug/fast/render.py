"""Image formation by the compiled loops, from the stored picture to the stored picture."""

import os
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache, lru_cache, partial
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import get_worker_info

from uwaug._support.checks import extent
from uwaug._support.types import Array
from uwaug.blur.plan import BlurPlan
from uwaug.fast import kernels
from uwaug.fast.tables import (
    DevelopmentTable,
    Floats,
    Indices,
    PlanTable,
    RaysTable,
    WaterTable,
    lamps_table,
    medium_table,
    places_table,
    plan_table,
    rays_tables,
    terms_table,
)
from uwaug.formation.colour import headroom
from uwaug.formation.demand import blurred_between, demand_of
from uwaug.formation.development import (
    BURNT,
    METERED,
    Development,
    gain_at,
    metering_points,
    tone_offset,
)
from uwaug.formation.sensor import standard_normals
from uwaug.formation.setting import Setting
from uwaug.light import Light
from uwaug.light.snow import flakes
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import IN_PIXELS
from uwaug.optics.view import Size
from uwaug.optics.weights import Weights

_NO_FLOATS, _NO_BYTES = np.zeros((3, 1, 0), np.float32), np.zeros((3, 1, 0), np.uint8)
_BAND = 1 << 20  # pixels whose coarse grids are held at a time: up to 24 MiB


class _Scene(NamedTuple):
    """One picture of a batch, as the loops take it."""

    light: Floats  # (3xHxW) linear light
    z: Floats  # (HxW) effective distance, m
    metres: Floats  # the same without the field
    water: WaterTable
    rays: RaysTable


def form(
    image: Tensor,
    z: Tensor,
    setting: Setting,
    plan: BlurPlan | None = None,
    tolerance: float = 0.002,
    metres: Tensor | None = None,
) -> Tensor:
    """D + F + B as the camera stores it, see `uwaug.formation.image.form`."""
    medium, light, development = setting.medium, setting.light, setting.development
    srgb, size = setting.color_space == "srgb", (z.shape[-2], z.shape[-1])
    low, high = (0.0, 1.0) if image.dtype == torch.uint8 else extent(image)
    J = _decoded(image, srgb, low < 0 or high > 1).contiguous()
    maps = z.detach().contiguous()
    unscaled = maps if metres is None else metres.detach().contiguous()
    weights = _in_pixels(medium, setting, size)
    brightest = weights
    if light is not None and light.lamps:
        brightest = _in_pixels(light.planned(medium), setting, size)
    waters = _waters(medium, light, weights, brightest, maps)
    rays = rays_tables(setting.view, light, size)
    batch = max(len(J), len(maps), len(waters), len(rays))
    columns: Any = J.numpy(), maps.numpy()[:, 0], unscaled.numpy()[:, 0], waters, rays
    if batch > 1:
        columns = [_each(column, batch) for column in columns]
    scenes = list(map(_Scene, *columns))
    gains = _gains(scenes, development)
    ends = blurred_between(z, brightest)
    if plan is None:
        law = IN_PIXELS[medium.law.shape]
        plan = demand_of(brightest.brightened(gains), law, ends, tolerance).plan(size, shared=True)
    blurs = plan_table(plan, size)
    widths = [places_table(weights.row(n), plan, blurs.line, ends) for n in range(len(waters))]
    highest = np.full(batch, srgb, np.float32)
    if high > 1:
        highest *= torch.as_tensor(headroom(image)).float().flatten().numpy()
    normals, begins, developments = _camera(development, gains, batch, size)
    layers = _snow(setting, z, z if metres is None else metres, batch)
    kind = torch.uint8 if image.dtype == torch.uint8 else torch.float32
    result = torch.empty(batch, 3, *size, dtype=kind, device="cpu")
    rows: Any = scenes, layers, _each(widths, batch), begins, _each(developments, batch), highest
    pictures = list(zip(*rows, result.numpy(), strict=True))
    halves = [_half(scene.light, blurs) for scene in scenes[: len(J)]]
    step = max(_BAND // size[1], 64)
    for first in range(0, size[0], step):
        lines = range(first, min(first + step, size[0]))
        for n, (scene, layer, width, begin, table, most, out) in enumerate(pictures):
            if n == 0 or len(J) > 1:  # one picture in several waters is blurred once
                grid, starts = _coarse_grids(halves[n], blurs, size[1], lines)
            inputs: Any = (
                *(scene.light, scene.z, scene.metres, layer, scene.water, scene.rays),
                *(width, blurs.stack, grid, starts, normals, begin, table, most),
                *((_NO_FLOATS, out) if out.dtype == np.uint8 else (out, _NO_BYTES)),
            )
            _in_bands(partial(kernels.render_rows, *inputs), lines, size[1])
    return result.to(image.dtype)


def _each(rows: Any, batch: int) -> Any:
    """A row for each picture of a batch; a single one serves all."""
    return rows if len(rows) == batch else [rows[n % len(rows)] for n in range(batch)]


def _in_pixels(medium: Medium, setting: Setting, size: Size) -> Weights:
    weights = medium.weights()
    return weights._replace(scale=weights.scale * medium.law.pixels(size, setting.view))


def _waters(
    medium: Medium, light: Light | None, day: Weights, lit: Weights, z: Tensor
) -> list[WaterTable]:
    """Tables of each medium: in the light of the day, and under lamps."""
    if light is not None and light.daylight != 1:
        day = day.brightened(light.daylight * np.eye(3)[None])
    tables, count = [], len(medium)
    for n in range(count):
        terms = terms_table(medium if count == 1 else medium[n], z.numpy())
        lamps = lamps_table(light, lit.row(n))
        tables.append(WaterTable(medium_table(day, n), terms, lamps))
    return tables


def _snow(setting: Setting, z: Tensor, metres: Tensor, batch: int) -> list[Floats]:
    """Light (3xHxW, or 3x1x0 for none) of the particles before each picture."""
    medium, layers = setting.medium, [_NO_FLOATS] * batch
    for n in range(batch if medium.snow else 0):
        scene = metres[n % len(metres)]
        row = medium[n % len(medium)]
        particles = flakes(row, setting.light, z[n % len(z)], setting.view, scene)
        if particles is not None:
            places, sent = (values.numpy() for values in particles)
            layers[n] = np.zeros((3, *scene.shape[-2:]), np.float32)
            solid = scene[0].contiguous().numpy()
            kernels.splat(np.ascontiguousarray(places), sent.astype(np.float32), solid, layers[n])
    return layers


def _gains(scenes: Sequence[_Scene], development: Development) -> Array:
    """Gains (B or 1, 3, 3), as of `Development.gain`."""
    factors, balance = np.ones(3), 0.0
    if isinstance(development.white_balance, tuple):
        factors = np.array(development.white_balance)
    else:
        balance = float(development.white_balance)
    camera = float(development.exposure), bool(development.metered), balance, factors
    colour = float(development.saturation), bool(development.gamut > 0)
    if not development.measures:
        return gain_at(np.zeros((3, 3)), 0.0, *camera, *colour)[None]
    matrices = []
    for scene in scenes:
        height, width = scene.z.shape
        points = _points(height, width)
        arriving = np.empty((3, len(points)), np.float32)
        light, maps = scene.light.reshape(3, -1), (scene.z.reshape(-1), scene.metres.reshape(-1))
        inputs: Any = (light, *maps, width, points, scene.water, scene.rays, arriving)
        kernels.meter(*inputs)
        values = np.stack([light[:, points], arriving, np.maximum(arriving, 0)])
        means = values.mean(2, dtype=np.float64)
        burnt = round(BURNT * METERED)
        highlight = float(np.partition(arriving.max(0), -burnt)[-burnt])
        matrices.append(gain_at(means, highlight, *camera, *colour))
    return np.stack(matrices)


@lru_cache(maxsize=8)
def _points(height: int, width: int) -> NDArray[np.uint32]:
    """Flat indices of the metered pixels, sorted, as that is fast to read."""
    points = metering_points(height, width, torch.device("cpu")).numpy()
    return np.sort(points).astype(np.uint32)


def _camera(
    development: Development, gains: Array, batch: int, size: tuple[int, int]
) -> tuple[Floats, Indices, list[DevelopmentTable]]:
    """The sensor's normals, the first for each row of each channel (Bx3xH), and tables."""
    sensor, normals, begins = development.noise, _NO_FLOATS[0, 0], np.zeros((batch, 3, 0), np.int64)
    variance = 0.0, 0.0
    if sensor is not None:
        normals = standard_normals(torch.device("cpu")).numpy()
        begins, variance = sensor.starts(batch, size).numpy(), sensor.variance
    shape = development.gamut, development.tone, tone_offset(float(development.tone))
    dark, photons, gamut, tone, offset = np.array([*variance, *shape], np.float32)
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


def _half(light: Floats, table: PlanTable) -> Floats:
    """The half picture, which coarse grids read; nothing if there are none."""
    if not table.coarse:
        return _NO_FLOATS
    _, height, width = light.shape
    half = np.empty((3, (height + 1) // 2, (width + 1) // 2), np.float32)
    run = partial(kernels.halve, light, table.half_rows, table.half_columns, half)
    _in_bands(run, range(half.shape[1]), 2 * width)
    return half


def _coarse_grids(
    half: Floats, table: PlanTable, width: int, rows: range
) -> tuple[Floats, Indices]:
    """Lines of all coarse grids that some rows of a picture need; where whole ones would start."""
    first = table.stack.back_first
    low, high = 3 * first[:, rows.start], 3 * (first[:, rows.stop - 1] + 4)
    counts = high - low
    places = np.cumsum(counts) - counts
    grid = np.empty((int(counts.sum()), width), np.float32)
    for k, (origin, count, place) in enumerate(zip(low, counts, places, strict=True)):
        lines, coarse = grid[place : place + count], table.coarse[k]
        run = partial(kernels.coarse_lines, half, lines, coarse, int(origin))
        _in_bands(run, range(count), width, kernels.LANES)
    return grid, places - low


# ------------------------------------------------------------------------------ threads

_LEAST = 1 << 17  # pixels for each thread: with fewer, waking it takes longer than it saves

_pool: ThreadPoolExecutor | None = None
_workers = 0
_lock = Lock()


def _in_bands(run: Callable[[int, int], None], lines: range, width: int, multiple: int = 1) -> None:
    """Call `run(start, stop)` for bands of lines of `width` px, multiples of `multiple`: on as many
    threads as torch may use; in a DataLoader's worker, on this one.
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
