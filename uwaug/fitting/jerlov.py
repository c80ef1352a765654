"""`fit_water`: which Jerlov type a scene lies in, how much is in the water, and how deep."""

import math
import os
from dataclasses import dataclass, replace
from functools import cached_property
from typing import get_args

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.threads import one_thread
from uwaug._support.types import Array, ColorSpace
from uwaug.fitting.api import Progress, checked_options
from uwaug.fitting.choose import FittedModel, block_losses, result_of
from uwaug.fitting.data import Geometry, Pictures, Pixels
from uwaug.fitting.model import MAX_OPTICAL_DEPTH, MOST_GAIN, Bounds, Model, Quantity
from uwaug.fitting.result import Fit
from uwaug.fitting.solve import Objective, loss, reweighed, roughly_weighed, solve
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.jerlov import JERLOV_TYPES
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import FOCAL_LENGTH, PointSpread
from uwaug.optics.scattering import Scattering
from uwaug.optics.surfaces import Surfaces
from uwaug.optics.water import Water

_SEEN = 0.02  # share of the contrast that is left at the visibility
_START_PIXELS = 1000  # pixels of the fits that others begin from
_VISIBILITIES = np.geomspace(0.4, 25.0, 8)  # to begin at, in multiples of the median distance
_VERTICAL_DEPTHS = (0.5, 3.0, 10.0)  # vertical depths to begin at, m
_MAX_VERTICAL_DEPTH = 30.0  # m; below, little is left of any light but blue
_CONTENTS = (1e-3, 1e3)  # of a type's: from pure water to clear types within the tables' error
_STEP = 1e-5  # of θ, for a difference that stands for the slope of a picture
_TOLERANCE = 0.002  # of the medium of a result


@dataclass(frozen=True, eq=False)
class TypeModel(Model):
    """A scene in a Jerlov type with more or less in it.

    θ holds the logarithms of contents and gain, and the vertical depth [m].

    Attributes:
        water: the type.
        camera, surfaces, g, point_spread: as of `fit_water`.
        depth: the vertical depth, m; None if it is fitted.
        geometry: of the pictures.
    """

    water: Water
    camera: Camera
    surfaces: Surfaces
    g: float
    point_spread: PointSpread
    depth: float | None
    geometry: Geometry

    @property
    def name(self) -> str:
        """Of the type."""
        return self.water.name

    @cached_property
    def bounds(self) -> dict[str, Bounds]:
        """Bounds of each number that is fitted, by name, in the order of θ."""
        unseen = math.exp(-MAX_OPTICAL_DEPTH)
        most = max(self.water.contents_for(unseen, self.geometry.reference), 1.0)
        low, high = (math.log(x) for x in (_CONTENTS[0], min(most, _CONTENTS[1])))
        bounds = {"contents": Bounds(low, high, 0.0)}
        if self.depth is None:
            bounds["vertical_depth"] = Bounds(0.0, _MAX_VERTICAL_DEPTH, 3.0)
        return bounds | {"gain": Bounds(-math.log(MOST_GAIN), math.log(MOST_GAIN), 0.0)}

    def numbers(self, theta: Array) -> dict[str, float]:
        """Contents, vertical depth and gain."""
        numbers = dict(zip(self.bounds, theta.tolist(), strict=True))
        depth = numbers.get("vertical_depth", self.depth) or 0.0
        logarithms = {name: math.exp(numbers[name]) for name in ("contents", "gain")}
        return {**logarithms, "vertical_depth": max(depth, 0.0)}

    def water_of(self, theta: Array) -> Water:
        """The type with what is in it."""
        return self.water.with_contents(self.numbers(theta)["contents"])

    def medium(self, theta: Array, tolerance: float = 0.0) -> Medium:
        """The medium of these numbers; by default with all bands: fewer rates jump as numbers
        change.
        """
        numbers = self.numbers(theta)
        medium = Medium.from_water(
            self.water_of(theta),
            self.camera,
            vertical_depth=numbers["vertical_depth"],
            g=self.g,
            point_spread=self.point_spread,
            surfaces=self.surfaces,
            tolerance=tolerance,
        )
        return medium.brightened(torch.tensor([numbers["gain"]], dtype=torch.float64))

    def render(self, theta: Array, pixels: Pixels) -> Tensor:
        """The pixels (1x3x1xN) in linear light."""
        medium = self.medium(theta)
        soft = pixels.softened(self.point_spread.shape, medium.width(pixels.z, pixels.size))
        return medium.image(pixels.z, pixels.clean, soft)

    def slopes(self, theta: Array, pixels: Pixels) -> Array:
        """Derivatives of the 3·N values by θ (3·N x numbers), by differences."""
        here, columns = self.render(theta, pixels), []
        for i, (name, bound) in enumerate(self.bounds.items()):
            if name == "gain":  # a logarithm
                columns.append(here)
                continue
            moved = theta.copy()
            moved[i] += _STEP if theta[i] + _STEP <= bound.high else -_STEP  # into the range
            columns.append((self.render(moved, pixels) - here) / (moved[i] - theta[i]))
        return torch.stack(columns, -1).reshape(-1, len(columns)).numpy()

    @property
    def quantities(self) -> list[Quantity]:
        """What is reported."""
        return [
            Quantity("visibility", "m", 0.0, "contents"),
            Quantity("contents", "1", 0.05, "contents"),
            Quantity("vertical_depth", "m", 0.5, "vertical_depth"),
            Quantity("gain", "1", 0.05, "gain"),
        ]

    def report(self, theta: Array) -> Array:
        """The value of each of `quantities`."""
        numbers = self.numbers(theta) | self.shown(theta)
        return np.array([numbers[quantity.name] for quantity in self.quantities])

    def shown(self, theta: Array) -> dict[str, float]:
        """Visibility and depth, m."""
        visibility = self.water_of(theta).visibility()
        return {
            "visibility": visibility,
            "vertical_depth": self.numbers(theta)["vertical_depth"],
        }


