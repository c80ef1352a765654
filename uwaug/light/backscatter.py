"""Near-field backscatter: a lamp's light that the water scatters into the camera, once.

Along a ray of the camera, s metres from it, the water scatters b·p(α) of the lamp's light to the
camera, of which e^(−G(s + r)) is left of both legs:

    B_c(z) = π·power ∫_0^z Σ_l f_cl e^(−G_l (s + r)) p(α) cone(ψ) / r² ds

r is the distance to the lamp, α the angle of scattering with p of Henyey & Greenstein (1941), ψ the
angle to the lamp's axis; f_cl are the weights of b. In the angle θ = atan((s − s₀)/h) that the lamp
sees (Kulla & Fajardo 2012, equiangular), with s₀ the ray's nearest point to the lamp and h the
distance there, ds/r² is dθ/h: the inverse square is gone, cos α = −sin θ, cos ψ is a sine, and

    s + r = s₀ + h·tan(π/4 + θ/2)

What is left is smooth within the cone, whose ends in θ are known; a cone of more than a right angle
may light two parts of a ray. Gauss quadrature projects it onto
Legendre polynomials, whose integral is a polynomial in θ: the veil at any distance of that ray. Its
few coefficients vary slowly from ray to ray: they are made on a coarse grid.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from uwaug._support.torch_func import transformed
from uwaug.light.geometry import Ray, View, along, as_map, before_camera, ray_of
from uwaug.light.light import OBTUSE, Lamp
from uwaug.optics.curves import decay
from uwaug.optics.medium import Medium

_POINTS = 12
"""Of the quadrature over the lit part of a ray: the worst of 450 random lamps is off by 3e-5, with
10 by 2e-4.
"""

_POLYNOMIALS = 6
"""Along a ray, at most. With 4 the worst of the lamps beside a camera is off by .004, with 6 by
.001, with 12 by .001.
"""

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


def _legendre(count: int, x: float) -> list[float]:
    """P_0 to P_count at x."""
    values = [1.0, x]
    for k in range(1, count):
        values.append(((2 * k + 1) * x * values[k] - k * values[k - 1]) / (k + 1))
    return values


def _gauss(count: int) -> tuple[list[float], list[float]]:
    """Nodes and weights of the Gauss–Legendre quadrature over −1…1: Newton's steps to the zeros of
    P_count. NumPy's take 5 ms to import, and compiled code cannot compute with them.
    """
    nodes, weights = [], []
    for k in reversed(range(count)):
        x = math.cos(math.pi * (k + 0.75) / (count + 0.5))
        for _ in range(8):
            *_, before, value = _legendre(count, x)
            slope = count * (before - x * value) / (1 - x * x)
            x -= value / slope
        nodes.append(x)
        weights.append(2 / ((1 - x * x) * slope * slope))
    return nodes, weights


def _quotients() -> list[list[float]]:
    """For k < _POLYNOMIALS, the polynomial Q_k in u = 2x − 1, from the lowest power up, with
    (2k + 1)·∫_−1^u P_k(v) dv/2 = x·Q_k(u).
    """
    powers = [[1.0], [0.0, 1.0]]  # of P_k
    for k in range(1, _POLYNOMIALS):
        raised = [0.0, *((2 * k + 1) * c for c in powers[k])]
        lower = [k * c for c in powers[k - 1]] + [0.0, 0.0]
        powers.append([(a - b) / (k + 1) for a, b in zip(raised, lower, strict=True)])
    quotients = [[1.0]]
    for k in range(1, _POLYNOMIALS):
        lower = [*powers[k - 1], 0.0, 0.0]
        integral = [(a - b) / 2 for a, b in zip(powers[k + 1], lower, strict=True)]
        # divided by x = (u + 1)/2, from the highest power down
        quotient = [0.0] * (k + 1)
        rest = 0.0
        for power in range(k, -1, -1):
            rest = 2 * integral[power + 1] - rest
            quotient[power] = rest
        quotients.append(quotient)
    return quotients


_NODES, _WEIGHTS = _gauss(_POINTS)

_THETA = torch.tensor([(x + 1) / 2 for x in _NODES], dtype=torch.float64, device="cpu")
"""Nodes (M) as shares of the lit part of a ray."""

_SHARES = torch.tensor([w / 2 for w in _WEIGHTS], dtype=torch.float64, device="cpu")
"""Their weights (M)."""

_PROJECT = (
    torch.tensor(
        [_legendre(_POLYNOMIALS - 1, x) for x in _NODES], dtype=torch.float64, device="cpu"
    ).T.contiguous()
    * _SHARES
)
"""From values at the nodes to the coefficients (K, M) of integrals of Legendre polynomials, none of
which exceeds 1.
"""

_POWERS = torch.tensor(
    [q + [0.0] * (_POLYNOMIALS - len(q)) for q in _quotients()], dtype=torch.float64, device="cpu"
).T.contiguous()
"""From those to the coefficients (K, K) of a polynomial Q in u = 2x − 1, where the integral from 0
to x is x·Q(u).
"""


class Grid(NamedTuple):
    """The backscatter of a lamp along some rows of rays that span the picture.

    Attributes:
        planes (BxnxNxW tensor): where a lit part of a ray begins, θ, and 1/its length; then the
            coefficients of three channels, from the lowest power up; for one part after the other.
        tangents (n tensor): of the rows.
        parts: of a ray, that may be lit, 1 or 2.
    """

    planes: Tensor
    tangents: Tensor
    parts: int


class _LitPart(NamedTuple):
    """A part of a ray that the lamp lights, from one angle θ over a span; and cos ψ(θ) as
    across·cos θ + along·sin θ.
    """

    low: Tensor
    span: Tensor
    across: Tensor
    along: Tensor


def _lit(lamp: Lamp, view: View, ray: Ray, last: Tensor | None, wide: bool) -> list[_LitPart]:
    """The parts of each ray within the lamp's cone, up to the angle `last`, or to infinity.

    wide: see `Lamp.wide`; such a lamp lights what is before the dark on its back, and behind it.
    """
    forward = along(lamp.direction, view)
    across = (ray.middle * forward - before_camera(lamp)) / ray.height
    low = torch.atan2(-ray.middle, ray.height)
    high = torch.full_like(low, math.pi / 2) if last is None else last
    size = torch.sqrt((across.square() + forward.square()).clamp(min=_EPS**2))
    _, outer = lamp.edges()
    outer = as_map(outer)
    half = torch.acos((outer / size).clamp(-1 + _EPS, 1 - _EPS))
    half = torch.where(outer >= size, 0.0, half)
    middle = torch.atan2(forward, across)

    def part(low: Tensor, high: Tensor) -> _LitPart:
        return _LitPart(low, (high - low).clamp(min=0.0), across, forward)

    ends = torch.maximum(low, middle - half), torch.minimum(high, middle + half)
    if not wide:
        return [part(*ends)]
    # what is dark lies around the back of the lamp, at the far end of the ray or at the near one
    beside = size.square() - outer.square()
    dark = torch.atan2(torch.sqrt(beside.clamp(min=_EPS**2)), -outer)
    dark = torch.where(beside > 0, dark, 0.0)
    right = middle < 0
    back = torch.where(right, middle + math.pi, middle - math.pi)
    dark_from, dark_to = back - dark, back + dark
    # Where it reaches beyond the ray's end, one piece is lit, and cut in two. From ray to ray the
    # cut moves on such that no part jumps when the dark comes in from the other end.
    centre = (low + high) / 2
    cut_right, cut_left = (
        torch.maximum(centre, high - 2 * dark),
        torch.minimum(centre, low + 2 * dark),
    )
    free = (math.pi / 2 - dark).clamp(min=_EPS)  # the dark is beyond both ends
    cut = torch.lerp(cut_right, cut_left, ((middle / free).clamp(-1.0, 1.0) + 1) / 2)
    beyond_right, beyond_left = right & (dark_to >= high), ~right & (dark_from <= low)
    begin = torch.where(beyond_left, torch.maximum(low, dark_to), low)
    end = torch.where(beyond_right, torch.minimum(high, dark_from), high)
    beyond = beyond_right | beyond_left
    first_end = torch.minimum(torch.where(beyond, cut, dark_from), end)
    second_begin = torch.maximum(torch.where(beyond, cut, dark_to), begin)
    narrow = (outer >= -OBTUSE).expand_as(cut)
    first = part(torch.where(narrow, ends[0], begin), torch.where(narrow, ends[1], first_end))
    return [first, part(torch.where(narrow, high, second_begin), torch.where(narrow, high, end))]


def _source(lamp: Lamp, water: Medium, ray: Ray, lit: _LitPart, theta: Tensor) -> Tensor:
    """The light that the water scatters into the camera from each angle `theta` (BxMxHxW), per unit
    of θ and times the ray's distance h from the lamp (Bx3xMxHxW).
    """
    # half angles: near the lamp 1 + sin θ would cancel
    up, level = torch.sin(math.pi / 4 + theta / 2), torch.cos(math.pi / 4 + theta / 2)
    raised, cosine = 2 * up.square(), 2 * up * level
    g = as_map(lamp.asymmetry)
    # cos α = −sin θ; the 4π of the phase function and the π of a white plate leave 1/4
    root = ((1 - g).square() + 2 * g * raised).rsqrt()
    phase = root * root.square() * (0.25 * (1 - g * g))
    seen = lamp.cone_at(lit.across * cosine + lit.along * (raised - 1)) * phase
    path = ray.middle + ray.height * up / level.clamp(min=_LEAST)
    b, m, height, width = path.shape
    flat = path.clamp(min=0.0).reshape(b, 1, -1)
    arrives = water.veil_weights @ decay(water.G[..., None], flat)
    return arrives.reshape(-1, 3, m, height, width) * seen[:, None]


def grid_of(lamp: Lamp, water: Medium, view: View, polynomials: int, wide: bool) -> Grid:
    """The backscatter of a lamp as polynomials along the rays of a picture.

    Args:
        lamp: of B or 1 rows.
        water: `Medium.under` this lamp's light, of its power and colour.
        view: of the whole picture.
        polynomials: how many, see `polynomials_of`.
        wide: see `Lamp.wide`.
    """
    x, y = _spread(view.x, 3), _spread(view.y, 2)
    powers = _POWERS.to(x)[:polynomials, :polynomials]
    planes = []
    _, parts = _series(lamp, water, View(x, y), wide)
    for lit, series in parts:
        shown = series[:, :polynomials]
        coefficients = torch.einsum("jk,bkchw->bjchw", powers, shown).flatten(1, 2)
        low = lit.low.expand(len(coefficients), -1, -1, -1)
        steep = 1 / lit.span.clamp(min=_EPS).expand_as(low)
        planes += [low, steep, coefficients]
    along_rows = torch.cat(planes, 1) @ _tents(x.flatten(), view.x.flatten()).T
    return Grid(along_rows.transpose(1, 2).contiguous(), y.flatten(), len(parts))


def _series(
    lamp: Lamp, water: Medium, view: View, wide: bool
) -> tuple[Ray, list[tuple[_LitPart, Tensor]]]:
    """The backscatter along each part of each ray, times h, as a series (BxKx3xHxW) of integrals of
    Legendre polynomials.
    """
    ray = ray_of(lamp, view)
    series = []
    for lit in _lit(lamp, view, ray, None, wide):
        theta = lit.low + lit.span * _THETA.to(view.x).reshape(1, -1, 1, 1)
        values = _source(lamp, water, ray, lit, theta) * lit.span[:, None]
        series.append((lit, torch.einsum("km,bcmhw->bkchw", _PROJECT.to(view.x), values)))
    return ray, series


def polynomials_of(lamp: Lamp, water: Medium) -> int:
    """How many polynomials show in any view of up to 100° across; all of them where numbers may
    change or cannot be looked at.
    """
    if torch.compiler.is_compiling() or transformed() or water.requires_grad:
        return _POLYNOMIALS
    if any(value.requires_grad for value in lamp.tensors().values()):
        return _POLYNOMIALS
    like = water.G
    tangents = torch.linspace(-_WIDEST, _WIDEST, _FEW, dtype=like.dtype, device=like.device)
    view = View(tangents.reshape(1, 1, 1, -1), tangents.reshape(1, 1, -1, 1))
    ray, parts = _series(lamp, water, view, lamp.wide)
    sizes = [(series.abs().amax(2) / ray.height).amax((0, 2, 3)) for _, series in parts]
    size = torch.stack(sizes).amax(0)
    tails = size.flip(0).cumsum(0).flip(0)  # of what comes from each of them on
    return max(1, int((tails > _SHOWS).sum()))


def _spread(tangents: Tensor, axis: int) -> Tensor:
    """A few tangents from the first to the last."""
    first, last = tangents.narrow(axis, 0, 1), tangents.narrow(axis, tangents.shape[axis] - 1, 1)
    shape = [1, 1, 1, 1]
    shape[axis] = _GRID
    t = torch.linspace(0, 1, _GRID, dtype=tangents.dtype, device=tangents.device).reshape(shape)
    return first + (last - first) * t


def _tents(nodes: Tensor, places: Tensor) -> Tensor:
    """The matrix (MxN) that interpolates linearly from N tangents of even steps to M others.

    As a product it takes a tenth of the time of picking columns, and a third of picking rows.
    """
    gap = (nodes[-1] - nodes[0]).clamp(min=_EPS)
    at = ((places - nodes[0]) / gap).clamp(0.0, 1.0) * (_GRID - 1)
    index = torch.arange(_GRID, dtype=at.dtype, device=at.device)
    return (1 - (at[:, None] - index).abs()).clamp(min=0.0)


def interpolated(grid: Grid, view: View, ray: Ray, z: Tensor, columns: slice) -> Tensor:
    """The backscatter before points at distance z (Bx3xHxW) in some `columns` of the picture."""
    tents, planes = _tents(grid.tangents, view.y.flatten()), grid.planes[..., columns]
    if not torch.compiler.is_compiling():  # of a strip, few rows of the grid are needed
        used = torch.nonzero(tents.amax(0)).flatten()
        few = slice(int(used[0]), int(used[-1]) + 1)
        tents, planes = tents[:, few], planes[:, few]

    def plane(first: int, count: int) -> Tensor:
        rows = tents @ planes[:, :, first : first + count].flatten(2)
        return torch.unflatten(rows, 2, (count, planes.shape[3]))

    theta = torch.atan((z - ray.middle) / ray.height).transpose(1, 2)
    each = planes.shape[2] // grid.parts
    veil: Tensor | None = None
    for begin in range(0, planes.shape[2], each):
        x = ((theta - plane(begin, 1)) * plane(begin + 1, 1)).clamp(0.0, 1.0)
        u = 2 * x - 1
        last = begin + each - 3
        total = plane(last, 3)
        # one by one, so that they stay in the cache
        for first in range(last - 3, begin + 1, -3):
            total = torch.addcmul(plane(first, 3), total, u)
        part = total.transpose(1, 2) * (x.transpose(1, 2) / ray.height)
        veil = part if veil is None else veil + part
    assert veil is not None
    return veil


def integrated(lamp: Lamp, water: Medium, view: View, ray: Ray, z: Tensor, wide: bool) -> Tensor:
    """The backscatter before points at distance z (Bx3xHxW), by quadrature along each ray."""
    parts = []
    for lit in _lit(lamp, view, ray, torch.atan((z - ray.middle) / ray.height), wide):
        theta = lit.low + lit.span * _THETA.to(z).reshape(1, -1, 1, 1)
        values = _source(lamp, water, ray, lit, theta)
        total = (values * _SHARES.to(z).reshape(1, 1, -1, 1, 1)).sum(2)
        parts.append(total * (lit.span / ray.height))
    return parts[0] if len(parts) == 1 else parts[0] + parts[1]
