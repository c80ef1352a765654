"""Frames of films: one draw for all, settled on one of them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from uwaug._support import checks
from uwaug.files.recipe import Recipe
from uwaug.files.record import reason_of
from uwaug.files.table import Row
from uwaug.transforms.draws import Record, of_frame

_CANDIDATES = 9  # largest number of frames of a film that its draw may be settled on
_DARK_MEAN = 0.1  # 0…1; a darker frame, such as a fade, is no measure of a film's exposure


class Frame(NamedTuple):
    """A frame of a film, which several cameras of a rig may have taken."""

    number: int  # place among all frames of the film, from 0
    moment: float  # time in frames, from 0, which frames of several cameras share
    # frames that the film's draw may be settled on, the middle one of the first camera first
    candidates: tuple[Row, ...]


def frames_of(rows: Sequence[Row]) -> dict[str, Frame]:
    """The frame of each row that is of a film, by its name. A camera of a film has a folder of its
    own, and its usual step in time is one frame; rows of one folder and time are of several, too.
    """
    films: dict[str, list[Row]] = {}
    for row in rows:
        if row.film:
            films.setdefault(row.film, []).append(row)
    frames = {}
    for film, those in films.items():
        times = [row.time for row in those if row.time is not None]
        if times and len(times) < len(those):
            bare = next(row.name for row in those if row.time is None)
            raise ValueError(f"time: of film {film} {bare} has none: give each of its rows one")
        moments = np.array(times or range(len(those)), float)
        order = np.argsort(moments, kind="stable")
        folders = np.array([row.picture.parent.as_posix() for row in those])
        clocks = [np.unique(moments[folders == folder]) for folder in {*folders}]
        steps = np.concatenate([np.diff(clock) for clock in clocks])
        step = np.median(steps) if len(steps) else 1.0
        own = np.flatnonzero(folders == folders[order[0]])
        camera = [those[own[place]] for place in np.unique(moments[own], return_index=True)[1]]
        shares = [(n / _CANDIDATES + 0.5) % 1 for n in range(_CANDIDATES)]
        candidates = tuple(dict.fromkeys(camera[int(s * len(camera))] for s in shares))
        moments = ((moments - moments.min()) / step).round(1)
        for number, place in enumerate(order):
            frames[those[place].name] = Frame(number, float(moments[place]), candidates)
    return frames


class Films:
    """Draws of a recipe's films. Each process settles a film once."""

    def __init__(self, recipe: Recipe) -> None:
        self.recipe = recipe
        self._settled: dict[tuple[Row, int], Record] = {}

    def draw(self, frame: Frame, variant: int) -> Record:
        """The draw of a frame: its film's, with noise and drift of the field of its own."""
        middle = frame.candidates[0]
        if (middle, variant) not in self._settled:
            # those of one film at a time
            self._settled = {key: film for key, film in self._settled.items() if key[0] == middle}
            self._settled[middle, variant] = self._settle(frame.candidates, variant)
        record = self._settled[middle, variant]
        (sample,) = record["samples"]
        if "measured" not in sample:
            return record
        motion = [step * frame.moment for step in self.recipe.motion]
        ways = {"moved": self.recipe.drift * frame.moment, "motion": motion}
        return {"samples": [{**of_frame(sample, frame.number), **ways}]}

    def _settle(self, candidates: Sequence[Row], variant: int) -> Record:
        """Settle a draw on the first frame that can be read, is not dark and shows more than open
        water; without one, on the first that can be read.
        """
        draw = self.recipe.drawn(candidates[0].name, variant)
        poor, reasons = [], []
        for row in candidates:
            try:
                (image, *_), z = self.recipe.read(row)
                record = self.recipe.transform_of(row.picture).for_clip(draw, image, z)
            except Exception as error:  # as over the picture itself
                reasons.append(f"{row.name}: {reason_of(error)}")
                continue
            median = record["samples"][0].get("measured", {}).get("median", 0.0)
            light = float(image.float().mean()) / (1 if image.is_floating_point() else 255)
            if light >= _DARK_MEAN and median < checks.OPEN:
                return record
            poor.append(record)
        if not poor:
            raise ValueError(f"no frame serves to settle the film's draw: {reasons[0]}")
        return poor[0]
