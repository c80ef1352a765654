"""The pictures of the demo: what the model does to a real scene. Each function draws one and says what it modelled."""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import torch
from torch import Tensor

from uwaug.colour import linear_to_srgb, srgb_to_linear
from uwaug.demand import blur_demand
from uwaug.distance import along_ray, fill_unknown, from_disparity, from_relative
from uwaug.field import gaussian_random_field
from uwaug.formation import Terms, form_image
from uwaug.medium import Medium, PointSpread
from uwaug.water import JERLOV_TYPES, Water

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DPI, _WIDTH = 100, 1400  # px
_MARGIN, _GAP, _LABEL, _HEADER = 32, 18, 30, 92  # px
_INK, _GREY = "#1a1a1a", "#5a5a5a"
_RGB = ("#c0392b", "#2e8b57", "#2a5caa")
_COAST = "1C"
_SETTING = "Scene 1 m deep, g = 0.2, μ = 0.3"  # the defaults of Medium.from_water
_HALF = {"gaussian": math.sqrt(2 * math.log(2)), "exponential": math.sqrt(3)}  # σ that hold half of the light


@dataclass(frozen=True)
class Scene:
    """A picture with distances.

    Attributes:
        image (3xHxW tensor): sRGB, 0…1.
        distance (1xHxW tensor): along the ray, m.
        focal_px: focal length, px.
    """

    image: Tensor
    distance: Tensor
    focal_px: float


class Drawing(NamedTuple):
    """A figure, and lines that say what it models."""

    figure: "Figure"
    modelled: list[str]


def motorcycle() -> Scene:
    """The motorcycle of the Middlebury 2014 stereo benchmark (Scharstein et al.), as scikit-image's wheel holds it.

    The 7 % of its pixels without disparity take the distance of the nearest pixel that has one.
    """
    from skimage.data import stereo_motorcycle

    left, _, disparity = stereo_motorcycle()
    focal_px = 994.978
    depth = from_disparity(torch.from_numpy(disparity)[None], focal_px, baseline_m=0.193001, offset_px=31.086)
    # the benchmark counts pixels from the centre of the first
    distance = along_ray(fill_unknown(depth), focal_px, centre=(311.193 + 0.5, 254.877 + 0.5))
    return Scene(torch.from_numpy(left).permute(2, 0, 1) / 255, distance, focal_px)


def draw_contact_sheet(scene: Scene) -> Drawing:
    """The ten Jerlov types over the scene's own distances."""
    waters = [Water.jerlov(name) for name in JERLOV_TYPES]
    low, high = scene.distance.aminmax()
    caption = (
        f"Jerlov types over the measured distances, {low:.1f}–{high:.1f} m. {_SETTING}, homogeneous, one exposure."
    )
    figure, axes = _sheet(3, 4, scene, "One scene in ten waters", caption)
    terms, modelled = _form(scene, Medium.stack([Medium.from_water(water) for water in waters]))
    _show(axes[0], scene.image, "No water")
    _show_distance(axes[1], scene.distance)
    for axis, water, picture in zip(axes[2:], waters, terms.image, strict=True):
        _show(axis, linear_to_srgb(picture), f"{water.name}   (visibility {water.visibility():.2g} m)")
    return Drawing(figure, modelled)


def draw_terms(scene: Scene) -> Drawing:
    """Every term of the model for a coastal type, in an inhomogeneous medium."""
    caption = f"I = D + F + B, added in linear light. All pictures at one exposure. {_SETTING}."
    figure, axes = _sheet(2, 4, scene, f"The terms of the image, Jerlov {_COAST}", caption)
    medium = Medium.from_water(Water.jerlov(_COAST))
    generator = torch.Generator().manual_seed(4)
    field = gaussian_random_field(scene.distance.shape[-2:], low=0.3, high=1.7, generator=generator)[0]
    terms, modelled = _form(scene, medium, field=field)
    _show(axes[0], scene.image, "J   scene without water")
    _show_distance(axes[1], scene.distance)
    _show_map(axes[2], field, "m   medium field (multiplies z)", "RdBu_r", ("0.3", "1.0", "1.7"))
    _show(axes[4], linear_to_srgb(terms.direct), "D   direct")
    _show(axes[5], linear_to_srgb(terms.forward), "F   forward scatter")
    _show(axes[6], linear_to_srgb(terms.backscatter), "B   backscatter")
    _show(axes[7], linear_to_srgb(terms.image), "I   image")
    plot = _plot(axes[3], "Curves of distance, red, green, blue", "z [m]", "")
    z = torch.linspace(0, 10, 201, dtype=torch.float64)
    for label, curve, style in (
        ("$T_β$  direct", medium.transmission(z), "-"),
        ("$T_G$  direct + forward", medium.signal(z), "--"),
        ("$B$  backscatter", medium.backscatter(z), ":"),
    ):
        for values, colour in zip(curve[0], _RGB, strict=True):
            plot.plot(z.numpy(), values.numpy(), style, color=colour, linewidth=1.6)
        plot.plot([], [], style, color=_INK, label=label)
    plot.set(xlim=(0, 10), ylim=(0, 1))
    plot.legend(frameon=False, fontsize=9.5, loc="upper right", handlelength=2.2, borderpad=0)
    return Drawing(figure, modelled)


