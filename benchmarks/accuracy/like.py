"""Do draws of `uwaug.like` look like the photograph they were fitted to?

`--photographs FOLDER` holds real underwater photographs, called SET_NUMBER.jpg; `--sources FOLDER`
pictures in air with distances, see `benchmarks.accuracy.draws`. To each of 100 photographs `like`
is fitted on one half of the pictures in air, and draws of the other half are judged, beside those
of the defaults and beside a transfer of colour (Reinhard et al. 2001: mean and spread of L*, a* and
b* of the photograph). The method was chosen on 36 other photographs.

Pictures are judged at 112 px, which most of the photographs have, by how far they are from the
photograph: root mean square over some of the 26 numbers of `benchmarks.accuracy.photographs`, in
standard deviations of the photographs.

    water     the 12 numbers that `like` looks at
    all       all 26
    neither   the 10 that neither `like` nor the transfer was given: contrast of detail at three
              scales, spectrum, light of top and middle, clipping, blue against green

What a transfer cannot do is see distance. "fading" is the rank correlation of distance with what is
left of local contrast: water takes more of it from what is farther, so it must be negative.
Without folders a draw of the bundled scene stands for a photograph, which says nothing.
"""

import argparse
import time
import warnings
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.stats import spearmanr
from skimage.color import lab2rgb, rgb2lab
from torch import Tensor
from torch.nn.functional import interpolate

import uwaug
from benchmarks.accuracy.draws import picture_of, sources
from benchmarks.accuracy.photographs import numbers_of
from benchmarks.harness import save
from uwaug.transforms.appearance import WATER_FEATURES

REFERENCES = 100
CHOSEN_ON = 36  # photographs, by this seed:
SEED = 5
LOOKED_AT = 8  # pictures in air that `like` gets
DEFAULTS = 4  # default draws of each picture
SHORT = 112  # px

OF_NEITHER = [
    *("sd_BG", "corr_BG", "loc2", "loc6", "loc18"),
    *("slope", "clip_hi", "clip_lo", "top_bottom", "centre_edge"),
]

Numbers = NDArray[np.float64]


def references(folder: Path | None) -> tuple[list[Tensor], list[Tensor]]:
    """Photographs (3xHxW, uint8): as many as are judged, of all sets in turn; and all."""
    if folder is None:
        image, distance = next(sources(None))
        wet, _ = uwaug.RandomUnderwater("5C").at(0, 0, 0)(image, distance)
        return [(wet * 255).byte()], [(wet * 255).byte(), (image * 255).byte()]
    paths = sorted(folder.glob("*.jpg"))
    order = np.random.default_rng(SEED).permutation(len(paths))[CHOSEN_ON:]
    turns: dict[str, int] = defaultdict(int)
    ranked = []
    for place, i in enumerate(order):
        name = paths[i].stem.partition("_")[0]
        ranked.append((turns[name], place, i))
        turns[name] += 1
    photographs = [
        torch.from_numpy(np.array(Image.open(path).convert("RGB"))).permute(2, 0, 1)
        for path in paths
    ]
    return [photographs[i] for _, _, i in sorted(ranked)[:REFERENCES]], photographs


def judged(picture: Tensor, short: int = SHORT) -> dict[str, float]:
    """The 26 numbers of a picture (3xHxW: uint8, or 0…1), with a short side of so many px."""
    values = picture.float() / (255 if picture.dtype == torch.uint8 else 1)
    scale = short / min(values.shape[-2:])
    size = [round(scale * side) for side in values.shape[-2:]]
    small = interpolate(values[None], size, mode="bilinear", antialias=True)[0]
    return numbers_of(picture_of(small))


def transferred(picture: Tensor, reference: Tensor) -> Tensor:
    """A picture (3xHxW, 0…1) with mean and spread of L*, a*, b* of a reference."""
    own = rgb2lab(picture.permute(1, 2, 0).numpy())
    other = rgb2lab(reference.permute(1, 2, 0).numpy())
    ends = (0, 1)
    spread = other.std(ends) / np.maximum(own.std(ends), 1e-3)  # of a plain picture
    lab = (own - own.mean(ends)) * spread + other.mean(ends)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of colours that sRGB does not have
        rgb = lab2rgb(lab).clip(0, 1).astype(np.float32)
    return torch.from_numpy(rgb).permute(2, 0, 1)


