"""Does a marker detector fail under water where it fails in our pictures?

    python -m benchmarks.evidence.markers --kit FOLDER

OpenCV reads AprilTags in the frames of a film whose corners are known, and in boards pasted into
photographs in air and degraded: by the defaults over a wide range of contrasts, and by `uwaug.like`
of five of the frames. Contrast is the spread of green in a tag, from the 10th to the 90th of a
hundred, in levels of 255. The kit is that of `benchmarks.evidence.detector`.
"""

import argparse
import importlib
import json
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from scipy.optimize import minimize

import uwaug
from benchmarks.evidence.arms import tensors
from benchmarks.evidence.tasks import Array
from benchmarks.harness import save

EDGES = (2, 6, 9, 13, 18, 25, 35, 50, 75, 110, 256)
"""Of bins of contrast."""

SCENES = 400
NEAR_PX = 4.0  # from a true corner to one that is found, on the mean
DISTANCES = (0.5, 3.0)  # m, from the camera to the floor
CONTRASTS = (0.01, 0.9)
QUALITY = 90  # of JPEG
RESAMPLES = 500

DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_16h5)


class Tag(NamedTuple):
    """A marker in a picture."""

    block: str
    contrast: float
    side: float  # px
    is_read: bool


def tags_of(picture: Array, truth: list[tuple[int, Array]], block: str) -> Iterator[Tag]:
    """What is read of the markers of a picture (HxWx3, uint8) that it holds whole."""
    green = np.ascontiguousarray(picture[..., 1])
    quads, names, _ = cv2.aruco.ArucoDetector(DICTIONARY).detectMarkers(green)
    read = [*zip(np.ravel(names), quads, strict=True)] if quads else []
    height, width = green.shape
    for name, corners in truth:
        if corners.min() < 1 or (corners > [width - 2, height - 2]).any():
            continue
        mask = np.zeros_like(green)
        cv2.fillConvexPoly(mask, corners.round().astype(np.int32), 1)
        low, high = np.percentile(green[mask > 0], (10, 90))
        side = np.linalg.norm(corners - np.roll(corners, 1, 0), axis=1).mean()
        hit = any(
            other == name and np.linalg.norm(quad[0] - corners, axis=1).mean() < NEAR_PX
            for other, quad in read
        )
        yield Tag(block, high - low, side, hit)


def of_film(kit: Any, folder: Path) -> list[Tag]:
    """Of the frames."""
    groups = json.loads((folder / "choose/groups.json").read_text())["tags"]
    truth, tags = kit.tags("choose/tags", folder), []
    for frame in kit.load("choose/tags", folder):
        boards = [(t["id"], np.array(t["corners"])) for t in truth.get(frame.name, [])]
        tags += tags_of(frame.image, boards, groups[frame.name])
    return tags


def of_boards(
    kit: Any, folder: Path, augment: uwaug.RandomUnderwater, sides: tuple[float, float]
) -> list[Tag]:
    """Of boards in photographs, degraded, with markers of such sides."""
    photographs, tags = kit.load("land/train", folder), []
    rng = np.random.default_rng(0)
    names = sorted({t["id"] for some in kit.tags("choose/tags", folder).values() for t in some})
    for index in range(SCENES):
        photograph = cv2.resize(photographs[index % len(photographs)].image, (640, 480))
        air, corners, ids = kit.tag_scene(photograph, rng, ids=names, low=sides[0], high=sides[1])
        (image,) = tensors([air])
        wet = augment.at(0, 0, index)(image)
        levels = wet.clamp(0, 1).mul(255).round().byte().permute(1, 2, 0).numpy()
        file = cv2.imencode(".jpg", levels, (cv2.IMWRITE_JPEG_QUALITY, QUALITY))[1]
        picture = cv2.imdecode(file, cv2.IMREAD_COLOR)
        tags += tags_of(picture, [*zip(ids, corners, strict=True)], str(index))
    return tags


def curve(tags: list[Tag]) -> dict[str, Any]:
    """Shares that are read by contrast, and the contrast at which half are, with 95 %."""
    contrast, read = np.array([t.contrast for t in tags]), np.array([t.is_read for t in tags])
    bins = np.digitize(contrast, EDGES) - 1
    _, unit, sizes = np.unique([t.block for t in tags], return_inverse=True, return_counts=True)
    picked = np.random.default_rng(0).integers(0, len(sizes), (RESAMPLES, len(sizes)))
    often = np.stack([np.bincount(row, minlength=len(sizes)) for row in picked])[:, unit]
    halves = [half_read(contrast, read, row) for row in (np.ones(len(tags)), *often)]
    rows = []
    for place in range(len(EDGES) - 1):
        inside = bins == place
        if inside.sum() < 5:
            continue
        weights = often[:, inside]
        with np.errstate(invalid="ignore"):
            shares = weights @ read[inside] / weights.sum(1)
        ends = np.nanpercentile(shares, (2.5, 97.5)).tolist()
        row = {"contrast": float(np.median(contrast[inside])), "tags": int(inside.sum())}
        rows.append({**row, "share": float(read[inside].mean()), "interval": ends})
    return {
        "tags": len(tags),
        "read": float(read.mean()),
        "sides_px": np.percentile([t.side for t in tags], (5, 50, 95)).tolist(),
        "half": halves[0],
        "half_interval": np.nanpercentile(halves[1:], (2.5, 97.5)).tolist(),
        "bins": rows,
    }


def half_read(contrast: Array, read: Array, weights: Array) -> float:
    """Contrast at which a logistic curve over its logarithm is a half."""
    log = np.log(np.maximum(contrast, 1))

    def loss(at: Array) -> float:
        margin = np.exp(at[1]) * (log - at[0])
        return float((weights * np.logaddexp(0, np.where(read, -margin, margin))).sum())

    return float(np.exp(minimize(loss, (np.log(20.0), 1.0), method="Nelder-Mead").x[0]))


def main(folder: Path) -> dict[str, Any]:
    """Read, compare, print, save and draw."""
    torch.set_num_threads(1)
    sys.path.insert(0, str(folder))
    kit = importlib.import_module("kit")
    film = of_film(kit, folder)
    sides = tuple(np.percentile([t.side for t in film], (2.5, 97.5)))
    frames = kit.load("choose/tags", folder)
    shown = [*tensors([frame.image.copy() for frame in frames[:: len(frames) // 5][:5]])]
    air = [*tensors([x.image.copy() for x in kit.load("land/train", folder)[::22][:8]])]
    plain = uwaug.RandomUnderwater(distance=DISTANCES)
    wide = uwaug.RandomUnderwater(uwaug.RandomWater(contrast=CONTRASTS), distance=DISTANCES)
    curves = {"film": curve(film)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of contents and draws that are far: the sweep is wide
        augments = {"defaults": wide, "like": uwaug.like(shown, air, augment=plain)}
        for name, augment in augments.items():
            curves[name] = curve(of_boards(kit, folder, augment, sides))
    for name, of in curves.items():
        print(name, {key: value for key, value in of.items() if key != "bins"}, flush=True)
        for row in of["bins"]:
            print("  ", row)
    return curves


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kit", type=Path, required=True)
    main(parser.parse_args().kit)
