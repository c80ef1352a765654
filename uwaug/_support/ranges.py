"""Ranges from which numbers are drawn."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from uwaug._support import checks

Range = float | tuple[float, float]  # number, or (low, high)


def as_range(
    name: str, value: object, least: float = -math.inf, most: float = math.inf, unit: str = ""
) -> tuple[float, float]:
    """Return a number or a range as (low, high); refuse anything else, a range that falls, and
    numbers that are infinite or leave [least, most].
    """
    low = high = math.nan
    if isinstance(value, (int, float, np.number)) and not isinstance(value, bool):
        low = high = float(value)
    elif (ends := ends_of(value)) is not None:
        (low, _), (high, _) = (as_range(name, end, least, most, unit) for end in ends)
    if not (least <= low <= high <= most and math.isfinite(low) and math.isfinite(high)):
        domain = f"{checks.bounds(least, most)} {unit}".rstrip()
        expected = f"a number or a range (low, high) with low ≤ high, {domain}"
        raise ValueError(f"{name} must be {expected}; got {value!r}")
    return low, high


def ends_of(value: Any) -> tuple[Any, Any] | None:
    """Return the ends of a range in any sequence, array or tensor of two; None for all else."""
    if isinstance(value, (str, bytes, Mapping)) or not hasattr(value, "__getitem__"):
        return None
    ends = tuple(value.tolist() if hasattr(value, "tolist") else value)
    return (ends[0], ends[1]) if len(ends) == 2 else None


def read_range(text: str) -> Range | None:
    """Read a number or a range, such as ".4" or "1:5"; None where the text is neither."""
    try:
        ends = [float(part) for part in text.split(":")]
    except ValueError:
        return None
    return ends[0] if len(ends) == 1 else (ends[0], ends[1]) if len(ends) == 2 else None
