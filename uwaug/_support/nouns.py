"""Nouns: what is random about a picture, such as its water or its light."""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

from uwaug._support import checks
from uwaug._support.codec import changed
from uwaug._support.ranges import Range, as_range

Drawn = Mapping[str, Any]
"""What a noun has drawn for a picture, by name, as JSON holds it."""

SEEDS = 2**32
"""Seeds are whole numbers from 0 to below this one."""


class Uniform:
    """The number of 0…1 that a picture draws for a name. A name stands for its number alone: a
    range that comes or goes moves no other.

    Args:
        key: of the picture, 8 bytes.
        noun: in front of all names.
    """

    def __init__(self, key: bytes, noun: str = "") -> None:
        self.key, self.noun = key, noun

    def __call__(self, name: str) -> float:
        name = f"{self.noun}{name}"
        digest = hashlib.blake2b(name.encode(), digest_size=8, key=self.key).digest()
        return (int.from_bytes(digest) >> 11) * 2.0**-53

    def of(self, noun: str) -> "Uniform":
        """The same for the names of a noun."""
        return Uniform(self.key, f"{self.noun}{noun}.")


class Domain(NamedTuple):
    """The least and the largest value of a number; whether it is drawn by its logarithm."""

    least: float = -math.inf
    most: float = math.inf
    logarithmic: bool = False


def number(
    default: Any, least: float = -math.inf, most: float = math.inf, *, logarithmic: bool = False
) -> Any:
    """A field of a noun: a number, or a range (low, high) from which each picture draws one.

    Args:
        default: of the field; None where nothing is drawn.
        least, most: the domain of the number.
        logarithmic: whether its logarithm is drawn uniformly, not the number itself.
    """
    return field(default=default, metadata={"domain": Domain(least, most, logarithmic)})


class Noun:
    """Something random about a picture. A subclass is a frozen dataclass, whose fields made by
    `number` are drawn anew for each picture; so are those of nouns that it holds.
    """

    PLAIN: ClassVar[Mapping[str, Any]] = {}
    """Options with which nothing is random but what is named."""

    def ranges(self) -> dict[str, Range | None]:
        """The range of each number that a picture draws, by name; None where there is none."""
        drawn = (f.name for f in fields(self) if "domain" in f.metadata)  # type: ignore[arg-type]
        return {name: getattr(self, name) for name in drawn}

    def require_ranges(self) -> None:
        """Refuse a range that falls, or leaves the domain of its number; a list becomes a tuple,
        which stays as it is.
        """
        self.random()  # looks at all of them
        for noun in (self, *self._nouns.values()):
            for name, value in [*vars(noun).items()]:
                if name in noun._ends and isinstance(value, list):
                    object.__setattr__(noun, name, tuple(value))

    def drawn(self, uniform: Uniform) -> dict[str, Any]:
        """What a picture draws."""
        drawn: dict[str, Any] = {}
        for name, (low, high, domain) in self._ends.items():
            if low == high:
                drawn[name] = low
            elif domain.logarithmic:
                drawn[name] = low * (high / low) ** uniform(name)
            else:
                drawn[name] = low + (high - low) * uniform(name)
        for name, noun in self._nouns.items():
            drawn[name] = noun.drawn(uniform.of(name))
        return drawn

    def require(self, drawn: Drawn, name: str) -> None:
        """Refuse what this noun, called `name`, cannot have drawn."""
        require_names(drawn, {*self._ends, *self._nouns}, name)
        for inner, (*_, domain) in self._ends.items():
            checks.within(f"params: {name}.{inner}", drawn[inner], domain.least, domain.most)
        for inner, noun in self._nouns.items():
            noun.require(drawn[inner], f"{name}.{inner}")

    def require_fixed(self, name: str) -> None:
        """Refuse ranges, where one thing is wanted, and numbers outside of their domain."""
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if "domain" in f.metadata and not hasattr(value, "detach"):  # a tensor
                least, most, _ = f.metadata["domain"]
                checks.within(f"{name}: {f.name}", value, least, most)

    def random(self) -> list[str]:
        """The names of what differs from picture to picture."""
        names = [name for name, (low, high, _) in self._ends.items() if low < high]
        return names + [
            f"{n}.{inner}" for n, noun in self._nouns.items() for inner in noun.random()
        ]

    def __repr__(self) -> str:
        shown = [f"{field.name}={getattr(self, field.name)!r}" for field in changed(self)]
        return f"{type(self).__name__}({', '.join(shown)})"

    @cached_property
    def _ends(self) -> dict[str, tuple[float, float, Domain]]:
        """Low and high end, and domain, of each number; refuses a range that leaves its domain."""
        domains = {f.name: f.metadata["domain"] for f in fields(self) if "domain" in f.metadata}  # type: ignore[arg-type]
        ends = {}
        for name, value in self.ranges().items():
            if value is not None:
                domain = domains.get(name)
                low, high = as_range(name, value, *domain[:2] if domain else ())
                ends[name] = low, high, domain or Domain(low, high)
        return ends

    @cached_property
    def _nouns(self) -> "dict[str, Noun]":
        values = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        return {name: value for name, value in values.items() if isinstance(value, Noun)}


class Seeded(Noun):
    """A noun with a seed: that which is given, for all pictures, or one for each of them."""

    seed: int | None

    def drawn(self, uniform: Uniform) -> dict[str, Any]:
        """See `Noun.drawn`."""
        seed = int(uniform("seed") * SEEDS) if self.seed is None else self.seed
        return {**super().drawn(uniform), "seed": seed}

    def require(self, drawn: Drawn, name: str) -> None:
        """See `Noun.require`."""
        require_names(drawn, {*self._ends, "seed"}, name)
        require_seed(f"params: {name}.seed", drawn["seed"])
        super().require({key: value for key, value in drawn.items() if key != "seed"}, name)

    def random(self) -> list[str]:
        """See `Noun.random`."""
        return [*super().random(), *(["seed"] if self.seed is None else [])]

    def of(self, drawn: Drawn) -> Self:
        """The same without anything random, for a picture."""
        return replace(self, **drawn)  # type: ignore[type-var]


@dataclass(frozen=True)
class Fixed(Noun):
    """What is the same for all pictures, among nouns."""

    value: Any

    def of(self, drawn: Drawn, seen: Any) -> Any:
        """The value."""
        return self.value


def require_names(drawn: Any, names: set[str], noun: str) -> None:
    """Refuse what is drawn by other names than those of a noun."""
    if not isinstance(drawn, Mapping):
        raise TypeError(f"params: {noun} must be a table, got {drawn!r:.80}")
    if odd := drawn.keys() ^ names:
        differ = ", ".join(sorted(f"{noun}.{name}" for name in odd))
        raise ValueError(f"params is of a transform with other options: {differ}")


def require_seed(name: str, seed: Any) -> None:
    """Refuse what is no seed."""
    if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < SEEDS:
        raise ValueError(f"{name} must be a whole number from 0 to {SEEDS - 1}, got {seed!r:.80}")
