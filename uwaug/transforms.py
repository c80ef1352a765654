"""`RandomUnderwater`: new water for every picture, in a DataLoader worker or on a whole batch."""

import copy
import hashlib
import inspect
import math
import os
from bisect import bisect
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache, partial
from itertools import accumulate
from numbers import Real
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor, nn

from uwaug.camera import Camera, load_camera
from uwaug.colour import linear_to_srgb, srgb_to_linear
from uwaug.distance import check_distance, from_inverse, from_relative
from uwaug.field import gaussian_random_field
from uwaug.formation import Order, check, form
from uwaug.medium import WAVELENGTHS, Medium, PointSpread
from uwaug.water import JERLOV_TYPES, Array, Water

Range = float | tuple[float, float]
Record = dict[str, Any]

_SHARE, _AMOUNT, _POSITIVE = (0.0, 1.0), (0.0, math.inf), (1e-3, math.inf)
_BOUNDS = {
    "mixing": _SHARE, "visibility": _POSITIVE, "vertical_depth": _AMOUNT, "g": _SHARE, "mu": _SHARE,
    "blur_factor": _AMOUNT, "near": _AMOUNT, "far": _AMOUNT, "gamma": _POSITIVE, "distance": _AMOUNT,
}  # fmt: skip
# What each picture draws a uniform number for. A new one goes to the end, so that keys of `at` keep their pictures.
_DRAWS = ("applied", "first", "second", "camera", "field", *_BOUNDS)
_SCALING = {"metric": (), "relative": ("near", "far", "gamma"), "inverse": ("near", "far")}
_TOUCHING = 1e-6  # m, for relative distance 0 with near = 0: in a map of metres 0 means unknown
_HDR_LIMIT = 16.0
_PAPER = PointSpread.paper()


