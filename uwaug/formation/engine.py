"""The one place that decides what computes a picture."""

from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor

from uwaug._support.tiles import RowSource, is_large
from uwaug._support.torch_func import transformed
from uwaug._support.types import Order
from uwaug.formation.loops.backend import RecordedEngine, can_render, engine_for
from uwaug.formation.setup import Setup
from uwaug.light.light import Light
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

Engine = Literal["fused", "fused-gradients", "fused-rows", "tiles", "tile-rows", "whole"]
"""The compiled loops; the same with gradients; the same on a large picture, a band of rows at a
time. Or PyTorch, a tile at a time, so that what is computed stays in the cache; the same on a large
picture, whose light is made a band of rows at a time. Or PyTorch, all pictures at once, for
compilers, gradients and curves that precede the blur.
"""


def choose(
    image: Tensor,
    maps: Sequence[Tensor | RowSource],
    setup: Setup,
    recorded: RecordedEngine | None = None,
) -> Engine:
    """The fastest engine that computes D + F + B of these pictures.

    Args:
        image (Bx3xHxW or 3xHxW tensor): as it was given, uint8 or floating.
        maps: the distance, and the field if there is one.
        setup: what the picture is taken with.
        recorded: that a record names: "eager" keeps to PyTorch; "fused" warns if the loops are
            missing.
    """
    if torch.compiler.is_compiling() or transformed():
        return "whole"
    medium, light, order = setup.medium, setup.light, setup.order
    law = (v for v in medium.point_spread.numbers().values() if isinstance(v, Tensor))
    tensors = [image, *(m if isinstance(m, Tensor) else m.like for m in maps)]
    numbers = [*medium.tensors(), *law]
    gradients = any(t.requires_grad for t in (*tensors, *numbers))
    gradients = gradients or (light is not None and light.requires_grad)
    gradients = gradients and torch.is_grad_enabled()
    in_rows = _is_in_rows(image, maps, medium, light)
    fused = _is_fused(recorded, order, light)
    # older records call fused what PyTorch made of a large picture
    fused = fused and not (in_rows and recorded == "fused" and not gradients)
    # of a law of one's own the loops know nothing
    fused = fused and type(medium) is Medium and type(medium.point_spread) is PointSpread
    # gradients where channels mix are by PyTorch
    mixes = medium.is_spectral or setup.development.saturation != 1
    fused = fused and not (gradients and mixes)
    if fused and can_render(tensors, numbers, gradients=gradients):
        if gradients:
            return "fused-gradients"
        return "fused-rows" if in_rows else "fused"
    if gradients or (order == "source" and not in_rows):
        return "whole"
    return "tile-rows" if in_rows else "tiles"


def recorded_engine(engine: Engine) -> RecordedEngine:
    """What a record says of an engine."""
    if engine == "fused" or engine == "fused-gradients":
        return "fused"
    return "fused-rows" if engine == "fused-rows" else "eager"


def expected_engine(size: tuple[int, int], order: Order, light: Light | None) -> RecordedEngine:
    """What a record says before there is a picture of (height, width) `size`."""
    if not _is_fused(None, order, light):
        return "eager"
    return "fused-rows" if is_large(size) else "fused"


def _is_fused(recorded: RecordedEngine | None, order: Order, light: Light | None) -> bool:
    """Whether the loops are wanted, and know this order and light."""
    wanted = engine_for(recorded) == "fused"
    return wanted and order == "line_of_sight" and (light is None or light.plain)


def _is_in_rows(
    image: Tensor, maps: Sequence[Tensor | RowSource], medium: Medium, light: Light | None
) -> bool:
    """Whether this is one picture in one water, too large to hold its light."""
    rows = 1 if light is None else light.rows()
    single = all(len(x.shape) == 3 or len(x) == 1 for x in (image, *maps))
    return single and len(medium) == rows == 1 and is_large((image.shape[-2], image.shape[-1]))
