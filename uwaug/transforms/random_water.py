"""What is random about water: which one, how much is in it, how deep it is and how uneven."""

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from dataclasses import field as derived
from functools import lru_cache
from typing import Any, NamedTuple

from torch import Tensor

from uwaug._support import checks, codec
from uwaug._support.once import Once
from uwaug._support.ranges import Range, as_range
from uwaug.formation.field import random_fields
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.constituents import UNITS, Constituents
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import FOCAL_LENGTH, PointSpread
from uwaug.optics.reduction import default_bands
from uwaug.optics.snow import MarineSnow
from uwaug.optics.water import Water, load_water
from uwaug.transforms.draws import Draw, Uniform, checked
from uwaug.transforms.measured import Measured

AnyWater = str | os.PathLike[str] | Water | Constituents | Medium

CONTENTS = Constituents(chlorophyll=(1.0, 30.0), cdom=(0.03, 0.35), minerals=(0.25, 4.0))
"""Seas and coasts, blue to green. Lakes hold more CDOM, which turns them yellow."""

WATERS = ("IB", "II", "III", "1C", "3C", "5C", "7C", "9C", *[CONTENTS] * 8)
"""Half of the waters are Jerlov types, half are of other contents. The clear oceanic types would
need 11 to 66 times what is in them to reach a contrast, and turn dark green. (Others that were
tried: benchmarks/CHOICES.md, default draws.)
"""

DIMMEST = 1 / 32
"""Share of the surface's light that a scene has at least, where the exposure is automatic: what the
largest gain makes up for, and an octave for what is lost on the way to the camera. Waters that are
turbid enough for a scene at arm's length are black at 10 m.
"""

_CURVES = 0.002
"""Tolerance of the curves of a medium, in the light that a metered exposure makes of it."""

MEDIANS = (1.0, 8.0)
"""m: median distances between which water can be brought to a contrast and have a colour of its
own. (What scenes at 35 m and at .1 m lose without: benchmarks/CHOICES.md, default draws.)
"""

MOST_SCALED, MOST_CONTENTS, MOST_MISSED = 4.0, 50.0, 2.0
"""What is worth a word: a scene scaled by more; contents more times those of the water, where the
clearest of `WATERS` need 42 for the severest grade at 1 m; a contrast so many times less than what
was asked for.
"""

_medium_of = lru_cache(maxsize=2)(Medium.from_water)
"""Kept for transforms of one fixed water."""

odd_scene = Once()
"""What it took to reach a contrast."""


class Reached(NamedTuple):
    """What it took to bring a water to the contrast asked for."""

    water: str
    metres: float  # the median distance, scaled
    scale: float  # times every distance
    contents: float  # times what is in the water besides pure water
    contrast: float  # left at the median distance
    asked: float

    @property
    def odd(self) -> str:
        """A sentence where distances are hardly metres, or the water is hardly the one that was
        named; "" where they are.
        """
        asked, unit = f"{self.asked:.2g} at {self.metres:.3g} m", "are distances metres?"
        if not 1 / MOST_SCALED <= self.scale <= MOST_SCALED:
            median = self.metres / self.scale
            odd = f"a median of {median:.3g} m is scaled by {self.scale:.3g}: {unit}"
        elif self.contents > MOST_CONTENTS:
            times = f"that is {self.contents:.3g} times what is in it"
            odd = f"water {self.water} is too clear for {asked}: {times}. Name a more turbid one"
        elif self.contrast < self.asked / MOST_MISSED:
            odd = f"pure water leaves {self.contrast:.2g} of contrast, not {asked}: {unit}"
        else:
            return ""
        return f"{odd}; contrast=None (--contrast none) leaves distances and water as they are"


class InWater(NamedTuple):
    """The water of a picture."""

    medium: Medium
    scale: float  # times every distance
    reached: Reached | None  # where a contrast was asked for


