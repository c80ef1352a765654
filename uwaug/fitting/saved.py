"""Fits in files: JSON, written whole, and refused by the name of the file."""

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from uwaug._support.atomic import require_regular, written_whole
from uwaug.fitting.noise import Noise
from uwaug.fitting.report import Candidate, Parameter
from uwaug.fitting.structure import Structure

__all__ = ["FIT", "SERIES", "Kind", "packed", "read", "unpacked", "write"]

_FORMAT = 1

T = TypeVar("T")


class Kind(NamedTuple):
    """What a file holds.

    Attributes:
        key: that only such files have; its value is the format.
        name: with its article.
        maker: the class that writes it.
        other: the sentence on a file of another format than `wanted`.
    """

    key: str
    name: str
    maker: str
    other: str


FIT = Kind("uwaug_fit", "a fit", "Fit", "expected a fit of format {wanted}, got format {got}")
SERIES = Kind("uwaug_series", "a series", "SeriesFit", "expected format {wanted}, got {got}")


def write(path: str | os.PathLike[str], kind: Kind, values: Mapping[str, Any]) -> None:
    """Write what `read` gives back, whole or not at all."""
    from importlib.metadata import version

    text = json.dumps({kind.key: _FORMAT, "uwaug": version("uwaug"), **values}, indent=1)
    with written_whole(path) as part:
        part.write_text(text + "\n", encoding="utf-8")


def read(path: str | os.PathLike[str], kind: Kind, made: Callable[[Mapping[str, Any]], T]) -> T:
    """What is made of the values in a file.

    Raises:
        ValueError: if the file is of another kind, or of a newer version; names it.
        OSError: if it cannot be read.
    """
    require_regular(path)
    try:
        values = json.loads(Path(path).read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not {kind.name}: {error}") from None
    known = values if isinstance(values, dict) else {}
    for other in (FIT, SERIES):
        if other is not kind and other.key in known:
            raise ValueError(f"{path}: {other.name}, not {kind.name}: see {other.maker}.load")
    if kind.key not in known:
        wanted = f"expected a file written by {kind.maker}.save"
        raise ValueError(f"{path}: not {kind.name}: {wanted}")
    if known[kind.key] != _FORMAT:
        words = kind.other.format(wanted=_FORMAT, got=repr(known[kind.key]))
        raise ValueError(f"{path}: {words}, written by uwaug {known.get('uwaug')}")
    try:
        return made(known)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: not {kind.name}: {type(error).__name__}: {error}") from None


def packed(fit: Any) -> dict[str, Any]:
    """What fits of all kinds have, as JSON holds it."""
    return {
        "model": fit.model,
        "message": fit.message,
        "parameters": {name: asdict(one) for name, one in fit.parameters.items()},
        "candidates": [one._asdict() for one in fit.candidates],
        "noise": asdict(fit.noise),
        "rms": fit.rms,
        "theta": fit.theta.tolist(),
        "covariance": fit.covariance.tolist(),
    }


def unpacked(values: Mapping[str, Any], structure: Structure) -> dict[str, Any]:
    """The same as a fit of this structure holds it; numbers that cannot be its own are refused."""
    theta, covariance = np.array(values["theta"]), np.array(values["covariance"])
    bounds = structure.bounds.values()
    n = len(bounds)
    if theta.shape != (n,) or covariance.shape != (n, n):
        raise ValueError(f"theta and covariance must hold {n} numbers, got {theta.shape}")
    low, high = np.array([one.low for one in bounds]), np.array([one.high for one in bounds])
    if not ((theta >= low) & (theta <= high)).all() or not np.isfinite(covariance).all():
        raise ValueError("theta must lie within its bounds, and covariance be finite")
    return {
        "model": values["model"],
        "message": values["message"],
        "parameters": {name: Parameter(**one) for name, one in values["parameters"].items()},
        "candidates": tuple(Candidate(**one) for one in values["candidates"]),
        "noise": Noise(**values["noise"]),
        "rms": values["rms"],
        "theta": theta,
        "covariance": covariance,
        "structure": structure,
    }
