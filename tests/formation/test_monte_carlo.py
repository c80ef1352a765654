"""The model against Monte Carlo radiative transfer of a plane in water (Henyey–Greenstein, mean
cosine .924).
"""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from uwaug import Medium, PointSpread, View, form_image


def error(law: PointSpread, g: float) -> float:
    """Mean RMSE of direct + forward light in six waters, the noise of the reference taken out."""
    with np.load(Path(__file__).parent.parent / "data" / "monte_carlo.npz") as data:
        texture = torch.from_numpy(data["J"].astype(np.float64))
        observed, cases = data["DF"].astype(np.float64), json.loads(str(data["params"]))
    offset = torch.arange(128).double() - 63.5
    errors = []
    for light, case in zip(observed, cases, strict=True):
        a, b, f = case["a"], case["b"], case["focal_px"]
        distance = case["z"] * torch.sqrt(1 + (offset[:, None] / f) ** 2 + (offset / f) ** 2)[None]
        rates = (a + b,) * 3, (a + g * b,) * 3, (0,) * 3
        medium = Medium.from_coefficients(*rates, b_mean=b, point_spread=law)
        view = View(focal_px=f)
        terms = form_image(texture.expand(3, -1, -1), distance, medium, view=view)
        off = (terms.direct + terms.forward)[0].numpy() - light
        errors.append(float(np.sqrt((off**2).mean() - case["noise"] ** 2)))
    assert len(errors) == 6
    return np.mean(errors)


def test_the_calibrated_law_the_papers_constants_and_what_the_blur_brings() -> None:
    g = 0.05  # goes with the calibrated law
    calibrated = error(PointSpread.calibrated(), g)
    assert calibrated <= 0.0125
    paper = error(PointSpread(0.3), 0.2)
    assert paper == pytest.approx(0.067, abs=0.002)
    assert paper > 5 * calibrated
    assert error(PointSpread.none(), 1.0) > error(PointSpread.none(), g) > 4 * calibrated
