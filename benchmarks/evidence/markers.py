"""Does a marker detector fail under water where it fails in our pictures?

    python -m benchmarks.evidence.markers --kit FOLDER --choose    step of the nets, by the dry arm
    python -m benchmarks.evidence.markers --kit FOLDER             curves, and nets of all arms

OpenCV reads AprilTags in the frames of a film whose corners are known, and in boards pasted into
photographs in air and degraded: by the defaults over a wide range of contrasts, and by `uwaug.like`
of five frames. Contrast is the spread of green in a tag, 10th to 90th percentile, of 255 levels.
Small nets of `benchmarks.evidence.readers` read the film, too. The kit is that of
`benchmarks.evidence.detector`.
"""

import json
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.optimize import minimize
from scipy.special import expit

import uwaug
from benchmarks.evidence import readers
from benchmarks.evidence.detector import NAMES, module, parser
from benchmarks.evidence.net import keeper, resampled_units
from benchmarks.evidence.readers import Tag
from benchmarks.evidence.tasks import Array
from benchmarks.figures.charts import FIGURES
from benchmarks.harness import save

EDGES = (2, 6, 9, 13, 18, 25, 35, 50, 75, 110, 256)
"""Of bins of contrast."""

SCENES = 300
NEAR_PX = 4.0  # from true corners to those that are read, the mean
DISTANCES = (0.5, 3.0)  # m, from the camera to the floor
CONTRASTS = (0.01, 0.9)
QUALITY = 90  # of JPEG
RESAMPLES = 200
SHOWN_FRAMES = 5
DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_16h5)


def tags_of(picture: Array, ids: Any, quads: Array, block: str) -> Iterator[Tag]:
    """Markers that a picture (HxWx3, uint8) holds whole, read on green or not."""
    green = np.ascontiguousarray(picture[..., 1])
    corners, names, _ = cv2.aruco.ArucoDetector(DICTIONARY).detectMarkers(green)
    for name, quad in zip(ids, quads, strict=True):
        if quad.min() < 1 or (quad > np.array(green.shape[::-1]) - 2).any():
            continue
        mask = cv2.fillConvexPoly(np.zeros_like(green), quad.round().astype(np.int32), 1)
        low, high = np.percentile(green[mask > 0], (10, 90))
        side = np.linalg.norm(quad - np.roll(quad, 1, 0), axis=1).mean()
        apart = (
            [
                np.linalg.norm(other[0] - quad, axis=1).mean()
                for other, named in zip(corners, np.ravel(names), strict=True)
                if named == name
            ]
            if corners
            else []
        )
        is_read = min(apart, default=np.inf) < NEAR_PX
        yield Tag(block, high - low, side, is_read, name, quad)


def film_of(kit: Any, folder: Path) -> list[tuple[Array, list[Tag]]]:
    """Frames of the film, with their markers."""
    groups = json.loads((folder / "choose/groups.json").read_text())["tags"]
    truth, frames = kit.tags("choose/tags", folder), list[tuple[Array, list[Tag]]]()
    for frame in kit.load("choose/tags", folder):
        boards = truth.get(frame.name, [])
        quads = np.array([board["corners"] for board in boards])
        ids = [board["id"] for board in boards]
        frames.append((frame.image, [*tags_of(frame.image, ids, quads, groups[frame.name])]))
    return frames


def of_boards(
    kit: Any, photographs: list[Array], augment: uwaug.RandomUnderwater, **boards: Any
) -> list[Tag]:
    """Markers of boards in degraded photographs."""
    rng, tags = np.random.default_rng(0), []
    for index in range(SCENES):
        photograph = cv2.resize(photographs[index % len(photographs)], (640, 480))
        air, quads, ids = kit.tag_scene(photograph, rng, **boards)
        wet = augment.at(0, 0, index)(torch.from_numpy(air).permute(2, 0, 1))
        file = cv2.imencode(
            ".jpg", wet.permute(1, 2, 0).numpy(), (cv2.IMWRITE_JPEG_QUALITY, QUALITY)
        )[1]
        tags += tags_of(cv2.imdecode(file, cv2.IMREAD_COLOR), ids, quads, str(index))
    return tags


