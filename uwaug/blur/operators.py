"""The matrices of each blur of a stack, made as they are asked for and remembered."""

import math
from functools import lru_cache
from typing import Literal, NamedTuple

import torch

from uwaug._support.cache import Cache
from uwaug.blur.banded import Banded, Kernels, Matrix
from uwaug.blur.kernels import (
    MARGIN,
    PERIOD,
    blur_kernel,
    enlarge_kernels,
    per_cell,
    shrink_kernels,
)

__all__ = ["Kind", "Node", "operator", "whole"]

Kind = Literal["blur", "shrink", "enlarge"]


class Node(NamedTuple):
    """One blur of a stack: its width, px; the cell of its grid, px; kernels are cut at reach·σ."""

    sigma: float
    cell: float
    reach: float


_REMEMBERED: Cache[Banded] = Cache(8 * 2**20)
"""Those of fifty sizes of a small picture, or of a few of a large one. With 16 MiB a process that
gets pictures of random size grows by half, as blocks that stay lie between temporaries that go, and
is no faster. To make one takes .1 ms; to put it together from blocks that sizes share would save
3 % of a picture's time.
"""


@lru_cache(maxsize=256)
def _kernels(kind: Kind, node: Node) -> Kernels:
    a, q = per_cell(node.cell)
    if kind == "blur":
        kernel = blur_kernel(node.sigma, node.reach)
        first = torch.tensor([-(kernel.shape[1] // 2)])
        return Kernels(first.numpy(), kernel.numpy(), step=1, shift=0, reflects=True)
    if kind == "shrink":
        first, weights = shrink_kernels(torch.arange(a), a, q, node.sigma, node.reach)
        return Kernels(first.numpy(), weights.numpy(), step=q, shift=MARGIN, reflects=True)
    first, weights = enlarge_kernels(torch.arange(q), a, q)
    return Kernels((first + MARGIN).numpy(), weights.numpy(), step=a, shift=0, reflects=False)


def whole(kind: Kind, size: int, node: Node, adjoint: bool = False) -> Matrix:
    """A matrix of a node for an axis of `size` px, or its transpose, before it is cut."""
    a, q = per_cell(node.cell)
    cells = -(-size * a // q) + 2 * MARGIN
    shape = {"blur": (size, size), "shrink": (cells, size), "enlarge": (size, cells)}[kind]
    return Matrix(_kernels(kind, node), *shape, adjoint and kind != "blur")


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
    key = (kind, axis, size, node, dtype, device, adjoint)
    found = _REMEMBERED.get(key)
    if found is not None:
        return found
    least = 8 if axis == 0 else 32  # rows of a block, the fastest of 4…64 on 256 and 512 px
    a, q = per_cell(node.cell)
    # whole periods of the grid repeat; a strip of rows of the image ends between two blocks
    height = period = least
    if kind != "blur":
        height, period = max(least, min(q, PERIOD)), q
    if (kind == "enlarge" and adjoint) or (kind == "shrink" and not adjoint):
        # rows are cells
        height, period = a * -(-least // a), a
    matrix = whole(kind, size, node, adjoint)
    made = matrix.banded(axis, height, math.lcm(height, period), dtype, device)
    _REMEMBERED.put(key, made, made.bytes)
    return made
