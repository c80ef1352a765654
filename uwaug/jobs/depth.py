"""From the numbers of a distance file to the map that a picture is degraded with."""

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from uwaug._support import checks
from uwaug.distance.convert import along_ray, from_disparity
from uwaug.distance.network import DepthNetwork
from uwaug.distance.sample import DistanceKind, as_unknown
from uwaug.formation.exposure import looks
from uwaug.io.pictures import Unit, metres_of, read_distance, read_numbers

__all__ = ["Depth", "Kind", "Mapped"]

Kind = Literal["metric", "relative", "inverse", "disparity"]

_FAR = 200.0
"""m: a median beyond is more likely in other units than in metres."""

_ASKEW = 0.02
"""Difference of two pictures' proportions, above which they are not of one view."""

_MANY = 0.2
"""Share of unknown pixels that is worth a note."""

_TURNED = "the picture was turned as its EXIF says; its map is taken as turned already"


class Mapped(NamedTuple):
    """A map of a picture.

    Attributes:
        values (1xHxW tensor): of the picture's size, of kind `Depth.map_kind`.
        notes: what is worth knowing of it.
    """

    values: Tensor
    notes: list[str]


@dataclass(frozen=True)
class Depth:
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
        if self._along_axis and self.focal_px is None:
            raise ValueError("focal_px is missing: disparity and planar depth need it, in px")
        if self.kind == "disparity" and self.baseline_m is None:
            raise ValueError("baseline_m is missing: disparity needs the cameras' distance, in m")
        self._require_use()
        if self.network is not None and self.kind != "inverse":
            raise ValueError(f"a depth network gives inverse depth, got kind {self.kind!r}")

    def _require_use(self) -> None:
        """Refuse options that would do nothing."""
        scaled, stereo = self.kind in ("relative", "inverse"), self.kind == "disparity"
        named = isinstance(self.unit, str) and self.unit != "m"
        no_unit = (scaled and self.unit != "m") or (stereo and named)
        idle = {
            "planar": (scaled and self.planar, "metric"),
            "baseline_m": (not stereo and self.baseline_m is not None, "disparity"),
            "offset_px": (not stereo and self.offset_px != 0, "disparity"),
            "distance_unit": (no_unit, "metric"),
        }
        for name, (wrong, wanted) in idle.items():
            if wrong:
                got = f"distance_kind is {self.kind!r}, not {wanted}"
                raise ValueError(f"{name} would do nothing: {got}")

    def require_constant(self) -> None:
        """Refuse options that say what files hold, where one number is the distance of all.

        Raises:
            ValueError: names the option.
        """
        told = {
            "distance_kind": self.kind != "metric",
            "distance_unit": self.unit != "m",
            "planar": self.planar,
        }
        for name, given in told.items():
            if given:
                got = "the distance is a number, which is metres along every ray"
                raise ValueError(f"{name} would do nothing: {got}")

    @property
    def _along_axis(self) -> bool:
        return self.planar or self.kind == "disparity"

    @property
    def map_kind(self) -> DistanceKind:
        """Of the maps that `read` gives."""
        return "metric" if self.kind == "disparity" else self.kind

    def read(self, where: Path | float | None, image: Tensor, *, turned: bool = False) -> Mapped:
        """The map of a picture.

        Args:
            where: its file; or metres along the ray, the same everywhere; or None, for the network.
            image (3xHxW tensor): uint8 or floating point.
            turned: whether it was turned as its EXIF says, see `uwaug.io.pictures.Source`.

        Raises:
            ValueError: if the file does not suit; names it.
            OSError: if it cannot be read.
        """
        size = (image.shape[-2], image.shape[-1])
        if where is None:
            if self.network is None:
                raise ValueError("no distances: give a file, metres, or a depth network")
            shown = image / 255 if image.dtype == torch.uint8 else image
            return Mapped(_network(self.network)(shown), [])
        if not isinstance(where, Path):
            if self.map_kind != "metric":
                cure = "give a file of that kind, or metres without distance_kind"
                raise ValueError(
                    f"distance={where:g} is metres, but distance_kind is {self.kind!r}: {cure}"
                )
            return Mapped(torch.full((1, *size), float(where)), [])
        values, notes = self._numbers(where), [_TURNED] * turned
        if tuple(values.shape[-2:]) != size:
            notes.append(f"distances of {_px(values)} px, resampled to {_px(image)}")
            wider = size[1] / values.shape[-1]
            values = _resized(where, values, size)
            if self.kind == "disparity":
                # they are px of the picture, as is the focal length
                values = values * wider
        values = self._along_rays(values)
        self._require_known(where, values)
        if self.kind in ("metric", "disparity"):
            notes += _doubts(values)
        return Mapped(values, notes)

    def _numbers(self, path: Path) -> Tensor:
        """What a file holds: metres of metric files, px of disparities, else numbers."""
        if self.kind == "metric":
            # what else may be done with unknown pixels needs no known ones
            return read_distance(path, self.unit, some_known=self.unknown in ("error", "fill"))
        numbers = read_numbers(path)
        scale = 1.0
        if self.kind == "disparity" and not isinstance(self.unit, str):
            scale = self.unit
        if self.kind == "relative" and numbers.dtype.kind in "bu":
            scale = 1.0 if numbers.dtype.kind == "b" else 1 / np.iinfo(numbers.dtype).max
        values = torch.from_numpy(numbers.astype(np.float32) * np.float32(scale))[None]
        if self.kind == "disparity":
            # with an offset, 0 would stand for a distance
            values = torch.where(values > 0, values, torch.nan)
        return values

    def _require_known(self, path: Path, values: Tensor) -> None:
        if self.unknown != "error":
            return
        known = values > 0 if self.map_kind == "metric" else ~values.isnan()
        if bool(known.all()):
            return
        what = "0, NaN or negative" if self.map_kind == "metric" else "NaN"
        got = f"{what} at {int((~known).sum())} of {known.numel()} pixels"
        cure = "say what they get by --unknown fill, skip, far or metres"
        raise ValueError(f"{path}: distances must be known, but are {got}: {cure}")

    def _along_rays(self, values: Tensor) -> Tensor:
        if not self._along_axis:
            return values
        assert self.focal_px is not None
        if self.kind == "disparity":
            assert self.baseline_m is not None
            values = from_disparity(values, self.focal_px, self.baseline_m, self.offset_px)
        return along_ray(values, self.focal_px)


