"""A picture as a function of which water it was taken in: a few numbers of a Jerlov type, by way of
its spectra and the camera's.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import Array, Shape
from uwaug.blur.stack import mixed, node_weights
from uwaug.fitting.pixels import Pixels
from uwaug.fitting.solve import Problem
from uwaug.fitting.structure import Bounds
from uwaug.optics.camera import Camera
from uwaug.optics.curves import curves
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water

__all__ = ["DEEPEST", "Grid", "OneType", "Optics", "SpectralProblem"]

DEEPEST = 30.0
"""m, vertical depth; below, little is left of any light but blue."""

_THICKEST = 40.0
"""Optical depths to the median distance: more than any picture survives."""

_LEAST_CONTENTS = 1e-3
"""Of a type's: nothing but pure water is left."""

_NODES = 48
"""Distances at which the spectra are summed. Between 2 m and 10 km they hold to 1e-7."""

_OPEN = 1e4
"""m, stands for more: even pure water lets nothing through."""

_STEP = 1e-5
"""Of a number, for a difference that stands for its slope."""


@dataclass(frozen=True)
class Optics:
    """What is known of camera and water, beside its type; see `Medium.from_water`."""

    camera: Camera
    g: float
    mu: float
    law: PointSpread


@dataclass(frozen=True, eq=False)
class Grid:
    """Distances from which those of all pixels are interpolated: the curves of 61 bands are smooth.

    Attributes:
        z (1x1x1xK tensor): Chebyshev's nodes of the logarithm of distance, m.
        weights (Px1xKxN tensor): of the nodes at each pixel.
    """

    z: Tensor
    weights: Tensor

    @staticmethod
    def of(pixels: Pixels) -> "Grid":
        """The nodes for the distances of these pixels."""
        places = pixels.z.clamp(max=_OPEN).log()
        low, high = float(places.min()), float(places.max())
        middle, half = (low + high) / 2, max((high - low) / 2, 1e-6)
        angles = (torch.arange(_NODES, dtype=torch.float64) + 0.5) * (math.pi / _NODES)
        x = ((places - middle) / half).clamp(-1, 1)
        # the polynomial that is 1 at one node and 0 at the others: Σ' 2/K·T_n(node)·T_n(x)
        orders = torch.arange(_NODES, dtype=torch.float64)
        at_nodes = torch.cos(orders[:, None] * angles) * (2 / _NODES)
        at_nodes[0] /= 2
        at_pixels = torch.cos(orders[:, None] * torch.acos(x))
        return Grid(
            z=(middle + half * torch.cos(angles)).exp().reshape(1, 1, 1, -1),
            weights=at_nodes.T @ at_pixels,
        )


