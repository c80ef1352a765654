"""A picture with distances, for demos and tests."""

from dataclasses import dataclass

import torch
from torch import Tensor

from uwaug.distance import along_ray, fill_unknown, from_disparity

__all__ = ["Scene", "motorcycle", "motorcycle_depth"]

_FOCAL_PX = 994.978


@dataclass(frozen=True)
class Scene:
    """A picture with distances.

    Attributes:
        image (3xHxW tensor): sRGB, 0…1.
        distance (1xHxW tensor): along the ray, m.
        focal_px: focal length, px.
    """

    image: Tensor
    distance: Tensor
    focal_px: float


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
    """The picture of that scene (3xHxW, sRGB), and its depth along the optical axis (1xHxW, m)."""
    from skimage.data import stereo_motorcycle

    left, _, disparity = stereo_motorcycle()
    pixels = torch.from_numpy(disparity)[None]
    depth = from_disparity(pixels, _FOCAL_PX, baseline_m=0.193001, offset_px=31.086)
    return torch.from_numpy(left).permute(2, 0, 1) / 255, fill_unknown(depth)