def _resized(path: Path, values: Tensor, size: tuple[int, int]) -> Tensor:
    """Of another size, by the nearest pixel: the mean of two distances is that of no thing."""
    height, width = values.shape[-2:]
    if abs(math.log(width / height * size[0] / size[1])) > _ASKEW:
        cure = "they must be of one view; is one of them cropped, or turned as EXIF says?"
        raise ValueError(f"{path}: is {width}×{height} but the picture {size[1]}×{size[0]}: {cure}")
    return interpolate(values[None], size, mode="nearest-exact")[0]


def _px(picture: Tensor) -> str:
    return f"{picture.shape[-1]}×{picture.shape[-2]}"


def _doubts(z: Tensor) -> list[str]:
    """Of metres, by some pixels, spread over the map: all would take long."""
    notes = []
    z = z.flatten()[looks(z.shape[-2], z.shape[-1], z.device)]
    known = z > 0
    share = 1 - float(known.double().mean())
    if share > _MANY:
        notes.append(f"distance is unknown at {100 * share:.0f} % of the pixels")
    near = z[known & z.isfinite()]
    if near.numel() and (middle := float(near.median())) > _FAR:
        notes.append(f"median distance {middle:.0f} m: is the file in mm? See --distance-unit")
    return notes


@lru_cache(maxsize=1)
def _network(path: str) -> DepthNetwork:
    """Once in a process."""
    return DepthNetwork(path)
