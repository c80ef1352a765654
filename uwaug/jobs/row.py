"""One picture of a run: where it is read and written."""

from pathlib import Path
from typing import NamedTuple

__all__ = ["Row", "record_path", "terms_path"]


class Row(NamedTuple):
    """A picture of a run.

    Attributes:
        id: what its randomness follows from: its path from the folder that was given, or the id of
            an index.
        input: its file.
        distance: the file of its distances; metres; or None, for a depth network.
        output: the file to write.
        variant: which of several of one picture, from 0.
        problem: why it cannot be done; None if nothing is known against it.
        name: path of the picture from the folder that was given, which labels know it by.
        out: the folder that is written to; None: the output's own.
    """

    id: str
    input: Path
    distance: Path | float | None
    output: Path
    variant: int = 0
    problem: str | None = None
    name: str = ""
    out: Path | None = None

    @property
    def key(self) -> str:
        """Tells it apart from all others of a run."""
        return f"{self.id}/{self.variant}"

    @property
    def place(self) -> Path:
        """Path of the output from the folder that is written to."""
        return self.output.relative_to(self.out or self.output.parent)

    @property
    def labels(self) -> Path:
        """Where labels of the output would be, were they a picture."""
        return (self.out or self.output.parent) / "labels" / self.place

    def moved(self, out: Path) -> "Row":
        """The same row, written to another folder."""
        return self._replace(output=out / self.place, out=out)


def terms_path(output: Path, term: str) -> Path:
    """The file of one of a picture's terms."""
    return output.with_name(f"{output.stem}_{term}{output.suffix}")


def record_path(output: Path) -> Path:
    """The record of a picture that is written to `output`."""
    return output.with_name(output.name + ".json")
