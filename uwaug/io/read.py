"""Pictures in files, decoded by their content: names may lie."""

import io
import logging
import os
import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EINVAL
from pathlib import Path
from threading import Lock
from typing import IO, Any, BinaryIO, NamedTuple

import numpy as np
import tifffile
import torch
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from PIL.PpmImagePlugin import PpmImageFile
from torch import Tensor

from uwaug._support import checks
from uwaug._support.atomic import require_regular
from uwaug._support.extras import require

File = str | os.PathLike[str] | BinaryIO
"""A path; or a file object that can be read and sought, whose attribute `name`, if it has one,
stands in errors.
"""

Values = NDArray[Any]

COLOUR, GREY = "colour", "grey"

_ORIENTATION = 0x0112
"""EXIF's tag, and TIFF's."""

_PROFILE = 0x8773
"""TIFF's tag of a colour profile."""

_TURNED = range(2, 9)
"""Orientations in which a picture does not stand upright."""

_ASIDE = (5, 6, 7, 8)
"""Those in which width and height change places."""

_MOST = 1_000_000_000
"""Pixels of a compressed picture. Pillow's own limit, 89 megapixels, is for files from strangers: a
small one may hold a picture that fills the memory. A person's own are larger.
"""

_DENSEST = 10_000
"""Pixels in a byte of a file, of one bit each, as dense as any compression makes them."""

_INKS = ("CMYK", "LAB", "HSV")
"""Pillow's names of channels that are neither light nor alpha."""

_opening = Lock()

# it tells of damaged files on standard error, besides what it raises
logging.getLogger("tifffile").addHandler(logging.NullHandler())


class _UnfitError(ValueError):
    """A file that is whole, and not what is needed; says so in a sentence without its name."""


class Raster(NamedTuple):
    """What a file holds.

    Attributes:
        values: HxW in grey, HxWx3 in colour.
        kind: "colour", "grey", or in words what cannot be used.
        alpha: HxW; None if there is none.
        exif, profile: as they are in the file; None if there are none. EXIF without orientation,
            as the picture stands upright.
        turned: whether it was turned or mirrored, as EXIF says that the camera was held.
        channels_last: whether it is an array with its channels in the last place.
        left_out: what a file holds besides, in words, such as further frames.
    """

    values: Values
    kind: str
    alpha: Values | None = None
    exif: bytes | None = None
    profile: bytes | None = None
    turned: bool = False
    channels_last: bool = False
    left_out: tuple[str, ...] = ()


class PictureFile(NamedTuple):
    """A picture, and what a copy of its file should keep.

    Attributes:
        image (3xHxW tensor): uint8 (0…255), or float32.
        bits: 8, 16, or 32 for floating point.
        alpha, exif, profile, turned, channels_last: as of `Raster`; alpha in the numbers of the
            file.
        left_out: what no copy keeps, in words: further frames, pages and digits.
    """

    image: Tensor
    bits: int
    alpha: Values | None = None
    exif: bytes | None = None
    profile: bytes | None = None
    turned: bool = False
    channels_last: bool = False
    left_out: tuple[str, ...] = ()


def read_picture(file: File) -> Tensor:
    """Read a picture in colour.

    Args:
        file: PNG, JPEG, WebP, TIFF (its first page) or whatever else Pillow reads; 8 or 16 bit, or
            floating point. Or .npy of HxWx3 or 3xHxW.

    Returns:
        3xHxW: uint8 (0…255) of 8-bit files, float32 of others: 0…1 of 16-bit files, as they are of
        floating point. Upright, as EXIF says that the camera was held; without alpha. A colour
        profile is not applied.

    Raises:
        ValueError: if it is grey, CMYK, of another type, or cannot be decoded; names the file.
        OSError: if there is no such file, or it cannot be read.
    """
    return read_picture_file(file).image


