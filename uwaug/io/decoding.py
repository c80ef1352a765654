"""What files of pictures and maps hold, as arrays."""

import logging
import os
import re
from errno import EINVAL
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from uwaug._support.atomic import require_regular

__all__ = ["COLOUR", "Raster", "UnfitError", "Values", "decoded", "of_mode"]

_ORIENTATION = 0x0112
"""EXIF's tag, and TIFF's."""

_PROFILE = 0x8773
"""TIFF's tag of a colour profile."""

_ASIDE = (5, 6, 7, 8)
"""Orientations in which width and height change places."""

_PER_INCH = {2: 1.0, 3: 2.54}
"""By TIFF's number of a unit of resolution."""

_FINEST = 65535
"""dpi: the most that JPEG holds."""

_MOST = 1_000_000_000
"""Pixels of a compressed picture. Pillow's own limit, 89 megapixels, is for files from strangers: a
small one may hold a picture that fills the memory. A person's own are larger.
"""

_opening = Lock()

COLOUR = "colour"

_INKS = ("CMYK", "LAB", "HSV")
"""Pillow's names of channels that are neither light nor alpha."""

_DENSEST = 10_000
"""Pixels in a byte of a file, of one bit each, as dense as any compression makes them."""

_CODE = re.compile(r"[A-Z]\w*Error|<\w|b['\"]|\n")
"""Stands in what decoders say to programmers."""

# it tells of damaged files on standard error, besides what it raises
logging.getLogger("tifffile").addHandler(logging.NullHandler())

Values = NDArray[Any]


class UnfitError(ValueError):
    """A file that is whole, and not what is needed; says so in a sentence."""


class Raster(NamedTuple):
    """What a file holds.

    Attributes:
        values: HxW in grey, HxWx3 in colour.
        kind: "colour", "grey", or in words what cannot be used.
        alpha: HxW; None if there is none.
        exif, profile: as they are in the file; None if there are none.
        dpi: across and down; None if the file does not say.
        turned: whether it stood otherwise in the file, see `_upright`.
    """

    values: Values
    kind: str
    alpha: Values | None = None
    exif: bytes | None = None
    profile: bytes | None = None
    dpi: tuple[float, float] | None = None
    turned: bool = False


def decoded(path: str | os.PathLike[str]) -> Raster:
    """What a file holds, by its content, as names may lie.

    Raises:
        ValueError: if it cannot be decoded; names the file.
        OSError: if there is no such file, or it cannot be read.
    """
    require_regular(path)
    try:
        raster = _by_content(Path(path))
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
    if isinstance(error, UnfitError):
        return str(error)
    if isinstance(error, UnidentifiedImageError):
        return "is no picture and no map that can be read: damaged, or of another kind?"
    said = str(error)
    clear = said and not isinstance(error, (LookupError, TypeError)) and not _CODE.search(said)
    return f"cannot be decoded, it seems to be damaged{f' ({said})' if clear else ''}"


def _by_content(path: Path) -> Raster:
    """By what a file begins with."""
    with path.open("rb") as file:
        head = file.read(26)
    if not head:
        raise UnfitError("is empty")
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


def _numpy(path: Path) -> Raster:
    # NumPy leaves a damaged file open that it has opened itself
    with path.open("rb") as file:
        found = np.load(file, allow_pickle=False)
        if isinstance(found, np.lib.npyio.NpzFile):
            if len(found.files) != 1:
                raise UnfitError(f"expected one array, got {', '.join(found.files) or 'none'}")
            found = found[found.files[0]]
    if found.ndim == 3 and found.shape[-1] not in (1, 3, 4) and found.shape[0] in (1, 3, 4):
        found = np.moveaxis(found, 0, -1)
    return _channels(found)


def _channels(values: Values) -> Raster:
    """Of HxW or HxWxC: grey or colour, without alpha."""
    if values.ndim == 2:
        return Raster(values, "grey")
    if values.ndim == 3 and values.shape[-1] in (1, 2):
        return Raster(values[..., 0], "grey")
    if values.ndim == 3 and values.shape[-1] in (3, 4):
        alpha = values[..., 3] if values.shape[-1] == 4 else None
        return Raster(values[..., :3], COLOUR, alpha)
    raise UnfitError(f"expected (H, W) or (H, W, 3), got {values.shape}: save one picture")


