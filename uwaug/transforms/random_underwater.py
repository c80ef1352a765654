"""`RandomUnderwater`: new water for every picture, in a DataLoader worker or on a whole batch."""

import math
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, asdict, dataclass
from dataclasses import field as option
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug import fast
from uwaug._support import checks, codec
from uwaug._support.ranges import Range, as_range
from uwaug.distance.doubts import doubts
from uwaug.distance.sources import Metres, Plane, Source
from uwaug.formation.colour import decoded, require_values
from uwaug.formation.contrast import FAINT, contrast_left
from uwaug.formation.demand import blur_demand
from uwaug.formation.development import NEUTRAL, Development, Means, metering_points
from uwaug.formation.field import random_fields
from uwaug.formation.image import form
from uwaug.light import Light
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.constituents import UNITS, Constituents
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import FOCAL_LENGTH, PointSpread
from uwaug.optics.reduction import default_bands
from uwaug.optics.water import Water, load_water
from uwaug.presets.preset import load_preset
from uwaug.transforms.params import RandomDevelopment, Record, checked, samples_of
from uwaug.transforms.samples import (
    Parts,
    SampleTransform,
    maps_for,
    naming,
    pictures_of,
    take_apart,
    typed,
    uncompiled,
)

AnyWater = str | os.PathLike[str] | Water | Constituents | Medium

CONTENTS = Constituents(chlorophyll=(0.5, 20.0), cdom=(0.3, 3.0), minerals=(0.05, 5.0))
"""Coasts, lakes and harbours, green to yellow."""

WATERS = ("IB", "II", "III", "1C", "3C", "5C", "7C", "9C", *[CONTENTS] * 8)
"""Half of the waters are Jerlov types, half are of other contents. The clear oceanic types would
need 11 to 66 times what is in them to reach a contrast, and turn dark green. (Contents alone, or
wider ranges of them: recall and coverage of photographs each .02 to .05 less.)
"""

SEVERITIES = {1: 0.65, 2: 0.5, 3: 0.35, 4: 0.2, 5: 0.08}
"""The contrast of each grade of severity."""

DIMMEST = 1 / 32
"""Share of the surface's light that a scene has at least, where the exposure is automatic: what the
largest gain makes up for, and an octave for what is lost on the way to the camera. Waters that are
turbid enough for a scene at arm's length are black at 10 m.
"""

_TOLERANCE = 0.002
"""Of the curves of a medium, in the light that a metered exposure makes of it."""

SIZES = (1.0, 8.0)
"""m: median distances between which water can be brought to a contrast and have a colour of its
own. Of photographs .34 lie inside the cloud of default draws at 35 m, nine in ten of them pure
water, and .67 at .1 m, many orange; .77 once the scene is scaled, as at 1 to 8 m. (Contrasts that
.1 to 10 times the contents leave: .78 and .68, but .17 and .33 have a draw near, of .48 and .44;
another water until one suits: .34 and .67; a scale of its own for each draw: .73 and .77, but
.28 near at .1 m.)
"""

_OFTEN, MUCH, _MISSED = 4.0, 50.0, 2.0
"""What is worth a word: a scene scaled by more; contents more times those of the water, where the
clearest of `WATERS` need 42 for the severest grade at 1 m; a contrast so many times less than what
was asked for.
"""

LOOKED_AT = 2048
"""Pixels of which the median distance is taken: it is right within 2 %."""

_medium_of = lru_cache(maxsize=2)(Medium.from_water)
"""Kept for transforms of one fixed water."""

_GREY = 0.25
"""Linear light of a scene that nobody has looked at."""

_OUTDOORS = 500.0
"""m: maps whose median is beyond are looked at for millimetres."""

_looks_left = [16]
"""Pictures of a process at which it is looked for whether anything is left to see; what is wrong
with all shows in the first.
"""

_says_odd = [True]
"""Until a process has warned of what it took to reach a contrast."""


class Reached(NamedTuple):
    """What it took to bring a water to the contrast asked for."""

    scale: float  # times every distance
    contents: float  # times what is in the water besides pure water
    contrast: float  # left at the median distance
    asked: float

    @property
    def odd(self) -> bool:
        """Whether distances are hardly metres, or the water is hardly the one that was named."""
        return (
            not 1 / _OFTEN <= self.scale <= _OFTEN
            or self.contents > MUCH
            or self.contrast < self.asked / _MISSED
        )

    def __str__(self) -> str:
        times = f"{self.scale:.3g} times its distances and {self.contents:.3g} times the contents"
        return f"{times} of the water leave {self.contrast:.2g} of contrast, {self.asked:.2g} asked"


