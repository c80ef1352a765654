"""Surfaces with spectra: how near the three basis reflectances come to real ones.

Truth is the integral over 61 bands of the spectra of 24 patches of the ColorChecker and of 99
CIE 2017 samples: all light that arrives from them, without blur and veil, through the default
camera and its colour matrix M⁻¹. Every method begins with the colours of the samples that this
camera shows in air, and is right there.

    basis                    uwaug's `surfaces="spectral"`, every band kept
    one number a channel     of raw channels: M·J, times T_G of a grey surface, and M⁻¹ of that, so
                             that it has the matrix as well
    three wavelengths        the same with e^(−K_d d − G z) at 600, 550 and 450 nm
    one number, as published that number times J, and no matrix: what is there is compared with the
                             truth all the same

Errors are RMSE over channels and samples of a set, in units of the brightest channel of a white
plate at that place, where that has at least 1/64 of its light at the surface: no automatic exposure
makes up for more.
"""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure
from PIL import Image
from referees import spectral
from referees.spectral import BANDS, colour

from benchmarks.figures.charts import FIGURES, STYLE
from benchmarks.harness import command, save, use_threads
from uwaug import JERLOV_TYPES, Medium, Water
from uwaug.formation.colour import linear_to_srgb

DEPTHS = (0.0, 2.0, 5.0, 10.0, 25.0)  # m below the surface
DISTANCES = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)  # m to the camera
SCATTERING = {"g": 0.2, "mu": 0.3}
FAINTEST = 1 / 64  # of the light at the surface
WAVELENGTHS = (600.0, 550.0, 450.0)  # nm
BASIS, CHANNEL, THREE, PUBLISHED = (
    "basis",
    "one number a channel",
    "three wavelengths",
    "one number, as published",
)
SHOWN = ("red", "green", "light skin", "white 9.5 (.05 D)")
FIGURE = FIGURES / "surfaces.png"

Array = np.ndarray


def samples() -> dict[str, dict[str, Array]]:
    """Reflectances in 61 bands, by set and name."""
    checker = colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"]
    tables = {name: (patch.wavelengths, patch.values) for name, patch in checker.items()}
    patches = {name: np.interp(BANDS, *table) for name, table in tables.items()}
    natural = colour.quality.cfi2017.load_TCS_CIE2017(colour.SpectralShape(380, 780, 5))
    columns = zip(map(str, natural.labels), natural.values.T, strict=True)
    rows = {name: np.interp(BANDS, natural.wavelengths, values) for name, values in columns}
    return {"ColorChecker": patches, "CIE 2017": rows}


def seen(reflectances: Array, water: Water, depth: float, z: float) -> dict[str, Array]:
    """The colours (Nx3) of surfaces (Nx61) in a place, by each method; "truth" is one."""
    eye = spectral.eye()
    bands = spectral.bands_of(water, depth=depth, **SCATTERING)
    left = bands.light * np.exp(-bands.G * z)
    raw = np.linalg.inv(eye.matrix)
    in_air = reflectances @ eye.sensor.T @ eye.matrix.T
    medium = Medium.from_water(
        water, vertical_depth=depth, surfaces="spectral", tolerance=0, **SCATTERING
    )
    metres = torch.tensor(z, dtype=torch.float64)
    numbers = Medium.from_water(water, vertical_depth=depth, tolerance=0, **SCATTERING)
    grey = numbers.signal(metres)[0].numpy()
    monochrome = np.array([left[nm == BANDS][0] for nm in WAVELENGTHS])
    of_raw = in_air @ raw.T
    return {
        "truth": (reflectances * left) @ eye.sensor.T @ eye.matrix.T,
        BASIS: in_air @ medium.signal(metres)[0].numpy().T,
        CHANNEL: (of_raw * grey) @ eye.matrix.T,
        THREE: (of_raw * monochrome) @ eye.matrix.T,
        PUBLISHED: in_air * grey,
    }


def errors(reflectances: Array, waters: tuple[str, ...]) -> list[dict[str, Any]]:
    """RMSE of each method in each place where there is light."""
    rows = []
    for name in waters:
        for depth in DEPTHS:
            for z in DISTANCES:
                white = np.ones((1, 61))
                colours = seen(np.concatenate([white, reflectances]), Water.jerlov(name), depth, z)
                truth = colours.pop("truth")
                brightest = float(truth[0].max())
                if brightest < FAINTEST:
                    continue
                off = {
                    method: float(np.sqrt(np.square(found[1:] - truth[1:]).mean())) / brightest
                    for method, found in colours.items()
                }
                rows.append({"water": name, "depth_m": depth, "distance_m": z, "rmse": off})
    return rows


def summary(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Mean and worst of each method over the places, and where it is worst."""
    table: dict[str, dict[str, Any]] = {}
    for method in rows[0]["rmse"]:
        worst = max(rows, key=lambda row: row["rmse"][method])
        place = {key: worst[key] for key in ("water", "depth_m", "distance_m")}
        mean = float(np.mean([row["rmse"][method] for row in rows]))
        table[method] = {"mean": mean, "worst": worst["rmse"][method], "where": place}
    return table


def draw(path: Path | None) -> None:
    """Patches against depth, as a camera shows them whose exposure keeps the brightest channel of a
    white plate.
    """
    patches = samples()["ColorChecker"]
    depths = np.linspace(0, 30, 121)
    chosen = np.stack([patches[name] for name in SHOWN])
    white = np.ones((1, 61))
    rows = [seen(np.concatenate([white, chosen]), Water.jerlov("II"), d, 1.0) for d in depths]
    methods = {"truth": "truth, 61 bands", BASIS: "uwaug", CHANNEL: "one number a channel"}
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 3.3), dpi=110, layout="constrained")
        for n, (axis, name) in enumerate(
            zip(figure.subplots(len(SHOWN), sharex=True), SHOWN, strict=True), 1
        ):
            bands = []
            for method in methods:
                light = np.stack([row[method][n] for row in rows])
                exposure = np.array([0.8 / row["truth"][0].max() for row in rows])
                linear = torch.from_numpy(light * exposure[:, None])
                bands.append(linear_to_srgb(linear).clamp(0, 1).numpy())
            axis.imshow(np.stack(bands), extent=(0, 30, 3, 0), aspect="auto")
            axis.set_yticks([0.5, 1.5, 2.5], list(methods.values()))
            axis.set_title(name.partition(" 9")[0], loc="left", pad=2)
            axis.hlines([1, 2], 0, 30, "white", linewidth=0.8)
        axis.set_xlabel("depth in type II, m; 1 m from the camera, exposed for a white plate")
        if path is not None:
            figure.savefig(path)
            Image.open(path).convert("RGB").save(path, optimize=True)
        else:
            figure.draw_without_rendering()


def main(quick: bool = False) -> dict[str, Any]:
    """Measure, print and save."""
    use_threads(1)
    results: dict[str, Any] = {"errors": {}, "places": {}}
    for name, table in samples().items():
        reflectances = np.stack(list(table.values()))
        rows = errors(reflectances, JERLOV_TYPES[:2] if quick else JERLOV_TYPES)
        results["errors"][name], results["places"][name] = summary(rows), len(rows)
        print(name, results["errors"][name])
    draw(None if quick else FIGURE)
    if not quick:
        print(save("surfaces", results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
