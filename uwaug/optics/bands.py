"""Inherent optical properties of a medium at each wavelength, for the light of lamps, which does
not come down from the surface.
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
    """The rates and weights of `Bands` under a lamp, which is the part that files hold."""

    under_lamp: Mapping[str, Tensor]

    @staticmethod
    def of_plain(under_lamp: Mapping[str, Any]) -> "Lamplit":
        """Make it of plain numbers, see `uwaug._support.codec`."""
        tensors = {n: torch.tensor(x, dtype=torch.float64) for n, x in under_lamp.items()}
        return Lamplit(tensors)


@dataclass(frozen=True, eq=False)
class Bands:
    """A medium band by band, and the camera that sees it.

    Attributes:
        beta, G, b (M arrays): β, G and scattering coefficient of the water, 1/m.
        response (3xM array): the camera's weights; each channel's sum is 1.
        lit (3xM or 9xM array): light of each band that surfaces send to the channels, see
            `uwaug.optics.surfaces.measure`.
        tolerance: largest error of a curve; 0 keeps every band.
    """

    beta: Array
    G: Array
    b: Array
    response: Array
    lit: Array
    tolerance: float

    def as_stored(self) -> Lamplit:
        """The part of this that files hold."""
        return Lamplit(self.under_lamp)

    @cached_property
    def under_lamp(self) -> dict[str, Tensor]:
        """Rates and weights of `Medium.under_lamp`, of one row, by name."""
        # b over its mean is about 1, so that the tolerance is relative to it
        b_mean = float(self.b.mean()) or 1.0
        scatter = self.response * self.b / b_mean
        tensors, _ = reduced_curves(self.beta, self.G, self.lit, scatter, self.tolerance)
        return {**tensors, "veil_weights": b_mean * tensors["veil_weights"]}


def padded(parts: Sequence[Tensor]) -> Tensor:
    """Join an attribute of several media to one tensor, (B) or (B, …, K); missing rates and weights
    are 0.
    """
    if parts[0].ndim == 1:
        return torch.cat(list(parts))
    if any(part.ndim == 4 for part in parts):
        parts = [as_matrices(part) for part in parts]
    width = max(part.shape[-1] for part in parts)
    return torch.cat([F.pad(part, (0, width - part.shape[-1])) for part in parts])
