"""Parts of pictures and maps; and large ones that are made a few rows at a time, so that none is
ever held whole.
"""

from collections.abc import Callable, Iterator
from types import EllipsisType

import torch
from torch import Tensor

Rows = Callable[[int, int], Tensor]
"""What makes rows `start` to `stop` of a picture or map: (CxRxW tensor)."""

Tile = EllipsisType | tuple[EllipsisType, slice, slice]
"""Rows and columns, as an index of tensors and of row sources; `...` for all of them."""

LARGE = 24_000_000
"""Pixels from which no light and no map of a picture is held whole. That would take 40 bytes a
pixel, 1 GB here.
"""

_BAND = 1 << 21
"""Pixels of a band: of float32, 24 MiB of a picture."""


def is_large(size: tuple[int, int]) -> bool:
    """Whether a picture of (height, width) `size` is made in rows."""
    return size[0] * size[1] >= LARGE


class RowSource:
    """A picture or map that is made as it is asked for; tiles of it are `source[..., rows,
    columns]` (1xCxRxS), as of a tensor.

    Args:
        rows: makes some rows.
        shape: channels, height and width.
        like: a tensor of their type and device.
    """

    def __init__(self, rows: Rows, shape: tuple[int, int, int], like: Tensor) -> None:
        self.rows = rows
        self.like = like.new_empty(1)
        self.shape = torch.Size((1, *shape))
        # tiles of the same rows follow each other
        self._last: tuple[int, int, Tensor] = (0, 0, torch.empty(0))

    def __len__(self) -> int:
        return 1

    @property
    def device(self) -> torch.device:
        """Where its rows are made."""
        return self.like.device

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.shape[-2], self.shape[-1]

    def __getitem__(self, tile: Tile) -> Tensor:
        _, rows, columns = (..., slice(None), slice(None)) if tile is ... else tile
        start, stop, _ = rows.indices(self.shape[-2])
        first, end, values = self._last
        if not first <= start <= stop <= end:
            first, end, values = self._last = start, stop, self.rows(start, stop)
        return values[None, :, start - first : stop - first, columns]

    def at(self, pixels: Tensor) -> Tensor:
        """The values (CxN) of some pixels, given by their flat indices (N)."""
        return at_pixels(self.rows, self.size, pixels)


def rows_of(x: Tensor | RowSource) -> Rows:
    """The rows of a picture or map, be it there (CxHxW or 1xCxHxW) or made as it is asked for."""
    if isinstance(x, RowSource):
        return x.rows
    picture = x.reshape(x.shape[-3:])
    return lambda start, stop: picture[:, start:stop]


def row_bands(height: int, width: int, multiple: int = 1) -> Iterator[tuple[int, int]]:
    """First row and end of each band; whole multiples of rows, but for the last."""
    rows = multiple * max(1, _BAND // (multiple * width))
    for start in range(0, height, rows):
        yield start, min(start + rows, height)


def at_pixels(values: Rows, size: tuple[int, int], pixels: Tensor) -> Tensor:
    """The values (CxN) of some pixels, given by their flat indices (N)."""
    height, width = size
    row, column = pixels // width, pixels % width
    sampled: Tensor | None = None
    for start, stop in row_bands(height, width):
        inside = (row >= start) & (row < stop)
        if not bool(inside.any()):
            continue
        band = values(start, stop)
        if sampled is None:
            sampled = band.new_empty(len(band), len(pixels))
        sampled[:, inside] = band[:, row[inside] - start, column[inside]]
    return torch.empty(0, 0) if sampled is None else sampled
