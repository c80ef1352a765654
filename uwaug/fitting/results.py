"""What fits return: numbers with their errors, in words, as media, as files and as pictures."""

import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Self, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.atomic import require_regular, written_whole
from uwaug._support.types import Array
from uwaug.fitting.coefficients import as_taken
from uwaug.fitting.data import Geometry, Pair
from uwaug.fitting.models import (
    COLOURS,
    EXPONENTS,
    MODELS,
    CoefficientModel,
    Gain,
    SpectralModel,
    TurbidityModel,
)
from uwaug.fitting.noise import Noise
from uwaug.formation.model import form_image
from uwaug.formation.underwater import Underwater
from uwaug.optics.camera import Camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.scattering import Scattering
from uwaug.optics.water import Water

if TYPE_CHECKING:
    from matplotlib.figure import Figure

State = Literal["free", "at bound", "not identified", "fixed"]
_FORMAT = 1
_HEAD = 64  # bytes of a file, in which its first key stands
_CAMERA = ("wavelengths", "response", "name", "color_matrix")
# Of the median distance and of the farthest: what a fit's module is planned for.
_NEAREST, _FARTHEST = 0.2, 1.5
_MOST_DIGITS = 12  # of the ends of an interval
_MEANINGS = {
    "veil": "of white, V(0)",
    "source": "of white, G·V(0)",
    "gain": "times the exposure of clean",
    "vignette": "of the light, less in the corners",
    "down": "of the light, more at the lower edge",
    "right": "of the light, more at the right edge",
    "contents": "times those of the type",
    "mixing": "share of the second type",
}
"""What a number is, by its kind, where its name and unit do not say so."""


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