def draw_white_plate() -> Drawing:
    """Colour of a white plate against distance in all types, with the veil in front of it and without."""
    from matplotlib.figure import Figure

    z = torch.linspace(0, 20, 801, dtype=torch.float64)
    waters = [Water.jerlov(name) for name in JERLOV_TYPES]
    media = [Medium.from_water(water) for water in waters]
    pitch, bar, gap, top = 42, 36, 36, _HEADER + 34  # px
    second, left = _MARGIN + 52, _MARGIN + 140
    width, height = (_WIDTH - left - gap - _MARGIN) / 2, top + pitch * len(media) + 64
    right = left + width + gap
    figure = Figure(figsize=(_WIDTH / _DPI, height / _DPI), dpi=_DPI)
    caption = "Camera RGB (Nikon D5100) of a white vertical plate against its distance, shown as sRGB."
    _head(figure, "A white plate in ten waters", f"{caption} {_SETTING}. The tick is the visibility.")

    def write(x: float, y: float, text: str, size: float, colour: str) -> None:
        figure.text(x / _WIDTH, 1 - y / height, text, fontsize=size, color=colour, va="center")

    write(_MARGIN, top - 19, "type", 10.5, _GREY)
    write(second, top - 19, "visibility", 10.5, _GREY)
    write(left, top - 19, "What the camera sees: plate and veil", 12.5, _INK)
    write(right, top - 19, "What is left of the plate's light", 12.5, _INK)
    for i, (water, medium) in enumerate(zip(waters, media, strict=True)):
        visibility, y, last = water.visibility(), top + pitch * i, medium is media[-1]
        write(_MARGIN, y + bar / 2, water.name, 12.5, _INK)
        write(second, y + bar / 2, f"{visibility:.2g} m", 10.5, _GREY)
        for x, veil in ((left, medium.backscatter(z)), (right, 0)):
            strip = linear_to_srgb(medium.signal(z) + veil)[0].clamp(0, 1).T[None].numpy()
            axis = figure.add_axes((x / _WIDTH, 1 - (y + bar) / height, width / _WIDTH, bar / height))
            axis.imshow(strip, extent=(0, 20, 0, 1), aspect="auto", interpolation="bilinear")
            if visibility <= 20:
                dark = strip[0, int(visibility * 40)].mean() < 0.5
                axis.plot([visibility, visibility], [0, 0.3], color="white" if dark else _INK, linewidth=1.6)
            axis.set(xlim=(0, 20), ylim=(0, 1), xticks=range(0, 21, 5) if last else [], yticks=[])
            axis.spines[:].set_visible(False)
            axis.tick_params(labelsize=11, colors=_GREY, length=3)
            axis.set_xlabel("distance [m]" if last else "", fontsize=11.5, color=_GREY)
    return Drawing(figure, ["the same ten media; one colour needs no blur"])


