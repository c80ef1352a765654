"""Results of runs."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from uwaug.files.labels import Judged
from uwaug.files.table import Row

_COLUMNS = ("name", "variant", "result", "contrast", "status", "reason")

ASKED = {
    "blank": "are lost in the water for the most part: are distances in another unit? If not, take "
    "clearer water by --contrast",
    "dark": "of 16 bits, hold no number above 4095: have they 12 bits? Stretch them to 16 first",
    "turned": "are upright by EXIF alone: maps and labels are taken as upright, too. Are they?",
    "alone": "have maps with 0, or another end, a gap away from all other values: unknown? --holes "
    "behind; sky? --holes far",
}
"""What is asked and told of pictures that may be wrong, by the key in records."""


class Result(NamedTuple):
    """Result of a picture."""

    row: Row
    variant: int
    place: str  # path of the written file below the folder of the run
    status: Literal["written", "skipped", "failed"]  # skipped, as the same was made before
    contrast: float | None = None  # mean share that is left, 0…1; None if it failed, and for maps
    objects: Sequence[Judged] = ()  # that have labels
    odd: str = ""  # a sentence on a water that is hardly the one that was named
    asked: Sequence[str] = ()  # keys of `ASKED` that apply
    reason: str = ""  # of a failure


@dataclass(frozen=True)
class Summary:
    """The results of a run in the order of rows and variants, and notes on labels and folder."""

    results: Sequence[Result]
    notes: Sequence[str] = ()

    def count(self, status: str) -> int:
        """Number of pictures with a status of `Result`."""
        return sum(result.status == status for result in self.results)

    @property
    def failures(self) -> list[str]:
        """Reasons of failures, each after a picture's name."""
        return [
            r.reason if r.reason.startswith(r.row.name) else f"{r.row.name}: {r.reason}"
            for r in self.results
            if r.status == "failed"
        ]

    @property
    def asked(self) -> list[str]:
        """Questions of `ASKED` that apply, and a water that is hardly the one that was named, each
        with the number of pictures and a name.
        """
        odd = [result for result in self.results if result.odd]
        sentences = [f"odd scenes: {len(odd)}, such as {r.row.name}: {r.odd}" for r in odd[:1]]
        for key, question in ASKED.items():
            names = list(dict.fromkeys(r.row.name for r in self.results if key in r.asked))
            if names:
                sentences.append(f"{len(names)} pictures, such as {names[0]}, {question}")
        return sentences

    @property
    def objects(self) -> tuple[int, int]:
        """Numbers of all labels, and of kept ones."""
        kept = [judged.kept for result in self.results for judged in result.objects]
        return len(kept), sum(kept)

    def index(self) -> bytes:
        """A table of CSV with a line for each picture."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(_COLUMNS)
        for r in self.results:
            writer.writerow([r.row.name, r.variant, r.place, r.contrast, r.status, r.reason])
        return text.getvalue().encode(errors="backslashreplace")
