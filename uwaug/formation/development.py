"""Development: what a camera does between its sensor and a file.

In linear light, after the sum of all terms, in this order:

    compensation    J → 2^stops·J, of the exposure
    white balance   each channel times (Y/mean)^share, then all so that the luminance Y is kept
    saturation      J → Y + saturation·(J − Y), Y the luminance of each pixel
    black point     J → (J − b)/(1 − b), b a share of the luminance of the darkest percent
    gamut           colours outside of sRGB, which have negative channels, move inside
    tone            a curve through black, mid-grey and white

The first three are linear: they change the weights of the medium, and cost nothing. What depends on
the picture is measured where an automatic exposure is, see `uwaug.formation.exposure`.
"""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.checks import DOMAIN
from uwaug.formation.colour import LUMINANCE
from uwaug.formation.exposure import Exposure, auto_gain, metered
from uwaug.optics.curves import Sums, amplified_sums

MID_GREY = 0.18
"""Linear light that a change of contrast leaves as it is."""

_MOST = 16.0
"""Of the ratio of luminance to a channel's mean that a white balance makes up for."""

_DARKEST = 0.01
"""Share of the pixels below the black that is found."""

_BLACKEST = 0.9
"""Of the luminance that becomes black."""

_GAMUT_FROM = 0.75
"""Distance from grey, (max − c)/max, from which on colours are compressed. 1 is where a channel
reaches 0."""

_BEYOND = 1 / (1 - _GAMUT_FROM)

_TOE = 1e-4
"""Linear light below which the curve of tone is straight: curves of less contrast are infinitely
steep at 0.
"""


@dataclass(frozen=True)
class Development:
    """What a camera does between its sensor and a file; nothing by default.

    Attributes:
        compensation: of the exposure, −10…10 stops, on top of it.
        white_balance: share of a grey-world correction, up to 1; 0 and less is none. Luminance is
            kept.
        saturation: 0 for grey, 1 to leave colours as they are, up to 4.
        black_point: share of the luminance of the darkest percent of the picture that becomes
            black, 0…1.
        gamut: share of gamut compression, 0…1. 0 clips negative channels, so that saturated colours
            turn flat; 1 squeezes distances from grey, (max − c)/max, above .75 to below 1, along
            the curve of ACES' reference gamut compression (Academy, S-2020-001) with power 2.
            Colours nearer to grey stay as they are.
        tone: slope of the curve about mid-grey, .25…4: c·k/(p + k) in stops a stop with
            p = .18^c and k = .82·p/(.18 − p); black, mid-grey and white stay. Light above white
            goes on along the curve's slope there.

    Raises:
        TypeError, ValueError: if a number is none, or outside of its range.
    """

    compensation: float = 0.0
    white_balance: float = 0.0
    saturation: float = 1.0
    black_point: float = 0.0
    gamut: float = 0.0
    tone: float = 1.0

    def __post_init__(self) -> None:
        for field in fields(self):
            checks.within(
                f"development: {field.name}", getattr(self, field.name), *DOMAIN[field.name]
            )

    @property
    def measures(self) -> bool:
        """Whether something of it depends on the picture."""
        return self.white_balance > 0 or self.black_point > 0

    @property
    def gain(self) -> float:
        """By how much it may multiply small differences, without a white balance."""
        stretch = 1 / (1 - _BLACKEST * self.black_point)
        return max(self.linear_gain, 1.0) * stretch * _steepest(self.tone)

    @property
    def linear_gain(self) -> float:
        """Of compensation and saturation alone."""
        stops: float = 2.0**self.compensation
        return stops * max(self.saturation, 1.0)

    @property
    def is_neutral(self) -> bool:
        """Whether it does nothing."""
        # number by number, as compilers take it; a white balance below 0 is none
        changes_light = self.compensation != 0 or self.white_balance > 0 or self.saturation != 1
        return self.is_linear and not changes_light

    @property
    def is_linear(self) -> bool:
        """Whether all of it is in the weights of a medium."""
        return self.black_point == 0 and self.gamut == 0 and self.tone == 1


NEUTRAL = Development()


def _gains(development: Development, light: Tensor) -> Tensor:
    """What each channel is multiplied by: (B or 1, 3).

    light (Bx3x1xN tensor): what arrives at some pixels, as exposed.
    """
    stops = 2.0**development.compensation
    if development.white_balance <= 0:
        return light.new_full((1, 3), stops)
    # colours out of sRGB have negative channels, which no picture shows
    means = light.clamp(min=0.0).mean((-2, -1))
    weights = means.new_tensor(LUMINANCE)
    before = (means * weights).sum(-1, keepdim=True)
    lit = before > 0
    before = torch.where(lit, before, 1.0)
    ratio = before / means.maximum(before / _MOST)
    balance: Tensor = ratio**development.white_balance
    after = (balance * means * weights).sum(-1, keepdim=True)
    balance = balance * before / torch.where(after > 0, after, before)
    gains: Tensor = torch.where(lit, balance, 1.0) * stops
    return gains


