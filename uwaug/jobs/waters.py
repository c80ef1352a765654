"""The water of a recipe: one that is drawn for each picture, or one that is known."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from uwaug.distance.sample import DistanceKind, Scaling, Unknown, skipped, to_metres
from uwaug.formation.engine import recorded_engine
from uwaug.formation.field import random_field
from uwaug.formation.loops.backend import RecordedEngine, path
from uwaug.formation.scene import Scene
from uwaug.formation.setup import Setup
from uwaug.light.geometry import focal_of
from uwaug.transforms.prepare import InWater as Wet
from uwaug.transforms.prepare import deterministic
from uwaug.transforms.random_underwater import RandomUnderwater

LEFT = "none"
"""In place of a water's name, of a picture that is left as it is."""


class InWater(NamedTuple):
    """A picture in its water.

    Attributes:
        image: like the picture that it was made of.
        drawn: all that is random, and what it came to; JSON can hold it.
        scene: what it was formed of; None if it was left as it is.
        water: the name of its water.
        visibility: of that water, m; None if it is not known.
    """

    image: Tensor
    drawn: dict[str, Any]
    scene: Scene | None
    water: str
    visibility: float | None


class Waters(Protocol):
    """Where pictures get their water."""

    @property
    def varies(self) -> bool:
        """Whether pictures of two keys may come out differently."""
        ...

    def degrade(
        self, image: Tensor, distance: Tensor | None, drawn: Mapping[str, Any] | None, key: int
    ) -> InWater:
        """Degrade a picture.

        Args:
            image (3xHxW tensor): uint8 or floating point.
            distance (1xHxW tensor): of the kind that the recipe says; None if it is drawn.
            drawn: what a sidecar holds; None to draw it from `key`.
            key: of all that is random.

        Raises:
            ValueError: if image or distance do not suit.
        """
        ...


@dataclass(frozen=True, eq=False)
class DrawnWaters:
    """A water of its own for each picture, bit for bit as by the transform."""

    transform: RandomUnderwater

    @property
    def varies(self) -> bool:
        """As of `Waters`."""
        return self.transform.varies

    def degrade(
        self, image: Tensor, distance: Tensor | None, drawn: Mapping[str, Any] | None, key: int
    ) -> InWater:
        """As of `Waters`."""
        generator = torch.Generator().manual_seed(key)
        record = self.transform.make_params(image, generator) if drawn is None else dict(drawn)

        def seen(wet: Wet) -> InWater:
            params = wet.resolved().to_dict()
            if drawn is not None:
                params["path"] = _engine_of(wet.scene, drawn["samples"][0])
            visibility = wet.water.visibility()
            picture = wet.scene.picture()
            return InWater(picture, {"samples": [params]}, wet.scene, wet.water.name, visibility)

        by_place = self.transform.in_water(image, distance, record, seen)
        if by_place:
            return by_place[0]
        record = self.transform.resolve(image, distance, record)
        return InWater(image, record, None, LEFT, None)


@dataclass(frozen=True, eq=False)
class KnownWater:
    """A medium that is known by its coefficients: that of a fit, or of a preset without spectra.

    Attributes:
        name: of the water.
        setup: what pictures are taken with; by default the view is 60° wide.
        field_range: least and largest value of the medium field; None for water without.
        kind, unknown, scaling: of the maps, see `uwaug.distance.sample.to_metres`.
    """

    name: str
    setup: Setup
    field_range: tuple[float, float] | None
    kind: DistanceKind
    unknown: Unknown
    scaling: Scaling

    @property
    def varies(self) -> bool:
        """As of `Waters`."""
        return self.field_range is not None

    def degrade(
        self, image: Tensor, distance: Tensor | None, drawn: Mapping[str, Any] | None, key: int
    ) -> InWater:
        """As of `Waters`."""
        assert distance is not None  # nothing is drawn
        if drawn is None:
            drawn = {}
            if self.field_range is not None:
                generator = torch.Generator().manual_seed(key)
                drawn["field_seed"] = int(torch.randint(2**32, (1,), generator=generator))
        if skipped(distance, self.kind, self.unknown):
            return InWater(image, dict(drawn), None, LEFT, None)
        size, field = (image.shape[-2], image.shape[-1]), None
        setup = replace(self.setup, focal_px=focal_of(self.setup.focal_px, size[1]))
        with deterministic(image):
            metres = to_metres(distance.contiguous(), self.scaling, self.kind, self.unknown)
            if self.field_range is not None:
                like = metres if isinstance(metres, Tensor) else metres.like
                field = random_field(size, drawn["field_seed"], *self.field_range, like)
            scene = Scene.of(image, metres, setup, field, drawn.get("path"))
            picture = scene.picture()
        record = {**drawn, "path": _engine_of(scene, drawn)}
        return InWater(picture, record, scene, self.name, None)


def _engine_of(scene: Scene, recorded: Mapping[str, Any]) -> RecordedEngine:
    """What has formed a scene, as its record says it; `recorded`: what an earlier record says."""
    if recorded.get("path") == "fused" and path() == "fused":
        # older records call fused what had only its sRGB decoded by the loops
        return "fused"
    return recorded_engine(scene.engine)
