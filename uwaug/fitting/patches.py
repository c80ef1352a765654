"""`fit_patches`: a water from the patches of colour charts at known distances."""

import csv
import io
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.atomic import read_text
from uwaug._support.threads import one_thread
from uwaug._support.types import Array, ColorSpace
from uwaug.fitting.data import FAR_QUANTILE, MIN_SPAN, NEAR_QUANTILE, Geometry, Pixels, Places
from uwaug.fitting.errors import covariance_of, fit_of, straight_line
from uwaug.fitting.model import COLOURS, MODELS, Bounds, CoefficientModel, Model, Quantity
from uwaug.fitting.result import Fit
from uwaug.fitting.solve import MAD, MIN_NOISE, Objective, Solution, guess, solve
from uwaug.formation.colour import decoded, require_values
from uwaug.formation.development import Development
from uwaug.formation.setting import Setting

_MIN_PATCHES = 12  # values of each colour that a fit needs: four of each of its numbers
_UNEVEN = 0.3  # default standard deviation of the logarithm of the light on a chart
_MAX_SPREAD = 2.0  # largest standard deviation of a logarithm
_MAX_LOG = 9.0  # of exposures, and of a chart's light and distance: it is far off
_ROUGH_SHARE, _ROUGH_FLOOR = 0.05, 1e-3  # noise of a first fit: a share of the light, and a least
_ROUNDS = 3  # of noise that is learnt from residuals
_UNEVEN_LIGHT = 1.5  # ratio of the lights on charts that is worth a note
_MAX_CAST = 0.05  # difference of the median errors of two colours of a picture
_CHART_DEPTH = 1.5  # ratio of the distances of the patches of one chart, which may lean
_BRIGHTEST = (0.01, 2.0)  # values that may be the largest of all
_FARTHEST = 100.0  # m; nobody sees a chart farther away, so it is another unit


class Patch(NamedTuple):
    """A patch of a chart, as it is and as the water shows it.

    Attributes:
        picture: name of the picture; each has an exposure of its own.
        chart: name of the chart in it; each has a light of its own, as charts lean and lie in
            shade.
        distance: from the camera along the ray, m.
        air: red, green and blue without water, as measured or published for the patch.
        water: red, green and blue in the picture; NaN where a value was clipped.
    """

    picture: str
    chart: str
    distance: float
    air: tuple[float, ...]
    water: tuple[float, ...]


def read_patches(path: str | os.PathLike[str]) -> list[Patch]:
    """Read patches from a CSV file with commas; or semicolons or tabs, and decimal commas.

    Args:
        path: a file whose first line names the columns, in any order: distance (m), air_red,
            air_green, air_blue, red, green, blue; and picture and chart, without which there is
            one picture, and a chart at each distance of a picture. An empty value of red, green or
            blue was clipped. Other columns, and empty rows, are left alone.

    Raises:
        ValueError: if it is no such table; the error names the line.
        OSError: if it cannot be read.
    """
    text = read_text(Path(path))
    first = text.partition("\n")[0]
    mark = next((mark for mark in ";\t" if mark in first), ",")
    rows = csv.DictReader(io.StringIO(text, newline=""), delimiter=mark, restval="")
    header = [name.strip().lower() for name in rows.fieldnames or ()]
    rows.fieldnames = header
    numbers = ["distance", *(f"air_{colour}" for colour in COLOURS), *COLOURS]
    if missing := [name for name in numbers if name not in header]:
        raise ValueError(f"{path}: expected a column {missing[0]}, got {', '.join(header)}")
    patches = []
    for row in rows:
        if not any(row.values()):
            continue  # spreadsheets end in empty rows
        cells = [row[name].strip().replace(",", ".") for name in numbers]
        try:
            distance, *air = map(float, cells[:4])
            water = [float(cell or "nan") for cell in cells[4:]]
            if None in row:
                raise ValueError
        except ValueError:
            got = f"expected numbers, got {', '.join(cells)}"
            raise ValueError(f"{path}, line {rows.line_num}: {got}") from None
        picture = row.get("picture", "").strip()
        chart = row.get("chart", "").strip() or f"{distance:g} m"
        patches.append(Patch(picture, chart, distance, tuple(air), tuple(water)))
    return patches


