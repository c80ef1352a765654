"""A picture with distances: the bundled one, or one's own."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from uwaug._support import checks
from uwaug.distance import along_ray, fill_unknown, from_disparity
from uwaug.formation.colour import decoded, linear_to_srgb, require_values

_PIXELS = 500_000
"""What a sheet shows of a picture: twice as wide as its cells, and enough for one across all."""

_LONGEST = 10
"""Sides: a longer picture leaves no room in its cell."""

_FOCAL_PX = 994.978


@dataclass(frozen=True)
class Scene:
    """A picture with distances.

    Attributes:
        image (3xHxW tensor): sRGB, 0…1.
        distance (1xHxW tensor): along the ray, m.
        focal_px: focal length, px; None if it is not known.
        note: what was done to the files to get here, for captions.
    """

    image: Tensor
    distance: Tensor
    focal_px: float | None = None
    note: str = ""


def motorcycle() -> Scene:
    """The motorcycle of the Middlebury 2014 stereo benchmark (Scharstein et al.), as scikit-image's
    wheel holds it: 500×741 px, 2 to 5 m.

    The 7 % of its pixels without disparity are filled by `uwaug.distance.fill_unknown`.
    """
    image, depth = motorcycle_depth()
    # the benchmark counts pixels from the centre of the first
    distance = along_ray(depth, _FOCAL_PX, centre=(311.193 + 0.5, 254.877 + 0.5))
    return Scene(image, distance, _FOCAL_PX)


def motorcycle_depth() -> tuple[Tensor, Tensor]:
    """The motorcycle's picture (3xHxW, sRGB), and its depth along the optical axis (1xHxW, m)."""
    from skimage.data import stereo_motorcycle

    picture, _, disparity = stereo_motorcycle()
    pixels = torch.from_numpy(disparity)[None]
    depth = from_disparity(pixels, _FOCAL_PX, baseline_m=0.193001, offset_px=31.086)
    return torch.from_numpy(picture).permute(2, 0, 1) / 255, fill_unknown(depth)


def own_scene(image: Tensor, distance: Tensor, most: int = _PIXELS) -> Scene:
    """A picture with its distances, as large as a sheet shows it.

    The picture is reduced in linear light. Of the distances each keeps one of its own pixels, as a
    mean across an edge would be the distance of nothing.

    Args:
        image (3xHxW tensor): sRGB; uint8, or floating point 0…1.
        distance (1xHxW tensor): along the ray, m, ≥ 0; +inf is open water.
        most: pixels; by default those of a sheet.

    Raises:
        ValueError: if the sizes differ, the picture is more than ten times as long as wide, or
            image or distance holds other values.
    """
    checks.same_size("distance", distance, image)
    height, width = image.shape[-2:]
    if max(height, width) > _LONGEST * min(height, width):
        expected = f"at most {_LONGEST} times as long as wide"
        raise ValueError(f"image must be {expected}, got {width}×{height} px: crop it")
    require_values(image, "srgb")
    checks.distances("distance", distance)
    light = decoded(image, "srgb")
    shrink, note = (most / (height * width)) ** 0.5, ""
    if shrink < 1:
        size = (max(1, round(height * shrink)), max(1, round(width * shrink)))
        light = interpolate(light[None], size, mode="area")[0]
        distance = interpolate(distance[None], size, mode="nearest-exact")[0]
        note = f"Drawn at {size[1]}×{size[0]} of {width}×{height} px."
    return Scene(linear_to_srgb(light), distance, note=note)
