"""Accuracy of the model's two parts, curves and blur.

`python -m benchmarks.accuracy.model` prints the tables and writes results/model.json.
"""

from typing import Any

import numpy as np
import torch

import uwaug
from benchmarks.exact import blur_exact
from benchmarks.harness import command, motorcycle, save
from uwaug.blur.plan import plan_blur
from uwaug.blur.stack import varying_blur
from uwaug.optics.spectra import WAVELENGTHS

MU = 0.3


def blur_accuracy(pixels: int = 3000) -> list[dict[str, Any]]:
    """PSNR of the stack against each pixel's own Gaussian, on the motorcycle scene."""
    image, depth = motorcycle()
    share = (depth - depth.min()) / (depth.max() - depth.min())
    at = torch.randperm(depth.numel(), generator=torch.Generator().manual_seed(0))[:pixels]
    rows = []
    for low, high in ((0.9, 4.5), (0.75, 15.0), (2.0, 60.0)):
        sigma = low + (high - low) * share
        exact = blur_exact(image[0], sigma[0, 0], at)
        for tolerance in (0.01, 0.002, 0.0005):
            plan = plan_blur(low, high, tolerance)
            error = varying_blur(image, sigma, plan)[0].flatten(1)[:, at] - exact
            psnr = -10 * float(torch.log10((error**2).mean()))
            blurs = len(plan.sigmas)
            row = {"sigma_px": [low, high], "tolerance": tolerance}
            rows.append({**row, "blurs": blurs, "psnr_db": psnr})
            print(rows[-1], flush=True)
    return rows


def curve_accuracy(tolerance: float = 0.002) -> list[dict[str, Any]]:
    """Rates chosen for each type and the largest error against the 61-band sums, over depths, g and
    any distance.
    """
    rows = []
    for name in uwaug.JERLOV_TYPES:
        found = []
        for depth in (0.0, 1.0, 10.0):
            for g in (0.0, 0.2, 1.0):
                found.append(_curve_error(name, depth, g, tolerance))
        worst = max(row["error"] for row in found)
        print(f"{name}: rates {[row['rates'] for row in found]}, worst {worst:.5f}", flush=True)
        rows += found
    return rows


def _curve_error(name: str, depth: float, g: float, tolerance: float) -> dict[str, Any]:
    near = torch.linspace(0, 20, 2001, dtype=torch.float64)
    z = torch.cat([near, torch.logspace(-6, 5, 1001, dtype=torch.float64)])
    water = uwaug.Water.jerlov(name).at(WAVELENGTHS)
    medium = uwaug.Medium.from_water(water, vertical_depth=depth, g=g, mu=MU, tolerance=tolerance)
    response = uwaug.load_camera("Nikon 5100 (NPL)").weights(WAVELENGTHS).T
    lit = response * np.exp(-water.kd * depth)
    rates = water.a + g * water.b
    fallen = np.exp(-np.multiply.outer(water.beta, z.numpy()))
    decay = np.exp(-np.multiply.outer(rates, z.numpy()))
    pairs = (
        (medium.transmission(z), lit @ fallen),
        (medium.signal(z), lit @ decay),
        (medium.backscatter(z), (lit * MU * water.b / rates) @ (1 - decay)),
    )
    errors = [float(np.abs(curve[0].numpy() - exact).max()) for curve, exact in pairs]
    counts = [medium.beta.shape[1], medium.G.shape[1]]
    return {"type": name, "depth_m": depth, "g": g, "rates": counts, "error": max(errors)}


def main(quick: bool = False) -> None:
    """Run both parts and save the figures."""
    results = {"blur": blur_accuracy(300 if quick else 3000), "curves": curve_accuracy()}
    if not quick:
        print(save("model", results))


if __name__ == "__main__":
    command(main, __doc__)
