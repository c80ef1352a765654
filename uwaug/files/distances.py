"""Distances of a run, by its options."""

from collections.abc import Mapping
from os.path import exists
from typing import Any, NamedTuple

from uwaug._support.ranges import read_range

# distances from pictures alone, by word: sources as plain values
WORDS: dict[str, dict[str, Any]] = {
    "made-up": {"kind": "MadeUp"},
    "depth-anything": {"kind": "Network", "model": "depth-anything-v2-small"},
}
_FILM_PLANE_M = (1.0, 5.0)  # least and largest distance of the plane that a film without maps is


class Distances(NamedTuple):
    """The distances of a run."""

    source: Any  # plain value of `RandomUnderwater(distance=…)`; None for its default
    maps: str | None  # file, folder or pattern of maps, for `find_items`
    note: str = ""  # a sentence to tell


def distances_of(
    distance: str | None = None,
    source: Any = None,
    *,
    unit: str | float = "m",
    holes: str | float = "error",
    sequence: bool = False,
) -> Distances:
    """Choose the distances of a run by its options; refuses options of maps where there are none.
    `distance` is a file, a folder or a pattern, see `find_items`; metres, as 3 or 1:5; or a word of
    `WORDS`. `source` is a plain value of `RandomUnderwater(distance=…)`.
    """
    has_options = source is not None or (unit, holes) != ("m", "error")
    if distance is not None and not exists(distance):
        plane = read_range(distance)
        if plane is not None:
            if has_options:
                cure = "leave out unit, holes and distance.…, which are of maps"
                raise ValueError(f"distance is {distance} m for all of a picture: {cure}")
            return Distances(plane, None)
        if (word := WORDS.get(distance)) is not None:
            options = word if source is None else source
            kind = options.get("kind", word["kind"]) if isinstance(options, Mapping) else None
            if kind != word["kind"] or (unit, holes) != ("m", "error"):
                cure = "unit, holes and other sources are of maps; leave them out"
                raise ValueError(f"distance is {distance}, guessed from pictures: {cure}")
            return Distances({**options, **word}, None)
    if distance is not None or has_options:
        if source is None or isinstance(source, Mapping):
            options = {} if holes == "error" else {"holes": holes}
            source = {"kind": "Metres", **(source or {}), **options}
        return Distances(source, distance)
    if sequence:
        low, high = _FILM_PLANE_M
        got = f"Without --distance, all of a film is a plane, {low:g} to {high:g} m away"
        why = "distances made up from each frame would flicker"
        return Distances(_FILM_PLANE_M, None, f"{got}, as {why}.")
    got = "Without --distance, distances are guessed from each picture"
    note = f"{got}: good to look at and to train with, not to measure or restore by."
    return Distances(WORDS["made-up"], None, note)
