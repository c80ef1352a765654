"""`Light`: what shines on the scene and into the water, daylight and lamps, as one value."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.torch_func import transformed
from uwaug._support.types import Array
from uwaug.optics.spectra import spectrum as checked_spectrum
from uwaug.optics.spectra import wavelength_axis

Number = Tensor | float
"""A number, or a tensor () or (B,) of one for each picture; it may require gradients."""

Vector = Tensor | tuple[float, float, float] | list[float]
"""Three numbers, or a tensor (3,) or (B, 3); it may require gradients."""

_AXES = "in the camera's coordinates: x to the right, y down, z forward"

_WHITE = (1.0, 1.0, 1.0)

_SHARPEST = 1e-3
"""Of a cone's edge, in its cosine, so that the edge has a slope."""

OBTUSE = 1e-4
"""Minus the cosine of the least angle that counts as more than a right one: in single precision the
cosine of 90° is negative.
"""

_ASIDE = 3.0**0.5
"""The tangent of 60°: pictures of up to 100° across show no lamp that is farther off their axis."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Relative power over wavelengths.

    Attributes:
        wavelengths, values (N arrays): nm, ascending; power ≥ 0. Zero outside.
    """

    wavelengths: Array
    values: Array

    @staticmethod
    def of(pair: Any) -> "Spectrum":
        """A pair of arrays, checked."""
        try:
            axis, power = pair
        except (TypeError, ValueError):
            expected = "a pair of arrays: wavelengths in nm and relative power"
            raise TypeError(f"spectrum must be {expected}, got {pair!r:.80}") from None
        axis = wavelength_axis(axis)
        power = checked_spectrum("spectrum", power, axis)
        if not power.any():
            raise ValueError("spectrum is 0 at all wavelengths")
        return Spectrum(axis, power)

    def __call__(self, wavelengths: Array) -> Array:
        """The power at other wavelengths."""
        power: Array = np.interp(wavelengths, self.wavelengths, self.values, left=0, right=0)
        return power


