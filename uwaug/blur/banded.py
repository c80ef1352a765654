"""Banded matrices that blur, shrink and enlarge one axis of an image, applied block by block.

A Gaussian blur with half-sample symmetric edges is a banded matrix per axis; so is "blur, then keep
every m-th sample", and so is spline interpolation back. Written as matrices the reflection at the
edges is folded into the entries, grids need not divide the image size, a 1×1 image is nothing
special, and the adjoint that gradients need is the transpose.

Each matrix is cut into row blocks that hold only the columns in use. Blocks that repeat are one
batched matrix product on overlapping windows, which on a CPU is about as fast as one scaled
addition per tap for the narrowest kernels and faster for all others: 3×256², one thread, σ 1.0 /
1.5 / 4 px: blocks 0.28 / 0.31 / 0.28 ms, scaled additions 0.25 / 0.40 / 1.0, kornia's convolution
1.1 / 1.4 / 2.7, a dense matrix 1.8; oneDNN strided convolutions lie between 0.3 and 3.

Away from the edges the blocks repeat, so that only a period of them is made, and the edges: nothing
grows with the square of the image's side.
"""

import math
from functools import lru_cache
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from uwaug.blur.kernels import (
    MARGIN,
    PERIOD,
    blur_kernel,
    enlarge_kernels,
    per_cell,
    reflect,
    shrink_kernels,
)

__all__ = ["Banded", "Node", "along_columns", "along_rows", "operator"]

Kind = Literal["blur", "shrink", "enlarge"]


class Node(NamedTuple):
    """One blur of a stack: its width, px; the cell of its grid, px; kernels are cut at reach·σ."""

    sigma: float
    cell: float
    reach: float


class Run(NamedTuple):
    """`repeats` equal blocks of a matrix, one below the other: each `height` rows, and `step`
    columns further on.
    """

    row: int
    height: int
    repeats: int
    col: int
    step: int
    matrix: Tensor  # (height, columns in use)
    transposed: Tensor


class Banded(NamedTuple):
    """A banded matrix of `rows` rows, as runs of row blocks."""

    rows: int
    runs: tuple[Run, ...]


class Kernels(NamedTuple):
    """A banded matrix A for an axis of any length: a kernel for each row, repeated with a period.

    Attributes:
        first (p): first column of the first p rows.
        weights (p, taps): weights of the columns from there on.
        step: columns from one period to the next.
        shift: row that begins a period.
        reflects: whether columns beyond the edges are folded back.
    """

    first: Tensor
    weights: Tensor
    step: int
    shift: int
    reflects: bool

    @property
    def taps(self) -> int:
        """Columns that a row uses."""
        return self.weights.shape[1]

    def starts(self, start: int, stop: int) -> Tensor:
        """The first columns of rows `start` to `stop`, before reflection."""
        index, period = torch.arange(start, stop) - self.shift, len(self.first)
        turn = torch.div(index, period, rounding_mode="floor")
        return self.first[index % period] + turn * self.step

    def slab(self, start: int, stop: int, cols: int) -> tuple[int, Tensor]:
        """Rows `start` to `stop` of A: the first column in use, and the weights from there on."""
        columns = self.starts(start, stop)[:, None] + torch.arange(self.taps)
        if self.reflects:
            columns = reflect(columns, cols)
        low, high = (int(column) for column in columns.aminmax())
        weights = self.weights[(torch.arange(start, stop) - self.shift) % len(self.first)]
        dense = torch.zeros(stop - start, high + 1 - low, dtype=torch.float64)
        return low, dense.scatter_add_(1, columns - low, weights)


class Matrix(NamedTuple):
    """A, or its transpose, for an axis of a given length.

    Attributes:
        kernels: of the rows of A.
        rows, cols: of A.
        transposed: whether this is Aᵀ.
    """

    kernels: Kernels
    rows: int
    cols: int
    transposed: bool

    def slab(self, start: int, stop: int) -> tuple[int, Tensor]:
        """Rows `start` to `stop`: the first column in use, and the weights from there on."""
        kernels, cols = self.kernels, self.cols
        if not self.transposed:
            return kernels.slab(start, stop, cols)
        # the rows of A that reach one of these columns, directly or folded back at an edge
        first = kernels.starts(0, self.rows)
        end = first + kernels.taps
        reaches = (first < stop) & (end > start)
        if kernels.reflects:
            reaches |= (first < -start) | (end > 2 * cols - stop) | (kernels.taps > cols)
        used = reaches.nonzero().flatten()
        if not len(used):
            return 0, torch.zeros(stop - start, 1, dtype=torch.float64)
        low, high = int(used[0]), int(used[-1]) + 1
        col, dense = kernels.slab(low, high, cols)
        whole = torch.zeros(high - low, max(stop, col + dense.shape[1]), dtype=torch.float64)
        whole[:, col : col + dense.shape[1]] = dense
        return low, whole[:, start:stop].t()

    def edge(self) -> int:
        """How many rows at either end differ from what the period says."""
        kernels, rows, cols = self.kernels, self.rows, self.cols
        first = kernels.starts(0, rows)
        if not self.transposed:
            return int(max((first < 0).sum(), (first + kernels.taps > cols).sum()))
        before, after = (int(kernels.starts(row, row + 1)) for row in (-1, rows))
        folded = int(max(-first.min(), first.max() + kernels.taps - cols))
        return max(before + kernels.taps, cols - after, folded)


