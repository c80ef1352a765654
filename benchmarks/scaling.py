"""Time and peak memory against pixels, batch, widest blur and number of rates; exponents fitted on log–log axes.

`python -m benchmarks.scaling` writes results/scaling.json and figures/scaling.png. One thread, float32, no gradients.
Next to ours: a copy that moves as many bytes as the model must (7 floats a pixel), and the same plan as a plain fused
C++ loop, compiled on the spot.
"""

import ctypes
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import uwaug
from benchmarks.harness import command, race, save, scene, use_threads
from uwaug.blur.banded import blur_kernel
from uwaug.blur.plan import range_in_v
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

DISTANCES = (1.0, 5.0)  # m
FUSED = r"""
#include <cmath>
#include <vector>

// Row by row: curves and weights of its pixels, then for every blur a vertical and a horizontal pass, added in place.
// Planar float32; tables as laid out by `Fused`. Width law σ = spread·z; half-sample symmetric edges.
extern "C" void form(const float* image, const float* z, float* out, int h, int w, int blurs, const int* reach,
                     const float* taps, int terms, const float* coefficients, float spread, float slope, float offset,
                     int rates, const float* beta, const float* direct, int scatter_rates, const float* G,
                     const float* signal, const float* veil) {
    int margin = 0;
    for (int k = 0; k < blurs; k++) margin = reach[k] > margin ? reach[k] : margin;
    auto mirror = [](int i, int n) { i = ((i % (2 * n)) + 2 * n) % (2 * n); return i < n ? i : 2 * n - 1 - i; };
    std::vector<float> weight(blurs * w), T(3 * w), share(3 * w), backscatter(3 * w), mixed(3 * w);
    std::vector<float> line(w + 2 * margin), v(w), e(w);
    std::vector<int> column(w + 2 * margin);
    for (int i = 0; i < w + 2 * margin; i++) column[i] = mirror(i - margin, w);
    for (int y = 0; y < h; y++) {
        const float* distance = z + (long)y * w;
        for (int x = 0; x < w; x++) {
            float s = spread * distance[x], u = std::log(1 + 2 * s * s) * slope + offset;
            v[x] = u < -1 ? -1 : u > 1 ? 1 : u;
        }
        for (int k = 0; k < blurs; k++) {
            const float* c = coefficients + k * terms;
            for (int x = 0; x < w; x++) {  // Clenshaw
                float a = 0, b = 0;
                for (int i = terms - 1; i > 0; i--) { float t = c[i] + 2 * v[x] * a - b; b = a; a = t; }
                weight[k * w + x] = c[0] + v[x] * a - b;
            }
        }
        for (int x = 0; x < 3 * w; x++) T[x] = share[x] = backscatter[x] = mixed[x] = 0;
        for (int r = 0; r < rates; r++) {
            for (int x = 0; x < w; x++) e[x] = std::exp(-beta[r] * distance[x]);
            for (int c = 0; c < 3; c++)
                for (int x = 0; x < w; x++) T[c * w + x] += direct[c * rates + r] * e[x];
        }
        for (int r = 0; r < scatter_rates; r++) {
            for (int x = 0; x < w; x++) e[x] = std::exp(-G[r] * distance[x]);
            for (int c = 0; c < 3; c++) {
                float s = signal[c * scatter_rates + r], b = veil[c * scatter_rates + r];
                for (int x = 0; x < w; x++) { share[c * w + x] += s * e[x]; backscatter[c * w + x] += b * (1 - e[x]); }
            }
        }
        const float* tap = taps;  // of each blur: the middle one and one half
        for (int k = 0; k < blurs; tap += reach[k++] + 1)
            for (int c = 0; c < 3; c++) {
                const float* plane = image + (long)c * h * w;
                float* middle = line.data() + margin;
                for (int x = 0; x < w; x++) middle[x] = tap[0] * plane[(long)y * w + x];
                for (int n = 1; n <= reach[k]; n++) {
                    const float *up = plane + (long)mirror(y - n, h) * w, *down = plane + (long)mirror(y + n, h) * w;
                    for (int x = 0; x < w; x++) middle[x] += tap[n] * (up[x] + down[x]);
                }
                for (int i = 0; i < margin; i++) {
                    line[i] = middle[column[i]];
                    line[margin + w + i] = middle[column[margin + w + i]];
                }
                for (int x = 0; x < w; x++) e[x] = tap[0] * middle[x];
                for (int n = 1; n <= reach[k]; n++)
                    for (int x = 0; x < w; x++) e[x] += tap[n] * (middle[x - n] + middle[x + n]);
                for (int x = 0; x < w; x++) mixed[c * w + x] += weight[k * w + x] * e[x];
            }
        for (int c = 0; c < 3; c++)
            for (int x = 0; x < w; x++) {
                long at = ((long)c * h + y) * w + x;
                int i = c * w + x;
                out[at] = T[i] * image[at] + (share[i] - T[i]) * mixed[i] + backscatter[i];
            }
    }
}
"""


