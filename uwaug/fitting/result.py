"""Results of fits: numbers with their errors, in words, as a medium, as files and as pictures."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from torch import Tensor

from uwaug._support import checks, codec
from uwaug._support.atomic import require_regular, written_whole
from uwaug._support.types import Array, ColorSpace
from uwaug.fitting.data import Geometry, Pictures
from uwaug.fitting.model import COLOURS
from uwaug.formation.image import form_image
from uwaug.formation.underwater import Underwater
from uwaug.optics.medium import Medium
from uwaug.optics.water import Water

if TYPE_CHECKING:
    from matplotlib.figure import Figure

State = Literal["free", "at bound", "not identified", "fixed"]

VISIBLE_LIGHT = 0.002
"""Smallest difference of linear light that shows in a picture, half of a step of 8 bits. The
default tolerance of media and blurs puts pictures .0007 off (RMS).
"""

THIN_OPTICAL_DEPTH = 0.3  # G·z at the far end, below which a veil is still a straight line
_SURE_ERRORS = 5.0  # standard errors of independent noise, beyond which a mean residual is real
_DEPENDENT_EFFECT = 1.5  # design effect, above which neighbouring residuals depend on each other
# Range that a fit's module is planned for, in shares of the median and of the farthest distance.
_NEAR_SHARE, _FAR_SHARE = 0.2, 1.5
_MAX_DIGITS = 12  # of the ends of an interval
_MEANINGS = {
    "veil": "of white, V(0)",
    "source": "of white, G·V(0)",
    "gain": "times the light of clean",
    "exponent": "of σ over distance",
    "contents": "times those of the type",
}
"""Meanings of numbers whose name and unit are not enough, by kind."""


@codec.plain
@dataclass(frozen=True)
class Parameter:
    """A number that a fit reports.

    Attributes:
        value: None if it is not identified.
        error: standard error; None if it is not identified, fixed, or at a bound.
        low, high: ends of the 95 % interval; None if it is not identified or fixed.
        unit: "1/m", "m", "px" or "1".
        state: "free"; "at bound": at the end of its range; "not identified": the pictures do not
            tell; "fixed": it was given.
    """

    value: float | None
    error: float | None
    low: float | None
    high: float | None
    unit: str
    state: State


@codec.plain
@dataclass(frozen=True)
class Candidate:
    """A model, or a Jerlov type, that was tried.

    Attributes:
        name: name of the model or type.
        numbers: count of the fitted numbers.
        error: root of the mean loss of left-out pixels (for a type: of the fitted pixels), in
            standard deviations of the noise.
        behind: excess of the summed loss over that of the best.
        behind_error: standard error of `behind`.
        chosen: True for the candidate of the fit.
        values: visibility and vertical depth of a type, m.
    """

    name: str
    numbers: int
    error: float
    behind: float
    behind_error: float
    chosen: bool = False
    values: Mapping[str, float] = field(default_factory=dict)


@codec.plain
@dataclass(frozen=True)
class Remainder:
    """Residual of the pixels at one distance.

    Attributes:
        distance: median distance of the pixels, m.
        mean: mean of observed − fitted, in linear light, for red, green and blue.
        error: standard error of each mean, if the noise were independent.
    """

    distance: float
    mean: tuple[float, ...]
    error: tuple[float, ...]


@codec.plain
@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """A water that was recovered from pictures, by `uwaug.fit`, `uwaug.fitting.fit_water` or
    `uwaug.fitting.fit_veil`; or read by `load_fit`.

    Attributes:
        model: a model of `uwaug.fit`, a Jerlov type or "no Jerlov type", or "darkest pixels".
        parameters: each number by name: value, standard error, 95 % interval, unit, state.
        covariance: covariance of all `parameters`, in their order; of no use where one is not
            identified.
        medium: the water, exposure included, as `uwaug.Underwater` and `uwaug.form_image` take it:
            a batch of one, float64. It makes the observed picture of the clean one.
        geometry: distances [m] and size [px] of the pictures.
        rms: root mean square of the residual, in linear light.
        notes: sentences on the result, and on what the pictures cannot tell.
        candidates: the models or types that were tried.
        remainder: residuals by distance.
        adequate: True if the residuals are noise; False if the model misses something; None by
            `fit_veil`.
        water: spectra with the fitted contents, for `uwaug.RandomUnderwater`; by `fit_water` alone.
        color_space: colour space of the pictures, and of those that `module` takes.
        pictures: the fitted pictures; None if the fit was read from a file.
    """

    model: str
    parameters: dict[str, Parameter]
    covariance: Array
    medium: Medium
    geometry: Geometry
    rms: float
    notes: tuple[str, ...]
    candidates: tuple[Candidate, ...] = ()
    remainder: tuple[Remainder, ...] = ()
    adequate: bool | None = None
    water: Water | None = None
    color_space: ColorSpace = "srgb"
    pictures: Pictures | None = field(default=None, metadata={"stored": False})

    @property
    def errors(self) -> dict[str, float]:
        """Standard errors by name, of the numbers that have one."""
        rows = self.parameters.items()
        return {name: number.error for name, number in rows if number.error is not None}

    def module(self, sides: tuple[int, int] | None = None) -> Underwater:
        """The water as a module for distances from .2 times the median of the fitted ones to 1.5
        times the farthest.

        Args:
            sides: smallest and largest short side of pictures, px, as of `uwaug.Underwater`.
        """
        low, high = _NEAR_SHARE * self.geometry.reference, _FAR_SHARE * self.geometry.farthest
        return Underwater(self.medium, (low, high), color_space=self.color_space, sides=sides)

    def rendered(self) -> Tensor:
        """The observed pictures (Bx3xHxW, linear light) as the water makes them.

        Raises:
            ValueError: if the fit was read from a file, or there was no clean picture.
        """
        if self.pictures is None or not self.pictures.clean.any():
            raise ValueError("the fit has no clean pictures: fit them again to see these")
        clean, z = self.pictures.clean.float(), self.pictures.z.float()
        return form_image(clean.expand(len(z), -1, -1, -1), z, self.medium).image

    def summary(self) -> str:
        """The result as text: notes, parameters, candidates, residuals by distance."""
        rows = [["", "value", "std. error", "95 % interval", "unit"]]
        for name, number in self.parameters.items():
            value = "not identified" if number.value is None else f"{number.value:.4g}"
            error = "" if number.error is None else f"{number.error:.2g}"
            rows.append([name, value, error, _interval(number), self._meaning(name)])
        parts = [*self.notes, *_aligned(rows)]
        if len(self.candidates) > 1:
            # errors are in standard deviations of the noise, what lies behind in their squares
            rows = [["  model", "numbers", "error [σ]", "behind the best [σ²]", ""]]
            for x in self.candidates:
                mark = "*" if x.chosen else " "
                behind = f"{x.behind:.4g} ± {x.behind_error:.2g}"
                values = ", ".join(f"{name} {value:.4g}" for name, value in x.values.items())
                row = [f"{mark} {x.name}", str(x.numbers), f"{x.error:.4f}", behind, values]
                rows.append(row)
            parts += _aligned(rows)
        if self.remainder:
            rows = [["observed − fitted", *COLOURS, "of linear light"]]
            for part in self.remainder:
                cells = [f"{m:+.4f} ± {e:.4f}" for m, e in zip(part.mean, part.error, strict=True)]
                rows.append([f"at {part.distance:.3g} m", *cells, ""])
            parts += _aligned(rows)
        return "\n".join(parts)

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        numbers = [f"{name} = {x.value:.3g}" for name, x in self.parameters.items() if x.value]
        return f"Fit({self.model!r}, {', '.join(numbers[:3])}, …)"

    def plot(self) -> "Figure":
        """Draw the result: pictures, residuals by distance, curves; needs matplotlib."""
        from uwaug.fitting.plot import plot

        return plot(self)

    def to_dict(self) -> dict[str, Any]:
        """Numbers and words as plain values for JSON, without pictures."""
        plain: dict[str, Any] = codec.to_plain(self)
        return plain

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "Fit":
        """Inverse of `to_dict`.

        Raises:
            TypeError, ValueError: if `data` is not a fit.
        """
        fit: Fit = codec.from_plain(data, Fit)
        checks.instance("data", fit, Fit)
        return fit

    @staticmethod
    def of_plain(covariance: Any, **values: Any) -> "Fit":
        """A fit of plain values, for `uwaug._support.codec`."""
        return Fit(covariance=np.array(covariance), **values)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result as JSON, whole or not at all; `uwaug.fitting.load_fit` reads it."""
        with written_whole(path) as part:
            part.write_text(json.dumps(self.to_dict(), indent=1) + "\n", encoding="utf-8")

    def _meaning(self, name: str) -> str:
        """Unit and meaning of a number, and its state if that is "at bound" or "fixed"."""
        number, kind = self.parameters[name], name.partition("_")[0]
        meaning = _MEANINGS.get(kind, "")
        if kind == "width":
            meaning = f"σ at {self.geometry.reference:.3g} m"
        if kind in ("beta", "G"):
            near, far = self.geometry.nearest, self.geometry.farthest
            meaning = f"one rate for {near:.3g} to {far:.3g} m"
        if kind == "beta" and self.model in ("haze", "veil"):
            meaning += ", of direct and forward light together"
        unit = number.unit if number.unit != "1" or not meaning else ""
        state = f"({number.state})" if number.state in ("at bound", "fixed") else ""
        return "  ".join(filter(None, (unit, meaning, state)))


