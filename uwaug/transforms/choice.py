"""What a picture is degraded with: waters, a camera, what was drawn, what is set."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

from uwaug._support.types import ColorSpace, Order
from uwaug.distance.sample import DistanceKind, Scaling, Unknown
from uwaug.formation.loops.switch import Path
from uwaug.light import Light
from uwaug.light.geometry import focal_of
from uwaug.optics.camera import Camera
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water

__all__ = ["Choice", "Draw", "Settings"]


class Draw(NamedTuple):
    """What is drawn for a picture, besides its waters and its camera; see `RandomUnderwater`.

    NaN: not drawn, as nothing asks for it.
    """

    mixing: float
    visibility: float
    vertical_depth: float
    g: float
    mu: float
    blur_factor: float
    near: float
    far: float
    gamma: float
    distance: float
    contrast: float
    exposure: float
    contents: float
    gain: float
    field_seed: float
    field_low: float
    field_high: float
    light: float
    fused: float

    @property
    def scaling(self) -> Scaling:
        """What scales a relative map."""
        return Scaling(self.near, self.far, self.gamma)

    @property
    def path(self) -> Path | None:
        """What has made the picture, if it is known; see `uwaug.fused`."""
        if math.isnan(self.fused):
            return None
        return "fused" if self.fused else "eager"

    @staticmethod
    def of(sample: Mapping[str, Any]) -> "Draw":
        """From a sample of a record."""
        low, high = sample["field_range"]
        drawn = {**sample, "field_low": low, "field_high": high}
        for name in ("contents", "gain"):
            drawn[name] = sample.get("used", {}).get(name)
        if "path" in sample:
            drawn["fused"] = float(sample["path"] == "fused")
        values = []
        for name in Draw._fields:
            value = drawn.get(name)
            values.append(math.nan if value is None else value)
        return Draw(*values)


@dataclass(frozen=True)
class Settings:
    """What is the same for all pictures. See `RandomUnderwater`."""

    distance_kind: DistanceKind
    unknown: Unknown
    color_space: ColorSpace
    order: Order
    point_spread: PointSpread | None
    focal_px: float | None
    exposure: Literal["none", "auto", "drawn"]
    tolerance: float
    varied: bool
    """Whether each picture has a medium of its own, so that none need be kept."""
    lights: str = ""
    """JSON of the lights that are drawn from (`Light.to_list`); none for daylight alone."""

    def law(self, width: int) -> PointSpread:
        """The width law for a picture of `width` px."""
        if self.point_spread is not None:
            return self.point_spread
        return PointSpread.calibrated(self.focal(width))

    def focal(self, width: int) -> float:
        """Focal length for a picture of `width` px, px."""
        return focal_of(self.focal_px, width)

    def light(self, draw: Draw) -> Light | None:
        """The light of a draw; None for daylight alone."""
        return None if math.isnan(draw.light) else lights_of(self.lights)[int(draw.light)]


@lru_cache(maxsize=16)
def lights_of(text: str) -> tuple[Light, ...]:
    """The lights of `Settings.lights`."""
    return tuple(Light.from_list(numbers) for numbers in json.loads(text))


class Choice(NamedTuple):
    """What a picture is degraded with.

    Attributes:
        waters: one, or two to be mixed.
        camera: response of the three channels.
        draw: what was drawn.
        settings: what is set.
    """

    waters: Sequence[Water]
    camera: Camera
    draw: Draw
    settings: Settings
