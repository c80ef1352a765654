"""`fit_water`: the Jerlov type of a scene, its contents and its vertical depth."""

import math
import os
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.threads import one_thread
from uwaug._support.types import Array, ColorSpace
from uwaug.fitting.api import checked_options
from uwaug.fitting.choose import FittedModel, block_losses, result_of
from uwaug.fitting.data import Geometry, Pictures, Pixels
from uwaug.fitting.model import COLOURS, MAX_GAIN, MAX_OPTICAL_DEPTH, Bounds, Model, Quantity
from uwaug.fitting.result import Fit
from uwaug.fitting.solve import Objective, loss, reweighed, solve
from uwaug.formation.setting import Setting
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.jerlov import JERLOV_TYPES
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.scattering import Scattering
from uwaug.optics.surfaces import Surfaces
from uwaug.optics.view import WIDE, View
from uwaug.optics.water import Water

_VISIBLE_CONTRAST = 0.02  # share of the contrast that is left at the visibility
_START_PIXELS = 1000  # pixels of the fits that others begin from
_START_VISIBILITIES = np.geomspace(0.4, 25.0, 8)  # multiples of the median distance
_START_DEPTHS = (0.5, 3.0, 10.0)  # vertical depths, m
_MAX_VERTICAL_DEPTH = 30.0  # m; below, little is left of any light but blue
# Multiples of a type's contents, from pure water to clear types within the tables' error.
_MIN_CONTENTS, _MAX_CONTENTS = 1e-3, 1e3
_FAR_CONTENTS = 3.0  # times those of a type, which make a sentence
# Scattering lengths up to whose width of a known law there are blurs: little light is left there.
# With blurs up to a fifth of the short side alone, no picture of 25° was that of its type.
_MOST_LENGTHS = 20.0
_WIDEST_SIDES = 3.0  # widest blur, in longest sides: wider ones all give the mean
_RESULT_TOLERANCE = 0.002  # of the medium of a result
# Linear light. Media and blurs of the default tolerance are off by .0007 RMS, and half of a step
# of 8 bits is .002: of each colour about so much is alike everywhere.
_OFFSET = 1e-4
_GAINS = {"known": ("gain",), "free": tuple(f"gain_{colour}" for colour in COLOURS)}


@dataclass(frozen=True, eq=False)
class TypeModel(Model):
    """A scene in a Jerlov type with contents multiplied by a factor. θ holds the logarithms of
    contents and gains, and the vertical depth [m].
    """

    water: Water
    camera: Camera
    surfaces: Surfaces
    g: float
    mu: float | None  # None: 1.5·g
    point_spread: PointSpread
    view: View
    depth: float | None  # m; None if it is fitted
    geometry: Geometry
    gains: tuple[str, ...]  # of all colours together, or of each
    offset: float = _OFFSET

    @property
    def name(self) -> str:
        return f"{self.water.name}, {self.surfaces}"

    @cached_property
    def bounds(self) -> dict[str, Bounds]:
        invisible = math.exp(-MAX_OPTICAL_DEPTH)
        opaque = max(self.water.contents_for(invisible, self.geometry.reference), 1.0)
        low, high = math.log(_MIN_CONTENTS), math.log(min(opaque, _MAX_CONTENTS))
        bounds = {"contents": Bounds(low, high, 0.0)}
        if self.depth is None:
            bounds["vertical_depth"] = Bounds(0.0, _MAX_VERTICAL_DEPTH, 3.0)
        gain = Bounds(-math.log(MAX_GAIN), math.log(MAX_GAIN), 0.0)
        return bounds | dict.fromkeys(self.gains, gain)

    def numbers(self, theta: Array) -> dict[str, float]:
        numbers = dict(zip(self.bounds, theta.tolist(), strict=True))
        depth = max(numbers.get("vertical_depth", self.depth) or 0.0, 0.0)
        factors = {name: math.exp(numbers[name]) for name in ("contents", *self.gains)}
        return {**factors, "vertical_depth": depth}

    def water_of(self, theta: Array) -> Water:
        return self.water.with_contents(self.numbers(theta)["contents"])

    def medium(self, theta: Array, tolerance: float = 0.0) -> Medium:
        """The medium of θ; by default with all bands, as fewer rates jump when numbers change."""
        numbers = self.numbers(theta)
        medium = Medium.from_water(
            self.water_of(theta),
            self.camera,
            vertical_depth=numbers["vertical_depth"],
            g=self.g,
            mu=self.mu,
            point_spread=self.point_spread,
            surfaces=self.surfaces,
            tolerance=tolerance,
        )
        gains = [numbers[name] for name in self.gains]
        return medium.brightened(torch.tensor([gains], dtype=torch.float64))

    def render(self, theta: Array, pixels: Pixels) -> Tensor:
        medium = self.medium(theta).in_pixels(pixels.size, self.view)
        soft = pixels.stacks[self.point_spread.shape].softened(medium.width(pixels.z))
        return medium.image(pixels.z, pixels.clean, soft)

    @property
    def quantities(self) -> list[Quantity]:
        return [
            Quantity("visibility", "m", 0.0, "contents"),
            Quantity("contents", "1", 0.05, "contents"),
            Quantity("vertical_depth", "m", 0.5, "vertical_depth"),
            *(Quantity(name, "1", 0.05, name) for name in self.gains),
        ]

    def report(self, theta: Array) -> Array:
        numbers = {"visibility": self.water_of(theta).visibility(), **self.numbers(theta)}
        return np.array([numbers[quantity.name] for quantity in self.quantities])


