"""Blurs of a plan as convolutions, for pictures of any size.

All but the widest blurs are convolutions with a channel for each px, or cell, of a period. All
results of a period come from one window, which is twice as fast as a window for each. What lies
beyond the picture, up to whole periods, is cut off at the end.

Blurs end, and are mixed, with their rows in order of phase: row 0 of all periods, row 1 of all, and
so on. That is how a convolution leaves them, and only the mixture is brought into the rows' order.
"""

from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from uwaug.blur.kernels import (
    HALVING,
    MARGIN,
    PERIOD,
    blur_kernel,
    enlarge_kernels,
    per_cell,
    reflect,
    rest_of,
    shrink_kernels,
)
from uwaug.blur.plan import BlurPlan
from uwaug.blur.stack import node_weights

_ROWS, _COLUMNS = 2, 3
_HALF_PERIOD = PERIOD // 2  # px of the half picture


class Blurs(nn.Module):
    """The varying blur of a plan, in place of `uwaug.blur.stack.blurred` and `mixed`."""

    def __init__(self, plan: BlurPlan) -> None:
        super().__init__()
        self.plan, self.halve, self.stack = plan, _Half(), nn.ModuleList()
        for sigma, cell in zip(plan.sigmas, plan.cells, strict=True):
            kind = _Fine if cell == 1 else _Coarse if cell < PERIOD else _Wide
            self.stack.append(kind(sigma, cell, plan.reach) if sigma else nn.Identity())

    def forward(self, light: Tensor, widths: Tensor) -> Tensor:
        """Blur linear light (Bx3xHxW) at each pixel by its width (Bx1xHxW, px)."""
        size, row = light.shape, torch.arange(light.shape[_ROWS])
        # all numbers are positive, as ONNX's division truncates
        in_order = row % PERIOD * _periods(size[_ROWS]) + row // PERIOD
        half = self.halve(light) if max(self.plan.cells) > 1 else light
        terms, mixture, rows = [], [], self._rows(half, size)
        weights = node_weights(_by_phase(widths), self.plan)
        for share, blur in zip(torch.split(weights, 1, 1), self.stack, strict=True):
            if isinstance(blur, nn.Identity):
                terms.append(share.index_select(_ROWS, in_order) * light)
            elif isinstance(blur, _Wide):
                mixture.append(share * blur(next(rows), size))
            elif isinstance(blur, _Coarse):
                mixture.append(share * blur(half, size))
            else:
                mixture.append(share * blur(light))
        if mixture:
            terms.append(sum(mixture[1:], mixture[0]).index_select(_ROWS, in_order))
        return sum(terms[1:], terms[0])

    def _rows(self, half: Tensor, size: torch.Size) -> Iterator[Tensor]:
        """The half picture with rows on the grid of each wide blur, by one product."""
        wide = [blur for blur in self.stack if isinstance(blur, _Wide)]
        if wide:
            shrink = [blur.shrinking(size[_ROWS], half.shape[_ROWS]) for blur in wide]
            rows, first = torch.cat(shrink) @ half, 0
            for matrix in shrink:
                cells = matrix.shape[0]  # len() of it would be fixed in a graph
                yield rows.narrow(_ROWS, first, cells)  # a split would stop ONNX Runtime's tools
                first += cells


class _Half(nn.Module):
    """The half picture up to whole periods, mirrored, see `uwaug.blur.kernels.HALVING`."""

    def __init__(self) -> None:
        super().__init__()
        kernel = torch.from_numpy(HALVING).expand(_HALF_PERIOD, -1)
        first = 2 * torch.arange(_HALF_PERIOD)
        self.lead = len(HALVING) // 2 - 1
        self.register_buffer("window", _window(first, kernel))

    def forward(self, x: Tensor) -> Tensor:
        window = self.get_buffer("window")
        for axis in (_ROWS, _COLUMNS):
            x = _folded(x, axis, 2 * x.shape[axis], self.lead, self.lead, PERIOD)
            x = _strided(x, window, PERIOD, axis)
        return x


