"""A map as a sample holds it, in metres, with something at every unknown pixel."""

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.tiles import Rows, RowSource, is_large, row_bands, rows_of
from uwaug.distance.behind import filled_behind_rows
from uwaug.distance.complete import filled_rows, warn_of_unknown
from uwaug.distance.convert import (
    check_distance,
    ends_of_inverse,
    fill_unknown,
    require_range,
    require_relative,
    scaled_inverse,
    scaled_relative,
    single,
)

DistanceKind = Literal["metric", "relative", "inverse"]
_Policy = Literal["error", "fill", "behind", "skip", "far"]
Unknown = _Policy | float
"""What unknown pixels get; a number is metres."""

_TOUCHING = 1e-6
"""m, for relative distance 0 with near = 0: in a map of metres 0 means unknown."""


class UnknownDistanceError(ValueError):
    """A map that has unknown pixels where none may be, or nothing else.

    Attributes:
        argument: "unknown", the option that says what they get.
        cures: values of it that would help.
    """

    argument = "unknown"

    def __init__(self, message: str, *cures: str) -> None:
        super().__init__(message)
        self.cures = cures

    def __reduce__(self) -> tuple[type, tuple[str, ...]]:
        return type(self), (str(self), *self.cures)


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
    finite = distance[distance.isfinite()]
    return not finite.numel() or bool((finite == finite[0]).all())


def to_metres(
    distance: Tensor, scaling: Scaling, kind: DistanceKind, unknown: Unknown
) -> Tensor | RowSource:
    """A map of one picture (1xHxW), in metres, every pixel known; of a large picture in rows.

    Raises:
        UnknownDistanceError: if pixels are unknown and `unknown` does not say what they get.
        ValueError: if the map is of another kind.
    """
    height, width = distance.shape[-2:]
    if not is_large((height, width)):
        return _completed(_scale(distance, scaling, kind)(distance), unknown)
    rows = metres_by_rows(distance, scaling, kind, unknown)
    return RowSource(rows, (1, height, width), single(distance[:, :0]))


def whole_metres(
    distance: Tensor, scaling: Scaling, kind: DistanceKind, unknown: Unknown
) -> Tensor:
    """`to_metres` of all rows at once, for those who see to unknown pixels: "fill", "behind" and
    "skip" leave them 0 or NaN.
    """
    z = _scale(distance, scaling, kind)(distance)
    return z if unknown in ("fill", "behind", "skip") else _completed(z, unknown)


def metres_by_rows(
    distance: Tensor, scaling: Scaling, kind: DistanceKind, unknown: Unknown
) -> Rows:
    """`to_metres`, a few rows at a time."""
    scale = _scale(distance, scaling, kind)

    def scaled(start: int, stop: int) -> Tensor:
        return scale(distance[:, start:stop])

    if unknown not in ("error", "fill", "behind", "skip"):
        return lambda start, stop: _completed(scaled(start, stop), unknown)
    size = (distance.shape[-2], distance.shape[-1])
    count = sum(int((scaled(start, stop) > 0).sum()) for start, stop in row_bands(*size))
    if count == distance.numel():
        return scaled
    if unknown == "error" or not count:
        return rows_of(_completed(scale(distance), unknown))  # which refuses it
    if unknown == "behind":
        return filled_behind_rows(scaled, size)
    warn_of_unknown(1 - count / distance.numel())
    return filled_rows(scaled, size)


def _completed(z: Tensor, unknown: Unknown) -> Tensor:
    """A map in metres with something at every unknown pixel."""
    if not isinstance(unknown, str):
        return torch.where(z > 0, z, unknown)
    if unknown == "far":
        return torch.where(z > 0, z, math.inf)
    try:
        if unknown == "error":
            return check_distance(z)
        return fill_unknown(z, behind=unknown == "behind")
    except ValueError as error:
        cures = ("fill", "behind", "skip", "far") if unknown == "error" else ("skip",)
        raise UnknownDistanceError(f"{error}; or use unknown={cures[0]!r}", *cures) from None


def _scale(distance: Tensor, scaling: Scaling, kind: DistanceKind) -> Callable[[Tensor], Tensor]:
    """A function from a part of a map to metres, that leaves unknown pixels; refuses a map of
    another kind.
    """
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
    require_range(near, far, inverse=True)
    try:
        ends = ends_of_inverse(single(distance))
    except ValueError as error:
        raise UnknownDistanceError(f"{error}; or use unknown='skip'", "skip") from None
    return lambda part: scaled_inverse(single(part), ends, near, far)
