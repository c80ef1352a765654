"""People, other things and skies of photographs with boxes, to train on and to judge by.

`python -m benchmarks.depth.people --photographs FOLDER --out FOLDER` cuts them out along their
outlines (GrabCut, by OpenCV). Which of them are clean, and who is judged by, was chosen by looking
(`people.csv`). A folder has `images/NAME.jpg` and `labels/NAME.txt`, lines of YOLO's boxes.
"""

import argparse
import csv
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from scipy.ndimage import binary_dilation, binary_fill_holes, binary_opening, label
from torch.nn.functional import interpolate, pad

from uwaug.distance import cue

Array = np.ndarray[Any, Any]
Maps = tuple[Array, Array, Array, Array]
"""A picture (HxWx3 bytes); logarithms of distance, what is open, and what each counts (HxW)."""

SIDE = 384  # px, the longer one of photographs
_TRAINED_SIDE = 256
_PERSON = 0
_CUT = {_PERSON, 2, 5, 7, *range(14, 24), 77}  # vehicles, animals, toys


def chosen(use: str) -> list[tuple[str, int]]:
    """Names of photographs and lines of their boxes: of "train", "judge" or "sky" (no line)."""
    with Path(__file__).with_name("people.csv").open() as table:
        rows = csv.DictReader(table)
        return [(row["name"], int(row["line"])) for row in rows if row["use"] == use]


def photograph(folder: Path, name: str, side: int = SIDE) -> tuple[Array, list[tuple[int, Array]]]:
    """A picture, and the class of each thing with its top, left, bottom, right (px)."""
    picture = Image.open(folder / "images" / f"{name}.jpg").convert("RGB")
    picture.thumbnail((side, side), Image.Resampling.BOX)
    boxes = []
    for line in (folder / "labels" / f"{name}.txt").read_text().splitlines():
        kind, x, y, w, h = map(float, line.split())
        ends = np.array([y - h / 2, x - w / 2, y + h / 2, x + w / 2])
        width, height = picture.size
        boxes.append((int(kind), np.rint(ends * [height, width, height, width]).astype(int)))
    return np.asarray(picture), boxes


