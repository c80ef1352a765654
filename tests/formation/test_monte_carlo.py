"""The model against Monte Carlo radiative transfer of a plane in water (Henyey–Greenstein, mean
cosine .924).
"""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from uwaug import Medium, PointSpread, View, form_image

G = 0.05  # goes with the calibrated law


def errors(law: PointSpread, g: float) -> list[float]:
    """RMSE of direct + forward light in six waters, the noise of the reference taken out."""
    with np.load(Path(__file__).parent.parent / "data" / "monte_carlo.npz") as data:
        texture = torch.from_numpy(data["J"].astype(np.float64))
        observed = data["DF"].astype(np.float64)
        cases = str(data["params"])
    offset = torch.arange(128).double() - 63.5
    found = []
    for light, case in zip(observed, json.loads(cases), strict=True):
        a, b, f = case["a"], case["b"], case["focal_px"]
        distance = case["z"] * torch.sqrt(1 + (offset[:, None] / f) ** 2 + (offset / f) ** 2)[None]
        beta, scatter = (a + b,) * 3, (a + g * b,) * 3
        medium = Medium.from_coefficients(beta, scatter, (0,) * 3, b_mean=b, point_spread=law)
        view = View(focal_px=f)
        terms = form_image(texture.expand(3, -1, -1), distance, medium, view=view)
        error = (terms.direct + terms.forward)[0].numpy() - light
        found.append(float(np.sqrt((error**2).mean() - case["noise"] ** 2)))
    return found


def test_the_calibrated_width_law() -> None:
    found = errors(PointSpread.calibrated(), G)
    assert len(found) == 6
    assert np.mean(found) <= 0.0125, found


def test_the_papers_constants_are_five_times_as_far() -> None:
    paper = np.mean(errors(PointSpread(0.3), 0.2))
    assert paper == pytest.approx(0.067, abs=0.002)
    assert paper > 5 * np.mean(errors(PointSpread.calibrated(), G))


def test_what_the_blur_brings() -> None:
    direct_only = np.mean(errors(PointSpread.none(), 1.0))
    unblurred = np.mean(errors(PointSpread.none(), G))
    assert direct_only > unblurred > 4 * np.mean(errors(PointSpread.calibrated(), G))
