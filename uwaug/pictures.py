"""Pictures, distances and masks from files."""

import logging
import os
import re
from errno import EINVAL
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tifffile
import torch
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from torch import Tensor

from uwaug import checks
from uwaug.files import require_regular

__all__ = [
    "UNITS",
    "Source",
    "read_distance",
    "read_mask",
    "read_numbers",
    "read_picture",
    "read_source",
]

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "um": 1e-6}
"""What distances may be written in, m."""

_FARTHEST = 1000.0
"""m: no map of metres has a median beyond; no water lets one see farther than 100 m."""

_OPEN = 1e7
"""Beyond, a number stands for open water."""

_ORIENTATION = 0x0112
"""EXIF's tag, and TIFF's."""

_PROFILE = 0x8773
"""TIFF's tag of a colour profile."""

_COLOUR = "colour"

_INKS = ("CMYK", "LAB", "HSV")
"""Pillow's names of channels that are neither light nor alpha."""

_CURES = {
    "grey": "the model needs colours; if it may have none, save it as RGB",
    "a palette of greys": "the model needs colours; if it may have none, save it as RGB",
    "CMYK": "save it as RGB from a picture editor, which knows the inks",
}

_DENSEST = 10_000
"""Pixels in a byte of a file, of one bit each, as dense as any compression makes them."""

_CODE = re.compile(r"[A-Z]\w*Error|<\w|b['\"]|\n")
"""Stands in what decoders say to programmers."""

# it tells of damaged files on standard error, besides what it raises
logging.getLogger("tifffile").addHandler(logging.NullHandler())

Values = NDArray[Any]


class _UnfitError(ValueError):
    """A file that is whole, and not what is needed; says so in a sentence."""


class _Raster(NamedTuple):
    """What a file holds.

    Attributes:
        values: HxW in grey, HxWx3 in colour.
        kind: "colour", "grey", or in words what cannot be used.
        alpha: HxW; None if there is none.
        exif, profile: as they are in the file; None if there are none.
    """

    values: Values
    kind: str
    alpha: Values | None = None
    exif: bytes | None = None
    profile: bytes | None = None


class Source(NamedTuple):
    """A picture, and what a copy of its file should keep.

    Attributes:
        picture (3xHxW tensor): uint8 (0…255), or float32.
        bits: 8, 16, or 32 for floating point.
        alpha: HxW, in the numbers of the file; None if there is none.
        exif: without orientation, as the picture stands upright; None if there is none.
        profile: of its colours (ICC); None if there is none.
    """

    picture: Tensor
    bits: int
    alpha: Values | None
    exif: bytes | None
    profile: bytes | None


def read_picture(path: str | os.PathLike[str]) -> Tensor:
    """Read a picture in colour.

    Args:
        path: PNG, JPEG, WebP, TIFF (its first page) or whatever else Pillow reads; 8 or 16 bit, or
            floating point. Or .npy of HxWx3 or 3xHxW.

    Returns:
        3xHxW: uint8 (0…255) of 8-bit files, float32 of others: 0…1 of 16-bit files, as they are of
        floating point. Upright, as EXIF says that the camera was held; without alpha. A colour
        profile is not applied.

    Raises:
        ValueError: if it is grey, CMYK, of another type, or cannot be decoded; names the file.
        OSError: if there is no such file, or it cannot be read.
    """
    return read_source(path).picture


def read_source(path: str | os.PathLike[str]) -> Source:
    """Read a picture in colour, with what a copy of its file should keep; as `read_picture`."""
    raster = _read(path)
    if raster.kind != _COLOUR:
        cure = _CURES.get(raster.kind, "save it as RGB")
        raise ValueError(f"{path}: expected a picture in colour, got {raster.kind}: {cure}")
    picture, bits = _in_colour(path, raster.values.transpose(2, 0, 1))
    return Source(picture, bits, raster.alpha, raster.exif, raster.profile)


def _in_colour(path: str | os.PathLike[str], values: Values) -> tuple[Tensor, int]:
    """The picture and the bits of its file."""
    if values.dtype == np.uint8:
        return torch.from_numpy(values.copy()), 8
    if values.dtype == np.uint16:
        return torch.from_numpy(values.astype(np.float32) / np.float32(65535)), 16
    if values.dtype.kind != "f":
        expected = "expected 8 or 16 bit, or floating point"
        raise ValueError(f"{path}: {expected}, got {values.dtype}: save it as 16 bit")
    picture = torch.from_numpy(values.astype(np.float32))
    try:
        checks.finite("picture", picture)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return picture, 32