@codec.plain
@dataclass(frozen=True, eq=False)
class RandomWater:
    """From what the water of each picture is drawn; arguments as for `RandomUnderwater`.

    Raises:
        TypeError, ValueError: if one does not suit, naming what came and what was expected.
    """

    waters: AnyWater | Iterable[AnyWater] | None = None
    _: KW_ONLY
    contrast: Range | None = (0.08, 0.35)
    mixing: Range = 0.0
    vertical_depth: Range = (4.0, 12.0)
    g: Range = 0.05
    mu: Range | None = (0.01, 0.05)
    point_spread: PointSpread | None = None
    field: tuple[float, float] | None = (0.8, 1.2)
    camera: str | os.PathLike[str] | Camera = "Nikon 5100 (NPL)"
    snow: MarineSnow | None = None

    names: Sequence[str] = derived(init=False, repr=False)
    by_name: Mapping[str, Water | Constituents | Medium] = derived(init=False, repr=False)
    mixes: bool = derived(init=False, repr=False)
    response: Camera = derived(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.point_spread is not None:
            checks.instance("point_spread", self.point_spread, PointSpread)
        if self.snow is not None:
            checks.instance("snow", self.snow, MarineSnow)
        loaded = _loaded(WATERS if self.waters is None else self.waters)
        mixes = checked(self.ranges())["mixing"][1] > 0
        if mixes and any(isinstance(water, Medium) for _, water in loaded):
            raise ValueError("mixing needs spectra: it must be 0 where a water is a Medium")
        vars(self).update(
            names=[name for name, _ in loaded],
            by_name=dict(loaded),
            mixes=mixes,
            response=load_camera(self.camera),
            field=None if self.field is None else as_range("field", self.field, 0.0),
        )

    def ranges(self) -> dict[str, Range | None]:
        """Each number that a picture draws, by name; None where there is none."""
        drawn = ("contrast", "mixing", "vertical_depth", "g", "mu")
        own = {name: getattr(self, name) for name in drawn}
        if self.snow is not None:
            own |= {"snow_density": self.snow.density, "snow_seed": checks.DOMAIN["snow_seed"]}
        return own

    def picked(self, uniform: Uniform) -> list[str]:
        """The names of the waters of a picture; that of drawn contents says all of them."""
        drawn = ("water", "second water") if self.mixes else ("water",)
        names = [self.names[int(uniform(which) * len(self.names))] for which in drawn]
        waters = [self.by_name[name] for name in names]
        return [
            water.drawn({content: uniform(content) for content in UNITS}).name
            if isinstance(water, Constituents)
            else name
            for name, water in zip(names, waters, strict=True)
        ]

    def field_seed(self, uniform: Uniform) -> int | None:
        """The seed of a picture's medium field, of the 32 bits that a generator of torch takes."""
        return None if self.field is None else int(uniform("field") * 2**32)

    def of(
        self, draw: Draw, seen: Measured, *, metered: bool = True, lamps: bool = False
    ) -> InWater:
        """The water of a picture, scaled to its median distance.

        Args:
            draw: of `ranges`, with the names of its waters.
            seen: the picture.
            metered: whether an exposure makes up for the light that is lost above the scene.
            lamps: whether lamps shine, which they do at any depth, from places in metres.
        """
        numbers, reached = draw.numbers, None
        fixed = self.by_name.get(draw.waters[0])
        if isinstance(fixed, Medium):
            return InWater(self._snowing(fixed, draw), 1.0, None)
        water, *others = map(self._spectra, draw.waters)
        if others:
            water = water.mix(others[0], numbers["mixing"])
        scale = 1.0
        if "contrast" in numbers:
            if not lamps and math.isfinite(seen.median):
                scale = min(max(seen.median, MEDIANS[0]), MEDIANS[1]) / seen.median
            water, reached = _with_contrast(water, numbers["contrast"], seen.median, scale)
        depth, daylight = numbers["vertical_depth"], 1.0
        if metered and not lamps:
            daylight = water.daylight(depth)
            if daylight < DIMMEST:
                depth, daylight = min(depth, water.depth_of_daylight(DIMMEST)), DIMMEST
        medium = _medium_of(
            water,
            self.response,
            vertical_depth=depth,
            g=numbers["g"],
            mu=self._towards(numbers),
            point_spread=self.point_spread or PointSpread.calibrated(FOCAL_LENGTH * seen.width),
            surfaces="spectral" if "color_matrix" in numbers else "grey",
            color_matrix=numbers.get("color_matrix", 1.0),
            tolerance=_CURVES * daylight,  # what an exposure brings up, errors included
        )
        return InWater(self._snowing(medium, draw), scale, reached)

    def _snowing(self, medium: Medium, draw: Draw) -> Medium:
        """A medium with the particles that are drawn; with those of its own if none are."""
        if self.snow is None:
            return medium
        density, seed = draw.numbers["snow_density"], int(draw.numbers["snow_seed"])
        return medium.with_snow(replace(self.snow, density=density, seed=seed, drift=draw.moved))

    def fields(self, draws: Sequence[Draw], seen: Sequence[Measured], like: Tensor) -> Tensor:
        """The medium field (Bx1xHxW) of each picture, for distances of the shape of a tensor; 1 in
        even water.
        """
        if self.field is None:
            return like.new_ones(())
        # in px of the view that the width law takes the picture for
        moved = [
            FOCAL_LENGTH * look.width * draw.moved / look.median
            for draw, look in zip(draws, seen, strict=True)
        ]
        seeds = [draw.field_seed or 0 for draw in draws]
        return random_fields(seeds, (like.shape[-2], like.shape[-1]), *self.field, like, moved)

    @property
    def has_one_law(self) -> bool:
        """Whether all media have one law of widths: those of fits may have laws of their own."""
        fitted = any(isinstance(water, Medium) for water in self.by_name.values())
        return len(self.by_name) == 1 or not fitted

    def require(self, name: Any) -> None:
        """Refuse the name of a water that cannot have been drawn."""
        ranges = [water for water in self.by_name.values() if isinstance(water, Constituents)]
        can_be = name in self.by_name and not isinstance(self.by_name[name], Constituents)
        if not can_be and isinstance(name, str) and "=" in name:
            contents = Constituents.parse(name)
            can_be = any(each.holds(contents) for each in ranges)
        if not can_be:
            has = ", ".join(self.by_name)
            raise ValueError(f"params asks for {name!r}, but this transform has {has}")

    def _towards(self, numbers: Mapping[str, float]) -> float | None:
        """μ; of a range no more than g, as no veil is brighter than a white plate."""
        if isinstance(self.mu, (tuple, list)):
            return min(numbers["mu"], numbers["g"])
        return numbers.get("mu")

    def _spectra(self, name: str) -> Water:
        """A water by the name that a record gives it."""
        water = self.by_name.get(name)
        return water if isinstance(water, Water) else load_water(name)


def _with_contrast(
    water: Water, asked: float, median: float, scale: float
) -> tuple[Water, Reached]:
    """A water with so much in it that this contrast is left at the median distance, m, of a scene
    whose distances are multiplied by `scale`.
    """
    metres = median * scale
    contents = water.contents_for(asked, metres)
    if math.isinf(contents):
        cure = "draw from waters that have something in them, or give contrast=None"
        raise ValueError(f"contrast: {water.name!r} is nothing but pure water to the eye: {cure}")
    scaled = water.with_contents(contents)
    contrast = asked if contents else scaled.contrast(metres)
    reached = Reached(water.name, metres, scale, contents, contrast, asked)
    if reached.odd:
        odd_scene.warn(reached.odd)
    return scaled, reached


def _loaded(waters: Any) -> list[tuple[str, Water | Constituents | Medium]]:
    """Waters, or ranges that each picture draws one from, with their names."""
    kinds = (str, os.PathLike, Water, Constituents, Medium)
    if isinstance(waters, (set, frozenset)):
        raise TypeError("waters must have an order, as draws follow it; got a set")
    loaded: list[tuple[str, Water | Constituents | Medium]] = []
    is_single = isinstance(waters, kinds) or not isinstance(waters, Iterable)
    for water in [waters] if is_single else waters:
        if isinstance(water, Medium):
            loaded += [(f"medium {len(loaded) + i}", water[i]) for i in range(len(water))]
            continue
        if isinstance(water, str) and "=" in water and not water.lower().endswith(".csv"):
            water = Constituents.parse(water)
        if isinstance(water, Constituents) and not water.fixed:
            loaded.append((water.name, water))
            continue
        spectra = load_water(water.name if isinstance(water, Constituents) else water)
        # at the bands that media are made from: mixing needs no interpolation
        loaded.append((spectra.name, spectra.at(default_bands(spectra))))
    if not loaded:
        raise ValueError("waters: expected at least one, got none")
    for name, water in loaded:
        if any(other != water for same, other in loaded if same == name):
            raise ValueError(f"waters: two are called {name!r}; name=… gives a name of its own")
    return loaded
