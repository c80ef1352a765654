"""The inherent optical properties of media, band by band: what a lamp, whose light does not come
down from the surface, needs to know of the water.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support.types import Array
from uwaug.optics.quadrature import reduce_rates
from uwaug.optics.surfaces import as_matrices, measure, tensor_of

_TENSORS = ("beta", "G", "b", "response", "surfaces")


@dataclass(frozen=True, eq=False)
class Bands:
    """A batch of media band by band, and the camera that sees them; each tensor has a row per
    medium.

    Attributes:
        beta, G, b (BxM tensors): β, G and scattering coefficient of the water, 1/m.
        response (Bx3xM tensor): the camera's weights; each channel's sum is 1.
        surfaces (Bx1xM or Bx3xM tensor): what surfaces reflect, see `uwaug.optics.surfaces`: all of
            it, or the three basis reflectances.
        tolerance: largest error of a curve; 0 where every band is a rate.
    """

    beta: Tensor
    G: Tensor
    b: Tensor
    response: Tensor
    surfaces: Tensor
    tolerance: float

    @staticmethod
    def of_tensors(tensors: Iterable[Tensor], tolerance: float) -> "Bands":
        """The inverse of `tensors`."""
        return Bands(**dict(zip(_TENSORS, tensors, strict=True)), tolerance=tolerance)

    @staticmethod
    def of_channels(beta: Tensor, G: Tensor, b_mean: Tensor) -> "Bands":
        """A band for each of three channels (B, 3), all of which scatter b̄ (B)."""
        response = torch.eye(3, dtype=beta.dtype, device=beta.device).expand(len(beta), 3, 3)
        b = b_mean[:, None].expand(-1, 3)
        return Bands(beta, G, b, response, torch.ones_like(beta)[:, None], 0.0)

    @staticmethod
    def stack(parts: "Sequence[Bands]") -> "Bands | None":
        """Several as one batch; None if the surfaces of some are grey and those of others are not.
        Bands that some lack have no weight.
        """
        if len({part.surfaces.shape[1] for part in parts}) > 1:
            return None
        columns = zip(*(part.tensors() for part in parts), strict=True)
        return Bands.of_tensors(map(padded, columns), min(part.tolerance for part in parts))

    def tensors(self) -> tuple[Tensor, ...]:
        """All but the tolerance, in the order of the attributes."""
        return tuple(getattr(self, name) for name in _TENSORS)

    def map(self, function: Callable[[Tensor], Tensor]) -> "Bands":
        """`function` applied to each tensor."""
        return Bands.of_tensors(map(function, self.tensors()), self.tolerance)

    def under_lamp(self) -> list[Tensor]:
        """Rates and weights of `Medium.under_lamp`: β and T_β's, G, T_G's and b's."""
        if self.tolerance == 0:
            lit = self.response
            if self.surfaces.shape[1] == 3:
                lit = lit[:, :, None] * self.surfaces[:, None]
            return [self.beta, lit, self.G, lit, self.response * self.b[:, None]]
        return list(_reduced_rows(self.tolerance, *self.tensors()))


@torch.compiler.assume_constant_result  # compiled code cannot follow NumPy's bytes
def _reduced_rows(tolerance: float, *tensors: Tensor) -> tuple[Tensor, ...]:
    """The rates and weights of `Bands.under_lamp` for a batch of media."""
    arrays = [tensor.detach().double().cpu().numpy() for tensor in tensors]
    rows = [
        _reduced(tolerance, *(array[n].tobytes() for array in arrays))
        for n in range(len(arrays[0]))
    ]
    columns = zip(*rows, strict=True)
    return tuple(padded([tensor_of(row)[None] for row in column]) for column in columns)


def padded(parts: Sequence[Tensor]) -> Tensor:
    """One attribute of several media as one tensor: (B) or (B, …, K). The missing rates and weights
    of some are 0.
    """
    if parts[0].ndim == 1:
        return torch.cat(list(parts))
    if any(part.ndim == 4 for part in parts):
        parts = [as_matrices(part) for part in parts]
    width = max(part.shape[-1] for part in parts)
    return torch.cat([F.pad(part, (0, width - part.shape[-1])) for part in parts])


@lru_cache(maxsize=64)
def _reduced(tolerance: float, *arrays: bytes) -> tuple[Array, ...]:
    """The rates and weights of `Bands.under_lamp` for one medium, from the bytes of its tensors."""
    beta, G, b, response, surfaces = (np.frombuffer(array) for array in arrays)
    response = response.reshape(3, -1)
    basis = surfaces.reshape(3, -1) if len(surfaces) > len(beta) else None
    lit = measure(response, basis)
    # b spans some tenths about its mean: as a measure of the scale of the light it keeps the
    # tolerance relative to it
    mean = float(b.mean()) or 1.0
    rates, (direct,), _ = reduce_rates(beta, (lit,), tolerance)
    G_rates, (signal, scatter), _ = reduce_rates(G, (lit, response * b / mean), tolerance)
    return rates, direct, G_rates, signal, scatter * mean
