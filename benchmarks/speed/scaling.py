"""Time and peak memory against pixels, batch, widest blur and number of rates; exponents fitted on
log–log axes.

`python -m benchmarks.speed.scaling` writes results/scaling.json and figures/scaling.png. One
thread, float32, no gradients. Next to ours: a copy that moves as many bytes as the model must (7
floats a pixel), and the same plan as a plain fused C++ loop, compiled on the spot.
"""

import ctypes
import json
import math
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import uwaug
from benchmarks.harness import (
    DISTANCES,
    WIDEST,
    command,
    peak_of,
    printed,
    race,
    save,
    scene,
    use_threads,
    water_medium,
)
from uwaug.blur.kernels import blur_kernel
from uwaug.blur.plan import place_line

SOURCE = Path(__file__).parent / "loops.cpp"
USUAL = {"side": 512, "batch": 1, "widest": WIDEST, "rates_tolerance": 0.002}
LONG = ((1024, 1024), (512, 8192), (64, 20000), (20000, 64), (1, 30000))  # px
SETTING = (
    "one thread, float32, no gradients, Jerlov 7C, 1…5 m; where not swept: 512² (batch: 256²), "
    "batch 1, σ .9…4.5 px, default rates"
)


def module(widest: float = WIDEST, rates_tolerance: float = 0.002) -> uwaug.Underwater:
    """Jerlov 7C with widths of widest/5…widest px over 1…5 m."""
    medium = water_medium("7C", widest, tolerance=rates_tolerance).to(torch.float32)
    return uwaug.Underwater(medium, DISTANCES, color_space="linear")


def compiler() -> str | None:
    return shutil.which("g++")


