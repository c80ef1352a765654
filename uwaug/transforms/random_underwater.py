"""`RandomUnderwater`: new water for every picture, in a DataLoader worker or on a whole batch."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, asdict, dataclass, fields
from dataclasses import field as option
from typing import Any

import torch
from torch import Tensor

from uwaug import fast
from uwaug._support import checks, codec
from uwaug._support.ranges import Range
from uwaug.distance.made_up import MadeUp
from uwaug.distance.sources import Metres, Plane, Source
from uwaug.formation.development import NEUTRAL
from uwaug.light import Light
from uwaug.optics.camera import Camera
from uwaug.optics.curves import FARTHEST
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.snow import MarineSnow
from uwaug.optics.water import Water
from uwaug.presets.preset import load_preset
from uwaug.transforms.distances import metres_of, require, second_look
from uwaug.transforms.draws import (
    Draw,
    Record,
    Uniform,
    checked,
    numbers_of,
    of_frame,
    read_draws,
    uniform_of,
)
from uwaug.transforms.measured import Measured, measured
from uwaug.transforms.random_development import RandomDevelopment
from uwaug.transforms.random_light import RandomLight
from uwaug.transforms.random_water import AnyWater, RandomWater
from uwaug.transforms.samples import (
    Parts,
    SampleTransform,
    is_film,
    maps_for,
    naming,
    pictures_of,
    take_apart,
    uncompiled,
)
from uwaug.transforms.scenes import Scenes

SEVERITIES = {1: 0.65, 2: 0.5, 3: 0.35, 4: 0.2, 5: 0.08}
"""The contrast of each grade of severity."""

PLAIN: dict[str, Any] = {
    "contrast": None,
    "vertical_depth": 0.0,
    "mu": None,
    "field": None,
    "light": None,
    "development": {"color_matrix": None, **asdict(NEUTRAL)},
}
"""Options that leave nothing random but waters and distances, and nothing to the camera."""


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
            the distances are scaled to that first, but under a `Light`, whose lamps stand in
            metres. None leaves distances, and waters as they are in nature.
        mixing: share of a second water, picked like the first; 0 for none, (0, 1) for a continuous
            slider between types. Contents of both are drawn at the same shares of their ranges.
        vertical_depth: m below the surface; with an automatic exposure no deeper than where 1/32 of
            the light is left, which it can make up for.
        g: share of the scattered light that leaves the line of sight, 0…1.
        mu: share of the scattered light sent towards the camera, 0…1. The veil of endless water has
            mu/g of the light of a white plate; a range is held at g. None for 1.5·g.
        point_spread: width law of the forward scatter; None for `PointSpread.calibrated` of a view
            60° wide, whose focal length is .866·width. Give one where pictures are crops of a view.
        field: least and largest value of the medium field, which is drawn anew for each picture and
            multiplies its distances; None for even water.
        distance: what maps hold, and what pixels without a distance get: `uwaug.distance.Metres`,
            `Relative` or `Inverse`. Or where distances come from without maps: `MadeUp`, `Network`,
            or `Plane`, for which a number or a range may stand, m.
        camera: a name, the path of a CSV file or a `Camera`.
        snow: particles that one sees, see `uwaug.MarineSnow`, whose density may be a range, drawn
            uniformly in its logarithm; None for clear water.
        development: what the camera does, and the colour space, see `RandomDevelopment`.
        light: what lights the scene, see `RandomLight`: by default lamps light a twelfth of the
            pictures; a `Light`, the same for all pictures, whose lamps stand where they are in
            metres; None for daylight.
        p: probability that a picture is degraded at all.
        keys: of image and map in a dict.

    Inputs:
        (image, distance, …), a tuple or list of them, (image, target) with the map in a dict in
        second place, or a dict. One picture (3xHxW, distance 1xHxW) or a batch, whose pictures may
        share one map; uint8 (0…255) or floating point (0…1); plain tensors or torchvision's
        tv_tensors (a distance map is best a `Mask`). A `Video` is a film: one draw for all frames,
        as by `for_clip`. The same structure comes back with a new image
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
    contrast: Range | None = RandomWater.contrast
    mixing: Range = RandomWater.mixing
    vertical_depth: Range = RandomWater.vertical_depth
    g: Range = RandomWater.g
    mu: Range | None = RandomWater.mu
    point_spread: PointSpread | None = RandomWater.point_spread
    field: tuple[float, float] | None = RandomWater.field
    distance: Source | Range = option(default_factory=Metres)
    camera: str | os.PathLike[str] | Camera = RandomWater.camera
    snow: MarineSnow | None = RandomWater.snow
    development: RandomDevelopment = option(default_factory=RandomDevelopment)
    light: RandomLight | Light | None = option(default_factory=RandomLight)
    p: float = 1.0
    keys: tuple[str, str] = ("image", "distance")

    def __post_init__(self) -> None:
        source = self.distance
        if isinstance(source, (int, float)):
            source = Plane(source)
        elif isinstance(source, (tuple, list)):
            source = Plane(*source)
        cure = "Metres, Relative, Inverse, MadeUp, Network(…) or Plane of uwaug.distance"
        checks.instance("distance", source, Source, f"; give {cure}")
        checks.instance("development", self.development, RandomDevelopment)
        checks.within("p", self.p, 0.0, 1.0)
        if not isinstance(self.light, Light | None):
            checks.instance("light", self.light, RandomLight, "; or a uwaug.Light")
        vars(self)["distance"] = self.source = source
        self.water = RandomWater(**{f.name: getattr(self, f.name) for f in _WATER_OPTIONS})
        drawn: dict[str, Range | None] = {}
        nouns = (self.source, self.water, self.development)
        for noun in (*nouns, self.light) if isinstance(self.light, RandomLight) else nouns:
            ranges = noun.ranges()
            if twice := sorted(drawn.keys() & ranges):
                kind = type(noun).__name__
                raise ValueError(f"{kind} draws {', '.join(twice)}, as another does: rename it")
            drawn |= ranges
        self._ranges = checked(drawn)

    @classmethod
    def severity(cls, level: int, **options: Any) -> "RandomUnderwater":
        """One of five grades, for robustness studies: the default at a fixed contrast. From one key
        a picture has the same light, camera and kind of water at each grade; `light=None` keeps to
        daylight.

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
        a fit, as it is. By daylight, which their numbers are of.

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

            fit = load_fit(name_or_path)
            neutral = {**PLAIN["development"], "color_space": fit.color_space}
            figures = {"waters": fit.medium, "field": None, "light": None}
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
        range as a list of two numbers, `development`, `light`, `point_spread` and `snow` as
        tables of their arguments, `distance` as one with a `kind`.

        Raises:
            TypeError, ValueError: as the class, and if a table does not suit.
        """
        read = dict(options)
        light = options.get("light")
        named = isinstance(light, Mapping) and ("lamps" in light or light.get("kind") == "Light")
        lit = Light if named else RandomLight
        water = {"point_spread": PointSpread, "snow": MarineSnow}
        tables = {"development": RandomDevelopment, "light": lit, **water}
        for name, kind in tables.items():
            if isinstance(options.get(name), Mapping):
                read[name] = codec.from_plain(options[name], kind)
        transform: RandomUnderwater = codec.from_plain(read, RandomUnderwater)
        return transform

    def make_params(self, image: Tensor, generator: torch.Generator | None = None) -> Record:
        """Draw everything that is random, for a picture or a batch of this shape.

        Args:
            image (3xHxW or Bx3xHxW tensor): only its shape is read; a `Video` draws once.
            generator: source of randomness; torch's global generator if None.

        Returns:
            A plain record that can be pickled and written as JSON, {"samples": […]} with a dict for
            each picture: "applied", whether it is degraded at all; "waters", the name of one or two
            (that of drawn contents says all of them); "numbers" by name; "field_seed" of the medium
            field, or None.
        """
        count = 1 if image.ndim == 3 or is_film(image) else len(image)
        seeds = torch.randint(2**63 - 1, (count,), generator=generator, device="cpu").tolist()
        return {"samples": [self._sample(uniform_of(seed)) for seed in seeds]}

    def _sample(self, uniform: Uniform) -> Record:
        """What a picture draws, of a record."""
        return {
            "applied": uniform("applied") < self.p,
            "waters": self.water.picked(uniform),
            "numbers": numbers_of(self._ranges, uniform),
            "field_seed": self.water.field_seed(uniform),
        }

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
        return self.scenes(image, distance, params).formed()

    @uncompiled
    def for_clip(self, params: Record, image: Tensor, distance: Tensor | None) -> Record:
        """The record of one picture for all frames of a film: what a draw takes from the picture
        (the median distance to which the water is scaled, exposure, white balance) is that of one
        frame for all of them. They may then come in any order, on any worker.

        Args:
            params: from `make_params`, of one picture.
            image, distance: a frame of the film, as for `transform`; or all frames, as a batch, of
                which the middle one is taken.

        Returns:
            A record with a sample for each of these frames, which has what was "measured" once for
            all. Its "moved", m, 0 here, says how far field and snow have drifted to the right at a
            frame: set it to m/s times seconds. By its "noise_seed" the sensor's noise is each
            frame's own.
        """
        frames = pictures_of(image)
        if len(frames) > 1 and isinstance(self.source, MadeUp):
            cure = "give maps, or metres, such as distance=(1, 5)"
            raise ValueError(f"distance: made up from each frame, a film would flicker: {cure}")
        maps = maps_for(frames, distance) if self.source.reads_maps else [None] * len(frames)
        middle = len(frames) // 2
        scenes = self.scenes(frames[middle], maps[middle], params)
        (sample,) = params["samples"]
        if not scenes.chosen:
            return {"samples": [sample]}
        sample = {**sample, "measured": scenes.settled(), "moved": 0.0}
        return {"samples": [of_frame(sample, number) for number in range(len(frames))]}

    @uncompiled
    def contrast_left(self, image: Tensor, distance: Tensor | None, params: Record) -> Tensor:
        """The share of contrast that is left at each pixel, see `uwaug.contrast_left`: what of an
        object can still be seen.

        Args:
            image, distance, params: as for `transform`.

        Returns:
            1xHxW of a picture, Bx1xHxW of a batch; 1 where a picture is left alone.
        """
        return self.scenes(image, distance, params).contrast_map()

    def take_apart(self, inputs: tuple[Any, ...]) -> Parts:
        """Image, map and the way back, of what the transform was called with."""
        return take_apart(inputs, self.keys, self.source.reads_maps)

    def _sampled(self, inputs: tuple[Any, ...], generator: torch.Generator | None) -> Any:
        image, distance, restore = self.take_apart(inputs)
        pictures_of(image)  # refuses what has no number of pictures
        record = self.make_params(image, generator)
        if is_film(image):
            return restore(self.transform(image, distance, record))
        draws = [Draw(**sample) for sample in record["samples"]]
        return restore(self._scenes(image, distance, draws).formed())

    def scenes(self, image: Tensor, distance: Tensor | None, params: Record) -> Scenes:
        """Pictures in the water of their draws; arguments as for `transform`."""
        count = len(pictures_of(image))
        draws = self.read(params, count)
        if is_film(image) and len(params["samples"]) == 1 and not draws[0].measured:
            draws = self.read(self.for_clip(params, image, distance), count)
        return self._scenes(image, distance, draws)

    def read(self, params: Record, count: int) -> list[Draw]:
        """The draws of a record of `count` pictures; refuses what cannot have been drawn."""
        draws = read_draws(params, count, set(self._ranges))
        waters = 2 if self.water.mixes else 1
        for draw in draws:
            uneven = (draw.field_seed is None) != (self.water.field is None)
            if uneven or len(draw.waters) != waters:
                differ = "field" if uneven else "mixing"
                raise ValueError(f"params is of a transform with other options: {differ}")
            for name in draw.waters:
                self.water.require(name)
        return draws

    def _scenes(self, image: Tensor, distance: Any, draws: Sequence[Draw]) -> Scenes:
        """An image in the water of draws that are known to be good."""
        fast.load()  # else the first picture of a process would be off by the last bits
        pictures, space = pictures_of(image), self.development.color_space
        given = image, pictures, space
        maps: Sequence[Tensor | None] = [None] * len(pictures)
        if self.source.reads_maps:
            maps = maps_for(pictures, distance)
        chosen = [i for i, draw in enumerate(draws) if draw.applied]
        if not chosen:
            return Scenes(*given)
        seen, waters, developments, lights = [], [], [], []
        metered = self.development.metered
        lamps = isinstance(self.light, Light) and bool(self.light.lamps)
        with torch.autocast(pictures.device.type, enabled=False):
            z = metres_of(self.source, pictures, maps, draws, space)
            some = pictures if len(chosen) == len(pictures) else pictures[chosen]
            own = measured(some, z)
            if (again := second_look(self.source, own, pictures, z, chosen)) is not z:
                z, own = again, measured(some, again)
            for i, look in zip(chosen, own, strict=True):
                with naming(i, len(pictures)):
                    require(look, pictures[i], space)
                    seen.append(look.of_film(draws[i].measured))
                    waters.append(self.water.of(draws[i], seen[-1], metered=metered, lamps=lamps))
                    developments.append(self.development.of(draws[i], seen[-1]))
                    lights.append(self._light_of(draws[i], seen[-1], waters[-1].scale))
            scales = [water.scale for water in waters]
            metres = z.to(torch.promote_types(pictures.dtype, z.dtype))
            if any(scale != 1 for scale in scales):
                metres = metres * metres.new_tensor(scales)[:, None, None, None]
            metres = metres.clamp(max=FARTHEST)
            z = metres * self.water.fields([draws[i] for i in chosen], seen, metres)
        thin, dense = self.water.field or (1.0, 1.0)
        spans = [
            (scale * thin * look.nearest, scale * look.median, scale * dense * look.farthest)
            for scale, look in zip(scales, own, strict=True)
        ]
        alike = self.water.has_one_law and not any(draw.measured for draw in draws)
        return Scenes(*given, chosen, z, metres, waters, developments, lights, spans, alike)

    def _light_of(self, draw: Draw, seen: Measured, scale: float) -> Light | None:
        """The light of a picture whose distances are scaled."""
        if isinstance(self.light, RandomLight):
            return self.light.of(draw, seen, scale=scale)
        return self.light

    def __repr__(self) -> str:
        shown = [f"{f.name}={getattr(self, f.name)!r}" for f in codec.changed(self)]
        return f"{type(self).__name__}({', '.join(shown)})"


_WATER_OPTIONS = tuple(field for field in fields(RandomWater) if field.init)
"""The arguments of `RandomUnderwater` that are those of its water."""
