"""Labels beside the points of a chart, each where it covers the least."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox

FONT = 7.5  # points
_COMPASS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
_RADII = (8, 12, 17, 24, 32, 42, 56, 72)  # points
_STEPS = [(r * dx, r * dy) for r in _RADII for dx, dy in _COMPASS]
_LEADER = 14  # points; a label farther off is joined to its point by a line


class Point(NamedTuple):
    """A point of a chart, in its data, and what is to be written beside it; "" for nothing."""

    x: float
    y: float
    label: str
    colour: str


@dataclass(frozen=True)
class _Text:
    """A label that looks for its place.

    Attributes:
        x, y: its point, px.
        width, height: its own, px.
        scale: px for each point of 1/72 in.
    """

    x: float
    y: float
    width: float
    height: float
    scale: float

    def box(self, dx: float, dy: float) -> Bbox:
        """What it covers, so many points from its point."""
        left = self.x + dx * self.scale
        if dx < 0:
            left -= self.width
        elif dx == 0:
            left -= self.width / 2
        bottom = self.y + dy * self.scale - self.height / 2
        return Bbox.from_bounds(left, bottom, self.width, self.height)

    def cost(self, dx: float, dy: float, taken: list[Bbox], frame: Bbox) -> float:
        """What is wrong with a place: what it covers, how far off it is, what the line crosses."""
        place = self.box(dx, dy)
        outside = self.width * self.height - _overlap(place, frame)
        covered = sum(_overlap(place, other) for other in taken)
        crossed = 0
        for other in taken:
            if not other.contains(self.x, self.y):
                for t in (0.5, 0.7, 0.9):
                    step = t * self.scale
                    crossed += other.contains(self.x + step * dx, self.y + step * dy)
        return covered + 3 * outside + self.scale * (abs(dx) + abs(dy)) + 10 * crossed


def write_labels(figure: Figure, axes: Axes, points: Sequence[Point], first: str) -> None:
    """Write each label beside its point, where it covers the least of points, labels and axes
    already there; those of the colour `first` choose before the others.
    """
    scale = figure.dpi / 72
    taken = _taken(axes, points, first, scale)
    frame = axes.get_window_extent()
    for point in sorted(points, key=lambda p: (p.colour != first, p.x)):
        if not point.label:
            continue
        text = _measured(axes, point, scale)
        costs = {step: text.cost(*step, taken, frame) for step in _STEPS}
        dx, dy = min(costs, key=costs.__getitem__)
        taken.append(text.box(dx, dy))
        _write(axes, point, dx, dy, -0.04 * text.width / scale)


def _taken(axes: Axes, points: Sequence[Point], first: str, scale: float) -> list[Bbox]:
    """Boxes around points and along lines."""
    taken = []
    for point in points:
        reach = scale * (8 if point.colour == first else 4)
        taken.append(_around(*axes.transData.transform(point[:2]), reach))
    for line in axes.lines:
        path = axes.transData.transform(line.get_path().vertices)
        for start, end in pairwise(path):
            along = np.linspace(0, 1, 2 + int(np.hypot(*(end - start)) / (6 * scale)))
            for share in along:
                taken.append(_around(*(start + share * (end - start)), scale))
    return taken


def _around(x: float, y: float, reach: float) -> Bbox:
    return Bbox.from_bounds(x - reach, y - reach, 2 * reach, 2 * reach)


def _measured(axes: Axes, point: Point, scale: float) -> _Text:
    at = {"textcoords": "offset points", "va": "center", "fontsize": FONT}
    text = axes.annotate(point.label, point[:2], (0, 0), color=point.colour, **at)
    extent = text.get_window_extent()
    text.remove()
    x, y = axes.transData.transform(point[:2])
    # outlines are wider than hinted text
    return _Text(x, y, 1.05 * extent.width + 4, extent.height + 2, scale)


def _write(axes: Axes, point: Point, dx: float, dy: float, inset: float) -> None:
    """`inset`: points, by which a label on the left comes nearer."""
    side = "center"
    if dx:
        side = "left" if dx > 0 else "right"
    far = abs(dx) + abs(dy) > _LEADER
    leader = {"arrowstyle": "-", "color": point.colour, "linewidth": 0.4}
    axes.annotate(
        point.label,
        point[:2],
        (dx + (inset if dx < 0 else 0), dy),
        textcoords="offset points",
        ha=side,
        va="center",
        fontsize=FONT,
        color=point.colour,
        path_effects=[withStroke(linewidth=2, foreground="white")],
        zorder=5,
        arrowprops=leader if far else None,
    )


def _overlap(a: Bbox, b: Bbox) -> float:
    width, height = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
    return float(max(width, 0) * max(height, 0))
