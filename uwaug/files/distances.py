"""Distances of a run, by its options."""

from collections.abc import Mapping
from os.path import exists
from typing import Any

from uwaug._support.ranges import read_range

# distances from pictures alone, by word: sources as plain values
WORDS: dict[str, dict[str, Any]] = {
    "made-up": {"kind": "MadeUp"},
    "depth-anything": {"kind": "Network", "model": "depth-anything-v2-small"},
}
_FILM_PLANE_M = (1.0, 5.0)  # least and largest distance of the plane that a film without maps is


def are_maps(distance: str | None) -> bool:
    """True for a file, a folder or a pattern of maps; not for metres, as 3 or 1:5, or a word."""
    if distance is None or exists(distance):
        return distance is not None
    return read_range(distance) is None and distance not in WORDS


def distances_of(
    distance: str | None = None,
    source: Any = None,
    *,
    unit: str | float = "m",
    holes: str | float = "error",
    has_maps: bool = False,
    is_film: bool = False,
) -> tuple[Any, str]:
    """Choose the distances of a run by its options; refuses options of maps where there are none.

    Args:
        distance: maps, see `propose`; metres, as 3 or 1:5; or a word of `WORDS`.
        source: a plain value of `RandomUnderwater(distance=…)`.
        unit, holes: of maps.
        has_maps, is_film: what the table of the run says.

    Returns:
        A plain value of `RandomUnderwater(distance=…)`; and a sentence to tell, or "".
    """
    has_options = source is not None or (unit, holes) != ("m", "error")
    if distance is not None and not are_maps(distance):
        if has_maps:
            raise ValueError(f"distance is {distance}, but the table names maps: leave one out")
        plane, word = read_range(distance), WORDS.get(distance, {})
        if plane is not None:
            if has_options:
                got = f"distance is {distance} m for all of a picture"
                raise ValueError(f"{got}: leave out unit, holes and distance.…, which are of maps")
            return plane, ""
        options = word if source is None else source
        kind = options.get("kind", word["kind"]) if isinstance(options, Mapping) else None
        if kind != word["kind"] or (unit, holes) != ("m", "error"):
            cure = "leave out unit, holes and other sources, which are of maps"
            raise ValueError(f"distance is {distance}, guessed from pictures: {cure}")
        return {**options, **word}, ""
    if distance is not None or has_options or has_maps:
        if source is None or isinstance(source, Mapping):
            options = {} if holes == "error" else {"holes": holes}
            source = {"kind": "Metres", **(source or {}), **options}
        return source, ""
    if is_film:
        low, high = _FILM_PLANE_M
        got = f"Without --distance, all of a film is a plane, {low:g} to {high:g} m away"
        return _FILM_PLANE_M, f"{got}, as distances made up from each frame would flicker."
    got = "Without --distance, distances are guessed from each picture"
    return WORDS["made-up"], f"{got}: to look at and to train with, not to measure or restore by."
