"""Scenes, pictures with distances: the bundled one, or the user's."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from uwaug._support import checks
from uwaug.distance import along_ray, fill_unknown, from_disparity
from uwaug.formation.colour import decoded, linear_to_srgb, require_values
from uwaug.optics.view import WIDE, View

_SHEET_PIXELS = 500_000  # most of a picture on a sheet, enough for one across all cells
_LONGEST_SIDES = 10  # ratio of a picture's sides: a longer one leaves no room in its cell
_MOTORCYCLE_FOCAL_PX = 994.978


@dataclass(frozen=True)
class Scene:
    """Picture with distances."""

    image: Tensor  # 3xHxW, sRGB, 0…1
    distance: Tensor  # 1xHxW, along the ray, m
    view: View = WIDE
    note: str = ""  # changes to the original, for captions


def motorcycle() -> Scene:
    """Motorcycle of the Middlebury 2014 stereo benchmark (Scharstein et al.), from scikit-image:
    500×741 px, 2 to 5 m. `uwaug.distance.fill_unknown` fills the 7 % of pixels without disparity.
    """
    image, depth = motorcycle_depth()
    # the benchmark counts pixels from the centre of the first
    distance = along_ray(depth, _MOTORCYCLE_FOCAL_PX, centre=(311.193 + 0.5, 254.877 + 0.5))
    return Scene(image, distance, View(focal_px=_MOTORCYCLE_FOCAL_PX))


def motorcycle_depth() -> tuple[Tensor, Tensor]:
    """Picture (3xHxW, sRGB) of the motorcycle, and its depth along the optical axis (1xHxW, m)."""
    from skimage.data import stereo_motorcycle

    picture, _, disparity = stereo_motorcycle()
    pixels = torch.from_numpy(disparity)[None]
    depth = from_disparity(pixels, _MOTORCYCLE_FOCAL_PX, baseline_m=0.193001, offset_px=31.086)
    return torch.from_numpy(picture).permute(2, 0, 1) / 255, fill_unknown(depth)


def own_scene(image: Tensor, distance: Tensor, max_pixels: int = _SHEET_PIXELS) -> Scene:
    """Make a scene of a picture and its distances, reduced to the size on a sheet.

    Args:
        image (3xHxW tensor): sRGB; uint8, or floating point 0…1; ten times as long as wide at most.
        distance (1xHxW tensor): along the ray, m, ≥ 0; +inf is open water.
        max_pixels: largest number of pixels; by default that on a sheet.
    """
    checks.same_size("distance", distance, image)
    height, width = image.shape[-2:]
    if max(height, width) > _LONGEST_SIDES * min(height, width):
        raise ValueError(f"image: {width}×{height} px are too narrow, crop it")
    require_values(image, "srgb")
    checks.distances("distance", distance)
    light = decoded(image, "srgb")
    shrink, note = (max_pixels / (height * width)) ** 0.5, ""
    if shrink < 1:
        size = (max(1, round(height * shrink)), max(1, round(width * shrink)))
        light = interpolate(light[None], size, mode="area")[0]
        # sampled: a mean across an edge would be the distance of nothing
        distance = interpolate(distance[None], size, mode="nearest-exact")[0]
        note = f"Drawn at {size[1]}×{size[0]} of {width}×{height} px."
    return Scene(linear_to_srgb(light), distance, note=note)
