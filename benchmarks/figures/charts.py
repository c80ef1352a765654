"""The chart of the frontier: error against time.

`python -m benchmarks.figures.charts` draws it from its results.
"""

import json
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import Bbox
from PIL import Image

from benchmarks.harness import RESULTS
from uwaug._support.atomic import written_whole

FIGURES = Path(__file__).parent
DEFAULT, OURS, RIVAL, FRONT = "#c1272d", "#0b6e99", "#7a7a7a", "#e8a33d"
SHOWN = (512, 1)  # size and threads of the panels drawn; all others are in the JSON
_OUR_NAMES = ("ours", "eager", "compiled loops", "torch.compile", "ONNX", "float", "bfloat")
_NUMBER = re.compile(r"\b\d[\de.-]*(?: \+ \d+)?\b")
STYLE = {
    "font.size": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9,
}
_COMPASS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
_STEPS = [(r * dx, r * dy) for r in (8, 12, 17, 24, 32, 42, 56, 72) for dx, dy in _COMPASS]
"""Points of 1/72 in from a point to its label, nearest first."""
_LETTERS: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 7.5}
_LEADER = 14  # points; a label farther off is joined to its point by a line


class Point(NamedTuple):
    """A point of a chart, in its data, and what is to be written beside it; "" for nothing."""

    x: float
    y: float
    label: str
    colour: str


def draw_frontier(results: dict[str, Any]) -> Path:
    return save_small(frontier_figure(results), "frontier")


def save_small(figure: Figure, name: str) -> Path:
    """Write figures/NAME.png, in 96 colours: a third of the bytes."""
    canvas = FigureCanvasAgg(figure)
    with matplotlib.rc_context(STYLE):
        canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    path = FIGURES / f"{name}.png"
    with written_whole(path) as part:
        few = picture.quantize(96, dither=Image.Dither.NONE)
        few.save(part, format="png", optimize=True)
    return path


def frontier_figure(results: dict[str, Any], shown: tuple[int, int] = SHOWN) -> Figure:
    """Time against PSNR of every method, a panel for each part of the model."""
    size, threads = shown
    panels = [p for p in results["panels"].values() if (p["size"], p["threads"]) == shown]
    panels.sort(key=lambda panel: not panel["part"].startswith("blur"))
    with matplotlib.rc_context(STYLE):
        figure = Figure((13, 12.5), layout="constrained")
        grid = figure.add_gridspec(3, 6, height_ratios=(1.25, 1, 1))
        places = [grid[0, 0:3], grid[0, 3:6], grid[1, 0:3], grid[1, 3:6]]
        places += [grid[2, 0:2], grid[2, 2:4], grid[2, 4:6]]
        drawn = []
        for place, panel in zip(places, panels, strict=False):
            drawn.append((figure.add_subplot(place), panel))
        setting = f"{size}² px, {threads} thread{'s' * (threads > 1)}"
        better = "up and to the left is better"
        title = f"Error of the final image against time, {setting}; {better}"
        figure.suptitle(title, fontsize=11)
        below = {"loc": "outside lower center", "ncols": 4, "frameon": False, "fontsize": 9}
        figure.legend(handles=_frontier_legend(), **below)
        marked = [(axes, _frontier_panel(axes, panel)) for axes, panel in drawn]
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # labels must not move what they were placed against
        for axes, points in marked:
            write_labels(figure, axes, points)
    return figure


def _frontier_legend() -> list[Line2D]:
    star = {"marker": "*", "markersize": 12, "linestyle": ""}
    return [
        Line2D([], [], color=DEFAULT, label="our default", **star),
        Line2D([], [], color=OURS, marker="o", linestyle="", label="ours"),
        Line2D([], [], color=RIVAL, marker="s", linestyle="", label="others"),
        Line2D([], [], color=FRONT, linewidth=4, alpha=0.5, label="Pareto front"),
    ]


def _frontier_panel(axes: Axes, panel: dict[str, Any]) -> list[Point]:
    """Draw one panel; return its points, which are to be labelled."""
    entries = sorted(panel["entries"], key=lambda entry: entry["median_ms"])
    finite = [entry["psnr_db"] for entry in entries if entry["psnr_db"] is not None]
    top = max(finite) + 0.12 * (max(finite) - min(finite))
    place = {}
    for entry in entries:
        psnr = entry["psnr_db"]
        place[entry["name"]] = (entry["median_ms"], top if psnr is None else psnr)
    front = [place[entry["name"]] for entry in entries if entry["front"]]
    thick = {"color": FRONT, "linewidth": 4, "alpha": 0.5, "solid_capstyle": "round"}
    axes.step(*zip(*front, strict=True), where="post", zorder=1, **thick)
    points = []
    for series in _series(panel["entries"]):
        names = [entry["name"] for entry in series]
        label, colour = _label(series), RIVAL
        size, marker, order = 5, "o" if _is_ours(names[0]) else "s", 3
        if series[0]["default"]:
            colour, size, marker, order = DEFAULT, 15, "*", 4
        elif _is_ours(names[0]):
            colour = OURS
        xy = [place[name] for name in names]
        look = {"color": colour, "marker": marker, "markersize": size, "linewidth": 0.8}
        axes.plot(*zip(*xy, strict=True), zorder=order, **look)
        points += [Point(*at, "", colour) for at in xy[:-1]]
        points.append(Point(*xy[-1], label, colour))
    _finish_frontier(axes, panel)
    return points


