"""Sheets of pictures: a heading, and cells of one shape for pictures, maps and curves."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from torch import Tensor

from uwaug._support.atomic import written_whole
from uwaug._support.checks import extent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


INK, GREY = "#1a1a1a", "#5a5a5a"
RGB = ("#c0392b", "#2e8b57", "#2a5caa")

_DPI, _WIDTH = 100, 1400  # px
MARGIN, GAP, _LABEL, HEADER = 32, 18, 30, 92  # px
_LINE = 20
"""px: height of a caption's line."""

_LOW = 130
"""px: a cell that is less high has no room for what is written into it."""

_TITLE: dict[str, Any] = {"loc": "left", "fontsize": 12.5, "color": INK}

_PLAIN: dict[str, Any] = {"parse_math": False}
"""Of a text that may be a user's, such as a file's name: a $ in it is a $."""


class Canvas:
    """A figure that is drawn on in px from its top left corner, with a heading. `math` says that
    the caption has mathematics between $.
    """

    width = _WIDTH

    def __init__(self, height: float, heading: str, caption: str, *, math: bool = False) -> None:
        from matplotlib.figure import Figure

        self.height = height
        self.figure: Figure = Figure(figsize=(_WIDTH / _DPI, height / _DPI), dpi=_DPI)
        self.write(MARGIN, 26, heading, 18, va="top", fontweight="bold")
        self.write(MARGIN, 62, caption, 11.5, GREY, va="top", parse_math=math)

    def write(
        self, x: float, y: float, text: str, size: float, colour: str = INK, **style: Any
    ) -> None:
        """Write a text; y is its middle."""
        style = {"va": "center", **_PLAIN, **style}
        at = (x / _WIDTH, 1 - y / self.height)
        self.figure.text(*at, text, fontsize=size, color=colour, **style)

    def axes(self, x: float, y: float, width: float, height: float) -> "Axes":
        """A cell, from its top left corner."""
        bottom = 1 - (y + height) / self.height
        box = (x / _WIDTH, bottom, width / _WIDTH, height / self.height)
        return self.figure.add_axes(box)


def columns_for(shape: tuple[int, int]) -> int:
    """How many pictures of (height, width) go beside one another: 4, or fewer panoramas."""
    for columns in (4, 2):
        if _cell_width(columns) * shape[0] / shape[1] >= _LOW:
            return columns
    return 1


def _cell_width(columns: int) -> float:
    return (_WIDTH - 2 * MARGIN - (columns - 1) * GAP) / columns


def sheet(
    rows: int,
    columns: int,
    shape: tuple[int, int],
    heading: str,
    caption: str,
    *,
    math: bool = False,
    below: float = 0,
    title_lines: int = 1,
) -> tuple["Figure", list["Axes"]]:
    """A grid of cells, row by row, each of the shape of a picture of (height, width). The caption
    may have several lines, and so may titles; for `math` see `Canvas`; `below` is room under the
    cells, px.
    """
    width = _cell_width(columns)
    tall, label = width * shape[0] / shape[1], _LABEL + _LINE * (title_lines - 1)
    pitch = label + tall + GAP
    top = HEADER + _LINE * caption.count("\n")
    canvas = Canvas(round(top + rows * pitch + MARGIN - GAP + below), heading, caption, math=math)
    axes = []
    for i in range(rows * columns):
        x, y = MARGIN + i % columns * (width + GAP), top + label + i // columns * pitch
        axes.append(canvas.axes(x, y, width, tall))
        axes[-1].set_axis_off()
    return canvas.figure, axes


def show(axis: "Axes", picture: Tensor, label: str) -> None:
    """A picture (3xHxW, sRGB)."""
    axis.imshow(picture.clamp(0, 1).permute(1, 2, 0).numpy(), aspect="auto")
    axis.set_title(label, **_TITLE, **_PLAIN)


