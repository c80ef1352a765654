"""What the model does to a scene, the demo's or one's own. Each function draws a sheet."""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from uwaug._support.checks import extent
from uwaug._support.types import ColorSpace
from uwaug.distance.convert import from_relative
from uwaug.figures.sheet import (
    GREY,
    HEADER,
    INK,
    MARGIN,
    RGB,
    Canvas,
    columns_for,
    plot,
    round_up,
    seen,
    sheet,
    show,
    show_distance,
    show_field,
    show_map,
    ticks_of,
)
from uwaug.formation.colour import decoded, linear_to_srgb
from uwaug.formation.development import NEUTRAL, Development, exposed
from uwaug.formation.field import gaussian_random_field
from uwaug.formation.image import form_image
from uwaug.formation.underwater import Underwater
from uwaug.optics.jerlov import JERLOV_TYPES
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.scattering import Scattering
from uwaug.optics.water import Water
from uwaug.presets.preset import Preset
from uwaug.presets.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SETTING = f"Scene 1 m deep, g = {Scattering.PAPER.g:g}, μ = {Scattering.PAPER.mu:g}"
"""In words, the defaults of `uwaug.Medium.from_water`."""

_DEPTH = 5.0
"""m below the surface: of scenes in waters, as a camera takes them."""

_CAMERA = (
    f"Scene {_DEPTH:g} m deep, surfaces with spectra, a camera with its colour matrix and an "
    "automatic exposure"
)
"""In words, what `water_case` has."""

_DEVELOPMENT = Development(exposure="auto", gamut=1.0)

_COAST = "1C"
_EVEN = f"{SETTING}, homogeneous, one exposure"

_HALF = {"gaussian": math.sqrt(2 * math.log(2)), "exponential": math.sqrt(3)}
"""Radius that holds half of the light, in σ."""


class Case(NamedTuple):
    """What the terms are drawn in.

    Attributes:
        name, setting: of the water, and how the scene lies in it, for heading and caption.
        medium: a batch of one.
        development, color_space: of the camera.
        field_range: least and largest value of the medium field.
    """

    name: str
    setting: str
    medium: Medium
    development: Development
    color_space: ColorSpace
    field_range: tuple[float, float]


def water_case(water: Water, scene: Scene, field_range: tuple[float, float] = (1.0, 1.0)) -> Case:
    """A scene in a water, as the sheet of ten waters has it."""
    name = f"Jerlov {water.name}" if water.name in JERLOV_TYPES else water.name
    return Case(name, _CAMERA, _media([water], scene), _DEVELOPMENT, "srgb", field_range)


def _media(waters: Sequence[Water], scene: Scene) -> Medium:
    """Each water with spectra, a colour matrix, and the calibrated width law."""
    width = scene.image.shape[-1]
    law = PointSpread.calibrated(scene.focal_px or 0.866 * width)
    return Medium.stack(
        Medium.from_water(
            water,
            vertical_depth=_DEPTH,
            g=Scattering.CALIBRATED.g,
            point_spread=law,
            surfaces="spectral",
        )
        for water in waters
    )


def preset_case(preset: Preset) -> Case:
    """What a preset comes to."""
    setting = f"Preset {preset.name}: {preset.medium.notes[0]}"
    return Case(
        f"preset {preset.name}",
        setting,
        preset.medium,
        preset.development,
        preset.color_space,
        preset.field_range,
    )


def draw_contact_sheet(scene: Scene) -> "Figure":
    """The ten Jerlov types over the scene's own distances."""
    waters = [Water.jerlov(name) for name in JERLOV_TYPES]
    low, _, high = ticks_of(scene.distance)
    metres = (
        f"{seen(scene.distance)[1]:.3g} m" if low == high else f"{low.removesuffix(' m')}–{high}"
    )
    beyond = "" if bool(scene.distance.isfinite().all()) else " and open water"
    caption = f"Jerlov types over the scene's distances, {metres}{beyond}. {_CAMERA}."
    columns = columns_for(_shape(scene))
    figure, axes = sheet(
        12 // columns, columns, _shape(scene), "One scene in ten waters", _noted(caption, scene)
    )
    pictures = _picture(scene, _media(waters, scene), _DEVELOPMENT)
    show(axes[0], scene.image, "No water")
    show_distance(axes[1], scene.distance)
    for axis, water, picture in zip(axes[2:], waters, pictures, strict=True):
        show(axis, picture, f"{water.name}   (visibility {water.visibility():.2g} m)")
    return figure


