"""The published systems, each written out from its own equation: NumPy, loops over wavelengths, the
veil of a lamp summed along the ray, and an exact blur of each pixel.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from referees import reference
from referees.lamps import ASYMMETRY, beam
from referees.reference import BANDS, NIKON
from uwaug import Lamp
from uwaug.optics.camera import load_camera
from uwaug.optics.water import Water

Array = np.ndarray

LAMP = Lamp((-0.8, -0.5, 0.0), 10.0, (0.8, 0.5, 3.0), cone=50.0)


class Scene(NamedTuple):
    """J (3xHxW) is light as the system takes it; z (HxW), m."""

    J: Array
    z: Array


def bands(water: Water) -> list[tuple[float, float, float, Array]]:
    """a, b, K_d and the three responses of each wavelength."""
    camera, found = load_camera(NIKON), []
    rows = [np.interp(BANDS, camera.wavelengths, row) for row in camera.response.T]
    S = np.stack([row / row.sum() for row in rows])
    for i, wavelength in enumerate(BANDS):
        of = [np.interp(wavelength, water.wavelengths, x) for x in (water.a, water.b, water.kd)]
        found.append((*map(float, of), S[:, i, None, None]))
    return found


def scattered(scene: Scene, water: Water, exact: Callable[[Array, Array], Array]) -> Array:
    """The scene under the point spread of each pixel, σ = .3·b̄z px of a short side of 518 px."""
    mean_b = sum(b * S.mean() for _, b, _, S in bands(water))
    sigma = 0.3 * min(scene.z.shape) / 518 * mean_b * scene.z
    return exact(scene.J, sigma).reshape(scene.J.shape)


def rays(height: int, width: int) -> Array:
    """Unit vectors (3xHxW) of a view 60° wide."""
    focal = width / 2 / math.tan(math.radians(30))
    x = (np.arange(width) - (width - 1) / 2)[None].repeat(height, 0) / focal
    y = (np.arange(height) - (height - 1) / 2)[:, None].repeat(width, 1) / focal
    ray = np.stack([x, y, np.ones_like(x)])
    return ray / np.linalg.norm(ray, axis=0)


def lit(scene: Scene, water: Water, g: float, steps: int = 3000) -> tuple[Array, Array, Array]:
    """What a lamp sends to planes that face the camera, its distance, and its veil (3xHxW)."""
    ray, z = rays(*scene.z.shape), scene.z
    share, r = beam(LAMP, np.moveaxis(z * ray, 0, -1))
    facing = np.maximum(z * ray[2] - LAMP.position[2], 0) / r
    s = (np.arange(steps) + 0.5)[:, None, None] / steps * z
    flux, path = beam(LAMP, np.moveaxis(s * ray[:, None], 0, -1))
    # of light that comes from the lamp and goes to the camera
    cosine = -(s - np.tensordot(LAMP.position, ray, 1)) / path
    phase = (1 - ASYMMETRY**2) / (1 + ASYMMETRY**2 - 2 * ASYMMETRY * cosine) ** 1.5 / 4
    veil = np.zeros_like(scene.J)
    for a, b, _, S in bands(water):
        source = b * flux * phase * np.exp(-(a + g * b) * (s + path))
        veil += S * source.sum(0) * z / steps
    return share * facing, r, veil


def mcglamery(scene: Scene, water: Water, from_direct: bool = False, g: float = 0.05) -> Array:
    J, z = scene
    L, r, veil = lit(scene, water, g)
    D, weight = np.zeros_like(J), np.zeros_like(J)
    for a, b, _, S in bands(water):
        c, G = a + b, a + g * b
        arrives = S * L * np.exp(-G * r)
        D += arrives * np.exp(-c * z) * J
        forward = arrives * (np.exp(-G * z) - np.exp(-c * z))
        weight += forward * np.exp(-c * z) if from_direct else forward
    return D + weight * scattered(scene, water, reference.varying_exponential) + veil


def jaffe(scene: Scene, water: Water) -> Array:
    return mcglamery(scene, water, from_direct=True, g=0.2)


def schechner(scene: Scene, water: Water) -> Array:
    J, z = scene
    spread = scattered(scene, water, reference.varying_exponential)
    result = np.zeros_like(J)
    for a, b, kd, S in bands(water):
        c, G, E = a + b, a + 0.2 * b, math.exp(-kd)
        effective = E * (J + (np.exp(-G * z) - np.exp(-c * z)) * spread)
        result += S * (np.exp(-c * z) * effective + 0.3 * b * E / c * (1 - np.exp(-c * z)))
    return result


def revised(scene: Scene, water: Water, depth: float = 1.0) -> Array:
    """By the coefficients β^D and β^B, which change with distance."""
    J, z = scene
    lit, left, at_infinity, come = 0.0, 0.0, 0.0, 0.0
    for a, b, kd, S in bands(water):
        c, E = a + b, math.exp(-kd * depth)
        lit = lit + S * E
        left = left + S * E * np.exp(-c * z)
        at_infinity = at_infinity + S * b * E / c
        come = come + S * b * E / c * (1 - np.exp(-c * z))
    beta_D = np.log(lit / left) / z
    beta_B = -np.log(1 - come / at_infinity) / z
    return J * lit * np.exp(-beta_D * z) + at_infinity * (1 - np.exp(-beta_B * z))


def desai_2024(scene: Scene, water: Water) -> Array:
    return revised(scene, water, depth=5.0)


def liu(scene: Scene, water: Water) -> Array:
    return revised(scene, water, depth=0.0)


def desai_2021(scene: Scene, water: Water) -> Array:
    J, z = scene
    result = np.zeros_like(J)
    for a, b, kd, S in bands(water):
        c = a + b
        result += S * np.exp(-c * z) * J + S * b * math.exp(-kd) / c * (1 - np.exp(-c * z))
    return result


def ueda(scene: Scene, water: Water) -> Array:
    vertical, both = 0.0, 0.0
    for a, b, _, S in bands(water):
        vertical = vertical + S * math.exp(-(a + b))
        both = both + S * np.exp(-(a + b) * (1 + scene.z))
    horizontal = both / vertical
    B = np.array([0.45, 0.75, 0.75])[:, None, None]
    return scene.J * vertical * horizontal + B * vertical * (1 - horizontal)


def paper(scene: Scene, water: Water) -> Array:
    J, z = scene
    D, weight, B = np.zeros_like(J), np.zeros_like(J), np.zeros_like(J)
    for a, b, kd, S in bands(water):
        G, E = a + 0.2 * b, math.exp(-kd)
        D += S * E * np.exp(-(a + b) * z) * J
        weight += S * E * (np.exp(-G * z) - np.exp(-(a + b) * z))
        B += S * 0.3 * b * E / G * (1 - np.exp(-G * z))
    return D + weight * scattered(scene, water, reference.varying_gaussian) + B


SPECTRAL: dict[str, Callable[[Scene, Any], Array]] = {
    "mcglamery-1980": mcglamery,
    "jaffe-1990": jaffe,
    "schechner-2004": schechner,
    "akkaynak-2018": revised,
    "ueda-2019": ueda,
    "desai-2021": desai_2021,
    "liu-2022": liu,
    "desai-2024": desai_2024,
    "ismiroglou-2025": paper,
    "ismiroglou-reference-2025": revised,
}
LINEAR = ("ueda-2019", "ismiroglou-2025", "ismiroglou-reference-2025")
"""Those that take sRGB values for light."""
