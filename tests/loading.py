"""Datasets for the DataLoader tests, in a module of their own: a spawned worker imports what it is
sent by name.
"""

import json
from typing import Any

from torch import Tensor
from torch.utils.data import Dataset

from uwaug import RandomUnderwater

Crops = list[tuple[Tensor, Tensor]]
"""Of a scene: picture (3xHxW, 0…1) and distance (1xHxW, m)."""


class Pairs(Dataset[tuple[Tensor, Tensor, str]]):
    """For restoration: clean, degraded, and the record that leads from one to the other."""

    def __init__(self, crops: Crops, augment: RandomUnderwater) -> None:
        self.crops, self.augment = crops, augment

    def __len__(self) -> int:
        return len(self.crops)

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor, str]:
        clean, distance = self.crops[index]
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


class Recorded(Keyed):
    """For tables of what was drawn: the record itself, in a dict."""

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor, dict[str, Any]]:  # type: ignore[override]
        image, distance = self.crops[index]
        record = self.augment.make_params(image, self.augment.generator_of(0, self.epoch, index))
        wet = self.augment.transform(image, distance, record)
        return image, wet, {"record": record, "index": index}
