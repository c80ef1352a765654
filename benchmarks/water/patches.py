"""Patches of charts at known distances, and the water that explains them by coefficients."""

import csv
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]
Some = NDArray[Any]  # names, numbers or a mask

GREYS = ("gray1", "gray2", "gray3", "gray4", "black")
LIGHT_SD = 0.3  # of the logarithm of a chart's light: charts are tilted, some in shade
ERROR = 0.05  # of a patch, as a share of its light
STARTS = (0.1, 0.3)  # rates, 1/m


class Patches(NamedTuple):
    """Patches (N) of charts. Light is linear; camera space is white-balanced raw."""

    pictures: Some
    charts: Some  # picture and chart
    names: Some
    z: Array  # m
    wet: Array  # Nx3, camera space
    air: Array  # Nx3, camera space
    shown: Array  # Nx3, sRGB, negative values lost
    truth: Array  # Nx3, sRGB
    to_camera: Array  # 3x3, of linear sRGB

    def of(self, inside: Some) -> Self:
        """Some of them."""
        return self._replace(**{name: getattr(self, name)[inside] for name in self._fields[:-1]})


def read(kit: Path) -> Patches:
    """The patches of a kit that can be used."""
    with (kit / "charts/patches.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["usable"] == "1"]

    def columns(kind: str) -> Array:
        return np.array([[float(row[f"{kind}_{colour}"]) for colour in "RGB"] for row in rows])

    wet, shown, truth = columns("cam"), columns("meas"), columns("ref")
    whole = shown.min(1) > 0.02  # nothing was cut off
    matrix = np.linalg.lstsq(shown[whole], wet[whole], rcond=None)[0].T
    return Patches(
        np.array([row["scene"] for row in rows]),
        np.array([f"{row['scene']} {row['chart']}" for row in rows]),
        np.array([row["patch"] for row in rows]),
        np.array([float(row["distance_m"]) for row in rows]),
        wet,
        truth @ matrix.T,
        shown,
        truth,
        matrix,
    )


def greys(patches: Patches) -> Patches:
    """The greys of charts that show three or more."""
    some = patches.of(np.isin(patches.names, GREYS))
    charts, counts = np.unique(some.charts, return_counts=True)
    return some.of(np.isin(some.charts, charts[counts >= 3]))


class Haze(NamedTuple):
    """Direct light and veil by coefficients of each colour, one water for several pictures."""

    beta: Array  # 3, 1/m
    G: Array  # 3, 1/m
    veil: Array  # 3, of a chart's light
    gains: dict[str, Array]  # of each picture, 3
    lights: dict[str, float]  # of each chart
    errors: Array  # 3, standard errors of β, 1/m
    squares: float  # sum of squared residuals, in sigmas, priors too

    def terms(self, z: Array) -> tuple[Array, Array]:
        """Share that arrives, and veil (Nx3)."""
        return np.exp(-self.beta * z[:, None]), self.veil * -np.expm1(-self.G * z[:, None])


def fit_haze(patches: Patches, *, two_rates: bool = False) -> Haze:
    """Rates and veils by least squares, with a gain of each picture and colour, a light a chart."""
    pictures, picture = np.unique(patches.pictures, return_inverse=True)
    charts, chart = np.unique(patches.charts, return_inverse=True)
    ends = np.cumsum([3, 3 * two_rates, 3, 3 * len(pictures), len(charts)])

    def haze(theta: Array) -> Haze:
        beta, G, veil, gains, lights = np.split(np.exp(theta), ends[:-1])
        each = dict(zip(pictures.tolist(), gains.reshape(-1, 3), strict=True))
        light = dict(zip(charts.tolist(), lights.tolist(), strict=True))
        return Haze(beta, G if two_rates else beta, veil, each, light, beta, 0.0)

    def residual(theta: Array) -> Array:
        water = haze(theta)
        arriving, veil = water.terms(patches.z)
        gains, lights = np.stack([*water.gains.values()]), np.array([*water.lights.values()])
        light = gains[picture] * (lights[chart, None] * arriving * patches.air + veil)
        misses = (light / patches.wet - 1) / ERROR
        return np.concatenate([misses.ravel(), theta[ends[3] :] / LIGHT_SD])

    ends_of = []
    for rate in STARTS:
        begin = np.zeros(ends[-1])
        begin[: ends[1]], begin[ends[1] : ends[2]] = np.log(rate), np.log(0.05)
        begin[ends[2] : ends[3]] = 1.5
        ends_of.append(least_squares(residual, begin, x_scale="jac", max_nfev=500))
    best = min(ends_of, key=lambda end: end.cost)
    water = haze(best.x)
    spread = np.sqrt(np.diag(np.linalg.pinv(best.jac.T @ best.jac)))[:3]
    return water._replace(errors=water.beta * spread, squares=2 * float(best.cost))
