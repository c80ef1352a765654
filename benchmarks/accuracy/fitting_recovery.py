"""Fits of random waters that are known: are the numbers right, and their errors?

`python -m benchmarks.accuracy.fitting_recovery` fits 200 pictures (250×370, 1 % noise, 8 bits),
then 100 smaller ones with .5 % noise for each way to store them, writes
results/fitting_recovery.json and prints the shares that matter.
"""

import io
import time
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.nn.functional import interpolate

from benchmarks.harness import command, save, use_threads
from uwaug.fitting import Fit, fit
from uwaug.fitting.model import COLOURS
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear
from uwaug.formation.image import form_image
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PAPER_SIDE, PointSpread
from uwaug.optics.scattering import Scattering
from uwaug.presets.scene import Scene, motorcycle

RUNS = 200
NOISE = 0.01  # standard deviation, of linear light
WIDTH = 370  # px, half of the scene
KINDS = ("exponential", "gaussian", "exponential", "narrow")
MAIN = ("beta", "G", "veil")
STORED, STORED_NOISE, STORED_WIDTH = 100, 0.005, 185  # runs, linear light, px
FRESH = 100  # the first seed of these: by lower ones the errors of JPEG were chosen
FILES: dict[str, int | None] = {"8 bits": None, "16 bits": None, "JPEG 95": 95, "JPEG 75": 75}

Array = np.ndarray[Any, np.dtype[np.float64]]
Row = dict[str, Any]


@lru_cache(maxsize=2)
def view(width: int = WIDTH) -> Scene:
    """The scene of the package, half as large and in linear light."""
    scene = motorcycle()
    height, whole = scene.image.shape[-2:]
    size = (round(height * width / whole), width)
    light, distance = (
        interpolate(x[None].double(), size, mode="area")[0]
        for x in (srgb_to_linear(scene.image.double()), scene.distance)
    )
    return Scene(light, distance, scene.view.resized(width / whole))


@dataclass(frozen=True, eq=False)
class Truth:
    """A water that is known: coefficients of the colours, and the width law."""

    beta: Array
    G: Array
    veil: Array
    law: PointSpread

    @property
    def b_mean(self) -> float:
        """Of the width law, as `fit` takes it."""
        return float((self.beta - self.G).mean() / (1 - Scattering.CALIBRATED.g))

    def numbers(self, reference: float) -> dict[str, float]:
        """By the names of `Fit.parameters`; widths are those at the `reference` distance."""
        found = {}
        for name in MAIN:
            for colour, value in zip(COLOURS, getattr(self, name), strict=True):
                found[f"{name}_{colour}"] = float(value)
        width = self.law.scale * (self.b_mean * reference) ** self.law.exponent
        return {**found, "width": width, "exponent": self.law.exponent}


def random_truth(kind: str, rng: np.random.Generator, scene: Scene) -> Truth:
    """A water that neither hides the scene nor leaves it as it is: .2 to 2.3 optical depths at the
    median distance; width laws are about the calibrated one, or ("narrow") the paper's.
    """
    beta = np.exp(rng.uniform(np.log(0.08), np.log(0.8), 3))
    G = beta * rng.uniform(0.1, 0.8, 3)
    veil = rng.uniform(0.05, 0.6, 3)
    known = PointSpread.calibrated().scale * scene.view.focal(scene.image.shape[-1])
    wider = known * float(np.exp(rng.uniform(-0.4, 0.4)))
    exponent, coefficient = float(rng.uniform(0.45, 0.8)), float(rng.uniform(0.3, 0.8))
    paper = min(scene.distance.shape[-2:]) / PAPER_SIDE
    # within 3^½·σ lies half of the light of an exponential, within 1.177 σ of a Gaussian
    law = {
        "exponential": PointSpread(wider, exponent, "exponential"),
        "gaussian": PointSpread(3**0.5 / 1.177 * wider, exponent),
        "narrow": PointSpread(coefficient * paper, 1.0),
    }[kind]
    return Truth(beta, G, veil, law)


def photographed(
    truth: Truth, scene: Scene, rng: np.random.Generator, noise: float = NOISE
) -> Tensor:
    """The picture with noise, sRGB."""
    rows = (torch.from_numpy(x) for x in (truth.beta, truth.G, truth.veil))
    water = Medium.from_coefficients(*rows, b_mean=truth.b_mean, point_spread=truth.law)
    light = form_image(scene.image, scene.distance, water, tolerance=1e-4).image
    noisy = light + noise * torch.from_numpy(rng.standard_normal(light.shape))
    return linear_to_srgb(noisy.clamp(0, 1))


