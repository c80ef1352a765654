"""The three curves of distance at every pixel, as sums of exponentials."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

FARTHEST = 1e9
"""m, stands for z = +inf, so that 0·inf never arises; any rate above 1e-7/m is spent by then."""

_CANCELS = 1 / 256
"""Optical depth; nearer, 1 − e^−x keeps less than 16 of the 24 bits of single precision, and the
veil less than 2e-5 of itself.
"""

_LOG2E = math.log2(math.e)


class Curves(NamedTuple):
    """T_β, T_G − T_β and V(0) − V at given distances, one value for each channel."""

    direct: Tensor
    scatter: Tensor
    veil: Tensor


class Sums(NamedTuple):
    """A medium's curves as one matrix product of exponentials; made by `Medium.sums`.

    Attributes:
        rates (BxRx1): first 0 (its exponential is 1 and carries the constants), then the rates of
            the direct term, then those that signal and veil share.
        weights (Bx9xR): the three curves, of three channels each.
        shifted: the first of the rates whose exponentials stand for e^−x − 1; None if all stand
            for e^−x.
    """

    rates: Tensor
    weights: Tensor
    shifted: int | None


def curves(sums: Sums, z: Tensor) -> Curves:
    """Σ weight·e^(−rate·z), for each curve and channel, at every pixel.

    Args:
        sums: from `Medium.sums`.
        z (Bx1xHxW tensor): effective distance, m, finite, ≥ 0.

    Returns:
        Each (B, 3, H, W), B the larger of the two batches.
    """
    flat, split = z.flatten(1)[:, None], sums.shifted
    if split is None:
        left = decay(sums.rates, flat)
    else:
        shifted = torch.mul(-sums.rates[:, split:], flat).expm1_()
        left = torch.cat([decay(sums.rates[:, :split], flat), shifted], 1)
    b = left.shape[0]  # len() of it would be fixed in a graph
    shape = (b, 3, *z.shape[-2:])
    if torch.compiler.is_compiling():  # ONNX Runtime would copy the parts of one product
        parts = [sums.weights[:, row : row + 3] @ left for row in (0, 3, 6)]
    else:  # three products take half as long again
        parts = list(torch.split(sums.weights.expand(b, -1, -1) @ left, 3, 1))
    return Curves(*(part.reshape(shape) for part in parts))


def decay(rates: Tensor, z: Tensor) -> Tensor:
    """e^(−rate·z), of shapes that broadcast."""
    if torch.compiler.is_compiling():
        return torch.exp(-rates * z)  # ONNX has no exp2
    return (rates * -_LOG2E * z).exp2_()  # four times as fast as exp


def cancels(rate: Tensor, z: Tensor) -> bool:
    """Whether 1 − e^(−rate·z) would lose digits anywhere, so that e^x − 1 has to be used."""
    return bool((rate * z <= _CANCELS).any())
