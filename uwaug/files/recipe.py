"""What is done to every picture of a run."""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.codec import plain
from uwaug.distance.sources import Metres
from uwaug.files.items import Item
from uwaug.files.pictures import metres_of, read_distance, read_picture, write_picture
from uwaug.transforms.draws import Record
from uwaug.transforms.random_underwater import RandomUnderwater
from uwaug.transforms.samples import key_of


@plain
@dataclass(frozen=True)
class Recipe:
    """What is done to every picture of a run. With the name of a picture and the number of a
    variant, all that is random follows from it.

    Attributes:
        transform: what puts pictures under water.
        unit: of distances in files, see `read_distance`, where the transform takes metres.
        seed: of all that is random.
        variants: of each picture.
        labels: a file or a folder of labels, see `open_labels`; None for none.
        min_contrast: labels of objects of which less contrast is left, 0…1, are left out; None
            keeps all.
        sequence: whether the pictures of a folder are frames of one film, in the order of their
            names: one draw for all, settled on one of them (see `RandomUnderwater.for_clip`).
        drift: m by which the field of a sequence drifts from frame to frame; .004 is .1 m/s at 25
            frames a second.
        quality: of pictures that are written as JPEG, 1…100.

    Raises:
        TypeError, ValueError: if a value does not suit.
    """

    transform: RandomUnderwater
    unit: str | float = "m"
    seed: int = 0
    variants: int = 1
    labels: str | None = None
    min_contrast: float | None = None
    sequence: bool = False
    drift: float = 0.004
    quality: float = 95

    def __post_init__(self) -> None:
        checks.instance("transform", self.transform, RandomUnderwater)
        metres_of(self.unit)
        if self.variants < 1:
            raise ValueError(f"variants must be 1 or more, got {self.variants}")
        if self.min_contrast is not None:
            checks.within("min_contrast", self.min_contrast, 0.0, 1.0)
        checks.within("drift", self.drift)
        checks.within("quality", self.quality, 1, 100)

    def drawn(self, name: str, variant: int) -> Record:
        """All that is random about a picture."""
        generator = torch.Generator().manual_seed(key_of(self.seed, variant, name))
        return self.transform.make_params(torch.empty(3, 1, 1), generator)

    def read(self, item: Item) -> tuple[Tensor, Tensor | None]:
        """The picture (3xHxW) of an item, and its map (1xHxW) where it has one."""
        color_space = self.transform.development.color_space
        return read_picture(item.picture, color_space), self.read_map(item)

    def write(self, path: Path, image: Tensor) -> None:
        """Write a picture as those that were read are."""
        write_picture(path, image, self.quality, self.transform.development.color_space)

    def read_map(self, item: Item) -> Tensor | None:
        """The map alone."""
        unit = self.unit if isinstance(self.transform.distance, Metres) else None
        return None if item.distance is None else read_distance(item.distance, unit)
