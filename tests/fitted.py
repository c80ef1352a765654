"""Pictures with a known water, to be fitted."""

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from uwaug.fitting.one_water import OneWater
from uwaug.fitting.pixels import Pair, gather
from uwaug.fitting.structure import MODELS, Geometry

import uwaug
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear
from uwaug.presets.scene import motorcycle

COLOURS = ("red", "green", "blue")
TRUTH = {"beta": (0.62, 0.41, 0.48), "G": (0.30, 0.15, 0.20), "veil": (0.10, 0.28, 0.33)}


class Known(NamedTuple):
    """A scene, and as it is seen in a known water."""

    clean: Tensor  # 3xHxW, uint8
    observed: Tensor
    distance: Tensor  # 1xHxW


def scene(step: int = 3) -> tuple[Tensor, Tensor]:
    """The motorcycle with every `step`-th pixel of a smoothed picture, sRGB, and its distances."""
    whole = motorcycle()
    small = torch.nn.functional.avg_pool2d(whole.image[None], step)[0]
    h, w = small.shape[-2:]
    return small, whole.distance[:, step // 2 :: step, step // 2 :: step][:, :h, :w]


def medium(law: uwaug.PointSpread | None = None, **truth: Any) -> uwaug.Medium:
    """One of three exponentials."""
    numbers = {**TRUTH, **truth}
    law = uwaug.PointSpread(2.0, 0.9) if law is None else law
    return uwaug.Medium.from_coefficients(
        numbers["beta"], numbers["G"], numbers["veil"], b_mean=1.0, point_spread=law
    )


def seen(
    water: uwaug.Medium, *, step: int = 3, noise: float = 0.01, seed: int = 0, gain: Any = 1.0
) -> Known:
    """The scene in a water, with noise in linear light, rounded to 8 bits."""
    clean, z = scene(step)
    stored = (clean * 255).round().to(torch.uint8)
    light = srgb_to_linear(stored.double() / 255)
    image = uwaug.form_image(light, z.double(), water, tolerance=1e-4).image
    generator = torch.Generator().manual_seed(seed)
    image = gain * image
    image = image + noise * torch.randn(image.shape, generator=generator, dtype=image.dtype)
    observed = (linear_to_srgb(image.clamp(min=0.0)).clamp(0, 1) * 255).round().to(torch.uint8)
    return Known(stored, observed, z)


def structure(name: str, pairs: int = 1, fixed: dict[str, float] | None = None) -> OneWater:
    """A candidate for a scene of 166 px, 3 m away."""
    geometry = Geometry(pairs, 166, 3.0, 4.5, 20.0, 300.0)
    return OneWater(MODELS[name], geometry, "fixed", 0.05, fixed or {})


def pair(known: Known) -> Pair:
    """As it is fitted."""
    clean, observed = (srgb_to_linear(one.double() / 255) for one in known[:2])
    return Pair(clean, observed, known.distance.double(), torch.ones_like(known.distance) > 0)


def pixels(known: Known, shapes: tuple[Any, ...] = ("gaussian", "exponential")) -> Any:
    """Two thousand of them."""
    return gather([pair(known)], shapes, 2000, np.random.default_rng(0))
