"""Checks of the inputs of image formation."""

from typing import Any

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
    agree(medium, light, image=image, distance=distance, field=field)
    view.require(image.shape[-1])
    require_values(image, color_space)
    if torch.compiler.is_compiling():
        return
    checks.distances("distance", distance)
    if field is not None and field.numel() and checks.finite("field", field)[0] < 0:
        raise ValueError(f"field falls to {float(field.min()):g}: expected values ≥ 0")


def agree(medium: Medium, light: Light | None, **images: Any) -> None:
    """Refuse types, shapes, devices and batches that do not agree: of a medium, a light, an `image`
    or none, and maps.
    """
    checks.instance("medium", medium, Medium, "; see Medium.from_water")
    sizes = {"medium": len(medium), **batch_sizes(**images)}
    if light is not None:
        checks.instance("light", light, Light)
        sizes["pitch"] = light.pitch.numel() if isinstance(light.pitch, Tensor) else 1
    checks.batches(sizes)


def batch_sizes(**images: Any) -> dict[str, int]:
    """Refuse pictures and maps whose types, shapes or devices do not agree; their batches."""
    sizes, (of, first) = {}, next(iter(images.items()))
    for name, value in images.items():
        if value is None:
            continue
        is_picture = name in ("image", "clean", "observed")
        if not (is_picture and isinstance(value, Tensor) and value.dtype == torch.uint8):
            checks.floating(name, value)
        checks.picture(name, value, 3 if is_picture else 1)
        checks.same_size(name, value, first, of)
        checks.same_device(name, value, first)
        sizes[name] = len(value) if value.ndim == 4 else 1
    return sizes


def effective_distance(distance: Tensor, field: Tensor | None, dtype: torch.dtype) -> Tensor:
    """m·z (Bx1xHxW), finite; +inf stands for open water."""
    z = (distance if distance.ndim == 4 else distance[None]).to(dtype).clamp(max=FARTHEST)
    # compiled code does not check its input, where a distance may be negative. (Newer releases of
    # torch have no gradient of clamp at its ends, such as 0 m)
    z = torch.where(z < 0, 0.0, z) if torch.compiler.is_compiling() else z
    return z if field is None else z * (field if field.ndim == 4 else field[None]).to(dtype)
