"""What the compiled loops look up: a plan for pictures of one size, and a medium, as arrays."""

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from uwaug._support.cache import Cache
from uwaug.blur.kernels import blur_kernel
from uwaug.blur.operators import Kind, Node, whole
from uwaug.blur.plan import V_FLOOR, BlurPlan, range_in_v
from uwaug.optics.medium import Medium

__all__ = [
    "Bytes",
    "Coarse",
    "Floats",
    "Indices",
    "Plan",
    "Stack",
    "Water",
    "order_of",
    "ordered_nodes",
    "plan_tables",
    "series_table",
    "water_tables",
]

Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Indices = NDArray[np.int64]

_REMEMBERED: "Cache[Plan]" = Cache(8 * 2**20)


class Coarse(NamedTuple):
    """One coarse grid of h cells by w, for pictures of HxW.

    Attributes:
        rows, row_margin: the picture's rows from `row_margin` before the first on, mirrored.
        down_first (h), down (h, taps): the first of these rows for each cell, and weights from
            there on.
        columns, column_margin, across_first (w), across (w, taps): the same along rows.
        back_first (W), back (W, 4): the first cell of each column, and weights from there on.
    """

    rows: Indices
    row_margin: int
    down_first: Indices
    down: Floats
    columns: Indices
    column_margin: int
    across_first: Indices
    across: Floats
    back_first: Indices
    back: Floats


class Stack(NamedTuple):
    """All blurs of a plan, sharp first, then narrow, then those on coarse grids.

    Attributes:
        series (K, N): weights of the blurs, as Chebyshev series.
        taps (n, reach + 1), pairs (n): of narrow blurs, the middle weight and one half; how many
            of those count, an even number.
        margin: px that the widest of them reaches.
        rows, columns: of the picture, mirrored, from `margin` before the first on.
        starts (m): the first line of each coarse grid.
        back_first (m, H), back (m, H, 4): the first cell of each row, and weights from there on.
    """

    series: Floats
    taps: Floats
    pairs: Indices
    margin: int
    rows: Indices
    columns: Indices
    starts: Indices
    back_first: Indices
    back: Floats


class Plan(NamedTuple):
    """A plan for pictures of one size."""

    stack: Stack
    coarse: tuple[Coarse, ...]

    @property
    def bytes(self) -> int:
        """Memory of all tables."""
        tables = (self.stack, *self.coarse)
        return sum(value.nbytes for table in tables for value in table if hasattr(value, "nbytes"))


class Water(NamedTuple):
    """A medium, for a plan and pictures of one size.

    Attributes:
        rates (R): times −log2(e): those of the direct term, then the others.
        direct (3, K), scatter (3, R), veil (3, R − K): weights; the veil's are those of e^−x − 1.
        law (7): b̄, scale, exponent; what 2σ or 2σ² is of scale and of scale²; slope and offset of
            log2.
    """

    rates: Floats
    direct: Floats
    scatter: Floats
    veil: Floats
    law: Floats


def plan_tables(plan: BlurPlan, size: tuple[int, int]) -> Plan:
    """A plan for pictures of (height, width) `size`."""
    found = _REMEMBERED.get((plan, size))
    if found is None:
        found = _plan_tables(plan, size)
        _REMEMBERED.put((plan, size), found, found.bytes)
    return found


def order_of(plan: BlurPlan) -> list[int]:
    """The blurs of a plan as `Stack` has them."""
    return sorted(range(len(plan.sigmas)), key=lambda k: (plan.cells[k] != 1, plan.sigmas[k] > 0))


def ordered_nodes(plan: BlurPlan) -> list[Node]:
    """The same, as nodes."""
    return [Node(plan.sigmas[k], plan.cells[k], plan.reach) for k in order_of(plan)]


def _plan_tables(plan: BlurPlan, size: tuple[int, int]) -> Plan:
    height, width = size
    nodes = ordered_nodes(plan)
    narrow = [node for node in nodes if node.cell == 1 and node.sigma > 0]
    wide = [node for node in nodes if node.cell != 1]
    taps = _taps(narrow)
    margin = taps.shape[1] - 1
    coarse = tuple(_coarse(node, height, width) for node in wide)
    lines = [3 * len(grid.down_first) for grid in coarse]
    back = [_rows_of("enlarge", node, height) for node in wide]
    stack = Stack(
        series=series_table([plan.coefficients[k] for k in order_of(plan)]),
        taps=taps,
        pairs=np.array([_pairs(node) for node in narrow], np.int64),
        margin=margin,
        rows=_mirrored(margin, height),
        columns=_mirrored(margin, width),
        starts=np.cumsum([0, *lines])[:-1].astype(np.int64),
        back_first=np.array([first for first, _ in back], np.int64).reshape(-1, height),
        back=np.array([weights for _, weights in back], np.float32).reshape(-1, height, 4),
    )
    return Plan(stack, coarse)


