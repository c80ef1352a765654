"""Banded matrices that blur, shrink and enlarge one axis of an image, applied block by block.

A Gaussian blur with half-sample symmetric edges is a banded matrix per axis; so are "blur, then
keep every m-th sample" and spline interpolation back. The adjoint is the transpose. Blurs on grids
of 2 px and more read the half picture, which is blurred a little and keeps every second sample.

Each matrix is cut into row blocks that hold only the columns in use. Blocks that repeat are one
batched matrix product on overlapping windows. For 3×256² and σ = 4 px one thread takes 0.28 ms,
with scaled additions 1.0, a dense matrix 1.8, and kornia's convolution 2.7. Only the edges and one
period of blocks are made: nothing grows with the square of the image's side.
"""

import math
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from uwaug._support.cache import Cache
from uwaug._support.types import Array
from uwaug.blur.kernels import (
    HALVING,
    MARGIN,
    PERIOD,
    blur_kernel,
    enlarge_kernels,
    per_cell,
    rest_of,
    shrink_kernels,
)

Index = NDArray[np.int64]


def mirrored(index: Index, turn: int) -> Index:
    """Fold indices at the edges of an axis, see `uwaug.blur.kernels.reflect`."""
    index = index % turn
    return np.minimum(index, turn - 1 - index)


class Run(NamedTuple):
    """Equal blocks of a matrix, each `height` rows below and `step` columns right of the last."""

    row: int
    height: int
    repeats: int
    col: int
    step: int
    matrix: Tensor  # (height, columns in use)
    transposed: Tensor


class Banded(NamedTuple):
    """Banded matrix of `rows` rows, as runs of row blocks."""

    rows: int
    runs: tuple[Run, ...]

    @property
    def bytes(self) -> int:
        """Memory of the blocks, which runs may share."""
        blocks = {id(run.matrix): run.matrix for run in self.runs}
        return sum(block.numel() * block.element_size() for block in blocks.values())


class Kernels(NamedTuple):
    """Banded matrix A for an axis of any length: a kernel for each row, repeated with a period."""

    first: Index  # (p) first column of the first p rows
    weights: Array  # (p, taps) weights of the columns from there on
    step: int  # columns from one period to the next
    shift: int  # row that begins a period

    @property
    def taps(self) -> int:
        """Number of columns that a row uses."""
        return int(self.weights.shape[1])

    def starts(self, start: int, stop: int) -> Index:
        """First columns of rows `start` to `stop`, before reflection."""
        turn, place = np.divmod(np.arange(start, stop) - self.shift, len(self.first))
        return np.asarray(self.first[place] + turn * self.step)

    def slab(self, start: int, stop: int, turn: int) -> tuple[int, Array]:
        """First column in use of rows `start` to `stop` of A, and their weights from there on."""
        columns = self.starts(start, stop)[:, None] + np.arange(self.taps)
        if turn:
            columns = mirrored(columns, turn)
        low, high = int(columns.min()), int(columns.max())
        rows, width = stop - start, high + 1 - low
        weights = self.weights[(np.arange(start, stop) - self.shift) % len(self.first)]
        place = columns - low + np.arange(rows)[:, None] * width
        # weights that are folded onto one column add up
        dense: NDArray[Any] = np.bincount(place.ravel(), weights.ravel(), rows * width)
        return low, dense.reshape(rows, width)


