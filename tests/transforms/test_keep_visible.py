"""`KeepVisible`: the objects of a sample that can still be seen."""

import copy
import pickle
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from augmenting import same
from torch import Tensor

from uwaug import KeepVisible, RandomUnderwater, RandomWater
from uwaug.distance import Network

H, W = 40, 60
NEAR, FAR, BOTH = [4.0, 5.0, 24.0, 30.0], [34.0, 2.0, 58.0, 38.0], [20.0, 10.0, 40.0, 30.0]
AUGMENT = RandomUnderwater(RandomWater("3C", contrast=None, field=None))
KEEP = KeepVisible(AUGMENT, 0.05)
IMAGE = torch.rand(3, H, W, generator=torch.Generator().manual_seed(1))
# near on the left, far on the right
DISTANCE = torch.where(torch.arange(W) < W // 2, 0.8, 9.0).expand(1, H, W).contiguous()


def target(boxes: Any = (NEAR, FAR, BOTH), **entries: Any) -> dict[str, Any]:
    rows = torch.as_tensor(boxes).reshape(len(boxes), -1 if len(boxes) else 4)
    numbers = {"labels": torch.arange(10, 10 + len(rows)), "area": torch.ones(len(rows))}
    return {"boxes": rows, **numbers, "image_id": torch.tensor([3]), **entries}


def filled(box: list[float]) -> Tensor:
    """Mask of a box."""
    x1, y1, x2, y2 = map(int, box)
    mask = torch.zeros(H, W, dtype=torch.uint8)
    mask[y1:y2, x1:x2] = 1
    return mask


def test_what_is_far_is_taken_out_and_what_was_given_stays() -> None:
    given = target()
    before = copy.deepcopy(given)
    _, z, seen = KEEP(IMAGE, DISTANCE, given)
    assert seen["boxes"].tolist() == [NEAR, BOTH]
    assert (seen["labels"].tolist(), seen["area"].tolist()) == ([10, 12], [1, 1])
    assert seen["image_id"] is given["image_id"]
    assert (seen["contrast"] >= 0.05).all()
    assert given.keys() == before.keys()
    assert torch.equal(given["boxes"], before["boxes"])
    assert torch.equal(z, DISTANCE)


@pytest.mark.parametrize("by", ["boxes", "masks"])
def test_the_contrast_is_the_mean_of_the_picture(by: str) -> None:
    aug = RandomUnderwater(RandomWater("3C", contrast=None, field=(0.5, 2.0)))
    torch.manual_seed(3)
    record = aug.make_params(IMAGE)
    left = aug.contrast_left(IMAGE, DISTANCE, record)
    masks = torch.stack([filled(box) for box in (NEAR, FAR, BOTH)])
    given = target(masks=masks) if by == "masks" else target()
    torch.manual_seed(3)
    degraded, _, seen = KeepVisible(aug, 0.0)(IMAGE, DISTANCE, given)
    assert same(degraded, aug.transform(IMAGE, DISTANCE, record))
    wanted = [float(left[0][mask > 0].mean()) for mask in masks]
    assert seen["contrast"].tolist() == pytest.approx(wanted, abs=1e-5)


def test_a_box_has_all_pixels_that_it_touches() -> None:
    middle = W // 2
    touched, whole = [middle - 1, 9.5, middle + 0.5, 10.5], [middle - 1.0, 9, middle + 1, 11]
    *_, seen = KeepVisible(AUGMENT, 0.0)(IMAGE, DISTANCE, target((touched, whole)))
    ours, theirs = seen["contrast"].tolist()
    assert ours == theirs


def test_distances_are_found_once() -> None:
    calls = []

    def network(image: Tensor) -> Tensor:
        calls.append(image)
        return image.mean(-3, keepdim=True)

    KeepVisible(RandomUnderwater("3C", distance=Network(network)))(IMAGE, target())
    assert len(calls) == 1


# the first is far, whatever its box says
MASKS = torch.stack([filled([50, 5, 55, 10]), filled([2, 5, 6, 10]), torch.zeros(H, W)])
TURNED = torch.tensor([[14.0, 5, 24, 20, 14, 35, 4, 20], [46, 2, 58, 20, 46, 38, 34, 20]])
OUTSIDE = [[-30.0, -30.0, -5.0, -5.0], [3.0, 3.0, 3.0, 9.0], [-9.0, -9.0, 6.0, 6.0]]
LISTS = {"labels": ["a", "b", "c"], "iscrowd": np.array([0, 0, 1])}
ROWS = {"track": [5, 6, 7], "other": torch.arange(3)}
BY_NAME = {"along": ("boxes", "track"), "apart": ("image_id", "other", "labels", "area")}
KEPT: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = {
    # options, entries, and those that are left
    "masks": ({}, {"masks": MASKS}, {"labels": [11], "masks": MASKS[1:2].tolist()}),
    "turned boxes": ({}, target(TURNED), {"labels": [10], "boxes": TURNED[:1].tolist()}),
    "none": ({}, target([]), {"labels": [], "boxes": [], "contrast": []}),
    "outside of the picture": ({}, target(OUTSIDE), {"labels": [12]}),
    "lists and arrays": ({}, LISTS, {"labels": ["a", "c"], "iscrowd": [0, 1]}),
    "flags": ({"flag": True}, {}, {"iscrowd": [0, 1, 0], "labels": [10, 11, 12]}),
    "flags of crowds": ({"flag": True}, {"iscrowd": [1, 0, 0]}, {"iscrowd": [1, 1, 0]}),
    "rows by name": (BY_NAME, ROWS, {"track": [5, 7], "other": [0, 1, 2], "labels": [10, 11, 12]}),
    "nothing dropped": ({"min_contrast": 0.0}, ROWS, {"track": [5, 6, 7]}),
}


@pytest.mark.parametrize("name", KEPT)
def test_what_is_left_of_targets(name: str) -> None:
    options, entries, expected = KEPT[name]
    *_, seen = KeepVisible(AUGMENT, **options)(IMAGE, DISTANCE, target() | entries)
    for key, value in expected.items():
        assert (seen[key] if isinstance(seen[key], list) else seen[key].tolist()) == value


def test_the_draws_are_those_of_the_augmentation_alone() -> None:
    aug = RandomUnderwater(p=0.5)
    keep = pickle.loads(pickle.dumps(KeepVisible(aug)))
    for seed in range(4):
        torch.manual_seed(seed)
        degraded, *_ = keep(IMAGE, DISTANCE, target())
        torch.manual_seed(seed)
        assert same(degraded, aug(IMAGE, DISTANCE)[0])
        keyed = keep.at(1, 2, f"{seed}.png")(IMAGE, DISTANCE, target())
        assert same(keyed[0], aug.at(1, 2, f"{seed}.png")(IMAGE, DISTANCE)[0])


def test_a_picture_left_alone_keeps_everything() -> None:
    aug = RandomUnderwater(p=0.0)
    degraded, _, seen = KeepVisible(aug, 1.0)(IMAGE, DISTANCE, target())
    assert degraded is IMAGE
    left = aug.contrast_left(IMAGE, DISTANCE, aug.make_params(IMAGE))
    assert torch.equal(left, torch.ones(1, H, W))
    assert seen["contrast"].tolist() == [1, 1, 1]


class Sample(NamedTuple):
    image: Tensor
    distance: Tensor
    target: dict[str, Any]


def test_structures() -> None:
    named = {"image": IMAGE, "distance": DISTANCE}
    assert KEEP({**named, **target()})["labels"].tolist() == [10, 12]
    nested = KEEP({**named, "objects": target(), "id": "a"})
    assert (nested["objects"]["labels"].tolist(), nested["id"]) == ([10, 12], "a")
    assert KEEP(IMAGE, target(distance=DISTANCE))[1]["labels"].tolist() == [10, 12]
    for sample in (Sample(IMAGE, DISTANCE, target()), [IMAGE, DISTANCE, target()]):
        seen = KEEP(sample)
        assert type(seen) is type(sample)
        assert seen[2]["labels"].tolist() == [10, 12]


@pytest.mark.parametrize("form", ["XYXY", "XYWH", "CXCYWH"])
def test_tv_tensors_in_a_pipeline(torchvision: Any, form: str) -> None:
    v2, tv = torchvision.transforms.v2, torchvision.tv_tensors
    converted = v2.functional.convert_bounding_box_format
    corners = tv.BoundingBoxes([NEAR, FAR, BOTH], format="XYXY", canvas_size=(H, W))
    boxes = converted(corners, new_format=form)
    given = {"boxes": boxes, "labels": torch.tensor([1, 2, 3]), "distance": tv.Mask(DISTANCE)}
    pipeline = v2.Compose([v2.RandomHorizontalFlip(1.0), v2.SanitizeBoundingBoxes(), KEEP])
    degraded, seen = pipeline(tv.Image(IMAGE), given)
    assert (type(degraded), type(seen["boxes"])) == (tv.Image, tv.BoundingBoxes)
    assert (seen["boxes"].format.name, seen["boxes"].canvas_size) == (form, (H, W))
    assert seen["labels"].tolist() == [1, 3]
    back = converted(seen["boxes"], new_format="XYXY")
    assert back[0].tolist() == [W - NEAR[2], NEAR[1], W - NEAR[0], NEAR[3]]
    masks = tv.Mask(torch.stack([filled(NEAR), filled(FAR), filled(NEAR)]))
    masked = KEEP(tv.Image(IMAGE), given | {"masks": masks})[1]
    assert (type(masked["masks"]), masked["labels"].tolist()) == (tv.Mask, [1, 3])


def kept(**entries: Any) -> Callable[[], Any]:
    return lambda: KEEP(IMAGE, DISTANCE, target() | entries)


REFUSED: list[tuple[Callable[[], Any], str]] = [
    (kept(labels=torch.arange(2)), r"target\['labels'\] has 2 rows for 3 objects"),
    (kept(boxes=torch.tensor([[20.0, 5.0, 9.0, 30.0]] * 3)), r"\['boxes'\] end before they begin"),
    (kept(boxes=torch.tensor([[0.1, 0.2, 0.5, 1.0]] * 3)), r"\['boxes'\] lie in 0…1"),
    (kept(boxes=torch.rand(3, 5)), r"be \(N, 4\) or \(N, 8\), got \(3, 5\)"),
    (kept(track=[1, 2, 3]), r"target\['track'\] seems to have a row for each object"),
    (kept(masks=torch.ones(3, 4, 5)), r"\['masks'\] must be \(N, 40, 60\), got \(3, 4, 5\)"),
    (lambda: KEEP(IMAGE, DISTANCE), "found 0"),
    (lambda: KEEP(IMAGE, DISTANCE, target(), target()), "found 2"),
    (lambda: KEEP(IMAGE[None], DISTANCE, target()), r"image must be one picture \(3, H, W\)"),
    (lambda: KeepVisible(0.05), r"augment must be a uwaug\.RandomUnderwater"),  # type: ignore[arg-type]
    (lambda: KeepVisible(AUGMENT, 5), r"min_contrast must be in \[0, 1\]"),
]


@pytest.mark.parametrize("call, message", REFUSED)
def test_what_is_refused(call: Callable[[], Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        call()
