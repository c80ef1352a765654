import pytest
import torch

from uwaug.blur import banded
from uwaug.blur.banded import Node, along_columns, along_rows, operator
from uwaug.blur.kernels import PERIOD


@pytest.mark.parametrize("cell", [1.0, 2.0, 16 / 7, 16 / 5, 8.0, 16.0, 48.0])
def test_strips_are_parts_of_the_whole(cell) -> None:
    node = Node(1.4 if cell == 1 else 1.3 * cell, cell, 3.0)
    kinds = ("blur",) if cell == 1 else ("shrink", "enlarge")
    where = torch.float64, torch.device("cpu")
    for size in (1, 7, 15, 16, 17, 33, 70, 130):
        for axis in (0, 1):
            for kind in kinds:
                matrix = operator(kind, axis, size, node, *where)
                transpose = operator(kind, axis, size, node, *where, adjoint=True)
                columns = transpose.rows
                # a slice: neither the first nor all of its storage
                x = torch.rand(columns + 5, 6, dtype=torch.float64)[3 : 3 + columns]
                whole = along_rows(matrix, x)
                dense = along_rows(matrix, torch.eye(columns, dtype=torch.float64))
                turned = along_columns(matrix, x.t().contiguous())
                back = along_rows(transpose, whole)
                torch.testing.assert_close(whole, dense @ x, rtol=0, atol=1e-12)
                torch.testing.assert_close(turned, whole.t(), rtol=0, atol=1e-12)
                torch.testing.assert_close(back, dense.t() @ whole, rtol=0, atol=1e-12)
        if size > PERIOD:
            last = operator(kinds[-1], 0, size, node, *where)
            columns = operator(kinds[-1], 0, size, node, *where, adjoint=True).rows
            x = torch.rand(columns, 4, dtype=torch.float64)
            strips = range(0, size, 2 * PERIOD)
            parts = [along_rows(last, x, first, first + 2 * PERIOD) for first in strips]
            torch.testing.assert_close(torch.cat(parts), along_rows(last, x), rtol=0, atol=1e-12)


def test_operators_of_random_sizes_take_no_more_than_their_budget() -> None:
    operators = banded._CACHE
    most = 0
    for size in range(100, 1100, 7):
        for cell in (1.0, 16 / 5, 16.0):
            node = Node(1.3 * cell, cell, 3.0)
            for kind in ("blur",) if cell == 1 else ("shrink", "enlarge"):
                operator(kind, 1, size, node, torch.float64, torch.device("cpu"))
                most = max(most, operators.held)
    assert most <= operators.budget


def test_an_operator_is_made_once() -> None:
    arguments = ("blur", 0, 77, Node(1.5, 1.0, 3.0), torch.float32, torch.device("cpu"))
    assert operator(*arguments) is operator(*arguments)
