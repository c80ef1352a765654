"""A referee that shares nothing with the package: the model from its equations, in float64.

All 61 bands, and every pixel under its own point spread. On an axis that is continued by
half-sample mirror images the cosine waves stay cosine waves under any symmetric point spread, so
that the blur of one pixel is a weighted sum of the picture's cosine transform: exact, without
kernels, grids or plans.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.fft import dctn, idct
from scipy.optimize import brentq

WIDTHS = np.exp(np.arange(math.log(1e-4), math.log(1e7), 0.05))
"""px, of the Gaussians that an exponential mixes: at equal steps of a logarithm sums converge
faster than any power.
"""


class Water(NamedTuple):
    """Spectra at the bands, what the camera sees of each, and the numbers that go with them."""

    a: np.ndarray  # (N), 1/m
    b: np.ndarray
    kd: np.ndarray
    response: np.ndarray  # (3, N), rows sum to 1
    depth: float
    g: float
    mu: float

    def at(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Direct light, forward-scattered light and veil, each (3, H, W), at distances (H, W)."""
        light = np.exp(-self.kd * self.depth)
        lost = self.a + self.g * self.b
        direct = np.exp(-z[..., None] * (self.a + self.b)) * light
        signal = np.exp(-z[..., None] * lost) * light
        veil = self.mu * self.b / lost * (light - signal)
        seen = np.stack([direct, signal - direct, veil]) @ self.response.T
        return tuple(np.moveaxis(seen, -1, 1))

    def lengths(self, z: np.ndarray) -> np.ndarray:
        """Scattering lengths b̄·z."""
        return float((self.response @ self.b).mean()) * z


class Law(NamedTuple):
    """σ = scale·(b̄ z)^exponent, px."""

    scale: float
    exponent: float
    shape: str


def terms(
    J: np.ndarray, z: np.ndarray, water: Water, law: Law
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Direct, forward and backscatter of a picture (3, H, W) at distances (H, W), finite."""
    direct, scatter, veil = water.at(z)
    sigma = law.scale * water.lengths(z) ** law.exponent
    return direct * J, scatter * blurred(J, sigma, law.shape), veil


def blurred(image: np.ndarray, sigma: np.ndarray, shape: str) -> np.ndarray:
    """(C, H, W), every pixel under the width that (H, W) `sigma` gives it."""
    _, h, w = image.shape
    waves = dctn(image, axes=(1, 2), norm="ortho")
    down, across = (idct(np.eye(size), axis=0, norm="ortho") for size in (h, w))
    transfer = gaussian if shape == "gaussian" else exponential
    out = np.empty_like(image)
    for y in range(h):
        for x in range(w):
            left = waves * transfer(float(sigma[y, x]), h, w)
            out[:, y, x] = down[y] @ left @ across[x]
    return out


def gaussian(sigma: float, h: int, w: int) -> np.ndarray:
    """What a sampled Gaussian of variance σ² leaves of each cosine wave."""
    return np.outer(axis(sigma, h), axis(sigma, w))


def exponential(sigma: float, h: int, w: int) -> np.ndarray:
    """What e^(−2πσf) leaves. Below 2 px, what samples can hold: the mixture of sampled Gaussians of
    widths σ/|N(0, 1)|.
    """
    if sigma >= 2:
        f = np.hypot(np.arange(h)[:, None] / (2 * h), np.arange(w) / (2 * w))
        return np.exp(-2 * math.pi * sigma * f)
    x = sigma / WIDTHS  # |N(0, 1)| distributed
    shares = x * np.exp(-0.5 * x**2)
    down, across = mixed(h), mixed(w)
    return (down * (shares / shares.sum())[:, None]).T @ across


@lru_cache
def mixed(size: int) -> np.ndarray:
    """`axis` at each of `WIDTHS`."""
    return np.array([axis(float(width), size) for width in WIDTHS])


def axis(sigma: float, size: int) -> np.ndarray:
    """What a sampled Gaussian leaves of the cosine waves of an axis of `size` samples."""
    f = np.arange(size) / (2 * size)
    if sigma > 6:
        return np.exp(-2 * (math.pi * sigma * f) ** 2)
    n = np.arange(-60, 61)
    taps = kernel(sigma)
    return taps @ np.cos(2 * math.pi * np.outer(n, f))


@lru_cache(maxsize=10_000)
def kernel(sigma: float) -> np.ndarray:
    """121 samples of a Gaussian, scaled so that their own variance is σ²."""
    n = np.arange(-60, 61)

    def taps(parameter: float) -> np.ndarray:
        found = np.exp(-0.5 * (n / parameter) ** 2)
        return found / found.sum()

    def excess(parameter: float) -> float:
        return float(taps(parameter) @ n**2) - sigma**2

    if excess(0.03) >= 0:
        return 1.0 * (n == 0)
    return taps(float(brentq(excess, 0.03, 1.1 * sigma + 1)))