def load_fit(path: str | os.PathLike[str]) -> Fit:
    """Read a fit that `Fit.save` wrote.

    Raises:
        ValueError: if the file is not a fit; the error names it.
        OSError: if it cannot be read.
    """
    require_regular(path)
    try:
        return Fit.from_dict(json.loads(Path(path).read_text(encoding="utf-8")))
    except (LookupError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: not a fit: {error}") from None


def left_over(remainder: list[Remainder], design_effect: float, rms: float) -> list[str]:
    """The sentence on residuals that are not noise, as they are off at one distance or alike in
    neighbouring pixels; none otherwise.
    """
    worst, example = 0.0, ""
    for row in remainder:
        for colour, mean, error in zip(COLOURS, row.mean, row.error, strict=True):
            if abs(mean) > max(VISIBLE_LIGHT, _SURE_ERRORS * error, worst):
                worst, side = abs(mean), "brighter" if mean > 0 else "darker"
                example = f"; {colour} is {worst:.2g} {side} than fitted at {row.distance:.3g} m"
    are_alike = design_effect > _DEPENDENT_EFFECT and rms > VISIBLE_LIGHT
    if not example and not are_alike:
        return []
    causes = "distances, alignment, uneven light, or more than one rate for a colour"
    return [
        f"What is left is not noise: errors are {design_effect:.1f} times those of independent "
        f"pixels{example}. The model misses something, such as {causes}: numbers may be off by "
        "more."
    ]


def straight_line(rates: Mapping[str, float], farthest: float) -> list[str]:
    """The sentence on colours whose veil has hardly begun to bend at the far end (m); `rates` holds
    their G (1/m).
    """
    straight = [colour for colour, G in rates.items() if G * farthest < THIN_OPTICAL_DEPTH]
    if not straight:
        return []
    return [
        f"In {', '.join(straight)} the veil still grows as a straight line at {farthest:.3g} m: "
        "its growth (source) is seen, where it ends is not."
    ]


def unknown(parameters: Mapping[str, Parameter]) -> list[str]:
    """Sentences on numbers that pictures do not tell, or that are at the end of their range."""
    words = {"not identified": "Not identified", "at bound": "At the end of what they may be"}
    sentences = []
    for state, beginning in words.items():
        names = [name for name, number in parameters.items() if number.state == state]
        if names:
            sentences.append(f"{beginning}: {', '.join(names)}.")
    return sentences


def _interval(number: Parameter) -> str:
    """Both ends, to as many digits as tell them apart."""
    if number.low is None or number.high is None:
        return ""
    for digits in range(4, _MAX_DIGITS):
        low, high = f"{number.low:.{digits}g}", f"{number.high:.{digits}g}"
        if low != high:
            break
    return f"{low} … {high}"


def _aligned(rows: list[list[str]]) -> list[str]:
    """Lines of a table below an empty line: words to the left, numbers to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [""]
    for first, *numbers, last in rows:
        cells = [cell.rjust(width) for cell, width in zip(numbers, widths[1:], strict=False)]
        lines.append("  ".join(["", first.ljust(widths[0]), *cells, last]).rstrip())
    return lines
