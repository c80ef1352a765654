"""`KeepVisible`: targets of a detector that name only what can still be seen."""

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.pixels import of_box, of_polygons
from uwaug.transforms.random_underwater import RandomUnderwater
from uwaug.transforms.samples import SampleTransform, pictures_of, replaced, take_apart, typed


@dataclass(eq=False, repr=False)
class KeepVisible(SampleTransform):
    """Degrade pictures as `augment` does, and take objects that can no longer be seen out of the
    targets.

    An object's contrast is the mean of `uwaug.contrast_left` over its mask, or else over its box.
    Put it after `SanitizeBoundingBoxes`, which does not know "contrast".

    Args:
        augment: the `RandomUnderwater` that degrades pictures.
        min_contrast: contrast below which objects are taken out, 0…1.
        flag: keep them, and set their "iscrowd" to 1: losses and scores leave those out.
        along: names of the entries that have a row for each object.
        apart: names of the entries that belong to the picture, whatever their length.

    Inputs:
        As for `augment`, one picture at a time. One dict, the sample or directly in it, holds the
        objects: "boxes" (Nx4) or "masks" (NxHxW) or both. Plain boxes are corners (x1, y1, x2, y2)
        in px, all four (Nx8) of boxes that are turned; torchvision's `BoundingBoxes` say what they
        are. The same structure comes back, with the rows that are left in a copy of that dict, and
        "contrast" (N, float32), 0 of objects with no pixel in the picture.

    Raises:
        ValueError: if there is not one such dict; if an entry has another number of rows, or as
            many and no name here; if boxes are no corners in px.

    Examples:
        >>> import torch
        >>> from uwaug import RandomUnderwater, RandomWater
        >>> augment = RandomUnderwater(RandomWater("3C", contrast=None))
        >>> keep = KeepVisible(augment, min_contrast=0.05)
        >>> distance = torch.full((1, 32, 48), 1.0)
        >>> distance[..., 32:] = 12.0
        >>> boxes = torch.tensor([[2.0, 2.0, 20.0, 20.0], [34.0, 2.0, 46.0, 20.0]])
        >>> target = {"boxes": boxes, "labels": torch.tensor([7, 8])}
        >>> image, distance, target = keep(torch.rand(3, 32, 48), distance, target)
        >>> target["labels"]
        tensor([7])
    """

    augment: RandomUnderwater
    min_contrast: float = 0.05
    flag: bool = False
    along: tuple[str, ...] = ("boxes", "masks", "labels", "area", "iscrowd", "keypoints")
    apart: tuple[str, ...] = ("image_id", "size", "orig_size")

    def __post_init__(self) -> None:
        checks.instance("augment", self.augment, RandomUnderwater)
        checks.within("min_contrast", self.min_contrast, 0.0, 1.0)

    def _sampled(self, inputs: tuple[Any, ...], generator: Any) -> Any:
        options = self.augment.keys, self.augment.distance.reads_maps
        image, distance, restore = take_apart(inputs, *options)
        pictures_of(image)  # refuses what is no image
        if image.ndim != 3:
            raise ValueError(f"image must be one picture (3, H, W), got {tuple(image.shape)}")
        scenes = self.augment.scenes(image, distance, self.augment.make_params(image, generator))
        sample = restore(scenes.formed())
        contrast_map = scenes.contrast_map()[0].detach()
        if _has_objects(sample):
            return self._visible(sample, contrast_map)
        members = dict(enumerate(sample)) if isinstance(sample, (tuple, list)) else dict(sample)
        places = [place for place, member in members.items() if _has_objects(member)]
        if len(places) != 1:
            counted = f"found {len(places)}"
            raise ValueError(f"expected one dict with 'boxes' or 'masks' in the sample, {counted}")
        return replaced(sample, places[0], self._visible(members[places[0]], contrast_map))

    def _visible(self, target: Mapping[str, Any], contrast_map: Tensor) -> Any:
        contrast = _means(target, contrast_map).float().cpu()
        keep = contrast >= self.min_contrast
        changed: Any = copy.copy(target)
        if self.flag:
            changed["contrast"] = contrast
            crowd = torch.as_tensor(target.get("iscrowd", torch.zeros_like(contrast).long()))
            changed["iscrowd"] = torch.where(keep.to(crowd.device), crowd, 1)
            return changed
        names = {*self.along, *self.apart, *self.augment.keys}
        for name, value in target.items():
            has_rows = isinstance(value, (np.ndarray, list, tuple))
            has_rows |= isinstance(value, Tensor) and value.ndim > 0
            count = len(value) if has_rows else None
            if name in self.along:
                if count != len(keep):
                    raise ValueError(f"target[{name!r}] has {count} rows for {len(keep)} objects")
                changed[name] = _rows(value, keep)
            elif name not in names and count == len(keep) and not bool(keep.all()):
                got = f"target[{name!r}] seems to have a row for each object"
                raise ValueError(f"{got}: name it in along=…, or in apart=… if it has not")
        changed["contrast"] = contrast[keep]
        return changed

    def extra_repr(self) -> str:
        """Options that `repr` shows besides `augment`."""
        return f"min_contrast={self.min_contrast}, flag={self.flag}"


