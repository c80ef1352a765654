"""What a wrong model does to the numbers: no forward scatter, and errors made on purpose."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

import uwaug
from benchmarks.accuracy.fitting_scenes import (
    COLOURS,
    SHARE,
    Truth,
    View,
    formed,
    photographed,
    problem_of,
    view,
)
from uwaug.fitting import Fit, fit
from uwaug.fitting.errors import cluster_covariance
from uwaug.fitting.least_squares import solve
from uwaug.formation.model import form_image
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.scattering import Scattering
from uwaug.optics.water import JERLOV_TYPES, Water

MU = Scattering.CALIBRATED.mu
CONTRAST = 0.25  # that luminance keeps at the median distance
QUANTITIES = ("beta", "G", "veil")

Results = dict[str, Any]


def water_of(kind: str, scene: View) -> Water:
    """A Jerlov type in which the scene is seen: with so much in it that a quarter of the contrast
    is left at the median distance.
    """
    middle = float(scene.distance.median())
    return Water.jerlov(kind).with_contrast(CONTRAST, middle)


def spectral(kind: str, scene: View) -> Medium:
    """The water as it is."""
    law = PointSpread.calibrated(scene.focal_px)
    water = water_of(kind, scene)
    return Medium.from_water(water, vertical_depth=0.0, g=SHARE, mu=MU, point_spread=law)


def mean_water(kind: str, scene: View) -> Truth:
    """β, G and veil as the camera's channels have them on average: one rate for each."""
    every = Medium.from_water(
        water_of(kind, scene), vertical_depth=0.0, g=SHARE, mu=MU, tolerance=0
    )

    def mean(weights: Tensor, rates: Tensor) -> Any:
        return ((weights[0] * rates[0]).sum(1) / weights[0].sum(1)).numpy()

    beta, G = mean(every.direct_weights, every.beta), mean(every.signal_weights, every.G)
    veil = every.veil_weights[0].sum(1).numpy()
    return Truth("calibrated", beta, G, veil, PointSpread.calibrated(scene.focal_px))


def fitted_numbers(found: Fit) -> dict[str, list[float]]:
    """β, G and veil of the colours, as they were fitted, identified or not."""
    natural = found.fitted.coefficients(torch.from_numpy(found.theta))
    beta, G, source = natural.beta[0], natural.G[0], natural.veil_slope[0]
    veil = source / G.clamp(min=1e-9)
    rows = (("beta", beta), ("G", G), ("veil", veil))
    return {name: [float(f"{v:.5g}") for v in row.tolist()] for name, row in rows}


def without_forward_scatter(quick: bool) -> Results:
    """Fits with and without it, in each Jerlov type."""
    scene, results = view(), {}
    for i, kind in enumerate(("7C",) if quick else JERLOV_TYPES):
        truth = mean_water(kind, scene)
        rng = np.random.default_rng(i)
        observed = photographed(formed(truth, scene), rng)
        row: Results = {"truth": {}, "bias": {}, "not_free": {}}
        for name in QUANTITIES:
            row["truth"][name] = [float(f"{v:.5g}") for v in getattr(truth, name)]
        for model in ("veil", "exponential") if quick else ("veil", "exponential", "auto"):
            found = fit(scene.srgb, observed, scene.distance, model=model, focal_px=scene.focal_px)
            row[model] = {"model": found.model, **fitted_numbers(found)}
            row["bias"][model] = _bias(row["truth"], row[model])
            states = {name: one.state for name, one in found.parameters.items()}
            row["not_free"][model] = {k: v for k, v in states.items() if v != "free"}
        results[kind] = row
        _print_bias(kind, row)
    removed: Results = {}
    for name in QUANTITIES:
        before, after = [], []
        for row in results.values():
            for c, colour in enumerate(COLOURS):
                # what the full model cannot tell has no bias
                if f"{name}_{colour}" not in row["not_free"]["exponential"]:
                    before.append(row["bias"]["veil"][name][c])
                    after.append(row["bias"]["exponential"][name][c])
        sums = [float(np.abs(one).sum()) for one in (before, after)]
        medians = [float(np.median(np.abs(one))) for one in (before, after)]
        removed[name] = {
            "numbers": len(after),
            "median_without": medians[0],
            "median_with": medians[1],
            "of_sum_percent": 100 * (1 - sums[1] / sums[0]),
            "of_median_percent": 100 * (1 - medians[1] / medians[0]),
        }
        print(f"{name}: {removed[name]}")
    return {"waters": results, "removed": removed}


def _bias(truth: dict[str, list[float]], found: Results) -> dict[str, list[float]]:
    bias = {}
    for name in QUANTITIES:
        pairs = zip(found[name], truth[name], strict=True)
        bias[name] = [float(f"{value / right - 1:.4g}") for value, right in pairs]
    return bias


