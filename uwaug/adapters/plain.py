"""Options of `RandomUnderwater` as JSON and YAML hold them: numbers, strings, lists and dicts."""

import inspect
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from uwaug.distance.network import DepthNetwork
from uwaug.light import Light
from uwaug.light.text import light_from, plain_numbers
from uwaug.optics.camera import Camera
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water

__all__ = ["from_plain", "to_plain"]

_CLASSES = {kind.__name__: kind for kind in (Camera, DepthNetwork, PointSpread, Water)}
"""Made anew from the attributes that are named like the arguments of their constructors."""

_CLASS = "uwaug"
"""The key that holds the name of a class."""


def to_plain(name: str, value: Any) -> Any:
    """An option in numbers, strings, lists and dicts.

    Args:
        name: of the option.
        value: of it.

    Raises:
        NotImplementedError: if it is, or holds, something else, such as a function.
    """
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (np.number, np.ndarray)):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, (list, tuple)):
        return [to_plain(name, item) for item in value]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: to_plain(name, item) for key, item in value.items()}
    if type(value).__name__ in _CLASSES:
        plain = {_CLASS: type(value).__name__}
        for field in inspect.signature(type(value)).parameters:
            plain[field] = to_plain(name, getattr(value, field))
        return plain
    if isinstance(value, Light):
        return {_CLASS: "Light", "sources": plain_numbers(value)}
    expected = "numbers, strings, or a Water, Camera, PointSpread, Light or DepthNetwork"
    cure = "keep the pipeline in code, or pickle it"
    raise NotImplementedError(
        f"{name} cannot be written: expected {expected}, got {value!r:.80}; {cure}"
    )


def from_plain(value: Any) -> Any:
    """What `to_plain` was given; with tuples for lists."""
    if isinstance(value, (list, tuple)):
        return tuple(from_plain(item) for item in value)
    if isinstance(value, Mapping):
        items = {key: from_plain(item) for key, item in value.items()}
        name = items.pop(_CLASS, None)
        if name == "Light":
            return light_from(items["sources"])
        return items if name is None else _CLASSES[name](**items)
    return value