def fit_water(
    clean: Tensor,
    observed: Tensor,
    distance: Tensor,
    *,
    camera: str | os.PathLike[str] | Camera = "Nikon 5100 (NPL)",
    surfaces: Surfaces = "spectral",
    vertical_depth: float | None = None,
    g: float = Scattering.CALIBRATED.g,
    point_spread: PointSpread | None = None,
    color_space: ColorSpace = "srgb",
    pixels: int = 5000,
    seed: int = 0,
    progress: bool | Progress = True,
) -> Fit:
    """Which Jerlov water a scene lies in, and how much is in it.

    Each of the ten types is fitted by its contents, vertical depth and exposure, by its spectra and
    the camera's, through `Medium.from_water`. That which leaves least is taken. What is taken for
    known by default is what `uwaug.RandomUnderwater` takes.

    Args:
        clean, observed, distance, color_space, seed, progress: as of `uwaug.fit`.
        camera: as of `Medium.from_water`. A wrong one gives a wrong water.
        surfaces: "spectral" or "grey", as of `Medium.from_water`.
        vertical_depth: of the scene below the surface, m; None: it is fitted, 0…30 m.
        g: share of the scattered light that leaves the line of sight; μ is 1.5·g. One picture does
            not tell it from the water.
        point_spread: the width law; None for `PointSpread.calibrated` of a view 60° wide, .866 of
            the width. A picture by the paper's has `PointSpread.paper()`, g = .2 and grey surfaces.
        pixels: how many are fitted, spread evenly over the distances, 500…100 000.

    Returns:
        The fit: its `model` is the type, its `water` goes into `uwaug.RandomUnderwater`; numbers
        are visibility [m], contents (the factor of `Water.with_contents`), vertical depth [m] and
        gain (exposure); candidates are the ten types.

    Raises:
        TypeError, ValueError: as `uwaug.fit`; if too few pixels lie above the noise.

    Source: spectra: Solonenko and Mobley 2015, see `Water.jerlov`.

    Examples:
        >>> import torch, uwaug
        >>> clean, z = torch.rand(3, 60, 80), torch.linspace(1, 6, 4800).reshape(1, 60, 80)
        >>> water = uwaug.Medium.from_water("5C", g=0.05, surfaces="spectral")
        >>> observed = uwaug.Underwater(water)(clean, z)
        >>> options = {"point_spread": water.point_spread, "pixels": 500, "progress": False}
        >>> uwaug.fitting.fit_water(clean, observed, z, **options).model
        '5C'
    """
    say = checked_options(pixels, seed, progress)
    checks.within("g", g, *checks.DOMAIN["g"])
    camera = load_camera(camera)
    checks.one_of("surfaces", surfaces, get_args(Surfaces))
    if vertical_depth is not None:
        checks.within("vertical_depth", vertical_depth, *checks.DOMAIN["vertical_depth"])
    pictures = Pictures.of(clean, observed, distance, color_space)
    geometry = pictures.geometry
    law = point_spread
    if law is None:
        law = PointSpread.calibrated(FOCAL_LENGTH * geometry.size[1])
    checks.instance("point_spread", law, PointSpread)
    models = [
        TypeModel(Water.jerlov(name), camera, surfaces, g, law, vertical_depth, geometry)
        for name in JERLOV_TYPES
    ]
    # a medium that is made in inference mode could not be trained
    with one_thread(), torch.inference_mode(False), torch.no_grad():
        say("blurring the clean picture")
        drawn = roughly_weighed(pictures.sample([law.shape], int(pixels), seed))
        few = drawn.subsample(_START_PIXELS, seed)
        scouts = []
        for model in models:
            say(f"trying {model.name}")
            objective = Objective(model, few)
            scouts.append((model, solve(objective, _start(objective))))
        best, end = min(scouts, key=lambda pair: pair[1].cost)
        say("learning the noise")
        weighed, _ = reweighed(Objective(best, drawn), end.theta, pictures.clips)
        tried = []
        for model, end in scouts:
            say(f"fitting {model.name}")
            objective = Objective(model, weighed)
            solution = solve(objective, end.theta)
            losses = block_losses(objective, solution.theta)
            tried.append(FittedModel(objective, solution, losses))
        tried.sort(key=lambda fitted: fitted.loss)
        chosen = tried[0]
        model, theta = chosen.model, chosen.solution.theta
        result = result_of(chosen, tried, model.name, model.medium(theta, _TOLERANCE), pictures)
    others = result.candidates[1:]
    alike = [x.name for x in others if x.behind <= x.behind_error]
    comparison = "All others explain the picture worse by more than one standard error."
    if alike:
        comparison = f"Within one standard error, these explain it as well: {', '.join(alike)}."
    notes = (
        f"Jerlov type {model.name}. {comparison}",
        f"The residual is {result.rms:.2g} RMS of linear light. Camera, g, surfaces and a linear "
        "camera are taken for known.",
    )
    return replace(result, notes=(*notes, *result.notes), water=model.water_of(theta))


def _start(objective: Objective[TypeModel]) -> Array:
    """The best of a grid of visibilities and depths, at a gain by linear least squares."""
    model, pixels = objective.model, objective.pixels
    observed = pixels.observed * pixels.weights
    best, least = np.zeros(len(model.bounds)), math.inf
    for metres in _VISIBILITIES * model.geometry.reference:
        contents = math.log(max(model.water.contents_for(_SEEN, metres), _CONTENTS[0]))
        for depth in _VERTICAL_DEPTHS if model.depth is None else (model.depth,):
            numbers = {"contents": contents, "vertical_depth": depth, "gain": 0.0}
            theta = np.clip([numbers[name] for name in model.bounds], *objective.bounds)
            light = model.render(theta, pixels) * pixels.weights
            gain = float((light * observed).sum() / light.square().sum().clamp(min=1e-300))
            theta[-1] = math.log(min(max(gain, 1 / MOST_GAIN), MOST_GAIN))
            cost = float(loss(objective.residual(theta)).sum())
            if cost < least:
                best, least = theta, cost
    return best
