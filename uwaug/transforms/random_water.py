"""Random water: which one, how much is in it, how deep it is and how uneven."""

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from dataclasses import field as derived
from functools import cached_property
from typing import Any, ClassVar, Literal, NamedTuple, get_args

from torch import Tensor

from uwaug._support import checks, codec
from uwaug._support.checks import DOMAIN
from uwaug._support.nouns import SEEDS, Drawn, Noun, Uniform, number, require_names, require_seed
from uwaug._support.once import Once
from uwaug._support.ranges import Range, as_range
from uwaug.formation.field import random_fields
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.constituents import Constituents
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.reduction import default_bands
from uwaug.optics.snow import MarineSnow
from uwaug.optics.view import View
from uwaug.optics.water import Water, load_water
from uwaug.transforms.draws import Draw
from uwaug.transforms.measured import Measured

AnyWater = str | os.PathLike[str] | Water | Constituents | Medium

Knob = Literal["contents", "distance"]
"""Means by which a scene is brought to its contrast: contents of the water, or the distance."""

CONTENTS = Constituents(chlorophyll=(1.0, 30.0), cdom=(0.03, 0.35), minerals=(0.25, 4.0))
"""Seas and coasts, blue to green. Lakes hold more CDOM, which turns them yellow."""

WATERS = ("IB", "II", "III", "1C", "3C", "5C", *[CONTENTS] * 4)
"""Six of ten default waters are Jerlov types. In 7C and 9C by name nearly one colour is left, which
looks like a filter. (Others that were tried: benchmarks/CHOICES.md, default draws.)
"""

DIMMEST = 1 / 8
"""Share of the surface's light that a scene has at least, where the exposure is automatic: below,
turbid waters have one colour, which a camera's matrix makes neon.
"""

_CURVES = 0.002  # tolerance of a medium's curves, in the light that a metered exposure makes of it

MEDIANS = (1.0, 8.0)
"""m: ends of the median distances at which water can be brought to a contrast by its contents and
have a colour of its own. (Beyond: benchmarks/CHOICES.md, default draws.)
"""

SCALED_MEDIANS = (0.1, 100.0)
"""m: ends of the median distances to which a scene is scaled for the contrast of a water as it is.
Nearer, the lens would touch it; no water lets one see farther.
"""

# warned of from these factors on; of the contents, the clearest of `WATERS` need 42 for the
# severest grade at 1 m
MOST_SCALED, MOST_CONTENTS, MOST_MISSED = 4.0, 50.0, 2.0

_CALIBRATED = PointSpread.calibrated()

odd_scene = Once()
"""The warning that distances are hardly metres, or the water hardly the one that was named."""


class Reached(NamedTuple):
    """The contrast to which a scene was brought, and what it took."""

    water: str
    metres: float  # median distance, scaled
    scale: float  # factor of all distances
    contents: float  # factor of what is in the water besides pure water
    contrast: float  # left at the median distance
    asked: float  # the contrast that was asked for
    by: Knob

    @property
    def odd(self) -> str:
        """A sentence if distances are hardly metres, or the water hardly the one named; else ""."""
        asked, unit = f"{self.asked:.2g} at {self.metres:.3g} m", "are distances metres?"
        by_contents = self.by == "contents"
        if by_contents and not 1 / MOST_SCALED <= self.scale <= MOST_SCALED:
            median = self.metres / self.scale
            odd = f"a median of {median:.3g} m is scaled by {self.scale:.3g}: {unit}"
        elif self.contents > MOST_CONTENTS:
            times = f"that is {self.contents:.3g} times what is in it"
            odd = f"water {self.water} is too clear for {asked}: {times}. Name a more turbid one"
        elif not 1 / MOST_MISSED <= self.contrast / self.asked <= MOST_MISSED:
            water = "pure water" if by_contents else f"water {self.water}"
            why = unit if by_contents else "water.contrast_by=contents would change what is in it"
            odd = f"{water} leaves {self.contrast:.2g} of contrast, not {asked}: {why}"
        else:
            return ""
        cure = "water.contrast=None (--contrast none) leaves distances and water as they are"
        return f"{odd}; {cure}"


