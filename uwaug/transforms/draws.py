"""Draws: all that is random about one picture, each number by its name, and the record of it."""

import hashlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

from uwaug._support import checks
from uwaug._support.ranges import Range, as_range
from uwaug.transforms.measured import Measured

Record = dict[str, Any]
"""A plain dictionary, {"samples": […]} with one for each picture, as JSON holds it."""

Uniform = Callable[[str], float]
"""The number of 0…1 that a picture draws for a name."""

_LOGARITHMIC = ("contrast", "full_well", "snow_density")
"""Numbers that are drawn uniformly in their logarithm."""


class Draw(NamedTuple):
    """All that is random about a picture.

    Attributes:
        applied: whether it is degraded at all.
        waters: the name of one, or of two that are mixed.
        numbers: by name, see `Drawn.ranges`.
        field_seed: of the medium field; None where there is none.
        measured: what is taken from one frame of a film for all of them: attributes of `Measured`.
        moved: m by which field and snow of a film have drifted to the right.
    """

    applied: bool
    waters: tuple[str, ...]
    numbers: Mapping[str, float]
    field_seed: int | None
    measured: Mapping[str, Any] = {}
    moved: float = 0.0


class Drawn(Protocol):
    """What is drawn anew for each picture: a source of distances, water, development."""

    def ranges(self) -> Mapping[str, Range | None]:
        """Each number that a picture draws, by name; None where there is none."""
        ...

    def of(self, draw: Draw, seen: Measured) -> Any:
        """The thing itself, from these numbers and from what may be known of the picture."""
        ...


def uniform_of(seed: int) -> Uniform:
    """What a picture of this seed (0…2^63) draws. A name stands for its number alone: a range that
    comes or goes moves no other.
    """
    key = seed.to_bytes(8)

    def drawn(name: str) -> float:
        digest = hashlib.blake2b(name.encode(), digest_size=8, key=key).digest()
        return (int.from_bytes(digest) >> 11) * 2.0**-53

    return drawn


def checked(ranges: Mapping[str, Range | None]) -> dict[str, tuple[float, float]]:
    """(low, high) of each number that is drawn; refuses what leaves the domain of its name."""
    return {
        name: as_range(name, value, *checks.DOMAIN.get(name, ()))
        for name, value in ranges.items()
        if value is not None
    }


def numbers_of(ranges: Mapping[str, tuple[float, float]], uniform: Uniform) -> dict[str, float]:
    """One number of each range, by name."""
    numbers = {}
    for name, (low, high) in ranges.items():
        share = uniform(name)
        is_log = name in _LOGARITHMIC
        numbers[name] = low * (high / low) ** share if is_log else low + (high - low) * share
    return numbers


def of_frame(sample: Record, number: int) -> Record:
    """What a picture of a record draws, as that frame of a film: its sensor's noise is its own."""
    numbers = dict(sample["numbers"])
    if "noise_seed" in numbers:
        numbers["noise_seed"] = (numbers["noise_seed"] + number) % 2**32
    return {**sample, "numbers": numbers}


def read_draws(record: Any, count: int, names: set[str]) -> list[Draw]:
    """The draw of each of `count` pictures that draw numbers of these names; refuses a record of
    other options, of another batch, or with numbers outside of their domain.
    """
    samples = record.get("samples") if isinstance(record, Mapping) else None
    if not isinstance(samples, list) or not all(isinstance(s, Mapping) for s in samples):
        expected = "a record from make_params, {'samples': [{…}]}"
        raise TypeError(f"params must be {expected}, got {record!r:.80}")
    if len(samples) not in (1, count):
        raise ValueError(f"params has {len(samples)} samples but image is a batch of {count}")
    required = set(Draw._fields) - set(Draw._field_defaults)
    for sample in samples:
        numbers = sample.get("numbers", {})
        odd = (set(sample) - set(Draw._field_defaults)) ^ required | set(numbers) ^ names
        if odd:
            differ = ", ".join(sorted(odd))
            raise ValueError(f"params is of a transform with other options: {differ}")
        for name, number in numbers.items():
            checks.within(f"params: {name}", number, *checks.DOMAIN.get(name, ()))
        checks.within("params: moved", sample.get("moved", 0.0))
    draws = [Draw(**sample) for sample in samples]
    return draws if len(draws) == count else draws * count
