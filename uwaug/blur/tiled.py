"""The blurs of one picture a piece at a time, from rows that are made as they are asked for."""

from collections.abc import Iterator, Sequence
from types import EllipsisType
from typing import NamedTuple

import torch
from torch import Tensor

from uwaug._support.tiles import Rows, RowSource, row_bands, rows_of
from uwaug.blur.banded import Banded, Node, along_columns, along_rows, whole
from uwaug.blur.kernels import PERIOD
from uwaug.blur.plan import BlurPlan
from uwaug.blur.stack import Chain, chain_of, products

_STRIP = 200_000
"""Samples of a strip; 50_000 takes a fifth longer (calls), 400_000 a tenth at 1024² (caches)."""

_PIECE = 2 * _STRIP
"""Samples of a piece: a strip, unless the image is wider than 8000 px."""

_KEPT = 4.0
"""px. Of a picture in bands, blurs on grids of such cells and coarser are kept whole, a sixteenth
of it at most: they reach far beyond a band. Finer ones are made for each band.
"""

_SLAB = 64
"""Rows that are shrunk at a time onto grids that are kept whole."""


class _Source(NamedTuple):
    """What a band's rows of one blur are made of.

    Attributes:
        rows (RxCxW tensor): from row `top` of what `along` is applied to.
        along: the product that gives a few rows at a time; None if they are these.
        after: what those rows still need.
    """

    rows: Tensor
    top: int
    along: Banded | None
    after: Chain


class PartBlur:
    """One blur of a stack, of a picture that comes in bands.

    On a coarse grid all but the last product is done up front: those intermediates live on coarse
    grids and are small.
    """

    def __init__(self, node: Node, size: tuple[int, int], like: Tensor) -> None:
        self.node, self.height = node, size[0]
        self.chain = chain_of(node, size, like)
        self.kept: Tensor | None = None

    def needs(self, start: int, stop: int) -> tuple[int, int] | None:
        """The picture's rows of which rows `start` to `stop` of the blur are made."""
        if self.kept is not None:
            return None
        if not self.chain:
            return start, stop
        if len(self.chain) == 2:
            span = self.chain[0][1].span(start, stop)
        else:
            cells = self.chain[-1][1].span(start, stop)
            span = self.chain[0][1].span(cells.low, cells.high)
        return span.low, span.high

    def source(self, light: Tensor, top: int, start: int, stop: int) -> _Source:
        """For rows `start` to `stop`, from the picture's rows (RxCxW) from `top` on."""
        if not self.chain:
            return _Source(light, top, None, ())
        if len(self.chain) == 2:
            return _Source(light, top, self.chain[0][1], self.chain[1:])
        (_, shrink), *across, (_, enlarge) = self.chain
        cells = enlarge.span(start, stop)
        if self.kept is not None:
            return _Source(self.lines(cells.low, cells.high), cells.low, enlarge, ())
        _, c, w = light.shape
        first, end, _, _ = shrink.span(cells.low, cells.high)
        part = along_rows(shrink, light.reshape(-1, c * w), first, end, top)
        return _Source(products(part.reshape(-1, c, w), tuple(across)), first, enlarge, ())

    def lines(self, low: int, high: int) -> Tensor:
        """Rows of cells of the kept grid, enlarged along rows (NxCxW)."""
        assert self.kept is not None
        return products(self.kept[low:high], (self.chain[2],))

    def keep(self, light: Tensor, start: int) -> None:
        """Add what the picture's rows (RxCxW) from `start` on give to the coarse grid."""
        r, c, w = light.shape
        (_, shrink), (_, across), *_ = self.chain
        if self.kept is None:
            self.kept = light.new_zeros(shrink.rows, c, across.rows)
        low, slab = whole("shrink", self.height, self.node, True).slab(start, start + r)
        cells = torch.from_numpy(slab.T).to(light) @ light.reshape(r, c * w)
        part = along_columns(across, cells.reshape(-1, w)).reshape(-1, c, across.rows)
        self.kept[low : low + len(part)] += part


def rows_of_strip(channels: int, width: int) -> int:
    """How many rows of an image are blurred at a time."""
    return PERIOD * max(1, _STRIP // (PERIOD * channels * width))


def blurred_tiles(
    picture: Tensor | RowSource, plan: BlurPlan
) -> Iterator[tuple[tuple[EllipsisType, slice, slice], list[Tensor]]]:
    """The plan's blurs of one picture, a tile at a time so that what follows stays in the cache: a
    strip of rows, or a part of one if the picture is very wide. Not for gradients.

    Args:
        picture (1xCxHxW tensor or row source): float32 or float64; of a row source a band of rows
            is held at a time.
        plan: from `plan_blur`.

    Yields:
        the tile, and K tensors (1xCxRxS): the picture blurred by each of `plan.sigmas`.
    """
    _, c, h, w = picture.shape
    strip, rows = rows_of_strip(c, w), rows_of(picture)
    if isinstance(picture, Tensor):
        like, step = picture, h
    else:
        like = picture.like
        (_, band), *_ = row_bands(h, w)
        step = strip * max(1, band // strip)
    blurs = []
    for sigma, cell in zip(plan.sigmas, plan.cells, strict=True):
        blurs.append(PartBlur(Node(sigma, cell, plan.reach), (h, w), like))
    if step < h:
        keep_coarse(blurs, rows, h)
    for top in range(0, h, step):
        sources = _sources(blurs, rows, top, min(top + step, h))
        for first in range(top, min(top + step, h), strip):
            part = slice(first, min(first + strip, h))
            strips = []
            for source in sources:
                lines = source.rows[part.start - source.top : part.stop - source.top]
                if source.along is not None:
                    flat = source.rows.reshape(len(source.rows), -1)
                    flat = along_rows(source.along, flat, part.start, part.stop, source.top)
                    lines = products(flat.reshape(-1, c, w), source.after)
                strips.append(lines.transpose(0, 1)[None])
            across = max(1, _PIECE // (c * (part.stop - part.start)))
            for left in range(0, w, across):
                columns = slice(left, min(left + across, w))
                yield (..., part, columns), [strip[..., columns] for strip in strips]


def keep_coarse(blurs: Sequence[PartBlur], rows: Rows, height: int) -> None:
    """Make the coarse grids of those blurs whose grids are kept whole."""
    coarse = [blur for blur in blurs if blur.node.cell >= _KEPT]
    if not coarse:
        return
    for start in range(0, height, _SLAB):
        light = _upright(rows(start, min(start + _SLAB, height)))
        for blur in coarse:
            blur.keep(light, start)


def _sources(blurs: list[PartBlur], rows: Rows, start: int, stop: int) -> list[_Source]:
    """Of each blur, what rows `start` to `stop` are made of."""
    needed = [span for blur in blurs if (span := blur.needs(start, stop)) is not None]
    low, high = start, start
    light = torch.empty(0)
    if needed:
        low, high = min(span[0] for span in needed), max(span[1] for span in needed)
        light = _upright(rows(low, high))
    return [blur.source(light, low, start, stop) for blur in blurs]


def _upright(light: Tensor) -> Tensor:
    """Rows first (RxCxW), as the products want them."""
    return light.transpose(0, 1).contiguous()
