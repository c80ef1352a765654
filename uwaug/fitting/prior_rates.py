"""How fast light fades in a picture whose open water is known: with distances, and without."""

import math
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug.fitting.prior_water import smooth

__all__ = ["SIDE", "Rates", "metric_rates", "relative_rates"]

_COLOURS = ("red", "green", "blue")

SIDE = 240
"""px: short side at which a picture is looked at, up to twice as much."""

_WINDOW = 11
"""px of these: neighbourhood that holds something dark. With 15, slopes were off by .05."""

_QUANTILES = (0.02, 0.1, 0.5, 0.9, 0.98)
"""Of the light of surfaces at a distance, all of which fade towards the veil. With the darkest
alone red was up to .5 off in transmission, where its veil is as dark as dark surfaces.
"""

_WEIGHT, _ALBEDO = 20.0, 0.02
"""What the darkest of them counts, and the most light that it may reflect: between (1, .05), which
trusts that near and far surfaces are alike, and (100, 0), which trusts that some are black.
"""

_READINGS = ((1.0, 0.05), (100.0, 0.0))
"""These two: where they differ, neither is to be trusted."""

_APART = 0.1
"""In transmission, from where on they differ."""

_GONE = 0.05
"""Transmission at the nearest surfaces, or loss at the farthest, below which a rate is a guess."""

_BINS = 12
"""Steps of distance."""

_FEWEST = 50
"""Pixels of a step, or neighbourhoods of a picture."""

_FADED = 0.1
"""Of the light of what is taken for open water, that may come from a surface."""

_SCATTER = 0.05
"""Relative, of the ratio of two channels' rates over neighbourhoods, from where on it is said."""

_LIGHT = 0.1
"""By how much the darkest of a neighbourhood is lighter than open water, so that it tells nothing;
and the share of such neighbourhoods from which on it is said.
"""

_CONTRARY, _CONTRARY_SHARE = 0.05, 0.03
"""By how much the second bound is above the first, and in how much of the scene, so that it is
said. Where neighbourhoods held something black it was 1 % at most, in the bundled scene 5 to 22 %.
"""


class Rates(NamedTuple):
    """β of each channel, the distance of each pixel (HxW) that they go with, doubts."""

    beta: Tensor
    distance: Tensor
    doubts: list[str]


def metric_rates(light: Tensor, veil: Tensor, water: Tensor, z: Tensor) -> Rates:
    """From how the light of surfaces fades towards the veil, step by step of distance."""
    metres, apart = _steps(light, veil, z.masked_fill(water, torch.nan))
    beta = _fading(metres, apart, veil, _WEIGHT, _ALBEDO)
    _require_far(beta, z[water], metres)
    readings = []
    for weight, albedo in _READINGS:
        rate = _fading(metres, apart, veil, weight, albedo)
        readings.append(torch.exp(-rate[:, None] * metres))
    differ = (readings[0] - readings[1]).abs().amax(1)
    doubts = []
    for c, colour in enumerate(_COLOURS):
        left = torch.exp(-beta[c] * metres)
        if float(left.max()) < _GONE:
            doubts.append(f"the rate of {colour} (hardly any of it is left at any distance)")
        elif float(left.min()) > 1 - _GONE:
            doubts.append(f"the rate of {colour} (it hardly fades)")
        elif float(differ[c]) > _APART:
            why = f"what is dark and what is alike tell transmissions {float(differ[c]):.2f} apart"
            doubts.append(f"the rate of {colour} ({why})")
    return Rates(beta, torch.where(water, torch.inf, z), doubts)


