"""A picture in the water that was drawn for it, before it is formed."""

import math
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from torch import Tensor

from uwaug._support.deterministic import reproducible
from uwaug._support.tiles import RowSource, row_bands
from uwaug.formation.contrast import faintness
from uwaug.formation.engine import recorded_engine
from uwaug.formation.exposure import GAINS, metering_points
from uwaug.formation.scene import Scene
from uwaug.optics.camera import Camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.surfaces import Surfaces
from uwaug.optics.water import CONTRAST_THRESHOLD, Water, load_water
from uwaug.transforms.params import Params

_DIMMEST = 2 / GAINS[1]
"""Share of the surface's light that a scene has at least, where an exposure is automatic: what the
largest gain makes up for, and an octave for what is lost on the way to the camera. Waters that are
turbid enough for a scene at arm's length are black at 10 m.
"""

_LOOKS = 16
"""Pictures of a process that are looked at for whether anything is left to see: each takes a
millisecond or two, and what is wrong with all of them shows in the first.
"""

_looked: list[str | None] = []
"""What there was to say of them."""


@dataclass(frozen=True, eq=False)
class InWater:
    """A picture in its water, and what a draw came to on it.

    Attributes:
        scene: forms the picture.
        params: what was drawn.
        water: with its contents.
        contents: factor on all that is in it besides pure water.
        vertical_depth: m, no deeper than an automatic exposure can make up for.
    """

    scene: Scene
    params: Params
    water: Water
    contents: float
    vertical_depth: float

    def resolved(self) -> Params:
        """The params with what they came to, and with what really computes the picture."""
        used = {
            "contents": self.contents,
            "visibility": self.water.visibility(),
            "vertical_depth": self.vertical_depth,
            "gain": float(self.scene.gain),
        }
        return replace(self.params, used=used, path=recorded_engine(self.scene.engine))

    def picture(self) -> Tensor:
        """The picture; with a warning, once in a process, if next to nothing is left to see."""
        if len(_looked) < _LOOKS:
            contrast, is_surface = self.scene.contrast_at_points()
            shares = contrast[is_surface]
            # by the median: the far end of a scene is hidden in many a good draw
            faint = faintness(shares.median()[None]) if shares.numel() else None
            _looked.extend([faint] * (1 if faint is None else _LOOKS))
            if faint is not None:
                near, sight = _median(self.scene.z), self.water.visibility()
                got = f"the median distance is {near:.3g} m, the visibility {sight:.3g} m"
                cure = "are distances metres? If so, take clearer water by visibility or contrast"
                warnings.warn(f"{faint}: {got}: {cure}", UserWarning, stacklevel=2)
        return self.scene.picture()


@contextmanager
def deterministic(image: Tensor) -> Iterator[None]:
    """Where a picture is degraded: without gradients, and bit for bit the same each time."""
    with reproducible(), torch.no_grad(), torch.autocast(image.device.type, enabled=False):
        yield


def water_of(
    waters: Mapping[str, Water], params: Params, z: Tensor | RowSource
) -> tuple[Water, float]:
    """The water of a picture with these distances, and the factor on what is in it.

    Args:
        waters: by name; others are named by their contents.
        params: of the picture.
        z: its distances, m.
    """
    drawn = [waters[name] if name in waters else load_water(name) for name in params.waters]
    numbers, used = params.numbers, params.used
    water = drawn[0].mix(drawn[1], numbers["mixing"]) if len(drawn) > 1 else drawn[0]
    if used is not None:
        contents = used["contents"]
    elif "visibility" in numbers:
        contents = water.contents_for(CONTRAST_THRESHOLD, numbers["visibility"])
    elif "contrast" in numbers:
        metres = _median(z)
        contents = water.contents_for(numbers["contrast"], metres)
        if math.isinf(contents):
            wanted = f"contrast={numbers['contrast']:.3g} is out of reach of water {water.name!r}"
            most = f"{water.most_contrast(metres):.2g} at {metres:.3g} m, the median distance"
            cure = "draw from waters that have something in them, or give contrast=None"
            raise ValueError(
                f"{wanted}: pure water leaves {most}, and to the eye it is that: {cure}"
            )
    else:
        return water, 1.0
    return water.with_contents(contents), contents


def _median(z: Tensor | RowSource) -> float:
    """The median distance at some pixels, m; at all, if these show nothing but open water."""
    points = metering_points(z.shape[-2], z.shape[-1], z.device)
    some = z.flatten()[points] if isinstance(z, Tensor) else z.at(points)
    finite = some.isfinite()
    # to pick them takes longer than the median itself
    near = some if bool(finite.all()) else some[finite]
    if not near.numel():
        rows = [z] if isinstance(z, Tensor) else (z.rows(*band) for band in row_bands(*z.size))
        near = torch.cat([part[part.isfinite()] for part in rows])
    return float(near.median()) if near.numel() else math.inf


def lit_depth(water: Water, metres: float) -> float:
    """A vertical depth, or that where the light is dimmest if it is deeper."""
    if water.daylight(metres) >= _DIMMEST:
        return metres
    return min(metres, water.depth_of_daylight(_DIMMEST))


def new_medium(
    water: Water,
    camera: Camera,
    numbers: tuple[float, float, float],
    law: PointSpread,
    tolerance: float,
    surfaces: Surfaces,
    color_matrix: float,
) -> Medium:
    """The medium of a water at a vertical depth, with g and mu."""
    depth, g, mu = numbers
    return Medium.from_water(
        water,
        camera,
        vertical_depth=depth,
        g=g,
        mu=mu,
        point_spread=law,
        tolerance=tolerance,
        surfaces=surfaces,
        color_matrix=color_matrix,
    )


kept_medium = lru_cache(maxsize=64)(new_medium)
"""Nine waters, or pairs of them, seen by a few cameras. Media that come once are not kept: they
would lie between the pictures in memory, so that the heap could not shrink.
"""
