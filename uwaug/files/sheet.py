"""A sheet of pictures before and after a run."""

import io
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path

import torch
from torch import Tensor

from uwaug.figures.sheet import Cell, sheet
from uwaug.files.pictures import read_picture

_MAX_PICTURES, _MAX_VARIANTS = 12, 5  # pictures, spread over a run, and variants of each
_MAX_COLUMNS = 6  # pictures side by side, before and after
_SIZE_PX = 240, 180  # of a picture
_BLANK: Cell = (torch.ones(3, 1, 1), "")


def drawn_sheet(
    variants: Sequence[tuple[Path, Sequence[Path]]],
    read: Callable[[Path], Tensor],
    caption: Callable[[Path], str],
    beside: Sequence[Path] = (),
) -> bytes:
    """A JPEG of pictures, each with its variants to the right, names and captions above; then of
    photographs to compare. `read` and `caption` give the picture (3xHxW) and the caption of a
    variant's file.
    """

    def before(file: Path, words: str = "") -> Cell:
        return read_picture(file, background="white"), f"{file.name}\n{words}"

    def group(file: Path, results: Sequence[Path]) -> Iterator[Cell]:
        yield before(file)
        for result in results:
            yield read(result), f"{result.name}\n{caption(result)}"
        yield from [_BLANK] * (columns - 1 - len(results))

    step = max(1, (len(variants) - 1) // max(1, _MAX_PICTURES - 1))
    sample = [(file, after[:_MAX_VARIANTS]) for file, after in variants[::step][:_MAX_PICTURES]]
    columns = 1 + max(len(after) for _, after in sample)
    across = min(len(sample), max(1, _MAX_COLUMNS // columns))
    rows: list[Iterator[Cell]] = [
        chain.from_iterable(group(*pair) for pair in sample[i : i + across])
        for i in range(0, len(sample), across)
    ]
    real = beside[:: -(-len(beside) // _MAX_PICTURES) or 1]
    for i in range(0, len(real), across * columns):
        rows.append(before(file, "real") for file in real[i : i + across * columns])
    jpeg = io.BytesIO()
    sheet(rows, _SIZE_PX).save(jpeg, "JPEG", quality=90)
    return jpeg.getvalue()
