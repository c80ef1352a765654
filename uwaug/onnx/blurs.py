"""The blurs of a plan as convolutions, for pictures of any size.

`uwaug.blur` works in blocks and caches that a graph has no room for. Here all but the widest blurs
are convolutions with a channel for each px, or cell, of a period: one window serves a period of
results, which is twice as fast as a window for each. Work is done in whole periods of rows and
columns, which may go beyond the picture.

A length in whole periods comes as a tensor of that length. To a tracer it is a size of its own;
quotients and remainders of height and width take most of its time.
"""

from collections.abc import Mapping
from typing import NamedTuple

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

_FEW = 8
"""Taps; a kernel of fewer is as fast with a window for each px."""

Size = tuple[int, int]
"""Height and width, px; in a trace, symbols."""


class Folds(NamedTuple):
    """The numbers of an axis's px, and of those around the picture, where it is folded back.

    Attributes:
        numbers: from `lead` px before the picture to `tail` px beyond its last period.
        lead, tail: px.
    """

    numbers: Tensor
    lead: int
    tail: int

    def rows(self, x: Tensor, lead: int, length: int) -> Tensor:
        """So many rows of x (B×C×H×W) from `lead` px before it on."""
        return x.index_select(2, self.numbers.narrow(0, self.lead - lead, length))

    def columns(self, x: Tensor, lead: int, tail: int) -> Tensor:
        """X (B×C×H×W) with `lead` columns before it and a period, less 1 px, and `tail` after."""
        left = self.numbers.narrow(0, self.lead - lead, lead)
        right = self.numbers.narrow(0, self.lead + x.shape[3], PERIOD - 1 + tail)
        # to gather whole rows would copy them value by value
        return torch.cat([x.index_select(3, left), x, x.index_select(3, right)], 3)


class Picture(NamedTuple):
    """A whole picture.

    Attributes:
        light: B×3×H×W.
        rows, columns: of it.
        whole: height and width in whole periods, px.
    """

    light: Tensor
    rows: Folds
    columns: Folds
    whole: Size


class Strip(NamedTuple):
    """Some rows of a picture.

    Attributes:
        numbers: of the rows (R): whole periods, which may go beyond the picture.
        light: B×3×R×W.
        around: the same with `margin` px above and below, before and, beyond whole periods, after.
        margin: px.
        across: width in whole periods, px.
    """

    numbers: Tensor
    light: Tensor
    around: Tensor
    margin: int
    across: int


class Blur(nn.Module):
    """One blur of a stack; as it is, none (σ = 0).

    Attributes:
        margin: px around a strip that it makes the strip from.
        lead, tail: px before the picture and beyond its whole periods that `before` needs.
    """

    margin = lead = tail = 0

    def before(self, picture: Picture) -> Tensor | None:
        """What is done once on the whole picture; None if that is nothing."""
        return None

    def height(self, height: int, periods: int) -> int:
        """Height of what `before` makes of a picture; of this in px, and in periods."""
        return height

    def strip(self, strip: Strip, prepared: Tensor | None) -> Tensor:
        """The blurred strip (B×3×R×W), from the strip or from what `before` made of the picture."""
        return strip.light


class Blurs(nn.Module):
    """The stack of blurs of a plan: what is done once on a whole picture, then strips of rows."""

    def __init__(self, plan: BlurPlan) -> None:
        super().__init__()
        self.stack = nn.ModuleList(
            _blur_of(sigma, cell, plan.reach)
            for sigma, cell in zip(plan.sigmas, plan.cells, strict=True)
        )
        self.margin = max(blur.margin for blur in self.blurs())
        self.lead = max(self.margin, *(blur.lead for blur in self.blurs()))
        self.tail = max(self.margin, *(blur.tail for blur in self.blurs()))

    def blurs(self) -> list[Blur]:
        """Each of them."""
        return list(self.stack)  # type: ignore[arg-type]

    def before(self, light: Tensor, down: Tensor, across: Tensor) -> dict[str, Tensor]:
        """What `strip` needs of a picture, by name.

        Args:
            light (Bx3xHxW tensor): the picture.
            down, across: tensors of the length of whole periods that cover its rows, its columns.
        """
        whole = (down.shape[0], across.shape[0])
        rows = reflect(torch.arange(-self.lead, whole[0] + self.tail), light.shape[2])
        columns = reflect(
            torch.arange(-self.lead, light.shape[3] + PERIOD - 1 + self.tail), light.shape[3]
        )
        picture = Picture(
            light,
            Folds(rows, self.lead, self.tail),
            Folds(columns, self.lead, self.tail),
            whole,
        )
        prepared = {f"blur_{i}": blur.before(picture) for i, blur in enumerate(self.blurs())}
        prepared |= {"light": light, "columns": columns}
        return {name: x for name, x in prepared.items() if x is not None}

    def height(self, name: str, height: int, periods: int) -> int:
        """Height of what `before` makes, by name; of the picture in px, and in periods."""
        return self.blurs()[int(name.removeprefix("blur_"))].height(height, periods)

    def strip(
        self, prepared: Mapping[str, Tensor], numbers: Tensor, across: Tensor
    ) -> tuple[Tensor, list[Tensor]]:
        """A strip of a picture, and of its blurs (each B×3×R×W).

        Args:
            prepared: by `before`.
            numbers: of its rows (R), whole periods, which may go beyond the picture.
            across: as for `before`.
        """
        light, m, count = prepared["light"], self.margin, numbers.shape[0]
        rows = reflect(numbers[:1] + torch.arange(-m, count + m), light.shape[2])
        light = light.index_select(2, rows)
        around = light
        if m:
            around = Folds(prepared["columns"], self.lead, self.tail).columns(light, m, m)
        strip = Strip(numbers, light.narrow(2, m, count), around, m, across.shape[0])
        return strip.light, [
            blur.strip(strip, prepared.get(f"blur_{i}")) for i, blur in enumerate(self.blurs())
        ]


