"""Water as light of a lamp meets it, which does not come down from the surface.

| symbol | meaning |
|---|---|
| S_c | response of the camera's channel c to the lamp's light |
| T_β,c(z) = ∫ S_c e^(−β z) dλ | what arrives unscattered |
| T_G,c(z) = ∫ S_c e^(−G z) dλ | what arrives at all |
| b_c(x) = ∫ S_c b e^(−G x) dλ | what a metre of water scatters, seen after a path of x metres |
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support.torch_func import values
from uwaug._support.types import Array
from uwaug.optics.bands import BandCoefficients
from uwaug.optics.quadrature import reduce_rates
from uwaug.optics.reduction import Forward

if TYPE_CHECKING:
    from uwaug.optics.medium import Medium

__all__ = ["Legs", "Unlit", "joined_bands", "legs_of", "of_channels", "unlit_bands"]

_LEAST = 1e-30
"""Stands for the light of a channel that gets none."""


class Unlit(NamedTuple):
    """A batch of media band by band, without the surface's light; each with a row per medium.

    Attributes:
        wavelengths (BxM tensor): nm; 0 where bands are the camera's channels.
        beta, G, b (BxM tensors): as of the water, 1/m.
        response (Bx3xM tensor): the camera's weights; each channel's sum is 1.
        from_direct (B tensor): 1 where forward scatter is a blur of the direct light, else 0.
        tolerance: largest error of a curve; 0 where every band is a rate.
    """

    wavelengths: Tensor
    beta: Tensor
    G: Tensor
    b: Tensor
    response: Tensor
    from_direct: Tensor
    tolerance: float

    def map(self, function: Callable[[Tensor], Tensor]) -> "Unlit":
        """`function` applied to each tensor."""
        return Unlit.of([function(tensor) for tensor in self.tensors()], self.tolerance)

    def tensors(self) -> tuple[Tensor, ...]:
        """All but the tolerance."""
        return self[:-1]

    @staticmethod
    def of(tensors: Sequence[Tensor], tolerance: float) -> "Unlit":
        """The inverse of `tensors`."""
        wavelengths, beta, G, b, response, from_direct = tensors
        return Unlit(wavelengths, beta, G, b, response, from_direct, tolerance)


class Legs(NamedTuple):
    """Sums of exponentials for a lamp's light, each with a row per medium.

    Attributes:
        G (BxL tensor): rates of T_G and b, 1/m.
        signal, scatter (Bx3xL tensors): weights of T_G and of b.
        both (Bx(K+L) tensor): rates of T_β, then of T_G.
        parts (Bx6x(K+L) tensor): weights of T_β and, in the last three rows, of T_G.
    """

    G: Tensor
    signal: Tensor
    scatter: Tensor
    both: Tensor
    parts: Tensor

    @staticmethod
    def of(beta: Tensor, direct: Tensor, G: Tensor, signal: Tensor, scatter: Tensor) -> "Legs":
        """From rates and weights of T_β, rates of T_G and b, and their weights."""
        upper = torch.cat([direct, torch.zeros_like(signal)], 2)
        lower = torch.cat([torch.zeros_like(direct), signal], 2)
        return Legs(G, signal, scatter, torch.cat([beta, G], 1), torch.cat([upper, lower], 1))

    def map(self, function: Callable[[Tensor], Tensor]) -> "Legs":
        """`function` applied to each tensor."""
        return Legs(*map(function, self))

    def tinted(self, colour: Tensor) -> "Legs":
        """Those of a lamp of this light (B or 1, 3)."""
        factor = colour[..., None]
        return self._replace(signal=self.signal * factor, scatter=self.scatter * factor)


def unlit_bands(
    wavelengths: Array,
    bands: BandCoefficients,
    b: Array,
    response: Array,
    forward: Forward,
    tolerance: float,
) -> Unlit:
    """Those of one medium, from arrays (M) and (3, M)."""
    arrays = (wavelengths, bands.beta, bands.G, b, response)
    tensors = [torch.tensor(array)[None] for array in arrays]
    return Unlit.of([*tensors, _from_direct(tensors[1], forward)], tolerance)


def of_channels(beta: Tensor, G: Tensor, b_mean: Tensor, forward: Forward) -> Unlit:
    """Those of media given by numbers of three channels (B, 3); each scatters b̄ (B)."""
    response = torch.eye(3, dtype=beta.dtype, device=beta.device).expand(len(beta), 3, 3)
    b = b_mean[:, None].expand(-1, 3)
    tensors = (torch.zeros_like(beta), beta, G, b, response, _from_direct(beta, forward))
    return Unlit.of(tensors, tolerance=0.0)


def _from_direct(beta: Tensor, forward: Forward) -> Tensor:
    return beta.new_full((len(beta),), float(forward == "direct"))


def joined_bands(parts: "Sequence[Unlit | None]") -> Unlit | None:
    """Several as one batch; None if one is missing. Bands that some lack have no weight."""
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return None
    width = max(part.beta.shape[-1] for part in known)
    columns = []
    for tensors in zip(*(part.tensors() for part in known), strict=True):
        wide = [F.pad(t, (0, width - t.shape[-1])) if t.ndim > 1 else t for t in tensors]
        columns.append(torch.cat(wide))
    return Unlit.of(columns, min(part.tolerance for part in known))


def legs_of(medium: "Medium", spectrum: "Callable[[Array], Array] | None" = None) -> Legs:
    """The sums for a lamp of the given spectrum: a function of wavelengths, None for white.

    A medium of numbers alone, as one that learns, has no bands: its own rates and the shares of its
    light stand for them, and b̄ for b.
    """
    unlit = medium.unlit
    if unlit is None:
        if spectrum is not None:
            raise ValueError("spectrum: the medium has no wavelengths any more; give rgb")
        return _from_sums(medium)
    if spectrum is None and unlit.tolerance == 0:
        response = unlit.response
        return Legs.of(unlit.beta, response, unlit.G, response, response * unlit.b[:, None])
    rows = []
    for n in range(len(unlit.beta)):
        tensors = unlit.tensors()[:-1]
        bands = [_values(t[n]) for t in tensors]
        if spectrum is not None:
            bands[-1] = _in_light(bands[-1], bands[0], spectrum)
        rows.append(_reduced(unlit.tolerance, *(band.tobytes() for band in bands)))
    columns = []
    for arrays in zip(*rows, strict=True):
        width = max(array.shape[-1] for array in arrays)
        parts = [F.pad(torch.from_numpy(array), (0, width - array.shape[-1])) for array in arrays]
        columns.append(torch.stack(parts).to(medium.beta))
    return Legs.of(*columns)


def _in_light(response: Array, wavelengths: Array, spectrum: Callable[[Array], Array]) -> Array:
    """The camera's response to a light, of which the mean of the channels is 1."""
    if not wavelengths.any():
        cure = "give rgb, or make the medium from a water"
        raise ValueError(f"spectrum: the medium has three channels and no wavelengths; {cure}")
    weighed = response * spectrum(wavelengths)
    mean = float(weighed.sum() / 3)
    if mean == 0:
        low, high = wavelengths.min(), wavelengths.max()
        raise ValueError(f"spectrum has no light between {low:g} and {high:g} nm")
    return weighed / mean


def _values(band: Tensor) -> Array:
    """Of one medium (M) or (3, M)."""
    return values(band.detach().double().flatten()).reshape(band.shape)


def _from_sums(medium: "Medium") -> Legs:
    shares = []
    for weights in (medium.direct_weights, medium.signal_weights):
        shares.append(weights / weights.sum(-1, keepdim=True).clamp(min=_LEAST))
    scatter = shares[1] * medium.b_mean[:, None, None]
    return Legs.of(medium.beta, shares[0], medium.G, shares[1], scatter)


@lru_cache(maxsize=64)
def _reduced(tolerance: float, *held: bytes) -> tuple[Array, ...]:
    """What `Legs.of` takes of one medium, from the bytes of its bands."""
    _, beta, G, b, response = (np.frombuffer(part) for part in held)
    response = response.reshape(3, -1)
    # b spans some tenths about its mean: as a measure of the scale of the light it keeps the
    # tolerance relative to it
    mean = float(b.mean()) or 1.0
    rates, (direct,), _ = reduce_rates(beta, (response,), tolerance)
    scatter, (signal, fog), _ = reduce_rates(G, (response, response * b / mean), tolerance)
    return rates, direct, scatter, signal, fog * mean