def series_table(coefficients: Any) -> Floats:
    """Series as the loops take them: with 4, 6, … terms."""
    series = np.array(coefficients, np.float32, order="C")
    count = series.shape[1]
    return np.pad(series, ((0, 0), (0, max(4, count + count % 2) - count)))


def _pairs(node: Node) -> int:
    """Pairs of taps beside the middle one: two at a time are added."""
    return max(2, 2 * math.ceil(math.ceil(node.reach * node.sigma) / 2))


def _taps(nodes: list[Node]) -> Floats:
    """The middle weight and one half of each kernel, with zeros after it."""
    widest = max(map(_pairs, nodes), default=2)
    taps = np.zeros((len(nodes), widest + 1), np.float32)
    for row, node in zip(taps, nodes, strict=True):
        kernel = blur_kernel(node.sigma, node.reach)[0].numpy()
        half = kernel[len(kernel) // 2 :]
        row[: len(half)] = half
    return taps


def _coarse(node: Node, height: int, width: int) -> Coarse:
    down_first, down = _rows_of("shrink", node, height)
    across_first, across = _rows_of("shrink", node, width)
    back_first, back = _rows_of("enlarge", node, width)
    row_margin = _beyond(down_first, down, height)
    column_margin = _beyond(across_first, across, width)
    return Coarse(
        rows=_mirrored(row_margin, height),
        row_margin=row_margin,
        down_first=down_first + row_margin,
        down=down,
        columns=_mirrored(column_margin, width),
        column_margin=column_margin,
        across_first=across_first + column_margin,
        across=across,
        back_first=back_first,
        back=back,
    )


def _rows_of(kind: Kind, node: Node, size: int) -> tuple[Indices, Floats]:
    """First column and weights of every row of a matrix; 4, 8, … weights, some of them 0."""
    matrix = whole(kind, size, node)
    kernels = matrix.kernels
    place = (np.arange(matrix.rows) - kernels.shift) % len(kernels.first)
    more = -kernels.taps % 4
    weights = np.pad(kernels.weights, ((0, 0), (0, more)))[place]
    return kernels.starts(0, matrix.rows), weights.astype(np.float32)


def _beyond(first: Indices, weights: Floats, size: int) -> int:
    """How far the columns of a matrix reach beyond an axis."""
    end = int(first.max()) + int(weights.shape[1])
    return max(0, -int(first.min()), end - size)


def _mirrored(margin: int, size: int) -> Indices:
    """Places on an axis, half-sample symmetric, from `margin` before its start on."""
    index = np.arange(-margin, size + margin) % (2 * size)
    return np.minimum(index, 2 * size - 1 - index)


def water_tables(medium: Medium, plan: BlurPlan, size: tuple[int, int]) -> Water:
    """A medium of one row."""
    beta, direct, rates, signal, veil, b_mean = map(_values, medium.tensors())
    return Water(
        rates=np.concatenate([beta, rates]) * np.float32(-math.log2(math.e)),
        direct=direct,
        scatter=np.concatenate([-direct, signal], 1),
        veil=-veil,
        law=_law(medium, float(b_mean), plan, size),
    )


def _law(medium: Medium, b_mean: float, plan: BlurPlan, size: tuple[int, int]) -> Floats:
    """See `uwaug.blur.stack.node_weights` for the place of a width in a plan."""
    spread = medium.point_spread
    # a law's numbers may be tensors of one value
    scale, exponent = (_number(value) for value in spread.numbers().values())
    if spread.reference_size is not None:
        scale *= min(size) / spread.reference_size
    low, high = range_in_v(plan)
    exponential = plan.shape == "exponential"
    slope = (2 if exponential else 1) / (high - low) if high > low else 0.0
    offset = slope * math.log(V_FLOOR) - (low + high) / (high - low) if high > low else 0.0
    powers = (1 / V_FLOOR, 0.0) if exponential else (0.0, 1 / V_FLOOR)
    law = (b_mean, scale, exponent, *powers, slope * math.log(2), offset)
    return np.array(law, np.float32)


def _number(value: Any) -> float:
    """A number of a law, as `Medium.to` leaves it: a tensor's is rounded to float32."""
    return float(value.detach().to(torch.float32)) if isinstance(value, Tensor) else float(value)


def _values(tensor: Any) -> Floats:
    """The values of a medium's one row."""
    return np.array(tensor.detach().numpy()[0], np.float32, order="C")
