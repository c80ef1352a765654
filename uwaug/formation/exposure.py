"""Exposure: what a camera does when the water takes the light.

One gain for a whole picture, in linear light, so that the picture is as bright as the scene was in
air. It multiplies what arrives, picture and veil alike: the medium's weights.
"""

from functools import lru_cache
from typing import Any, Literal

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.formation.colour import LUMINANCE
from uwaug.light.light import Light
from uwaug.light.lit import Lit, transmittance
from uwaug.optics.curves import Curves, Sums, mix, passed, veil_at
from uwaug.optics.medium import Medium

Exposure = Literal["none", "auto"] | float
"""What a camera does about dim light: nothing; one gain that keeps the mean luminance; or a gain in
stops, which doubles the light with each.
"""

GAINS = (1 / 8, 64.0)
"""Of an automatic exposure, −3 to +6 stops: 6 is what a camera has between ISO 100 and 6400."""

_LOOKS = 8192
"""Pixels at which the light is measured. Spread by a quasi-random sequence, they see stripes and
rows of any period, and pictures of any size; the mean luminance of noise is right within 1 %. A
grid of every fourth pixel is off by 10 % at 16 px and blind to stripes of its own period.
"""

_BITS = 20
_TURN = 1 << _BITS
_STEPS = (791_547, 597_521)
"""Of the sequence along rows and columns, of `_TURN` for a whole side: 1/x and 1/x² with x³ = x + 1
(Roberts 2018, the R₂ sequence), as odd whole numbers, which ONNX Runtime multiplies exactly.
"""


def require_exposure(exposure: Any) -> None:
    """Refuse what is neither "none", "auto" nor a number of stops."""
    if isinstance(exposure, bool) or not isinstance(exposure, (int, float)):
        checks.one_of("exposure", exposure, ("none", "auto", "a number of stops"))
    else:
        checks.within("exposure", exposure, *checks.DOMAIN["exposure"])


def auto_gain(image: Tensor, z: Tensor, sums: Sums, lit: Lit | None = None) -> Tensor:
    """The gain with which a degraded picture has the mean luminance of the scene.

    The blur moves light but adds none, so that it is left out: measured is T_G·J + B.

    Args:
        image (Bx3xHxW tensor): linear light.
        z (Bx1xHxW tensor): effective distance, m.
        sums: of the medium, see `uwaug.Medium.sums`.
        lit: the light, if it is not the default.

    Returns:
        (B,) within `GAINS`, and such that the veil of the farthest pixel stays at or below 1; 1
        where no light arrives.
    """
    light, arrives = metered(image, z, sums, lit)
    farthest = z.amax((-3, -2, -1), keepdim=True)
    veil = farthest_veil(sums, farthest, None if lit is None else lit.light)
    return balanced(light, arrives, veil)


def metered(image: Tensor, z: Tensor, sums: Sums, lit: Lit | None = None) -> tuple[Tensor, Tensor]:
    """The light (Bx3x1xN) of the scene at some pixels, and what arrives of it without the blur;
    arguments as for `auto_gain`.
    """
    points = metering_points(z.shape[-2], z.shape[-1], z.device)
    light, metres = _at(image, points), _at(z, points)
    # `mix` goes over the rates, whose number a graph does not know
    if lit is None and sums.is_spectral and not torch.compiler.is_compiling():
        return light, mix(sums, metres, light, light)
    T = transmittance(sums, metres, None if lit is None else lit.at(points))
    return light, arriving(light, T)


def arriving(light: Tensor, T: Curves) -> Tensor:
    """What arrives of light (Bx3x1xN) where transmittances are these, without the blur."""
    return passed(T.direct + T.scatter, light) + T.veil


def balanced(light: Tensor, arrives: Tensor, veil: Tensor) -> Tensor:
    """`auto_gain` from what some pixels show.

    Args:
        light (Bx3x1xN tensor): linear light of these pixels.
        arrives (Bx3x1xN tensor): from `arriving`.
        veil (B tensor): from `farthest_veil`.
    """
    before, after = _luminance(light), _luminance(arrives)
    dark = after <= 0
    gain = torch.where(dark, 1.0, before / torch.where(dark, 1.0, after))
    return gain.clamp(*GAINS).minimum(1 / veil.clamp(min=1 / GAINS[1]))


def farthest_veil(sums: Sums, farthest: Tensor, light: Light | None) -> Tensor:
    """The veil (B) of the farthest pixel, the highlight that a camera protects; a lamp in view may
    be blown out.

    Args:
        sums: as for `auto_gain`.
        farthest (Bx1x1x1 tensor): the largest of all effective distances, m.
        light: as for `uwaug.form_image`.
    """
    veil = veil_at(sums, farthest).amax((-3, -2, -1))
    return veil if light is None or light.plain else veil * light.to(veil).daylight()


def fixed_gain(medium: Medium, exposure: Exposure) -> Tensor:
    """The gain (1,) of an exposure that does not look at the picture."""
    stops = 0.0 if isinstance(exposure, str) else exposure
    return medium.beta.new_full((1,), 2.0**stops)


def exposed_for_planning(medium: Medium, exposure: Exposure, factor: float = 1.0) -> Medium:
    """The medium for which a blur is planned before a picture is seen: an automatic exposure is
    taken to make up for the light that is lost on the way down. `factor`: of the development, on
    top.
    """
    if exposure == "auto":
        left = medium.ambient().detach()
        luminance = (left * left.new_tensor(LUMINANCE)).sum(-1)
        return medium.brightened((1 / luminance.clamp(min=1e-30)).clamp(*GAINS) * factor)
    if exposure == "none" and factor == 1:
        return medium
    return medium.brightened(fixed_gain(medium, exposure) * factor)


def metering_points(height: int, width: int, device: torch.device) -> Tensor:
    """The flat indices of some pixels, spread evenly over a picture."""
    if torch.compiler.is_compiling() or not isinstance(height, int):
        return _points(height, width, device)
    return _cached_points(height, width, device)


def _points(height: int, width: int, device: torch.device) -> Tensor:
    count = torch.arange(_LOOKS, dtype=torch.int64, device=device)
    # of a whole side, and back into pixels: a remainder and a quotient take five times as long
    row, column = (((count * step + _TURN // 2) & (_TURN - 1)) for step in _STEPS)
    return (row * height >> _BITS) * width + (column * width >> _BITS)


@lru_cache(maxsize=8)
def _cached_points(height: int, width: int, device: torch.device) -> Tensor:
    # what inference mode makes cannot be used outside
    with torch.inference_mode(False):
        return _points(height, width, device)


def _at(values: Tensor, pixels: Tensor) -> Tensor:
    """Some pixels of a picture or map (BxCxHxW), as one row (BxCx1xN)."""
    flat = values.flatten(-2)
    # index_select takes 18 times as long
    return flat.gather(-1, pixels.expand(*flat.shape[:2], -1))[:, :, None]


def _luminance(light: Tensor) -> Tensor:
    """Mean luminance of each picture, (B,)."""
    means = light.mean((-2, -1))
    return (means * means.new_tensor(LUMINANCE)).sum(-1)
