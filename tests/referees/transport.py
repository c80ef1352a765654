"""A Monte Carlo random walk of light through water, and what it says of direct and scattered light.

Light is traced backwards: a photon leaves the camera along z through endless homogeneous water, is
scattered by the phase function, and ends where it first meets the endless plane at b·z scattering
lengths, which emits the same radiance in all directions. Absorption is a weight e^(−aL) of the path
L, so one walk serves every a/b.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jerlov
import numpy as np
from scipy.special import j0

LENGTHS = (0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0)  # b·z
ABSORPTION = (1.0, 0.4, 0.1)  # a/b: clear, coastal, turbid
SIZE, FOCAL = 512, 0.866 * 512  # px: a square picture of 60°
# cycles per unit tangent; equal steps of log f: equal power
FREQUENCIES = np.geomspace(FOCAL / SIZE, FOCAL / 2, 64)
EDGES = np.concatenate([[0.0], np.geomspace(1e-5, 1e3, 641)])  # of the histogram of tangents
TOGETHER = 20_000  # photons that walk at once

Array = np.ndarray[Any, np.dtype[np.float64]]
Sampler = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True)
class PhaseFunction:
    """Where one scattering sends light.

    Attributes:
        name: as printed.
        absorption: a/b of the waters to look at.
        sample: uniform numbers (N) to (cosine, sine) of the scattering angle.
    """

    name: str
    absorption: tuple[float, ...]
    sample: Sampler

    @property
    def mean_cosine(self) -> float:
        """⟨cos θ⟩."""
        return float(self.sample((np.arange(100_000) + 0.5) / 100_000)[0].mean())


def henyey_greenstein(asymmetry: float) -> PhaseFunction:
    """Henyey & Greenstein (1941), of mean cosine `asymmetry`, 0 < asymmetry < 1."""

    def sample(u: Array) -> tuple[Array, Array]:
        root = (1 - asymmetry**2) / (1 - asymmetry + 2 * asymmetry * u)
        cosine = np.clip((1 + asymmetry**2 - root**2) / (2 * asymmetry), -1, 1)
        return cosine, np.sqrt(1 - cosine**2)

    return PhaseFunction(f"HG {asymmetry}", ABSORPTION, sample)


def petzold(station: str) -> PhaseFunction:
    """Petzold (1972) as measured, log-log between angles; below 0.1° the power law of the first two
    angles, on which the report's own share of the light there rests.
    """
    measured = jerlov.petzold_scattering(station)
    known = np.log(np.radians(measured.angles_deg))
    grid = np.linspace(np.log(1e-10), np.log(np.pi), 20_001)
    logs = np.log(measured.vsf)
    slope = (logs[1] - logs[0]) / (known[1] - known[0])
    below = logs[0] + slope * (grid - known[0])
    vsf = np.exp(np.where(grid < known[0], below, np.interp(grid, known, logs)))
    ring = 2 * np.pi * vsf * np.sin(np.exp(grid)) * np.exp(grid)  # per unit of log θ
    share = np.concatenate([[0.0], np.cumsum((ring[1:] + ring[:-1]) / 2 * np.diff(grid))])
    held = share[-1]
    if abs(held / measured.b - 1) > 0.03:
        raise ValueError(f"the angles of {station} hold {held:.4f}/m of b = {measured.b:.4f}/m")
    share /= held

    def sample(u: Array) -> tuple[Array, Array]:
        angle = np.exp(np.interp(u, share, grid))
        return np.cos(angle), np.sin(angle)

    return PhaseFunction(station, (*ABSORPTION, round(measured.a / measured.b, 3)), sample)


@dataclass(frozen=True)
class Landings:
    """Scattered light that reached the plane at `lengths` = b·z.

    Attributes:
        tangent: of the angle under which the camera would see each landing point.
        path: in scattering lengths.
        weight: those of all photons sent sum to 1 − e^(−b·z).
    """

    lengths: float
    tangent: Array
    path: Array
    weight: Array


def walk(sample: Sampler, lengths: float, photons: int = 100_000, seed: int = 0) -> Landings:
    """Send photons, each made to scatter before the plane (what does not is e^(−cz) exactly)."""
    rng = np.random.default_rng(seed)
    parts = []
    for sent in range(0, photons, TOGETHER):
        parts.append(_walk(sample, lengths, min(TOGETHER, photons - sent), rng))
    tangent, path, weight = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Landings(lengths, tangent, path, weight * -np.expm1(-lengths) / photons)


def _walk(
    sample: Sampler, lengths: float, n: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Tangent, path and weight of every landing."""

    def strata() -> Array:
        numbers: Array = (rng.permutation(n) + rng.random(n)) / n
        return numbers

    path, angle, weight = -np.log1p(strata() * np.expm1(-lengths)), strata(), np.ones(n)
    at, to = np.zeros((3, n)), np.zeros((3, n))
    at[2], to[2] = path, 1.0
    landed = []
    while path.size:
        cosine, sine = sample(angle)
        to = turn(to, cosine, sine, rng.uniform(0, 2 * np.pi, path.size))
        step = rng.exponential(size=path.size)
        ends = at[2] + step * to[2] >= lengths
        x, y, z = at[:, ends]
        rest = (lengths - z) / to[2, ends]
        radius = np.hypot(x + rest * to[0, ends], y + rest * to[1, ends])
        landed.append((radius / lengths, path[ends] + rest, weight[ends]))
        stays = ~ends
        # what has come far carries little light: roulette in step with a = 0.1 b
        stays &= (path < 20) | (rng.random(path.size) < 0.9)
        weight = np.where(path < 20, weight, weight / 0.9)[stays]
        at, to, path = (at + step * to)[:, stays], to[:, stays], (path + step)[stays]
        angle = rng.random(path.size)
    tangent, total, weights = (np.concatenate(column) for column in zip(*landed, strict=True))
    return tangent, total, weights