def fit_patches(
    patches: Sequence[Patch],
    *,
    color_space: ColorSpace,
    model: Literal["haze", "veil"] = "haze",
    uneven: float = _UNEVEN,
    distance_error: float = 0.0,
) -> Fit:
    """Recover a water from patches of charts at known distances, such as a diver photographs with a
    tape measure. Each picture has an exposure, and each chart a light of its own.

    Args:
        patches: of one water; pictures of other exposures, or other charts, may be among them.
        color_space: "linear": values are taken as is, of 0…1 in any camera's space, but `air` and
            `water` in one. "srgb": they are decoded.
        model: "haze": one coefficient for the light of a patch and the veil, as there is where
            patches are wider than the blur; or "veil": a coefficient for each.
        uneven: standard deviation of the logarithm of the light on charts, 0…2; 0 if all are lit
            alike. A chart in deep shade counts for less.
        distance_error: standard deviation of distances, as a share of each, 0…2.

    Returns:
        The fit. Numbers are those of `uwaug.fit`, with the exposure of the first picture, and
        exposure of each picture (times that of the first), light of each chart. Its setting is for
        sRGB pictures of any exposure: the gain of the charts is metered away.

    Raises:
        TypeError, ValueError: if a number does not suit; fewer than 12 patches have all colours; or
            all are at one distance, or those of one chart at several.

    Examples:
        >>> import math, uwaug
        >>> from uwaug.fitting import Patch, fit_patches
        >>> def seen(grey, z):  # a haze of .3/m, whose end is .4
        ...     return (grey * math.exp(-0.3 * z) + 0.4 * (1 - math.exp(-0.3 * z)),) * 3
        >>> charts = [(z, grey) for z in (1, 2, 4, 8) for grey in (0.03, 0.1, 0.3, 0.6)]
        >>> patches = [Patch("1", f"{z} m", z, (grey,) * 3, seen(grey, z)) for z, grey in charts]
        >>> round(fit_patches(patches, color_space="linear").parameters["beta_green"].value, 2)
        0.3
    """
    checks.one_of("model", model, ("haze", "veil"))
    checks.one_of("color_space", color_space, get_args(ColorSpace))
    checks.within("uneven", uneven, 0.0, _MAX_SPREAD)
    checks.within("distance_error", distance_error, 0.0, _MAX_SPREAD)
    pictures, picture_of = _numbered([patch.picture for patch in patches])
    charts, chart_of = _numbered([f"{patch.picture}/{patch.chart}".strip("/") for patch in patches])
    pixels = _pixels(patches, chart_of, color_space)
    z = pixels.z.flatten().numpy()
    for i, name in enumerate(charts):
        of_chart = z[chart_of == i]
        if of_chart.max() > _CHART_DEPTH * of_chart.min():
            got = f"chart {name} lies at {of_chart.min():g} to {of_chart.max():g} m"
            raise ValueError(f"patches: {got}: name each picture, or each place of a chart")
    near, median, far = np.quantile(z, (NEAR_QUANTILE, 0.5, FAR_QUANTILE)).tolist()
    geometry = Geometry(near, median, far, pixels.size, 0.0)
    spreads = {"light": uneven, "distance": distance_error}
    spreads = {kind: spread for kind, spread in spreads.items() if spread > 0}
    # a medium that is made in inference mode could not be trained
    with one_thread(), torch.inference_mode(False), torch.no_grad():
        water = CoefficientModel(MODELS[model], geometry, True)
        patch_model = _PatchModel(water, pictures, charts, picture_of, chart_of, spreads)
        objective, solution = _solved(Objective(patch_model, pixels))
        theta, covariance = solution.theta, covariance_of(objective, solution)
        coefficients = water.coefficients(theta[: len(water.bounds)])
        setting = Setting(water.medium(coefficients), development=Development(metered=True))
        fit = fit_of(objective, solution, covariance, setting, geometry)
        light, measured = patch_model.render(theta, pixels), objective.pixels.observed
        measured = measured.where(pixels.weights > 0, torch.nan)
        notes = _notes(patch_model, theta, light / measured - 1)
        notes += straight_line(fit.parameters, coefficients.G, geometry.farthest)
    seen = z, measured[0, :, 0].numpy(), light[0, :, 0].numpy()
    return replace(fit, notes=(*notes, *fit.notes), patches=seen)


