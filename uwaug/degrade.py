"""One picture in one random water: what `RandomUnderwater` does once it has drawn."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug.colour import ColorSpace, from_light, headroom, to_light
from uwaug.exposure import auto_gain
from uwaug.field import gaussian_random_field
from uwaug.formation import Order, form, plan_at_hand, prepare, together
from uwaug.metres import DistanceKind, Scaling, Unknown, skipped, to_metres
from uwaug.optics.camera import Camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import CONTRAST_THRESHOLD, Water
from uwaug.replay import reproducible

__all__ = [
    "Draw",
    "InWater",
    "Opaque",
    "Settings",
    "degrade",
    "degrade_opaque",
    "in_water",
    "used",
]

_FOCAL = 0.5 / math.tan(math.radians(30))
"""Focal length of a view 60° wide, as a share of the picture's width."""

_MEASURED_EVERY = 4
"""px along each axis, at which the median of distance is taken: .03 ms instead of .5 at 256 px, and
within 1 % of that of all pixels.
"""


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
    contrast: float
    exposure: float
    contents: float
    gain: float
    field_seed: float
    field_low: float
    field_high: float

    @property
    def scaling(self) -> Scaling:
        """What scales a relative map."""
        return Scaling(self.near, self.far, self.gamma)

    @staticmethod
    def of(sample: Mapping[str, Any]) -> "Draw":
        """From a sample of a record."""
        low, high = sample["field_range"]
        drawn = {**sample, "field_low": low, "field_high": high}
        for name in ("contents", "gain"):
            drawn[name] = sample.get("used", {}).get(name)
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
    point_spread: PointSpread | None
    focal_px: float | None
    exposure: Literal["none", "auto", "drawn"]
    tolerance: float
    varied: bool
    """Whether each picture has a medium of its own, so that none need be kept."""

    def law(self, width: int) -> PointSpread:
        """The width law for a picture of `width` px."""
        if self.point_spread is not None:
            return self.point_spread
        return PointSpread.calibrated(self.focal_px or _FOCAL * width)

    def to_json(self) -> str:
        """As text, for an operator that takes no objects."""
        return json.dumps(asdict(self))

    @staticmethod
    def from_json(text: str) -> "Settings":
        """The inverse of `to_json`."""
        values = json.loads(text)
        if values["point_spread"] is not None:
            values["point_spread"] = PointSpread(**values["point_spread"])
        return Settings(**values)


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
    with reproducible(), torch.no_grad(), torch.autocast(image.device.type, enabled=False):
        found = in_water(image, distance, waters, camera, draw, settings)
        light, z, medium = found.light, found.z, found.medium
        plan = plan_at_hand(z, medium, settings.tolerance, settings.order)
        (result,) = form(light, z, medium, plan, settings.order, together)
        return from_light(result[0], settings.color_space, image.dtype, headroom(image))


def used(
    image: Tensor,
    distance: Tensor | None,
    waters: Sequence[Water],
    camera: Camera,
    draw: Draw,
    settings: Settings,
) -> dict[str, float]:
    """What the draw comes to on a picture; arguments as for `degrade`.

    Returns:
        contents: factor on all that is in the water besides pure water.
        visibility: of that water, m.
        gain: of the exposure.
    """
    with reproducible(), torch.no_grad(), torch.autocast(image.device.type, enabled=False):
        found = in_water(image, distance, waters, camera, draw, settings)
        visibility = found.water.visibility()
        return {"contents": found.contents, "visibility": visibility, "gain": float(found.gain)}


class InWater(NamedTuple):
    """Light, distance and medium as `form` takes them; what water, contents and gain came to."""

    light: Tensor
    z: Tensor
    medium: Medium
    water: Water
    contents: float
    gain: Tensor


def in_water(
    image: Tensor,
    distance: Tensor | None,
    waters: Sequence[Water],
    camera: Camera,
    draw: Draw,
    settings: Settings,
) -> InWater:
    """A picture in its water, before it is formed; arguments as for `degrade`."""
    # a view with other strides takes other paths through the kernels, which round differently
    light = to_light(image.contiguous(), settings.color_space)
    if distance is None:
        z = torch.full_like(light[:1], draw.distance)
    else:
        z = to_metres(distance.contiguous(), draw.scaling, settings.distance_kind, settings.unknown)
    water, contents = _water(waters, draw, z)
    medium = _medium(water, camera, draw, settings.law(image.shape[-1]), settings)
    light, z, medium = prepare(light, z, medium, _field(draw, z))
    gain = _gain(light, z, medium, draw, settings)
    return InWater(light, z, medium.brightened(gain), water, contents, gain)


