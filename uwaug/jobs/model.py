"""What a recipe comes to: a random water, or one that is known, that pictures are degraded in."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from uwaug._support.types import ColorSpace
from uwaug.distance.sample import DistanceKind, Scaling, metres_by_rows, skipped, to_metres
from uwaug.formation.colour import require_values
from uwaug.formation.exposure import Exposure, exposed_under
from uwaug.formation.field import gaussian_random_field, gaussian_random_rows
from uwaug.formation.loops.picture import to_light
from uwaug.formation.loops.switch import path
from uwaug.formation.model import prepare, separately, together
from uwaug.formation.strips import Strips, in_rows, is_large, require_daylight
from uwaug.light.geometry import focal_of
from uwaug.light.light import Light
from uwaug.light.lit import lit_of
from uwaug.optics.medium import Medium
from uwaug.transforms.prepare import Whole, exactly, in_water
from uwaug.transforms.random_underwater import RandomUnderwater

__all__ = [
    "TERMS",
    "Degraded",
    "Model",
    "OneMedium",
    "RandomWater",
    "terms_of",
]

TERMS = ("direct", "forward", "backscatter")


class Degraded(NamedTuple):
    """A degraded picture.

    Attributes:
        image: like the picture that it was made of.
        record: all that is random, and what it came to; JSON can hold it.
        seen: what it was formed of; None if it was left as it is.
        water: the name of its water.
        visibility: of that water, m; None if it is not known.
    """

    image: Tensor
    record: dict[str, Any]
    seen: Whole | Strips | None
    water: str
    visibility: float | None


class Model(Protocol):
    """What degrades pictures."""

    @property
    def color_space(self) -> ColorSpace:
        """Of the pictures."""
        ...

    def draw(self, image: Tensor, generator: torch.Generator) -> dict[str, Any]:
        """All that is random, for one picture."""
        ...

    def degrade(self, image: Tensor, distance: Tensor, record: Mapping[str, Any]) -> Degraded:
        """Degrade a picture (3xHxW) with its map (1xHxW) as a record says."""
        ...


@dataclass(frozen=True, eq=False)
class RandomWater:
    """A water of its own for each picture."""

    transform: RandomUnderwater

    @property
    def color_space(self) -> ColorSpace:
        """Of the pictures."""
        return self.transform.color_space

    def draw(self, image: Tensor, generator: torch.Generator) -> dict[str, Any]:
        """As `Model.draw`."""
        return self.transform.make_params(image, generator)

    def degrade(self, image: Tensor, distance: Tensor, record: Mapping[str, Any]) -> Degraded:
        """As `Model.degrade`, bit for bit what the transform makes of the same record."""
        (sample,) = record["samples"]
        jobs = self.transform.jobs(image, distance, dict(record))
        if not jobs:
            return Degraded(image, {"samples": [{**sample, "applied": False}]}, None, "none", None)
        ((_, mapped, _),) = jobs
        choice = self.transform.chosen(sample)
        with exactly(image):
            found = in_water(image, mapped, choice)
            (picture,) = found.seen.pictures(together)
        used = found.used()
        record = {"samples": [{**sample, "used": used}]}
        return Degraded(picture, record, found.seen, found.settled.water.name, used["visibility"])


@dataclass(frozen=True, eq=False)
class OneMedium:
    """A medium that is known by its coefficients: that of a fit, or of a preset without spectra.

    Attributes:
        name: of the water.
        medium: a batch of one.
        color_space, exposure: as of `uwaug.Underwater`.
        field_range: least and largest value of the medium field; None for water without.
        kind, unknown, scaling: of the maps, see `uwaug.distance.sample.to_metres`.
        light, focal_px: as of `uwaug.Underwater`; by default the view is 60° wide.
    """

    name: str
    medium: Medium
    color_space: ColorSpace
    exposure: Exposure
    field_range: tuple[float, float] | None
    kind: DistanceKind
    unknown: Any
    scaling: Scaling
    light: Light | None = None
    focal_px: float | None = None

    def draw(self, image: Tensor, generator: torch.Generator) -> dict[str, Any]:
        """As `Model.draw`."""
        if self.field_range is None:
            return {"path": path()}
        seed = int(torch.randint(2**32, (1,), generator=generator))
        return {"field_seed": seed, "path": path()}

    def degrade(self, image: Tensor, distance: Tensor, record: Mapping[str, Any]) -> Degraded:
        """As `Model.degrade`."""
        if skipped(distance, self.kind, self.unknown):
            return Degraded(image, dict(record), None, "none", None)
        with exactly(image):
            make = self._large if is_large(image) else self._whole
            seen = make(image, distance, record)
            (picture,) = seen.pictures(together)
        return Degraded(picture, dict(record), seen, self.name, None)

    def _whole(self, image: Tensor, distance: Tensor, record: Mapping[str, Any]) -> Whole:
        wanted = record.get("path")
        light = to_light(image.contiguous(), self.color_space, wanted)
        z = to_metres(distance.contiguous(), self.scaling, self.kind, self.unknown)
        field = None
        if self.field_range is not None:
            size = z.shape[-2:]
            field = gaussian_random_field(size, **self._field(record), dtype=z.dtype)
        metres, focal_px = z, focal_of(self.focal_px, image.shape[-1])
        light, z, medium = prepare(light, z, self.medium, field)
        lit = lit_of(self.light, metres, field, medium, focal_px, None)
        medium, lit = exposed_under(light, z, medium, self.exposure, lit, wanted)
        return Whole(image, self.color_space, light, z, medium, lit=lit, path=wanted)

    def _large(self, image: Tensor, distance: Tensor, record: Mapping[str, Any]) -> Strips:
        require_values(image, self.color_space)
        require_daylight(self.light)
        z = metres_by_rows(distance.contiguous(), self.scaling, self.kind, self.unknown)
        field = None
        if self.field_range is not None:
            size = (image.shape[-2], image.shape[-1])
            field = gaussian_random_rows(size, **self._field(record))
        found = in_rows(image, z, self.medium, field, self.color_space)
        return found.brightened(found.gain_of(self.exposure))

    def _field(self, record: Mapping[str, Any]) -> dict[str, Any]:
        """Which field is drawn."""
        assert self.field_range is not None
        low, high = self.field_range
        generator = torch.Generator().manual_seed(record["field_seed"])
        return {"low": low, "high": high, "generator": generator}


def terms_of(seen: Whole | Strips) -> dict[str, Tensor]:
    """Direct, forward-scattered and backscattered light, each as a picture like the image. In
    linear light they add up to the degraded picture.
    """
    with exactly(seen.image):
        return dict(zip(TERMS, seen.pictures(separately), strict=True))
