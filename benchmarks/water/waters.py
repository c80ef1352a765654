"""Which Jerlov water is it? What charts at known distances tell, and what they do not.

A chart's contrast, the slope of its greys' light against their reflectance, knows nothing of the
veil. Its logarithm is a gain of picture and colour, the chart's light (lognormal) and the logarithm
of what arrives: linear, so that ten types are compared without a search. Squares are of sigmas.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch

from benchmarks.water.patches import LIGHT_SD, Array, Patches, Some, fitted, greys, read
from uwaug import Medium, Water
from uwaug.fitting.model import COLOURS
from uwaug.optics.jerlov import JERLOV_TYPES

CAMERAS = ("Nikon 5100 (NPL)", "Sigma SDMerill (NPL)")
DEPTHS = np.arange(0.0, 31.0, 2.0)  # m
CONTENTS = np.geomspace(0.02, 40, 41)  # times those of a type
STEP, DARKEST = 0.25, 0.01  # m, near enough to a chart's distance; share of these pixels


class Contrasts(NamedTuple):
    """Of each chart (C)."""

    names: Some
    z: Array
    pictures: Some  # their numbers
    logarithms: Array  # Cx3: of the slopes
    errors: Array  # Cx3
    intercepts: Array  # Cx3: light of a surface that reflects nothing

    def explained(self, arriving: Array | None = None) -> tuple[float, Array, Array]:
        """Squares that are left where so much arrives (Cx3, logarithms); or rates (3) that explain
        it, and their covariance.
        """
        count, free = len(self.z), arriving is None
        gains = 3 * (self.pictures.max() + 1)
        rows = np.zeros((count, 3, gains + count + 3 * free))
        chart, colour = np.mgrid[:count, :3]
        rows[chart, colour, 3 * self.pictures[chart] + colour] = 1
        rows[chart, colour, gains + chart] = 1
        if free:
            rows[chart, colour, gains + count + colour] = -self.z[chart]
        values = self.logarithms if arriving is None else self.logarithms - arriving
        lights = np.eye(rows.shape[-1])[gains : gains + count] / LIGHT_SD
        design = np.vstack([(rows / self.errors[..., None]).reshape(3 * count, -1), lights])
        target = np.concatenate([(values / self.errors).ravel(), np.zeros(count)])
        answer = np.linalg.lstsq(design, target, rcond=None)[0]
        left, covariance = design @ answer - target, np.linalg.pinv(design.T @ design)
        return float(left @ left), answer[gains + count :], covariance[-3:, -3:]


def contrasts_of(patches: Patches) -> Contrasts:
    """Slopes and intercepts of light against reflectance, of shares of the light."""
    charts, chart = np.unique(patches.charts, return_inverse=True)
    pictures = np.unique(patches.pictures, return_inverse=True)[1]
    first = np.array([np.flatnonzero(chart == k)[0] for k in range(len(charts))])
    lines, spreads, misses = np.zeros((2, len(charts), 3)), np.zeros((len(charts), 3)), []
    for k, c in np.ndindex(len(charts), 3):
        wet, air = patches.wet[chart == k, c], patches.air[chart == k, c]
        design = np.stack([air, np.ones_like(air)], 1) / wet[:, None]
        lines[:, k, c] = np.linalg.lstsq(design, np.ones_like(wet), rcond=None)[0]
        spreads[k, c] = np.linalg.inv(design.T @ design)[0, 0] ** 0.5
        misses.append((len(wet) - 2, np.square(design @ lines[:, k, c] - 1).sum()))
    freedom, squares = np.array(misses).sum(0)
    errors = (squares / freedom) ** 0.5 * spreads / lines[0]
    return Contrasts(charts, patches.z[first], pictures[first], np.log(lines[0]), errors, lines[1])


def arrivals(name: str, camera: str, z: Array) -> Iterator[tuple[float, Array, Array]]:
    """Contents; and logarithms of the shares that arrive unscattered, and at all (Cx3)."""
    for contents in (1.0, *CONTENTS):
        water = Water.jerlov(name).with_contents(contents)
        for depth in DEPTHS:
            medium = Medium.from_water(water, camera, vertical_depth=depth, tolerance=0)
            curves = medium.curves(torch.from_numpy(z)[None, None, None])
            kinds = (curves.direct, curves.direct + curves.scatter)
            shares = [x[0, :, 0].T / medium.ambient() for x in kinds]
            yield contents, *(x.clamp(min=1e-12).log().numpy() for x in shares)


def types(charts: Contrasts, camera: str) -> dict[str, dict[str, float]]:
    """Squares of each type, as it is and with scaled contents: of the direct light, and of all."""
    table = {}
    for name in JERLOV_TYPES:
        waters = arrivals(name, camera, charts.z)
        rows = [(factor, *(charts.explained(x)[0] for x in both)) for factor, *both in waters]
        contents, *squares = np.array(rows).T
        row = table[name] = dict[str, float]()
        for kind, of in zip(("direct", "with scattered"), squares, strict=True):
            row[kind], row[f"{kind}, scaled"] = float(of[contents == 1].min()), float(of.min())
            row[f"{kind}, contents"] = float(contents[of.argmin()])
    return table


def dark(kit: Path, patches: Patches, charts: Contrasts) -> dict[str, Array]:
    """Darkest pixels at a chart's distance, of what its greys say of black: 1 or more of a veil."""
    rows = {}
    for path in sorted((kit / "charts/pictures").glob("*_distance.npz")):
        scene = path.name.removesuffix("_distance.npz")
        file = path.with_name(f"{scene}_lin16.png")
        picture = np.asarray(cv2.imread(str(file), cv2.IMREAD_UNCHANGED))
        z = np.load(path)["distance_m"].astype(np.float32)
        z = cv2.resize(z, picture.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        light = picture[..., ::-1] / 65535 @ patches.to_camera.T
        for name, metres, black in zip(charts.names, charts.z, charts.intercepts, strict=True):
            if name.startswith(f"{scene} "):
                near = light[abs(z - metres) < STEP]
                rows[str(name)] = np.quantile(near, DARKEST, axis=0) / black
    return rows


def shown(name: str, numbers: Iterable[float], digits: int = 3) -> None:
    """Print a row."""
    print(f"{name:34}", *(f"{number:8.{digits}f}" for number in numbers))


def main(kit: Path) -> dict[str, Any]:
    """Print the rates by two readings, what speaks against one veil, and the types."""
    torch.set_num_threads(1)
    patches = read(kit)
    charts, fit = contrasts_of(greys(patches)), fitted(greys(patches))
    numbers = [fit.parameters[f"beta_{colour}"] for colour in COLOURS]
    haze = [[x.value for x in numbers], [x.error for x in numbers]]
    squares, rates, covariance = charts.explained()
    differ = np.array([[1, 0, -1], [0, 1, -1]])
    errors, spread = (np.sqrt(np.diag(x)) for x in (covariance, differ @ covariance @ differ.T))
    print("rates of red, green, blue, 1/m, each with its standard errors")
    shown("contrasts", np.append(rates, errors))
    shown("  red − blue, green − blue", np.append(differ @ rates, spread))
    shown("one rate, one veil for all charts", np.concatenate(haze))
    darkest = dark(kit, patches, charts)
    for chart, share in darkest.items():
        shown(f"darkest pixels / {chart}", share, 2)
    print(f"squares; by a rate a colour {squares:.1f} of {charts.logarithms.size} contrasts")
    tables = {}
    for camera in CAMERAS:
        table = tables[camera] = types(charts, camera)
        print(camera, *table["I"], sep="; ")
        for name, row in table.items():
            shown(name, [*row.values()], 2)
    return {
        "contrasts": [rates.tolist(), errors.tolist()],
        "one veil": haze,
        "darkest": {chart: share.tolist() for chart, share in darkest.items()},
        "squares": squares,
        "types": tables,
    }
