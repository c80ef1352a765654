"""Patches of charts at known distances, and the water that explains them."""

import csv
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from uwaug.fitting import Fit, Patch, fit_patches

Array = NDArray[np.float64]
Some = NDArray[Any]  # names, numbers or a mask

GREYS = ("gray1", "gray2", "gray3", "gray4", "black")
LIGHT_SD = 0.3  # of the logarithm of a chart's light: charts are tilted, some in shade


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


def fitted(patches: Patches, model: Literal["haze", "veil"] = "haze") -> Fit:
    """The water of patches in camera space, with a light for each chart."""
    columns = patches.pictures, patches.charts, patches.z, patches.air, patches.wet
    rows = [
        Patch(picture, chart, z, tuple(air), tuple(wet))
        for picture, chart, z, air, wet in zip(*(x.tolist() for x in columns), strict=True)
    ]
    return fit_patches(rows, color_space="linear", model=model)