class PictureWater(NamedTuple):
    """The water of one picture."""

    medium: Medium
    scale: float  # factor of all distances
    vertical_depth: float | None  # m; None of a medium
    reached: Reached | None  # None if no contrast was asked for


@codec.plain
@dataclass(frozen=True, eq=False, repr=False)
class RandomWater(Noun):
    """Draws the water of each picture, as its camera sees it. A range is a number or (low, high),
    drawn uniformly; contrast is drawn uniformly in its logarithm.

    Args:
        waters: one or several of what `uwaug.load_water` takes; `Constituents` (or their text, such
            as "chlorophyll=1:20,cdom=.1:1"), whose contents are drawn anew for each picture,
            uniformly in their logarithm; and a `Medium`, which stays as it is: contrast, depth, g,
            mu, blur, camera and its matrix do not apply to it. Picked with equal weight; one that
            is given twice counts twice. None for `WATERS`.
        contrast: share of an object's contrast of luminance that is left at the scene's median
            distance, ignoring scattered light (see `Water.contrast`). None leaves distances, and
            waters as they are in nature.
        contrast_by: "contents" brings a water to it by scaling what is in it, as far as pure water
            allows; a scene whose median lies below 1 m or above 8 m is scaled to that first.
            "distance" scales the scene, to a median between .1 and 100 m, and leaves the water as
            it is. Under a `uwaug.Light` no scene is scaled, as lamps stand in metres. None: by
            distance where all waters of a picture are names; else by contents, and also under lamps
            where `waters` is None.
        mixing: share of a second water, picked like the first. Both draw their contents at
            the same shares of their ranges.
        vertical_depth: m below the surface; with an automatic exposure no deeper than where 1/8 of
            the light is left.
        g: share of the scattered light that leaves the line of sight, 0…1.
        mu: share of the scattered light sent towards the camera, 0…1. The veil of endless water has
            mu/g of the light of a white plate; a range is held at g. None for 1.5·g.
        point_spread: width law of the forward scatter; None for `PointSpread.calibrated`.
        field: least and largest value of the medium field, which multiplies distances; None for
            even water.
        camera: a name, the path of a CSV file or a `Camera`.
        color_matrix: share of the camera's colour matrix, 0…1. None for grey surfaces, see
            `uwaug.Medium.from_water`.
        snow: a `uwaug.MarineSnow`, whose density may be a range; None for clear water.

    `PLAIN` are the options of even water as it is in nature, at the surface, with grey surfaces.

    Raises:
        TypeError, ValueError: if an option does not suit.

    Examples:
        >>> RandomWater(["1C", "7C"], contrast=(0.2, 0.5))
        RandomWater(waters=('1C', '7C'), contrast=(0.2, 0.5))
    """

    PLAIN: ClassVar = {
        "contrast": None,
        "vertical_depth": 0.0,
        "mu": None,
        "field": None,
        "color_matrix": None,
    }

    waters: AnyWater | Iterable[AnyWater] | None = None
    _: KW_ONLY
    contrast: Range | None = number((0.07, 0.4), 1e-3, 1.0, logarithmic=True)
    contrast_by: Knob | None = None
    mixing: Range = number(0.0, *DOMAIN["mixing"])
    vertical_depth: Range = number((1.0, 15.0), *DOMAIN["vertical_depth"])
    g: Range = number(0.05, *DOMAIN["g"])
    mu: Range | None = number((0.02, 0.07), *DOMAIN["mu"])
    point_spread: PointSpread | None = None
    field: tuple[float, float] | None = (0.8, 1.2)
    camera: str | os.PathLike[str] | Camera = "Nikon 5100 (NPL)"
    color_matrix: Range | None = number((0.0, 0.8), *DOMAIN["color_matrix"])
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
        if self.contrast_by is not None:
            checks.one_of("contrast_by", self.contrast_by, get_args(Knob))
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
        if self.mixes and self.has_media:
            raise ValueError("mixing needs spectra: it must be 0 where a water is a Medium")

    @cached_property
    def has_media(self) -> bool:
        """True if a water is a `Medium`."""
        return any(isinstance(water, Medium) for water in self.by_name.values())

    def ranges(self) -> dict[str, Range | None]:
        """See `Noun.ranges`; none if all waters are a `Medium`."""
        are_media = all(isinstance(water, Medium) for water in self.by_name.values())
        return {} if are_media else super().ranges()

    def drawn(self, uniform: Uniform) -> dict[str, Any]:
        """See `Noun.drawn`; "waters" are the names of one or two, or amounts of contents."""
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
        """See `Noun.require`."""
        further = {"waters"} if self.field is None else {"waters", "field_seed"}
        require_names(draw, {*self._ends, *self._nouns, *further}, name)
        super().require({key: value for key, value in draw.items() if key not in further}, name)
        if self.field is not None:
            require_seed(f"params: {name}.field_seed", draw["field_seed"])
        waters, count = draw["waters"], 2 if self.mixes else 1
        if not isinstance(waters, (list, tuple)) or len(waters) != count:
            raise ValueError(f"params: {name}.waters must be {count}, got {waters!r:.80}")
        for water in waters:
            self._require_water(water)

    def random(self) -> list[str]:
        """See `Noun.random`; the field is an input of `uwaug.Underwater`."""
        has_contents = any(isinstance(water, Constituents) for water in self.by_name.values())
        return ["waters"] * (len(self.by_name) > 1 or has_contents) + super().random()

    def of_each_picture(self) -> list[str]:
        """Names of the options that follow from the distances of a picture."""
        return ["water.contrast"] if self.contrast is not None and not self.has_media else []

    def of(self, draw: Drawn, measured: Measured, *, lamps: bool) -> PictureWater:
        """The water of a picture, for lamps if there are any, and the factor of its distances."""
        first = draw["waters"][0]
        fixed = self.by_name.get(first) if isinstance(first, str) else None
        if isinstance(fixed, Medium):
            return PictureWater(self._with_snow(fixed, draw, measured), 1.0, None, None)
        water, *second = map(self._spectra, draw["waters"])
        if second:
            water = water.mix(second[0], draw["mixing"])
        scale, reached = 1.0, None
        if "contrast" in draw:
            are_names = {*map(type, draw["waters"])} == {str}
            stays = are_names and (self.waters is not None or not measured.lamps)
            knob = self.contrast_by or ("distance" if stays else "contents")
            reach = _by_distance if knob == "distance" else _by_contents
            water, reached = reach(water, draw["contrast"], measured)
            scale = reached.scale
            if reached.odd:
                odd_scene.warn(reached.odd)
        depth, daylight = draw["vertical_depth"], 1.0
        if measured.metered and not measured.lamps:
            daylight = water.daylight(depth)
            if daylight < DIMMEST:
                deepest = min(depth, water.depth_of_daylight(DIMMEST))
                if not isinstance(self.vertical_depth, tuple):
                    got = f"{depth:g} m below the surface {water.name} leaves {daylight:.1g}"
                    taken = f"the scene is taken at {deepest:.3g} m; metered=False keeps the dark"
                    odd_scene.warn(f"{got} of light: {taken}")
                depth, daylight = deepest, DIMMEST
        law = self.point_spread or _CALIBRATED
        surfaces = "color_matrix" in draw, draw.get("color_matrix", 1.0)
        tolerance = _CURVES * daylight  # errors, too, are brought up by an exposure
        options = (depth, draw["g"], self._mu(draw), law, *surfaces, tolerance)
        medium = self._medium(water, options, lamps)
        medium = self._with_snow(medium, draw, measured.scaled(scale))
        return PictureWater(medium, scale, depth, reached)

    def fields(
        self, draws: Sequence[Draw], measured: Sequence[Measured], like: Tensor, view: View
    ) -> Tensor:
        """The medium field (Bx1xHxW) of each picture, of the size of `like`; 1 in even water."""
        if self.field is None:
            return like.new_ones(())
        scales = [view.focal(m.width) / m.median for m in measured]  # px a metre
        moved = [(k * m.moved[0], k * m.moved[1]) for k, m in zip(scales, measured, strict=True)]
        seeds = [draw.water["field_seed"] for draw in draws]
        return random_fields(seeds, (like.shape[-2], like.shape[-1]), *self.field, like, moved)

    def _medium(self, water: Water, options: tuple[Any, ...], lamps: bool) -> Medium:
        """The medium of a water; the last one again if nothing differs, as if nothing is random."""
        before: tuple[Water, Any, Medium] | None = vars(self).get("_before")
        if before and before[0] is water and before[1] == (options, lamps):
            return before[2]
        medium = Medium.of_spectra(water, self.response, *options, lamps=lamps)
        vars(self)["_before"] = water, (options, lamps), medium
        return medium

    def _with_snow(self, medium: Medium, draw: Drawn, measured: Measured) -> Medium:
        if self.snow is None:
            return medium
        snow = self.snow.of(draw["snow"])
        x, y, z = (own + way for own, way in zip(snow.drift, measured.moved, strict=True))
        return medium.with_snow(replace(snow, drift=(x, y, z)))

    def _mu(self, draw: Drawn) -> float:
        """μ; of a range no more than g, as no veil is brighter than a white plate."""
        g: float = draw["g"]
        if self.mu is None:
            return min(1.5 * g, 1.0)
        mu: float = draw["mu"]
        return min(mu, g) if isinstance(self.mu, (tuple, list)) else mu

    def _spectra(self, water: str | Mapping[str, float]) -> Water:
        if not isinstance(water, str):
            return Water.of_amounts(water)
        spectra = self.by_name[water]
        assert isinstance(spectra, Water)
        return spectra

    def _require_water(self, water: Any) -> None:
        """Refuse a water that cannot have been drawn."""
        if isinstance(water, str):
            is_possible = isinstance(self.by_name.get(water), Water | Medium)
        else:
            contents = [w for w in self.by_name.values() if isinstance(w, Constituents)]
            is_possible = isinstance(water, Mapping) and any(w.holds(water) for w in contents)
        if not is_possible:
            has = ", ".join(self.by_name)
            raise ValueError(f"params asks for {water!r:.80}, but this transform has {has}")