def _banded(
    matrix: Matrix, height: int, period: int, dtype: torch.dtype, device: torch.device
) -> Banded:
    """A matrix in blocks of `height` rows; it repeats every `period` rows, whole blocks."""
    count = matrix.cols if matrix.transposed else matrix.rows
    edge = matrix.edge()
    left, right = -(-edge // period) * period, (count - edge) // period * period
    if right - left <= period:
        left = right = count
    runs = _blocks(matrix, 0, left, height, dtype, device)
    if right > left:
        repeats = (right - left) // period
        step = matrix.kernels.step * period // len(matrix.kernels.first)
        if matrix.transposed:
            step = len(matrix.kernels.first) * period // matrix.kernels.step
        blocks = _blocks(matrix, left, left + period, height, dtype, device)
        if len(blocks) == 1:
            runs.append(blocks[0]._replace(repeats=repeats, step=step))
        else:
            for n in range(repeats):
                runs += [b._replace(row=b.row + n * period, col=b.col + n * step) for b in blocks]
        runs += _blocks(matrix, right, count, height, dtype, device)
    return Banded(count, tuple(runs))


def _blocks(
    matrix: Matrix, start: int, stop: int, height: int, dtype: torch.dtype, device: torch.device
) -> list[Run]:
    """Rows `start` to `stop` as blocks, each with the columns that it uses."""
    if start == stop:
        return []
    first, slab = matrix.slab(start, stop)
    runs = []
    for row in range(0, stop - start, height):
        rows = slab[row : row + height]
        used = (rows != 0).any(0).nonzero().flatten()
        # a cell that no pixel uses has no column
        low, high = (int(used[0]), int(used[-1]) + 1) if len(used) else (0, 1)
        block = rows[:, low:high].to(device, dtype).contiguous()
        transposed = block.t().contiguous()
        runs.append(Run(start + row, len(block), 1, first + low, 0, block, transposed))
    return runs


@lru_cache(maxsize=256)
def _kernels(kind: Kind, node: Node) -> Kernels:
    a, q = per_cell(node.cell)
    if kind == "blur":
        kernel = blur_kernel(node.sigma, node.reach)
        first = torch.tensor([-(kernel.shape[1] // 2)])
        return Kernels(first, kernel, step=1, shift=0, reflects=True)
    if kind == "shrink":
        found = shrink_kernels(torch.arange(a), a, q, node.sigma, node.reach)
        return Kernels(*found, step=q, shift=MARGIN, reflects=True)
    first, weights = enlarge_kernels(torch.arange(q), a, q)
    return Kernels(first + MARGIN, weights, step=a, shift=0, reflects=False)


@lru_cache(maxsize=128)
def operator(
    kind: Kind,
    axis: int,
    size: int,
    node: Node,
    dtype: torch.dtype,
    device: torch.device,
    adjoint: bool = False,
) -> Banded:
    """A matrix of a node for an axis of `size` px, or its transpose.

    Args:
        kind: "blur" on the image's own grid; "shrink" to a coarser one, "enlarge" back.
        axis: 0: along rows, 1: along columns.
        size: of the image along that axis, px.
        node: which blur.
        adjoint: the transpose. That of a blur is itself: half-sample reflection makes the cosine
            transform diagonalise it.
    """
    least = 8 if axis == 0 else 32  # rows of a block, the fastest of 4…64 on 256 and 512 px
    a, q = per_cell(node.cell)
    cells = -(-size * a // q) + 2 * MARGIN
    kernels = _kernels(kind, node)
    if kind == "blur":
        return _banded(Matrix(kernels, size, size, False), least, least, dtype, device)
    shape = (cells, size) if kind == "shrink" else (size, cells)
    # whole periods of the grid repeat; a strip of rows of the image ends between two blocks
    height, period = max(least, min(q, PERIOD)), q
    if (kind == "shrink") != adjoint:
        height, period = a * -(-least // a), a
    whole = math.lcm(height, period)
    return _banded(Matrix(kernels, *shape, adjoint), height, whole, dtype, device)


def along_rows(matrix: Banded, x: Tensor, first: int = 0, end: int | None = None) -> Tensor:
    """`matrix @ x` for x (rows, N), contiguous.

    Only rows `first` to `end` of the result, which lie between blocks.
    """
    n, start = x.shape[1], x.storage_offset()
    end = matrix.rows if end is None else min(end, matrix.rows)
    out = x.new_empty(end - first, n)
    for row, height, repeats, col, step, block, _ in matrix.runs:
        skip = max(0, (first - row) // height)
        repeats = min(repeats, (end - row + height - 1) // height) - skip
        if repeats < 1:
            continue
        row, col = row + skip * height - first, col + skip * step
        part, width = out.narrow(0, row, repeats * height), block.shape[1]
        if repeats == 1:
            torch.mm(block, x.narrow(0, col, width), out=part)
        else:
            windows = x.as_strided((repeats, width, n), (step * n, n, 1), start + col * n)
            torch.bmm(block.expand(repeats, -1, -1), windows, out=part.view(repeats, height, n))
    return out


def along_columns(matrix: Banded, x: Tensor) -> Tensor:
    """`x @ matrix.T` for x (N, columns), contiguous."""
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