def read_picture_file(file: File) -> PictureFile:
    """Read a picture in colour with what a copy of its file should keep; files and errors as for
    `read_picture`.
    """
    raster, name = decode(file), name_of(file)
    _require_colour(name, raster)
    values = raster.values.transpose(2, 0, 1)
    if values.dtype == np.uint8:
        return PictureFile(torch.from_numpy(values.copy()), 8, *raster[2:])
    if values.dtype == np.uint16:
        image = torch.from_numpy(values.astype(np.float32)).div_(65535)
        return PictureFile(image, 16, *raster[2:])
    if values.dtype.kind != "f":
        expected = "expected 8 or 16 bit, or floating point"
        raise ValueError(f"{name}: {expected}, got {values.dtype}: save it as 16 bit")
    image = torch.from_numpy(values.astype(np.float32))
    try:
        checks.finite("picture", image)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if values.dtype.itemsize != 4:
        kind = f"numbers of {values.dtype.newbyteorder('=')}, which become float32"
        raster = raster._replace(left_out=(*raster.left_out, kind))
    return PictureFile(image, 32, *raster[2:])


def colours_of(image: Image.Image) -> tuple[Values, Values | None]:
    """The colours of a picture in Pillow's hands (HxWx3, uint8), and its alpha if there is one.

    As it lies there, whatever EXIF says; by the same rules as `read_picture`.

    Raises:
        ValueError: if it is grey, or of inks.
    """
    raster = _of_mode(image)
    _require_colour("image", raster)
    return raster.values, raster.alpha


def decode(file: File) -> Raster:
    """What a file holds, by its content.

    Raises:
        ValueError: if it cannot be decoded; names the file.
        OSError: if there is no such file, or it cannot be read.
    """
    name = name_of(file)
    with opened(file) as stream:
        try:
            raster = _by_content(stream)
        except MemoryError:
            raise
        except Exception as error:
            # decoders raise whatever they like over a damaged file
            # and seek where a damaged one sends them: an invalid argument
            if isinstance(error, OSError) and error.errno not in (None, EINVAL):
                error.filename = error.filename or name
                raise
            raise ValueError(f"{name}: {_reason(error)}") from error
    if not raster.values.size:
        raise ValueError(f"{name}: holds no pixels, got shape {raster.values.shape}")
    return raster


def name_of(file: File) -> str:
    """What a file is called in errors."""
    if isinstance(file, (str, os.PathLike)):
        return os.fspath(file)
    return str(getattr(file, "name", "file"))


@contextmanager
def opened(file: File) -> Iterator[BinaryIO]:
    """A file to read, from its beginning; what was open stays open.

    Raises:
        OSError: if there is no such file, it is none, or cannot be read.
    """
    if isinstance(file, (str, os.PathLike)):
        require_regular(file)
        with Path(file).open("rb") as stream:
            yield stream
    else:
        file.seek(0)
        yield file


def _reason(error: Exception) -> str:
    if isinstance(error, _UnfitError):
        return str(error)
    if isinstance(error, UnidentifiedImageError):
        return "is no picture and no map that can be read: damaged, or of another kind?"
    return f"cannot be decoded, it seems to be damaged ({str(error) or type(error).__name__})"


def _require_colour(name: str, raster: Raster) -> None:
    if raster.kind != COLOUR:
        raise ValueError(f"{name}: expected a picture in colour, got {raster.kind}: save it as RGB")


