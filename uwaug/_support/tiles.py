"""Pictures and maps that are made a few rows at a time, so that a large one is never held whole."""

from collections.abc import Callable, Iterator

import torch
from torch import Tensor

__all__ = ["Rows", "at_pixels", "bands", "extremes", "held"]

Rows = Callable[[int, int], Tensor]
"""What makes rows `start` to `stop` of a picture or map: (CxRxW tensor)."""

_BAND = 1 << 21
"""Pixels of a band: of float32, 24 MiB of a picture."""


def held(picture: Tensor) -> Rows:
    """The rows of a picture (CxHxW) that is there."""
    return lambda start, stop: picture[:, start:stop]


def bands(height: int, width: int, multiple: int = 1) -> Iterator[tuple[int, int]]:
    """First row and end of each band; whole multiples of rows, but for the last."""
    rows = multiple * max(1, _BAND // (multiple * width))
    for start in range(0, height, rows):
        yield start, min(start + rows, height)


def at_pixels(values: Rows, size: tuple[int, int], pixels: Tensor) -> Tensor:
    """The values (CxN) of some pixels, given by their flat indices (N)."""
    height, width = size
    row, column = pixels // width, pixels % width
    found: Tensor | None = None
    for start, stop in bands(height, width):
        inside = (row >= start) & (row < stop)
        if not bool(inside.any()):
            continue
        band = values(start, stop)
        if found is None:
            found = band.new_empty(len(band), len(pixels))
        found[:, inside] = band[:, row[inside] - start, column[inside]]
    return torch.empty(0, 0) if found is None else found


def extremes(values: Rows, size: tuple[int, int]) -> tuple[float, float]:
    """The least and the largest value; NaN if there is any."""
    ends = [values(start, stop).aminmax() for start, stop in bands(*size)]
    low, high = torch.stack([end.min for end in ends]), torch.stack([end.max for end in ends])
    return float(low.amin()), float(high.amax())
