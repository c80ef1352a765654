"""How far one sees through water, and how much of what is in it that takes."""

import math
from functools import cache, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from uwaug._support.types import Array

if TYPE_CHECKING:
    from uwaug.optics.water import Water

__all__ = ["contents_for", "contrast_at", "depth_of_light", "distance_to", "eye_on", "pure_inside"]

_VISIBLE = (400.0, 700.0)
"""nm."""

_NODES = 301
"""Wavelengths for the eye, 1 nm apart on a full range. The 61 bands of a medium would put the
visibility of type I 7e-4 off.
"""


def eye_on(water: "Water") -> tuple[Array, Array]:
    """Wavelengths of the water that are seen, and the eye's weights there, whose sum is 1."""
    low, high = water.wavelengths[[0, -1]].tolist()
    if low > _VISIBLE[1] or high < _VISIBLE[0]:
        cure = "give visibility() a wavelength"
        raise ValueError(f"{water} has no wavelength in 400–700 nm: {cure}")
    return _eye(low, high)


def pure_inside(water: "Water") -> Array:
    """a, b and K_d (3, N) of the pure sea water in a water."""
    nm = water.wavelengths
    if nm[0] < 300 or nm[-1] > 800:
        cure = "resample with .at() first"
        raise ValueError(f"pure water is tabulated at 300–800 nm, but {water} leaves it: {cure}")
    absorption, scattering = _pure_water(nm.tobytes())  # an array is no key
    a, b = np.minimum(water.a, absorption), np.minimum(water.b, scattering)
    return np.array([a, b, np.minimum(water.kd, a + b / 2)])


def contents_for(water: "Water", contrast: float, metres: float) -> float:
    """The factor s of `Water.with_contrast`; 0 if pure water leaves no more, infinity if no factor
    will do.
    """
    nodes, weights = eye_on(water)
    a, b, _ = pure_inside(water)
    still = np.interp(nodes, water.wavelengths, a + b)
    seen = weights * np.exp(still * -metres)
    if float(seen.sum()) <= contrast:
        return 0.0
    contents = np.interp(nodes, water.wavelengths, water.a + water.b - (a + b))
    return distance_to(contrast, seen, contents * metres)


def contrast_at(water: "Water", beta: Array, metres: float) -> float:
    """The luminance contrast that is left at a distance in a water of this β."""
    nodes, weights = eye_on(water)
    return float((weights * np.exp(np.interp(nodes, water.wavelengths, beta) * -metres)).sum())


def depth_of_light(water: "Water", share: float) -> float:
    """The vertical depth at which this share of the surface's luminance is left."""
    nodes, weights = eye_on(water)
    return distance_to(share, weights, np.interp(nodes, water.wavelengths, water.kd))


def distance_to(contrast: float, weights: Array, rates: Array) -> float:
    """The z ≥ 0 at which Σ weights·e^(−rates·z) falls to `contrast`; inf if it never does."""
    if weights[rates <= 0].sum() >= contrast:
        return math.inf
    # the logarithm of the sum is convex and falls, so Newton's steps from 0 never overshoot
    fading = weights * rates
    z, step = 0.0, math.inf
    while step > 1e-15 * z:
        left = np.exp(-rates * z)
        seen = float(weights @ left)
        step = math.log(seen / contrast) * seen / float(fading @ left)
        z += step
    return z


@lru_cache(maxsize=16)
def _eye(low: float, high: float) -> tuple[Array, Array]:
    nodes = np.linspace(max(low, _VISIBLE[0]), min(high, _VISIBLE[1]), _NODES)
    weights = np.interp(nodes, *_observer())
    return nodes, weights / weights.sum()


@cache
def _observer() -> tuple[Array, Array]:
    """The CIE 1931 observer: wavelengths and ȳ."""
    import jerlov

    wavelengths, xyz = jerlov.cie_1931_cmf()
    return wavelengths, xyz[:, 1]


@lru_cache(maxsize=16)
def _pure_water(axis: bytes) -> Array:
    """Absorption and scattering (2, N) of pure sea water at these wavelengths."""
    import jerlov

    nm = np.frombuffer(axis)
    return np.array([jerlov.pure_water_absorption(nm), jerlov.pure_water_scattering(nm)])
