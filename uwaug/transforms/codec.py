"""Options of `RandomUnderwater` as files hold them: in numbers, strings, lists and dicts."""

import inspect
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from uwaug.distance.network import DepthNetwork
from uwaug.light import Light
from uwaug.optics.camera import Camera
from uwaug.optics.constituents import Constituents
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water

_CLASS = "uwaug"
"""The key that holds the name of a class."""

_CLASSES = {
    kind.__name__: kind for kind in (Camera, Constituents, DepthNetwork, PointSpread, Water)
}
"""Made anew from the attributes that are named like the arguments of their constructors."""


def encode_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of `RandomUnderwater` in numbers, strings, lists and dicts.

    Raises:
        NotImplementedError: if one is, or holds, something else, such as a function.
    """
    return {name: _encode(name, value) for name, value in options.items()}


def decode_options(plain: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of `encode_options`; lists become tuples.

    A point spread may also be a plain table of its arguments, and a light a list of tables, each
    with kind = "ambient", "parallel" or "lamp" and the arguments of that constructor of `Light`:
    so a person writes them in TOML.

    Raises:
        TypeError, ValueError: if a table does not suit, naming the option.
    """
    options = {}
    for name, value in plain.items():
        if name == "point_spread" and isinstance(value, Mapping) and _CLASS not in value:
            value = {_CLASS: "PointSpread", **value}
        tables = name == "light" and isinstance(value, (list, tuple))
        if tables and all(isinstance(table, Mapping) and _CLASS not in table for table in value):
            options[name] = Light.from_list(list(value))
        else:
            options[name] = _decode(name, value)
    return options


def _encode(name: str, value: Any) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (np.number, np.ndarray)):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, (list, tuple)):
        return [_encode(name, item) for item in value]
    if isinstance(value, Mapping):
        if all(isinstance(key, str) for key in value):
            return {key: _encode(name, item) for key, item in value.items()}
        return {_CLASS: "Mapping", "items": _encode(name, list(value.items()))}
    if isinstance(value, Light):
        return {_CLASS: "Light", "sources": value.to_list()}
    if type(value).__name__ in _CLASSES:
        fields = inspect.signature(type(value)).parameters
        attributes = {field: _encode(name, getattr(value, field)) for field in fields}
        return {_CLASS: type(value).__name__, **attributes}
    expected = (
        "numbers, strings, or a Water, Constituents, Camera, PointSpread, Light or DepthNetwork"
    )
    cure = "keep the pipeline in code, or pickle it"
    raise NotImplementedError(
        f"{name} cannot be written: expected {expected}, got {value!r:.80}; {cure}"
    )


def _decode(name: str, value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return tuple(_decode(name, item) for item in value)
    if not isinstance(value, Mapping):
        return value
    items = {key: _decode(name, item) for key, item in value.items()}
    kind = items.pop(_CLASS, None)
    if kind is None:
        return items
    try:
        if kind == "Light":
            return Light.from_list(items["sources"])
        if kind == "Mapping":
            return dict(items["items"])
        return _CLASSES[kind](**items)
    except KeyError as error:
        raise ValueError(f"{name}: unknown or missing: {error}") from None
    except TypeError as error:
        raise ValueError(f"{name}: {error}") from None
