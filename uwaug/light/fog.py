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
from typing import NamedTuple

import torch
from torch import Tensor

from uwaug._support.torch_func import transformed
from uwaug.light.beam import Ray, along, before_camera, column, ray_of
from uwaug.light.rays import View
from uwaug.light.rules import TERMS, rules
from uwaug.light.source import Lamp
from uwaug.optics.curves import decay
from uwaug.optics.inherent import Legs

__all__ = ["Fog", "fog_at", "fog_of", "fog_within", "terms_of"]

_GRID = 49
"""Rays along either side of the picture. With 33 the worst is off by .002, with 49 by .001, as with
65.
"""

_SHOWS = 5e-4
"""Of the veil: less is left out."""

_WIDEST, _FEW = 1.2, 25
"""The tangent of 50°, and rays on which is looked for what shows."""

_LEAST = 1e-6
"""Stands for the cosine at the far end of a ray."""

_EPS = 1e-4
"""By which a cosine stays within −1…1, where the slope of its angle is endless."""


class Fog(NamedTuple):
    """The veil of a lamp at some rows of rays that span the picture.

    Attributes:
        planes (BxnxNxW tensor): where the lit part of a ray begins, θ, and 1/its length; then the
            coefficients of three channels, from the lowest power up.
        tangents (n tensor): of the rows.
    """

    planes: Tensor
    tangents: Tensor


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
    forward = along(lamp.direction, view)
    across = (ray.middle * forward - before_camera(lamp)) / ray.height
    low = torch.atan2(-ray.middle, ray.height)
    high = torch.full_like(low, math.pi / 2) if far is None else far
    size = torch.sqrt((across.square() + forward.square()).clamp(min=_EPS**2))
    _, outer = lamp.edges()
    outer = column(outer)
    half = torch.acos((outer / size).clamp(-1 + _EPS, 1 - _EPS))
    half = torch.where(outer >= size, 0.0, half)
    middle = torch.atan2(forward, across)
    # a cone of more than a right angle may leave dark the middle of a ray: there nothing is cut
    wide = outer < 0
    low = torch.where(wide, low, torch.maximum(low, middle - half))
    high = torch.where(wide, high, torch.minimum(high, middle + half))
    return _Lit(low, (high - low).clamp(min=0.0), across, forward)


def _source(lamp: Lamp, legs: Legs, ray: Ray, lit: _Lit, theta: Tensor) -> Tensor:
    """H times what reaches the camera from each angle, per unit of it (Bx3xHxW…), at `theta`
    (BxMxHxW).
    """
    # half angles: near the lamp 1 + sin θ would cancel
    up, level = torch.sin(math.pi / 4 + theta / 2), torch.cos(math.pi / 4 + theta / 2)
    raised, cosine = 2 * up.square(), 2 * up * level
    g = column(lamp.asymmetry)
    # cos α = −sin θ; the 4π of the phase function and the π of a white plate leave 1/4
    root = ((1 - g).square() + 2 * g * raised).rsqrt()
    phase = root * root.square() * (0.25 * (1 - g * g))
    seen = lamp.cone_at(lit.across * cosine + lit.along * (raised - 1)) * phase
    path = ray.middle + ray.height * up / level.clamp(min=_LEAST)
    b, m, height, width = path.shape
    flat = path.clamp(min=0.0).reshape(b, 1, -1)
    arrives = legs.scatter @ decay(legs.G[..., None], flat)
    return arrives.reshape(-1, 3, m, height, width) * seen[:, None]


def fog_of(lamp: Lamp, legs: Legs, view: View, terms: int) -> Fog:
    """The veil of a lamp as polynomials along the rays of a picture.

    Args:
        lamp: of B or 1 rows.
        legs: of the medium, for this lamp's spectrum.
        view: of the whole picture.
        terms: of the polynomials, see `terms_of`.
    """
    x, y = _spread(view.x, 3), _spread(view.y, 2)
    _, lit, series = _series(lamp, legs, View(x, y))
    powers = rules()[3].to(x)[:terms, :terms]
    coefficients = torch.einsum("jk,bkchw->bjchw", powers, series[:, :terms]).flatten(1, 2)
    low = lit.low.expand(len(coefficients), -1, -1, -1)
    steep = 1 / lit.span.clamp(min=_EPS).expand_as(low)
    planes = torch.cat([low, steep, coefficients], 1)
    planes = planes @ _tents(x.flatten(), view.x.flatten()).T
    return Fog(planes.transpose(1, 2).contiguous(), y.flatten())