class RandomUnderwater(nn.Module):
    """Degrade pictures in random waters.

    A range is a number or (low, high), drawn uniformly; visibility is drawn uniformly in its logarithm. The defaults
    are the figures of the paper's survey (its nine waters, g, mu, vertical depth, width law, field, and near, far and
    gamma for relative distance), but for its camera, a Nikon D90, and for its use of sRGB values as light, which
    `color_space="linear"` repeats.

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
        distance: where no map is given. None: that is an error. A number or a range: a plane at that distance, m. All
            of the picture gets one veil, one cast and one blur, but for the field: right for a flat scene that faces
            the camera; anywhere else the mark of water, that what is far fades first, is missing, and a network may
            learn a tint. A callable, such as a depth network: takes the image (3xHxW or Bx3xHxW, 0…1) and returns a
            map of `distance_kind`; it takes its own time for every picture, and its errors become wrong colours. With
            any of these a tuple holds no map: all that follows its image is left alone.
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
        distance_kind: Literal["metric", "relative", "inverse"] = "metric",
        near: Range = 1.0,
        far: Range = 5.0,
        gamma: Range = 1.0,
        distance: Range | Callable[[Tensor], Tensor] | None = None,
        p: float = 1.0,
        same_on_batch: bool = False,
        unknown: Literal["error", "fill"] = "error",
        image_key: str = "image",
        distance_key: str = "distance",
        tolerance: float = 0.002,
        color_space: Literal["srgb", "linear"] = "srgb",
        order: Order = "line_of_sight",
    ) -> None:
        super().__init__()
        self.waters = _weigh(waters)
        self.spectra = {w if isinstance(w, str) else w.name: _resample(w) for w in self.waters}
        one = isinstance(cameras, (str, os.PathLike, Camera))
        self.cameras: list[str | os.PathLike[str] | Camera] = [cameras] if one else list(cameras)  # type: ignore[arg-type, list-item]
        loaded = [load_camera(camera) for camera in self.cameras]
        self.responses = {camera.name: camera for camera in loaded}
        for name, given, kept in (("waters", self.waters, self.spectra), ("cameras", loaded, self.responses)):
            if not given or len(kept) < len(given):
                raise ValueError(f"{name}: expected at least one, each with a name of its own, got {list(given)}")
        self._water_tables = {n: _table(w.wavelengths, w.a, w.b, w.kd) for n, w in self.spectra.items()}
        self._camera_tables = {n: _table(c.wavelengths, *c.response.T) for n, c in self.responses.items()}
        for name, value, allowed in (
            ("distance_kind", distance_kind, tuple(_SCALING)),
            ("unknown", unknown, ("error", "fill")),
            ("color_space", color_space, ("srgb", "linear")),
            ("order", order, ("line_of_sight", "source")),
        ):
            if value not in allowed:
                raise ValueError(f"{name} must be one of {allowed}, got {value!r}")
        for name, share in (("p", p), ("field_probability", field_probability)):
            if not 0 <= share <= 1:
                raise ValueError(f"{name} must be a probability in [0, 1], got {share}")
        if not 0 < tolerance < 1:
            raise ValueError(f"tolerance must lie in (0, 1) (image scale 0…1), got {tolerance}")
        if not isinstance(point_spread, PointSpread):
            raise TypeError(f"point_spread must be a PointSpread, got {type(point_spread).__name__}")

        self.mixing, self.visibility, self.vertical_depth, self.g, self.mu = mixing, visibility, vertical_depth, g, mu
        self.point_spread, self.blur_factor = point_spread, blur_factor
        self.field_range, self.field_probability = field_range, field_probability
        self.distance_kind, self.near, self.far, self.gamma, self.distance = distance_kind, near, far, gamma, distance
        self.p, self.same_on_batch, self.unknown = p, same_on_batch, unknown
        self.image_key, self.distance_key = image_key, distance_key
        self.tolerance, self.color_space, self.order = tolerance, color_space, order

        self._field = _range("field_range", field_range, *_AMOUNT)
        left_out = {"visibility"} if visibility is None else set()
        left_out |= {"distance"} if distance is None or callable(distance) else set()
        for name, usual in (("near", 1.0), ("far", 5.0), ("gamma", 1.0)):
            if name not in _SCALING[distance_kind]:
                if (value := getattr(self, name)) != usual:
                    raise ValueError(f"{name} would do nothing: distance_kind is {distance_kind!r}, got {value}")
                left_out.add(name)
        self._ranges = {
            name: _range(name, getattr(self, name), *bounds) for name, bounds in _BOUNDS.items() if name not in left_out
        }
        if distance_kind != "metric" and self._ranges["near"][1] >= self._ranges["far"][0]:
            raise ValueError(f"near must lie below far, got near = {near} and far = {far} in metres")
        if distance_kind == "inverse" and self._ranges["near"][0] == 0:
            raise ValueError(f"near must lie above 0 m where distance_kind is 'inverse', got {near}")
        for water in self.spectra.values():
            for metres in self._ranges.get("visibility", ()):
                try:
                    water.with_visibility(metres)
                except ValueError as error:
                    raise ValueError(f"visibility={visibility} does not suit water {water.name!r}: {error}") from None

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
        return {"samples": [self._sample(dict(zip(_DRAWS, u)), seed) for u, seed in zip(uniform, seeds)]}

    def _sample(self, u: dict[str, float], seed: int) -> Record:
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
        maps: Sequence[Tensor | None] = [None] * len(chosen)
        if distance is not None:
            given = _maps(distance, images)
            maps = [given[i] for i in chosen]
        elif self.distance is None:
            raise ValueError(
                "distance is missing: give a map, or RandomUnderwater(distance=…) a constant, a range or a callable"
            )
        elif callable(self.distance) and chosen:
            seen = images[chosen]
            with torch.no_grad():
                maps = list(_maps(self.distance(_unit(plain if plain.ndim == 3 else seen)), seen))
        if not chosen:
            return image
        parts = list(images)
        for i, z in zip(chosen, maps):
            parts[i] = self._degrade(parts[i], z, samples[i])
        return _typed(parts[0] if plain.ndim == 3 else torch.stack(parts), type(image))

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
                raise ValueError(
                    f"params is of a transform with other options: they differ in {', '.join(sorted(odd))}"
                )
            for name, known in [(w, self.spectra) for w in sample["waters"]] + [(sample["camera"], self.responses)]:
                if name not in known:
                    raise ValueError(f"params asks for {name!r}, but this transform has {', '.join(known)}")
        return samples * batch if len(samples) < batch else samples

    def _degrade(self, image: Tensor, distance: Tensor | None, sample: Record) -> Tensor:
        law, (low, high) = self.point_spread, sample["field_range"]
        numbers = {name: sample[name] for name in ("field_seed", *self._ranges) if sample[name] is not None}
        numbers |= {"low": low, "high": high, "tolerance": self.tolerance, "scale": law.scale, "exponent": law.exponent}
        if law.reference_size is not None:
            numbers["reference_size"] = law.reference_size
        modes = (self.distance_kind, self.unknown, self.color_space, self.order, law.shape)
        if not torch.compiler.is_compiling():
            waters = [self.spectra[name] for name in sample["waters"]]
            return _degrade(image, distance, waters, self.responses[sample["camera"]], numbers, modes)
        one = torch.ones((), dtype=torch.float64)
        values = torch.stack([one * value for value in numbers.values()])  # torch.tensor(…) would fix them in the graph
        tables = [*(self._water_tables[name] for name in sample["waters"]), self._camera_tables[sample["camera"]]]
        result: Tensor = _degrade_opaque(image, distance, tables, " ".join(numbers), values, " ".join(modes))
        return result

    def at(self, seed: int, epoch: int, index: int) -> Callable[..., Any]:
        """The transform with randomness from a key: the same result in any worker, in any order.

        Args:
            seed, epoch, index: of the run, of the pass through the data, of the picture (or batch).

        Returns:
            A function of the same inputs as the transform, which draws the same at every call.
        """
        key = hashlib.blake2b(f"{int(seed)}/{int(epoch)}/{int(index)}".encode(), digest_size=4).digest()
        return partial(self._run, int.from_bytes(key))

    def forward(self, *inputs: Any) -> Any:
        """Draw and degrade; see the class."""
        return self._run(None, *inputs)

    def _run(self, key: int | None, *inputs: Any) -> Any:
        generator = None if key is None else torch.Generator().manual_seed(key)
        if len(inputs) == 1 and isinstance(inputs[0], Mapping):
            result: Any = copy.copy(inputs[0])
            for name in (self.image_key, self.distance_key):
                if name not in result and (name == self.image_key or self.distance is None):
                    there = ", ".join(map(repr, result))
                    raise ValueError(f"sample has no {name!r}, only {there}: see image_key, distance_key and distance")
            result[self.image_key] = self._draw(result[self.image_key], result.get(self.distance_key), generator)
            return result
        if len(inputs) == 1 and not isinstance(inputs[0], (tuple, list)):
            return self._draw(inputs[0], None, generator)
        leaves = inputs[0] if len(inputs) == 1 else inputs
        if not leaves:
            raise ValueError("sample is empty: expected (image, distance, …)")
        distance = leaves[1] if len(leaves) > 1 and self.distance is None else None
        values = (self._draw(leaves[0], distance, generator), *leaves[1:])
        return type(leaves)(*values) if hasattr(leaves, "_fields") else type(leaves)(values)

    def _draw(self, image: Any, distance: Any, generator: torch.Generator | None) -> Tensor:
        _picture(image)
        return self.transform(image, distance, self.make_params(image, generator))

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
    low, high = water.wavelengths[[0, -1]]
    return water.at(WAVELENGTHS[(low <= WAVELENGTHS) & (high >= WAVELENGTHS)])


def _table(*columns: Array) -> Tensor:
    return torch.from_numpy(np.array(columns))


def _range(name: str, value: Any, least: float, most: float) -> tuple[float, float]:
    try:
        low, high = map(float, (value, value) if isinstance(value, Real) else value)
        if least <= low <= high <= most and high < math.inf:
            return low, high
    except (TypeError, ValueError):
        pass
    bounds = f"in [{least:g}, {most:g}]" if most < math.inf else f"finite and ≥ {least:g}"
    raise ValueError(f"{name} must be a number or a range (low, high) with low ≤ high, {bounds}; got {value!r}")


def _typed(x: Tensor, wanted: type[Tensor]) -> Tensor:
    return x if type(x) is wanted else x.as_subclass(wanted)


def _unit(image: Tensor) -> Tensor:
    return image / 255 if image.dtype == torch.uint8 else image


def _picture(image: Any) -> Tensor:
    """Check an image's type and shape; return it as a plain tensor."""
    if not isinstance(image, Tensor) or not (image.is_floating_point() or image.dtype == torch.uint8):
        got = image.dtype if isinstance(image, Tensor) else type(image).__name__
        raise TypeError(
            f"image must be a uint8 or floating-point tensor, got {got}; convert PIL images and arrays first"
        )
    if image.ndim not in (3, 4) or image.shape[-3] != 3:
        raise ValueError(f"image must have shape (3, H, W) or (B, 3, H, W), got {tuple(image.shape)}")
    return _typed(image, Tensor)


