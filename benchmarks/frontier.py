"""Error against time for every way to compute each part of the model, and where our default stands.

`python -m benchmarks.frontier` writes results/frontier.json and figures/frontier.png. Each panel swaps one part and
keeps the others exact; errors are those of the final image (linear light, 0…1) against float64, 61 bands and each
pixel's own Gaussian. Scene: scikit-image's motorcycle at 1…5 m in Jerlov 7C.
"""

import contextlib
import importlib.util
import logging
import math
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import uwaug
from benchmarks import baselines, blurs
from benchmarks.harness import command, race, save, scene, use_threads
from uwaug.blur.plan import plan_blur
from uwaug.blur.stack import row_strips
from uwaug.formation import together
from uwaug.optics.curves import curves
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

DISTANCES = (1.0, 5.0)  # m
NEAR_TIE = 1.01  # a rival 1 % (.09 dB) less accurate still counts as equally accurate, against us
WITHIN = 0.1
Method = Callable[[], Any]


@dataclass(frozen=True, eq=False)
class Case:
    """One scene: input in float32, reference in float64."""

    image: Tensor  # (1, 3, H, W)
    z: Tensor  # (1, 1, H, W), m
    sigma: Tensor  # (1, 1, H, W), px
    medium: Medium  # of the default tolerance, float32
    scattered: Tensor  # image blurred exactly, float64
    share: Tensor  # T_G − T_β of 61 bands, float64
    exact: Tensor  # the final image, float64


def water_medium(water: str, widest: float, **options: Any) -> Medium:
    """Widths proportional to distance, up to `widest` px at the farthest."""
    medium = Medium.from_water(uwaug.Water.jerlov(water), **options)
    return replace(medium, point_spread=PointSpread(widest / DISTANCES[1] / float(medium.b_mean)))


def centre(size: int) -> tuple[Tensor, Tensor]:
    """The middle of the scene, where its detail is, with distances stretched to the full range."""
    image, z = scene(max(size, 512))
    first = (image.shape[-1] - size) // 2
    image, z = (t[..., first : first + size, first : first + size].contiguous() for t in (image, z))
    (near, far), (low, high) = DISTANCES, z.aminmax()
    return image, near + (far - near) * (z - low) / (high - low)


@lru_cache(maxsize=4)
def case(size: int, widest: float, water: str = "7C") -> Case:
    image, z = centre(size)
    medium, bands = water_medium(water, widest), water_medium(water, widest, tolerance=0.0)
    sigma = medium.width(z.double(), (size, size))
    scattered, _ = blurs.exact(image, sigma)
    direct, signal = bands.transmission(z.double()), bands.signal(z.double())
    exact = direct * image + (signal - direct) * scattered + bands.backscatter(z.double())
    return Case(
        image, z, sigma.float(), medium.to(torch.float32), scattered, signal - direct, exact
    )


def errors(result: Tensor, exact: Tensor) -> dict[str, float | None]:
    """Largest error, RMSE, PSNR (None if there is no error) and SSIM of an image on a scale of 0…1."""
    from skimage.metrics import structural_similarity

    difference = result.double() - exact
    rmse = float((difference**2).mean().sqrt())
    planar = [x[0].double().numpy() for x in (result, exact)]
    return {
        "max": float(difference.abs().max()),
        "rmse": rmse,
        "psnr_db": -20 * math.log10(rmse) if rmse > 0 else None,
        "ssim": float(structural_similarity(*planar, channel_axis=0, data_range=1.0)),
    }


def pareto(points: list[tuple[float, float]]) -> list[int]:
    """Indices of the (time, error) pairs that no other pair beats, in order of time."""
    front: list[int] = []
    for i in sorted(range(len(points)), key=points.__getitem__):
        if not front or points[i][1] < points[front[-1]][1] or points[i] == points[front[-1]]:
            front.append(i)
    return front


def excess(points: list[tuple[float, float]], ours: int) -> tuple[float, int]:
    """How much slower `ours` is than the fastest of equal or better error (0 = on the front), and which that is."""
    time, error = points[ours]
    rivals = [i for i, p in enumerate(points) if p[1] <= NEAR_TIE * error]
    best = min(rivals, key=lambda i: points[i][0])
    return (time / points[best][0] - 1, best) if points[best][0] < time else (0.0, ours)