@dataclass(frozen=True, eq=False)
class _Source:
    """Numbers with a row for each picture, or one for all."""

    def tensors(self) -> dict[str, Tensor]:
        """The numbers, by name."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {name: value for name, value in values.items() if isinstance(value, Tensor)}

    def map(self, function: Callable[[Tensor], Tensor]) -> Self:
        """`function` applied to each tensor."""
        return replace(self, **{name: function(t) for name, t in self.tensors().items()})

    def row(self, n: int) -> Self:
        """The source of the n-th picture, as a batch of one."""
        if all(len(t) == 1 for t in self.tensors().values()):
            return self
        return self.map(lambda t: t[n % len(t)][None])


@dataclass(frozen=True, eq=False, repr=False)
class Daylight(_Source):
    """Light from the surface, see `uwaug.Light.ambient` and `uwaug.Light.parallel`.

    Attributes:
        gain (B tensor): of all of it; None for 1.
        gradient (B tensor): how the veil grows with the height of the look; None for 0.
        diffuse (B tensor): share of the light that comes from all sides; None for all.
        elevation, azimuth (B tensors): of the sun, degrees; None if all of it is diffuse.
    """

    gain: Tensor | None = None
    gradient: Tensor | None = None
    diffuse: Tensor | None = None
    elevation: Tensor | None = None
    azimuth: Tensor | None = None

    @property
    def has_view(self) -> bool:
        """Whether it differs from ray to ray."""
        return self.gradient is not None or self.elevation is not None

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

    def to_dict(self) -> dict[str, Any]:
        """Lists of numbers, which JSON can hold."""
        usual = {"gain": 1.0, "gradient": 0.0, "diffuse": 1.0}
        numbers = {name: _plain(getattr(self, name), [least]) for name, least in usual.items()}
        if self.elevation is not None:
            numbers |= {name: _plain(getattr(self, name)) for name in ("elevation", "azimuth")}
        return {"kind": "daylight", **numbers}

    def __repr__(self) -> str:
        rest = f"gain={_shown(self.gain, 1.0)}, gradient={_shown(self.gradient, 0.0)}"
        if self.elevation is None or self.azimuth is None:
            return f"Light.ambient({rest})"
        sun = f"{_shown(self.elevation)}, {_shown(self.azimuth)}"
        return f"Light.parallel({sun}, diffuse={_shown(self.diffuse, 1.0)}, {rest})"


@dataclass(frozen=True, eq=False, repr=False)
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
        rgb (Bx3 tensor): of its light; white where a spectrum is given.
        spectrum: its light over wavelengths, or None.
    """

    position: Tensor
    axis: Tensor
    power: Tensor
    cone: Tensor
    falloff: Tensor
    radius: Tensor
    asymmetry: Tensor
    rgb: Tensor
    spectrum: Spectrum | None = None

    has_view = True

    @property
    def direction(self) -> Tensor:
        """Unit vector (Bx3) along its axis. Made anew each time: the axis may be learned."""
        unit: Tensor = self.axis / self.axis.norm(dim=-1, keepdim=True)
        return unit

    @property
    def ahead(self) -> bool:
        """Whether it may be in view, less than 60° off the camera's axis; compiled code cannot
        look.
        """
        if torch.compiler.is_compiling():
            return True
        x, y, z = self.position.detach().unbind(-1)
        return bool(((z > 0) & (torch.hypot(x, y) < _ASIDE * z)).any())

    @property
    def wide(self) -> bool:
        """Whether its cone may be more than a right angle; compiled code cannot look."""
        if torch.compiler.is_compiling():
            return True
        _, outer = self.edges()
        return bool((outer.detach() < -OBTUSE).any())

    def edges(self) -> tuple[Tensor, Tensor]:
        """Cosines (B) of the angles at which the light begins to fade, and has faded."""
        inner = torch.cos(torch.deg2rad(self.cone * (1 - self.falloff)))
        outer = torch.cos(torch.deg2rad(self.cone))
        return inner, torch.minimum(outer, inner - _SHARPEST)

    def cone_at(self, cosine: Tensor) -> Tensor:
        """The share of the light (BxCxHxW) at angles to the axis that have this cosine."""
        inner, outer = (edge.reshape(-1, 1, 1, 1) for edge in self.edges())
        factor = 1 / (inner - outer)
        t = (cosine * factor - outer * factor).clamp(0.0, 1.0)
        return t * t * (3 - 2 * t)

    def to_dict(self) -> dict[str, Any]:
        """Lists of numbers, which JSON can hold."""
        numbers = {name: _plain(value) for name, value in self.tensors().items()}
        numbers["direction"] = numbers.pop("axis")
        if self.spectrum is not None:
            del numbers["rgb"]
            pair = (self.spectrum.wavelengths, self.spectrum.values)
            numbers["spectrum"] = [array.tolist() for array in pair]
        return {"kind": "lamp", **numbers}

    def __repr__(self) -> str:
        numbers = {name: _shown(value) for name, value in self.tensors().items()}
        white = torch.equal(self.rgb, torch.ones_like(self.rgb))
        if self.spectrum is not None or white:
            del numbers["rgb"]
        shown = ", ".join(f"{name}={value}" for name, value in numbers.items())
        spectrum = "" if self.spectrum is None else ", spectrum=…"
        return f"Light.lamp({shown.replace('axis=', 'direction=')}{spectrum})"


