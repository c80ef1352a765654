"""Frames of films: one draw for all, settled on one of them."""

import itertools
import math
import os
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uwaug._support import checks
from uwaug.files.items import Item
from uwaug.files.paths import time_of
from uwaug.files.recipe import Recipe
from uwaug.files.record import digest, reason_of
from uwaug.transforms.draws import Record, of_frame

_CANDIDATES = 9  # largest number of frames of a film that its draw may be settled on
_DARK_MEAN = 0.1  # 0…1; a darker frame, such as a fade, is no measure of a film's exposure

_SIDES = "left|right|cent(?:er|re)|front|rear|back|top|bottom|[lr]"
_CAMERA = "cam(?:era)?[-_ ]?(?:\\d+|[a-d])"
_COUNTED = f"(?:image|img|im|view|infra|rgb)[-_ ]?\\d{{1,2}}|{_CAMERA}"
# what tells the cameras of a rig apart: in names of files, where the frame's number is another, and
# in names of folders
_IN_FILES, _IN_FOLDERS = (
    re.compile(rf"(?<![a-z])(?:{words})(?:[-_ ](?:{_SIDES}))*(?![a-z\d])", re.IGNORECASE)
    for words in (rf"{_SIDES}|{_CAMERA}(?=[-_ ]\d)", f"{_SIDES}|{_COUNTED}")
)


class Frame(NamedTuple):
    """A frame of a film, which several cameras of a rig may have taken."""

    number: int  # place among all frames of the film, from 0
    moment: float  # time in frames, from 0, which frames of several cameras share
    # frames that the film's draw may be settled on, the middle one of the first camera first
    candidates: tuple[Item, ...]


def frames_of(items: Sequence[Item], rig: str = "auto") -> dict[Item, Frame]:
    """The frame of each picture, by `rig` of `Recipe`."""
    folders: dict[str, list[Item]] = {}
    for item in sorted(items, key=lambda item: _counted(item.name)):
        folders.setdefault(os.path.dirname(item.name), []).append(item)
    folder_names = () if rig in ("auto", "none") else rig.split(",")
    if absent := {*folder_names} - {part for folder in folders for part in folder.split("/")}:
        raise ValueError(f"rig (--rig): no folder of pictures is called {' or '.join(absent)}")
    films: dict[str, list[list[Item]]] = {}
    for folder, pictures in folders.items():
        film = "/".join("*" if part in folder_names else part for part in folder.split("/"))
        if rig == "auto":
            film = _without_camera(folder, _IN_FOLDERS)
            if film in films and not _are_at_one_time(films[film][0], pictures):
                film = folder
        films.setdefault(film, []).append(pictures)
    frames: dict[Item, Frame] = {}
    for cameras in films.values():
        shares = [(n / _CANDIDATES + 0.5) % 1 for n in range(_CANDIDATES)]
        candidates = tuple(
            dict.fromkeys(film[int(share * len(film))] for film in cameras for share in shares)
        )
        numbers = itertools.count()
        for camera, moments in zip(cameras, _moments_of(cameras), strict=True):
            for item, moment in zip(camera, moments, strict=True):
                frames[item] = Frame(next(numbers), moment, candidates)
    return frames


def rigs_of(frames: Mapping[Item, Frame]) -> str:
    """A sentence on films that share a water, or do not; "" for one film of one camera."""
    films = _folders_of(frames)
    count_of_all = f"{len(films)} films, each in its own water" if len(films) > 1 else "one film"
    first, *others = max(films, key=len)
    if not others:
        return f"{count_of_all}: are some by one rig? --rig FOLDER,FOLDER" if len(films) > 1 else ""
    got = f"{first} and {others[0]} are taken for one rig: one water, metered on {first}"
    return f"{count_of_all}; {got}; --rig none if they are none"


def unjoined(items: Sequence[Item]) -> str:
    """A sentence on pictures of a rig that are no film; "" without a rig."""
    folders = max(_folders_of(frames_of(items)), key=len, default=[])
    if len(folders) < 2:
        return ""
    rig = f"{folders[0]} and {folders[1]}"
    return f"{rig} look like cameras of a rig: --sequence gives their pictures the same water"