def _blur_of(sigma: float, cell: float, reach: float) -> Blur:
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
        self.phases = 1 if kernel.shape[1] < _FEW else PERIOD
        window = _windows(torch.arange(self.phases), kernel.expand(self.phases, -1))
        self.register_buffer("kernel", window)

    def strip(self, strip: Strip, prepared: Tensor | None) -> Tensor:
        m, spare, kernel = self.margin, strip.margin - self.margin, self.get_buffer("kernel")
        x = strip.around.narrow(2, spare, strip.numbers.shape[0] + 2 * m)
        x = _strided(x, kernel, self.phases, 2).narrow(3, spare, strip.across + 2 * m)
        return _strided(x, kernel, self.phases, 3).narrow(3, 0, strip.light.shape[3])


class _Coarse(Blur):
    """On a grid of whole cells for every `PERIOD` px: one strided convolution along each axis and
    back, with a channel for each cell of a period, or each px.
    """

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        a, q = per_cell(cell)
        self.cells = a * (PERIOD // q)
        cells = torch.arange(-MARGIN, self.cells - MARGIN)
        first, kernel = shrink_kernels(cells, self.cells, PERIOD, sigma, reach)
        self.register_buffer("shrink", _windows(first, kernel))
        enlarge = _windows(*enlarge_kernels(torch.arange(PERIOD), self.cells, PERIOD))
        self.register_buffer("enlarge", enlarge)
        # cells that the last px need beyond their own period, and whole periods of them
        self.beyond = enlarge.shape[1] - self.cells
        self.more = -(-self.beyond // self.cells)
        self.lead = -int(first[0])
        self.tail = PERIOD * (self.more - 1) + self.get_buffer("shrink").shape[1] - self.lead

    def before(self, picture: Picture) -> Tensor:
        shrink, around = self.get_buffer("shrink"), self.lead + self.tail
        x = picture.rows.rows(picture.light, self.lead, picture.whole[0] + around)
        x = picture.columns.columns(_strided(x, shrink, PERIOD, 2), self.lead, self.tail)
        x = _strided(x.narrow(3, 0, picture.whole[1] + around), shrink, PERIOD, 3)
        x = _strided(x, self.get_buffer("enlarge"), self.cells, 3)
        return x.narrow(3, 0, picture.light.shape[3])

    def height(self, height: int, periods: int) -> int:
        return self.cells * periods + self.cells * self.more

    def strip(self, strip: Strip, prepared: Tensor | None) -> Tensor:
        assert prepared is not None
        periods = strip.numbers.shape[0] // PERIOD
        first = strip.numbers[:1] // PERIOD * self.cells
        rows = first + torch.arange(periods * self.cells + self.beyond)
        # what lies beyond the end is no pixel's
        x = prepared.index_select(2, rows.clamp(max=prepared.shape[2] - 1))
        return _strided(x, self.get_buffer("enlarge"), self.cells, 2)


class _Wide(Blur):
    """On a grid with cells of several periods: dense matrices, which are small; the kernel may
    exceed the image.
    """

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

    def before(self, picture: Picture) -> Tensor:
        x = picture.light
        (shrink_rows, enlarge_rows), (shrink_columns, enlarge_columns) = (
            self._matrices(n) for n in x.shape[-2:]
        )
        x = (shrink_rows @ x) @ shrink_columns.t()
        return enlarge_rows @ (x @ enlarge_columns.t())

    def strip(self, strip: Strip, prepared: Tensor | None) -> Tensor:
        assert prepared is not None
        return prepared.index_select(2, strip.numbers.clamp(max=prepared.shape[2] - 1))

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


def _strided(x: Tensor, kernels: Tensor, stride: int, axis: int) -> Tensor:
    """The n kernels (n, taps) at every `stride` along an axis, their results in turn.

    One pixel_shuffle for both axes is quicker to trace, but the convolutions of 3·16 groups that it
    takes keep two threads waiting for each other: 1024² in 2.3 times the time.
    """
    n, taps = kernels.shape
    weights = kernels.repeat(3, 1).reshape(3 * n, 1, *((taps, 1) if axis == 2 else (1, taps)))
    y = F.conv2d(x, weights, stride=(stride, 1) if axis == 2 else (1, stride), groups=3)
    if n == 1:
        return y
    y = torch.unflatten(y, 1, (3, n))
    return y.transpose(2, 3).flatten(2, 3) if axis == 2 else y.permute(0, 1, 3, 4, 2).flatten(3, 4)
