"""What became of a run."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

from uwaug._support.atomic import written_whole
from uwaug.files.items import Item
from uwaug.files.labels import Judged
from uwaug.files.record import COLUMNS
from uwaug.formation.contrast import FAINT
from uwaug.transforms.random_water import Reached

ASKED = {
    "turned": "are upright by EXIF alone: maps and labels are taken as upright, too. Are they?",
    "dark": "of 16 bits, reach less than 1/8 of white: have they 10 or 12 bits? Stretch them first",
    "alone": "have maps with 0, or another end, a gap away from all other values: unknown? --holes "
    "behind; sky? --holes far",
}
"""What there is to ask of a picture of which one cannot be sure."""


class Result(NamedTuple):
    """What became of a picture.

    Attributes:
        item, variant: which picture.
        place: of the file that was written, below the folder of the run.
        status: "written"; "skipped", as it has been made before, of the same; "failed".
        contrast: mean share of contrast that is left; None if it failed, and of maps.
        objects: of the picture, if there are labels.
        reached: what it took to reach the contrast asked for, if one was.
        asked: what there is to ask of it, see `ASKED`.
        reason: why it failed.
    """

    item: Item
    variant: int
    place: str
    status: Literal["written", "skipped", "failed"]
    contrast: float | None = None
    objects: Sequence[Judged] = ()
    reached: Reached | None = None
    asked: Sequence[str] = ()
    reason: str = ""


@dataclass(frozen=True)
class Summary:
    """What became of a run: the `Result` of each picture, in the order of items and variants; and
    notes, what there is to say of its labels.
    """

    results: Sequence[Result]
    notes: Sequence[str] = ()

    def count(self, status: str) -> int:
        """How many pictures have a status of `Result`."""
        return sum(result.status == status for result in self.results)

    @property
    def failures(self) -> list[str]:
        """What went wrong: each begins with a picture's name."""
        return [
            r.reason if r.reason.startswith(r.item.name) else f"{r.item.name}: {r.reason}"
            for r in self.results
            if r.status == "failed"
        ]

    @property
    def blank(self) -> list[str]:
        """Names of pictures in which next to nothing is left to see, less than 3 % of the contrast:
        distances may be in another unit, or the water too turbid.
        """
        shares = [(result.item.name, result.contrast) for result in self.results]
        return [name for name, share in shares if share is not None and share < FAINT]

    @property
    def odd(self) -> list[str]:
        """What is odd about pictures whose contrast it took odd distances or contents to reach, or
        that did not reach it, see `RandomUnderwater`: each begins with a name.
        """
        named = [(result.item.name, result.reached) for result in self.results]
        return [f"{name}: {reached.odd}" for name, reached in named if reached and reached.odd]

    @property
    def asked(self) -> list[str]:
        """What there is to ask of some pictures, see `ASKED`, with their number and a name."""
        sentences = []
        for key, question in ASKED.items():
            names = list(dict.fromkeys(r.item.name for r in self.results if key in r.asked))
            if names:
                sentences.append(f"{len(names)} pictures, such as {names[0]}, {question}")
        return sentences

    @property
    def objects(self) -> tuple[int, int]:
        """How many labels there were, and how many of them were kept."""
        kept = [judged.kept for result in self.results for judged in result.objects]
        return len(kept), sum(kept)

    def write_index(self, path: Path) -> None:
        """Write a line for each picture."""
        with written_whole(path) as part, part.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            for result in self.results:
                item = result.item
                where = [item.name, result.variant, item.picture, item.distance, result.place]
                writer.writerow([*where, result.contrast, result.status, result.reason])
