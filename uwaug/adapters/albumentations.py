"""`RandomUnderwater` for Albumentations 2.x."""

import os
from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.extras import install
from uwaug.adapters.conversion import map_of, picture_of
from uwaug.io.distances import Unit, metres_of, read_distance
from uwaug.transforms.codec import encode_options
from uwaug.transforms.params import Record
from uwaug.transforms.random_underwater import RandomUnderwater

try:
    from albumentations import ImageOnlyTransform
except ImportError as missing:
    raise ImportError(f"{missing.name} is missing: {install('adapters')}") from missing


class AlbumentationsUnderwater(ImageOnlyTransform):  # type: ignore[misc]
    """Degrade pictures in an Albumentations pipeline.

    Args:
        augment: a `RandomUnderwater`; or its options, as a dict. Its own `p` has to be 1.
        distance_key: the name under which a call passes the map: an array (HxW), or the path of a
            file that `uwaug.io.read_distance` reads. An array in a pipeline has to be in its
            `additional_targets={"distance": "mask"}`, so that it moves with the picture, or it is
            refused. Not needed where `augment` has a `distance`.
        lookup: a function that finds the map (or its path) where a call passes none; it gets all
            that the call passed, as a dict. Neither flips nor crops move what it finds, and what is
            in files: such transforms belong behind this one.
        unit: of the map: "m", "cm", "mm", "um", or the metres that 1 stands for.
        channels: the order of the picture's colours. "bgr" is what OpenCV reads and Ultralytics
            passes on.
        p: probability, as in all transforms of Albumentations.

    Targets:
        image, and others of its kind (`additional_targets`, `images`), in the same water at the
        same distances. Masks, boxes and keypoints are returned as they are.

    Image types:
        uint8 (0…255), float32 (0…1); HxWx3.

    Randomness comes from the pipeline: `A.Compose(…, seed=…)`. Albumentations 2.0 draws the same in
    all workers of a DataLoader and in all epochs, whatever the transforms: call
    `pipeline.set_random_seed(torch.initial_seed())` in a `worker_init_fn`.

    What was drawn is a record, under "record" in the "replay" of `A.ReplayCompose` and in
    "applied_transforms". A replay is the same bit for bit, and takes the map that it is given.
    `A.to_dict` writes options that JSON can hold, and own waters, cameras, width laws and
    `DepthNetwork`s besides; no other functions. Reading them needs this module imported.

    Raises:
        TypeError, ValueError: if an option, a picture or a map does not suit, or a map is missing;
            names what came and what was expected.

    Examples:
        >>> import albumentations as A, numpy as np, uwaug
        >>> water = AlbumentationsUnderwater(uwaug.RandomUnderwater(["II", "7C"]), p=1.0)
        >>> targets = {"distance": "mask"}
        >>> pipeline = A.Compose([A.HorizontalFlip(), water], additional_targets=targets, seed=0)
        >>> image, distance = np.full((32, 48, 3), 200, np.uint8), np.full((32, 48), 3.0)
        >>> pipeline(image=image, distance=distance)["image"].shape
        (32, 48, 3)
    """

    def __init__(
        self,
        augment: RandomUnderwater | Mapping[str, Any] | None = None,
        *,
        distance_key: str = "distance",
        lookup: Callable[[dict[str, Any]], Any] | None = None,
        unit: Unit = "m",
        channels: Literal["rgb", "bgr"] = "rgb",
        p: float = 0.5,
    ) -> None:
        checks.within("p", p, 0.0, 1.0)
        super().__init__(p=p)
        if augment is None or isinstance(augment, Mapping):
            augment = RandomUnderwater.from_dict(augment or {})
        checks.instance("augment", augment, RandomUnderwater)
        if augment.p != 1:
            raise ValueError(f"augment.p must be 1, got {augment.p}: give p to the adapter instead")
        checks.one_of("channels", channels, ("rgb", "bgr"))
        metres_of(unit)
        self.augment = augment
        self.distance_key = distance_key
        self.lookup = lookup
        self.unit = unit
        self.channels = channels
        self._in_pipeline = False
        self._moved = {"mask"}  # what a pipeline moves with the picture

    def add_targets(self, additional_targets: dict[str, str]) -> None:
        """Hear of the arrays that a pipeline moves with the picture."""
        super().add_targets(additional_targets)
        self._moved |= set(additional_targets)

    def set_processors(self, processors: dict[str, Any]) -> None:
        """Hear that there is a pipeline: each calls this of all its transforms."""
        super().set_processors(processors)
        self._in_pipeline = True

    def get_params(self) -> dict[str, Any]:
        """What is random: a record, see `RandomUnderwater.make_params`."""
        key = int(self.random_generator.integers(2**32))
        generator = torch.Generator().manual_seed(key)
        return {"record": self.augment.make_params(torch.empty(3, 1, 1), generator)}

    def apply_with_params(
        self, params: dict[str, Any], *args: Any, **kwargs: Any
    ) -> dict[str, Any]:
        """Degrade what a call passed, as a record says."""
        # the map is found here: Albumentations shows a picture no other target, and as a parameter
        # it would be kept for replays, which may be of another picture
        params = {**params, "distance": self._distance(kwargs)}
        result: dict[str, Any] = super().apply_with_params(params, *args, **kwargs)
        return result

    def _distance(self, passed: dict[str, Any]) -> Tensor | None:
        """The map of a call, 1xHxW in metres."""
        distance, key = passed.get(self.distance_key), self.distance_key
        is_file = isinstance(distance, (str, os.PathLike))
        if distance is not None and not is_file and self._in_pipeline:
            cure = f"give A.Compose(…, additional_targets={{{key!r}: 'mask'}})"
            if key not in self._moved:
                got = f"{key} is no target of the pipeline, so flips and crops leave it where it is"
                raise ValueError(f"{got}: {cure}")
            if key in self._key2func:
                raise ValueError(f"{key} is a picture to the pipeline, which changes it: {cure}")
        if distance is None and self.lookup is not None:
            distance = self.lookup(passed)
        if distance is None:
            if self.augment.distance is not None:
                return None
            got = ", ".join(map(repr, passed))
            cure = "pass it, or give lookup=… or RandomUnderwater(distance=…)"
            raise ValueError(f"there is no {key!r}, only {got}: {cure}")
        if isinstance(distance, (str, os.PathLike)):
            return read_distance(distance, self.unit)
        return map_of(distance, self.unit, metric=self.augment.distance_kind == "metric")

    def apply(
        self, img: np.ndarray[Any, Any], record: Record, distance: Tensor | None, **params: Any
    ) -> np.ndarray[Any, Any]:
        """One picture with water."""
        backwards = self.channels == "bgr"
        picture, restore = picture_of(img[..., ::-1] if backwards else img)
        result = restore(self.augment.transform(picture, distance, record))
        return np.ascontiguousarray(result[..., ::-1] if backwards else result)

    def get_transform_init_args(self) -> dict[str, Any]:
        """The options, as they are."""
        names = ("augment", "distance_key", "lookup", "unit", "channels")
        return {name: getattr(self, name) for name in names}

    def to_dict_private(self) -> dict[str, Any]:
        """The options, as JSON holds them."""
        state: dict[str, Any] = super().to_dict_private()
        return encode_options({**state, "augment": self.augment.to_dict()})
