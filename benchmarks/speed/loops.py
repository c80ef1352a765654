"""The compiled loops against eager PyTorch, the published recipe, its authors' loops and a plain
loop in C++, in the same run.

`python -m benchmarks.speed.loops` writes results/fused.json and prints the tables. Survey preset,
Jerlov 7C, 1…5 m, float32, no gradients. What shares this machine slows all alike: read the ratios.
"""

import tempfile
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from referees import published
from torch import Tensor

import uwaug
from benchmarks.harness import command, printed, race, save, scene, use_threads
from benchmarks.speed import scaling
from uwaug import fused

Runners = dict[str, Callable[[], object]]

WATER = "7C"
EVERYTHING: dict[str, Any] = {
    "mixing": (0.0, 1.0),
    "g": (0.03, 0.07),
    "mu": (0.05, 0.1),
    "blur_factor": (0.7, 1.4),
}
"""What the default does not draw from ranges."""

FIRST = """
import time, torch, uwaug
degrade = uwaug.load_preset("survey", water="7C").module()
image, distance = torch.rand(1, 3, 64, 64), torch.full((1, 1, 64, 64), 2.0)
began = time.perf_counter()
with torch.no_grad():
    degrade(image, distance)
print(time.perf_counter() - began)
"""


def by(path: bool, run: Callable[..., object], *given: object) -> Callable[[], object]:
    """A run by the loops, or by eager PyTorch."""

    def forced() -> object:
        with fused.use(path):
            return run(*given)

    return forced


def module(color_space: Any) -> uwaug.Underwater:
    """The whole model of the survey."""
    degrade = uwaug.load_preset("survey", water=WATER).module()
    degrade.color_space = color_space
    return degrade


def direct_and_veil(image: Tensor, distance: Tensor, field: Tensor) -> Tensor:
    """A model without forward scatter, one exponential for each channel and term."""
    found = published.three_wavelengths(WATER)
    beta, G, veil, light = (
        found[name].float().view(1, 3, 1, 1) for name in ("beta", "G", "veil", "light")
    )
    path = distance * field
    return light * torch.exp(-beta * path) * image + veil * (1 - torch.exp(-G * path))


def _race(runners: Runners, quick: bool) -> dict[str, dict[str, float]]:
    with torch.no_grad():
        return race(runners, 3 if quick else 45, 0.5 if quick else 30.0)


def _said(times: dict[str, dict[str, float]]) -> str:
    ours = next(iter(times.values()))["median_ms"]
    parts = []
    for name, taken in times.items():
        parts.append(f"{name} {taken['median_ms']:.2f} ms (×{taken['median_ms'] / ours:.2f})")
    return ", ".join(parts)


def _row(times: dict[str, dict[str, float]], **about: Any) -> dict[str, Any]:
    ours = next(iter(times.values()))["median_ms"]
    faster = {name: taken["median_ms"] / ours for name, taken in times.items()}
    print(", ".join(f"{name} {value}" for name, value in about.items()), "|", _said(times))
    return {**about, "ms": times, "times_faster": faster}


def whole_model(size: int, threads: int, quick: bool) -> dict[str, Any]:
    """With field, in linear light."""
    use_threads(threads)
    image, distance = scene(size)
    field = uwaug.gaussian_random_field(distance.shape)
    degrade, bands = module("linear"), published.bands(WATER)
    planes = (image[0].permute(1, 2, 0), distance[0, 0], field[0, 0])
    arrays = [np.ascontiguousarray(plane.numpy()) for plane in planes]
    given = (degrade, image, distance, field)
    runners: Runners = {
        "fused": by(True, *given),
        "eager": by(False, *given),
        "published recipe": partial(published.published, *arrays, bands),
        "direct + veil": partial(direct_and_veil, image, distance, field),
    }
    if threads == 1:
        runners["authors' loops, float32"] = partial(published.authors, *arrays, bands)
        doubled = [array.astype(np.float64) for array in arrays]
        runners["authors' loops"] = partial(published.authors, *doubled, published.doubled(bands))
    return _row(_race(runners, quick), size=size, threads=threads)


