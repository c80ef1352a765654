"""The recipe of a run: its transform, and the options of files."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.codec import plain
from uwaug.distance.sources import Metres
from uwaug.files.pictures import Picture, metres_of, open_picture, read_distance, write_picture
from uwaug.files.table import Row
from uwaug.formation.colour import linear_to_srgb
from uwaug.transforms.draws import Record
from uwaug.transforms.random_underwater import RandomUnderwater

MAP_FORMATS = ("npy", "exr")  # float32, for light below 0 and above 1 and any distance


@plain
@dataclass(frozen=True)
class Recipe:
    """Transform and options of a run. All random numbers follow from it, the name of a picture and
    the number of a variant.

    Attributes:
        transform: transform that puts pictures under water.
        unit: unit of distances in files, see `read_distance`, where the transform takes metres.
        seed: seed of all random numbers.
        variants: number of variants of each picture.
        min_contrast: least contrast left of an object, 0…1, for its label to be kept.
        classes: file that names the classes of YOLO's labels, see `open_labels`.
        drift: drift of a film's field and snow, m a frame.
        motion: motion of its camera to the right, down and forward, m a frame.
        quality: quality of JPEG, 1…100.
        maps: format of maps of the truth (see `uwaug.transforms.truth.Truth`), "npy" or "exr".
    """

    transform: RandomUnderwater
    unit: str | float = "m"
    seed: int = 0
    variants: int = 1
    min_contrast: float | None = None
    classes: str | None = None
    drift: float = 0.004
    motion: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quality: float = 95
    maps: str | None = None

    def __post_init__(self) -> None:
        checks.instance("transform", self.transform, RandomUnderwater)
        metres_of(self.unit)
        if self.variants < 1:
            raise ValueError(f"variants must be 1 or more, got {self.variants}")
        if self.min_contrast is not None:
            checks.within("min_contrast", self.min_contrast, 0.0, 1.0)
        checks.within("drift", self.drift)
        object.__setattr__(self, "motion", checks.vector("motion", self.motion))
        checks.within("quality", self.quality, 1, 100)
        if self.maps is not None:
            checks.one_of("maps", self.maps, MAP_FORMATS)

    def at_contrast(self, left: float) -> "Recipe":
        """The same recipe with so much contrast left at the median distance of each picture."""
        water = replace(self.transform.water, contrast=left)
        return replace(self, transform=replace(self.transform, water=water))

    def drawn(self, name: str, variant: int) -> Record:
        """The draw of a picture: all its random numbers."""
        generator = self.transform.generator_of(self.seed, variant, name)
        return self.transform.make_params(torch.empty(3, 1, 1), generator)

    @cached_property
    def _in_light(self) -> RandomUnderwater:
        development = replace(self.transform.development, color_space="linear")
        return replace(self.transform, development=development)

    def transform_of(self, picture: Path) -> RandomUnderwater:
        """The transform in the colour space of a picture's file: an EXR holds linear light."""
        return self._in_light if picture.suffix.lower() == ".exr" else self.transform

    def read(self, row: Row) -> tuple[Picture, Tensor | None]:
        """The picture of a row, and its map (1xHxW) where it has one."""
        space = self.transform_of(row.picture).development.color_space
        return open_picture(row.picture, space), self.read_map(row)

    def write(self, path: Path, image: Tensor, picture: Path, exif: bytes) -> None:
        """Write the result (3xHxW) of the transform of a picture, with EXIF of its own."""
        default = self.transform.development.color_space
        space = self.transform_of(picture).development.color_space
        if space != default and path.suffix.lower() != ".exr":
            image, space = linear_to_srgb(image.clamp(0, 1)), default
        write_picture(path, image, self.quality, space, exif)

    def read_map(self, row: Row) -> Tensor | None:
        """The map (1xHxW) of a row, where it has one."""
        unit = self.unit if isinstance(self.transform.distance, Metres) else None
        return None if row.distance is None else read_distance(row.distance, unit)
