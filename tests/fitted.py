"""Pictures with a known water, to be fitted."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

import uwaug
from uwaug.fitting.data import Pictures
from uwaug.fitting.model import MODELS, CoefficientModel
from uwaug.fitting.solve import Objective
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear
from uwaug.presets.scene import motorcycle

COLOURS = ("red", "green", "blue")
TRUTH = {"beta": (0.62, 0.41, 0.48), "G": (0.30, 0.15, 0.20), "veil": (0.10, 0.28, 0.33)}
HAZE = {"G": TRUTH["beta"], "law": uwaug.PointSpread.none()}
"""No light is scattered forward."""


class Known(NamedTuple):
    """A scene, and as it is seen in a known water."""

    clean: Tensor  # 3xHxW, uint8
    observed: Tensor
    distance: Tensor  # 1xHxW


def medium(law: uwaug.PointSpread | None = None, **truth: Any) -> uwaug.Medium:
    """One of three exponentials."""
    numbers = {**TRUTH, **truth}
    law = uwaug.PointSpread(0.8, 0.9) if law is None else law
    return uwaug.Medium.from_coefficients(
        numbers["beta"], numbers["G"], numbers["veil"], b_mean=1.0, point_spread=law
    )


def scene(step: int = 7) -> tuple[Tensor, Tensor]:
    """The motorcycle (71×105) as bytes, and its distances."""
    whole = motorcycle()
    small = torch.nn.functional.avg_pool2d(whole.image[None], step)[0]
    h, w = small.shape[-2:]
    z = whole.distance[:, step // 2 :: step, step // 2 :: step][:, :h, :w]
    return (small * 255).round().to(torch.uint8), z


def as_bytes(light: Tensor, noise: float = 0.01, seed: int = 0) -> Tensor:
    """Linear light with noise, as a camera stores it."""
    generator = torch.Generator().manual_seed(seed)
    light = light + noise * torch.randn(light.shape, generator=generator, dtype=light.dtype)
    return (linear_to_srgb(light.clamp(min=0)).clamp(0, 1) * 255).round().to(torch.uint8)


def seen(
    water: uwaug.Medium, *, step: int = 7, noise: float = 0.01, seed: int = 0, gain: Any = 1.0
) -> Known:
    """The scene in a water, with noise in linear light, rounded to 8 bits."""
    clean, z = scene(step)
    light = srgb_to_linear(clean.double() / 255)
    image = gain * uwaug.form_image(light, z.double(), water, tolerance=1e-4).image
    return Known(clean, as_bytes(image, noise, seed), z)


def objective(
    known: Known, name: str = "haze", count: int = 2000, gain: bool = False
) -> Objective[CoefficientModel]:
    """One of the candidates, and pixels that it is to explain, with weights by a noise of .01; dark
    ones, where noise is clipped, have none.
    """
    pictures = Pictures.of(*known, "srgb")
    model = CoefficientModel(MODELS[name], pictures.geometry, gain)
    pixels = pictures.sample([model.spec.shape] if model.spec.shape else (), count, 0)
    lit = pixels.observed.mean(1, keepdim=True) > 0.05
    return Objective(model, replace(pixels, weights=pixels.weights * lit))


def errors(fit: Any, truth: Any = TRUTH, kinds: Any = ("beta", "G", "veil")) -> Any:
    """How far the numbers are off, in standard errors."""
    away = []
    for kind in kinds:
        for c, colour in enumerate(COLOURS):
            number = fit.parameters[f"{kind}_{colour}"]
            away.append((number.value - truth[kind][c]) / number.error)
    return np.array(away)


STONES = torch.linspace(0.8, 8.0, 90 * 120).reshape(1, 90, 120)
"""Distances of stones, m."""


def stones(darkest: float = 0.0) -> Tensor:
    """Patches of linear light (3x90x120), some of them black, at every distance."""
    generator = torch.Generator().manual_seed(1)
    patches = torch.rand(3, 18, 24, generator=generator) ** 2
    patches[:, torch.rand(18, 24, generator=generator) < 0.1] = 0
    light = patches.repeat_interleave(5, 1).repeat_interleave(5, 2)
    return darkest + (1 - darkest) * light


def veiled(water: uwaug.Medium, z: Tensor = STONES, darkest: float = 0.0, seed: int = 0) -> Tensor:
    """The stones in a water, as bytes."""
    return as_bytes(uwaug.form_image(stones(darkest), z, water).image, seed=seed)


def veil_water(veil: Any = (0.1, 0.35, 0.45), G: Any = (0.5, 0.35, 0.4)) -> uwaug.Medium:
    """A water of which the veil is to be found."""
    return uwaug.Medium.from_coefficients([rate + 0.1 for rate in G], G, veil)
