"""`Fit`: a water that was recovered from pictures."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug import checks
from uwaug.files import require_regular, written_whole
from uwaug.fitting.media import media_of
from uwaug.fitting.model import KINDS, Natural
from uwaug.fitting.noise import Noise
from uwaug.fitting.one_water import OneWater
from uwaug.fitting.pixels import Pair
from uwaug.fitting.report import Parameter, table
from uwaug.fitting.solve import stacked
from uwaug.fitting.structure import MODELS, Gain, Geometry
from uwaug.formation import form_image
from uwaug.optics.medium import Medium
from uwaug.optics.spectra import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Candidate", "Correlation", "Fit"]

_FORMAT = 1

_FLATTEST = 0.2
"""Exponent of a width law, at least."""


class Candidate(NamedTuple):
    """A model that was tried.

    Attributes:
        name: of the model.
        numbers: how many were fitted.
        error: root of the mean held-out loss, in standard deviations of the noise.
        behind: how far the summed held-out loss lies behind the best.
        behind_error: standard error of that.
    """

    name: str
    numbers: int
    error: float
    behind: float
    behind_error: float


class Correlation(NamedTuple):
    """Of the parameters that have a standard error.

    Attributes:
        names: of rows and columns.
        matrix: −1…1.
    """

    names: list[str]
    matrix: Array


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
        pictures = []
        for pair, gain in zip(self._pairs(), self.gains, strict=True):
            light = form_image(pair.clean.float(), pair.z.float(), self.medium).image
            pictures.append(gain.reshape(3, 1, 1).float() * light)
        return pictures

    @property
    def residual(self) -> list[Tensor]:
        """Rendered − observed (3xHxW, linear light) of each picture; NaN where the distance is not
        known or a value was clipped.
        """
        found = []
        for pair, picture in zip(self._pairs(), self.rendered, strict=True):
            difference = picture - pair.observed.float()
            found.append(torch.where(pair.usable, difference, torch.nan))
        return found

    def _pairs(self) -> tuple[Pair, ...]:
        if not self.pairs:
            raise ValueError("a fit read from a file has no pictures: fit them again to see these")
        return self.pairs

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
        with written_whole(path) as part:
            part.write_text(json.dumps(self._as_json(), indent=1) + "\n", encoding="utf-8")

    def _as_json(self) -> dict[str, Any]:
        from uwaug import __version__

        structure = self.structure
        return {
            "uwaug_fit": _FORMAT,
            "uwaug": __version__,
            "model": self.model,
            "message": self.message,
            "parameters": {name: asdict(one) for name, one in self.parameters.items()},
            "correlation": {
                "names": self.correlation.names,
                "matrix": self.correlation.matrix.tolist(),
            },
            "candidates": [one._asdict() for one in self.candidates],
            "noise": asdict(self.noise),
            "rms": self.rms,
            "history": self.history,
            "structure": {
                "geometry": structure.geometry._asdict(),
                "gain": structure.gain,
                "g": structure.g,
                "fixed": dict(structure.fixed),
            },
            "theta": self.theta.tolist(),
            "covariance": self.covariance.tolist(),
        }

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "Fit":
        """Read a fit that `save` wrote.

        Raises:
            ValueError: if the file is no fit, or one of a newer version; names it.
            OSError: if it cannot be read.
        """
        require_regular(path)
        try:
            values = json.loads(Path(path).read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{path}: not a fit: {error}") from None
        if isinstance(values, dict) and "uwaug_series" in values:
            raise ValueError(f"{path}: a series of turbidities, see SeriesFit.load")
        if not isinstance(values, dict) or "uwaug_fit" not in values:
            raise ValueError(f"{path}: not a fit: expected a file written by Fit.save")
        if values["uwaug_fit"] != _FORMAT:
            got = f"format {values['uwaug_fit']!r}, written by uwaug {values.get('uwaug')}"
            raise ValueError(f"{path}: expected a fit of format {_FORMAT}, got {got}")
        try:
            return _from_json(values)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise ValueError(f"{path}: not a fit: {type(error).__name__}: {error}") from None

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
    theta, covariance = np.array(values["theta"]), np.array(values["covariance"])
    n = len(structure.bounds)
    if theta.shape != (n,) or covariance.shape != (n, n):
        raise ValueError(f"theta and covariance must hold {n} numbers, got {theta.shape}")
    low = np.array([one.low for one in structure.bounds.values()])
    high = np.array([one.high for one in structure.bounds.values()])
    if not ((theta >= low) & (theta <= high)).all() or not np.isfinite(covariance).all():
        raise ValueError("theta must lie within its bounds, and covariance be finite")
    correlation = values["correlation"]
    return Fit(
        model=values["model"],
        parameters={name: Parameter(**one) for name, one in values["parameters"].items()},
        correlation=Correlation(correlation["names"], np.array(correlation["matrix"])),
        candidates=tuple(Candidate(**one) for one in values["candidates"]),
        message=values["message"],
        noise=Noise(**values["noise"]),
        rms=values["rms"],
        history=values["history"],
        structure=structure,
        theta=theta,
        covariance=covariance,
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