def fading(air: Tensor, picture: Tensor, distance: Tensor) -> float:
    """Rank correlation of distance with what is left of local contrast."""
    before, after = (_local_contrast(x) for x in (air, picture))
    z = distance[0].numpy()
    # where there was contrast to lose
    used = np.isfinite(z) & (z > 0) & (before > np.median(before))
    left = np.log(after[used] + 1e-3) - np.log(before[used])
    return float(spearmanr(left[::7], z[used][::7]).statistic)


def _local_contrast(picture: Tensor) -> Numbers:
    """Spread of luminance near each pixel, of sRGB values."""
    grey = picture.double().mean(0).numpy()
    mean = gaussian_filter(grey, 3.0)
    spread: Numbers = np.sqrt(np.maximum(gaussian_filter(grey * grey, 3.0) - mean * mean, 1e-8))
    return spread


def main(
    quick: bool = False, photographs: Path | None = None, folder: Path | None = None
) -> dict[str, Any]:
    """Measure, print and save."""
    chosen, every = references(photographs)
    chosen = chosen[:3] if quick else chosen
    scenes = list(sources(folder))
    fitted, other = scenes[0::2], scenes[1::2] or scenes
    # spread over the half, as the command line takes them
    looked = fitted[:: max(1, len(fitted) // LOOKED_AT)][:LOOKED_AT]
    all_numbers = [judged(photograph) for photograph in every]
    names = list(all_numbers[0])
    spreads = np.std([list(numbers.values()) for numbers in all_numbers], 0) + 1e-9
    of = {"water": list(WATER_FEATURES), "all": names, "neither": OF_NEITHER}
    places = {kind: [names.index(name) for name in some] for kind, some in of.items()}

    def away(drawn: Numbers, reference: Numbers) -> dict[str, float]:
        """Median distance of pictures, by kind of numbers."""
        apart = ((drawn - reference) / spreads).clip(-4, 4) ** 2
        return {
            kind: float(np.median(np.sqrt(apart[:, some].mean(1)))) for kind, some in places.items()
        }

    def row(picture: Tensor) -> list[float]:
        return list(judged(picture).values())

    default = uwaug.RandomUnderwater()
    defaults = np.array(
        [
            row(default.at(0, i, n)(*scene)[0])
            for i, scene in enumerate(other)
            for n in range(1 if quick else DEFAULTS)
        ]
    )
    rows = []
    for n, reference in enumerate(chosen):
        goal = np.array(row(reference))
        began = time.perf_counter()
        augment = uwaug.like(
            reference,
            [image for image, _ in looked],
            [distance for _, distance in looked],
            draws=30 if quick else 300,
            keep=2 if quick else 10,
        )
        seconds = time.perf_counter() - began
        wet = [augment.at(1, i, 0)(*scene)[0] for i, scene in enumerate(other)]
        copied = [transferred(image, reference) for image, _ in other]
        rows.append(
            {
                "default": away(defaults, goal),
                "like": away(np.array([row(picture) for picture in wet]), goal),
                "transfer": away(np.array([row(picture) for picture in copied]), goal),
                "fading": {
                    name: float(np.median([fading(x, y, z) for (x, z), y in pairs]))
                    for name, pairs in (
                        ("like", list(zip(other, wet, strict=True))),
                        ("transfer", list(zip(other, copied, strict=True))),
                    )
                },
                "seconds": seconds,
                "doubt": bool(augment.conditions.nearness.doubt),
            }
        )
        if n % 10 == 9:
            print(n + 1, summary(rows), flush=True)
    found = summary(rows)
    print(found)
    if photographs and not quick:
        save("like", {"references": len(rows), **found})
    return found


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Mean over references of the median distances, and how often which is nearer."""
    kinds = ("water", "all", "neither")
    found: dict[str, Any] = {
        method: {kind: round(float(np.mean([r[method][kind] for r in rows])), 3) for kind in kinds}
        for method in ("like", "default", "transfer")
    }
    for rival in ("default", "transfer"):
        found[f"nearer than {rival}"] = {
            kind: sum(r["like"][kind] < r[rival][kind] for r in rows) for kind in kinds
        }
    found["fading"] = {
        name: round(float(np.median([r["fading"][name] for r in rows])), 3)
        for name in ("like", "transfer")
    }
    found["fades more than transfer"] = sum(
        r["fading"]["like"] < r["fading"]["transfer"] for r in rows
    )
    found["seconds"] = round(float(np.median([r["seconds"] for r in rows])), 2)
    found["doubts"] = sum(r["doubt"] for r in rows)
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a smoke test, nothing written")
    parser.add_argument("--photographs", type=Path)
    parser.add_argument("--sources", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    main(arguments.quick, arguments.photographs, arguments.sources)
