"""Random light: daylight from above, or lamps with what is left of it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

from uwaug._support import checks, codec
from uwaug._support.nouns import Drawn, Noun, Uniform, number
from uwaug._support.ranges import Range
from uwaug.light import Lamp, Light
from uwaug.transforms.measured import Measured

T = TypeVar("T")


class Rig(NamedTuple):
    """A mount of lamps; least and largest number of them, and m from lens to outermost lamp."""

    lamps: tuple[int, int]
    aside: tuple[float, float]
    above: tuple[float, float]


RIGS = {
    "vehicle": Rig((2, 4), (0.3, 1.0), (0.2, 0.8)),
    "diver": Rig((1, 2), (0.3, 0.7), (-0.1, 0.5)),
    "strobe": Rig((1, 2), (0.08, 0.2), (0.0, 0.15)),
}
"""A bar of a vehicle, a diver's arms, and strobes at the lens."""

# of the lamps of a rig, in turn: shares of `aside` and `above`
_LAMP_PLACES = ((1.0, 1.0), (-1.0, 1.0), (0.4, 0.3), (-0.4, 0.3))
_OPEN_WATER_M = 8.0  # stands for the median distance where all is open water


@codec.plain
@dataclass(frozen=True, repr=False)
class RandomLight(Noun):
    """Draws the light of each picture: daylight from above for most, lamps near the camera for
    some. A range is a number or (low, high), drawn uniformly.

    Attributes:
        share: of pictures that lamps light, 0…1.
        rigs: "vehicle" (2 to 4 lamps, above and beside), "diver" (1 or 2, on arms) and "strobe" (1
            or 2, at the lens); picked with equal weight.
        daylight: factor of daylight beside the lamps, see `uwaug.Light`.
        pitch: angle of the camera's axis above the horizon, degrees; None: light is alike in all
            directions.
        power: stops by which all lamps together, if they hung at the lens, would make a white plate
            at the median distance, in air, brighter than daylight at the surface does.
        cone: as for `uwaug.Lamp`, degrees.
        across, down: point at which the lamps aim, right of the middle and below it, in shares of
            the median distance.
        tint: stops by which the lamps' blue is above their red: −1.7 of a halogen lamp.

    Raises:
        TypeError, ValueError: if a value does not suit, or leaves its domain.
    """

    share: float = 1 / 10
    rigs: str | tuple[str, ...] = tuple(RIGS)
    daylight: Range = number((0.05, 0.5), 0.0)
    power: Range = number((-1.0, 1.0), -10.0, 10.0)
    cone: Range = number((30.0, 75.0), 1.0, 90.0)
    across: Range = number((-0.1, 0.1), -2.0, 2.0)
    down: Range = number((0.05, 0.3), -2.0, 2.0)
    tint: Range = number((-1.7, 0.3), -2.0, 2.0)
    pitch: Range | None = number((-25.0, 15.0), -90.0, 90.0)

    def __post_init__(self) -> None:
        checks.within("share", self.share, 0.0, 1.0)
        rigs = (self.rigs,) if isinstance(self.rigs, str) else self.rigs
        for rig in rigs or ("",):
            checks.one_of("rigs", rig, RIGS)
        object.__setattr__(self, "rigs", tuple(rigs))
        self.require_ranges()

    def ranges(self) -> dict[str, Range | None]:
        # with a rig, its count of lamps, and where on it they hang
        places = {"rig": (0.0, 1.0), "count": (0.0, 1.0), "aside": (-1.0, 1.0), "above": (0.0, 1.0)}
        return {**super().ranges(), **places}

    def drawn(self, uniform: Uniform) -> dict[str, Any]:
        return super().drawn(uniform) if uniform("share") < self.share else self._day.drawn(uniform)

    def require(self, draw: Drawn, name: str) -> None:
        require = super().require if "rig" in draw else self._day.require
        require(draw, name)

    def random(self) -> list[str]:
        return ["share", *super().random()] if self.share > 0 else self._day.random()

    @cached_property
    def _day(self) -> "_Day":
        return _Day(self.pitch)

    def of(self, draw: Drawn, measured: Measured) -> Light | None:
        pitch = draw.get("pitch")
        if "rig" not in draw:
            return None if pitch is None else checks.unchecked(Light, pitch=pitch)
        metres = measured.median if math.isfinite(measured.median) else _OPEN_WATER_M
        rig = RIGS[_picked(draw["rig"], self.rigs)]
        count = _picked(draw["count"], range(rig.lamps[0], rig.lamps[1] + 1))
        # of −1…1 the sign says on which side the first lamp is
        side = draw["aside"]
        aside = math.copysign(_between(rig.aside, abs(side)), side)
        above = _between(rig.above, draw["above"])
        across, down = draw["across"] * metres, draw["down"] * metres
        power = 2 ** draw["power"] * metres**2 / count
        color = (2 ** (-draw["tint"] / 2), 1.0, 2 ** (draw["tint"] / 2))
        lamps = []
        for right, up in _LAMP_PLACES[:count]:
            x, y = right * aside, -up * above
            aim = (across - x, down - y, metres)
            lamps.append(Lamp((x, y, 0.0), power=power, aim=aim, cone=draw["cone"], color=color))
        return Light(tuple(lamps), draw["daylight"], pitch=pitch)


@dataclass(frozen=True)
class _Day(Noun):
    pitch: Range | None = number(None, -90.0, 90.0)


def _picked(share: float, choices: Sequence[T]) -> T:
    return choices[min(int(share * len(choices)), len(choices) - 1)]


def _between(ends: tuple[float, float], share: float) -> float:
    return ends[0] + (ends[1] - ends[0]) * share
