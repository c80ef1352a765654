"""Dataclasses as plain dictionaries, as JSON and TOML hold them; the one codec of presets, records,
fits, ONNX files, runs and options.
"""

import os
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, Field, fields
from difflib import get_close_matches
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

_KINDS: dict[str, type] = {}


def plain(kind: type[T]) -> type[T]:
    """Let a dataclass be written as a dictionary: {"kind": its name, attributes…}.

    Raises:
        TypeError: if another class has the name.
    """
    taken = _KINDS.get(kind.__name__, kind)
    # a module that is loaded anew replaces its own
    if (taken.__module__, taken.__qualname__) != (kind.__module__, kind.__qualname__):
        where = f"{taken.__module__}.{taken.__qualname__}"
        raise TypeError(f"kind {kind.__name__!r} is taken by {where}: give the class another name")
    _KINDS[kind.__name__] = kind
    return kind


def to_plain(value: Any) -> Any:
    """Numbers, strings, lists and dictionaries for a value; of a dataclass, its kind and what
    differs from its defaults.

    Raises:
        TypeError: if it is, or holds, anything else, such as a function.
    """
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if hasattr(value, "detach"):  # a tensor; waters and cameras are written without PyTorch
        return value.detach().cpu().tolist()
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, (list, tuple)):
        return [to_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if _KINDS.get(type(value).__name__) is type(value):
        stored = {field.name: to_plain(getattr(value, field.name)) for field in changed(value)}
        return {"kind": type(value).__name__, **stored}
    raise TypeError(f"cannot be written as numbers and words: {value!r:.80}")


def from_plain(data: Any, expected: type | None = None) -> Any:
    """The inverse of `to_plain`; lists become tuples.

    Args:
        data: from `to_plain`, or as a person writes it in TOML.
        expected: the class of the result, where its name may be left out.

    Raises:
        TypeError, ValueError: if the class is unknown, or refuses what it is given.
    """
    if isinstance(data, (list, tuple)):
        return tuple(from_plain(item) for item in data)
    if not isinstance(data, Mapping):
        return data
    values = {key: from_plain(item) for key, item in data.items()}
    name = values.pop("kind", expected and expected.__name__)
    if name is None:
        return values
    if name not in _KINDS or (expected is not None and not issubclass(_KINDS[name], expected)):
        wanted = _KINDS if expected is None else [expected.__name__]
        meant = _meant(str(name), wanted)
        raise ValueError(f"kind must be {', '.join(wanted)}, got {name!r}{meant}")
    kind = _KINDS[name]
    names = [field.name for field in fields(kind) if field.init]
    for key in values:
        if key not in names:
            raise TypeError(f"{name} has no {key!r}, only {', '.join(names)}{_meant(key, names)}")
    try:
        return getattr(kind, "of_plain", kind)(**values)  # of_plain: makes tensors of numbers
    except TypeError as error:  # an argument that is missing
        raise TypeError(f"{name}: {error}") from None


def _meant(word: str, words: Iterable[str]) -> str:
    """A question after the one of some words that another was meant for."""
    return "".join(f": did you mean {near}?" for near in get_close_matches(word, words, 1))


def changed(value: Any) -> list[Field[Any]]:
    """The fields of a dataclass that are not as by default."""

    def default(field: Any) -> Any:
        return field.default if field.default_factory is MISSING else field.default_factory()

    def same(a: Any, b: Any) -> bool:
        return type(a) is type(b) and not hasattr(a, "shape") and a == b

    stored = (f for f in fields(value) if f.init and f.metadata.get("stored", True))
    return [f for f in stored if not same(getattr(value, f.name), default(f))]
