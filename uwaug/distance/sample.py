"""A map as a sample holds it, in metres, with something at every unknown pixel."""

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.tiles import Rows, bands, held
from uwaug.distance.complete import filled_rows, warn_of_unknown
from uwaug.distance.convert import check_distance
from uwaug.distance.scaling import (
    ends_of_inverse,
    require_range,
    require_relative,
    scaled_inverse,
    scaled_relative,
    single,
)

__all__ = [
    "DistanceKind",
    "Scaling",
    "Unknown",
    "as_unknown",
    "metres_by_rows",
    "skipped",
    "to_metres",
]

DistanceKind = Literal["metric", "relative", "inverse"]
_Policy = Literal["error", "fill", "skip", "far"]
Unknown = _Policy | float
"""What unknown pixels get; a number is metres."""

_TOUCHING = 1e-6
"""m, for relative distance 0 with near = 0: in a map of metres 0 means unknown."""


_SKIP = "unknown='skip' (--unknown skip)"
"""In Python, and on the command line."""


class Scaling(NamedTuple):
    """What scales a map that does not hold metres, see `uwaug.distance.from_relative`."""

    near: float
    far: float
    gamma: float


def as_unknown(value: Any) -> Unknown:
    """Check what unknown pixels are to get."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        checks.one_of("unknown", value, (*get_args(_Policy), "a number of metres"))
        policy: Unknown = value
        return policy
    checks.positive("unknown", float(value), "m")
    return float(value)


def skipped(distance: Tensor | None, kind: DistanceKind, unknown: Unknown) -> bool:
    """Whether a picture is left alone, as its map has no known pixel or, of inverse depth, no two
    that differ.
    """
    if distance is None or unknown != "skip":
        return False
    if kind == "metric":
        return not bool((distance > 0).any())
    if kind == "relative":
        return bool(distance.isnan().all())
    known = distance[distance.isfinite()]
    return not known.numel() or bool((known == known[0]).all())


def to_metres(distance: Tensor, scaling: Scaling, kind: DistanceKind, unknown: Unknown) -> Tensor:
    """A map of one picture (1xHxW), in metres, every pixel known.

    Raises:
        ValueError: if the map does not suit, saying which option would help.
    """
    instead = math.inf if unknown == "far" else unknown
    return _known(_scale(distance, scaling, kind)(distance), instead)


def metres_by_rows(
    distance: Tensor, scaling: Scaling, kind: DistanceKind, unknown: Unknown
) -> Rows:
    """`to_metres`, a few rows at a time."""
    instead = math.inf if unknown == "far" else unknown
    scale = _scale(distance, scaling, kind)

    def scaled(start: int, stop: int) -> Tensor:
        return scale(distance[:, start:stop])

    if not isinstance(instead, str):
        return lambda start, stop: _known(scaled(start, stop), instead)
    size = (distance.shape[-2], distance.shape[-1])
    known = 0
    for start, stop in bands(*size):
        known += int((scaled(start, stop) > 0).sum())
    if known == distance.numel():
        return scaled
    if instead == "error" or not known:
        # refused
        return held(_known(scale(distance), instead))
    warn_of_unknown(1 - known / distance.numel())
    return filled_rows(scaled, size)


def _known(z: Tensor, instead: Unknown) -> Tensor:
    """A map in metres with something at every unknown pixel."""
    if not isinstance(instead, str):
        return torch.where(z > 0, z, instead)
    strict = instead == "error"
    others = "fill, skip, far or metres"
    cure = f"unknown='fill' (--unknown {others})" if strict else _SKIP
    try:
        return check_distance(z, strict=strict)
    except ValueError as error:
        raise ValueError(f"{error}; or use {cure}") from None


def _scale(distance: Tensor, scaling: Scaling, kind: DistanceKind) -> Callable[[Tensor], Tensor]:
    """What takes a part of a map to metres, unknown pixels left; refuses what does not suit."""
    if kind == "metric":
        checks.metres("distance", distance)
        return single
    near, far, gamma = scaling
    if kind == "relative":
        near = max(near, _TOUCHING)
        require_relative(distance, near, far, gamma)
        return lambda part: scaled_relative(single(part), near, far, gamma)
    if not bool(distance.isfinite().any()):
        return lambda part: torch.full_like(part, math.nan)
    try:
        require_range(near, far, inverse=True)
        ends = ends_of_inverse(single(distance))
    except ValueError as error:
        raise ValueError(f"{error}; or use {_SKIP}") from None
    return lambda part: scaled_inverse(single(part), ends, near, far)
