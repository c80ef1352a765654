"""Where the distances of a run come from."""

from collections.abc import Mapping
from os.path import exists
from typing import Any, NamedTuple

from uwaug._support.ranges import read_range

_FILM = (1.0, 5.0)
"""m, between which a film without maps is a plane."""


class Distances(NamedTuple):
    """Where the distances of a run come from.

    Attributes:
        source: for `RandomUnderwater(distance=…)`, as `from_dict` takes it; None for its default.
        maps: for `find_items`; None where there are no maps.
        note: what there is to say of it, "" for nothing.
    """

    source: Any
    maps: str | None
    note: str = ""


def distances_of(
    distance: str | None = None,
    source: Any = None,
    *,
    unit: str | float = "m",
    holes: str | float = "error",
    sequence: bool = False,
) -> Distances:
    """Where distances come from, of what a person says of them.

    Args:
        distance: a file, a folder or a pattern, see `find_items`; where nothing is called so,
            metres, as 3 or 1:5, or "made-up"; None where nothing is said.
        source: what else is said of `RandomUnderwater(distance=…)`, as `from_dict` takes it.
        unit, holes: as for `Recipe` and `Metres`. Who speaks of them has maps.
        sequence: whether pictures are frames of films.

    Raises:
        ValueError: if metres are given, and something is said of maps.
    """
    if distance is not None and not exists(distance):
        metres = read_range(distance)
        if metres is not None:
            if source is not None or (unit, holes) != ("m", "error"):
                cure = "unit, holes and distance.… are of maps; leave them out"
                raise ValueError(f"distance is {distance} m for all of a picture: {cure}")
            return Distances(metres, None)
        if distance == "made-up":
            options = source if isinstance(source, Mapping) else {}
            return Distances({**options, "kind": "MadeUp"}, None)
    if distance is not None or source is not None or (unit, holes) != ("m", "error"):
        if source is None or isinstance(source, Mapping):
            said = {} if holes == "error" else {"holes": holes}
            source = {"kind": "Metres", **(source or {}), **said}
        return Distances(source, distance)
    if sequence:
        low, high = _FILM
        note = (
            f"Without --distance, all of a film is a plane, {low:g} to {high:g} m away, as "
            "distances made up from each frame would flicker."
        )
        return Distances(_FILM, None, note)
    note = (
        "Without --distance, distances are guessed from each picture: good to look at and to train "
        "with, not to measure or restore by."
    )
    return Distances({"kind": "MadeUp"}, None, note)
