"""From spectra to the rates and weights of a medium: coefficients at each band, then sums over few
shared rates.
"""

from collections.abc import Mapping
from typing import Literal, get_args

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import Array
from uwaug.optics.bands import Forward
from uwaug.optics.quadrature import distances_of, reduce_rates
from uwaug.optics.spectra import WAVELENGTHS
from uwaug.optics.surfaces import measure, tensor_of
from uwaug.optics.water import Water

Downwelling = Literal["kd", "beam", "none"]
"""What dims light on its way down: K_d, beam attenuation β, or nothing."""

Dims = Literal["both", "direct", "veil"]
"""What that light is lost to: the picture and the veil, the picture alone, or the veil alone."""

VeilRate = Literal["G", "beta"]
"""At which the veil of each wavelength comes in."""

USUAL = {"downwelling": "kd", "dims": "both", "veil_rate": "G", "forward": "image"}
"""The choices of the paper, and of `uwaug.RandomUnderwater`."""

_LOSSLESS = 1e-6
"""1/m, stands for G = 0, where the veil has the limit μ·b·E·z. Over 20 m it is off by 1e-5 of
that; a smaller one loses digits in V(0) − V(z), two large numbers.
"""

Part = tuple[Tensor, Tensor]
"""Rates (B, K) and weights (B, 3, K) or (B, 3, 3, K) of a curve, or of a part of one."""


def default_bands(water: Water) -> Array:
    """Those of `WAVELENGTHS` that the water covers."""
    low, high = water.wavelengths[[0, -1]]
    bands: Array = WAVELENGTHS[(low <= WAVELENGTHS) & (high >= WAVELENGTHS)]
    if len(bands) == 0:
        cure = "give wavelengths in its range"
        raise ValueError(f"water covers {low:g}–{high:g} nm: no band of 400–700 nm; {cure}")
    return bands


def attenuations(a: Array, b: Array, g: float | Array) -> tuple[Array, Array]:
    """β = a + b and G = a + g·b [1/m] at each band."""
    return a + b, np.maximum(a + g * b, _LOSSLESS)


def light_and_veil(
    beta: Array,
    G: Array,
    b: Array,
    kd: Array,
    *,
    vertical_depth: float,
    mu: float,
    downwelling: Downwelling = "kd",
    dims: Dims = "both",
    veil_rate: VeilRate = "G",
) -> tuple[Array, Array, Array]:
    """Light of the picture, V(0) and rate of the veil [1/m] at each band: E = e^(−K_d d),
    V(0) = μ·b·E/G and G, unless the choices of `uwaug.Medium.from_water` say otherwise.
    """
    checks.one_of("downwelling", downwelling, get_args(Downwelling))
    checks.one_of("dims", dims, get_args(Dims))
    checks.one_of("veil_rate", veil_rate, get_args(VeilRate))
    loss = {"kd": kd, "beam": beta, "none": np.zeros_like(beta)}[downwelling]
    left = np.exp(-loss * vertical_depth)
    full = np.ones_like(left)
    light = full if dims == "veil" else left
    ambient = full if dims == "direct" else left
    rate = G if veil_rate == "G" else np.maximum(beta, _LOSSLESS)
    return light, mu * b * ambient / rate, rate


