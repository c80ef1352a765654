"""A sheet of pictures before and after a run."""

import io
from collections.abc import Iterator, Sequence
from itertools import chain, groupby
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from uwaug.figures.sheet import Cell, draw_box, sheet
from uwaug.files.labels import Labels
from uwaug.files.pictures import read_picture
from uwaug.files.summary import Result

if TYPE_CHECKING:
    from uwaug.files.run import Work

_MAX_PICTURES, _MAX_VARIANTS = 12, 5  # pictures, spread over a run, and variants of each
_MAX_COLUMNS, _SIZE_PX = 6, (240, 180)  # pictures side by side, before and after; size of each


def drawn_sheet(
    results: Sequence[Result], work: "Work", labels: Labels | None, beside: Sequence[Path]
) -> bytes:
    """A JPEG of pictures, each before its variants and their boxes; then of photographs beside."""

    def before(file: Path, words: str = "") -> Cell:
        return read_picture(file), f"{file.name}\n{words}"

    def after(result: Result) -> Cell:
        path = work.out / result.place
        picture, kept = read_picture(path), {judged.key: judged.kept for judged in result.objects}
        size = picture.shape[1], picture.shape[2]
        for key, pixels in labels.objects(result.row.name, size) if labels and kept else ():
            draw_box(picture, pixels, "yellow" if kept[key] else "red", _SIZE_PX)
        return picture, f"{path.name}\n{work.caption(path)}"

    def group(variants: Sequence[Result]) -> Iterator[Cell]:
        blanks = [(torch.ones(3, 1, 1), "")] * (columns - 1 - len(variants))
        return chain([before(variants[0].row.picture)], map(after, variants), blanks)

    groups = [[*each] for _, each in groupby(results, lambda result: result.row.picture)]
    step = max(1, (len(groups) - 1) // max(1, _MAX_PICTURES - 1))
    sample = [each[:_MAX_VARIANTS] for each in groups[::step][:_MAX_PICTURES]]
    columns = 1 + max(map(len, sample))
    across = min(len(sample), max(1, _MAX_COLUMNS // columns))
    parts = [sample[i : i + across] for i in range(0, len(sample), across)]
    rows: list[Iterator[Cell]] = [chain.from_iterable(map(group, part)) for part in parts]
    real = beside[:: -(-len(beside) // _MAX_PICTURES) or 1]
    for i in range(0, len(real), across * columns):
        rows.append(before(file, "real") for file in real[i : i + across * columns])
    kept = [judged.kept for each in sample for result in each for judged in result.objects]
    counts = f"Labels: {sum(kept)} kept (yellow), {len(kept) - sum(kept)} dropped (red)"
    jpeg, drawn = io.BytesIO(), sheet(rows, _SIZE_PX, caption=counts if labels else "")
    drawn.save(jpeg, "JPEG", quality=90, subsampling=0)  # else thin lines lose their colours
    return jpeg.getvalue()
