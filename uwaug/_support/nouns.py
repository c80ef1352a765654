"""Nouns: the random parts of a picture, such as its water or its light."""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

from uwaug._support import checks
from uwaug._support.codec import changed
from uwaug._support.ranges import Range, as_range, ends_of

Drawn = Mapping[str, Any]  # numbers of a noun that a picture has drawn, by name
SEEDS = 2**32  # seeds are whole numbers from 0 to below this one


class Uniform(NamedTuple):
    """Random numbers of 0…1 by name, for one picture. Each follows from the picture's key (8 bytes)
    and the name alone: a range that comes or goes changes no other.
    """

    key: bytes
    noun: str = ""  # stands before all names

    def __call__(self, name: str) -> float:
        text = f"{self.noun}{name}".encode()
        digest = hashlib.blake2b(text, digest_size=8, key=self.key).digest()
        return (int.from_bytes(digest) >> 11) * 2.0**-53

    def of(self, noun: str) -> "Uniform":
        return Uniform(self.key, f"{self.noun}{noun}.")


class Domain(NamedTuple):
    """Least and largest value of a number; `logarithmic`: its logarithm is drawn uniformly."""

    least: float = -math.inf
    most: float = math.inf
    logarithmic: bool = False


def number(
    default: Any, least: float = -math.inf, most: float = math.inf, *, logarithmic: bool = False
) -> Any:
    """Declare a field of a noun: a number, or a range (low, high) that each picture draws from, or
    None where nothing is drawn. `least` and `most` are the number's domain.
    """
    return field(default=default, metadata={"domain": Domain(least, most, logarithmic)})


class Noun:
    """Random part of a picture. A subclass is a frozen dataclass. Its fields made by `number`, and
    those of nouns that it holds, are drawn anew for each picture.
    """

    PLAIN: ClassVar[Mapping[str, Any]] = {}
    """Options with which nothing is random."""

    def ranges(self) -> dict[str, Range | None]:
        """The range of each number that a picture draws, by name; None where nothing is drawn."""
        return {name: getattr(self, name) for name in self._domains}

    def require_ranges(self) -> None:
        """Refuse a range that falls or leaves its domain; turn others into tuples."""
        for noun in (self, *self._nouns.values()):
            for name in noun._ends.keys() & vars(noun).keys():
                if ends := ends_of(vars(noun)[name]):
                    vars(noun)[name] = ends

    def drawn(self, uniform: Uniform) -> dict[str, Any]:
        numbers: dict[str, Any] = {}
        for name, (low, high, domain) in self._ends.items():
            if low == high:
                numbers[name] = low
            elif domain.logarithmic:
                numbers[name] = low * (high / low) ** uniform(name)
            else:
                numbers[name] = low + (high - low) * uniform(name)
        for name, noun in self._nouns.items():
            numbers[name] = noun.drawn(uniform.of(name))
        return numbers

    def require(self, drawn: Drawn, name: str) -> None:
        require_names(drawn, {*self._ends, *self._nouns}, name)
        for inner, (*_, domain) in self._ends.items():
            checks.within(f"params: {name}.{inner}", drawn[inner], domain.least, domain.most)
        for inner, noun in self._nouns.items():
            noun.require(drawn[inner], f"{name}.{inner}")

    def require_fixed(self, name: str) -> None:
        for inner, (least, most, _) in self._domains.items():
            value = getattr(self, inner)
            if not hasattr(value, "detach"):
                checks.within(f"{name}: {inner}", value, least, most)

    def random(self) -> list[str]:
        inner = [f"{name}.{n}" for name, noun in self._nouns.items() for n in noun.random()]
        return [name for name, (low, high, _) in self._ends.items() if low < high] + inner

    def __repr__(self) -> str:
        options = [f"{field.name}={getattr(self, field.name)!r}" for field in changed(self)]
        return f"{type(self).__name__}({', '.join(options)})"

    @cached_property
    def _domains(self) -> dict[str, Domain]:
        return {f.name: f.metadata["domain"] for f in fields(self) if "domain" in f.metadata}  # type: ignore[arg-type]

    @cached_property
    def _ends(self) -> dict[str, tuple[float, float, Domain]]:
        ends = {}
        for name, value in self.ranges().items():
            if value is not None:
                domain = self._domains.get(name)
                low, high = as_range(name, value, *domain[:2] if domain else ())
                ends[name] = low, high, domain or Domain(low, high)
        return ends

    @cached_property
    def _nouns(self) -> "dict[str, Noun]":
        values = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        return {name: value for name, value in values.items() if isinstance(value, Noun)}


class Seeded(Noun):
    """Noun with a seed: one for all pictures if it is given, else one for each."""

    seed: int | None

    def drawn(self, uniform: Uniform) -> dict[str, Any]:
        seed = int(uniform("seed") * SEEDS) if self.seed is None else self.seed
        return {**super().drawn(uniform), "seed": seed}

    def require(self, drawn: Drawn, name: str) -> None:
        require_names(drawn, {*self._ends, "seed"}, name)
        require_seed(f"params: {name}.seed", drawn["seed"])
        super().require({key: value for key, value in drawn.items() if key != "seed"}, name)

    def random(self) -> list[str]:
        return super().random() + ["seed"] * (self.seed is None)

    def of(self, drawn: Drawn) -> Self:
        return replace(self, **drawn)  # type: ignore[type-var]


@dataclass(frozen=True)
class Fixed(Noun):
    """Noun with nothing random: a value that all pictures share."""

    value: Any

    def of(self, drawn: Drawn, seen: Any) -> Any:
        return self.value


def require_names(drawn: Any, names: set[str], noun: str) -> None:
    if not isinstance(drawn, Mapping):
        raise TypeError(f"params: {noun} must be a table, got {drawn!r:.80}")
    if unmatched := drawn.keys() ^ names:
        listed = ", ".join(sorted(f"{noun}.{name}" for name in unmatched))
        raise ValueError(f"params is of a transform with other options: {listed}")


def require_seed(name: str, seed: Any) -> None:
    if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < SEEDS:
        raise ValueError(f"{name} must be a whole number from 0 to {SEEDS - 1}, got {seed!r:.80}")
