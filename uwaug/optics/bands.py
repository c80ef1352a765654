"""The inherent optical properties of a medium, band by band: what a lamp, whose light does not come
down from the surface, needs to know of the water.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support.codec import plain
from uwaug._support.types import Array
from uwaug.optics.reduction import reduced_curves
from uwaug.optics.surfaces import as_matrices


@plain
@dataclass(frozen=True, eq=False)
class Lamplit:
    """What files hold of `Bands`: their `under_lamp`."""

    under_lamp: Mapping[str, Tensor]

    @staticmethod
    def of_plain(under_lamp: Mapping[str, Any]) -> "Lamplit":
        """Of plain numbers, see `uwaug._support.codec`."""
        tensors = {n: torch.tensor(x, dtype=torch.float64) for n, x in under_lamp.items()}
        return Lamplit(tensors)


@dataclass(frozen=True, eq=False)
class Bands:
    """A medium band by band, and the camera that sees it.

    Attributes:
        beta, G, b (M arrays): β, G and scattering coefficient of the water, 1/m.
        response (3xM array): the camera's weights; each channel's sum is 1.
        lit (3xM or 9xM array): what of each band surfaces send to the channels, see
            `uwaug.optics.surfaces.measure`.
        tolerance: largest error of a curve; 0 where every band is a rate.
    """

    beta: Array
    G: Array
    b: Array
    response: Array
    lit: Array
    tolerance: float

    def as_stored(self) -> Lamplit:
        """What stands for this in a file."""
        return Lamplit(self.under_lamp)

    @cached_property
    def under_lamp(self) -> dict[str, Tensor]:
        """Rates and weights of `Medium.under_lamp`, of one row, by name."""
        # b spans some tenths about its mean: as a measure of the scale of the light it keeps the
        # tolerance relative to it
        mean = float(self.b.mean()) or 1.0
        scatter = self.response * self.b / mean
        tensors, _ = reduced_curves(self.beta, self.G, self.lit, scatter, self.tolerance)
        return {**tensors, "veil_weights": mean * tensors["veil_weights"]}


def padded(parts: Sequence[Tensor]) -> Tensor:
    """One attribute of several media as one tensor: (B) or (B, …, K). The missing rates and weights
    of some are 0.
    """
    if parts[0].ndim == 1:
        return torch.cat(list(parts))
    if any(part.ndim == 4 for part in parts):
        parts = [as_matrices(part) for part in parts]
    width = max(part.shape[-1] for part in parts)
    return torch.cat([F.pad(part, (0, width - part.shape[-1])) for part in parts])
