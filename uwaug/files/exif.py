"""EXIF of pictures: what goes with a result, and the focal length that it says."""

import math
import zlib
from contextlib import suppress
from typing import Any

from numpy.typing import NDArray
from PIL import ExifTags, Image

_TAGS, _IFDS = ExifTags.Base, (ExifTags.IFD.Exif, ExifTags.IFD.GPSInfo)
_OF_CAMERA = (_TAGS.Make, _TAGS.Model, _TAGS.DateTime, _TAGS.Artist, _TAGS.Copyright)
# of the source's pixels; a maker's note may hold a picture, and breaks where it is moved
_OF_PIXELS = {_TAGS.MakerNote, _TAGS.ColorSpace, _TAGS.ExifImageWidth, _TAGS.ExifImageHeight}
_OF_PIXELS |= {_TAGS.ExifInteroperabilityOffset, _TAGS.Gamma}
_MOST_BYTES = 65533  # that JPEG takes
_FILM_MM = math.hypot(36, 24)


def kept_exif(exif: Image.Exif) -> bytes:
    """Who took a picture, when, where and how, for its result; b"" if nothing says it. What is of
    the source's pixels goes: small pictures, a turn that has been made, a colour space.
    """
    kept = Image.Exif()
    with suppress(Exception):  # damaged EXIF is no reason to refuse a picture
        kept.update({tag: exif[tag] for tag in _OF_CAMERA if tag in exif})
        for ifd in _IFDS:
            entries = {tag: of for tag, of in exif.get_ifd(ifd).items() if tag not in _OF_PIXELS}
            kept.update({ifd: entries} if entries else {})
        data = kept.tobytes() if kept else b""
        return data if len(data) <= _MOST_BYTES else b""
    return b""


def tiff_with(values: NDArray[Any], exif: bytes) -> bytes:
    """A TIFF of an RGB picture (HxWx3); without the time of writing, so that equal pictures are
    equal files.
    """
    entries, kind = Image.Exif(), values.dtype.newbyteorder("<")
    data = zlib.compress(values.astype(kind).tobytes())
    entries.load(exif)
    entries.endian = "<"
    entries.update({_TAGS.ImageWidth: values.shape[1], _TAGS.ImageLength: values.shape[0]})
    entries.update({_TAGS.BitsPerSample: (8 * values.itemsize,) * 3, _TAGS.SamplesPerPixel: 3})
    entries.update({_TAGS.Compression: 8, _TAGS.PhotometricInterpretation: 2})  # Deflate, RGB
    # one strip, which Pillow takes to begin where the entries end
    entries.update({_TAGS.StripOffsets: 0, _TAGS.StripByteCounts: len(data)})
    return entries.tobytes().removeprefix(b"Exif\0\0") + data


def focal_lengths(exif: bytes, height: int, width: int) -> tuple[float, int] | None:
    """Focal length on film of 35 mm, mm, and in a picture, px; None where EXIF does not say it."""
    entries = Image.Exif()
    entries.load(exif)
    length = entries.get_ifd(ExifTags.IFD.Exif).get(_TAGS.FocalLengthIn35mmFilm)
    # by the diagonal, as cameras of other shapes are compared
    return (length, round(length * math.hypot(height, width) / _FILM_MM)) if length else None
