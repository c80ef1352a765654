"""Are the pictures that `RandomUnderwater()` makes worth training on? 200 default draws a scene,
and how near draws lie to photographs.

`--pairs FOLDER` adds pictures with distances of one's own: `NAME_rgb.png` beside
`NAME_depth_mm.png` (16 bit, 0 = unknown). The committed figures are those of the bundled scene and
of five public RGB-D pairs (GEOMAR, ICL-NUIM twice, Middlebury, TUM).

`--sources FOLDER` holds pictures in air with distances, `NAME.jpg` and `distances.npz` with a map
(HxW, m) by each name; 16 draws of each are held against the photographs (see
`benchmarks.accuracy.photographs`), with all ranges of the defaults and with one range left out at a
time. The committed figures are those of 40 pictures: five RGB-D pairs and 35 photographs with
invented distances. Without a folder the bundled scene stands for them, which says little.
"""

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib.figure import Figure
from PIL import Image
from torch import Tensor
from torch.nn.functional import interpolate

import uwaug
from benchmarks.accuracy.photographs import Picture, closeness
from benchmarks.harness import RESULTS, machine, save
from uwaug.distance.convert import fill_unknown
from uwaug.formation.colour import LUMINANCE
from uwaug.presets.scene import motorcycle
from uwaug.transforms.random_underwater import GOOD_WATERS

DRAWS = 200
WIDTH = 320  # px, at which the pictures are degraded
SHEET = (4, 6)  # rows and columns of default draws
SEED = 7
BARS = {
    "kept": "10–95 % of the contrast left at the median distance",
    "veil": "veil at most 1",
    "bright": "the brightest channel's mean at least .1",
}


class Pair(NamedTuple):
    """A picture (3xHxW, sRGB) and its distance (1xHxW, m)."""

    name: str
    image: Tensor
    distance: Tensor


def bundled() -> Pair:
    """The scene of the package."""
    scene = motorcycle()
    return _resized("motorcycle", scene.image, scene.distance)


def pairs(folder: Path) -> list[Pair]:
    """The pairs of a folder."""
    found = []
    for path in sorted(folder.glob("*_rgb.png")):
        name = path.name.removesuffix("_rgb.png")
        image = np.array(Image.open(path).convert("RGB"))
        depth = np.array(Image.open(folder / f"{name}_depth_mm.png")).astype(np.float32) / 1000
        light = torch.from_numpy(image).permute(2, 0, 1) / 255
        distance = fill_unknown(torch.from_numpy(depth)[None])
        found.append(_resized(name, light, distance))
    return found


def _resized(name: str, image: Tensor, distance: Tensor) -> Pair:
    size = (round(WIDTH * image.shape[-2] / image.shape[-1]), WIDTH)
    small = interpolate(image[None], size, mode="bilinear", antialias=True)[0]
    return Pair(name, small.clamp(0, 1), interpolate(distance[None], size, mode="nearest")[0])


def judged(aug: uwaug.RandomUnderwater, pair: Pair, index: int) -> tuple[Tensor, dict[str, Any]]:
    """A draw on a pair, and what is to be said of it.

    Contrast is the standard deviation of luminance in the degraded picture, in sRGB values, over
    that in air: of the pixels whose distance is among the middle 40 %.
    """
    generator = torch.Generator().manual_seed(SEED * 100_000 + index)
    record = aug.make_params(pair.image, generator)
    picture = aug.transform(pair.image, pair.distance, record)
    sample = record["samples"][0]
    low, high = torch.quantile(pair.distance, torch.tensor([0.3, 0.7]))
    middle = (pair.distance[0] >= low) & (pair.distance[0] <= high)
    share = _deviation(picture, middle) / _deviation(pair.image, middle)
    (wet,) = aug.in_water(pair.image, pair.distance, record, lambda wet: wet).values()
    veil = float(wet.scene.medium.backscatter(wet.scene.z).max())
    judgement = {
        "water": sample["waters"][0],
        "contrast": sample.get("contrast"),
        "contents": wet.contents,
        "gain": float(wet.scene.gain),
        "share": share,
        "veil": veil,
        "brightest_channel": float(picture.mean((1, 2)).max()),
    }
    judgement["good"] = {
        "kept": 0.10 <= share <= 0.95,
        "veil": veil <= 1 + 1e-6,
        "bright": judgement["brightest_channel"] >= 0.1,
    }
    return picture, judgement


def _deviation(picture: Tensor, where: Tensor) -> float:
    weights = torch.tensor(LUMINANCE).view(3, 1, 1)
    return float((picture * weights).sum(0)[where].std())


def measure(scenes: list[Pair], aug: uwaug.RandomUnderwater, draws: int) -> dict[str, Any]:
    """The bars on each scene, as shares of its draws."""
    table = {}
    for pair in scenes:
        found = [judged(aug, pair, index)[1] for index in range(draws)]
        row: dict[str, Any] = {}
        for bar in BARS:
            row[bar] = sum(one["good"][bar] for one in found) / draws
        shares = sorted(one["share"] for one in found)
        row["share_of_contrast"] = [shares[int(q * (draws - 1))] for q in (0.05, 0.5, 0.95)]
        row["largest_veil"] = max(one["veil"] for one in found)
        row["brightest_channel"] = min(one["brightest_channel"] for one in found)
        row["gains"] = [min(one["gain"] for one in found), max(one["gain"] for one in found)]
        row["largest_contents"] = max(one["contents"] for one in found)
        table[pair.name] = row
        low, middle, high = row["share_of_contrast"]
        print(
            f"{pair.name}: kept {row['kept']:.1%}, contrast {low:.2f} / {middle:.2f} / {high:.2f}, "
            f"veil ≤ {row['largest_veil']:.2f}, "
            f"brightest channel ≥ {row['brightest_channel']:.3f}, "
            f"gain {row['gains'][0]:.2g}…{row['gains'][1]:.2g}"
        )
    return table


