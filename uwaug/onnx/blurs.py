"""The blurs of a plan as convolutions, for pictures of any size.

`uwaug.blur` works in blocks and caches that a graph has no room for. Here all but the widest blurs
are convolutions with a channel for each px, or cell, of a period: one window serves a period of
results, which is twice as fast as a window for each. Work is done in whole periods of rows and
columns, which go beyond the picture and are cut off at the end.
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
from uwaug.blur.plan import BlurPlan

_FEW_TAPS = 8
"""Taps; a kernel of fewer is as fast with a window for each px."""

_ROWS, _COLUMNS = 2, 3


class Blurs(nn.Module):
    """The stack of blurs of a plan; in place of `uwaug.blur.stack.blurred`."""

    def __init__(self, plan: BlurPlan) -> None:
        super().__init__()
        nodes = zip(plan.sigmas, plan.cells, strict=True)
        self.stack = nn.ModuleList(_blur_of(sigma, cell, plan.reach) for sigma, cell in nodes)

    def forward(self, light: Tensor, plan: BlurPlan) -> list[Tensor]:
        """The blurs (K tensors, Bx3xHxW) of linear light (Bx3xHxW)."""
        return [blur(light) for blur in self.stack]


def _blur_of(sigma: float, cell: float, reach: float) -> nn.Module:
    """One blur of a plan."""
    if sigma == 0:
        return nn.Identity()
    return (_Fine if cell == 1 else _Coarse if cell <= PERIOD else _Wide)(sigma, cell, reach)


class _Fine(nn.Module):
    """On the image's own grid: one convolution along each axis."""

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        kernel = blur_kernel(sigma, reach)
        self.radius = kernel.shape[1] // 2
        phases = 1 if kernel.shape[1] < _FEW_TAPS else PERIOD
        window = _window(torch.arange(phases), kernel.expand(phases, -1))
        self.register_buffer("window", window)

    def forward(self, x: Tensor) -> Tensor:
        window = self.get_buffer("window")
        for axis in (_ROWS, _COLUMNS):
            size, phases = x.shape[axis], len(window)
            around = _folded(x, axis, self.radius, self.radius, phases)
            x = _strided(around, window, phases, axis).narrow(axis, 0, size)
        return x


class _Coarse(nn.Module):
    """On a grid of whole cells for every `PERIOD` px: one strided convolution along each axis and
    back, with a channel for each cell of a period, or each px.
    """

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        a, q = per_cell(cell)
        self.cells = a * (PERIOD // q)
        cells = torch.arange(-MARGIN, self.cells - MARGIN)
        first, kernel = shrink_kernels(cells, self.cells, PERIOD, sigma, reach)
        shrink = _window(first, kernel)
        enlarge = _window(*enlarge_kernels(torch.arange(PERIOD), self.cells, PERIOD))
        self.register_buffer("shrink", shrink)
        self.register_buffer("enlarge", enlarge)
        # the last px need cells beyond their own period: so many whole periods of them
        more = -(-(enlarge.shape[1] - self.cells) // self.cells)
        self.lead = -int(first[0])
        self.tail = PERIOD * (more - 1) + shrink.shape[1] - self.lead

    def forward(self, x: Tensor) -> Tensor:
        height, width = x.shape[-2:]
        shrink, enlarge = self.get_buffer("shrink"), self.get_buffer("enlarge")
        for axis in (_ROWS, _COLUMNS):
            x = _strided(_folded(x, axis, self.lead, self.tail, PERIOD), shrink, PERIOD, axis)
        x = _strided(x, enlarge, self.cells, _COLUMNS).narrow(_COLUMNS, 0, width)
        return _strided(x, enlarge, self.cells, _ROWS).narrow(_ROWS, 0, height)


class _Wide(nn.Module):
    """On a grid with cells of several periods: dense matrices, which are small; the kernel may
    exceed the image.
    """

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        self.pitch = round(cell)
        cell_0 = torch.zeros(1, dtype=torch.int64)
        first, kernel = shrink_kernels(cell_0, 1, self.pitch, sigma, reach)
        self.first = int(first[0])
        self.register_buffer("shrink", kernel.to(torch.float32))
        starts, spline = enlarge_kernels(torch.arange(self.pitch), 1, self.pitch)
        self.register_buffer("starts", starts)
        self.register_buffer("enlarge", spline.to(torch.float32))

    def forward(self, x: Tensor) -> Tensor:
        (shrink_rows, enlarge_rows), (shrink_columns, enlarge_columns) = (
            self._matrices(n) for n in x.shape[-2:]
        )
        x = (shrink_rows @ x) @ shrink_columns.t()
        return enlarge_rows @ (x @ enlarge_columns.t())

    def _matrices(self, size: int) -> tuple[Tensor, Tensor]:
        """(cells, size) and (size, cells)."""
        kernel = self.get_buffer("shrink")
        # of positive numbers: ONNX's division truncates
        cells = (size + self.pitch - 1) // self.pitch + 2 * MARGIN
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
        first = self.get_buffer("starts")[within] + (px - within) // pitch + MARGIN
        enlarge = torch.zeros(size, cells, dtype=torch.float32)
        return shrink, enlarge.scatter_add(
            1, first[:, None] + torch.arange(4), self.get_buffer("enlarge")[within]
        )


def _window(first: Tensor, kernel: Tensor) -> Tensor:
    """(n, taps) kernels that begin at `first` as rows of one window that begins at the first of
    them.
    """
    offset = first - first[0]
    rows = torch.zeros(len(first), int(offset[-1]) + kernel.shape[1], dtype=torch.float64)
    columns = offset[:, None] + torch.arange(kernel.shape[1])
    return rows.scatter_(1, columns, kernel).to(torch.float32)


def _folded(x: Tensor, axis: int, lead: int, tail: int, period: int) -> Tensor:
    """X (BxCxHxW) with `lead` px before an axis, and after it whole periods and `tail` px; folded
    back at the edges.
    """
    size = x.shape[axis]
    periods = (size + period - 1) // period * period
    px = reflect(torch.arange(-lead, periods + tail), size)
    if axis == _ROWS:
        return x.index_select(axis, px)
    # to gather whole rows would copy them value by value
    before, after = px.narrow(0, 0, lead), px.narrow(0, lead + size, periods - size + tail)
    return torch.cat([x.index_select(axis, before), x, x.index_select(axis, after)], axis)


def _strided(x: Tensor, window: Tensor, stride: int, axis: int) -> Tensor:
    """The n kernels of a window (n, taps) at every `stride` along an axis, their results in turn.

    One pixel_shuffle for both axes is quicker to trace, but the convolutions of 3·16 groups that it
    takes keep two threads waiting for each other: 1024² in 2.3 times the time.
    """
    n, taps = window.shape
    weights = window.repeat(3, 1).reshape(3 * n, 1, *((taps, 1) if axis == _ROWS else (1, taps)))
    y = F.conv2d(x, weights, stride=(stride, 1) if axis == _ROWS else (1, stride), groups=3)
    if n == 1:
        return y
    y = torch.unflatten(y, 1, (3, n))
    return y.transpose(2, 3).flatten(2, 3) if axis == _ROWS else y.permute(0, 1, 3, 4, 2).flatten(3)