class Fused:
    """A module's model, with its plan but without coarse grids, as one loop in C++."""

    def __init__(self, folder: str) -> None:
        compiled, library = Path(folder) / "fused.o", Path(folder) / "fused.so"
        gxx, flags = compiler() or "g++", ("-O3", "-march=native", "-ffast-math", "-fPIC")
        subprocess.run([gxx, *flags, "-c", SOURCE, "-o", compiled], check=True)
        # linked with -ffast-math too, g++ before 13 would have the library flush subnormals in all
        # of this process
        subprocess.run([gxx, "-shared", compiled, "-o", library, "-lmvec", "-lm"], check=True)
        self._form = ctypes.CDLL(str(library)).form

    def bind(
        self, degrade: uwaug.Underwater, image: Tensor, distance: Tensor
    ) -> Callable[[], Tensor]:
        """What runs the module's model on this input."""
        b, _, h, w = image.shape
        plan = degrade.plan((h, w))
        assert plan is not None
        medium, out = degrade.medium, torch.empty_like(image)
        kernels = [blur_kernel(s, plan.reach)[0] if s > 0 else torch.ones(1) for s in plan.sigmas]
        halves = [kernel[len(kernel) // 2 :].float() for kernel in kernels]
        reach = torch.tensor([len(half) - 1 for half in halves], dtype=torch.int32)
        taps = torch.cat(halves)
        coefficients = torch.tensor(plan.coefficients).contiguous()
        slope, offset = place_line(plan)
        spread = float(medium.b_mean) * float(medium.point_spread.scale)
        law = (ctypes.c_float(value) for value in (spread, slope, offset))
        names = ("beta", "direct_weights", "G", "signal_weights", "veil_weights")
        tables = [getattr(medium, name).detach()[0].contiguous() for name in names]
        beta, direct, G, signal, veil = map(_pointer, tables)
        blurs = (len(halves), _pointer(reach), _pointer(taps))
        weights = (coefficients.shape[1], _pointer(coefficients), *law)
        curves = (tables[0].numel(), beta, direct, tables[2].numel(), G, signal, veil)
        held = (reach, taps, coefficients, tables)  # pointers do not keep what they point to

        def run(held: object = held) -> Tensor:
            for i in range(b):
                planes = (_pointer(t[i]) for t in (image, distance, out))
                self._form(*planes, h, w, *blurs, *weights, *curves)
            return out

        return run


def _pointer(tensor: Tensor) -> ctypes.c_void_p:
    return ctypes.c_void_p(tensor.data_ptr())


def copy_bound(image: Tensor) -> Callable[[], Tensor]:
    """A copy of 3.5 floats a pixel: read and written, they are the 3 + 1 that the model reads and
    the 3 it writes.
    """
    source = torch.rand(7 * image.numel() // 6)
    target = torch.empty_like(source)
    return partial(target.copy_, source)


def fit(x: Sequence[float], y: Sequence[float]) -> dict[str, float]:
    """Exponent p of y ∝ x^p by least squares on log–log axes, and the RMS residual as a factor."""
    lx, ly = np.log(x), np.log(y)
    slope, start = np.polyfit(lx, ly, 1)
    residual = float(np.sqrt(np.mean((slope * lx + start - ly) ** 2)))
    return {"exponent": float(slope), "residual_factor": math.exp(residual)}


@lru_cache
def peak_memory(**options: float) -> dict[str, float]:
    """Peak memory of one call above what the process held before, in a process of its own; and per
    byte of input.
    """
    code = "import json, sys; from benchmarks.speed.scaling import _peak"
    code += "; print(json.dumps(_peak(**json.loads(sys.argv[1]))))"
    return dict(json.loads(printed(code, json.dumps(options), OMP_NUM_THREADS="1")))


def _peak(
    side: int, batch: int, widest: float, rates_tolerance: float, width: int = 0
) -> dict[str, float]:
    torch.set_num_threads(1)
    degrade = module(widest, rates_tolerance)
    size = (side, width or side)
    image, distance = torch.rand(batch, 3, *size), 1 + 4 * torch.rand(batch, 1, *size)
    with torch.no_grad():
        degrade(image[..., :48, :48], distance[..., :48, :48])
        peak = peak_of(lambda: degrade(image, distance))
    held = 4 * (image.numel() + distance.numel())
    return {"peak_mib": peak / 2**20, "peak_per_input": peak / held}


def long_shapes(shapes: Sequence[tuple[int, int]] = LONG) -> list[dict[str, float]]:
    """Peak memory of the first picture of its size, of long pictures next to a square one."""
    found = []
    for height, width in shapes:
        peak = peak_memory(**{**USUAL, "side": height, "width": width})
        of_input = f"{peak['peak_per_input']:.1f} × the input"
        print(f"{height}×{width}: peak {peak['peak_mib']:.1f} MiB, {of_input}", flush=True)
        found.append({"height": height, "width": width, **peak})
    return found


@dataclass(frozen=True)
class Sweep:
    """One axis.

    Attributes:
        axis: what it is called.
        options: those of each point that are not `USUAL`, see `_peak`.
        place: where a point lies on the axis, from its options and its module.
        fit_from: exponents are fitted over places ≥ this.
    """

    axis: str
    options: Sequence[dict[str, Any]]
    place: Callable[[dict[str, Any], uwaug.Underwater], float]
    fit_from: float = 0.0

    def run(self, fused: Fused | None, rounds: int) -> dict[str, Any]:
        """Time and memory of all points, and the exponents."""
        points = []
        for changed in self.options:
            point = self._point({**USUAL, **changed}, fused, rounds)
            points.append(point)
            times = point["ms"].items()
            said = ", ".join(f"{name} {taken['median_ms']:.2f} ms" for name, taken in times)
            peak = f"peak {point['peak_mib']:.1f} MiB"
            print(f"{self.axis} {point['x']:g}: {said}, {peak}", flush=True)
        fits = self._fits(points)
        for name, found in fits.items():
            law = f"x^{found['exponent']:.2f} (residual ×{found['residual_factor']:.2f})"
            print(f"{self.axis}: {name} ∝ {law}", flush=True)
        return {"axis": self.axis, "fit_from": self.fit_from, "points": points, "fits": fits}

    def _point(self, options: dict[str, Any], fused: Fused | None, rounds: int) -> dict[str, Any]:
        degrade = module(options["widest"], options["rates_tolerance"])
        image, distance = scene(options["side"], options["batch"])
        runners: dict[str, Callable[[], object]] = {
            "uwaug": partial(degrade, image, distance),
            "copy bound": copy_bound(image),
        }
        if fused is not None:
            runners["fused C++"] = fused.bind(degrade, image, distance)
        with torch.no_grad():
            times = race(runners, rounds, 4.0)
        place = {"x": self.place(options, degrade)}
        return {**place, **options, "ms": times, **peak_memory(**options)}

    def _fits(self, points: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
        fitted = [point for point in points if point["x"] >= self.fit_from]
        x = [point["x"] for point in fitted]
        fits = {}
        for name in points[0]["ms"]:
            fits[name] = fit(x, [point["ms"][name]["median_ms"] for point in fitted])
        fits["uwaug, peak memory"] = fit(x, [point["peak_mib"] for point in fitted])
        return fits


def sweeps(quick: bool) -> dict[str, Sweep]:
    """All axes."""
    sides: Sequence[int] = (64, 128, 256, 512, 1024, 2048, 4096)
    batches: Sequence[int] = (1, 2, 4, 8, 16, 32, 64)
    widths: Sequence[float] = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 100.0)
    tolerances: Sequence[float] = (0.5, 0.02, 0.002, 1e-4, 1e-5, 0.0)
    side, of_batch, fit_from = 512, 256, 256.0**2
    if quick:
        sides, batches, widths, tolerances = (64, 128), (1, 2), (4.5, 9.0), (0.1, 0.002)
        side, of_batch, fit_from = 64, 64, 0.0

    def rates(_: Any, degrade: uwaug.Underwater) -> float:
        return float(degrade.medium.beta.shape[1] + degrade.medium.G.shape[1])

    return {
        "pixels": Sweep(
            "pixels", [{"side": n} for n in sides], lambda o, _: float(o["side"] ** 2), fit_from
        ),
        "batch": Sweep(
            "batch",
            [{"side": of_batch, "batch": n} for n in batches],
            lambda o, _: float(o["batch"]),
        ),
        "widest": Sweep(
            "widest σ, px", [{"side": side, "widest": s} for s in widths], lambda o, _: o["widest"]
        ),
        "rates": Sweep("rates", [{"side": side, "rates_tolerance": t} for t in tolerances], rates),
    }


def main(quick: bool = False) -> dict[str, Any]:
    """Run all sweeps; return what is saved (nothing is, if quick)."""
    use_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        fused = Fused(folder) if compiler() else None
        found = {name: one.run(fused, 3 if quick else 15) for name, one in sweeps(quick).items()}
    skipped = [] if fused is not None else ["fused C++ (no g++)"]
    shapes = long_shapes(((32, 48), (1, 500)) if quick else LONG)
    results = {"setting": SETTING, "skipped": skipped, "sweeps": found, "first_calls": shapes}
    if not quick:
        from benchmarks.figures.charts import draw_scaling

        print(save("scaling", results), draw_scaling(results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
