"""`RandomUnderwater`: new water for every picture, in a DataLoader worker or on a whole batch."""

import copy
import hashlib
import inspect
import math
import os
from bisect import bisect
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import accumulate
from numbers import Real
from typing import Any, get_args

import torch
from torch import Tensor, nn

from uwaug import checks
from uwaug.camera import Camera, load_camera
from uwaug.checks import DOMAIN
from uwaug.colour import ColorSpace
from uwaug.degrade import DistanceKind, Draw, Settings, Unknown, degrade, degrade_opaque, spectra_table
from uwaug.formation import Order
from uwaug.medium import PointSpread, default_bands
from uwaug.water import JERLOV_TYPES, Water

__all__ = ["RandomUnderwater"]

Range = float | tuple[float, float]
Record = dict[str, Any]

_RANGES = (
    "mixing", "visibility", "vertical_depth", "g", "mu", "blur_factor", "near", "far", "gamma", "distance",
)  # fmt: skip
# What each picture draws a uniform number for. A new one goes to the end, so that keys of `at` keep their pictures.
_DRAWS = ("applied", "first", "second", "camera", "field", *_RANGES)
_SCALING = {"metric": (), "relative": ("near", "far", "gamma"), "inverse": ("near", "far")}
_PAPER = PointSpread.paper()