def _by_contents(water: Water, asked: float, measured: Measured) -> tuple[Water, Reached]:
    """Bring a water to the contents that leave a contrast at the median distance."""
    scale = 1.0
    if not measured.lamps and math.isfinite(measured.median):
        scale = min(max(measured.median, MEDIANS[0]), MEDIANS[1]) / measured.median
    metres = measured.median * scale
    contents = water.contents_for(asked, metres)
    if math.isinf(contents):
        cure = "draw from waters that have something in them, or give contrast=None"
        raise ValueError(f"contrast: {water.name!r} is nothing but pure water to the eye: {cure}")
    scaled = water.with_contents(contents)
    contrast = asked if contents else scaled.contrast(metres)
    return scaled, Reached(water.name, metres, scale, contents, contrast, asked, "contents")


def _by_distance(water: Water, asked: float, measured: Measured) -> tuple[Water, Reached]:
    """Leave a water as it is, and bring the median distance to where it leaves a contrast."""
    metres = measured.median
    if not measured.lamps and math.isfinite(metres):
        metres = min(max(water.metres_for(asked), SCALED_MEDIANS[0]), SCALED_MEDIANS[1])
    contrast = water.contrast(metres) if math.isfinite(metres) else asked
    scale = metres / measured.median if math.isfinite(metres) else 1.0
    return water, Reached(water.name, metres, scale, 1.0, contrast, asked, "distance")


def _named(waters: Any) -> list[tuple[str, Water | Constituents | Medium]]:
    """Names and waters, or ranges from which each picture draws one."""
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
