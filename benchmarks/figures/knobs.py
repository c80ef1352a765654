"""Each range of `RandomUnderwater` at five values, on one scene. All else stays as it is in the
middle of its range.
"""

from dataclasses import replace
from typing import Any

import torch
from PIL import Image
from torch import Tensor

from uwaug import (
    PointSpread,
    RandomDevelopment,
    RandomLight,
    RandomUnderwater,
    RandomWater,
    Sensor,
)
from uwaug.distance import MadeUp
from uwaug.figures.sheet import sheet

STEPS = 5
WATER = "3C"

OWN: dict[str, tuple[Any, ...]] = {
    "waters": ("IB", "II", "1C", "9C", "chlorophyll=10,cdom=1"),
    "mixing": (0.0, 0.25, 0.5, 0.75, 1.0),
    "g": (0.0, 0.05, 0.1, 0.2, 0.4),
    "mu": (0.0, 0.04, 0.075, 0.15, 0.3),
    "point_spread": (0.0, 0.5, 1.0, 2.0, 4.0),
    "field": (0.0, 0.15, 0.3, 0.5, 0.8),
    "noise": (None, 50_000, 5_000, 1_000, 300),
}
"""Values of what has no range by default: the width of the blur, times that of the calibrated law;
the spread of the field about 1; the full well of the sensor.
"""


def values() -> dict[str, tuple[Any, ...]]:
    """Five values of each, from the least to the largest that a default draw has."""
    water = RandomWater()
    ranges = {name: getattr(water, name) for name in ("vertical_depth", "color_matrix")}
    five = {}
    for name, ends in {**ranges, **RandomDevelopment().ranges()}.items():
        assert isinstance(ends, tuple)
        five[name] = tuple(torch.linspace(*ends, STEPS).tolist())
    sources = {"contrast": (0.6, 0.07), "distance.near": (0.3, 2.5), "distance.far": (3.0, 12.0)}
    lights = ("power", "cone", "tint", "daylight")
    lamps = {f"light.{name}": getattr(RandomLight(), name) for name in lights}
    for name, (low, high) in {**sources, **lamps}.items():
        five[name] = tuple(torch.linspace(low, high, STEPS).tolist())
    return {**OWN, **five}


def transform(name: str, value: Any, width: int) -> RandomUnderwater:
    """Fixed in all but one."""
    middles: dict[str, Any] = {"noise": None}
    for own, ends in RandomDevelopment().ranges().items():
        assert isinstance(ends, tuple)
        middles[own] = sum(ends) / 2
    water: dict[str, Any] = {
        "waters": WATER,
        "contrast": 0.4,
        "vertical_depth": 4.0,
        "field": None,
        "color_matrix": 0.4,
    }
    nouns: dict[str, Any] = {"light": None}
    if name == "mixing":
        water["waters"] = f"{1 - value}*{WATER}+{value}*9C"
    elif name == "point_spread":
        law = PointSpread.calibrated()
        water[name] = replace(law, scale=law.scale * value)
    elif name == "field":
        water[name] = (1 - value, 1 + value)
    elif name == "noise":
        middles[name] = None if value is None else Sensor(value)
    elif name.startswith("distance."):
        nouns["distance"] = MadeUp(**{name.partition(".")[2]: value})
        water |= {"waters": "II", "contrast": None}
    elif name.startswith("light."):
        own = {name.partition(".")[2]: value}
        nouns["light"] = RandomLight(share=1.0, rigs="diver", **own)
    elif name in middles:
        middles[name] = value
    else:
        water[name] = value
    camera = RandomDevelopment(**middles)
    return RandomUnderwater(RandomWater(**water), development=camera, **nouns)


def at(name: str, value: Any, image: Tensor, distance: Tensor) -> Tensor:
    """The scene at a value."""
    augment = transform(name, value, image.shape[-1])
    drawn = augment.at(0, 0, 0)
    picture: Tensor = drawn(image, distance)[0] if augment.distance.reads_maps else drawn(image)
    return picture


def knobs(image: Tensor, distance: Tensor) -> Image.Image:
    """A row for each."""
    rows = []
    for name, five in values().items():
        cells = []
        for value in five:
            shown = f"{value:.3g}" if isinstance(value, float) else str(value)
            shown = {"field": "1 ± ", "point_spread": "× "}.get(name, "") + shown
            label = shown if cells else f"{name} = {shown}"
            cells.append((at(name, value, image, distance), label))
        rows.append(cells)
    return sheet(rows, (150, 150))
