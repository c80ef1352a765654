"""Refusals that several modules share, worded once: which argument, what was expected, what came.
And the domain of each quantity.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

__all__ = [
    "DOMAIN",
    "batches",
    "bounds",
    "counted",
    "extent",
    "floating",
    "instance",
    "number_only",
    "one_of",
    "picture",
    "positive",
    "same_device",
    "same_size",
    "span",
    "tolerance",
    "within",
]

DOMAIN = {
    "mixing": (0.0, 1.0),
    "visibility": (1e-3, math.inf),
    "vertical_depth": (0.0, math.inf),
    "g": (0.0, 1.0),
    "mu": (0.0, 1.0),
    "scale": (0.0, math.inf),
    "exponent": (1e-3, math.inf),
    "blur_factor": (0.0, math.inf),
    "near": (0.0, math.inf),
    "far": (0.0, math.inf),
    "gamma": (1e-3, math.inf),
    "distance": (0.0, math.inf),
    "field_range": (0.0, math.inf),
}
"""Least and largest value of every quantity that may be drawn or read from a preset. Infinity
itself is never allowed.
"""


def one_of(name: str, value: object, allowed: Iterable[str]) -> None:
    """Refuse what is no member of `allowed`."""
    choices = tuple(allowed)
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}, got {value!r}")


def bounds(low: float, high: float) -> str:
    """A domain in words."""
    return f"in [{low:g}, {high:g}]" if high < math.inf else f"finite and ≥ {low:g}"


def within(name: str, value: Any, low: float = -math.inf, high: float = math.inf) -> None:
    """Refuse a number outside [low, high], an infinite one, and what is no number."""
    number_only(name, value)
    number = isinstance(value, (int, float, np.number))
    if not number or not (low <= value <= high and math.isfinite(value)):
        wanted = "finite" if low == -math.inf else bounds(low, high)
        raise ValueError(f"{name} must be {wanted}, got {value!r}")


def number_only(name: str, value: object) -> None:
    """Refuse a tensor where a number is asked for, which would get no gradient."""
    if isinstance(value, Tensor):
        cure = "to learn what water does, use Underwater(…, learnable=True)"
        raise TypeError(f"{name} must be a number, got a tensor; {cure}")


def positive(name: str, value: float, unit: str = "") -> None:
    """Refuse a number that is 0, negative, infinite or NaN."""
    if not 0 < value < math.inf:
        raise ValueError(f"{name} must be finite and > 0{unit and f' {unit}'}, got {value!r}")


def tolerance(value: float) -> None:
    """Refuse a tolerance outside (0, 1)."""
    if not 0 < value < 1:
        raise ValueError(f"tolerance must lie in (0, 1) (image scale 0…1), got {value}")


def instance(name: str, value: object, kind: type, hint: str = "") -> None:
    """Refuse what is no object of one of the package's classes."""
    if not isinstance(value, kind):
        got = type(value).__name__
        raise TypeError(f"{name} must be a uwaug.{kind.__name__}, got {got}{hint}")


def floating(name: str, value: object, hint: str = "") -> None:
    """Refuse what is no floating-point tensor; `hint` says what to do about it."""
    if not isinstance(value, Tensor) or not value.is_floating_point():
        got = value.dtype if isinstance(value, Tensor) else type(value).__name__
        cure = "; scale 0…255 to 0…1 first" if got == torch.uint8 and not hint else hint
        raise TypeError(f"{name} must be a floating-point tensor, got {got}{cure}")


def picture(name: str, value: Tensor, channels: int) -> None:
    """Refuse a tensor that is neither (B, channels, H, W) nor (channels, H, W)."""
    if value.ndim not in (3, 4) or value.shape[-3] != channels:
        shapes = f"({channels}, H, W) or (B, {channels}, H, W)"
        raise ValueError(f"{name} must have shape {shapes}, got {tuple(value.shape)}")


def same_size(name: str, value: Tensor, image: Tensor) -> None:
    """Refuse a map of another height or width than the image."""
    if value.shape[-2:] != image.shape[-2:]:
        mine, wanted = tuple(value.shape[-2:]), tuple(image.shape[-2:])
        raise ValueError(f"{name} is {mine} but image is {wanted}: height and width must agree")


def same_device(name: str, value: Tensor, image: Tensor) -> None:
    """Refuse a tensor on another device than the image."""
    if value.device != image.device:
        where = f"on {value.device} but image is on {image.device}"
        raise ValueError(f"{name} is {where}: move it with .to(…)")


def batches(sizes: Mapping[str, int]) -> None:
    """Refuse batches of different sizes; a batch of 1 serves any other."""
    if len({size for size in sizes.values() if size != 1}) > 1:
        raise ValueError(f"batch sizes must agree or be 1, got {dict(sizes)}")


def counted(x: Tensor, *kinds: str) -> str:
    """How many values of a tensor are "NaN", "negative", "zero" or "infinite", in words."""
    found = {"NaN": x.isnan(), "negative": x < 0, "zero": x == 0, "infinite": x.isinf()}
    parts = [f"{kind} at {int(found[kind].sum())}" for kind in kinds]
    *first, last = parts
    return f"{', '.join(first)} and {last} of {x.numel()} pixels"


def extent(x: Tensor) -> tuple[float, float]:
    """The least and the largest value of a tensor; NaN if it holds any."""
    low, high = x.detach().aminmax()
    return float(low), float(high)


def span(x: Tensor) -> str:
    """The values of a tensor, in words."""
    known = x[~x.isnan()]
    if not known.numel():
        return "NaN only"
    return f"{float(known.min()):.4g} to {float(known.max()):.4g}"