class _Fine(nn.Module):
    """Blur on the image's grid: one convolution along each axis."""

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        kernel = blur_kernel(sigma, reach)
        self.radius = kernel.shape[1] // 2
        self.register_buffer("window", _window(torch.arange(PERIOD), kernel.expand(PERIOD, -1)))
        self.register_buffer("kernel", kernel.to(torch.float32))

    def forward(self, x: Tensor) -> Tensor:
        size, reach = x.shape, (self.radius, self.radius)
        folded = _folded(x, _ROWS, 2 * size[_ROWS], *reach, PERIOD)
        phases = _convolved(folded, self.get_buffer("window"), PERIOD, _ROWS)
        # a channel for each phase: sixteen at once are three times as fast as one by one
        phases = _folded(phases, _COLUMNS, 2 * size[_COLUMNS], *reach, 1)
        kernel = self.get_buffer("kernel").repeat(3 * PERIOD, 1)[:, None, None]
        return _joined(F.conv2d(phases, kernel, groups=3 * PERIOD), size)


class _Coarse(nn.Module):
    """Blur on a grid of whole cells for every `PERIOD` px: one strided convolution of the half
    picture along each axis and back, with a channel for each cell of a period, or each px.
    """

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        a, q = per_cell(cell)
        self.cells = a * (PERIOD // q)
        cells = torch.arange(-MARGIN, self.cells - MARGIN)
        first, kernel = shrink_kernels(cells, self.cells, _HALF_PERIOD, rest_of(sigma), reach)
        shrink = _window(first, kernel)
        enlarge = _window(*enlarge_kernels(torch.arange(PERIOD), self.cells, PERIOD))
        self.register_buffer("shrink", shrink)
        self.register_buffer("enlarge", enlarge)
        # the last px need so many periods of cells beyond their own
        more = -(-(enlarge.shape[1] - self.cells) // self.cells)
        self.lead = -int(first[0])
        self.tail = _HALF_PERIOD * (more - 1) + shrink.shape[1] - self.lead

    def forward(self, x: Tensor, size: torch.Size) -> Tensor:
        """Blur a half picture, of a picture of `size`."""
        shrink, enlarge = self.get_buffer("shrink"), self.get_buffer("enlarge")
        for axis in (_ROWS, _COLUMNS):
            x = _folded(x, axis, size[axis], self.lead, self.tail, _HALF_PERIOD)
            x = _strided(x, shrink, _HALF_PERIOD, axis)
        x = _strided(x, enlarge, self.cells, _COLUMNS).narrow(_COLUMNS, 0, size[_COLUMNS])
        return _joined(_convolved(x, enlarge, self.cells, _ROWS), size)


class _Wide(nn.Module):
    """Blur on a grid with cells of several periods, by small dense matrices."""

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        self.pitch = round(cell)
        cell_0 = torch.zeros(1, dtype=torch.int64)
        first, kernel = shrink_kernels(cell_0, 1, self.pitch // 2, rest_of(sigma), reach)
        self.first = int(first[0])
        self.register_buffer("shrink", kernel.to(torch.float32))
        starts, spline = enlarge_kernels(torch.arange(self.pitch), 1, self.pitch)
        self.register_buffer("starts", starts)
        self.register_buffer("enlarge", spline.to(torch.float32))

    def forward(self, x: Tensor, size: torch.Size) -> Tensor:
        """Blur a half picture whose rows are on the grid, of a picture of `size`."""
        shrink = self.shrinking(size[_COLUMNS], x.shape[_COLUMNS])
        wide = x @ shrink.t() @ self.enlarging(size[_COLUMNS]).t()
        return _by_phase(self.enlarging(size[_ROWS])) @ wide

    def _cells(self, size: int) -> int:
        # all numbers are positive, as ONNX's division truncates
        return (size + self.pitch - 1) // self.pitch + 2 * MARGIN

    def shrinking(self, size: int, half: int) -> Tensor:
        """Matrix (cells, half) to the grid of an axis of `size` px."""
        kernel, cells = self.get_buffer("shrink"), self._cells(size)
        first = self.first + self.pitch // 2 * torch.arange(-MARGIN, cells - MARGIN)
        # from `half`, so that the exporter computes the indices at run time and stores none
        taps = torch.arange(half + kernel.shape[1])[: kernel.shape[1]]
        columns = reflect(first[:, None] + taps, size)
        shrink = torch.zeros(cells, half, dtype=torch.float32)
        return shrink.scatter_add(1, columns, kernel.expand(cells, -1))

    def enlarging(self, size: int) -> Tensor:
        """Matrix (size, cells) back to the picture."""
        px = torch.arange(size)
        pitch = torch.full((1,), self.pitch, dtype=torch.int64)
        phase = torch.remainder(px, pitch)
        first = self.get_buffer("starts")[phase] + (px - phase) // pitch + MARGIN
        columns, weights = first[:, None] + torch.arange(4), self.get_buffer("enlarge")[phase]
        enlarge = torch.zeros(size, self._cells(size), dtype=torch.float32)
        return enlarge.scatter_add(1, columns, weights)


def _window(first: Tensor, kernel: Tensor) -> Tensor:
    """Put kernels (n, taps) that begin at `first` into rows of one window."""
    offset = first - first[0]
    rows = torch.zeros(len(first), int(offset[-1]) + kernel.shape[1], dtype=torch.float64)
    columns = offset[:, None] + torch.arange(kernel.shape[1])
    return rows.scatter_(1, columns, kernel).to(torch.float32)


def _periods(size: int) -> int:
    return (size + PERIOD - 1) // PERIOD


def _by_phase(x: Tensor) -> Tensor:
    """Rows (second-last axis) in order of phase, folded back in the last period."""
    height, place = x.shape[-2], torch.arange(PERIOD * _periods(x.shape[-2]))
    # a tensor, as ONNX has no remainder by a symbolic number
    periods = torch.full((1,), _periods(height), dtype=torch.int64)
    rows = reflect(place % periods * PERIOD + place // periods, 2 * height)
    return x.index_select(-2, rows)


def _joined(phases: Tensor, size: torch.Size) -> Tensor:
    """Channels of phases (Bx48xPxW) as rows in order of phase, of a picture of `size`."""
    return phases.reshape(size[0], 3, PERIOD * _periods(size[_ROWS]), size[_COLUMNS])


def _folded(x: Tensor, axis: int, turn: int, lead: int, tail: int, period: int) -> Tensor:
    """Extend x (BxCxHxW) by px that are folded back at the edges, see `reflect`: `lead` before an
    axis, and after it up to whole periods and `tail`.
    """
    size = x.shape[axis]
    periods = (size + period - 1) // period * period
    px = reflect(torch.arange(-lead, periods + tail), turn)
    # to gather all of a row would copy it value by value
    before, after = px.narrow(0, 0, lead), px.narrow(0, lead + size, periods - size + tail)
    return torch.cat([x.index_select(axis, before), x, x.index_select(axis, after)], axis)


def _convolved(x: Tensor, window: Tensor, stride: int, axis: int) -> Tensor:
    """Apply the n kernels of a window (n, taps) at each `stride` of an axis: Bx(3·n)x…"""
    n, taps = window.shape
    weights = window.repeat(3, 1).reshape(3 * n, 1, *((taps, 1) if axis == _ROWS else (1, taps)))
    return F.conv2d(x, weights, stride=(stride, 1) if axis == _ROWS else (1, stride), groups=3)


def _strided(x: Tensor, window: Tensor, stride: int, axis: int) -> Tensor:
    """The same as Bx3x…: along the axis, results alternate."""
    # one pixel_shuffle for both axes is quicker to trace, but in convolutions of 3·16 groups two
    # threads wait for each other: 1024² takes 2.3 times as long
    y = torch.unflatten(_convolved(x, window, stride, axis), 1, (3, len(window)))
    return y.transpose(2, 3).flatten(2, 3) if axis == _ROWS else y.permute(0, 1, 3, 4, 2).flatten(3)
