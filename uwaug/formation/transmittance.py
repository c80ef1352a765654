"""T_β, T_G − T_β and V(0) − V at pixels, under a light; exact near the lens."""

import math

import torch
from torch import Tensor

from uwaug.light.lit import Lit, seen
from uwaug.optics.curves import Curves
from uwaug.optics.medium import Medium

__all__ = ["any_at_lens", "at_lens", "transmittance"]

_CANCELS = 1 / 256
"""Optical depth; nearer, 1 − e^−x keeps less than 16 of the 24 bits of single precision, and the
veil less than 2e-5 of itself.
"""


def transmittance(medium: Medium, z: Tensor, lit: Lit | None) -> Curves:
    """The transmittances of pixels.

    Args:
        medium: of the type of z.
        z (Bx1xHxW tensor): effective distance, m.
        lit: the light on these pixels; None for daylight as the medium has it.
    """
    # a compiler cannot look at the distances
    exact = torch.compiler.is_compiling() or any_at_lens(z, medium)
    return seen(medium.sums(exact_at_lens=exact), z, lit)


def any_at_lens(z: Tensor, medium: Medium) -> bool:
    """Whether a pixel is so near that V(0) − V(z) cannot be subtracted without cancellation."""
    return at_lens(z.flatten(1).amin(1), medium)


def at_lens(nearest: Tensor, medium: Medium) -> bool:
    """`any_at_lens` from the nearest distance of each picture (B)."""
    slowest = medium.G.masked_fill(medium.G <= 0, math.inf).amin(1)
    return bool((slowest * nearest <= _CANCELS).any())
