"""`Light`: what shines on the scene and into the water, as one value."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.light.rules import rules
from uwaug.light.source import (
    AXES,
    Daylight,
    Lamp,
    Number,
    Spectrum,
    Vector,
    at_most,
    batch_of,
    vector_of,
)

__all__ = ["Light"]

_WHITE = (1.0, 1.0, 1.0)

_ASIDE = 3.0**0.5
"""The tangent of 60°: pictures of up to 100° across show no lamp that is farther off their axis."""


@dataclass(frozen=True, eq=False)
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
        return _checked(_daylight(gain, gradient, 1.0))

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
        up = batch_of("elevation", elevation, (), "degrees", -90.0)
        around = batch_of("azimuth", azimuth, (), "degrees", -1e6)
        at_most({"elevation": up}, {"elevation": 90.0}, " degrees")
        return _checked(_daylight(gain, gradient, diffuse, up, around))

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
        numbers: dict[str, Any] = {
            "power": batch_of("power", power, (), "of a white plate at 1 m", 0.0),
            "cone": batch_of("cone", cone, (), "in degrees from the axis", 0.0),
            "falloff": batch_of("falloff", falloff, (), "a share of the cone", 0.0),
            "radius": batch_of("radius", radius, (), "in metres", 1e-4),
            "asymmetry": batch_of("asymmetry", asymmetry, (), "a mean cosine", 0.0),
        }
        at_most(numbers, {"cone": 180.0}, " degrees")
        at_most(numbers, {"falloff": 1.0, "asymmetry": 0.999}, "")
        place = batch_of("position", position, (3,), f"in metres, {AXES}", -1e5)
        lamp = Lamp(
            position=place,
            axis=vector_of("direction", direction),
            colour=batch_of("rgb", _WHITE if rgb is None else rgb, (3,), "light", 0.0),
            spectrum=None if spectrum is None else Spectrum.of(spectrum),
            ahead=_ahead(place),
            **numbers,
        )
        rules()
        return _checked(lamp)

    def __add__(self, other: "Light") -> "Light":
        """Both together."""
        if not isinstance(other, Light):
            return NotImplemented
        return Light(self.sources + other.sources)

    @property
    def plain(self) -> bool:
        """Whether it is the default: today's ambient light and nothing else."""
        if len(self.sources) != 1 or not isinstance(self.sources[0], Daylight):
            return False
        return self.sources[0].whole and not self.sources[0].has_view

    @property
    def has_view(self) -> bool:
        """Whether it differs from ray to ray, so that it takes a focal length."""
        return any(source.has_view for source in self.sources)

    @property
    def requires_grad(self) -> bool:
        """Whether a number of it records gradients."""
        return any(t.requires_grad for one in self.sources for t in one.tensors().values())

    @property
    def has_lamp(self) -> bool:
        """Whether some of it does not come from the surface."""
        return any(isinstance(source, Lamp) for source in self.sources)

    def daylight(self) -> Tensor | float:
        """How bright daylight's veil is (B) where it is level, as a multiple of the medium's."""
        gains = [source.gain for source in self.sources if isinstance(source, Daylight)]
        return sum(gains[1:], start=gains[0]) if gains else 0.0

    def rows(self) -> int:
        """Pictures that it is for: 1 serves any number.

        Raises:
            ValueError: if its numbers are for other batches.
        """
        sizes = {}
        for number, source in enumerate(self.sources):
            for name, value in source.tensors().items():
                sizes[f"light {number} {name}"] = len(value)
        checks.batches(sizes)
        return max([1, *sizes.values()])

    def map(self, function: Callable[[Tensor], Tensor]) -> "Light":
        """`function` applied to each number."""
        return Light(tuple(source.map(function) for source in self.sources))

    def to(self, *args: Any, **kwargs: Any) -> "Light":
        """Move or cast, as `torch.Tensor.to`."""
        return self.map(lambda t: t.to(*args, **kwargs))

    def row(self, n: int) -> "Light":
        """The light of the n-th picture, as a batch of one."""
        return Light(tuple(source.row(n) for source in self.sources))

    def __radd__(self, other: object) -> "Light":
        """For `sum` of several, which begins with 0."""
        return self if other == 0 else NotImplemented

    def __repr__(self) -> str:
        return " + ".join(_call(source) for source in self.sources) or "Light.none()"


def _call(source: Daylight | Lamp) -> str:
    """What makes a source; of a spectrum, or of several rows, in short."""
    if isinstance(source, Lamp):
        names = ("power", "cone", "falloff", "radius", "asymmetry")
        shown = [f"position={_shown(source.position)}", f"direction={_shown(source.axis)}"]
        shown += [f"{name}={_shown(getattr(source, name))}" for name in names]
        if source.spectrum is not None:
            shown.append("spectrum=…")
        elif not torch.equal(source.colour, torch.ones_like(source.colour)):
            shown.append(f"rgb={_shown(source.colour)}")
        return f"Light.lamp({', '.join(shown)})"
    shown = [f"gain={_shown(source.gain)}", f"gradient={_shown(source.gradient)}"]
    if source.elevation is None or source.azimuth is None:
        return f"Light.ambient({', '.join(shown)})"
    sun = [_shown(source.elevation), _shown(source.azimuth)]
    return f"Light.parallel({', '.join([*sun, f'diffuse={_shown(source.diffuse)}', *shown])})"


def _shown(value: Tensor) -> str:
    """A number or a vector; of several rows, how many."""
    if len(value) > 1:
        return f"<{len(value)} rows>"
    numbers = [repr(number) for number in value.detach().flatten().tolist()]
    return numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"


def _checked(source: Daylight | Lamp) -> Light:
    """A light of one source, whose numbers are for one batch."""
    sizes = {name: len(value) for name, value in source.tensors().items()}
    if "axis" in sizes:
        sizes["direction"] = sizes.pop("axis")
    checks.batches(sizes)
    return Light((source,))


def _daylight(
    gain: Number,
    gradient: Number,
    diffuse: Number,
    elevation: Tensor | None = None,
    azimuth: Tensor | None = None,
) -> Daylight:
    share = batch_of("diffuse", diffuse, (), "a share of the light", 0.0)
    at_most({"diffuse": share}, {"diffuse": 1.0}, "")
    gain = batch_of("gain", gain, (), "a factor", 0.0)
    gradient = batch_of("gradient", gradient, (), "a number", -10.0)
    at_most({"gradient": gradient}, {"gradient": 10.0}, "")
    known = {"level": _fixed(gradient, 0.0), "whole": _fixed(gain, 1.0)}
    return Daylight(gain, gradient, share, elevation, azimuth, **known)


def _fixed(value: Tensor, at: float) -> bool:
    """Whether a number has this value and gets no gradient; compiled code cannot look."""
    if torch.compiler.is_compiling() or value.requires_grad:
        return False
    return bool((value == at).all())


def _ahead(position: Tensor) -> bool:
    """Whether a lamp is less than 60° off the camera's axis; compiled code cannot look."""
    if torch.compiler.is_compiling():
        return True
    x, y, z = position.detach().unbind(-1)
    return bool(((z > 0) & (torch.hypot(x, y) < _ASIDE * z)).any())
