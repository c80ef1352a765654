"""What every benchmark shares: fair races, a record of the machine, results written whole."""

import argparse
import json
import os
import platform
import random
import subprocess
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import skimage.data
import torch
from torch import Tensor

RESULTS = Path(__file__).parent / "results"
PACKAGES = ("torch", "kornia", "numpy", "opencv-python-headless", "scipy", "jerlov", "onnxruntime")


def use_threads(threads: int) -> None:
    """Give torch and OpenCV so many threads, and the allocator the state of a process that has handled a batch.

    glibc hands freed memory back to the system until a large block has been freed once; until then every call pays for
    page faults, ours and the baselines' alike, by chance of the heap's layout.
    """
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    block = torch.zeros(7_000_000)
    del block


def race(
    runners: dict[str, Callable[[], object]],
    rounds: int = 15,
    seconds: float = 20.0,
    reference: str | None = None,
) -> dict[str, dict[str, float]]:
    """Time the runners in turn, round after round in an order drawn anew, so that a noisy machine slows all alike.

    Each is run once untimed just before, as `torch.utils.benchmark` does, so that it finds its own data in the caches
    and not its predecessor's. `seconds` counts from the fourth round on, which what takes ten times as long as
    `reference` does not run.

    Returns:
        For each name: median and quartiles in milliseconds, and the number of rounds.
    """
    times: dict[str, list[float]] = {name: [] for name in runners}
    order = random.Random(0)
    for run in runners.values():
        run()
    start = time.perf_counter()
    for n in range(rounds):
        if n == 3:
            start = time.perf_counter()
        elif n > 3 and time.perf_counter() - start > seconds:
            break
        running = list(runners)
        if reference is not None and n >= 3:
            running = [
                name
                for name in runners
                if np.median(times[name]) < 10 * np.median(times[reference])
            ]
        for name in order.sample(running, len(running)):
            runners[name]()
            began = time.perf_counter()
            runners[name]()
            times[name].append(1e3 * (time.perf_counter() - began))
    quartiles = {name: np.percentile(t, (25, 50, 75)) for name, t in times.items()}
    return {
        name: {
            "median_ms": float(q[1]),
            "q1_ms": float(q[0]),
            "q3_ms": float(q[2]),
            "rounds": len(times[name]),
        }
        for name, q in quartiles.items()
    }


def command(main: Callable[[bool], object], about: str | None) -> None:
    """Run a part of the benchmarks from the command line."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument(
        "--quick", action="store_true", help="a smoke test: little of everything, nothing written"
    )
    main(parser.parse_args().quick)


def machine() -> dict[str, Any]:
    """Processor, threads, versions and commit."""
    model = platform.processor()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [
            line.split(":", 1)[1].strip()
            for line in cpuinfo.read_text().splitlines()
            if line.startswith("model name")
        ]
        model = names[0] if names else model
    commit = _git("rev-parse", "--short", "HEAD") + (
        "-dirty" if _git("status", "--porcelain", "*.py") else ""
    )
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in PACKAGES if _installed(name)},
        "commit": commit,
    }


def _git(*arguments: str) -> str:
    done = subprocess.run(
        ["git", *arguments], cwd=RESULTS.parent.parent, capture_output=True, text=True, check=False
    )
    return done.stdout.strip()


def _installed(package: str) -> bool:
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True


def save(name: str, results: dict[str, Any]) -> Path:
    """Write results, with the machine, to results/NAME.json: whole or not at all."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    part = path.with_suffix(".part")
    part.write_text(json.dumps({"machine": machine(), **results}, indent=1) + "\n")
    part.replace(path)
    return path


def motorcycle() -> tuple[Tensor, Tensor]:
    """scikit-image's motorcycle scene: sRGB (1x3x500x741) and depth in metres (1x1x500x741), unknown pixels filled."""
    from uwaug.distance import fill_unknown, from_disparity

    left, _, disparity = skimage.data.stereo_motorcycle()
    image = torch.from_numpy(left).permute(2, 0, 1)[None].float() / 255
    depth = from_disparity(
        torch.from_numpy(disparity.astype(np.float32))[None, None], 994.978, 0.193001, 31.086
    )
    return image, fill_unknown(depth)


def scene(size: int, batch: int = 1) -> tuple[Tensor, Tensor]:
    """Picture and distance (1…5 m) of a square `size`, cut or tiled from the motorcycle scene, repeated `batch`
    times.
    """
    image, depth = motorcycle()
    near, far = depth.aminmax()
    distance = 1 + 4 * (depth - near) / (far - near)
    reps = -(-size // 500)
    image, distance = (
        torch.cat(
            [torch.cat([t, t.flip(-1)] * reps, -1), torch.cat([t, t.flip(-1)] * reps, -1).flip(-2)]
            * reps,
            -2,
        )
        for t in (image, distance)
    )
    return tuple(
        t[..., :size, :size].repeat(batch, 1, 1, 1).contiguous() for t in (image, distance)
    )  # type: ignore[return-value]