_maps_left = [8]
"""The first maps of a process, which are questioned: one alone, and all of them as a run."""

_questioned: list[tuple[Tensor, Tensor]] = []
"""These maps and pictures; emptied when all are judged."""


class Scene(NamedTuple):
    """A picture, and its water where it is degraded."""

    picture: Tensor  # 3xHxW
    sample: Record  # that it has drawn
    # effective distances (1x1xHxW, m), the medium, and distances where a field multiplies them
    water: tuple[Tensor, Medium, Tensor | None] | None
    reached: Reached | None  # where a contrast was asked for


@codec.plain
@dataclass(eq=False, repr=False)
class RandomUnderwater(SampleTransform):
    """Degrade pictures in random waters.

    A range is a number or (low, high), drawn uniformly; contrast is drawn uniformly in its
    logarithm. The defaults give pictures as an underwater camera takes them: constants calibrated
    to light transport (see `PointSpread.calibrated`), waters as turbid as the scene bears, surfaces
    with spectra, an exposure and a development. `severity` has five grades, `from_preset` a
    preset's figures.

    Args:
        waters: None for `WATERS`: half of the pictures in Jerlov types, half in waters of other
            contents. Else one or several of what `uwaug.load_water` takes (Jerlov types, contents,
            CSV files, `Water` objects); `Constituents` (or their text, such as
            "chlorophyll=1:20,cdom=.1:1"), whose contents are drawn anew for each picture,
            uniformly in their logarithm; and a `Medium`, such as that of a fit, which stays as it
            is: contrast, depth, g, mu, blur and camera do not apply to it. Picked with equal
            weight; one that is given twice counts twice.
        contrast: share of an object's contrast of luminance that is left at the scene's median
            distance, ignoring scattered light (see `Water.contrast`); the contents of the water are
            scaled to it, as far as pure water allows. Where the median is below 1 m or above 8 m,
            the distances are scaled to that first, but with lamps, whose places are metres. None
            leaves distances, and waters as they are in nature.
        mixing: share of a second water, picked like the first; 0 for none, (0, 1) for a continuous
            slider between types. Contents of both are drawn at the same shares of their ranges.
        vertical_depth: m below the surface; with an automatic exposure no deeper than where 1/32 of
            the light is left, which it can make up for.
        g: share of the scattered light that leaves the line of sight, 0…1.
        mu: share of the scattered light sent towards the camera, 0…1; None for 1.5·g.
        point_spread: width law of the forward scatter; None for `PointSpread.calibrated` of a view
            60° wide, whose focal length is .866·width. Give one where pictures are crops of a view.
        field: least and largest value of the medium field, which is drawn anew for each picture and
            multiplies its distances; None for even water.
        distance: what maps hold, and what pixels without a distance get: `uwaug.distance.Metres`,
            `Relative` or `Inverse`. Or where distances come from without maps: `MadeUp`, `Network`,
            or `Plane`, for which a number or a range may stand, m.
        camera: a name, the path of a CSV file or a `Camera`.
        development: what the camera does, and the colour space, see `RandomDevelopment`.
        light: a `Light` with lamps; None for daylight.
        p: probability that a picture is degraded at all.
        keys: of image and map in a dict.

    Inputs:
        (image, distance, …), a tuple or list of them, (image, target) with the map in a dict in
        second place, or a dict. One picture (3xHxW, distance 1xHxW) or a batch, whose pictures may
        share one map; uint8 (0…255) or floating point (0…1); plain tensors or torchvision's
        tv_tensors (a distance map is best a `Mask`). The same structure comes back with a new image
        of the same type; every other leaf is returned as it is, and no input is changed. Gradients
        pass to image and distance; what is drawn is constant.

    Randomness comes from torch's global generator, which a DataLoader seeds for each worker and
    epoch; `at` draws from a key instead. Place the transform before normalisation, and after
    resizing and cropping: the default width law takes the picture for the whole view.

    Raises:
        TypeError, ValueError: if an option or an input does not suit, naming what came and what was
            expected.

    Warns:
        UserWarning: once in a process, if next to nothing is left to see in one of its first
            pictures; and once, if distances are scaled by more than 4 or less than 1/4 for a
            contrast, contents are more than 50 times those of the water, or less than half of the
            contrast is reached.

    Examples:
        >>> import torch
        >>> aug = RandomUnderwater(["1C", "7C"], contrast=(0.2, 0.5))
        >>> aug
        RandomUnderwater(waters=['1C', '7C'], contrast=(0.2, 0.5))
        >>> image, distance = torch.rand(3, 32, 48), torch.full((1, 32, 48), 3.0)
        >>> degraded, _ = aug(image, distance)
        >>> record = aug.make_params(image)
        >>> again, once_more = (aug.transform(image, distance, record) for _ in range(2))
        >>> torch.equal(again, once_more)
        True
    """

    waters: AnyWater | Iterable[AnyWater] | None = None
    _: KW_ONLY
    contrast: Range | None = (0.1, 0.9)
    mixing: Range = 0.0
    vertical_depth: Range = (0.0, 10.0)
    g: Range = 0.05
    mu: Range | None = None
    point_spread: PointSpread | None = None
    field: tuple[float, float] | None = (0.7, 1.3)
    distance: Source | Range = option(default_factory=Metres)
    camera: str | os.PathLike[str] | Camera = "Nikon 5100 (NPL)"
    development: RandomDevelopment = option(default_factory=RandomDevelopment)
    light: Light | None = None
    p: float = 1.0
    keys: tuple[str, str] = ("image", "distance")

    def __post_init__(self) -> None:
        if isinstance(self.distance, (int, float, tuple, list)):
            ends = self.distance if isinstance(self.distance, (tuple, list)) else (self.distance,)
            self.distance = Plane(*ends)
        cure = "Metres, Relative, Inverse, MadeUp, Network(…) or Plane of uwaug.distance"
        checks.instance("distance", self.distance, Source, f"; give {cure}")
        checks.instance("development", self.development, RandomDevelopment)
        checks.within("p", self.p, 0.0, 1.0)
        if self.point_spread is not None:
            checks.instance("point_spread", self.point_spread, PointSpread)
        if self.light is not None:
            checks.instance("light", self.light, Light)
        self._source = self.distance
        self._response = load_camera(self.camera)
        loaded = _loaded(WATERS if self.waters is None else self.waters)
        self._picked = [name for name, _ in loaded]
        self._waters = dict(loaded)
        ranges = {
            "contrast": self.contrast,
            "mixing": self.mixing,
            "vertical_depth": self.vertical_depth,
            "g": self.g,
            "mu": self.mu,
            **self.development.ranges(),
            **self.distance.ranges(),
        }
        self._ranges = checked(ranges)
        self._field = None if self.field is None else as_range("field", self.field, 0.0)
        self._mixes = self._ranges["mixing"][1] > 0
        if self._mixes and any(isinstance(water, Medium) for _, water in loaded):
            raise ValueError("mixing needs spectra: it must be 0 where a water is a Medium")

    @classmethod
    def severity(cls, level: int, **options: Any) -> "RandomUnderwater":
        """One of five grades, for robustness studies: the default at a fixed contrast.

        Args:
            level: 1 (mild) … 5 (severe); .65, .5, .35, .2 and .08 of the contrast are left at the
                scene's median distance.
            options: any other argument of the class.
        """
        if level not in SEVERITIES:
            raise ValueError(f"level must be a whole number from 1 to 5, got {level!r}")
        return cls(**{"contrast": SEVERITIES[level], **options})

    @classmethod
    def from_preset(
        cls,
        name_or_path: str | os.PathLike[str],
        *,
        water: str | os.PathLike[str] | Water | None = None,
        **options: Any,
    ) -> "RandomUnderwater":
        """A preset's water, camera, constants, width law, field and development; or the medium of
        a fit, as it is.

        Args:
            name_or_path, water: as for `uwaug.load_preset`; or the path of a fit's JSON file.
            options: any argument of the class, in place of the preset's.
        """
        figures: dict[str, Any]
        if str(name_or_path).endswith(".json"):
            if water is not None:
                raise ValueError(f"{name_or_path} holds coefficients, which no water replaces")
            # fits load scipy.optimize, which a DataLoader worker can do without
            from uwaug.fitting.result import load_fit

            neutral = {"color_matrix": None, **asdict(NEUTRAL)}
            figures = {"waters": load_fit(name_or_path).medium, "field": None}
        else:
            figures = load_preset(name_or_path, water=water).options()
            neutral = figures.pop("development")
        return cls(**{**figures, "development": RandomDevelopment(**neutral), **options})

    def to_dict(self) -> dict[str, Any]:
        """The options that differ from the defaults, in numbers, strings, lists and dicts, as JSON,
        YAML and TOML hold them.

        Raises:
            TypeError: if one cannot be written so, such as a function.
        """
        plain: dict[str, Any] = codec.to_plain(self)
        return plain

    @staticmethod
    def from_dict(options: Mapping[str, Any]) -> "RandomUnderwater":
        """A transform from what `to_dict` gives, or from options as a person writes them in TOML: a
        range as a list of two numbers, `development`, `light` and `point_spread` as tables of their
        arguments, `distance` as one with a `kind`.

        Raises:
            TypeError, ValueError: as the class, and if a table does not suit.
        """
        read = dict(options)
        tables = {"development": RandomDevelopment, "light": Light, "point_spread": PointSpread}
        for name, kind in tables.items():
            if options.get(name):
                read[name] = codec.from_plain(options[name], kind)
        transform: RandomUnderwater = codec.from_plain(read, RandomUnderwater)
        return transform

    def make_params(self, image: Tensor, generator: torch.Generator | None = None) -> Record:
        """Draw everything that is random, for a picture or a batch of this shape.

        Args:
            image (3xHxW or Bx3xHxW tensor): only its shape is read.
            generator: source of randomness; torch's global generator if None.

        Returns:
            A plain record that can be pickled and written as JSON, {"samples": […]} with a dict for
            each picture: "applied", whether it is degraded at all; "waters", the name of one or two
            (that of drawn contents says all of them); "numbers" by name; "field_seed" of the medium
            field, or None.
        """
        count = 1 if image.ndim == 3 else len(image)
        # 32 bits: all that a generator of torch takes from a seed
        seeds = torch.randint(2**32, (count,), generator=generator, device="cpu").tolist()
        shape = count, 3 + len(UNITS) + len(self._ranges)
        uniform = torch.rand(shape, generator=generator, dtype=torch.float64, device="cpu")
        samples = []
        for seed, (applied, first, second, *rest) in zip(seeds, uniform.tolist(), strict=True):
            shares = dict(zip(UNITS, rest, strict=False))
            picked = (first, second) if self._mixes else (first,)
            numbers = {}
            for (name, (low, high)), u in zip(
                self._ranges.items(), rest[len(UNITS) :], strict=True
            ):
                log = name in ("contrast", "full_well")
                numbers[name] = low * (high / low) ** u if log else low + (high - low) * u
            sample = {
                "applied": applied < self.p,
                "waters": [self._drawn_water(which, shares) for which in picked],
                "numbers": numbers,
                "field_seed": None if self._field is None else seed,
            }
            samples.append(sample)
        return {"samples": samples}

    def _drawn_water(self, which: float, shares: Mapping[str, float]) -> str:
        """The name of a water; of contents that are drawn, at these shares of their ranges."""
        name = self._picked[int(which * len(self._picked))]
        water = self._waters[name]
        return water.drawn(shares).name if isinstance(water, Constituents) else name

    @uncompiled
    def transform(self, image: Tensor, distance: Tensor | None, params: Record) -> Tensor:
        """Degrade a picture or a batch as a record says: deterministic.

        Args:
            image (3xHxW or Bx3xHxW tensor): uint8 or floating point.
            distance (1xHxW or Bx1xHxW tensor): of the kind that `distance` says; None where it
                reads no maps.
            params: from `make_params`, of this or an equally configured transform; that of a single
                picture serves a whole batch.

        Returns:
            The degraded image, like `image`; `image` itself if the record leaves all of it alone.

        Raises:
            TypeError, ValueError: if an input does not suit, naming what came and what was
                expected.
        """
        pictures = pictures_of(image)
        return self._formed(image, pictures, distance, self._read(params, len(pictures)))

    @uncompiled
    def for_clip(self, params: Record, image: Tensor, distance: Tensor | None) -> Record:
        """The record of one picture for all frames of a clip: what a draw takes from the picture
        (the median distance to which the water is scaled, exposure, white balance) is that of this
        one for all of them. They may then come in any order, on any worker.

        Args:
            params: from `make_params`, of one picture.
            image, distance: a frame of the clip, as for `transform`.

        Returns:
            A record whose sample has a "clip" of numbers. Its "moved", m, 0 here, says how far the
            field has drifted to the right at a frame: set it to m/s times seconds. A "noise_seed"
            beside it makes the sensor's noise of a frame its own.
        """
        pictures = pictures_of(image)
        if len(pictures) != 1:
            raise ValueError(f"image must be one frame of the clip, got {len(pictures)}")
        (sample,) = self._read(params, 1)
        (scene,) = self.scenes(pictures, distance, [sample])
        if scene.water is None:
            return {"samples": [sample]}
        z, medium, metres = scene.water
        medium = medium.to(z)
        J = decoded(pictures, self.development.color_space).to(z.dtype)
        T = None if self.light is None else self.light.curves(medium, z, metres)
        look = self.development.of(sample).settled(J, z, medium, T)
        scale = scene.reached.scale if scene.reached else 1.0
        clip = {
            "metres": _median((z if metres is None else metres)[0]) / scale,
            "exposure": look.exposure,
            "white_balance": look.white_balance,
            "moved": 0.0,
        }
        return {"samples": [{**sample, "clip": clip}]}

    @uncompiled
    def contrast_left(self, image: Tensor, distance: Tensor | None, params: Record) -> Tensor:
        """The share of contrast that is left at each pixel, see `uwaug.contrast_left`: what of an
        object can still be seen.

        Args:
            image, distance, params: as for `transform`.

        Returns:
            1xHxW of a picture, Bx1xHxW of a batch; 1 where a picture is left alone.
        """
        pictures = pictures_of(image)
        samples = self._read(params, len(pictures))
        return self.left(image, self.scenes(pictures, distance, samples))

    def take_apart(self, inputs: tuple[Any, ...]) -> Parts:
        """Image, map and the way back, of what the transform was called with."""
        return take_apart(inputs, self.keys, self._source.reads_maps)

    def _sampled(self, inputs: tuple[Any, ...], generator: torch.Generator | None) -> Any:
        image, distance, restore = self.take_apart(inputs)
        pictures = pictures_of(image)
        samples = self.make_params(image, generator)["samples"]
        return restore(self._formed(image, pictures, distance, samples))

    def _formed(
        self, image: Tensor, pictures: Tensor, distance: Any, samples: list[Record]
    ) -> Tensor:
        """The image of samples, which are known to be good: on a device all pictures at once."""
        # media of fits may have other width laws, which no batch holds
        fitted = any(isinstance(water, Medium) for water in self._waters.values())
        alike = len(self._waters) == 1 or not fitted
        alike = alike and not any("clip" in sample for sample in samples)
        if alike and self.light is None and not checks.on_host(pictures):
            return self._formed_together(image, pictures, distance, samples)
        return self.degraded(image, self.scenes(pictures, distance, samples))

    def _formed_together(
        self, image: Tensor, pictures: Tensor, distance: Any, samples: list[Record]
    ) -> Tensor:
        """`_formed` with one look at the distances, all that a device has to wait for. What of the
        blur may be left out follows from a grey scene, as its light is not known here.
        """
        chosen = [i for i, sample in enumerate(samples) if sample["applied"]]
        if not chosen:
            return image
        drawn = [samples[i] for i in chosen]
        every = len(chosen) == len(pictures)
        scene = pictures if every else pictures[torch.tensor(chosen).to(pictures.device)]
        size = (pictures.shape[-2], pictures.shape[-1])
        fast.load()
        with torch.autocast(image.device.type, enabled=False):
            z = self._metres_together(pictures, distance, chosen, drawn)
            looks = _looked_at(scene, z)
            self._require(looks, scene, z)
            pairs = list(zip(looks, drawn, strict=True))
            scales = [self._scale(look.median, sample) for look, sample in pairs]
            looks = [look.scaled(scale) for look, scale in zip(looks, scales, strict=True)]
            several = zip(looks, scales, drawn, strict=True)
            media = [
                self._medium(look.median, scale, size[1], sample)[0]
                for look, scale, sample in several
            ]
            _warn_if_blank(torch.full((1, 1, 1, 1), looks[0].median), media[0], None)
            z = z.to(torch.promote_types(scene.dtype, torch.float32))
            z = (z * z.new_tensor(scales)[:, None, None, None]).clamp(max=FARTHEST)
            low, high = (1.0, 1.0) if self._field is None else self._field
            if self._field is not None:
                z = z * random_fields([s["field_seed"] for s in drawn], size, low, high, z)
            developments = [self.development.of(sample) for sample in drawn]
            water = Medium.stack(media)
            seen = _grey_seen(water, developments, looks, high)
            ends = [(low * look.nearest, high * look.farthest) for look in looks]
            demands = [blur_demand(seen[i], ends[i]) for i in range(len(looks))]
            result = form(
                scene,
                z,
                water,
                Development.stack(developments, z),
                color_space=self.development.color_space,
                plans=[demand.plan(size, shared=True) for demand in demands],
            )
        if scene is not pictures:
            result = pictures.index_copy(0, torch.tensor(chosen).to(scene.device), result)
        return typed(result[0] if image.ndim == 3 else result, type(image))

    def _metres_together(
        self, pictures: Tensor, distance: Any, chosen: list[int], drawn: list[Record]
    ) -> Tensor:
        """The distances (Bx1xHxW) of the chosen pictures, m. Of a source other than `Metres()` the
        host may have to wait for each.
        """
        maps: list[Any] = [None] * len(drawn)
        if self._source.reads_maps:
            given = maps_for(pictures, distance)
            maps = [given[i] for i in chosen]
            if self._source == Metres():
                return torch.stack(maps)
        numbers = [sample["numbers"] for sample in drawn]
        chosen_pictures = [pictures[i] for i in chosen]
        return torch.stack(list(map(self._source.metres, maps, chosen_pictures, numbers)))

    def _require(self, looks: "list[Look]", scene: Tensor, z: Tensor) -> None:
        """Refuse pictures and maps by their numbers; only if one is wrong, by a second look."""
        space = self.development.color_space
        for i, (darkest, brightest, nearest, _, median) in enumerate(looks):
            with naming(i, len(looks)):
                if not (darkest >= 0 and brightest <= 1):
                    require_values(scene[i], space)
                if self._source == Metres() and not (nearest > 0 and median < _OUTDOORS):
                    self._source.metres(z[i], scene[i], {})

    def scenes(self, pictures: Tensor, distance: Any, samples: list[Record]) -> list[Scene]:
        """Pictures (Bx3xHxW) and maps in the waters of samples, which are known to be good."""
        fast.load()  # else the first picture of a process would be off by the last bits
        maps: Sequence[Tensor | None] = [None] * len(pictures)
        if self._source.reads_maps:
            maps = maps_for(pictures, distance)
        scenes = []
        for i, (picture, z, sample) in enumerate(zip(pictures, maps, samples, strict=True)):
            water = reached = None
            if sample["applied"]:
                with naming(i, len(pictures)), torch.autocast(pictures.device.type, enabled=False):
                    require_values(picture, self.development.color_space)
                    water, reached = self._water(picture, z, sample)
            scenes.append(Scene(picture, sample, water, reached))
        return scenes

    def degraded(self, image: Tensor, scenes: list[Scene]) -> Tensor:
        """The degraded image of these scenes, see `transform`."""
        if not any(scene.water for scene in scenes):
            return image
        space, results = self.development.color_space, []
        with torch.autocast(image.device.type, enabled=False):
            for picture, sample, water, _ in scenes:
                result = picture[None]
                if water is not None:
                    z, medium, metres = water
                    lit: Any = {"light": self.light, "metres": metres}
                    _warn_if_blank(z, medium, **lit)
                    look = self.development.of(sample)
                    result = form(result, z, medium, look, color_space=space, **lit)
                results.append(result)
        result = results[0][0] if image.ndim == 3 else torch.cat(results)
        return typed(result, type(image))

    def left(self, image: Tensor, scenes: list[Scene], step: int = 1) -> Tensor:
        """The share of contrast in these scenes, see `contrast_left`; in every so many rows and
        columns.
        """
        shares = []
        for picture, _, water, _ in scenes:
            share = picture.new_ones(1, 1, *picture[0, ::step, ::step].shape, dtype=torch.float32)
            if water is not None:
                z, medium, metres = water
                z = z[..., ::step, ::step]
                metres = None if metres is None else metres[..., ::step, ::step]
                share = contrast_left(z, medium, light=self.light, metres=metres)
            shares.append(share)
        return shares[0][0] if image.ndim == 3 else torch.cat(shares)

    def _water(
        self, picture: Tensor, distance: Tensor | None, sample: Record
    ) -> tuple[tuple[Tensor, Medium, Tensor | None], Reached | None]:
        """What a picture (3xHxW) is seen through, see `Scene`."""
        if _maps_left[0] and isinstance(self._source, Metres) and checks.on_host(picture):
            assert distance is not None
            _warn_of_doubts(distance, picture)
        z = self._source.metres(distance, picture, sample["numbers"])
        clip = sample.get("clip", {})
        metres = clip["metres"] if clip else _median(z)
        scale = self._scale(metres, sample)
        medium, reached = self._medium(metres * scale, scale, z.shape[-1], sample)
        z = z.to(torch.promote_types(picture.dtype, torch.float32))
        z = (z if scale == 1 else z * scale).clamp(max=FARTHEST)[None]
        if self._field is None:
            return (z, medium, None), reached
        size = (z.shape[-2], z.shape[-1])
        # of the view that the width law takes the picture for
        moved = FOCAL_LENGTH * size[1] * clip.get("moved", 0.0) / metres
        field = random_fields([sample["field_seed"]], size, *self._field, z, moved)
        return (z * field, medium, z), reached

    def _scale(self, median: float, sample: Record) -> float:
        """What the distances of a picture of this median, m, are multiplied by."""
        fixed = isinstance(self._waters.get(sample["waters"][0]), Medium)
        lamps = self.light is not None and self.light.lamps
        if fixed or lamps or "contrast" not in sample["numbers"] or math.isinf(median):
            return 1.0
        nearest, farthest = SIZES
        return min(max(median, nearest), farthest) / median

    def _medium(
        self, metres: float, scale: float, width: int, sample: Record
    ) -> tuple[Medium, Reached | None]:
        """The medium of a picture of this median distance, m, and width, px; and what came of the
        contrast asked for, where its distances were multiplied by `scale`.
        """
        names, numbers = sample["waters"], sample["numbers"]
        fixed, reached = self._waters.get(names[0]), None
        if isinstance(fixed, Medium):
            return fixed, None
        water, *others = (self._spectra(name) for name in names)
        if others:
            water = water.mix(others[0], numbers["mixing"])
        if "contrast" in numbers:
            asked = numbers["contrast"]
            contents = water.contents_for(asked, metres)
            if math.isinf(contents):
                cure = "draw from waters that have something in them, or give contrast=None"
                raise ValueError(
                    f"contrast: {water.name!r} is nothing but pure water to the eye: {cure}"
                )
            water = water.with_contents(contents)
            most = asked if contents else water.contrast(metres)
            reached = Reached(scale, contents, most, asked)
            if reached.odd:
                _warn_of(reached, metres / scale)
        depth = numbers["vertical_depth"]
        lamps = self.light is not None and self.light.lamps  # they shine at any depth
        left = 1.0
        if self.development.metered and not lamps:
            left = water.daylight(depth)
            if left < DIMMEST:
                depth, left = min(depth, water.depth_of_daylight(DIMMEST)), DIMMEST
        law = self.point_spread or PointSpread.calibrated(FOCAL_LENGTH * width)
        grey = "color_matrix" not in numbers
        medium = _medium_of(
            water,
            self._response,
            vertical_depth=depth,
            g=numbers["g"],
            mu=numbers.get("mu"),
            point_spread=law,
            surfaces="grey" if grey else "spectral",
            color_matrix=numbers.get("color_matrix", 1.0),
            tolerance=_TOLERANCE * left,  # what an exposure brings up, errors included
        )
        return medium, reached

    def _spectra(self, name: str) -> Water:
        """A water by the name that a record gives it."""
        water = self._waters.get(name)
        return water if isinstance(water, Water) else load_water(name)

    def _read(self, record: Any, count: int) -> list[Record]:
        """The samples of a record, one for each of `count` pictures; refuses one of others."""
        samples = samples_of(record, count, set(self._ranges))
        for sample in samples:
            for name in sample["waters"]:
                self._require_water(name)
        return samples

    def _require_water(self, name: Any) -> None:
        """Refuse the name of a water that cannot have been drawn."""
        ranges = [water for water in self._waters.values() if isinstance(water, Constituents)]
        known = name in self._waters and not isinstance(self._waters[name], Constituents)
        if not known and isinstance(name, str) and "=" in name:
            contents = Constituents.parse(name)
            known = any(each.holds(contents) for each in ranges)
        if not known:
            has = ", ".join(self._waters)
            raise ValueError(f"params asks for {name!r}, but this transform has {has}")

    def __repr__(self) -> str:
        shown = [f"{f.name}={getattr(self, f.name)!r}" for f in codec.changed(self)]
        return f"{type(self).__name__}({', '.join(shown)})"