def _is_ours(name: str) -> bool:
    return name.startswith(_OUR_NAMES) or name.endswith("rates")


def _series(entries: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Entries whose names differ by one number belong together; the default stands alone."""
    series: dict[str, list[dict[str, Any]]] = {}
    for entry in entries:
        name = entry["name"]
        key = name if entry["default"] else _NUMBER.sub("#", name, count=1)
        series.setdefault(key, []).append(entry)
    return list(series.values())


def _label(series: list[dict[str, Any]]) -> str:
    label: str = series[0]["name"]
    if len(series) > 1:
        numbers = [_NUMBER.search(entry["name"]) for entry in (series[0], series[-1])]
        span = " … ".join(number.group() for number in numbers if number)
        label = _NUMBER.sub(span, label, count=1)
    exact = any(entry["psnr_db"] is None for entry in series)
    return f"{label} (no error)" if exact else label


def _finish_frontier(axes: Axes, panel: dict[str, Any]) -> None:
    axes.set_xscale("log")
    axes.margins(0.16, 0.16)
    plain_numbers(axes.xaxis)
    axes.set(xlabel="time, ms (log)", ylabel="PSNR, dB")
    verdict = panel["verdict"]
    slower = f"{100 * verdict['slower_than_front']:.0f} % slower than “{verdict['beaten_by']}”"
    stands = "on the front" if verdict["on_front"] else slower
    title = f"{panel['part']}\ndefault: {verdict['psnr_db']:.1f} dB, {stands}"
    axes.set_title(title, loc="left")
    axes.grid(alpha=0.2)


def write_labels(figure: Figure, axes: Axes, points: Sequence[Point]) -> None:
    """Write each label beside its point, where it covers the least of points, labels and axes
    already there; those of our default choose before the others.
    """
    scale = figure.dpi / 72
    frame, taken = axes.get_window_extent(), _taken(axes, points, scale)
    for point in sorted(points, key=lambda p: (p.colour != DEFAULT, p.x)):
        if not point.label:
            continue
        x, y = axes.transData.transform(point[:2])
        measured = axes.annotate(point.label, point[:2], (0, 0), **_LETTERS)
        extent = measured.get_window_extent()
        measured.remove()
        # outlines are wider than hinted text
        width, height = 1.05 * extent.width + 4, extent.height + 2

        def box(dx: float, dy: float) -> Bbox:
            left = x + dx * scale - width * (0.5 - 0.5 * np.sign(dx))
            return Bbox.from_bounds(left, y + dy * scale - height / 2, width, height)

        others = [one for one in taken if not one.contains(x, y)]

        def cost(step: tuple[float, float]) -> float:
            """Of what it covers, how far off it is, and what the line to it crosses."""
            (dx, dy), place = step, box(*step)
            outside = width * height - _overlap(place, frame)
            covered = sum(_overlap(place, one) for one in taken)
            ways = [(x + t * scale * dx, y + t * scale * dy) for t in (0.5, 0.7, 0.9)]
            crossed = sum(one.contains(*at) for one in others for at in ways)
            return covered + 3 * outside + scale * (abs(dx) + abs(dy)) + 10 * crossed

        dx, dy = min(_STEPS, key=cost)
        taken.append(box(dx, dy))
        leader = {"arrowstyle": "-", "color": point.colour, "linewidth": 0.4}
        axes.annotate(
            point.label,
            point[:2],
            (dx - 0.04 * width / scale * (dx < 0), dy),
            ha={-1: "right", 0: "center", 1: "left"}[int(np.sign(dx))],
            color=point.colour,
            path_effects=[withStroke(linewidth=2, foreground="white")],
            zorder=5,
            arrowprops=leader if abs(dx) + abs(dy) > _LEADER else None,
            **_LETTERS,
        )


def _taken(axes: Axes, points: Sequence[Point], scale: float) -> list[Bbox]:
    """Boxes around points and along lines."""
    boxes = []
    for point in points:
        reach = scale * (8 if point.colour == DEFAULT else 4)
        boxes.append(Bbox.from_extents(*_around(axes.transData.transform(point[:2]), reach)))
    for line in axes.lines:
        path = axes.transData.transform(line.get_path().vertices)
        for start, end in pairwise(path):
            for share in np.linspace(0, 1, 2 + int(np.hypot(*(end - start)) / (6 * scale))):
                boxes.append(Bbox.from_extents(*_around(start + share * (end - start), scale)))
    return boxes


def _around(at: np.ndarray, reach: float) -> np.ndarray:
    return np.concatenate([at - reach, at + reach])


def _overlap(a: Bbox, b: Bbox) -> float:
    width, height = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
    return float(max(width, 0) * max(height, 0))


def plain_numbers(axis: Axis) -> None:
    """1, 2, 5 along an axis instead of powers of ten."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axis.set_minor_formatter(NullFormatter())


if __name__ == "__main__":
    print(draw_frontier(json.loads((RESULTS / "frontier.json").read_text())))
