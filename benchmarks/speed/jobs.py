"""Files per second of `uwaug degrade`, against what its pictures cost apart.

`python -m benchmarks.speed.jobs` writes results/jobs.json: 200 files of 500×741 px with two
workers, against reading, degrading and encoding one picture, each timed by itself (their sum for
all pictures, divided by two). The parts are timed in two processes at once, before and after the
run, as a machine with others on it is not the same from minute to minute. What does not depend on
that: how much more one picture takes in `degrader`, which hashes, writes a record and flushes
to the disk too, than its parts do just before; and the share of the run that workers spend in
`degrader`, and not in beginning and waiting. The one divided by the other is the ratio too.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from uwaug.io.read import read_picture_file
from uwaug.io.write import FORMATS, encode
from uwaug.jobs import Degrader, Item, Items, Recipe
from uwaug.jobs.pool import run

from benchmarks.harness import ROOT, command, save
from uwaug.presets import scene

WANTED = 1.25
"""Times the sum of the parts."""

WORKERS = 2


def files(folder: Path, end: str, count: int) -> None:
    """So many pictures that differ, and their distances."""
    motorcycle = scene.motorcycle()
    pixels = (motorcycle.image * 255).round().byte().permute(1, 2, 0).numpy()
    (folder / "all").mkdir()
    for number in range(count):
        options = {"quality": 95} if end == ".jpg" else {}
        shown = Image.fromarray(np.roll(pixels, number, 1))
        shown.save(folder / f"all/{number:04}{end}", **options)
    np.save(folder / "z.npy", motorcycle.distance[0].float().numpy())


def _apart(name: str, end: str, count: int) -> None:
    """Print the milliseconds of each part, and of the whole."""
    torch.set_num_threads(1)
    folder, recipe = Path(name), Recipe(random=True)
    waters, times = recipe.open(), []
    degrader = Degrader(recipe, force=True)
    with tempfile.TemporaryDirectory(dir=folder) as out:
        for number in range(count + 2):
            picture, target = folder / f"all/{number:04}{end}", Path(out) / f"{number}{end}"
            began = time.perf_counter()
            source = read_picture_file(picture)
            size = (source.image.shape[-2], source.image.shape[-1])
            distance, _ = recipe.distance.read(folder / "z.npy", size)
            read = time.perf_counter()
            made = waters.degrade(source.image, distance, None, number)
            formed = time.perf_counter()
            with target.open("wb") as file:
                encode(file, FORMATS[end], made.image, source)
            encoded = time.perf_counter()
            item = Item("a", picture, folder / "z.npy", target)
            outcome = degrader(item)
            if outcome.status != "done":
                raise RuntimeError(outcome.reason)
            times.append([read - began, formed - read, encoded - formed, outcome.seconds])
    print(json.dumps((1e3 * np.array(times[2:])).mean(0).tolist()))


def apart(folder: Path, end: str, count: int) -> dict[str, float]:
    """Mean milliseconds of a picture, in as many processes at once as there are workers."""
    code = f"from benchmarks.speed.jobs import _apart; _apart({str(folder)!r}, {end!r}, {count})"
    begun = []
    for _ in range(WORKERS):
        arguments = [sys.executable, "-c", code]
        begun.append(subprocess.Popen(arguments, stdout=subprocess.PIPE, cwd=ROOT))
    found = [json.loads(process.communicate()[0].splitlines()[-1]) for process in begun]
    names = ("read", "degrade", "encode", "degrader")
    return dict(zip(names, np.mean(found, 0).tolist(), strict=True))


def together(folder: Path, count: int) -> dict[str, float]:
    """Seconds of a run, until its first picture was there, and that pictures took."""
    items = Items([folder / "all"], str(folder / "z.npy"), folder / "out")
    first = inside = 0.0
    began = time.perf_counter()
    for number, outcome in enumerate(run(items, Recipe(random=True), workers=WORKERS)):
        if outcome.status != "done":
            raise RuntimeError(outcome.reason)
        inside += outcome.seconds
        if number == 0:
            first = time.perf_counter() - began
    return {"seconds": time.perf_counter() - began, "first": first, "inside": inside}


def measured(end: str, count: int, sample: int) -> dict[str, Any]:
    """Of one format."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files(folder, end, count)
        before = apart(folder, end, sample)
        taken = together(folder, count)
        after = apart(folder, end, sample)
    parts = {key: (before[key] + after[key]) / 2 for key in before}
    whole = parts.pop("degrader")
    expected = sum(parts.values()) * count / 1e3 / WORKERS
    busy = taken["inside"] / taken["seconds"] / WORKERS
    found = {
        "files": count,
        "workers": WORKERS,
        "parts_ms": parts,
        "degrader_ms": whole,
        "seconds": taken["seconds"],
        "first_after_s": taken["first"],
        "expected_s": expected,
        "ratio": taken["seconds"] / expected,
        "degrader_ratio": whole / sum(parts.values()),
        "busy": busy,
        "ratio_by_shares": whole / sum(parts.values()) / busy,
    }
    told = ", ".join(f"{key} {ms:.0f}" for key, ms in parts.items())
    print(f"{end}: {told} ms; degrader {whole:.0f} ms (× {found['degrader_ratio']:.2f})")
    print(
        f"   {count} files {taken['seconds']:.1f} s, first after {taken['first']:.1f} s: ", end=""
    )
    by_shares = found["ratio_by_shares"]
    print(f"× {found['ratio']:.2f}, by shares × {by_shares:.2f}", flush=True)
    return found


def main(quick: bool = False) -> dict[str, Any]:
    """Print and save; return what is saved (nothing is, if quick)."""
    count, sample = (4, 1) if quick else (200, 15)
    formats = {}
    for end in (".jpg",) if quick else (".jpg", ".png"):
        formats[end] = measured(end, count, sample)
    results = {"wanted": WANTED, "formats": formats}
    if not quick:
        print(save("jobs", results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
