"""Pictures in air with distances, and draws of `RandomUnderwater` on them."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.nn.functional import interpolate

import uwaug
from benchmarks.accuracy.photographs import Picture
from uwaug.presets.scene import motorcycle

SIDE = 256  # px, short side of the bundled scene


def sources(folder: Path | None) -> Iterator[tuple[Tensor, Tensor]]:
    """Pictures in air (3xHxW, short side 256 px) with distances (1xHxW, m): `NAME.jpg`, and
    `distances.npz` with a map by each name. Without a folder the bundled scene stands for them,
    which says little.
    """
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
            yield picture_of(out)


def picture_of(values: Tensor) -> Picture:
    """A picture (3xHxW, 0…1) as bytes (HxWx3)."""
    return (values.clamp(0, 1) * 255).round().byte().permute(1, 2, 0).numpy()
