"""Particles in the water, lit as the scene is, and drawn as a lens shows them.

A particle at a distance r sends the light of a surface: reflectance·T_β(r), of daylight and of
lamps, before the camera's gain. That light times the area of its picture is spread over its pixels:
the more they are, the fainter. A nearer scene hides it. It is added to the veil, as particles are
translucent.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug.light.light import Light, density_of
from uwaug.optics.curves import Curves
from uwaug.optics.medium import Medium
from uwaug.optics.view import Rays, View

_EDGE_PX = 0.75  # softness (px) of an edge to either side: half the diagonal of a pixel, and a lens
_SOFT_SHARE = 0.4  # softness of an edge as a share of the particle's radius: aggregates have no rim


class Flakes(NamedTuple):
    """Particles, N of them, in a picture."""

    # 8xN: column and row of the middle, px; radii along the long axis where the light begins to
    # fall, and is gone, px; factors of dx², dx·dy and dy² in the square of such a radius; metres
    # along the ray
    places: Tensor
    light: Tensor  # 3xN: sum over all pixels


def flakes(
    medium: Medium, light: Light | None, z: Tensor, view: View, metres: Tensor
) -> Flakes | None:
    """Particles before one picture; arguments as for `snowing`, of one row, maps 1xHxW."""
    snow = medium.snow[0]
    if snow is None:
        return None
    light = Light() if light is None else light
    height, width = z.shape[-2:]
    focal, middle = view.focal(width), view.middle((height, width))
    # of a view whose axis lies aside, the part to one side of it stands for both
    right, down = (
        max(at + 0.5, side - 0.5 - at) / focal
        for at, side in zip(middle, (width, height), strict=True)
    )
    particles = snow.particles(right, down)
    if not len(particles.z):
        return None
    x, y, turn = particles.x, particles.y, particles.turn
    length = np.sqrt(1 + x**2 + y**2)
    radius = focal / 2 * (particles.diameter / particles.z)
    blur = focal / 2 * snow.blur(particles.z)
    flux = math.pi * radius**2 * snow.reflectance * particles.brightness
    ends = []
    for axis in (radius * particles.stretch, radius / particles.stretch):
        # two discs folded with each other fall from |R − r| to R + r
        half = np.minimum(axis, blur) + _SOFT_SHARE * axis + _EDGE_PX
        ends.append(np.maximum(axis, blur) + half)
    inner = ends[0] - 2 * half
    slim, cosine, sine = (ends[0] / ends[1]) ** 2, np.cos(turn), np.sin(turn)
    columns = (
        *(x, y, 1 / length, flux),
        *(focal * x + middle[0], focal * y + middle[1]),
        *(inner.clip(0), ends[0]),
        *(cosine**2 + slim * sine**2, 2 * (1 - slim) * sine * cosine, sine**2 + slim * cosine**2),
        particles.z * length,
    )
    values = z.new_tensor(np.stack(columns))
    directions, fluxes, places = values[:3], values[3], values[4:]
    column, row = (
        t.round().long().clamp(0, side - 1)
        for t, side in zip(places, (width, height), strict=False)
    )
    density = density_of(z[0, row, column], metres[0, row, column])
    rays = Rays(*(t.reshape(1, 1, 1, -1) for t in directions))
    distance = places[-1].reshape(1, 1, 1, -1)
    white = light.on_white(medium, distance * density, distance, rays)
    return Flakes(places, fluxes * white[0, :, 0])


def snowing(
    T: Curves | None,
    medium: Medium,
    light: Light | None,
    z: Tensor,
    view: View,
    metres: Tensor | None = None,
    J: Tensor | None = None,
) -> Curves | None:
    """Add the light of the medium's particles to the veil of curves from `Light.curves`, whose
    arguments these are, or of the medium's own; for pictures J that may share a map and a medium.
    """
    if not medium.snow:
        return T
    if torch.compiler.is_compiling():
        raise RuntimeError("marine snow cannot be compiled: take medium.with_snow(None)")
    T = medium.curves(z) if T is None else T
    layers, metres = [], z if metres is None else metres
    for n in range(max(len(z), len(medium), 1 if J is None else len(J))):
        scene = metres[n % len(metres)]
        particles = flakes(medium[n % len(medium)], light, z[n % len(z)], view, scene)
        layer = T.veil.new_zeros(3, *z.shape[-2:])
        layers.append(layer if particles is None else splat(particles, scene))
    return T._replace(veil=T.veil + torch.stack(layers))


def splat(flakes: Flakes, scene: Tensor) -> Tensor:
    """Light of particles (3xHxW) before a scene (1xHxW, m)."""
    height, width = scene.shape[-2:]
    layer = scene.new_zeros(3, height * width)
    reach = flakes.places[3].ceil()
    low = 0.0
    # particles of about a size together, in squares of pixels that hold each of them
    while bool((reach > low).any()):
        high = max(2 * low, 2.0)
        alike = (reach > low) & (reach <= high)
        low = high
        column, row, inner, outer, *form, metres = flakes.places[:, alike, None, None]
        side = torch.arange(-high, high + 1, dtype=scene.dtype, device=scene.device)
        across, down = column.round() + side, row.round() + side[:, None]
        dx, dy = across - column, down - row
        radius = (form[0] * dx * dx + form[1] * dx * dy + form[2] * dy * dy).clamp(min=0.0).sqrt()
        shares = ((outer - radius) / (outer - inner)).clamp(0.0, 1.0)
        shares = shares / shares.sum((-2, -1), keepdim=True)
        inside = (across >= 0) & (across < width) & (down >= 0) & (down < height)
        place = (down.clamp(0, height - 1) * width + across.clamp(0, width - 1)).long()
        shares = torch.where(inside & (scene.flatten()[place] > metres), shares, 0.0)
        lights = flakes.light[:, alike, None, None] * shares
        layer = layer.index_add(1, place.flatten(), lights.flatten(1))
    return layer.reshape(3, height, width)
