"""What a run says of its pictures when it ends: in no more lines than there are things to say."""

import re
from collections.abc import Callable, Iterator, Sequence

from uwaug.jobs.picture import named


class Remarks:
    """Texts about pictures; those that differ in numbers alone are told once, as the first says it,
    with how many pictures they are about.

    Args:
        most: different texts that are kept.
        reword: what a text is told as.

    Attributes:
        dropped: how many were not kept.
    """

    def __init__(self, most: int, reword: Callable[[str], str] = str) -> None:
        self._most, self._reword = most, reword
        self._first: dict[str, tuple[str, str]] = {}
        self._counts: dict[str, int] = {}
        self.dropped = 0

    def add(self, text: str, names: Sequence[str]) -> None:
        """Take down a text about a picture, whose name comes first, and its other files; a name in
        front of the text is no part of what it says.
        """
        about = [name for name in names if text.startswith(f"{name}: ")]
        told = text.removeprefix(f"{about[0]}: ") if about else text
        kind = re.sub(r"[\d.]+", "0", told)
        if kind not in self._counts and len(self._counts) == self._most:
            self.dropped += 1
            return
        self._first.setdefault(kind, (told, (about or names)[0]))
        self._counts[kind] = self._counts.get(kind, 0) + 1

    def __iter__(self) -> Iterator[str]:
        for kind, count in self._counts.items():
            first, name = self._first[kind]
            told = self._reword(first)
            yield f"{count} × {told} (first: {name})" if count > 1 else named(name, told)
