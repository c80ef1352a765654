"""What the loops look up for the transposes of blurs."""

from typing import NamedTuple

import numpy as np

from uwaug._support.cache import Cache
from uwaug.blur.operators import Kind, Node, whole
from uwaug.blur.plan import BlurPlan
from uwaug.formation.loops.tables import Floats, Indices, ordered_nodes, plan_tables

__all__ = ["Back", "Cells", "Transposed", "transposed_tables"]

_REMEMBERED: "Cache[Transposed]" = Cache(8 * 2**20)


class Cells(NamedTuple):
    """The transpose of one blur on a coarse grid of h cells by w, for pictures of HxW.

    Attributes:
        rows (h, taps), down (h, taps): three times the rows of the picture that a row of cells was
            enlarged to, and weights.
        across_first (w), across (w, taps): the first column of the picture that a cell was enlarged
            to, and weights from there on.
        along_first (W), along (W, taps): the first cell that a column was shrunk into, and weights
            from there on.
    """

    rows: Indices
    down: Floats
    across_first: Indices
    across: Floats
    along_first: Indices
    along: Floats


class Back(NamedTuple):
    """The last step of all transposes.

    Attributes:
        folds (3, n): of each channel, the lines (see `cell_lines`) of the rows of `Stack`.
        rows (m, H, taps), up (m, H, taps): the lines of all grids that a row was shrunk into, and
            weights.
    """

    folds: Indices
    rows: Indices
    up: Floats


class Transposed(NamedTuple):
    """A plan's transposes for pictures of one size."""

    cells: tuple[Cells, ...]
    back: Back

    @property
    def bytes(self) -> int:
        """Memory of all tables."""
        return sum(value.nbytes for table in (*self.cells, self.back) for value in table)


def transposed_tables(plan: BlurPlan, size: tuple[int, int]) -> Transposed:
    """A plan for pictures of (height, width) `size`."""
    found = _REMEMBERED.get((plan, size))
    if found is None:
        found = _transposed_tables(plan, size)
        _REMEMBERED.put((plan, size), found, found.bytes)
    return found


def _transposed_tables(plan: BlurPlan, size: tuple[int, int]) -> Transposed:
    stack, (height, _) = plan_tables(plan, size).stack, size
    wide = [node for node in ordered_nodes(plan) if node.cell != 1]
    shrunk = [_columns_of("shrink", node, height) for node in wide]
    taps = max((weights.shape[1] for _, weights in shrunk), default=0)
    rows = np.zeros((len(wide), height, taps), np.int64)
    up = np.zeros((len(wide), height, taps), np.float32)
    for k, (first, weights) in enumerate(shrunk):
        count = weights.shape[1]
        cells = whole("shrink", height, wide[k]).rows
        rows[k] = stack.starts[k] + 3 * _from(first, taps, cells)
        up[k, :, :count] = weights
    folds = 3 * stack.rows + np.arange(3)[:, None]
    return Transposed(tuple(_cells(node, size) for node in wide), Back(folds, rows, up))


def _cells(node: Node, size: tuple[int, int]) -> Cells:
    height, width = size
    down_first, down = _columns_of("enlarge", node, height)
    across_first, across = _columns_of("enlarge", node, width)
    along_first, along = _columns_of("shrink", node, width)
    rows = 3 * _from(down_first, down.shape[1], height)
    return Cells(rows, down, across_first, across, along_first, along)


def _from(first: Indices, taps: int, size: int) -> Indices:
    """Places (n, taps) from the first on. Beyond the end, where nothing has a weight, the last."""
    return np.asarray(np.minimum(first[:, None] + np.arange(taps), size - 1))


def _columns_of(kind: Kind, node: Node, size: int) -> tuple[Indices, Floats]:
    """First row and weights of every column of a matrix; 4, 8, … weights, some of them 0.

    What is folded onto a column from beyond the edges is among them.
    """
    matrix = whole(kind, size, node)
    kernels = matrix.kernels
    columns = kernels.starts(0, matrix.rows)[:, None] + np.arange(kernels.taps)
    if kernels.reflects:
        columns = columns % (2 * size)
        columns = np.minimum(columns, 2 * size - 1 - columns)
    rows = np.broadcast_to(np.arange(matrix.rows)[:, None], columns.shape)
    weights = kernels.weights[(rows[:, 0] - kernels.shift) % len(kernels.first)]
    used = weights != 0
    rows, columns, weights = rows[used], columns[used], weights[used]
    first = np.full(matrix.cols, matrix.rows)
    last = np.zeros(matrix.cols, np.int64)
    np.minimum.at(first, columns, rows)
    np.maximum.at(last, columns, rows)
    first = np.minimum(first, last)  # of a column that no row uses
    taps = 4 * -(-int((last - first).max() + 1) // 4)
    table = np.zeros((matrix.cols, taps))
    np.add.at(table, (columns, rows - first[columns]), weights)
    return first, table.astype(np.float32)
