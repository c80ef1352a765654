"""Pictures and distance maps in files. The end of a file's name says its format."""

import io
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import tifffile
import torch
from numpy.typing import NDArray
from PIL import ExifTags, Image, ImageCms, PngImagePlugin
from torch import Tensor

from uwaug._support import checks
from uwaug._support.atomic import require_regular, written_whole
from uwaug._support.extras import require
from uwaug._support.types import ColorSpace
from uwaug.files.exif import kept_exif, tiff_with
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear

ENDINGS = (".npy", ".exr", ".tif", ".tiff", ".png", ".jpg", ".jpeg")  # of pictures
MAP_ENDINGS = (".npy", ".npz", ".exr", ".tif", ".tiff", ".png")
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}

# place in a PNG of the byte with the number of bits of a channel, and of its second chunk
_BIT_DEPTH, _HEAD = 24, 33
_PROFILE_TAG, _NODATA_TAG = 34675, 42113  # of TIFF
_REC_709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)  # x, y of red, green, blue, white
_JPEG_TABLE_SUM = 3688  # of the standard's table for luminance, which is quality 50
_SAME_LEVELS = 2  # by which profiles of sRGB differ, of 255
_SRGB_POWER, _SAME_POWER = 1 / 2.2, 0.05  # of light, and the share by which it may differ (libpng)
_SAME_PRIMARIES, _NEAR_PRIMARIES = 0.002, 0.015  # in x, y; those of all television are near
_VIDEO_POWER = 1 / 1.961  # as FFmpeg writes it as gAMA
# by a cICP's numbers of primaries and curve: sRGB; and video, Rec. 709 and 601
_POWERS = {b"\1\15": _SRGB_POWER, **dict.fromkeys((b"\1\1", b"\5\6", b"\6\6"), _VIDEO_POWER)}


class Picture(NamedTuple):
    """A picture in a file."""

    image: Tensor  # 3xHxW, upright, see `read_picture`
    orientation: int  # of the file by EXIF: 1 is upright, 2…8 were turned or mirrored
    exif: bytes  # that goes with a result, see `kept_exif`


def read_picture(path: str | Path, color_space: ColorSpace = "srgb") -> Tensor:
    """Read a picture. Grey becomes R = G = B; an opaque alpha is dropped.

    Args:
        path: a PNG, JPEG or TIFF file of 8 or 16 bits; or a .npy (HxWx3) or .exr file, which may
            also hold floating-point numbers, 0…1. EXR and PNG of 16 bits need the extra "files".
        color_space: colour space of the result. An EXR holds linear light; a colour profile, such
            as Display P3, and a PNG's gamma are converted to sRGB.

    Returns:
        3xHxW, upright by EXIF: uint8 (0…255) for 8 bits, else float32 (0…1 for 16 bits).

    Raises:
        ValueError: if it is no such picture; the error names the file.
        OSError: if it cannot be read.
    """
    return open_picture(Path(path), color_space).image


def open_picture(path: Path, color_space: ColorSpace = "srgb") -> Picture:
    """As `read_picture`, with what was done to the file's pixels."""
    file = _decoded(path, "RGB")
    values = file.values
    if values.dtype not in (np.uint8, np.uint16) and values.dtype.kind != "f":
        raise ValueError(f"{path}: expected 8 or 16 bits, or floating point, got {values.dtype}")
    if values.ndim == 2 and values.dtype.kind == "f":
        raise ValueError(f"{path}: one channel of floating point is a map, and no picture")
    if values.ndim == 2:
        values = values[..., None].repeat(3, 2)
    if values.ndim != 3 or values.shape[2] != 3:
        raise ValueError(f"{path}: expected RGB or grey, without alpha, got shape {values.shape}")
    if color_space == "srgb" and values.dtype.kind == "u":
        values = _in_srgb(values, file)
    if values.dtype == np.uint16:
        values = values / np.float32(65535)
    elif values.dtype != np.uint8:
        values = values.astype(np.float32)
    image = torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1)))
    is_light = path.suffix.lower() == ".exr"
    image = linear_to_srgb(image) if is_light and color_space == "srgb" else image
    return Picture(image, file.orientation, file.exif)


