"""The one place that decides what computes a picture."""

from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor

from uwaug._support.tiles import RowSource, is_large
from uwaug._support.torch_func import transformed
from uwaug._support.types import Order
from uwaug.formation.loops.backend import Path, can_render, path_for
from uwaug.light.light import Light
from uwaug.optics.medium import Medium

Engine = Literal["fused", "fused-rows", "tiles", "whole"]
"""The compiled loops; the same on a large picture, a band of rows at a time; or PyTorch, a tile at
a time, so that what is computed stays in the cache; or PyTorch, all pictures at once, for
compilers, gradients and curves that precede the blur.
"""


def choose(
    image: Tensor,
    maps: Sequence[Tensor | RowSource],
    medium: Medium,
    light: Light | None = None,
    order: Order = "line_of_sight",
    path: Path | None = None,
) -> Engine:
    """The fastest engine that computes D + F + B of these pictures; a record names it.

    Args:
        image (Bx3xHxW or 3xHxW tensor): as it was given, uint8 or floating.
        maps: the distance, and the field if there is one.
        medium, light, order: as for `uwaug.form_image`.
        path: that a record names: "eager" keeps to PyTorch; "fused" warns if the loops are missing.
    """
    if torch.compiler.is_compiling() or transformed():
        return "whole"
    law = (v for v in medium.point_spread.numbers().values() if isinstance(v, Tensor))
    tensors = [image, *(m if isinstance(m, Tensor) else m.like for m in maps)]
    numbers = [*medium.tensors(), *law]
    learns = any(t.requires_grad for t in (*tensors, *numbers))
    learns = torch.is_grad_enabled() and (learns or (light is not None and light.requires_grad))
    rows = is_in_rows(image, maps, medium, light)
    fused = path_for(path) == "fused" and order == "line_of_sight"
    fused = fused and (light is None or light.plain)
    # older records call fused what PyTorch made of a large picture
    fused = fused and not (rows and path == "fused" and not learns)
    if fused and can_render(tensors, numbers, gradients=learns):
        return "fused-rows" if rows and not learns else "fused"
    if learns or (order == "source" and not rows):
        return "whole"
    return "tiles"


def is_in_rows(
    image: Tensor, maps: Sequence[Tensor | RowSource], medium: Medium, light: Light | None
) -> bool:
    """Whether this is one picture in one water, too large to hold its light."""
    rows = 1 if light is None else light.rows()
    single = all(len(x.shape) == 3 or len(x) == 1 for x in (image, *maps))
    return single and len(medium) == rows == 1 and is_large((image.shape[-2], image.shape[-1]))


def path_of(engine: Engine) -> Path:
    """What a record says of an engine."""
    return "eager" if engine == "tiles" or engine == "whole" else engine


def expected_path(size: tuple[int, int], order: Order, light: Light | None) -> Path:
    """What a record says before there is a picture of (height, width) `size`."""
    if path_for(None) == "eager" or order != "line_of_sight" or not (light is None or light.plain):
        return "eager"
    return "fused-rows" if is_large(size) else "fused"