def draw_depth_scaling(scene: Scene) -> Drawing:
    """The paper's depth-scaling study: z from 0 to 20 m, γ = 1, 3, 6, in types II and 7C."""
    caption = f"$z$ = 20 m · $t^γ$, where $t$ = 0…1 is the relative distance. {_SETTING}, homogeneous, one exposure."
    figure, axes = _sheet(3, 3, scene, "Depth scaling", caption)
    low, high = scene.distance.aminmax()
    t = (scene.distance - low) / (high - low)
    modelled = []
    for column, gamma in enumerate((1.0, 3.0, 6.0)):
        z = from_relative(t, 0.0, 20.0, gamma)
        _show_map(axes[column], z, f"Distance z, γ = {gamma:g}", "viridis_r", ("0 m", "10 m", "20 m"), column == 0)
        for row, name in ((1, "II"), (2, "7C")):
            terms, lines = _form(scene, Medium.from_water(Water.jerlov(name)), z)
            _show(axes[3 * row + column], linear_to_srgb(terms.image), f"{name}, γ = {gamma:g}")
            modelled += [f"γ = {gamma:g}: {lines[0]}", *lines[1:]]
    return Drawing(figure, modelled)


def draw_width_laws(scene: Scene) -> Drawing:
    """The paper's width law against the one calibrated to Monte Carlo light transport, with an enlarged part."""
    from matplotlib.patches import Rectangle

    caption = (
        "Paper's: Gaussian, g = 0.2, μ = 0.3. Calibrated to Monte Carlo light transport: exponential, g = 0.05, "
        f"μ = 0.075, focal length {scene.focal_px:.0f} px. Scene 1 m deep."
    )
    figure, axes = _sheet(3, 3, scene, f"Width laws of the forward scatter, Jerlov {_COAST}", caption)
    water = Water.jerlov(_COAST)
    paper = Medium.from_water(water)
    # μ in the paper's ratio to g: the veil stays below a white plate
    calibrated = Medium.from_water(water, g=0.05, mu=0.075, point_spread=PointSpread.calibrated(scene.focal_px))
    height, width = scene.image.shape[-2:]
    plot = _plot(axes[6], "Half of the scattered light is within", "distance [m]", "radius [px]")
    z = torch.linspace(0.05, 8, 160, dtype=torch.float64)
    columns: list[tuple[str, Tensor]] = [("No water", scene.image)]
    modelled = []
    for axis, label, medium, colour in (
        (axes[7], "Paper's law", paper, _RGB[2]),
        (axes[8], "Calibrated law", calibrated, _RGB[0]),
    ):
        terms, lines = _form(scene, medium)
        modelled += lines
        columns.append((label, linear_to_srgb(terms.image)))
        _show(axis, linear_to_srgb(terms.forward), f"{label}, forward scatter alone")
        half = _HALF[medium.point_spread.shape] * medium.width(z[None, None, None], (height, width)).flatten()
        plot.plot(z.numpy(), half.numpy(), color=colour, label=label, linewidth=2)
    low, high = (float(v) for v in scene.distance.aminmax())
    plot.axvspan(low, high, color="black", alpha=0.07, linewidth=0, label="this scene")
    plot.set(xlim=(0, 8), yscale="log", ylim=(0.01, 500))
    plot.legend(frameon=False, fontsize=10.5, loc="lower right", reverse=True)
    (y, x), (h, w) = (int(0.32 * height), int(0.50 * width)), (height // 4, width // 4)
    for whole, part, (label, picture) in zip(axes[:3], axes[3:6], columns, strict=True):
        _show(whole, picture, label)
        whole.add_patch(Rectangle((x, y), w, h, fill=False, edgecolor="white", linewidth=1.4))
        _show(part, picture[:, y : y + h, x : x + w], f"{label}, enlarged")
    return Drawing(figure, modelled)


PICTURES: dict[str, Callable[[Scene], Drawing]] = {
    "1-waters.jpg": draw_contact_sheet,
    "2-terms.jpg": draw_terms,
    "3-white-plate.png": lambda _: draw_white_plate(),
    "4-depth-scaling.jpg": draw_depth_scaling,
    "5-width-laws.jpg": draw_width_laws,
}
"""The demo's files and who draws them."""


def save(figure: "Figure", path: Path) -> None:
    """Write a figure as PNG or JPEG, whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    options = {"quality": 88} if path.suffix == ".jpg" else {"optimize": True}
    try:
        figure.savefig(partial, format=path.suffix[1:], pil_kwargs=options)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def _form(
    scene: Scene, medium: Medium, distance: Tensor | None = None, field: Tensor | None = None
) -> tuple[Terms, list[str]]:
    z = scene.distance if distance is None else distance
    low, high = (float(v) for v in (z if field is None else z * field).aminmax())
    plan = blur_demand(medium, (low, high)).plan((z.shape[-2], z.shape[-1]))
    terms = form_image(srgb_to_linear(scene.image), z, medium, field, plan=plan)
    return terms, [*(repr(medium[i]) for i in range(len(medium))), str(plan)]


def _head(figure: "Figure", heading: str, caption: str) -> None:
    height = figure.get_figheight() * _DPI
    figure.text(_MARGIN / _WIDTH, 1 - 26 / height, heading, fontsize=18, fontweight="bold", color=_INK, va="top")
    figure.text(_MARGIN / _WIDTH, 1 - 62 / height, caption, fontsize=11.5, color=_GREY, va="top")


def _sheet(rows: int, columns: int, scene: Scene, heading: str, caption: str) -> tuple["Figure", list["Axes"]]:
    """A grid of cells, row by row, each of the scene's shape."""
    from matplotlib.figure import Figure

    width = (_WIDTH - 2 * _MARGIN - (columns - 1) * _GAP) / columns
    tall = width * scene.image.shape[-2] / scene.image.shape[-1]
    pitch = _LABEL + tall + _GAP
    height = round(_HEADER + rows * pitch + _MARGIN - _GAP)
    figure = Figure(figsize=(_WIDTH / _DPI, height / _DPI), dpi=_DPI)
    _head(figure, heading, caption)
    axes = []
    for i in range(rows * columns):
        x, bottom = _MARGIN + i % columns * (width + _GAP), _HEADER + (i // columns + 1) * pitch - _GAP
        axes.append(figure.add_axes((x / _WIDTH, 1 - bottom / height, width / _WIDTH, tall / height)))
        axes[-1].set_axis_off()
    return figure, axes


def _show(axis: "Axes", picture: Tensor, label: str) -> None:
    axis.imshow(picture.clamp(0, 1).permute(1, 2, 0).numpy(), aspect="auto")
    axis.set_title(label, loc="left", fontsize=12.5, color=_INK)


def _show_distance(axis: "Axes", z: Tensor) -> None:
    low, high = (float(v) for v in z.aminmax())
    ticks = tuple(f"{v:.1f} m" for v in (low, (low + high) / 2, high))
    _show_map(axis, z, "z   distance", "viridis_r", ticks)


def _show_map(axis: "Axes", values: Tensor, label: str, colours: str, ticks: tuple[str, ...], bar: bool = True) -> None:
    """A map, with a colour bar inside: labels for the low end, the middle and the high end."""
    low, high = (float(tick.split()[0]) for tick in (ticks[0], ticks[-1]))
    picture = axis.imshow(values[0].numpy(), cmap=colours, vmin=low, vmax=high, aspect="auto")
    axis.set_title(label, loc="left", fontsize=12.5, color=_INK)
    if not bar:
        return
    frame = axis.inset_axes((0.03, 0.04, 0.94, 0.14), facecolor=(1, 1, 1, 0.85), xticks=[], yticks=[])
    frame.spines[:].set_visible(False)
    scale = axis.inset_axes((0.06, 0.13, 0.88, 0.03))
    axis.figure.colorbar(picture, cax=scale, orientation="horizontal", ticks=[low, (low + high) / 2, high])
    scale.set_xticklabels(ticks, fontsize=9.5, color=_INK)
    scale.tick_params(length=2, pad=2)
    sides: tuple[Literal["left", "center", "right"], ...] = ("left", "center", "right")
    for text, side in zip(scale.get_xticklabels(), sides, strict=True):
        text.set_horizontalalignment(side)


def _plot(cell: "Axes", label: str, xlabel: str, ylabel: str) -> "Axes":
    """Axes for curves inside a cell of a sheet, with room for what is written on them."""
    cell.set_title(label, loc="left", fontsize=12.5, color=_INK)
    axis = cell.inset_axes((0.14, 0.17, 0.84, 0.80))
    axis.set_xlabel(xlabel, fontsize=10.5, color=_GREY, labelpad=2)
    axis.set_ylabel(ylabel, fontsize=10.5, color=_GREY, labelpad=2)
    axis.tick_params(labelsize=10, colors=_GREY, length=3)
    axis.spines[["top", "right"]].set_visible(False)
    return axis