def _by_content(stream: BinaryIO) -> Raster:
    """By what a file begins with."""
    head = stream.read(26)
    stream.seek(0)
    if not head:
        raise _UnfitError("is empty")
    if head.startswith((b"\x93NUMPY", b"PK\x03\x04")):
        return _numpy(stream)
    if head.startswith((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")):
        return _tiff(stream)
    if head.startswith(b"\x76\x2f\x31\x01"):
        return _exr(stream)
    # the bits of a PNG's channels, of which Pillow would drop half
    if head.startswith(b"\x89PNG") and head[24] == 16:
        return _png_of_16_bits(stream)
    return _pillow(stream)


def _numpy(stream: BinaryIO) -> Raster:
    is_archive = stream.read(2) == b"PK"
    stream.seek(0)
    if is_archive:
        with zipfile.ZipFile(stream) as archive:
            names = [name.removesuffix(".npy") for name in archive.namelist()]
            if len(names) != 1:
                raise _UnfitError(f"expected one array, got {', '.join(names) or 'none'}")
            # a small file may hold an array that fills the memory
            with archive.open(archive.namelist()[0]) as member:
                _require_pixels(stream, *_header(member))
    else:
        _require_pixels(stream, *_header(stream))
    stream.seek(0)
    array = np.load(stream, allow_pickle=False)
    if isinstance(array, np.lib.npyio.NpzFile):
        array = array[array.files[0]]
    channels_first = _has_channels_first(array.shape)
    if channels_first:
        array = np.moveaxis(array, 0, -1)
    return _channels(array)._replace(channels_last=array.ndim == 3 and not channels_first)


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of the array of a .npy file."""
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    return shape, dtype


def _has_channels_first(shape: tuple[int, ...]) -> bool:
    return len(shape) == 3 and shape[-1] not in (1, 3, 4) and shape[0] in (1, 3, 4)


def _require_pixels(stream: BinaryIO, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Refuse an array that is no picture, no map and no mask, before it is read."""
    if dtype.kind not in "biuf":
        got = f"got numbers of type {dtype}" if dtype.kind != "O" else "got a pickle of objects"
        raise _UnfitError(f"expected whole numbers or floating point, {got}")
    if len(shape) not in (2, 3):
        raise _UnfitError(f"expected (H, W) or (H, W, 3), got {shape}: save one picture")
    height, width = shape[1:] if _has_channels_first(shape) else shape[:2]
    _require_held(stream, width, height)


def _channels(values: Values) -> Raster:
    """Of HxW or HxWxC: grey or colour, without alpha."""
    if values.ndim == 2:
        return Raster(values, GREY)
    if values.ndim == 3 and values.shape[-1] == 1:
        return Raster(values[..., 0], GREY)
    if values.ndim == 3 and values.shape[-1] == 2:
        return Raster(values, "grey with a second channel")
    if values.ndim == 3 and values.shape[-1] in (3, 4):
        alpha = values[..., 3] if values.shape[-1] == 4 else None
        return Raster(values[..., :3], COLOUR, alpha)
    raise _UnfitError(f"expected (H, W) or (H, W, 3), got {values.shape}: save one picture")


def _tiff(stream: BinaryIO) -> Raster:
    with tifffile.TiffFile(stream) as file:
        page = file.pages.first
        # palettes, inks and YCbCr are Pillow's
        if page.photometric not in (tifffile.PHOTOMETRIC.RGB, tifffile.PHOTOMETRIC.MINISBLACK):
            return _pillow(stream)
        _require_held(stream, page.imagewidth, page.imagelength)
        if page.bitspersample not in (1, 8, 16, 32, 64):
            got = f"got {page.bitspersample} bits in a channel"
            raise _UnfitError(f"expected 8 or 16 bits, or floating point, {got}: save it as 16")
        values = page.asarray()
        if "S" in page.axes:
            values = np.moveaxis(values, page.axes.index("S"), -1)
        orientation = int(page.tags.valueof(_ORIENTATION) or 1)
        profile = page.tags.valueof(_PROFILE)
        left_out = _further(len(file.pages), "page")
    raster = _channels(_upright(values, orientation))
    profile = None if profile is None else bytes(profile)
    turned = orientation in _TURNED
    return raster._replace(profile=profile, turned=turned, left_out=left_out)


def _further(count: int, what: str) -> tuple[str, ...]:
    """What is left out of a file of several pictures, in words."""
    return () if count < 2 else (f"{count - 1} more {what}{'s' if count > 2 else ''}",)


def _png_of_16_bits(stream: BinaryIO) -> Raster:
    from imagecodecs import png_decode

    with _pillow_opened(stream) as image:
        _require_held(stream, *image.size)
        orientation, kept = _metadata(image)
    stream.seek(0)
    return _channels(_upright(png_decode(stream.read()), orientation))._replace(**kept)


def _pillow(stream: BinaryIO) -> Raster:
    with _pillow_opened(stream) as image:
        _require_held(stream, *image.size)
        # of these Pillow stretches other numbers to 255 or 65535: right for colours, not for metres
        if isinstance(image, PpmImageFile) and image.mode != "RGB" and image.tile[0][0] != "raw":
            raise _UnfitError("is no binary PGM with a maximum of 255 or 65535: save it as PNG")
        image.load()
        orientation, kept = _metadata(image)
        return _of_mode(image, orientation)._replace(**kept)


def _pillow_opened(stream: BinaryIO) -> Image.Image:
    """A file opened by Pillow, which has no limit of its own meanwhile."""
    stream.seek(0)
    with _opening:
        limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
        try:
            return Image.open(stream)
        finally:
            Image.MAX_IMAGE_PIXELS = limit


def _require_held(stream: BinaryIO, width: int, height: int) -> None:
    """Refuse a size that is too large, or that the file is too small for, before memory is taken
    for it: one damaged bit can make 40 px of 32 808.
    """
    if width * height > _MOST:
        got = f"{width} × {height} px, which is more than {_MOST // 10**6} megapixels"
        raise _UnfitError(f"holds {got}: cut it into parts")
    before = stream.tell()
    size = stream.seek(0, os.SEEK_END)
    stream.seek(before)
    if width * height > _DENSEST * size:
        got = f"{width} × {height} px cannot be held in {size} bytes"
        raise _UnfitError(f"{got}: the file seems to be damaged")


def _metadata(image: Image.Image) -> tuple[int, dict[str, Any]]:
    """Orientation, and what is kept of a file."""
    exif = image.getexif()
    orientation = exif.get(_ORIENTATION, 1)
    if _ORIENTATION in exif:
        del exif[_ORIENTATION]
    return orientation, {
        "exif": exif.tobytes() if len(exif) else None,
        "profile": image.info.get("icc_profile"),
        "turned": orientation in _TURNED,
        "left_out": _further(getattr(image, "n_frames", 1), "frame"),
    }


def _of_mode(image: Image.Image, orientation: int = 1) -> Raster:
    """By what Pillow calls its channels."""
    mode = image.mode
    has_key = mode == "RGB" and "transparency" in image.info
    if mode in ("P", "PA", "YCbCr") or has_key:
        # by way of alpha, else Pillow warns of a transparent entry of a palette; a colour that
        # stands for transparent ones would be another in water
        image = image.convert("RGBA")
    values = _upright(np.asarray(image), orientation)
    if mode in ("P", "PA") and bool((values[..., 1:3] == values[..., :1]).all()):
        return Raster(values, "a palette of greys")
    if mode in _INKS:
        return Raster(values, mode)
    raster = _channels(values)
    opaque = mode == "YCbCr" or (mode == "P" and bool((values[..., 3] == 255).all()))
    return raster._replace(alpha=None if opaque else raster.alpha)


def _exr(stream: BinaryIO) -> Raster:
    try:
        (OpenEXR,) = require("exr", "OpenEXR")
    except ImportError as error:
        raise _UnfitError(f"{error}, or save it as .npy") from None
    if isinstance(stream, io.BufferedReader):
        channels = OpenEXR.File(str(stream.name), separate_channels=True).channels()
    else:
        # it reads nothing but files with names
        with tempfile.NamedTemporaryFile(suffix=".exr") as file:
            shutil.copyfileobj(stream, file)
            file.flush()
            channels = OpenEXR.File(file.name, separate_channels=True).channels()
    names = list(channels)
    if len(names) > 1 and "Z" not in names:
        cure = "save one channel, or call it Z"
        raise _UnfitError(f"holds the channels {', '.join(names)}, none of them Z: {cure}")
    return _channels(channels["Z" if "Z" in names else names[0]].pixels)


def _upright(values: Values, orientation: int) -> Values:
    """As EXIF says that the camera was held: where the first row and the first column belong."""
    if orientation in _ASIDE:
        values = values.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    if orientation in (3, 4, 7, 8):
        values = values[::-1]
    return values
