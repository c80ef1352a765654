"""A map as a sample holds it, in metres, with something at every unknown pixel."""

import math
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug import checks
from uwaug.distance import check_distance, from_inverse, from_relative

__all__ = ["DistanceKind", "Scaling", "Unknown", "as_unknown", "skipped", "to_metres"]

DistanceKind = Literal["metric", "relative", "inverse"]
_Policy = Literal["error", "fill", "skip", "far"]
Unknown = _Policy | float
"""What unknown pixels get; a number is metres."""

_TOUCHING = 1e-6
"""m, for relative distance 0 with near = 0: in a map of metres 0 means unknown."""


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
    z, instead = _scaled(distance, scaling, kind), unknown
    if instead == "far":
        instead = math.inf
    if not isinstance(instead, str):
        return torch.where(z > 0, z, instead)
    strict = instead == "error"
    cure = "unknown='fill'), or 'skip', 'far' or metres" if strict else "unknown='skip')"
    try:
        return check_distance(z, strict=strict)
    except ValueError as error:
        raise ValueError(f"{error}; or use RandomUnderwater({cure}") from None


def _scaled(distance: Tensor, scaling: Scaling, kind: DistanceKind) -> Tensor:
    """In metres, unknown pixels left."""
    if kind == "metric":
        checks.metres("distance", distance)
        return distance
    near, far, gamma = scaling
    if kind == "relative":
        return from_relative(distance, max(near, _TOUCHING), far, gamma)
    if not bool(distance.isfinite().any()):
        return torch.full_like(distance, math.nan)
    try:
        return from_inverse(distance, near, far)
    except ValueError as error:
        raise ValueError(f"{error}; or use RandomUnderwater(unknown='skip')") from None
