"""Sheets that show the model on a scene, the demo's or the user's: a function each."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from uwaug._support.checks import extent
from uwaug.distance.convert import from_relative
from uwaug.figures.sheet import (
    INK,
    RGB,
    finite_extent,
    metres,
    plot,
    sheet,
    show,
    show_distance,
    show_field,
    show_map,
)
from uwaug.formation.colour import decoded, linear_to_srgb
from uwaug.formation.development import Development, exposed
from uwaug.formation.field import gaussian_random_field
from uwaug.formation.image import form_image
from uwaug.formation.underwater import Underwater
from uwaug.optics.jerlov import JERLOV_TYPES
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.scattering import Scattering
from uwaug.optics.water import Water
from uwaug.presets.scene import Scene
from uwaug.transforms.random_underwater import RandomUnderwater

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DEPTH_M = 5.0  # below the surface, of scenes in waters

SETTING = (
    f"Scene {_DEPTH_M:g} m deep, surfaces with spectra, a camera with its colour matrix and an "
    "automatic exposure"
)
"""Caption for pictures of `in_waters`."""

_COASTAL_TYPE = "1C"

# radius of half of the light, in σ
_HALF_LIGHT_RADIUS = {"gaussian": math.sqrt(2 * math.log(2)), "exponential": math.sqrt(3)}


class Case(NamedTuple):
    """Medium and camera in which the terms are drawn."""

    name: str  # of the water, for the heading
    setting: str  # place of the scene in it, for the caption
    module: Underwater
    field_range: tuple[float, float]  # of the medium field


def water_case(water: Water, scene: Scene, field_range: tuple[float, float] = (1.0, 1.0)) -> Case:
    """Make the case of a scene in a water, as on the sheet of ten waters."""
    name = f"Jerlov {water.name}" if water.name in JERLOV_TYPES else water.name
    return Case(name, SETTING, in_waters([water], scene), field_range)


def preset_case(name: str, preset: RandomUnderwater) -> Case:
    """Make the case of a preset without anything random, over the scene's distances."""
    only = preset.module()
    if only.light is not None:
        raise ValueError(f"{name}: sheets of terms are by daylight, but it has a light of its own")
    space, camera = only.color_space, only.development
    module = Underwater(only.medium, None, color_space=space, development=camera)
    setting = f"Preset {name}: {only.medium.notes[0]}"
    return Case(f"preset {name}", setting, module, preset.water.field or (1.0, 1.0))


def in_waters(waters: Sequence[Water], scene: Scene) -> Underwater:
    """Make a module of waters, 5 m deep, with spectral surfaces and the calibrated width law."""
    options: dict[str, Any] = {
        "vertical_depth": _DEPTH_M,
        "g": Scattering.CALIBRATED.g,
        "point_spread": PointSpread.calibrated(),
        "surfaces": "spectral",
    }
    media = Medium.stack(Medium.from_water(water, **options) for water in waters)
    return Underwater(media, None, development=Development("auto", gamut=1.0), view=scene.view)


def draw_contact_sheet(scene: Scene) -> "Figure":
    """Draw the scene in the ten Jerlov types."""
    waters = [Water.jerlov(name) for name in JERLOV_TYPES]
    beyond = "" if bool(scene.distance.isfinite().all()) else " and open water"
    caption = f"Jerlov types over the scene's distances, {metres(scene.distance)}{beyond}"
    figure, axes = sheet(scene, 12, "One scene in ten waters", f"{caption}. {SETTING}.")
    show(axes[0], scene.image, "No water")
    show_distance(axes[1], scene.distance)
    pictures = in_waters(waters, scene)(scene.image, scene.distance)
    for axis, water, picture in zip(axes[2:], waters, pictures, strict=True):
        show(axis, picture, f"{water.name}   (visibility {water.visibility():.2g} m)")
    return figure


def draw_terms(scene: Scene, case: Case) -> "Figure":
    """Draw every term of the model."""
    module, medium = case.module, case.module.medium
    linear = module.color_space == "linear"
    light = "of sRGB values taken for light" if linear else "added in linear light"
    caption = f"I = D + F + B, {light}. All pictures at one exposure."
    if module.development.gamut > 0:
        caption += " Colours out of sRGB are clipped in terms, and compressed in I."
    heading = f"The terms of the image, {case.name}"
    figure, axes = sheet(scene, 8, heading, f"{caption}\n{case.setting}.")
    rng, (low, high) = torch.Generator().manual_seed(4), case.field_range
    height, width = scene.image.shape[-2:]
    field = gaussian_random_field((height, width), low=low, high=high, generator=rng)[0]
    z = scene.distance * field
    J = decoded(scene.image, module.color_space)
    gain = module.development.gain(J[None], z[None].clamp(max=1e9), medium.to(J))
    terms = [exposed(term[None], gain)[0] for term in form_image(J, z, medium)]
    direct, forward, backscatter = terms if linear else map(linear_to_srgb, terms)
    show(axes[0], scene.image, "J   scene without water")
    show_distance(axes[1], scene.distance)
    show_field(axes[2], field, case.field_range)
    show(axes[4], direct, "D   direct")
    show(axes[5], forward, "F   forward scatter")
    show(axes[6], backscatter, "B   backscatter")
    show(axes[7], module(scene.image, z), "I   image")
    axis = plot(axes[3], "Curves of distance, red, green, blue", "z [m]", "")
    reach = 1.5 * finite_extent(scene.distance)[1]
    path = torch.linspace(0, reach, 201, dtype=torch.float64)
    for label, curve, style in (
        ("$T_β$  direct", _of_white(medium.transmission(path)), "-"),
        ("$T_G$  direct + forward", _of_white(medium.signal(path)), "--"),
        ("$B$  backscatter", medium.backscatter(path), ":"),
    ):
        for values, colour in zip(curve[0], RGB, strict=True):
            axis.plot(path.numpy(), values.numpy(), style, color=colour, linewidth=1.6)
        axis.plot([], [], style, color=INK, label=label)
    # a colour matrix may raise a channel above 1
    axis.set(xlim=(0, reach), ylim=(0, max(1, axis.dataLim.ymax)))
    axis.legend(fontsize=9.5, loc="upper right", framealpha=0.85, edgecolor="none", borderpad=0)
    return figure