def stored(picture: Tensor, kind: str) -> Tensor:
    """A picture as a file of `FILES` holds it."""
    if kind == "16 bits":
        return (65535 * picture).round() / 65535
    values = (255 * picture).round().to(torch.uint8)
    quality = FILES[kind]
    if quality is None:
        return values
    file = io.BytesIO()
    Image.fromarray(values.permute(1, 2, 0).numpy()).save(file, "JPEG", quality=quality)
    return torch.from_numpy(np.array(Image.open(file))).permute(2, 0, 1)


def recovered_from_files(seed: int, kind: str, pixels: int = 4000) -> Row:
    """As `recovered`, of two files of a kind and the right model."""
    rng, scene = np.random.default_rng(seed), view(STORED_WIDTH)
    truth = random_truth("exponential", rng, scene)
    wet = stored(photographed(truth, scene, rng, STORED_NOISE), kind)
    dry = stored(linear_to_srgb(scene.image), kind)
    began = time.perf_counter()
    options = {"model": "exponential", "pixels": pixels, "progress": False}
    found = fit(dry, wet, scene.distance, jpeg=FILES[kind], **options)
    row = {"kind": "exponential", "model": found.model, "numbers": _rows(truth, found)}
    return {**row, "seconds": time.perf_counter() - began}


def recovered(seed: int, pixels: int = 20_000) -> Row:
    """A run: its water, and of each number truth, value, standard error, interval, state."""
    rng, scene, kind = np.random.default_rng(seed), view(), KINDS[seed % len(KINDS)]
    truth = random_truth(kind, rng, scene)
    observed = stored(photographed(truth, scene, rng), "8 bits")
    began = time.perf_counter()
    clean = linear_to_srgb(scene.image)
    found = fit(clean, observed, scene.distance, pixels=pixels, progress=False)
    seconds = time.perf_counter() - began
    return {"kind": kind, "model": found.model, "seconds": seconds, "numbers": _rows(truth, found)}


def _rows(truth: Truth, found: Fit) -> dict[str, list[Any]]:
    rows, right_numbers = {}, truth.numbers(found.geometry.reference)
    if found.model in ("haze", "veil"):  # direct light and forward scatter are one, and fade with G
        right_numbers |= {f"beta_{colour}": right_numbers[f"G_{colour}"] for colour in COLOURS}
    for name, right in right_numbers.items():
        one = found.parameters.get(name)
        if one is not None:
            rows[name] = [right, one.value, one.error, one.low, one.high, one.state]
    return rows


def summarised(rows: list[Row]) -> dict[str, Any]:
    """The shares that matter."""
    within, covered, states = [], [], {}
    errors: dict[str, list[float]] = {name: [] for name in MAIN}
    for row in rows:
        for name, (right, value, error, low, high, state) in row["numbers"].items():
            states[state] = states.get(state, 0) + 1
            if low is not None:
                covered.append(low <= right <= high)
            if state == "free":
                within.append(abs(value - right) <= 2 * error)
                kind = name.partition("_")[0]
                if kind in errors:
                    errors[kind].append(abs(value - right) / right)
    right = [row["model"] == row["kind"].replace("narrow", "gaussian") for row in rows]
    return {
        "runs": len(rows),
        "numbers": len(covered),
        "covered_percent": 100 * float(np.mean(covered)),
        "within_2_errors_percent": 100 * float(np.mean(within)),
        "median_relative_error": {name: float(np.median(one)) for name, one in errors.items()},
        "states": states,
        "right_model_percent": 100 * float(np.mean(right)),
        "seconds": float(np.median([row["seconds"] for row in rows])),
    }


def main(quick: bool = False) -> None:
    """Run, print, save."""
    use_threads(1)
    rows = []
    for seed in range(1 if quick else RUNS):
        rows.append(recovered(seed, pixels=1000 if quick else 20_000))
        print(".", end="", flush=True)
    results = summarised(rows)
    print(f"\n{results}")
    results["files"] = {}
    for kind in FILES:
        seeds = range(FRESH, FRESH + (1 if quick else STORED))
        runs = [recovered_from_files(seed, kind) for seed in seeds]
        results["files"][kind] = summarised(runs)
        print(kind, results["files"][kind], flush=True)
    if not quick:
        print(save("fitting_recovery", results))


if __name__ == "__main__":
    command(main, __doc__)
