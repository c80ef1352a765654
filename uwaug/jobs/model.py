"""What a recipe comes to: a random water, or one that is known, that pictures are degraded in."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from uwaug.colour import ColorSpace, from_light, require_values, to_light
from uwaug.contrast import contrast
from uwaug.degrade import exactly, in_strips, in_water
from uwaug.exposure import Exposure, exposed, looks
from uwaug.field import gaussian_random_field, gaussian_random_rows
from uwaug.formation import Combine, Order, form, plan_at_hand, prepare, separately, together
from uwaug.metres import DistanceKind, Scaling, metres_by_rows, skipped, to_metres
from uwaug.optics.medium import Medium
from uwaug.rows import bands
from uwaug.strips import Strips, in_rows, is_large
from uwaug.transforms import RandomUnderwater

__all__ = [
    "TERMS",
    "Degraded",
    "Model",
    "OneMedium",
    "RandomWater",
    "Seen",
    "contrast_of",
    "terms_of",
]

TERMS = ("direct", "forward", "backscatter")


class Seen(NamedTuple):
    """What a picture was formed of, see `uwaug.formation.prepare`.

    Attributes:
        light (1x3xHxW tensor): of the scene.
        z (1x1xHxW tensor): effective distance, m.
        medium: as the camera's exposure sees it.
        image (3xHxW tensor): as it was given.
        color_space: of its values.
        order, tolerance: as for `uwaug.form_image`.
    """

    light: Tensor
    z: Tensor
    medium: Medium
    image: Tensor
    color_space: ColorSpace
    order: Order = "line_of_sight"
    tolerance: float = 0.002

    def pictures(self, combine: Combine) -> tuple[Tensor, ...]:
        """What `combine` makes, `together` or `separately`, as pictures like the image."""
        plan = plan_at_hand(self.z, self.medium, self.tolerance, self.order)
        parts = form(self.light, self.z, self.medium, plan, self.order, combine)
        return tuple(from_light(part[0], self.color_space, self.image) for part in parts)

    def some(self) -> Tensor:
        """Effective distances of some pixels, spread over the picture (N)."""
        z = self.z[0, 0]
        return z.flatten()[looks(z.shape[0], z.shape[1], z.device)]


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
    seen: Seen | Strips | None
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
        settings = choice.settings
        with exactly(image):
            seen: Seen | Strips
            if is_large(image):
                seen, settled, gain = in_strips(image, mapped, choice)
            else:
                light, z, medium, settled, gain = in_water(image, mapped, choice)
                kept = settings.color_space, settings.order, settings.tolerance
                seen = Seen(light, z, medium, image, *kept)
            (picture,) = seen.pictures(together)
        used = settled.used(gain)
        record = {"samples": [{**sample, "used": used}]}
        return Degraded(picture, record, seen, settled.water.name, used["visibility"])


@dataclass(frozen=True, eq=False)
class OneMedium:
    """A medium that is known by its coefficients: that of a fit, or of a preset without spectra.

    Attributes:
        name: of the water.
        medium: a batch of one.
        color_space, exposure: as of `uwaug.Underwater`.
        field_range: least and largest value of the medium field; None for water without.
        kind, unknown, scaling: of the maps, see `uwaug.metres.to_metres`.
    """

    name: str
    medium: Medium
    color_space: ColorSpace
    exposure: Exposure
    field_range: tuple[float, float] | None
    kind: DistanceKind
    unknown: Any
    scaling: Scaling

    def draw(self, image: Tensor, generator: torch.Generator) -> dict[str, Any]:
        """As `Model.draw`."""
        if self.field_range is None:
            return {}
        return {"field_seed": int(torch.randint(2**32, (1,), generator=generator))}

    def degrade(self, image: Tensor, distance: Tensor, record: Mapping[str, Any]) -> Degraded:
        """As `Model.degrade`."""
        if skipped(distance, self.kind, self.unknown):
            return Degraded(image, dict(record), None, "none", None)
        with exactly(image):
            make = self._large if is_large(image) else self._whole
            seen = make(image, distance, record)
            (picture,) = seen.pictures(together)
        return Degraded(picture, dict(record), seen, self.name, None)

    def _whole(self, image: Tensor, distance: Tensor, record: Mapping[str, Any]) -> Seen:
        light = to_light(image.contiguous(), self.color_space)
        z = to_metres(distance.contiguous(), self.scaling, self.kind, self.unknown)
        field = None
        if self.field_range is not None:
            size = z.shape[-2:]
            field = gaussian_random_field(size, **self._field(record), dtype=z.dtype)
        light, z, medium = prepare(light, z, self.medium, field)
        medium = exposed(light, z, medium, self.exposure)
        return Seen(light, z, medium, image, self.color_space)

    def _large(self, image: Tensor, distance: Tensor, record: Mapping[str, Any]) -> Strips:
        require_values(image, self.color_space)
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


def contrast_of(seen: Seen | Strips) -> Tensor:
    """The share of contrast that is left at each pixel (1xHxW), see `uwaug.contrast`."""
    with exactly(seen.image):
        if isinstance(seen, Seen):
            return contrast(seen.medium, seen.z)[0]
        parts = []
        for start, stop in bands(*seen.size):
            parts.append(contrast(seen.medium, seen.z(start, stop)[None])[0])
        return torch.cat(parts, 1)


def terms_of(seen: Seen | Strips) -> dict[str, Tensor]:
    """Direct, forward-scattered and backscattered light, each as a picture like the image. In
    linear light they add up to the degraded picture.
    """
    with exactly(seen.image):
        return dict(zip(TERMS, seen.pictures(separately), strict=True))
