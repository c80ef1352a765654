"""Pictures by the compiled loops: decoding, and all from light to the encoded picture."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import ColorSpace
from uwaug.blur.plan import BlurPlan
from uwaug.formation import colour
from uwaug.formation.colour import headroom
from uwaug.formation.loops import loops
from uwaug.formation.loops.serving import decodes
from uwaug.formation.loops.switch import Path
from uwaug.formation.loops.tables import (
    Bytes,
    Floats,
    Indices,
    Plan,
    Water,
    plan_tables,
    water_tables,
)
from uwaug.formation.loops.threads import in_bands
from uwaug.optics.medium import Medium

__all__ = ["coarse_grids", "decode", "form_light", "fused_picture", "to_light"]

_NO_FLOATS, _NO_BYTES = np.zeros((3, 1, 0), np.float32), np.zeros((3, 1, 0), np.uint8)

_BAND = 1 << 21
"""Pixels whose coarse grids are held at a time: of all together, up to 24 MiB."""


def to_light(image: Tensor, color_space: ColorSpace, wanted: Path | None = None) -> Tensor:
    """`uwaug.formation.colour.to_light`, by the loops if they can; `wanted` as a record has it."""
    ends = colour.require_values(image, color_space)
    return decode(image, color_space, ends, wanted)


def decode(
    image: Tensor, color_space: ColorSpace, ends: tuple[float, float], wanted: Path | None = None
) -> Tensor:
    """`to_light` of values that are known to be good, and to lie between these."""
    is_light = color_space == "linear" and image.dtype != torch.uint8
    if is_light or not decodes(image, wanted):
        return colour.decoded(image, color_space)
    low, high = ends
    light = torch.empty(image.shape, dtype=torch.float32)
    width = image.shape[-1]
    given = image.detach().contiguous().numpy().reshape(-1, width)
    made = light.numpy().reshape(-1, width)
    pixels = loops.get().pixels
    if image.dtype == torch.uint8:
        # by the same arithmetic as floating point, so that both give one picture
        every = np.arange(256, dtype=np.float32)[None] / np.float32(255)
        table = every.copy()
        if color_space == "srgb":
            pixels.decode_rows(every, table, False, 0, 1)
        in_bands(lambda *rows: pixels.look_up(given, table[0], made, *rows), len(given), width)
    else:
        beyond = low < 0 or high > 1
        in_bands(lambda *rows: pixels.decode_rows(given, made, beyond, *rows), len(given), width)
    return light


def fused_picture(
    image: Tensor,
    light: Tensor,
    z: Tensor,
    medium: Medium,
    plan: BlurPlan,
    color_space: ColorSpace,
    highest: float | None = None,
) -> Tensor:
    """A batch of pictures like `image`, in the line of sight.

    Args:
        image (Bx3xHxW or 3xHxW tensor): as it was given.
        light, z, medium: as for `uwaug.formation.form`, which the loops take.
        plan: of the blur.
        color_space: of the image.
        highest: its largest value, where it is known.
    """
    size = (light.shape[-2], light.shape[-1])
    batch = max(len(light), len(z), len(medium))
    light, z = light.detach().contiguous(), z.detach().contiguous()
    tables, srgb = plan_tables(plan, size), color_space == "srgb"
    most = headroom(image, highest) if srgb else 1.0
    largest = [most] * batch
    if isinstance(most, Tensor):
        largest = most.to(torch.float32).reshape(-1).expand(batch).tolist()
    in_bytes = image.dtype == torch.uint8
    result = torch.empty(batch, 3, *size, dtype=torch.uint8 if in_bytes else torch.float32)
    media = [medium[i] for i in range(len(medium))] if len(medium) > 1 else [medium]
    waters = [water_tables(one, plan, size) for one in media]
    _form_all(light, z, tables, waters, [(srgb, np.float32(one)) for one in largest], result)
    return result if in_bytes else result.to(image.dtype)


def form_light(light: Tensor, z: Tensor, plan: BlurPlan, waters: list[Water]) -> Tensor:
    """The same in linear light, of waters for this plan and size."""
    size = (light.shape[-2], light.shape[-1])
    result = torch.empty(max(len(light), len(z), len(waters)), 3, *size)
    ends = [(False, np.float32(1))] * len(result)
    _form_all(light, z, plan_tables(plan, size), waters, ends, result)
    return result


def _form_all(
    light: Tensor,
    z: Tensor,
    tables: Plan,
    waters: list[Water],
    ends: list[tuple[bool, Any]],
    result: Tensor,
) -> None:
    """Form a batch of pictures; `ends` says whether to encode each, and its largest value then."""
    for i, seen in enumerate(light.numpy()):
        # one picture in several waters is blurred once
        samples = range(len(result)) if len(light) == 1 else (i,)
        for rows in _bands((light.shape[-2], light.shape[-1])):
            grid, starts = coarse_grids(seen, tables, rows)
            stack = tables.stack._replace(starts=starts)
            for n in samples:
                rest = (waters[n % len(waters)], stack, grid, *ends[n], *_outs(result[n]))
                _form(seen, z[n % len(z), 0].numpy(), rows, *rest)


def _bands(size: tuple[int, int]) -> Iterator[range]:
    """Rows whose coarse grids are held at a time."""
    height, width = size
    step = max(_BAND // width, 64)
    return (range(first, min(first + step, height)) for first in range(0, height, step))


def _outs(result: Tensor) -> tuple[Floats, Bytes]:
    """Where the loops put a picture, and nothing in place of the other kind."""
    made = result.numpy()
    return (_NO_FLOATS, made) if made.dtype == np.uint8 else (made, _NO_BYTES)


def _form(light: Floats, z: Floats, rows: range, *rest: Any) -> None:
    form_rows, first = loops.get().pixels.form_rows, rows.start
    in_bands(
        lambda start, stop: form_rows(light, z, *rest, first + start, first + stop),
        len(rows),
        z.shape[1],
    )


def coarse_grids(light: Floats, tables: Plan, rows: range) -> tuple[Floats, Indices]:
    """The lines of all coarse grids that some rows of a picture need, and where those of each would
    start if they were whole.
    """
    loop, width, needed = loops.get().grids, light.shape[-1], tables.stack.back_first
    low, high = 3 * needed[:, rows.start], 3 * (needed[:, rows.stop - 1] + 4)
    counts = high - low
    places = np.cumsum(counts) - counts
    grid = np.empty((int(counts.sum()), width), np.float32)
    for coarse, origin, count, place in zip(tables.coarse, low, counts, places, strict=True):
        run = partial(loop.coarse_lines, light, grid[place : place + count], coarse, int(origin))
        in_bands(run, int(count), width, loop.LANES)
    return grid, places - low
