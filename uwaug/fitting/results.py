"""What fits return: numbers with their errors, in words, as media, as files and as pictures."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Self, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.atomic import require_regular, written_whole
from uwaug._support.types import Array
from uwaug.fitting.data import Geometry, Pair
from uwaug.fitting.models import (
    COLOURS,
    EXPONENTS,
    MODELS,
    CoefficientModel,
    Gain,
    Model,
    Scattering,
    SpectralModel,
    TurbidityModel,
)
from uwaug.fitting.noise import Noise
from uwaug.formation.model import form_image
from uwaug.formation.underwater import Underwater
from uwaug.optics.camera import Camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water

if TYPE_CHECKING:
    from matplotlib.figure import Figure

State = Literal["free", "at bound", "not identified", "fixed"]

_FORMAT = 1

_NEAREST, _FARTHEST = 0.2, 1.5
"""Of the median distance and of the farthest: what a fit's module is planned for."""


@dataclass(frozen=True)
class Parameter:
    """A number that a fit reports.

    Attributes:
        value: None if it is not identified.
        error: standard error; None if there is none: not identified, fixed, or at a bound.
        low, high: ends of the 95 % interval; None as the error, but at a bound known.
        unit: "1/m", "m", "px" or "1".
        state: "free"; "at bound": at the least or largest value that it may have; "not
            identified": the pictures do not tell; "fixed": it was given.
    """

    value: float | None
    error: float | None
    low: float | None
    high: float | None
    unit: str
    state: State


@dataclass(frozen=True)
class Candidate:
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


@dataclass(frozen=True)
class JerlovType(Candidate):
    """A type, or a mixture of two such as "II + III", that was tried.

    Attributes:
        visibility: of what was fitted, m.
        vertical_depth: m.
    """

    visibility: float
    vertical_depth: float

    @property
    def told_apart(self) -> bool:
        """Whether it lies more than one standard error behind."""
        return self.behind > self.behind_error


class Correlation(NamedTuple):
    """Of the parameters that have a standard error.

    Attributes:
        names: of rows and columns.
        matrix: −1…1.
    """

    names: list[str]
    matrix: Array


