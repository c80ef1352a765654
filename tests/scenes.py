"""Pictures, distances and media that tests share, the same at every call."""

from collections.abc import Callable

import numpy as np
import torch
from referees import reference
from torch import Tensor

from uwaug.blur.plan import BlurPlan
from uwaug.blur.stack import varying_blur
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water

LAW = PointSpread(1.2, 0.8)
CURVES = ("transmission", "signal", "backscatter")
# m; finer near 0, where curves bend
Z = np.concatenate([[0.0], np.geomspace(1e-4, 1, 200), np.linspace(1, 20, 200)[1:]])
SIZES = [(1, 1), (1, 9), (9, 1), (2, 3), (7, 5), (33, 31), (64, 48)]


def rand(*shape: int, dtype: torch.dtype = torch.float64, seed: int = 0) -> Tensor:
    """Numbers 0…1 from a seed."""
    return torch.rand(*shape, dtype=dtype, generator=torch.Generator().manual_seed(seed))


def picture(height: int = 32, width: int = 40, batch: int = 1) -> Tensor:
    """Pictures in single precision, 0…1."""
    images = np.stack([reference.picture(height, width, seed) for seed in range(batch)])
    return torch.from_numpy(images).clamp(0, 1).float()


def distances(height: int = 32, width: int = 40, batch: int = 1) -> Tensor:
    """Distances in single precision, each pixel by itself, m."""
    return 0.5 + 5 * rand(batch, 1, height, width, dtype=torch.float32, seed=1)


def stepped(*shape: int, far: float = 6.0, seed: int = 1) -> Tensor:
    """Distances in double precision, with steps as a scene has them, m."""
    coarse = rand(shape[0], 1, 3, 4, seed=seed)
    steps = torch.nn.functional.interpolate(coarse, shape[-2:], mode="nearest")
    return 0.3 + (far - 0.5) * steps + 0.2 * rand(*shape, seed=seed)


def coefficients(seed: int = 3, law: PointSpread = LAW) -> Medium:
    """A medium of random coefficients."""
    beta, share, veil, light = rand(4, 3, seed=seed)
    beta = 0.3 + beta
    G = beta * (0.1 + 0.4 * share)
    return Medium.from_coefficients(beta, G, veil, b_mean=0.7, light=light, point_spread=law)


def uniform(
    beta: float, G: float, veil: float = 0.3, b_mean: float = 0.7, law: PointSpread = LAW
) -> Callable[[], Medium]:
    """What makes a medium that is the same in all channels."""
    return lambda: Medium.from_coefficients(
        (beta,) * 3, (G,) * 3, (veil,) * 3, b_mean=b_mean, point_spread=law
    )


def coastal(**options: object) -> Medium:
    return Medium.from_water(Water.jerlov("3C"), **{"point_spread": LAW, **options})


def two_waters() -> Medium:
    """Each with a width law of its own."""
    laws = {"I": (1.2, 0.8), "9C": (2.0, 0.7)}
    media = []
    for name, (scale, exponent) in laws.items():
        law = PointSpread(scale, exponent)
        media.append(Medium.from_water(Water.jerlov(name), point_spread=law))
    return Medium.stack(media)


MEDIA = {
    "water": coastal,
    "spectral": lambda: coastal(surfaces="spectral"),
    "no blur": lambda: coastal(point_spread=PointSpread.none()),
    "coefficients": coefficients,
    "batch": two_waters,
}


def errors(medium: Medium, water: Water, z: np.ndarray = Z, **numbers: float) -> list[float]:
    """How far each of a medium's curves is at most from the integral over the spectrum."""
    exact = reference.spectral_curves(water, z, **numbers)
    found = []
    for name, curve in zip(CURVES, exact, strict=True):
        ours = getattr(medium, name)(torch.from_numpy(z))[0].numpy()
        found.append(float(np.abs(ours - curve).max()))
    return found


def constant(image: Tensor, sigma: float, plan: BlurPlan) -> Tensor:
    """Every pixel under the same width."""
    widths = image.new_full((len(image), 1, *image.shape[-2:]), sigma)
    return varying_blur(image, widths, plan)
