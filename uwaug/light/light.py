"""Daylight and its direction, and lamps near the camera.

Lights add. With T_β, T_G and V of the medium and c for a channel of the picture,

    daylight  daylight·T_β, daylight·(T_G − T_β), daylight·(V(0) − V)·(1 − .8·s)⁻²
    a lamp    share·A_c, (1 − share)·A_c, and its backscatter (see `uwaug.light.backscatter`)

s is the sine of a ray's elevation, see `uwaug.light.direction`; 0 everywhere without a pitch.
A_c = power·color_c·cone(ψ)/r²·T_G,c(r + z) is a lamp's light that arrives after both ways through
the water, r from the lamp to the surface and z from there to the camera. On the way to the scene,
light that is scattered forward still lights it. The share T_β(z)/T_G(z) has come straight from the
surface. The cosine of the angle of incidence is left out, as a photograph has its shading in it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import torch
from torch import Tensor

from uwaug._support import checks, codec
from uwaug.light.backscatter import Cone, backscatter
from uwaug.light.direction import veil_factor
from uwaug.optics.curves import Curves, added, decay, passed
from uwaug.optics.medium import Medium
from uwaug.optics.surfaces import white
from uwaug.optics.view import Rays, Vector, View

LAMP_RADIUS_M = 0.03  # distance (m) from a lamp within which its light grows no more
_SOFT_EDGE = 0.5  # outer share of the cone, over which the light fades
_MIN_METRES = 1e-6  # distance (m) below which it does not tell the field that multiplies it
_MIN_LIGHT = 1e-30  # amount of light that stands for none


class Sent(NamedTuple):
    """Light of a lamp on a scene, without the water."""

    share: Tensor  # Bx1xHxW: light at each surface, relative to a white plate at 1 m
    path: Tensor  # Bx1xHxW: distance from the lamp to the surface, m
    nearest: Tensor  # this and the next: the lamp beside the rays, see `uwaug.light.backscatter`
    height: Tensor
    cone: Cone | None


@codec.plain
@dataclass(frozen=True)
class Lamp:
    """Lamp in the water. Coordinates are the camera's: x to the right, y down, z forward.

    Attributes:
        position: m.
        power: brightness of a white plate at 1 m in air, ≥ 0; 1 is daylight at the surface.
        aim: direction of the axis, of any length.
        cone: half-angle, degrees, 1…90; the light fades over its outer half. None: to all sides.
        color: light in the channels of the picture, each ≥ 0.
    """

    position: Vector = (0.4, -0.3, 0.0)
    power: float = 1.0
    aim: Vector = (0.0, 0.0, 1.0)
    cone: float | None = None
    color: Vector = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        limits = {"position": (-1e4, 1e4), "aim": (-1e4, 1e4), "color": (0.0, math.inf)}
        for name, ends in limits.items():
            object.__setattr__(self, name, checks.vector(name, getattr(self, name), *ends))
        if math.hypot(*self.aim) < 1e-6:
            raise ValueError(f"aim must point somewhere, got {self.aim}")
        checks.within("power", self.power, 0.0)
        if self.cone is not None:
            checks.within("cone", self.cone, 1.0, 90.0)

    def dyed(self, weights: Tensor) -> Tensor:
        """Weights of channels (Bx3xL) times colour and power of this lamp."""
        return weights * (weights.new_tensor(self.color)[:, None] * self.power)

    def sent(self, rays: Rays, z: Tensor) -> Sent:
        """Light on a scene at distance z (Bx1xHxW, m) if the lamp had power 1."""
        nearest = rays.along(self.position)
        height = torch.sqrt(rays.distance(self.position).square() + LAMP_RADIUS_M**2)
        beyond = z - nearest
        squared = beyond.square() + height.square()
        inverse = squared.rsqrt()
        share, cone = inverse.square(), None
        if self.cone is not None:
            inner, outer = self.fade
            slope = 1 / (inner - outer)
            along = slope * rays.along(self.axis)
            before = slope * sum(x * y for x, y in zip(self.position, self.axis, strict=True))
            cone = Cone((nearest * along - before) / height, along, slope * outer)
            share = share * cone.share(height * inverse, beyond * inverse)
        return Sent(share, squared * inverse, nearest, height, cone)

    @property
    def axis(self) -> Vector:
        """Direction `aim` at length 1."""
        length = math.hypot(*self.aim)
        x, y, z = (part / length for part in self.aim)
        return x, y, z

    @property
    def fade(self) -> tuple[float, float]:
        """Cosines of the angles from the axis at which the light begins to fade, and has faded."""
        edge = math.radians(self.cone or 0.0)
        return math.cos(edge * (1 - _SOFT_EDGE)), math.cos(edge)


@codec.plain
@dataclass(frozen=True)
class Light:
    """Daylight and its direction, and lamps near the camera.

    Attributes:
        lamps: any number of `Lamp`.
        daylight: factor of daylight, and of its veil; ≥ 0.
        pitch: angle of the camera's axis above the horizon, degrees, −90…90, or a tensor of one for
            each picture (B), which may learn, see `uwaug.light.direction`. None: alike all around.

    Examples:
        >>> headlight = Lamp((0.3, -0.2, 0.0), power=4.0, aim=(-0.1, 0.1, 1.0), cone=40.0)
        >>> Light([headlight], daylight=0.2).lamps[0].power
        4.0
    """

    lamps: tuple[Lamp, ...] = ()
    daylight: float = 1.0
    pitch: float | Tensor | Sequence[float] | None = None

    def __post_init__(self) -> None:
        if isinstance(self.lamps, (Lamp, Mapping)) or not isinstance(self.lamps, (tuple, list)):
            raise TypeError(f"lamps must be a list of uwaug.Lamp, got {self.lamps!r:.80}")
        # tables of TOML need not call each one a lamp
        lamps = [codec.from_plain(lamp, Lamp) for lamp in self.lamps]
        for lamp in lamps:
            checks.instance("lamps", lamp, Lamp)
        object.__setattr__(self, "lamps", tuple(lamps))
        checks.within("daylight", self.daylight, 0.0)
        if isinstance(self.pitch, (tuple, list)):  # a tensor, as it is written
            object.__setattr__(self, "pitch", torch.tensor(self.pitch, dtype=torch.float32))
        if isinstance(self.pitch, Tensor):
            checks.floating("pitch", self.pitch)
            for angle in self.pitch.detach().flatten().tolist():
                checks.within("pitch", angle, -90.0, 90.0)
        elif self.pitch is not None:
            checks.within("pitch", self.pitch, -90.0, 90.0)
            object.__setattr__(self, "pitch", float(cast(float, self.pitch)))

    def curves(self, medium: Medium, z: Tensor, view: View, metres: Tensor | None = None) -> Curves:
        """In place of `Medium.curves`: light of a white scene that reaches the camera at each
        pixel, at effective distances z (Bx1xHxW), m: `metres` times the field where there is one.
        """
        day = medium.brightened(z.new_full((1, 1), self.daylight)).curves(z)
        if self.pitch is not None:
            day = day._replace(veil=day.veil * veil_factor(self.pitch, z, view))
        if not self.lamps:
            return day
        density: float | Tensor = 1.0 if metres is None else density_of(z, metres)
        metres = z if metres is None else metres
        water = medium.under_lamp()
        arrives, veil = self.lit(water, view.rays(metres), metres, density)
        direct = _dimmed(arrives, _straight(water, z))
        return added(day, Curves(direct, arrives - direct, veil))

    def lit(
        self, water: Medium, rays: Rays, z: Tensor, density: float | Tensor = 1.0
    ) -> tuple[Tensor, Tensor]:
        """Light of the lamps from a white scene at each pixel (Bx3xHxW, or Bx3x3xHxW), and their
        fog (Bx3xHxW), in a water from `uwaug.Medium.under_lamp`, at distances z (Bx1xHxW), m, with
        the density of the medium field.
        """
        sent = [lamp.sent(rays, z) for lamp in self.lamps]
        fogs = [
            backscatter(water.G, lamp.dyed(water.veil_weights), *light[2:], z, density)
            for lamp, light in zip(self.lamps, sent, strict=True)
        ]
        return self._arriving(water, sent, z, density), sum(fogs[1:], fogs[0])

    def _arriving(
        self, water: Medium, sent: Sequence[Sent], z: Tensor, density: float | Tensor
    ) -> Tensor:
        decayed, weights = [], []
        for lamp, light in zip(self.lamps, sent, strict=True):
            path = (density * (z + light.path)).flatten(2)
            decayed.append(decay(water.G[..., None], path) * light.share.flatten(2))
            weights.append(lamp.dyed(water.signal_weights.flatten(2)))
        # one product for all lamps, which writes up to nine numbers a pixel once
        shape = water.signal_weights.shape[1:-1]
        rows = torch.cat([part.reshape(part.shape[0], shape.numel(), -1) for part in weights], 2)
        arrives = torch.unflatten(rows @ torch.cat(decayed, 1), -1, z.shape[-2:])
        return torch.unflatten(arrives, 1, shape)

    def on_white(self, medium: Medium, z: Tensor, metres: Tensor, rays: Rays) -> Tensor:
        """Unscattered light of white surfaces (Bx3xHxW) on any rays; arguments as for `curves`."""
        white_light = z.new_ones(1, 3, 1, 1)
        total = passed(medium.curves(z).direct, white_light) * self.daylight
        if not self.lamps:
            return total
        water = medium.under_lamp()
        sent = [lamp.sent(rays, metres) for lamp in self.lamps]
        arrives = self._arriving(water, sent, metres, z / metres)
        return total + passed(_dimmed(arrives, _straight(water, z)), white_light)

    def planned(self, medium: Medium) -> Medium:
        """Medium for which a blur is planned: lamps may be as bright as daylight at the surface."""
        return medium.under_lamp() if self.lamps else medium


def density_of(z: Tensor, metres: Tensor) -> Tensor:
    """Medium field m from the effective distance z = m·metres; 1 where it is too near to tell."""
    return torch.where(metres > _MIN_METRES, z / metres.clamp(min=_MIN_METRES), 1.0)


def _straight(water: Medium, z: Tensor) -> Tensor:
    """Share T_β/T_G of the arriving light that has come straight from the surface; of all channels
    (Bx1xHxW) for surfaces with spectra, where one may be black or negative.
    """
    direct = _summed(water.beta, white(water.direct_weights), z)
    signal = _summed(water.G, white(water.signal_weights), z)
    if water.is_spectral:
        # by row, as a stack may hold grey surfaces, too
        aside = 1 - torch.eye(3, dtype=z.dtype, device=z.device)[:, :, None]
        mixes = (water.signal_weights * aside).abs().sum((1, 2, 3)).reshape(-1, 1, 1, 1) > 0
        direct, signal = (torch.where(mixes, x.sum(1, keepdim=True), x) for x in (direct, signal))
    return (direct / signal.clamp(min=_MIN_LIGHT)).clamp(max=1.0)


def _summed(rates: Tensor, weights: Tensor, length: Tensor) -> Tensor:
    sums = weights @ decay(rates[..., None], length.flatten(2))
    return torch.unflatten(sums, -1, length.shape[-2:])


def _dimmed(T: Tensor, light: Tensor) -> Tensor:
    return T * light if T.ndim == 4 else T * light[:, :, None]