def _folders_of(frames: Mapping[Item, Frame]) -> list[list[str]]:
    films: dict[Item, dict[str, None]] = {}
    for item, frame in frames.items():
        films.setdefault(frame.candidates[0], {})[os.path.dirname(item.name) or "."] = None
    return [*map(list, films.values())]


def _without_camera(path: str, camera: re.Pattern[str]) -> str:
    """A path with * in place of words that tell cameras apart. A capital begins a word, too."""
    return camera.sub("*", re.sub(r"(?<=[a-z\d])(?=[A-Z])", " ", path))


def _moments_of(cameras: Sequence[Sequence[Item]]) -> list[list[float]]:
    """The moment of each frame of each camera, which may have lost some: by the nearest time of the
    first camera if names are times, else by the numbers in the names of all, or their order.
    """
    times = [[time_of(item.name) or math.nan for item in camera] for camera in cameras]
    if not any(map(math.isnan, itertools.chain(*times))):
        clock = np.sort(times[0])
        between = (clock[1:] + clock[:-1]) / 2
        moments = _in_frames(clock)
        return [moments[np.searchsorted(between, camera)].tolist() for camera in times]
    names = [_frame_names(camera) for camera in cameras]
    ordered = sorted({*itertools.chain(*names)}, key=_counted)
    columns = [{*column} for column in itertools.zip_longest(*map(_counted, ordered))]
    varied = [[*column] for column in columns if len(column) > 1]
    is_counted = [*map(len, varied)] == [len(ordered)] and isinstance(varied[0][0], int)
    numbers = np.array(sorted(varied[0]) if is_counted else range(len(ordered)), float)
    places = dict(zip(ordered, _in_frames(numbers).tolist(), strict=True))
    return [[places[name] for name in camera] for camera in names]


def _in_frames(times: NDArray[Any]) -> NDArray[Any]:
    """Times, or numbers, that rise, as numbers of frames from 0: the usual step is one frame."""
    steps = np.diff(times)
    frames: NDArray[Any] = (times - times[0]) / (np.median(steps[steps > 0]) if steps.any() else 1)
    return frames.round(1)


def _frame_names(film: Sequence[Item]) -> list[str]:
    """Names of frames that all cameras of a rig share."""
    stems = (os.path.splitext(os.path.basename(item.name))[0] for item in film)
    return [_without_camera(stem, _IN_FILES) for stem in stems]


def _are_at_one_time(film: Sequence[Item], other: Sequence[Item]) -> bool:
    """True if half of the names of frames are the same, or the times overlap that they say."""
    names = {*_frame_names(film)} & {*_frame_names(other)}
    if 2 * len(names) >= min(len(film), len(other)):
        return True
    times = [[t for item in f if (t := time_of(item.name)) is not None] for f in (film, other)]
    return all(times) and max(map(min, times)) <= min(map(max, times))


def _counted(name: str) -> list[Any]:
    """A key that sorts names by the numbers in them: 2.png before 10.png."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)]


class Films:
    """Draws of a recipe's films. Each process settles a film once."""

    def __init__(self, recipe: Recipe) -> None:
        self.recipe = recipe
        self._settled: dict[tuple[Item, int], tuple[Record, list[Any]]] = {}

    def settled(self, frame: Frame, variant: int) -> tuple[Record, list[Any]]:
        """The record of a frame's film, with its camera's motion a frame, and the frame that it is
        settled on: its name, and the digests of its picture and its map.
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
        motion = [step * frame.moment for step in sample["motion"]]
        ways = {"moved": self.recipe.drift * frame.moment, "motion": motion}
        return {"samples": [{**of_frame(sample, frame.number), **ways}]}

    def _settle(self, candidates: Sequence[Item], variant: int) -> tuple[Record, Item]:
        """Settle a draw on the first frame that can be read, is not dark and shows more than open
        water; without one, on the first that can be read.
        """
        draw = self.recipe.drawn(candidates[0].name, variant)
        poor, reasons = [], []
        for item in candidates:
            try:
                (image, *_), z = self.recipe.read(item)
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
