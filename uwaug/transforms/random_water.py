"""Random water: which one, how much is in it, how deep it is and how uneven."""

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from dataclasses import field as derived
from functools import cached_property, partial
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from uwaug._support import checks, codec
from uwaug._support.checks import DOMAIN
from uwaug._support.nouns import SEEDS, Drawn, Noun, Uniform, number, require_names, require_seed
from uwaug._support.once import Once
from uwaug._support.ranges import Range, as_range
from uwaug.formation.contrast import contrast_left, metres_for
from uwaug.formation.field import random_fields
from uwaug.light import Light
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.constituents import Constituents
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.reduction import default_bands, reduced
from uwaug.optics.snow import MarineSnow
from uwaug.optics.view import View
from uwaug.optics.water import CONTRAST_THRESHOLD, Water, load_water
from uwaug.transforms.draws import Draw
from uwaug.transforms.measured import Measured

AnyWater = str | os.PathLike[str] | Water | Constituents | Medium

WATERS = Constituents(chlorophyll=(0.2, 15.0), cdom=(0.02, 3.0), minerals=(0.02, 2.5))
"""Seas, coasts and pools, blue to yellow-green."""

DIMMEST = 1 / 8
"""Share of the surface's light that a scene has at least, where the exposure is automatic."""

_CURVES = 0.002  # tolerance of a medium's curves, in the light that a metered exposure makes of it

VISIBLE = (1.1, 60.0)
"""Median distances of a scene that one sees in the default waters."""

PLACED_M = 2.0
"""m: stands for the median distance of a scene without a size, which is placed in its water."""

MILDEST = 0.65
"""Contrast of the mildest grade of severity, for which scenes that are placed are small enough."""

# times what is in a water, from which on is warned: the clearest of `WATERS` need 18 for the
# severest grade at 1 m
MOST_CONTENTS = 50.0
_LEAST_CONTENTS = 1e-3  # share of it that stays where pure water is too murky already
MOST_STOPS = 12.0  # by which contents are scaled, whatever is asked for
_HALVINGS = 13  # of stops that are looked for under lamps
_WALL_PX = 192  # of a wall at the median distance, under lamps

_CALIBRATED = PointSpread.calibrated()

odd_scene = Once()
"""The warning that the water is hardly the one that was named, or as deep as was asked for."""


class Clarity(NamedTuple):
    """The clarity of the water of a picture."""

    water: Water | Medium
    contents: float  # factor of what is in it, besides pure water; of a medium, of its rates
    metres: float  # median distance
    asked: float | None  # contrast that was asked for at this distance

    def record(self) -> dict[str, Any]:
        """All but the water as JSON holds it, and the visibility, m."""
        numbers = self._asdict() | {"visibility": metres_for(self.water, CONTRAST_THRESHOLD)}
        del numbers["water"]
        return {name: None if value == math.inf else value for name, value in numbers.items()}

    @property
    def odd(self) -> str:
        """A sentence if the water is hardly the one named, or too murky when pure; else ""."""
        if self.contents == 0:
            asked = f"a contrast of {self.asked:.2g}" if self.asked else "the visibility"
            return f"pure water has less than {asked} at {self.metres:.3g} m: ask for less"
        if self.contents <= MOST_CONTENTS:
            return ""
        got = f"that takes {self.contents:.3g} times what is in it, which is hardly that water"
        return f"{got}: name a more turbid one, if distances are metres"