def _maps(distance: Any, images: Tensor) -> Tensor:
    """Check a map of distances; return one for each image (Bx1xHxW), as a plain tensor."""
    if not isinstance(distance, Tensor) or not distance.is_floating_point():
        got = distance.dtype if isinstance(distance, Tensor) else type(distance).__name__
        raise TypeError(f"distance must be a floating-point tensor, got {got}; divide a map in millimetres by 1000")
    maps, batch, size = _typed(distance, Tensor), len(images), images.shape[-2:]
    if maps.ndim not in (3, 4) or maps.shape[-3] != 1:
        raise ValueError(f"distance must have shape (1, H, W) or (B, 1, H, W), got {tuple(maps.shape)}")
    if maps.shape[-2:] != size:
        raise ValueError(
            f"distance is {tuple(maps.shape[-2:])} but image is {tuple(size)}: height and width must agree"
        )
    maps = maps if maps.ndim == 4 else maps[None]
    if len(maps) not in (1, batch):
        raise ValueError(f"distance is a batch of {len(maps)} but image is one of {batch}")
    return maps.expand(batch, -1, -1, -1)


def _metres(distance: Tensor, kind: str, unknown: str, numbers: Mapping[str, Any]) -> Tensor:
    if kind == "relative":
        distance = from_relative(distance, max(numbers["near"], _TOUCHING), numbers["far"], numbers["gamma"])
    elif kind == "inverse":
        distance = from_inverse(distance, numbers["near"], numbers["far"])
    try:
        return check_distance(distance, strict=unknown == "error")
    except ValueError as error:
        hint = "; or use RandomUnderwater(unknown='fill')" if unknown == "error" else ""
        raise ValueError(f"{error}{hint}") from None


