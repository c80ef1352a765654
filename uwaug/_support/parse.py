"""JSON and TOML of files that strangers may have written."""

import json
import tomllib
from collections.abc import Callable
from typing import Any


def from_json(text: str) -> Any:
    """What JSON says.

    Raises:
        ValueError: if it is none, or nests too deeply.
    """
    return _parsed(json.loads, text)


def from_toml(text: str) -> Any:
    """What TOML says.

    Raises:
        ValueError: if it is none, or nests too deeply.
    """
    return _parsed(tomllib.loads, text)


def _parsed(parse: Callable[[str], Any], text: str) -> Any:
    try:
        return parse(text)
    except RecursionError:
        raise ValueError("its brackets or keys nest too deeply") from None
