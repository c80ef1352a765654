"""Banded matrices that blur, shrink and enlarge one axis of an image, applied block by block.

A Gaussian blur with half-sample symmetric edges is a banded matrix per axis; so is "blur, then keep
every m-th sample", and so is spline interpolation back. Written as matrices the reflection at the
edges is folded into the entries, grids need not divide the image size, a 1×1 image is nothing
special, and the adjoint that gradients need is the transpose. Each matrix is cut into row blocks
that hold only the columns in use. Blocks that repeat are one batched matrix product on overlapping
windows, which on a CPU is about as fast as one scaled addition per tap for the narrowest kernels
and faster for all others: 3×256², one thread, σ 1.0 / 1.5 / 4 px: blocks 0.28 / 0.31 / 0.28 ms,
scaled additions 0.25 / 0.40 / 1.0, kornia's convolution 1.1 / 1.4 / 2.7, a dense matrix 1.8; oneDNN
strided convolutions lie between 0.3 and 3.
"""

import math
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from kornia.filters import get_gaussian_kernel1d
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[np.float64]

POLE = math.sqrt(3.0) - 2.0
"""Of the filter that turns samples into cubic B-spline coefficients."""

PERIOD = 16
"""px that hold whole cells of a grid, or a cell whole periods; strips of rows are multiples."""

MARGIN = 2
"""Cells of a grid beyond either edge, as a cubic spline needs."""

SPLINE_REACH = 8
"""|POLE|^8 = 3e-5, at a frequency where the Gaussian has already removed all but 1e-2."""


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


def sampled_parameter(sigma: Array) -> Array:
    """Parameter of the sampled Gaussian whose variance is sigma²: sigma itself from 1 px on.

    A sampled Gaussian of σ = 0.5 px has a variance of 0.215 instead of 0.25 and one of 0.3 px
    hardly reacts to σ.
    """
    parameters, variances = _sampled_variances()
    return np.where(sigma < 1, np.interp(sigma**2, variances, parameters), sigma)


@lru_cache(maxsize=1)
def _sampled_variances() -> tuple[Array, Array]:
    """Parameters of sampled Gaussians, and the variances that they have."""
    parameters = np.linspace(0.08, 1.05, 4096)
    squares = np.arange(1, 9) ** 2
    weights = np.exp(-0.5 * squares / parameters[:, None] ** 2)
    return parameters, 2 * (weights @ squares) / (1 + 2 * weights.sum(1))


def reflect(index: Tensor, size: int) -> Tensor:
    """Fold indices into [0, size), half-sample symmetric."""
    period = torch.full(
        (1,), 2 * size, dtype=torch.int64
    )  # a tensor, as ONNX has no remainder by a symbolic number
    index = torch.remainder(index, period)
    return torch.minimum(index, period - 1 - index)


def _fold(kernel: Tensor, first: Tensor, size: int) -> Tensor:
    """Dense (n, size) matrix: row i holds `kernel[i]` from column first[i] on, reflected into [0,
    size).
    """
    columns = reflect(first[:, None] + torch.arange(kernel.shape[1]), size)
    return torch.zeros(kernel.shape[0], size, dtype=torch.float64).scatter_add(1, columns, kernel)


def blur_kernel(sigma: float, reach: float) -> Tensor:
    """(1, 2r + 1) sampled Gaussian of variance sigma² px², cut at `reach`·sigma."""
    radius = math.ceil(reach * sigma)
    parameter = float(sampled_parameter(np.array(sigma)))
    kernel: Tensor = get_gaussian_kernel1d(2 * radius + 1, parameter, dtype=torch.float64)
    return kernel