@dataclass(frozen=True)
class Line:
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
    """What all fits have in common. A file holds the attributes under their names.

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

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest value of each number of `theta`."""
        raise NotImplementedError

    @property
    def meanings(self) -> dict[str, str]:
        """What a number is, by its kind (its name up to "_"), where name and unit do not say so."""
        return _MEANINGS

    def summary(self) -> str:
        """The result as text: message, parameters, candidates."""
        rows = [["", "value", "std. error", "95 % interval", "unit"]]
        for name, number in self.parameters.items():
            value = "not identified" if number.value is None else f"{number.value:.4g}"
            error = "" if number.error is None else f"{number.error:.2g}"
            state = f"({number.state})" if number.state in ("at bound", "fixed") else ""
            meaning = self.meanings.get(name.partition("_")[0], "")
            unit = number.unit if number.unit != "1" or not meaning else ""
            last = (
                "  ".join(filter(None, (unit, meaning, state))) if number.value is not None else ""
            )
            rows.append([name, value, error, _interval(number), last])
        parts = [self.message, *_aligned(rows)]
        if len(self.candidates) > 1:
            # errors are in standard deviations of the noise, what lies behind in their squares
            rows = [["  model", "numbers", "held-out error [σ]", "behind the best [σ²]", ""]]
            for tried in self.candidates:
                mark = "*" if tried.name == self.chosen else " "
                behind = (
                    f"{tried.behind:.4g} ± {tried.behind_error:.2g}" if tried.behind else "best"
                )
                row = [f"{mark} {tried.name}", str(tried.numbers), f"{tried.error:.4f}", behind, ""]
                if isinstance(tried, JerlovType):
                    doubt = "" if tried.told_apart or not tried.behind else ", not told apart"
                    metres = f"{tried.visibility:.4g} m at {tried.vertical_depth:.3g} m"
                    row[-1] = f"visibility {metres}{doubt}"
                rows.append(row)
            parts += _aligned(rows)
        return "\n".join(parts)

    def __str__(self) -> str:
        return self.summary()

    def plot(self) -> "Figure":
        """Draw the result; needs matplotlib."""
        from uwaug.fitting.plot import plot

        return plot(self)

    def _structure(self) -> dict[str, Any]:
        """What of the fitted model is written: its attributes, as far as JSON can hold them."""
        return {}

    @classmethod
    def _fitted(cls, values: dict[str, Any]) -> dict[str, Any]:
        """The fitted model by its attribute's name, of what `_structure` wrote."""
        return {}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result as JSON, whole or not at all. Pictures are not part of it."""
        from importlib.metadata import version

        values = {self.KEY: _FORMAT, "uwaug": version("uwaug")}
        values |= {name: getattr(self, name) for name in self._written()}
        values |= self._structure()
        with written_whole(path) as part:
            part.write_text(json.dumps(values, default=_plain, indent=1) + "\n", encoding="utf-8")

    @classmethod
    def _written(cls) -> list[str]:
        """The attributes that are written under their own names."""
        return [entry.name for entry in fields(cls) if entry.name not in ("fitted", "pairs")]

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
            if values.get(cls.KEY) != _FORMAT:
                keys = [cls.KEY, *(kind.KEY for kind in (Fit, SeriesFit, WaterFit, VeilFit))]
                held = next((f"{key} {values[key]}" for key in keys if key in values), "none")
                raise ValueError(f"expected {cls.KEY} {_FORMAT}, got {held}")
            read = {name: _READERS.get(name, _as_it_is)(values[name]) for name in cls._written()}
            result = cls(**read, **cls._fitted(values))
            theta, covariance, (low, high) = result.theta, result.covariance, result.bounds
            if theta.shape != low.shape or covariance.shape != (len(low), len(low)):
                raise ValueError(f"theta and covariance must hold {len(low)} numbers")
            if not ((theta >= low) & (theta <= high)).all() or not np.isfinite(covariance).all():
                raise ValueError("theta must lie within its bounds, and covariance be finite")
        except (
            ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError
        ) as error:  # fmt: skip
            raise ValueError(f"{path}: not {cls.NOUN}: {type(error).__name__}: {error}") from None
        return result


def _plain(value: Any) -> Any:
    """A value that JSON does not know, as one that it knows."""
    return asdict(value) if is_dataclass(value) else value.tolist()  # type: ignore[arg-type]


def _as_it_is(value: Any) -> Any:
    return value


_READERS: dict[str, Callable[[Any], Any]] = {
    "parameters": lambda rows: {name: Parameter(**x) for name, x in rows.items()},
    "candidates": lambda rows: tuple(
        (JerlovType if "visibility" in x else Candidate)(**x) for x in rows
    ),
    "noise": lambda x: None if x is None else Noise(**x),
    "theta": np.array,
    "covariance": np.array,
    "levels": tuple,
    "lines": lambda rows: {colour: Line(**x) for colour, x in rows.items()},
    "farthest": float,
}
"""What makes an attribute of the value that JSON has for it, where the two differ."""


def _interval(number: Parameter) -> str:
    """Both ends, to as many digits as tell them apart."""
    if number.low is None or number.high is None:
        return ""
    for digits in range(4, _MOST_DIGITS):
        low, high = f"{number.low:.{digits}g}", f"{number.high:.{digits}g}"
        if low != high:
            break
    return f"{low} … {high}"


def _aligned(rows: list[list[str]]) -> list[str]:
    """A table in lines, below an empty one: words to the left, numbers to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [""]
    for first, *numbers, last in rows:
        cells = [cell.rjust(width) for cell, width in zip(numbers, widths[1:], strict=False)]
        lines.append("  ".join(["", first.ljust(widths[0]), *cells, last]).rstrip())
    return lines


def _drawn(
    mean: Tensor, covariance: Tensor, count: int, generator: torch.Generator | None
) -> Tensor:
    """Numbers (count x n) of a normal distribution."""
    if not isinstance(count, (int, np.integer)) or isinstance(count, bool) or count < 1:
        raise ValueError(f"count must be a whole number ≥ 1, got {count!r}")
    values, vectors = torch.linalg.eigh(covariance)
    root = vectors * values.clamp(min=0.0).sqrt()
    normal = torch.randn(int(count), len(mean), generator=generator, dtype=torch.float64)
    drawn: Tensor = mean + normal @ root.T
    return drawn


