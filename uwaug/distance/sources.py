"""Sources of distances, for `RandomUnderwater(distance=…)`: the meaning of maps, or no maps."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args

import torch
from torch import Tensor

from uwaug._support import checks, codec
from uwaug._support.nouns import Drawn, Noun, number
from uwaug._support.once import Once
from uwaug._support.ranges import Range, as_range
from uwaug.distance.convert import along_ray, as_maps, from_inverse, from_relative
from uwaug.distance.fill import fill_unknown
from uwaug.distance.unknown import (
    FARTHEST_SEEN,
    NO_RANGE,
    in_words,
    of_metres,
    of_shares,
    range_end,
    scattered,
)

_Policy = Literal["error", "fill", "behind", "far"]
Holes = _Policy | float
"""Pixels without a distance: an error; filled from around, or from behind, for depth cameras (see
`fill_unknown`); open water; or a number of metres.
"""

NEAR_LEFT, FAR_LEFT = (0.25, 0.65), (0.005, 0.05)
"""Shares of contrast that a water leaves at the ends of a scene that is placed in it."""

_NEAREST_M = 0.1, 2.5  # between which the near end is placed: one stands where one can see
_FARTHEST_M = 50.0
_LEAST_RATIO = 2.0  # of far to near
LEAST_NEAR_M = 1e-6  # that relative distance 0 gets with near = 0: a distance of 0 means unknown
_stand_in_warning = Once()


class Source(Noun):
    """Source of a picture's distances. A subclass is a frozen dataclass."""

    reads_maps: ClassVar[bool] = True  # of which each picture brings one
    reads_pictures: ClassVar[bool] = False  # as sRGB; else their size and type alone count
    has_size = True  # scenes are as large as they are, whatever the water

    def reach(self) -> tuple[float, float] | None:
        """Nearest and farthest distance (m) of all pictures; None where they follow from maps, or
        from the water.
        """
        return None

    def placed(
        self, drawn: Drawn, metres_for: Callable[[float], float], farthest: float = math.inf
    ) -> dict[str, Any]:
        """The draw of a picture in its water, which leaves shares of contrast at so many metres; at
        most `farthest` m large.
        """
        return dict(drawn)

    def metres(self, distance: Tensor | None, image: Tensor, drawn: Drawn, **view: Any) -> Tensor:
        """Compute the distances of a picture: metres above 0, or +inf for open water.

        Args:
            distance (1xhxw tensor): the map, of the picture's aspect, if the source reads maps.
            image (3xHxW tensor): the picture; uint8, or floating point in 0…1.
            drawn: numbers that the picture has drawn, by name.
            view: focal_px (px of the picture), which planar maps need; and center, the pixel (x, y)
                of the optical axis, or None for the middle.

        Returns:
            1xhxw, of the map's size or the picture's. ValueError where a map holds something else.
        """
        raise NotImplementedError


@codec.plain
@dataclass(frozen=True)
class Metres(Source):
    """Maps of metres along the ray, or of planar depth.

    Attributes:
        holes: treatment of NaN, 0 and negative distances, see `Holes`; of +inf that is scattered
            among near pixels; and of the largest number of a type, such as 65.535. With "error" all
            from 100 m on is open water, as is 1e7 m; what is nearer stays, with a warning.
        planar: maps hold depth along the optical axis, as depth cameras and renderers write it.
    """

    holes: Holes = "error"
    planar: bool = False

    def __post_init__(self) -> None:
        _require_holes(self.holes)
        if self.planar not in (True, False):
            raise ValueError(f"planar must be true or false, got {self.planar!r}")

    def metres(self, distance: Tensor | None, image: Tensor, drawn: Drawn, **view: Any) -> Tensor:
        assert distance is not None
        z = as_maps("distance", distance)
        checks.metres("distance", z)
        if z.numel() and not float(z.detach().amax()) <= FARTHEST_SEEN:  # or NaN
            z = torch.where(z >= checks.OPEN, torch.inf, z)
            stand_in = of_metres(z)
            if self.holes != "error":
                z = torch.where(stand_in | scattered(z), torch.nan, z)
            elif bool((stand_in & (z < NO_RANGE)).any()):
                _stand_in_warning.warn(f"distance: {in_words(z, stand_in)}")
            else:
                z = torch.where(stand_in, torch.inf, z)
            z = torch.where(range_end(z), torch.inf, z)
        if self.planar:
            focal_px: Any = view.get("focal_px")
            if focal_px is None:
                raise ValueError(
                    "planar maps need the camera's view: give view= (--view, --focal-px)"
                )
            checks.positive("focal_px", focal_px, "px")
            (h, w), (height, width) = z.shape[-2:], image.shape[-2:]
            x, y = view.get("center") or (width / 2, height / 2)
            focal = focal_px * w / width, focal_px * h / height
            z = along_ray(z, focal, (x * w / width, y * h / height))
        return _without_holes(z, self.holes)


