"""One picture in one random water: what `RandomUnderwater` does once it has drawn."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug.camera import Camera
from uwaug.colour import ColorSpace, from_light, to_light
from uwaug.distance import check_distance, from_inverse, from_relative
from uwaug.field import gaussian_random_field
from uwaug.formation import Order, form, plan_at_hand, prepare, together
from uwaug.medium import Medium, PointSpread
from uwaug.water import Water

__all__ = ["Draw", "Settings", "degrade"]

DistanceKind = Literal["metric", "relative", "inverse"]
Unknown = Literal["error", "fill"]

_TOUCHING = 1e-6
"""m, for relative distance 0 with near = 0: in a map of metres 0 means unknown."""


class Draw(NamedTuple):
    """What is drawn for a picture, beside its waters and its camera; see `RandomUnderwater`.

    None: this picture's water is not scaled to a visibility, or is even. NaN: nothing asks for it.
    """

    mixing: float
    visibility: float | None
    vertical_depth: float
    g: float
    mu: float
    blur_factor: float
    near: float
    far: float
    gamma: float
    distance: float
    field_seed: float | None
    field_low: float
    field_high: float

    @staticmethod
    def of(sample: Mapping[str, Any]) -> "Draw":
        """From a sample of a record."""
        low, high = sample["field_range"]
        drawn = {name: sample.get(name, math.nan) for name in Draw._fields[:10]}
        drawn["visibility"] = sample.get("visibility")
        return Draw(**drawn, field_seed=sample["field_seed"], field_low=low, field_high=high)

    def to_tensor(self) -> Tensor:
        """As numbers, for an operator that takes no objects; NaN stands for None."""
        one = torch.ones((), dtype=torch.float64)
        # torch.tensor(…) would fix them in a graph
        return torch.stack([one * (math.nan if value is None else value) for value in self])

    @staticmethod
    def from_tensor(values: Tensor) -> "Draw":
        """The inverse of `to_tensor`."""
        draw = Draw(*values.tolist())
        visibility, seed = (None if math.isnan(v) else v for v in (values[1].item(), values[10].item()))
        return draw._replace(visibility=visibility, field_seed=seed)


@dataclass(frozen=True)
class Settings:
    """What is the same for all pictures. See `RandomUnderwater`."""

    distance_kind: DistanceKind
    unknown: Unknown
    color_space: ColorSpace
    order: Order
    point_spread: PointSpread
    tolerance: float

    def to_json(self) -> str:
        """As text, for an operator that takes no objects."""
        return json.dumps(asdict(self))

    @staticmethod
    def from_json(text: str) -> "Settings":
        """The inverse of `to_json`."""
        values = json.loads(text)
        return Settings(**{**values, "point_spread": PointSpread(**values["point_spread"])})


def degrade(
    image: Tensor,
    distance: Tensor | None,
    waters: Sequence[Water],
    camera: Camera,
    draw: Draw,
    settings: Settings,
) -> Tensor:
    """Degrade a picture.

    Args:
        image (3xHxW tensor): uint8 or floating point.
        distance (1xHxW tensor): of `settings.distance_kind`; None for a plane at `draw.distance`.
        waters: one, or two to be mixed.
        camera: response of the three channels.
        draw: what was drawn.
        settings: what is set.

    Returns:
        The picture, like `image`.
    """
    with _one_thread(), torch.no_grad(), torch.autocast(image.device.type, enabled=False):
        light = to_light(image, settings.color_space)
        if distance is None:
            z = torch.full_like(light[:1], draw.distance)
        else:
            z = _metres(distance, draw, settings)
        law = settings.point_spread
        law = PointSpread(law.scale * draw.blur_factor, law.exponent, law.shape, law.reference_size)
        medium = _medium(tuple(waters), camera, draw[:5], law, settings.tolerance)
        light, z, medium = prepare(light, z, medium, _field(draw, z))
        size = (image.shape[-2], image.shape[-1])
        plan = plan_at_hand(z, medium, size, settings.tolerance, settings.order)
        (result,) = form(light, z, medium, plan, settings.order, together)
        return from_light(result[0], settings.color_space, image.dtype)


def _metres(distance: Tensor, draw: Draw, settings: Settings) -> Tensor:
    if settings.distance_kind == "relative":
        distance = from_relative(distance, max(draw.near, _TOUCHING), draw.far, draw.gamma)
    elif settings.distance_kind == "inverse":
        distance = from_inverse(distance, draw.near, draw.far)
    strict = settings.unknown == "error"
    try:
        return check_distance(distance, strict=strict)
    except ValueError as error:
        hint = "; or use RandomUnderwater(unknown='fill')" if strict else ""
        raise ValueError(f"{error}{hint}") from None


def _field(draw: Draw, z: Tensor) -> Tensor | None:
    if draw.field_seed is None:
        return None
    generator = torch.Generator().manual_seed(int(draw.field_seed))
    field = gaussian_random_field(z.shape[-2:], low=draw.field_low, high=draw.field_high, generator=generator)
    return field.to(z.device)


@lru_cache(maxsize=256)
def _medium(
    waters: tuple[Water, ...], camera: Camera, drawn: tuple[Any, ...], law: PointSpread, tolerance: float
) -> Medium:
    mixing, visibility, vertical_depth, g, mu = drawn
    water = waters[0].mix(waters[1], mixing) if len(waters) > 1 else waters[0]
    if visibility is not None:
        water = water.with_visibility(visibility)
    return Medium.from_water(
        water, camera, vertical_depth=vertical_depth, g=g, mu=mu, point_spread=law, tolerance=tolerance
    )


@contextmanager
def _one_thread() -> Iterator[None]:
    """Run on one thread, as a DataLoader worker does, so that records replay bit for bit: the split between threads
    decides which elements take the scalar path, where exp2 and pow differ in the last bit.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def spectra_table(*columns: Any) -> Tensor:
    """Wavelengths and what belongs to them, for `degrade_opaque`."""
    return torch.from_numpy(np.array(columns))


@torch.library.custom_op(
    "uwaug::random_underwater",
    mutates_args=(),
    schema="(Tensor image, Tensor? distance, Tensor[] waters, Tensor camera, Tensor draw, str settings) -> Tensor",
)
def degrade_opaque(
    image: Tensor, distance: Tensor | None, waters: list[Tensor], camera: Tensor, draw: Tensor, settings: str
) -> Tensor:
    """`degrade` for compiled code. What is drawn comes as a tensor, or a graph would hold for one record alone."""
    spectra = [Water(*table.numpy()) for table in waters]
    wavelengths, *response = camera.numpy()
    lens = Camera(wavelengths, np.array(response).T)
    return degrade(image, distance, spectra, lens, Draw.from_tensor(draw), Settings.from_json(settings))


@degrade_opaque.register_fake
def _(image: Tensor, *_: Any) -> Tensor:
    return torch.empty_like(image, memory_format=torch.contiguous_format)