def _loaded(waters: Any) -> list[tuple[str, Water | Constituents | Medium]]:
    """Waters, or ranges that each picture draws one from, with their names."""
    kinds = (str, os.PathLike, Water, Constituents, Medium)
    if isinstance(waters, (set, frozenset)):
        raise TypeError("waters must have an order, as draws follow it; got a set")
    loaded: list[tuple[str, Water | Constituents | Medium]] = []
    alone = isinstance(waters, kinds) or not isinstance(waters, Iterable)
    for water in [waters] if alone else waters:
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
        if any(other != water for known, other in loaded if known == name):
            raise ValueError(f"waters: two are called {name!r}; name=… gives a name of its own")
    return loaded


class Look(NamedTuple):
    """What the host knows of a picture on a device: values, and distances, m."""

    darkest: float
    brightest: float
    nearest: float
    farthest: float  # of all but open water
    median: float

    def scaled(self, scale: float) -> "Look":
        """The same, of distances that are multiplied."""
        return Look(*self[:2], *(scale * metres for metres in self[2:]))


def _looked_at(scene: Tensor, z: Tensor) -> list[Look]:
    """A look at pictures (Bx3xHxW) and distances (Bx1xHxW): the one transfer from their device."""
    values, metres = scene.detach().flatten(1), z.detach().flatten(1)
    some = metres[:, metering_points(z.shape[-2], z.shape[-1], z.device)[:LOOKED_AT]]
    some = some.sort(1).values  # open water and NaN come last
    middle = some.isfinite().sum(1, keepdim=True) // 2
    farthest = torch.where(metres.isfinite(), metres, 0.0).amax(1)
    columns = (
        values.amin(1),
        values.amax(1),
        metres.amin(1),
        farthest,
        some.gather(1, middle)[:, 0],
    )
    scale = 1.0 if scene.is_floating_point() else 255.0
    rows = torch.stack([column.to(torch.float32) for column in columns], 1).cpu().tolist()
    return [Look(dark / scale, bright / scale, *metres) for dark, bright, *metres in rows]