def show_map(
    axis: "Axes",
    values: Tensor,
    label: str,
    colours: str,
    ticks: tuple[str, str, str],
    bar: bool = True,
) -> None:
    """A map (1xHxW), with a colour bar inside: labels for its low end, middle and high end."""
    low, high = (float(tick.split()[0]) for tick in (ticks[0], ticks[2]))
    picture = axis.imshow(values[0].numpy(), cmap=colours, vmin=low, vmax=high, aspect="auto")
    axis.set_title(label, **_TITLE, **_PLAIN)
    if not bar:
        return
    # what is written beneath a bar is as high in a low cell, and in a high one
    tall = axis.get_window_extent().height
    k = min(max(1.0, 200 / tall), 300 / tall)
    frame = axis.inset_axes((0.03, 0.04 * k, 0.94, 0.14 * k), facecolor=(1, 1, 1, 0.85))
    frame.set(xticks=[], yticks=[])
    frame.spines[:].set_visible(False)
    scale = axis.inset_axes((0.06, 0.13 * k, 0.88, 0.03 * k))
    at = [low, (low + high) / 2, high]
    axis.figure.colorbar(picture, cax=scale, orientation="horizontal", ticks=at)
    scale.set_xticklabels(ticks, fontsize=9.5, color=INK)
    scale.tick_params(length=2, pad=2)
    sides: tuple[Literal["left", "center", "right"], ...] = ("left", "center", "right")
    for text, side in zip(scale.get_xticklabels(), sides, strict=True):
        text.set_horizontalalignment(side)


def seen(z: Tensor) -> tuple[float, float]:
    """The nearest and the farthest distance (m) that is not open water."""
    return extent(z[z.isfinite()])


def ticks_of(z: Tensor) -> tuple[str, str, str]:
    """The nearest, the middle and the farthest distance in words, with the digits that tell them
    apart.
    """
    low, high = seen(z)
    digits = _digits(max(high - low, high / 1000))
    return f"{low:.{digits}f} m", f"{(low + high) / 2:.{digits}f} m", f"{high:.{digits}f} m"


def _digits(span: float) -> int:
    """Decimals of numbers that span so much."""
    return max(0, 1 - math.floor(math.log10(span)))


def round_up(metres: float) -> float:
    """To 1, 2 or 5 times a power of ten."""
    power: float = 10.0 ** math.floor(math.log10(metres))
    return next(step * power for step in (1, 2, 5, 10) if step * power >= metres)


def show_distance(axis: "Axes", z: Tensor) -> None:
    """Distances (1xHxW, m); +inf is open water."""
    ticks, far = ticks_of(z), seen(z)[1]
    everywhere = bool(z.isfinite().all())
    if ticks[0] == ticks[2]:
        label = f"z   distance, {far:.3g} m {'everywhere' if everywhere else 'or open water'}"
        show_map(axis, z.clamp(max=2 * far), label, "viridis_r", ("0", "", f"{2 * far}"), bar=False)
        return
    label = "z   distance" if everywhere else "z   distance (darkest: open water too)"
    show_map(axis, z.clamp(max=far), label, "viridis_r", ticks)


def show_field(axis: "Axes", field: Tensor, span: tuple[float, float]) -> None:
    """A medium field (1xHxW), in colours for `span`."""
    low, high = span
    if low == high:
        label = f"m   medium field, {low:g} everywhere"
        show_map(axis, field, label, "RdBu_r", ("0", "", str(2 * low)), bar=False)
        return
    digits = _digits(high - low)
    ticks = (f"{low:.{digits}f}", f"{(low + high) / 2:.{digits}f}", f"{high:.{digits}f}")
    show_map(axis, field, "m   medium field (multiplies z)", "RdBu_r", ticks)


def plot(cell: "Axes", label: str, xlabel: str, ylabel: str) -> "Axes":
    """Axes for curves inside a cell of a sheet, with room for what is written on them. The label
    is ours, and may have mathematics between $.
    """
    cell.set_title(label, **_TITLE)
    bottom = max(0.17, 36 / cell.get_window_extent().height)
    axis = cell.inset_axes((0.14, bottom, 0.84, 0.97 - bottom))
    axis.set_xlabel(xlabel, fontsize=10.5, color=GREY, labelpad=2)
    axis.set_ylabel(ylabel, fontsize=10.5, color=GREY, labelpad=2)
    axis.tick_params(labelsize=10, colors=GREY, length=3)
    axis.spines[["top", "right"]].set_visible(False)
    return axis


def save(figure: "Figure", path: Path) -> None:
    """Write a figure as PNG or JPEG, whole or not at all."""
    options = {"quality": 88} if path.suffix == ".jpg" else {"optimize": True}
    with written_whole(path) as part:
        figure.savefig(part, format=path.suffix[1:], pil_kwargs=options)
