"""Does forward scatter show in real pictures? From edges of white boards, and from tank pairs.

* **Core**: the spread of a board's edge, as a Gaussian's, against distance. Lens, focus, motion,
  demosaicing and JPEG are in it, so it limits a narrow blur from above: "room" is the scattering b
  with which the paper's law alone, and no lens, explains the edge.
* **Halo**: a wide kernel lifts what lies beside a board, and lowers the board towards its edge. How
  much of a law's halo do the levels beside the edges have? 1 is the law. Shade and stones are there
  as well: so the same of pictures that the law has spread once more, where it must be 1 higher.
* **Black**: light of a chart where it reflects nothing. Veil apart it is spread from around, so "b"
  is the most that the law may scatter, and that leaves no veil.
* **Tank**: what direct light and an uneven veil leave of a turbid picture's spread, and with a blur
  of the clean picture. A mirrored blur knows nothing of the scene: what it takes off is chance.

Boards in green alone: blue clips more often, and red is lost beyond 4 m.
"""

import csv
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares
from scipy.special import ndtr

from uwaug import PointSpread, Scattering
from uwaug._support.types import Shape

Array = NDArray[np.float64]

PAPER_G = 0.2  # of the paper's water
GREEN = 1  # of BGR and of RGB
FOCAL, SHORT_SIDE = 7175.0, 4912.0  # px, of the camera
CLIPPED = 0.95
SCALE = 4  # px of the camera per px of what is restored
REACH = 1400  # px about a chart that is restored
BANDS = ((0.0, 3.5), (3.5, 5.5), (5.5, 7.0), (7.0, 99.0))  # m
RATES = np.geomspace(0.01, 1, 41)  # b, 1/m
LIKELY = 0.07, 0.2  # b, 1/m: what charts lose, if their light is the same, and if it is free,
# less what clear water absorbs
TANK_FOCAL = 443.0  # px: 60° of two quadrants side by side
CONTRASTS = ((0.6, 2.0), (0.3, 0.6), (0.1, 0.3), (0.0, 0.1))  # of turbid by clean
LENGTHS = 0.05, 0.2, 0.5, 1.0, 2.0, 4.0  # b·z in the tank
WIDTHS = 1.0, 2.0, 4.0, 16.0, 64.0  # px in the tank


Side = tuple[int, Array, Array]  # 1 left, -1 right; column as a line of the row; rows


class Board(NamedTuple):
    """A chart on its board, with the sides of the board below the chart."""

    distance: float
    crop: Array  # HxW, linear
    canvas: Array  # the picture about it, at 1/SCALE
    shift: Array  # x and y of the crop in the canvas, px of the camera
    sides: list[Side]
    width: float  # of the chart, px
    box: Array  # left, top, right, bottom of the chart in the canvas
    black: list[float]  # light where nothing is reflected; the same without each of the greys


def linear(path: Path) -> Array:
    """Green of an 8-bit picture (HxW), the power of 2.2 undone."""
    return (cv2.imread(str(path))[..., GREEN] / 255.0) ** 2.2


def boards(kit: Path) -> list[Board]:
    """All charts with a crop."""
    with (kit / "patches.csv").open() as file:
        patches = list(csv.DictReader(file))
    on_boards = []
    for corner in json.loads((kit / "corners.json").read_text()).values():
        crops = list((kit / "crops").glob(f"{corner['scene']}_chart{corner['chart']}_x*_y*.png"))
        rows = [
            p
            for p in patches
            if (p["scene"], p["chart"]) == (corner["scene"], str(corner["chart"]))
        ]
        if not (crops and rows):
            continue
        origin = np.array(re.findall(r"_[xy](\d+)", crops[0].stem)[-2:], float)
        corners = np.array(corner["corners_fullres_TL_TR_BR_BL"]) - origin
        crop = linear(crops[0])
        canvas, shift = _about(kit / "pictures" / f"{corner['scene']}_lin16.png", crop, origin)
        box = np.concatenate([corners.min(0) + shift, corners.max(0) + shift]) / SCALE
        greys = [p for p in rows if p["patch"].startswith(("gray", "black")) and p["usable"] == "1"]
        points = np.array([[p["ref_G"], p["meas_G"]] for p in greys], float).reshape(-1, 2)
        some = [points, *(np.delete(points, i, 0) for i in range(len(points)))]
        black = [float(np.polyfit(*part.T, 1)[1]) for part in some] if len(points) > 3 else []
        width = float(np.linalg.norm(corners[1] - corners[0]))
        sides = [side for sign in (1, -1) for side in _side(crop, corners, sign)]
        distance = float(rows[0]["distance_m"])
        on_boards.append(Board(distance, crop, canvas, shift, sides, width, box, black))
    return sorted(on_boards, key=lambda board: board.distance)


