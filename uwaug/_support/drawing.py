"""What all figures share: their ink, and how they are written."""

from pathlib import Path
from typing import TYPE_CHECKING

from uwaug._support.atomic import written_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, GREY = "#1a1a1a", "#5a5a5a"
RGB = ("#c0392b", "#2e8b57", "#2a5caa")


def save(figure: "Figure", path: Path) -> None:
    """Write a figure as PNG or JPEG, whole or not at all."""
    options = {"quality": 88} if path.suffix == ".jpg" else {"optimize": True}
    with written_whole(path) as part:
        figure.savefig(part, format=path.suffix[1:], pil_kwargs=options)
