"""Names of before, for callers that are being rewritten; they go with the last of these."""

import torch
from torch import Tensor

from uwaug._support.types import ColorSpace
from uwaug.blur.plan import BlurPlan
from uwaug.formation import colour
from uwaug.formation.loops import render
from uwaug.formation.loops.backend import Path, can_decode
from uwaug.optics.medium import Medium

__all__ = ["decode", "fused_picture", "to_light"]


def to_light(image: Tensor, color_space: ColorSpace, wanted: Path | None = None) -> Tensor:
    """Linear light of a picture."""
    ends = colour.require_values(image, color_space)
    return decode(image, color_space, ends, wanted)


def decode(
    image: Tensor, color_space: ColorSpace, ends: tuple[float, float], wanted: Path | None = None
) -> Tensor:
    """Linear light of values that are known to be good."""
    is_light = color_space == "linear" and image.dtype != torch.uint8
    if is_light or not can_decode(image, wanted):
        return colour.decoded(image, color_space)
    return render.decode(image, color_space == "srgb", ends[0] < 0 or ends[1] > 1)


def fused_picture(
    image: Tensor,
    light: Tensor,
    z: Tensor,
    medium: Medium,
    plan: BlurPlan,
    color_space: ColorSpace,
    highest: float | None = None,
) -> Tensor:
    """A picture by the loops."""
    srgb = color_space == "srgb"
    largest = colour.headroom(image, highest) if srgb else 1.0
    return render.render(light, z, medium, plan, srgb=srgb, largest=largest, dtype=image.dtype)