def read_distance(
    path: str | os.PathLike[str], unit: str | float = "m", *, some_known: bool = True
) -> Tensor:
    """Read a map of distances.

    Args:
        path: .npy, or .npz of one array (HxW, 1xHxW or HxWx1); TIFF (its first page) or PNG of one
            channel, 16 bit or floating point; PFM; or OpenEXR of one channel, or with one called Z.
        unit: of the numbers in the file: "m", "cm", "mm" or "um"; or how many metres 1 stands for.
        some_known: whether to refuse a map that tells nothing.

    Returns:
        1xHxW, float32, m. 0 and NaN, which stand for unknown, and +inf stay.

    Raises:
        ValueError: if it holds colours or 8 bits, which are no distances; if no pixel's is known;
            if its median lies beyond 1000 m; or if it cannot be decoded. Names the file.
        OSError: if there is no such file, or it cannot be read.
    """
    if isinstance(unit, str):
        checks.one_of("unit", unit, UNITS)
    else:
        checks.positive("unit", unit, "m")
    metres = UNITS[unit] if isinstance(unit, str) else unit
    values = _one_channel(path, "distances")
    if values.dtype.itemsize == 1:
        cure = "relative depth? Make metres of it with uwaug.distance and save them as .npy"
        raise ValueError(f"{path}: expected 16 bit or floating point, got {values.dtype}: {cure}")
    z = values.astype(np.float64) * metres
    known = z[(z > 0) & (z < _OPEN)]
    if some_known and not (z > 0).any():
        raise ValueError(f"{path}: no pixel has a distance > 0: expected metres, 0 where unknown")
    if known.size and (median := float(np.median(known))) > _FARTHEST:
        finer = "mm" if unit in ("m", "cm") else "um"
        got = f"its median is {median:.5g} m if it is in {unit}"
        raise ValueError(f"{path}: {got}, farther than one sees: try --distance-unit {finer}")
    return torch.from_numpy(z.astype(np.float32))[None]


def read_numbers(path: str | os.PathLike[str]) -> Values:
    """Read the numbers (HxW) of a file of one channel, as they are; files as for `read_distance`.

    Raises:
        ValueError: if it holds colours, or cannot be decoded; names the file.
        OSError: if there is no such file, or it cannot be read.
    """
    return _one_channel(path, "distances")


def read_mask(path: str | os.PathLike[str]) -> Tensor:
    """Read a mask, from files of one channel as `read_distance`, of 8 bits or 1 bit too.

    Returns:
        1xHxW, bool: true where the file is > 0.

    Raises:
        ValueError: if it holds colours, or cannot be decoded; names the file.
        OSError: if there is no such file, or it cannot be read.
    """
    return torch.from_numpy(_one_channel(path, "a mask") > 0)[None]


def _one_channel(path: str | os.PathLike[str], wanted: str) -> Values:
    """The HxW numbers of a file."""
    raster = _read(path)
    if raster.kind != "grey" or raster.values.dtype.kind not in "biuf":
        got = raster.kind if raster.kind != "grey" else f"numbers of type {raster.values.dtype}"
        cure = "save one channel of plain numbers"
        raise ValueError(f"{path}: expected {wanted} in one channel, got {got}: {cure}")
    return raster.values


def _read(path: str | os.PathLike[str]) -> _Raster:
    require_regular(path)
    try:
        raster = _decoded(Path(path))
    except MemoryError:
        raise
    except Exception as error:
        # decoders raise whatever they like over a damaged file
        # and seek where a damaged one sends them: an invalid argument
        if isinstance(error, OSError) and error.errno not in (None, EINVAL):
            error.filename = error.filename or os.fspath(path)
            raise
        raise ValueError(f"{path}: {_in_words(error)}") from error
    if not raster.values.size:
        raise ValueError(f"{path}: holds no pixels, got shape {raster.values.shape}")
    return raster


def _in_words(error: Exception) -> str:
    if isinstance(error, _UnfitError):
        return str(error)
    if isinstance(error, UnidentifiedImageError):
        return "is no picture and no map that can be read: damaged, or of another kind?"
    said = str(error)
    clear = said and not isinstance(error, (LookupError, TypeError)) and not _CODE.search(said)
    return f"cannot be decoded, it seems to be damaged{f' ({said})' if clear else ''}"