@codec.plain
@dataclass(frozen=True, eq=False, repr=False)
class RandomWater(Noun):
    """Draws the water of each picture, as its camera sees it. A range is a number or (low, high),
    drawn uniformly; visibility and contrast uniformly in their logarithm.

    Args:
        waters: one or several of what `uwaug.load_water` takes; `Constituents` (or their text, such
            as "chlorophyll=1:20,cdom=.1:1"), whose contents are drawn anew for each picture,
            uniformly in their logarithm; and a `Medium`: visibility, depth, g, mu, blur, camera and
            its matrix do not apply to it. Picked with equal weight; one that is given twice counts
            twice. None for `WATERS`.
        visibility: m at which 2 % of an object's contrast of luminance are left by daylight, see
            `Water.visibility`: what is in each water is scaled to it. None: waters stay as they
            are; those of `WATERS`, where `waters` is None, let one see 1.1 to 60 times the median
            distance of the scene.
        contrast: share of contrast that is left at the scene's median distance, ignoring scattered
            light (see `Water.contrast`), but under lamps with it: what is in the water is scaled
            to it; of a `Medium` all rates are. None: what is left follows from the water. Metres
            are never scaled; a scene without a size is placed where pure water leaves .65.
        mixing: share of a second water, picked like the first. Both draw their contents at
            the same shares of their ranges.
        vertical_depth: m below the surface; with an automatic exposure no deeper than where 1/8 of
            the light is left.
        g: share of the scattered light that leaves the line of sight, 0…1: .2 of a subject of 20°,
            .5 of one of 6°, .05 of a wall that fills the view.
        mu: share of the scattered light sent towards the camera, 0…1. The veil of endless water has
            mu/g of the light of a white plate; a range is held at g. None for 1.5·g.
        point_spread: width law of the forward scatter; None for `PointSpread.calibrated`.
        field: ends of the medium field, which multiplies distances; None for even water.
        camera: a name, the path of a CSV file or a `Camera`.
        color_matrix: share of the camera's colour matrix, 0…1; None for grey surfaces.
        snow: a `uwaug.MarineSnow`, whose density may be a range; None for clear water.

    `PLAIN` are the options of even water as it is in nature, at the surface, with grey surfaces.

    Raises:
        TypeError, ValueError: if an option does not suit.

    Examples:
        >>> RandomWater(["1C", "7C"], contrast=(0.2, 0.5))
        RandomWater(waters=('1C', '7C'), contrast=(0.2, 0.5))
    """

    PLAIN: ClassVar = {
        "vertical_depth": 0.0,
        "mu": None,
        "field": None,
        "color_matrix": None,
    }

    waters: AnyWater | Iterable[AnyWater] | None = None
    _: KW_ONLY
    visibility: Range | None = number(None, 1e-3, 1e3, logarithmic=True)
    contrast: Range | None = number(None, 1e-3, 1.0, logarithmic=True)
    mixing: Range = number(0.0, *DOMAIN["mixing"])
    vertical_depth: Range = number((0.0, 15.0), *DOMAIN["vertical_depth"])
    g: Range = number(0.2, *DOMAIN["g"])
    mu: Range | None = number((0.04, 0.2), *DOMAIN["mu"])
    point_spread: PointSpread | None = None
    field: tuple[float, float] | None = (0.8, 1.2)
    camera: str | os.PathLike[str] | Camera = "Nikon 5100 (NPL)"
    color_matrix: Range | None = number((0.0, 1.0), *DOMAIN["color_matrix"])
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
        if self.visibility is not None and self.contrast is not None:
            raise ValueError("visibility and contrast both say how clear water is: give one")
        waters = self.waters
        if isinstance(waters, (set, frozenset)):
            raise TypeError("waters must have an order, as draws follow it; got a set")
        if not isinstance(waters, (str, os.PathLike, Water, Medium, type(None))):
            # a tuple stays as it is, whatever becomes of a list
            vars(self)["waters"] = tuple(waters) if isinstance(waters, Iterable) else (waters,)
        named = _named(WATERS if self.waters is None else self.waters)
        vars(self).update(
            names=[name for name, _ in named],
            by_name=dict(named),
            mixes=as_range("mixing", self.mixing, *DOMAIN["mixing"])[1] > 0,
            response=load_camera(self.camera),
            field=None if self.field is None else as_range("field", self.field, 0.0),
        )
        self.require_ranges()
        if self.mixes and (self.waters is None or self.has_media):
            raise ValueError("mixing must be 0 without named waters, as of a Medium or by default")

    @cached_property
    def has_media(self) -> bool:
        return any(isinstance(water, Medium) for water in self.by_name.values())

    def ranges(self) -> dict[str, Range | None]:
        """Contrast alone if all waters are a `Medium`. "clearness" is where in `VISIBLE` the
        visibility lies.
        """
        if all(isinstance(water, Medium) for water in self.by_name.values()):
            return {"contrast": self.contrast}
        is_free = self.waters is None and self.visibility is None
        return {**super().ranges(), **({"clearness": (0.0, 1.0)} if is_free else {})}

    def drawn(self, uniform: Uniform) -> dict[str, Any]:
        # "waters" are the names of one or two, or amounts of contents
        waters: list[str | dict[str, float]] = []
        for order in ("waters", "second water")[: 2 if self.mixes else 1]:
            name = self.names[int(uniform(order) * len(self.names))]
            water = self.by_name[name]
            waters.append(water.drawn(uniform) if isinstance(water, Constituents) else name)
        draw = {"waters": waters, **super().drawn(uniform)}
        if self.field is not None:
            draw["field_seed"] = int(uniform("field") * SEEDS)
        return draw

    def require(self, draw: Drawn, name: str) -> None:
        further = {"waters"} if self.field is None else {"waters", "field_seed"}
        require_names(draw, {*self._ends, *self._nouns, *further}, name)
        super().require({key: value for key, value in draw.items() if key not in further}, name)
        if self.field is not None:
            require_seed(f"params: {name}.field_seed", draw["field_seed"])
        waters, count = draw["waters"], 2 if self.mixes else 1
        if not isinstance(waters, (list, tuple)) or len(waters) != count:
            raise ValueError(f"params: {name}.waters must be {count}, got {waters!r:.80}")
        amounts = [w for w in self.by_name.values() if isinstance(w, Constituents)]
        for water in waters:
            is_name = isinstance(water, str) and isinstance(self.by_name.get(water), Water | Medium)
            is_drawn = isinstance(water, Mapping) and any(w.holds(water) for w in amounts)
            if not (is_name or is_drawn):
                has = ", ".join(self.by_name)
                raise ValueError(f"params asks for {water!r:.80}, but this transform has {has}")

    def random(self) -> list[str]:
        # the field is an input of `uwaug.Underwater`
        has_contents = any(isinstance(water, Constituents) for water in self.by_name.values())
        return ["waters"] * (len(self.by_name) > 1 or has_contents) + super().random()

    def water(self, draw: Drawn, median: float) -> tuple[Water | Medium, float]:
        """The water of a picture, of a scene with this median distance [m], before a contrast is
        asked for; and how many times its contents it has.
        """
        named: Any = self.by_name
        waters = (named[w] if isinstance(w, str) else Water.of_amounts(w) for w in draw["waters"])
        water, *second = waters
        if isinstance(water, Medium):
            return water, 1.0
        if second:
            water = water.mix(second[0], draw["mixing"])
        visibility, least_contents = draw.get("visibility"), 0.0
        if "clearness" in draw and math.isfinite(median):
            least_contents = _LEAST_CONTENTS
            least, most = VISIBLE[0] * median, VISIBLE[1] * median
            visibility = least * (most / least) ** draw["clearness"]
        if visibility is None:
            return water, 1.0
        contents = water.contents_for(CONTRAST_THRESHOLD, visibility)
        contents = min(max(contents, least_contents), 2.0**MOST_STOPS)
        return water.with_contents(contents), contents

    def farthest(self, water: Water | Medium, draw: Drawn) -> float:
        """Distance [m] within which a scene is placed: pure water leaves what is asked for."""
        asked = draw.get("contrast")
        if asked is None or isinstance(water, Medium):
            return math.inf
        return water.with_contents(0.0).metres_for(max(asked, MILDEST))

    def of(
        self,
        water: Water | Medium,
        draw: Drawn,
        measured: Measured,
        light: Light | None,
        view: View,
    ) -> tuple[Medium, float | None, Water | Medium, float]:
        """The medium of a picture; its depth [m], None of a medium; its `water`, brought to the
        contrast that was drawn, if any, in this light; and the factor of its contents that does it.
        """
        has_lamps = bool(light and light.lamps)
        medium_of = partial(self._medium_of, draw=draw, metered=measured.metered, lamps=has_lamps)
        contents, asked = 1.0, draw.get("contrast")
        if asked is not None and math.isfinite(measured.median):
            if has_lamps:
                contents = _contents_under(light, water, medium_of, asked, measured, view)
            elif isinstance(water, Medium):
                contents = metres_for(water, asked) / measured.median
            else:
                contents = min(water.contents_for(asked, measured.median), 2.0**MOST_STOPS)
            water = water.with_contents(contents)
        medium, depth = medium_of(water)
        if self.snow is not None:
            snow = self.snow.of(draw["snow"])
            x, y, z = (own + way for own, way in zip(snow.drift, measured.moved, strict=True))
            medium = medium.with_snow(replace(snow, drift=(x, y, z)))
        return medium, depth, water, contents

    def _medium_of(
        self, water: Water | Medium, *, draw: Drawn, metered: bool, lamps: bool
    ) -> tuple[Medium, float | None]:
        if isinstance(water, Medium):
            return water, None
        depth, daylight = draw["vertical_depth"], 1.0
        if metered and not lamps:
            daylight = water.daylight(depth)
            if daylight < DIMMEST:
                deepest = min(depth, water.depth_of_daylight(DIMMEST))
                if not isinstance(self.vertical_depth, tuple):
                    got = f"{depth:g} m deep {water.name} leaves {daylight:.1g} of the light"
                    odd_scene.warn(f"{got}: taken at {deepest:.3g} m, but with metered=False")
                depth, daylight = deepest, DIMMEST
        tolerance = _CURVES * daylight  # errors, too, are brought up by an exposure
        g, mu = draw["g"], draw.get("mu")
        if mu is None:
            mu = min(1.5 * g, 1.0)
        elif isinstance(self.mu, tuple):  # no veil that is drawn is brighter than a white plate
            mu = min(mu, g)
        options = depth, g, mu, draw.get("color_matrix"), tolerance
        # the last one again if nothing differs, as if nothing is random
        before: tuple[Water, Any, Medium, float] | None = vars(self).get("_before")
        if before and before[0] is water and before[1] == (options, lamps):
            return before[2:]
        arrays = reduced(water, self.response, *options, lamps=lamps)
        medium = Medium.of_arrays(*arrays, self.point_spread or _CALIBRATED)
        vars(self)["_before"] = water, (options, lamps), medium, depth
        return medium, depth

    def fields(
        self, draws: Sequence[Draw], measured: Sequence[Measured], like: Tensor, view: View
    ) -> Tensor:
        """The medium field (Bx1xHxW) of each picture, of the size of `like`; 1 in even water."""
        if self.field is None:
            return like.new_ones(())
        seeds, moved = list[int](), list[tuple[float, float]]()
        for draw, picture in zip(draws, measured, strict=True):
            right, down, _ = picture.moved
            # to move by 0 m needs no px a metre
            scale = view.focal(picture.width) / picture.median if right or down else 0.0
            seeds.append(draw.water["field_seed"])
            moved.append((scale * right, scale * down))
        return random_fields(seeds, (like.shape[-2], like.shape[-1]), *self.field, like, moved)