def fit_water(
    clean: Tensor,
    observed: Tensor,
    distance: Tensor,
    *,
    camera: str | os.PathLike[str] | Camera = "Nikon 5100 (NPL)",
    surfaces: Surfaces | Literal["auto"] = "auto",
    vertical_depth: float | None = None,
    g: float = Scattering.CALIBRATED.g,
    mu: float | None = None,
    point_spread: PointSpread | None = None,
    view: View | float = WIDE,
    balance: Literal["known", "free"] = "known",
    color_space: ColorSpace = "srgb",
    jpeg: int | None = None,
    pixels: int = 5000,
    seed: int = 0,
    progress: bool = True,
) -> Fit:
    """Find the Jerlov type of a scene's water, its contents and its vertical depth.

    All ten types are fitted, by spectra of water and camera; the one with the smallest residual is
    named if what it leaves is noise.

    Args:
        clean, observed, distance, color_space, jpeg, seed, progress: as of `uwaug.fit`.
        camera, g, mu: as of `Medium.from_water`; a wrong one gives a wrong water.
        surfaces: "spectral" or "grey", as of `Medium.from_water`; "auto": what explains the
            picture better.
        vertical_depth: depth of the scene below the surface, m; None: it is fitted, 0…30 m.
        point_spread: width law; None: `PointSpread.calibrated`.
        view: of the camera, a `uwaug.View` or its angle in degrees.
        balance: "known": white is as in `clean`, and the gain is one for all colours. "free": each
            colour has its own. Depth is less sure then; but a white balance that is taken for water
            gives a wrong type, without a note.
        pixels: number of pixels to fit, 500…100 000.

    Returns:
        The fit: its `model` is the type, or "no Jerlov type". Numbers are visibility [m], contents
        (the factor of `Water.with_contents`), vertical depth [m] and gain (exposure).

    Raises:
        TypeError, ValueError: as `uwaug.fit`; if too few pixels lie above the noise.

    Source: spectra: Solonenko and Mobley 2015, see `Water.jerlov`.

    Examples:
        >>> import torch, uwaug
        >>> clean, z = torch.rand(3, 60, 80), torch.linspace(1, 6, 4800).reshape(1, 60, 80)
        >>> water = uwaug.Medium.from_water("5C", surfaces="spectral")
        >>> observed = uwaug.Underwater(water)(clean, z)
        >>> uwaug.fitting.fit_water(clean, observed, z, pixels=500, progress=False).model
        '5C'
    """
    say = checked_options(pixels, seed, progress=progress)
    camera = load_camera(camera)
    checks.one_of("balance", balance, _GAINS)
    checks.one_of("surfaces", surfaces, (*get_args(Surfaces), "auto"))
    if vertical_depth is not None:
        checks.within("vertical_depth", vertical_depth, *checks.DOMAIN["vertical_depth"])
    pictures = Pictures.of(clean, observed, distance, color_space, jpeg)
    geometry = pictures.geometry
    law = PointSpread.calibrated() if point_spread is None else point_spread
    view, gains = View.of(view), _GAINS[balance]
    checks.instance("point_spread", law, PointSpread)
    models = [
        TypeModel(
            Water.jerlov(name), camera, kind, g, mu, law, view, vertical_depth, geometry, gains
        )
        for kind in (get_args(Surfaces) if surfaces == "auto" else (surfaces,))
        for name in JERLOV_TYPES
    ]
    # a medium that is made in inference mode could not be trained
    with one_thread(), torch.inference_mode(False), torch.no_grad():
        say("blurring the clean picture")
        widest = law.scale * _MOST_LENGTHS**law.exponent * law.law.pixels(geometry.size, view)
        widest = min(widest, _WIDEST_SIDES * max(geometry.size))
        sample = pictures.sample([law.shape], int(pixels), seed, widest)
        subset = sample.subsample(_START_PIXELS, seed)
        scouts = []
        for model in models:
            say(f"trying {model.name}")
            objective = Objective(model, subset)
            scouts.append((model, solve(objective, _start(objective))))
        best, end = min(scouts, key=lambda pair: pair[1].cost)
        say("learning the noise")
        weighed, _ = reweighed(Objective(best, sample), end.theta, pictures.clips)
        candidates = []
        for model, end in scouts:
            say(f"fitting {model.name}")
            objective = Objective(model, weighed)
            end = solve(objective, end.theta)
            candidates.append(FittedModel(objective, end, block_losses(objective, end.theta)))
        candidates.sort(key=lambda candidate: candidate.loss)
        winner = candidates[0]
        model, theta = winner.model, winner.solution.theta
        medium = model.medium(theta, _RESULT_TOLERANCE)
        setting = Setting(medium, view=view, color_space=color_space)
        result = result_of(winner, candidates, setting, pictures)
    water = model.water_of(theta)
    return replace(
        result,
        model=model.water.name if result.adequate else "no Jerlov type",
        notes=(*_notes(result, model, water.visibility()), *result.notes),
        water=water,
    )


