"""What fits make of Monte Carlo pictures: tests/data/monte_carlo.npz, three waters, two distances
each, without a veil.
"""

import json
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.accuracy.physics import CALIBRATED, PICTURES
from uwaug.fitting import Fit, fit
from uwaug.fitting.models import COLOURS
from uwaug.formation.model import form_image
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

Results = dict[str, Any]


def transport(quick: bool) -> Results:
    """Fit each water, print, return."""
    with np.load(PICTURES) as data:
        texture = torch.from_numpy(data["J"].astype(float)).expand(3, -1, -1)
        seen = torch.from_numpy(data["DF"].astype(float))
        cases = json.loads(str(data["params"]))
    results: Results = {}
    for first in (2,) if quick else (0, 2, 4):
        pair = cases[first : first + 2]
        name = f"a {pair[0]['a']:g}, b {pair[0]['b']:g}"
        pictures = [seen[first + k].expand(3, -1, -1) for k in (0, 1)]
        results[name] = _one_water(texture, pictures, pair, quick=quick)
        _print_water(name, results[name])
    return results


def _one_water(
    texture: Tensor, pictures: list[Tensor], cases: list[Results], *, quick: bool
) -> Results:
    distances = [_distance(case) for case in cases]
    no_veil = {f"veil_{colour}": 0.0 for colour in COLOURS}
    a, b, focal = (cases[0][name] for name in ("a", "b", "focal_px"))
    row: Results = {
        "distances": [case["z"] for case in cases],
        "truth": {"a": a, "b": b},
        "noise_floor": [case["noise"] for case in cases],
        "known_law": _known_law(texture, pictures, distances, cases),
        "fits": {},
    }
    models = ("auto", "exponential", "gaussian", "calibrated")
    for model in models[1:2] if quick else models:
        found = fit(
            texture,
            pictures,
            distances,
            model=model,
            fixed=no_veil,
            color_space="linear",
            focal_px=focal,
        )
        row["fits"][model] = _judged(found, a, b, focal, row["noise_floor"])
    return row


def _distance(case: Results) -> Tensor:
    offset = torch.arange(128).double() - 63.5
    f = case["focal_px"]
    return case["z"] * torch.sqrt(1 + (offset[:, None] / f) ** 2 + (offset / f) ** 2)[None]


def _known_law(
    texture: Tensor, pictures: list[Tensor], distances: list[Tensor], cases: list[Results]
) -> list[float]:
    """The residual of the calibrated law with the true coefficients, noise taken out."""
    found = []
    for picture, z, case in zip(pictures, distances, cases, strict=True):
        a, b = case["a"], case["b"]
        law = PointSpread.calibrated(case["focal_px"])
        rates = ((a + b,) * 3, (a + CALIBRATED.g * b,) * 3)
        medium = Medium.from_coefficients(*rates, (0,) * 3, b_mean=b, point_spread=law)
        residual = form_image(texture, z, medium, tolerance=1e-4).image - picture
        found.append(_beyond(residual, case["noise"]))
    return found


def _beyond(residual: Tensor, noise: float) -> float:
    """RMS of what is no noise."""
    return max(float(residual.square().mean()) - noise**2, 0.0) ** 0.5


def _judged(found: Fit, a: float, b: float, focal: float, floor: list[float]) -> Results:
    structure = found.fitted
    natural = structure.coefficients(torch.from_numpy(found.theta))
    beta, G = float(natural.beta[0, 1]), float(natural.G[0, 1])
    assert natural.width is not None
    assert natural.exponent is not None
    exponent = float(natural.exponent[0])
    lengths = b * structure.geometry.reference
    residuals = []
    for residual, noise in zip(found.residual, floor, strict=True):
        residuals.append(_beyond(residual[residual.isfinite()], noise))
    states = {name: one.state for name, one in found.parameters.items() if "at" in one.state}
    return {
        "model": found.model,
        "beta_of_truth": beta / (a + b),
        "G_of_beta": G / beta,
        "g": (G - a) / b,
        "width_at_one_length_of_focal": float(natural.width[0]) / lengths**exponent / focal,
        "exponent": exponent,
        "residual": residuals,
        "message": found.message,
        "at_bound": states,
    }


def _print_water(name: str, row: Results) -> None:
    print(f"{name} at {row['distances']} m: noise floor {_four(row['noise_floor'])}")
    print(f"  calibrated law, true coefficients: residual beyond noise {_four(row['known_law'])}")
    for model, one in row["fits"].items():
        print(
            f"  {model:12} {one['model']:12} β {one['beta_of_truth']:.3f} of truth, G/β "
            f"{one['G_of_beta']:.3f}, g {one['g']:.3f}, σ/f "
            f"{one['width_at_one_length_of_focal']:.4f}·(bz)^{one['exponent']:.2f}, residual "
            f"beyond noise {_four(one['residual'])} {one['at_bound'] or ''}"
        )


def _four(values: list[float]) -> str:
    return ", ".join(f"{value:.4f}" for value in values)
