"""`RandomUnderwater`: new water for every picture, in a DataLoader worker or on a whole batch."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from dataclasses import field as option
from typing import Any, Literal

import torch
from torch import Tensor

from uwaug._support import checks, codec
from uwaug._support.nouns import Fixed, Uniform
from uwaug._support.ranges import Range, ends_of
from uwaug.distance.made_up import MadeUp
from uwaug.distance.sources import Metres, Plane, Source
from uwaug.formation.underwater import Underwater
from uwaug.light import Light
from uwaug.optics.view import WIDE, View
from uwaug.transforms.conditions import Conditions, laid_over, photographed
from uwaug.transforms.draws import NOUNS, Batchable, Draw, Record, of_frame, read_draws
from uwaug.transforms.measured import Measured
from uwaug.transforms.random_development import RandomDevelopment
from uwaug.transforms.random_light import RandomLight
from uwaug.transforms.random_water import MILDEST, AnyWater, RandomWater
from uwaug.transforms.samples import (
    SampleTransform,
    are_pictures,
    is_film,
    maps_for,
    pictures_of,
    take_apart,
    uncompiled,
)
from uwaug.transforms.scenes import Scenes, scene_of, scenes_of

SEVERITIES = {1: MILDEST, 2: 0.5, 3: 0.35, 4: 0.2, 5: 0.08}
"""Contrast at the scene's median distance, by grade of severity."""