class RandomUnderwater(nn.Module):
    """Degrade pictures in random waters.

    A range is a number or (low, high), drawn uniformly; visibility is drawn uniformly in its logarithm. The defaults
    are the figures of the paper's survey (its nine waters, g, mu, vertical depth, width law, field, and near, far and
    gamma for relative distance). Two defaults differ from the survey: the camera (the paper used a Nikon D90) and the
    colour space (the paper treats sRGB values as linear light; `color_space="linear"` does the same).

    Args:
        waters: Jerlov types or `Water` objects, drawn with equal weight (one that is given twice counts twice); or a
            mapping to weights.
        mixing: share of a second water, drawn like the first; 0 for none, (0, 1) for a continuous slider between types.
        visibility: m; scale the water to this visibility, or None to leave it. See `Water.with_visibility`.
        cameras: names, CSV files or `Camera` objects, drawn with equal weight.
        vertical_depth: m below the surface.
        g: share of the scattered light that leaves the line of sight, 0…1.
        mu: share of the scattered light sent towards the camera, 0…1.
        point_spread: width law of the forward scatter.
        blur_factor: multiplies the scale of the width law.
        field_range: least and largest value of the medium field, which is drawn anew for each picture.
        field_probability: how often the water is uneven; else the field is 1.
        distance_kind: what a distance map holds. "metric": metres along the ray; nothing is invented. "relative": 0…1,
            0 = near, mapped to near + (far − near)·t^gamma: order and proportions of the scene are right, its size is
            drawn. "inverse": what monocular networks give, large = near, of unknown scale and shift: every map is
            stretched to reach from near to far, even that of a flat scene.
        near, far, gamma: m, m and exponent for "relative" and "inverse" (gamma for "relative" alone).
        distance: where no map is given. None: that is an error. A number or a range: a plane at that distance, m. The
            whole picture gets one veil, cast and blur. That suits a flat scene facing the camera. Elsewhere the depth
            cue is lost (far objects should fade first), and a network may learn only the tint. A callable, such as a
            depth network: takes the image (3xHxW or Bx3xHxW, 0…1) and returns a map of `distance_kind`; it takes its
            own time for every picture, and its errors become wrong colours. With any of these a tuple holds no map:
            all that follows its image is left alone.
        p: probability that a picture is degraded at all.
        same_on_batch: draw once for a batch.
        unknown: what NaN, 0 or negative metres get (NaN, in relative and inverse maps). "error": an error. "fill": the
            nearest known distance (12 ms at 500×741). Geometric transforms pad with 0: in maps that are not metric,
            where 0 is a distance, let them pad with NaN.
        image_key, distance_key: where to find the two in a dict.
        tolerance, color_space, order: as for `uwaug.Underwater`.

    Inputs:
        (image, distance, …), a tuple or list of them, or a dict. One picture (3xHxW, distance 1xHxW) or a batch, whose
        pictures may share one map; uint8 (0…255) or floating point (0…1); plain tensors or torchvision's tv_tensors (a
        distance map is best a `Mask`). The same structure comes back with a new image of the same type; every other
        leaf is returned as it is, and no input is changed. Gradients end here; `uwaug.Underwater` passes them on.

    Randomness comes from torch's global generator, which a DataLoader seeds for each worker and epoch; `at` draws from
    a key instead. Place the transform before normalisation, and after resizing and cropping: a width law with a
    reference size, such as the default, takes the picture that it gets for the whole view.

    Raises:
        TypeError, ValueError: if an option or an input does not suit, naming what came and what was expected.

    Examples:
        >>> import torch
        >>> aug = RandomUnderwater(["1C", "7C"], visibility=(2.0, 10.0))
        >>> aug
        RandomUnderwater(['1C', '7C'], visibility=(2.0, 10.0))
        >>> image, distance = torch.rand(3, 32, 48), torch.full((1, 32, 48), 3.0)
        >>> degraded, _ = aug(image, distance)
        >>> record = aug.make_params(image)
        >>> torch.equal(aug.transform(image, distance, record), aug.transform(image, distance, record))
        True
    """

    def __init__(
        self,
        waters: str | Water | Mapping[str | Water, float] | Iterable[str | Water] = JERLOV_TYPES[1:],
        *,
        mixing: Range = 0.0,
        visibility: Range | None = None,
        cameras: str | os.PathLike[str] | Camera | Iterable[str | os.PathLike[str] | Camera] = "Nikon 5100 (NPL)",
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
        self.waters = _weigh(waters)
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
        self._settle()

    def _settle(self) -> None:
        """Check the options, and prepare what all pictures share."""
        for name, kind in (("distance_kind", DistanceKind), ("unknown", Unknown), ("color_space", ColorSpace)):
            checks.one_of(name, getattr(self, name), get_args(kind))
        checks.one_of("order", self.order, get_args(Order))
        for name in ("p", "field_probability"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be a probability in [0, 1], got {getattr(self, name)}")
        checks.tolerance(self.tolerance)
        if not isinstance(self.point_spread, PointSpread):
            raise TypeError(f"point_spread must be a PointSpread, got {type(self.point_spread).__name__}")
        self._settings = Settings(
            self.distance_kind, self.unknown, self.color_space, self.order, self.point_spread, self.tolerance
        )
        self._opaque_settings = self._settings.to_json()
        self.spectra = {w if isinstance(w, str) else w.name: _resample(w) for w in self.waters}
        loaded = [load_camera(camera) for camera in self.cameras]
        self.responses = {camera.name: camera for camera in loaded}
        for name, given, kept in (("waters", list(self.waters), self.spectra), ("cameras", loaded, self.responses)):
            if not given or len(kept) < len(given):
                raise ValueError(f"{name}: expected at least one, each with a name of its own, got {given}")
        self._water_tables = {n: spectra_table(w.wavelengths, w.a, w.b, w.kd) for n, w in self.spectra.items()}
        self._camera_tables = {n: spectra_table(c.wavelengths, *c.response.T) for n, c in self.responses.items()}
        self._field = _range("field_range", self.field_range)
        self._ranges = self._settled_ranges()

    def _settled_ranges(self) -> dict[str, tuple[float, float]]:
        """The ranges that are drawn from, (low, high) each."""
        left_out = {"visibility"} if self.visibility is None else set()
        if self.distance is None or callable(self.distance):
            left_out.add("distance")
        defaults = inspect.signature(type(self)).parameters
        for name in ("near", "far", "gamma"):
            if name in _SCALING[self.distance_kind]:
                continue
            value = getattr(self, name)
            if value != defaults[name].default:
                raise ValueError(f"{name} would do nothing: distance_kind is {self.distance_kind!r}, got {value}")
            left_out.add(name)
        ranges = {name: _range(name, getattr(self, name)) for name in _RANGES if name not in left_out}
        if self.distance_kind != "metric" and ranges["near"][1] >= ranges["far"][0]:
            raise ValueError(f"near must lie below far, got near = {self.near} and far = {self.far} in metres")
        if self.distance_kind == "inverse" and ranges["near"][0] == 0:
            raise ValueError(f"near must lie above 0 m where distance_kind is 'inverse', got {self.near}")
        for water in self.spectra.values():
            for metres in ranges.get("visibility", ()):
                _require_visibility(water, metres, self.visibility)
        return ranges

    @classmethod
    def severity(cls, level: int, **options: Any) -> "RandomUnderwater":
        """One of five grades, for robustness studies: visibility 20, 10, 5, 2.5, 1.25 m, in any of the coastal types
        and II. They take 46, 62, 75, 84, 93 % of the contrast from a scene at 2 to 5 m.

        Args:
            level: 1 (mild) … 5 (severe).
            options: any other argument of the class.
        """
        if level not in (1, 2, 3, 4, 5):
            raise ValueError(f"level must be a whole number from 1 to 5, got {level!r}")
        visibility = 20.0 * 0.5 ** (level - 1)
        return cls(**{"waters": ("II", "1C", "3C", "5C", "7C", "9C"), "visibility": visibility, **options})

    def make_params(self, image: Tensor, generator: torch.Generator | None = None) -> Record:
        """Draw everything that is random, for a picture or a batch of this shape.

        Args:
            image (3xHxW or Bx3xHxW tensor): only its shape is read.
            generator: source of randomness; torch's global generator if None.

        Returns:
            A plain record, {"samples": [one dict for each picture]}, that can be pickled and written as JSON.
        """
        batch = 1 if image.ndim == 3 or self.same_on_batch else len(image)
        # 32 bits: all that a generator of torch takes from a seed
        seeds = torch.randint(2**32, (batch,), generator=generator).tolist()
        uniform = torch.rand(len(_DRAWS), batch, generator=generator, dtype=torch.float64).T.tolist()
        samples = []
        for numbers, seed in zip(uniform, seeds, strict=True):
            samples.append(self._sample(dict(zip(_DRAWS, numbers, strict=False)), seed))
        return {"samples": samples}

    def _sample(self, u: Mapping[str, float], seed: int) -> Record:
        names, weights = list(self.spectra), list(accumulate(self.waters.values()))
        two = ("first", "second") if self._ranges["mixing"][1] > 0 else ("first",)
        record: Record = {
            "applied": u["applied"] < self.p,
            "waters": [names[bisect(weights, u[which] * weights[-1])] for which in two],
            "camera": list(self.responses)[int(u["camera"] * len(self.responses))],
            "field_seed": seed if u["field"] < self.field_probability else None,
            "field_range": list(self._field),
        }
        for name, (low, high) in self._ranges.items():
            geometric = name == "visibility"
            record[name] = low * (high / low) ** u[name] if geometric else low + (high - low) * u[name]
        return record

    def transform(self, image: Tensor, distance: Tensor | None, params: Record) -> Tensor:
        """Degrade a picture or a batch as a record says: deterministic, bit for bit.

        To `torch.compile` it is one opaque operator, bit for bit as well and no faster. A graph is for one choice of
        waters and camera, and PyTorch makes eight at most (`torch._dynamo.config.recompile_limit`).

        Args:
            image (3xHxW or Bx3xHxW tensor): uint8 or floating point.
            distance (1xHxW or Bx1xHxW tensor): of `distance_kind`; None where `distance` was given to the class.
            params: from `make_params`, of this or an equally configured transform; that of a single picture serves a
                whole batch.

        Returns:
            The degraded image, like `image`; `image` itself if the record leaves all of it alone.

        Raises:
            TypeError, ValueError: if an input does not suit, naming what came and what was expected.
        """
        plain = _picture(image)
        images = plain if plain.ndim == 4 else plain[None]
        samples = self._samples(params, len(images))
        chosen = [i for i, sample in enumerate(samples) if sample["applied"]]
        maps = self._maps(plain, distance, chosen)
        if not chosen:
            return image
        parts = list(images)
        for i, z in zip(chosen, maps, strict=True):
            sample = samples[i]
            names, camera, draw = sample["waters"], sample["camera"], Draw.of(sample)
            if torch.compiler.is_compiling():
                tables = [self._water_tables[name] for name in names]
                lens = self._camera_tables[camera]
                parts[i] = degrade_opaque(parts[i], z, tables, lens, draw.to_tensor(), self._opaque_settings)
            else:
                waters = [self.spectra[name] for name in names]
                parts[i] = degrade(parts[i], z, waters, self.responses[camera], draw, self._settings)
        return _typed(parts[0] if plain.ndim == 3 else torch.stack(parts), type(image))

    def _maps(self, image: Tensor, distance: Tensor | None, chosen: list[int]) -> Sequence[Tensor | None]:
        """A map for each picture that is to be degraded; None where a plane is."""
        batch = image if image.ndim == 4 else image[None]
        if distance is not None:
            maps = _require_maps(distance, batch)
            return [maps[i] for i in chosen]
        if self.distance is None:
            raise ValueError(
                "distance is missing: give a map, or RandomUnderwater(distance=…) a constant, a range or a callable"
            )
        if not callable(self.distance) or not chosen:
            return [None] * len(chosen)
        seen = batch[chosen]
        unit = image if image.ndim == 3 else seen
        with torch.no_grad():
            return list(_require_maps(self.distance(unit / 255 if unit.dtype == torch.uint8 else unit), seen))

    def _samples(self, params: Any, batch: int) -> list[Record]:
        """A record's sample for each picture, if they suit this transform."""
        if not isinstance(params, Mapping) or "samples" not in params:
            raise TypeError(f"params must be a record from make_params, {{'samples': […]}}, got {params!r:.80}")
        samples: list[Record] = params["samples"]
        if len(samples) not in (1, batch):
            raise ValueError(f"params has {len(samples)} samples but image is a batch of {batch}")
        wanted = {"applied", "waters", "camera", "field_seed", "field_range", *self._ranges}
        for sample in samples:
            if odd := wanted ^ set(sample):
                names = ", ".join(sorted(odd))
                raise ValueError(f"params is of a transform with other options: they differ in {names}")
            _require_known(sample["waters"], self.spectra)
            _require_known([sample["camera"]], self.responses)
        return samples * batch if len(samples) < batch else samples

    def at(self, seed: int, epoch: int, index: int) -> Callable[..., Any]:
        """The transform with randomness from a key: the same result in any worker, in any order.

        Args:
            seed, epoch, index: of the run, of the pass through the data, of the picture (or batch).

        Returns:
            A function of the same inputs as the transform, which draws the same at every call.
        """
        key = hashlib.blake2b(f"{int(seed)}/{int(epoch)}/{int(index)}".encode(), digest_size=4).digest()
        return partial(self._apply_to, int.from_bytes(key))

    def forward(self, *inputs: Any) -> Any:
        """Draw and degrade; see the class."""
        image, distance, rebuild = self._taken_apart(inputs)
        return rebuild(self.transform(image, distance, self.make_params(_picture(image))))

    def _apply_to(self, key: int, *inputs: Any) -> Any:
        generator = torch.Generator().manual_seed(key)
        image, distance, rebuild = self._taken_apart(inputs)
        return rebuild(self.transform(image, distance, self.make_params(_picture(image), generator)))

    def _taken_apart(self, inputs: tuple[Any, ...]) -> tuple[Any, Any, Callable[[Tensor], Any]]:
        """The image, the map if there is one, and what puts a new image in the image's place."""
        sample = inputs[0] if len(inputs) == 1 else inputs
        if isinstance(sample, Mapping):
            for name in (self.image_key, self.distance_key):
                if name not in sample and (name == self.image_key or self.distance is None):
                    there = ", ".join(map(repr, sample))
                    raise ValueError(f"sample has no {name!r}, only {there}: see image_key, distance_key and distance")
            return sample[self.image_key], sample.get(self.distance_key), partial(_with_key, sample, self.image_key)
        if not isinstance(sample, (tuple, list)):
            return sample, None, lambda result: result
        if not sample:
            raise ValueError("sample is empty: expected (image, distance, …)")
        distance = sample[1] if len(sample) > 1 and self.distance is None else None
        return sample[0], distance, partial(_with_first, sample)

    def __repr__(self) -> str:
        waters = list(self.waters) if set(self.waters.values()) == {1} else self.waters
        shown = [repr(waters)] if waters != list(JERLOV_TYPES[1:]) else []
        for name, parameter in list(inspect.signature(type(self)).parameters.items())[1:]:
            value = getattr(self, name)
            if value not in (parameter.default, [parameter.default]):
                shown.append(f"{name}={value!r}")
        return f"{type(self).__name__}({', '.join(shown)})"


def _weigh(waters: Any) -> dict[str | Water, float]:
    if not isinstance(waters, Mapping):
        waters = Counter([waters] if isinstance(waters, (str, Water)) else waters)
    weights = list(waters.values())
    if weights and not (min(weights) >= 0 and 0 < sum(weights) < math.inf):
        raise ValueError(f"waters: expected weights ≥ 0 with a positive sum, got {weights}")
    return dict(waters)


def _resample(water: str | Water) -> Water:
    """The water at the bands that media are made from, so that mixing and scaling need no interpolation."""
    water = Water.jerlov(water) if isinstance(water, str) else water
    return water.at(default_bands(water))


def _range(name: str, value: Any) -> tuple[float, float]:
    """A number or (low, high) as (low, high), inside the domain of that name."""
    least, most = DOMAIN[name]
    try:
        low, high = map(float, (value, value) if isinstance(value, Real) else value)
        if least <= low <= high <= most and high < math.inf:
            return low, high
    except (TypeError, ValueError):
        pass
    bounds = f"in [{least:g}, {most:g}]" if most < math.inf else f"finite and ≥ {least:g}"
    raise ValueError(f"{name} must be a number or a range (low, high) with low ≤ high, {bounds}; got {value!r}")


def _require_visibility(water: Water, metres: float, given: Any) -> None:
    try:
        water.with_visibility(metres)
    except ValueError as error:
        raise ValueError(f"visibility={given} does not suit water {water.name!r}: {error}") from None


def _require_known(names: Iterable[str], known: Iterable[str]) -> None:
    for name in names:
        if name not in known:
            raise ValueError(f"params asks for {name!r}, but this transform has {', '.join(known)}")


def _with_key(sample: Any, key: str, result: Tensor) -> Any:
    """A copy of a dict with another image."""
    changed = copy.copy(sample)
    changed[key] = result
    return changed


def _with_first(sample: Any, result: Tensor) -> Any:
    """The same tuple, named tuple or list with another first leaf."""
    leaves = (result, *sample[1:])
    return type(sample)(*leaves) if hasattr(sample, "_fields") else type(sample)(leaves)


def _typed(x: Tensor, wanted: type[Tensor]) -> Tensor:
    return x if type(x) is wanted else x.as_subclass(wanted)


def _picture(image: Any) -> Tensor:
    """Check an image's type and shape; return it as a plain tensor."""
    if not isinstance(image, Tensor) or not (image.is_floating_point() or image.dtype == torch.uint8):
        got = image.dtype if isinstance(image, Tensor) else type(image).__name__
        raise TypeError(
            f"image must be a uint8 or floating-point tensor, got {got}; convert PIL images and arrays first"
        )
    checks.picture("image", image, 3)
    return _typed(image, Tensor)


def _require_maps(distance: Any, images: Tensor) -> Tensor:
    """Check a map of distances; return one for each image (Bx1xHxW), as a plain tensor."""
    checks.floating("distance", distance, "; divide a map in millimetres by 1000")
    checks.picture("distance", distance, 1)
    checks.same_size("distance", distance, images)
    maps, batch = _typed(distance, Tensor), len(images)
    maps = maps if maps.ndim == 4 else maps[None]
    if len(maps) not in (1, batch):
        raise ValueError(f"distance is a batch of {len(maps)} but image is one of {batch}")
    return maps.expand(batch, -1, -1, -1)