def _about(picture: Path, crop: Array, origin: Array) -> tuple[Array, Array]:
    """The picture about a crop, which replaces its part of it; the crop alone without a picture."""
    height, width = (n // SCALE for n in crop.shape)
    inner = crop[: height * SCALE, : width * SCALE].reshape(height, SCALE, width, SCALE)
    small = inner.mean((1, 3))
    if not picture.exists():
        return small, np.zeros(2)
    whole = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)[..., GREEN] / 65535.0
    size = (int(SHORT_SIDE / whole.shape[0] * whole.shape[1] / SCALE), int(SHORT_SIDE / SCALE))
    whole = cv2.resize(whole, size, interpolation=cv2.INTER_LINEAR)
    x, y = (int(v) for v in np.round(origin / SCALE))
    whole[y : y + height, x : x + width] = small
    reach = REACH // SCALE
    x0, y0 = max(x - reach, 0), max(y - reach, 0)
    return whole[y0 : y + height + reach, x0 : x + width + reach], SCALE * np.array(
        [x - x0, y - y0]
    )


def _side(crop: Array, corners: Array, sign: int) -> list[Side]:
    """A side of the board below a chart, if it is straight: the steepest places of its rows."""
    size = max(corners[1] - corners[0])
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    to_crop = cv2.getPerspectiveTransform(square, corners.astype(np.float32))
    u = np.arange(0.02, -0.42, -0.5 / size) if sign > 0 else np.arange(0.98, 1.42, 0.5 / size)
    v = np.arange(1.15, 2.6, 1.6 / size)
    grid = np.stack(np.meshgrid(u, v), -1).astype(np.float32)
    places = cv2.perspectiveTransform(grid.reshape(1, -1, 2), to_crop).reshape(grid.shape)
    limit = np.array(crop.shape[::-1]) - 2
    places = places[((places > 1) & (places < limit)).all((1, 2))]
    if len(places) < 20:
        return []
    levels = map_coordinates(crop, [places[..., 1], places[..., 0]], order=1)
    reach = max(4, int(0.06 * size))
    sums = np.cumsum(levels, 1)
    inside, outside = sums[:, reach:-reach] - sums[:, : -2 * reach], sums[:, 2 * reach :]
    steps = inside - (outside - sums[:, reach:-reach])
    x, y = places[np.arange(len(places)), steps.argmax(1) + reach].T
    random, best = np.random.default_rng(0), np.zeros(len(x), bool)
    for first, second in random.integers(0, len(x), (300, 2)):
        if y[first] != y[second]:
            slope = (x[second] - x[first]) / (y[second] - y[first])
            near = abs(x - x[first] - slope * (y - y[first])) < 1.5
            best = near if near.sum() > best.sum() else best
    if best.mean() < 0.6:
        return []
    return [(sign, np.polyfit(y[best], x[best], 1), np.arange(y[best].min(), y[best].max()))]


def across(image: Array, side: Side, x: Array, shift: Array | float = 0.0, scale: int = 1) -> Array:
    """Light (rows, N) at distances x, px, from a side, positive on the board."""
    sign, line, rows = side
    length = math.hypot(1, line[0])
    column = np.polyval(line, rows)[:, None] + sign * x / length
    row = rows[:, None] - sign * x * line[0] / length
    places = np.stack([column, row], -1) + shift
    places = (places - (scale - 1) / 2) / scale  # the middle of a pixel of the canvas
    return map_coordinates(image, [places[..., 1], places[..., 0]], order=1)


def transfer(image: Array, shape: Shape, sigma: float) -> Array:
    """A kernel's transfer function, in the frequencies of the cosine transform of an image."""
    rows, columns = (np.arange(n) / (2 * n) for n in image.shape[:2])
    x = 2 * math.pi * sigma * np.hypot(rows[:, None], columns)
    return np.exp(-x) if shape == "exponential" else np.exp(-(x**2) / 2)


