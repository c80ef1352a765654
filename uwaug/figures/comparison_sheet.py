"""A comparison of systems as a sheet: their pictures, and the table below."""

from typing import TYPE_CHECKING

from uwaug._support.sheet import GREY, INK, MARGIN, columns_for, sheet, show
from uwaug.figures.comparison import FULLEST, HEADINGS, cells_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from uwaug.figures.comparison import Comparison

__all__ = ["draw_comparison"]

_LINE = 24
"""px: height of a row of the table."""

_COLUMNS = (0, 330, 560, 660, 800, 900, 990, 1180)
"""px: where the columns of the table end, the first two where they begin."""


def draw_comparison(found: "Comparison") -> "Figure":
    """See `Comparison.figure`."""
    shape = (found.image.shape[-2], found.image.shape[-1])
    columns = columns_for(shape)
    rows = -(-(1 + len(found.pictures)) // columns)
    caption = "Each as its authors computed it, with one water, one exposure, no noise."
    if found.fixed:
        caption += f" With a water of its own: {', '.join(found.fixed)}."
    below = _LINE * (len(found.rows) + 3)
    heading = f"One scene, {len(found.rows)} systems, Jerlov {found.water}"
    figure, axes = sheet(rows, columns, shape, heading, caption, below=below)
    pictures = {"No water": found.image, **found.pictures}
    for axis, (name, picture) in zip(axes, pictures.items(), strict=False):
        show(axis, picture, name)
    _write_table(figure, found)
    return figure


def _write_table(figure: "Figure", found: "Comparison") -> None:
    width, height = figure.get_size_inches() * figure.dpi
    lines = [HEADINGS, *map(cells_of, found.rows)]
    note = (
        "Contrast: of fine detail on grey, left at that distance. "
        f"ΔE: mean CIEDE2000 to {FULLEST}. "
        "PC difference: of phase congruency, 0 = all structure is left."
    )
    for n, line in enumerate(lines):
        y = (_LINE * (len(lines) - n) + MARGIN) / height
        for cell, x in zip(line, _COLUMNS, strict=True):
            left = x in _COLUMNS[:2]
            figure.text(
                (MARGIN + x) / width,
                y,
                cell,
                fontsize=11,
                color=GREY if n == 0 else INK,
                ha="left" if left else "right",
                va="center",
                parse_math=False,
            )
    figure.text(MARGIN / width, MARGIN / height, note, fontsize=10, color=GREY, va="center")
