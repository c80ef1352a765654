"""Sheets: a heading, and cells of one shape for pictures, maps and curves."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from torch import Tensor

from uwaug._support.atomic import written_whole
from uwaug._support.checks import extent
from uwaug.presets.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


INK, GREY = "#1a1a1a", "#5a5a5a"
RGB = ("#c0392b", "#2e8b57", "#2a5caa")

_DPI, _WIDTH = 100, 1400  # px
_MARGIN, _GAP, _LABEL, _HEADER = 32, 18, 30, 92  # px
_LINE_PX = 20  # height of a caption's line
_LOW_PX = 130  # least height of a cell that has room for letters
_SMALLEST_PT = 6.0  # letters of a label that would leave its cell
_TITLE_STYLE: dict[str, Any] = {"loc": "left", "fontsize": 12.5, "color": INK}
_AS_WRITTEN: dict[str, Any] = {"parse_math": False}  # names of files: a $ stays a $


def sheet(
    scene: Scene, cells: int, heading: str, caption: str, columns: int | None = None
) -> tuple["Figure", list["Axes"]]:
    """Make at least so many cells, row by row, of the shape of a scene's picture, below a heading
    and a caption. By default 4 stand side by side, or fewer panoramas.
    """
    from matplotlib.figure import Figure

    height, width = scene.image.shape[-2:]

    def cell_width(columns: int) -> float:
        return (_WIDTH - 2 * _MARGIN - (columns - 1) * _GAP) / columns

    if columns is None:
        high = (n for n in (4, 2) if cell_width(n) * height / width >= _LOW_PX)
        columns = next(high, 1)
    rows = math.ceil(cells / columns)
    caption = f"{caption}\n{scene.note}".rstrip()
    wide = cell_width(columns)
    tall = wide * height / width
    pitch = _LABEL + tall + _GAP
    top = _HEADER + _LINE_PX * caption.count("\n")
    size = _WIDTH, round(top + rows * pitch + _MARGIN - _GAP)
    figure = Figure(figsize=(size[0] / _DPI, size[1] / _DPI), dpi=_DPI)
    style = {"va": "top", **_AS_WRITTEN}
    x0 = _MARGIN / size[0]
    figure.text(x0, 1 - 26 / size[1], heading, fontsize=18, fontweight="bold", **style)
    figure.text(x0, 1 - 62 / size[1], caption, fontsize=11.5, color=GREY, **style)
    axes = []
    for i in range(rows * columns):
        x = _MARGIN + i % columns * (wide + _GAP)
        y = size[1] - (top + i // columns * pitch + _LABEL + tall)
        axes.append(figure.add_axes((x / size[0], y / size[1], wide / size[0], tall / size[1])))
        axes[-1].set_axis_off()
    return figure, axes


def show(axis: "Axes", picture: Tensor, label: str) -> None:
    """Draw a picture (3xHxW, sRGB)."""
    axis.imshow(picture.clamp(0, 1).permute(1, 2, 0).numpy(), aspect="auto")
    title = axis.set_title(label, **_TITLE_STYLE, **_AS_WRITTEN)
    size, room = _TITLE_STYLE["fontsize"], axis.get_window_extent().width
    # letters do not narrow in proportion to their size
    while title.get_window_extent().width > room and size > _SMALLEST_PT:
        size -= 0.5
        title.set_fontsize(size)


def show_map(
    axis: "Axes",
    values: Tensor,
    label: str,
    colours: str,
    span: tuple[float, float],
    unit: str = "",
) -> None:
    """Draw a map (1xHxW) and a colour bar; one colour and no bar if the span is a single value."""
    low, high = span
    flat = _is_point(span)
    ends = (0, 2 * high) if flat else span
    pixels = values[0].numpy()
    picture = axis.imshow(pixels, cmap=colours, vmin=ends[0], vmax=ends[1], aspect="auto")
    axis.set_title(label, **_TITLE_STYLE, **_AS_WRITTEN)
    if flat:
        return
    # letters beneath a bar are as high in a low cell as in a high one
    tall = axis.get_window_extent().height
    k = min(max(1.0, 200 / tall), 300 / tall)
    frame = axis.inset_axes((0.03, 0.04 * k, 0.94, 0.14 * k), facecolor=(1, 1, 1, 0.85))
    frame.set(xticks=[], yticks=[])
    frame.spines[:].set_visible(False)
    bar = axis.inset_axes((0.06, 0.13 * k, 0.88, 0.03 * k))
    ticks = [low, (low + high) / 2, high]
    axis.figure.colorbar(picture, cax=bar, orientation="horizontal", ticks=ticks)
    bar.set_xticklabels(in_words(span, unit), fontsize=9.5, color=INK)
    bar.tick_params(length=2, pad=2)
    sides: tuple[Literal["left", "center", "right"], ...] = ("left", "center", "right")
    for text, side in zip(bar.get_xticklabels(), sides, strict=True):
        text.set_horizontalalignment(side)


def _is_point(span: tuple[float, float]) -> bool:
    return span[1] - span[0] <= span[1] / 1000


def in_words(span: tuple[float, float], unit: str) -> list[str]:
    """Low end, middle and high end in words, with the digits that tell them apart."""
    low, high = span
    digits = max(0, 1 - math.floor(math.log10(high - low)))
    return [f"{value:.{digits}f}{unit}" for value in (low, (low + high) / 2, high)]


def finite_extent(z: Tensor) -> tuple[float, float]:
    """Nearest and farthest distance (m) but for open water."""
    return extent(z[z.isfinite()])


def metres(z: Tensor) -> str:
    """Nearest and farthest distance in words."""
    span = finite_extent(z)
    if _is_point(span):
        return f"{span[1]:.3g} m"
    low, _, high = in_words(span, "")
    return f"{low}–{high} m"


def show_distance(axis: "Axes", z: Tensor) -> None:
    """Draw distances (1xHxW, m); +inf is open water."""
    span = finite_extent(z)
    flat, endless = _is_point(span), not bool(z.isfinite().all())
    label = "z   distance (darkest: open water too)" if endless else "z   distance"
    if flat:
        label = f"z   distance, {metres(z)} {'or open water' if endless else 'everywhere'}"
    farthest = 2 * span[1] if flat else span[1]
    show_map(axis, z.clamp(max=farthest), label, "viridis_r", span, " m")


def show_field(axis: "Axes", field: Tensor, span: tuple[float, float]) -> None:
    """Draw a medium field (1xHxW), in colours for `span`."""
    label = "m   medium field (multiplies z)"
    if _is_point(span):
        label = f"m   medium field, {span[0]:g} everywhere"
    show_map(axis, field, label, "RdBu_r", span)


def plot(cell: "Axes", label: str, xlabel: str, ylabel: str) -> "Axes":
    """Make axes for curves inside a cell of a sheet. The label may hold mathematics between $."""
    cell.set_title(label, **_TITLE_STYLE)
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