@contextmanager
def _one_thread() -> Iterator[None]:
    """As in a DataLoader worker. Where threads divide an array decides which elements are not computed as vectors,
    and those of exp2 and pow differ in the last bit: more threads would not replay what a worker has drawn.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _degrade(
    image: Tensor,
    distance: Tensor | None,
    waters: Sequence[Water],
    camera: Camera,
    numbers: Mapping[str, Any],
    modes: Sequence[Any],
) -> Tensor:
    """The whole transform of one picture (3xHxW), from what was drawn and what the transform is set to."""
    kind, unknown, color_space, order, shape = modes
    with _one_thread(), torch.no_grad(), torch.autocast(image.device.type, enabled=False):
        unit = _unit(image)
        if unit.numel() and unit.amax() > _HDR_LIMIT:
            raise ValueError(f"image reaches {float(unit.amax()):g}: expected 0…1; divide a 0…255 image by 255")
        if distance is None:
            z = torch.full_like(unit[:1], numbers["distance"], dtype=torch.promote_types(unit.dtype, torch.float32))
        else:
            z = _metres(distance, kind, unknown, numbers)
        field = None
        if "field_seed" in numbers:
            generator = torch.Generator().manual_seed(int(numbers["field_seed"]))
            field = gaussian_random_field(z.shape[-2:], low=numbers["low"], high=numbers["high"], generator=generator)
            field = field.to(z.device)
        scale = numbers["scale"] * numbers["blur_factor"]
        law = PointSpread(scale, numbers["exponent"], shape, numbers.get("reference_size"))
        drawn = (numbers.get(name) for name in ("mixing", "visibility", "vertical_depth", "g", "mu", "tolerance"))
        medium = _medium(tuple(waters), camera, law, *drawn)
        picture, z, medium = check(unit, z, medium, field, order)
        picture = srgb_to_linear(picture) if color_space == "srgb" else picture
        (result,) = form(picture, z, medium, order, numbers["tolerance"], None, total=True)
        result = linear_to_srgb(result)[0] if color_space == "srgb" else result[0]
        if image.dtype == torch.uint8:
            return (result * 255).round_().clamp_(0, 255).to(torch.uint8)
        return result.to(image.dtype)


@lru_cache(maxsize=256)
def _medium(waters: tuple[Water, ...], camera: Camera, law: PointSpread, *drawn: Any) -> Medium:
    mixing, visibility, vertical_depth, g, mu, tolerance = drawn
    water = waters[0].mix(waters[1], mixing) if len(waters) > 1 else waters[0]
    water = water if visibility is None else water.with_visibility(visibility)
    return Medium.from_water(
        water, camera, vertical_depth=vertical_depth, g=g, mu=mu, point_spread=law, tolerance=tolerance
    )


@torch.library.custom_op(
    "uwaug::random_underwater",
    mutates_args=(),
    schema="(Tensor image, Tensor? distance, Tensor[] tables, str names, Tensor values, str modes) -> Tensor",
)
def _degrade_opaque(
    image: Tensor, distance: Tensor | None, tables: list[Tensor], names: str, values: Tensor, modes: str
) -> Tensor:
    """`_degrade` for compiled code. What is drawn comes as tensors, or a graph would hold for one record alone."""
    *waters, (wavelengths, *response) = (table.numpy() for table in tables)
    camera = Camera(wavelengths, np.array(response).T)
    numbers = dict(zip(names.split(), values.tolist()))
    return _degrade(image, distance, [Water(*table) for table in waters], camera, numbers, modes.split())


@_degrade_opaque.register_fake
def _(image: Tensor, *_: Any) -> Tensor:
    return torch.empty_like(image, memory_format=torch.contiguous_format)