def turn(to: Array, cosine: Array, sine: Array, azimuth: Array) -> Array:
    """Unit vectors (3, N) turned by an angle; the basis of Duff et al. (2017) is smooth about the z
    axis.
    """
    x, y, z = to
    sign = np.copysign(1.0, z)
    q = -1 / (sign + z)
    across, along = sine * np.cos(azimuth), sine * np.sin(azimuth)
    turned = cosine * to
    turned[0] += across * (1 + sign * x * x * q) + along * (x * y * q)
    turned[1] += across * (sign * x * y * q) + along * (sign + y * y * q)
    turned[2] -= across * (sign * x) + along * y
    turned /= np.sqrt((turned**2).sum(0))
    return turned


@dataclass(frozen=True, eq=False)
class Spread:
    """Light from the plane in a water of absorption a/b.

    Attributes:
        lengths, absorption: b·z, a/b.
        direct, forward: shares of the light.
        transfer: function of the scattered light at `FREQUENCIES`.
        encircled: share of the scattered light within each of `EDGES`[1:].
        figures: to print.
    """

    lengths: float
    absorption: float
    direct: float
    forward: float
    transfer: Array
    encircled: Array
    figures: dict[str, float]


def spread(landings: Landings, absorption: float) -> Spread:
    """Weigh a walk with absorption a/b.

    Figures: shares D, F; g from D + F = e^(−(a + g b) z), of an endless plane and of a disc of 10°
    and 3° radius; quantiles of the tangent; root mean square tangent within 45°; mean and deviation
    of its logarithm.
    """
    lengths, tangent = landings.lengths, landings.tangent
    weight = landings.weight * np.exp(-absorption * landings.path)
    direct, forward = float(np.exp(-(1 + absorption) * lengths)), float(weight.sum())

    def g(arrived: float) -> float:
        return float(-np.log(arrived) / lengths - absorption)

    figures = {"D": direct, "F": forward, "g": g(direct + forward)}
    for degrees in (10, 3):
        on_disc = tangent < np.tan(np.radians(degrees))
        figures[f"g_{degrees}deg"] = g(direct + weight[on_disc].sum())
    order = np.argsort(tangent)
    share = np.cumsum(weight[order]) / forward
    for percent in (10, 25, 50, 75, 90):
        figures[f"q{percent}"] = float(np.interp(percent / 100, share, tangent[order]))
    near = tangent < 1
    logs = np.log(np.maximum(tangent, 1e-9))
    centre = float(np.average(logs, weights=weight))
    figures["rms_45deg"] = float(np.sqrt(np.average(tangent[near] ** 2, weights=weight[near])))
    figures["log_mean"] = centre
    figures["log_deviation"] = float(np.sqrt(np.average((logs - centre) ** 2, weights=weight)))
    mass, _ = np.histogram(tangent, EDGES, weights=weight / forward)
    transfer = j0(2 * np.pi * np.multiply.outer(FREQUENCIES, (EDGES[1:] + EDGES[:-1]) / 2)) @ mass
    return Spread(lengths, absorption, direct, forward, transfer, np.cumsum(mass), figures)


def survey(phases: Sequence[PhaseFunction], photons: int) -> dict[str, list[Spread]]:
    """All phase functions at all `LENGTHS` and their own a/b."""
    result: dict[str, list[Spread]] = {}
    for phase in phases:
        walks = [walk(phase.sample, lengths, photons, seed) for seed, lengths in enumerate(LENGTHS)]
        found = result[phase.name] = []
        for absorption in phase.absorption:
            found += [spread(landings, absorption) for landings in walks]
    return result


def chosen(spreads: Sequence[Spread], lengths: float, absorption: float) -> Spread:
    """The one of these b·z and a/b."""
    return next(s for s in spreads if s.lengths == lengths and s.absorption == absorption)
