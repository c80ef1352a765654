"""Waters in which the terms of a picture are drawn."""

from typing import NamedTuple

from uwaug._support.types import ColorSpace
from uwaug.formation.exposure import Exposure
from uwaug.light.light import Light
from uwaug.optics.medium import Medium
from uwaug.optics.water import Water
from uwaug.presets.preset import Preset

__all__ = ["SETTING", "Case", "preset_case", "water_case"]

SETTING = "Scene 1 m deep, g = 0.2, μ = 0.3"
"""In words, the defaults of `uwaug.Medium.from_water`."""


class Case(NamedTuple):
    """What the terms are drawn in.

    Attributes:
        name, setting: of the water, and how the scene lies in it, for heading and caption.
        medium: a batch of one.
        field_range: least and largest value of the medium field.
        color_space, exposure, light: see `uwaug.Underwater`.
    """

    name: str
    setting: str
    medium: Medium
    field_range: tuple[float, float] = (0.3, 1.7)
    color_space: ColorSpace = "srgb"
    exposure: Exposure = "none"
    light: Light | None = None


def water_case(water: str) -> Case:
    """A Jerlov type with the defaults of `uwaug.Medium.from_water`.

    Raises:
        ValueError: if the type is unknown.
    """
    return Case(f"Jerlov {water}", SETTING, Medium.from_water(Water.jerlov(water)))


def preset_case(preset: Preset) -> Case:
    """What a preset comes to."""
    name, setting = f"preset {preset.name}", f"Scene {preset.vertical_depth:g} m deep"
    if preset.spectral is None:
        setting += ", coefficients of red, green and blue"
    else:
        name += f", {preset.spectral['waters'].name}"
        setting += f", g = {preset.spectral['g']:g}, μ = {preset.spectral['mu']:g}"
    for key, value in preset.choices.items():
        setting += f", {key} = {value}"
    if preset.light is not None:
        setting += ", by its own light; the curves are those of daylight"
    shown = preset.color_space, preset.exposure, preset.light
    return Case(name, setting, preset.medium, preset.field_range, *shown)
