"""A sheet of pictures before and after a run."""

import io
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from uwaug.figures.sheet import Cell, sheet
from uwaug.files.labels import Labels
from uwaug.files.pictures import read_picture
from uwaug.files.summary import Result

if TYPE_CHECKING:
    from uwaug.files.run import Work

_MAX_PICTURES, _MAX_VARIANTS = 12, 5  # pictures, spread over a run, and variants of each
_MAX_COLUMNS = 6  # pictures side by side, before and after
_SIZE_PX = 240, 180  # of a picture
_BLANK: Cell = (torch.ones(3, 1, 1), "")
_COLOURS = torch.tensor([[1, 0, 0], [1, 1, 0]])[..., None, None]  # of dropped labels, of kept ones


def drawn_sheet(
    results: Sequence[Result], work: "Work", labels: Labels | None, beside: Sequence[Path]
) -> bytes:
    """A JPEG of pictures, each with its variants to the right, names and captions above, and boxes
    of labels within; then of photographs to compare.
    """

    def before(file: Path, words: str = "") -> Cell:
        return read_picture(file, background="white"), f"{file.name}\n{words}"

    def group(variants: Sequence[Result]) -> Iterator[Cell]:
        yield before(variants[0].item.picture)
        for result in variants:
            path = work.out / result.place
            picture = work.read(path)
            if labels is not None:
                _draw_boxes(picture, labels, result)
            yield picture, f"{path.name}\n{work.caption(path)}"
        yield from [_BLANK] * (columns - 1 - len(variants))

    variants: dict[Path, list[Result]] = {}
    for result in results:
        variants.setdefault(result.item.picture, []).append(result)
    step = max(1, (len(variants) - 1) // max(1, _MAX_PICTURES - 1))
    sample = [each[:_MAX_VARIANTS] for each in [*variants.values()][::step][:_MAX_PICTURES]]
    columns = 1 + max(map(len, sample))
    across = min(len(sample), max(1, _MAX_COLUMNS // columns))
    rows: list[Iterator[Cell]] = [
        chain.from_iterable(map(group, sample[i : i + across]))
        for i in range(0, len(sample), across)
    ]
    real = beside[:: -(-len(beside) // _MAX_PICTURES) or 1]
    for i in range(0, len(real), across * columns):
        rows.append(before(file, "real") for file in real[i : i + across * columns])
    kept = [judged.kept for each in sample for result in each for judged in result.objects]
    counts = f"Labels: {kept.count(True)} kept (yellow), {kept.count(False)} dropped (red)"
    jpeg = io.BytesIO()
    drawn = sheet(rows, _SIZE_PX, caption="" if labels is None else counts)
    drawn.save(jpeg, "JPEG", quality=90, subsampling=0)  # else thin lines lose their colours
    return jpeg.getvalue()


def _draw_boxes(picture: Tensor, labels: Labels, result: Result) -> None:
    """Draw boxes around the objects of a picture (3xHxW), a pixel wide on the sheet."""
    size = picture.shape[1], picture.shape[2]
    width = max(1, size[0] // _SIZE_PX[1], size[1] // _SIZE_PX[0])
    kept = {judged.key: judged.kept for judged in result.objects}
    for key, pixels in labels.objects(result.item.name, size) if kept else ():
        inside = np.zeros(size, bool)
        inside[pixels] = True
        y, x = inside.nonzero()
        if len(y):
            box = picture[:, y.min() : y.max() + 1, x.min() : x.max() + 1]
            core = box[:, width:-width, width:-width].clone()
            box[:] = _COLOURS[int(kept[key])] * (1 if picture.is_floating_point() else 255)
            box[:, width:-width, width:-width] = core
