"""A grid of pictures, and how a sheet is written."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from benchmarks.harness import RESULTS
from uwaug._support.atomic import written_whole

FIGURES = RESULTS.parent / "figures"
LABEL = 22  # px
GAP = 6  # px
QUALITY = 70


class Grid:
    """Pictures of one shape in columns, each with a label above."""

    def __init__(
        self, rows: int, columns: int, shape: tuple[int, int], width: int = 188, label: int = LABEL
    ) -> None:
        self.wide, self.tall, self.label = width, width * shape[0] / shape[1], label
        self.size = (columns * (width + GAP) - GAP, rows * (self.tall + label))
        self.columns = columns
        self.figure = Figure(figsize=(self.size[0] / 100, self.size[1] / 100), dpi=100)

    def show(self, place: int, picture: Tensor, label: str = "") -> Axes:
        """The picture (3xHxW, sRGB) at a place, counted row by row."""
        row, column = divmod(place, self.columns)
        wide, high = self.size
        x, y = column * (self.wide + GAP), row * (self.tall + self.label) + self.label
        box = (x / wide, 1 - (y + self.tall) / high, self.wide / wide, self.tall / high)
        axis: Axes = self.figure.add_axes(box)
        axis.imshow(picture.clamp(0, 1).permute(1, 2, 0).numpy(), aspect="auto")
        axis.set_axis_off()
        axis.set_title(label, loc="left", fontsize=8, pad=3)
        return axis


def save(figure: Figure, name: str) -> Path:
    """Write it into benchmarks/figures."""
    path = FIGURES / f"{name}.jpg"
    with written_whole(path) as part:
        figure.savefig(part, format="jpg", pil_kwargs={"quality": QUALITY})
    return path