def _contents_under(
    light: Light | None,
    water: Water | Medium,
    medium_of: Callable[..., tuple[Medium, float | None]],
    contrast: float,
    measured: Measured,
    view: View,
) -> float:
    """Factor of what is in a water that leaves this contrast of a wall at the median distance, in a
    light, whose scattered light counts.
    """
    size = measured.height, measured.width
    # whole columns of square pixels, so that rows are nearly whole
    columns = max(1, round(math.sqrt(_WALL_PX * size[1] / size[0])))
    rows = max(1, round(columns * size[0] / size[1]))
    wall = torch.full((1, rows, columns), measured.median, dtype=torch.float64)
    shown = view.crop(size, 0, 0).resized(columns / size[1])
    low, high = -MOST_STOPS, MOST_STOPS
    for _ in range(_HALVINGS):
        stops = (low + high) / 2
        medium, _depth = medium_of(water.with_contents(2.0**stops))
        left = contrast_left(wall, medium, light=light, view=shown).mean()
        low, high = (stops, high) if float(left) > contrast else (low, stops)
    return 2.0**low if low > -MOST_STOPS else 0.0


def _named(waters: Any) -> list[tuple[str, Water | Constituents | Medium]]:
    named: list[tuple[str, Water | Constituents | Medium]] = []
    for water in waters if isinstance(waters, tuple) else (waters,):
        if isinstance(water, Medium):
            named += [(f"medium {len(named) + i}", water[i]) for i in range(len(water))]
            continue
        if isinstance(water, str) and "=" in water and not water.lower().endswith(".csv"):
            water = Constituents.parse(water)
        if isinstance(water, Constituents) and not water.fixed:
            named.append((water.name, water))
            continue
        spectra = load_water(water.name if isinstance(water, Constituents) else water)
        # at the bands that media are made from: mixing needs no interpolation
        named.append((spectra.name, spectra.at(default_bands(spectra))))
    if not named:
        raise ValueError("waters: expected at least one, got none")
    for name, water in named:
        if any(other != water for same, other in named if same == name):
            raise ValueError(f"waters: two are called {name!r}; name=… gives a name of its own")
    return named
