"""The report of one fit, for the README."""

from typing import Any

import numpy as np

from benchmarks.accuracy.fitting_scenes import Truth, formed, photographed, view
from benchmarks.harness import ROOT
from uwaug._support.drawing import save
from uwaug.fitting import fit
from uwaug.optics.point_spread import PointSpread

SEED = 8
WATER = ((0.62, 0.41, 0.48), (0.30, 0.15, 0.20), (0.10, 0.28, 0.33))  # β, G, veil


def picture(quick: bool = False) -> dict[str, Any]:
    """Draw it; what it shows."""
    rng = np.random.default_rng(SEED)
    scene = view()
    beta, G, veil = (np.array(one) for one in WATER)
    truth = Truth("calibrated", beta, G, veil, PointSpread.calibrated(scene.focal_px))
    observed = photographed(formed(truth, scene), rng)
    model = "haze" if quick else "auto"
    found = fit(scene.srgb, observed, scene.distance, model=model, focal_px=scene.focal_px)
    figure = found.plot()
    if not quick:
        save(figure, ROOT / "benchmarks" / "figures" / "fit.jpg")
    return {"seed": SEED, "model": found.model, "rms": found.rms}
