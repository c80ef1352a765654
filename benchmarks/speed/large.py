"""Memory and time of pictures of 2 to 100 megapixels, from file to file.

`python -m benchmarks.speed.large` writes results/large.json: for each size, in a process of its
own, peak resident memory (all of it: Python, PyTorch, picture and map too) and processor seconds of
reading, degrading and writing a PNG of 8 bits with a map of distances in a PNG of 16 bits; and how
much longer a pixel takes than one of the smallest picture. `RandomUnderwater("7C")` as it comes: a
field, automatic exposure, the calibrated width law. One thread.
"""

import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from imagecodecs import png_encode

import uwaug
from benchmarks.harness import command, printed, save
from uwaug._support.tiles import row_bands
from uwaug.io.distances import read_distance
from uwaug.io.read import read_picture_file
from uwaug.io.write import write_picture

SIZES = ((1155, 1733), (4000, 6000), (8660, 11547))  # px: 2, 24 and 100 megapixels
QUICK = ((64, 96), (96, 128))
WANTED = 2e9
"""Bytes at 100 megapixels."""

ROUNDS = 3
DISTANCES = (1.0, 8.0)  # m, from the top of the picture to its bottom


def _make(folder: Path, height: int, width: int) -> None:
    """A picture of shapes of some hundred px under noise, and a ramp of distances in mm."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(30, 226, (height // 100 + 2, width // 100 + 2, 3)).astype(np.float32)
    picture = np.empty((height, width, 3), np.uint8)
    across = np.linspace(0, coarse.shape[1] - 1.001, width, dtype=np.float32)
    left, share = across.astype(int), (across % 1)[:, None]
    for start, stop in row_bands(height, width):
        down = np.linspace(0, coarse.shape[0] - 1.001, height, dtype=np.float32)[start:stop]
        upper, part = down.astype(int), (down % 1)[:, None, None]
        rows = coarse[upper] * (1 - part) + coarse[upper + 1] * part
        band = rows[:, left] * (1 - share) + rows[:, left + 1] * share
        noise = rng.integers(-8, 9, band.shape, dtype=np.int8)
        picture[start:stop] = (band + noise).clip(0, 255)
    (folder / "picture.png").write_bytes(png_encode(picture, level=1))
    ramp = np.linspace(*(1000 * metres for metres in DISTANCES), height).astype(np.uint16)
    distance = np.ascontiguousarray(np.broadcast_to(ramp[:, None], (height, width)))
    (folder / "distance.png").write_bytes(png_encode(distance, level=1))


def _peak_mib() -> float:
    """Of this process, since it began. Linux."""
    status = Path("/proc/self/status").read_text()
    (line,) = (line for line in status.splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024


def _measure(folder: str, rounds: int) -> dict[str, Any]:
    """Peaks so far and seconds of the steps, in this process."""
    torch.set_num_threads(1)
    seconds, peaks, began = {}, {}, time.process_time()

    def done(step: str) -> None:
        nonlocal began
        seconds[step], peaks[step] = time.process_time() - began, _peak_mib()
        began = time.process_time()

    source = read_picture_file(Path(folder) / "picture.png")
    distance = read_distance(Path(folder) / "distance.png", "mm")
    done("read")
    augment = uwaug.RandomUnderwater("7C")
    record = augment.make_params(source.image, torch.Generator().manual_seed(1))
    out = augment.transform(source.image, distance, record)
    done("degrade")
    write_picture(Path(folder) / "out.png", out, source)
    done("write")
    again = []
    for _ in range(rounds):
        began = time.process_time()
        out = augment.transform(source.image, distance, record)
        again.append(time.process_time() - began)
    if again:
        # plans and matrices of a size are made at the first picture
        seconds["degrade"] = float(np.median(again))
    return {"seconds": seconds, "peak_mib": peaks}


def measured(height: int, width: int, rounds: int) -> dict[str, Any]:
    """A picture of one size, in a process of its own."""
    code = "import json, sys; from benchmarks.speed.large import _measure"
    code += "; print(json.dumps(_measure(sys.argv[1], int(sys.argv[2]))))"
    with tempfile.TemporaryDirectory() as folder:
        _make(Path(folder), height, width)
        found = json.loads(printed(code, folder, str(rounds), OMP_NUM_THREADS="1"))
    pixels, peak = height * width, max(found["peak_mib"].values())
    found["ns_per_pixel"] = 1e9 * found["seconds"]["degrade"] / pixels
    told = ", ".join(f"{step} {taken:.1f} s" for step, taken in found["seconds"].items())
    print(f"{pixels / 1e6:.1f} megapixels: peak {peak:.0f} MiB; {told}", flush=True)
    return {"height": height, "width": width, "peak_bytes": peak * 2**20, **found}


def main(quick: bool = False) -> dict[str, Any]:
    """Print and save; return what is saved (nothing is, if quick)."""
    pictures = []
    for height, width in QUICK if quick else SIZES:
        # a single large one takes as long as several small ones
        rounds = 0 if height * width > 50e6 else ROUNDS
        pictures.append(measured(height, width, rounds))
    ratio = pictures[-1]["ns_per_pixel"] / pictures[0]["ns_per_pixel"]
    print(f"time per pixel, largest to smallest: × {ratio:.2f}")
    results = {"wanted_bytes": WANTED, "pictures": pictures, "ratio": ratio}
    if not quick:
        print(save("large", results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
