"""What image formation is given, looked at before it is formed."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.torch_func import refuse_mapped
from uwaug.light.light import Light
from uwaug.optics.medium import Medium

_ROUNDING = 1e-6
"""Of float32. A field of .7…1.3 on a range that was planned for it would be looked at each time:
4 ms of 30 at 1024².
"""


class MapRanges(NamedTuple):
    """Between which values the distance, m, and the field lie; the field is 1 without one."""

    nearest: float
    farthest: float
    thinnest: float = 1.0
    densest: float = 1.0

    def lie_within(self, near: float, far: float) -> bool:
        """Whether no effective distance can lie outside of a range, m, by more than rounding."""
        nearest, farthest = self.nearest * self.thinnest, self.farthest * self.densest
        return near <= nearest * (1 + _ROUNDING) and farthest <= far * (1 + _ROUNDING)


def validate(
    image: Tensor,
    distance: Tensor,
    medium: Medium | None,
    field: Tensor | None,
    *,
    also_bytes: bool = False,
    light: Light | None = None,
) -> MapRanges | None:
    """Refuse what `form_image` cannot take: types, shapes, batches, devices, wrong distances.

    medium: None if it is none of the caller's, as that of a file.
    also_bytes: take a uint8 picture, as files hold it.

    Returns:
        What the maps hold; None in a graph, which is for others as well.
    """
    if medium is not None:
        checks.instance("medium", medium, Medium, "; see Medium.from_water")
    maps = {"distance": distance} if field is None else {"distance": distance, "field": field}
    sizes = {"medium": 1 if medium is None else len(medium)}
    if light is not None:
        checks.instance("light", light, Light)
        sizes["light"] = light.rows()
    for name, value in {"image": image, **maps}.items():
        if not (name == "image" and also_bytes and _holds_bytes(image)):
            checks.floating(name, value)
        checks.picture(name, value, 3 if name == "image" else 1)
        checks.same_size(name, value, image)
        checks.same_device(name, value, image)
        refuse_mapped(name, value)
        sizes[name] = len(value) if value.ndim == 4 else 1
    checks.batches(sizes)
    if torch.compiler.is_compiling():
        return None
    nearest, farthest = checks.distances("distance", distance)
    thinnest = densest = 1.0
    if field is not None and field.numel():
        thinnest, densest = checks.extent(field)
        if not (thinnest >= 0 and densest < math.inf):
            counts = checks.counted(field, "NaN", "negative", "infinite")
            raise ValueError(f"field is {counts}: expected finite values ≥ 0")
    tracing = torch.jit.is_tracing()  # type: ignore[attr-defined, no-untyped-call]
    return None if tracing else MapRanges(nearest, farthest, thinnest, densest)


def _holds_bytes(image: object) -> bool:
    return isinstance(image, Tensor) and image.dtype == torch.uint8