def draw_terms(scene: Scene, case: Case) -> "Figure":
    """Every term of the model."""
    light = "added in linear light"
    if case.color_space == "linear":
        light = "of sRGB values taken for light"
    caption = f"I = D + F + B, {light}. All pictures at one exposure."
    if case.development.gamut > 0:
        caption += " Colours out of sRGB are clipped in terms, and compressed in I."
    columns = columns_for(_shape(scene))
    figure, axes = sheet(
        8 // columns,
        columns,
        _shape(scene),
        f"The terms of the image, {case.name}",
        _noted(f"{caption}\n{case.setting}.", scene),
    )
    rng, (low, high) = torch.Generator().manual_seed(4), case.field_range
    field = gaussian_random_field(_shape(scene), low=low, high=high, generator=rng)[0]
    z, medium = scene.distance * field, case.medium
    direct, forward, backscatter = _terms(scene, z, case)
    show(axes[0], scene.image, "J   scene without water")
    show_distance(axes[1], scene.distance)
    show_field(axes[2], field, case.field_range)
    show(axes[4], direct, "D   direct")
    show(axes[5], forward, "F   forward scatter")
    show(axes[6], backscatter, "B   backscatter")
    show(axes[7], _picture(scene, medium, case.development, z, case.color_space), "I   image")
    axis = plot(axes[3], "Curves of distance, red, green, blue", "z [m]", "")
    reach = round_up(1.5 * seen(scene.distance)[1])
    metres = torch.linspace(0, reach, 201, dtype=torch.float64)
    for label, curve, style in (
        ("$T_β$  direct", _of_white(medium.transmission(metres)), "-"),
        ("$T_G$  direct + forward", _of_white(medium.signal(metres)), "--"),
        ("$B$  backscatter", medium.backscatter(metres), ":"),
    ):
        for values, colour in zip(curve[0], RGB, strict=True):
            axis.plot(metres.numpy(), values.numpy(), style, color=colour, linewidth=1.6)
        axis.plot([], [], style, color=INK, label=label)
    # a colour matrix makes more of a channel than there is
    axis.set(xlim=(0, reach), ylim=(0, max(1, axis.dataLim.ymax)))
    box: dict[str, Any] = {
        "framealpha": 0.85,
        "edgecolor": "none",
        "handlelength": 2.2,
        "borderpad": 0,
    }
    axis.legend(fontsize=9.5, loc="upper right", **box)
    return figure


def draw_white_plate() -> "Figure":
    """Colour of a white plate against distance in all types, with the veil in front of it and
    without.
    """
    z = torch.linspace(0, 20, 801, dtype=torch.float64)
    pitch, bar, gap, top = 42, 36, 36, HEADER + 34  # px
    second, left = MARGIN + 52, MARGIN + 140
    width = (Canvas.width - left - gap - MARGIN) / 2
    right = left + width + gap
    plate = "Camera RGB (Nikon D5100) of a white vertical plate against its distance, shown as sRGB"
    canvas = Canvas(
        height=top + pitch * len(JERLOV_TYPES) + 64,
        heading="A white plate in ten waters",
        caption=f"{plate}. {SETTING}. The tick is the visibility.",
    )
    canvas.write(MARGIN, top - 19, "type", 10.5, GREY)
    canvas.write(second, top - 19, "visibility", 10.5, GREY)
    canvas.write(left, top - 19, "What the camera sees: plate and veil", 12.5)
    canvas.write(right, top - 19, "What is left of the plate's light", 12.5)
    for i, name in enumerate(JERLOV_TYPES):
        water, y = Water.jerlov(name), top + pitch * i
        medium, visibility = Medium.from_water(water), water.visibility()
        canvas.write(MARGIN, y + bar / 2, name, 12.5)
        canvas.write(second, y + bar / 2, f"{visibility:.2g} m", 10.5, GREY)
        for x, veil in ((left, medium.backscatter(z)), (right, 0)):
            axis = canvas.axes(x, y, width, bar)
            _draw_strip(axis, linear_to_srgb(medium.signal(z) + veil), visibility)
            if name == JERLOV_TYPES[-1]:
                axis.set(xticks=range(0, 21, 5))
                axis.set_xlabel("distance [m]", fontsize=11.5, color=GREY)
    return canvas.figure


