"""The blurs of a plan as a graph has them: what is done once on a whole picture, and what is left
for each strip of rows.

`uwaug.blur` works in blocks and caches that a graph has no room for. Here all but the widest blurs
are convolutions with a channel for each px, or cell, of a period: one window serves a period of
results, which is twice as fast as a window for each.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from uwaug.blur.kernels import (
    MARGIN,
    PERIOD,
    blur_kernel,
    enlarge_kernels,
    per_cell,
    reflect,
    shrink_kernels,
)
from uwaug.onnx.strips import PICTURE, Rows

__all__ = ["Blur", "blur_of"]


class Blur(nn.Module):
    """One blur of a stack; as it is, none (σ = 0).

    Attributes:
        rows: those that a strip is made of: of the picture, or of what `before` makes of it.
        prepared: whether there is anything to do before.
    """

    rows = PICTURE
    prepared = False

    def before(self, x: Tensor) -> Tensor:
        """What is done once, on the whole picture (BxCxHxW)."""
        return x

    def within(self, part: Tensor) -> Tensor:
        """A strip of the blurred picture from its rows."""
        return part

    def forward(self, x: Tensor) -> Tensor:
        """The whole picture blurred, as one strip."""
        height = x.shape[2]
        # a period to spare: torch.export takes it for granted that a free size is not 1
        strip = torch.arange((height + PERIOD - 1) // PERIOD * PERIOD + PERIOD)
        strip = self.within(self.rows.of(self.before(x), strip))
        # not narrowed: torch.export would take the height for whole periods
        return strip.index_select(2, torch.arange(height))


def blur_of(sigma: float, cell: float, reach: float) -> Blur:
    """One blur of a plan."""
    if sigma == 0:
        return Blur()
    return (_Fine if cell == 1 else _Coarse if cell <= PERIOD else _Wide)(sigma, cell, reach)


class _Fine(Blur):
    """On the image's own grid: one convolution along each axis."""

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        kernel = blur_kernel(sigma, reach)
        self.margin = kernel.shape[1] // 2
        self.rows = Rows(PERIOD, -self.margin, self.margin)
        self.phases = 1 if kernel.shape[1] < _FEW else PERIOD
        window = _windows(torch.arange(self.phases), kernel.expand(self.phases, -1))
        self.register_buffer("kernel", window)

    def within(self, part: Tensor) -> Tensor:
        kernel, width = self.get_buffer("kernel"), part.shape[3]
        x, end = _strided(part, kernel, self.phases, 2), width
        if self.phases > 1:
            # a period to spare, as in `forward`
            end = (width + PERIOD - 1) // PERIOD * PERIOD + PERIOD
        x = _extended(x, -self.margin, end + self.margin, 3)
        x = _strided(x, kernel, self.phases, 3)
        return x if self.phases == 1 else x.narrow(3, 0, width)


_FEW = 8
"""Taps; a kernel of fewer is as fast with a window for each px."""