def spread(image: Array, share: float, sigma: float, power: int = 1) -> Array:
    """An image of which this share is spread by an exponential kernel; by power −1 what it was."""
    kept = 1 - share + share * transfer(image, "exponential", sigma / SCALE)
    return idctn(dctn(image) * kept**power)


def law(model: PointSpread, g: float, lengths: Any, unit: float) -> tuple[Any, Any]:
    """Share and width, px, of forward-scattered light after so many scattering lengths."""
    return 1 - np.exp(-(1 - g) * lengths), unit * model.scale * lengths**model.exponent


def calibrated(lengths: Any, focal: float = FOCAL) -> tuple[Any, Any]:
    return law(PointSpread.calibrated(), Scattering.CALIBRATED.g, lengths, focal)


def paper(lengths: Any, short_side: float = SHORT_SIDE) -> tuple[Any, Any]:
    return law(PointSpread.paper(), PAPER_G, lengths, short_side / 518)


def core(board: Board, side: Side) -> tuple[float, float]:
    """Spread of an edge as a Gaussian's, px, and the paper's law's b, 1/m, without a lens."""
    x = np.arange(-14, 14.1, 0.5)
    value = across(board.crop, side, x).mean(0)
    if value.max() > CLIPPED:
        return math.nan, math.nan

    def fitted(shape: Callable[[Array, float], Array], start: float) -> float:
        def misses(p: Array) -> Array:
            return (p[0] + p[1] * shape(x - p[2], abs(p[3])) - value) / np.ptp(value)

        first = [value.min(), np.ptp(value), 0, start]
        return float(abs(least_squares(misses, first, loss="soft_l1", f_scale=0.02).x[3]))

    def by_paper(x: Array, b: float) -> Array:
        share, sigma = paper(b * board.distance)
        return (1 - share) * ndtr(x / 0.3) + share * ndtr(x / np.hypot(0.3, sigma))

    return fitted(lambda x, sigma: ndtr(x / max(sigma, 0.1)), 1.5), fitted(by_paper, 0.05)


def halo(board: Board, share: float, sigma: float, again: bool = False) -> Array:
    """Products of the levels beside the edges with a kernel's halo, and of the halo with itself."""
    seen_image = board.canvas
    image = spread(seen_image, share, sigma) if again else seen_image
    before = spread(image, share, sigma, -1)
    x = np.arange(12, max(0.35 * board.width, 40), SCALE)
    products = np.zeros(2)
    for side in board.sides:
        seen = across(seen_image, side, x, board.shift, SCALE).mean(0) < CLIPPED
        pairs = []
        for picture in (image, before):
            on, off = (across(picture, side, way, board.shift, SCALE).mean(0) for way in (x, -x))
            levels = [off, on[seen]] if seen.mean() > 0.5 else [off]
            pairs.append([(level - level.mean()) / (on.mean() - off.mean()) for level in levels])
        for level, flat in zip(*pairs, strict=True):
            products += level @ (level - flat), (level - flat) @ (level - flat)
    return products


def most(board: Board, black: float) -> float:
    """The largest b, 1/m, whose glow on a chart is not above its black."""
    left, top, right, bottom = (int(v) for v in board.box)
    for b in RATES:
        share, sigma = calibrated(b * board.distance)
        glow = spread(board.canvas, 1, sigma)[top:bottom, left:right].mean()
        if share * glow > black:
            return float(b)
    return math.inf


def interval(estimate: Callable[[Array], Any], n: int) -> list[float]:
    """An estimate from n things, and its interval of 95 % by bootstrap over them."""
    random = np.random.default_rng(0)
    drawn = [estimate(random.integers(0, n, n)) for _ in range(1000)]
    return [
        round(float(v), 2) for v in (estimate(np.arange(n)), *np.percentile(drawn, (2.5, 97.5)))
    ]


