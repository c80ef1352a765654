"""The inherent optical properties of media, band by band: what a light that does not come down from
the surface needs to know of the water.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support.torch_func import values
from uwaug._support.types import Array
from uwaug.optics.quadrature import reduce_rates
from uwaug.optics.surfaces import as_matrices, measure, tensor_of

Forward = Literal["image", "direct"]
"""What forward scatter is a blur of: the scene J, or the direct light D."""


@dataclass(frozen=True, eq=False)
class Bands:
    """A batch of media band by band, and the camera that sees them; each tensor has a row per
    medium.

    Attributes:
        wavelengths (BxM tensor): nm; 0 where bands are the camera's channels.
        beta, G, b (BxM tensors): β, G and scattering coefficient of the water, 1/m.
        response (Bx3xM tensor): the camera's weights; each channel's sum is 1.
        from_direct (B tensor): 1 where forward scatter is a blur of the direct light, else 0.
        surfaces (Bx1xM or Bx3xM tensor): what surfaces reflect, see `uwaug.optics.surfaces`: all of
            it, or the three basis reflectances.
        eye (BxM tensor): mean of the channels of the sensor, before any colour matrix: what says
            how bright a light is.
        tolerance: largest error of a curve; 0 where every band is a rate.
    """

    wavelengths: Tensor
    beta: Tensor
    G: Tensor
    b: Tensor
    response: Tensor
    from_direct: Tensor
    surfaces: Tensor
    eye: Tensor
    tolerance: float

    @staticmethod
    def of_channels(beta: Tensor, G: Tensor, b_mean: Tensor, forward: Forward) -> "Bands":
        """A band for each of three channels (B, 3), all of which scatter b̄ (B)."""
        response = torch.eye(3, dtype=beta.dtype, device=beta.device).expand(len(beta), 3, 3)
        from_direct = beta.new_full((len(beta),), float(forward == "direct"))
        b = b_mean[:, None].expand(-1, 3)
        grey = torch.ones_like(beta)[:, None]
        eye = response.mean(1)
        return Bands(torch.zeros_like(beta), beta, G, b, response, from_direct, grey, eye, 0.0)

    @staticmethod
    def stack(parts: "Sequence[Bands]") -> "Bands | None":
        """Several as one batch; None if the surfaces of some are grey and those of others are not.
        Bands that some lack have no weight.
        """
        if len({part.surfaces.shape[1] for part in parts}) > 1:
            return None
        columns = zip(*(part.tensors() for part in parts), strict=True)
        tolerance = min(part.tolerance for part in parts)
        return Bands.of_tensors([padded(column) for column in columns], tolerance)

    def tensors(self) -> tuple[Tensor, ...]:
        """All but the tolerance, in the order of the attributes."""
        return tuple(getattr(self, name) for name in _TENSORS)

    def map(self, function: Callable[[Tensor], Tensor]) -> "Bands":
        """`function` applied to each tensor."""
        return Bands.of_tensors(list(map(function, self.tensors())), self.tolerance)

    @staticmethod
    def of_tensors(tensors: Sequence[Tensor], tolerance: float) -> "Bands":
        """The inverse of `tensors`."""
        if len(tensors) == 6:  # files of older versions know of grey surfaces alone
            _, beta, _, _, response, _ = tensors
            tensors = [*tensors, torch.ones_like(beta)[:, None], response.mean(1)]
        return Bands(**dict(zip(_TENSORS, tensors, strict=True)), tolerance=tolerance)

    def under(self, spectrum: Callable[[Array], Array] | None) -> list[Tensor]:
        """Rates and weights of `Medium.under`: β and T_β's, G, T_G's and b's."""
        if spectrum is None and self.tolerance == 0:
            scatter, lit = self.response * self.b[:, None], self.response
            if self.surfaces.shape[1] == 3:
                lit = lit[:, :, None] * self.surfaces[:, None]
            return [self.beta, lit, self.G, lit, scatter]
        rows = []
        for n in range(len(self.beta)):
            axis, beta, G, b, response, _, surfaces, eye = (_array(t[n]) for t in self.tensors())
            if spectrum is not None:
                response = _in_light(response, eye, axis, spectrum)
            arrays = (beta, G, b, response, *(surfaces if len(surfaces) == 3 else ()))
            rows.append(_reduced(self.tolerance, *(t.tobytes() for t in arrays)))
        columns = zip(*rows, strict=True)
        return [padded([tensor_of(row)[None] for row in column]) for column in columns]


# not asked of the class by each call, which torch.compile cannot follow
_TENSORS = tuple(field.name for field in fields(Bands)[:-1])


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


def _in_light(
    response: Array, eye: Array, wavelengths: Array, spectrum: Callable[[Array], Array]
) -> Array:
    """The camera's response to a light, of which the mean of the sensor's channels is 1."""
    if not wavelengths.any():
        cure = "give rgb, or make the medium from a water"
        raise ValueError(f"spectrum: the medium has three channels and no wavelengths; {cure}")
    power = spectrum(wavelengths)
    mean = float(power @ eye)
    if mean == 0:
        low, high = wavelengths.min(), wavelengths.max()
        raise ValueError(f"spectrum has no light between {low:g} and {high:g} nm")
    return response * (power / mean)


def _array(row: Tensor) -> Array:
    """The numbers of one medium (M) or (3, M)."""
    return values(row.detach().double().flatten()).reshape(row.shape)


@lru_cache(maxsize=64)
def _reduced(tolerance: float, *arrays: bytes) -> tuple[Array, ...]:
    """The rates and weights of `Bands.under` for one medium, from the bytes of its β, G, b and
    response, and of the three reflectances of its surfaces if these have spectra.
    """
    beta, G, b, response, *basis = (np.frombuffer(array) for array in arrays)
    response = response.reshape(3, -1)
    lit = measure(response, np.stack(basis) if basis else None)
    # b spans some tenths about its mean: as a measure of the scale of the light it keeps the
    # tolerance relative to it
    mean = float(b.mean()) or 1.0
    rates, (direct,), _ = reduce_rates(beta, (lit,), tolerance)
    G_rates, (signal, scatter), _ = reduce_rates(G, (lit, response * b / mean), tolerance)
    return rates, direct, G_rates, signal, scatter * mean