def judged(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """A panel's entries with its front marked, and the verdict on our default."""
    points = [(e["median_ms"], e["rmse"]) for e in entries]
    on = pareto(points)
    for i, entry in enumerate(entries):
        entry["front"] = i in on
    ours = next(i for i, e in enumerate(entries) if e["default"])
    slower, best = excess(points, ours)
    return {
        "entries": entries,
        "verdict": {
            "default": entries[ours]["name"],
            "psnr_db": entries[ours]["psnr_db"],
            "on_front": slower == 0,
            "slower_than_front": slower,
            "within_10_percent": slower <= WITHIN,
            "beaten_by": None if slower == 0 else entries[best]["name"],
        },
    }


def blur_panel(size: int, widest: float, rounds: int, seconds: float) -> list[dict[str, Any]]:
    """Time of the blur alone; error of the final image, and of the blur itself."""
    c = case(size, widest)
    low, high = (float(v) for v in c.sigma.aminmax())
    demand = uwaug.blur_demand(c.medium, DISTANCES)
    default = demand.plan((size, size))
    plans = {
        f"ours, tolerance {t:g}": plan_blur(low, high, t) for t in (0.01, 0.002, 0.0005, 0.0001)
    }
    # the one that is the default, which the strength of forward scatter in this water relaxes, would race itself
    plans = {
        n: p
        for n, p in plans.items()
        if len(p.sigmas) != len(default.sigmas) or p.reach > 1.01 * default.reach
    }
    plans["ours, default"] = default
    methods: dict[str, Callable[[], Tensor | np.ndarray]] = {
        name: partial(blurs.stack, c.image, c.sigma, plan) for name, plan in plans.items()
    }
    for name, plan in plans.items():
        if max(plan.cells) > 1:
            full = replace(plan, cells=(1.0,) * len(plan.cells))
            methods[f"{name}, no coarse grids"] = partial(blurs.stack, c.image, c.sigma, full)
    methods["ours, whole image (varying_blur)"] = partial(
        uwaug.varying_blur, c.image, c.sigma, default
    )
    methods["our plan, OpenCV blurs"] = partial(blurs.stack_opencv, c.image, c.sigma, default)
    planes, widths = c.image[0].permute(1, 2, 0).contiguous().numpy(), c.sigma[0, 0].numpy()
    for n in (8, 16, 32, 64):
        methods[f"{n} hard bins, kornia"] = partial(blurs.hard_bins_kornia, c.image, c.sigma, n)
        methods[f"{n} hard bins, OpenCV"] = partial(
            blurs.hard_bins, planes, widths, n, blurs.opencv_gaussian
        )
    for n in (4, 8, 16):
        methods[f"{n} linear bins, OpenCV"] = partial(blurs.linear_bins, planes, widths, n)
    methods["16 hard bins, scipy"] = partial(
        blurs.hard_bins, planes, widths, 16, blurs.scipy_gaussian
    )
    methods["16 hard bins, skimage"] = partial(
        blurs.hard_bins, planes, widths, 16, blurs.skimage_gaussian
    )
    methods["published, 30 bins 15×15"] = partial(blurs.published, planes, widths)
    methods["two 1-D passes"] = partial(blurs.two_passes, c.image, c.sigma)
    times = race(methods, rounds, seconds, "ours, default")
    entries = []
    for name, run in methods.items():
        out = blurs.planar(run()).double()
        wrong = errors(out, c.scattered)
        final = errors(c.exact + c.share * (out - c.scattered), c.exact)
        entries.append(
            {
                "name": name,
                "default": name == "ours, default",
                **times[name],
                **final,
                "blur_alone": wrong,
            }
        )
    _, took = blurs.exact(c.image, c.sigma, most=4)
    entries.append(
        {"name": "exact, per pixel", "default": False, "median_ms": took, "estimated": True,
         **errors(c.exact, c.exact), "blur_alone": errors(c.exact, c.exact)}
    )  # fmt: skip
    return entries


def pointwise(c: Case, medium: Medium, scattered: Tensor) -> Tensor:
    out, sums = torch.empty_like(c.image), medium.sums(near=False)
    for rows in row_strips(*c.image.shape[1:]):
        image, z, blurred = (t[..., rows, :] for t in (c.image, c.z, scattered))
        (out[..., rows, :],) = together(image, curves(sums, z), blurred)
    return out


def table_lookup(c: Case, table: Tensor, farthest: float, scattered: Tensor) -> Tensor:
    """Direct, share and veil (3×3 curves) interpolated linearly in a table over 0…farthest."""
    out = torch.empty_like(c.image)
    for rows in row_strips(*c.image.shape[1:]):
        image, z, blurred = (t[0, :, rows] for t in (c.image, c.z, scattered))
        place = (z * ((table.shape[1] - 1) / farthest)).flatten().clamp(0, table.shape[1] - 1.001)
        index = place.int()
        left, right = table.index_select(1, index), table.index_select(1, index + 1)
        direct, share, veil = torch.lerp(left, right, place - index).reshape(3, *image.shape)
        out[0, :, rows] = veil.addcmul_(share, blurred).addcmul_(direct, image)
    return out


def three_wavelengths(water: str) -> dict[str, Tensor]:
    """Coefficients of the channels, taken at 600, 550 and 450 nm; 1 m deep, g = .2, μ = .3."""
    one = uwaug.Water.jerlov(water).at(np.array([450.0, 550.0, 600.0]))
    a, b, kd = (torch.from_numpy(v[::-1].copy()) for v in (one.a, one.b, one.kd))
    G, light = a + 0.2 * b, torch.exp(-kd)
    return {"beta": a + b, "G": G, "veil": 0.3 * b * light / G, "light": light}


def spectra_panel(size: int, water: str, rounds: int, seconds: float) -> list[dict[str, Any]]:
    """Time of all that a pixel does by itself: curves, veil, sum; the blurred image is given, exact."""
    c = case(size, 4.5, water)
    scattered = c.scattered.float()
    media: dict[str, Medium] = {}
    for tolerance in np.geomspace(0.5, 1e-5, 120):
        medium = water_medium(water, 4.5, tolerance=float(tolerance))
        media.setdefault(f"{medium.beta.shape[1]} + {medium.G.shape[1]} rates", medium)
    default = f"{c.medium.beta.shape[1]} + {c.medium.G.shape[1]} rates"
    ours = f"ours, default ({default})"
    media[ours] = c.medium
    del media[default]  # the first tolerance that gave as many
    media["7 bands"] = water_medium(
        water, 4.5, tolerance=0.0, wavelengths=np.arange(400.0, 701.0, 50.0)
    )
    media["61 bands"] = bands = water_medium(water, 4.5, tolerance=0.0)
    media["3 wavelengths"] = Medium.from_coefficients(**three_wavelengths(water))
    methods: dict[str, Method] = {
        n: partial(pointwise, c, m.to(torch.float32), scattered) for n, m in media.items()
    }
    for entries in (32, 256, 2048):
        z = torch.linspace(0, DISTANCES[1], entries, dtype=torch.float64)
        direct = bands.transmission(z)[0]
        table = torch.cat([direct, bands.signal(z)[0] - direct, bands.backscatter(z)[0]]).float()
        methods[f"table of {entries}"] = partial(table_lookup, c, table, DISTANCES[1], scattered)
    times = race(methods, rounds, seconds, ours)
    return [
        {"name": n, "default": n == ours, **times[n], **errors(run(), c.exact)}
        for n, run in methods.items()
    ]


def number_panel(size: int, rounds: int, seconds: float) -> list[dict[str, Any]]:
    """The whole model on images and distances of each type."""
    c = case(size, 4.5)
    methods: dict[str, Method] = {}
    for tolerance in (0.002, 1e-5):
        medium = water_medium("7C", 4.5, tolerance=tolerance)
        for dtype in (torch.float64, torch.float32, torch.bfloat16):
            degrade = uwaug.Underwater(
                medium.to(torch.promote_types(dtype, torch.float32)), DISTANCES, tolerance, "linear"
            )
            name = f"{str(dtype).removeprefix('torch.')}, tolerance {tolerance:g}"
            methods[name] = partial(degrade, c.image.to(dtype), c.z.to(dtype))
    ours = "float32, tolerance 0.002"
    times = race(methods, rounds, seconds, ours)
    return [
        {"name": n, "default": n == ours, **times[n], **errors(run(), c.exact)}
        for n, run in methods.items()
    ]


def naive(c: Case, image: Tensor, z: Tensor) -> Tensor:
    """The recipe as one writes it with kornia: three wavelengths, 30 hard bins, source order."""
    channels = {k: v.float() for k, v in three_wavelengths("7C").items()}
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # it reads the ends of its bins from tensors that record gradients
        return baselines.naive_kornia(
            image, z, torch.ones_like(z), **channels, phi=4.5 / DISTANCES[1]
        )


def exported(
    degrade: uwaug.Underwater, threads: int, folder: str
) -> Callable[[Tensor, Tensor], Tensor]:
    """The module as ONNX Runtime runs it."""
    from uwaug.onnx import OnnxUnderwater, export_onnx

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter, about itself
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)
        path = export_onnx(degrade, Path(folder) / "model.onnx", verify=False)
    return OnnxUnderwater(path, threads)


