"""How near do draws of `RandomUnderwater()` lie to real underwater photographs?

`--sources FOLDER` holds pictures in air (short side 256 px) with distances: `NAME.jpg`, and
`distances.npz` with a map (HxW, m) by each name. 16 draws of each are held against the photographs
(see `benchmarks.accuracy.photographs`): of the defaults with three seeds, and with one range of
theirs changed at a time with one. The committed figures are those of 40 pictures: five RGB-D pairs
and 35 photographs with invented distances. Without a folder the bundled scene stands for them,
which says little.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.nn.functional import interpolate

import uwaug
from benchmarks.accuracy.photographs import (
    MEASURES,
    Picture,
    closeness,
    dead,
    neon,
    neutral,
    numbers_of,
)
from benchmarks.harness import save
from uwaug import RandomDevelopment, RandomLight, RandomWater
from uwaug.presets.scene import motorcycle

EACH = 16  # draws of a picture
SEEDS = 3  # of the defaults
SIDE = 256  # px, short side of the bundled scene

CHANGED: dict[str, dict[str, Any]] = {
    "defaults": {},
    "Jerlov types alone": {"water": RandomWater(("IB", "II", "III", "1C", "3C", "5C"))},
    "contrast .07–.4": {"water": RandomWater(contrast=(0.07, 0.4))},
    "no lamps": {"light": RandomLight(share=0.0)},
    "grey surfaces": {"water": RandomWater(color_matrix=None)},
    "white_balance −.8….8": {"development": RandomDevelopment(white_balance=(-0.8, 0.8))},
    "saturation 1": {"development": RandomDevelopment(saturation=1.0)},
    "gamut 0": {"development": RandomDevelopment(gamut=0.0)},
}
"""What is put in place of a range of the defaults, by name."""


MIDDLE = {"chroma": "chroma", "lightness": "L_mean", "log₂ R/G": "log_RG"}
"""Numbers whose medians over all pictures are told."""


def sources(folder: Path | None) -> Iterator[tuple[Tensor, Tensor]]:
    """Pictures in air (3xHxW) with distances (1xHxW, m); the bundled scene without a folder."""
    if folder is None:
        scene = motorcycle()
        size = SIDE, round(SIDE * scene.image.shape[-1] / scene.image.shape[-2])
        small = interpolate(scene.image[None], size, mode="bilinear", antialias=True)[0]
        yield small.clamp(0, 1), interpolate(scene.distance[None], size, mode="nearest")[0]
        return
    maps = np.load(folder / "distances.npz")
    for path in sorted(folder.glob("*.jpg")):
        image = torch.from_numpy(np.array(Image.open(path).convert("RGB"))).permute(2, 0, 1) / 255
        yield image, torch.from_numpy(maps[path.stem].astype(np.float32))[None]


def draws(
    augment: uwaug.RandomUnderwater, folder: Path | None, each: int, seed: int
) -> Iterator[Picture]:
    """So many draws of each picture."""
    for index, (image, distance) in enumerate(sources(folder)):
        for draw in range(each):
            out, _ = augment.at(seed=seed, epoch=index, index=draw)(image, distance)
            yield (out * 255).round().byte().permute(1, 2, 0).numpy()


def measured(
    augment: uwaug.RandomUnderwater, folder: Path | None, each: int, seeds: int
) -> dict[str, Any]:
    """Each measure by all numbers and by those of water, the shares of neon, dead and neutral
    pictures, and medians of what the middle of the draws is: means over the seeds, and standard
    deviations.
    """
    rows = []
    for seed in range(seeds):
        numbers, shares = [], []
        for picture in draws(augment, folder, each, seed):
            numbers.append(numbers_of(picture))
            shares.append((neon(picture), dead(picture), neutral(numbers[-1])))
        medians = [np.median([row[name] for row in numbers]) for name in MIDDLE.values()]
        rows.append([*closeness(numbers).ravel(), *np.mean(shares, 0), *medians])
    means, spreads = (values.round(4).tolist() for values in (np.mean(rows, 0), np.std(rows, 0)))
    names = [f"{measure}, {kind}" for measure in MEASURES for kind in ("all", "water")]
    names += ["neon", "dead", "neutral", *MIDDLE]
    return {
        name: {"mean": mean, "deviation": spread}
        for name, mean, spread in zip(names, means, spreads, strict=True)
    }


def main(quick: bool = False, folder: Path | None = None) -> None:
    """Measure, print and save."""
    each = 8 if quick else EACH if folder else 40 * EACH
    found = {}
    for name, options in CHANGED.items():
        seeds = 1 if quick or options else SEEDS
        found[name] = measured(uwaug.RandomUnderwater(**options), folder, each, seeds)
        means = (f"{key} {value['mean']:.3f}" for key, value in found[name].items())
        print(f"{name}: {'; '.join(means)}", flush=True)
        if quick:
            return
    save("draws", {"draws": each, "seeds": SEEDS, "photographs": found})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke test, nothing written")
    parser.add_argument("--sources", type=Path)
    arguments = parser.parse_args()
    main(arguments.quick, arguments.sources)
