"""Pictures, distance maps and masks in files, read and written whole."""

from uwaug.io.distances import UNITS, DistanceFormat, Unit, metres_of, read_distance, read_mask
from uwaug.io.read import PictureFile, read_picture, read_picture_file
from uwaug.io.write import FORMATS, format_of, write_picture

__all__ = [
    "FORMATS",
    "UNITS",
    "DistanceFormat",
    "PictureFile",
    "Unit",
    "format_of",
    "metres_of",
    "read_distance",
    "read_mask",
    "read_picture",
    "read_picture_file",
    "write_picture",
]