def tank(clean: Array, turbid: Array) -> dict[str, float]:
    """What is left of a turbid picture's spread (HxWx3) by each law, whose length is free."""
    rows, columns = np.meshgrid(*(np.linspace(-1, 1, n) for n in clean.shape[:2]), indexing="ij")
    uneven = np.stack([rows**i * columns**j for i in range(3) for j in range(3 - i)], -1)
    field = np.linalg.qr(uneven.reshape(-1, 6))[0]
    total = np.linalg.norm(turbid - turbid.mean((0, 1)))
    spectrum = dctn(clean, axes=(0, 1))

    def blurred(shape: Shape, sigma: float) -> Array:
        return idctn(spectrum * transfer(clean, shape, sigma)[..., None], axes=(0, 1))

    def left(*parts: Array) -> tuple[float, Array]:
        fits, missed = [], 0.0
        for c in range(3):
            *known, y = (p[..., c].reshape(-1, 1) for p in (*parts, turbid))
            known_, y = (v - field @ (field.T @ v) for v in (np.hstack(known), y))
            fit, *_ = np.linalg.lstsq(known_, y, rcond=None)
            fits.append(fit[:, 0])
            missed += float(((known_ @ fit - y) ** 2).sum())
        return math.sqrt(missed) / float(total), np.mean(fits, 0)

    def mixture(shape: Shape, share: float, sigma: float) -> float:
        return left((1 - share) * clean + share * blurred(shape, sigma))[0]

    plain, contrast = left(clean)
    trials = []
    for sigma in WIDTHS:
        wide = blurred("exponential", sigma)
        missed, (direct, scattered) = left(clean, wide)
        mirrored = left(clean, wide[::-1, ::-1])[0]
        trials.append((missed, sigma, float(scattered / (direct + scattered)), mirrored))
    side = 2 * len(clean)
    return {
        "contrast": float(contrast[0]),
        "direct, veil": plain,
        "blur": min(trials)[0],
        "width, px": min(trials)[1],
        "share": min(trials)[2],
        "mirrored": min(trial[3] for trial in trials),
        "calibrated": min(mixture("exponential", *calibrated(n, TANK_FOCAL)) for n in LENGTHS),
        "paper": min(mixture("gaussian", *paper(n, side)) for n in LENGTHS),
    }


def main(kit: Path) -> dict[str, Any]:
    """Measure a kit, print, and return the numbers, each with its interval of 95 %."""
    on_boards = [board for board in boards(kit / "charts") if board.sides]
    results: dict[str, Any] = {"core": {}, "halo": {}, "black": {}, "tank": {}}
    for low, high in BANDS:
        here = [b for b in on_boards if low <= b.distance < high]
        cores = [core(b, side) for b in here for side in b.sides]
        edges = np.array([pair for pair in cores if pair[0] > 0]).reshape(-1, 2)
        if not len(edges):
            continue
        distance = float(np.mean([b.distance for b in here]))
        row: dict[str, Any] = {
            "edges": len(edges),
            "px": interval(lambda i: np.median(edges[i, 0]), len(edges)),
            "sharpest, px": float(edges[:, 0].min()),
            "room, 1/m": interval(lambda i: np.median(edges[i, 1]), len(edges)),
            "least room, 1/m": float(edges[:, 1].min()),
        }
        for b in LIKELY:
            row[f"calibrated, b {b:g}: share, px"] = [float(v) for v in calibrated(b * distance)]
            row[f"paper, b {b:g}: share, px"] = [float(v) for v in paper(b * distance)]
        results["core"][f"{distance:.1f} m"] = row
    for b in LIKELY if on_boards else ():
        for again in (False, True):
            products = np.array(
                [halo(board, *calibrated(b * board.distance), again) for board in on_boards]
            )
            # least squares over boards
            results["halo"][f"b {b:g}" + (", spread once more" if again else "")] = interval(
                lambda i: np.divide(*products[i].sum(0)), len(products)
            )
    for board in on_boards:
        if board.black:
            limits = [most(board, black) for black in board.black]
            row = {"black": board.black[0], "b": [limits[0], min(limits), max(limits)]}
            results["black"].setdefault(f"{board.distance:.2f} m", row)
    pairs = []
    for file in sorted((kit / "turbid" / "clean").glob("*.jpg")):
        paths = file, kit / "turbid" / "degraded" / file.name
        if paths[1].exists():
            pairs.append(tank(*((cv2.imread(str(p)) / 255.0) ** 2.2 for p in paths)))
    for low, high in CONTRASTS:
        some = [pair for pair in pairs if low <= pair["contrast"] < high]
        if some:
            medians = {
                key: interval(lambda i: np.median([some[j][key] for j in i]), len(some))
                for key in some[0]
            }
            results["tank"][f"contrast {low:g} to {high:g}"] = {"pairs": len(some), **medians}
    for part, rows in results.items():
        for name, row in rows.items():
            cells = row.items() if isinstance(row, dict) else [("amplitude", row)]
            print(part, name, *(f"{key}: {np.round(value, 2).tolist()};" for key, value in cells))
    return results