def read_distance(path: str | Path, unit: str | float | None = "m") -> Tensor:
    """Read a map of distances.

    Args:
        path: a .npy (HxW), .npz (one array, or one called Z, depth or distance), .exr (one layer,
            or one called Z or Y), TIFF or PNG file. Axes of length 1 count as none, and equal
            channels as one.
        unit: "m", "cm", "mm", or the metres that 1 stands for. None: the numbers are relative or
            inverse; those of 8 and 16 bits become shares of the largest of their type.

    Returns:
        1xHxW, float32: m, or numbers without unit. Unknown pixels (0, negative, NaN) stay; GDAL's
        NODATA of a TIFF becomes NaN, and with a unit the largest number of a type, too.

    Raises:
        ValueError: if channels differ, the unit is unknown, or the file cannot be decoded; with a
            unit, if it has 8 bits, or a median beyond 1000 m.
        OSError: if it cannot be read.
    """
    file = _decoded(Path(path), "Z")
    values, nodata = file.values, file.nodata
    if values.ndim == 3 and all(np.array_equal(v, values[..., 0].T, True) for v in values.T):
        values = values[..., 0]
    if values.ndim != 2:
        got = f"{values.shape}: are distances packed in them? Unpack them first"
        raise ValueError(f"{path}: expected one channel (H, W), got {got}")
    is_unknown = np.zeros(values.shape, bool) if nodata is None else values == nodata
    if unit is None:
        white = np.iinfo(values.dtype).max if values.dtype in (np.uint8, np.uint16) else 1
        shares = np.where(is_unknown, np.nan, values / white)
        return torch.from_numpy(shares.astype(np.float32))[None]
    if values.dtype.itemsize == 1:
        cure = "are they relative? Those have no unit: --set distance.kind=Inverse, or Relative"
        raise ValueError(f"{path}: 8 bits are too few for distances in {unit}: {cure}")
    # rounded once, from double precision
    z = (values.astype(np.float64) * metres_of(unit)).astype(np.float32)
    largest = np.iinfo(values.dtype).max if values.dtype.kind in "ui" else np.inf
    z[is_unknown | (values == largest) & np.isfinite(largest)] = np.nan
    distance = torch.from_numpy(z)[None]
    median = checks.too_far(distance)
    if median is not None:
        cure = "is the unit mm (--unit mm), or are they relative (--set distance.kind=Inverse)?"
        raise ValueError(f"{path}: a median of {median:.4g} m is farther than one sees: {cure}")
    return distance


def metres_of(unit: str | float) -> float:
    """Metres that a unit of distances stands for; refuses any other word or number."""
    if isinstance(unit, str):
        checks.one_of("unit", unit, (*UNITS, "a number of metres"))
        return UNITS[unit]
    checks.positive("unit", unit, "m")
    return float(unit)


def jpeg_quality(path: str | Path) -> int | None:
    """Quality of a JPEG file by its table for luminance, 1…100; None of other files."""
    if Path(path).suffix.lower() not in (".jpg", ".jpeg"):
        return None
    with Image.open(path) as image:
        table = getattr(image, "quantization", {}).get(0)
    if not table:
        return None
    percent = 100 * sum(table) / _JPEG_TABLE_SUM
    quality = (200 - percent) / 2 if percent <= 100 else 5000 / percent
    return int(min(max(round(quality), 1), 100))