def _draw_strip(axis: "Axes", colours: Tensor, visibility: float) -> None:
    """Colours (1x3xN) over 0…20 m, with a tick at the visibility."""
    strip = colours[0].clamp(0, 1).T[None].numpy()
    axis.imshow(strip, extent=(0, 20, 0, 1), aspect="auto", interpolation="bilinear")
    if visibility <= 20:
        here = strip[0, round(visibility / 20 * (strip.shape[1] - 1))]
        tick = "white" if here.mean() < 0.5 else INK
        axis.plot([visibility, visibility], [0, 0.3], color=tick, linewidth=1.6)
    axis.set(xlim=(0, 20), ylim=(0, 1), xticks=[], yticks=[])
    axis.spines[:].set_visible(False)
    axis.tick_params(labelsize=11, colors=GREY, length=3)


def draw_depth_scaling(scene: Scene) -> "Figure":
    """The paper's depth-scaling study: z from 0 to 20 m, γ = 1, 3, 6, in types II and 7C."""
    law = "$z$ = 20 m · $t^γ$, where $t$ = 0…1 is the relative distance"
    figure, axes = sheet(3, 3, _shape(scene), "Depth scaling", f"{law}. {_EVEN}.", math=True)
    low, high = scene.distance.aminmax()
    t = (scene.distance - low) / (high - low)
    for column, gamma in enumerate((1.0, 3.0, 6.0)):
        z = from_relative(t, 0.0, 20.0, gamma)
        label, ticks = f"Distance z, γ = {gamma:g}", ("0 m", "10 m", "20 m")
        show_map(axes[column], z, label, "viridis_r", ticks, bar=column == 0)
        for row, name in ((1, "II"), (2, "7C")):
            picture = _picture(scene, Medium.from_water(name), NEUTRAL, z)
            show(axes[3 * row + column], picture, f"{name}, γ = {gamma:g}")
    return figure


