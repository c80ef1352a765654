"""Distances along the ray (m): from maps of depth or disparity, a network, a plane, or made up."""

from uwaug.distance.convert import along_ray, from_disparity, from_inverse, from_relative
from uwaug.distance.doubts import doubts
from uwaug.distance.fill import fill_unknown
from uwaug.distance.made_up import MadeUp
from uwaug.distance.network import Network
from uwaug.distance.sources import Inverse, Metres, Plane, Relative, Source

__all__ = [
    "Inverse",
    "MadeUp",
    "Metres",
    "Network",
    "Plane",
    "Relative",
    "Source",
    "along_ray",
    "doubts",
    "fill_unknown",
    "from_disparity",
    "from_inverse",
    "from_relative",
]
