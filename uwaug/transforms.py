"""`RandomUnderwater`: new water for every picture, in a DataLoader worker or on a whole batch."""

import hashlib
import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, Literal

import torch
from torch import Tensor, nn

from uwaug.blur import BlurPlan
from uwaug.camera import Camera, load_camera
from uwaug.colour import linear_to_srgb, srgb_to_linear
from uwaug.distance import check_distance, from_inverse, from_relative
from uwaug.field import gaussian_random_field
from uwaug.formation import Order, blur_demand, check, form
from uwaug.medium import WAVELENGTHS, Medium, PointSpread, assemble
from uwaug.water import JERLOV_TYPES, Water

Range = float | tuple[float, float]
Record = dict[str, Any]

_HDR_LIMIT = 16.0
COMPILED_RANGE = (0.1, 20.0)  # m: effective distances that a compiled transform plans its blur for
_DRAWS = 15  # uniform numbers per sample; a new one goes to the end, so that old seeds keep their pictures


class RandomUnderwater(nn.Module):
    """Degrade pictures in random waters.

    Ranges are a number or (low, high), drawn uniformly; visibility is drawn uniformly in its logarithm. Defaults are
    those of the paper's survey pictures.

    Args:
        waters: names of Jerlov types or `Water` objects, drawn with equal weight; or a mapping to weights.
        mixing: share of a second water, drawn like the first; 0 for none, (0, 1) for a continuous slider between types.
        visibility: m; scale the water to this visibility, or None to leave it. See `Water.with_visibility`.
        cameras: names, CSV files or `Camera` objects, drawn with equal weight.
        vertical_depth: m below the surface.
        g: share of the scattered light that leaves the line of sight, 0…1.
        mu: share of the scattered light sent towards the camera, 0…1.
        point_spread: width law of the forward scatter.
        blur_factor: multiplies the scale of the width law.
        field_range: least and largest value of the medium field, drawn anew for each picture.
        field_probability: of uneven water.
        distance_kind: what a distance map holds. "metric": metres along the ray. "relative": 0…1, 0 = near, mapped to
            near + (far − near)·t^gamma. "inverse": what monocular networks give, large = near, mapped to near…far.
        near, far, gamma: m, m and exponent for "relative" and "inverse" (gamma for "relative" alone).
        distance: what to use where no map is given. None: an error. A number or a range: a plane at that distance, m;
            the veil then hides all parts alike and nothing is blurred more than the rest. A callable: gets the image
            (3xHxW or Bx3xHxW, 0…1) and returns a map of `distance_kind`; a depth network costs its own time and gives
            relative distance only.
        p: probability that a picture is degraded at all.
        same_on_batch: draw once for a batch.
        unknown: "error", or "fill" to give unknown pixels (NaN, ≤ 0) the nearest known distance (12 ms at 500×741).
        image_key, distance_key: where to find the two in a dict sample.
        tolerance, color_space, order: as for `uwaug.Underwater`.

    Inputs:
        (image, distance, …), a tuple or list of them, or a dict. One picture (3xHxW, distance 1xHxW) or a batch; uint8
        (0…255) or floating point (0…1); plain tensors or torchvision's tv_tensors (a distance map is best a `Mask`).
        The same structure comes back with a new image of the same type; every other leaf is returned as it is, and no
        input is changed.

    Randomness comes from torch's global generator, which a DataLoader seeds for each worker and epoch; `at` draws from
    a key instead. Place the transform before normalisation and after resizing; a width law with a reference size scales
    with the image.

    Examples:
        >>> import torch
        >>> aug = RandomUnderwater(["1C", "7C"], visibility=(2.0, 10.0))
        >>> image, distance = torch.rand(3, 32, 48), torch.full((1, 32, 48), 3.0)
        >>> degraded, _ = aug(image, distance)
        >>> record = aug.make_params(image)
        >>> torch.equal(aug.transform(image, distance, record), aug.transform(image, distance, record))
        True
    """

    def __init__(
        self,
        waters: Mapping[str | Water, float] | Iterable[str | Water] = JERLOV_TYPES,
        *,
        mixing: Range = 0.0,
        visibility: Range | None = None,
        cameras: Sequence[str | Camera] = ("Nikon 5100 (NPL)",),
        vertical_depth: Range = 1.0,
        g: Range = 0.2,
        mu: Range = 0.3,
        point_spread: PointSpread | None = None,
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
        weighted = dict(waters) if isinstance(waters, Mapping) else dict.fromkeys(waters, 1.0)
        if not weighted:
            raise ValueError("waters is empty: expected at least one Jerlov type or Water")
        if min(weighted.values()) < 0 or not 0 < sum(weighted.values()) < math.inf:
            raise ValueError(f"waters: expected weights ≥ 0 with a positive sum, got {list(weighted.values())}")
        self.waters = weighted
        self.spectra = {water if isinstance(water, str) else water.name: _resample(water) for water in weighted}
        if len(self.spectra) < len(weighted):
            raise ValueError("waters: each water needs a name of its own")
        if not cameras:
            raise ValueError("cameras is empty: expected at least one camera")
        self.cameras = tuple(cameras)
        self.responses = {c if isinstance(c, str) else c.name: load_camera(c) for c in cameras}
        ranges = {
            "mixing": (mixing, 0.0, 1.0),
            "visibility": (visibility, 1e-3, math.inf),
            "vertical_depth": (vertical_depth, 0.0, math.inf),
            "g": (g, 0.0, 1.0),
            "mu": (mu, 0.0, 1.0),
            "blur_factor": (blur_factor, 0.0, math.inf),
            "near": (near, 0.0, math.inf),
            "far": (far, 0.0, math.inf),
            "gamma": (gamma, 1e-3, math.inf),
            "field_range": (field_range, 0.0, math.inf),
        }
        self._ranges = {name: _range(name, *args) for name, args in ranges.items() if args[0] is not None}
        if visibility is not None:
            for name, water in self.spectra.items():
                for metres in self._ranges["visibility"]:
                    try:
                        water.with_visibility(metres)
                    except ValueError as error:
                        raise ValueError(f"visibility={visibility} does not suit water {name!r}: {error}") from None
        for name, (value, *_) in ranges.items():
            setattr(self, name, value)
        for name, value in (("p", p), ("field_probability", field_probability)):
            if not 0 <= value <= 1:
                raise ValueError(f"{name} must be a probability in [0, 1], got {value}")
        choices = {
            "distance_kind": (distance_kind, ("metric", "relative", "inverse")),
            "unknown": (unknown, ("error", "fill")),
            "color_space": (color_space, ("srgb", "linear")),
            "order": (order, ("line_of_sight", "source")),
        }
        for name, (choice, allowed) in choices.items():
            if choice not in allowed:
                raise ValueError(f"{name} must be one of {allowed}, got {choice!r}")
        if distance_kind != "metric" and self._ranges["near"][1] >= self._ranges["far"][0]:
            raise ValueError(f"near must lie below far, got near = {near} and far = {far} in metres")
        if distance is not None and not callable(distance):
            self._ranges["distance"] = _range("distance", distance, 0.0, math.inf)
        self.point_spread = PointSpread.paper() if point_spread is None else point_spread
        self.field_probability = field_probability
        self.distance_kind = distance_kind
        self.distance = distance
        self.p = p
        self.same_on_batch = same_on_batch
        self.unknown = unknown
        self.image_key, self.distance_key = image_key, distance_key
        self.tolerance = tolerance
        self.color_space = color_space
        self.order: Order = order

    @classmethod
    def severity(cls, level: int, **options: Any) -> "RandomUnderwater":
        """One of five grades, for robustness studies: visibility 20, 10, 5, 2.5, 1.25 m, in any of the coastal types
        and II.

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
        uniform = torch.rand(batch, _DRAWS, generator=generator, dtype=torch.float64).tolist()
        seeds = torch.randint(2**53, (batch,), generator=generator).tolist()
        return {"samples": [self._sample(u, seed) for u, seed in zip(uniform, seeds)]}

    def _sample(self, u: list[float], seed: int) -> Record:
        names, weights = list(self.spectra), list(self.waters.values())
        spread = self._ranges

        def between(name: str, share: float) -> float:
            low, high = spread[name]
            return low + (high - low) * share

        record: Record = {
            "applied": u[0] < self.p,
            "waters": [names[_pick(weights, u[1])], names[_pick(weights, u[2])]],
        }
        record["mixing"] = between("mixing", u[3])
        record["visibility"] = None
        if "visibility" in spread:
            low, high = spread["visibility"]
            record["visibility"] = low * (high / low) ** u[4]
        record["camera"] = list(self.responses)[int(u[5] * len(self.responses))]
        for name, share in (("vertical_depth", u[6]), ("g", u[7]), ("mu", u[8]), ("blur_factor", u[9])):
            record[name] = between(name, share)
        record["field_seed"] = seed if u[10] < self.field_probability else None
        record["field_range"] = list(spread["field_range"])
        if self.distance_kind != "metric":
            record |= {"near": between("near", u[11]), "far": between("far", u[12]), "gamma": between("gamma", u[13])}
        if "distance" in spread:
            record["distance"] = between("distance", u[14])
        return record

    def transform(self, image: Tensor, distance: Tensor | None, params: Record) -> Tensor:
        """Degrade a picture or a batch as a record says: deterministic, bit for bit.

        Args:
            image (3xHxW or Bx3xHxW tensor): uint8 or floating point.
            distance (1xHxW or Bx1xHxW tensor): of `distance_kind`; None where `distance` was given to the class.
            params: from `make_params`, of this or an equally configured transform.

        Returns:
            The degraded image, like `image`.

        Raises:
            TypeError, ValueError: if an input does not suit, naming what came and what was expected.
        """
        plain = _picture(image)
        samples = params["samples"]
        images = plain if plain.ndim == 4 else plain[None]
        if len(samples) not in (1, len(images)):
            raise ValueError(f"params has {len(samples)} samples but image is a batch of {len(images)}")
        maps = self._distances(images, distance, image.ndim)
        if not any(sample["applied"] for sample in samples) or len(images) == 0:
            return image
        if plain.ndim == 3:
            return _typed(self._degrade(plain, maps[0], samples[0]), type(image))
        parts = [
            self._degrade(j, maps[i if len(maps) > 1 else 0], samples[i if len(samples) > 1 else 0])
            for i, j in enumerate(images)
        ]
        return _typed(torch.stack(parts), type(image))

    def _distances(self, images: Tensor, distance: Tensor | None, ndim: int) -> Sequence[Tensor | None]:
        """One map (1xHxW) for each image, or one for all, or None where a plane is drawn."""
        if distance is None:
            if self.distance is None:
                raise ValueError(
                    "distance is missing: give a map, or RandomUnderwater(distance=…) a constant, a range or a callable"
                )
            if not callable(self.distance):
                return [None] * len(images)
            with torch.no_grad():
                distance = self.distance(_unit(images if ndim == 4 else images[0]))
        if not isinstance(distance, Tensor) or not distance.is_floating_point():
            got = distance.dtype if isinstance(distance, Tensor) else type(distance).__name__
            raise TypeError(
                f"distance must be a floating-point tensor, got {got}; divide a depth map in millimetres by 1000"
            )
        plain = _typed(distance, Tensor)
        if plain.ndim not in (3, 4) or plain.shape[-3] != 1:
            raise ValueError(f"distance must have shape (1, H, W) or (B, 1, H, W), got {tuple(distance.shape)}")
        if plain.shape[-2:] != images.shape[-2:]:
            raise ValueError(
                f"distance is {tuple(plain.shape[-2:])} but image is {tuple(images.shape[-2:])}: "
                "height and width must agree"
            )
        maps = plain if plain.ndim == 4 else plain[None]
        if len(maps) not in (1, len(images)):
            raise ValueError(f"distance is a batch of {len(maps)} but image is one of {len(images)}")
        return list(maps)

    def _degrade(self, image: Tensor, distance: Tensor | None, sample: Record) -> Tensor:
        if not sample["applied"]:
            return image
        tensors, law, field, plan = _ingredients(self, sample, image.shape[-2], image.shape[-1])
        medium = assemble(tensors, PointSpread(*law), ())
        with torch.no_grad(), torch.autocast(image.device.type, enabled=False):
            unit = _unit(image)
            if not torch.compiler.is_compiling() and unit.numel() and unit.amax() > _HDR_LIMIT:
                raise ValueError(f"image reaches {float(unit.amax()):g}: expected 0…1; divide a 0…255 image by 255")
            z = self._metres(unit, distance, sample)
            picture, path, medium = check(unit, z, medium, None if field is None else field.to(z), self.order)
            picture = srgb_to_linear(picture) if self.color_space == "srgb" else picture
            (result,) = form(picture, path, medium, self.order, self.tolerance, plan, total=True)
            result = linear_to_srgb(result)[0] if self.color_space == "srgb" else result[0]
            return (
                (result * 255).round_().clamp_(0, 255).to(torch.uint8)
                if image.dtype == torch.uint8
                else result.to(image.dtype)
            )

    def _metres(self, image: Tensor, distance: Tensor | None, sample: Record) -> Tensor:
        if distance is None:
            return torch.full_like(image[:1], sample["distance"])
        if self.distance_kind == "relative":
            return from_relative(distance, sample["near"], sample["far"], sample["gamma"])
        if self.distance_kind == "inverse":
            return from_inverse(distance, sample["near"], sample["far"])
        return distance if torch.compiler.is_compiling() else check_distance(distance, strict=self.unknown == "error")

    def at(self, seed: int, epoch: int, index: int) -> Callable[..., Any]:
        """The transform with randomness from a key: the same result in any worker, in any order.

        Returns:
            A function of the same inputs as the transform, to be called once.
        """
        key = hashlib.blake2b(f"{seed}/{epoch}/{index}".encode(), digest_size=8).digest()
        return partial(self._run, generator=torch.Generator().manual_seed(int.from_bytes(key, "little") >> 1))

    def forward(self, *inputs: Any) -> Any:
        """Draw and degrade; see the class."""
        return self._run(*inputs)

    def _run(self, *inputs: Any, generator: torch.Generator | None = None) -> Any:
        if len(inputs) == 1 and isinstance(inputs[0], Mapping):
            sample = inputs[0]
            if self.image_key not in sample:
                raise ValueError(
                    f"sample has no key {self.image_key!r}: it has {sorted(map(str, sample))}; see image_key"
                )
            image = self._draw(sample[self.image_key], sample.get(self.distance_key), generator)
            return type(sample)({**sample, self.image_key: image})  # type: ignore[call-arg]
        if len(inputs) == 1 and isinstance(inputs[0], (tuple, list)):
            leaves = inputs[0]
            return _like(leaves, self._leaves(list(leaves), generator))
        if len(inputs) == 1:
            return self._draw(inputs[0], None, generator)
        return tuple(self._leaves(list(inputs), generator))

    def _leaves(self, leaves: list[Any], generator: torch.Generator | None) -> list[Any]:
        if not leaves:
            raise ValueError("sample is empty: expected (image, distance, …)")
        distance = leaves[1] if len(leaves) > 1 and self.distance is None else None
        return [self._draw(leaves[0], distance, generator), *leaves[1:]]

    def _draw(self, image: Any, distance: Any, generator: torch.Generator | None) -> Tensor:
        _picture(image)
        return self.transform(image, distance, self.make_params(image, generator))

    def __repr__(self) -> str:
        defaults = inspect.signature(type(self)).parameters
        options = {name: getattr(self, name) for name in list(defaults)[1:]}
        usual = {name: defaults[name].default for name in options} | {"point_spread": PointSpread.paper()}
        changed = "".join(f", {name}={value!r}" for name, value in options.items() if value != usual[name])
        return f"RandomUnderwater({self.waters!r}{changed})"


def _resample(water: str | Water) -> Water:
    """The water at the bands that media are made from, so that mixing and scaling need no interpolation."""
    water = Water.jerlov(water) if isinstance(water, str) else water
    low, high = water.wavelengths[[0, -1]]
    return water.at(WAVELENGTHS[(low <= WAVELENGTHS) & (high >= WAVELENGTHS)])


def _range(name: str, value: Any, least: float, most: float) -> tuple[float, float]:
    low, high = (value, value) if isinstance(value, (int, float)) else tuple(value)
    if not least <= low <= high <= most or math.isinf(high):
        bounds = f"[{least:g}, {most:g}]" if most < math.inf else f"≥ {least:g}"
        raise ValueError(f"{name} must be a number or a range (low, high) with low ≤ high, {bounds}; got {value}")
    return float(low), float(high)


def _pick(weights: list[float], share: float) -> int:
    target = share * sum(weights)
    for i, weight in enumerate(weights):
        target -= weight
        if target < 0:
            return i
    return max(i for i, weight in enumerate(weights) if weight > 0)


def _like(leaves: Any, values: list[Any]) -> Any:
    """A tuple, named tuple or list like `leaves` with other values."""
    return type(leaves)(*values) if hasattr(leaves, "_fields") else type(leaves)(values)


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


def _typed(x: Tensor, wanted: type[Tensor]) -> Tensor:
    return x if type(x) is wanted else x.as_subclass(wanted)


def _unit(image: Tensor) -> Tensor:
    return image / 255 if image.dtype == torch.uint8 else image


def _ingredients(
    aug: RandomUnderwater, sample: Record, height: int, width: int
) -> tuple[tuple[Tensor, ...], tuple[Any, ...], Tensor | None, BlurPlan | None]:
    """From a record: a medium's tensors, its width law, the field and, when compiling, a blur plan.

    Compiled code cannot look at distances to plan, and takes constants as plain tuples, not as objects of ours.
    """
    field = None
    if sample["field_seed"] is not None:
        low, high = sample["field_range"]
        generator = torch.Generator().manual_seed(sample["field_seed"])
        field = gaussian_random_field((height, width), low=low, high=high, generator=generator)
    medium = _medium(
        *(aug.spectra[name] for name in sample["waters"]),
        sample["mixing"],
        sample["visibility"],
        aug.responses[sample["camera"]],
        sample["vertical_depth"],
        sample["g"],
        sample["mu"],
        replace(aug.point_spread, scale=aug.point_spread.scale * sample["blur_factor"]),
        aug.tolerance,
    )
    plan = None
    if torch.compiler.is_compiling():
        plan = blur_demand(medium, COMPILED_RANGE, aug.tolerance).plan((height, width))
    law = medium.point_spread
    return medium.tensors(), (law.scale, law.exponent, law.shape, law.reference_size), field, plan


# what torch.compiler.assume_constant_result does, without its import of torch._dynamo, which takes .7 s
_ingredients._dynamo_marked_constant = True  # type: ignore[attr-defined]


@lru_cache(maxsize=256)
def _medium(
    first: Water,
    second: Water,
    mixing: float,
    visibility: float | None,
    camera: Camera,
    vertical_depth: float,
    g: float,
    mu: float,
    point_spread: PointSpread,
    tolerance: float,
) -> Medium:
    water = first.mix(second, mixing) if mixing > 0 else first
    if visibility is not None:
        water = water.with_visibility(visibility)
    return Medium.from_water(
        water, camera, vertical_depth=vertical_depth, g=g, mu=mu, point_spread=point_spread, tolerance=tolerance
    )