def blur_matrix(size: int, sigma: float, reach: float) -> Tensor:
    """(size, size) matrix of that kernel on a half-sample symmetric axis."""
    kernel = blur_kernel(sigma, reach)
    return _fold(kernel.expand(size, -1), torch.arange(size) - kernel.shape[1] // 2, size)


def grid_matrices(size: int, sigma: float, cell: float, reach: float) -> tuple[Tensor, Tensor]:
    """What blurs an axis on a grid of `cell` px: shrink (cells, size), enlarge (size, cells)."""
    a, q = per_cell(cell)
    cells = -(-size * a // q) + 2 * MARGIN
    return shrink_matrix(size, cells, a, q, sigma, reach), enlarge_matrix(size, cells, a, q)


def per_cell(cell: float) -> tuple[int, int]:
    """A grid's pitch as `a` cells on `q` px."""
    pitch = Fraction(cell).limit_denominator(PERIOD)
    return pitch.denominator, pitch.numerator


def shrink_matrix(size: int, cells: int, a: int, q: int, sigma: float, reach: float) -> Tensor:
    """(cells, size) matrix: cubic B-spline coefficients, on a grid of `a` cells for every `q` px,
    of the axis blurred by `sigma` px.
    """
    first, kernel = shrink_kernels(torch.arange(-MARGIN, cells - MARGIN), a, q, sigma, reach)
    return _fold(kernel, first, size)


def shrink_kernels(
    index: Tensor, a: int, q: int, sigma: float, reach: float
) -> tuple[Tensor, Tensor]:
    """First px (n) and weights (n, taps) of the cells `index`: the same in every period, to the
    last bit.

    Sampling a Gaussian and solving for spline coefficients (Unser 1999, eq. 11) is one kernel, Σ_k
    √3·pole^|k| g(x + k·cell): the blur itself is the anti-aliasing filter, and the spline loses
    less than 70 dB from cell ≤ σ/1.1 on (linear interpolation: 45 dB; Keys' cubic: 57). With g(x +
    k·cell) = g(x)·g(k·cell)·ratio^k it takes two exponentials and a polynomial.
    """
    cell = q / a
    within = (torch.remainder(index, a).double() + 0.5) * cell - 0.5
    radius = math.ceil(reach * sigma)
    first = torch.floor(within).long() - radius
    x = (first[:, None] + torch.arange(2 * radius + 2)) - within[:, None]
    ratio, step = (
        torch.exp(-x * (cell / sigma**2)),
        math.exp(-0.5 * (cell / sigma) ** 2),
    )  # step = g(cell)
    kernel, forth, back = torch.ones_like(x), torch.ones_like(x), torch.ones_like(x)
    for k in range(1, SPLINE_REACH + 1):
        # g(k·cell)·ratio^±k, each from the one before: g(k·cell) = g((k − 1)·cell)·g(cell)^(2k − 1)
        forth, back = forth * (ratio * step ** (2 * k - 1)), back / ratio * step ** (2 * k - 1)
        kernel = kernel + POLE**k * (forth + back)
    # cut at the same distance on both sides, wherever between two pixels the centre lies
    kernel = kernel * torch.exp(-0.5 * (x / sigma) ** 2) * (x.abs() <= radius + 0.5)
    return first + torch.div(index, a, rounding_mode="floor") * q, kernel / kernel.sum(
        1, keepdim=True
    )


def enlarge_matrix(size: int, cells: int, a: int, q: int) -> Tensor:
    """(size, cells) matrix: values at `size` samples of the cubic B-spline with coefficients on
    that grid.
    """
    first, kernel = enlarge_kernels(torch.arange(size), a, q)
    columns = MARGIN + first[:, None] + torch.arange(4)
    return torch.zeros(size, cells, dtype=torch.float64).scatter_(1, columns, kernel)


def enlarge_kernels(index: Tensor, a: int, q: int) -> tuple[Tensor, Tensor]:
    """First cell (n) and weights (n, 4) of the px `index`."""
    x = (torch.remainder(index, q).double() + 0.5) * (a / q) - 0.5
    first = torch.floor(x).long() + torch.div(index, q, rounding_mode="floor") * a - 1
    t = (x - torch.floor(x))[:, None]
    return first, torch.cat(
        [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, 3 * (1 - t) ** 3 - 6 * (1 - t) ** 2 + 4, t**3], 1
    ) / 6


def cut(dense: Tensor, height: int, dtype: torch.dtype, device: torch.device) -> Banded:
    """Cut a dense matrix into row blocks of `height` rows, each with the columns that it uses, and
    join those that repeat.
    """
    runs: list[Run] = []
    used = dense != 0
    for row in range(0, len(dense), height):
        columns = used[row : row + height].any(0).nonzero().flatten()
        col, col_end = (
            (int(columns[0]), int(columns[-1]) + 1) if len(columns) else (0, 1)
        )  # a cell that no pixel uses
        matrix = dense[row : row + height, col:col_end].to(device, dtype).contiguous()
        if (
            runs
            and runs[-1].matrix.shape == matrix.shape
            and bool((runs[-1].matrix == matrix).all())
        ):
            last = runs[-1]
            step = last.step if last.repeats > 1 else col - last.col
            if col == last.col + last.repeats * step:
                runs[-1] = last._replace(repeats=last.repeats + 1, step=step)
                continue
        runs.append(Run(row, len(matrix), 1, col, 0, matrix, matrix.t().contiguous()))
    return Banded(len(dense), tuple(runs))


@lru_cache(maxsize=1024)
def operators(
    axis: int,
    size: int,
    sigma: float,
    cell: float,
    reach: float,
    dtype: torch.dtype,
    device: torch.device,
) -> tuple[tuple[Banded, Banded], ...]:
    """What blurs one axis (0: along rows, 1: along columns), as (matrix, transpose) pairs in the
    order of use.

    One pair, a blur, on the image's own grid (`cell` = 1); two, shrink and enlarge, on a coarser
    one.
    """
    least = 8 if axis == 0 else 32  # rows of a block, the fastest of 4…64 on 256 and 512 px
    if cell == 1:
        blur = cut(blur_matrix(size, sigma, reach), least, dtype, device)
        return (
            (blur, blur),
        )  # symmetric: half-sample reflection makes the cosine transform diagonalise it
    shrink, enlarge = grid_matrices(size, sigma, cell, reach)
    a, q = per_cell(cell)
    # whole periods of the grid repeat
    cells, px = a * -(-least // a), max(least, min(q, PERIOD))
    return (
        (cut(shrink, cells, dtype, device), cut(shrink.t(), px, dtype, device)),
        (cut(enlarge, px, dtype, device), cut(enlarge.t(), cells, dtype, device)),
    )


def along_rows(matrix: Banded, x: Tensor, first: int = 0, end: int | None = None) -> Tensor:
    """`matrix @ x` for x (rows, N), contiguous; only rows `first` to `end`, between blocks, of the
    result.
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