def write_picture(
    path: str | Path,
    image: Tensor,
    quality: float = 95,
    color_space: ColorSpace = "srgb",
    exif: bytes = b"",
) -> None:
    """Write a picture, whole or not at all.

    Args:
        path: file to write or replace; the end of its name is the format.
        image (3xHxW tensor): uint8 (0…255), written in 8 bits; or floating point (0…1), written in
            16 bits to PNG and TIFF, as float32 to .npy and .exr, which take maps (1xHxW), too.
        quality: quality of JPEG, 1…100.
        color_space: colour space of the image. An EXR gets linear light.
        exif: EXIF of JPEG, PNG and TIFF, as Pillow's `Exif.tobytes` gives it.
    """
    end = _ending(Path(path), ENDINGS)
    values = image.detach().cpu().permute(1, 2, 0).contiguous().numpy()
    if values.dtype != np.uint8 and end not in (".npy", ".exr"):
        white, kind = (255, np.uint8) if end in (".jpg", ".jpeg") else (65535, np.uint16)
        values = np.rint(values.clip(0, 1).astype(np.float64) * white).astype(kind)
    with written_whole(path) as part:
        if end == ".exr":
            (exr,) = require("files", "OpenEXR")
            light = (values / 255 if values.dtype == np.uint8 else values).astype(np.float32)
            is_map = light.shape[-1] == 1
            if color_space == "srgb" and not is_map:
                light = srgb_to_linear(torch.from_numpy(light)).numpy()
            layers = {"Z": light[..., 0]} if is_map else {"RGB": light}
            exr.File({"type": exr.scanlineimage}, layers).write(str(part))
            return
        with part.open("wb") as file:
            if end == ".npy":
                np.save(file, values if values.shape[-1] > 1 else values[..., 0])
            elif end in (".tif", ".tiff"):
                file.write(tiff_with(values, exif))
            elif values.dtype == np.uint16:
                (codecs,) = require("files", "imagecodecs")
                data = codecs.png_encode(values)
                file.write(data[:_HEAD])
                if exif:
                    PngImagePlugin.putchunk(file, b"eXIf", exif.removeprefix(b"Exif\0\0"))
                file.write(data[_HEAD:])
            else:
                # of JPEG; colour is what water changes: none of it is subsampled
                how: Any = {"quality": round(quality), "subsampling": "4:4:4", "exif": exif}
                Image.fromarray(values).save(file, "PNG" if end == ".png" else "JPEG", **how)


@lru_cache(maxsize=16)
def _to_srgb(profile: bytes) -> ImageCms.ImageCmsTransform | None:
    """Transform from a profile to sRGB; None without one, for sRGB, and for other colours."""
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        transform = ImageCms.buildTransform(source, ImageCms.createProfile("sRGB"), "RGB", "RGB")
    except (OSError, ImageCms.PyCMSError):
        return None
    colours = (15 * np.indices((18, 18, 18))).astype(np.uint8).reshape(3, -1, 1).T
    converted = np.asarray(transform.apply(Image.fromarray(colours)))
    return transform if (np.abs(converted - colours.astype(int)) > _SAME_LEVELS).any() else None


def _in_srgb(values: NDArray[Any], file: "_File") -> NDArray[Any]:
    if abs(file.power / _SRGB_POWER - 1) > _SAME_POWER:
        white = np.iinfo(values.dtype).max
        light = torch.linspace(0, 1, white + 1, dtype=torch.float64) ** (1 / file.power)
        levels = np.rint(linear_to_srgb(light).numpy() * white).astype(values.dtype)
        return np.asarray(levels[values])
    if (transform := _to_srgb(file.profile)) is None:
        return values
    values = np.ascontiguousarray(values)
    if values.dtype == np.uint8:
        return np.asarray(transform.apply(Image.fromarray(values)))
    (codecs,) = require("files", "imagecodecs")  # Pillow converts 8 bits alone
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    # optimised, 16 bits would go by a coarse table that is off by 11 of 255 in shadows
    how: Any = {"colorspace": "rgb", "outcolorspace": "rgb", "flags": codecs.CMS.FLAGS.NOOPTIMIZE}
    converted: NDArray[Any] = codecs.cms_transform(values, file.profile, srgb, **how)
    return converted


class _File(NamedTuple):
    values: NDArray[Any]  # HxW or HxWxC, upright
    orientation: int = 1
    exif: bytes = b""
    profile: bytes = b""
    power: float = _SRGB_POWER  # of light, that the values are without a profile
    nodata: float | None = None  # number that stands for none, by GDAL


_What = Literal["RGB", "Z"]
_Kind = tifffile.PHOTOMETRIC


