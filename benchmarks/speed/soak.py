"""Memory and time of a loader's worker that gets pictures of random sizes, one after the other.

`python -m benchmarks.speed.soak` writes results/soak.json: resident memory of a process of its own
after 100 and after 5000 pictures of 64…320 px, and after 30 and 300 of 400…1100 px, each degraded
by a `RandomUnderwater` whose waters are drawn from ranges. Next to it: the time per pixel with
random sizes and with one size. One thread.
"""

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

import uwaug
from benchmarks.harness import command, printed, save

SMALL, LARGE = (64, 320), (400, 1100)  # px, either side
WANTED = 1.5
"""Times the memory after the first hundred pictures."""


def augmentation() -> uwaug.RandomUnderwater:
    """Waters that do not come twice, with the heavy tails of the calibrated law."""
    return uwaug.RandomUnderwater(
        visibility=(2.0, 10.0),
        vertical_depth=(0.0, 5.0),
        point_spread=uwaug.PointSpread(30.0, 0.62, "exponential"),
    )


def degrade(augment: uwaug.RandomUnderwater, height: int, width: int) -> None:
    image, distance = torch.rand(3, height, width), 1 + 4 * torch.rand(1, height, width)
    augment(image, distance)


def sizes(low: int, high: int, count: int, seed: int) -> list[tuple[int, int]]:
    drawn = np.random.default_rng(seed).integers(low, high + 1, (count, 2))
    return [(int(height), int(width)) for height, width in drawn]


def resident() -> float:
    """MiB that this process holds. Linux."""
    status = Path("/proc/self/status").read_text()
    (line,) = (line for line in status.splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


def _soak(low: int, high: int, counts: list[int]) -> list[float]:
    """MiB after so many pictures."""
    torch.set_num_threads(1)
    augment, held = augmentation(), []
    for done, (height, width) in enumerate(sizes(low, high, counts[-1], 0), 1):
        degrade(augment, height, width)
        if done in counts:
            held.append(resident())
    return held


def soak(low: int, high: int, counts: list[int]) -> dict[str, Any]:
    """Memory after some counts of pictures, in a process of its own."""
    code = "import json, sys; from benchmarks.speed.soak import _soak"
    code += "; print(json.dumps(_soak(*json.loads(sys.argv[1]))))"
    asked = json.dumps([low, high, counts])
    held = [float(mib) for mib in json.loads(printed(code, asked, OMP_NUM_THREADS="1"))]
    told = ", ".join(f"{mib:.0f} MiB after {n}" for n, mib in zip(counts, held, strict=True))
    print(f"{low}…{high} px: {told}: × {held[-1] / held[0]:.2f}", flush=True)
    return {"sides": [low, high], "counts": counts, "mib": held, "growth": held[-1] / held[0]}


def _per_pixel(shapes: list[tuple[int, int]]) -> float:
    """Nanoseconds per pixel of pictures of these sizes."""
    augment = augmentation()
    for height, width in shapes[:10]:
        degrade(augment, height, width)
    began = time.perf_counter()
    for height, width in shapes:
        degrade(augment, height, width)
    pixels = sum(height * width for height, width in shapes)
    return 1e9 * (time.perf_counter() - began) / pixels


def pace(low: int, high: int, count: int, rounds: int) -> dict[str, Any]:
    """Time with random sizes and with one of as many pixels, in turn; medians."""
    torch.set_num_threads(1)
    side = round((low + high) / 2)
    # a loader that has run for a while knows its plans
    _per_pixel(sizes(low, high, 5 * count, 0))
    times: dict[str, list[float]] = {"random sizes": [], "one size": []}
    for n in range(rounds):
        times["random sizes"].append(_per_pixel(sizes(low, high, count, n + 1)))
        times["one size"].append(_per_pixel([(side, side)] * count))
    found = {name: float(np.median(taken)) for name, taken in times.items()}
    ratio = found["random sizes"] / found["one size"]
    told = ", ".join(f"{name} {ns:.0f} ns a pixel" for name, ns in found.items())
    print(f"{low}…{high} px: {told}: × {ratio:.2f}", flush=True)
    return {"sides": [low, high], "ns_per_pixel": found, "ratio": ratio}


def main(quick: bool = False) -> dict[str, Any]:
    """Print and save both; return what is saved (nothing is, if quick)."""
    small, large, count, rounds = [100, 1000, 5000], [30, 300], 60, 7
    if quick:
        small, large, count, rounds = [5, 10], [2, 3], 3, 2
    memory = [soak(*SMALL, small), soak(*LARGE, large)]
    times = [pace(*SMALL, count, rounds), pace(*LARGE, max(3, count // 6), rounds)]
    results = {"wanted": WANTED, "memory": memory, "time": times}
    if not quick:
        print(save("soak", results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
