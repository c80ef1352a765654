"""From coefficients band by band to the rates and weights of a medium."""

from collections.abc import Mapping
from typing import Literal, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import Array
from uwaug.optics.bands import BandCoefficients
from uwaug.optics.quadrature import reduce_rates

__all__ = [
    "USUAL",
    "Forward",
    "Part",
    "forward_from_direct",
    "joined",
    "reduced",
    "require_forward",
    "spectral_note",
]

Forward = Literal["image", "direct"]
"""What forward scatter is a blur of: the scene J, or the direct light D."""

USUAL = {"downwelling": "kd", "dims": "both", "veil_rate": "G", "forward": "image"}
"""The choices of the paper, and of `uwaug.RandomUnderwater`."""

Part = tuple[Tensor, Tensor]
"""Rates (B, K) and weights (B, 3, K) of a curve, or of a part of one."""


def reduced(
    bands: BandCoefficients, response: Array, forward: Forward, tolerance: float
) -> tuple[list[Tensor], float]:
    """Rates and weights of a medium in the order of its attributes, and the largest error of a
    curve.

    Args:
        bands: of N bands.
        response (3xN array): of the camera; rows sum to 1.
        forward: see `uwaug.Medium.from_water`.
        tolerance: largest error of each curve; 0 keeps every band.
    """
    require_forward(forward)
    lit, haze = response * bands.light, response * bands.veil
    together = forward == "image" and np.array_equal(bands.veil_rate, bands.G)
    if together and np.array_equal(bands.beta, bands.G):
        # nothing is scattered forward: of two reductions, the difference would be left
        rates, (direct, veil), error = reduce_rates(bands.beta, (lit, haze), tolerance)
        return _tensors(rates, direct, rates, direct, veil), error
    # forward scatter from D is the sum of three curves
    share = tolerance if forward == "image" else tolerance / 3
    beta, (direct,), error = reduce_rates(bands.beta, (lit,), share)
    if together:
        G, (signal, veil), more = reduce_rates(bands.G, (lit, haze), tolerance)
        return _tensors(beta, direct, G, signal, veil), max(error, more)
    first = _part(beta, direct)
    veil_rates, (veil,), of_veil = reduce_rates(bands.veil_rate, (haze,), tolerance)
    if forward == "direct":
        sums, (weights,), more = reduce_rates(bands.beta + bands.G, (lit,), share)
        arriving, error = forward_from_direct(first, _part(sums, weights)), 2 * error + more
    else:
        G, (signal,), more = reduce_rates(bands.G, (lit,), tolerance)
        arriving, error = [_part(G, signal)], max(error, more)
    return joined(first, arriving, _part(veil_rates, veil)), max(error, of_veil)


def forward_from_direct(direct: Part, both: Part) -> list[Part]:
    """What arrives at all, if forward scatter is a blur of D instead of J.

    F = (e^(−Gz) − e^(−βz))·blur{D} with D = e^(−βz)·J, so that the light that arrives is
    e^(−βz) + e^(−(β + G)z) − e^(−2βz).

    Args:
        direct: T_β.
        both: the curve whose rates are β + G.
    """
    rates, weights = direct
    return [direct, both, (2 * rates, -weights)]


def joined(direct: Part, signal: list[Part], veil: Part) -> list[Tensor]:
    """Rates and weights of a medium whose signal and veil have rates of their own: they share a
    list of rates, and have weights of 0 where a rate is the other's.
    """
    rates = [part[0] for part in signal]
    arriving = torch.cat([part[1] for part in signal], 2)
    signal_weights = torch.cat([arriving, torch.zeros_like(veil[1])], 2)
    veil_weights = torch.cat([torch.zeros_like(arriving), veil[1]], 2)
    return [*direct, torch.cat([*rates, veil[0]], 1), signal_weights, veil_weights]


def require_forward(forward: str) -> None:
    """Refuse what forward scatter is no blur of."""
    checks.one_of("forward", forward, get_args(Forward))


def spectral_note(
    water: str,
    tensors: list[Tensor],
    error: float,
    numbers: Mapping[str, float],
    choices: Mapping[str, str],
) -> str:
    """One line on a medium from spectra, with those of its choices that are not the usual."""
    said = (
        f"{water}: {tensors[0].shape[1]} + {tensors[2].shape[1]} rates, "
        f"curves within {error:.1g} at any distance, "
        f"{numbers['vertical_depth']:g} m deep, g = {numbers['g']:g}, μ = {numbers['mu']:g}"
    )
    for name, value in choices.items():
        if value != USUAL[name]:
            said += f", {name} = {value}"
    return said


def _part(rates: Array, weights: Array) -> Part:
    first, second = _tensors(rates, weights)
    return first, second


def _tensors(*arrays: Array) -> list[Tensor]:
    return [torch.from_numpy(array[None]) for array in arrays]