@dataclass(frozen=True, eq=False, repr=False)
class Light:
    """Daylight and lamps. Lights add: `Light.ambient() + Light.lamp(…)`.

    Numbers may be tensors: () for one, (B,) for one of each picture, (B, 3) for vectors; they may
    require gradients. Coordinates are the camera's: x to the right of the picture, y down, z
    forward; metres.

    Attributes:
        sources: each a `Daylight` or a `Lamp`.

    Examples:
        >>> headlight = Light.lamp((0.3, -0.2, 0.0), (-0.1, 0.1, 1.0), power=4.0, cone=40.0)
        >>> len((Light.ambient(0.2) + headlight).sources)
        2
    """

    sources: tuple[Daylight | Lamp, ...]

    @staticmethod
    def none() -> "Light":
        """Darkness."""
        return Light(())

    @staticmethod
    def ambient(gain: Number = 1.0, gradient: Number = 0.0) -> "Light":
        """Daylight from all sides, as the medium has it; `form_image` takes it by default.

        Args:
            gain: multiplies it, ≥ 0.
            gradient: the veil of a ray that looks up by an angle e is e^(gradient·sin e) times that
                of a level one, −10…10: > 0 is lighter above than below. The camera is taken to be
                level.
        """
        return _of_one(_daylight(gain, gradient))

    @staticmethod
    def parallel(
        elevation: Number,
        azimuth: Number,
        *,
        diffuse: Number = 0.5,
        gain: Number = 1.0,
        gradient: Number = 0.0,
    ) -> "Light":
        """Daylight with a sun, which shades the surfaces of the scene: diffuse + (1 − diffuse)·cos
        of the angle between sun and normal. Normals are those of the distance map. The veil is that
        of `ambient`, as water is lit from all sides.

        Args:
            elevation: of the sun's rays in the water above the horizon, degrees, −90…90.
            azimuth: from where they come, degrees: 0 from straight ahead, 90 from the right, 180
                from behind the camera.
            diffuse: share of the light that comes from all sides, 0…1; with 1, it is `ambient`.
            gain, gradient: as for `ambient`.
        """
        return _of_one(
            replace(
                _daylight(gain, gradient),
                diffuse=_batch("diffuse", diffuse, "a share of the light", 0.0, 1.0),
                elevation=_batch("elevation", elevation, "degrees", -90.0, 90.0),
                azimuth=_batch("azimuth", azimuth, "degrees", -1e6, 1e6),
            )
        )

    @staticmethod
    def lamp(
        position: Vector,
        direction: Vector,
        power: Number = 1.0,
        cone: Number = 60.0,
        falloff: Number = 0.5,
        *,
        rgb: Vector | None = None,
        spectrum: Any = None,
        radius: Number = 0.03,
        asymmetry: Number = 0.924,
    ) -> "Light":
        """A lamp: its light on the surfaces of the scene, and what the water before it scatters
        into the camera.

        Args:
            position: m, in the camera's coordinates.
            direction: of its axis; of any length.
            power: how bright a white plate is that faces it at 1 m in air, where 1 is a white plate
                in daylight at the surface; ≥ 0.
            cone: angle from the axis to the edge of the light, degrees, 0…180; 180 shines to all
                sides.
            falloff: width of the soft edge as a share of the cone, 0…1.
            rgb: its light in the camera's channels; white by default.
            spectrum: its light instead as (wavelengths in nm, relative power), for a medium made
                from a water; scaled such that the mean of the three channels is 1.
            radius: of the lamp, m, > 0: nearer than so, its light grows no more.
            asymmetry: mean cosine of the phase function (Henyey & Greenstein 1941) by which the
                water scatters its light, 0 ≤ asymmetry < 1; .924 is that of Petzold's waters.

        Raises:
            TypeError, ValueError: if an argument is of another shape or outside its domain.
        """
        if rgb is not None and spectrum is not None:
            raise ValueError("rgb and spectrum: give one of them, got both")
        return _of_one(
            Lamp(
                position=_batch("position", position, f"in metres, {_AXES}", -1e5, 1e5, (3,)),
                axis=_direction(direction),
                power=_batch("power", power, "of a white plate at 1 m", 0.0),
                cone=_batch("cone", cone, "in degrees from the axis", 0.0, 180.0),
                falloff=_batch("falloff", falloff, "a share of the cone", 0.0, 1.0),
                radius=_batch("radius", radius, "in metres", 1e-4),
                asymmetry=_batch("asymmetry", asymmetry, "a mean cosine", 0.0, 0.999),
                rgb=_batch("rgb", _WHITE if rgb is None else rgb, "light", 0.0, shape=(3,)),
                spectrum=None if spectrum is None else Spectrum.of(spectrum),
            )
        )

    @staticmethod
    def from_list(tables: Any) -> "Light":
        """The sum of lights that TOML or JSON gives as tables: a kind, "ambient", "parallel" or
        "lamp", and the arguments of that constructor of `Light`; or those of `to_list`.

        Raises:
            ValueError: naming the key, if it is no such table.
        """
        expected = 'tables, each with kind = "ambient", "parallel" or "lamp" and its arguments'
        if not isinstance(tables, list | tuple) or not all(isinstance(t, Mapping) for t in tables):
            raise ValueError(f"light: expected {expected}, got {tables!r:.80}")
        light = Light.none()
        for table in tables:
            arguments = dict(table)
            kind = arguments.pop("kind", None)
            checks.one_of("light.kind", kind, ("ambient", "parallel", "lamp", "daylight"))
            if kind == "daylight" and "elevation" in arguments:
                kind = "parallel"
            elif kind == "daylight":
                kind, _ = "ambient", arguments.pop("diffuse", None)  # without a sun, all is
            try:
                light = light + getattr(Light, kind)(**arguments)
            except (TypeError, ValueError) as error:
                raise ValueError(f"light of kind {kind!r}: {error}") from None
        return light

    def to_list(self) -> list[dict[str, Any]]:
        """Each source as a table of lists of numbers, which JSON can hold."""
        return [source.to_dict() for source in self.sources]

    def __add__(self, other: "Light") -> "Light":
        """Both together."""
        if not isinstance(other, Light):
            return NotImplemented
        return Light(self.sources + other.sources)

    def __radd__(self, other: object) -> "Light":
        """For `sum` of several, which begins with 0."""
        return self if other == 0 else NotImplemented

    @property
    def daylights(self) -> tuple[Daylight, ...]:
        """The sources that come from the surface."""
        return tuple(source for source in self.sources if isinstance(source, Daylight))

    @property
    def lamps(self) -> tuple[Lamp, ...]:
        """The sources that do not."""
        return tuple(source for source in self.sources if isinstance(source, Lamp))

    @property
    def plain(self) -> bool:
        """Whether it is the default: daylight as the medium has it, and nothing else."""
        if len(self.sources) != 1 or self.lamps:
            return False
        (source,) = self.daylights
        return source.gain is None and not source.has_view

    @property
    def has_view(self) -> bool:
        """Whether it differs from ray to ray, so that it takes a focal length."""
        return any(source.has_view for source in self.sources)

    @property
    def requires_grad(self) -> bool:
        """Whether a number of it records gradients."""
        return any(t.requires_grad for source in self.sources for t in source.tensors().values())

    def daylight(self) -> Tensor | float:
        """How bright daylight's veil is (B) where it is level, as a multiple of the medium's."""
        total: Tensor | float = 0.0
        for source in self.daylights:
            total = total + (1.0 if source.gain is None else source.gain)
        return total

    def rows(self) -> int:
        """Pictures that it is for: 1 serves any number.

        Raises:
            ValueError: if its numbers are for other batches.
        """
        sizes = {
            f"light {number} {name}": len(value)
            for number, source in enumerate(self.sources)
            for name, value in source.tensors().items()
        }
        checks.batches(sizes)
        return max([1, *sizes.values()])

    def require_one(self) -> "Light":
        """Itself, where it is for any number of pictures.

        Raises:
            ValueError: if it is for a batch.
        """
        if self.rows() > 1:
            raise ValueError(f"light must be for one picture, got one for {self.rows()}")
        return self

    def map(self, function: Callable[[Tensor], Tensor]) -> "Light":
        """`function` applied to each number."""
        return Light(tuple(source.map(function) for source in self.sources))

    def to(self, *args: Any, **kwargs: Any) -> "Light":
        """Move or cast, as `torch.Tensor.to`."""
        return self.map(lambda t: t.to(*args, **kwargs))

    def row(self, n: int) -> "Light":
        """The light of the n-th picture, as a batch of one."""
        return Light(tuple(source.row(n) for source in self.sources))

    def __repr__(self) -> str:
        return " + ".join(map(repr, self.sources)) or "Light.none()"