@dataclass(frozen=True)
class Placed(Source):
    """Source whose scenes have a shape, but no size of their own: murky water has small scenes, and
    clear water large ones.

    Attributes:
        near, far: ends of the scene, m; numbers or (low, high). None: where the water leaves .25
            to .65 of the contrast, from .1 to 2.5 m; and .005 to .05.
    """

    near: Range | None = number(None, 0.0)
    far: Range | None = number(None, 0.0)

    def ranges(self) -> dict[str, Range | None]:
        """See `Noun.ranges`; of an end that is None, the share of contrast that is left there."""
        lefts = (("near_left", self.near, NEAR_LEFT), ("far_left", self.far, FAR_LEFT))
        return {**super().ranges(), **{name: left for name, end, left in lefts if end is None}}

    def reach(self) -> tuple[float, float] | None:
        return (self._ends["near"][0], self._ends["far"][1]) if self.has_size else None

    @property
    def has_size(self) -> bool:  # type: ignore[override]
        return self.near is not None and self.far is not None

    def placed(
        self, drawn: Drawn, metres_for: Callable[[float], float], farthest: float = math.inf
    ) -> dict[str, Any]:
        if self.has_size:
            return dict(drawn)
        near, far = drawn.get("near"), drawn.get("far")
        farthest = min(max(farthest, _LEAST_RATIO * _NEAREST_M[0]), _FARTHEST_M)
        if near is None:
            nearest = min(_NEAREST_M[1], (far or farthest) / _LEAST_RATIO)
            near = min(max(metres_for(drawn["near_left"]), _NEAREST_M[0]), nearest)
        if far is None:
            far = max(min(metres_for(drawn["far_left"]), farthest), _LEAST_RATIO * near)
        return {**drawn, "near": near, "far": far}


@codec.plain
@dataclass(frozen=True)
class Relative(Placed):
    """Maps of relative distance, 0 = near, 1 = far: near + (far − near)·t^gamma.

    Attributes:
        near, far: see `Placed`.
        gamma: exponent; a number or (low, high).
        holes: treatment of NaN and of numbers alone such as −1, see `Holes`; "error" only warns of
            0, which may be near. Let geometric transforms pad with NaN.
    """

    gamma: Range = number(1.0, 1e-3)
    holes: Holes = "error"

    def __post_init__(self) -> None:
        require_ends(self.near, self.far)
        as_range("gamma", self.gamma, 1e-3)
        _require_holes(self.holes)

    def metres(self, distance: Tensor | None, image: Tensor, drawn: Drawn, **view: Any) -> Tensor:
        t, near = _without_stand_ins(distance, self.holes), max(drawn["near"], LEAST_NEAR_M)
        return _without_holes(from_relative(t, near, drawn["far"], drawn["gamma"]), self.holes)


@codec.plain
@dataclass(frozen=True)
class Inverse(Placed):
    """Maps of inverse depth as monocular networks give it: large = near, of unknown scale and
    shift. Every map is stretched to reach from near to far, even that of a flat scene.

    Attributes:
        near, far: see `Placed`; near above 0.
        holes: treatment of NaN, infinity and numbers alone, see `Holes`; "error" only warns of 0,
            which may be the sky.
    """

    holes: Holes = "error"

    def __post_init__(self) -> None:
        require_ends(self.near, self.far, LEAST_NEAR_M)
        _require_holes(self.holes)

    def metres(self, distance: Tensor | None, image: Tensor, drawn: Drawn, **view: Any) -> Tensor:
        inverse = _without_stand_ins(distance, self.holes)
        return _without_holes(from_inverse(inverse, drawn["near"], drawn["far"]), self.holes)


@codec.plain
@dataclass(frozen=True)
class Plane(Source):
    """Plane that faces the camera, in place of maps: one veil, cast and blur for each picture.
    Elsewhere than in a flat scene, a network may learn only the tint.

    Attributes:
        distance: m; a number or (low, high).
    """

    reads_maps = False

    distance: Range = number(1.0, 0.0)

    def __post_init__(self) -> None:
        as_range("distance", self.distance, 0.0, unit="m")

    def reach(self) -> tuple[float, float]:
        low, high, _ = self._ends["distance"]
        return low, high

    def metres(self, distance: Tensor | None, image: Tensor, drawn: Drawn, **view: Any) -> Tensor:
        dtype = torch.promote_types(image.dtype, torch.float32)
        return image.new_full((1, *image.shape[-2:]), drawn["distance"], dtype=dtype)


def _require_holes(holes: object) -> None:
    if isinstance(holes, (int, float)) and not isinstance(holes, bool):
        checks.positive("holes", holes, "m")
    else:
        checks.one_of("holes", holes, (*get_args(_Policy), "a number of metres"))


def require_ends(near: Range | None, far: Range | None, least: float = 0.0) -> None:
    """Refuse ranges of near and far that meet, and a near end below the least."""
    nearest = 0.0 if near is None else as_range("near", near, least, unit="m")[1]
    if far is not None and not nearest < as_range("far", far, 0.0, unit="m")[0]:
        raise ValueError(f"near must lie below far, got near = {near} and far = {far} in metres")


def _without_stand_ins(distance: Tensor | None, holes: Holes) -> Tensor:
    assert distance is not None
    x = as_maps("distance", distance)
    alone = of_shares(x)
    if not bool(alone.any()):
        return x
    if holes != "error":
        return torch.where(alone, torch.nan, x)
    sentence = f"distance: {in_words(x, alone)}"
    if bool((x[alone] != 0).any()):
        raise ValueError(sentence)
    _stand_in_warning.warn(sentence)
    return x


def _without_holes(z: Tensor, holes: Holes) -> Tensor:
    if not isinstance(holes, str):
        return torch.where(z > 0, z, holes)
    if holes == "far":
        return torch.where(z > 0, z, torch.inf)
    if holes != "error":
        return fill_unknown(z, behind=holes == "behind")
    # the least is NaN if any is; a mask of all pixels takes several times as long
    if z.numel() and not z.detach().amin() > 0:
        counts = checks.counted(z, "NaN", "negative", "zero")
        cure = "give holes='behind' (--holes behind, for depth cameras), fill, far or metres"
        raise ValueError(f"distance must be above 0 m, but is {counts}: {cure}")
    return z
