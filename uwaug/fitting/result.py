"""`Fit`: a water that was recovered from pictures."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import Array
from uwaug.fitting import saved
from uwaug.fitting.media import media_of
from uwaug.fitting.model import KINDS, Natural
from uwaug.fitting.noise import Noise
from uwaug.fitting.one_water import OneWater
from uwaug.fitting.pixels import Pair
from uwaug.fitting.report import Candidate, Correlation, Parameter, table
from uwaug.fitting.solve import stacked
from uwaug.fitting.structure import MODELS, Gain, Geometry
from uwaug.formation.model import form_image
from uwaug.optics.medium import Medium

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Fit"]

_FLATTEST = 0.2
"""Exponent of a width law, at least."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A water that was recovered from pictures; made by `uwaug.fit`, or read by `Fit.load`.

    Attributes:
        model: the name of the model that was chosen.
        parameters: each number by name: value, standard error, 95 % interval, unit, state. beta, G,
            a and b of each colour [1/m]; veil, V(0); source, the growth of the veil at the lens,
            G·V(0) [1/m]; width, σ at the median distance [px], and exponent of the width law; gain.
        correlation: of the parameters.
        candidates: the models that were tried.
        message: in words: which model, how well it explains the pictures, what they cannot tell.
        noise: of the observed pictures.
        rms: of the residual, in linear light.
        history: the cost after each evaluation of the model that was chosen.
        structure, theta, covariance: the numbers as they were fitted.
    """

    model: str
    parameters: dict[str, Parameter]
    correlation: Correlation
    candidates: tuple[Candidate, ...]
    message: str
    noise: Noise
    rms: float
    history: list[float]
    structure: OneWater
    theta: Array
    covariance: Array
    pairs: tuple[Pair, ...] = field(default=(), repr=False)

    @property
    def medium(self) -> Medium:
        """The water, as `uwaug.Underwater` and `uwaug.form_image` take it: a batch of one."""
        return _medium(self.structure, torch.from_numpy(self.theta))

    @property
    def gains(self) -> Tensor:
        """The exposure of each observed picture (Px3)."""
        return self.structure.natural(torch.from_numpy(self.theta)).gain

    def sample(self, count: int, generator: torch.Generator | None = None) -> Medium:
        """A batch of waters that the pictures allow: drawn from the normal distribution of what
        pictures depend on, as far as a water can be so.

        Args:
            count: how many.
            generator: source of randomness; torch's global generator if None.
        """
        if not isinstance(count, (int, np.integer)) or isinstance(count, bool) or count < 1:
            raise ValueError(f"count must be a whole number ≥ 1, got {count!r}")
        middle, root = self._natural_spread()
        normal = torch.randn(int(count), root.shape[1], generator=generator, dtype=torch.float64)
        drawn = (middle + normal @ root.T).clamp(min=0.0).reshape(count, len(KINDS), 3)
        beta, G, source, width, exponent, _ = drawn.unbind(1)
        shape, forward = self.structure.shape, self.structure.shape is not None
        if forward or self.structure.model.veil == "shared":
            G = G.minimum(beta)
        natural = Natural(
            beta=beta,
            G=G,
            source=source,
            width=width[:, 0] if forward else None,
            exponent=exponent[:, 0].clamp(min=_FLATTEST) if forward else None,
            gain=torch.ones_like(beta),
        )
        b = (beta - G) / (1 - self.structure.g)
        return media_of(natural, b.mean(1), shape, self.structure.geometry)

    def _natural_spread(self) -> tuple[Tensor, Tensor]:
        """What pictures depend on (18), and a root of its covariance. (Of θ a sample would be
        none of the fit's: where β is hardly known and G well, G/β and β make up for each other,
        and no longer do where one of them meets its bound.)
        """
        theta = torch.from_numpy(self.theta)

        def natural(numbers: Tensor) -> Tensor:
            return stacked(self.structure.natural(numbers))[:, 0].flatten()

        slopes = torch.func.jacrev(natural)(theta)
        covariance = slopes @ torch.from_numpy(self.covariance) @ slopes.T
        values, vectors = torch.linalg.eigh(covariance)
        return natural(theta), vectors * values.clamp(min=0.0).sqrt()

    @property
    def rendered(self) -> list[Tensor]:
        """Each observed picture (3xHxW, linear light) as the fitted water makes it."""
        return [picture for picture, _ in self._formed()]

    @property
    def residual(self) -> list[Tensor]:
        """Rendered − observed (3xHxW, linear light) of each picture; NaN where the distance is not
        known or a value was clipped.
        """
        return [difference for _, difference in self._formed()]

    def _formed(self, most: int | None = None) -> list[tuple[Tensor, Tensor]]:
        """Rendered picture and residual of at most so many pairs."""
        if not self.pairs:
            raise ValueError("a fit read from a file has no pictures: fit them again to see these")
        medium, found = self.medium, []
        for pair, gain in zip(self.pairs[:most], self.gains[:most], strict=True):
            light = form_image(pair.clean.float(), pair.z.float(), medium).image
            picture = gain.reshape(3, 1, 1).float() * light
            difference = picture - pair.observed.float()
            found.append((picture, torch.where(pair.usable, difference, torch.nan)))
        return found

    def summary(self) -> str:
        """The fit as text: verdict, parameters, candidates, strong correlations."""
        parts = [self.message, "", table(self.parameters)]
        if len(self.candidates) > 1:
            parts += [
                "",
                f"  {'model':22}{'numbers':>8}{'held-out error':>16}{'behind the best':>18}",
            ]
            for one in self.candidates:
                mark = "*" if one.name == self.structure.name else " "
                behind = (
                    f"{one.behind:10.4g} ± {one.behind_error:.2g}" if one.behind else "      best"
                )
                parts.append(f"{mark} {one.name:22}{one.numbers:8}{one.error:16.4f}   {behind}")
        strong = self._strong()
        if strong:
            parts += ["", "  correlations above .9: " + ", ".join(strong)]
        return "\n".join(parts)

    def _strong(self) -> list[str]:
        names, matrix = self.correlation
        found = []
        for i, j in zip(*np.triu_indices(len(names), 1), strict=True):
            if abs(matrix[i, j]) > 0.9 and _kin(names[i], names[j]):
                found.append(f"{names[i]}–{names[j]} {matrix[i, j]:+.2f}")
        return found

    def plot(self) -> "Figure":
        """Observed, rendered and residual pictures, and the curves with their bands."""
        from uwaug.fitting.drawing import draw

        return draw(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the fit as JSON, whole or not at all. Pictures are not part of it."""
        structure = self.structure
        own = {
            "correlation": {
                "names": self.correlation.names,
                "matrix": self.correlation.matrix.tolist(),
            },
            "history": self.history,
            "structure": {
                "geometry": structure.geometry._asdict(),
                "gain": structure.gain,
                "g": structure.g,
                "fixed": dict(structure.fixed),
            },
        }
        saved.write(path, saved.FIT, {**saved.packed(self), **own})

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "Fit":
        """Read a fit that `save` wrote.

        Raises:
            ValueError: if the file is no fit, or one of a newer version; names it.
            OSError: if it cannot be read.
        """
        return saved.read(path, saved.FIT, _from_json)

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        shown = []
        for name in ("beta_red", "beta_green", "beta_blue"):
            value = self.parameters[name].value
            shown.append("?" if value is None else f"{value:.3g}")
        return f"Fit({self.model!r}, β = {', '.join(shown)} /{self.structure.geometry.unit})"


def _from_json(values: Mapping[str, Any]) -> Fit:
    made = values["structure"]
    structure = OneWater(
        model=MODELS[values["model"]],
        geometry=Geometry(**made["geometry"]),
        gain=made["gain"],
        g=float(made["g"]),
        fixed=made["fixed"],
    )
    checks.one_of("gain", structure.gain, get_args(Gain))
    correlation = values["correlation"]
    return Fit(
        **saved.unpacked(values, structure),
        correlation=Correlation(correlation["names"], np.array(correlation["matrix"])),
        history=values["history"],
    )


def _medium(structure: OneWater, theta: Tensor) -> Medium:
    natural = structure.natural(theta)
    # any pair, as all are of one water
    one = [None if value is None else value[:1] for value in natural]
    b = (natural.beta[:1] - natural.G[:1]) / (1 - structure.g)
    return media_of(Natural(*one), b.mean(1), structure.shape, structure.geometry)  # type: ignore[arg-type]


def _kin(one: str, other: str) -> bool:
    """Whether a correlation tells something: not that of numbers which follow from each other."""
    derived = ("a_", "b_", "source_")
    return not one.startswith(derived) and not other.startswith(derived)