def _steps(light: Tensor, veil: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
    """Mean distance of each of N steps, and there quantiles of light − veil (NxQx3)."""
    known = z.isfinite()
    metres, colours = z[known], smooth(light)[:, known]
    if len(metres) < _BINS * _FEWEST:
        expected = f"expected {_BINS * _FEWEST} at least that are no open water"
        raise ValueError(f"distance is known at {len(metres)} pixels of a small copy: {expected}")
    order = metres.argsort()
    low, high = (float(metres[order[int(q * (len(order) - 1))]]) for q in (0.005, 0.995))
    quantiles = colours.new_tensor(_QUANTILES)
    step = ((metres / low).log() / max(math.log(high / low), 1e-9) * _BINS).floor()
    means, rows = [], []
    for k in range(_BINS):
        inside = step == k
        if int(inside.sum()) >= _FEWEST:
            means.append(metres[inside].mean())
            rows.append(torch.quantile(colours[:, inside], quantiles, dim=1) - veil)
    if len(means) < 3 or high < 1.2 * low:
        got = f"surfaces from {low:.3g} to {high:.3g} m"
        raise ValueError(f"distance: {got} are too much alike to show how light fades")
    return torch.stack(means), torch.stack(rows)


def _fading(metres: Tensor, apart: Tensor, veil: Tensor, weight: float, albedo: float) -> Tensor:
    """β of each channel by least squares: all quantiles fade as (J − V)·e^(−βz), J is free. The
    darkest counts `weight` times and has J of 0 to `albedo`.
    """
    rates = torch.logspace(-3, 1.5, 2000, dtype=torch.float64) / metres.max()
    fades = torch.exp(-rates[:, None] * metres)
    found = []
    for c in range(3):
        seen = apart[:, :, c]
        amplitude = (fades @ seen) / fades.square().sum(1, keepdim=True)
        dark = -float(veil[c])
        amplitude[:, 0] = amplitude[:, 0].clamp(dark, dark + albedo)
        error = (seen - fades[:, :, None] * amplitude[:, None]).square().sum(1)
        error[:, 0] *= weight
        found.append(rates[error.sum(1).argmin()])
    return torch.stack(found)


def _require_far(beta: Tensor, z: Tensor, metres: Tensor) -> None:
    """Refuse what looks like open water and has a distance that is none."""
    near = z[z.isfinite()]
    if 2 * len(near) < len(z):
        return
    middle = float(near.median())
    left = float(torch.exp(-beta.min() * middle))
    if left > _FADED or bool((metres > 1.1 * middle).any()):
        said = f"what looks like open water is {middle:.3g} m away"
        cure = "a wall? Give a picture with open water, +inf in its map"
        raise ValueError(f"picture: {said}, from where {left:.0%} of the light arrives: {cure}")


def relative_rates(light: Tensor, veil: Tensor, water: Tensor) -> Rates:
    """From bounds of t in each neighbourhood: the channel of most veil gives the distance, and the
    ratios of the others' rates to its own are what most neighbourhoods agree on.
    """
    black, white = _bounds(light, veil, water)
    first, scene = int(veil.argmax()), ~water
    tells = scene & (black[first] > 0.05) & (black[first] < 0.9)
    if int(tells.sum()) < max(_FEWEST, 0.05 * int(scene.sum())):
        raise ValueError(
            "picture: hardly any surface is darker than the open water, so that nothing tells how "
            "light fades: give a picture with near surfaces, or distances"
        )
    bound = torch.maximum(black[first], white[first])
    depth = -bound.clamp(0.01, 1).log()
    blank = scene & (bound < -_LIGHT)
    far = float(depth[scene & ~blank].quantile(0.98))
    ratios, doubts = [], []
    for c, colour in enumerate(_COLOURS):
        usable = tells & (black[c] > 0.05) & (black[c] < 0.9)
        if int(usable.sum()) < _FEWEST:
            raise ValueError(f"picture: no surface tells how {colour} fades: give distances")
        own = black[c][usable]
        ratio = own.log() / black[first][usable].log()
        weights = own * -own.log()  # what an error of the rate is worth in transmission
        middle = _median(ratio, weights)
        ratios.append(middle)
        scatter = float(_median((ratio / middle - 1).abs(), weights))
        if scatter > _SCATTER:
            doubts.append(f"the rate of {colour} (half of the picture is {scatter:.0%} off it)")
    contrary = scene & (white[first] > black[first] + _CONTRARY)
    shares = [float(part.sum() / scene.sum()) for part in (blank, contrary)]
    if shares[0] > _LIGHT or shares[1] > _CONTRARY_SHARE:
        doubts.append(f"all distances ({max(shares):.0%} of the scene has nothing dark in it)")
    relative = torch.where(water, torch.inf, depth / far)
    return Rates(torch.stack(ratios) * far, relative.masked_fill(blank, torch.nan), doubts)


def _bounds(light: Tensor, veil: Tensor, water: Tensor) -> tuple[Tensor, Tensor]:
    """What t is more than, by what is darkest and by what is lightest in each neighbourhood (3xhxw
    each); open water is left out.
    """
    # a guided filter over them, or an opening, was no better
    shown, V = smooth(light), veil[:, None, None]
    darkest = -_largest(-shown.masked_fill(water, math.inf))
    lightest = _largest(shown.masked_fill(water, -math.inf))
    darkest, lightest = (torch.where(x.isinf(), V, x) for x in (darkest, lightest))
    return 1 - darkest / V, 1 - (1 - lightest) / (1 - V)


def _largest(values: Tensor) -> Tensor:
    """Over each neighbourhood."""
    radius = max(1, round(_WINDOW * min(values.shape[-2:]) / SIDE / 2))
    wide = F.pad(values[None], (radius,) * 4, value=-math.inf)
    return F.max_pool2d(wide, 2 * radius + 1, 1)[0]


def _median(values: Tensor, weights: Tensor) -> Tensor:
    order = values.argsort()
    total = weights[order].cumsum(0)
    return values[order][torch.searchsorted(total, total[-1] / 2)]
