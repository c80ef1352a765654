"""What a recipe comes to: a random water, or one that is known, that pictures are degraded in."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from uwaug._support.types import ColorSpace
from uwaug.distance.sample import DistanceKind, Scaling, metres_of, skipped
from uwaug.formation.engine import path_of
from uwaug.formation.exposure import Exposure
from uwaug.formation.field import random_field
from uwaug.formation.loops.backend import path
from uwaug.formation.scene import Scene, Setup
from uwaug.light.geometry import focal_of
from uwaug.light.light import Light
from uwaug.optics.medium import Medium
from uwaug.transforms.prepare import InWater, deterministic
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
    seen: Scene | None
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

        def degraded(wet: InWater) -> Degraded:
            params = wet.resolved()
            record = {"samples": [params.to_dict()]}
            visibility = wet.water.visibility()
            return Degraded(wet.scene.picture(), record, wet.scene, wet.water.name, visibility)

        made = self.transform.in_water(image, distance, dict(record), degraded)
        if made:
            return made[0]
        (sample,) = record["samples"]
        return Degraded(image, {"samples": [{**sample, "applied": False}]}, None, "none", None)


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
        # the loops know daylight alone
        drawn = {"path": path() if self.light is None or self.light.plain else "eager"}
        if self.field_range is None:
            return drawn
        return {"field_seed": int(torch.randint(2**32, (1,), generator=generator)), **drawn}

    def degrade(self, image: Tensor, distance: Tensor, record: Mapping[str, Any]) -> Degraded:
        """As `Model.degrade`."""
        if skipped(distance, self.kind, self.unknown):
            return Degraded(image, dict(record), None, "none", None)
        with deterministic(image):
            scene = self._scene(image, distance, record)
            picture = scene.picture()
        record = {**record, "path": path_of(scene.engine)}
        return Degraded(picture, record, scene, self.name, None)

    def _scene(self, image: Tensor, distance: Tensor, record: Mapping[str, Any]) -> Scene:
        metres = metres_of(distance.contiguous(), self.scaling, self.kind, self.unknown)
        size, field = (image.shape[-2], image.shape[-1]), None
        if self.field_range is not None:
            like = metres if isinstance(metres, Tensor) else metres.like
            field = random_field(size, record["field_seed"], *self.field_range, like)
        setup = Setup(
            medium=self.medium,
            light=self.light,
            exposure=self.exposure,
            color_space=self.color_space,
            focal_px=focal_of(self.focal_px, size[1]),
        )
        return Scene.of(image, metres, setup, field, record.get("path"))


def terms_of(seen: Scene) -> dict[str, Tensor]:
    """Direct, forward-scattered and backscattered light, each as a picture like the image. In
    linear light they add up to the degraded picture.
    """
    with deterministic(seen.image):
        return seen.term_pictures()
