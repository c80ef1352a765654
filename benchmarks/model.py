"""The model's figures: speed against the published and the naive recipe, scaling, memory, accuracy of curves and blur.

`python -m benchmarks.model` writes results/model.json and prints the tables.
"""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import uwaug
from benchmarks import baselines
from benchmarks.exact import blur_exact
from benchmarks.harness import command, motorcycle, race, save, scene, use_threads
from uwaug.blur.plan import plan_blur
from uwaug.blur.stack import varying_blur
from uwaug.optics.bands import WAVELENGTHS

WIDEST = 4.5  # px, at 5 m; .9 at 1 m


def _medium(water: str) -> uwaug.Medium:
    """A type whose widths run from .9 to 4.5 px over 1…5 m, the range that the issue names."""
    medium = uwaug.Medium.from_water(uwaug.Water.jerlov(water)).to(torch.float32)
    return replace(medium, point_spread=uwaug.PointSpread(WIDEST / 5 / float(medium.b_mean)))


def speed(
    water: str = "7C",
    sizes: tuple[int, ...] = (256, 512),
    batches: tuple[int, ...] = (1, 8),
    rounds: int = 15,
) -> list[dict[str, Any]]:
    """Whole model, field given, one thread, against the published recipe and the naive kornia recipe."""
    use_threads(1)
    seven = uwaug.Water.jerlov(water).at(np.arange(400, 701, 50))
    response = uwaug.load_camera("Nikon 5100 (NPL)").weights(seven.wavelengths).astype(np.float32)
    a, b, kd = (v.astype(np.float32) for v in (seven.a, seven.b, seven.kd))
    light, G = np.exp(-kd), a + np.float32(0.2) * b
    rgb = [4, 3, 1]  # 600, 550, 450 nm
    veil = np.float32(0.3) * b * light / G
    bands = {
        "response": response,
        "beta": a + b,
        "G": G,
        "light": light,
        "light_rgb": light[rgb],
        "veil": veil,
    }
    per_channel = {k: torch.from_numpy(bands[k][rgb]) for k in ("beta", "G", "light", "veil")}
    default, degrade = (
        uwaug.Underwater(_medium(water), (1.0, 5.0), color_space="linear") for _ in range(2)
    )
    # ≥ 60 dB of the blur itself: do not let the strength of the forward term relax it
    degrade.demand = replace(degrade.demand, tolerance=0.002)
    rows = []
    for size in sizes:
        for batch in batches:
            image, distance = scene(size, batch)
            field = torch.ones_like(distance)
            arrays = [
                [
                    t[i].permute(1, 2, 0).squeeze(-1).contiguous().numpy()
                    for t in (image, distance, field)
                ]
                for i in range(batch)
            ]
            runners = {
                "uwaug": lambda: degrade(image, distance, field),
                "uwaug, default": lambda: default(image, distance, field),
                "published, OpenCV": lambda: [
                    baselines.published(*x, **bands, phi=WIDEST / 5) for x in arrays
                ],
                "naive kornia": lambda: baselines.naive_kornia(
                    image, distance, field, **per_channel, phi=WIDEST / 5
                ),
            }
            with torch.no_grad():
                result = race(runners, rounds)
            ours = result["uwaug"]["median_ms"]
            ratios = {
                k: v["median_ms"] / ours for k, v in result.items() if not k.startswith("uwaug")
            }
            rows.append(
                {"water": water, "size": size, "batch": batch, "ms": result, "times_faster": ratios}
            )
            print(
                f"{water} {size}² × {batch}: {ours:7.2f} ms; "
                + ", ".join(f"{r:.1f} × {k}" for k, r in ratios.items()),
                flush=True,
            )
    return rows


def scaling(rounds: int = 15) -> dict[str, float]:
    """Ratios of time: widest blur 60 px to 4 px, 1024² to 256², forward and backward to forward."""
    use_threads(1)
    image, distance = scene(512)
    blur = {}
    for widest in (4.0, 60.0):
        sigma = widest * (0.2 + 0.8 * (distance - 1) / 4)
        plan = plan_blur(float(sigma.min()), float(sigma.max()))
        blur[widest] = (sigma, plan)
    medium = _medium("7C")

    def module(widest: float, **options: Any) -> uwaug.Underwater:
        law = uwaug.PointSpread(widest / 5 / float(medium.b_mean))
        return uwaug.Underwater(
            replace(medium, point_spread=law), (1.0, 5.0), color_space="linear", **options
        )

    small, large = module(4.0), module(60.0)
    with torch.no_grad():
        wide = race(
            {"4": lambda: small(image, distance), "60": lambda: large(image, distance)}, rounds
        )
        near, far = scene(256), scene(1024)
        tiles = race({"256": lambda: small(*near), "1024": lambda: small(*far)}, rounds)
    learned = module(4.5, learnable=True)
    for parameter in learned.parameters():
        parameter.requires_grad_(True)
    picture, z = (t.clone().requires_grad_() for t in near)

    def backward() -> None:
        learned(picture, z).sum().backward()

    def forward() -> Tensor:
        with torch.no_grad():
            return learned(picture, z)  # type: ignore[no-any-return]

    grads = race({"forward": forward, "both": backward}, rounds)
    ratio = lambda r, a, b: r[a]["median_ms"] / r[b]["median_ms"]  # noqa: E731
    result = {
        "60 px / 4 px": ratio(wide, "60", "4"),
        "1024² / 256²": ratio(tiles, "1024", "256"),
        "forward + backward / forward": ratio(grads, "both", "forward"),
    }
    for name, value in result.items():
        print(f"{name}: {value:.2f}", flush=True)
    return result