def _grey_seen(
    medium: Medium, developments: list[Development], looks: list[Look], densest: float
) -> Medium:
    """Media as a camera brightens them where the scene is grey and all at its median distance."""
    rows = [(min(look.median, FARTHEST), densest * look.farthest) for look in looks]
    z, far = torch.tensor(rows, dtype=torch.float64).T[..., None, None, None]
    grey = z.new_full((len(z), 3, 1, 1), _GREY)
    arriving = medium.image(z, grey, grey).flatten(1)
    veil = medium.curves(far).veil.flatten(1).amax(1, keepdim=True)
    means = Means(grey.flatten(1), arriving, arriving.clamp(min=0.0), veil)
    return medium.brightened(Development.stack(developments, z).gain_of(means, z))


def _median(z: Tensor) -> float:
    """The median distance, m, of some pixels, or of all if these show nothing but open water."""
    points = metering_points(z.shape[-2], z.shape[-1], z.device)[:LOOKED_AT]
    for some in (z.flatten()[points], z.flatten()):
        near = some.detach().cpu().numpy()
        near = near[np.isfinite(near)]
        if near.size:
            middle = near.size // 2
            return float(np.partition(near, middle)[middle])
    return math.inf


def _warn_of(reached: Reached, median: float) -> None:
    """Warn, once in a process, of an odd scene of this median distance, m."""
    if _says_odd[0]:
        _says_odd[0] = False
        cure = "are distances metres? contrast=None leaves them and the water as they are"
        warnings.warn(f"a scene of median distance {median:.3g} m: {reached}: {cure}", stacklevel=2)