def _notes(result: Fit, model: TypeModel, metres: float) -> list[str]:
    """Sentences on a type, or on none in a water in which one sees so far."""
    degrees = model.view.angle(model.geometry.size[1])
    residual = (
        f"The residual is {result.rms:.2g} RMS of linear light. Camera, g, μ, {model.surfaces} "
        f"surfaces and a view {degrees:.3g}° wide (--view, --focal-px) are taken for known."
    )
    if result.adequate:
        equals = [x.name for x in result.candidates[1:] if x.behind <= x.behind_error]
        comparison = f"Within one standard error of it: {'; '.join(equals) or 'no other'}."
        notes = [f"Jerlov type {model.name} surfaces. {comparison}", residual]
        times = result.parameters["contents"].value or 1.0
        if not 1 / _FAR_CONTENTS < times < _FAR_CONTENTS:
            notes.append(
                f"It has {times:.2g} times the type's contents, which is hardly that type."
            )
        return notes
    none = (
        "No Jerlov type explains the picture. In what comes nearest one sees about "
        f"{metres:.2g} m far; `uwaug.fit` (--model auto) tells rates of each colour without a type."
    )
    return [none, residual]


def _start(objective: Objective[TypeModel]) -> Array:
    """The best θ of a grid of visibilities and depths, with gains by linear least squares."""
    model, pixels = objective.model, objective.pixels
    observed = pixels.observed * pixels.weights
    trials = []
    for visibility in _START_VISIBILITIES * model.geometry.reference:
        contents = max(model.water.contents_for(_VISIBLE_CONTRAST, visibility), _MIN_CONTENTS)
        for depth in _START_DEPTHS if model.depth is None else (model.depth,):
            numbers = {"contents": math.log(contents), "vertical_depth": depth}
            theta = np.clip([numbers.get(name, 0.0) for name in model.bounds], *objective.bounds)
            light = model.render(theta, pixels) * pixels.weights
            products = (light * observed).reshape(len(model.gains), -1).sum(1)
            squares = light.square().reshape(len(model.gains), -1).sum(1).clamp(min=1e-300)
            gains = (products / squares).clamp(1 / MAX_GAIN, MAX_GAIN)
            theta[-len(gains) :] = gains.log().numpy()
            trials.append((float(loss(objective.residual(theta)).sum()), theta))
    return min(trials, key=lambda trial: trial[0])[1]
