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
from uwaug.formation.loops.measuring import measured
from uwaug.formation.loops.serving import serves
from uwaug.formation.loops.switch import Path
from uwaug.light.lit import Lit, seen
from uwaug.optics.curves import Sums, curves
from uwaug.optics.medium import Medium

__all__ = [
    "GAINS",
    "Exposure",
    "auto_gain",
    "balanced",
    "brightest",
    "exposed_sums",
    "exposed_under",
    "fixed_gain",
    "gain_of",
    "looks",
    "require_exposure",
]

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
    some = looks(z.shape[-2], z.shape[-1], z.device)
    here = None if lit is None else lit.at(some)
    farthest = z.amax((-3, -2, -1), keepdim=True)
    return balanced(_at(image, some), _at(z, some), farthest, sums, here)


def balanced(
    light: Tensor, z: Tensor, farthest: Tensor, sums: Sums, lit: Lit | None = None
) -> Tensor:
    """The same from what some pixels show.

    Args:
        light (Bx3x1xN tensor): linear light of these pixels.
        z (Bx1x1xN tensor): their effective distances, m.
        farthest (Bx1x1x1 tensor): the largest of all effective distances, m.
        sums: as for `auto_gain`.
        lit: the light on these pixels, if it is not the default.
    """
    found = seen(sums, z, lit)
    arrives = (found.direct + found.scatter) * light + found.veil
    before, after = _luminance(light), _luminance(arrives)
    dark = after <= 0
    gain = torch.where(dark, 1.0, before / torch.where(dark, 1.0, after))
    # the far water is the highlight that a camera protects; a lamp in view may be blown out
    veil = curves(sums, farthest).veil.amax((-3, -2, -1))
    if lit is not None:
        veil = veil * lit.light.daylight()
    return gain.clamp(*GAINS).minimum(1 / veil.clamp(min=1 / GAINS[1]))


def gain_of(
    image: Tensor,
    z: Tensor,
    medium: Medium,
    exposure: Exposure,
    lit: Lit | None = None,
    wanted: Path | None = None,
) -> Tensor:
    """The gain of an exposure: (B,), or (1,) if it is the same for all pictures; `wanted` is the
    path that a record names.
    """
    if exposure != "auto" or not image.numel() or not z.numel():
        return fixed_gain(medium, exposure)
    if lit is None and serves(image, z, medium, "line_of_sight", wanted):
        return _gain_by_loops(image, z, medium)
    return auto_gain(image, z, medium.sums(exact_at_lens=False), lit)


def _gain_by_loops(image: Tensor, z: Tensor, medium: Medium) -> Tensor:
    """`auto_gain` in a fifth of the time, to rounding."""
    pixels = looks(z.shape[-2], z.shape[-1], z.device)
    gains = []
    for n in range(max(len(image), len(z), len(medium))):
        row = medium if len(medium) == 1 else medium[n]
        found = measured(image[n % len(image)], z[n % len(z)], row, pixels)
        before, after = (float(light @ LUMINANCE) for light in (found.before, found.after))
        gain = before / after if after > 0 else 1.0
        most = 1 / max(float(found.veil.max()), 1 / GAINS[1])
        gains.append(min(max(gain, GAINS[0]), GAINS[1], most))
    return z.new_tensor(gains)


def fixed_gain(medium: Medium, exposure: Exposure) -> Tensor:
    """The gain (1,) of an exposure that does not look at the picture."""
    stops = 0.0 if isinstance(exposure, str) else exposure
    return medium.beta.new_full((1,), 2.0**stops)


def exposed_under(
    image: Tensor,
    z: Tensor,
    medium: Medium,
    exposure: Exposure,
    lit: Lit | None,
    wanted: Path | None = None,
) -> tuple[Medium, Lit | None]:
    """The medium and the light (None if it is the default) as a camera of this exposure sees them;
    arguments as for `gain_of`.
    """
    if exposure == "none":
        return medium, lit
    gain = gain_of(image, z, medium, exposure, lit, wanted)
    return medium.brightened(gain), None if lit is None else lit.brightened(gain)


def exposed_sums(image: Tensor, z: Tensor, sums: Sums, exposure: Exposure) -> Sums:
    """The sums of a medium so exposed, for a graph, in which the number of rows is not known."""
    if exposure == "none":
        return sums
    if exposure == "auto":
        gain = auto_gain(image, z, sums)[:, None, None]
        return sums._replace(weights=gain * sums.weights)
    return sums._replace(weights=2.0**exposure * sums.weights)


def brightest(medium: Medium, exposure: Exposure) -> Medium:
    """The medium for which a blur is planned before a picture is seen: an automatic exposure is
    taken to make up for the light that is lost on the way down.
    """
    if exposure == "none":
        return medium
    if exposure == "auto":
        left = medium.signal_weights.detach().sum(-1)
        luminance = (left * left.new_tensor(LUMINANCE)).sum(-1)
        return medium.brightened((1 / luminance.clamp(min=1e-30)).clamp(*GAINS))
    return medium.brightened(medium.beta.new_full((1,), 2.0**exposure))


def looks(height: int, width: int, device: torch.device) -> Tensor:
    """The flat indices of some pixels, spread evenly over a picture."""
    if torch.compiler.is_compiling() or not isinstance(height, int):
        return _looks(height, width, device)
    return _kept_looks(height, width, device)


def _looks(height: int, width: int, device: torch.device) -> Tensor:
    count = torch.arange(_LOOKS, dtype=torch.int64, device=device)
    # of a whole side, and back into pixels: a remainder and a quotient take five times as long
    row, column = (((count * step + _TURN // 2) & (_TURN - 1)) for step in _STEPS)
    return (row * height >> _BITS) * width + (column * width >> _BITS)


@lru_cache(maxsize=8)
def _kept_looks(height: int, width: int, device: torch.device) -> Tensor:
    # what inference mode makes cannot be used outside
    with torch.inference_mode(False):
        return _looks(height, width, device)


def _at(values: Tensor, pixels: Tensor) -> Tensor:
    """Some pixels of a picture or map (BxCxHxW), as one row (BxCx1xN)."""
    flat = values.flatten(-2)
    # index_select takes 18 times as long
    return flat.gather(-1, pixels.expand(*flat.shape[:2], -1))[:, :, None]


def _luminance(light: Tensor) -> Tensor:
    """Mean luminance of each picture, (B,)."""
    means = light.mean((-2, -1))
    return (means * means.new_tensor(LUMINANCE)).sum(-1)