def outlined(picture: Array, box: Array, is_person: bool) -> Array | None:
    """The pixels of what is in a box (HxW), unless they are clearly not it."""
    import cv2

    top, left, bottom, right = box.clip(0, [*picture.shape[:2]] * 2)
    height, width = bottom - top, right - left
    if height < 44 or width < 16:
        return None
    likely = np.full(picture.shape[:2], cv2.GC_BGD, np.uint8)
    likely[top:bottom, left:right] = cv2.GC_PR_FGD
    if is_person and height > 1.5 * width:
        for aside in (left, right - width // 5):  # of the head
            likely[top : top + height // 8, aside : aside + width // 5] = cv2.GC_PR_BGD
        middle = slice(left + int(0.42 * width), left + int(0.58 * width))
        likely[top + height // 20 : top + height // 2, middle] = cv2.GC_FGD
    margin = (height // 5 + 6, width // 3 + 6)
    rows = slice(max(top - margin[0], 0), bottom + margin[0])
    columns = slice(max(left - margin[1], 0), right + margin[1])
    mask = np.zeros(likely.shape, bool)
    mask[rows, columns] = _grabbed(picture[rows, columns], likely[rows, columns])
    pieces, count = label(binary_opening(mask, np.ones((3, 3))))
    if count == 0:
        return None
    mask = binary_fill_holes(pieces == 1 + np.bincount(pieces.ravel())[1:].argmax())
    tall, wide = (np.ptp(k) + 1 for k in np.where(mask))
    fits = tall > 0.85 * height and wide > 0.7 * width and 0.25 < mask.sum() / height / width < 0.95
    return mask if fits else None


def sky(picture: Array, weights: cue.Weights) -> Array | None:
    """The pixels of the sky (HxW), from where a network is sure of it."""
    import cv2

    _, probable = _averaged(picture, weights)
    levels = [cv2.GC_BGD, cv2.GC_PR_BGD, cv2.GC_PR_FGD, cv2.GC_FGD]
    likely = np.array(levels, np.uint8)[np.digitize(probable, (0.08, 0.4, 0.8))]
    if not (likely == cv2.GC_FGD).any() or (likely == cv2.GC_FGD).all():
        return None
    pieces, _ = label(binary_opening(_grabbed(picture, likely), np.ones((3, 3))))
    sizes = np.bincount(pieces.ravel())
    return (pieces > 0) & (sizes[pieces] > 0.01 * pieces.size)


def _grabbed(picture: Array, likely: Array) -> Array:
    import cv2

    cv2.setRNGSeed(0)
    likely, models = likely.copy(), (np.zeros((1, 65)), np.zeros((1, 65)))
    colours = np.ascontiguousarray(picture[..., ::-1])
    cv2.grabCut(colours, likely, None, *models, 6, cv2.GC_INIT_WITH_MASK)
    return (likely == cv2.GC_FGD) | (likely == cv2.GC_PR_FGD)


def _counted(mask: Array) -> float:
    """What a pixel of a thing counts, more if the thing is small."""
    return float(1 + min(1, 0.06 / mask.mean()))


def cut_outs(folder: Path) -> list[tuple[Array, bool]]:
    """Clean ones, each of its own size (HxWx4 bytes, the last whether it is there), and whether it
    stands in its photograph, upright and whole.
    """
    cuts = []
    for name, line in chosen("train"):
        whole = np.asarray(Image.open(folder / f"{name}_{line}.png"))
        rows, columns = (np.flatnonzero(whole[..., 3].any(axis)) for axis in (1, 0))
        cut = whole[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        stands = rows[-1] < len(whole) - 3 and cut.shape[0] > 1.6 * cut.shape[1]
        cuts.append((cut, bool(stands)))
    return cuts


def pasted(rng: np.random.Generator, maps: Maps, cut: Array, stands: bool) -> Maps:
    """Put a cut-out into a scene, as far as the ground where it stands or, if it reaches below the
    picture, nearer than what it hides. Its colours change from top to bottom, as hair differs from
    a shirt. Where it has no place the scene stays as it is.
    """
    rgb, log, is_open, weight = maps
    height, width = log.shape
    tall = height * (rng.uniform(0.2, 0.8) if stands else rng.uniform(0.5, 1.3))
    wide = tall * cut.shape[1] / cut.shape[0] * np.exp(rng.normal(0, 0.1))
    small = Image.fromarray(cut).resize((max(3, int(wide)), int(tall)), Image.Resampling.BOX)
    thing = np.asarray(small).astype(np.float32)[:, :: rng.choice([-1, 1])]
    foot = rng.uniform(max(0.4 * height, tall - 0.1 * height), height) if stands else height
    top, left = int(foot - min(tall, 0.95 * height)), int(rng.uniform(-0.3, 0.7) * width)
    rows, columns = np.arange(height)[:, None] - top, np.arange(width) - left
    inside = (rows >= 0) & (rows < len(thing)) & (columns >= 0) & (columns < thing.shape[1])
    thing = thing[rows.clip(0, len(thing) - 1), columns.clip(0, thing.shape[1] - 1)]
    alpha = np.where(inside, thing[..., 3], 0) / 255
    mask = alpha > 0.5
    if mask.sum() < 50 or is_open.all():
        return maps
    low = np.flatnonzero(mask.any(1))[-1]
    under = mask & (np.arange(height)[:, None] > low - 3)
    far = np.median(log[under]) if stands else np.quantile(log[mask], 0.03) - rng.uniform(0, 0.3)
    if (stands and is_open[under].any()) or (log[mask] < far - 0.05).mean() > 0.3:
        return maps
    seen = log > far - 0.05
    knots = np.exp(rng.normal(0, 0.4, (5, 1)) + rng.normal(0, 0.07, (5, 3)))
    places = np.clip(rows[:, 0] / max(low - top, 1), 0, 1) * 4
    gains = np.stack([np.interp(places, np.arange(5), column) for column in knots.T], -1)
    light = (rgb[~is_open].mean() + 20) / (thing[..., :3][mask].mean() + 20)
    share = (alpha * seen)[..., None]
    changed = (thing[..., :3] * gains[:, None] * light ** rng.uniform(0, 0.7)).clip(0, 255)
    picture = rgb * (1 - share) + changed * share
    mask = mask & seen
    counted = _counted(mask) * (1 + (rows < 0.2 * (low - top)))  # heads twice
    log, weight = np.where(mask, far, log), np.where(mask, counted, weight)
    return picture.astype(np.uint8), log, is_open & ~mask, weight


def photographs(folder: Path, cuts: Path, weights: cue.Weights) -> list[Maps]:
    """Photographs with maps of a network, mended: what was cut out lies at one distance, a sky that
    was cut out is open, people that were not are unknown, as are rims.
    """
    skies, made = {name for name, _ in chosen("sky")}, []
    for name in sorted({name for name, _ in chosen("train")} | skies):
        picture, boxes = photograph(folder, name, _TRAINED_SIDE)
        log, probable = _averaged(picture, weights)
        weight, is_open = np.ones(log.shape), probable > 0.5
        if name in skies:
            is_open = _mask(cuts / f"{name}_sky.png", log)
            solid = log[~is_open]
            farthest = np.quantile(solid, 0.98)
            log = np.where(is_open, farthest + 0.7 * solid.std(), np.minimum(log, farthest))
        own = [line for other, line in chosen("train") if other == name]
        for line, (kind, box) in enumerate(boxes):
            top, left, bottom, right = box.clip(0)
            if kind == _PERSON and line not in own and bottom - top >= 27:
                weight[top:bottom, left:right] = 0
        for line in own:
            mask = _mask(cuts / f"{name}_{line}.png", log)
            rim = binary_dilation(mask, iterations=max(3, int(np.sqrt(mask.sum()) / 12))) & ~mask
            weight = np.where(mask, _counted(mask), weight * ~rim)
            log, is_open = np.where(mask, np.quantile(log[mask], 0.25), log), is_open & ~mask
        if (weight > 0).mean() > 0.4:
            made.append((picture, log, is_open, weight))
    return made


def _mask(path: Path, like: Array) -> Array:
    """Where a cut-out is, in the size of a map."""
    alpha = Image.open(path).getchannel("A")
    return np.asarray(alpha.resize(like.shape[::-1], Image.Resampling.NEAREST)) > 0


def _averaged(picture: Array, weights: cue.Weights) -> tuple[Array, Array]:
    """What a network says, as a mean over margins and both ways round."""
    size, logs, opens = picture.shape[:2], [], []
    whole = torch.from_numpy(picture.copy()).permute(2, 0, 1)[None].float() / 255
    for is_mirrored, part in itertools.product((False, True), (0.0, 0.055, 0.125)):
        down, across = (round(part * side) for side in size)
        padded = pad(
            whole.flip(3) if is_mirrored else whole, (across,) * 2 + (down,) * 2, "reflect"
        )
        answers = torch.stack(cue.relative(cue.small_copy(padded[0]), weights))[None]
        large = interpolate(answers, padded.shape[2:], mode="bilinear")[0]
        large = large[:, down : down + size[0], across : across + size[1]]
        log, probable = (large.flip(2) if is_mirrored else large).numpy()
        logs.append((log - log.mean()) / log.std())
        opens.append(probable)
    return np.mean(logs, 0), np.mean(opens, 0)


def main(folder: Path, out: Path) -> None:
    """Cut out all that can be, to be chosen from."""
    out.mkdir(parents=True, exist_ok=True)
    for path in sorted((folder / "labels").glob("*.txt")):
        picture, boxes = photograph(folder, path.stem)
        masks = {"sky": sky(picture, cue.learnt())}
        for line, (kind, box) in enumerate(boxes):
            if kind in _CUT:
                masks[str(line)] = outlined(picture, box, kind == _PERSON)
        for name, mask in masks.items():
            if mask is not None:
                cut = np.dstack([picture, 255 * mask.astype(np.uint8)])
                Image.fromarray(cut).save(out / f"{path.stem}_{name}.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--photographs", type=Path, required=True, help="folder with boxes")
    parser.add_argument("--out", type=Path, required=True, help="folder of cut-outs")
    given = parser.parse_args()
    main(given.photographs, given.out)
