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

from uwaug.colour import ColorSpace, from_light, to_light
from uwaug.distance import check_distance, from_inverse, from_relative
from uwaug.field import gaussian_random_field
from uwaug.formation import Order, form, plan_at_hand, prepare, together
from uwaug.optics.camera import Camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water

__all__ = ["DistanceKind", "Draw", "Settings", "Unknown", "degrade", "degrade_opaque"]

DistanceKind = Literal["metric", "relative", "inverse"]
Unknown = Literal["error", "fill"]

_OF_MEDIUM = 6
"""The first so many numbers of a draw make a medium of waters and a camera."""

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

    @staticmethod
    def varies(ranges: Mapping[str, tuple[float, float]]) -> bool:
        """Whether draws from these ranges make a new medium each time."""
        of_medium = [ranges[name] for name in Draw._fields[:_OF_MEDIUM] if name in ranges]
        return any(low < high for low, high in of_medium)

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
    varied: bool
    """Whether media are drawn from ranges, so that none comes twice and none need be kept."""

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
        numbers = (None if math.isnan(value) else value for value in draw[:_OF_MEDIUM])
        medium = _medium(tuple(waters), camera, tuple(numbers), settings)
        light, z, medium = prepare(light, z, medium, _field(draw, z))
        plan = plan_at_hand(z, medium, settings.tolerance, settings.order)
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
    if math.isnan(draw.field_seed):
        return None
    generator = torch.Generator().manual_seed(int(draw.field_seed))
    size, low, high = z.shape[-2:], draw.field_low, draw.field_high
    return gaussian_random_field(size, low=low, high=high, generator=generator).to(z.device)


def _medium(
    waters: tuple[Water, ...], camera: Camera, drawn: tuple[Any, ...], settings: Settings
) -> Medium:
    # media that are kept for nothing would lie between the pictures in memory, so that the heap
    # could not shrink
    make = _new_medium if settings.varied else _kept_medium
    return make(waters, camera, drawn, settings)


def _new_medium(
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


_kept_medium = lru_cache(maxsize=64)(_new_medium)
"""Nine waters, or pairs of them, seen by a few cameras."""


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
    return degrade(image, distance, spectra, lens, drawn, Settings.from_json(settings))


@degrade_opaque.register_fake
def _(image: Tensor, *_: Any) -> Tensor:
    return torch.empty_like(image, memory_format=torch.contiguous_format)


def table(spectra: Water | Camera) -> Tensor:
    """Wavelengths, and below them the values at each."""
    if isinstance(spectra, Camera):
        return torch.from_numpy(np.array([spectra.wavelengths, *spectra.response.T]))
    return torch.from_numpy(np.array([spectra.wavelengths, spectra.a, spectra.b, spectra.kd]))
