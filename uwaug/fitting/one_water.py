"""One water for all pictures: how the numbers that are fitted make up those that pictures need."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import Array, Shape
from uwaug.fitting.model import SLOWEST, Natural
from uwaug.fitting.structure import COLOURS, Bounds, Gain, Geometry, Model, Quantity
from uwaug.optics.point_spread import PAPER_SIZE, PointSpread

__all__ = ["OneWater"]

_THICKEST = 40.0
"""Optical depths to the reference distance: more than any picture survives."""

_LARGEST_SHARE = 4.0
"""Of G in β, where no light is scattered forward and nothing ties the two together."""

_FITTED = {f"G_{colour}": f"share_{colour}" for colour in COLOURS}
_FITTED |= {f"veil_{colour}": f"source_{colour}" for colour in COLOURS}
"""Numbers that are fitted in place of those that are reported."""


@dataclass(frozen=True)
class OneWater:
    """All pairs are of one water.

    Attributes:
        model: the candidate.
        geometry: of the pictures.
        gain: "fixed": the exposure is that of the clean picture. "free": one factor for each
            picture. "channels": one for each of its colours, which is also what is left of each
            colour at the scene's depth.
        g: share of the scattered light that leaves the line of sight; gives a and b from β and G.
        fixed: numbers that are known, by the names of `quantities`.
    """

    model: Model
    geometry: Geometry
    gain: Gain
    g: float
    fixed: Mapping[str, float]

    @property
    def shape(self) -> Shape | None:
        """Of the point spread."""
        return self.model.shape

    @property
    def name(self) -> str:
        """Of the candidate."""
        return self.model.name if self.gain == "fixed" else f"{self.model.name} + gain"

    @property
    def fixable(self) -> tuple[str, ...]:
        """The names of numbers that may be given instead of fitted."""
        kinds = ["beta"]
        if self.model.veil == "own":
            kinds.append("G")
        if self.model.veil != "none":
            kinds.append("veil")
        names = [f"{kind}_{colour}" for kind in kinds for colour in COLOURS]
        return (*names, *(("width", "exponent") if self.model.own_law else ()))

    def begun(self, numbers: Mapping[str, float], given: Mapping[str, float]) -> Array:
        """Where a fit begins: what is `given`, by the names of `fixable`, else `numbers`."""
        begin = {**numbers, **{name: given[name] for name in given if name in self.bounds}}
        for colour in COLOURS:
            beta = begin.get(f"beta_{colour}", self.fixed.get(f"beta_{colour}", 1.0))
            G = begin.get(f"share_{colour}", 1.0) * beta
            if f"G_{colour}" in given:
                G = given[f"G_{colour}"]
                begin[f"share_{colour}"] = G / max(beta, 1e-9)
            if f"veil_{colour}" in given:
                begin[f"source_{colour}"] = G * given[f"veil_{colour}"]
        return np.array([begin[name] for name in self.bounds])

    @property
    def bounds(self) -> dict[str, Bounds]:
        """Of each number that is fitted, by name, in the order of θ."""
        thickest = _THICKEST / self.geometry.reference
        typical = 1 / self.geometry.reference
        forward = self.model.law is not None
        each: dict[str, Bounds] = {}
        for colour in COLOURS:
            each[f"beta_{colour}"] = Bounds(0.0, thickest, typical)
        if self.model.veil == "own":
            for colour in COLOURS:
                each[f"share_{colour}"] = Bounds(0.0, 1.0 if forward else _LARGEST_SHARE, 0.5)
        if self.model.veil != "none":
            for colour in COLOURS:
                each[f"source_{colour}"] = Bounds(0.0, thickest, 0.2 * typical)
        if self.model.own_law:
            each["width"] = Bounds(0.0, self.geometry.widest, 0.1 * self.geometry.widest)
            each["exponent"] = Bounds(0.2, 3.0, 1.0)
        for name in self._gains():
            each[name] = Bounds(1e-3, 1e3, 1.0)
        taken = {_FITTED.get(name, name) for name in self.fixed}
        return {name: one for name, one in each.items() if name not in taken}

    def _gains(self) -> list[str]:
        pictures = range(1, self.geometry.pairs + 1)
        if self.gain == "free":
            return [f"gain_{i}" for i in pictures]
        if self.gain == "channels":
            return [f"gain_{i}_{colour}" for i in pictures for colour in COLOURS]
        return []

    def natural(self, theta: Tensor) -> Natural:
        """The numbers that pictures depend on; differentiable."""
        value = self._values(theta)
        beta = self._colours(value, "beta")
        G, source = beta, torch.zeros_like(beta)
        if self.model.veil == "own":
            G = torch.stack([self._G(value, colour) for colour in COLOURS])
        if self.model.veil != "none":
            source = torch.stack([self._source(value, colour) for colour in COLOURS])
        width, exponent = self._law(value, beta, G)
        pairs = self.geometry.pairs
        return Natural(
            beta=beta.expand(pairs, 3),
            G=G.expand(pairs, 3),
            source=source.expand(pairs, 3),
            width=None if width is None else width.expand(pairs),
            exponent=None if exponent is None else exponent.expand(pairs),
            gain=self._gain(value, beta),
        )

    def _values(self, theta: Tensor) -> Callable[[str], Tensor]:
        """Looks numbers up by name, fitted or fixed."""
        places = {name: i for i, name in enumerate(self.bounds)}

        def value(name: str) -> Tensor:
            if name in places:
                return theta[places[name]]
            return theta.new_tensor(self.fixed[name])

        return value

    def _colours(self, value: Callable[[str], Tensor], quantity: str) -> Tensor:
        return torch.stack([value(f"{quantity}_{colour}") for colour in COLOURS])

    def _G(self, value: Callable[[str], Tensor], colour: str) -> Tensor:
        if f"G_{colour}" in self.fixed:
            return value(f"G_{colour}")
        return value(f"share_{colour}") * value(f"beta_{colour}")

    def _source(self, value: Callable[[str], Tensor], colour: str) -> Tensor:
        if f"veil_{colour}" not in self.fixed:
            return value(f"source_{colour}")
        own = self.model.veil == "own"
        G = self._G(value, colour) if own else value(f"beta_{colour}")
        return G * value(f"veil_{colour}")

    def _law(
        self, value: Callable[[str], Tensor], beta: Tensor, G: Tensor
    ) -> tuple[Tensor | None, Tensor | None]:
        """Width at the reference distance, and exponent."""
        law = self.model.law
        if law is None:
            return None, None
        if self.model.own_law:
            return value("width"), value("exponent")
        known = self.known_law()
        lengths = ((beta - G) / (1 - self.g)).mean() * self.geometry.reference
        exponent = torch.as_tensor(known.exponent, dtype=beta.dtype)
        return known.scale * lengths.clamp(min=1e-6) ** exponent, exponent

    def known_law(self) -> PointSpread:
        """The paper's width law or the calibrated one, in px of these pictures."""
        if self.model.law == "paper":
            paper = PointSpread.paper()
            return PointSpread(paper.scale * self.geometry.short_side / PAPER_SIZE, paper.exponent)
        if self.geometry.focal_px is None:
            raise ValueError("focal_px: the calibrated width law needs the focal length in px")
        return PointSpread.calibrated(self.geometry.focal_px)

    def _gain(self, value: Callable[[str], Tensor], like: Tensor) -> Tensor:
        pairs = self.geometry.pairs
        if self.gain == "fixed":
            return like.new_ones(pairs, 3)
        found = torch.stack([value(name) for name in self._gains()])
        return found.reshape(pairs, -1).expand(pairs, 3)

    @property
    def quantities(self) -> list[Quantity]:
        """What is reported: those that are fitted or fixed, and what follows from them."""
        distance, unit = self.geometry.farthest, f"1/{self.geometry.unit}"
        rate = 0.1 / distance
        kinds = [("beta", unit, rate)]
        if self.model.veil == "own":
            kinds.append(("G", unit, rate))
        if self.model.veil != "none":
            kinds += [("veil", "1", 0.02), ("source", unit, 0.02 / distance)]
        if self.model.law is not None:
            kinds += [("a", unit, rate), ("b", unit, rate)]
        found = []
        for name, its_unit, shows in kinds:
            for colour in COLOURS:
                found.append(Quantity(f"{name}_{colour}", its_unit, shows))
        if self.model.own_law:
            found += [Quantity("width", "px", 0.2), Quantity("exponent", "1", 0.2)]
        return found + [Quantity(name, "1", 0.02) for name in self._gains()]

    def reported(self, theta: Tensor) -> Tensor:
        """The value of each of `quantities`; differentiable."""
        natural, value = self.natural(theta), self._values(theta)
        beta, G, source = natural.beta[0], natural.G[0], natural.source[0]
        b = (beta - G) / (1 - self.g)
        parts = [beta]
        if self.model.veil == "own":
            parts.append(G)
        if self.model.veil != "none":
            parts += [source / (G + SLOWEST), source]
        if self.model.law is not None:
            parts += [beta - b, b]
        if self.model.own_law:
            parts.append(torch.stack([value("width"), value("exponent")]))
        if self._gains():
            parts.append(torch.stack([value(name) for name in self._gains()]))
        return torch.cat(parts)
