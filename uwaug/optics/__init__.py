"""Waters and cameras, which know wavelengths, and the medium that comes of them, which is curves of
distance and a width law.
"""

from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.constituents import Constituents
from uwaug.optics.jerlov import JERLOV_TYPES
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.scattering import Scattering
from uwaug.optics.water import Water, load_water

__all__ = [
    "JERLOV_TYPES",
    "Camera",
    "Constituents",
    "Medium",
    "PointSpread",
    "Scattering",
    "Water",
    "load_camera",
    "load_water",
]
