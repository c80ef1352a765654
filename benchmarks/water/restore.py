"""Does the model give back the colours of charts that it has not seen?

Each picture in turn is left out: the water is that of the others' greys, and one grey of its
nearest chart tells its gain. Direct light and veil are undone in camera space, patch by patch.
Stretch and grey-world know the whole picture, but no distance; "one grey" is the gain
without a water. Errors are ΔE2000, after one gain a picture, or a chart, whose light no model
knows, to the truth's mean luminance. Left out are the colours whose truth the kit doubts.

    python -m benchmarks.evidence.restore --kit KITS --answered NETS
    python -m benchmarks.water --kit FOLDER --nets NETS restore

adds what trained nets make of whole pictures. An arm's errors are means over its nets.
"""

import csv
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from skimage.color import deltaE_ciede2000, rgb2lab

from benchmarks.evidence import restore as evidence
from benchmarks.evidence.restore import BASELINES, LUMINANCE
from benchmarks.water.patches import GREYS, Array, Patches, Some, fitted, greys, read
from uwaug import Medium
from uwaug.formation import linear_to_srgb

DOUBTED = ("white", "brown1", "brown2", "orange", "pink", "cyan")
BINS = (0.0, 5.0, 7.0, np.inf)  # m
RESAMPLES = 1000  # of charts
GREY = "one grey"
DEPTH = 5.0  # m, of a water that nobody fitted
FULL_WIDTH = 7360  # px, of the pictures in which the kit tells boxes

Water = Callable[[Array], tuple[Array, Array]]
"""From distances to what arrives and the veil (Nx3)."""


def of_medium(medium: Medium) -> Water:
    """A medium's, of a white surface's light at the lens."""

    def terms(z: Array) -> tuple[Array, Array]:
        curves = medium.curves(torch.from_numpy(z)[None, None, None])
        light = medium.ambient()[0].numpy()
        direct, veil = (x[0, :, 0].T.numpy() / light for x in (curves.direct, curves.veil))
        return direct, veil

    return terms


def nothing(z: Array) -> tuple[Array, Array]:
    """No water."""
    return np.ones((len(z), 3)), np.zeros((len(z), 3))


def dry(patches: Patches, water: Water) -> Array:
    """Patches without water, linear sRGB; one that is known tells the gain."""
    arriving, veil = water(patches.z)
    told = told_by(patches)
    gain = patches.wet[told] / (arriving[told] * patches.air[told] + veil[told])
    return np.asarray(((patches.wet / gain - veil) / arriving) @ np.linalg.inv(patches.to_camera).T)


def told_by(patches: Patches) -> int:
    """The patch whose colour is known: the lightest grey of the nearest chart."""
    score = patches.truth[:, 1] - 10 * patches.z
    return int(np.where(np.isin(patches.names, GREYS), score, -np.inf).argmax())


def picture_of(kit: Path, scene: str) -> Array | None:
    """A picture's light (HxWx3), if the kit has it."""
    path = kit / f"charts/pictures/{scene}_lin16.png"
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return None if picture is None else picture[..., ::-1] / 65535


def by_picture(kit: Path, patches: Patches) -> dict[str, Array]:
    """Patches after what needs the picture alone, linear sRGB."""
    picture = picture_of(kit, patches.pictures[0])
    if picture is None:
        return {}
    # a patch is as small as a pixel here: patches stand beside the picture, as measured
    light = np.concatenate([picture.reshape(-1, 3), patches.shown])
    encoded = 255 * linear_to_srgb(torch.from_numpy(light)).numpy()[None]
    arms = ("as it is", "grey-world", "stretch")
    return {arm: BASELINES[arm](encoded)[0, -len(patches.z) :] for arm in arms}


def by_nets(kit: Path, patches: Patches, nets: Path) -> dict[str, Array]:
    """Patches by the nets of each arm, linear sRGB (KxNx3). Nets see whole pictures, as stretch
    does; crops of charts, as large as in training, serve a net no better.
    """
    with (kit / "charts/patches.csv").open(newline="") as file:
        boxes = {
            (f"{row['scene']} {row['chart']}", row["patch"]): [
                int(row[side]) for side in ("x0", "x1", "y0", "y1")
            ]
            for row in csv.DictReader(file)
        }
    arms: dict[str, list[Array]] = {}
    for path in sorted(nets.glob("*.net")):
        restore, answer = evidence.restorer(path), np.full(patches.wet.shape, np.nan)
        for scene in np.unique(patches.pictures):
            picture = picture_of(kit, scene)
            if picture is None:
                continue
            light, scale = restore(evidence.as_bytes(picture)), picture.shape[1] / FULL_WIDTH
            for i in np.flatnonzero(patches.pictures == scene):
                box = np.array(boxes[patches.charts[i], patches.names[i]])
                x0, x1, y0, y1 = np.round(scale * box).astype(int)
                pixels = light[y0 : max(y1, y0 + 1), x0 : max(x1, x0 + 1)]
                answer[i] = pixels.mean((0, 1))
        arms.setdefault(f"net: {path.stem.rpartition(', ')[0]}", []).append(answer)
    return {arm: np.stack(answers) for arm, answers in arms.items()}


