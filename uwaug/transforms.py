"""`RandomUnderwater`: new water for every picture, in a DataLoader worker or on a whole batch."""

import copy
import hashlib
import inspect
import json
import math
import os
from bisect import bisect
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from itertools import accumulate
from numbers import Real
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from uwaug.blur import Shape
from uwaug.camera import Camera, load_camera
from uwaug.colour import linear_to_srgb, srgb_to_linear
from uwaug.distance import check_distance, from_inverse, from_relative
from uwaug.field import gaussian_random_field
from uwaug.formation import Order, check, form
from uwaug.medium import WAVELENGTHS, Medium, PointSpread
from uwaug.water import JERLOV_TYPES, Water

Range = float | tuple[float, float]
Record = dict[str, Any]
Kind = Literal["metric", "relative", "inverse"]

_HDR_LIMIT = 16.0
_TOUCHING = 1e-6  # m, for relative distance 0 with near = 0: in a map of metres 0 means unknown
_BOUNDS = {
    "mixing": (0.0, 1.0),
    "visibility": (1e-3, math.inf),
    "vertical_depth": (0.0, math.inf),
    "g": (0.0, 1.0),
    "mu": (0.0, 1.0),
    "blur_factor": (0.0, math.inf),
    "near": (0.0, math.inf),
    "far": (0.0, math.inf),
    "gamma": (1e-3, math.inf),
    "distance": (0.0, math.inf),
}
# What each picture draws a uniform number for. A new one goes to the end, so that keys of `at` keep their pictures.
_DRAWS = ("applied", "first", "second", "camera", "field", *_BOUNDS)
_SCALING = {"metric": (), "relative": ("near", "far", "gamma"), "inverse": ("near", "far")}


