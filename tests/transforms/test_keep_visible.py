"""`KeepVisible`: the objects of a sample that can still be seen."""

import copy
import pickle
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from augmenting import same
from torch import Tensor

from uwaug import KeepVisible, RandomUnderwater, RandomWater
from uwaug.distance import Network

H, W = 40, 60
NEAR = [4.0, 5.0, 24.0, 30.0]
FAR = [34.0, 2.0, 58.0, 38.0]
BOTH = [20.0, 10.0, 40.0, 30.0]
AUGMENT = RandomUnderwater(RandomWater("3C", contrast=None, field=None))
KEEP = KeepVisible(AUGMENT, 0.05)


def image() -> Tensor:
    return torch.rand(3, H, W, generator=torch.Generator().manual_seed(1))


def distance() -> Tensor:
    """Near on the left, far on the right."""
    z = torch.full((1, H, W), 0.8)
    z[..., W // 2 :] = 9.0
    return z


def target(boxes: Any = (NEAR, FAR, BOTH)) -> dict[str, Any]:
    rows = torch.as_tensor(boxes)
    rows = rows if rows.numel() else rows.reshape(0, 4)
    count = len(rows)
    return {
        "boxes": rows,
        "labels": torch.arange(10, 10 + count),
        "area": torch.ones(count),
        "image_id": torch.tensor([3]),
    }


def test_what_is_far_is_taken_out() -> None:
    given = target()
    before = copy.deepcopy(given)
    degraded, z, found = KEEP(image(), distance(), given)
    assert found["labels"].tolist() == [10, 12]
    assert found["boxes"].tolist() == [NEAR, BOTH]
    assert found["area"].tolist() == [1, 1]
    assert found["image_id"] is given["image_id"]
    assert (found["contrast"] >= 0.05).all()
    assert given.keys() == before.keys()
    assert torch.equal(given["boxes"], before["boxes"])
    assert degraded.shape == (3, H, W)
    assert torch.equal(z, distance())


def test_the_contrast_is_that_of_the_picture() -> None:
    aug = RandomUnderwater(RandomWater("3C", contrast=None, field=(0.5, 2.0)))
    torch.manual_seed(3)
    record = aug.make_params(image())
    left = aug.contrast_left(image(), distance(), record)
    torch.manual_seed(3)
    degraded, _, found = KeepVisible(aug, 0.0)(image(), distance(), target())
    assert same(degraded, aug.transform(image(), distance(), record))
    for box, value in zip((NEAR, FAR, BOTH), found["contrast"].tolist(), strict=True):
        x1, y1, x2, y2 = map(int, box)
        assert value == pytest.approx(float(left[0, y1:y2, x1:x2].mean()), abs=1e-5)


def test_a_box_has_all_pixels_that_it_touches() -> None:
    touched, whole = (
        [W // 2 - 1.0, 9.5, W // 2 + 0.5, 10.5],
        [W // 2 - 1.0, 9.0, W // 2 + 1.0, 11.0],
    )
    *_, found = KeepVisible(AUGMENT, 0.0)(image(), distance(), target((touched, whole)))
    ours, theirs = found["contrast"].tolist()
    assert ours == theirs


def test_distances_are_found_once() -> None:
    calls = []

    def network(image: Tensor) -> Tensor:
        calls.append(image)
        return image.mean(-3, keepdim=True)

    keep = KeepVisible(RandomUnderwater("3C", distance=Network(network)))
    keep(image(), target())
    assert len(calls) == 1


MASKS = torch.zeros(3, H, W, dtype=torch.uint8)
MASKS[0, 5:10, 50:55] = MASKS[1, 5:10, 2:6] = 1  # the first is far, whatever its box says
TURNED = torch.tensor([[14.0, 5, 24, 20, 14, 35, 4, 20], [46, 2, 58, 20, 46, 38, 34, 20]])
OUTSIDE = [[-30.0, -30.0, -5.0, -5.0], [3.0, 3.0, 3.0, 9.0], [-9.0, -9.0, 6.0, 6.0]]
ROWS = {"track": [5, 6, 7], "other": torch.arange(3)}
APART = ("image_id", "other", "labels", "area")
KEPT: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = {
    # options, entries, and those that are left
    "masks": ({}, {"masks": MASKS}, {"labels": [11], "masks": MASKS[1:2].tolist()}),
    "turned boxes": ({}, target(TURNED), {"labels": [10], "boxes": TURNED[:1].tolist()}),
    "none": ({}, target([]), {"labels": [], "boxes": [], "contrast": []}),
    "outside of the picture": ({}, target(OUTSIDE), {"labels": [12]}),
    "lists and arrays": (
        {},
        {"labels": ["a", "b", "c"], "iscrowd": np.array([0, 0, 1])},
        {"labels": ["a", "c"], "iscrowd": [0, 1]},
    ),
    "flags": ({"flag": True}, {}, {"iscrowd": [0, 1, 0], "labels": [10, 11, 12]}),
    "flags of crowds": ({"flag": True}, {"iscrowd": [1, 0, 0]}, {"iscrowd": [1, 1, 0]}),
    "rows by name": (
        {"along": ("boxes", "track"), "apart": APART},
        ROWS,
        {"track": [5, 7], "other": [0, 1, 2], "labels": [10, 11, 12]},
    ),
    "rows where nothing is dropped": ({"min_contrast": 0.0}, ROWS, {"track": [5, 6, 7]}),
}


@pytest.mark.parametrize("name", KEPT)
def test_what_is_left_of_targets(name: str) -> None:
    options, entries, expected = KEPT[name]
    *_, found = KeepVisible(AUGMENT, **options)(image(), distance(), target() | entries)
    for key, value in expected.items():
        assert (found[key] if isinstance(found[key], list) else found[key].tolist()) == value


def test_the_draws_are_those_of_the_augmentation_alone() -> None:
    aug = RandomUnderwater(p=0.5)
    keep = KeepVisible(aug)
    for seed in range(4):
        torch.manual_seed(seed)
        degraded, *_ = keep(image(), distance(), target())
        torch.manual_seed(seed)
        assert same(degraded, aug(image(), distance())[0])
        keyed = keep.at(1, 2, f"{seed}.png")(image(), distance(), target())
        assert same(keyed[0], aug.at(1, 2, f"{seed}.png")(image(), distance())[0])


def test_a_picture_left_alone_keeps_everything() -> None:
    picture = image()
    aug = RandomUnderwater(p=0.0)
    degraded, _, found = KeepVisible(aug, 1.0)(picture, distance(), target())
    assert degraded is picture
    left = aug.contrast_left(picture, distance(), aug.make_params(picture))
    assert torch.equal(left, torch.ones(1, H, W))
    assert found["contrast"].tolist() == [1, 1, 1]


class Sample(NamedTuple):
    image: Tensor
    distance: Tensor
    target: dict[str, Any]


def test_structures() -> None:
    flat = KEEP({"image": image(), "distance": distance(), **target()})
    assert flat["labels"].tolist() == [10, 12]
    nested = KEEP({"image": image(), "distance": distance(), "objects": target(), "id": "a"})
    assert nested["objects"]["labels"].tolist() == [10, 12]
    assert nested["id"] == "a"
    pair = KEEP(image(), {**target(), "distance": distance()})
    assert pair[1]["labels"].tolist() == [10, 12]
    named = KEEP(Sample(image(), distance(), target()))
    assert isinstance(named, Sample)
    assert named.target["labels"].tolist() == [10, 12]
    listed = KEEP([image(), distance(), target()])
    assert isinstance(listed, list)


@pytest.mark.parametrize("form", ["XYXY", "XYWH", "CXCYWH"])
def test_tv_tensors_in_a_pipeline(torchvision: Any, form: str) -> None:
    v2, tv = torchvision.transforms.v2, torchvision.tv_tensors
    corners = tv.BoundingBoxes([NEAR, FAR, BOTH], format="XYXY", canvas_size=(H, W))
    boxes = v2.functional.convert_bounding_box_format(corners, new_format=form)
    masks = tv.Mask(torch.ones(3, H, W, dtype=torch.uint8))
    masks[1, :, : W // 2] = 0
    given = {"boxes": boxes, "labels": torch.tensor([1, 2, 3]), "distance": tv.Mask(distance())}
    pipeline = v2.Compose([v2.RandomHorizontalFlip(1.0), v2.SanitizeBoundingBoxes(), KEEP])
    picture = tv.Image(image())
    degraded, found = pipeline(picture, given)
    assert isinstance(degraded, tv.Image)
    assert isinstance(found["boxes"], tv.BoundingBoxes)
    assert found["boxes"].format.name == form
    assert found["boxes"].canvas_size == (H, W)
    assert found["labels"].tolist() == [1, 3]
    back = v2.functional.convert_bounding_box_format(found["boxes"], new_format="XYXY")
    assert back[0].tolist() == [W - NEAR[2], NEAR[1], W - NEAR[0], NEAR[3]]
    masked = KEEP(picture, given | {"masks": masks})[1]
    assert isinstance(masked["masks"], tv.Mask)
    assert masked["labels"].tolist() == [1, 3]


def test_keys_draw_the_same_and_copies_are_alike() -> None:
    first, again = (KEEP.at(0, 0, 1)(image(), distance(), target()) for _ in range(2))
    assert same(first[0], again[0])
    assert same(first[2]["contrast"], again[2]["contrast"])
    twin = pickle.loads(pickle.dumps(KEEP))
    assert repr(twin) == repr(KEEP)
    assert "min_contrast=0.05" in repr(KEEP)
    assert KEEP.to("cpu").train() is KEEP  # as any module


@pytest.mark.parametrize(
    "change, message",
    [
        ({"labels": torch.arange(2)}, r"target\['labels'\] has 2 rows for 3 objects"),
        (
            {"boxes": torch.tensor([[20.0, 5.0, 9.0, 30.0]] * 3)},
            r"\['boxes'\] end before they begin: give corners in px",
        ),
        (
            {"boxes": torch.tensor([[0.1, 0.2, 0.5, 1.0]] * 3)},
            r"\['boxes'\] lie in 0…1: multiply by width and height",
        ),
        ({"boxes": torch.rand(3, 5)}, r"be \(N, 4\) or \(N, 8\), got \(3, 5\)"),
        ({"track": [1, 2, 3]}, r"target\['track'\] seems to have a row for each object"),
        (
            {"masks": torch.ones(3, 4, 5)},
            r"target\['masks'\] must be \(N, 40, 60\), got \(3, 4, 5\)",
        ),
    ],
)
def test_targets_that_do_not_fit(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        KEEP(image(), distance(), target() | change)


def test_other_refusals() -> None:
    with pytest.raises(ValueError, match="found 0"):
        KEEP(image(), distance())
    with pytest.raises(ValueError, match="found 2"):
        KEEP(image(), distance(), target(), target())
    with pytest.raises(ValueError, match=r"image must be one picture \(3, H, W\), got"):
        KEEP(image()[None], distance(), target())
    with pytest.raises(TypeError, match=r"augment must be a uwaug\.RandomUnderwater"):
        KeepVisible(0.05)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"min_contrast must be in \[0, 1\]"):
        KeepVisible(AUGMENT, 5)
