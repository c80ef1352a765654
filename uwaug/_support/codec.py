"""Dataclasses as dictionaries for JSON, YAML and TOML, in which "none" stands for None."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, Field, fields
from difflib import get_close_matches
from functools import cache
from types import NoneType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

T = TypeVar("T")

_KINDS: dict[str, type] = {}


def plain(kind: type[T]) -> type[T]:
    """Let the codec write a dataclass as a dictionary: {"kind": its name, attributes…}. The name
    must be that of no other.
    """
    taken = _KINDS.get(kind.__name__, kind)
    # a module that is loaded anew replaces its own
    if (taken.__module__, taken.__qualname__) != (kind.__module__, kind.__qualname__):
        raise TypeError(f"kind {kind.__name__!r} is taken by {taken}: give the class another name")
    _KINDS[kind.__name__] = kind
    return kind


def to_plain(value: Any) -> Any:
    """Turn a value into numbers, strings, lists and dictionaries; a dataclass into its kind and the
    fields that differ from their defaults. Anything else, such as a function, is refused.
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
    if hasattr(value, "as_stored"):
        return to_plain(value.as_stored())
    if _is_plain(type(value)):
        stored = {field.name: getattr(value, field.name) for field in changed(value)}
        named = {name: "none" if item is None else to_plain(item) for name, item in stored.items()}
        return {"kind": type(value).__name__, **named}
    raise TypeError(f"cannot be written as numbers and words: {value!r:.80}")


def from_plain(data: Any, *expected: type) -> Any:
    """Read what `to_plain` has written, or a person in TOML; lists become tuples.

    Args:
        data: value to read.
        expected: classes that the result may have, with those that derive from them; without any,
            no object is made. Without "kind" it is the first that has all of the attributes.

    Raises:
        TypeError, ValueError: if a class or the type of a field is another, or a class refuses it.
    """
    try:
        return _read("", data, expected)
    except RecursionError:
        raise ValueError("lists or tables are nested too deeply") from None


def _read(name: str, data: Any, hints: tuple[Any, ...]) -> Any:
    if isinstance(data, (list, tuple)):
        return tuple(_read(name, item, hints) for item in data)
    if not isinstance(data, Mapping):
        return _scalar(name, data, hints)
    for hint in hints:
        if _is_mapping(hint):
            inner = _flat(get_args(hint)[1])
            return {key: _read(f"{name}.{key}", item, inner) for key, item in data.items()}
    kind = _kind_of(data, tuple(filter(_is_expected, hints)))
    if kind is None:
        return {key: _read(f"{name}.{key}", item, ()) for key, item in data.items()}
    members, values = _members(kind), {}
    for key, item in data.items():
        if key == "kind":
            continue
        if not hasattr(kind, "of_plain") and key not in members:
            has = f"{kind.__name__} has no {key!r}, only {', '.join(members)}"
            raise TypeError(f"{has}{_meant(key, members)}")
        classes = members.get(key, ())
        is_none = isinstance(item, str) and item == "none" and NoneType in classes
        values[key] = None if is_none else _read(f"{kind.__name__}.{key}", item, classes)
    try:
        return getattr(kind, "of_plain", kind)(**values)  # of_plain: makes tensors of numbers
    except TypeError as error:  # an argument that is missing
        raise TypeError(f"{kind.__name__}: {error}") from None


# words that people write after `--set`
_TRUTH = {"true": True, "on": True, "yes": True, "false": False, "off": False, "no": False}


def _scalar(name: str, value: Any, hints: tuple[Any, ...]) -> Any:
    is_free = not name or not hints or Any in hints
    if is_free or not isinstance(value, (bool, int, float, str, NoneType)):
        return value
    if bool in hints and isinstance(value, str) and value.lower() in _TRUTH:
        return _TRUTH[value.lower()]
    expected = {kind for hint in hints if (kind := _scalar_type(hint))}
    # where objects alone are expected, the class says what stands for one; an int is a number
    if not expected or type(value) in expected or (type(value) is int and float in expected):
        return value
    words = ", ".join(sorted(_IN_WORDS[kind] for kind in expected))
    raise ValueError(f"{name} must be {words}, got {value!r:.80}")


_IN_WORDS = {bool: "true or false", int: "a whole number", float: "a number"}
_IN_WORDS |= {str: "a string", NoneType: "none"}


def _scalar_type(hint: Any) -> type | None:
    if isinstance(hint, str) or get_origin(hint) is os.PathLike or hint is os.PathLike:
        return str
    if getattr(hint, "__name__", "") in ("Tensor", "ndarray"):  # without PyTorch
        return float
    return hint if isinstance(hint, type) and hint in _IN_WORDS else None


def _kind_of(data: Mapping[str, Any], expected: tuple[type, ...]) -> type | None:
    """Return the class that a dictionary stands for; None for a dictionary as such."""
    if "kind" not in data:
        kinds = [kind for kind in expected if _is_plain(kind)]
        has_all = (kind for kind in kinds if data.keys() <= _members(kind).keys())
        return next(has_all, kinds[0] if kinds else None)
    name = data["kind"]
    kind = _KINDS.get(name) if isinstance(name, str) else None
    if kind is None or not issubclass(kind, expected):
        wanted = [known for known, kind in _KINDS.items() if issubclass(kind, expected)]
        listed = ", ".join(wanted) or "left out: no object is expected here"
        raise ValueError(f"kind must be {listed}, got {name!r:.80}{_meant(str(name), wanted)}")
    return kind


@cache
def _members(kind: type) -> dict[str, tuple[type, ...]]:
    hints = get_type_hints(kind)
    return {field.name: _flat(hints[field.name]) for field in fields(kind) if field.init}


def _flat(hint: Any) -> tuple[Any, ...]:
    """List the classes in a type hint, but for those in a mapping, which is written as such."""
    inner = get_args(hint)
    if not inner or _is_mapping(hint):
        return (hint,)
    return sum((_flat(each) for each in inner), ())


def _is_mapping(hint: Any) -> bool:
    origin = get_origin(hint)
    return isinstance(origin, type) and issubclass(origin, Mapping)


def _is_expected(hint: Any) -> bool:
    return isinstance(hint, type) and any(issubclass(kind, hint) for kind in _KINDS.values())


def _is_plain(kind: Any) -> bool:
    return isinstance(kind, type) and _KINDS.get(kind.__name__) is kind


def _meant(word: str, words: Iterable[str]) -> str:
    """': did you mean …?' with the word that is most similar; "" if none is."""
    return "".join(f": did you mean {match}?" for match in get_close_matches(word, words, 1))


def changed(value: Any) -> list[Field[Any]]:
    """List the fields that differ from their defaults, or that `always_stored` names."""

    def default(field: Any) -> Any:
        return field.default if field.default_factory is MISSING else field.default_factory()

    def same(a: Any, b: Any) -> bool:
        if type(a) is not type(b) or hasattr(a, "shape"):
            return False
        # some classes, such as those that hold arrays, compare by identity
        return a == b or (_is_plain(type(a)) and not changed(a) and not changed(b))

    stored = (f for f in fields(value) if f.init and f.metadata.get("stored", True))
    always = getattr(value, "always_stored", ())
    return [f for f in stored if f.name in always or not same(getattr(value, f.name), default(f))]