def _warn_of_doubts(distance: Tensor, picture: Tensor) -> None:
    """Warn, once in a process, of what speaks against its first maps (1xHxW) being metres."""
    _maps_left[0] -= 1
    _questioned.append((distance.detach().clone(), picture.detach().clone()))
    asked = len(_questioned) == 1 or not _maps_left[0]
    if asked and (said := doubts(*zip(*_questioned, strict=True))):
        _maps_left[0] = 0
        warnings.warn("; ".join(said), stacklevel=2)
    if not _maps_left[0]:
        _questioned.clear()


def _warn_if_blank(
    z: Tensor, medium: Medium, light: Light | None, metres: Tensor | None = None
) -> None:
    """Warn, once in a process, if next to nothing is left to see of a picture at these effective
    distances (1x1xHxW).
    """
    if _looks_left[0] == 0:
        return
    _looks_left[0] -= 1
    shares = contrast_left(z.detach(), medium, light=light, metres=metres)[z < checks.OPEN]
    # by the median: the far end of a scene is hidden in many a good draw
    if shares.numel() and shares.median() < FAINT:
        _looks_left[0] = 0
        got = f"less than {100 * FAINT:g} % of the contrast is left on half of a picture or more"
        cure = "are distances metres? If so, take clearer water by contrast"
        warnings.warn(f"{got}, of median distance {_median(z):.3g} m: {cure}", stacklevel=2)