def _of_white(curve: Tensor) -> Tensor:
    """Curves (Bx3xN) of white, from curves or from matrices (Bx3x3xN)."""
    return curve if curve.ndim == 3 else curve.sum(2)


def draw_depth_scaling(scene: Scene) -> "Figure":
    """Draw the paper's depth scaling: z from 0 to 20 m, γ = 1, 3, 6, in types II and 7C."""
    law = "z = 20 m · t^γ, where t = 0…1 is the relative distance"
    constants = f"g = {Scattering.PAPER.g:g}, μ = {Scattering.PAPER.mu:g}"
    caption = f"{law}. Scene 1 m deep, {constants}, homogeneous, one exposure."
    figure, axes = sheet(scene, 9, "Depth scaling", caption, columns=3)
    low, high = scene.distance.aminmax()
    t = (scene.distance - low) / (high - low)
    for column, gamma in enumerate((1.0, 3.0, 6.0)):
        z = from_relative(t, 0.0, 20.0, gamma)
        label = f"Distance z, γ = {gamma:g}"
        show_map(axes[column], z, label, "viridis_r", (0.0, 20.0), " m")
        for row, name in ((1, "II"), (2, "7C")):
            picture = Underwater(Medium.from_water(name), None)(scene.image, z)
            show(axes[3 * row + column], picture, f"{name}, γ = {gamma:g}")
    return figure


def draw_width_laws(scene: Scene) -> "Figure":
    """Draw the paper's width law beside the one calibrated to Monte Carlo light transport."""
    from matplotlib.patches import Rectangle

    height, width = scene.image.shape[-2:]
    constants, papers = Scattering.CALIBRATED, Scattering.PAPER
    caption = (
        f"Paper's: Gaussian, g = {papers.g:g}, μ = {papers.mu:g}. Calibrated to Monte Carlo light "
        f"transport: exponential, g = {constants.g:g}, μ = {constants.mu:g}, focal length "
        f"{scene.view.focal(width):.0f} px. Scene 1 m deep."
    )
    heading = f"Width laws of the forward scatter, Jerlov {_COASTAL_TYPE}"
    figure, axes = sheet(scene, 9, heading, caption, columns=3)
    law = PointSpread.calibrated()
    paper = Medium.from_water(_COASTAL_TYPE)
    calibrated = Medium.from_water(_COASTAL_TYPE, g=constants.g, point_spread=law)
    radius = plot(axes[6], "Half of the scattered light is within", "distance [m]", "radius [px]")
    z = torch.linspace(0.05, 8, 160, dtype=torch.float64)
    columns: list[tuple[str, Tensor]] = [("No water", scene.image)]
    laws = (axes[7], "Paper's law", paper, RGB[2]), (axes[8], "Calibrated law", calibrated, RGB[0])
    for axis, label, medium, colour in laws:
        picture = Underwater(medium, None, view=scene.view)(scene.image, scene.distance)
        columns.append((label, picture))
        light = decoded(scene.image, "srgb")
        forward = form_image(light, scene.distance, medium, view=scene.view).forward
        show(axis, linear_to_srgb(forward), f"{label}, forward scatter alone")
        sigma = medium.in_pixels((height, width), scene.view).width(z[None, None, None]).flatten()
        half = _HALF_LIGHT_RADIUS[medium.law.shape] * sigma
        radius.plot(z.numpy(), half.numpy(), color=colour, label=label, linewidth=2)
    low, high = extent(scene.distance)
    radius.axvspan(low, high, color="black", alpha=0.07, linewidth=0, label="this scene")
    radius.set(xlim=(0, 8), yscale="log", ylim=(0.01, 500))
    radius.legend(frameon=False, fontsize=10.5, loc="lower right", reverse=True)
    (y, x), (h, w) = (int(0.32 * height), int(0.50 * width)), (height // 4, width // 4)
    for full, part, (label, picture) in zip(axes[:3], axes[3:6], columns, strict=True):
        show(full, picture, label)
        full.add_patch(Rectangle((x, y), w, h, fill=False, edgecolor="white", linewidth=1.4))
        show(part, picture[:, y : y + h, x : x + w], f"{label}, enlarged")
    return figure


PICTURES: "dict[str, Callable[[Scene], Figure]]" = {
    "1-waters.jpg": draw_contact_sheet,
    "2-terms.jpg": lambda scene: draw_terms(
        scene, water_case(Water.jerlov(_COASTAL_TYPE), scene, (0.3, 1.7))
    ),
    "3-depth-scaling.jpg": draw_depth_scaling,
    "4-width-laws.jpg": draw_width_laws,
}
"""Files of the demo, and the functions that draw them."""


def own_pictures(case: Case) -> "dict[str, Callable[[Scene], Figure]]":
    """Files for a user's scene, and the functions that draw them: the demo's other sheets need
    relative distances or a focal length.
    """
    terms = partial(draw_terms, case=case)
    return {"1-waters.jpg": draw_contact_sheet, "2-terms.jpg": terms}
