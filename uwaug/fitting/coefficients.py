"""The picture as a function of coefficients of each pair, and its slopes: what a fit compares with
what was observed. The image is formed by the functions that form any other.
"""

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from uwaug._support.types import Shape
from uwaug.blur.stack import mixed, node_slopes, node_weights
from uwaug.fitting.data import Geometry, Pixels
from uwaug.optics.curves import curves
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

MIN_G = 1e-9  # 1/m, stands for smaller G, where the veil has no end
MIN_SCATTERING = 1e-6  # 1/m, or scattering lengths: stands for none in a width law
_MIN_WIDTH = 1e-9  # px, stands for less: widths are proportional to it
_DARKEST = 1e-6  # of linear light: below, a curve of less than 1 has no slope


class Coefficients(NamedTuple):
    """What the picture of each of P pairs depends on.

    Attributes:
        beta (Px3 tensor): attenuation of the direct light, 1/m.
        G (Px3 tensor): attenuation of signal and veil, 1/m.
        veil_slope (Px3 tensor): growth of the veil at the lens, G·V(0), 1/m: what is seen of the
            veil where G is small.
        width (P tensor): σ at the reference distance, px; None if no light is scattered forward.
        exponent (P tensor): of the width law.
        gain (Px3 tensor): of the picture's exposure.
        shading (Px3 tensor): 1 − vignette·r² + down·y + right·x is what light is multiplied by at
            (y, x) half diagonals from the middle, r = |(y, x)|; None for 1.
        tone (P tensor): c of the camera's curve (1 + s)·x^c/(1 + s·x^c), which leaves black and
            white; None if there is no curve.
        shoulder (P tensor): s of the same: 0 for a power, more for lights that are squeezed.
    """

    beta: Tensor
    G: Tensor
    veil_slope: Tensor
    width: Tensor | None
    exponent: Tensor | None
    gain: Tensor
    shading: Tensor | None = None
    tone: Tensor | None = None
    shoulder: Tensor | None = None

    @property
    def veil(self) -> Tensor:
        """V(0) of each pair (Px3)."""
        return self.veil_slope / self.G.clamp(min=MIN_G)

    def at(self, pair: int) -> "Coefficients":
        """Those of one pair."""
        rows = {name: x[pair : pair + 1] for name, x in self._asdict().items() if x is not None}
        return self._replace(**rows)

    def stacked(self) -> Tensor:
        """All numbers of each pair and colour (11xPx3); 0 where there are none."""
        none = torch.zeros_like(self.beta)
        each = [*self[:6], *(3 * [None] if self.shading is None else self.shading.unbind(1))]
        rows = []
        for value in (*each, self.tone, self.shoulder):
            value = none if value is None else value
            rows.append(value if value.ndim == 2 else value[:, None].expand_as(self.beta))
        return torch.stack(rows)

    def media(self, b_mean: Tensor, shape: Shape | None, geometry: Geometry) -> Medium:
        """A batch of media that any picture can be formed in; gains are the cameras' and stay out.

        Args:
            b_mean (P tensor): mean scattering coefficient, 1/m.
            shape: of the point spread; None if no light is scattered forward.
            geometry: of the pictures that were fitted.
        """
        if shape is None or self.width is None or self.exponent is None:
            return lossy_media(self.beta, self.G, self.veil)
        b, exponent = b_mean.clamp(min=MIN_SCATTERING), self.exponent
        # σ = width·(z/reference)^exponent
        scale = self.width / (b * geometry.reference) ** exponent
        law = PointSpread(scale, exponent, shape, geometry.short_side)
        if len(self.beta) == 1:
            law = replace(law, scale=float(scale), exponent=float(exponent))
        return Medium.from_coefficients(self.beta, self.G, self.veil, b_mean=b, point_spread=law)


def lossy_media(beta: Tensor, G: Tensor, veil: Tensor) -> Medium:
    """Media in which all light that leaves the line of sight is lost: T_G = T_β, and a veil that
    has rates of its own.
    """
    unit = torch.diag_embed(torch.ones_like(beta))
    none = torch.zeros_like(unit)
    return Medium(
        beta=beta,
        direct_weights=unit,
        G=torch.cat([beta, G], 1),
        signal_weights=torch.cat([unit, none], 2),
        veil_weights=torch.cat([none, torch.diag_embed(veil)], 2),
        b_mean=beta.new_zeros(len(beta)),
        point_spread=PointSpread.none(),
        notes=("fitted: direct light and veil, no forward scatter",) * len(beta),
    )


def render(c: Coefficients, pixels: Pixels, shape: Shape | None) -> Tensor:
    """The pixels (Px3x1xN) of these coefficients, in linear light; differentiable."""
    return as_taken(arriving(c, pixels, shape), c, pixels.position)


def arriving(c: Coefficients, pixels: Pixels, shape: Shape | None) -> Tensor:
    """The light (Px3x1xN) that arrives at the camera; differentiable."""
    medium = _medium(c, shape, pixels.reference)
    T = curves(medium.sums(exact_at_lens=True), pixels.z)
    light = T.direct * pixels.clean + T.veil
    if shape is not None:
        plan, blurs, _ = pixels.stacks[shape]
        sigma = medium.point_spread.sigma(medium.lengths(pixels.z), None)
        light = light + T.scatter * mixed(blurs, node_weights(sigma, plan))
    return light


