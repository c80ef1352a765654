"""`RandomUnderwater` on pictures and maps of data sets, with randomness from their names."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.adapters.conversion import map_of, picture_of
from uwaug.io.distances import Unit, metres_of
from uwaug.transforms.random_underwater import RandomUnderwater
from uwaug.transforms.samples import key_of


class Epoch:
    """The number of the pass through the data, in memory that all workers look at: those that
    persist hear of a new one, too.
    """

    def __init__(self) -> None:
        number = torch.zeros((), dtype=torch.int64)
        self.number: Tensor = number.share_memory_()  # type: ignore[no-untyped-call]

    def __deepcopy__(self, memo: dict[int, Any]) -> "Epoch":
        # a data set copies its transform with itself: the copy has to hear of it as well
        return self


@dataclass(eq=False)
class SampleAdapter:
    """`RandomUnderwater` on pictures and maps that are no tensors.

    Args:
        augment: what degrades them.
        unit: of the maps: "m", "cm", "mm", "um", or the metres that 1 stands for. In maps that are
            not metric, a number that scales them.
        seed: None draws from torch's generator, which a DataLoader seeds for each worker and epoch.
            With a number, draws depend on it, on the epoch and on the name of a picture alone.
    """

    augment: RandomUnderwater
    _: KW_ONLY
    unit: Unit = "m"
    seed: int | None = None
    _epoch: Epoch = field(default_factory=Epoch, init=False, repr=False)

    def __post_init__(self) -> None:
        checks.instance("augment", self.augment, RandomUnderwater)
        metres_of(self.unit)

    def set_epoch(self, epoch: int) -> None:
        """Say which pass through the data begins; for adapters that have a seed.

        Without it, every pass shows each picture in the same water. Workers of a DataLoader hear of
        it, as long as the adapter was not pickled on its way to them.
        """
        self._epoch.number.fill_(epoch)

    def _degraded(self, image: Any, distance: Any, name: int | str | None) -> Any:
        picture, restore = picture_of(image)
        z = None
        if distance is not None:
            z = map_of(distance, self.unit, metric=self.augment.distance_kind == "metric")
        generator = None
        if self.seed is not None:
            if name is None:
                raise ValueError("seed needs the name of each picture, got None for one")
            key = key_of(self.seed, int(self._epoch.number), name)
            generator = torch.Generator().manual_seed(key)
        record = self.augment.make_params(picture, generator)
        return restore(self.augment.transform(picture, z, record))

    def _key_of_map(self, sample: Mapping[str, Any], keys: str, what: str) -> str | None:
        """The key of a map; None where a sample has none and needs none."""
        if self.augment.distance is None:
            return first_of(
                sample, keys, what, "see distance_key, and RandomUnderwater(distance=…)"
            )
        return next((key for key in keys.split(";") if key in sample), None)


def first_of(sample: Mapping[str, Any], keys: str, what: str, cure: str) -> str:
    """The first of the keys, divided by ";", that a sample has."""
    for key in keys.split(";"):
        if key in sample:
            return key
    names = ", ".join(map(repr, sample))
    raise ValueError(f"{what} has no {keys!r}, only {names}: {cure}")
