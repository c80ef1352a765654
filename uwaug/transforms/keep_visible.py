"""`KeepVisible`: targets of a detector that name only what can still be seen."""

import copy
from collections.abc import Callable, Collection, Mapping
from itertools import compress
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from uwaug._support import checks
from uwaug.labels.regions import box_region, mask_region, mean_over
from uwaug.transforms.random_underwater import RandomUnderwater
from uwaug.transforms.samples import SampleTransform, replaced, typed

_ALONG = ("boxes", "masks", "labels", "area", "iscrowd", "keypoints")
"""Entries of a target that must have a row for each object."""

_WHOLE = ("image_id", "size", "orig_size", "image_size")
"""Entries that are of the picture, however many objects there are."""

_CORNERS: dict[str, Callable[..., tuple[float, ...]]] = {
    "XYXY": lambda x1, y1, x2, y2: (x1, y1, x2, y2),
    "XYWH": lambda x, y, w, h: (x, y, x + w, y + h),
    "CXCYWH": lambda x, y, w, h: (x - w / 2, y - h / 2, x + w / 2, y + h / 2),
}
"""By torchvision's name of a format."""


class KeepVisible(SampleTransform):
    """A `RandomUnderwater` that takes objects which can no longer be seen out of the targets.

    It degrades as `augment` alone does, with the same draws, and finds for each object the mean of
    `uwaug.contrast` over its mask, or over its box if it has no mask. Put it in the place of
    `augment` in a pipeline, after `SanitizeBoundingBoxes`, which does not know "contrast".

    Args:
        augment: what degrades.
        min_contrast: objects with less are taken out, 0…1.
        flag: keep them, and set their "iscrowd" to 1: losses and scores leave those out.
        whole: names of entries that stay as they are, see below.

    Inputs:
        As for `augment`, one picture at a time. One dict holds the objects: the sample itself, or a
        dict directly in it, such as torchvision's target. It has "boxes" (Nx4) or "masks" (NxHxW)
        or both. Plain boxes are corners (x1, y1, x2, y2) in px; torchvision's `BoundingBoxes` say
        what they are.

    The same structure comes back. In a copy of that dict every tensor, array and list of length N
    has the rows of the objects that are left, so that no entry goes with another's object. "boxes",
    "masks", "labels", "area", "iscrowd" and "keypoints" must have that length. "contrast" (N,
    float32) is new; it is 0 of objects with no pixel in the picture. What is of the whole picture
    stays: "image_id", "size", "orig_size", "image_size", the picture and its distances, other maps
    of its height and width (unless "masks" is in their name), and what `whole` names. Name there
    what may have length N by chance.

    Raises:
        TypeError, ValueError: as `augment`; if there is no such dict, or more than one; if an entry
            has another number of rows, or the picture is a batch.

    Examples:
        >>> import torch
        >>> from uwaug import RandomUnderwater
        >>> keep = KeepVisible(RandomUnderwater("3C", contrast=None), min_contrast=0.05)
        >>> distance = torch.full((1, 32, 48), 1.0)
        >>> distance[..., 24:] = 12.0
        >>> boxes = torch.tensor([[2.0, 2.0, 20.0, 20.0], [26.0, 2.0, 46.0, 20.0]])
        >>> target = {"boxes": boxes, "labels": torch.tensor([7, 8])}
        >>> image, distance, target = keep(torch.rand(3, 32, 48), distance, target)
        >>> target["labels"]
        tensor([7])
    """

    def __init__(
        self,
        augment: RandomUnderwater,
        min_contrast: float = 0.05,
        *,
        flag: bool = False,
        whole: Collection[str] = (),
    ) -> None:
        super().__init__()
        checks.instance("augment", augment, RandomUnderwater)
        checks.within("min_contrast", min_contrast, 0.0, 1.0)
        self.augment = augment
        self.min_contrast = min_contrast
        self.flag = flag
        if isinstance(whole, str):
            raise TypeError(f"whole must be names, such as ({whole!r},), got a string")
        self.whole = tuple(whole)

    def _sampled(self, inputs: tuple[Any, ...], generator: torch.Generator | None) -> Any:
        image, distance, restore = self.augment.take_apart(inputs)
        if image.ndim != 3:
            got = f"a batch {tuple(image.shape)}"
            raise ValueError(f"KeepVisible takes one picture (3, H, W) at a time, got {got}")
        record = self.augment.make_params(image, generator)
        degraded = self.augment.in_water(
            image, distance, record, lambda wet: (wet.picture(), wet.scene.contrast())
        )
        contrast = np.ones(image.shape[-2:], np.float32)
        if degraded:
            picture, contrast_map = degraded[0]
            image, contrast = typed(picture, type(image)), contrast_map[0].float().cpu().numpy()
        return self._without_unseen(restore(image), contrast)

    def _without_unseen(self, sample: Any, contrast: NDArray[Any]) -> Any:
        """A sample with the objects that can still be seen, by a map of contrast (HxW)."""
        if _has_objects(sample):
            return self._kept(sample, contrast)
        members = dict(sample) if isinstance(sample, Mapping) else {}
        if isinstance(sample, (tuple, list)):
            members = dict(enumerate(sample))
        places = [place for place, member in members.items() if _has_objects(member)]
        if len(places) != 1:
            expected = "one dict with 'boxes' or 'masks', the sample or directly in it"
            cure = "without any, use augment alone"
            raise ValueError(f"expected {expected}; found {len(places)}: {cure}")
        (place,) = places
        return replaced(sample, place, self._kept(members[place], contrast))

    def _kept(self, target: Mapping[str, Any], contrast: NDArray[Any]) -> Any:
        """A copy of a target, of what a map of contrast (HxW) leaves."""
        visible = _contrast_of_objects(target, contrast)
        for name in _ALONG:
            if name in target and len(target[name]) != len(visible):
                got = f"target[{name!r}] has {len(target[name])} rows for {len(visible)} objects"
                raise ValueError(f"{got}: expected one each")
        changed: Any = copy.copy(target)
        keep = visible >= self.min_contrast
        changed["contrast"] = visible
        if self.flag:
            crowd = torch.as_tensor(
                target.get("iscrowd", torch.zeros(len(visible), dtype=torch.int64))
            )
            changed["iscrowd"] = torch.where(keep.to(crowd.device), crowd, 1)
            return changed
        for name, value in changed.items():
            if name in _ALONG or self._has_rows(name, value, len(visible), contrast.shape):
                changed[name] = _rows(value, keep)
        return changed

    def _has_rows(self, name: Any, value: Any, count: int, size: tuple[int, ...]) -> bool:
        """Whether an entry of a target has a row for each of `count` objects."""
        of_picture = (*_WHOLE, *self.whole, self.augment.image_key, self.augment.distance_key)
        if name in of_picture or not isinstance(value, (Tensor, np.ndarray, list)):
            return False
        if isinstance(value, list):
            return len(value) == count
        is_map = size in (tuple(value.shape[-2:]), tuple(value.shape[:2]))
        if is_map and "masks" not in str(name):
            return False
        return value.ndim > 0 and len(value) == count

    def extra_repr(self) -> str:
        """What `repr` shows besides `augment`."""
        whole = f", whole={self.whole}" if self.whole else ""
        return f"min_contrast={self.min_contrast}" + ", flag=True" * self.flag + whole


