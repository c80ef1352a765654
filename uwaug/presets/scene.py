"""A picture with distances: the bundled one, or one's own."""

import warnings
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from uwaug._support import checks
from uwaug.distance.convert import along_ray, from_disparity
from uwaug.distance.fill import fill_unknown
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
    focal_px: float | None
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


def own_scene(
    image: Tensor, distance: Tensor, focal_px: float | None = None, *, behind: bool = True
) -> Scene:
    """A picture with its distances, as large as a sheet shows it and without holes.

    The picture is reduced in linear light. Of the distances each keeps one of its own pixels, as a
    mean across an edge would be the distance of nothing.

    Args:
        image (3xHxW tensor): sRGB; uint8, or floating point.
        distance (1xHxW tensor): along the ray, m. NaN, zero and negative are unknown, and filled by
            `uwaug.distance.fill_unknown`; +inf, or beyond 1e7, is open water.
        focal_px: focal length, px of the picture; that of the scene is as much shorter as it is
            smaller.
        behind: fill holes with what is behind, see `uwaug.distance.fill_unknown`.

    Raises:
        ValueError: if the sizes differ, the picture is more than ten times as long as wide, none of
            its pixels has a distance, or the image is none of 0…1.
    """
    checks.same_size("distance", distance, image)
    height, width = image.shape[-2:]
    if max(height, width) > _LONGEST * min(height, width):
        expected = f"at most {_LONGEST} times as long as wide"
        raise ValueError(f"image must be {expected}, got {width}×{height} px: crop it")
    require_values(image, "srgb")
    notes, light = [], decoded(image, "srgb")
    unknown = float((~(distance > 0)).double().mean())
    shrink = (_PIXELS / (height * width)) ** 0.5
    if shrink < 1:
        size = (max(1, round(height * shrink)), max(1, round(width * shrink)))
        light = interpolate(light[None], size, mode="area")[0]
        distance = interpolate(distance[None], size, mode="nearest-exact")[0]
        focal_px = None if focal_px is None else focal_px * size[1] / width
        notes.append(f"Drawn at {size[1]}×{size[0]} of {width}×{height} px.")
    distance = torch.where(distance > checks.OPEN, torch.inf, distance)
    if not bool(((distance > 0) & distance.isfinite()).any()):
        expected = "some pixel above 0 m that is not open water"
        raise ValueError(f"distance must have {expected}, got {checks.span(distance)}")
    if unknown:
        how = "with what is behind" if behind else "with what is around"
        share = f"{100 * unknown:.2g} %"
        notes.append(f"{share} of the distances were unknown and are filled {how}.")
    with warnings.catch_warnings():
        # of many unknown pixels: the note says how many
        warnings.simplefilter("ignore", UserWarning)
        distance = fill_unknown(distance, behind=behind)
    return Scene(linear_to_srgb(light), distance, focal_px, " ".join(notes))


def motorcycle_depth() -> tuple[Tensor, Tensor]:
    """The motorcycle's picture (3xHxW, sRGB), and its depth along the optical axis (1xHxW, m)."""
    from skimage.data import stereo_motorcycle

    left, _, disparity = stereo_motorcycle()
    pixels = torch.from_numpy(disparity)[None]
    depth = from_disparity(pixels, _FOCAL_PX, baseline_m=0.193001, offset_px=31.086)
    return torch.from_numpy(left).permute(2, 0, 1) / 255, fill_unknown(depth)
