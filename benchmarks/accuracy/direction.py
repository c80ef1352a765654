"""The referee of daylight's direction: a backward Monte Carlo walk in a plane-parallel sea under an
overcast sky, with Petzold's phase function of HAOCE 5, multiple scattering and Fresnel's surface.

`python -m benchmarks.accuracy.direction` prints the radiance of open water and of a grey wall at
five elevations, relative to a white vertical plate, beside the factors of `uwaug.light.direction`,
and writes results/direction.json.
"""

import math
from typing import Any

import numpy as np
import torch
from referees.transport import Array, Sampler, petzold

from benchmarks.harness import command, save, use_threads
from uwaug import Water
from uwaug.light.direction import veil_factor
from uwaug.optics.view import WIDE

SEAS = (("II", 480), ("1C", 550), ("3C", 550))
"""Jerlov type and wavelength, nm."""

DEPTH = 8.0  # m
ELEVATIONS = (-45, -20, -10, 0, 10, 20, 45)  # degrees
WALLS = (1.0, 3.0, 10.0)  # m
REFLECTANCE = 0.5  # of a wall
REFRACTION = 1.34  # of water
FAINTEST = 1e-3  # weight below which a walk ends
ORDERS = 400  # of scattering, at most


def transmitted(cosine: Array) -> Array:
    """Fresnel's share of light that leaves water at an angle to the vertical; 0 beyond Snell's."""
    squared = REFRACTION**2 * (1 - cosine**2)
    above = np.sqrt((1 - squared).clip(0))
    inside = squared < 1
    cosine = np.where(inside, cosine, 1.0)
    across = (REFRACTION * cosine - above) / (REFRACTION * cosine + above)
    along = (cosine - REFRACTION * above) / (cosine + REFRACTION * above)
    return np.where(inside, 1 - (across**2 + along**2) / 2, 0.0)


def turned(direction: Array, cosine: Array, sine: Array, around: Array) -> Array:
    """Directions (Nx3) after scattering by an angle, turned about the old ones."""
    helper = np.where(abs(direction[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(direction, first)
    aside = first * np.cos(around)[:, None] + second * np.sin(around)[:, None]
    return direction * cosine[:, None] + aside * sine[:, None]


def radiance(
    a: float, b: float, sample: Sampler, direction: Array, wall: float, rng: np.random.Generator
) -> float:
    """Mean radiance, π = that of a white plate above the sea, that reaches the camera from given
    directions (Nx3, z upwards), with a wall across x at `wall` metres.
    """
    n = len(direction)
    x, z, w, total = np.zeros(n), np.full(n, -DEPTH), np.ones(n), 0.0
    for _ in range(ORDERS):
        step = rng.exponential(1 / (a + b), len(w))
        with np.errstate(divide="ignore", invalid="ignore"):
            to_top = np.where(direction[:, 2] > 0, -z / direction[:, 2], np.inf)
            to_wall = np.where(direction[:, 0] > 0, (wall - x) / direction[:, 0], np.inf)
        at_top = (to_top < step) & (to_top < to_wall)
        at_wall = (to_wall < step) & ~at_top
        step = np.where(at_top, to_top, np.where(at_wall, to_wall, step))
        x, z = x + step * direction[:, 0], z + step * direction[:, 2]
        through = transmitted(direction[:, 2].clip(0)) * at_top
        total += float((w * through).sum()) * REFRACTION**2
        # what is reflected at the surface, or by the wall, or scattered goes on
        w *= np.where(at_top, 1 - through, np.where(at_wall, REFLECTANCE, b / (a + b)))
        cosine, sine = sample(rng.uniform(size=len(w)))
        around = rng.uniform(0, 2 * np.pi, len(w))
        scattered = turned(direction, cosine, sine, around)
        up = np.sqrt(rng.uniform(size=len(w)))  # by Lambert's law
        aside = np.sqrt(1 - up**2)
        lambertian = np.stack([-up, aside * np.cos(around), aside * np.sin(around)], 1)
        mirrored = direction * [[1, 1, -1]]
        direction = np.where(
            at_top[:, None], mirrored, np.where(at_wall[:, None], lambertian, scattered)
        )
        x, z = np.where(at_wall, wall - 1e-9, x), np.where(at_top, -1e-9, z)
        goes_on = w > FAINTEST
        x, z, w, direction = x[goes_on], z[goes_on], w[goes_on], direction[goes_on]
        if not len(w):
            break
    return total / n


def sea(water: str, nm: int, walks: int) -> dict[str, Any]:
    """Open water and walls of a sea at all elevations."""
    spectra, rng = Water.jerlov(water), np.random.default_rng(0)
    a, b = (float(np.interp(nm, spectra.wavelengths, y)) for y in (spectra.a, spectra.b))
    sample = petzold("HAOCE 5").sample
    # irradiance of a vertical plate: the mean of radiance by Lambert's law
    along, around = np.sqrt(rng.uniform(size=walks)), rng.uniform(0, 2 * np.pi, walks)
    aside = np.sqrt(1 - along**2)
    before = np.stack([along, aside * np.cos(around), aside * np.sin(around)], 1)
    plate = radiance(a, b, sample, before, math.inf, rng)
    rows = {}
    for elevation in ELEVATIONS:
        angle = math.radians(elevation)
        ray = np.tile([[math.cos(angle), 0.0, math.sin(angle)]], (walks, 1))
        values = [radiance(a, b, sample, ray, wall, rng) / plate for wall in (math.inf, *WALLS)]
        rows[elevation] = [round(value, 3) for value in values]
    return {"a": a, "b": b, "open water, walls": rows}


def main(quick: bool = False) -> dict[str, Any]:
    """Measure, print and save."""
    use_threads(1)
    walks = 200 if quick else 40_000
    ray = torch.zeros(1, 1, 1, 1)
    factors = {e: round(float(veil_factor(float(e), ray, WIDE)), 2) for e in ELEVATIONS}
    print("here", factors)
    results: dict[str, Any] = {"factors": factors, "seas": {}}
    for water, nm in SEAS[: 1 if quick else None]:
        results["seas"][f"{water}, {nm} nm"] = rows = sea(water, nm, walks)
        level = rows["open water, walls"][0][0]
        shares = {e: round(row[0] / level, 2) for e, row in rows["open water, walls"].items()}
        print(water, nm, rows, "relative to level water", shares, flush=True)
    if not quick:
        print(save("direction", results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
