"""Sheets that show the model on a scene, the demo's or the user's: a function each."""

import io
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from uwaug._support.checks import extent
from uwaug.figures.sheet import LESS_TO_MORE, Cell, coloured, sheet
from uwaug.formation.colour import decoded, linear_to_srgb
from uwaug.formation.development import Development, exposed
from uwaug.formation.field import gaussian_random_field
from uwaug.formation.image import form_image
from uwaug.formation.underwater import Underwater
from uwaug.optics.jerlov import JERLOV_TYPES
from uwaug.optics.medium import Medium
from uwaug.optics.water import Water
from uwaug.presets.scene import Scene
from uwaug.transforms.random_underwater import RandomUnderwater

_DEPTH_M = 5.0  # below the surface, of scenes in waters

SETTING = (
    f"Scene {_DEPTH_M:g} m deep, surfaces with spectra, a camera with its colour matrix and an "
    "automatic exposure"
)
"""Caption for pictures of `in_waters`."""

_CURVES_IN = 3.2, 2.16
"""Width and height of the curves, inches, at twice the pixels of a cell."""


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
    module = Underwater.of(only.setting, None)
    setting = f"Preset {name}: {only.medium.notes[0]}"
    return Case(f"preset {name}", setting, module, preset.water.field or (1.0, 1.0))


def in_waters(waters: Sequence[Water], scene: Scene) -> Underwater:
    """Make a module of waters, 5 m deep, with spectral surfaces and the calibrated width law."""
    media = Medium.stack(
        Medium.from_water(water, vertical_depth=_DEPTH_M, surfaces="spectral") for water in waters
    )
    return Underwater(
        media, None, development=Development(metered=True, gamut=1.0), view=scene.view
    )


def sheet_of(scene: Scene, cells: Sequence[Cell], heading: str, caption: str) -> Image.Image:
    """Draw pictures of a scene, four side by side, or two panoramas."""
    height, width = scene.image.shape[-2:]
    columns, size = (2, 652) if width > 3 * height else (4, 320)
    rows = [cells[i : i + columns] for i in range(0, len(cells), columns)]
    return sheet(rows, (size, size), heading, f"{caption}\n{scene.note}")


def draw_waters(scene: Scene) -> Image.Image:
    """Draw the scene in the ten Jerlov types."""
    waters = [Water.jerlov(name) for name in JERLOV_TYPES]
    cells = [(scene.image, "No water"), _distance(scene.distance)]
    pictures = in_waters(waters, scene)(scene.image, scene.distance)
    for water, picture in zip(waters, pictures, strict=True):
        cells.append((picture, f"{water.name}   (visibility {water.visibility():.2g} m)"))
    caption = f"Jerlov types over the scene's distances. {SETTING}."
    return sheet_of(scene, cells, "One scene in ten waters", caption)


def draw_terms(scene: Scene, case: Case) -> Image.Image:
    """Draw every term of the model."""
    module, medium = case.module, case.module.medium
    linear = module.color_space == "linear"
    light = "of sRGB values taken for light" if linear else "added in linear light"
    caption = f"I = D + F + B, {light}. All pictures at one exposure."
    if module.development.gamut > 0:
        caption += " Colours out of sRGB are clipped in terms, and compressed in I."
    rng, (low, high) = torch.Generator().manual_seed(4), case.field_range
    size = (scene.image.shape[-2], scene.image.shape[-1])
    field = gaussian_random_field(size, low=low, high=high, generator=rng)[0]
    z, farthest = scene.distance * field, extent(scene.distance[scene.distance.isfinite()])[1]
    J = decoded(scene.image, module.color_space)
    gain = module.development.gain(J[None], z[None].clamp(max=1e9), medium.to(J))
    terms = [exposed(term[None], gain)[0] for term in form_image(J, z, medium, view=module.view)]
    direct, forward, backscatter = terms if linear else map(linear_to_srgb, terms)
    span = f"{low:g} (blue) to {high:g} (red)" if low < high else f"{low:g} everywhere"
    cells = [
        (scene.image, "J   scene without water"),
        _distance(scene.distance),
        (coloured(field, (low, max(high, low + 1e-3)), LESS_TO_MORE), f"m   medium field, {span}"),
        (_curves(medium, 1.5 * farthest), "Curves of red, green and blue"),
        (direct, "D   direct"),
        (forward, "F   forward scatter"),
        (backscatter, "B   backscatter"),
        (module(scene.image, z), "I   image"),
    ]
    heading = f"The terms of the image, {case.name}"
    return sheet_of(scene, cells, heading, f"{caption}\n{case.setting}.")


def _distance(z: Tensor) -> Cell:
    near, far = extent(z[z.isfinite()])
    beyond = "" if bool(z.isfinite().all()) else ", open water"
    words = f"z   {near:.3g} m (yellow) to {far:.3g} m{beyond} (violet)"
    return coloured(z, (near, max(far, near + 1e-3))), words


def _curves(medium: Medium, farthest: float) -> Tensor:
    from matplotlib.figure import Figure

    from uwaug.fitting.plot import draw_curves

    figure = Figure(_CURVES_IN, dpi=200, layout="constrained")
    draw_curves(figure.subplots(), medium, farthest)
    png = io.BytesIO()
    figure.savefig(png)
    return torch.from_numpy(np.array(Image.open(png).convert("RGB"))).permute(2, 0, 1)