def _has_objects(value: Any) -> bool:
    return isinstance(value, Mapping) and ("boxes" in value or "masks" in value)


def _contrast_of_objects(target: Mapping[str, Any], contrast: NDArray[Any]) -> Tensor:
    """The contrast of each object, (N)."""
    if "masks" in target:
        masks = np.asarray(torch.as_tensor(target["masks"]).cpu()) != 0
        if masks.ndim != 3 or masks.shape[1:] != contrast.shape:
            got = f"target['masks'] is {masks.shape}"
            raise ValueError(f"{got}: expected (N, {contrast.shape[0]}, {contrast.shape[1]})")
        regions = [mask_region(mask) for mask in masks]
    else:
        corners = _corners(target["boxes"], contrast.shape)
        regions = [box_region(box, contrast.shape) for box in corners]
    return torch.tensor([mean_over(contrast, region) for region in regions], dtype=torch.float32)


def _corners(boxes: Any, size: tuple[int, ...]) -> list[tuple[float, ...]]:
    """(x1, y1, x2, y2) of each box, px."""
    layout = getattr(boxes, "format", "XYXY")
    name = getattr(layout, "name", layout)
    if name not in _CORNERS:
        cure = "convert them with torchvision's ConvertBoundingBoxFormat first"
        raise ValueError(f"boxes must be {', '.join(_CORNERS)}, got {name}: {cure}")
    canvas = tuple(getattr(boxes, "canvas_size", size))
    if canvas != tuple(size):
        raise ValueError(f"boxes are of a picture of {canvas}, but image is {tuple(size)}")
    rows = torch.as_tensor(boxes).reshape(-1, 4).tolist()
    return [_CORNERS[name](*row) for row in rows]


def _rows(value: Any, keep: Tensor) -> Any:
    """Some rows of a tensor (of its own class), an array or a list."""
    if not isinstance(value, Tensor):
        chosen = compress(value, keep.tolist())
        return value[keep.numpy()] if isinstance(value, np.ndarray) else type(value)(chosen)
    rows = typed(value, Tensor)[keep.to(value.device)]
    if type(value) is not Tensor:
        rows = typed(rows, type(value))
        # torchvision's boxes carry their format with them
        rows.__dict__.update(value.__dict__)
    return rows
