"""Names of before, for callers that are being rewritten; they go with the last of these."""

from typing import NamedTuple

from torch import Tensor

from uwaug._support.types import Array
from uwaug.formation.loops.render import meter
from uwaug.optics.medium import Medium

__all__ = ["Measured", "measured"]


class Measured(NamedTuple):
    """What an exposure measures."""

    before: Array
    after: Array
    veil: Array


def measured(light: Tensor, z: Tensor, medium: Medium, pixels: Tensor) -> Measured:
    """What an exposure measures."""
    return Measured(*meter(light, z, medium, pixels))