def curve(tags: list[Tag]) -> dict[str, Any]:
    """Shares that are read, by contrast; and at which contrast there are half as many as at high
    ones; with 95 % over blocks.
    """
    contrast, read = np.array([t.contrast for t in tags]), np.array([t.is_read for t in tags])
    often = resampled_units([t.block for t in tags], RESAMPLES)
    bins, rows = np.digitize(contrast, EDGES), []
    for place in range(1, len(EDGES)):
        inside = bins == place
        if inside.sum() >= 5:
            weights = often[:, inside]
            shares = (weights @ read[inside]) / np.maximum(weights.sum(1), 1e-9)
            row = {"contrast": float(np.median(contrast[inside])), "tags": int(inside.sum())}
            row |= {"share": float(read[inside].mean())}
            rows.append(row | {"interval": np.percentile(shares, (2.5, 97.5)).tolist()})
    return {
        "tags": len(tags),
        "sides_px": np.percentile([t.side for t in tags], (5, 50, 95)).tolist(),
        "half": half_read(contrast, read, np.ones(len(tags))),
        "interval": np.percentile(
            [half_read(contrast, read, row) for row in often], (2.5, 97.5)
        ).tolist(),
        "bins": rows,
    }


def half_read(contrast: Array, read: Array, weights: Array) -> float:
    """Where a logistic curve over the logarithm of contrast has half of its height."""
    log = np.log(np.maximum(contrast, 1))

    def loss(at: Array) -> float:
        share = expit(np.exp(at[1]) * (log - at[0])) * expit(at[2])
        return float(-(weights * np.log(np.where(read, share, 1 - share) + 1e-9)).sum())

    begin = (np.log(20.0), 1.5, 3.0)
    return float(np.exp(minimize(loss, begin, method="Nelder-Mead").x[0]))


def drawn(curves: dict[str, Any]) -> None:
    """The figure."""
    figure = Figure((5, 3), layout="constrained")
    axes = figure.subplots()
    for (name, of), colour in zip(curves.items(), ("k", "#c1272d", "#0b6e99"), strict=True):
        x, y = ([row[key] for row in of["bins"]] for key in ("contrast", "share"))
        ends = np.array([row["interval"] for row in of["bins"]]).T
        label = f"{name}: half at {of['half']:.0f}"
        axes.plot(x, y, "o-", ms=3, color=colour, label=label)
        axes.fill_between(x, *ends, color=colour, alpha=0.15, lw=0)
    axes.set(xscale="log", xlabel="spread of green in the tag, of 255", ylabel="share read")
    axes.set_xticks([5, 10, 20, 50, 100], ["5", "10", "20", "50", "100"])
    axes.legend(fontsize=8)
    FigureCanvasAgg(figure).print_png(FIGURES / "markers.png")


def main(
    folder: Path, arms: Sequence[str] = NAMES, nets: int = 1, answered: Path | None = None
) -> dict[str, Any]:
    """Read, train, compare, print, save and draw. What a net reads is kept in `answered`."""
    torch.set_num_threads(1)
    kit = module(folder)
    truth, frames = kit.tags("choose/tags", folder), film_of(kit, folder)
    film = [tag for _, tags in frames for tag in tags]
    low, high = np.percentile([t.side for t in film], (2.5, 97.5))
    names = sorted({board["id"] for boards in truth.values() for board in boards})
    air, other = (
        [sample.image for sample in kit.load(f"land/{part}", folder)] for part in ("train", "val")
    )
    places = range(0, len(frames), len(frames) // SHOWN_FRAMES)[:SHOWN_FRAMES]
    shown = [frames[place][0] for place in places]
    references, looked = (
        [torch.from_numpy(picture.copy()).permute(2, 0, 1) for picture in some]
        for some in (shown, air[::22][:8])
    )
    curves = {"film": curve(film)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of contents and draws that are far: the sweep is wide
        water = uwaug.RandomWater(contrast=CONTRASTS)
        plain = uwaug.RandomUnderwater(distance=DISTANCES)
        augments = {
            "RandomUnderwater": uwaug.RandomUnderwater(water, distance=DISTANCES),
            "like of five frames": uwaug.like(references, looked, augment=plain),
        }
        for name, augment in augments.items():
            curves[name] = curve(of_boards(kit, air, augment, ids=names, low=low, high=high))
    for name, of in curves.items():
        print(name, of, flush=True)
    unseen = [
        (picture, tags)
        for place, (picture, tags) in enumerate(frames)
        if place not in places and tags
    ]
    with keeper(answered) as answers:
        read = readers.measured(kit, (air, other), shown, unseen, arms, nets, answers)
    results = {"scenes": SCENES, "contrasts": CONTRASTS, "curves": curves, "readers": read}
    save("markers", results)
    drawn(curves)
    return results


if __name__ == "__main__":
    flags = parser(__doc__)
    flags.add_argument("--choose", action="store_true", help="step of the nets, by the dry arm")
    given = flags.parse_args()
    if given.choose:
        readers.choose(module(given.kit), given.kit)
    else:
        main(given.kit, given.arms, given.nets, given.answered)