class Line(NamedTuple):
    """b = b₀ + k·turbidity, in one colour, by generalised least squares.

    Attributes:
        b0, b0_error: scattering at turbidity 0 and its standard error, 1/m.
        k, k_error: its growth with turbidity, 1/m for each unit.
        correlation: of the two.
        probability: of a misfit at least as large if b lay on a line; None with two levels.
    """

    b0: float
    b0_error: float
    k: float
    k_error: float
    correlation: float
    probability: float | None

    def error_at(self, turbidity: Array) -> Array:
        """The standard error of the line, 1/m."""
        both = 2 * self.correlation * self.b0_error * self.k_error * turbidity
        return np.asarray(np.sqrt(self.b0_error**2 + both + (self.k_error * turbidity) ** 2))


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """What all fits have in common.

    Attributes:
        parameters: each number by name: value, standard error, 95 % interval, unit, state.
        candidates: the models that were tried.
        message: in words: what was found, how well it explains the pictures, what they cannot tell.
        noise: of the observed pictures; None if it was not looked at.
        rms: of the residual, in linear light.
        theta, covariance: the numbers as they were fitted.
    """

    parameters: dict[str, Parameter]
    candidates: tuple[Candidate, ...]
    message: str
    noise: Noise | None
    rms: float
    theta: Array
    covariance: Array

    KEY: ClassVar[str]
    """That only files of this kind have; its value is the format."""

    NOUN: ClassVar[str]
    """What a file of this kind holds, with its article."""

    @property
    def errors(self) -> dict[str, float]:
        """The standard errors that are known, by name."""
        rows = self.parameters.items()
        return {name: number.error for name, number in rows if number.error is not None}

    @property
    def chosen(self) -> str:
        """The name of the candidate that was taken."""
        return ""

    def _lines(self) -> list[str]:
        """What stands in the summary between message and parameters."""
        return []

    def _remarks(self) -> list[str]:
        """What stands at the end of the summary."""
        return []

    def summary(self) -> str:
        """The result as text: message, parameters, candidates."""
        parts = [self.message, "", *self._lines()]
        parts.append(f"  {'':14}{'value':>10}{'std. error':>12}{'95 % interval':>22}  unit")
        for name, number in self.parameters.items():
            if number.value is None:
                parts.append(f"  {name:14}{'not identified':>22}")
                continue
            error = "" if number.error is None else f"{number.error:.2g}"
            interval = "" if number.low is None else f"{number.low:.4g} … {number.high:.4g}"
            state = "" if number.state == "free" else f"  ({number.state})"
            row = f"{number.value:>10.4g}{error:>12}{interval:>22}  {number.unit}{state}"
            parts.append(f"  {name:14}{row}")
        if len(self.candidates) > 1:
            head = f"{'numbers':>8}{'held-out error':>16}{'behind the best':>18}"
            parts += ["", f"  {'model':22}{head}"]
            for tried in self.candidates:
                mark = "*" if tried.name == self.chosen else " "
                behind = f"{tried.behind:10.4g} ± {tried.behind_error:.2g}"
                behind = behind if tried.behind else "      best"
                if isinstance(tried, JerlovType):
                    seen = f"{tried.visibility:.4g} m at {tried.vertical_depth:.3g} m"
                    behind = f"{behind:22} visibility {seen}"
                    behind += "" if tried.told_apart or not tried.behind else ", not told apart"
                parts.append(
                    f"{mark} {tried.name:22}{tried.numbers:8}{tried.error:16.4f}   {behind}"
                )
        return "\n".join([*parts, *self._remarks()])

    def __str__(self) -> str:
        return self.summary()

    def _drawn(self, count: int, generator: torch.Generator | None) -> Array:
        """Draw θ (count x n) from its normal distribution."""
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        normal = torch.randn(count, len(values), generator=generator, dtype=torch.float64)
        return np.asarray(self.theta + normal.numpy() @ root.T)

    def plot(self) -> "Figure":
        """Draw the result; needs matplotlib."""
        from uwaug.fitting.plot import plot

        return plot(self)

    def _to_dict(self) -> dict[str, Any]:
        """What this kind of result has beside what all have."""
        raise NotImplementedError

    @classmethod
    def _from_dict(cls, values: Mapping[str, Any], common: dict[str, Any]) -> Self:
        """A result of a file's values; `common` are the attributes that all have."""
        raise NotImplementedError

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result as JSON, whole or not at all. Pictures are not part of it."""
        from importlib.metadata import version

        values = {
            self.KEY: _FORMAT,
            "uwaug": version("uwaug"),
            "message": self.message,
            "parameters": {name: asdict(number) for name, number in self.parameters.items()},
            "candidates": [asdict(tried) for tried in self.candidates],
            "noise": None if self.noise is None else asdict(self.noise),
            "rms": self.rms,
            "theta": self.theta.tolist(),
            "covariance": self.covariance.tolist(),
            **self._to_dict(),
        }
        with written_whole(path) as part:
            part.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a result that `save` wrote.

        Raises:
            ValueError: if the file is of another kind, or of a newer version; names it.
            OSError: if it cannot be read.
        """
        require_regular(path)
        try:
            values = json.loads(Path(path).read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{path}: not {cls.NOUN}: {error}") from None
        values = values if isinstance(values, dict) else {}
        if cls.KEY not in values:
            expected = f"expected a file written by {cls.__name__}.save"
            for other in (Fit, SeriesFit, WaterFit, VeilFit):
                if other.KEY in values:
                    expected = f"it holds {other.NOUN}, see {other.__name__}.load"
            raise ValueError(f"{path}: not {cls.NOUN}: {expected}")
        if values[cls.KEY] != _FORMAT:
            formats = f"expected format {_FORMAT}, got {values[cls.KEY]!r}"
            raise ValueError(f"{path}: {formats}, written by uwaug {values.get('uwaug')}")
        try:
            common = {
                "message": values["message"],
                "parameters": {name: Parameter(**x) for name, x in values["parameters"].items()},
                "candidates": tuple(_candidate(x) for x in values["candidates"]),
                "noise": None if values["noise"] is None else Noise(**values["noise"]),
                "rms": values["rms"],
                "theta": np.array(values["theta"]),
                "covariance": np.array(values["covariance"]),
            }
            return cls._from_dict(values, common)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise ValueError(f"{path}: not {cls.NOUN}: {type(error).__name__}: {error}") from None


def _candidate(values: Mapping[str, Any]) -> Candidate:
    return (JerlovType if "visibility" in values else Candidate)(**values)


def _require_numbers(result: Result, model: Model) -> None:
    """Refuse numbers that cannot be a model's own."""
    bounds, theta = model.bounds.values(), result.theta
    n = len(bounds)
    if theta.shape != (n,) or result.covariance.shape != (n, n):
        raise ValueError(f"theta and covariance must hold {n} numbers, got {theta.shape}")
    low, high = np.array([[bound.low, bound.high] for bound in bounds]).T
    if not ((theta >= low) & (theta <= high)).all() or not np.isfinite(result.covariance).all():
        raise ValueError("theta must lie within its bounds, and covariance be finite")


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Result):
    """A water that was recovered from pictures; made by `uwaug.fit`, or read by `Fit.load`.

    Attributes:
        parameters: each number by name: value, standard error, 95 % interval, unit, state. beta, G,
            a and b of each colour [1/m]; veil, V(0); source, the growth of the veil at the lens,
            G·V(0) [1/m]; width, σ at the median distance [px], and exponent of the width law; gain.
        candidates, message, noise, rms, theta, covariance: as of `Result`.
        fitted: the model that was chosen, which makes pictures of `theta`.
        history: the cost after each evaluation of that model.
        pairs: what it was fitted to; none, if it was read from a file.
    """

    fitted: CoefficientModel
    history: list[float]
    pairs: tuple[Pair, ...] = field(default=(), repr=False)

    KEY = "uwaug_fit"
    NOUN = "a fit"

    @property
    def model(self) -> str:
        """The name of the model that was chosen."""
        return self.fitted.spec.name

    @property
    def chosen(self) -> str:
        """The name of the candidate that was taken: the model, with or without a gain."""
        return self.fitted.name

    @property
    def medium(self) -> Medium:
        """The water, as `uwaug.Underwater` and `uwaug.form_image` take it: a batch of one."""
        c = self.fitted.coefficients(torch.from_numpy(self.theta))
        # any pair, as all are of one water
        first = c._replace(**{k: x[:1] for k, x in c._asdict().items() if x is not None})
        return self.fitted.media(first)

    def module(self, sides: tuple[int, int] | None = None) -> Underwater:
        """The water as a module for the distances that it was fitted to, and some more: from .2
        times their median to 1.5 times the farthest, with the exposure of the clean picture.

        Args:
            sides: smallest and largest short side that it serves, px, as of `uwaug.Underwater`.
        """
        geometry = self.fitted.geometry
        distances = (_NEAREST * geometry.reference, _FARTHEST * geometry.farthest)
        return Underwater(self.medium, distances, sides=sides)

    @property
    def gains(self) -> Tensor:
        """The exposure of each observed picture (Px3)."""
        return self.fitted.coefficients(torch.from_numpy(self.theta)).gain

    @property
    def correlation(self) -> Correlation:
        """The correlations of the quantities that have an error."""
        slopes = self.fitted.report_jacobian(self.theta)
        covariance = slopes @ self.covariance @ slopes.T
        error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        known = np.flatnonzero(error > 0)
        matrix = covariance[np.ix_(known, known)] / np.outer(error[known], error[known])
        return Correlation([self.fitted.quantities[i].name for i in known], matrix)

    def sample(self, count: int, generator: torch.Generator | None = None) -> Medium:
        """A batch of waters that the pictures allow: drawn from the normal distribution of what
        pictures depend on, as far as a water can be so.

        Args:
            count: how many.
            generator: source of randomness; torch's global generator if None.
        """
        if not isinstance(count, (int, np.integer)) or isinstance(count, bool) or count < 1:
            raise ValueError(f"count must be a whole number ≥ 1, got {count!r}")
        model = self.fitted

        def flat(theta: Tensor) -> Tensor:
            return model.coefficients(theta).stacked()[:, 0].flatten()

        # of θ a sample would be none of the fit's: where β is hardly known and G well, G/β and β
        # make up for each other, and no longer do where one of them meets its bound
        theta = torch.from_numpy(self.theta)
        slopes = torch.func.jacrev(flat)(theta)
        covariance = slopes @ torch.from_numpy(self.covariance) @ slopes.T
        values, vectors = torch.linalg.eigh(covariance)
        root = vectors * values.clamp(min=0.0).sqrt()
        normal = torch.randn(int(count), root.shape[1], generator=generator, dtype=torch.float64)
        drawn = (flat(theta) + normal @ root.T).clamp(min=0.0).reshape(int(count), 6, 3)
        beta, G, veil_slope, width, exponent, _ = drawn.unbind(1)
        if model.shape is not None or model.spec.veil == "shared":
            G = G.minimum(beta)
        forward = model.shape is not None
        c = model.coefficients(theta)._replace(
            beta=beta,
            G=G,
            veil_slope=veil_slope,
            width=width[:, 0] if forward else None,
            exponent=exponent[:, 0].clamp(min=EXPONENTS[0]) if forward else None,
        )
        return model.media(c)

    @property
    def rendered(self) -> list[Tensor]:
        """Each observed picture (3xHxW, linear light) as the fitted water makes it."""
        return [picture for picture, _ in self.formed()]

    @property
    def residual(self) -> list[Tensor]:
        """Rendered − observed (3xHxW, linear light) of each picture; NaN where the distance is not
        known or a value was clipped.
        """
        return [difference for _, difference in self.formed()]

    def formed(self, most: int | None = None) -> list[tuple[Tensor, Tensor]]:
        """Rendered picture and residual, as `rendered` and `residual`, of at most so many pairs."""
        if not self.pairs:
            raise ValueError("a fit read from a file has no pictures: fit them again to see these")
        medium, rows = self.medium, []
        for pair, gain in zip(self.pairs[:most], self.gains[:most], strict=True):
            light = form_image(pair.clean.float(), pair.z.float(), medium).image
            picture = gain.reshape(3, 1, 1).float() * light
            difference = picture - pair.observed.float()
            rows.append((picture, torch.where(pair.usable, difference, torch.nan)))
        return rows

    def _remarks(self) -> list[str]:
        # not of numbers which follow from each other
        derived = ("a_", "b_", "source_")
        names, matrix = self.correlation
        strong = [
            f"{names[i]}–{names[j]} {matrix[i, j]:+.2f}"
            for i, j in zip(*np.triu_indices(len(names), 1), strict=True)
            if abs(matrix[i, j]) > 0.9
            and not (names[i] + " " + names[j]).startswith(derived)
            and not names[j].startswith(derived)
        ]
        return ["", "  correlations above .9: " + ", ".join(strong)] if strong else []

    def _to_dict(self) -> dict[str, Any]:
        model = self.fitted
        return {
            "model": self.model,
            "history": self.history,
            "structure": {
                "geometry": model.geometry._asdict(),
                "gain": model.gain,
                "g": model.g,
                "fixed": dict(model.fixed),
            },
        }

    @classmethod
    def _from_dict(cls, values: Mapping[str, Any], common: dict[str, Any]) -> "Fit":
        stored = values["structure"]
        checks.one_of("gain", stored["gain"], get_args(Gain))
        model = CoefficientModel(
            spec=MODELS[values["model"]],
            geometry=Geometry(**stored["geometry"]),
            gain=stored["gain"],
            g=float(stored["g"]),
            fixed=stored["fixed"],
        )
        fit = Fit(**common, fitted=model, history=values["history"])
        _require_numbers(fit, model)
        return fit

    def __repr__(self) -> str:
        beta = [self.parameters[f"beta_{colour}"].value for colour in COLOURS]
        shown = ", ".join("?" if value is None else f"{value:.3g}" for value in beta)
        return f"Fit({self.model!r}, β = {shown} /{self.fitted.geometry.unit})"


