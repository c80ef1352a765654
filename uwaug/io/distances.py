"""Distance maps and masks in files, and what their numbers mean."""

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import interpolate

from uwaug._support import checks
from uwaug._support.tiles import row_bands
from uwaug.distance.convert import along_ray, from_disparity
from uwaug.distance.sample import DistanceKind, Scaling, as_unknown, whole_metres
from uwaug.io.read import GREY, File, Values, decode, name_of

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "um": 1e-6}
"""What distances may be written in, m."""

Unit = str | float
"""Of distances: "m", "cm", "mm", "um", or how many metres 1 stands for."""

Kind = Literal["metric", "relative", "inverse", "disparity"]

_FAR = 200.0
"""m: a median beyond is more likely in other units than in metres."""

_NEAR = 0.05
"""m: a median below is more likely in other units, too."""

_ASKEW = 0.02
"""Difference of two pictures' proportions, above which they are not of one view."""

_MANY = 0.2
"""Share of unknown pixels that is worth a note."""

_DONE = {
    "behind": "filled with what is behind",
    "fill": "filled with what is around",
    "skip": "filled with what is around",
    "far": "taken for open water",
    "error": "an error where they are needed",
}
"""What becomes of unknown pixels, in words."""

_LOOKS = 128
"""Rows, and columns, that notes of a map are taken from."""

_TURNED = "the picture was turned as its EXIF says; its map is taken as turned already"


