"""The three curves of distance at every pixel, as sums of exponentials."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from uwaug.optics.surfaces import as_matrices

FARTHEST = 1e9  # m, stands for +inf, so that 0·inf never arises
_LOG2E = math.log2(math.e)


class Curves(NamedTuple):
    """T_β, T_G − T_β and V(0) − V at given distances, one value for each channel (Bx3xHxW); of
    surfaces with spectra, T_β and T_G − T_β are matrices (Bx3x3xHxW), see `passed`.
    """

    direct: Tensor
    scatter: Tensor
    veil: Tensor

    def image(self, J: Tensor, soft: Tensor) -> Tensor:
        return self.veil + passed(self.direct, J) + passed(self.scatter, soft)

    def parts(self, J: Tensor, soft: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """D, F and B (Bx3xHxW), which add up to `image`."""
        return passed(self.direct, J), passed(self.scatter, soft), self.veil


class Sums(NamedTuple):
    """A medium's curves as one matrix product of exponentials; made by `Medium.sums`."""

    # BxRx1: 0, whose exponential carries constants, rates of the direct term, of signal and veil
    rates: Tensor
    # Bx9xR: three curves of three channels; Bx21xR of surfaces with spectra, two of nine
    weights: Tensor
    direct: int  # number of the rates of the direct term
    shifted: int | None  # the first rate whose exponential stands for e^−x − 1, if any

    @property
    def is_spectral(self) -> bool:
        return self.weights.shape[1] == 21


def curves(sums: Sums, z: Tensor) -> Curves:
    """Σ weight·e^(−rate·z) of each curve and channel at distances z (Bx1xHxW), m, finite, ≥ 0."""
    exponentials = _exponentials(sums, z)
    b = exponentials.shape[0]  # len() of it would be fixed in a graph
    channels = (3, 3) if sums.is_spectral else (3,)
    # three products take half as long again
    parts = _parts(sums.weights.expand(b, -1, -1) @ exponentials)
    shapes = ((b, *channel, *z.shape[-2:]) for channel in (channels, channels, (3,)))
    return Curves(*(part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)))


def mix(sums: Sums, z: Tensor, light: Tensor, blurred: Tensor) -> Tensor:
    """D + F + B (Bx3xHxW) of surfaces with spectra, from J and its blur. Colours are mixed once for
    each rate and then summed, as Σ T_β·(J − blur) + T_G·blur + V(0) − V: matrices of curves would
    take half as long again.
    """
    stack, size, soft = _exponentials(sums, z), z.shape[-2:], blurred.flatten(2)
    first = 1 + sums.direct
    direct, signal, veil = _parts(sums.weights)
    exponentials = stack[:, :, None].unbind(1)
    terms = list(zip(exponentials[first:], _mixed(signal[..., first:], soft), strict=True))
    if blurred is not light:
        sharp = (light - blurred).flatten(2)
        terms += zip(exponentials[1:first], _mixed(direct[..., 1:first], sharp), strict=True)
    total = torch.addcmul(veil @ stack, *terms[0])  # of the widest batch
    for exponential, colours in terms[1:]:
        total.addcmul_(exponential, colours)
    if sums.shifted is not None:
        total += torch.unflatten(signal[..., 0], 1, (3, 3)) @ soft
    return torch.unflatten(total, -1, size)


def _mixed(weights: Tensor, light: Tensor) -> tuple[Tensor, ...]:
    """Products of the matrix of each rate (Bx9xR) and light (Bx3xN): R tensors (Bx3xN)."""
    matrices = torch.unflatten(weights, 1, (3, 3)).permute(0, 3, 1, 2)
    return torch.unflatten(matrices.flatten(1, 2) @ light, 1, (-1, 3)).unbind(1)


def _parts(rows: Tensor) -> list[Tensor]:
    count = (rows.shape[1] - 3) // 2
    # gradients of slices would each fill all rows with zeros
    return list(torch.split(rows, [count, count, 3], 1))


def _exponentials(sums: Sums, z: Tensor) -> Tensor:
    """e^(−rate·z) of each rate (BxRxN), less 1 from `sums.shifted` on."""
    flat, split = z.flatten(1)[:, None], sums.shifted
    if split is None:
        return decay(sums.rates, flat)
    shifted = torch.mul(-sums.rates[:, split:], flat).expm1_()
    return torch.cat([decay(sums.rates[:, :split], flat), shifted], 1)


def passed(T: Tensor, light: Tensor) -> Tensor:
    """Light (Bx3xHxW) after transmittances: T·J of each channel, or the product of matrices
    (Bx3x3xHxW) and colours.
    """
    if T.ndim < 5:
        return T * light
    red, green, blue = (light[:, j, None] for j in range(3))
    return (T[:, :, 0] * red).addcmul(T[:, :, 1], green).addcmul(T[:, :, 2], blue)


def added(first: Curves, second: Curves) -> Curves:
    """Sum of the curves of two lights. Numbers beside matrices are diagonals: three weights may
    serve for one light where another mixes channels.
    """
    if first.direct.ndim == second.direct.ndim:
        return Curves(*map(torch.add, first, second))
    direct, scatter = (
        as_matrices(a, 2) + as_matrices(b, 2) for a, b in zip(first[:2], second[:2], strict=True)
    )
    return Curves(direct, scatter, first.veil + second.veil)


def decay(rates: Tensor, z: Tensor) -> Tensor:
    if torch.compiler.is_compiling():
        return torch.exp(-rates * z)  # ONNX has no exp2
    return (rates * -_LOG2E * z).exp2_()  # four times as fast as exp