@dataclass(frozen=True, eq=False, repr=False)
class SeriesFit(Result):
    """A series of turbidities; made by `uwaug.fitting.fit_series`, or read by `SeriesFit.load`.

    Attributes:
        parameters: each number by name, as of `Fit`: a of each colour; b of each colour and level,
            such as b_red_1; m, veil for each unit of scattering, G·V(0)/b; g; scale and exponent of
            the width law.
        candidates, message, noise, rms, theta, covariance: as of `Result`.
        fitted: the model that was chosen, which makes pictures of `theta`.
        levels: the turbidities, ascending.
        unit: of the turbidities.
        lines: b₀ + k·turbidity, by colour.
    """

    fitted: TurbidityModel
    levels: tuple[float, ...]
    unit: str
    lines: dict[str, Line]

    KEY = "uwaug_series"
    NOUN = "a series"

    @property
    def model(self) -> str:
        """The name of the model that was chosen."""
        return self.fitted.name

    @property
    def chosen(self) -> str:
        """The name of the candidate that was taken."""
        return self.fitted.name

    @property
    def media(self) -> Medium:
        """The water of each level: a batch."""
        theta = torch.from_numpy(self.theta)
        return self.fitted.media(theta, self.fitted.scattering(theta))

    def medium(self, turbidity: float) -> Medium:
        """The water at a turbidity, by the line: a batch of one.

        Args:
            turbidity: ≥ 0, in the unit of the series.
        """
        checks.within("turbidity", turbidity, 0.0)
        b = [max(line.b0 + line.k * turbidity, 0.0) for line in self.lines.values()]
        theta = torch.from_numpy(self.theta)
        return self.fitted.media(theta, torch.tensor([b], dtype=torch.float64))

    def _lines(self) -> list[str]:
        head = f"  {'':14}{'b₀ [1/m]':>18}{f'k [1/m per {self.unit}]':>24}{'on a line':>12}"
        parts = [head]
        for colour, line in self.lines.items():
            b0, k = f"{line.b0:.4g} ± {line.b0_error:.2g}", f"{line.k:.4g} ± {line.k_error:.2g}"
            odds = "" if line.probability is None else f"p = {line.probability:.2g}"
            parts.append(f"  {colour:14}{b0:>18}{k:>24}{odds:>12}")
        return [*parts, ""]

    def _to_dict(self) -> dict[str, Any]:
        model = self.fitted
        return {
            "model": self.model,
            "levels": self.levels,
            "unit": self.unit,
            "lines": {colour: line._asdict() for colour, line in self.lines.items()},
            "structure": {
                "name": model.name,
                "shape": model.shape,
                "geometry": model.geometry._asdict(),
                "level": model.level,
                "levels": model.levels,
            },
        }

    @classmethod
    def _from_dict(cls, values: Mapping[str, Any], common: dict[str, Any]) -> "SeriesFit":
        stored = values["structure"]
        model = TurbidityModel(
            spec=MODELS[stored["name"]],
            geometry=Geometry(**stored["geometry"]),
            level=tuple(stored["level"]),
            levels=stored["levels"],
        )
        series = SeriesFit(
            **common,
            fitted=model,
            levels=tuple(values["levels"]),
            unit=values["unit"],
            lines={colour: Line(**line) for colour, line in values["lines"].items()},
        )
        _require_numbers(series, model)
        return series

    def __repr__(self) -> str:
        return f"SeriesFit({self.model!r}, {len(self.levels)} turbidities, {self.unit})"


