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

_CANDIDATES = 9  # largest number of frames of a film that its draw may be settled on
_DARK_MEAN = 0.1  # 0…1; a darker frame, such as a fade, is no measure of a film's exposure


class Frame(NamedTuple):
    """A frame of a film.

    Attributes:
        number: place of the frame in its film, from 0.
        candidates: frames that the film's draw may be settled on, from all over it, the middle one
            first.
    """

    number: int
    candidates: tuple[Item, ...]


def frames_of(items: Sequence[Item]) -> dict[Item, Frame]:
    """The frame of each picture, where each folder is a film."""
    films: dict[str, list[Item]] = {}
    for item in sorted(items, key=_as_counted):
        films.setdefault(os.path.dirname(item.name), []).append(item)
    frames: dict[Item, Frame] = {}
    for film in films.values():
        n = len(film)
        places = dict.fromkeys((n // 2 + k * n // _CANDIDATES) % n for k in range(_CANDIDATES))
        candidates = tuple(film[place] for place in places)
        frames |= {item: Frame(number, candidates) for number, item in enumerate(film)}
    return frames


def _as_counted(item: Item) -> list[Any]:
    """A key that sorts names by the numbers in them: 2.png before 10.png."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", item.name)]


class Films:
    """Draws of a recipe's films. Each process settles a film once."""

    def __init__(self, recipe: Recipe) -> None:
        self.recipe = recipe
        self._settled: dict[tuple[Item, int], tuple[Record, list[Any]]] = {}

    def settled(self, frame: Frame, variant: int) -> tuple[Record, list[Any]]:
        """The record of a frame's film, with its camera's motion a frame, and the frame that it is
        settled on: its name, and the digests of its picture and its map.

        The film is settled on the first candidate that can be read, is not dark and shows more than
        open water; without one, on the first that can be read. Without that, it is refused.
        """
        middle = frame.candidates[0]
        if (middle, variant) not in self._settled:
            # those of one film at a time
            self._settled = {key: film for key, film in self._settled.items() if key[0] == middle}
            record, item = self._settle(frame.candidates, variant)
            files = [path and digest(path) for path in (item.picture, item.distance)]
            self._settled[middle, variant] = record, [item.name, *files]
        return self._settled[middle, variant]

    def draw(self, frame: Frame, variant: int) -> Record:
        """The draw of a frame: its film's, with noise and drift of the field of its own."""
        record, _ = self.settled(frame, variant)
        (sample,) = record["samples"]
        if "measured" not in sample:
            return record
        motion = [step * frame.number for step in sample["motion"]]
        ways = {"moved": self.recipe.drift * frame.number, "motion": motion}
        return {"samples": [{**of_frame(sample, frame.number), **ways}]}

    def _settle(self, candidates: Sequence[Item], variant: int) -> tuple[Record, Item]:
        draw = self.recipe.drawn(candidates[0].name, variant)
        poor, reasons = [], []
        for item in candidates:
            try:
                image, z = self.recipe.read(item)
                record = self.recipe.transform_of(item.picture).for_clip(draw, image, z)
            except Exception as error:  # as over the picture itself
                reasons.append(f"{item.name}: {reason_of(error)}")
                continue
            (sample,) = record["samples"]
            median = sample.get("measured", {}).get("median", 0.0)
            if median:
                sample["motion"] = self.recipe.motion_before(median, image.shape[-1])
            light = float(image.float().mean()) / (1 if image.is_floating_point() else 255)
            if light >= _DARK_MEAN and median < checks.OPEN:
                return record, item
            poor.append((record, item))
        if not poor:
            raise ValueError(f"no frame serves to settle the film's draw: {reasons[0]}")
        return poor[0]