class _Coarse(Blur):
    """On a grid of whole cells for every `PERIOD` px: one strided convolution along each axis and
    back, with a channel for each cell of a period, or each px.
    """

    prepared = True

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        a, q = per_cell(cell)
        self.cells = a * (PERIOD // q)
        cells = torch.arange(-MARGIN, self.cells - MARGIN)
        first, kernel = shrink_kernels(cells, self.cells, PERIOD, sigma, reach)
        self.first = int(first[0])
        self.register_buffer("shrink", _windows(first, kernel))
        enlarge = _windows(*enlarge_kernels(torch.arange(PERIOD), self.cells, PERIOD))
        self.register_buffer("enlarge", enlarge)
        self.rows = Rows(self.cells, 0, enlarge.shape[1] - self.cells)

    def before(self, x: Tensor) -> Tensor:
        shrink, enlarge = self.get_buffer("shrink"), self.get_buffer("enlarge")
        # periods of cells that the last px need beyond their own
        more, width = -(-enlarge.shape[1] // self.cells) - 1, x.shape[3]
        for axis in (2, 3):
            # one to spare, as in `forward`
            last = (x.shape[axis] + PERIOD - 1) // PERIOD + more
            end = self.first + PERIOD * last + shrink.shape[1]
            x = _strided(_extended(x, self.first, end, axis), shrink, PERIOD, axis)
        return _strided(x, enlarge, self.cells, 3).narrow(3, 0, width)

    def within(self, part: Tensor) -> Tensor:
        return _strided(part, self.get_buffer("enlarge"), self.cells, 2)


class _Wide(Blur):
    """On a grid with cells of several periods: dense matrices, which are small; the kernel may
    exceed the image.
    """

    prepared = True

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        self.pitch = round(cell)
        first, kernel = shrink_kernels(
            torch.zeros(1, dtype=torch.int64), 1, self.pitch, sigma, reach
        )
        self.first = int(first[0])
        self.register_buffer("shrink", kernel.to(torch.float32))
        starts, spline = enlarge_kernels(torch.arange(self.pitch), 1, self.pitch)
        self.starts: list[int] = starts.tolist()
        self.register_buffer("enlarge", spline.to(torch.float32))

    def before(self, x: Tensor) -> Tensor:
        (shrink_rows, enlarge_rows), (shrink_columns, enlarge_columns) = (
            self._matrices(n) for n in x.shape[-2:]
        )
        x = (shrink_rows @ x) @ shrink_columns.t()
        return enlarge_rows @ (x @ enlarge_columns.t())

    def _matrices(self, size: int) -> tuple[Tensor, Tensor]:
        """(cells, size) and (size, cells)."""
        kernel = self.get_buffer("shrink")
        cells = (
            size + self.pitch - 1
        ) // self.pitch + 2 * MARGIN  # of positive numbers: ONNX's division truncates
        first = self.first + self.pitch * torch.arange(-MARGIN, cells - MARGIN)
        # derived from `size`, so that the exporter computes the indices at run time instead of
        # storing them
        taps = torch.arange(size + kernel.shape[1])[: kernel.shape[1]]
        columns = reflect(first[:, None] + taps, size)
        shrink = torch.zeros(cells, size, dtype=torch.float32).scatter_add(
            1, columns, kernel.expand(cells, -1)
        )
        px = torch.arange(size)
        pitch = torch.full((1,), self.pitch, dtype=torch.int64)
        within = torch.remainder(px, pitch)
        first = torch.tensor(self.starts)[within] + (px - within) // pitch + MARGIN
        enlarge = torch.zeros(size, cells, dtype=torch.float32)
        return shrink, enlarge.scatter_add(
            1, first[:, None] + torch.arange(4), self.get_buffer("enlarge")[within]
        )


def _windows(first: Tensor, kernel: Tensor) -> Tensor:
    """(n, taps) kernels that begin at `first` as rows of one window that begins at the first of
    them.
    """
    offset = first - first[0]
    rows = torch.zeros(len(first), int(offset[-1]) + kernel.shape[1], dtype=torch.float64)
    return rows.scatter_(1, offset[:, None] + torch.arange(kernel.shape[1]), kernel).to(
        torch.float32
    )


def _extended(x: Tensor, first: int, end: int, axis: int) -> Tensor:
    """An axis from px `first` ≤ 0 to `end` ≥ its size, half-sample symmetric."""
    size = x.shape[axis]
    index = reflect(torch.arange(first, end), size)
    if axis == 2:
        return x.index_select(2, index)
    # to gather whole rows would copy them value by value
    left, right = x.index_select(3, index[:-first]), x.index_select(3, index[size - first :])
    return torch.cat([left, x, right], 3)


def _strided(x: Tensor, kernels: Tensor, stride: int, axis: int) -> Tensor:
    """The n kernels (n, taps) at every `stride` along an axis, their results in turn."""
    n, taps = kernels.shape
    weights = kernels.repeat(3, 1).reshape(3 * n, 1, *((taps, 1) if axis == 2 else (1, taps)))
    y = F.conv2d(x, weights, stride=(stride, 1) if axis == 2 else (1, stride), groups=3)
    if n == 1:
        return y
    y = torch.unflatten(y, 1, (3, n))
    return y.transpose(2, 3).flatten(2, 3) if axis == 2 else y.permute(0, 1, 3, 4, 2).flatten(3, 4)
