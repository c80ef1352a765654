"""Datasets for the DataLoader tests, in a module of their own: a spawned worker imports what it is
sent by name.
"""

import json

import torch
from torch import Tensor
from torch.utils.data import Dataset

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
    """For studies that must repeat: water from (seed, epoch, name)."""

    def __init__(self, crops: Crops, augment: RandomUnderwater) -> None:
        self.crops, self.augment, self.epoch = crops, augment, 0

    def __len__(self) -> int:
        return len(self.crops)

    def __getitem__(self, index: int) -> tuple[int, Tensor]:
        image, *_ = self.augment.at(0, self.epoch, f"crops/{index}.png")(self.crops[index])
        return index, image
