"""Pictures in waters that are known, for the benchmarks of fits."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from uwaug.fitting import Fit
from uwaug.fitting.data import Observations
from uwaug.fitting.least_squares import Objective, guess
from uwaug.fitting.models import COLOURS, MODELS, CoefficientModel
from uwaug.formation.colour import linear_to_srgb, to_light
from uwaug.formation.model import form_image
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PAPER_SIZE, PointSpread
from uwaug.optics.scattering import Scattering
from uwaug.presets.scene import motorcycle

NOISE = 0.01  # standard deviation, of linear light
SHARE = Scattering.CALIBRATED.g  # as `fit` takes it
HALF = 370  # px, width of half of the scene
WHOLE = 741

Array = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True, eq=False)
class View:
    """The motorcycle: picture (3xHxW) in linear light and in sRGB, distance (1xHxW, m)."""

    light: Tensor
    srgb: Tensor
    distance: Tensor
    focal_px: float


@lru_cache(maxsize=2)
def view(width: int = HALF) -> View:
    """The scene of the package, whole or smaller."""
    scene = motorcycle()
    light = to_light(scene.image.double(), "srgb")
    height, whole = light.shape[-2:]
    size = (round(height * width / whole), width)
    small = interpolate(light[None], size, mode="area")[0]
    distance = interpolate(scene.distance[None].double(), size, mode="area")[0]
    return View(small, linear_to_srgb(small), distance, scene.focal_px * width / whole)


@dataclass(frozen=True, eq=False)
class Truth:
    """A water that is known.

    Attributes:
        kind: the name of the model that it is of.
        beta, G, veil: of the colours.
        law: the width law; None if no light is scattered forward.
    """

    kind: str
    beta: Array
    G: Array
    veil: Array
    law: PointSpread | None

    @property
    def b_mean(self) -> float:
        """Of the width law, as `fit` takes it."""
        share = Scattering.PAPER.g if self.kind == "paper" else SHARE
        return float((self.beta - self.G).mean() / (1 - share))

    def numbers(self, reference: float) -> dict[str, float]:
        """By the names of `Fit.parameters`; widths are those at the `reference` distance."""
        found = {}
        for name in ("beta", "G", "veil"):
            for colour, value in zip(COLOURS, getattr(self, name), strict=True):
                found[f"{name}_{colour}"] = float(value)
        if self.law is not None:
            lengths = torch.tensor(self.b_mean * reference)
            found["width"] = float(self.law.sigma(lengths, None))
            found["exponent"] = float(self.law.exponent)
        return found


def random_truth(kind: str, rng: np.random.Generator, scene: View) -> Truth:
    """A water of a kind, that neither hides the scene nor leaves it as it is: .2 to 2.3 optical
    depths at the median distance.
    """
    beta = np.exp(rng.uniform(np.log(0.08), np.log(0.8), 3))
    G = beta * rng.uniform(0.1, 0.8, 3)
    veil = rng.uniform(0.05, 0.6, 3)
    if kind in ("attenuation", "haze"):
        G = beta
    if kind == "attenuation":
        veil = np.zeros(3)
    law = None
    if kind not in ("attenuation", "haze", "veil"):
        law = _random_law(kind, rng, scene)
    return Truth(kind, beta, G, veil, law)


def _random_law(kind: str, rng: np.random.Generator, scene: View) -> PointSpread:
    """The paper's law and the calibrated one as they are, others about them."""
    known = PointSpread.calibrated(scene.focal_px)
    paper = min(scene.distance.shape[-2:]) / PAPER_SIZE
    wider = float(np.exp(rng.uniform(-0.4, 0.4)))
    exponent = float(rng.uniform(0.45, 0.8))
    coefficient = float(rng.uniform(0.3, 0.8))
    if kind == "paper":
        return PointSpread(0.3 * paper)
    if kind == "calibrated":
        return known
    if kind == "exponential":
        return PointSpread(known.scale * wider, exponent, "exponential")
    # "narrow" is a Gaussian about the paper's law
    if kind == "narrow":
        return PointSpread(coefficient * paper, 1.0)
    # within 3^½·σ lies half of the light of an exponential, within 1.177 σ of a Gaussian
    return PointSpread(3**0.5 / 1.177 * known.scale * wider, exponent)


def formed(truth: Truth, scene: View) -> Tensor:
    """The picture (3xHxW) in linear light, without noise."""
    beta, G, veil = (torch.from_numpy(one) for one in (truth.beta, truth.G, truth.veil))
    if truth.law is None:
        beta, G, veil = (one[:, None, None] for one in (beta, G, veil))
        direct = torch.exp(-beta * scene.distance) * scene.light
        return direct - veil * torch.expm1(-G * scene.distance)
    water = Medium.from_coefficients(beta, G, veil, b_mean=truth.b_mean, point_spread=truth.law)
    return form_image(scene.light, scene.distance, water, tolerance=1e-4).image


def photographed(light: Tensor, rng: np.random.Generator, noise: float = NOISE) -> Tensor:
    """With noise, in 8 bits of sRGB."""
    noisy = light + noise * torch.from_numpy(rng.standard_normal(light.shape))
    return (255 * linear_to_srgb(noisy.clamp(0, 1))).round().to(torch.uint8)


def problem_of(
    fit: Fit, name: str | None = None, light: Tensor | None = None, count: int = 20_000
) -> Objective[CoefficientModel]:
    """What `fit` has solved for its model, or for that of a `name`; `light`: to explain a picture
    (3xHxW) other than the observed one.
    """
    pairs = fit.pairs
    if light is not None:
        pairs = (pairs[0]._replace(observed=light),)
    model = fit.fitted
    if name is not None:
        spec = MODELS[name]
        model = CoefficientModel(spec, model.geometry, model.gain, spec.g, {})
    shapes = [] if model.shape is None else [model.shape]
    pixels = Observations(pairs, "srgb", 8, model.geometry.unit).sample_pixels(shapes, count, 0)
    now = model.render(fit.theta, pixels) if name is None else pixels.observed
    deviation = fit.noise.deviation(now, "srgb")
    inside = (now > 3 * deviation) & (now < 1 - 3 * deviation)
    return Objective(model, pixels.weighed(pixels.weights * inside / deviation))


def first_guess(problem: Objective[CoefficientModel]) -> Array:
    """Where `fit` begins."""
    model = problem.model
    return model.start(guess(model, problem.pixels), {})


def percent(values: Sequence[bool]) -> float:
    """How many are true."""
    return 100 * float(np.mean(values)) if len(values) else float("nan")