@dataclass(frozen=True, eq=False, repr=False)
class _ByModel(Result):
    """A result with a model that makes pictures of its numbers."""

    fitted: Any

    @property
    def chosen(self) -> str:
        """The name of the candidate that was taken."""
        return str(self.fitted.name)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest value of each number of `theta`."""
        low, high = np.array([(x.low, x.high) for x in self.fitted.bounds.values()]).T
        return low, high


class _OneWater(_ByModel):
    """A result that is one water."""

    pairs: tuple[Pair, ...]

    @property
    def medium(self) -> Medium:
        """As `uwaug.Underwater` takes it."""
        raise NotImplementedError

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
        for i, pair in enumerate(self.pairs[:most]):
            light = form_image(pair.clean.float(), pair.z.float(), medium).image
            picture = self._as_taken(light.double(), i).float()
            difference = picture - pair.observed.float()
            rows.append((picture, torch.where(pair.usable, difference, torch.nan)))
        return rows

    def _as_taken(self, light: Tensor, i: int) -> Tensor:
        """Light (3xHxW) as the camera of pair i has taken it."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False, repr=False)
class Fit(_OneWater):
    """A water that was recovered from pictures; made by `uwaug.fit`, or read by `Fit.load`.

    Attributes:
        parameters: each number by name: value, standard error, 95 % interval, unit, state. beta, G,
            a and b of each colour [1/m]; veil, V(0); source, the growth of the veil at the lens,
            G·V(0) [1/m]; width, σ at the median distance [px], and exponent of the width law.
            Of the camera: gain; vignette, down and right of its shading; tone and shoulder of its
            curve.
        fitted: the model that was chosen, which makes pictures of `theta`.
        history: the cost after each evaluation of that model.
        pairs: what it was fitted to; none, if it was read from a file.

    All else is as of `Result`.
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
    def medium(self) -> Medium:
        """The water, as `uwaug.Underwater` and `uwaug.form_image` take it: a batch of one."""
        # any pair, as all are of one water
        return self.fitted.media(self.fitted.coefficients(torch.from_numpy(self.theta)).at(0))

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
        places = np.flatnonzero(error > 0)
        matrix = covariance[np.ix_(places, places)] / np.outer(error[places], error[places])
        return Correlation([self.fitted.quantities[i].name for i in places], matrix)

    def sample(self, count: int, generator: torch.Generator | None = None) -> Medium:
        """A batch of waters that the pictures allow: drawn from the normal distribution of what
        pictures depend on, as far as a water can be so.

        Args:
            count: how many.
            generator: source of randomness; torch's global generator if None.
        """
        model = self.fitted

        def flat(theta: Tensor) -> Tensor:
            return model.coefficients(theta).stacked()[:, 0].flatten()

        # of θ a sample would be none of the fit's: where β is hardly known and G well, G/β and β
        # make up for each other, and no longer do where one of them meets its bound
        theta = torch.from_numpy(self.theta)
        slopes = torch.func.jacrev(flat)(theta)
        covariance = slopes @ torch.from_numpy(self.covariance) @ slopes.T
        drawn = _drawn(flat(theta), covariance, count, generator).clamp(min=0.0)
        beta, G, veil_slope, width, exponent, *_ = drawn.reshape(-1, 11, 3).unbind(1)
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

    def _as_taken(self, light: Tensor, i: int) -> Tensor:
        c = self.fitted.coefficients(torch.from_numpy(self.theta))
        return as_taken(light[None], c.at(i), self.pairs[i].position[None])[0]

    @property
    def meanings(self) -> dict[str, str]:
        """As of `Result`, and where widths are those of; without forward scatter, what fades."""
        meanings = {
            **_MEANINGS,
            "width": f"σ at {self._reference}",
            "exponent": "of σ over distance",
        }
        if self.fitted.spec.law is None:
            meanings["beta"] = "of direct and forward light together"
        return meanings

    @property
    def _reference(self) -> str:
        geometry = self.fitted.geometry
        return f"{geometry.reference:.3g} {geometry.unit}"

    def summary(self) -> str:
        """The result as text: message, parameters, candidates, what depends on what."""
        # not of numbers which follow from each other
        derived = ("a_", "b_", "source_")
        names, matrix = self.correlation
        strong = []
        for i, j in zip(*np.nonzero(np.triu(abs(matrix) > 0.9, 1)), strict=True):
            if not names[i].startswith(derived) and not names[j].startswith(derived):
                strong.append(f"{names[i]}–{names[j]} {matrix[i, j]:+.2f}")
        text = super().summary()
        return f"{text}\n\n  correlations above .9: {', '.join(strong)}" if strong else text

    def _structure(self) -> dict[str, Any]:
        x = self.fitted
        structure = {"geometry": x.geometry, "gain": x.gain, "g": x.g, "fixed": x.fixed}
        structure |= {name: True for name in ("shading", "tone") if getattr(x, name)}
        return {"model": self.model, "structure": structure}

    @classmethod
    def _fitted(cls, values: dict[str, Any]) -> dict[str, Any]:
        x = values["structure"]
        checks.one_of("gain", x["gain"], get_args(Gain))
        x["geometry"] = Geometry(**x["geometry"])
        return {"fitted": CoefficientModel(MODELS[values["model"]], **x)}

    def __repr__(self) -> str:
        beta = [self.parameters[f"beta_{colour}"].value for colour in COLOURS]
        shown = ", ".join("?" if value is None else f"{value:.3g}" for value in beta)
        return f"Fit({self.model!r}, β = {shown} /{self.fitted.geometry.unit})"


@dataclass(frozen=True, eq=False, repr=False)
class SeriesFit(_ByModel):
    """A series of turbidities; made by `uwaug.fitting.fit_series`, or read by `SeriesFit.load`.

    Attributes:
        parameters: each number by name, as of `Fit`: a of each colour; b of each colour and level,
            such as b_red_1; m, veil for each unit of scattering, G·V(0)/b; g; scale and exponent of
            the width law.
        fitted: the model that was chosen, which makes pictures of `theta`.
        levels: the turbidities, ascending.
        unit: of the turbidities.
        lines: b₀ + k·turbidity, by colour.

    All else is as of `Result`.
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

    def summary(self) -> str:
        """The result as text: message, parameters, candidates, lines."""
        rows = [["", "b₀ [1/m]", f"k [1/m per {self.unit}]", "on a line"]]
        for colour, line in self.lines.items():
            b0, k = f"{line.b0:.4g} ± {line.b0_error:.2g}", f"{line.k:.4g} ± {line.k_error:.2g}"
            odds = "" if line.probability is None else f"p = {line.probability:.2g}"
            rows.append([colour, b0, k, odds])
        return "\n".join([super().summary(), *_aligned(rows)])

    def _structure(self) -> dict[str, Any]:
        names = ("name", "shape", "level", "levels", "geometry")
        structure = {name: getattr(self.fitted, name) for name in names}
        return {"model": self.model, "structure": structure}

    @classmethod
    def _fitted(cls, values: dict[str, Any]) -> dict[str, Any]:
        x = values["structure"]
        spec, geometry = MODELS[x["name"]], Geometry(**x["geometry"])
        return {"fitted": TurbidityModel(spec, geometry, tuple(x["level"]), x["levels"])}

    def __repr__(self) -> str:
        return f"SeriesFit({self.model!r}, {len(self.levels)} turbidities, {self.unit})"