def _has_objects(value: Any) -> bool:
    return isinstance(value, Mapping) and ("boxes" in value or "masks" in value)


def _means(target: Mapping[str, Any], contrast_map: Tensor) -> Tensor:
    """Mean of a map (HxW) over each object, (N); 0 for one without pixels."""
    if "masks" in target:
        masks = typed(torch.as_tensor(target["masks"]), Tensor).to(contrast_map.device) != 0
        if masks.shape[1:] != contrast_map.shape:
            height, width = contrast_map.shape
            expected = f"target['masks'] must be (N, {height}, {width})"
            raise ValueError(f"{expected}, got {tuple(masks.shape)}")
        return (masks * contrast_map).sum((-2, -1)) / masks.sum((-2, -1)).clamp(min=1)
    boxes = target["boxes"]
    if np.ndim(boxes) > 1 and np.shape(boxes)[-1] not in (0, 4, 8):
        raise ValueError(f"target['boxes'] must be (N, 4) or (N, 8), got {tuple(np.shape(boxes))}")
    size: tuple[int, int] = (contrast_map.shape[0], contrast_map.shape[1])
    if np.shape(boxes)[1:] == (8,):
        polygons = typed(torch.as_tensor(boxes), Tensor).tolist()
        parts = [contrast_map[of_polygons([polygon], size)] for polygon in polygons]
        return torch.tensor([float(part.mean()) if part.numel() else 0.0 for part in parts])
    if hasattr(boxes, "format"):  # torchvision's
        from torchvision.transforms.v2.functional import convert_bounding_box_format

        boxes = convert_bounding_box_format(boxes, new_format="XYXY")
    corners = torch.as_tensor(boxes).reshape(-1, 4)
    if bool((corners[:, 2:] < corners[:, :2]).any()):
        cure = "give corners in px, or torchvision's BoundingBoxes"
        raise ValueError(f"target['boxes'] end before they begin: {cure}")
    if len(corners) and 0 < float(corners.max()) <= 1 < max(contrast_map.shape):
        raise ValueError("target['boxes'] lie in 0…1: multiply by width and height, to px")
    return means_over(corners.tolist(), contrast_map)


def means_over(boxes: Iterable[Sequence[float]], contrast_map: Tensor) -> Tensor:
    """Mean of a map (HxW) over each box (x1, y1, x2, y2, px); 0 for one without pixels."""
    means, size = [], (contrast_map.shape[0], contrast_map.shape[1])
    for x1, y1, x2, y2 in boxes:
        part = contrast_map[of_box(x1, y1, x2, y2, size)]
        means.append(float(part.mean()) if part.numel() and x1 < x2 and y1 < y2 else 0.0)
    return torch.tensor(means)


def _rows(value: Any, keep: Tensor) -> Any:
    if isinstance(value, np.ndarray):
        return value[keep.numpy()]
    if not isinstance(value, Tensor):
        return type(value)(compress(value, keep.tolist()))
    rows = typed(value, Tensor)[keep.to(value.device)]
    if type(value) is not Tensor:
        rows = typed(rows, type(value))
        rows.__dict__.update(value.__dict__)  # torchvision's boxes carry their format with them
    return rows
