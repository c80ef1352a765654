"""What the tests of RandomUnderwater and its adapters share."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

import uwaug
from uwaug import Camera, Constituents, Lamp, RandomDevelopment, RandomUnderwater, RandomWater, View
from uwaug.distance import Inverse, MadeUp, Metres, Network, Plane, Relative

H, W = 24, 33
TANK = uwaug.Water([400, 550, 700], [0.5, 0.2, 0.7], [1.3, 1.1, 1.0], [0.7, 0.3, 0.8], name="tank")
COAST = Constituents(chlorophyll=(1, 20), cdom=(0.1, 2), minerals=0.5)
LASERS = Camera([450, 550, 600], [[0, 0, 1], [0, 1, 0], [1, 0, 0]], name="lasers")
FIT = uwaug.Medium.from_coefficients([0.4, 0.2, 0.1], [0.3, 0.15, 0.1], [0.1, 0.3, 0.4], b_mean=0.2)
RAW = RandomDevelopment(**RandomDevelopment.PLAIN)
QUIET = RandomDevelopment(noise=None)
EVERYTHING = {
    "mixing": (0.0, 1.0),
    "contrast": (0.2, 0.4),
    "vertical_depth": (0.5, 8.0),
    "g": (0.1, 0.4),
    "mu": (0.2, 0.35),
}


def brightness(image: Tensor) -> Tensor:
    """Stands for a depth network."""
    return image.mean(-3, keepdim=True)


# 0…1 is a map as good as any in metres, in relative and in inverse distance
OPTIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "raw": {"water": RandomWater(contrast=None, color_matrix=None), "development": RAW},
    "one water": {"water": "7C"},
    "waters": {"water": ["II", "II", TANK, "chlorophyll=5,cdom=.3"]},
    "everything random": {"water": RandomWater(["IB", COAST], **EVERYTHING)},
    "contents": {"water": RandomWater([COAST, "II", TANK], mixing=(0.0, 1.0))},
    "fit": {"water": [FIT, "II"]},
    "camera": {"water": RandomWater(camera=LASERS)},
    "heavy tails": {"water": RandomWater(point_spread=uwaug.PointSpread(1.0, 0.6, "exponential"))},
    "even": {"water": RandomWater(field=None)},
    "snowy": {"water": RandomWater(snow=uwaug.MarineSnow((500.0, 2000.0)))},
    "relative": {"distance": Relative((0.0, 1.0), (4.0, 8.0), (1.0, 3.0))},
    "inverse": {"distance": Inverse((0.5, 1.0), 8.0, holes=3.0)},
    "plane": {"distance": 3.0},
    "planes": {"distance": Plane((1.0, 4.0))},
    "network": {"distance": Network(brightness)},
    "made up": {"distance": MadeUp()},
    "half": {"p": 0.5},
    "fill": {"distance": Metres("fill", True), "view": View(60.0)},
    "keys": {"keys": ("rgb", "range")},
    "linear": {"development": RandomDevelopment(color_space="linear")},
    "night": {"light": uwaug.RandomLight(share=0.5)},
    "lamp": {"light": uwaug.Light((Lamp((0.5, 0.0, -1.0), 3.0),), 0.5)},
    "noisy": {"development": RandomDevelopment(noise=uwaug.Sensor((2e3, 2e4), (1.0, 4.0)))},
}


def picture(batch: int | None = None, dtype: torch.dtype = torch.float32) -> Tensor:
    """The same picture, or batch of pictures, at every call."""
    generator = torch.Generator().manual_seed(7)
    image = torch.rand(*_leading(batch), 3, H, W, generator=generator)
    return (255 * image).round().byte() if dtype == torch.uint8 else image.to(dtype)


def distances(batch: int | None = None) -> Tensor:
    """The same map, or batch of maps, at every call: .001 to 1."""
    generator = torch.Generator().manual_seed(8)
    return 1e-3 + 0.999 * torch.rand(*_leading(batch), 1, H, W, generator=generator)


def _leading(batch: int | None) -> tuple[int, ...]:
    return () if batch is None else (batch,)


def leaves(aug: RandomUnderwater, batch: int | None = None) -> tuple[Tensor, ...]:
    """What a transform takes: image and map, or image alone."""
    return (picture(batch), distances(batch)) if aug.distance.reads_maps else (picture(batch),)


def result(aug: RandomUnderwater, batch: int | None = None, key: int = 0) -> Tensor:
    """The degraded image."""
    out = aug.at(1, 2, key)(*leaves(aug, batch))
    return out[0] if isinstance(out, tuple) else out


def same(a: Any, b: Any) -> bool:
    """Whether two tensors agree in class, type, shape and every bit."""
    return type(a) is type(b) and a.dtype == b.dtype and a.shape == b.shape and torch.equal(a, b)


def flat(drawn: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """What is drawn, by names such as "water.contrast"."""
    leaves: dict[str, Any] = {}
    for name, value in drawn.items():
        inner = isinstance(value, Mapping)
        leaves |= flat(value, f"{prefix}{name}.") if inner else {prefix + name: value}
    return leaves
