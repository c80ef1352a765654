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
    """Crops of a scene: picture (3xSxS, 0…1), distance (1xSxS, m), and whether the crop is
    bright.
    """

    def __init__(self, image: Tensor, distance: Tensor, count: int = 16) -> None:
        generator = torch.Generator().manual_seed(0)
        height, width = image.shape[-2:]
        rows = torch.randint(height - SIZE, (count,), generator=generator).tolist()
        columns = torch.randint(width - SIZE, (count,), generator=generator).tolist()
        pairs = []
        for y, x in zip(rows, columns, strict=True):
            window = (slice(None), slice(y, y + SIZE), slice(x, x + SIZE))
            pairs.append((image[window].clone(), distance[window].clone()))
        brightness = torch.stack([picture.mean() for picture, _ in pairs])
        bright = (brightness > brightness.median()).tolist()
        self.items = [(*pair, int(b)) for pair, b in zip(pairs, bright, strict=True)]

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor, int]:
        return self.items[index]


class Degraded(Dataset[tuple[Tensor, int]]):
    """For a classifier: every picture in a water of its own, new in every epoch."""

    def __init__(self, crops: Crops, augment: RandomUnderwater) -> None:
        self.crops, self.augment = crops, augment

    def __len__(self) -> int:
        return len(self.crops)

    def __getitem__(self, index: int) -> tuple[Tensor, int]:
        image, _, label = self.augment(self.crops[index])
        return image, label


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
    """For studies that must repeat: water from (seed, epoch, index)."""

    def __init__(self, crops: Crops, augment: RandomUnderwater) -> None:
        self.crops, self.augment, self.epoch = crops, augment, 0

    def __len__(self) -> int:
        return len(self.crops)

    def __getitem__(self, index: int) -> tuple[int, Tensor]:
        image, *_ = self.augment.at(0, self.epoch, index)(self.crops[index])
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
        order = torch.randperm(self.count).tolist()
        pairs = [(self.epoch, index) for index in order]
        self.epoch += 1
        return iter(pairs)


class KeyedByEpoch(Dataset[tuple[int, Tensor]]):
    """Water from (seed, epoch, name), the epoch from the sampler."""

    def __init__(self, crops: Crops, augment: RandomUnderwater) -> None:
        self.crops, self.augment = crops, augment

    def __getitem__(self, key: tuple[int, int]) -> tuple[int, Tensor]:
        epoch, index = key
        image, *_ = self.augment.at(0, epoch, f"crops/{index}.png")(self.crops[index])
        return index, image


class DegradeBatch:
    """A `collate_fn` that degrades whole batches."""

    def __init__(self, augment: RandomUnderwater) -> None:
        self.augment = augment

    def __call__(self, samples: list[Any]) -> Any:
        return self.augment(default_collate(samples))
