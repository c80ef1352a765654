"""The near-field veil of a lamp: its light that the water scatters into the camera, once.

Along a ray of the camera, s metres from it, the water scatters b·p(α) of the lamp's light to the
camera, of which e^(−G(s + r)) is left of both legs:

    B_c(z) = π·power ∫_0^z Σ_l f_cl e^(−G_l (s + r)) p(α) cone(ψ) / r² ds

r is the distance to the lamp, α the angle of scattering with p of Henyey & Greenstein (1941), ψ the
angle to the lamp's axis; f_cl are the weights of b. In the angle θ = atan((s − s₀)/h) that the lamp
sees (Kulla & Fajardo 2012, equiangular), with s₀ the ray's nearest point to the lamp and h the
distance there, ds/r² is dθ/h: the inverse square is gone, cos α = −sin θ, cos ψ is a sine, and

    s + r = s₀ + h·tan(π/4 + θ/2)

What is left is smooth within the cone, whose ends in θ are known. Gauss quadrature projects it onto
Legendre polynomials, whose integral is a polynomial in θ: the veil at any distance of that ray. Its
few coefficients vary slowly from ray to ray: they are made on a coarse grid.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug.light.beam import Ray, along_axis, column, ray_of
from uwaug.light.rays import View
from uwaug.light.source import Lamp
from uwaug.optics.curves import decay
from uwaug.optics.spectra import Array
from uwaug.optics.unlit import Legs

__all__ = ["Fog", "fog_at", "fog_of", "fog_within"]

_NODES = 16
"""Of the quadrature over the lit part of a ray."""

_TERMS = 6
"""Of the polynomials. With 4 the worst of the lamps beside a camera is off by .004, with 6 by .001,
with 12 by .001.
"""

_GRID = 65
"""Rays along either side of the picture. With 33 the worst is off by .002."""

_EPS = 1e-4
"""By which a cosine stays within −1…1, where the slope of its angle is endless."""


class Fog(NamedTuple):
    """The veil of a lamp at some rows of rays that span the picture.

    Attributes:
        planes (BxNxnxW tensor): where the lit part of a ray begins, θ, and 1/its length; then the
            coefficients of each channel.
        top, bottom (): tangents of the first and the last row.
    """

    planes: Tensor
    top: Tensor
    bottom: Tensor


class _Lit(NamedTuple):
    """What the lamp lights of a ray, from one angle θ over a span; and cos ψ(θ) as
    across·cos θ + along·sin θ.
    """

    low: Tensor
    span: Tensor
    across: Tensor
    along: Tensor


def _lit(lamp: Lamp, view: View, ray: Ray, far: Tensor | None) -> _Lit:
    """The part of each ray within the lamp's cone, up to the angle `far`, or to infinity."""
    along, onto = along_axis(lamp, view)
    across = (ray.middle * along - onto) / ray.height
    low = torch.atan2(-ray.middle, ray.height)
    high = torch.full_like(low, math.pi / 2) if far is None else far
    size = torch.sqrt((across.square() + along.square()).clamp(min=_EPS**2))
    _, outer = lamp.edges()
    outer = column(outer)
    half = torch.acos((outer / size).clamp(-1 + _EPS, 1 - _EPS))
    half = torch.where(outer >= size, 0.0, half)
    middle = torch.atan2(along, across)
    # a cone of more than a right angle may leave dark the middle of a ray: there nothing is cut
    wide = outer < 0
    low = torch.where(wide, low, torch.maximum(low, middle - half))
    high = torch.where(wide, high, torch.minimum(high, middle + half))
    return _Lit(low, (high - low).clamp(min=0.0), across, along)


def _source(lamp: Lamp, legs: Legs, ray: Ray, lit: _Lit, theta: Tensor) -> Tensor:
    """H times what reaches the camera from each angle, per unit of it (Bx3xHxW…), at `theta`
    (BxMxHxW).
    """
    sine, cosine = torch.sin(theta), torch.cos(theta)
    g = column(lamp.asymmetry)
    # cos α = −sin θ; the 4π of the phase function and the π of a white plate leave 1/4
    phase = 0.25 * (1 - g * g) * (1 + g * g + 2 * g * sine).clamp(min=_EPS).pow(-1.5)
    seen = lamp.cone_at(lit.across * cosine + lit.along * sine) * phase
    path = ray.middle + ray.height * torch.tan(math.pi / 4 + theta / 2).clamp(min=0.0)
    b, m, height, width = path.shape
    flat = path.clamp(min=0.0).reshape(b, 1, -1)
    arrives = legs.scatter @ decay(legs.G[..., None], flat)
    power = (lamp.power[:, None] * lamp.colour)[:, :, None, None, None]
    result = arrives.reshape(-1, 3, m, height, width) * seen[:, None]
    return result * power