def _decoded(path: Path) -> _Raster:
    """By what a file begins with, as names may lie."""
    with path.open("rb") as file:
        head = file.read(26)
    if not head:
        raise _UnfitError("is empty")
    if head.startswith((b"\x93NUMPY", b"PK\x03\x04")):
        return _numpy(path)
    if head.startswith((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")):
        return _tiff(path)
    if head.startswith(b"\x76\x2f\x31\x01"):
        return _exr(path)
    # the bits of a PNG's channels, of which Pillow would drop half
    if head.startswith(b"\x89PNG") and head[24] == 16:
        return _png_of_16_bits(path)
    return _pillow(path)


def _numpy(path: Path) -> _Raster:
    # NumPy leaves a damaged file open that it has opened itself
    with path.open("rb") as file:
        found = np.load(file, allow_pickle=False)
        if isinstance(found, np.lib.npyio.NpzFile):
            if len(found.files) != 1:
                raise _UnfitError(f"expected one array, got {', '.join(found.files) or 'none'}")
            found = found[found.files[0]]
    if found.ndim == 3 and found.shape[-1] not in (1, 3, 4) and found.shape[0] in (1, 3, 4):
        found = np.moveaxis(found, 0, -1)
    return _channels(found)


def _channels(values: Values) -> _Raster:
    """Of HxW or HxWxC: grey or colour, without alpha."""
    if values.ndim == 2:
        return _Raster(values, "grey")
    if values.ndim == 3 and values.shape[-1] in (1, 2):
        return _Raster(values[..., 0], "grey")
    if values.ndim == 3 and values.shape[-1] in (3, 4):
        alpha = values[..., 3] if values.shape[-1] == 4 else None
        return _Raster(values[..., :3], _COLOUR, alpha)
    raise _UnfitError(f"expected (H, W) or (H, W, 3), got {values.shape}: save one picture")


def _tiff(path: Path) -> _Raster:
    with tifffile.TiffFile(path) as file:
        page = file.pages.first
        # palettes, inks and YCbCr are Pillow's
        if page.photometric not in (tifffile.PHOTOMETRIC.RGB, tifffile.PHOTOMETRIC.MINISBLACK):
            return _pillow(path)
        _require_held(path, page.imagewidth, page.imagelength)
        if page.bitspersample not in (1, 8, 16, 32, 64):
            # of a damaged file, it may be anything
            bits = page.bitspersample if isinstance(page.bitspersample, int) else "an odd number of"
            got = f"got {bits} bits in a channel"
            raise _UnfitError(f"expected 8 or 16 bits, or floating point, {got}: save it as 16")
        values = page.asarray()
        if "S" in page.axes:
            values = np.moveaxis(values, page.axes.index("S"), -1)
        orientation, profile = page.tags.valueof(_ORIENTATION), page.tags.valueof(_PROFILE)
    raster = _channels(_upright(values, int(orientation or 1)))
    return raster._replace(profile=None if profile is None else bytes(profile))


def _png_of_16_bits(path: Path) -> _Raster:
    from imagecodecs import png_decode

    with Image.open(path) as image:
        _require_held(path, *image.size)
        orientation, exif, profile = _metadata(image)
    raster = _channels(_upright(png_decode(path.read_bytes()), orientation))
    return raster._replace(exif=exif, profile=profile)


def _require_held(path: Path, width: int, height: int) -> None:
    """Refuse a size that the file is too small for, before memory is taken for it: one damaged bit
    can make 40 px of 32 808.
    """
    size = path.stat().st_size
    if width * height > _DENSEST * size:
        got = f"{width} × {height} px cannot be held in {size} bytes"
        raise _UnfitError(f"{got}: the file seems to be damaged")


def _metadata(image: Image.Image) -> tuple[int, bytes | None, bytes | None]:
    """Orientation; EXIF without it; colour profile."""
    found = image.getexif()
    orientation = found.get(_ORIENTATION, 1)
    if _ORIENTATION in found:
        del found[_ORIENTATION]
    return orientation, found.tobytes() if len(found) else None, image.info.get("icc_profile")


def _pillow(path: Path) -> _Raster:
    with Image.open(path) as image:
        _require_held(path, *image.size)
        image.load()
        orientation, exif, profile = _metadata(image)
        mode = image.mode
        if mode in ("P", "PA", "YCbCr"):
            # by way of alpha, else Pillow warns of a transparent entry of a palette
            values = np.asarray(image.convert("RGBA"))
        else:
            values = np.asarray(image)
    values = _upright(values, orientation)
    if mode in ("P", "PA") and bool((values[..., 1:3] == values[..., :1]).all()):
        return _Raster(values, "a palette of greys")
    if mode in _INKS:
        return _Raster(values, mode)
    raster = _channels(values)
    opaque = mode == "YCbCr" or (mode == "P" and bool((values[..., 3] == 255).all()))
    alpha = None if opaque else raster.alpha
    return raster._replace(alpha=alpha, exif=exif, profile=profile)


def _exr(path: Path) -> _Raster:
    try:
        import OpenEXR
    except ImportError:
        cure = 'pip install ".[exr]" in a checkout of uwaug, or save it as .npy'
        raise _UnfitError(f"OpenEXR is missing, which reads it: {cure}") from None
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    names = list(channels)
    if len(names) > 1 and "Z" not in names:
        cure = "save one channel, or call it Z"
        raise _UnfitError(f"holds the channels {', '.join(names)}, none of them Z: {cure}")
    return _channels(channels["Z" if "Z" in names else names[0]].pixels)


def _upright(values: Values, orientation: int) -> Values:
    """As EXIF says that the camera was held: where the first row and the first column belong."""
    if orientation in (5, 6, 7, 8):
        values = values.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    if orientation in (3, 4, 7, 8):
        values = values[::-1]
    return values
