"""The picture as a function of a few numbers for each pair, and its slopes: what a fit compares
with what was observed. The image is formed by the same functions as any other.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from uwaug._support.types import Shape
from uwaug.blur.stack import mixed, node_slopes, node_weights
from uwaug.fitting.pixels import Pixels
from uwaug.optics.curves import curves
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

__all__ = ["KINDS", "SLOWEST", "Natural", "medium_of", "rendered", "slopes"]

KINDS = ("beta", "G", "source", "width", "exponent", "gain")
"""The numbers of a pair, in the order of `slopes`."""

SLOWEST = 1e-9
"""1/m, stands for smaller G, where the veil has no end."""

_NARROWEST = 1e-9
"""px, stands for less: widths are proportional to it."""


class Natural(NamedTuple):
    """What the picture of each of P pairs depends on.

    Attributes:
        beta (Px3 tensor): attenuation of the direct light, 1/m.
        G (Px3 tensor): attenuation of signal and veil, 1/m.
        source (Px3 tensor): growth of the veil at the lens, G·V(0), 1/m: what is seen of the veil
            where G is small.
        width (P tensor): σ at the reference distance, px; None if no light is scattered forward.
        exponent (P tensor): of the width law.
        gain (Px3 tensor): of the picture's exposure.
    """

    beta: Tensor
    G: Tensor
    source: Tensor
    width: Tensor | None
    exponent: Tensor | None
    gain: Tensor

    @property
    def veil(self) -> Tensor:
        """V(0) of each pair (Px3)."""
        return self.source / self.G.clamp(min=SLOWEST)


def medium_of(natural: Natural, shape: Shape | None, reference: float) -> Medium:
    """The media, one row for each pair; their width law counts in multiples of the reference."""
    law = PointSpread.none()
    if natural.width is not None and natural.exponent is not None and shape is not None:
        law = PointSpread(natural.width, natural.exponent, shape)
    return Medium.from_coefficients(
        natural.beta,
        natural.G.clamp(min=SLOWEST),
        natural.veil,
        b_mean=1 / reference,
        point_spread=law,
    )


def rendered(natural: Natural, pixels: Pixels, shape: Shape | None) -> Tensor:
    """The pixels (Px3x1xN) as the model has them, in linear light."""
    medium = medium_of(natural, shape, pixels.reference)
    found = curves(medium.sums(exact_at_lens=True), pixels.z)
    light = found.direct * pixels.clean + found.veil
    if shape is not None:
        plan, blurs = pixels.stacks[shape]
        sigma = medium.point_spread.sigma(medium.lengths(pixels.z), None)
        light = light + found.scatter * mixed(blurs, node_weights(sigma, plan))
    return _over_pixels(natural.gain) * light


def slopes(natural: Natural, pixels: Pixels, shape: Shape | None) -> tuple[Tensor, Tensor]:
    """The pixels, and their derivatives (6xPx3x1xN) by each of `KINDS`.

    Written out, as colours do not mix: forward mode through `rendered` takes 25 times as long. A
    test compares the two.
    """
    medium = medium_of(natural, shape, pixels.reference)
    found = curves(medium.sums(exact_at_lens=True), pixels.z)
    z, gain = pixels.z, _over_pixels(natural.gain)
    x, source = _over_pixels(natural.G) * z, _over_pixels(natural.source)
    none = torch.zeros_like(found.direct)
    light = found.direct * pixels.clean + found.veil
    by_beta = -z * found.direct * pixels.clean
    by_G = -source * z * z * _veil_slope(x)
    by_source = z * _veil_growth(x)
    by_width, by_exponent = none, none
    if shape is not None and natural.width is not None:
        plan, blurs = pixels.stacks[shape]
        sigma = medium.point_spread.sigma(medium.lengths(z), None)
        blur = mixed(blurs, node_weights(sigma, plan))
        light = light + found.scatter * blur
        by_beta = by_beta + z * found.direct * blur
        by_G = by_G - z * (found.direct + found.scatter) * blur
        by_logarithm = found.scatter * mixed(blurs, node_slopes(sigma, plan)) * sigma
        by_width = by_logarithm / natural.width.clamp(min=_NARROWEST).reshape(-1, 1, 1, 1)
        by_exponent = by_logarithm * (z / pixels.reference).log()
    each = (by_beta, by_G, by_source, by_width, by_exponent)
    return gain * light, torch.stack([gain * one for one in each] + [light])


def _over_pixels(rows: Tensor) -> Tensor:
    return rows[:, :, None, None]


def _veil_growth(x: Tensor) -> Tensor:
    """(1 − e^−x)/x."""
    small = x < 1e-4
    safe = torch.where(small, 1.0, x)
    return torch.where(small, 1 - x / 2, -torch.expm1(-safe) / safe)


def _veil_slope(x: Tensor) -> Tensor:
    """(1 − e^−x·(1 + x))/x², the derivative of −(1 − e^−x)/x."""
    small = x < 1e-2
    safe = torch.where(small, 1.0, x)
    series = 0.5 - x / 3 + x * x / 8 - x**3 / 30 + x**4 / 144
    return torch.where(small, series, (1 - torch.exp(-safe) * (1 + safe)) / (safe * safe))
