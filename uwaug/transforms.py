"""`RandomUnderwater`: new water for every picture, in a DataLoader worker or on a whole batch."""

import hashlib
import inspect
import os
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, get_args

import torch
from torch import Tensor, nn

from uwaug import checks
from uwaug.colour import ColorSpace
from uwaug.degrade import DistanceKind, Draw, Settings, Unknown, degrade, degrade_opaque, table
from uwaug.draw import (
    RANGES,
    Distribution,
    Range,
    Record,
    as_range,
    cameras_of,
    require_scaling,
    require_visibility,
    spectra_of,
    weighed,
)
from uwaug.formation import Order
from uwaug.optics.camera import Camera
from uwaug.optics.jerlov_tables import JERLOV_TYPES
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water
from uwaug.structure import maps_for, plain_image, take_apart, typed

__all__ = ["RandomUnderwater"]

_SCALING = {"metric": (), "relative": ("near", "far", "gamma"), "inverse": ("near", "far")}
_CHOICES = {
    "distance_kind": get_args(DistanceKind),
    "unknown": get_args(Unknown),
    "color_space": get_args(ColorSpace),
    "order": get_args(Order),
}
_PAPER = PointSpread.paper()


class RandomUnderwater(nn.Module):
    """Degrade pictures in random waters.

    A range is a number or (low, high), drawn uniformly; visibility is drawn uniformly in its
    logarithm. The defaults are the figures of the paper's survey (its nine waters, g, mu, vertical
    depth, width law, field, and near, far and gamma for relative distance). Two defaults differ
    from the survey: the camera (the paper used a Nikon D90) and the colour space (the paper treats
    sRGB values as linear light; `color_space="linear"` does the same).

    Args:
        waters: Jerlov types or `Water` objects, drawn with equal weight (one that is given twice
            counts twice); or a mapping to weights.
        mixing: share of a second water, drawn like the first; 0 for none, (0, 1) for a continuous
            slider between types.
        visibility: m; scale the water to this visibility, or None to leave it. See
            `Water.with_visibility`.
        cameras: names, CSV files or `Camera` objects, drawn with equal weight.
        vertical_depth: m below the surface.
        g: share of the scattered light that leaves the line of sight, 0…1.
        mu: share of the scattered light sent towards the camera, 0…1.
        point_spread: width law of the forward scatter.
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
            error. "fill": the nearest known distance (12 ms at 500×741). Geometric transforms pad
            with 0: in maps that are not metric, where 0 is a distance, let them pad with NaN.
        image_key, distance_key: where to find the two in a dict.
        tolerance, color_space, order: as for `uwaug.Underwater`.

    Inputs:
        (image, distance, …), a tuple or list of them, or a dict. One picture (3xHxW, distance
        1xHxW) or a batch, whose pictures may share one map; uint8 (0…255) or floating point (0…1);
        plain tensors or torchvision's tv_tensors (a distance map is best a `Mask`). The same
        structure comes back with a new image of the same type; every other leaf is returned as it
        is, and no input is changed. Gradients end here; `uwaug.Underwater` passes them on.

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
        waters: str | Water | Mapping[str | Water, float] | Iterable[str | Water] = JERLOV_TYPES[
            1:
        ],
        *,
        mixing: Range = 0.0,
        visibility: Range | None = None,
        cameras: str
        | os.PathLike[str]
        | Camera
        | Iterable[str | os.PathLike[str] | Camera] = "Nikon 5100 (NPL)",
        vertical_depth: Range = 1.0,
        g: Range = 0.2,
        mu: Range = 0.3,
        point_spread: PointSpread = _PAPER,
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
    ) -> None:
        super().__init__()
        self.waters = weighed(waters)
        one = isinstance(cameras, (str, os.PathLike, Camera))
        self.cameras: list[Any] = [cameras] if one else list(cameras)  # type: ignore[arg-type]
        self.mixing = mixing
        self.visibility = visibility
        self.vertical_depth = vertical_depth
        self.g = g
        self.mu = mu
        self.point_spread = point_spread
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
        self._check_options()
        self._prepare()

    def _check_options(self) -> None:
        for name, allowed in _CHOICES.items():
            checks.one_of(name, getattr(self, name), allowed)
        for name in ("p", "field_probability"):
            checks.within(name, getattr(self, name), 0.0, 1.0)
        checks.tolerance(self.tolerance)
        checks.instance("point_spread", self.point_spread, PointSpread)
        defaults = inspect.signature(type(self)).parameters
        for name in ("near", "far", "gamma"):
            value = getattr(self, name)
            used = name in _SCALING[self.distance_kind]
            if not used and value != defaults[name].default:
                kind = f"distance_kind is {self.distance_kind!r}"
                raise ValueError(f"{name} would do nothing: {kind}, got {value}")

    def _prepare(self) -> None:
        """What all pictures share: spectra, what is drawn from, settings."""
        self.spectra = spectra_of(self.waters)
        self.responses = cameras_of(self.cameras)
        self._distribution = Distribution(
            waters=dict(zip(self.spectra, self.waters.values(), strict=True)),
            cameras=tuple(self.responses),
            ranges=self._ranges(),
            field_range=as_range("field_range", self.field_range),
            p=self.p,
            field_probability=self.field_probability,
        )
        self._settings = Settings(
            distance_kind=self.distance_kind,
            unknown=self.unknown,
            color_space=self.color_space,
            order=self.order,
            point_spread=self.point_spread,
            tolerance=self.tolerance,
            varied=Draw.varies(self._distribution.ranges),
        )
        # for compiled code, which takes no objects
        self._opaque_settings = self._settings.to_json()
        self._tables = {name: table(water) for name, water in self.spectra.items()}
        self._camera_tables = {name: table(camera) for name, camera in self.responses.items()}

    def _ranges(self) -> dict[str, tuple[float, float]]:
        """The ranges that are drawn from."""
        left_out = {"near", "far", "gamma"} - set(_SCALING[self.distance_kind])
        if self.visibility is None:
            left_out.add("visibility")
        if self.distance is None or callable(self.distance):
            left_out.add("distance")
        ranges = {}
        for name in RANGES:
            if name not in left_out:
                ranges[name] = as_range(name, getattr(self, name))
        if self.distance_kind != "metric":
            require_scaling(ranges, self.distance_kind)
        for water in self.spectra.values():
            require_visibility(water, ranges)
        return ranges

    @classmethod
    def severity(cls, level: int, **options: Any) -> "RandomUnderwater":
        """One of five grades, for robustness studies: visibility 20, 10, 5, 2.5, 1.25 m, in any of
        the coastal types and II. They take 46, 62, 75, 84, 93 % of the contrast from a scene at 2
        to 5 m.

        Args:
            level: 1 (mild) … 5 (severe).
            options: any other argument of the class.
        """
        if level not in (1, 2, 3, 4, 5):
            raise ValueError(f"level must be a whole number from 1 to 5, got {level!r}")
        visibility = 20.0 * 0.5 ** (level - 1)
        return cls(
            **{"waters": ("II", "1C", "3C", "5C", "7C", "9C"), "visibility": visibility, **options}
        )

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

    def transform(self, image: Tensor, distance: Tensor | None, params: Record) -> Tensor:
        """Degrade a picture or a batch as a record says: deterministic, bit for bit.

        To `torch.compile` it is one opaque operator, bit for bit as well and no faster. Each
        choice of waters and camera compiles a graph of its own; PyTorch keeps at most eight
        (`torch._dynamo.config.recompile_limit`).

        Args:
            image (3xHxW or Bx3xHxW tensor): uint8 or floating point.
            distance (1xHxW or Bx1xHxW tensor): of `distance_kind`; None where `distance` was given
                to the class.
            params: from `make_params`, of this or an equally configured transform; that of a single
                picture serves a whole batch.

        Returns:
            The degraded image, like `image`; `image` itself if the record leaves all of it alone.

        Raises:
            TypeError, ValueError: if an input does not suit, naming what came and what was
                expected.
        """
        plain = plain_image(image)
        images = plain if plain.ndim == 4 else plain[None]
        samples = self._distribution.samples(params, len(images))
        chosen = [i for i, sample in enumerate(samples) if sample["applied"]]
        maps = maps_for(plain, distance, chosen, self.distance)
        if not chosen:
            return image
        parts = list(images)
        for i, z in zip(chosen, maps, strict=True):
            names, camera, draw = samples[i]["waters"], samples[i]["camera"], Draw.of(samples[i])
            if torch.compiler.is_compiling():
                tables, lens = [self._tables[name] for name in names], self._camera_tables[camera]
                drawn, settings = draw.to_tensor(), self._opaque_settings
                parts[i] = degrade_opaque(parts[i], z, tables, lens, drawn, settings)
            else:
                waters, response = [self.spectra[name] for name in names], self.responses[camera]
                parts[i] = degrade(parts[i], z, waters, response, draw, self._settings)
        return typed(parts[0] if plain.ndim == 3 else torch.stack(parts), type(image))

    def at(self, seed: int, epoch: int, index: int) -> Callable[..., Any]:
        """The transform with randomness from a key: the same result in any worker, in any order.

        Args:
            seed, epoch, index: of the run, of the pass through the data, of the picture (or batch).

        Returns:
            A function of the same inputs as the transform, which draws the same at every call.
        """
        key = hashlib.blake2b(
            f"{int(seed)}/{int(epoch)}/{int(index)}".encode(), digest_size=4
        ).digest()
        return partial(self._apply_with, int.from_bytes(key))

    def _apply_with(self, key: int, *inputs: Any) -> Any:
        generator = torch.Generator().manual_seed(key)
        image, distance, rebuild = self._taken_apart(inputs)
        return rebuild(self.transform(image, distance, self.make_params(image, generator)))

    def forward(self, *inputs: Any) -> Any:
        """Draw and degrade; see the class."""
        image, distance, rebuild = self._taken_apart(inputs)
        return rebuild(self.transform(image, distance, self.make_params(image)))

    def _taken_apart(self, inputs: tuple[Any, ...]) -> tuple[Tensor, Any, Callable[[Tensor], Any]]:
        parts = take_apart(inputs, self.image_key, self.distance_key, mapped=self.distance is None)
        plain_image(parts.image)
        return parts

    def __repr__(self) -> str:
        waters = list(self.waters) if set(self.waters.values()) == {1} else self.waters
        shown = [repr(waters)] if waters != list(JERLOV_TYPES[1:]) else []
        for name, parameter in list(inspect.signature(type(self)).parameters.items())[1:]:
            value = getattr(self, name)
            if value not in (parameter.default, [parameter.default]):
                shown.append(f"{name}={value!r}")
        return f"{type(self).__name__}({', '.join(shown)})"