def colours(size: int, threads: int, quick: bool) -> dict[str, Any]:
    """What sRGB and bytes cost."""
    use_threads(threads)
    image, distance = scene(size)
    field, in_bytes = uwaug.gaussian_random_field(distance.shape), (image * 255).byte()
    linear, srgb = module("linear"), module("srgb")
    runners: Runners = {}
    for name, on in (("fused", True), ("eager", False)):
        runners[f"{name}, sRGB"] = by(on, srgb, image, distance, field)
        runners[f"{name}, bytes"] = by(on, srgb, in_bytes, distance, field)
        runners[f"{name}, linear"] = by(on, linear, image, distance, field)
    return _row(_race(runners, quick), size=size, threads=threads)


def plain_loop(widest: float, size: int, quick: bool) -> dict[str, Any]:
    """Against the plan as one loop in C++, without coarse grids: widths of widest/5…widest px."""
    use_threads(1)
    image, distance = scene(size)
    degrade = scaling.module(widest)
    runners: Runners = {"fused": by(True, degrade, image, distance)}
    with tempfile.TemporaryDirectory() as folder:
        runners["C++ loop"] = scaling.Fused(folder).bind(degrade, image, distance)
        runners["eager"] = by(False, degrade, image, distance)
        return _row(_race(runners, quick), size=size, widest_px=widest)


def random_water(name: str, aug: uwaug.RandomUnderwater, quick: bool) -> dict[str, Any]:
    """One worker, 256 px; eight pictures, each in a water of its own."""
    use_threads(1)
    images, distances = scene(256)
    image, distance = images[0], distances[0]
    arrays = (np.ascontiguousarray(image.permute(1, 2, 0).numpy()), distance[0].numpy())
    bands = published.bands(WATER)

    def eight() -> None:
        torch.manual_seed(0)
        for _ in range(8):
            aug(image, distance)

    def recipe() -> None:
        rng = np.random.default_rng(0)
        for _ in range(8):
            published.published(*arrays, published.field(256, 256, rng), bands)

    runners: Runners = {
        "fused": by(True, eight),
        "eager": by(False, eight),
        "published recipe": recipe,
    }
    if aug.exposure == "auto":
        runners["drawing and medium"] = partial(_settle_eight, aug, image, distance)
    return _row(_race(runners, quick), transform=name, pictures=8)


def _settle_eight(aug: uwaug.RandomUnderwater, image: Tensor, distance: Tensor) -> None:
    """What is drawn for eight pictures, and their media."""
    torch.manual_seed(0)
    for _ in range(8):
        (params,) = aug._draw(image, None)
        aug._setup(params, distance)


def first_call() -> dict[str, float]:
    """Seconds of the first picture in a process: loops from the disk, and eager."""
    found = {}
    for name, value in (("fused", "1"), ("eager", "0")):
        found[name] = min(float(printed(FIRST, UWAUG_FUSED=value)) for _ in range(3))
        print(f"first call, {name}: {found[name]:.2f} s", flush=True)
    return found


def main(quick: bool = False) -> dict[str, Any]:
    """Run all races; return what is saved (nothing is, if quick)."""
    began = time.perf_counter()
    sizes, threads, widths = (256, 512, 1024), (1, 2), (4.0, 8.0, 16.0)
    if quick:
        sizes, threads, widths = (64,), (1,), (4.0,)
    augments = {
        "survey, sRGB": uwaug.RandomUnderwater.survey(),
        "survey, linear": uwaug.RandomUnderwater.survey(color_space="linear"),
        "default": uwaug.RandomUnderwater(),
        "all from ranges": uwaug.RandomUnderwater(**EVERYTHING),
    }
    results = {
        "whole_model": [whole_model(n, t, quick) for t in threads for n in sizes],
        "colours": [colours(n, t, quick) for t in threads for n in sizes],
        "plain_loop": [],
        "random": [random_water(name, aug, quick) for name, aug in augments.items()],
        "first_call_s": first_call(),
    }
    if scaling.compiler():
        side = 64 if quick else 512
        results["plain_loop"] = [plain_loop(widest, side, quick) for widest in widths]
    print(f"{time.perf_counter() - began:.0f} s")
    if not quick:
        print(save("fused", results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