def _print_bias(kind: str, row: Results) -> None:
    for model, bias in row["bias"].items():
        cells = []
        for name in QUANTITIES:
            each = " ".join(f"{100 * v:+7.1f}" for v in bias[name])
            cells.append(f"{name} {each}")
        vague = ", ".join(f"{k} {v}" for k, v in row["not_free"][model].items())
        print(f"{kind:4}{model:12}bias %: {'; '.join(cells)} | {row[model]['model']} {vague}")


class Wrong(NamedTuple):
    """A picture that the model cannot explain, the distances that it is told, the numbers that it
    should find, and the water if these do not say all of it.
    """

    light: Tensor
    distance: Tensor
    truth: Truth
    factor: float = 1.0
    medium: Medium | None = None


def wrong_models(scene: View, *, quick: bool) -> dict[str, Wrong]:
    """Spectra, uneven water, wrong distances; and nothing wrong, to compare with."""
    z = scene.distance
    truth = mean_water("5C", scene)
    right = formed(truth, scene)
    found = {"nothing wrong": Wrong(right, z, truth)}
    if quick:
        return found
    found["distances 5 % long"] = Wrong(right, 1.05 * z, truth, 1.05)
    across = torch.linspace(-1, 1, z.shape[-1], dtype=z.dtype)
    found["distances ±5 % across"] = Wrong(right, z * (1 + 0.05 * across), truth)
    middle = z.median()
    stretched = middle * (z / middle) ** 1.05
    found["distances z^1.05"] = Wrong(right, stretched, truth)
    for span in (0.1, 0.3):
        generator = torch.Generator().manual_seed(0)
        shape = (1, *z.shape)
        field = uwaug.gaussian_random_field(
            shape, low=1 - span, high=1 + span, generator=generator, dtype=z.dtype
        )
        uneven = replace(scene, distance=z * field[0])
        found[f"field 1 ± {span:g}"] = Wrong(formed(truth, uneven), z, truth)
    for kind in ("IB", "III", "5C", "9C"):
        water = spectral(kind, scene)
        light = form_image(scene.light, z, water, tolerance=1e-4).image
        found[f"spectra of {kind}"] = Wrong(light, z, mean_water(kind, scene), medium=water)
    return found


def errors_on_purpose(quick: bool) -> Results:
    """How far the numbers are off, and whether the fit says so."""
    scene, results = view(), {}
    for i, (name, wrong) in enumerate(wrong_models(scene, quick=quick).items()):
        observed = photographed(wrong.light, np.random.default_rng(100 + i))
        found = fit(scene.srgb, observed, wrong.distance, model="exponential")
        row = judged(found, wrong)
        results[name] = row
        print(
            f"{name:24} errors × {row['widened']:.2f}, says so: {row['says_so']}, residual "
            f"{row['rms']:.4f}, noise {row['read']:.4f}, within 2 errors {row['within']} of "
            f"{row['numbers']}, farthest {row['farthest']:.1f}, median relative error of "
            f"β {100 * row['beta_off']:.2g} %"
        )
        if row["curves_off"]:
            cells = [f"{curve} {off:.4f}" for curve, off in row["curves_off"].items()]
            print(f"{'':24} largest error of curves: {', '.join(cells)}")
    return results


def judged(found: Fit, wrong: Wrong) -> Results:
    """What a fit says of its errors, and how far it is off."""
    problem = problem_of(found)
    end = solve(problem, found.theta, most=10)
    widened = cluster_covariance(problem, end).design_effect
    scores, off = [], []
    reference = found.fitted.geometry.reference / wrong.factor
    for name, right in wrong.truth.numbers(reference).items():
        one = found.parameters[name]
        rate = name.startswith(("beta", "G_"))
        if one.state == "free" and one.value is not None and one.error is not None:
            right = right / wrong.factor if rate else right
            scores.append(float((one.value - right) / one.error))
            if name in [f"beta_{colour}" for colour in COLOURS]:
                off.append(abs(one.value / right - 1))
    return {
        "widened": widened,
        "says_so": "depend on each other" in found.message,
        "rms": found.rms,
        "read": found.noise.read,
        "within": int(sum(abs(score) <= 2 for score in scores)),
        "numbers": len(scores),
        "farthest": float(max((abs(score) for score in scores), default=0.0)),
        "beta_off": float(np.median(off)) if off else 0.0,
        "scores": [round(score, 2) for score in scores],
        "message": found.message,
        "curves_off": None if wrong.medium is None else _curves_off(found, wrong.medium),
    }


def _curves_off(found: Fit, water: Medium) -> dict[str, float]:
    """Largest difference of T_β, T_G and veil in the distances of the scene, and to twice that."""
    near, far = found.fitted.geometry.reference, found.fitted.geometry.farthest
    rows = {}
    for name, end in (("inside", far), ("to twice", 2 * far)):
        z = torch.linspace(0.7 * near, end, 50, dtype=torch.float64)
        for curve in ("transmission", "signal", "backscatter"):
            ours, true = (getattr(medium, curve)(z) for medium in (found.medium, water))
            rows[f"{curve}, {name}"] = float((ours - true).abs().max())
    return rows