@dataclass(frozen=True, eq=False, repr=False)
class WaterFit(_OneWater):
    """The Jerlov water that was recovered from pictures; made by `uwaug.fitting.fit_water`, or read
    by `WaterFit.load`.

    Attributes:
        parameters: each number by name, as of `Fit`: visibility [m]; contents, the factor of
            `Water.with_contents`; mixing, the share of the second type, 0…1; vertical_depth [m];
            gain_1, …, the exposure of each observed picture.
        candidates: the ten types and those mixtures that are neither of their ends, best first.
        fitted: the model that was chosen, which makes pictures of `theta`.
        pairs: what it was fitted to; none, if it was read from a file.

    All else is as of `Result`.
    """

    candidates: tuple[JerlovType, ...]
    fitted: SpectralModel
    pairs: tuple[Pair, ...] = field(default=(), repr=False)

    KEY = "uwaug_water"
    NOUN = "a water"

    @property
    def type(self) -> str:
        """The Jerlov type, such as "3C"; a mixture of neighbours, as "II + III"."""
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
        """Draw waters that the pictures allow, as `Fit.sample`: θ from its normal distribution,
        within its bounds.
        """
        theta, covariance = torch.from_numpy(self.theta), torch.from_numpy(self.covariance)
        drawn = np.clip(_drawn(theta, covariance, count, generator).numpy(), *self.bounds)
        return Medium.stack([self.fitted.medium(numbers) for numbers in drawn])

    def _as_taken(self, light: Tensor, i: int) -> Tensor:
        pair, gains = self.pairs[i], self.fitted.gains(self.theta)[i : i + 1]
        flat, observed, weights = (
            x[None].flatten(2)[:, :, None] for x in (light, pair.observed, pair.usable.double())
        )
        return self.fitted.as_taken(flat, gains, observed, weights).view_as(light)

    @property
    def visibility(self) -> float | None:
        """As `Water.visibility` [m]; None if the pictures do not tell."""
        return self.parameters["visibility"].value

    @property
    def vertical_depth(self) -> float | None:
        """Below the surface [m]; None if the pictures do not tell."""
        return self.parameters["vertical_depth"].value

    def _structure(self) -> dict[str, Any]:
        x = self.fitted
        structure = {
            "waters": [water.name for water in x.waters],
            "camera": {name: getattr(x.camera, name) for name in _CAMERA},
            "surfaces": x.surfaces,
            "point_spread": x.point_spread,
            "geometry": x.geometry,
            "g": x.scattering.g,
            "mu": x.scattering.mu,
            "depth": x.depth,
            "sizes": x.sizes,
            "gain": x.gain,
        }
        return {"model": structure}

    @classmethod
    def _fitted(cls, values: dict[str, Any]) -> dict[str, Any]:
        x = values["model"]
        model = SpectralModel(
            waters=tuple(Water.jerlov(name) for name in x["waters"]),
            camera=Camera(**x["camera"]),
            surfaces=x.get("surfaces", "grey"),  # files of 0.1 do not say
            scattering=Scattering(x["g"], x["mu"]),
            point_spread=PointSpread(**x["point_spread"]),
            depth=x["depth"],
            sizes=tuple((height, width) for height, width in x["sizes"]),
            geometry=Geometry(**x["geometry"]),
            gain={False: "fixed", True: "free"}.get(x["gain"], x["gain"]),
        )
        return {"fitted": model}

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
        rms: of the dark pixels about their veil.
        theta, covariance: source and G of each colour.
        farthest: distance that the veil is seen to, m; infinity if there is open water.

    All else is as of `Result`; there are no candidates, and no noise.
    """

    farthest: float

    KEY = "uwaug_veil"
    NOUN = "a veil"

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest value of each number of `theta`."""
        return np.zeros(6), np.full(6, np.inf)

    @property
    def medium(self) -> Medium:
        """The veil as a water. That the direct light fades as the veil does, β = G, is assumed:
        pictures without a clean one do not tell.
        """
        return _veil_medium(torch.from_numpy(self.theta).reshape(1, 3, 2))

    def sample(self, count: int, generator: torch.Generator | None = None) -> Medium:
        """Draw veils that the pictures allow, as `Fit.sample`, from the normal distribution of
        what was fitted.
        """
        theta, covariance = torch.from_numpy(self.theta), torch.from_numpy(self.covariance)
        drawn = _drawn(theta, covariance, count, generator).maximum(1e-3 * theta)
        return _veil_medium(drawn.reshape(-1, 3, 2))

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
        numbers = [np.nan if value is None else value for value in values]
        return torch.tensor(numbers, dtype=torch.float64)

    def backscatter(self, z: Tensor) -> Tensor:
        """The veil in front of points at these distances, m; shapes as of `Medium.backscatter`.

        It is known where V(0) and G are not, as far as `farthest`.
        """
        return self.medium.backscatter(z)

    def __repr__(self) -> str:
        shown = ", ".join("?" if x.isnan() else f"{float(x):.3g}" for x in self.veil)
        return f"VeilFit(V(0) = {shown})"


def _veil_medium(numbers: Tensor) -> Medium:
    """Media of source and G of each colour (Bx3x2)."""
    source, G = numbers.unbind(-1)
    return Medium.from_coefficients(G, G, source / G)


def load_fit(path: str | os.PathLike[str]) -> Fit | WaterFit:
    """Read a fit of one water, whichever of `uwaug.fit` and `uwaug.fitting.fit_water` made it.

    Raises:
        ValueError: if the file is of neither, or of a newer version; names it.
        OSError: if it cannot be read.
    """
    require_regular(path)
    with Path(path).open("rb") as file:
        # the first key says which
        is_water = f'"{WaterFit.KEY}"'.encode() in file.read(_HEAD)
    return WaterFit.load(path) if is_water else Fit.load(path)
