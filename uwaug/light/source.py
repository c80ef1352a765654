"""What shines: daylight and lamps, as batches of numbers."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import Array
from uwaug.optics.spectra import spectrum, wavelength_axis

__all__ = [
    "AXES",
    "Daylight",
    "Lamp",
    "Number",
    "Spectrum",
    "Vector",
    "at_most",
    "batch_of",
    "vector_of",
]

Number = Tensor | float
"""A number, or a tensor () or (B,) of one for each picture; it may require gradients."""

Vector = Tensor | tuple[float, float, float] | list[float]
"""Three numbers, or a tensor (3,) or (B, 3); it may require gradients."""

_SHARPEST = 1e-3
"""Of a cone's edge, in its cosine, so that the edge has a slope."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Relative power over wavelengths.

    Attributes:
        wavelengths, values (N arrays): nm, ascending; power ≥ 0. Zero outside.
    """

    wavelengths: Array
    values: Array

    @staticmethod
    def of(given: Any) -> "Spectrum":
        """A pair of arrays, checked."""
        try:
            axis, power = given
        except (TypeError, ValueError):
            wanted = "a pair of arrays: wavelengths in nm and relative power"
            raise TypeError(f"spectrum must be {wanted}, got {given!r:.80}") from None
        axis = wavelength_axis(axis)
        power = spectrum("spectrum", power, axis)
        if not power.any():
            raise ValueError("spectrum is 0 at all wavelengths")
        return Spectrum(axis, power)

    def __call__(self, wavelengths: Array) -> Array:
        """The power at other wavelengths."""
        found: Array = np.interp(wavelengths, self.wavelengths, self.values, left=0, right=0)
        return found


@dataclass(frozen=True, eq=False)
class _Source:
    """Numbers with a row for each picture, or one for all."""

    def tensors(self) -> dict[str, Tensor]:
        """The numbers, by name."""
        named = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {name: value for name, value in named.items() if isinstance(value, Tensor)}

    def map(self, function: Callable[[Tensor], Tensor]) -> Any:
        """`function` applied to each tensor."""
        return replace(self, **{name: function(t) for name, t in self.tensors().items()})

    def row(self, n: int) -> Any:
        """The source of the n-th picture, as a batch of one."""
        if all(len(t) == 1 for t in self.tensors().values()):
            return self
        return self.map(lambda t: t[n % len(t)][None])


@dataclass(frozen=True, eq=False)
class Daylight(_Source):
    """Light from the surface, see `uwaug.Light.ambient` and `uwaug.Light.parallel`.

    Attributes:
        gain (B tensor): of all of it.
        gradient (B tensor): how the veil grows with the height of the look.
        diffuse (B tensor): share of the light that comes from all sides.
        elevation, azimuth (B tensors): of the sun, degrees; None if all of it is diffuse.
        level: whether the gradient is 0 and gets none, known without a look.
        whole: whether the gain is 1, likewise.
    """

    gain: Tensor
    gradient: Tensor
    diffuse: Tensor
    elevation: Tensor | None = None
    azimuth: Tensor | None = None
    level: bool = False
    whole: bool = False

    @property
    def has_view(self) -> bool:
        """Whether it differs from ray to ray."""
        return not self.level or self.elevation is not None

    @property
    def sun(self) -> Tensor | None:
        """Unit vector (Bx3) to the sun. Made anew each time: angles may be learned."""
        if self.elevation is None or self.azimuth is None:
            return None
        up, around = torch.deg2rad(self.elevation), torch.deg2rad(self.azimuth)
        level = torch.cos(up)
        # y points down
        parts = (level * torch.sin(around), -torch.sin(up), level * torch.cos(around))
        rows = max(len(part) for part in parts)
        return torch.stack([part.expand(rows) for part in parts], -1)


@dataclass(frozen=True, eq=False)
class Lamp(_Source):
    """A lamp, see `uwaug.Light.lamp`.

    Attributes:
        position (Bx3 tensor): m, in the camera's coordinates.
        axis (Bx3 tensor): along its axis, of any length.
        power (B tensor): of a white plate before it at 1 m.
        cone (B tensor): from the axis to the edge, degrees.
        falloff (B tensor): width of the edge as a share of the cone.
        radius (B tensor): m.
        asymmetry (B tensor): ⟨cos α⟩ of what the water scatters.
        colour (Bx3 tensor): of its light; white where a spectrum is given.
        spectrum: its light over wavelengths, or None.
        ahead: whether it may be in view, less than 60° off the camera's axis.
        terms: of its veil's polynomials; 0 if it has not been looked for.
    """

    position: Tensor
    axis: Tensor
    power: Tensor
    cone: Tensor
    falloff: Tensor
    radius: Tensor
    asymmetry: Tensor
    colour: Tensor
    spectrum: Spectrum | None = None
    ahead: bool = True
    terms: int = 0

    has_view = True

    @property
    def direction(self) -> Tensor:
        """Unit vector (Bx3) along its axis. Made anew each time: the axis may be learned."""
        unit: Tensor = self.axis / self.axis.norm(dim=-1, keepdim=True)
        return unit

    def edges(self) -> tuple[Tensor, Tensor]:
        """Cosines (B) of the angles at which the light begins to fade, and has faded."""
        inner = torch.cos(torch.deg2rad(self.cone * (1 - self.falloff)))
        outer = torch.cos(torch.deg2rad(self.cone))
        return inner, torch.minimum(outer, inner - _SHARPEST)

    @property
    def ramp(self) -> tuple[Tensor, Tensor]:
        """What makes of the cosine of an angle to the axis 0 beyond the edge and 1 before it: a
        factor and a summand (Bx1x1x1).
        """
        inner, outer = (edge.reshape(-1, 1, 1, 1) for edge in self.edges())
        factor = 1 / (inner - outer)
        return factor, -outer * factor

    def cone_at(self, cosine: Tensor) -> Tensor:
        """The share of the light (BxCxHxW) at angles to the axis that have this cosine."""
        factor, summand = self.ramp
        t = (cosine * factor + summand).clamp(0.0, 1.0)
        return t * t * (3 - 2 * t)


def batch_of(name: str, value: Any, shape: tuple[int, ...], unit: str, least: float) -> Tensor:
    """A number of `shape`, or a batch of them, as (B, *shape); finite and ≥ `least`."""
    wanted = "a number or a tensor (B,)" if shape == () else "3 numbers or a tensor (B, 3)"
    wanted = f"{wanted}, {unit}"
    try:
        row = value if isinstance(value, Tensor) else torch.tensor(value, dtype=torch.float64)
    except (TypeError, ValueError, RuntimeError):
        raise TypeError(f"{name} must be {wanted}, got {value!r:.80}") from None
    if not row.is_floating_point():
        row = row.to(torch.float64)
    batched = row.ndim == len(shape) + 1
    if row.shape[batched:] != shape or row.ndim > len(shape) + 1:
        raise ValueError(f"{name} must be {wanted}, got shape {tuple(row.shape)}")
    if not torch.compiler.is_compiling():
        known = row.detach()
        if not bool((known.isfinite() & (known >= least)).all()):
            limit = "finite" if least == -math.inf else f"finite and ≥ {least:g}"
            raise ValueError(f"{name} must be {limit}, {unit}, got {known.tolist()!r:.120}")
    return row if batched else row[None]


def vector_of(name: str, value: Any) -> Tensor:
    """A direction (B, 3) of any length but 0."""
    vector = batch_of(name, value, (3,), AXES, -math.inf)
    length = vector.norm(dim=-1, keepdim=True)
    if not torch.compiler.is_compiling() and not bool((length > 0).all()):
        raise ValueError(f"{name} must point somewhere, got {vector.detach().tolist()!r:.120}")
    return vector


def at_most(numbers: Mapping[str, Tensor], most: Mapping[str, float], unit: str) -> None:
    """Refuse numbers beyond their largest."""
    for name, limit in most.items():
        value = numbers[name].detach()
        if not torch.compiler.is_compiling() and bool((value > limit).any()):
            got = f"got {value.tolist()!r:.120}"
            raise ValueError(f"{name} must be at most {limit:g}{unit}, {got}")


AXES = "in the camera's coordinates: x to the right, y down, z forward"
