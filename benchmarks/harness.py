"""What every benchmark shares: fair races, a record of the machine, results written whole."""

import argparse
import json
import os
import platform
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from uwaug._support.atomic import written_whole
from uwaug.optics.camera import load_camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.reduction import attenuations
from uwaug.optics.water import Water
from uwaug.presets.scene import motorcycle_depth

ROOT = Path(__file__).parent.parent
RESULTS = Path(__file__).parent / "results"
DISTANCES = (1.0, 5.0)  # m, of `scene`
WIDEST = 4.5  # px, at the farthest of them; .9 at the nearest
PACKAGES = ("torch", "kornia", "numpy", "opencv-python-headless", "scipy", "jerlov", "onnxruntime")


def use_threads(threads: int) -> None:
    """Give torch and OpenCV so many threads, and the allocator the state of a process that has
    handled a batch.

    glibc hands freed memory back to the system until a large block has been freed once; until then
    every call pays for page faults, ours and the baselines' alike, by chance of the heap's layout.
    """
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    block = torch.zeros(7_000_000)
    del block


def race(
    runners: Mapping[str, Callable[[], object]],
    rounds: int = 15,
    seconds: float = 20.0,
    reference: str | None = None,
) -> dict[str, dict[str, float]]:
    """Time the runners in turn, round after round in an order drawn anew, so that a noisy machine
    slows all alike.

    Each is run once untimed just before, as `torch.utils.benchmark` does, so that it finds its own
    data in the caches and not its predecessor's. `seconds` counts from the fourth round on, which
    what takes ten times as long as `reference` does not run.

    Returns:
        For each name: median and quartiles in milliseconds, and the number of rounds.
    """
    times: dict[str, list[float]] = {name: [] for name in runners}
    order = random.Random(0)
    for run in runners.values():
        run()
    start = time.perf_counter()
    running = list(runners)
    for n in range(rounds):
        if n == 3:
            start = time.perf_counter()
        elif n > 3 and time.perf_counter() - start > seconds:
            break
        if n >= 3 and reference is not None:
            medians = {name: np.median(taken) for name, taken in times.items()}
            running = [name for name in runners if medians[name] < 10 * medians[reference]]
        for name in order.sample(running, len(running)):
            runners[name]()
            began = time.perf_counter()
            runners[name]()
            times[name].append(1e3 * (time.perf_counter() - began))
    found = {}
    for name, taken in times.items():
        first, median, third = (float(q) for q in np.percentile(taken, (25, 50, 75)))
        spread = {"median_ms": median, "q1_ms": first, "q3_ms": third}
        found[name] = {**spread, "rounds": len(taken)}
    return found


def printed(code: str, *arguments: str, **environment: str) -> str:
    """What Python code prints in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env={**os.environ, **environment},
    )
    return done.stdout


def command(main: Callable[[bool], object], about: str | None) -> None:
    """Run a part of the benchmarks from the command line."""
    parser = argparse.ArgumentParser(description=about)
    quick = "a smoke test: little of everything, nothing written"
    parser.add_argument("--quick", action="store_true", help=quick)
    measure_eager()
    main(parser.parse_args().quick)


@contextmanager
def loops(used: bool) -> Iterator[None]:
    """Where pictures are formed by the compiled loops, or by PyTorch."""
    before = os.environ.get("UWAUG_FAST", "1")
    os.environ["UWAUG_FAST"] = "1" if used else "0"
    try:
        yield
    finally:
        os.environ["UWAUG_FAST"] = before


def by_loops(model: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """A model as the compiled loops run it."""

    def run(*inputs: Tensor) -> Tensor:
        with loops(True):
            return model(*inputs)

    return run


def measure_eager() -> None:
    """Let "uwaug" be eager PyTorch where a benchmark does not ask for the loops."""
    os.environ.setdefault("UWAUG_FAST", "0")


def machine() -> dict[str, Any]:
    """Processor, threads, versions and commit."""
    commit = _git("rev-parse", "--short", "HEAD")
    changed = _git("status", "--porcelain", "*.py")
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in PACKAGES if _installed(name)},
        "commit": f"{commit}-dirty" if changed else commit,
    }


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    for line in lines:
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.processor()


def _git(*arguments: str) -> str:
    done = subprocess.run(
        ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip()


def _installed(package: str) -> bool:
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True


def save(name: str, results: Mapping[str, Any]) -> Path:
    """Write results, with the machine, to results/NAME.json: whole or not at all."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    with written_whole(path) as part:
        part.write_text(json.dumps({"machine": machine(), **results}, indent=1) + "\n")
    return path


@lru_cache(maxsize=1)
def motorcycle() -> tuple[Tensor, Tensor]:
    """scikit-image's motorcycle: sRGB (1x3x500x741) and depth in metres (1x1x500x741), unknown
    pixels filled.

    The depth is planar, as in all results so far; `uwaug.presets.scene` has distances
    along the ray.
    """
    image, depth = motorcycle_depth()
    return image[None], depth[None]


def water_medium(water: str, widest: float = WIDEST, **options: Any) -> Medium:
    """A Jerlov type whose widths are proportional to distance, up to `widest` px at the farthest.

    The default is the range that the issue names.
    """
    law = PointSpread(1.0)
    medium = Medium.from_water(Water.jerlov(water), g=0.2, point_spread=law, **options)
    return replace(medium, scale=widest / DISTANCES[1] / medium.b_mean)


def banded_medium(water: str, wavelengths: Sequence[float]) -> Medium:
    """A Jerlov type 1 m deep by some wavelengths alone, each a rate."""
    spectra = Water.jerlov(water).at(wavelengths)
    weights = torch.from_numpy(load_camera("Nikon 5100 (NPL)").weights(wavelengths).T)[None]
    beta, G = (torch.from_numpy(x)[None] for x in attenuations(spectra.a, spectra.b, 0.2))
    light = torch.from_numpy(np.exp(-spectra.kd))
    veil = 0.3 * torch.from_numpy(spectra.b) * light / G
    like = water_medium(water).without_lamps()
    return replace(
        like,
        beta=beta,
        direct_weights=weights * light,
        G=G,
        signal_weights=weights * light,
        veil_weights=weights * veil[:, None],
        notes=(),
    )


def scene(size: int, batch: int = 1) -> tuple[Tensor, Tensor]:
    """Picture and distance (1…5 m) of a square `size`, cut or tiled from the motorcycle scene,
    repeated `batch` times.
    """
    image, depth = motorcycle()
    (near, far), (low, high) = DISTANCES, depth.aminmax()
    distance = near + (far - near) * (depth - low) / (high - low)
    return _square(image, size, batch), _square(distance, size, batch)


def _square(picture: Tensor, size: int, batch: int) -> Tensor:
    """Tiled with its mirror images, so that no tile ends in an edge."""
    tiles = -(-size // 500)
    row = torch.cat([picture, picture.flip(-1)] * tiles, -1)
    sheet = torch.cat([row, row.flip(-2)] * tiles, -2)
    return sheet[..., :size, :size].repeat(batch, 1, 1, 1).contiguous()
