"""What the tests of Underwater share."""

import numpy as np
import torch
from referees import reference
from torch import Tensor

from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water

LAW = PointSpread(1.2, 0.8)


def picture(height: int = 32, width: int = 40, batch: int = 1) -> Tensor:
    images = np.stack([reference.picture(height, width, seed) for seed in range(batch)])
    return torch.from_numpy(images).clamp(0, 1).float()


def distances(height: int = 32, width: int = 40, batch: int = 1) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return 0.5 + 5 * torch.rand(batch, 1, height, width, generator=generator)


def coastal(**kwargs: object) -> Medium:
    return Medium.from_water(Water.jerlov("3C"), **{"point_spread": LAW, **kwargs})


def per_image() -> Medium:
    return coastal(point_spread=PointSpread(torch.tensor([1.5]), torch.tensor([0.6])))


def from_coefficients(beta: tuple[float, ...] | Tensor, G: tuple[float, ...]) -> Medium:
    return Medium.from_coefficients(beta, G, (0.1, 0.3, 0.4), b_mean=0.3, point_spread=LAW)


def two_waters() -> Medium:
    """Each with a width law of its own."""
    laws = {"I": (1.2, 0.8), "9C": (2.0, 0.7)}
    media = []
    for name, (scale, exponent) in laws.items():
        law = PointSpread(torch.tensor([scale]), torch.tensor([exponent]))
        media.append(Medium.from_water(Water.jerlov(name), point_spread=law))
    return Medium.stack(media)


MEDIA = {
    "water": coastal,
    "clear": lambda: Medium.from_water(Water.jerlov("I")),
    "no blur": lambda: coastal(point_spread=PointSpread.none()),
    "exponent per image": per_image,
    "g = 1": lambda: coastal(g=1.0),
    "no veil": lambda: coastal(mu=0.0),
    "all bands": lambda: coastal(tolerance=0),
    "coefficients": lambda: from_coefficients((0.6, 0.3, 0.25), (0.4, 0.1, 0.0)),
    "float32": lambda: from_coefficients(torch.tensor([0.6, 0.3, 0.2]), (0.4, 0.1, 0.1)),
    "batch": two_waters,
}
