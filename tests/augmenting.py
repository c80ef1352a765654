"""What the tests of RandomUnderwater and its adapters share."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from uwaug import Camera, Constituents, Light, PointSpread, RandomUnderwater, Water
from uwaug.transforms.random_underwater import SURVEY

H, W = 24, 33
TANK = Water([400, 550, 700], [0.5, 0.2, 0.7], [1.3, 1.1, 1.0], [0.7, 0.3, 0.8], name="tank")
COAST = Constituents(chlorophyll=(1, 20), cdom=(0.1, 2), minerals=0.5)
LASERS = Camera([450, 550, 600], [[0, 0, 1], [0, 1, 0], [1, 0, 0]], name="lasers")
EVERYTHING = {
    "mixing": (0.0, 1.0),
    "visibility": (1.5, 9.0),
    "vertical_depth": (0.5, 8.0),
    "g": (0.1, 0.4),
    "mu": (0.2, 0.35),
    "blur_factor": (0.5, 3.0),
}


def brightness(image: Tensor) -> Tensor:
    """Stands for a depth network."""
    return image.mean(-3, keepdim=True)


LIGHTS = [
    Light.ambient() + Light.lamp((0.4, -0.2, 0.0), (-0.1, 0.0, 1.0), 4.0, 40.0),
    Light.parallel(50.0, 120.0, gradient=0.3),
]

# in a plane, in relative and in inverse distance, 0…1 is a map as good as any
OPTIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "survey": SURVEY,
    "exposures": {"exposure": (-1.0, 2.0), "contrast": 0.3, "focal_px": 30.0},
    "one water": {"waters": "7C"},
    "weights": {"waters": {"II": 3.0, "9C": 0, TANK: 1.5}},
    "everything random": EVERYTHING,
    "contents": {"waters": [COAST, "II", TANK], "mixing": (0.0, 1.0)},
    "cameras": {"cameras": ["sigma sdmerill (npl)", LASERS]},
    "calibrated": {"point_spread": PointSpread.calibrated(28.6), "g": 0.05, "mu": 0.075},
    "heavy tails": {"point_spread": PointSpread(1.0, 0.6, "exponential")},
    "no blur": {"point_spread": PointSpread.none(), "tolerance": 0.01},
    "no field": {"field_probability": 0.0},
    "fields": {"field_probability": 0.5, "field_range": [0.3, 1.7]},
    "relative": {
        "distance_kind": "relative",
        "near": (0.0, 1.0),
        "far": (4.0, 8.0),
        "gamma": (1.0, 3.0),
    },
    "inverse": {"distance_kind": "inverse", "near": (0.5, 1.0), "far": 8.0},
    "plane": {"distance": 3.0},
    "planes": {"distance": (1.0, 4.0)},
    "network": {"distance": brightness, "distance_kind": "inverse"},
    "half": {"p": 0.5},
    "batch": {"same_on_batch": True, **EVERYTHING},
    "fill": {"unknown": "fill"},
    "keys": {"image_key": "rgb", "distance_key": "range"},
    "light": {"color_space": "linear", "order": "source"},
    "dim daylight": {"light": Light.ambient(0.4)},
    "lamps": {"light": LIGHTS, "vertical_depth": (5.0, 30.0), "focal_px": 40.0},
}


def picture(batch: int | None = None, dtype: torch.dtype = torch.float32) -> Tensor:
    """The same picture, or batch of pictures, at every call."""
    generator = torch.Generator().manual_seed(7)
    image = torch.rand(*_leading(batch), 3, H, W, generator=generator)
    return (255 * image).round().byte() if dtype == torch.uint8 else image.to(dtype)


def array(dtype: str = "uint8") -> NDArray[Any]:
    """The picture as an array, HxWx3."""
    image = np.ascontiguousarray(picture().permute(1, 2, 0).numpy())
    return np.rint(255 * image).astype(np.uint8) if dtype == "uint8" else image.astype(dtype)


def distances(batch: int | None = None) -> Tensor:
    """The same map, or batch of maps, at every call: .001 to 1."""
    generator = torch.Generator().manual_seed(8)
    return 1e-3 + 0.999 * torch.rand(*_leading(batch), 1, H, W, generator=generator)


def metres() -> NDArray[np.float32]:
    """A map as an array, HxW: 1…5 m."""
    z: NDArray[np.float32] = 1 + 4 * distances()[0].numpy()
    return z


def _leading(batch: int | None) -> tuple[int, ...]:
    return () if batch is None else (batch,)


def leaves(aug: RandomUnderwater, batch: int | None = None) -> tuple[Tensor, ...]:
    """What a transform takes: image and map, or image alone."""
    return (picture(batch), distances(batch)) if aug.distance is None else (picture(batch),)


def result(aug: RandomUnderwater, batch: int | None = None, key: int = 0) -> Tensor:
    """The degraded image."""
    out = aug.at(1, 2, key)(*leaves(aug, batch))
    return out[0] if isinstance(out, tuple) else out


def same(a: Any, b: Any) -> bool:
    """Whether two tensors agree in class, type, shape and every bit."""
    return type(a) is type(b) and a.dtype == b.dtype and a.shape == b.shape and torch.equal(a, b)
