"""What a recipe comes to: a random water, or one that is known, that pictures are degraded in."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from uwaug.colour import ColorSpace, from_light, to_light
from uwaug.degrade import exactly, formed, in_water
from uwaug.exposure import Exposure, exposed
from uwaug.field import gaussian_random_field
from uwaug.formation import Order, form, plan_at_hand, prepare, separately, together
from uwaug.metres import DistanceKind, Scaling, skipped, to_metres
from uwaug.optics.medium import Medium
from uwaug.transforms import RandomUnderwater

__all__ = ["TERMS", "Degraded", "Model", "OneMedium", "RandomWater", "Seen", "terms_of"]

TERMS = ("direct", "forward", "backscatter")


class Seen(NamedTuple):
    """What a picture was formed of, see `uwaug.formation.prepare`.

    Attributes:
        light (1x3xHxW tensor): of the scene.
        z (1x1xHxW tensor): effective distance, m.
        medium: as the camera's exposure sees it.
        order, tolerance: as for `uwaug.form_image`.
    """

    light: Tensor
    z: Tensor
    medium: Medium
    order: Order = "line_of_sight"
    tolerance: float = 0.002


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
    seen: Seen | None
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
        ((_, z, _),) = jobs
        choice = self.transform.chosen(sample)
        settings = choice.settings
        with exactly(image):
            found = in_water(image, z, choice)
            picture = formed(found, image, settings)
        used = found.used()
        seen = Seen(found.light, found.z, found.medium, settings.order, settings.tolerance)
        record = {"samples": [{**sample, "used": used}]}
        return Degraded(picture, record, seen, found.water.name, used["visibility"])


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
            light = to_light(image.contiguous(), self.color_space)
            z = to_metres(distance.contiguous(), self.scaling, self.kind, self.unknown)
            light, z, medium = prepare(light, z, self.medium, self._field(z, record))
            medium = exposed(light, z, medium, self.exposure)
            seen = Seen(light, z, medium)
            plan = plan_at_hand(z, medium, seen.tolerance, seen.order)
            (result,) = form(light, z, medium, plan, seen.order, together)
            picture = from_light(result[0], self.color_space, image)
        return Degraded(picture, dict(record), seen, self.name, None)

    def _field(self, z: Tensor, record: Mapping[str, Any]) -> Tensor | None:
        if self.field_range is None:
            return None
        low, high = self.field_range
        generator = torch.Generator().manual_seed(record["field_seed"])
        size = z.shape[-2:]
        return gaussian_random_field(size, low=low, high=high, generator=generator, dtype=z.dtype)


def terms_of(seen: Seen, image: Tensor, color_space: ColorSpace) -> dict[str, Tensor]:
    """Direct, forward-scattered and backscattered light, each as a picture like `image`. In linear
    light they add up to the degraded picture.
    """
    with exactly(image):
        plan = plan_at_hand(seen.z, seen.medium, seen.tolerance, seen.order)
        parts = form(seen.light, seen.z, seen.medium, plan, seen.order, separately)
        found = {}
        for name, part in zip(TERMS, parts, strict=True):
            found[name] = from_light(part[0], color_space, image)
        return found
