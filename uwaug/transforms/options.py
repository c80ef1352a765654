"""What a `RandomUnderwater` is told, checked, and as what it draws from."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, get_args

from uwaug._support import checks
from uwaug._support.types import ColorSpace, Order
from uwaug.distance.sample import DistanceKind, as_unknown
from uwaug.light import Light
from uwaug.optics.jerlov import JERLOV_TYPES
from uwaug.optics.point_spread import PointSpread
from uwaug.transforms.draw import (
    RANGES,
    Distribution,
    Range,
    as_range,
    require_scaling,
    require_visibility,
)
from uwaug.transforms.prepare import Settings

if TYPE_CHECKING:
    from uwaug.transforms.random_underwater import RandomUnderwater

__all__ = [
    "CONTRAST",
    "GOOD_WATERS",
    "SURVEY",
    "check_options",
    "contrast_beside",
    "contrast_of",
    "distribution_of",
    "settings_of",
]

_SCALING = {"metric": (), "relative": ("near", "far", "gamma"), "inverse": ("near", "far")}
_CHOICES = {
    "distance_kind": get_args(DistanceKind),
    "color_space": get_args(ColorSpace),
    "order": get_args(Order),
}


GOOD_WATERS = ("II", "III", "1C", "3C", "5C", "7C", "9C")
"""The types that keep their look when their contents are scaled to a wanted contrast. The clear
oceanic types would need 11 to 66 times what is in them, and turn dark green.
"""

CONTRAST = (0.1, 0.6)
"""Less is fog in which little can be learnt, more is hardly water."""

_GRADES = (0.65, 0.5, 0.35, 0.2, 0.08)
"""Of the five grades of severity."""

SURVEY: dict[str, Any] = {
    "waters": JERLOV_TYPES[1:],
    "contrast": None,
    "vertical_depth": 1.0,
    "exposure": "none",
    "g": 0.2,
    "mu": 0.3,
    "point_spread": PointSpread.paper(),
}
"""The set of the paper's survey."""


_OF_MEDIUM = ("mixing", "visibility", "vertical_depth", "g", "mu", "blur_factor")
"""What makes a medium of waters and a camera."""


def contrast_of(level: int) -> float:
    """The contrast of a grade of severity."""
    if not isinstance(level, int) or level not in (1, 2, 3, 4, 5):
        raise ValueError(f"level must be a whole number from 1 to 5, got {level!r}")
    return _GRADES[level - 1]


def contrast_beside(visibility: Range | None, contrast: Range | None) -> Range | None:
    """The contrast to be drawn: none if a visibility is given, which takes the default's place."""
    if visibility is None:
        return contrast
    if contrast not in (None, CONTRAST):
        got = f"visibility = {visibility} and contrast = {contrast}"
        raise ValueError(f"visibility and contrast: give one of them, got {got}")
    return None


def check_options(aug: RandomUnderwater) -> None:
    """Refuse options that are unknown, out of range, or would do nothing."""
    for name, allowed in _CHOICES.items():
        checks.one_of(name, getattr(aug, name), allowed)
    for name in ("p", "field_probability"):
        checks.within(name, getattr(aug, name), 0.0, 1.0)
    checks.tolerance(aug.tolerance)
    if isinstance(aug.exposure, str):
        checks.one_of("exposure", aug.exposure, ("none", "auto"))
    if aug.point_spread is not None:
        checks.instance("point_spread", aug.point_spread, PointSpread)
    if aug.focal_px is not None:
        checks.positive("focal_px", aug.focal_px, "px")
        if aug.point_spread is not None and aug.light is None:
            given = "a point_spread takes the place of the calibrated law that it is for"
            raise ValueError(f"focal_px would do nothing: {given}, got {aug.focal_px}")
    lights_in(aug)
    defaults = inspect.signature(type(aug)).parameters
    for name in ("near", "far", "gamma"):
        value = getattr(aug, name)
        used = name in _SCALING[aug.distance_kind]
        if not used and value != defaults[name].default:
            kind = f"distance_kind is {aug.distance_kind!r}"
            raise ValueError(f"{name} would do nothing: {kind}, got {value}")


def lights_in(aug: RandomUnderwater) -> list[Light]:
    """The lights that are drawn from, checked."""
    if aug.light is None:
        return []
    lights = [aug.light] if isinstance(aug.light, Light) else list(aug.light)
    if not lights:
        raise ValueError("light: expected a Light or several to draw from, got none")
    for light in lights:
        checks.instance("light", light, Light)
        if light.rows() > 1:
            raise ValueError(f"light must be for one picture, got one for {light.rows()}")
    return lights


def distribution_of(aug: RandomUnderwater) -> Distribution:
    """What is random."""
    return Distribution(
        waters=dict(zip(aug.spectra, aug.waters.values(), strict=True)),
        cameras=tuple(aug.responses),
        ranges=_ranges(aug),
        field_range=as_range("field_range", aug.field_range),
        p=aug.p,
        field_probability=aug.field_probability,
        lights=len(lights_in(aug)),
    )


def settings_of(aug: RandomUnderwater, ranges: Mapping[str, tuple[float, float]]) -> Settings:
    """What is set, beside what is drawn from `ranges`."""
    exposure: Literal["none", "auto", "drawn"] = "drawn"
    if isinstance(aug.exposure, str):
        exposure = aug.exposure
    return Settings(
        distance_kind=aug.distance_kind,
        unknown=as_unknown(aug.unknown),
        color_space=aug.color_space,
        order=aug.order,
        point_spread=aug.point_spread,
        focal_px=aug.focal_px,
        exposure=exposure,
        tolerance=aug.tolerance,
        varied=_varies(ranges),
        lights=json.dumps([light.to_list() for light in lights_in(aug)]),
    )


def _varies(ranges: Mapping[str, tuple[float, float]]) -> bool:
    """Whether draws from these ranges make a new medium each time."""
    if "contrast" in ranges:  # which is a matter of the picture's distances
        return True
    return any(ranges[name][0] < ranges[name][1] for name in _OF_MEDIUM if name in ranges)


def _ranges(aug: RandomUnderwater) -> dict[str, tuple[float, float]]:
    """The ranges that are drawn from."""
    left_out = {"near", "far", "gamma"} - set(_SCALING[aug.distance_kind])
    for name in ("contrast", "visibility"):
        if getattr(aug, name) is None:
            left_out.add(name)
    if isinstance(aug.exposure, str):
        left_out.add("exposure")
    if aug.distance is None or callable(aug.distance):
        left_out.add("distance")
    ranges = {}
    for name in RANGES:
        if name not in left_out:
            ranges[name] = as_range(name, getattr(aug, name))
    if aug.distance_kind != "metric":
        require_scaling(ranges, aug.distance_kind)
    for water in aug.spectra.values():
        require_visibility(water, ranges)
    return ranges