class Matrix(NamedTuple):
    """Banded matrix A of a size, or its transpose, with the kernels of the rows of A."""

    kernels: Kernels
    rows: int
    cols: int
    turn: int  # columns beyond the edges are folded back, see `mirrored`; 0 if there are none
    transposed: bool

    @property
    def period(self) -> int:
        """Rows, or columns of A, from one period to the next."""
        return self.kernels.step if self.transposed else len(self.kernels.first)

    def slab(self, start: int, stop: int) -> tuple[int, Array]:
        """First column in use of rows `start` to `stop`, and their weights from there on."""
        kernels, turn = self.kernels, self.turn
        if not self.transposed:
            return kernels.slab(start, stop, turn)
        # the rows of A that reach one of these columns, directly or folded back at an edge
        first = kernels.starts(0, self.rows)
        end = first + kernels.taps
        reaches = (first < stop) & (end > start)
        if turn:
            reaches |= (first < -start) | (end > turn - stop) | (2 * kernels.taps > turn)
        used = np.flatnonzero(reaches)
        if not len(used):
            return 0, np.zeros((stop - start, 1))
        low, high = int(used[0]), int(used[-1]) + 1
        col, dense = kernels.slab(low, high, turn)
        padded = np.zeros((high - low, max(stop, col + dense.shape[1])))
        padded[:, col : col + dense.shape[1]] = dense
        return low, padded[:, start:stop].T

    def edge(self) -> int:
        """Number of rows at either end that do not repeat with the period."""
        kernels, rows, cols = self.kernels, self.rows, self.cols
        # a kernel that leaves the axis is at most so many rows from its end
        count = (kernels.taps // kernels.step + 2) * len(kernels.first) + kernels.shift
        count = min(count, rows)
        head, tail = kernels.starts(0, count), kernels.starts(rows - count, rows)
        if not self.transposed:
            return int(max((head < 0).sum(), (tail + kernels.taps > cols).sum()))
        before, after = (int(kernels.starts(row, row + 1)[0]) for row in (-1, rows))
        folded = int(max(-head.min(), tail.max() + kernels.taps + cols - self.turn))
        return max(before + kernels.taps, cols - after, folded if self.turn else 0)

    def banded(self, axis: int, dtype: torch.dtype, device: torch.device) -> Banded:
        """Cut the matrix into blocks of rows, which lie in memory as the product along `axis` wants
        them.
        """
        least = 8 if axis == 0 else 32  # rows of a block: the fastest of 4…64 on 256 and 512 px
        height = max(least, PERIOD)
        if self.period <= PERIOD:
            height = self.period * -(-least // self.period)
        period = math.lcm(height, self.period)

        def blocks(start: int, stop: int) -> list[Run]:
            """Cut rows `start` to `stop`, with the columns that each block uses."""
            if start == stop:
                return []
            first, slab = self.slab(start, stop)
            runs = []
            for row in range(0, stop - start, height):
                rows = slab[row : row + height]
                used = np.flatnonzero(rows.any(0))
                # a cell that no pixel uses has no column
                low, high = (int(used[0]), int(used[-1]) + 1) if len(used) else (0, 1)
                part = rows[:, low:high]
                block = torch.from_numpy(np.ascontiguousarray(part if axis == 0 else part.T))
                block = block.to(device, dtype)
                matrix = block if axis == 0 else block.t()
                runs.append(Run(start + row, len(part), 1, first + low, 0, matrix, matrix.t()))
            return runs

        count = self.cols if self.transposed else self.rows
        edge = self.edge()
        begin, end = -(-edge // period) * period, (count - edge) // period * period
        if end - begin <= period:
            return Banded(count, tuple(blocks(0, count)))
        repeats = (end - begin) // period
        step = self.kernels.step * period // len(self.kernels.first)
        if self.transposed:
            step = len(self.kernels.first) * period // self.kernels.step
        middle = blocks(begin, begin + period)
        runs = blocks(0, begin)
        if len(middle) == 1:
            runs.append(middle[0]._replace(repeats=repeats, step=step))
        else:
            for n in range(repeats):
                for run in middle:
                    runs.append(run._replace(row=run.row + n * period, col=run.col + n * step))
        return Banded(count, (*runs, *blocks(end, count)))


def along_rows(matrix: Banded, x: Tensor) -> Tensor:
    """Product `matrix @ x` for x (rows, N), contiguous."""
    n, start = x.shape[1], x.storage_offset()
    out = x.new_empty(matrix.rows, n)
    for row, height, repeats, col, step, block, _ in matrix.runs:
        part, width = out.narrow(0, row, repeats * height), block.shape[1]
        if repeats == 1:
            torch.mm(block, x.narrow(0, col, width), out=part)
        else:
            windows = x.as_strided((repeats, width, n), (step * n, n, 1), start + col * n)
            torch.bmm(block.expand(repeats, -1, -1), windows, out=part.view(repeats, height, n))
    return out


def along_columns(matrix: Banded, x: Tensor) -> Tensor:
    """Product `x @ matrix.T` for x (N, columns), contiguous."""
    (n, size), start = x.shape, x.storage_offset()
    out = x.new_empty(n, matrix.rows)
    for row, height, repeats, col, step, block, transposed in matrix.runs:
        width = block.shape[1]
        if repeats == 1:
            torch.mm(x.narrow(1, col, width), transposed, out=out.narrow(1, row, height))
        else:
            windows = x.as_strided((repeats, n, width), (step, size, 1), start + col)
            part = out.as_strided((repeats, n, height), (height, matrix.rows, 1), row)
            torch.bmm(windows, transposed.expand(repeats, -1, -1), out=part)
    return out


Kind = Literal["blur", "halve", "shrink", "enlarge"]


class Node(NamedTuple):
    """One blur of a stack: its width and the cell of its grid, px; its kernel is cut at reach·σ."""

    sigma: float
    cell: float
    reach: float


HALF = Node(0.0, 2.0, 0.0)  # stands for the half picture


# Matrices for fifty sizes of a small picture, or for a few of a large one. With 16 MiB a process
# that gets pictures of random size is no faster, and grows by half: blocks lie between temporaries.
_CACHE: Cache[Banded] = Cache(8 * 2**20)


@lru_cache(maxsize=256)
def _kernels(kind: Kind, node: Node) -> Kernels:
    a, q = per_cell(node.cell)
    if kind == "blur":
        kernel = blur_kernel(node.sigma, node.reach)
        return Kernels(np.array([-(kernel.shape[1] // 2)]), kernel.numpy(), step=1, shift=0)
    if kind == "halve":
        return Kernels(np.array([1 - len(HALVING) // 2]), HALVING[None], step=2, shift=0)
    cells = torch.arange(a if kind == "shrink" else q, device="cpu")
    if kind == "shrink":
        first, weights = shrink_kernels(cells, a, q // 2, rest_of(node.sigma), node.reach)
        return Kernels(first.numpy(), weights.numpy(), step=q // 2, shift=MARGIN)
    first, weights = enlarge_kernels(cells, a, q)
    return Kernels((first + MARGIN).numpy(), weights.numpy(), step=a, shift=0)


def whole(kind: Kind, size: int, node: Node, adjoint: bool = False) -> Matrix:
    """Matrix of a node for an axis of `size` px, or its transpose, before it is cut into blocks:
    "blur" on the picture's grid; "halve" to the half picture, "shrink" from there to a coarser
    grid, "enlarge" to the picture's. A blur is its own transpose: with half-sample reflection, the
    cosine transform diagonalises it.
    """
    a, q = per_cell(node.cell)
    half, cells = -(-size // 2), -(-size * a // q) + 2 * MARGIN
    rows, cols, turn = {
        "blur": (size, size, 2 * size),
        "halve": (half, size, 2 * size),
        "shrink": (cells, half, size),
        "enlarge": (size, cells, 0),
    }[kind]
    return Matrix(_kernels(kind, node), rows, cols, turn, adjoint and kind != "blur")


def operator(
    kind: Kind,
    axis: int,
    size: int,
    node: Node,
    dtype: torch.dtype,
    device: torch.device,
    adjoint: bool = False,
) -> Banded:
    """Matrix of a node, see `whole`, for an axis (0 for rows), in blocks."""
    key = (kind, axis, size, node, dtype, device, adjoint)
    banded = _CACHE.get(key)
    if banded is None:
        banded = whole(kind, size, node, adjoint).banded(axis, dtype, device)
        _CACHE.put(key, banded, banded.bytes)
    return banded
