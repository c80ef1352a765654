"""Pictures, distances and masks from files."""

import os
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from uwaug._support import checks
from uwaug._support.tiles import bands
from uwaug.io.decoding import COLOUR, Raster, Values, decoded, of_mode

__all__ = [
    "UNITS",
    "Source",
    "Unit",
    "colours_of",
    "metres_of",
    "read_distance",
    "read_mask",
    "read_numbers",
    "read_picture",
    "read_source",
]

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "um": 1e-6}
"""What distances may be written in, m."""

Unit = str | float
"""Of distances: "m", "cm", "mm", "um", or how many metres 1 stands for."""

_FARTHEST = 1000.0
"""m: no map of metres has a median beyond; no water lets one see farther than 100 m."""

_OPEN = 1e7
"""Beyond, a number stands for open water."""

_CURES = {
    "grey": "the model needs colours; if it may have none, save it as RGB",
    "a palette of greys": "the model needs colours; if it may have none, save it as RGB",
    "CMYK": "save it as RGB from a picture editor, which knows the inks",
}


class Source(NamedTuple):
    """A picture, and what a copy of its file should keep.

    Attributes:
        picture (3xHxW tensor): uint8 (0…255), or float32.
        bits: 8, 16, or 32 for floating point.
        alpha: HxW, in the numbers of the file; None if there is none.
        exif: without orientation, as the picture stands upright; None if there is none.
        profile: of its colours (ICC); None if there is none.
        dpi: across and down; None if the file does not say.
        turned: whether it was turned or mirrored, as EXIF says that the camera was held.
    """

    picture: Tensor
    bits: int
    alpha: Values | None
    exif: bytes | None
    profile: bytes | None
    dpi: tuple[float, float] | None = None
    turned: bool = False


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
    raster = decoded(path)
    _require_colour(path, raster)
    picture, bits = _in_colour(path, raster.values.transpose(2, 0, 1))
    kept = (raster.alpha, raster.exif, raster.profile, raster.dpi, raster.turned)
    return Source(picture, bits, *kept)


def colours_of(image: Image.Image) -> tuple[Values, Values | None]:
    """The colours of a picture in Pillow's hands (HxWx3, uint8), and its alpha if there is one.

    As it lies there, whatever EXIF says; by the same rules as `read_picture`.

    Raises:
        ValueError: if it is grey, or of inks.
    """
    raster = of_mode(image)
    _require_colour("image", raster)
    return raster.values, raster.alpha


def _require_colour(name: str | os.PathLike[str], raster: Raster) -> None:
    if raster.kind != COLOUR:
        cure = _CURES.get(raster.kind, "save it as RGB")
        raise ValueError(f"{name}: expected a picture in colour, got {raster.kind}: {cure}")


def _in_colour(path: str | os.PathLike[str], values: Values) -> tuple[Tensor, int]:
    """The picture and the bits of its file."""
    if values.dtype == np.uint8:
        return torch.from_numpy(values.copy()), 8
    if values.dtype == np.uint16:
        picture = torch.from_numpy(values.astype(np.float32))
        return picture.div_(65535), 16
    if values.dtype.kind != "f":
        expected = "expected 8 or 16 bit, or floating point"
        raise ValueError(f"{path}: {expected}, got {values.dtype}: save it as 16 bit")
    picture = torch.from_numpy(values.astype(np.float32))
    try:
        checks.finite("picture", picture)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return picture, 32


def metres_of(unit: Unit, name: str = "unit") -> float:
    """Metres of a unit; `name` is what it is called where it is wrong."""
    if isinstance(unit, str):
        checks.one_of(name, unit, (*UNITS, "a number of metres"))
        return UNITS[unit]
    checks.positive(name, unit, "m")
    return float(unit)


def read_distance(
    path: str | os.PathLike[str], unit: Unit = "m", *, some_known: bool = True
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
    metres = metres_of(unit)
    values = _one_channel(path, "distances")
    if values.dtype.itemsize == 1:
        cure = "relative depth? Make metres of it with uwaug.distance and save them as .npy"
        raise ValueError(f"{path}: expected 16 bit or floating point, got {values.dtype}: {cure}")
    z = _in_metres(values, metres)
    positive, known, beyond = _counted(z)
    if some_known and not positive:
        raise ValueError(f"{path}: no pixel has a distance > 0: expected metres, 0 where unknown")
    if beyond and 2 * beyond >= known:
        median = float(np.median(z[(z > 0) & (z < _OPEN)]))
        if median > _FARTHEST:
            finer = "mm" if unit in ("m", "cm") else "um"
            got = f"its median is {median:.5g} m if it is in {unit}"
            raise ValueError(f"{path}: {got}, farther than one sees: try --distance-unit {finer}")
    return torch.from_numpy(z)[None]


def _in_metres(values: Values, metres: float) -> NDArray[np.float32]:
    """Float32, rounded once; a large map is never held in double precision."""
    plain = values.dtype == np.float32 and values.dtype.isnative
    if plain and metres == 1 and values.flags.writeable:
        return np.ascontiguousarray(values)
    z = np.empty(values.shape, np.float32)
    for start, stop in bands(*values.shape):
        z[start:stop] = values[start:stop].astype(np.float64) * metres
    return z


def _counted(z: NDArray[np.float32]) -> tuple[int, int, int]:
    """How many distances are > 0; which of them are none of open water; which of those lie beyond
    what anybody sees.
    """
    counts = np.zeros(3, np.int64)
    for start, stop in bands(*z.shape):
        band = z[start:stop]
        positive, known = band > 0, (band > 0) & (band < _OPEN)
        counts += [positive.sum(), known.sum(), (known & (band > _FARTHEST)).sum()]
    return int(counts[0]), int(counts[1]), int(counts[2])


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
    raster = decoded(path)
    if raster.kind != "grey" or raster.values.dtype.kind not in "biuf":
        got = raster.kind if raster.kind != "grey" else f"numbers of type {raster.values.dtype}"
        cure = "save one channel of plain numbers"
        raise ValueError(f"{path}: expected {wanted} in one channel, got {got}: {cure}")
    return raster.values
