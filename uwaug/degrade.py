"""One picture in one random water: what `RandomUnderwater` does once it has drawn."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug import checks
from uwaug.colour import ColorSpace, from_light, to_light
from uwaug.distance import check_distance, from_inverse, from_relative
from uwaug.draw import Record
from uwaug.field import gaussian_random_field
from uwaug.formation import Order, form, plan_at_hand, prepare, together
from uwaug.optics.camera import Camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water
from uwaug.structure import maps_for, plain_image

__all__ = [
    "DistanceKind",
    "Draw",
    "Settings",
    "Unknown",
    "as_unknown",
    "degrade",
    "degrade_opaque",
    "skipping",
]

DistanceKind = Literal["metric", "relative", "inverse"]
_Policy = Literal["error", "fill", "skip", "far"]
Unknown = _Policy | float
"""What unknown pixels get; a number is metres."""

_TOUCHING = 1e-6
"""m, for relative distance 0 with near = 0: in a map of metres 0 means unknown."""


class Draw(NamedTuple):
    """What is drawn for a picture, besides its waters and its camera; see `RandomUnderwater`.

    NaN: not drawn, as nothing asks for it.
    """

    mixing: float
    visibility: float
    vertical_depth: float
    g: float
    mu: float
    blur_factor: float
    near: float
    far: float
    gamma: float
    distance: float
    field_seed: float
    field_low: float
    field_high: float

    @staticmethod
    def of(sample: Mapping[str, Any]) -> "Draw":
        """From a sample of a record."""
        low, high = sample["field_range"]
        drawn = {**sample, "field_low": low, "field_high": high}
        values = []
        for name in Draw._fields:
            value = drawn.get(name)
            values.append(math.nan if value is None else value)
        return Draw(*values)

    def to_tensor(self) -> Tensor:
        """As numbers; torch.tensor(…) would fix them in a graph."""
        one = torch.ones((), dtype=torch.float64)
        return torch.stack([one * value for value in self])


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
        The picture, like `image`; `image` itself if its map tells nothing and is to be skipped.
    """
    if distance is not None and _skipped(distance, settings):
        return image
    with _one_thread(), torch.no_grad(), torch.autocast(image.device.type, enabled=False):
        light = to_light(image, settings.color_space)
        if distance is None:
            z = torch.full_like(light[:1], draw.distance)
        else:
            z = _metres(distance, draw, settings)
        numbers = (None if math.isnan(value) else value for value in draw[:6])
        medium = _medium(tuple(waters), camera, tuple(numbers), settings)
        light, z, medium = prepare(light, z, medium, _field(draw, z))
        plan = plan_at_hand(z, medium, settings.tolerance, settings.order)
        (result,) = form(light, z, medium, plan, settings.order, together)
        return from_light(result[0], settings.color_space, image.dtype)


