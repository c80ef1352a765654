"""Ray on this machine against the pool of processes, and what a billion pictures would take.

`python -m benchmarks.speed.jobs_ray` writes results/jobs_ray.json: the time of a run over copies of
the motorcycle (500×741, JPEG), by the pool, by Ray into files and by Ray into shards, in turn, with
and without what starting takes; and a plan computed from it.
"""

import math
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.harness import command, save
from uwaug.jobs import Items, Recipe
from uwaug.jobs.pool import run
from uwaug.jobs.ray import LOCAL, SIZE, Shards, connected, run_on_ray
from uwaug.presets.scene import motorcycle

WANTED = 1.5
"""Times the pool."""

WORKERS = 2
RECIPE = Recipe(random=True)
A_RUN = 1_000_000
"""Pictures of one run, of a plan for many: what is listed in memory, and can be begun again."""

CORE_HOUR = 0.04
"""US dollars for an hour of one core with 4 GB: of the order of what large clouds ask."""

GIGABYTE_MONTH = 0.023
"""US dollars for keeping a gigabyte for a month, likewise."""


def pictures(folder: Path, count: int) -> Items:
    """Files in a folder, and the items that write beside it."""
    scene = motorcycle()
    values = (scene.image * 255).round().byte().permute(1, 2, 0).numpy()
    source = folder / "in"
    source.mkdir()
    Image.fromarray(np.ascontiguousarray(values)).save(source / "0.jpg", quality=95)
    np.save(source / "0.npy", scene.distance.numpy().astype(np.float32))
    for i in range(1, count):
        for end in ("jpg", "npy"):
            (source / f"{i}.{end}").hardlink_to(source / f"0.{end}")
    return Items([source], "{stem}.npy", folder / "out")


def by_pool(items: Items) -> tuple[float, float]:
    """Seconds with and without starting, from the first picture that is done."""
    return _timed(lambda: run(items, RECIPE, workers=WORKERS, force=True), items)


def by_ray(items: Items) -> tuple[float, float]:
    """Likewise, into files."""
    began = time.perf_counter()
    with connected(LOCAL, WORKERS):
        started = time.perf_counter() - began
        whole, steady = _timed(lambda: run_on_ray(items, RECIPE, force=True), items)
    return started + whole, steady


def _timed(go: Callable[[], Any], items: Items) -> tuple[float, float]:
    """The first pictures, one for each worker, wait for what is imported."""
    count = len(items)
    began, first = time.perf_counter(), 0.0
    for n, outcome in enumerate(go(), 1):
        assert outcome.status == "done", outcome.reason
        if n == WORKERS:
            first = time.perf_counter()
    ended = time.perf_counter()
    return ended - began, (ended - first) * count / (count - WORKERS)


def by_shards(items: Items) -> tuple[float, float]:
    """Seconds with starting, and without starting Ray."""
    began = time.perf_counter()
    with connected(LOCAL, WORKERS):
        started = time.perf_counter()
        shards = Shards(str(items.out.with_name("shards")))
        shards.prepare(RECIPE, force=True)
        shards.write(items, RECIPE)
        ended = time.perf_counter()
    tally = shards.tally(1)
    assert (tally.rows, tally.failed) == (len(items), 0), tally
    return ended - began, ended - started


def plan(pictures: int, core_seconds: float, size: int, cores: int) -> dict[str, Any]:
    """What many pictures would take.

    Args:
        pictures: how many.
        core_seconds: of one core, for each picture.
        size: of a picture that is written, bytes.
        cores: that work on it.
    """
    hours = pictures * core_seconds / 3600
    kept = pictures * size
    return {
        "pictures": pictures,
        "cores": cores,
        "seconds_per_picture": core_seconds,
        "core_hours": hours,
        "days": hours / cores / 24,
        "dollars": hours * CORE_HOUR,
        "terabytes": kept / 1e12,
        "dollars_a_month": kept / 1e9 * GIGABYTE_MONTH,
        "shards": math.ceil(pictures / SIZE),
        "shard_megabytes": SIZE * size / 1e6,
        "runs": math.ceil(pictures / A_RUN),
        # 8 bytes a key, of a run that goes on
        "keys_megabytes_in_a_run": 8 * min(pictures, A_RUN) / 1e6,
        "keys_gigabytes_in_one_run": 8 * pictures / 1e9,
    }


def main(quick: bool = False, count: int = 200, rounds: int = 3) -> dict[str, Any]:
    """Print and save; return what is saved (nothing is, if quick)."""
    if quick:
        count, rounds = 4, 1
    ways = {"pool": by_pool, "ray": by_ray, "shards": by_shards}
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    with tempfile.TemporaryDirectory() as folder:
        items = pictures(Path(folder), count)
        for _ in range(rounds):
            for name, way in ways.items():
                times[name].append(way(items))
                print(f"{name}: {times[name][-1][0]:.1f} s, {times[name][-1][1]:.1f} s", flush=True)
        written = sum(path.stat().st_size for path in items.out.glob("*.jpg")) / count
    found: dict[str, Any] = {"count": count, "rounds": rounds, "workers": WORKERS}
    found |= {"wanted": WANTED, "seconds": times}
    for name in ("ray", "shards"):
        both = list(zip(times[name], times["pool"], strict=True))
        whole = float(np.median([one[0] / other[0] for one, other in both]))
        steady = float(np.median([one[1] / other[1] for one, other in both]))
        found[name] = {"ratio": whole, "ratio_without_starting": steady}
        print(f"{name}: × {whole:.2f} of the pool, × {steady:.2f} without starting")
    each = WORKERS * float(np.median([one[1] for one in times["ray"]])) / count
    found["plan"] = plan(10**9, each, int(written), 1000)
    print(found["plan"])
    if not quick:
        print(save("jobs_ray", found))
    return found


if __name__ == "__main__":
    if sys.argv[1:2] == ["--count"]:
        main(count=int(sys.argv[2]), rounds=int(sys.argv[3]))
    else:
        command(main, __doc__)