def draw_width_laws(scene: Scene) -> "Figure":
    """The paper's width law against the one calibrated to Monte Carlo light transport, with an
    enlarged part.
    """
    from matplotlib.patches import Rectangle

    if scene.focal_px is None:
        raise ValueError("scene.focal_px is None: expected the focal length in px, for its law")
    constants, papers = Scattering.CALIBRATED, Scattering.PAPER
    caption = (
        f"Paper's: Gaussian, g = {papers.g:g}, μ = {papers.mu:g}. Calibrated to Monte Carlo light "
        f"transport: exponential, g = {constants.g:g}, μ = {constants.mu:g}, focal length "
        f"{scene.focal_px:.0f} px. Scene 1 m deep."
    )
    heading = f"Width laws of the forward scatter, Jerlov {_COAST}"
    figure, axes = sheet(3, 3, _shape(scene), heading, caption)
    water, law = Water.jerlov(_COAST), PointSpread.calibrated(scene.focal_px)
    paper = Medium.from_water(water)
    calibrated = Medium.from_water(water, g=constants.g, point_spread=law)
    height, width = _shape(scene)
    radius = plot(axes[6], "Half of the scattered light is within", "distance [m]", "radius [px]")
    z = torch.linspace(0.05, 8, 160, dtype=torch.float64)
    columns: list[tuple[str, Tensor]] = [("No water", scene.image)]
    for axis, label, medium, colour in (
        (axes[7], "Paper's law", paper, RGB[2]),
        (axes[8], "Calibrated law", calibrated, RGB[0]),
    ):
        columns.append((label, _picture(scene, medium, NEUTRAL)))
        forward = form_image(decoded(scene.image, "srgb"), scene.distance, medium).forward
        show(axis, linear_to_srgb(forward), f"{label}, forward scatter alone")
        sigma = medium.width(z[None, None, None], (height, width)).flatten()
        half = _HALF[medium.point_spread.shape] * sigma
        radius.plot(z.numpy(), half.numpy(), color=colour, label=label, linewidth=2)
    low, high = extent(scene.distance)
    radius.axvspan(low, high, color="black", alpha=0.07, linewidth=0, label="this scene")
    radius.set(xlim=(0, 8), yscale="log", ylim=(0.01, 500))
    radius.legend(frameon=False, fontsize=10.5, loc="lower right", reverse=True)
    (y, x), (h, w) = (int(0.32 * height), int(0.50 * width)), (height // 4, width // 4)
    for whole, part, (label, picture) in zip(axes[:3], axes[3:6], columns, strict=True):
        show(whole, picture, label)
        whole.add_patch(Rectangle((x, y), w, h, fill=False, edgecolor="white", linewidth=1.4))
        show(part, picture[:, y : y + h, x : x + w], f"{label}, enlarged")
    return figure


PICTURES: "dict[str, Callable[[Scene], Figure]]" = {
    "1-waters.jpg": draw_contact_sheet,
    "2-terms.jpg": lambda scene: draw_terms(
        scene, water_case(Water.jerlov(_COAST), scene, (0.3, 1.7))
    ),
    "3-white-plate.png": lambda _: draw_white_plate(),
    "4-depth-scaling.jpg": draw_depth_scaling,
    "5-width-laws.jpg": draw_width_laws,
}
"""The demo's files and who draws them."""


def own_pictures(case: Case | Water) -> "dict[str, Callable[[Scene], Figure]]":
    """The files that show a scene of one's own, and who draws them; the terms in a water, or in a
    case, such as that of a preset.

    The white plate is the same for every scene; the other sheets of the demo need distances that
    are relative, or a focal length.
    """

    def draw_own_terms(scene: Scene) -> "Figure":
        return draw_terms(scene, water_case(case, scene) if isinstance(case, Water) else case)

    return {"1-waters.jpg": draw_contact_sheet, "2-terms.jpg": draw_own_terms}


def _shape(scene: Scene) -> tuple[int, int]:
    return scene.image.shape[-2], scene.image.shape[-1]


def _picture(
    scene: Scene,
    medium: Medium,
    development: Development,
    z: Tensor | None = None,
    color_space: ColorSpace = "srgb",
) -> Tensor:
    """A scene in a medium; in several Bx3xHxW."""
    degrade = Underwater(medium, None, color_space=color_space, development=development)
    return degrade(scene.image, scene.distance if z is None else z)


def _terms(scene: Scene, z: Tensor, case: Case) -> list[Tensor]:
    """The three terms, exposed as their sum is, and encoded."""
    J = decoded(scene.image, case.color_space)
    gain = case.development.gain(J[None], z[None].clamp(max=1e9), case.medium.to(J))
    terms = (exposed(term[None], gain)[0] for term in form_image(J, z, case.medium))
    return [linear_to_srgb(t) if case.color_space == "srgb" else t for t in terms]


def _of_white(curve: Tensor) -> Tensor:
    """What white shows of curves (Bx3xN), or of matrices (Bx3x3xN)."""
    return curve if curve.ndim == 3 else curve.sum(2)


def _noted(caption: str, scene: Scene) -> str:
    return f"{caption}\n{scene.note}" if scene.note else caption