def _field(draw: Draw, z: Tensor) -> Tensor | None:
    if math.isnan(draw.field_seed):
        return None
    generator = torch.Generator().manual_seed(int(draw.field_seed))
    size, low, high = z.shape[-2:], draw.field_low, draw.field_high
    field = gaussian_random_field(
        size, low=low, high=high, generator=generator, dtype=torch.float32, device="cpu"
    )
    return field.to(z.device)


def _water(waters: Sequence[Water], draw: Draw, z: Tensor) -> tuple[Water, float]:
    """The water of a picture, and the factor on what is in it."""
    water = waters[0].mix(waters[1], draw.mixing) if len(waters) > 1 else waters[0]
    if not math.isnan(draw.contents):
        contents = draw.contents
    elif not math.isnan(draw.visibility):
        contents = water.contents_for(CONTRAST_THRESHOLD, draw.visibility)
    elif not math.isnan(draw.contrast):
        contents = water.contents_for(draw.contrast, _middle(z))
    else:
        return water, 1.0
    return water.with_contents(contents), contents


def _middle(z: Tensor) -> float:
    """The median of all distances that are not open water, m."""
    some = z[..., ::_MEASURED_EVERY, ::_MEASURED_EVERY]
    near = some[some.isfinite()]
    return float(near.median()) if near.numel() else math.inf


def _gain(light: Tensor, z: Tensor, medium: Medium, draw: Draw, settings: Settings) -> Tensor:
    """The exposure of a picture, (1,)."""
    if not math.isnan(draw.gain):
        return light.new_full((1,), draw.gain)
    if settings.exposure == "auto":
        return auto_gain(light, z, medium.sums(exact_at_lens=False))
    stops = draw.exposure if settings.exposure == "drawn" else 0.0
    return light.new_full((1,), 2.0**stops)


def _medium(
    water: Water, camera: Camera, draw: Draw, law: PointSpread, settings: Settings
) -> Medium:
    # media that are kept for nothing would lie between the pictures in memory, so that the heap
    # could not shrink
    make = _new_medium if settings.varied else _kept_medium
    numbers = (draw.vertical_depth, draw.g, draw.mu)
    return make(water, camera, numbers, law.widened(draw.blur_factor), settings.tolerance)


def _new_medium(
    water: Water,
    camera: Camera,
    numbers: tuple[float, float, float],
    law: PointSpread,
    tolerance: float,
) -> Medium:
    depth, g, mu = numbers
    return Medium.from_water(
        water,
        camera,
        vertical_depth=depth,
        g=g,
        mu=mu,
        point_spread=law,
        tolerance=tolerance,
    )


_kept_medium = lru_cache(maxsize=64)(_new_medium)
"""Nine waters, or pairs of them, seen by a few cameras."""


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
    baked into the graph. Waters and camera come as tables, see `_table`.
    """
    spectra = [Water(*rows.numpy()) for rows in waters]
    wavelengths, *response = camera.numpy()
    lens = Camera(wavelengths, np.array(response).T)
    drawn = Draw(*draw.tolist())
    options = Settings.from_json(settings)
    if skipped(distance, options):
        return image.clone()  # an operator must not return what it was given
    return degrade(image, distance, spectra, lens, drawn, options)


@degrade_opaque.register_fake
def _(image: Tensor, *_: Any) -> Tensor:
    return torch.empty_like(image, memory_format=torch.contiguous_format)


class Opaque:
    """`degrade` as one opaque operator, for compiled code, which takes no objects.

    Args:
        spectra, cameras: by the names that samples have for them.
        settings: what is set.
    """

    def __init__(
        self, spectra: Mapping[str, Water], cameras: Mapping[str, Camera], settings: Settings
    ) -> None:
        self._text = settings.to_json()
        self._waters = {name: _table(water) for name, water in spectra.items()}
        self._cameras = {name: _table(camera) for name, camera in cameras.items()}

    def __call__(self, image: Tensor, distance: Tensor | None, sample: Mapping[str, Any]) -> Tensor:
        """A picture (3xHxW) as a sample of a record says."""
        waters = [self._waters[name] for name in sample["waters"]]
        camera, draw = self._cameras[sample["camera"]], Draw.of(sample).to_tensor()
        result: Tensor = degrade_opaque(image, distance, waters, camera, draw, self._text)
        return result


def _table(spectra: Water | Camera) -> Tensor:
    """Wavelengths, and below them the values at each."""
    if isinstance(spectra, Camera):
        return torch.from_numpy(np.array([spectra.wavelengths, *spectra.response.T]))
    return torch.from_numpy(np.array([spectra.wavelengths, spectra.a, spectra.b, spectra.kd]))