def _tiff(path: Path) -> Raster:
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
            raise UnfitError(f"expected 8 or 16 bits, or floating point, {got}: save it as 16")
        values = page.asarray()
        if "S" in page.axes:
            values = np.moveaxis(values, page.axes.index("S"), -1)
        orientation, profile = page.tags.valueof(_ORIENTATION), page.tags.valueof(_PROFILE)
        dpi = _tiff_dpi(page.tags)
    kept = _Kept(int(orientation or 1), None, None if profile is None else bytes(profile), dpi)
    return kept.beside(_channels(_upright(values, kept.orientation)))


def _tiff_dpi(tags: tifffile.TiffTags) -> Any:
    scale = _PER_INCH.get(tags.valueof("ResolutionUnit", 1))
    sides = [tags.valueof(name) for name in ("XResolution", "YResolution")]
    if scale is None or not all(isinstance(side, tuple) and all(side) for side in sides):
        return None
    return tuple(scale * side[0] / side[1] for side in sides)


def _png_of_16_bits(path: Path) -> Raster:
    from imagecodecs import png_decode

    with _opened(path) as image:
        _require_held(path, *image.size)
        kept = _metadata(image)
    return kept.beside(_channels(_upright(png_decode(path.read_bytes()), kept.orientation)))


def _opened(path: Path) -> Image.Image:
    """A file opened by Pillow, which has no limit of its own meanwhile."""
    with _opening:
        limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
        try:
            return Image.open(path)
        finally:
            Image.MAX_IMAGE_PIXELS = limit


def _require_held(path: Path, width: int, height: int) -> None:
    """Refuse a size that is too large, or that the file is too small for, before memory is taken
    for it: one damaged bit can make 40 px of 32 808.
    """
    if width * height > _MOST:
        got = f"{width} × {height} px, which is more than {_MOST // 10**6} megapixels"
        raise UnfitError(f"holds {got}: cut it into parts")
    size = path.stat().st_size
    if width * height > _DENSEST * size:
        got = f"{width} × {height} px cannot be held in {size} bytes"
        raise UnfitError(f"{got}: the file seems to be damaged")


class _Kept(NamedTuple):
    """What stands beside the pixels: EXIF without orientation, and as of `Raster`."""

    orientation: int
    exif: bytes | None
    profile: bytes | None
    dpi: Any

    def beside(self, raster: Raster) -> Raster:
        """A picture that is upright, with all of it."""
        dpi = None
        # of a damaged file, it may be anything
        if self.dpi is not None and all(0 < side < _FINEST for side in self.dpi):
            x, y = map(float, self.dpi)
            dpi = (y, x) if self.orientation in _ASIDE else (x, y)
        turned = self.orientation in range(2, 9)
        return raster._replace(exif=self.exif, profile=self.profile, dpi=dpi, turned=turned)


def _metadata(image: Image.Image) -> _Kept:
    found = image.getexif()
    orientation = found.get(_ORIENTATION, 1)
    if _ORIENTATION in found:
        del found[_ORIENTATION]
    exif = found.tobytes() if len(found) else None
    return _Kept(orientation, exif, image.info.get("icc_profile"), image.info.get("dpi"))


def _pillow(path: Path) -> Raster:
    with _opened(path) as image:
        _require_held(path, *image.size)
        image.load()
        kept = _metadata(image)
        return kept.beside(of_mode(image, kept.orientation))


def of_mode(image: Image.Image, orientation: int = 1) -> Raster:
    """By what Pillow calls its channels."""
    mode = image.mode
    if mode in ("P", "PA", "YCbCr"):
        # by way of alpha, else Pillow warns of a transparent entry of a palette
        image = image.convert("RGBA")
    values = _upright(np.asarray(image), orientation)
    if mode in ("P", "PA") and bool((values[..., 1:3] == values[..., :1]).all()):
        return Raster(values, "a palette of greys")
    if mode in _INKS:
        return Raster(values, mode)
    raster = _channels(values)
    opaque = mode == "YCbCr" or (mode == "P" and bool((values[..., 3] == 255).all()))
    alpha = None if opaque else raster.alpha
    return raster._replace(alpha=alpha)


def _exr(path: Path) -> Raster:
    try:
        import OpenEXR
    except ImportError:
        cure = 'pip install ".[exr]" in a checkout of uwaug, or save it as .npy'
        raise UnfitError(f"OpenEXR is missing, which reads it: {cure}") from None
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    names = list(channels)
    if len(names) > 1 and "Z" not in names:
        cure = "save one channel, or call it Z"
        raise UnfitError(f"holds the channels {', '.join(names)}, none of them Z: {cure}")
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