@dataclass(frozen=True, eq=False)
class OneType:
    """All pairs were taken in one Jerlov type, or in a mixture of two, with more or less in it.

    Attributes:
        waters: one type or two.
        optics: what is known.
        depth: the vertical depth, m; None if it is fitted.
        sizes: height and width of each observed picture, px.
        reference: the median distance, m.
        gain: whether each picture has an exposure of its own.
    """

    waters: tuple[Water, ...]
    optics: Optics
    depth: float | None
    sizes: tuple[tuple[int, int], ...]
    reference: float
    gain: bool

    @property
    def name(self) -> str:
        """Of the type, or of both."""
        return " + ".join(water.name for water in self.waters)

    @property
    def shape(self) -> Shape:
        """Of the point spread."""
        return self.optics.law.shape

    @property
    def bounds(self) -> dict[str, Bounds]:
        """Of each number that is fitted, by name, in the order of θ; contents by their
        logarithm.
        """
        thickest = max(float(water.beta.mean()) for water in self.waters) * self.reference
        most = max(_THICKEST / thickest, 1.0)
        found = {"contents": Bounds(math.log(_LEAST_CONTENTS), math.log(most), 0.0)}
        if len(self.waters) == 2:
            found["mixing"] = Bounds(0.0, 1.0, 0.5)
        if self.depth is None:
            found["vertical_depth"] = Bounds(0.0, DEEPEST, 3.0)
        if self.gain:
            for i in range(len(self.sizes)):
                found[f"gain_{i + 1}"] = Bounds(1e-3, 1e3, 1.0)
        return found

    def numbers(self, theta: Array) -> dict[str, float]:
        """The fitted numbers by name."""
        return dict(zip(self.bounds, theta.tolist(), strict=True))

    def water(self, theta: Array) -> Water:
        """The water of these numbers."""
        numbers = self.numbers(theta)
        water = self.waters[0]
        if len(self.waters) == 2:
            water = water.mix(self.waters[1], min(max(numbers["mixing"], 0.0), 1.0))
        return water.with_contents(math.exp(numbers["contents"]))

    def depth_of(self, theta: Array) -> float:
        """The vertical depth, m, fitted or known."""
        if self.depth is not None:
            return self.depth
        return max(self.numbers(theta)["vertical_depth"], 0.0)

    def medium(self, theta: Array) -> Medium:
        """The medium of these numbers, with all bands: fewer rates jump as numbers change."""
        return Medium.from_water(
            self.water(theta),
            self.optics.camera,
            vertical_depth=self.depth_of(theta),
            g=self.optics.g,
            mu=self.optics.mu,
            point_spread=self.optics.law,
            tolerance=0,
        )

    def sigma(self, medium: Medium, z: Tensor) -> Tensor:
        """Widths (Px1x1xN) of the forward scatter, px, at distances of that shape."""
        lengths = medium.lengths(z)
        rows = []
        for i, size in enumerate(self.sizes):
            rows.append(medium.point_spread.sigma(lengths[i : i + 1], size))
        return torch.cat(rows)

    def reported(self, theta: Array) -> dict[str, float]:
        """What is reported, by name."""
        numbers = self.numbers(theta)
        found = {"visibility": self.water(theta).visibility()}
        found["contents"] = math.exp(numbers.pop("contents"))
        found["vertical_depth"] = self.depth_of(theta)
        return {**found, **numbers}

    def gains(self, theta: Array) -> Tensor:
        """The exposure of each picture (Px1x1x1)."""
        pairs = len(self.sizes)
        gains = torch.from_numpy(theta[-pairs:]) if self.gain else torch.ones(pairs)
        return gains.double().reshape(-1, 1, 1, 1)


@dataclass(frozen=True, eq=False)
class SpectralProblem(Problem[Any]):
    """A type and the pixels that it is to explain.

    Attributes:
        structure: the type, a `OneType`; it has no rates of channels, as other structures do.
    """

    @cached_property
    def grid(self) -> Grid:
        """Of the distances of the pixels."""
        return Grid.of(self.pixels)

    def model(self, theta: Array) -> Tensor:
        """The pixels (Px3x1xN) in linear light."""
        structure, pixels = self.structure, self.pixels
        medium = structure.medium(theta)
        at_nodes = curves(medium.sums(exact_at_lens=True), self.grid.z)
        direct, scatter, veil = (curve @ self.grid.weights for curve in at_nodes)
        plan, blurs = pixels.stacks[structure.shape]
        blur = mixed(blurs, node_weights(structure.sigma(medium, pixels.z), plan))
        light: Tensor = direct * pixels.clean + scatter * blur + veil
        gains: Tensor = structure.gains(theta)
        return gains * light

    def linearised(self, theta: Array) -> tuple[Array, Array]:
        """The residual and its Jacobian (P·3·N × numbers), by differences."""
        here = self.residual(theta)
        _, high = self.limits
        columns = []
        for i in range(len(theta)):
            # into the range
            step = _STEP if theta[i] + _STEP <= high[i] else -_STEP
            moved = theta.copy()
            moved[i] += step
            columns.append((self.residual(moved) - here) / step)
        return here, np.stack(columns, 1)