@dataclass(frozen=True)
class DistanceFormat:
    """What distance files hold.

    Attributes:
        kind: "metric"; "relative" (0…1, 0 = near; whole numbers are taken as shares of the largest
            that their type holds); "inverse" (near = large, of any scale, as depth networks give
            it); "disparity" (px, of a rectified stereo pair).
        unit: of metric files: "m", "cm", "mm", "um", or metres for each count. Of disparities: px
            for each count.
        focal_px: focal length of the picture, px, for disparity and planar depth.
        baseline_m: between the two cameras, m, for disparity.
        offset_px: difference of their principal points, px of the picture, see
            `uwaug.distance.from_disparity`. A disparity of 0 or less is unknown all the same.
        planar: whether metric files hold depth along the optical axis. Disparity always does.
        unknown: what NaN and 0 get, see `RandomUnderwater`.
        network: path of a depth network, in place of files. See `uwaug.distance.DepthNetwork`.

    Raises:
        ValueError: if a value is none, one that the kind needs is missing, or one that is given
            would do nothing.
    """

    kind: Kind = "metric"
    unit: Unit = "m"
    focal_px: float | None = None
    baseline_m: float | None = None
    offset_px: float = 0.0
    planar: bool = False
    unknown: Any = "error"
    network: str | None = None

    def __post_init__(self) -> None:
        checks.one_of("distance_kind", self.kind, get_args(Kind))
        as_unknown(self.unknown)
        metres_of(self.unit, "distance_unit")
        for name in ("focal_px", "baseline_m"):
            value = getattr(self, name)
            if value is not None:
                checks.positive(name, value)
        scaled, stereo = self.kind in ("relative", "inverse"), self.kind == "disparity"
        if self.focal_px is None and (stereo or (self.planar and not scaled)):
            raise ValueError("focal_px is missing: disparity and planar depth need it, in px")
        if stereo and self.baseline_m is None:
            raise ValueError("baseline_m is missing: disparity needs the cameras' distance, in m")
        named_unit = isinstance(self.unit, str) and self.unit != "m"
        idle = {
            "planar": (scaled and self.planar, "metric"),
            "baseline_m": (not stereo and self.baseline_m is not None, "disparity"),
            "offset_px": (not stereo and self.offset_px != 0, "disparity"),
            "distance_unit": ((scaled and self.unit != "m") or (stereo and named_unit), "metric"),
        }
        for name, (is_idle, kind) in idle.items():
            if is_idle:
                got = f"distance_kind is {self.kind!r}, not {kind}"
                raise ValueError(f"{name} would do nothing: {got}")
        if self.network is not None and self.kind != "inverse":
            raise ValueError(f"a depth network gives inverse depth, got kind {self.kind!r}")

    @property
    def map_kind(self) -> DistanceKind:
        """Of the maps that `read` gives."""
        return "metric" if self.kind == "disparity" else self.kind

    def require_constant(self) -> None:
        """Refuse options that say what files hold, where one number is the distance of all.

        Raises:
            ValueError: names the option.
        """
        said = {
            "distance_kind": self.kind != "metric",
            "distance_unit": self.unit != "m",
            "planar": self.planar,
        }
        for name, is_said in said.items():
            if is_said:
                got = "the distance is a number, which is metres along every ray"
                raise ValueError(f"{name} would do nothing: {got}")

    def metres(
        self,
        place: File | float,
        size: tuple[int, int],
        *,
        near: float | None = None,
        far: float | None = None,
        gamma: float | None = None,
        turned: bool = False,
    ) -> tuple[Tensor, list[str]]:
        """The distances of a picture, with what is worth knowing of them.

        Args:
            place: a file, as for `read`; or metres, for all pixels.
            size: height and width of the picture, px.
            near, far: m, of relative and inverse distances, which need them.
            gamma: exponent of relative distances; None for 1.
            turned: as for `read`.

        Returns:
            1xHxW, float32, m along the ray; what is unknown as `unknown` says, but for "fill",
            "behind" and "skip", which leave it 0 or NaN. And notes.

        Raises:
            ValueError: if the file does not suit, or an option is missing or would do nothing.
            OSError: if the file cannot be read.
        """
        scaled = {"near": self.map_kind != "metric", "far": self.map_kind != "metric"}
        scaled["gamma"] = self.map_kind == "relative"
        for name, value in {"near": near, "far": far, "gamma": gamma}.items():
            if value is not None and not scaled[name]:
                raise ValueError(f"{name} would do nothing: distance_kind is {self.kind!r}")
            if value is None and scaled[name] and name != "gamma":
                raise ValueError(f"{name} is missing: {self.kind} distances need it, in m")
        if isinstance(place, (int, float)):
            self.require_constant()
            checks.positive("distance", place, "m")
            return torch.full((1, *size), float(place)), []
        values, notes = self._of_picture(place, size, turned)
        if self.unknown not in ("fill", "behind", "skip"):  # who fills holes says so
            notes += self._holes(values)
        # metric maps have no scale
        scaling = Scaling(near or 0.0, far or 0.0, 1.0 if gamma is None else gamma)
        try:
            z = whole_metres(values, scaling, self.map_kind, as_unknown(self.unknown))
        except ValueError as error:
            raise ValueError(f"{name_of(place)}: {error}") from error
        return z, notes

    def read(
        self, file: File, size: tuple[int, int], *, turned: bool = False
    ) -> tuple[Tensor, list[str]]:
        """Read the map of a picture, with what is worth knowing of it.

        Args:
            file: as for `read_distance`; relative and inverse maps of 8 bits too.
            size: height and width of the picture, px.
            turned: whether it was turned as its EXIF says, see `uwaug.io.PictureFile`.

        Returns:
            The map (1xHxW, float32) of the picture's size and of `map_kind`, unknown pixels 0 or
            NaN; and notes.

        Raises:
            ValueError: if the file does not suit; names it.
            OSError: if it cannot be read.
        """
        values, notes = self._of_picture(file, size, turned)
        return values, notes + self._holes(values)

    def _of_picture(
        self, file: File, size: tuple[int, int], turned: bool
    ) -> tuple[Tensor, list[str]]:
        """As `read`, without a note of holes."""
        notes = [_TURNED] if turned else []
        values = torch.from_numpy(self._numbers(file))[None]
        height, width = values.shape[-2:]
        if (height, width) != size:
            if abs(math.log(width / height * size[0] / size[1])) > _ASKEW:
                got = f"is {width}×{height} but the picture {size[1]}×{size[0]}"
                cure = "they must be of one view; is one of them cropped, or turned as EXIF says?"
                raise ValueError(f"{name_of(file)}: {got}: {cure}")
            notes.append(f"distances of {width}×{height} px, resampled to {size[1]}×{size[0]}")
            # by the nearest pixel: the mean of two distances is that of no thing
            values = interpolate(values[None], size, mode="nearest-exact")[0]
            if self.kind == "disparity":
                # they are px of the picture, as is the focal length
                values = values * (size[1] / width)
        if self.kind == "disparity":
            assert self.focal_px is not None
            assert self.baseline_m is not None
            values = from_disparity(values, self.focal_px, self.baseline_m, self.offset_px)
        if self.kind == "disparity" or self.planar:
            assert self.focal_px is not None
            values = along_ray(values, self.focal_px)
        if self.map_kind == "metric":
            notes += _doubts(values)
        return values, notes

    def _holes(self, z: Tensor) -> list[str]:
        """A note of a map in metres that has many holes: what becomes of them."""
        if self.map_kind != "metric":
            return []
        share = 1 - float((_some(z) > 0).double().mean())
        if share <= _MANY:
            return []
        done = _DONE.get(self.unknown, f"taken for {self.unknown} m")
        return [f"{100 * share:.0f} % of the distances are unknown: {done}"]

    def survey(self, file: File) -> tuple[float | None, float]:
        """What a map makes one ask, without reading it as the picture's.

        Returns:
            The median of a metric map, m, if it lies farther than one sees; and the share of its
            pixels that are unknown.

        Raises:
            ValueError, OSError: as of `read`, but for a wrong unit.
        """
        if self.kind != "metric":
            unknown = np.isnan(self._numbers(file))
            return None, float(unknown.mean())
        z = torch.from_numpy(_scaled(file, self.unit))
        return checks.too_far(z), float((~(z > 0)).double().mean())

    def _numbers(self, file: File) -> NDArray[np.float32]:
        """What a file holds (HxW): metres of metric files, px of disparities, else numbers."""
        if self.kind == "metric":
            return _metres(file, self.unit)
        numbers = _one_channel(file, "distances")
        scale = 1.0
        if self.kind == "disparity" and not isinstance(self.unit, str):
            scale = self.unit
        if self.kind == "relative" and numbers.dtype.kind in "bu":
            scale = 1.0 if numbers.dtype.kind == "b" else 1 / np.iinfo(numbers.dtype).max
        values = numbers.astype(np.float32) * np.float32(scale)
        if self.kind == "disparity":
            # with an offset, 0 would stand for a distance
            values[~(values > 0)] = np.nan
        return values