def as_unknown(value: Any) -> Unknown:
    """Check what unknown pixels are to get."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        checks.one_of("unknown", value, (*get_args(_Policy), "a number of metres"))
        return value
    checks.positive("unknown", float(value), "m")
    return float(value)


def skipping(record: Record, image: Tensor, distance: Tensor, settings: Settings) -> Record:
    """The record, with "applied": False for what is left alone on account of its map."""
    if settings.unknown != "skip":
        return record
    plain = plain_image(image)
    whole = list(range(len(plain) if plain.ndim == 4 else 1))
    maps = maps_for(plain, distance, whole, None)
    samples = record["samples"]
    if len(samples) == 1:
        samples = samples * len(maps)
    changed = []
    for sample, z in zip(samples, maps, strict=True):
        left = z is not None and _skipped(z, settings)
        changed.append({**sample, "applied": sample["applied"] and not left})
    return {"samples": changed}


def _skipped(distance: Tensor, settings: Settings) -> bool:
    """Whether a picture is left alone, as its map has no known pixel or, of inverse depth, no two
    that differ.
    """
    if settings.unknown != "skip":
        return False
    if settings.distance_kind == "metric":
        return not bool((distance > 0).any())
    if settings.distance_kind == "relative":
        return bool(distance.isnan().all())
    known = distance[distance.isfinite()]
    return not known.numel() or bool((known == known[0]).all())


def _metres(distance: Tensor, draw: Draw, settings: Settings) -> Tensor:
    z, instead = _scaled(distance, draw, settings.distance_kind), settings.unknown
    if instead == "far":
        instead = math.inf
    if not isinstance(instead, str):
        return torch.where(z > 0, z, instead)
    strict = instead == "error"
    cure = "unknown='fill'), or 'skip', 'far' or metres" if strict else "unknown='skip')"
    try:
        return check_distance(z, strict=strict)
    except ValueError as error:
        raise ValueError(f"{error}; or use RandomUnderwater({cure}") from None


def _scaled(distance: Tensor, draw: Draw, kind: DistanceKind) -> Tensor:
    """In metres, unknown pixels left."""
    if kind == "metric":
        checks.metres("distance", distance)
        return distance
    if kind == "relative":
        return from_relative(distance, max(draw.near, _TOUCHING), draw.far, draw.gamma)
    if not bool(distance.isfinite().any()):
        return torch.full_like(distance, math.nan)
    try:
        return from_inverse(distance, draw.near, draw.far)
    except ValueError as error:
        raise ValueError(f"{error}; or use RandomUnderwater(unknown='skip')") from None


def _field(draw: Draw, z: Tensor) -> Tensor | None:
    if math.isnan(draw.field_seed):
        return None
    generator = torch.Generator().manual_seed(int(draw.field_seed))
    size, low, high = z.shape[-2:], draw.field_low, draw.field_high
    return gaussian_random_field(size, low=low, high=high, generator=generator).to(z.device)


@lru_cache(maxsize=256)
def _medium(
    waters: tuple[Water, ...], camera: Camera, drawn: tuple[Any, ...], settings: Settings
) -> Medium:
    mixing, visibility, vertical_depth, g, mu, blur_factor = drawn
    water = waters[0].mix(waters[1], mixing) if len(waters) > 1 else waters[0]
    if visibility is not None:
        water = water.with_visibility(visibility)
    law = settings.point_spread
    return Medium.from_water(
        water,
        camera,
        vertical_depth=vertical_depth,
        g=g,
        mu=mu,
        point_spread=law.widened(blur_factor),
        tolerance=settings.tolerance,
    )


@contextmanager
def _one_thread() -> Iterator[None]:
    """Run on one thread, as a DataLoader worker does, so that records replay bit for bit: the split
    between threads decides which elements take the scalar path, where exp2 and pow differ in the
    last bit.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@torch.library.custom_op(
    "uwaug::random_underwater",
    mutates_args=(),
    schema="(Tensor image, Tensor? distance, Tensor[] waters, Tensor camera, Tensor draw, "
    "str settings) -> Tensor",
)
def degrade_opaque(
    image: Tensor,
    distance: Tensor | None,
    waters: list[Tensor],
    camera: Tensor,
    draw: Tensor,
    settings: str,
) -> Tensor:
    """`degrade` for compiled code. The draw comes as a tensor; as Python numbers it would be
    baked into the graph. Waters and camera come as tables, see `table`.
    """
    spectra = [Water(*rows.numpy()) for rows in waters]
    wavelengths, *response = camera.numpy()
    lens = Camera(wavelengths, np.array(response).T)
    drawn = Draw(*draw.tolist())
    result = degrade(image, distance, spectra, lens, drawn, Settings.from_json(settings))
    # an operator must not return what it was given
    return result.clone() if result is image else result


@degrade_opaque.register_fake
def _(image: Tensor, *_: Any) -> Tensor:
    return torch.empty_like(image, memory_format=torch.contiguous_format)


def table(spectra: Water | Camera) -> Tensor:
    """Wavelengths, and below them the values at each."""
    if isinstance(spectra, Camera):
        return torch.from_numpy(np.array([spectra.wavelengths, *spectra.response.T]))
    return torch.from_numpy(np.array([spectra.wavelengths, spectra.a, spectra.b, spectra.kd]))