def linear_part(development: Development, light: Tensor) -> Tensor:
    """What the weights of a medium are multiplied by, as for `Medium.brightened`: gains of the
    channels (B or 1, 3), or matrices (B or 1, 3, 3).

    light (Bx3x1xN tensor): what arrives at some pixels, as exposed.
    """
    each = _gains(development, light)
    if development.saturation == 1:
        return each
    unit = torch.eye(3, dtype=light.dtype, device=light.device)
    grey = light.new_tensor(LUMINANCE).expand(3, 3)
    matrix: Tensor = (grey + development.saturation * (unit - grey)) * each[:, None]
    return matrix


def developed(light: Tensor, linear: Tensor) -> Tensor:
    """Light (Bx3xHxW) after the linear part."""
    if linear.ndim == 2:
        return light * linear[..., None, None]
    return (linear[..., None, None] * light[:, None]).sum(2)


def black_of(development: Development, light: Tensor) -> Tensor:
    """The light that becomes black (B or 1, 1, 1, 1).

    light (Bx3x1xN tensor): what arrives at some pixels, developed up to there.
    """
    if development.black_point == 0:
        return light.new_zeros(1, 1, 1, 1)
    weights = light.new_tensor(LUMINANCE)[:, None, None]
    luminance = (light * weights).sum(1).flatten(1)
    rank = max(1, int(_DARKEST * luminance.shape[1]))
    darkest = luminance.topk(rank, largest=False).values[:, -1].clamp(0.0, _BLACKEST)
    black: Tensor = development.black_point * darkest
    return black.reshape(-1, 1, 1, 1)


def finished(development: Development, light: Tensor, black: Tensor) -> Tensor:
    """What is left to do where light (Bx3xHxW) has passed a medium so developed."""
    if development.black_point > 0:
        light = (light - black) / (1 - black)
    if development.gamut > 0:
        light = compressed(light, development.gamut)
    return light if development.tone == 1 else curved(light, development.tone)


def compressed(light: Tensor, share: float) -> Tensor:
    """Colours outside of the gamut, moved inside by a share of the way; others stay."""
    brightest = light.amax(1, keepdim=True)
    lit = brightest > 0
    distance = 1 - light / torch.where(lit, brightest, 1.0)
    beyond = (distance - _GAMUT_FROM).clamp(min=0.0) * _BEYOND
    squeezed = beyond * (1 + beyond * beyond).rsqrt()
    less = (beyond - squeezed) * ((1 - _GAMUT_FROM) * share)
    # the limit where no channel is above 0, as below the black point
    return light + torch.where(lit, less * brightest, -share * light)


def seen_sums(
    image: Tensor, z: Tensor, sums: Sums, exposure: Exposure, development: Development
) -> tuple[Sums, Tensor]:
    """The sums of a medium as a camera sees them, exposed and developed, and what becomes black,
    see `black_of`; for a graph, in which the number of media is not known.
    """
    if exposure == "auto":
        sums = amplified_sums(sums, auto_gain(image, z, sums))
    elif exposure != "none":
        sums = sums._replace(weights=2.0**exposure * sums.weights)
    light = image.new_zeros(1, 3, 1, 1)
    if development.measures:
        light = metered(image, z, sums)[1]
    linear = linear_part(development, light)
    black = black_of(development, developed(light, linear))
    return (sums if development.is_neutral else amplified_sums(sums, linear)), black


def look_of(development: Development, black: Tensor) -> Tensor:
    """What `finished` does as numbers for the compiled loops (B or 1, 5): black and 1/(1 − black),
    share of the gamut, contrast and k.
    """
    flat = black.detach().reshape(-1, 1)
    contrast = development.tone
    rest = flat.new_tensor([development.gamut, contrast, _offset(contrast)])
    return torch.cat([flat, 1 / (1 - flat), rest.expand(len(flat), 3)], 1)


def _offset(contrast: float) -> float:
    """K of the curve, for which mid-grey stays; 0 where there is none."""
    grey = MID_GREY**contrast
    return 0.0 if contrast == 1 else (1 - MID_GREY) * grey / (MID_GREY - grey)


def _steepest(contrast: float) -> float:
    """The curve's largest slope, about: near mid-grey, or at the toe if contrast is taken away."""
    if contrast >= 1:
        return contrast
    k = _offset(contrast)
    power: float = _TOE**contrast
    return (1 + k) * power / (power + k) / _TOE


def curved(light: Tensor, contrast: float) -> Tensor:
    """Light along the curve (1 + k)·x^c/(x^c + k), odd, through 0, mid-grey and 1; straight below
    `_TOE`, and from 1 on, as curves of c < 1 have a pole beyond.
    """
    k = _offset(contrast)
    size = light.abs().clamp(min=_TOE)
    inside = size.clamp(max=1.0)
    power = inside**contrast
    beyond = (size - inside) * (contrast * k / (1 + k))
    curve: Tensor = light / size * ((1 + k) * power / (power + k) + beyond)
    return curve