def fog_of(lamp: Lamp, legs: Legs, view: View) -> Fog:
    """The veil of a lamp as polynomials along the rays of a picture.

    Args:
        lamp: of B or 1 rows.
        legs: of the medium, for this lamp's spectrum.
        view: of the whole picture.
    """
    x, y = _spread(view.x, 3), _spread(view.y, 2)
    coarse = View(x, y)
    ray = ray_of(lamp, coarse)
    lit = _lit(lamp, coarse, ray, None)
    nodes, project = (one.to(x) for one in _rules())
    theta = lit.low + lit.span * nodes.reshape(1, -1, 1, 1)
    values = _source(lamp, legs, ray, lit, theta) * lit.span[:, None]
    coefficients = torch.einsum("km,bcmhw->bckhw", project, values).flatten(1, 2)
    low = lit.low.expand(len(coefficients), -1, -1, -1)
    steep = 1 / lit.span.clamp(min=_EPS).expand_as(low)
    planes = _between(torch.cat([low, steep, coefficients], 1), x, view.x, 3)
    return Fog(planes, y[0, 0, 0, 0], y[0, 0, -1, 0])


def _spread(tangents: Tensor, axis: int) -> Tensor:
    """A few tangents from the first to the last."""
    first, last = tangents.narrow(axis, 0, 1), tangents.narrow(axis, tangents.shape[axis] - 1, 1)
    shape = [1, 1, 1, 1]
    shape[axis] = _GRID
    t = torch.linspace(0, 1, _GRID, dtype=tangents.dtype, device=tangents.device).reshape(shape)
    return first + (last - first) * t


def _between(planes: Tensor, given: Tensor, wanted: Tensor, axis: int) -> Tensor:
    """Planes at other tangents along an axis, by linear interpolation of those at a few `given`."""
    first, last = given.flatten()[0], given.flatten()[-1]
    gap = (last - first).clamp(min=_EPS)
    at = ((wanted - first) / gap).clamp(0.0, 1.0) * (_GRID - 1)
    index = at.detach().floor().clamp(max=_GRID - 2)
    rows = index.flatten().to(torch.int64)
    before, after = planes.index_select(axis, rows), planes.index_select(axis, rows + 1)
    return torch.lerp(before, after, (at - index).expand_as(before))


@lru_cache(maxsize=1)
def _rules() -> tuple[Tensor, Tensor]:
    """Nodes in 0…1 (M), and what makes of the values there the coefficients (K, M) of a polynomial
    Q in u = 2x − 1, where the integral from 0 to x is x·Q(u).
    """
    points, weights = np.polynomial.legendre.leggauss(_NODES)
    rows = np.zeros((_TERMS, _NODES))
    for k in range(_TERMS):
        one = np.zeros(k + 1)
        one[k] = 1.0
        # ∫ dx is ∫ du/2, from u = −1; it holds the factor x = (u + 1)/2
        power = np.polynomial.legendre.leg2poly(np.polynomial.legendre.legint(one, lbnd=-1) / 2)
        quotient: Array = np.polynomial.polynomial.polydiv(power, [0.5, 0.5])[0]
        legendre = np.polynomial.legendre.legval(points, one)
        share = (2 * k + 1) * weights / 2 * legendre
        rows[: len(quotient)] += np.multiply.outer(quotient, share)
    return torch.from_numpy((points + 1) / 2), torch.from_numpy(rows)


def fog_within(fog: Fog, view: View, ray: Ray, z: Tensor, columns: slice) -> Tensor:
    """The veil in front of points at distance z (Bx3xHxW); those of some `columns`."""
    ends = torch.stack([fog.top, fog.bottom])
    planes = _between(fog.planes[..., columns], ends, view.y, 2)
    theta = torch.atan((z - ray.middle) / ray.height)
    low, steep = planes[:, :1], planes[:, 1:2]
    x = ((theta - low) * steep).clamp(0.0, 1.0)
    u = 2 * x - 1
    rows = torch.unflatten(planes[:, 2:], 1, (3, _TERMS))
    total = rows[:, :, -1]
    for k in range(_TERMS - 2, -1, -1):
        total = torch.addcmul(rows[:, :, k], total, u)
    return total * (x / ray.height)


def fog_at(lamp: Lamp, legs: Legs, view: View, ray: Ray, z: Tensor) -> Tensor:
    """The veil in front of points at distance z (Bx3xHxW), by quadrature along each ray."""
    lit = _lit(lamp, view, ray, torch.atan((z - ray.middle) / ray.height))
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    t = torch.from_numpy((nodes + 1) / 2).to(z).reshape(1, -1, 1, 1)
    share = torch.from_numpy(weights / 2).to(z).reshape(1, 1, -1, 1, 1)
    values = _source(lamp, legs, ray, lit, lit.low + lit.span * t)
    return (values * share).sum(2) * (lit.span / ray.height)
