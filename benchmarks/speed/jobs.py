"""Files per second of `uwaug degrade`: 200 files of 500×741 px with two workers, beside reading,
degrading and encoding them one by one, divided by two.

`python -m benchmarks.speed.jobs` writes results/jobs.json.
"""

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

import uwaug
from benchmarks.harness import command, loops, save, use_threads
from uwaug.files import Recipe, degrade, find_items, read_distance, read_picture, write_picture
from uwaug.presets import scene

WORKERS = 2


def files(folder: Path, end: str, count: int) -> None:
    """So many pictures that differ, and their distances."""
    motorcycle = scene.motorcycle()
    pixels = (motorcycle.image * 255).round().byte().permute(1, 2, 0).numpy()
    (folder / "all").mkdir()
    for number in range(count):
        shown = Image.fromarray(np.roll(pixels, number, 1))
        shown.save(folder / f"all/{number:04}{end}")
    np.save(folder / "z.npy", motorcycle.distance[0].float().numpy())


def apart(folder: Path, end: str, count: int) -> dict[str, float]:
    """Mean milliseconds of each step of a picture."""
    use_threads(1)
    augment = uwaug.RandomUnderwater()
    times = []
    for number in range(count + 2):
        began = time.perf_counter()
        image = read_picture(folder / f"all/{number:04}{end}")
        distance = read_distance(folder / "z.npy")
        read = time.perf_counter()
        made = augment.at(0, 0, number)(image, distance)[0]
        formed = time.perf_counter()
        write_picture(folder / f"one{end}", made)
        times.append([read - began, formed - read, time.perf_counter() - formed])
    means = 1e3 * np.array(times[2:]).mean(0)
    return dict(zip(("read", "degrade", "write"), means.tolist(), strict=True))


def measured(end: str, count: int, sample: int) -> dict[str, Any]:
    """A run over files of one format, and its steps apart."""
    with tempfile.TemporaryDirectory() as name, loops(True), torch.no_grad():
        folder = Path(name)
        files(folder, end, max(count, sample + 2))
        steps = apart(folder, end, sample)
        items = find_items(folder / "all", folder / "z.npy")
        began = time.perf_counter()
        summary = degrade(Recipe(uwaug.RandomUnderwater()), items, folder / "out", workers=WORKERS)
        seconds = time.perf_counter() - began
    if summary.failures:
        raise RuntimeError(summary.failures[0])
    expected = sum(steps.values()) * len(items) / 1e3 / WORKERS
    found = {"files": len(items), "steps_ms": steps, "seconds": seconds, "expected_s": expected}
    print(end, found)
    return found


def main(quick: bool = False) -> dict[str, Any]:
    """Print and save; return what is saved (nothing is, if quick)."""
    count, sample = (4, 1) if quick else (200, 15)
    formats = {
        end: measured(end, count, sample) for end in ((".jpg",) if quick else (".jpg", ".png"))
    }
    results = {"workers": WORKERS, "formats": formats}
    if not quick:
        print(save("jobs", results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