class RandomUnderwater(nn.Module):
    """Degrade pictures in random waters.

    A range is a number or (low, high), drawn uniformly; visibility is drawn uniformly in its logarithm. The defaults
    are the figures of the paper's survey (g, mu, vertical depth, width law, field, and near, far, gamma for relative
    distance; its nine waters with equal weight), but for its camera, a Nikon D90, and its use of sRGB values as light:
    `color_space="linear"` does that too.

    Args:
        waters: Jerlov types or `Water` objects, drawn with equal weight (one that is given twice counts twice); or a
            mapping to weights.
        mixing: share of a second water, drawn like the first; 0 for none, (0, 1) for a continuous slider between types.
        visibility: m; scale the water to this visibility, or None to leave it. See `Water.with_visibility`.
        cameras: names, CSV files or `Camera` objects, drawn with equal weight.
        vertical_depth: m below the surface.
        g: share of the scattered light that leaves the line of sight, 0…1.
        mu: share of the scattered light sent towards the camera, 0…1.
        point_spread: width law of the forward scatter, `PointSpread.paper()` by default.
        blur_factor: multiplies the scale of the width law.
        field_range: least and largest value of the medium field, which is drawn anew for each picture.
        field_probability: how often the water is uneven; else the field is 1.
        distance_kind: what a distance map holds. "metric": metres along the ray; nothing is invented. "relative": 0…1,
            0 = near, mapped to near + (far − near)·t^gamma: order and proportions of the scene are right, its scale is
            drawn. "inverse": what monocular networks give, large = near, of unknown scale and shift: each map is
            stretched to reach from near to far, so that even a scene without depth does.
        near, far, gamma: m, m and exponent for "relative" and "inverse" (gamma for "relative" alone).
        distance: where no map is given. None: that is an error. A number or a range: a plane at that distance, m. All
            of the picture then gets one veil, one colour cast and one blur, but for the field: right for a flat scene
            that faces the camera; elsewhere, that far things fade first, which tells water from a tint, is missing. A
            callable, such as a depth network: takes the image (3xHxW or Bx3xHxW, 0…1), returns a map of
            `distance_kind`. It costs its own time for every picture, its errors become wrong colours, and it gives
            metres only if the network does. A tuple is then taken to hold no map: what follows its image is left alone.
        p: probability that a picture is degraded at all.
        same_on_batch: draw once for a batch.
        unknown: what NaN, 0 or negative metres (NaN in relative and inverse maps) get. "error": an error. "fill": the
            nearest known distance (12 ms at 500×741). Geometric transforms pad with 0: pad maps with NaN unless metric.
        image_key, distance_key: where to find the two in a dict.
        tolerance, color_space, order: as for `uwaug.Underwater`.

    Inputs:
        (image, distance, …), a tuple or list of them, or a dict. One picture (3xHxW, distance 1xHxW) or a batch, whose
        pictures may share one map; uint8 (0…255) or floating point (0…1); plain tensors or torchvision's tv_tensors (a
        distance map is best a `Mask`). The same structure comes back with a new image of the same type; every other
        leaf is returned as it is, and no input is changed. Gradients end here: `uwaug.Underwater` passes them on.

    Randomness comes from torch's global generator, which a DataLoader seeds for each worker and epoch; `at` draws from
    a key instead. Place the transform before normalisation, and after resizing and cropping: a width law with a
    reference size, such as the default, takes the picture it is given for the whole view.

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
        point_spread: PointSpread | None = None,
        blur_factor: Range = 1.0,
        field_range: tuple[float, float] = (0.7, 1.3),
        field_probability: float = 1.0,
        distance_kind: Kind = "metric",
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
        point_spread = PointSpread.paper() if point_spread is None else point_spread
        if not isinstance(point_spread, PointSpread):
            raise TypeError(f"point_spread must be a PointSpread, got {type(point_spread).__name__}")
        given = locals()
        given = {name: given[name] for name in _DEFAULTS}
        for name in ("p", "field_probability"):
            if not 0 <= given[name] <= 1:
                raise ValueError(f"{name} must be a probability in [0, 1], got {given[name]}")
        if not 0 < tolerance < 1:
            raise ValueError(f"tolerance must lie in (0, 1) (image scale 0…1), got {tolerance}")
        for name, allowed in {
            "distance_kind": tuple(_SCALING),
            "unknown": ("error", "fill"),
            "color_space": ("srgb", "linear"),
            "order": ("line_of_sight", "source"),
        }.items():
            if given[name] not in allowed:
                raise ValueError(f"{name} must be one of {allowed}, got {given[name]!r}")
        self.field_range = _range("field_range", field_range, 0.0, math.inf)
        ranges = {name: _range(name, given[name], *bounds) for name, bounds in _BOUNDS.items() if _ranges(given[name])}
        for name in _SCALING["relative"]:
            if name not in _SCALING[distance_kind]:
                if given[name] != _DEFAULTS[name]:
                    raise ValueError(f"{name} = {given[name]} has no effect on {distance_kind} distance: expected none")
                del ranges[name]
        if "far" in ranges and ranges["near"][1] >= ranges["far"][0]:
            raise ValueError(f"near must lie below far, got near = {near} and far = {far} in metres")
        if distance_kind == "inverse" and ranges["near"][0] == 0:
            raise ValueError(f"near must be above 0 m for inverse distance, got {near}")

        weighted: dict[str | Water, float] = dict(
            waters if isinstance(waters, Mapping) else Counter([waters] if isinstance(waters, (str, Water)) else waters)
        )
        if not weighted:
            raise ValueError("waters is empty: expected at least one Jerlov type or Water")
        if min(weighted.values()) < 0 or not 0 < sum(weighted.values()) < math.inf:
            raise ValueError(f"waters: expected weights ≥ 0 with a positive sum, got {list(weighted.values())}")
        self.spectra = {water if isinstance(water, str) else water.name: _resample(water) for water in weighted}
        if len(self.spectra) < len(weighted):
            raise ValueError("waters: each water needs a name of its own")
        for name, water in self.spectra.items():
            for metres in ranges.get("visibility", ()):
                try:
                    water.with_visibility(metres)
                except ValueError as error:
                    raise ValueError(f"visibility={visibility} does not suit water {name!r}: {error}") from None
        one = isinstance(cameras, (str, os.PathLike, Camera))
        loaded = [(camera, load_camera(camera)) for camera in ([cameras] if one else cameras)]
        if not loaded:
            raise ValueError("cameras is empty: expected at least one camera")
        self.responses = {c if isinstance(c, str) else camera.name: camera for c, camera in loaded}
        for name, value in {**given, "waters": weighted, "cameras": [c for c, _ in loaded]}.items():
            setattr(self, name, value)
        self._ranges = ranges