@dataclass(frozen=True, eq=False)
class _PatchModel(Model):
    """A water, exposures of pictures, light on charts, and distances of charts. θ holds that of the
    water, then logarithms.
    """

    water: CoefficientModel
    pictures: Sequence[str]
    charts: Sequence[str]
    picture_of: Places  # (N): number of the picture of each patch
    chart_of: Places  # (N): number of its chart
    spread_of: dict[str, float]  # standard deviation of the logarithms of charts, by kind

    @property
    def spreads(self) -> Array:
        return np.repeat([*self.spread_of.values()], len(self.charts))

    @property
    def name(self) -> str:
        return self.water.spec.name

    @cached_property
    def bounds(self) -> dict[str, Bounds]:
        names = [f"exposure {i}" for i in range(1, len(self.pictures))]
        names += [f"{kind} {i}" for kind in self.spread_of for i in range(len(self.charts))]
        return self.water.bounds | dict.fromkeys(names, Bounds(-_MAX_LOG, _MAX_LOG, 0.0))

    def factors(self, theta: Array) -> dict[str, Array]:
        """Exposure of each picture; light and factor on the distance of each chart."""
        logs = theta[len(self.water.bounds) :]
        exposures, logs = np.split(logs, [len(self.pictures) - 1])
        kinds = np.exp(logs).reshape(len(self.spread_of), len(self.charts))
        ones = dict.fromkeys(("light", "distance"), np.ones(len(self.charts)))
        exposures = np.exp(np.concatenate([[0.0], exposures]))
        return {"exposure": exposures, **ones, **dict(zip(self.spread_of, kinds, strict=True))}

    def render(self, theta: Array, pixels: Pixels) -> Tensor:
        factors = self.factors(theta)
        light, metres = (torch.from_numpy(factors[x][self.chart_of]) for x in ("light", "distance"))
        lit = replace(pixels, clean=pixels.clean * light, z=pixels.z * metres)
        exposure = torch.from_numpy(factors["exposure"][self.picture_of])
        return exposure * self.water.render(theta[: len(self.water.bounds)], lit)

    @cached_property
    def quantities(self) -> list[Quantity]:
        names = {"exposure": self.pictures, "light": self.charts, "distance": self.charts}
        return self.water.quantities + [
            Quantity(f"{kind}_{name}", "1", 0.02, f"{kind} {i}")
            for kind in ("exposure", *self.spread_of)
            for i, name in enumerate(names[kind])
        ]

    def report(self, theta: Array) -> Array:
        factors = self.factors(theta)
        of_water = self.water.report(theta[: len(self.water.bounds)])
        return np.hstack([of_water, *(factors[kind] for kind in ("exposure", *self.spread_of))])


def _numbered(names: Sequence[str]) -> tuple[list[str], Places]:
    """Each name once, and the number of that of each."""
    numbers = {name: i for i, name in enumerate(dict.fromkeys(names))}
    return [*numbers], np.array([numbers[name] for name in names], dtype=np.int64)


