"""Datasets for the DataLoader tests, in a module of their own: a spawned worker imports what it is
sent by name.
"""

import json
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import Dataset, Sampler, default_collate

from uwaug import RandomUnderwater

SIZE = 48


class Crops(Dataset[tuple[Tensor, Tensor, int]]):
    """Crops of a scene: picture (3xSxS, 0…1), distance (1xSxS, m), and its number."""

    def __init__(self, image: Tensor, distance: Tensor, count: int = 16) -> None:
        generator = torch.Generator().manual_seed(0)
        height, width = image.shape[-2:]
        rows = torch.randint(height - SIZE, (count,), generator=generator).tolist()
        columns = torch.randint(width - SIZE, (count,), generator=generator).tolist()
        self.items = []
        for number, (y, x) in enumerate(zip(rows, columns, strict=True)):
            window = (slice(None), slice(y, y + SIZE), slice(x, x + SIZE))
            self.items.append((image[window].clone(), distance[window].clone(), number))

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor, int]:
        return self.items[index]


class Pairs(Dataset[tuple[Tensor, Tensor, str]]):
    """For restoration: clean, degraded, and the record that leads from one to the other."""

    def __init__(self, crops: Crops, augment: RandomUnderwater) -> None:
        self.crops, self.augment = crops, augment

    def __len__(self) -> int:
        return len(self.crops)

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor, str]:
        clean, distance, _ = self.crops[index]
        record = self.augment.make_params(clean)
        return clean, self.augment.transform(clean, distance, record), json.dumps(record)


class Keyed(Dataset[tuple[int, Tensor]]):
    """For studies that must repeat: water from (seed, epoch, name); the epoch may come from a
    sampler.
    """

    def __init__(self, crops: Crops, augment: RandomUnderwater) -> None:
        self.crops, self.augment, self.epoch = crops, augment, 0

    def __len__(self) -> int:
        return len(self.crops)

    def __getitem__(self, key: int | tuple[int, int]) -> tuple[int, Tensor]:
        epoch, index = key if isinstance(key, tuple) else (self.epoch, key)
        image, *_ = self.augment.at(0, epoch, f"crops/{index}.png")(self.crops[index])
        return index, image


class Epochs(Sampler[tuple[int, int]]):
    """Shuffled (epoch, index): what reaches workers that persist, which keep the dataset that they
    were started with.
    """

    def __init__(self, count: int) -> None:
        self.count, self.epoch = count, 0

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[tuple[int, int]]:
        pairs = [(self.epoch, index) for index in torch.randperm(self.count).tolist()]
        self.epoch += 1
        return iter(pairs)


class DegradeBatch:
    """A `collate_fn` that degrades whole batches."""

    def __init__(self, augment: RandomUnderwater) -> None:
        self.augment = augment

    def __call__(self, samples: list[Any]) -> Any:
        return self.augment(default_collate(samples))
