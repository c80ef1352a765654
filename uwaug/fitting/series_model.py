"""Waters of one series: what is dissolved stays, what scatters grows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import Array, Shape
from uwaug.fitting.model import Natural
from uwaug.fitting.structure import COLOURS, Bounds, Geometry, Quantity

__all__ = ["SeriesWater"]

_LEAST = 1e-6
"""1/m, stands for no scattering in a width law."""


@dataclass(frozen=True)
class SeriesWater:
    """Waters that differ in what scatters.

        β = a + b,  G = a + g·b,  G·V(0) = m·b,  σ = scale·(b̄ z)^exponent

    a, m (μ times the light at the scene) of each colour, g and the width law are those of all
    pictures, b of each colour is that of each level of turbidity.

    Attributes:
        name: of the candidate.
        shape: of the point spread; None if no light is scattered forward, and G is that of the veil
            alone.
        geometry: of the pictures.
        level: of turbidity, of each picture, counted from 0.
        levels: how many there are.
    """

    name: str
    shape: Shape | None
    geometry: Geometry
    level: tuple[int, ...]
    levels: int

    @property
    def bounds(self) -> dict[str, Bounds]:
        """Of each number that is fitted, by name, in the order of θ."""
        thickest, typical = 40 / self.geometry.reference, 1 / self.geometry.reference
        each: dict[str, Bounds] = {}
        for colour in COLOURS:
            each[f"a_{colour}"] = Bounds(0.0, thickest, 0.3 * typical)
        for i in range(self.levels):
            for colour in COLOURS:
                each[f"b_{colour}_{i + 1}"] = Bounds(0.0, thickest, typical)
        for colour in COLOURS:
            each[f"m_{colour}"] = Bounds(0.0, 10.0, 0.1)
        each["g"] = Bounds(0.0, 1.0, 0.1)
        if self.shape is not None:
            # the widest blur at .1 scattering lengths
            each["scale"] = Bounds(0.0, 10 * self.geometry.widest, 0.1 * self.geometry.widest)
            each["exponent"] = Bounds(0.2, 3.0, 1.0)
        return each

    @property
    def quantities(self) -> list[Quantity]:
        """What is reported: the numbers themselves."""
        unit, far = f"1/{self.geometry.unit}", self.geometry.farthest
        found = []
        for name in self.bounds:
            kind = name.split("_")[0]
            if kind in ("a", "b"):
                found.append(Quantity(name, unit, 0.1 / far))
            else:
                unit_of = {"scale": "px"}.get(kind, "1")
                shows = {"scale": 0.2, "exponent": 0.2, "g": 0.05, "m": 0.02}[kind]
                found.append(Quantity(name, unit_of, shows))
        return found

    def reported(self, theta: Tensor) -> Tensor:
        """The value of each of `quantities`: θ itself."""
        return 1 * theta

    def scattering(self, theta: Tensor) -> Tensor:
        """The b of each level (levelsx3)."""
        return theta[3 : 3 + 3 * self.levels].reshape(self.levels, 3)

    def natural(self, theta: Tensor) -> Natural:
        """The numbers that pictures depend on; differentiable."""
        b = self.scattering(theta)
        return self.at(theta, b[torch.tensor(self.level)])

    def at(self, theta: Tensor, b: Tensor) -> Natural:
        """The same for any scattering (Px3)."""
        after = 3 + 3 * self.levels
        a, m, g = theta[:3], theta[after : after + 3], theta[after + 3]
        width = exponent = None
        if self.shape is not None:
            lengths = b.mean(1).clamp(min=_LEAST) * self.geometry.reference
            exponent = theta[after + 5].expand(len(b))
            width = theta[after + 4] * lengths**exponent
        return Natural(
            beta=a + b,
            G=a + g * b,
            source=m * b,
            width=width,
            exponent=exponent,
            gain=torch.ones_like(b),
        )

    def begun(self, found: Sequence[Natural]) -> Array:
        """θ from one water for each level, fitted alone."""
        share = self.bounds["g"].begin
        beta = torch.cat([one.beta[:1] for one in found])
        G = torch.cat([one.G[:1] for one in found])
        source = torch.cat([one.source[:1] for one in found])
        b = ((beta - G) / (1 - share)).clamp(min=0.01 / self.geometry.reference)
        a = (beta - b).clamp(min=0.0).median(0).values
        parts = [a, b.flatten(), (source / b).median(0).values, torch.tensor([share])]
        if self.shape is not None:
            parts.append(self._law(found, b))
        return np.asarray(torch.cat([part.double() for part in parts]))

    def _law(self, found: Sequence[Natural], b: Tensor) -> Tensor:
        """Scale and exponent that the widths of the levels suggest."""
        exponent = self.bounds["exponent"].begin
        scales = []
        for one, row in zip(found, b, strict=True):
            if one.width is not None:
                scales.append(one.width[0] / (row.mean() * self.geometry.reference) ** exponent)
        scale = torch.stack(scales).median() if scales else torch.tensor(1.0)
        return torch.stack([scale.double(), torch.tensor(exponent, dtype=torch.float64)])
