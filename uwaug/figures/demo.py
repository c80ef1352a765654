"""What the model does to a scene, the demo's or one's own. Each function draws a sheet."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from uwaug._support.checks import extent
from uwaug._support.drawing import GREY, INK, RGB
from uwaug.distance.convert import from_relative
from uwaug.figures.sheet import (
    HEADER,
    MARGIN,
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
from uwaug.formation.colour import linear_to_srgb
from uwaug.formation.demand import blur_demand
from uwaug.formation.development import NEUTRAL, Development
from uwaug.formation.field import gaussian_random_field
from uwaug.formation.scene import Scene as InWater
from uwaug.formation.setup import Setup
from uwaug.light.geometry import focal_of
from uwaug.light.lit import planning_medium
from uwaug.optics.curves import of_white
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
"""In words, what `_taken` does."""

_COAST = "1C"
_EVEN = f"{SETTING}, homogeneous, one exposure"

_HALF = {"gaussian": math.sqrt(2 * math.log(2)), "exponential": math.sqrt(3)}
"""Radius that holds half of the light, in σ."""


class Case(NamedTuple):
    """What the terms are drawn in.

    Attributes:
        name, setting: of the water, and how the scene lies in it, for heading and caption.
        setup: its medium, a batch of one, and what the picture is taken with.
        field_range: least and largest value of the medium field.
    """

    name: str
    setting: str
    setup: Setup
    field_range: tuple[float, float]


def water_case(water: Water, scene: Scene, field_range: tuple[float, float] = (1.0, 1.0)) -> Case:
    """A scene in a water, as the sheet of ten waters has it."""
    name = f"Jerlov {water.name}" if water.name in JERLOV_TYPES else water.name
    return Case(name, _CAMERA, _taken([water], scene), field_range)


def _taken(waters: Sequence[Water], scene: Scene) -> Setup:
    """What a scene is taken with in each of several waters: spectra, a colour matrix, an automatic
    exposure, and the calibrated width law.
    """
    constants = Scattering.CALIBRATED
    law = PointSpread.calibrated(focal_of(scene.focal_px, _shape(scene)[1]))
    media = [
        Medium.from_water(
            water,
            vertical_depth=_DEPTH,
            g=constants.g,
            mu=constants.mu,
            point_spread=law,
            surfaces="spectral",
        )
        for water in waters
    ]
    camera = Development(gamut=1.0)
    return Setup(Medium.stack(media), exposure="auto", development=camera, focal_px=scene.focal_px)


def preset_case(preset: Preset) -> Case:
    """What a preset comes to."""
    name, setting = f"preset {preset.name}", f"Scene {preset.vertical_depth:g} m deep"
    if preset.spectral is None:
        setting += ", coefficients of red, green and blue"
    else:
        name += f", {preset.spectral['waters'].name}"
        setting += f", g = {preset.spectral['g']:g}, μ = {preset.spectral['mu']:g}"
        if preset.spectral["surfaces"] == "spectral":
            setting += ", surfaces with spectra"
    for key, value in preset.choices.items():
        setting += f", {key} = {value}"
    if preset.development != NEUTRAL:
        setting += ", developed"
    if preset.light is not None:
        setting += ", by its own light; the curves are those of daylight"
    return Case(name, setting, preset.setup(), preset.field_range)


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
    in_water = _in_water(scene, _taken(waters, scene))
    show(axes[0], scene.image, "No water")
    show_distance(axes[1], scene.distance)
    for axis, water, picture in zip(axes[2:], waters, in_water.picture(), strict=True):
        show(axis, picture, f"{water.name}   (visibility {water.visibility():.2g} m)")
    return figure


def draw_terms(scene: Scene, case: Case) -> "Figure":
    """Every term of the model."""
    setup = case.setup
    light = "added in linear light"
    if setup.color_space == "linear":
        light = "of sRGB values taken for light"
    exposure = f" ({setup.exposure})" if isinstance(setup.exposure, float) else ""
    caption = f"I = D + F + B, {light}. All pictures at one exposure{exposure}."
    if setup.development.gamut > 0:
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
    in_water = _in_water(scene, setup, scene.distance, field)
    terms, medium = in_water.term_pictures(), in_water.medium
    show(axes[0], scene.image, "J   scene without water")
    show_distance(axes[1], scene.distance)
    show_field(axes[2], field, case.field_range)
    show(axes[4], terms["direct"], "D   direct")
    show(axes[5], terms["forward"], "F   forward scatter")
    show(axes[6], terms["backscatter"], "B   backscatter")
    show(axes[7], in_water.picture(), "I   image")
    axis = plot(axes[3], "Curves of distance, red, green, blue", "z [m]", "")
    reach = round_up(1.5 * seen(scene.distance)[1])
    z = torch.linspace(0, reach, 201, dtype=torch.float64)
    row = z[None, None, None]  # a map, as `of_white` wants one
    for label, curve, style in (
        ("$T_β$  direct", of_white(medium.transmission(row)), "-"),
        ("$T_G$  direct + forward", of_white(medium.signal(row)), "--"),
        ("$B$  backscatter", medium.backscatter(row), ":"),
    ):
        for values, colour in zip(curve[0, :, 0], RGB, strict=True):
            axis.plot(z.numpy(), values.numpy(), style, color=colour, linewidth=1.6)
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
            in_water = _in_water(scene, Setup(Medium.from_water(name)), z)
            show(axes[3 * row + column], in_water.picture(), f"{name}, γ = {gamma:g}")
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
    calibrated = Medium.from_water(water, g=constants.g, mu=constants.mu, point_spread=law)
    height, width = _shape(scene)
    radius = plot(axes[6], "Half of the scattered light is within", "distance [m]", "radius [px]")
    z = torch.linspace(0.05, 8, 160, dtype=torch.float64)
    columns: list[tuple[str, Tensor]] = [("No water", scene.image)]
    for axis, label, medium, colour in (
        (axes[7], "Paper's law", paper, RGB[2]),
        (axes[8], "Calibrated law", calibrated, RGB[0]),
    ):
        in_water = _in_water(scene, Setup(medium))
        columns.append((label, in_water.picture()))
        forward = in_water.term_pictures()["forward"]
        show(axis, forward, f"{label}, forward scatter alone")
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


def own_pictures(case: Case | Water | None = None) -> "dict[str, Callable[[Scene], Figure]]":
    """The files that show a scene of one's own, and who draws them; the terms in a water, that of
    the demo if there is none, or in a case, such as that of a preset.

    The white plate is the same for every scene; the other sheets of the demo need distances that
    are relative, or a focal length.
    """
    drawn = Water.jerlov(_COAST) if case is None else case

    def draw_own_terms(scene: Scene) -> "Figure":
        if isinstance(drawn, Water):
            return draw_terms(scene, water_case(drawn, scene))
        setup = replace(drawn.setup, focal_px=scene.focal_px)
        return draw_terms(scene, drawn._replace(setup=setup))

    return {"1-waters.jpg": draw_contact_sheet, "2-terms.jpg": draw_own_terms}


def _shape(scene: Scene) -> tuple[int, int]:
    return scene.image.shape[-2], scene.image.shape[-1]


def _in_water(
    scene: Scene, setup: Setup, distance: Tensor | None = None, field: Tensor | None = None
) -> InWater:
    """A scene in a medium, in a view 60° wide if the setup does not say."""
    z = scene.distance if distance is None else distance
    setup = replace(setup, focal_px=focal_of(setup.focal_px, _shape(scene)[1]))
    demand = blur_demand(
        planning_medium(setup.medium, setup.light), extent(z if field is None else z * field)
    )
    return InWater.of(scene.image, z, setup, field, plan=demand.plan(_shape(scene)))


def _noted(caption: str, scene: Scene) -> str:
    return f"{caption}\n{scene.note}" if scene.note else caption
