"""No more than a scene needs: what the planner chose for ten waters and three ranges of distance, its cost, the true
error.

`python -m benchmarks.planner` prints the table and writes results/planner.json. Errors are of the image in linear light
on the motorcycle scene (500×741, its distances stretched to the range), against float64 with 61 bands and each pixel's
own point spread at 2000 pixels. The blur follows the law calibrated to a 60° view, the wide one with heavy tails; the
paper's law is skipped more often.
"""

import math
from typing import Any

import numpy as np
import torch
from scipy.fft import dctn, idctn
from torch import Tensor

import uwaug
from benchmarks.exact import blur_exact
from benchmarks.harness import command, motorcycle, race, save, use_threads
from uwaug.blur.demand import blur_demand
from uwaug.blur.plan import BlurPlan, plan_blur
from uwaug.colour import srgb_to_linear
from uwaug.optics.point_spread import Shape

RANGES = ((0.05, 1.0), (1.0, 5.0), (1.0, 20.0))
TOLERANCE = 0.002
LAWS = {
    "paper": lambda w: uwaug.PointSpread.paper(),
    "calibrated": lambda w: uwaug.PointSpread.calibrated(0.866 * w),
}


def exact_exponential(image: Tensor, sigma: Tensor, at: Tensor) -> Tensor:
    """As `benchmarks.exact.blur_exact`, under each pixel's own e^(−2πσf): a sum of the picture's cosine waves."""
    _, h, w = image.shape
    waves = dctn(image.double().numpy(), axes=(1, 2), norm="ortho")
    down, across = (idctn(np.eye(n), axes=(0,), norm="ortho") for n in (h, w))
    f = np.hypot(np.arange(h)[:, None] / (2 * h), np.arange(w) / (2 * w))
    out = np.empty((len(image), len(at)))
    for n, p in enumerate(at.tolist()):
        width = float(sigma.flatten()[p])
        # what is left out is down to e^−40
        k, m = (min(size, math.ceil(40 / (np.pi * max(width, 1e-9)) * size)) for size in (h, w))
        spent = waves[:, :k, :m] * np.exp(-2 * np.pi * width * f[:k, :m])
        out[:, n] = down[p // w, :k] @ spent @ across[p % w, :m]
    return torch.from_numpy(out)


def _fewer(plan: BlurPlan, low: float, high: float, shape: Shape, longest: int) -> BlurPlan | None:
    """The plan with one blur less; None if there is none to spare."""
    if len(plan.sigmas) == 1:
        return None
    for tolerance in np.geomspace(TOLERANCE, 0.9, 60):
        other = plan_blur(low, high, float(tolerance), shape, longest)
        if len(other.sigmas) < len(plan.sigmas):
            return other
    return None


def cell(
    name: str, distances: tuple[float, float], law: str, pixels: int, rounds: int
) -> dict[str, Any]:
    """One cell of the table."""
    picture, depth = motorcycle()
    image = srgb_to_linear(picture)
    h, w = image.shape[-2:]
    share = (depth - depth.min()) / (depth.max() - depth.min())
    z = distances[0] + (distances[1] - distances[0]) * share
    g = 0.2 if law == "paper" else 0.05
    options = {
        "g": g,
        "mu": 0.3 * g / 0.2,
        "point_spread": LAWS[law](w),
        "distance_range": distances,
    }
    water = uwaug.Water.jerlov(name)
    medium = uwaug.Medium.from_water(water, tolerance=TOLERANCE, **options)
    every = uwaug.Medium.from_water(water, tolerance=0, **options)
    demand = blur_demand(medium, distances, TOLERANCE)
    plan = demand.plan((h, w))
    at = torch.randperm(h * w, generator=torch.Generator().manual_seed(0))[:pixels]
    zs = z.double().flatten()[at]
    signal, direct, veil = every.signal(zs)[0], every.transmission(zs)[0], every.backscatter(zs)[0]
    j = image.double()[0].flatten(1)[:, at]
    widths = every.width(z.double(), (h, w))[0, 0]
    blur = exact_exponential if medium.point_spread.shape == "exponential" else blur_exact
    exact = direct * j + (signal - direct) * blur(image[0], widths, at) + veil

    def error(medium: uwaug.Medium, plan: BlurPlan) -> tuple[float, float]:
        with torch.no_grad():
            out = uwaug.form_image(image, z, medium, plan=plan).image[0].flatten(1)[:, at].double()
        difference: Tensor = (out - exact).abs()
        return float(difference.square().mean().sqrt()), float(difference.max())

    rmse, worst = error(medium, plan)
    scale = 1.0 if demand.reference_size is None else min(h, w) / demand.reference_size
    fewer = (
        _fewer(plan, demand.low * scale, demand.high * scale, demand.shape, max(h, w))
        if demand.high > 0
        else None
    )
    with torch.no_grad():
        cost = race({"form": lambda: uwaug.form_image(image, z, medium, plan=plan)}, rounds)[
            "form"
        ]["median_ms"]
    return {
        "type": name, "distance_m": distances, "law": law, "rates": [medium.beta.shape[1], medium.G.shape[1]],
        "widths_px": [round(s, 2) for s in plan.sigmas], "cells_px": [round(c, 1) for c in plan.cells],
        "blurred": plan.sigmas != (0.0,), "ms": cost, "rmse": rmse, "max": worst,
        "rmse_one_blur_less": error(medium, fewer)[0] if fewer else None,
        "blur_tolerance": demand.tolerance,
    }  # fmt: skip


def main(quick: bool = False) -> None:
    """Print the table and save it."""
    use_threads(1)
    types = ("II", "7C") if quick else uwaug.JERLOV_TYPES
    rows = []
    for law in LAWS:
        for name in types:
            for distances in RANGES[1:2] if quick else RANGES:
                row = cell(name, distances, law, 200 if quick else 2000, 2 if quick else 5)
                rows.append(row)
                less = (
                    "–" if row["rmse_one_blur_less"] is None else f"{row['rmse_one_blur_less']:.5f}"
                )
                print(
                    f"{law:10} {name:3} {distances[0]:g}–{distances[1]:g} m: rates {row['rates']}, "
                    f"blurs {len(row['widths_px']) if row['blurred'] else 'none'}, {row['ms']:.0f} ms, "
                    f"RMSE {row['rmse']:.5f}, max {row['max']:.4f}, one blur less {less}",
                    flush=True,
                )
    held = sum(r["rmse"] <= TOLERANCE for r in rows)
    spare = [r for r in rows if r["rmse_one_blur_less"] is not None]
    broken = sum(r["rmse_one_blur_less"] > 0.5 * TOLERANCE for r in spare)
    print(
        f"{held} of {len(rows)} cells within {TOLERANCE}; one blur less breaks half of it in {broken} of {len(spare)}"
    )
    if not quick:
        print(
            save(
                "planner",
                {"rows": rows, "within": held, "one_less_breaks": broken, "with_blurs": len(spare)},
            )
        )


if __name__ == "__main__":
    command(main, __doc__)
