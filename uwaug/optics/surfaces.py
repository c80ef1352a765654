"""Surfaces with spectra, and the camera's colour matrix.

An sRGB colour (R, G, B) is taken for a surface that reflects

    ρ(λ) = R·ρ_R(λ) + G·ρ_G(λ) + B·ρ_B(λ),        ρ_R + ρ_G + ρ_B = 1

with the three basis reflectances of Mallett and Yuksel, *Spectral primary decomposition for
rendering with sRGB reflectance*, EGSR 2019. A camera of response S sees it in air as M·(R, G, B)
with M_cj = ∫ S_c ρ_j dλ, and its colour matrix M⁻¹ gives R, G, B back. M⁻¹S is the response of the
camera with its matrix: it may be negative, as the matrix takes out of red the green that the sensor
let in, and its channels have an integral of 1 as those of S have.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from uwaug._support.compiled import compiled
from uwaug._support.types import Array

Surfaces = Literal["grey", "spectral"]
_UNIT = np.eye(3)
_MAX_CONDITION = 1e3  # of M, above which the three channels see the same; usual cameras have 3


@lru_cache(maxsize=16)
def reflectances(axis: bytes) -> Array:
    """ρ_R, ρ_G and ρ_B (3, N) at wavelengths, nm, given as the bytes of their array."""
    file = Path(__file__).parent / "reflectances" / "mallett-yuksel-2019.csv"
    nm, *columns = np.loadtxt(file, delimiter=",", skiprows=1).T
    return np.stack([np.interp(np.frombuffer(axis), nm, column) for column in columns])


def through_camera(sensor: Array, basis: Array, share: float = 1.0) -> tuple[Array, Array]:
    """Response (3, N) of a camera with a share of its colour matrix, C = 1 + share·(M⁻¹ − 1), and
    reflectances (3, N) of the surfaces that it shows in air as R, G and B: (C·M)⁻¹ makes them of
    the basis. With C = M⁻¹ they are the basis; with less of it they have purer colours.
    """
    M = sensor @ basis.T
    return _through_camera(sensor, basis, M, _UNIT + share * (_inverse(M.tobytes()) - _UNIT))


@compiled
def _through_camera(sensor: Array, basis: Array, M: Array, matrix: Array) -> tuple[Array, Array]:
    return matrix @ sensor, np.ascontiguousarray(np.linalg.inv(matrix @ M).T) @ basis


@lru_cache(maxsize=16)
def _inverse(matrix: bytes) -> Array:
    M = np.frombuffer(matrix).reshape(3, 3)
    if np.linalg.cond(M) > _MAX_CONDITION:
        raise ValueError("camera cannot tell three colours apart: give surfaces='grey'")
    return np.asarray(np.linalg.inv(M))


def measure(response: Array, basis: Array | None) -> Array:
    """Light that reaches the channels: S_c (3, N), or S_c·ρ_j (9, N) of surfaces with spectra."""
    return response if basis is None else (response[:, None] * basis).reshape(9, -1)


def mixed(gain: Any, weights: Any) -> Any:
    """Weights (Bx3x…) of a camera after a matrix (B or 1, 3, 3); arrays or tensors."""
    return (gain @ weights.reshape(len(weights), 3, -1)).reshape(-1, *weights.shape[1:])


def nine_rows(weights: Array) -> Array:
    """Weights of channels (Bx3xK) as those of matrices (Bx9xK), which stay as they are."""
    if weights.shape[1] == 9:
        return weights
    matrices = np.zeros((len(weights), 9, weights.shape[2]))
    matrices[:, ::4] = weights
    return matrices


def row_of(values: Array) -> Tensor:
    """An array as a tensor of one row, which shares its memory; weights (9, K) as (1, 3, 3, K)."""
    shape = (3, 3, -1) if values.ndim == 2 and len(values) == 9 else values.shape
    return torch.from_numpy(values.reshape(1, *shape))  # a tenth of the time of torch.tensor


def white(weights: Tensor) -> Tensor:
    """Weights (Bx3xK) of a white surface, from those of channels (Bx3xK) or matrices (Bx3x3xK)."""
    return weights if weights.ndim == 3 else weights.sum(2)


def as_matrices(weights: Tensor, axes: int = 1) -> Tensor:
    """Weights of channels (Bx3x…, with so many further axes) as diagonal matrices (Bx3x3x…);
    matrices stay as they are.
    """
    if weights.ndim == 3 + axes:
        return weights
    unit = torch.eye(3, dtype=weights.dtype, device=weights.device)
    return unit.reshape(3, 3, *[1] * axes) * weights[:, :, None]
