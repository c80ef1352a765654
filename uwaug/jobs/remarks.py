"""What a run says of its pictures when it ends: in no more lines than there are things to say."""

from collections.abc import Iterator, Sequence

from uwaug.jobs.picture import named


class Remarks:
    """Texts about pictures; equal ones are told once, with how many pictures they are about.

    Args:
        most: different texts that are kept.

    Attributes:
        dropped: how many were not kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._names: dict[str, list[str]] = {}
        self._counts: dict[str, int] = {}
        self.dropped = 0

    def add(self, text: str, names: Sequence[str]) -> None:
        """Take down a text about a picture, whose name comes first, and its other files; a name in
        front of the text is no part of what it says.
        """
        about = [name for name in names if text.startswith(f"{name}: ")]
        told = text.removeprefix(f"{about[0]}: ") if about else text
        if told not in self._counts and len(self._counts) == self._most:
            self.dropped += 1
            return
        self._names.setdefault(told, about or [names[0]])
        self._counts[told] = self._counts.get(told, 0) + 1

    def __iter__(self) -> Iterator[str]:
        for told, count in self._counts.items():
            (first, *_) = self._names[told]
            yield f"{count} × {told} (first: {first})" if count > 1 else named(first, told)
