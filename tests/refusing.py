"""One test of what is refused."""

from collections.abc import Callable
from typing import Any

import pytest


def refusals(*rows: tuple[Any, ...], error: Any = (TypeError, ValueError)) -> Callable[..., None]:
    """A test of rows, each of a callable, its arguments, and a pattern of what is said of them."""

    @pytest.mark.parametrize("row", rows, ids=lambda row: row[-1])
    def refused(row: tuple[Any, ...]) -> None:
        call, *arguments, words = row
        with pytest.raises(error, match=words):
            call(*arguments)

    return refused
