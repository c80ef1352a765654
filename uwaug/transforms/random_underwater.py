"""`RandomUnderwater`: new water for every picture, in a DataLoader worker or on a whole batch."""

import inspect
import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, TypeVar, get_args

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.tiles import RowSource
from uwaug._support.types import ColorSpace, Order
from uwaug.distance.sample import (
    DistanceKind,
    Scaling,
    Unknown,
    as_unknown,
    skipped,
    to_metres,
)
from uwaug.formation.development import Development
from uwaug.formation.engine import expected_engine
from uwaug.formation.field import random_field
from uwaug.formation.scene import Scene
from uwaug.formation.setup import Setup
from uwaug.light import Light
from uwaug.light.geometry import focal_of
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.constituents import Constituents
from uwaug.optics.jerlov import JERLOV_TYPES
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.reduction import default_bands
from uwaug.optics.scattering import Scattering
from uwaug.optics.surfaces import Surfaces, require_surfaces
from uwaug.optics.water import Water, load_water
from uwaug.presets.preset import load_preset
from uwaug.transforms.codec import decode_options, encode_options
from uwaug.transforms.params import (
    DEVELOPED,
    QUANTITIES,
    Distribution,
    Params,
    Range,
    Record,
    as_range,
)
from uwaug.transforms.prepare import (
    InWater,
    deterministic,
    kept_medium,
    lit_depth,
    new_medium,
    water_of,
)
from uwaug.transforms.samples import (
    Parts,
    SampleTransform,
    maps_for,
    naming,
    plain_image,
    take_apart,
    uncompiled,
    with_pictures,
)

AnyWater = str | os.PathLike[str] | Water | Constituents

GOOD_WATERS = ("II", "III", "1C", "3C", "5C", "7C", "9C")
"""The types that keep their look when their contents are scaled to a wanted contrast. The clear
oceanic types would need 11 to 66 times what is in them, and turn dark green.
"""

CONTENTS = Constituents(chlorophyll=(0.5, 20.0), cdom=(0.1, 3.0), minerals=(0.05, 5.0))
"""Coasts, lakes and harbours, green to yellow."""

WATERS: dict[AnyWater, float] = {**dict.fromkeys(("IB", *GOOD_WATERS), 1.0), CONTENTS: 8.0}
"""Half of the waters are Jerlov types, half are of other contents. (Contents alone, or wider ranges
of them: recall and coverage of photographs each .02 to .05 less. `python -m
benchmarks.accuracy.draws` measures what each range below is worth.)
"""

CONTRAST = (0.1, 0.8)
"""Less is fog in which little can be learnt, more is hardly water."""

COLOR_MATRIX = (0.0, 1.0)
"""Photographs have been through cameras that apply much or little of theirs."""

SEVERITIES = {1: 0.65, 2: 0.5, 3: 0.35, 4: 0.2, 5: 0.08}
"""The contrast of each grade of severity."""

UNDEVELOPED: dict[str, Any] = {"surfaces": "grey"} | dict.fromkeys(
    ("color_matrix", *DEVELOPED), None
)
"""What raw channels shown as sRGB are: the pictures of the paper, and of versions up to 0.1."""

HAZY: dict[str, Any] = {
    **UNDEVELOPED,
    "waters": GOOD_WATERS,
    "contrast": (0.1, 0.6),
    "vertical_depth": (0.0, 10.0),
    "mu": Scattering.CALIBRATED.mu,
}
"""The defaults of versions up to 0.1, and what severities grade."""

SURVEY: dict[str, Any] = {
    **UNDEVELOPED,
    "waters": JERLOV_TYPES[1:],
    "contrast": None,
    "vertical_depth": 1.0,
    "exposure": "none",
    "g": Scattering.PAPER.g,
    "mu": Scattering.PAPER.mu,
    "point_spread": PointSpread.paper(),
}
"""The set of the paper's survey."""


T = TypeVar("T")