def severities(pair: Pair, draws: int) -> dict[str, float]:
    """The loss of the picture's contrast at each grade, over all pixels."""
    everywhere, losses = torch.ones_like(pair.distance[0], dtype=torch.bool), {}
    before = _deviation(pair.image, everywhere)
    for level in range(1, 6):
        aug, left = uwaug.RandomUnderwater.severity(level), 0.0
        for index in range(draws):
            picture, _ = judged(aug, pair, index)
            left += _deviation(picture, everywhere) / before / draws
        losses[str(level)] = 1 - left
        print(f"severity {level}: {losses[str(level)]:.1%} of the contrast lost")
    return losses


def draw_sheet(pair: Pair, aug: uwaug.RandomUnderwater, path: Path) -> None:
    """Default draws of a scene, one beside the other."""
    rows, columns = SHEET
    height, width = pair.image.shape[-2:]
    figure = Figure(figsize=(columns * 1.6, rows * 1.6 * height / width), dpi=150)
    for index in range(rows * columns):
        picture, _ = judged(aug, pair, index)
        axis = figure.add_axes(
            (index % columns / columns, 1 - (index // columns + 1) / rows, 1 / columns, 1 / rows)
        )
        axis.imshow(picture.permute(1, 2, 0).numpy())
        axis.axis("off")
    figure.savefig(path, pil_kwargs={"quality": 85})


LEFT_OUT: dict[str, dict[str, Any]] = {
    "defaults": {},
    "without waters by contents": {"waters": GOOD_WATERS},
    "color_matrix 1": {"color_matrix": 1.0},
    "grey surfaces": {"surfaces": "grey", "color_matrix": None},
    "without compensation": {"compensation": None},
    "without white_balance": {"white_balance": None},
    "without saturation": {"saturation": None},
    "without black_point": {"black_point": None},
    "without gamut": {"gamut": None},
    "without tone": {"tone": None},
    "contrast .1–.6": {"contrast": (0.1, 0.6)},
    "contrast .12–.95": {"contrast": (0.12, 0.95)},
    "mu .02–.075": {"mu": (0.02, 0.075)},
    "vertical_depth 0–10 m": {"vertical_depth": (0.0, 10.0)},
}
"""What is put in place of a range, by name."""


def sources(folder: Path) -> Iterator[tuple[Tensor, Tensor]]:
    """Pictures in air (3xHxW) with distances (1xHxW, m)."""
    maps = np.load(folder / "distances.npz")
    for path in sorted(folder.glob("*.jpg")):
        image = torch.from_numpy(np.array(Image.open(path).convert("RGB"))).permute(2, 0, 1) / 255
        yield image, torch.from_numpy(maps[path.stem].astype(np.float32))[None]


def drawn(
    aug: uwaug.RandomUnderwater, scenes: Iterable[tuple[Tensor, Tensor]], each: int
) -> list[Picture]:
    """So many draws of each picture, at most 440 px wide."""
    pictures = []
    for i, (image, distance) in enumerate(scenes):
        for k in range(each):
            torch.manual_seed(1000 * i + k)
            out, _ = aug(image, distance)
            picture = (out * 255).round().byte().permute(1, 2, 0).numpy()
            cut = max(0, picture.shape[1] - 440) // 2
            pictures.append(np.ascontiguousarray(picture[:, cut : picture.shape[1] - cut]))
    return pictures


def realism(folder: Path | None, each: int, quick: bool) -> dict[str, Any]:
    """Recall, coverage and precision of the defaults, of `hazy`, and with one range left out."""
    scene = bundled()
    rows: dict[str, Any] = {}
    systems = {name: uwaug.RandomUnderwater(**options) for name, options in LEFT_OUT.items()}
    systems["hazy"] = uwaug.RandomUnderwater.hazy()
    for name, aug in systems.items():
        scenes = sources(folder) if folder else [(scene.image, scene.distance)]
        rows[name] = closeness(drawn(aug, scenes, each))
        pairs = (f"{measure} {a:.2f} / {b:.2f}" for measure, (a, b) in rows[name].items())
        print(f"{name}: {', '.join(pairs)}", flush=True)
        if quick:
            break
    return rows


def main(quick: bool = False, folder: Path | None = None, air: Path | None = None) -> None:
    """Measure, print and save."""
    aug, own = uwaug.RandomUnderwater(), bundled()
    scenes = [own] + (pairs(folder) if folder else [])
    draws = 4 if quick else DRAWS
    table = measure(scenes, aug, draws)
    worst = min(min(row[bar] for bar in BARS) for row in table.values())
    print(f"worst share of good draws: {worst:.1%}")
    losses = severities(own, 2 if quick else 40)
    rows = realism(air, 8 if quick else 16 if air else 200, quick)
    if quick:
        return
    figures = RESULTS.parent / "figures"
    draw_sheet(own, aug, figures / "default-draws.jpg")
    results = {"draws": draws, "scenes": table, "severity": losses, "photographs": rows}
    save("draws", {"machine": machine(), **results})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--pairs", type=Path)
    parser.add_argument("--sources", type=Path)
    arguments = parser.parse_args()
    main(arguments.quick, arguments.pairs, arguments.sources)