def _decoded(path: Path, what: _What) -> _File:
    decode = _DECODERS[_ending(path, ENDINGS if what == "RGB" else MAP_ENDINGS)]
    require_regular(path)
    try:
        file = decode(path, what)
    except (ImportError, MemoryError):
        raise
    except Exception as error:  # decoders raise whatever they like over a damaged file
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise ValueError(f"{path}: cannot be decoded: {error}") from error
    values = file.values
    if values.dtype.kind not in "uif":
        raise ValueError(f"{path}: expected numbers, got {values.dtype}")
    values = values.astype(values.dtype.newbyteorder("="), copy=False)
    if not values.size:
        raise ValueError(f"{path}: holds no pixels, got shape {values.shape}")
    while values.ndim > 2 and values.shape[0] == 1 and (values.ndim > 3 or values.shape[-1] > 4):
        values = values[0]
    white = 1 if values.dtype.kind == "f" else np.iinfo(values.dtype).max
    if values.ndim == 3 and values.shape[-1] in (2, 4) and (values[..., -1] == white).all():
        values = values[..., :-1]
    while values.ndim > 2 and values.shape[-1] == 1:
        values = values[..., 0]
    return file._replace(values=values)


def _ending(path: Path, endings: tuple[str, ...]) -> str:
    end = path.suffix.lower()
    if end not in endings:
        raise ValueError(f"{path}: expected a file that ends in {', '.join(endings)}")
    return end


def _of_npy(path: Path, what: _What) -> _File:
    # mapped, so that a header that lies about its size does not fill the memory
    return _File(np.array(np.load(path, mmap_mode="r", allow_pickle=False)))


def _of_npz(path: Path, what: _What) -> _File:
    with np.load(path, allow_pickle=False) as arrays:
        names = [n for n in arrays if len(arrays) == 1 or n.lower() in ("z", "depth", "distance")]
        if len(names) != 1:
            raise ValueError(f"expected one array called depth, got {', '.join(arrays)}")
        return _File(np.asarray(arrays[names[0]]))


def _of_pillow(path: Path, what: _What) -> _File:
    with Image.open(path) as image:  # refuses pictures that would fill the memory
        modes = ("RGB", "RGBA", "L", "LA", "I;16", "I;16B")
        if image.mode not in modes or "transparency" in image.info:
            got = "a transparent colour" if image.mode in modes else image.mode
            raise ValueError(f"expected RGB or grey, without a palette, got {got}")
        if image.format == "PNG" and (count := getattr(image, "n_frames", 1)) > 1:
            raise ValueError(f"holds {count} pictures: save each in a file of its own")
        profile, values = image.info.get("icc_profile") or b"", np.asarray(image)
        exif, power = image.getexif(), _SRGB_POWER
    turn = int(exif.get(ExifTags.Base.Orientation, 1))
    interop = exif.get_ifd(ExifTags.IFD.Interop)
    if interop.get(ExifTags.Interop.InteropIndex) == "R03" and not profile:
        raise ValueError("is in Adobe RGB, without a profile: convert it first, or add one")
    if image.format == "PNG":
        data = path.read_bytes()
        if what == "RGB":
            profile, power = _coded(image.info, data)
        if values.ndim == 3 and data[_BIT_DEPTH] == 16:  # of which Pillow has dropped half
            (codecs,) = require("files", "imagecodecs")
            values = codecs.png_decode(data)
    return _File(_upright(values, turn), turn, kept_exif(exif), profile, power)


def _coded(info: dict[Any, Any], data: bytes) -> tuple[bytes, float]:
    """Colour profile of a PNG, and the power of light that its numbers are without one: by cICP, or
    else iCCP, sRGB, or cHRM and gAMA.
    """
    head = data[: data.find(b"IDAT")]
    if cicp := head.partition(b"\0\0\0\4cICP")[2][:4]:
        if (power := _POWERS.get(cicp[:2])) is None or cicp[2:] != b"\0\1":
            got = "/".join(map(str, cicp))
            raise ValueError(f"cICP must be sRGB (1/13/0/1) or Rec. 709 (1/1/0/1), got {got}")
        return b"", power
    if "icc_profile" in info or "srgb" in info:
        return info.get("icc_profile") or b"", _SRGB_POWER
    if "chromaticity" in info:  # of white first
        _require_rec_709(np.roll(info["chromaticity"], -2), _NEAR_PRIMARIES)
    return b"", info.get("gamma") or _SRGB_POWER


