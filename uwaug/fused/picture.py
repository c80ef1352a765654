"""Pictures by the compiled loops: decoding, and all from light to the encoded picture."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug import colour
from uwaug.blur.plan import BlurPlan
from uwaug.colour import ColorSpace, headroom
from uwaug.fused import loops
from uwaug.fused.serving import decodes
from uwaug.fused.switch import Path
from uwaug.fused.tables import Coarse, Floats, Plan, plan_tables, water_tables
from uwaug.fused.threads import in_bands
from uwaug.optics.medium import Medium

__all__ = ["fused_picture", "to_light"]

_NO_FLOATS, _NO_BYTES = np.zeros((3, 1, 0), np.float32), np.zeros((3, 1, 0), np.uint8)
_NO_GRID = np.zeros((0, 0), np.float32)


def to_light(image: Tensor, color_space: ColorSpace, wanted: Path | None = None) -> Tensor:
    """`uwaug.colour.to_light`, by the loops where they can; `wanted` is what a record names."""
    is_light = color_space == "linear" and image.dtype != torch.uint8
    if is_light or not decodes(image, wanted):
        return colour.to_light(image, color_space)
    colour.require_values(image, color_space)
    light = torch.empty(image.shape, dtype=torch.float32)
    width = image.shape[-1]
    given = image.detach().contiguous().numpy().reshape(-1, width)
    made = light.numpy().reshape(-1, width)
    pixels = loops.get().pixels
    if image.dtype == torch.uint8:
        every = torch.arange(256, dtype=torch.uint8)
        table = colour.decoded(every, color_space).numpy()
        in_bands(lambda *rows: pixels.look_up(given, table, made, *rows), len(given), width)
    else:
        in_bands(lambda *rows: pixels.decode_rows(given, made, *rows), len(given), width)
    return light


def fused_picture(
    image: Tensor,
    light: Tensor,
    z: Tensor,
    medium: Medium,
    plan: BlurPlan,
    color_space: ColorSpace,
) -> Tensor:
    """A batch of pictures like `image`, in the line of sight.

    Args:
        image (Bx3xHxW or 3xHxW tensor): as it was given.
        light, z, medium: as for `uwaug.formation.form`, which the loops take.
        plan: of the blur.
        color_space: of the image.
    """
    size = (light.shape[-2], light.shape[-1])
    batch = max(len(light), len(z), len(medium))
    light, z = light.detach().contiguous(), z.detach().contiguous()
    tables, srgb = plan_tables(plan, size), color_space == "srgb"
    most = headroom(image) if srgb else 1.0
    largest = torch.as_tensor(most, dtype=torch.float32).reshape(-1).expand(batch).tolist()
    in_bytes = image.dtype == torch.uint8
    result = torch.empty(batch, 3, *size, dtype=torch.uint8 if in_bytes else torch.float32)
    media = [medium[i] for i in range(len(medium))] if len(medium) > 1 else [medium]
    waters = [water_tables(one, plan, size) for one in media]
    grid = _NO_GRID
    for n, made in enumerate(result.numpy()):
        seen = light[n % len(light)].numpy()
        if n < len(light):
            grid = _grid(seen, tables)
        outs = (_NO_FLOATS, made) if in_bytes else (made, _NO_BYTES)
        water, far = waters[n % len(waters)], z[n % len(z), 0].numpy()
        rest = (water, tables.stack, grid, srgb, np.float32(largest[n]), *outs)
        _form(seen, far, *rest)
    return result if in_bytes else result.to(image.dtype)


def _form(light: Floats, z: Floats, *rest: Any) -> None:
    height, width = z.shape
    form_rows = loops.get().pixels.form_rows
    in_bands(lambda *rows: form_rows(light, z, *rest, *rows), height, width)


def _grid(light: Floats, tables: Plan) -> Floats:
    """The lines of all coarse grids of a picture."""
    loop, width = loops.get().grids, light.shape[-1]
    counts = [3 * len(coarse.down_first) for coarse in tables.coarse]
    grid = np.empty((sum(counts), width), np.float32)
    first = 0
    for coarse, count in zip(tables.coarse, counts, strict=True):
        lines = grid[first : first + count]

        def run(start: int, stop: int, lines: Floats = lines, coarse: Coarse = coarse) -> None:
            loop.coarse_lines(light, lines, coarse, start, stop)

        in_bands(run, count, width, loop.LANES)
        first += count
    return grid
