"""Sheets of pictures: a heading, and cells of one shape for pictures, maps and curves."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from torch import Tensor

from uwaug.files import written_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["GREY", "INK", "RGB", "Canvas", "plot", "save", "sheet", "show", "show_map"]

INK, GREY = "#1a1a1a", "#5a5a5a"
RGB = ("#c0392b", "#2e8b57", "#2a5caa")

_DPI, _WIDTH = 100, 1400  # px
MARGIN, GAP, _LABEL, HEADER = 32, 18, 30, 92  # px
_TITLE: dict[str, Any] = {"loc": "left", "fontsize": 12.5, "color": INK}


class Canvas:
    """A figure that is drawn on in px from its top left corner, with a heading."""

    width = _WIDTH

    def __init__(self, height: float, heading: str, caption: str) -> None:
        from matplotlib.figure import Figure

        self.height = height
        self.figure: Figure = Figure(figsize=(_WIDTH / _DPI, height / _DPI), dpi=_DPI)
        self.write(MARGIN, 26, heading, 18, va="top", fontweight="bold")
        self.write(MARGIN, 62, caption, 11.5, GREY, va="top")

    def write(
        self, x: float, y: float, text: str, size: float, colour: str = INK, **style: Any
    ) -> None:
        """Write a text; y is its middle."""
        style = {"va": "center", **style}
        at = (x / _WIDTH, 1 - y / self.height)
        self.figure.text(*at, text, fontsize=size, color=colour, **style)

    def axes(self, x: float, y: float, width: float, height: float) -> "Axes":
        """A cell, from its top left corner."""
        bottom = 1 - (y + height) / self.height
        box = (x / _WIDTH, bottom, width / _WIDTH, height / self.height)
        return self.figure.add_axes(box)


def sheet(
    rows: int, columns: int, shape: tuple[int, int], heading: str, caption: str
) -> tuple["Figure", list["Axes"]]:
    """A grid of cells, row by row, each of the shape of a picture of (height, width)."""
    width = (_WIDTH - 2 * MARGIN - (columns - 1) * GAP) / columns
    tall = width * shape[0] / shape[1]
    pitch = _LABEL + tall + GAP
    canvas = Canvas(round(HEADER + rows * pitch + MARGIN - GAP), heading, caption)
    axes = []
    for i in range(rows * columns):
        x, y = MARGIN + i % columns * (width + GAP), HEADER + _LABEL + i // columns * pitch
        axes.append(canvas.axes(x, y, width, tall))
        axes[-1].set_axis_off()
    return canvas.figure, axes


def show(axis: "Axes", picture: Tensor, label: str) -> None:
    """A picture (3xHxW, sRGB)."""
    axis.imshow(picture.clamp(0, 1).permute(1, 2, 0).numpy(), aspect="auto")
    axis.set_title(label, **_TITLE)


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
    axis.set_title(label, **_TITLE)
    if not bar:
        return
    frame = axis.inset_axes((0.03, 0.04, 0.94, 0.14), facecolor=(1, 1, 1, 0.85))
    frame.set(xticks=[], yticks=[])
    frame.spines[:].set_visible(False)
    scale = axis.inset_axes((0.06, 0.13, 0.88, 0.03))
    at = [low, (low + high) / 2, high]
    axis.figure.colorbar(picture, cax=scale, orientation="horizontal", ticks=at)
    scale.set_xticklabels(ticks, fontsize=9.5, color=INK)
    scale.tick_params(length=2, pad=2)
    sides: tuple[Literal["left", "center", "right"], ...] = ("left", "center", "right")
    for text, side in zip(scale.get_xticklabels(), sides, strict=True):
        text.set_horizontalalignment(side)


def plot(cell: "Axes", label: str, xlabel: str, ylabel: str) -> "Axes":
    """Axes for curves inside a cell of a sheet, with room for what is written on them."""
    cell.set_title(label, **_TITLE)
    axis = cell.inset_axes((0.14, 0.17, 0.84, 0.80))
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
