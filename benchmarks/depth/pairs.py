"""Pictures with measured distances: a folder of `NAME.jpg`, `NAME.png` and `table.csv`.

A map has 16 bits: 0 is unknown, else 1 + 65534·(l − low)/(high − low), l being the logarithm of the
distance; `low` and `high` stand in the table. A source is what stands before the number in a name.
"""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

Array = np.ndarray[Any, Any]


@dataclass
class Pair:
    """A picture (HxWx3 bytes) and the logarithm of its distances (HxW, NaN unknown)."""

    name: str
    picture: Array
    log: Array

    @property
    def source(self) -> str:
        """The place or camera it comes from."""
        return self.name.rsplit("_", 1)[0]


def read(folder: Path) -> list[Pair]:
    """All pairs of a folder; or of one with `NAME_rgb.png` and `NAME_depth_mm.png`, 0 unknown."""
    if not (folder / "table.csv").is_file():
        return [_in_millimetres(path) for path in sorted(folder.glob("*_rgb.png"))]
    pairs = []
    with (folder / "table.csv").open() as table:
        for row in csv.DictReader(table):
            picture = np.asarray(Image.open(folder / f"{row['name']}.jpg").convert("RGB"))
            levels = np.asarray(Image.open(folder / f"{row['name']}.png")).astype(float)
            low, high = float(row["low"]), float(row["high"])
            log = np.where(levels > 0, low + (high - low) * (levels - 1) / 65534, np.nan)
            pairs.append(Pair(row["name"], picture, log))
    return pairs


def _in_millimetres(path: Path) -> Pair:
    name = path.name.removesuffix("_rgb.png")
    picture = Image.open(path).convert("RGB")
    levels = Image.open(path.with_name(f"{name}_depth_mm.png"))
    share = min(1.0, 256 / max(picture.size))
    size = [round(share * side) for side in picture.size]
    millimetres = np.asarray(levels.resize(size, Image.Resampling.NEAREST)).astype(float)
    log = np.log(np.where(millimetres > 0, millimetres / 1000, np.nan))
    # each is a place of its own
    return Pair(f"{name}_0", np.asarray(picture.resize(size, Image.Resampling.BOX)), log)