class RandomUnderwater(SampleTransform):
    """Degrade pictures in random waters.

    A range is a number or (low, high), drawn uniformly; contrast and visibility are drawn uniformly
    in their logarithm. The defaults give pictures as an underwater camera takes them: constants
    calibrated to light transport (see `PointSpread.calibrated`), waters as turbid as the scene
    bears, surfaces with spectra, an exposure and a development. `survey` has the paper's set,
    `hazy` the defaults of versions up to 0.1, `severity` five grades, `from_preset` a preset's
    figures.

    Args:
        waters: None for `WATERS`: half of the pictures in Jerlov types, half in waters of other
            contents. Else what `uwaug.load_water` takes (Jerlov types, contents, CSV files, `Water`
            objects), and `Constituents` (or their text, such as "chlorophyll=1:20,cdom=.1:1"),
            whose contents are drawn anew for each picture. Picked with equal weight (one that is
            given twice counts twice); or a mapping to weights.
        mixing: share of a second water, picked like the first; 0 for none, (0, 1) for a continuous
            slider between types. Contents of both are drawn at the same shares of their ranges.
        contrast: share of an object's contrast of luminance that is left at the scene's median
            distance, ignoring scattered light (see `Water.contrast`); the contents of the water are
            scaled to it, as far as pure water allows. None leaves the water as it is, and
            `visibility` takes its place.
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
            error. "fill": a distance from the known ones around, see `distance.fill_unknown`.
            "behind": from those behind, for maps of depth cameras, with their shadows and their
            range. "skip": as "fill", and a picture whose map tells nothing (no known pixel, or a
            flat map of inverse depth), as crops have it, stays as it is. "far": open water. A
            number: as many metres. Geometric transforms pad with 0: in maps that are not metric,
            where 0 is a distance, let them pad with NaN.
        image_key, distance_key: where to find the two in a dict.
        tolerance, color_space, order: as for `uwaug.Underwater`.
        light: a `Light`, or several, of which each picture draws one; None for daylight.
        surfaces: "spectral" or "grey", as for `uwaug.Medium.from_water`.
        color_matrix: share of the camera's colour matrix, see there; None for grey surfaces.
        compensation, white_balance, saturation, black_point, gamut, tone: how the camera develops
            what it sees, see `uwaug.Development`; None leaves out what it is.

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
        waters: AnyWater | Mapping[AnyWater, float] | Iterable[AnyWater] | None = None,
        *,
        mixing: Range = 0.0,
        contrast: Range | None = CONTRAST,
        visibility: Range | None = None,
        cameras: str | os.PathLike[str] | Camera | Iterable[Any] = "Nikon 5100 (NPL)",
        vertical_depth: Range = (0.0, 15.0),
        exposure: Literal["none", "auto"] | Range = "auto",
        g: Range = Scattering.CALIBRATED.g,
        mu: Range = Scattering.CALIBRATED.mu,
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
        surfaces: Surfaces = "spectral",
        color_matrix: Range | None = COLOR_MATRIX,
        compensation: Range | None = (-1.8, 0.6),
        white_balance: Range | None = (-0.5, 1.0),
        saturation: Range | None = (0.8, 1.5),
        black_point: Range | None = (0.0, 0.9),
        gamut: Range | None = (0.5, 1.0),
        tone: Range | None = (0.9, 1.5),
    ) -> None:
        super().__init__()
        if visibility is not None:  # it takes the place of the default contrast
            if contrast not in (None, CONTRAST):
                got = f"visibility = {visibility} and contrast = {contrast}"
                raise ValueError(f"visibility and contrast: give one of them, got {got}")
            contrast = None
        self.waters = _weights_of(WATERS if waters is None else waters)
        single = isinstance(cameras, (str, os.PathLike, Camera))
        self.cameras: list[Any] = [cameras] if single else list(cameras)  # type: ignore[arg-type]
        self.mixing = mixing
        self.contrast = contrast
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
        self.image_key = image_key
        self.distance_key = distance_key
        self.tolerance = tolerance
        self.color_space = color_space
        self.order = order
        self.light = light
        self.surfaces = surfaces
        self.color_matrix = color_matrix
        self.compensation = compensation
        self.white_balance = white_balance
        self.saturation = saturation
        self.black_point = black_point
        self.gamut = gamut
        self.tone = tone
        self._check_options()
        # what all pictures share: spectra, lights, what is drawn from
        named = _by_name("waters", [_loaded(water) for water in self.waters])
        self._constituents = {
            name: water for name, water in named.items() if isinstance(water, Constituents)
        }
        # at the bands that media are made from: mixing needs no interpolation
        self.spectra = {
            name: water.at(default_bands(water))
            for name, water in named.items()
            if isinstance(water, Water)
        }
        self.responses = _by_name("cameras", [load_camera(camera) for camera in self.cameras])
        self._lights = _lights_of(light)
        self._unknown = as_unknown(unknown)
        self._distribution = Distribution(
            waters=dict(zip(named, self.waters.values(), strict=True)),
            constituents=self._constituents,
            cameras=tuple(self.responses),
            ranges=self._ranges(),
            field_range=as_range("field_range", field_range),
            p=p,
            field_probability=field_probability,
        )

    @classmethod
    def hazy(cls, **options: Any) -> "RandomUnderwater":
        """The defaults of versions up to 0.1: turbid waters alone, surfaces without spectra, and a
        camera that shows its raw channels. Like fog with a tint; structure is as in the defaults.

        Args:
            options: any other argument of the class.
        """
        return cls(**hazy_options(options))

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
        """One of five grades, for robustness studies: `hazy` at a fixed contrast.

        | level | contrast left at the median distance | loss | visibility | at 2, 5 m | PCD |
        |---|---|---|---|---|---|
        | 1 | .65 | 16 % | 34 m | .85, .67 | .20 |
        | 2 | .50 | 36 % | 18 m | .66, .35 | .33 |
        | 3 | .35 | 52 % | 11 m | .47, .16 | .45 |
        | 4 | .20 | 67 % | 7 m | .28, .05 | .60 |
        | 5 | .08 | 79 % | 5 m | .13, .01 | .78 |

        The loss is that of the standard deviation of luminance in sRGB, PCD the difference of phase
        congruency (0: all structure is left), both at the bundled scene; at 2 and 5 m: the contrast
        of fine detail on grey, see `uwaug.contrast`. Medians of
        `python -m benchmarks.accuracy.information`.

        Args:
            level: 1 (mild) … 5 (severe).
            options: any other argument of the class.
        """
        if not isinstance(level, int) or level not in SEVERITIES:
            raise ValueError(f"level must be a whole number from 1 to 5, got {level!r}")
        return cls(**hazy_options({"contrast": SEVERITIES[level], **options}))

    @classmethod
    def from_preset(
        cls,
        name_or_path: str | os.PathLike[str],
        *,
        water: str | os.PathLike[str] | Water | None = None,
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
        figures = preset.options(options.get("distance_kind", "metric"))
        if options.get("surfaces") == "grey":  # have no use for a matrix of the preset's
            figures.pop("color_matrix", None)
        return cls(**{**UNDEVELOPED, **figures, **options})

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

    def make_params(self, image: Tensor, generator: torch.Generator | None = None) -> Record:
        """Draw everything that is random, for a picture or a batch of this shape.

        Args:
            image (3xHxW or Bx3xHxW tensor): only its shape is read.
            generator: source of randomness; torch's global generator if None.

        Returns:
            A plain record, {"samples": [one dict for each picture]}, that can be pickled and
            written as JSON.
        """
        return {"samples": [params.to_dict() for params in self._draw(image, generator)]}

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
        return self._transform(image, distance, self._read(image, params))

    def resolve(self, image: Tensor, distance: Tensor | None, params: Record) -> Record:
        """The record with what its samples come to on these pictures.

        Each sample that is applied gains "used": "contents", the factor on all that is in the water
        besides pure water; its "visibility", m; the "vertical_depth", m, that was reached; the
        "gain" of the exposure. `transform` takes contents and gain from there, for any picture.
        Its "path" says what computes the picture. One that is left alone has none, and a skipped
        one (see `unknown`) is no longer "applied".

        Args:
            image, distance, params: as for `transform`.
        """
        samples = self._read(image, params)
        resolved = self._each(image, distance, samples, InWater.resolved)
        seen = [
            resolved.get(i, replace(sample, applied=False, path=None))
            for i, sample in enumerate(samples)
        ]
        return {"samples": [params.to_dict() for params in seen]}

    def in_water(
        self, image: Tensor, distance: Tensor | None, params: Record, see: Callable[[InWater], T]
    ) -> dict[int, T]:
        """What `see` makes of each picture in its water: of its scene, and what the draw came to.

        Args:
            image, distance, params: as for `transform`.
            see: called once for each picture that is degraded, without gradients.

        Returns:
            By the picture's place in the batch; those that are left alone are missing.
        """
        return self._each(image, distance, self._read(image, params), see)

    @property
    def varies(self) -> bool:
        """Whether two pictures may get different waters, cameras or light."""
        return callable(self.distance) or self._distribution.varies

    def take_apart(self, inputs: tuple[Any, ...]) -> Parts:
        """Image, map and the way back, of what the transform was called with."""
        mapped = self.distance is None
        return take_apart(inputs, self.image_key, self.distance_key, mapped=mapped)

    def _sampled(self, inputs: tuple[Any, ...], generator: torch.Generator | None) -> Any:
        image, distance, restore = self.take_apart(inputs)
        return restore(self._transform(image, distance, self._draw(image, generator)))

    def _draw(self, image: Tensor, generator: torch.Generator | None) -> list[Params]:
        count = 1 if image.ndim == 3 or self.same_on_batch else len(image)
        drawn = self._distribution.draw(count, generator)
        size = (image.shape[-2], image.shape[-1])
        return [
            replace(params, path=expected_engine(size, self.order, self._light(params)))
            for params in drawn
        ]

    def _light(self, params: Params) -> Light | None:
        return self._lights[int(params.numbers["light"])] if self._lights else None

    def _read(self, image: Tensor, record: Any) -> list[Params]:
        plain = plain_image(image)
        return self._distribution.read(record, 1 if plain.ndim == 3 else len(plain))

    def _transform(self, image: Tensor, distance: Any, samples: list[Params]) -> Tensor:
        degraded = self._each(image, distance, samples, InWater.picture)
        return with_pictures(image, degraded)

    def _each(
        self, image: Tensor, distance: Any, samples: list[Params], see: Callable[[InWater], T]
    ) -> dict[int, T]:
        """`in_water`, of params that were read or drawn."""
        plain = plain_image(image)
        pictures = plain if plain.ndim == 4 else plain[None]
        if len(samples) < len(pictures):  # one serves all
            samples = samples * len(pictures)
        applied = [i for i, params in enumerate(samples) if params.applied]
        results = {}
        for i, z in zip(applied, maps_for(plain, distance, applied, self.distance), strict=True):
            if not skipped(z, self.distance_kind, self._unknown):
                with naming(i, len(pictures)), deterministic(pictures[i]):
                    results[i] = see(self._in_water(pictures[i], z, samples[i]))
        return results

    def _in_water(self, image: Tensor, distance: Tensor | None, params: Params) -> InWater:
        """A picture (3xHxW) with its map (1xHxW) in the water that was drawn for it."""
        numbers, size = params.numbers, (image.shape[-2], image.shape[-1])
        z: Tensor | RowSource
        if distance is None:
            dtype = torch.promote_types(image.dtype, torch.float32)
            z = image.new_full((1, 1, 1), numbers["distance"], dtype=dtype).expand(1, *size)
        else:
            scaling = Scaling(*(numbers.get(name, math.nan) for name in Scaling._fields))
            z = to_metres(distance.contiguous(), scaling, self.distance_kind, self._unknown)
        setup, water, contents, depth = self._setup(params, z)
        field = None
        if params.field_seed is not None:
            field = random_field(size, params.field_seed, *params.field_range, image)
        gain = None if params.used is None else params.used["gain"]
        scene = Scene.of(image, z, setup, field, params.path, gain=gain)
        return InWater(scene, params, water, contents, depth)

    def _setup(self, params: Params, z: Tensor | RowSource) -> tuple[Setup, Water, float, float]:
        """What a picture with these distances is taken with; its water, the factor on what is in
        it, and the vertical depth, m.
        """
        numbers, light = params.numbers, self._light(params)
        water, contents = water_of(self.spectra, params, z)
        depth = numbers["vertical_depth"]
        # a lamp shines at any depth
        if self.exposure == "auto" and not (light is not None and light.lamps):
            depth = lit_depth(water, depth)
        focal_px = focal_of(self.focal_px, z.shape[-1])
        law = self.point_spread or PointSpread.calibrated(focal_px)
        medium = (new_medium if self._distribution.makes_media else kept_medium)(
            water,
            self.responses[params.camera],
            (depth, numbers["g"], numbers["mu"]),
            law.widened(numbers["blur_factor"]),
            self.tolerance,
            self.surfaces,
            numbers.get("color_matrix", 1.0),
        )
        setup = Setup(
            medium,
            light=light,
            exposure=self.exposure if isinstance(self.exposure, str) else numbers["exposure"],
            color_space=self.color_space,
            focal_px=focal_px,
            tolerance=self.tolerance,
            order=self.order,
            development=Development(**{n: numbers[n] for n in DEVELOPED if n in numbers}),
        )
        return setup, water, contents, depth

    def _check_options(self) -> None:
        """Refuse options that are unknown, out of range, or would do nothing."""
        checks.one_of("distance_kind", self.distance_kind, get_args(DistanceKind))
        checks.one_of("color_space", self.color_space, get_args(ColorSpace))
        checks.one_of("order", self.order, get_args(Order))
        require_surfaces(self.surfaces)
        if self.surfaces == "grey" and self.color_matrix not in (None, COLOR_MATRIX):
            got = f"surfaces are grey, got {self.color_matrix}"
            raise ValueError(f"color_matrix would do nothing: {got}")
        checks.within("p", self.p, 0.0, 1.0)
        checks.within("field_probability", self.field_probability, 0.0, 1.0)
        checks.tolerance(self.tolerance)
        if isinstance(self.exposure, str):
            checks.one_of("exposure", self.exposure, ("none", "auto"))
        if self.point_spread is not None:
            checks.instance("point_spread", self.point_spread, PointSpread)
        if self.focal_px is not None:
            checks.positive("focal_px", self.focal_px, "px")
            if self.point_spread is not None and self.light is None:
                instead = "a point_spread takes the place of the calibrated law that it is for"
                raise ValueError(f"focal_px would do nothing: {instead}, got {self.focal_px}")
        defaults = inspect.signature(type(self)).parameters
        for name, quantity in QUANTITIES.items():
            unused = self.distance_kind not in quantity.maps
            if unused and getattr(self, name) != defaults[name].default:
                kind = f"distance_kind is {self.distance_kind!r}"
                raise ValueError(f"{name} would do nothing: {kind}, got {getattr(self, name)}")

    def _ranges(self) -> dict[str, tuple[float, float]]:
        """(low, high) of each quantity that is drawn."""
        ranges: dict[str, tuple[float, float]] = {}
        if self._lights:
            ranges["light"] = (0, len(self._lights))
        for name, quantity in QUANTITIES.items():
            if name == "light" or quantity.content or self.distance_kind not in quantity.maps:
                continue
            option = getattr(self, name)
            if name == "exposure" and isinstance(option, str):
                continue
            if name == "distance" and callable(option):
                continue
            if name == "color_matrix" and self.surfaces == "grey":
                continue
            if option is not None or name not in _OPTIONAL:
                ranges[name] = as_range(name, option)
        if self.distance_kind != "metric":
            near, far = ranges["near"], ranges["far"]
            if near[1] >= far[0]:
                got = f"near = {near} and far = {far}"
                raise ValueError(f"near must lie below far, got {got} in metres")
            if self.distance_kind == "inverse" and near[0] == 0:
                where = "above 0 m where distance_kind is 'inverse'"
                raise ValueError(f"near must lie {where}, got {near}")
        clearest = [load_water(water.clearest.name) for water in self._constituents.values()]
        for water in (*self.spectra.values(), *clearest):
            for metres in ranges.get("visibility", ()):
                try:
                    water.with_visibility(metres)
                except ValueError as error:
                    unsuited = f"visibility={metres:g} does not suit water {water.name!r}"
                    raise ValueError(f"{unsuited}: {error}") from None
        return ranges

    def _changed_options(self) -> dict[str, Any]:
        """The options that differ from the defaults."""
        options: dict[str, Any] = {}
        waters = list(self.waters) if set(self.waters.values()) == {1} else self.waters
        if waters != WATERS:
            options["waters"] = waters
        for name, parameter in list(inspect.signature(type(self)).parameters.items())[1:]:
            value, default = getattr(self, name), parameter.default
            if name == "contrast" and self.visibility is not None:
                continue  # visibility takes its place
            if value not in (default, [default]):
                options[name] = value
        return options

    def __repr__(self) -> str:
        options = self._changed_options()
        shown = [repr(options.pop("waters"))] if "waters" in options else []
        shown += [f"{name}={value!r}" for name, value in options.items()]
        return f"{type(self).__name__}({', '.join(shown)})"


_OPTIONAL = ("contrast", "visibility", "distance", "color_matrix", *DEVELOPED)
"""Quantities that may be None: nothing asks for them."""

_NO_SPECTRUM = (
    ", Constituents, or what uwaug.load_water takes. A picture, a fit or a medium has three "
    "coefficients and no spectrum: give it to uwaug.Underwater, such as "
    "uwaug.Underwater(uwaug.fitting.red_channel_prior(…).medium)"
)


def hazy_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """`HAZY` with other options in place of its own; a visibility takes the place of a contrast."""
    replaced = {"contrast": None} if options.get("visibility") is not None else {}
    return {**HAZY, **replaced, **options}


def _weights_of(waters: Any) -> dict[AnyWater, float]:
    """Each water's weight."""
    if isinstance(waters, (set, frozenset)):
        raise TypeError("waters must have an order, as draws follow it; got a set")
    kinds = (str, os.PathLike, Water, Constituents)
    listed = [waters] if isinstance(waters, kinds) else list(waters)
    for water in listed:
        if not isinstance(water, kinds):
            checks.instance("waters", water, Water, _NO_SPECTRUM)
    weights = dict(waters if isinstance(waters, Mapping) else Counter(listed))
    values = list(weights.values())
    if values and not (min(values) >= 0 and 0 < sum(values) < math.inf):
        raise ValueError(f"waters: expected weights ≥ 0 with a positive sum, got {values}")
    return weights


def _loaded(water: AnyWater) -> Water | Constituents:
    """A water, or the ranges that each picture draws one from."""
    if isinstance(water, str) and "=" in water and not water.lower().endswith(".csv"):
        water = Constituents.parse(water)
    if isinstance(water, Constituents):
        return load_water(water.name) if water.fixed else water
    return load_water(water)


def _by_name(option: str, spectra: list[Any]) -> dict[str, Any]:
    named = {spectrum.name: spectrum for spectrum in spectra}
    if not spectra or len(named) < len(spectra):
        got = [spectrum.name for spectrum in spectra]
        expected = "expected at least one, each with a name of its own (name=… gives one)"
        raise ValueError(f"{option}: {expected}, got {got}")
    return named


def _lights_of(light: Light | Sequence[Light] | None) -> list[Light]:
    """The lights that are drawn from."""
    if light is None:
        return []
    lights = [light] if isinstance(light, Light) else list(light)
    if not lights:
        raise ValueError("light: expected a Light or several to draw from, got none")
    for each in lights:
        checks.instance("light", each, Light)
        each.require_one()
    return lights