def reduced(
    beta: Array,
    G: Array,
    light: Array,
    veil: Array,
    veil_rate: Array,
    response: Array,
    basis: Array | None,
    forward: Forward,
    tolerance: float,
) -> tuple[list[Tensor], float]:
    """Rates and weights of a medium in the order of its attributes, and the largest error of a
    curve.

    Args:
        beta, G, light, veil, veil_rate (N arrays): from `attenuations` and `light_and_veil`.
        response (3xN array): of the camera, with its colour matrix if there is a basis; rows sum
            to 1.
        basis (3xN array): reflectances of surfaces with spectra; None for grey ones.
        forward: see `uwaug.Medium.from_water`.
        tolerance: largest error of each curve; 0 keeps every band.
    """
    checks.one_of("forward", forward, get_args(Forward))
    lit, haze = measure(response, basis) * light, response * veil
    if basis is not None and not _mixes(lit, np.stack([beta, G]), tolerance / 2):
        # three numbers serve, and so leave half of the tolerance
        lit, tolerance = response * light, tolerance / 2
    shared = forward == "image" and np.array_equal(veil_rate, G)
    if shared and np.array_equal(beta, G):
        # nothing is scattered forward: of two reductions, the difference would be left
        rates, (direct, veil_weights), error = reduce_rates(beta, (lit, haze), tolerance)
        return _tensors(rates, direct, rates, direct, veil_weights), error
    # forward scatter from D is the sum of three curves
    share = tolerance if forward == "image" else tolerance / 3
    rates, (direct,), error = reduce_rates(beta, (lit,), share)
    if shared:
        G_rates, (signal, veil_weights), other = reduce_rates(G, (lit, haze), tolerance)
        return _tensors(rates, direct, G_rates, signal, veil_weights), max(error, other)
    first = _part(rates, direct)
    veil_rates, (veil_weights,), of_veil = reduce_rates(veil_rate, (haze,), tolerance)
    if forward == "direct":
        sums, (weights,), other = reduce_rates(beta + G, (lit,), share)
        arriving, error = forward_from_direct(first, _part(sums, weights)), 2 * error + other
    else:
        G_rates, (signal,), other = reduce_rates(G, (lit,), tolerance)
        arriving, error = [_part(G_rates, signal)], max(error, other)
    return joined(first, arriving, _part(veil_rates, veil_weights)), max(error, of_veil)


def _mixes(lit: Array, rates: Array, tolerance: float) -> bool:
    """Whether a channel takes more than a tolerance from the other two at some distance.

    Args:
        lit (9xN array): weights of the nine curves.
        rates (2xN array): β and G, 1/m.
    """
    others = lit[[1, 2, 3, 5, 6, 7]]
    if (np.abs(others.sum(1)).reshape(3, 2).sum(1) > tolerance).any():  # at the lens, as most do
        return True
    with np.errstate(over="ignore", invalid="ignore"):
        left = (others @ np.exp(-rate[:, None] * distances_of(rate)) for rate in rates)
        sums = [np.abs(curves).reshape(3, 2, -1).sum(1) for curves in left]
    return max(float(curve.max()) for curve in sums) > tolerance


def forward_from_direct(direct: Part, both: Part) -> list[Part]:
    """The light that arrives at all, if forward scatter is a blur of D instead of J.

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
    arriving = torch.cat([part[1] for part in signal], -1)
    signal_weights = F.pad(arriving, (0, veil[1].shape[-1]))
    veil_weights = F.pad(veil[1], (arriving.shape[-1], 0))
    return [*direct, torch.cat([*rates, veil[0]], 1), signal_weights, veil_weights]


def spectral_note(
    water: str,
    tensors: list[Tensor],
    error: float,
    numbers: Mapping[str, float],
    choices: Mapping[str, str],
) -> str:
    """One line on a medium from spectra, with those of its choices that are not the usual."""
    usual = {**USUAL, "surfaces": "grey"}
    unusual = [f", {name} = {value}" for name, value in choices.items() if value != usual[name]]
    if choices["surfaces"] == "spectral":
        mixes = tensors[1].ndim == 4
        unusual.append(" (3×3 weights)" if mixes else " (3 weights serve: channels do not mix)")
    return (
        f"{water}: {tensors[0].shape[1]} + {tensors[2].shape[1]} rates, "
        f"curves within {error:.1g} at any distance, "
        f"{numbers['vertical_depth']:g} m deep, g = {numbers['g']:g}, μ = {numbers['mu']:g}"
        + "".join(unusual)
    )


def _part(rates: Array, weights: Array) -> Part:
    first, second = _tensors(rates, weights)
    return first, second


def _tensors(*arrays: Array) -> list[Tensor]:
    return [tensor_of(array)[None] for array in arrays]