def metres_of(unit: Unit, name: str = "unit") -> float:
    """Metres of a unit; `name` is what it is called where it is wrong."""
    if isinstance(unit, str):
        checks.one_of(name, unit, (*UNITS, "a number of metres"))
        return UNITS[unit]
    checks.positive(name, unit, "m")
    return float(unit)


def read_distance(file: File, unit: Unit = "m") -> Tensor:
    """Read a map of distances.

    Args:
        file: .npy, or .npz of one array (HxW, 1xHxW or HxWx1); TIFF (its first page) or PNG of one
            channel, 16 bit or floating point; PFM; or OpenEXR of one channel, or with one called Z.
        unit: of the numbers in the file: "m", "cm", "mm" or "um"; or how many metres 1 stands for.

    Returns:
        1xHxW, float32, m. 0 and NaN, which stand for unknown, and +inf stay.

    Raises:
        ValueError: if it holds colours or 8 bits, which are no distances; if no pixel's is known;
            if its median lies beyond 1000 m; or if it cannot be decoded. Names the file.
        OSError: if there is no such file, or it cannot be read.
    """
    z = _metres(file, unit)
    if not (z > 0).any():
        expected = "expected metres, 0 where unknown"
        raise ValueError(f"{name_of(file)}: no pixel has a distance > 0: {expected}")
    return torch.from_numpy(z)[None]


def read_mask(file: File) -> Tensor:
    """Read a mask, from files of one channel as `read_distance`, of 8 bits or 1 bit too.

    Returns:
        1xHxW, bool: true where the file is > 0.

    Raises:
        ValueError: if it holds colours, or cannot be decoded; names the file.
        OSError: if there is no such file, or it cannot be read.
    """
    return torch.from_numpy(_one_channel(file, "a mask") > 0)[None]


def _metres(file: File, unit: Unit) -> NDArray[np.float32]:
    """The distances of a file (HxW), m, if they are such as can be seen."""
    z = _scaled(file, unit)
    require_in_sight(name_of(file), torch.from_numpy(z), unit)
    return z


def finer_unit(unit: Unit) -> str:
    """The unit to try where distances are farther than one sees."""
    return "mm" if unit in ("m", "cm") else "um"


def _scaled(file: File, unit: Unit) -> NDArray[np.float32]:
    """The distances of a file (HxW), m."""
    scale = metres_of(unit)
    values = _one_channel(file, "distances")
    if values.dtype.itemsize == 1:
        got = f"expected 16 bit or floating point, got {values.dtype}"
        cure = "relative depth? Make metres of it with uwaug.distance and save them as .npy"
        raise ValueError(f"{name_of(file)}: {got}: {cure}")
    native = values.dtype == np.float32 and values.dtype.isnative
    if native and scale == 1 and values.flags.writeable:
        z: NDArray[np.float32] = np.ascontiguousarray(values)
    else:
        # rounded once; a large map is never held in double precision
        z = np.empty(values.shape, np.float32)
        for start, stop in row_bands(*values.shape):
            z[start:stop] = values[start:stop].astype(np.float64) * scale
    return z


def require_in_sight(name: str, z: Tensor, unit: Unit) -> None:
    """Refuse a map (m) whose median lies farther than one sees: it is in another unit.

    Args:
        name: of the map, for the message.
        z: m, as read in `unit`.
        unit: that its numbers were taken to be in.
    """
    median = checks.too_far(z)
    if median is not None:
        got = f"its median is {median:.5g} m if it is in {unit}, farther than one sees"
        raise ValueError(f"{name}: {got}: try unit={finer_unit(unit)!r}")


def _one_channel(file: File, expected: str) -> Values:
    """The HxW numbers of a file."""
    raster = decode(file)
    if raster.kind != GREY or raster.values.dtype.kind not in "biuf":
        got = raster.kind if raster.kind != GREY else f"numbers of type {raster.values.dtype}"
        cure = "save one channel of plain numbers"
        raise ValueError(f"{name_of(file)}: expected {expected} in one channel, got {got}: {cure}")
    return raster.values


def _doubts(z: Tensor) -> list[str]:
    """Notes of a map in metres whose unit is doubtful, by some of its pixels: all would take
    long.
    """
    z = _some(z)
    near = z[(z > 0) & z.isfinite()]
    median = float(near.median()) if near.numel() else _NEAR
    if _NEAR <= median <= _FAR:
        return []
    return [f"median distance {median:.3g} m: is the file in another unit?"]


def _some(z: Tensor) -> Tensor:
    """Pixels of a map, spread over it."""
    rows, columns = (max(1, side // _LOOKS) for side in z.shape[-2:])
    return z[..., ::rows, ::columns]