@codec.plain
@dataclass(init=False, eq=False, repr=False)
class RandomUnderwater(SampleTransform):
    """Degrade pictures in random waters, as an underwater camera takes them.

    Args:
        water: a `RandomWater`, or its first argument alone.
        distance: the content of maps: `uwaug.distance.Metres`, `Relative` or `Inverse`. Or the
            source of distances where there are no maps: `MadeUp`, `Network`, or `Plane`, for which
            a number or a range may stand, m.
        light: a `RandomLight`; a `Light`, the same for all pictures, whose lamps stand in metres;
            None for daylight. "auto" is `RandomLight()`, and None where a water is a `Medium`,
            which has daylight of its own.
        development: a `RandomDevelopment`: what the camera does, and the colour space.
        view: of the camera, a `uwaug.View` or its angle in degrees. Of a crop give that of the
            crop, see `uwaug.View.crop`.
        conditions: `uwaug.Conditions`, of which each picture takes one: numbers of water and camera
            that belong together. By default those of photographs, for options that are left out;
            one that is set leaves the rest of the condition as it is, and a water that is named is
            as clear as in nature. None: each range is drawn on its own.
        p: probability that a picture is degraded at all.
        keys: names of image and map in a dict.

    Inputs:
        (image, distance, …), a tuple or list of them, (image, target) with the map in a dict in
        second place, or a dict. One picture (3xHxW, distance 1xHxW) or a batch, whose pictures may
        share one map; uint8 (0…255) or floating point (0…1); plain tensors or torchvision's
        tv_tensors (a map is best a `Mask`). A `Video` is a film: one draw for all frames. A list
        of pictures (3xHxW, of any sizes) is a batch, with a list of maps; a tuple is one sample, of
        which the first picture gets wet, the second stays as it is, and a third is refused.

        The same structure comes back with a new image of the same type; every other leaf is
        returned as it is, and no input is changed. Gradients pass to image and distance; draws are
        constant.

    Randomness comes from torch's global generator; `at` draws from a key instead. Place the
    transform before normalisation, and after resizing and cropping.

    Raises:
        TypeError, ValueError: if an option or an input does not suit.

    Examples:
        >>> import torch
        >>> from uwaug import RandomWater
        >>> aug = RandomUnderwater(RandomWater("3C", contrast=0.2), p=0.5)
        >>> aug
        RandomUnderwater(water=RandomWater(waters='3C', contrast=0.2), p=0.5)
        >>> image, distance = torch.rand(3, 32, 48), torch.full((1, 32, 48), 3.0)
        >>> degraded, _ = aug(image, distance)
        >>> again = aug.transform(image, distance, aug.make_params(image))
    """

    water: RandomWater = option(default_factory=RandomWater)
    distance: Source = option(default_factory=Metres)
    light: RandomLight | Light | Literal["auto"] | None = "auto"
    development: RandomDevelopment = option(default_factory=RandomDevelopment)
    view: View = WIDE
    conditions: Conditions | None = option(default_factory=photographed)
    p: float = 1.0
    keys: tuple[str, str] = ("image", "distance")

    def __init__(
        self,
        water: RandomWater | AnyWater | Iterable[AnyWater] | None = None,
        *,
        distance: Source | Range | None = None,
        light: RandomLight | Light | Literal["auto"] | None = "auto",
        development: RandomDevelopment | None = None,
        view: View | float = WIDE,
        conditions: Conditions | Literal["photographed"] | None = "photographed",
        p: float = 1.0,
        keys: tuple[str, str] = ("image", "distance"),
    ) -> None:
        self.water = water if isinstance(water, RandomWater) else RandomWater(water)
        distance = ends_of(distance) or distance
        if isinstance(distance, (int, float, tuple)):
            distance = Plane(distance)
        self.distance = Metres() if distance is None else distance
        cure = "Metres, Relative, Inverse, MadeUp, Network(…) or Plane of uwaug.distance"
        checks.instance("distance", self.distance, Source, f"; give {cure}")
        self.distance.require_ranges()
        self.light = light
        if light == "auto":
            light = None if self.water.has_media else RandomLight()
        if not isinstance(light, Light | None):
            checks.instance("light", light, RandomLight, "; or a uwaug.Light")
        pitch = light.pitch if isinstance(light, Light) else None
        if isinstance(pitch, Tensor) and pitch.numel() > 1:
            raise ValueError("light.pitch must be one number for all pictures; see RandomLight")
        self.development = RandomDevelopment() if development is None else development
        checks.instance("development", self.development, RandomDevelopment)
        self.view = View.of(view)
        checks.within("p", p, 0.0, 1.0)
        self.p = p
        if isinstance(keys, str) or [*map(type, keys)] != [str, str]:
            raise TypeError(f"keys must be the names of image and map, got {keys!r:.80}")
        self.keys = keys[0], keys[1]
        light_noun = light if isinstance(light, RandomLight) else Fixed(light)
        nouns = (self.water, self.distance, light_noun, self.development)
        self._nouns: dict[str, Any] = dict(zip(NOUNS, nouns, strict=True))
        self.conditions = photographed() if conditions == "photographed" else conditions
        self._set = dict[str, set[str]]()  # options that win over conditions, by noun
        if self.conditions is not None:
            checks.instance("conditions", self.conditions, Conditions, "; see Conditions.read")
        if self.conditions and self.conditions.binding:
            sample = self._sample(Uniform(bytes(8)))
            for row in self.conditions.rows:
                read_draws({"samples": [laid_over(sample, row)]}, 1, self._nouns)
        elif self.conditions:
            for name in ("water", "development"):
                self._set[name] = {field.name for field in codec.changed(self._nouns[name])}

    @classmethod
    def severity(cls, level: int, water: Any = None, **options: Any) -> "RandomUnderwater":
        """One of five grades, for robustness studies: the default at a fixed contrast. From one
        key a picture has the same scene, light, camera and kind of water at each grade.

        Args:
            level: 1 (mild) … 5 (severe); .65, .5, .35, .2 and .08 of the contrast are left at the
                scene's median distance. ValueError if there is none, or the water has a visibility.
            water, options: as for the class.
        """
        if level not in SEVERITIES:
            raise ValueError(f"level must be a whole number from 1 to 5, got {level!r}")
        noun = water if isinstance(water, RandomWater) else RandomWater(water)
        return cls(replace(noun, contrast=SEVERITIES[level]), **options)

    def module(
        self,
        distance_range: tuple[float, float] | None = None,
        sides: tuple[int, int] | None = None,
    ) -> Underwater:
        """The only draw of a transform of which nothing is random, as a module, whose inputs are
        distances times the medium field.

        Args:
            distance_range: ends for which the blur is planned, m; None for those of `distance`,
                .1 to 20 m if maps have them, times the field.
            sides: the smallest and the largest short side, px, see `uwaug.Underwater`.

        Raises:
            ValueError: if something is random, or follows from each picture; names it.
        """
        nouns = {name: noun for name, noun in self._nouns.items() if name != "distance"}
        names = [f"{name}.{option}" for name, noun in nouns.items() for option in noun.random()]
        names += ["p"] * (self.p < 1) + ["water.contrast"] * (self.water.contrast is not None)
        if self.conditions and self.conditions.binding and len(self.conditions.rows) > 1:
            names.append("conditions")
        if names:
            got = ", ".join(dict.fromkeys(names))
            raise ValueError(f"a module makes the same of all pictures, but {got} differ: fix them")
        nearest, farthest = self.distance.reach() or (0.1, 20.0)
        measured = Measured(1, 1, 0.0, 1.0, nearest, farthest, farthest, self.development.metered)
        thin, dense = self.water.field or (1.0, 1.0)
        low, high = nearest * thin, farthest * dense
        draw = Draw(**self._sample(Uniform(bytes(8))))
        water = self.water.water(draw.water, farthest)
        setting = scene_of(draw, water, measured, measured, self._nouns, self.view).setting
        distance_range = distance_range or (low, max(high, 1.01 * low))  # of a plane, too
        return Underwater.of(setting, distance_range, sides=sides)

    def to_dict(self) -> dict[str, Any]:
        """The options that differ from the defaults, as JSON, YAML and TOML hold them; "none" for
        None. TypeError if an option cannot be written so, such as a function.
        """
        return dict(codec.to_plain(self))

    @staticmethod
    def from_dict(options: Mapping[str, Any]) -> "RandomUnderwater":
        """A transform from what `to_dict` gives, or from options as a person writes them in TOML:
        nouns as tables, a range as two numbers, "none" for None; `distance` with a `kind`. Raises
        as the class.
        """
        transform: RandomUnderwater = codec.from_plain(options, RandomUnderwater)
        return transform

    def make_params(self, image: Tensor | list[Tensor], generator: Any = None) -> Record:
        """Draw everything that is random, for a picture or a batch.

        Args:
            image (3xHxW or Bx3xHxW tensor, or list): only its shape is read; a `Video` draws once.
            generator: `torch.Generator`, or a list, one for each picture; None: the global one.

        Returns:
            A plain record, as JSON holds it: {"samples": […]} with a dict for each picture:
            "applied", whether it is degraded at all; and the draws of "water" (with names or
            contents of one or two "waters"), "distance", "light" (the pitch alone by daylight) and
            "development", by the names of their options.
        """
        is_batch = isinstance(image, list) or (image.ndim > 3 and not is_film(image))
        count = len(image) if is_batch else 1
        if isinstance(generator, list):
            if len(generator) != count:
                raise ValueError(f"index has {len(generator)} keys but image has {count} pictures")
            samples = [self.make_params(torch.empty(3, 1, 1), g)["samples"][0] for g in generator]
            return Batchable(samples=samples)
        seeds = torch.randint(2**63 - 1, (count,), generator=generator, device="cpu").tolist()
        return Batchable(samples=[self._sample(Uniform(seed.to_bytes(8))) for seed in seeds])

    def _sample(self, uniform: Uniform) -> Record:
        sample: Record = {"applied": uniform("applied") < self.p}
        for name, noun in self._nouns.items():
            sample[name] = noun.drawn(Uniform(uniform.key, f"{name}."))
        if self.conditions is None:
            return sample
        condition = self.conditions.picked(uniform)
        for noun, options in self._set.items():
            names = sample[noun].keys() - options
            numbers = {n: value for n, value in condition[noun].items() if n in names}
            condition = {**condition, noun: numbers}
        return laid_over(sample, condition)

    @uncompiled
    def transform(self, image: Any, distance: Any, params: Record) -> Any:
        """Degrade a picture or a batch as a record says: deterministic. `image` itself comes back
        if the record leaves all of it alone.

        Args:
            image (3xHxW or Bx3xHxW tensor, or list of pictures): uint8 or floating point.
            distance (1xHxW or Bx1xHxW tensor, or list): maps that `distance` reads; or None.
            params: from `make_params` of an equal transform; one sample serves a whole batch.
        """
        if not are_pictures(image):
            return self.scenes(image, distance, params).formed()
        draws = read_draws(params, len(image), self._nouns)
        maps = distance if isinstance(distance, (list, tuple)) else [distance] * len(image)
        if len(maps) != len(image):
            raise ValueError(f"distance has {len(maps)} maps but image is a list of {len(image)}")
        each = zip(image, map(pictures_of, image), maps, ([draw] for draw in draws), strict=True)
        return [scenes_of(*scene, self._nouns, self.view).formed() for scene in each]

    @uncompiled
    def for_clip(self, params: Record, image: Tensor, distance: Tensor | None) -> Record:
        """Turn the record of one picture into that of a film, with a sample for each frame. Median
        distance, exposure and white balance are those of one frame, so that frames may come in any
        order, on any worker.

        Args:
            params: from `make_params`, of one picture.
            image, distance: a frame of the film, or all, of which the middle one is taken.

        Returns:
            A record with a sample for each of these frames. Set at each how far, in m, field and
            snow have drifted to the right ("moved"), and the camera has moved to the right, down
            and forward ("motion"); all are 0. A sample that serves several frames gives them the
            same noise: set the "seed" of its "noise" anew.
        """
        frames = pictures_of(image)
        if len(frames) > 1 and isinstance(self.distance, MadeUp):
            raise ValueError("distance: made up from each frame, a film would flicker: give maps")
        maps = maps_for(frames, distance, self.distance)
        middle = len(frames) // 2
        scenes = self.scenes(frames[middle], maps[middle], params)
        (sample,) = params["samples"]
        if not scenes.chosen:
            return Batchable(samples=[sample])
        sample = {**sample, "measured": scenes.settled(), "moved": 0.0, "motion": (0.0, 0.0, 0.0)}
        return Batchable(samples=[of_frame(sample, number) for number in range(len(frames))])

    @uncompiled
    def contrast_left(self, image: Tensor, distance: Tensor | None, params: Record) -> Tensor:
        """Share of contrast that is left at each pixel (1xHxW, or Bx1xHxW of a batch), see
        `uwaug.contrast_left`; 1 where a picture is left alone. Arguments as for `transform`.
        """
        return self.scenes(image, distance, params).contrast_map()

    def scenes(self, image: Tensor, distance: Tensor | None, params: Record) -> Scenes:
        """Pictures in the water of their draws, of which no image is formed yet. Arguments as for
        `transform`.
        """
        pictures = pictures_of(image)
        count = len(pictures)
        draws = read_draws(params, count, self._nouns)
        if is_film(image) and len(params["samples"]) == 1 and not draws[0].measured:
            draws = read_draws(self.for_clip(params, image, distance), count, self._nouns)
        return scenes_of(image, pictures, distance, draws, self._nouns, self.view)

    def _sampled(self, inputs: tuple[Any, ...], generator: Any) -> Any:
        image, distance, restore = take_apart(inputs, self.keys, self.distance.reads_maps)
        if are_pictures(image) or is_film(image):
            record = self.make_params(image, generator)
            return restore(self.transform(image, distance, record))
        pictures, record = pictures_of(image), self.make_params(image, generator)
        draws = [Draw(**sample) for sample in record["samples"]]  # as just drawn, unchecked
        scenes = scenes_of(image, pictures, distance, draws, self._nouns, self.view)
        return restore(scenes.formed())

    def __repr__(self) -> str:
        options = [f"{f.name}={getattr(self, f.name)!r}" for f in codec.changed(self)]
        return f"{type(self).__name__}({', '.join(options)})"