@dataclass(frozen=True, eq=False, repr=False)
class WaterFit(Result):
    """The Jerlov water that was recovered from pictures; made by `uwaug.fitting.fit_water`, or read
    by `WaterFit.load`.

    Attributes:
        parameters: each number by name, as of `Fit`: visibility [m]; contents, the factor of
            `Water.with_contents`; mixing, the share of the second type, 0…1; vertical_depth [m];
            gain_1, …, the exposure of each observed picture.
        candidates: the ten types and those mixtures that are neither of their ends, best first.
        message, noise, rms, theta, covariance: as of `Result`.
        fitted: the model that was chosen, which makes pictures of `theta`.
    """

    candidates: tuple[JerlovType, ...]
    fitted: SpectralModel

    KEY = "uwaug_water"
    NOUN = "a water"

    @property
    def type(self) -> str:
        """The Jerlov type, such as "3C"; a mixture of neighbours, as "II + III"."""
        return self.fitted.name

    @property
    def chosen(self) -> str:
        """The name of the candidate that was taken."""
        return self.fitted.name

    @property
    def types(self) -> tuple[JerlovType, ...]:
        """The candidates."""
        return self.candidates

    @property
    def water(self) -> Water:
        """Spectra with as much in them as was found, as `uwaug.RandomUnderwater` takes them:
        `RandomUnderwater(waters=[fit.water])`.
        """
        return self.fitted.water(self.theta)

    @property
    def medium(self) -> Medium:
        """The water with camera, depth, g, μ and width law, as `uwaug.Underwater` takes it."""
        return self.fitted.medium(self.theta, tolerance=0.002)

    def sample(self, count: int, generator: torch.Generator | None = None) -> Medium:
        """A batch of waters that the pictures allow: θ drawn from its normal distribution, within
        its bounds.

        Args:
            count: how many.
            generator: source of randomness; torch's global generator if None.
        """
        low, high = np.array([[x.low, x.high] for x in self.fitted.bounds.values()]).T
        drawn = np.clip(self._drawn(count, generator), low, high)
        return Medium.stack([self.fitted.medium(theta) for theta in drawn])

    @property
    def visibility(self) -> float | None:
        """As `Water.visibility` [m]; None if the pictures do not tell."""
        return self.parameters["visibility"].value

    @property
    def vertical_depth(self) -> float | None:
        """Below the surface [m]; None if the pictures do not tell."""
        return self.parameters["vertical_depth"].value

    @property
    def mixing(self) -> float | None:
        """The share of the second type, 0…1; None of a single type."""
        return self.parameters["mixing"].value if "mixing" in self.parameters else None

    @property
    def gain(self) -> tuple[float | None, ...]:
        """The exposure of each observed picture, as multiples of the clean one's; empty if it was
        not fitted.
        """
        rows = self.parameters.items()
        return tuple(number.value for name, number in rows if name.startswith("gain"))

    def _to_dict(self) -> dict[str, Any]:
        model = self.fitted
        law = model.scattering.law
        return {
            "model": {
                "waters": [water.name for water in model.waters],
                "camera": {
                    "name": model.camera.name,
                    "wavelengths": model.camera.wavelengths.tolist(),
                    "response": model.camera.response.tolist(),
                },
                "point_spread": {
                    "scale": float(law.scale),
                    "exponent": float(law.exponent),
                    "shape": law.shape,
                    "reference_size": law.reference_size,
                },
                "g": model.scattering.g,
                "mu": model.scattering.mu,
                "depth": model.depth,
                "sizes": model.sizes,
                "geometry": model.geometry._asdict(),
                "gain": model.gain,
            }
        }

    @classmethod
    def _from_dict(cls, values: Mapping[str, Any], common: dict[str, Any]) -> "WaterFit":
        stored = values["model"]
        camera, law = stored["camera"], PointSpread(**stored["point_spread"])
        model = SpectralModel(
            waters=tuple(Water.jerlov(name) for name in stored["waters"]),
            camera=Camera(camera["wavelengths"], camera["response"], camera["name"]),
            scattering=Scattering(law, stored["g"], stored["mu"]),
            depth=stored["depth"],
            sizes=tuple((height, width) for height, width in stored["sizes"]),
            geometry=Geometry(**stored["geometry"]),
            gain=stored["gain"],
        )
        water = WaterFit(**common, fitted=model)
        _require_numbers(water, model)
        return water

    def __repr__(self) -> str:
        seen = "?" if self.visibility is None else f"{self.visibility:.3g}"
        return f"WaterFit({self.type!r}, visibility {seen} m)"