def as_taken(light: Tensor, c: Coefficients, position: Tensor) -> Tensor:
    """Light (Px3xHxW) as the camera stores it, still in linear light: shaded, exposed, and along
    its curve.

    position (Px2xHxW tensor): of the pixels, see `Pixels`.
    """
    light = _exposures(c, position) * light
    if c.tone is None or c.shoulder is None:
        return light
    tone, shoulder = _each(c.tone), _each(c.shoulder)
    power = light.clamp(min=_DARKEST) ** tone
    return (1 + shoulder) * power / (1 + shoulder * power)


def _exposures(c: Coefficients, position: Tensor) -> Tensor:
    """What light is multiplied by (Px3x1x1, or at each position)."""
    gain = c.gain[:, :, None, None]
    if c.shading is None:
        return gain
    by_shading = shading_slopes(position)
    return gain * (1 + (c.shading[:, :, None, None] * by_shading).sum(1, keepdim=True))


def shading_slopes(position: Tensor) -> Tensor:
    """What vignette, down and right add to a light of 1 (Px3xHxW) at positions (Px2xHxW)."""
    return torch.cat([-position.square().sum(1, keepdim=True), position], 1)


def _each(numbers: Tensor) -> Tensor:
    return numbers.reshape(-1, 1, 1, 1)


def _medium(c: Coefficients, shape: Shape | None, reference: float) -> Medium:
    """The media, one row for each pair; their width law counts in multiples of the reference."""
    G = c.G.clamp(min=MIN_G)
    if c.width is None or c.exponent is None or shape is None:
        return lossy_media(c.beta, G, c.veil)
    law = PointSpread(c.width, c.exponent, shape)
    return Medium.from_coefficients(c.beta, G, c.veil, b_mean=1 / reference, point_spread=law)


def derivatives(c: Coefficients, pixels: Pixels, shape: Shape | None) -> tuple[Tensor, Tensor]:
    """The pixels, and their derivatives (11xPx3x1xN) by each of the coefficients.

    Written out, as colours do not mix: forward mode through `render` takes 25 times as long. A
    test compares the two.
    """
    medium = _medium(c, shape, pixels.reference)
    T = curves(medium.sums(exact_at_lens=True), pixels.z)
    z = pixels.z
    x, veil_slope = c.G[:, :, None, None] * z, c.veil_slope[:, :, None, None]
    light = T.direct * pixels.clean + T.veil
    by_beta = -z * T.direct * pixels.clean
    by_G = -veil_slope * z * z * _growth_slope(x)
    by_veil_slope = veil_growth(c.G, pixels)
    by_width = by_exponent = torch.zeros_like(T.direct)
    if shape is not None and c.width is not None:
        plan, blurs, _ = pixels.stacks[shape]
        sigma = medium.point_spread.sigma(medium.lengths(z), None)
        blur = mixed(blurs, node_weights(sigma, plan))
        light = light + T.scatter * blur
        by_beta = by_beta + z * T.direct * blur
        by_G = by_G - z * (T.direct + T.scatter) * blur
        by_logarithm = T.scatter * mixed(blurs, node_slopes(sigma, plan)) * sigma
        by_width = by_logarithm / c.width.clamp(min=_MIN_WIDTH).reshape(-1, 1, 1, 1)
        by_exponent = by_logarithm * (z / pixels.reference).log()
    each = (by_beta, by_G, by_veil_slope, by_width, by_exponent)
    exposure = _exposures(c, pixels.position)
    by_gain = light * (exposure / c.gain[:, :, None, None])
    slopes = [*(exposure * slope for slope in each), by_gain]
    if c.shading is None:
        slopes += 3 * [torch.zeros_like(light)]
    else:
        by_shading = shading_slopes(pixels.position)
        slopes += [c.gain[:, :, None, None] * by_shading[:, i, None] * light for i in range(3)]
    light = exposure * light
    if c.tone is None or c.shoulder is None:
        return light, torch.stack([*slopes, *2 * [torch.zeros_like(light)]])
    tone, shoulder = _each(c.tone), _each(c.shoulder)
    size = light.clamp(min=_DARKEST)
    power = size**tone
    below = 1 + shoulder * power
    by_power = (1 + shoulder) / below**2
    slopes = [by_power * tone * power / size * (light >= _DARKEST) * slope for slope in slopes]
    slopes += [by_power * power * size.log(), power * (1 - power) / below**2]
    return (1 + shoulder) * power / below, torch.stack(slopes)


def veil_growth(G: Tensor, pixels: Pixels) -> Tensor:
    """The veil (Px3x1xN) at the pixels for a slope of 1 at the lens: z·(1 − e^−x)/x, x = G·z."""
    x = G[:, :, None, None] * pixels.z
    small = x < 1e-4
    safe = torch.where(small, 1.0, x)
    return pixels.z * torch.where(small, 1 - x / 2, -torch.expm1(-safe) / safe)


def _growth_slope(x: Tensor) -> Tensor:
    """(1 − e^−x·(1 + x))/x², the derivative of −(1 − e^−x)/x."""
    small = x < 1e-2
    safe = torch.where(small, 1.0, x)
    series = 0.5 - x / 3 + x * x / 8 - x**3 / 30 + x**4 / 144
    return torch.where(small, series, (1 - torch.exp(-safe) * (1 + safe)) / (safe * safe))