def module(widest: float = 4.5, rates_tolerance: float = 0.002) -> uwaug.Underwater:
    """Jerlov 7C with widths of widest/5…widest px over 1…5 m."""
    medium = Medium.from_water(uwaug.Water.jerlov("7C"), tolerance=rates_tolerance).to(
        torch.float32
    )
    law = PointSpread(widest / DISTANCES[1] / float(medium.b_mean))
    return uwaug.Underwater(replace(medium, point_spread=law), DISTANCES, color_space="linear")


def compiler() -> str | None:
    return shutil.which("g++")


class Fused:
    """A module's model, with its plan but without coarse grids, as one loop in C++."""

    def __init__(self, folder: str) -> None:
        source, compiled, library = (Path(folder) / f"fused.{kind}" for kind in ("cpp", "o", "so"))
        source.write_text(FUSED)
        gxx, flags = compiler() or "g++", ["-O3", "-march=native", "-ffast-math", "-fPIC"]
        subprocess.run([gxx, *flags, "-c", str(source), "-o", str(compiled)], check=True)
        # linked with -ffast-math too, g++ before 13 would have the library flush subnormals in all of this process
        subprocess.run(
            [gxx, "-shared", str(compiled), "-o", str(library), "-lmvec", "-lm"], check=True
        )
        self._form = ctypes.CDLL(str(library)).form

    def bind(
        self, degrade: uwaug.Underwater, image: Tensor, distance: Tensor
    ) -> Callable[[], Tensor]:
        """What runs the module's model on this input."""
        b, _, h, w = image.shape
        plan = degrade.plan((h, w))
        assert plan is not None
        medium, out = degrade.medium, torch.empty_like(image)
        halves = [blur_kernel(s, plan.reach)[0] if s > 0 else torch.ones(1) for s in plan.sigmas]
        halves = [k[len(k) // 2 :].float() for k in halves]
        reach = torch.tensor([len(k) - 1 for k in halves], dtype=torch.int32)
        coefficients = torch.tensor(plan.coefficients).contiguous()
        low, high = range_in_v(plan)
        slope = 1 / (high - low)
        offset = (math.log(0.5) - low - high) * slope
        names = ("beta", "direct_weights", "G", "signal_weights", "veil_weights")
        tensors = [getattr(medium, name).detach()[0].contiguous() for name in names]
        keep = (image, distance, out, reach, torch.cat(halves), coefficients, *tensors)
        real, pointer = ctypes.c_float, lambda t: ctypes.c_void_p(t.data_ptr())
        spread = float(medium.b_mean) * float(medium.point_spread.scale)
        tables = [pointer(t) for t in keep[3:]]

        def run(keep: tuple[Tensor, ...] = keep) -> Tensor:
            for i in range(b):
                self._form(
                    pointer(image[i]), pointer(distance[i]), pointer(out[i]), h, w, len(halves), *tables[:2],
                    coefficients.shape[1], tables[2], real(spread), real(slope), real(offset),
                    tensors[0].numel(), *tables[3:5], tensors[2].numel(), *tables[5:],
                )  # fmt: skip
            return keep[2]

        return run


def copy_bound(image: Tensor) -> Callable[[], Tensor]:
    """A copy of 3.5 floats a pixel: read and written, they are the 3 + 1 that the model reads and the 3 it writes."""
    source = torch.rand(7 * image.numel() // 6)
    target = torch.empty_like(source)
    return partial(target.copy_, source)


def fit(x: list[float], y: list[float]) -> dict[str, float]:
    """Exponent p of y ∝ x^p by least squares on log–log axes, and the RMS residual as a factor."""
    lx, ly = np.log(x), np.log(y)
    slope, start = np.polyfit(lx, ly, 1)
    residual = float(np.sqrt(np.mean((slope * lx + start - ly) ** 2)))
    return {"exponent": float(slope), "residual_factor": math.exp(residual)}


@lru_cache
def peak_memory(**options: float) -> dict[str, float]:
    """Peak memory of one call above what the process held before, in a process of its own; and per byte of input."""
    code = "import json, sys; from benchmarks.scaling import _peak; print(json.dumps(_peak(**json.loads(sys.argv[1]))))"
    run = [sys.executable, "-c", code, json.dumps(options)]
    root, environment = Path(__file__).parent.parent, {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        run, capture_output=True, text=True, check=True, cwd=root, env=environment
    )
    return dict(json.loads(done.stdout))


def _peak(side: int, batch: int, widest: float, rates_tolerance: float) -> dict[str, float]:
    torch.set_num_threads(1)
    degrade = module(widest, rates_tolerance)
    image, distance = torch.rand(batch, 3, side, side), 1 + 4 * torch.rand(batch, 1, side, side)
    with torch.no_grad():
        degrade(image[..., :48, :48], distance[..., :48, :48])
        Path("/proc/self/clear_refs").write_text("5")  # Linux: let the peak begin here
        before = _peak_bytes()
        degrade(image, distance)
    peak = _peak_bytes() - before
    return {
        "peak_mib": peak / 2**20,
        "peak_per_input": peak / (4 * (image.numel() + distance.numel())),
    }


def _peak_bytes() -> int:
    status = Path("/proc/self/status").read_text()
    return 1024 * int(
        next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    )


def sweep(
    axis: str,
    values: list[float],
    options: Callable[[float], dict[str, Any]],
    fused: Fused | None,
    rounds: int,
    fit_from: float = 0.0,
    x_of: Callable[[uwaug.Underwater], float] | None = None,
) -> dict[str, Any]:
    """Time and memory of one axis; exponents fitted over x ≥ fit_from."""
    points = []
    for value in values:
        chosen = {
            "side": 512,
            "batch": 1,
            "widest": 4.5,
            "rates_tolerance": 0.002,
            **options(value),
        }
        degrade = module(chosen["widest"], chosen["rates_tolerance"])
        image, distance = scene(chosen["side"], chosen["batch"])
        runners: dict[str, Callable[[], object]] = {
            "uwaug": partial(degrade, image, distance),
            "copy bound": copy_bound(image),
        }
        if fused is not None:
            runners["fused C++"] = fused.bind(degrade, image, distance)
        with torch.no_grad():
            times = race(runners, rounds, 4.0)
        x = value if x_of is None else x_of(degrade)
        point = {"x": x, **chosen, "ms": times, **peak_memory(**chosen)}
        points.append(point)
        said = ", ".join(f"{name} {t['median_ms']:.2f} ms" for name, t in times.items())
        print(f"{axis} {x:g}: {said}, peak {point['peak_mib']:.1f} MiB", flush=True)
    fitted = [p for p in points if p["x"] >= fit_from]
    x = [p["x"] for p in fitted]
    fits = {name: fit(x, [p["ms"][name]["median_ms"] for p in fitted]) for name in points[0]["ms"]}
    fits["uwaug, peak memory"] = fit(x, [p["peak_mib"] for p in fitted])
    for name, f in fits.items():
        print(
            f"{axis}: {name} ∝ x^{f['exponent']:.2f} (residual ×{f['residual_factor']:.2f})",
            flush=True,
        )
    return {"axis": axis, "fit_from": fit_from, "points": points, "fits": fits}


def main(quick: bool = False) -> dict[str, Any]:
    """Run all sweeps; return what is saved (nothing is, if quick)."""
    use_threads(1)
    rounds = 3 if quick else 15
    sides = [64, 128] if quick else [64, 128, 256, 512, 1024, 2048, 4096]
    batches = [1, 2] if quick else [1, 2, 4, 8, 16, 32, 64]
    widths = [4.5, 9.0] if quick else [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 100.0]
    tolerances = [0.1, 0.002] if quick else [0.5, 0.02, 0.002, 1e-4, 1e-5, 0.0]
    size = 64 if quick else 512
    with tempfile.TemporaryDirectory() as folder:
        fused = Fused(folder) if compiler() else None
        sweeps = {
            "pixels": sweep(
                "pixels", [float(s * s) for s in sides], lambda n: {"side": math.isqrt(int(n))}, fused, rounds,
                fit_from=0.0 if quick else 256.0**2,
            ),
            "batch": sweep(
                "batch", [float(b) for b in batches], lambda b: {"side": min(size, 256), "batch": int(b)}, fused, rounds
            ),
            "widest": sweep("widest σ, px", widths, lambda s: {"side": size, "widest": s}, fused, rounds),
            "rates": sweep(
                "rates", tolerances, lambda t: {"side": size, "rates_tolerance": t}, fused, rounds,
                x_of=lambda m: float(m.medium.beta.shape[1] + m.medium.G.shape[1]),
            ),
        }  # fmt: skip
    results = {
        "setting": "one thread, float32, no gradients, Jerlov 7C, 1…5 m; where not swept: 512² (batch: 256²), batch 1, "
        "σ .9…4.5 px, default rates",
        "skipped": [] if fused is not None else ["fused C++ (no g++)"],
        "sweeps": sweeps,
    }
    if not quick:
        from benchmarks.charts import draw_scaling

        print(save("scaling", results), draw_scaling(results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
