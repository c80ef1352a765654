"""Metres along the ray, from what people have: metric depth, disparity, relative or inverse depth,
a depth network.
"""

from uwaug.distance.convert import (
    along_ray,
    check_distance,
    fill_unknown,
    from_disparity,
    from_inverse,
    from_relative,
)
from uwaug.distance.network import DepthNetwork
from uwaug.distance.sample import UnknownDistanceError

__all__ = [
    "DepthNetwork",
    "UnknownDistanceError",
    "along_ray",
    "check_distance",
    "fill_unknown",
    "from_disparity",
    "from_inverse",
    "from_relative",
]
