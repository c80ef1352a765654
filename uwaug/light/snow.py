"""Particles in the water, lit as a scene is, and drawn as a lens shows them.

A particle at a distance r sends what a surface of its reflectance would: reflectance·T_β(r) in
daylight and of lamps, before the camera's gain. That light times the area of its picture is spread
over as many pixels as size, defocus and pixel make it wide: the more they are, the fainter. Nothing
of it is seen where the scene is nearer. It is added to the veil, as particles are translucent.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug.light.light import Light
from uwaug.light.rays import Rays
from uwaug.optics.curves import Curves
from uwaug.optics.medium import Medium

_EDGE_PX = 0.75
"""By which an edge is soft to either side: half the diagonal of a pixel, and a lens."""

_FUZZY = 0.4
"""Of a particle's radius, by which its edge is soft: aggregates have no rim."""

_MIN_METRES = 1e-6
"""As in `uwaug.light.light`."""


class Flakes(NamedTuple):
    """N particles in a picture, see `uwaug.light.snow`.

    Attributes:
        places (8xN): column and row of their middles, px; radii along the long axis where their
            light begins to fall, and is gone, px; what of dx², dx·dy and dy² the square of such a
            radius is; metres along the ray.
        light (3xN): summed over all pixels.
    """

    places: Tensor
    light: Tensor


def flakes(
    medium: Medium, light: Light | None, z: Tensor, metres: Tensor | None, n: int
) -> Flakes | None:
    """The particles before picture `n` of a batch; arguments as for `snowing`."""
    snow = medium.snow[n % len(medium)]
    if snow is None:
        return None
    light = Light() if light is None else light
    z, height, width = z[n % len(z)], z.shape[-2], z.shape[-1]
    scene = z if metres is None else metres[n % len(metres)]
    right = math.tan(math.radians(light.view / 2))
    down, focal = right * height / width, width / 2 / right
    drawn = snow.particles(right, down)
    if not len(drawn.z):
        return None
    length = np.sqrt(1 + drawn.x**2 + drawn.y**2)
    radius, blur = (focal / 2 * x for x in (drawn.diameter / drawn.z, snow.blur(drawn.z)))
    ends = []
    for axis in (radius * drawn.stretch, radius / drawn.stretch):
        # what two discs make of each other falls from |R − r| to R + r
        half = np.minimum(axis, blur) + _FUZZY * axis + _EDGE_PX
        ends.append(np.maximum(axis, blur) + half)
    inner = ends[0] - 2 * half
    slim, cosine, sine = (ends[0] / ends[1]) ** 2, np.cos(drawn.turn), np.sin(drawn.turn)
    columns = (
        *(drawn.x, drawn.y, 1 / length, math.pi * radius**2 * snow.reflectance * drawn.brightness),
        *(focal * drawn.x + (width - 1) / 2, focal * drawn.y + (height - 1) / 2),
        *(inner.clip(0), ends[0]),
        *(cosine**2 + slim * sine**2, 2 * (1 - slim) * sine * cosine, sine**2 + slim * cosine**2),
        drawn.z * length,
    )
    values = z.new_tensor(np.stack(columns))
    (x, y, shortening, flux), places = values[:4], values[4:]
    column, row = (
        t.round().long().clamp(0, n - 1) for t, n in zip(places, (width, height), strict=False)
    )
    far, near = (m[0, row, column] for m in (z, scene))
    density = torch.where(near > _MIN_METRES, far / near.clamp(min=_MIN_METRES), 1.0)
    rays = Rays(*(t.reshape(1, 1, 1, -1) for t in (x, y, shortening)))
    at = places[-1].reshape(1, 1, 1, -1)
    sent = light.on_white(medium[n % len(medium)], at * density, at, rays)[0, :, 0]
    return Flakes(places, flux * sent)


def snowing(
    T: Curves | None, medium: Medium, light: Light | None, z: Tensor, metres: Tensor | None = None
) -> Curves | None:
    """The curves of a picture with the light of the medium's particles in their veil.

    Args:
        T: of the picture, from `Light.curves`; None for the medium's own.
        medium: of B or 1 rows.
        light: lamps; None for daylight.
        z, metres (Bx1xHxW tensors): as for `Light.curves`.
    """
    if not medium.snow:
        return T
    if torch.compiler.is_compiling():
        raise RuntimeError("marine snow cannot be compiled: take medium.with_snow(None)")
    T = medium.curves(z) if T is None else T
    layers = []
    for n in range(max(len(z), len(medium))):
        drawn = flakes(medium, light, z, metres, n)
        scene = (z if metres is None else metres)[n % len(z)]
        layers.append(T.veil.new_zeros(3, *z.shape[-2:]) if drawn is None else splat(drawn, scene))
    return T._replace(veil=T.veil + torch.stack(layers))


def splat(flakes: Flakes, scene: Tensor) -> Tensor:
    """The light of particles (3xHxW) before a scene (1xHxW), m."""
    height, width = scene.shape[-2:]
    layer = scene.new_zeros(3, height * width)
    reach = flakes.places[3].ceil()
    least = 0.0
    # those of about a size together, in squares of pixels that hold each of them
    while bool((reach > least).any()):
        most = max(2 * least, 2.0)
        alike = (reach > least) & (reach <= most)
        least = most
        column, row, inner, outer, *form, metres = flakes.places[:, alike, None, None]
        side = torch.arange(-most, most + 1, dtype=scene.dtype, device=scene.device)
        across, down = column.round() + side, row.round() + side[:, None]
        dx, dy = across - column, down - row
        away = (form[0] * dx * dx + form[1] * dx * dy + form[2] * dy * dy).clamp(min=0.0).sqrt()
        shares = ((outer - away) / (outer - inner)).clamp(0.0, 1.0)
        shares = shares / shares.sum((-2, -1), keepdim=True)
        inside = (across >= 0) & (across < width) & (down >= 0) & (down < height)
        place = (down.clamp(0, height - 1) * width + across.clamp(0, width - 1)).long()
        shares = torch.where(inside & (scene.flatten()[place] > metres), shares, 0.0)
        added = flakes.light[:, alike, None, None] * shares
        layer = layer.index_add(1, place.flatten(), added.flatten(1))
    return layer.reshape(3, height, width)