@dataclass(frozen=True, eq=False, repr=False)
class VeilFit(Result):
    """A veil that was estimated from pictures alone; made by `uwaug.fitting.fit_veil`, or read by
    `VeilFit.load`.

    Attributes:
        parameters: each number by name, as of `Fit`: veil, V(0); G [1/m]; source, the growth of the
            veil at the lens, G·V(0) [1/m]; of each colour.
        message, rms: as of `Result`; `rms` is that of the dark pixels about their veil.
        theta, covariance: source and G of each colour.
        farthest: distance that the veil is seen to, m; infinity if there is open water.
    """

    farthest: float

    KEY = "uwaug_veil"
    NOUN = "a veil"

    @property
    def medium(self) -> Medium:
        """The veil as a water. That the direct light fades as the veil does, β = G, is assumed:
        pictures without a clean one do not tell.
        """
        return _veil_medium(self.theta.reshape(1, 3, 2))

    def sample(self, count: int, generator: torch.Generator | None = None) -> Medium:
        """A batch of veils that the pictures allow: drawn from the normal distribution of what was
        fitted.

        Args:
            count: how many.
            generator: source of randomness; torch's global generator if None.
        """
        drawn = np.maximum(self._drawn(count, generator), 1e-3 * self.theta)
        return _veil_medium(drawn.reshape(count, 3, 2))

    @property
    def veil(self) -> Tensor:
        """V(0) of each channel (3); NaN where it is not identified."""
        return self._values("veil")

    @property
    def G(self) -> Tensor:
        """Of each channel (3), 1/m; NaN where it is not identified."""
        return self._values("G")

    @property
    def source(self) -> Tensor:
        """Growth of the veil at the lens, of each channel (3), 1/m."""
        return self._values("source")

    def _values(self, kind: str) -> Tensor:
        values = [self.parameters[f"{kind}_{colour}"].value for colour in COLOURS]
        known = [np.nan if value is None else value for value in values]
        return torch.tensor(known, dtype=torch.float64)

    def backscatter(self, z: Tensor) -> Tensor:
        """The veil in front of points at these distances, m; shapes as of `Medium.backscatter`.

        It is known where V(0) and G are not, as far as `farthest`.
        """
        return self.medium.backscatter(z)

    def _to_dict(self) -> dict[str, Any]:
        return {"farthest": self.farthest}

    @classmethod
    def _from_dict(cls, values: Mapping[str, Any], common: dict[str, Any]) -> "VeilFit":
        if common["theta"].shape != (6,) or common["covariance"].shape != (6, 6):
            raise ValueError("theta and covariance must hold 6 numbers")
        return VeilFit(**common, farthest=float(values["farthest"]))

    def __repr__(self) -> str:
        shown = ", ".join("?" if x.isnan() else f"{float(x):.3g}" for x in self.veil)
        return f"VeilFit(V(0) = {shown})"


def _veil_medium(numbers: Array) -> Medium:
    """Media of source and G of each colour (Bx3x2)."""
    source, G = torch.from_numpy(numbers).unbind(-1)
    return Medium.from_coefficients(G, G, source / G)
