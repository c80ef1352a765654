"""Pictures into files, whole or not at all; or into file objects."""

import os
import struct
import zlib
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import tifffile
from PIL import Image
from torch import Tensor

from uwaug._support.atomic import written_whole
from uwaug._support.tiles import row_bands
from uwaug.io.read import PictureFile

FORMATS = {
    ".png": "PNG",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".webp": "WEBP",
    ".tif": "TIFF",
    ".tiff": "TIFF",
    ".npy": "NPY",
}
"""By the end of a file's name."""

_QUALITY = 95
"""Of lossy formats."""

_DEPTHS = {"PNG": (8, 16), "JPEG": (8,), "WEBP": (8,), "TIFF": (8, 16, 32), "NPY": (8, 16, 32)}
"""Bits that a format holds."""

_HEAD = 33
"""Bytes of a PNG before what may stand beside its pixels."""


def format_of(path: str | os.PathLike[str]) -> str:
    """The format that a file's name asks for.

    Raises:
        ValueError: if its end is unknown; lists the known.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        ends = ", ".join(FORMATS)
        raise ValueError(f"{path}: expected a name that ends in {ends}, got {suffix or 'none'}")
    return FORMATS[suffix]


def write_picture(path: str | os.PathLike[str], image: Tensor, like: PictureFile) -> None:
    """Write a picture as its original was: as many bits where the format holds them, with its
    alpha, EXIF and colour profile where the format can; see `lost`.

    Args:
        path: its end is the format; a file that exists is replaced.
        image (3xHxW tensor): of the type of `like.image`.
        like: where it comes from.

    Raises:
        ValueError: if the end of the name is unknown.
        OSError: if it cannot be written.
    """
    format = format_of(path)
    with written_whole(path) as part, part.open("wb") as file:
        encode(file, format, image, like)


def lost(like: PictureFile, format: str) -> list[str]:
    """What a format of `FORMATS` does not keep of a picture, such as "alpha"."""
    most = max(_DEPTHS[format])
    gone = {
        f"{like.bits} bits (it has {most})": like.bits > most,
        "alpha": like.alpha is not None and format == "JPEG",
        "EXIF": like.exif is not None and format in ("TIFF", "NPY"),
        "colour profile": like.profile is not None and format == "NPY",
    }
    return [what for what, is_lost in gone.items() if is_lost]


def encode(file: BinaryIO, format: str, image: Tensor, like: PictureFile) -> None:
    """Write a picture into an open file in a format of `FORMATS`; otherwise as `write_picture`."""
    bits = max(bits for bits in _DEPTHS[format] if bits <= like.bits)
    values = _in_bits(image, bits)
    if like.alpha is not None and format != "JPEG":
        alpha = _alpha_in_bits(like.alpha, values.dtype)
        values = np.concatenate([values, alpha[..., None]], 2)
    if format == "NPY":
        np.save(file, values if like.channels_last else values.transpose(2, 0, 1))
    elif format == "TIFF":
        _write_tiff(file, values, like)
    elif bits == 16:
        _write_png16(file, values, like)
    else:
        _write_pillow(file, values, format, like)


def _in_bits(image: Tensor, bits: int) -> Any:
    """HxWx3, in the numbers of a file."""
    values = image.permute(1, 2, 0).numpy()
    if values.dtype == np.uint8 or bits == 32:
        return values
    most = 2**bits - 1
    scaled = np.empty(values.shape, np.uint8 if bits == 8 else np.uint16)
    for start, stop in row_bands(*values.shape[:2]):
        band = values[start:stop].astype(np.float64)
        scaled[start:stop] = np.rint(np.clip(band, 0, 1) * most)
    return scaled


def _alpha_in_bits(alpha: Any, dtype: Any) -> Any:
    """Alpha in the numbers of another type."""
    if alpha.dtype == dtype:
        return alpha
    unit = alpha.astype(np.float64)
    if alpha.dtype.kind == "u":
        unit = unit / np.iinfo(alpha.dtype).max
    if dtype.kind == "f":
        return unit.astype(dtype)
    return np.rint(np.clip(unit, 0, 1) * np.iinfo(dtype).max).astype(dtype)


def _write_tiff(file: BinaryIO, values: Any, like: PictureFile) -> None:
    options: dict[str, Any] = {"photometric": "rgb", "compression": "zlib", "metadata": None}
    if like.profile is not None:
        options["iccprofile"] = like.profile
    if values.shape[2] == 4:
        options["extrasamples"] = ["unassalpha"]
    # else the time of writing would be part of the file
    tifffile.imwrite(file, values, datetime=None, software="uwaug", **options)


def _write_png16(file: BinaryIO, values: Any, like: PictureFile) -> None:
    from imagecodecs import png_encode

    data = png_encode(np.ascontiguousarray(values))
    file.write(data[:_HEAD])
    if like.profile is not None:
        _write_chunk(file, b"iCCP", b"ICC Profile\0\0" + zlib.compress(like.profile))
    if like.exif is not None:
        _write_chunk(file, b"eXIf", like.exif.removeprefix(b"Exif\0\0"))
    file.write(data[_HEAD:])


def _write_chunk(file: BinaryIO, name: bytes, data: bytes) -> None:
    """A part of a PNG, as its specification has it."""
    file.write(struct.pack(">I", len(data)) + name + data)
    file.write(struct.pack(">I", zlib.crc32(name + data)))


def _write_pillow(file: BinaryIO, values: Any, format: str, like: PictureFile) -> None:
    options: dict[str, Any] = {}
    if like.exif is not None:
        options["exif"] = like.exif
    if like.profile is not None:
        options["icc_profile"] = like.profile
    if format in ("JPEG", "WEBP"):
        options["quality"] = _QUALITY
    if format == "JPEG":
        options["subsampling"] = "4:4:4"  # colour is what water changes
    height, width, channels = values.shape
    image = Image.new("RGB" if channels == 3 else "RGBA", (width, height))
    # Pillow's copy has four bytes a pixel: one of ours beside it would double the memory
    for start, stop in row_bands(height, width):
        image.paste(Image.fromarray(np.ascontiguousarray(values[start:stop])), (0, start))
    image.save(file, format, **options)