def _pixels(patches: Sequence[Patch], chart_of: Places, color_space: ColorSpace) -> Pixels:
    """Patches as pixels whose blocks are charts."""
    z = torch.tensor([patch.distance for patch in patches] or [0.0], dtype=torch.float64)
    nearest, farthest = float(z.min()), float(z.max())
    if not 0 < nearest <= farthest - MIN_SPAN * float(z.median()) or farthest > _FARTHEST:
        got = f"{nearest:g} to {farthest:g}"
        raise ValueError(f"patches: distance must be several, 0…{_FARTHEST:g} m, got {got}")
    air, water = (
        torch.tensor(values, dtype=torch.float64).reshape(-1, 3).T.reshape(1, 3, 1, -1)
        for values in ([patch.air for patch in patches], [patch.water for patch in patches])
    )
    # white is clipped
    is_used = (water > 0) & (water < 1)
    water = torch.where(water.isnan(), 0.0, water)
    for name, light in (("patches: air", air), ("patches: water", water)):
        _, high = require_values(light, color_space, name)
        # noise, and what shows, are of light whose white is about 1
        checks.within(f"{name}, brightest", high, *_BRIGHTEST)
    if (count := int(is_used.sum(3).min())) < _MIN_PATCHES:
        got = f"only {count} have a value between black and white of each colour"
        raise ValueError(f"patches: {got}, expected at least {_MIN_PATCHES}")
    air, water = decoded(air, color_space), decoded(water, color_space)
    return Pixels(
        clean=air,
        observed=water,
        z=z.reshape(1, 1, 1, -1),
        weights=is_used / (_ROUGH_SHARE * water + _ROUGH_FLOOR),
        places=np.arange(len(patches)),
        blocks=chart_of,
        stacks={},
        size=(1, len(patches)),
    )


def _solved(objective: Objective[_PatchModel]) -> tuple[Objective[_PatchModel], Solution]:
    """The least cost, with pixels weighed by a noise that the residuals tell: a share of the light
    for each colour.
    """
    model, pixels = objective.model, objective.pixels
    water = Objective(model.water, pixels)
    theta = model.water.start(guess(water))
    solution = solve(objective, np.pad(theta, (0, len(model.bounds) - len(theta))))
    is_used = pixels.weights > 0
    # numbers of charts and pictures take a part of the residuals
    count = int(is_used.sum())
    freedom = max(count - len(model.bounds), count / 4) / count
    for _ in range(_ROUNDS):
        light = model.render(solution.theta, pixels)
        share = (pixels.observed / light - 1).abs()
        medians = [float(share[0, c][is_used[0, c]].median()) for c in range(3)]
        spread = MAD * torch.tensor(medians).reshape(1, 3, 1, 1) / math.sqrt(freedom)
        weights = is_used / (spread * light).clamp(min=MIN_NOISE)
        objective = Objective(model, replace(pixels, weights=weights))
        solution = solve(objective, solution.theta)
    return objective, solution


def _notes(model: _PatchModel, theta: Array, errors: Tensor) -> list[str]:
    """Sentences on a fit whose values are off by shares of themselves (1x3x1xN)."""
    errors = errors[0, :, 0]
    notes = [
        f"Model {model.name!r}: {model.water.spec.words}.",
        f"Half of all values are off by less than {100 * float(errors.abs().nanmedian()):.2g} %.",
    ]
    light = model.factors(theta)["light"]
    if light.max() > _UNEVEN_LIGHT * light.min():
        darkest, brightest = (model.charts[int(i)] for i in (light.argmin(), light.argmax()))
        notes.append(
            f"Charts are lit unevenly: {darkest} by {light.min():.2g}, {brightest} by "
            f"{light.max():.2g} of the common light. Look for shade, a tone curve, or a wrong name."
        )
    for i, picture in enumerate(model.pictures):
        colours = errors[:, torch.from_numpy(model.picture_of == i)].nanmedian(1).values
        if float(colours.max() - colours.min()) > _MAX_CAST:
            notes.append(f"{picture} has another cast: is its white balance that of the others?")
    return notes
