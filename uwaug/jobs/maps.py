"""What must be said of the maps of a run before it begins, asked for all of them at once."""

from pathlib import Path

from uwaug.io.distances import DistanceFormat, finer_unit
from uwaug.jobs.items import Items

_LOOKS = 16
"""Maps, about, that are looked at, spread over the run."""


def require_explained(items: Items, format: DistanceFormat) -> None:
    """Refuse a run most of whose maps need more to be said of them than the format does: another
    unit, or what unknown pixels get. One bad map among good ones fails later, and alone.

    Raises:
        ValueError: with all that is asked for.
    """
    paths = dict.fromkeys(item.distance for item in items if isinstance(item.distance, Path))
    far: dict[Path, float] = {}
    holed: dict[Path, float] = {}
    looked = 0
    for path in list(paths)[:: max(1, len(paths) // _LOOKS)]:
        try:
            median, unknown = format.survey(path)
        except (OSError, ValueError):
            continue
        looked += 1
        if median is not None:
            far[path] = median
        if unknown and format.unknown == "error":
            holed[path] = unknown
    if 2 * max(len(far), len(holed)) <= looked:
        return
    asked = []
    if far:
        low, high = min(far.values()), max(far.values())
        span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
        got = f"the median is {span} m if they are in {format.unit}, farther than one sees"
        asked.append(f"{_names(far)}: {got}: try unit={finer_unit(format.unit)!r}")
    if holed:
        got = f"unknown (0 or NaN) at up to {100 * max(holed.values()):.3g} % of the pixels"
        cure = "unknown='behind' suits depth cameras, 'far' takes open water, 3.5 takes metres"
        asked.append(f"{_names(holed)}: {got}: {cure}")
    raise ValueError("\n  ".join(asked))


def _names(paths: dict[Path, float]) -> str:
    first, *others = paths
    return f"{first} and {len(others)} more" if others else str(first)
