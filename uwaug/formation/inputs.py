"""Checks of the inputs of image formation."""

import math

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import ColorSpace
from uwaug.formation.colour import require_values
from uwaug.light import Light
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium
from uwaug.optics.view import WIDE, View


def validate(
    image: Tensor,
    distance: Tensor,
    medium: Medium,
    field: Tensor | None = None,
    *,
    color_space: ColorSpace,
    light: Light | None = None,
    view: View = WIDE,
) -> None:
    """Refuse inputs of a wrong type, shape, batch, device or value."""
    checks.instance("medium", medium, Medium, "; see Medium.from_water")
    if light is not None:
        checks.instance("light", light, Light)
    maps = {"distance": distance} if field is None else {"distance": distance, "field": field}
    sizes = {"medium": len(medium)}
    if light is not None and isinstance(light.pitch, Tensor):
        sizes["pitch"] = light.pitch.numel()
    for name, value in {"image": image, **maps}.items():
        if not (name == "image" and isinstance(image, Tensor) and image.dtype == torch.uint8):
            checks.floating(name, value)
        checks.picture(name, value, 3 if name == "image" else 1)
        checks.same_size(name, value, image)
        checks.same_device(name, value, image)
        sizes[name] = len(value) if value.ndim == 4 else 1
    checks.batches(sizes)
    view.require(image.shape[-1])
    require_values(image, color_space)
    if torch.compiler.is_compiling():
        return
    checks.distances("distance", distance)
    if field is not None and field.numel():
        thinnest, densest = checks.extent(field)
        if not (thinnest >= 0 and densest < math.inf):
            counts = checks.counted(field, "NaN", "negative", "infinite")
            raise ValueError(f"field is {counts}: expected finite values ≥ 0")


def effective_distance(distance: Tensor, field: Tensor | None, dtype: torch.dtype) -> Tensor:
    """m·z (Bx1xHxW), finite; +inf stands for open water."""
    z = (distance if distance.ndim == 4 else distance[None]).to(dtype).clamp(max=FARTHEST)
    # compiled code does not check its input, where a distance may be negative. (Newer releases of
    # torch have no gradient of clamp at its ends, such as 0 m)
    z = torch.where(z < 0, 0.0, z) if torch.compiler.is_compiling() else z
    return z if field is None else z * (field if field.ndim == 4 else field[None]).to(dtype)
