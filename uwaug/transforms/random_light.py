"""What is random about light: daylight, or lamps and what of daylight is left beside them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from uwaug._support import checks, codec
from uwaug._support.ranges import Range
from uwaug.light import Lamp, Light
from uwaug.transforms.draws import Draw, checked
from uwaug.transforms.measured import Measured

T = TypeVar("T")


class Rig(NamedTuple):
    """Where lamps hang.

    Attributes:
        lamps: the fewest and the most of them.
        aside, above: from the lens to the outermost, m.
    """

    lamps: tuple[int, int]
    aside: tuple[float, float]
    above: tuple[float, float]


RIGS = {
    "vehicle": Rig((2, 4), (0.3, 1.0), (0.2, 0.8)),
    "diver": Rig((1, 2), (0.3, 0.7), (-0.1, 0.5)),
    "strobe": Rig((1, 2), (0.08, 0.2), (0.0, 0.15)),
}
"""On a bar of a vehicle, on a diver's arms, and at the lens."""

_PLACES = ((1.0, 1.0), (-1.0, 1.0), (0.4, 0.3), (-0.4, 0.3))
"""Of the lamps of a rig, in turn: shares of `aside` and `above`."""

_FAR = 8.0
"""m: stands for the median distance where all is open water."""


@codec.plain
@dataclass(frozen=True)
class RandomLight:
    """From what the light of each picture is drawn: some are taken at night, or where daylight
    hardly comes, by lamps near the camera.

    A range is a number or (low, high), drawn uniformly.

    Attributes:
        share: of the pictures that lamps light, 0…1.
        rigs: on what lamps hang, of "vehicle" (2 to 4, above and beside), "diver" (1 or 2, on arms)
            and "strobe" (1 or 2, at the lens); picked with equal weight.
        daylight: factor of daylight beside the lamps, see `uwaug.Light`.
        power: stops by which all lamps together make a white plate at the median distance brighter
            than daylight at the surface does, in air: so do they reach the scene.
        cone: as for `uwaug.Lamp`, degrees.
        across, down: where at the median distance the lamps aim, in shares of that distance, right
            of the middle and below it; the view ends at .58.
        tint: stops by which the lamps' blue is above their red, beside daylight: −1.7 of a halogen
            lamp of 3000 K, .3 of an LED of 6500 K.

    Raises:
        TypeError, ValueError: if a value does not suit, or leaves its domain.
    """

    share: float = 1 / 12
    rigs: str | tuple[str, ...] = tuple(RIGS)
    daylight: Range = (0.0, 0.1)
    power: Range = (-1.0, 1.0)
    cone: Range = (30.0, 75.0)
    across: Range = (-0.1, 0.1)
    down: Range = (0.05, 0.3)
    tint: Range = (-1.7, 0.3)

    def __post_init__(self) -> None:
        checks.within("light: share", self.share, 0.0, 1.0)
        rigs = (self.rigs,) if isinstance(self.rigs, str) else self.rigs
        if not isinstance(rigs, (tuple, list)) or not rigs:
            raise TypeError(f"light: rigs must be some of {', '.join(RIGS)}, got {rigs!r}")
        for rig in rigs:
            checks.one_of("light: rigs", rig, RIGS)
        object.__setattr__(self, "rigs", tuple(rigs))
        checked(self.ranges())

    def ranges(self) -> dict[str, Range | None]:
        """Each number that a picture draws, by name."""
        places = ("light_night", "lamp_rig", "lamp_count", "lamp_aside", "lamp_above")
        own = ("power", "cone", "across", "down", "tint")
        return {
            **{name: checks.DOMAIN[name] for name in places},
            "light_daylight": self.daylight,
            **{f"lamp_{name}": getattr(self, name) for name in own},
        }

    def of(self, draw: Draw, seen: Measured, *, scale: float = 1.0) -> Light | None:
        """The light of a picture whose distances are multiplied by `scale`; None for daylight."""
        numbers = draw.numbers
        if numbers["light_night"] >= self.share:
            return None
        metres = seen.median * scale if math.isfinite(seen.median) else _FAR
        rig = RIGS[_picked(numbers["lamp_rig"], self.rigs)]
        fewest, most = rig.lamps
        count = _picked(numbers["lamp_count"], range(fewest, most + 1))
        # of −1…1 the sign says on which side the first lamp is
        side = numbers["lamp_aside"]
        aside = math.copysign(_between(rig.aside, abs(side)), side)
        above = _between(rig.above, numbers["lamp_above"])
        target = numbers["lamp_across"] * metres, numbers["lamp_down"] * metres
        tint = numbers["lamp_tint"]
        lamps = []
        for right, up in _PLACES[:count]:
            x, y = right * aside, -up * above
            lamps.append(
                Lamp(
                    (x, y, 0.0),
                    power=2 ** numbers["lamp_power"] * metres**2 / count,
                    aim=(target[0] - x, target[1] - y, metres),
                    cone=numbers["lamp_cone"],
                    color=(2 ** (-tint / 2), 1.0, 2 ** (tint / 2)),
                )
            )
        return Light(tuple(lamps), numbers["light_daylight"])


def _picked(share: float, choices: Sequence[T]) -> T:
    return choices[min(int(share * len(choices)), len(choices) - 1)]


def _between(ends: tuple[float, float], share: float) -> float:
    low, high = ends
    return low + (high - low) * share
