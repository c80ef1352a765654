"""The model's figures: speed against the published and the naive recipe, scaling, memory, accuracy
of curves and blur.

`python -m benchmarks.speed.model` writes results/model.json and prints the tables.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

import uwaug
from benchmarks import recipe
from benchmarks.exact import blur_exact
from benchmarks.harness import (
    DISTANCES,
    WIDEST,
    by_loops,
    command,
    motorcycle,
    peak_of,
    printed,
    race,
    save,
    scene,
    use_threads,
    water_medium,
)
from benchmarks.speed.panels import exported
from uwaug.blur.plan import plan_blur
from uwaug.blur.stack import varying_blur
from uwaug.optics.spectra import WAVELENGTHS

MU = 0.3


def _module(water: str, widest: float = WIDEST, **options: Any) -> uwaug.Underwater:
    medium = water_medium(water, widest).to(torch.float32)
    return uwaug.Underwater(medium, DISTANCES, color_space="linear", **options)


def speed(
    water: str = "7C",
    sizes: tuple[int, ...] = (256, 512),
    batches: tuple[int, ...] = (1, 8),
    rounds: int = 15,
) -> list[dict[str, Any]]:
    """Whole model, field given, one thread, against the published recipe and the naive kornia
    recipe.
    """
    use_threads(1)
    rows = []
    for size in sizes:
        for batch in batches:
            runners = _contestants(water, size, batch)
            with torch.no_grad():
                times = race(runners, rounds)
            medians = {name: found["median_ms"] for name, found in times.items()}
            ours = medians["uwaug"]
            others = (name for name in medians if not name.startswith("uwaug"))
            ratios = {name: medians[name] / ours for name in others}
            row = {"water": water, "size": size, "batch": batch, "ms": times}
            rows.append({**row, "times_faster": ratios})
            said = ", ".join(f"{ratio:.1f} × {name}" for name, ratio in ratios.items())
            print(f"{water} {size}² × {batch}: {ours:7.2f} ms; {said}", flush=True)
    return rows


def _contestants(water: str, size: int, batch: int) -> dict[str, Callable[[], object]]:
    image, distance = scene(size, batch)
    field = torch.ones_like(distance)
    default, degrade = _module(water), _module(water)
    # ≥ 60 dB of the blur itself: do not let the strength of the forward term relax it
    degrade.demand = replace(degrade.demand, blur_tolerance=0.002)
    arrays = list(zip(*map(_arrays, (image, distance, field)), strict=True))
    phi = WIDEST / DISTANCES[1]
    bands = recipe.bands(water, phi)
    channels = recipe.three_wavelengths(water)
    channels = {name: value.float() for name, value in channels.items()}
    return {
        "uwaug": lambda: degrade(image, distance, field),
        "uwaug, default": lambda: default(image, distance, field),
        "uwaug, loops": partial(by_loops(default), image, distance, field),
        "published, OpenCV": lambda: [recipe.published(*x, bands) for x in arrays],
        "naive kornia": lambda: recipe.naive_kornia(image, distance, field, channels, phi),
    }


def _arrays(batch: Tensor) -> list[np.ndarray]:
    """(H, W, 3) or (H, W) of each."""
    return [x.squeeze(-1).contiguous().numpy() for x in batch.permute(0, 2, 3, 1)]


def scaling(rounds: int = 15) -> dict[str, float]:
    """Ratios of time: widest blur 60 px to 4 px, 1024² to 256², forward and backward to forward."""
    use_threads(1)
    near, far = scene(256), scene(1024)
    small, large = _module("7C", 4.0), _module("7C", 60.0)
    with torch.no_grad():
        wide = race({"4": partial(small, *scene(512)), "60": partial(large, *scene(512))}, rounds)
        tiles = race({"256": partial(small, *near), "1024": partial(small, *far)}, rounds)
    grads = race(_learning(*near), rounds)

    def ratio(times: dict[str, dict[str, float]], one: str, other: str) -> float:
        return times[one]["median_ms"] / times[other]["median_ms"]

    result = {
        "60 px / 4 px": ratio(wide, "60", "4"),
        "1024² / 256²": ratio(tiles, "1024", "256"),
        "forward + backward / forward": ratio(grads, "both", "forward"),
    }
    print(result, flush=True)
    return result


def _learning(image: Tensor, distance: Tensor) -> dict[str, Callable[[], object]]:
    """Forward and backward, to image, distance and all parameters."""
    medium = water_medium("7C").as_coefficients().to(torch.float32)
    learned = uwaug.Underwater(medium, DISTANCES, color_space="linear", learnable=True)
    picture, z = (t.clone().requires_grad_() for t in (image, distance))

    def forward() -> Tensor:
        with torch.no_grad():
            return learned(picture, z)  # type: ignore[no-any-return]

    def both() -> None:
        learned(picture, z).sum().backward()

    return {"forward": forward, "both": both}


def file_against_loops(rounds: int = 15) -> dict[str, Any]:
    """An ONNX file of one water and size beside the module by the compiled loops: sRGB, metered,
    512², one thread.
    """
    use_threads(1)
    metered = uwaug.Development(metered=True)
    medium = uwaug.Medium.from_water("7C")
    module = uwaug.Underwater(medium, (0.5, 10.0), sides=(512, 512), development=metered)
    image, distance = scene(512)
    run = exported(module, 1)
    with torch.no_grad():
        runners = {"loops": partial(by_loops(module), image, distance)}
        times = race({**runners, "file": partial(run, image, distance)}, rounds)
    ratio = times["file"]["median_ms"] / times["loops"]["median_ms"]
    print(f"ONNX file / loops: {ratio:.2f}", flush=True)
    return {"ms": times, "file / loops": ratio}


def memory() -> float:
    """Peak memory of one 1024² image, in multiples of its input's bytes, in a process of its
    own.
    """
    peak = float(printed("from benchmarks.speed.model import _peak; print(_peak())"))
    print(f"memory at 1024²: {peak:.1f} × the input", flush=True)
    return peak


def _peak() -> float:
    torch.set_num_threads(1)
    degrade = _module("7C")
    image, distance = torch.rand(1, 3, 1024, 1024), 1 + 4 * torch.rand(1, 1, 1024, 1024)
    with torch.no_grad():
        degrade(image[..., :64, :64], distance[..., :64, :64])
        peak = peak_of(lambda: degrade(image, distance))
    return peak / (4 * (image.numel() + distance.numel()))


def import_time(rounds: int = 7) -> float:
    """Seconds that `import uwaug` adds to `import torch, kornia`, in fresh processes."""
    code = "import time, torch, kornia; t = time.perf_counter()"
    code += "; import uwaug; print(time.perf_counter() - t)"
    median = float(np.median([float(printed(code)) for _ in range(rounds)]))
    print(f"import uwaug: {median:.3f} s", flush=True)
    return median


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
    """Run all parts and save the figures."""
    rounds, sizes, batches, waters = 15, (256, 512), (1, 8), ("7C", "1C", "I")
    if quick:
        rounds, sizes, batches, waters = 3, (256,), (1,), ("7C",)
    speeds = []
    for water in waters:
        speeds += speed(water, sizes, batches, rounds)
    results = {
        "speed": speeds,
        "scaling": scaling(rounds),
        "memory_times_input": memory(),
        "import_s": import_time(3 if quick else 7),
        "blur": blur_accuracy(300 if quick else 3000),
        "curves": curve_accuracy(),
    }
    if not quick:
        results["onnx"] = file_against_loops()  # to export takes a minute
        print(save("model", results))


if __name__ == "__main__":
    command(main, __doc__)