def errors(light: Array, truth: Array, groups: Some) -> Array:
    """ΔE2000 of each patch after a gain of each group."""
    levels = np.stack([light, truth]).clip(0) @ LUMINANCE
    gains = np.ones(len(light))
    for group in np.unique(groups):
        mine, true = levels[:, groups == group].sum(1)
        gains[groups == group] = true / max(mine, 1e-9)
    pair = np.stack([light * gains[:, None], truth]).clip(0, 1)
    lab = rgb2lab(linear_to_srgb(torch.from_numpy(pair)).numpy())
    return np.asarray(deltaE_ciede2000(*lab))


def restored(kit: Path, patches: Patches) -> dict[str, Array]:
    """Patches by each way, linear sRGB."""
    answers: dict[str, Array] = {}
    for scene in np.unique(patches.pictures):
        inside = patches.pictures == scene
        own, others = patches.of(inside), greys(patches.of(~inside))
        jerlov = Medium.from_water("IB", vertical_depth=DEPTH)
        waters: dict[str, Water] = {GREY: nothing, "Jerlov IB": of_medium(jerlov)}
        for name, charts, model in (
            ("one rate", others, "haze"),
            ("two rates", others, "veil"),
            ("one rate, own charts", greys(own), "haze"),
        ):
            with suppress(ValueError):  # too few to tell a water
                waters[name] = of_medium(fitted(charts, model).medium)
        ways = by_picture(kit, own) | {name: dry(own, water) for name, water in waters.items()}
        for name, light in ways.items():
            answers.setdefault(name, np.full(patches.wet.shape, np.nan))[inside] = light
    return answers


def medians(values: Array, charts: Some) -> list[float]:
    """Median, and its 95 % interval over charts."""
    names = np.unique(charts)
    of = [values[charts == name] for name in names]
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, len(of), (RESAMPLES, len(of)))
    resampled = [np.median(np.concatenate([of[k] for k in row])) for row in drawn]
    return [float(np.median(values)), *np.quantile(resampled, (0.025, 0.975)).tolist()]


def main(kit: Path, nets: Path | None = None) -> dict[str, Any]:
    """Print the errors of each way, and of the nets in a folder."""
    patches = read(kit)
    answers = {name: light[None] for name, light in restored(kit, patches).items()}
    if nets:
        answers |= by_nets(kit, patches, nets)
    scored = ~np.isin(patches.names, DOUBTED)
    for scene in np.unique(patches.pictures):
        places = np.flatnonzero(patches.pictures == scene)
        scored[places[told_by(patches.of(places))]] = False
    of_greys = np.isin(patches.names, GREYS)
    parts: dict[str, Some] = {"all": scored, "greys": of_greys, "colours": ~of_greys} | {
        f"{low:g} to {high:g} m": (patches.z >= low) & (patches.z < high)
        for low, high in pairwise(BINS)
    }
    results = {}
    for gain, groups in (("a picture", patches.pictures), ("a chart", patches.charts)):
        misses = {}
        for name, lights in answers.items():
            some = scored & np.isfinite(lights[0, :, 0])
            misses[name] = np.full(len(some), np.nan)
            rows = [errors(light[some], patches.truth[some], groups[some]) for light in lights]
            misses[name][some] = np.mean(rows, 0)
        print(f"\nΔE2000, a gain {gain}", "all, more than one grey", *[*parts][1:], sep="; ")
        for name, of_name in misses.items():
            told = scored & np.isfinite(of_name)
            groups_of = {part: told & of for part, of in parts.items() if (told & of).any()}
            row = {part: medians(of_name[of], patches.charts[of]) for part, of in groups_of.items()}
            first, *rest = (f"{median:6.1f}" for median, *_ in row.values())
            row["more"] = medians((of_name - misses[GREY])[told], patches.charts[told])
            more = "{:+.1f} ({:+.1f} to {:+.1f})".format(*row["more"])
            print(f"{name:23} {first} {more}", *rest)
            results[f"{name}, a gain {gain}"] = row
    return results
