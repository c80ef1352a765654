"""`RandomUnderwater`: new water for every picture, in a DataLoader worker or on a whole batch."""

import inspect
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal

import torch
from torch import Tensor

from uwaug._support.types import ColorSpace, Order
from uwaug.distance.sample import DistanceKind, Unknown, skipped
from uwaug.light import Light
from uwaug.optics.camera import Camera
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water
from uwaug.presets.preset import load_preset
from uwaug.transforms.codec import decode_options, encode_options
from uwaug.transforms.draw import Lens, Range, Record, cameras_of, spectra_of, weighed
from uwaug.transforms.options import (
    CONTRAST,
    GOOD_WATERS,
    SURVEY,
    check_options,
    contrast_beside,
    contrast_of,
    distribution_of,
    settings_of,
)
from uwaug.transforms.prepare import Choice, Draw, exactly, in_water, used
from uwaug.transforms.samples import (
    SampleTransform,
    maps_for,
    naming,
    plain_image,
    typed,
    uncompiled,
)

__all__ = ["RandomUnderwater"]


Job = tuple[int, Tensor | None, Record]
"""A picture that is to be degraded: its place in the batch, its map, its sample."""


class RandomUnderwater(SampleTransform):
    """Degrade pictures in random waters.

    A range is a number or (low, high), drawn uniformly; contrast and visibility are drawn uniformly
    in their logarithm. The defaults give pictures as an underwater camera takes them: constants
    calibrated to light transport (see `PointSpread.calibrated`), waters as turbid as the scene
    bears, an exposure. `survey` has the paper's set, `severity` five grades, `from_preset` a
    preset's figures.

    Args:
        waters: Jerlov types or `Water` objects, drawn with equal weight (one that is given twice
            counts twice); or a mapping to weights.
        mixing: share of a second water, drawn like the first; 0 for none, (0, 1) for a continuous
            slider between types.
        contrast: share of an object's contrast of luminance that is left at the scene's median
            distance, ignoring scattered light; the contents of the water are scaled to it, as far
            as pure water allows. None leaves the water as it is, and `visibility` takes its place.
        visibility: m; scale the water to this visibility. See `Water.with_visibility`.
        cameras: names, CSV files or `Camera` objects, drawn with equal weight.
        vertical_depth: m below the surface; with an automatic exposure no deeper than where 1/32 of
            the light is left, which it can make up for.
        exposure: "auto": one gain for each picture, in linear light, keeps the mean luminance of
            the scene, as a camera does; from 1/8 to 64. "none": the picture gets as dark as it is
            down there. Or a gain in stops.
        g: share of the scattered light that leaves the line of sight, 0…1.
        mu: share of the scattered light sent towards the camera, 0…1.
        point_spread: width law of the forward scatter; None for `PointSpread.calibrated`.
        focal_px: focal length in px of the picture, for the calibrated law and for `light`; None
            for a view 60° wide, .866·width. Give it where pictures are crops of a view.
        blur_factor: multiplies the scale of the width law.
        field_range: least and largest value of the medium field, which is drawn anew for each
            picture.
        field_probability: how often the water is uneven; else the field is 1.
        distance_kind: what a distance map holds. "metric": metres along the ray; nothing is
            invented. "relative": 0…1, 0 = near, mapped to near + (far − near)·t^gamma: order and
            proportions of the scene are right, its size is drawn. "inverse": what monocular
            networks give, large = near, of unknown scale and shift: every map is stretched to reach
            from near to far, even that of a flat scene.
        near, far, gamma: m, m and exponent for "relative" and "inverse" (gamma for "relative"
            alone).
        distance: used when a call brings no map; None makes that an error. A number or a range: a
            plane at that distance, m. The whole picture gets one veil, cast and blur. That suits a
            flat scene facing the camera. Elsewhere the depth cue is lost (far objects should fade
            first), and a network may learn only the tint. A callable, such as a depth network:
            takes the image (3xHxW or Bx3xHxW, 0…1) and returns a map of `distance_kind`; it takes
            its own time for every picture, and its errors become wrong colours. With any of these a
            tuple holds no map: all that follows its image is left alone.
        p: probability that a picture is degraded at all.
        same_on_batch: draw once for a batch.
        unknown: what NaN, 0 or negative metres get (NaN, in relative and inverse maps). "error": an
            error. "fill": a distance from the known ones, see `distance.fill_unknown`. "skip": the
            same, and a picture whose map tells nothing (no known pixel, or a flat map of inverse
            depth), as crops have it, stays as it is. "far": open water, for what lies beyond a
            sensor's range. A number: as many metres. Geometric transforms pad with 0: in maps that
            are not metric, where 0 is a distance, let them pad with NaN.
        image_key, distance_key: where to find the two in a dict.
        tolerance, color_space, order: as for `uwaug.Underwater`.
        light: a `Light`, or several, of which each picture draws one; None for daylight.

    Inputs:
        (image, distance, …), a tuple or list of them, (image, target) with the map in a dict in
        second place, or a dict. One picture (3xHxW, distance 1xHxW) or a batch, whose pictures may
        share one map; uint8 (0…255) or floating point (0…1); plain tensors or torchvision's
        tv_tensors (a distance map is best a `Mask`). The same structure comes back with a new image
        of the same type; every other leaf is returned as it is, and no input is changed. Gradients
        end here; `uwaug.Underwater` passes them on. `torch.compile` leaves the transform as it
        is, at a break of the graph, as it does torchvision's.

    Randomness comes from torch's global generator, which a DataLoader seeds for each worker and
    epoch; `at` draws from a key instead. Place the transform before normalisation, and after
    resizing and cropping: a width law with a reference size, such as the default, takes the picture
    that it gets for the whole view.

    Raises:
        TypeError, ValueError: if an option or an input does not suit, naming what came and what was
            expected.

    Examples:
        >>> import torch
        >>> aug = RandomUnderwater(["1C", "7C"], visibility=(2.0, 10.0))
        >>> aug
        RandomUnderwater(['1C', '7C'], visibility=(2.0, 10.0))
        >>> image, distance = torch.rand(3, 32, 48), torch.full((1, 32, 48), 3.0)
        >>> degraded, _ = aug(image, distance)
        >>> record = aug.make_params(image)
        >>> again, once_more = (aug.transform(image, distance, record) for _ in range(2))
        >>> torch.equal(again, once_more)
        True
    """

    def __init__(
        self,
        waters: str | Water | Mapping[str | Water, float] | Iterable[str | Water] = GOOD_WATERS,
        *,
        mixing: Range = 0.0,
        contrast: Range | None = CONTRAST,
        visibility: Range | None = None,
        cameras: Lens | Iterable[Lens] = "Nikon 5100 (NPL)",
        vertical_depth: Range = (0.0, 10.0),
        exposure: Literal["none", "auto"] | Range = "auto",
        g: Range = 0.05,
        mu: Range = 0.075,
        point_spread: PointSpread | None = None,
        focal_px: float | None = None,
        blur_factor: Range = 1.0,
        field_range: tuple[float, float] = (0.7, 1.3),
        field_probability: float = 1.0,
        distance_kind: DistanceKind = "metric",
        near: Range = 1.0,
        far: Range = 5.0,
        gamma: Range = 1.0,
        distance: Range | Callable[[Tensor], Tensor] | None = None,
        p: float = 1.0,
        same_on_batch: bool = False,
        unknown: Unknown = "error",
        image_key: str = "image",
        distance_key: str = "distance",
        tolerance: float = 0.002,
        color_space: ColorSpace = "srgb",
        order: Order = "line_of_sight",
        light: Light | Sequence[Light] | None = None,
    ) -> None:
        super().__init__(image_key, distance_key, mapped=distance is None)
        self.waters = weighed(waters)
        one = isinstance(cameras, (str, os.PathLike, Camera))
        self.cameras: list[Any] = [cameras] if one else list(cameras)  # type: ignore[arg-type]
        self.mixing = mixing
        self.contrast = contrast_beside(visibility, contrast)
        self.visibility = visibility
        self.vertical_depth = vertical_depth
        self.exposure = exposure
        self.g = g
        self.mu = mu
        self.point_spread = point_spread
        self.focal_px = focal_px
        self.blur_factor = blur_factor
        self.field_range = field_range
        self.field_probability = field_probability
        self.distance_kind = distance_kind
        self.near = near
        self.far = far
        self.gamma = gamma
        self.distance = distance
        self.p = p
        self.same_on_batch = same_on_batch
        self.unknown = unknown
        self.tolerance = tolerance
        self.color_space = color_space
        self.order = order
        self.light = light
        check_options(self)
        # what all pictures share: spectra, what is drawn from, settings
        self.spectra = spectra_of(self.waters)
        self.responses = cameras_of(self.cameras)
        self._distribution = distribution_of(self)
        self._settings = settings_of(self, self._distribution.ranges)

    @classmethod
    def survey(cls, **options: Any) -> "RandomUnderwater":
        """The set of the paper's survey: its nine waters, g, mu, depth and width law, no exposure.

        Two things differ: the camera (the paper used a Nikon D90) and the colour space (the paper
        treats sRGB values as linear light; `color_space="linear"` does the same).

        Args:
            options: any other argument of the class.
        """
        return cls(**{**SURVEY, **options})

    @classmethod
    def severity(cls, level: int, **options: Any) -> "RandomUnderwater":
        """One of five grades, for robustness studies: the default at a fixed contrast.

        | level | contrast left at the median distance | loss | visibility | at 2, 5 m | PCD |
        |---|---|---|---|---|---|
        | 1 | .65 | 16 % | 34 m | .85, .67 | .20 |
        | 2 | .50 | 36 % | 18 m | .66, .35 | .33 |
        | 3 | .35 | 52 % | 11 m | .47, .16 | .45 |
        | 4 | .20 | 67 % | 7 m | .28, .05 | .60 |
        | 5 | .08 | 79 % | 5 m | .13, .01 | .78 |

        The loss is that of the standard deviation of luminance in sRGB, PCD the difference of phase
        congruency (0: all structure is left), both at the bundled scene; at 2 and 5 m: the contrast
        of fine detail on grey, see `uwaug.contrast`. Medians of `python -m benchmarks.information`.

        Args:
            level: 1 (mild) … 5 (severe).
            options: any other argument of the class.
        """
        return cls(**{"contrast": contrast_of(level), **options})

    @classmethod
    def from_preset(
        cls,
        name_or_path: str | os.PathLike[str],
        *,
        water: str | Water | None = None,
        camera: str | os.PathLike[str] | Camera | None = None,
        **options: Any,
    ) -> "RandomUnderwater":
        """A preset's water, camera, constants, width law, field, exposure and colour space; and its
        near, far and gamma where distances are relative. See `uwaug.load_preset`.

        Args:
            name_or_path, water, camera: as for `uwaug.load_preset`.
            options: any argument of the class, in place of the preset's.

        Raises:
            ValueError: as `uwaug.load_preset`; and if the preset has coefficients of three channels
                instead of spectra.
        """
        preset = load_preset(name_or_path, water=water, camera=camera)
        return cls(**{**preset.options(options.get("distance_kind", "metric")), **options})

    def to_dict(self) -> dict[str, Any]:
        """The options that differ from the defaults, in numbers, strings, lists and dicts, as JSON,
        YAML and TOML hold them.

        Raises:
            NotImplementedError: if one cannot be written so, such as a function.
        """
        return encode_options(self._changed_options())

    @classmethod
    def from_dict(cls, options: Mapping[str, Any]) -> "RandomUnderwater":
        """A transform from what `to_dict` gives, or from options as a person writes them in TOML: a
        range as a list of two numbers, `point_spread` as a table of its arguments, `light` as a
        list of tables, each with kind = "ambient", "parallel" or "lamp" and the arguments of that
        constructor of `Light`.

        Raises:
            TypeError, ValueError: as the class, and if a table does not suit.
        """
        return cls(**decode_options(options))

    def _changed_options(self) -> dict[str, Any]:
        """The options that differ from the defaults."""
        options: dict[str, Any] = {}
        waters = list(self.waters) if set(self.waters.values()) == {1} else self.waters
        if waters != list(GOOD_WATERS):
            options["waters"] = waters
        for name, parameter in list(inspect.signature(type(self)).parameters.items())[1:]:
            value, default = getattr(self, name), parameter.default
            if name == "contrast" and self.visibility is not None:
                continue  # visibility takes its place
            if value not in (default, [default]):
                options[name] = value
        return options

    def make_params(self, image: Tensor, generator: torch.Generator | None = None) -> Record:
        """Draw everything that is random, for a picture or a batch of this shape.

        Args:
            image (3xHxW or Bx3xHxW tensor): only its shape is read.
            generator: source of randomness; torch's global generator if None.

        Returns:
            A plain record, {"samples": [one dict for each picture]}, that can be pickled and
            written as JSON.
        """
        batch = 1 if image.ndim == 3 or self.same_on_batch else len(image)
        return self._distribution.draw(batch, generator)

    @uncompiled
    def transform(self, image: Tensor, distance: Tensor | None, params: Record) -> Tensor:
        """Degrade a picture or a batch as a record says: deterministic, bit for bit.

        Args:
            image (3xHxW or Bx3xHxW tensor): uint8 or floating point.
            distance (1xHxW or Bx1xHxW tensor): of `distance_kind`; None where `distance` was given
                to the class.
            params: from `make_params`, of this or an equally configured transform; that of a single
                picture serves a whole batch.

        Returns:
            The degraded image, like `image`; `image` itself if the record leaves all of it alone.
            With unknown="skip", pictures whose maps tell nothing stay as they are, whatever the
            record says.

        Raises:
            TypeError, ValueError: if an input does not suit, naming what came and what was
                expected.
        """
        plain = plain_image(image)
        parts = list(plain if plain.ndim == 4 else plain[None])
        jobs = self.jobs(plain, distance, params)
        if not jobs:
            return image
        for i, z, sample in jobs:
            with naming(i, len(parts)), exactly(parts[i]):
                found = in_water(parts[i], z, self.chosen(sample))
                parts[i] = found.scene.picture()
        return typed(parts[0] if plain.ndim == 3 else torch.stack(parts), type(image))

    def resolve(self, image: Tensor, distance: Tensor | None, params: Record) -> Record:
        """The record with what its samples come to on these pictures.

        Each sample that is applied gains "used": "contents", the factor on all that is in the water
        besides pure water; its "visibility", m; the "gain" of the exposure. `transform` takes both
        factors from there, for any picture. A skipped one (see `unknown`) is no longer "applied".

        Args:
            image, distance, params: as for `transform`.
        """
        plain = plain_image(image)
        images = plain if plain.ndim == 4 else plain[None]
        samples = self._distribution.samples(params, len(images))
        resolved = [{**sample, "applied": False} for sample in samples]
        for i, z, sample in self.jobs(plain, distance, params):
            found = used(images[i], z, self.chosen(sample))
            resolved[i] = {**sample, "used": found}
        return {"samples": resolved}

    def chosen(self, sample: Record) -> Choice:
        """What a sample of a record degrades its picture with."""
        waters = [self.spectra[name] for name in sample["waters"]]
        camera = self.responses[sample["camera"]]
        return Choice(waters, camera, Draw.of(sample), self._settings)

    def jobs(self, plain: Tensor, distance: Any, params: Record) -> list[Job]:
        """The pictures of a batch that are to be degraded."""
        samples = self._distribution.samples(params, len(plain) if plain.ndim == 4 else 1)
        chosen = [i for i, sample in enumerate(samples) if sample["applied"]]
        maps = maps_for(plain, distance, chosen, self.distance)
        jobs = []
        for i, z in zip(chosen, maps, strict=True):
            if not skipped(z, self._settings.distance_kind, self._settings.unknown):
                jobs.append((i, z, samples[i]))
        return jobs

    def __repr__(self) -> str:
        options = self._changed_options()
        shown = [repr(options.pop("waters"))] if "waters" in options else []
        for name, value in options.items():
            shown.append(f"{name}={value!r}")
        return f"{type(self).__name__}({', '.join(shown)})"