def runtime_panel(
    size: int,
    backward: bool,
    threads: int,
    rounds: int,
    seconds: float,
    compiled: bool,
    skipped: list[str],
) -> list[dict[str, Any]]:
    """The whole model, forward or forward and backward (to image and distance), as each runtime runs it."""
    c = case(size, 4.5)
    degrade = uwaug.Underwater(c.medium, DISTANCES, color_space="linear")
    runs: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
        "eager": degrade,
        "eager, no distance_range": uwaug.Underwater(c.medium, None, color_space="linear"),
        "naive kornia, 3 wavelengths": partial(naive, c),
    }
    if compiled:
        torch._dynamo.reset()
        runs["torch.compile"] = torch.compile(degrade, fullgraph=True)
    else:
        skipped.append("torch.compile (takes too long for --quick)")
    with contextlib.ExitStack() as stack:
        missing = [
            p for p in ("onnx", "onnxscript", "onnxruntime") if importlib.util.find_spec(p) is None
        ]
        if missing or not compiled:
            skipped.append(
                f"ONNX Runtime ({', '.join(missing) + ' missing' if missing else 'too long for --quick'})"
            )
        elif not backward:
            runs["ONNX Runtime"] = exported(
                degrade, threads, stack.enter_context(tempfile.TemporaryDirectory())
            )

        def once(run: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
            if not backward:
                with torch.no_grad():
                    return run(c.image, c.z)
            image, z = (t.clone().requires_grad_() for t in (c.image, c.z))
            out = run(image, z)
            out.sum().backward()
            return out.detach()

        methods: dict[str, Method] = {name: partial(once, run) for name, run in runs.items()}
        times = race(methods, rounds, seconds, "eager")
        return [
            {"name": n, "default": n == "eager", **times[n], **errors(run(), c.exact)}
            for n, run in methods.items()
        ]


def report(panels: dict[str, dict[str, Any]]) -> None:
    """Say of each panel whether our default is on the front, or how far off and beaten by what."""
    print(f"\n{'panel':<52} default")
    for name, panel in panels.items():
        v = panel["verdict"]
        stands = (
            "on front"
            if v["on_front"]
            else f"{100 * v['slower_than_front']:.0f} % off: {v['beaten_by']}"
        )
        print(f"{name:<52} {v['psnr_db']:5.1f} dB  {stands}")


def main(quick: bool = False) -> dict[str, Any]:
    """Run all panels; return what is saved (nothing is, if quick)."""
    rounds, seconds = (1, 1.0) if quick else (25, 6.0)
    settings = [(64, 1)] if quick else [(256, 1), (512, 1), (1024, 1), (512, 2)]
    panels: dict[str, dict[str, Any]] = {}
    skipped: list[str] = []
    for size, threads in settings:
        use_threads(threads)
        parts: dict[str, Callable[[], list[dict[str, Any]]]] = {
            "blur 0.9…4.5 px": partial(blur_panel, size, 4.5, rounds, seconds),
            "spectra 7C": partial(spectra_panel, size, "7C", rounds, seconds),
            "spectra I": partial(spectra_panel, size, "I", rounds, seconds),
            "number format": partial(number_panel, size, rounds, seconds),
            "forward": partial(
                runtime_panel, size, False, threads, rounds, seconds, not quick, skipped
            ),
            "forward + backward": partial(
                runtime_panel, size, True, threads, rounds, seconds, not quick, skipped
            ),
        }
        if 64 < size <= 512:
            parts["blur 6…30 px"] = partial(blur_panel, size, 30.0, rounds, seconds)
        for part, run in parts.items():
            with contextlib.nullcontext() if part == "forward + backward" else torch.no_grad():
                panel = {"part": part, "size": size, "threads": threads, **judged(run())}
            name = f"{part}, {size}², {threads} thread{'s' * (threads > 1)}"
            panels[name] = panel
            for e in panel["entries"]:
                psnr = "     ∞" if e["psnr_db"] is None else f"{e['psnr_db']:6.1f}"
                mark = "●" if e["default"] else "·" if e["front"] else " "
                print(
                    f"{name:<46} {mark} {e['name']:<34} {e['median_ms']:9.2f} ms {psnr} dB",
                    flush=True,
                )
    report(panels)
    results = {
        "scene": "motorcycle, 1…5 m, Jerlov 7C (spectra also I), d = 1 m, g = .2, μ = .3, linear light",
        "skipped": sorted(set(skipped)),
        "panels": panels,
    }
    if not quick:
        from benchmarks.charts import draw_frontier

        print(save("frontier", results), draw_frontier(results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