def memory() -> float:
    """Peak memory of one 1024² image, in multiples of its input's bytes, in a process of its own."""
    code = "from benchmarks.model import _peak; print(_peak())"
    peak = float(
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
    )
    print(f"memory at 1024²: {peak:.1f} × the input", flush=True)
    return peak


def _peak() -> float:
    torch.set_num_threads(1)
    degrade = uwaug.Underwater(_medium("7C"), (1.0, 5.0), color_space="linear")
    image, distance = torch.rand(1, 3, 1024, 1024), 1 + 4 * torch.rand(1, 1, 1024, 1024)
    with torch.no_grad():
        degrade(image[..., :64, :64], distance[..., :64, :64])
        Path("/proc/self/clear_refs").write_text("5")  # Linux: let the peak begin here
        before = _peak_bytes()
        degrade(image, distance)
    return (_peak_bytes() - before) / (4 * (image.numel() + distance.numel()))


def _peak_bytes() -> int:
    status = Path("/proc/self/status").read_text()
    return 1024 * int(
        next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    )


def import_time(rounds: int = 7) -> float:
    """Seconds that `import uwaug` adds to `import torch, kornia`, in fresh processes."""
    code = "import time, torch, kornia; t = time.perf_counter(); import uwaug; print(time.perf_counter() - t)"
    times = [
        float(
            subprocess.run(
                [sys.executable, "-c", code], capture_output=True, text=True, check=True
            ).stdout
        )
        for _ in range(rounds)
    ]
    print(f"import uwaug: {np.median(times):.3f} s", flush=True)
    return float(np.median(times))


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
            rows.append(
                {
                    "sigma_px": [low, high],
                    "tolerance": tolerance,
                    "blurs": len(plan.sigmas),
                    "psnr_db": psnr,
                }
            )
            print(
                f"σ {low}…{high} px, tolerance {tolerance}: {len(plan.sigmas)} blurs, {psnr:.1f} dB",
                flush=True,
            )
    return rows


def curve_accuracy(tolerance: float = 0.002) -> list[dict[str, Any]]:
    """Rates chosen for each type and the largest error against the 61-band sums, over depths and g."""
    z = torch.linspace(0, 20, 2001, dtype=torch.float64)
    response = uwaug.load_camera("Nikon 5100 (NPL)").weights(WAVELENGTHS).T
    rows = []
    for name in uwaug.JERLOV_TYPES:
        water = uwaug.Water.jerlov(name).at(WAVELENGTHS)
        for depth in (0.0, 1.0, 10.0):
            for g in (0.0, 0.2, 1.0):
                medium = uwaug.Medium.from_water(
                    water, vertical_depth=depth, g=g, tolerance=tolerance
                )
                light, G = np.exp(-water.kd * depth), water.a + g * water.b
                decay = np.exp(-np.multiply.outer(G, z.numpy()))
                exact = (
                    (response * light) @ np.exp(-np.multiply.outer(water.beta, z.numpy())),
                    (response * light) @ decay,
                    (response * light * 0.3 * water.b / G) @ (1 - decay),
                )
                curves = (medium.transmission(z), medium.signal(z), medium.backscatter(z))
                error = max(
                    float(np.abs(c[0].numpy() - e).max())
                    for c, e in zip(curves, exact, strict=True)
                )
                rows.append(
                    {
                        "type": name,
                        "depth_m": depth,
                        "g": g,
                        "rates": [medium.beta.shape[1], medium.G.shape[1]],
                        "error": error,
                    }
                )
        worst = max(r["error"] for r in rows if r["type"] == name)
        print(
            f"{name}: rates {[r['rates'] for r in rows if r['type'] == name]}, worst {worst:.5f}",
            flush=True,
        )
    return rows


def main(quick: bool = False) -> None:
    """Run all parts and save the figures."""
    rounds = 3 if quick else 15
    sizes, batches, waters = (
        ((256,), (1,), ("7C",)) if quick else ((256, 512), (1, 8), ("7C", "1C", "I"))
    )
    results = {
        "speed": [row for water in waters for row in speed(water, sizes, batches, rounds)],
        "scaling": scaling(rounds),
        "memory_times_input": memory(),
        "import_s": import_time(3 if quick else 7),
        "blur": blur_accuracy(300 if quick else 3000),
        "curves": curve_accuracy(),
    }
    if not quick:
        print(save("model", results))


if __name__ == "__main__":
    command(main, __doc__)
