"""Frames of films: one draw for all, settled on one of them."""

import os
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from uwaug._support import checks
from uwaug.files.items import Item
from uwaug.files.recipe import Recipe
from uwaug.files.record import digest, reason_of
from uwaug.transforms.draws import Record, of_frame

_MAX_TRIED = 9
"""Frames of a film on which its draw may be settled."""

_DARK = 0.1
"""Mean value of a frame, of 0…1, that is no measure of a film's exposure: a fade, or the gap of a
cut.
"""


class Frame(NamedTuple):
    """A frame's place in its film; and the frames on which the film's draw may be settled, from all
    over it, the middle one first.
    """

    number: int
    candidates: tuple[Item, ...]


def frames_of(items: Sequence[Item]) -> dict[Item, Frame]:
    """The frame that each picture is, where each folder is a film."""
    films: dict[str, list[Item]] = {}
    for item in sorted(items, key=_as_counted):
        films.setdefault(os.path.dirname(item.name), []).append(item)
    frames: dict[Item, Frame] = {}
    for film in films.values():
        n = len(film)
        places = dict.fromkeys((n // 2 + k * n // _MAX_TRIED) % n for k in range(_MAX_TRIED))
        candidates = tuple(film[place] for place in places)
        frames |= {item: Frame(number, candidates) for number, item in enumerate(film)}
    return frames


def _as_counted(item: Item) -> list[Any]:
    """A key that sorts names as one counts: 2.png before 10.png."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", item.name)]


class Films:
    """The draws of a recipe's films. In each process a film is settled once."""

    def __init__(self, recipe: Recipe) -> None:
        self.recipe = recipe
        self._settled: dict[tuple[Item, int], tuple[Record, list[Any]]] = {}

    def settled(self, frame: Frame, variant: int) -> tuple[Record, list[Any]]:
        """The record of a frame's film; and what it is settled on: a frame's name, and the digests
        of its picture and its map. That is the first candidate that can be read, is not dark, and
        shows more than open water; if there is none, the first that can be read.

        Raises:
            ValueError: if none can be read; says why not the middle one.
        """
        middle = frame.candidates[0]
        if (middle, variant) not in self._settled:
            # those of one film at a time
            self._settled = {key: film for key, film in self._settled.items() if key[0] == middle}
            record, item = self._settle(frame.candidates, variant)
            files = [path and digest(path) for path in (item.picture, item.distance)]
            self._settled[middle, variant] = record, [item.name, *files]
        return self._settled[middle, variant]

    def drawn(self, frame: Frame, variant: int) -> Record:
        """All that is random about a frame: its film's, but for its noise and the field's drift."""
        record, _ = self.settled(frame, variant)
        (sample,) = record["samples"]
        if "measured" not in sample:
            return record
        moved = self.recipe.drift * frame.number
        return {"samples": [{**of_frame(sample, frame.number), "moved": moved}]}

    def _settle(self, candidates: Sequence[Item], variant: int) -> tuple[Record, Item]:
        drawn = self.recipe.drawn(candidates[0].name, variant)
        poor, reasons = [], []
        for item in candidates:
            try:
                image, z = self.recipe.read(item)
                record = self.recipe.transform_of(item.picture).for_clip(drawn, image, z)
            except Exception as error:  # as over the picture itself
                reasons.append(f"{item.name}: {reason_of(error)}")
                continue
            median = record["samples"][0].get("measured", {}).get("median", 0.0)
            light = float(image.float().mean()) / (1 if image.is_floating_point() else 255)
            if light >= _DARK and median < checks.OPEN:
                return record, item
            poor.append((record, item))
        if not poor:
            raise ValueError(f"no frame serves to settle the film's draw: {reasons[0]}")
        return poor[0]