def _require_rec_709(primaries: Any, within: float) -> None:
    if not np.allclose(np.reshape(primaries, (-1, 8)), _REC_709, atol=within):
        got = ", ".join(f"{number:.4g}" for number in np.ravel(primaries)[:8])
        raise ValueError(f"primaries must be those of Rec. 709, got {got}: convert it first")


def _of_tiff(path: Path, what: _What) -> _File:
    with tifffile.TiffFile(path) as file:
        page, count = file.pages.first, sum(not page.is_reduced for page in file.pages)
        kind = _Kind(page.photometric)
        is_reversed = kind is _Kind.MINISWHITE and what == "RGB"
        is_jpeg = kind is _Kind.YCBCR and page.compression == tifffile.COMPRESSION.JPEG
        if not (is_reversed or is_jpeg or kind in (_Kind.RGB, _Kind.MINISBLACK)):
            got = {_Kind.SEPARATED: "CMYK"}.get(kind, kind.name)
            raise ValueError(f"expected RGB or grey, got {got}")
        if page.imagewidth * page.imagelength > 2 * (Image.MAX_IMAGE_PIXELS or np.inf):
            raise ValueError(f"{page.imagewidth}×{page.imagelength} px: see PIL.MAX_IMAGE_PIXELS")
        if (count := max(count, file.series[0].size // page.size)) > 1 or page.is_reduced:
            raise ValueError(f"holds {count} pictures: save each in a file of its own")
        values = page.asarray()
        if is_reversed:
            values = (1 << page.bitspersample) - 1 - values
        values = np.moveaxis(values, page.axes.index("S"), -1) if "S" in page.axes else values
        turn = int(page.tags.valueof(ExifTags.Base.Orientation, 1))
        profile = bytes(page.tags.valueof(_PROFILE_TAG) or b"")
        nodata = str(page.tags.valueof(_NODATA_TAG, "")).strip("\0 ")
        number, exif = float(nodata) if nodata else None, Image.Exif()
        with suppress(Exception):  # as a damaged one
            file.filehandle.seek(0)
            exif.load_from_fp(file.filehandle)
        return _File(_upright(values, turn), turn, kept_exif(exif), profile, nodata=number)


def _of_exr(path: Path, what: _What) -> _File:
    (exr,) = require("files", "OpenEXR")
    parts = exr.File(str(path)).parts
    if what == "RGB":
        primaries = [part.header.get("chromaticities", _REC_709) for part in parts]
        _require_rec_709(primaries, _SAME_PRIMARIES)
    layers = [(name, channel.pixels) for part in parts for name, channel in part.channels.items()]
    names = ("RGB", "RGBA") if what == "RGB" else ("Z", "Y")
    is_alone = what == "Z" and len(layers) == 1
    fits = [pixels for name, pixels in layers if name in names or is_alone]
    if len(fits) != 1:
        got = ", ".join(name for name, _ in layers)
        raise ValueError(f"expected one layer {' or '.join(names)}, got {got}")
    return _File(np.asarray(fits[0]))


def _upright(values: NDArray[Any], orientation: int) -> NDArray[Any]:
    mirrored = values[:, ::-1] if orientation in (2, 4, 5, 7) else values
    quarters = {3: 2, 4: 2, 5: 1, 6: 3, 7: 3, 8: 1}.get(orientation, 0)
    return np.rot90(mirrored, quarters)


_DECODERS: dict[str, Callable[[Path, _What], _File]] = {
    ".npy": _of_npy,
    ".npz": _of_npz,
    ".exr": _of_exr,
    **dict.fromkeys((".tif", ".tiff"), _of_tiff),
    **dict.fromkeys((".png", ".jpg", ".jpeg"), _of_pillow),
}