def _series(lamp: Lamp, legs: Legs, view: View) -> tuple[Ray, _Lit, Tensor]:
    """The veil along each ray, times h, as a series (BxKx3xHxW) of integrals of Legendre
    polynomials.
    """
    ray = ray_of(lamp, view)
    lit = _lit(lamp, view, ray, None)
    nodes, _, project, _ = [rule.to(view.x) for rule in rules()]
    theta = lit.low + lit.span * nodes.reshape(1, -1, 1, 1)
    values = _source(lamp, legs, ray, lit, theta) * lit.span[:, None]
    return ray, lit, torch.einsum("km,bcmhw->bkchw", project, values)


def terms_of(lamp: Lamp, legs: Legs) -> int:
    """How many polynomials show in any view of up to 100° across; all of them where numbers may
    change or cannot be looked at.
    """
    if torch.compiler.is_compiling() or transformed() or legs.scatter.requires_grad:
        return TERMS
    if any(value.requires_grad for value in lamp.tensors().values()):
        return TERMS
    tangents = torch.linspace(-_WIDEST, _WIDEST, _FEW).to(legs.G)
    view = View(tangents.reshape(1, 1, 1, -1), tangents.reshape(1, 1, -1, 1))
    ray, _, series = _series(lamp, legs, view)
    size = (series.abs().amax(2) / ray.height).amax((0, 2, 3))
    left = size.flip(0).cumsum(0).flip(0)  # of what comes from each of them on
    return max(1, int((left > _SHOWS).sum()))


def _spread(tangents: Tensor, axis: int) -> Tensor:
    """A few tangents from the first to the last."""
    first, last = tangents.narrow(axis, 0, 1), tangents.narrow(axis, tangents.shape[axis] - 1, 1)
    shape = [1, 1, 1, 1]
    shape[axis] = _GRID
    t = torch.linspace(0, 1, _GRID, dtype=tangents.dtype, device=tangents.device).reshape(shape)
    return first + (last - first) * t


def _tents(given: Tensor, wanted: Tensor) -> Tensor:
    """What interpolates linearly (MxN) from N tangents of even steps to M others.

    As a product it takes a tenth of the time of picking columns, and a third of picking rows.
    """
    gap = (given[-1] - given[0]).clamp(min=_EPS)
    at = ((wanted - given[0]) / gap).clamp(0.0, 1.0) * (_GRID - 1)
    index = torch.arange(_GRID, dtype=at.dtype, device=at.device)
    return (1 - (at[:, None] - index).abs()).clamp(min=0.0)


def fog_within(fog: Fog, view: View, ray: Ray, z: Tensor, columns: slice) -> Tensor:
    """The veil in front of points at distance z (Bx3xHxW); those of some `columns`."""
    tents, grid = _tents(fog.tangents, view.y.flatten()), fog.planes[..., columns]
    if not torch.compiler.is_compiling():  # of a strip, few rows of the grid are needed
        used = torch.nonzero(tents.amax(0)).flatten()
        few = slice(int(used[0]), int(used[-1]) + 1)
        tents, grid = tents[:, few], grid[:, few]

    def plane(first: int, count: int) -> Tensor:
        rows = tents @ grid[:, :, first : first + count].flatten(2)
        return torch.unflatten(rows, 2, (count, grid.shape[3]))

    theta = torch.atan((z - ray.middle) / ray.height).transpose(1, 2)
    x = ((theta - plane(0, 1)) * plane(1, 1)).clamp(0.0, 1.0)
    u = 2 * x - 1
    last = fog.planes.shape[2] - 3
    total = plane(last, 3)
    # one by one, so that they stay in the cache
    for first in range(last - 3, 1, -3):
        total = torch.addcmul(plane(first, 3), total, u)
    return total.transpose(1, 2) * (x.transpose(1, 2) / ray.height)


def fog_at(lamp: Lamp, legs: Legs, view: View, ray: Ray, z: Tensor) -> Tensor:
    """The veil in front of points at distance z (Bx3xHxW), by quadrature along each ray."""
    lit = _lit(lamp, view, ray, torch.atan((z - ray.middle) / ray.height))
    nodes, shares, *_ = [rule.to(z) for rule in rules()]
    theta = lit.low + lit.span * nodes.reshape(1, -1, 1, 1)
    values = _source(lamp, legs, ray, lit, theta)
    return (values * shares.reshape(1, 1, -1, 1, 1)).sum(2) * (lit.span / ray.height)