def _of_one(source: Daylight | Lamp) -> Light:
    """A light of one source, whose numbers are for one batch."""
    sizes = {name: len(value) for name, value in source.tensors().items()}
    if "axis" in sizes:
        sizes["direction"] = sizes.pop("axis")
    checks.batches(sizes)
    return Light((source,))


def _daylight(gain: Number, gradient: Number) -> Daylight:
    """Daylight from all sides; the usual numbers are left out, so that compiled code knows them."""
    return Daylight(
        _unless(1.0, _batch("gain", gain, "a factor", 0.0)),
        _unless(0.0, _batch("gradient", gradient, "a number", -10.0, 10.0)),
    )


def _unless(usual: float, value: Tensor) -> Tensor | None:
    """A number; None for the usual one, which gets no gradient."""
    differentiated = value.requires_grad or transformed()
    if torch.compiler.is_compiling() or differentiated or len(value) > 1:
        return value
    return None if float(value) == usual else value


def _batch(
    name: str,
    value: Any,
    unit: str,
    low: float = -math.inf,
    high: float = math.inf,
    shape: tuple[int, ...] = (),
) -> Tensor:
    """A number of `shape`, or a batch of them, as (B, *shape); finite and within [low, high]."""
    expected = "a number or a tensor (B,)" if shape == () else "3 numbers or a tensor (B, 3)"
    expected = f"{expected}, {unit}"
    row: Tensor = value
    if not isinstance(value, Tensor):
        try:
            row = torch.tensor(value, dtype=torch.float64, device="cpu")
        except (TypeError, ValueError, RuntimeError):
            row = torch.empty(0)
        if isinstance(value, bool) or not row.numel():
            raise TypeError(f"{name} must be {expected}, got {value!r:.80}")
    row = row if row.is_floating_point() else row.to(torch.float64)
    batched = row.ndim == len(shape) + 1
    if row.shape[batched:] != shape or row.ndim > len(shape) + 1:
        raise ValueError(f"{name} must be {expected}, got shape {tuple(row.shape)}")
    if not torch.compiler.is_compiling():
        numbers = row.detach()
        if not bool((numbers.isfinite() & (numbers >= low) & (numbers <= high)).all()):
            limit = "finite" if low == -math.inf else checks.bounds(low, high)
            raise ValueError(f"{name} must be {limit}, {unit}, got {numbers.tolist()!r:.120}")
    return row if batched else row[None]


def _direction(value: Any) -> Tensor:
    """A vector (B, 3) of any length but 0."""
    vector = _batch("direction", value, _AXES, shape=(3,))
    length = vector.norm(dim=-1, keepdim=True)
    if not torch.compiler.is_compiling() and not bool((length > 0).all()):
        raise ValueError(f"direction must point somewhere, got {vector.detach().tolist()!r:.120}")
    return vector


def _plain(value: Tensor | None, usual: Any = None) -> Any:
    """Numbers as lists."""
    return usual if value is None else value.detach().double().tolist()


def _shown(value: Tensor | None, usual: float = 0.0) -> str:
    """A number or a vector; of several rows, how many."""
    if value is None:
        return repr(usual)
    if len(value) > 1:
        return f"<{len(value)} rows>"
    numbers = [repr(number) for number in value.detach().flatten().tolist()]
    return numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"
