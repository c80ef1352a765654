import math
from collections import OrderedDict, defaultdict
from typing import Any, NamedTuple

import kornia
import PIL.Image
import pytest
import torch
from augmenting import EVERYTHING, OPTIONS, H, W, distances, picture, same
from torch import Tensor

from uwaug import RandomUnderwater


class Sample(NamedTuple):
    image: Tensor
    distance: Tensor
    label: int


@pytest.mark.parametrize("batch", [None, 2], ids=["single", "batch"])
@pytest.mark.parametrize("name", ["default", "keys", "plane", "network"])
def test_structure_identity_and_no_mutation(name: str, batch: int | None) -> None:
    aug = RandomUnderwater(**OPTIONS[name])
    image, distance = picture(batch), distances(batch)
    kept = image.clone(), distance.clone()
    label, boxes = object(), [torch.zeros(2, 4)]
    keys = aug.image_key, aug.distance_key
    named = {keys[0]: image, "label": label, keys[1]: distance, "boxes": boxes}
    default: defaultdict[str, Any] = defaultdict(list, named)
    for sample in (named, OrderedDict(named), default):
        before = dict(sample)
        out = aug(sample)
        assert type(out) is type(sample)
        assert out is not sample
        assert list(out) == list(sample)
        assert all(sample[k] is before[k] for k in before)
        assert all(out[k] is sample[k] for k in sample if k != keys[0])
        assert out[keys[0]].shape == image.shape
        assert not torch.equal(out[keys[0]], image)
    leaves = (image, distance, label, boxes)
    for sample in (leaves, list(leaves), Sample(image, distance, 3)):
        before = list(sample)
        out = aug(sample)
        assert type(out) is type(sample)
        assert len(out) == len(sample)
        assert all(a is b for a, b in zip(sample, before, strict=True))
        assert all(a is b for a, b in zip(out[1:], sample[1:], strict=True))
        assert not torch.equal(out[0], image)
    out = aug(image, distance, label)
    assert type(out) is tuple
    assert out[1] is distance
    assert out[2] is label
    assert all(torch.equal(a, b) for a, b in zip((image, distance), kept, strict=True))


class Photo(Tensor):
    """Wrapped and unwrapped as torchvision's tv_tensors are."""


class Map(Tensor):
    pass


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
@pytest.mark.parametrize("batch", [None, 2], ids=["single", "batch"])
def test_subclasses_come_back(batch: int | None, dtype: torch.dtype) -> None:
    aug = RandomUnderwater()
    image = picture(batch, dtype).as_subclass(Photo)
    distance = (distances(batch) + 1).as_subclass(Map)
    out, same_map = aug.at(0, 0, 0)(image, distance)
    assert type(out) is Photo
    assert same_map is distance
    assert type(distance) is Map
    plain, _ = aug.at(0, 0, 0)(picture(batch, dtype), distances(batch) + 1)
    assert type(plain) is Tensor
    assert same(plain, out.as_subclass(Tensor))
    assert type(aug({"image": image, "distance": distance})["image"]) is Photo


@pytest.mark.parametrize("name", ["default", "keys", "plane"])
def test_a_map_in_the_dict_in_second_place(name: str) -> None:
    aug = RandomUnderwater(**OPTIONS[name])
    image, boxes = picture(), torch.zeros(2, 4)
    target = OrderedDict({"boxes": boxes, aug.distance_key: distances(), "labels": [1, 2]})
    kept = dict(target)
    expected = aug.at(0, 0, 0)((image, target[aug.distance_key]))[0]
    for sample in ((image, target, "more"), [image, target]):
        out = aug.at(0, 0, 0)(sample)
        assert type(out) is type(sample)
        assert same(out[0], expected)
        assert out[1] is target
        assert all(a is b for a, b in zip(out[1:], sample[1:], strict=True))
    assert same(aug.at(0, 0, 0)(image, target)[0], expected)
    assert list(target) == list(kept)
    assert all(target[key] is kept[key] for key in kept)


def test_kornia() -> None:
    mirror = kornia.augmentation.RandomHorizontalFlip(p=1.0)
    image, distance, aug = picture(2), distances(2) + 1, RandomUnderwater()
    inside = kornia.augmentation.AugmentationSequential(mirror, aug, data_keys=["input"])
    with pytest.raises(ValueError, match=r"kornia gives its children the image alone: call"):
        inside(image)
    flip = kornia.augmentation.AugmentationSequential(mirror, data_keys=["input", "mask"])
    moved = flip(image, distance)
    assert isinstance(moved, list)
    out, z = aug.at(0, 0, 0)(moved)
    assert z is moved[1]
    assert same(out, aug.at(0, 0, 0)(image.flip(-1), distance.flip(-1))[0])


GREY = r"repeat grey with image.expand\("
SMALL = f"distance is .20, {W}. but image is .{H}, {W}."


@pytest.mark.parametrize(
    "image, distance, match",
    [
        (picture(), distances()[:, :20], SMALL),
        (picture(3), distances(2), "distance is a batch of 2 but image is one of 3"),
        (picture(), distances(2), "distance is a batch of 2 but image is one of 1"),
        (picture(), distances()[0], r"distance must have shape .1, H, W.*: give distance\[None\]"),
        (picture(), distances().expand(3, H, W), r"distance must have shape.*\(3, "),
        (255 * picture(), distances() + 1, r"image reaches 2\d\d.*divide a 0…255 image by 255"),
        (picture()[:1], distances(), GREY + r"3, -1, -1\)"),
        (picture()[0], distances(), GREY + r"3, -1, -1\)"),
        (picture(2)[:, :1], distances(), GREY + r"-1, 3, -1, -1\)"),
        (picture(4).transpose(0, 1), distances(3), rf"image must have.*\(3, 4, {H}, {W}\)"),
        (picture()[[0, 1, 2, 2]], distances(), r"drop alpha with image\[:3\]"),
        (picture(2)[:, [0, 1, 2, 2]], distances(2), r"drop alpha with image\[:, :3\]"),
        (picture().permute(1, 2, 0), distances(), r"first with image.permute\(2, 0, 1\)"),
        (picture(2).permute(0, 2, 3, 1), distances(2), r"first with image.permute\(0, 3, 1, 2\)"),
        (picture(), distances().permute(1, 2, 0), r"first with distance.permute\(2, 0, 1\)"),
        (picture().long(), distances(), "image must be a floating.*got torch.int64; or uint8"),
        (picture().numpy(), distances(), "image must be.*ndarray.*Convert"),
        (PIL.Image.new("RGB", (W, H)), distances(), r"got Image. Convert a PIL.*pil_to_tensor"),
        (4 * picture() - 2, distances() + 1, r"image falls to -1\..*place it before Normalize"),
        (picture(), 3, r"got int; expected \(image, distance, …\)"),
        (picture(), distances() - 0.5, r"distance must be above 0 m.* negative at [1-9].*'fill'"),
        (picture(), distances() * math.nan, rf"distance must be above 0 m.*NaN at {H * W}"),
        (picture(), (1000 * distances()).int(), "distance must be a.*int32.*millimetres by 1000"),
        (picture(), distances().numpy(), "distance must be a floating-point tensor, got ndarray"),
        (picture(), None, "distance is missing"),
    ],
)
def test_inputs_are_checked(image: Any, distance: Any, match: str) -> None:
    with pytest.raises((TypeError, ValueError), match=match):
        RandomUnderwater()(image, distance)


def test_shapes_are_checked_whatever_is_drawn() -> None:
    with pytest.raises(ValueError, match="height and width must agree"):
        RandomUnderwater(p=0.0)(picture(), distances()[:, 1:])


@pytest.mark.parametrize(
    "options, sample, match",
    [
        (
            {},
            {"image": picture(), "depth": 0},
            "no 'distance', only 'image', 'depth'.*distance_key",
        ),
        ({}, {"rgb": picture()}, "no 'image', only 'rgb'.*image_key"),
        ({}, (picture(), {"depth": 1}), "dict in second place has no 'distance', only 'depth'"),
        ({}, (), "sample is empty"),
        ({}, picture(), "distance is missing"),
        ({}, [picture()], "distance is missing"),
        ({"unknown": "fill"}, (picture(), distances() * math.nan), "at least one known pixel"),
        ({"distance_kind": "relative"}, (picture(), distances() + 1), r"t must lie in \[0, 1\]"),
        ({"distance_kind": "inverse"}, (picture(), 0 * distances()), "inverse must vary"),
        ({"distance": lambda x: x}, picture(), r"distance must have shape.*\(3, "),
    ],
)
def test_samples_are_checked(options: dict[str, Any], sample: Any, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        RandomUnderwater(**options)(sample)


# torchvision


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
def test_in_a_torchvision_pipeline(torchvision: Any, dtype: torch.dtype) -> None:
    v2, tv = torchvision.transforms.v2, torchvision.tv_tensors
    pipeline = v2.Compose(
        [
            v2.RandomResizedCrop((20, 28), antialias=True),
            v2.RandomHorizontalFlip(p=1.0),
            v2.ColorJitter(0.2, 0.2),
            RandomUnderwater(**EVERYTHING),
            v2.ToDtype(torch.float32, scale=True),
            v2.Normalize([0.5] * 3, [0.25] * 3),
        ]
    )
    image, distance, label = tv.Image(picture(dtype=dtype)), tv.Mask(distances() + 1), object()
    values = set(distance.flatten().tolist())
    named = {"image": image, "distance": distance, "label": label}
    for sample in ((image, distance, label), named):
        out = pipeline(sample)
        seen, z, same_label = out.values() if isinstance(out, dict) else out
        assert type(out) is type(sample)
        assert same_label is label
        assert type(seen) is tv.Image
        assert type(z) is tv.Mask
        assert seen.shape == (3, 20, 28)
        assert seen.isfinite().all()
        assert set(z.flatten().tolist()) <= values  # moved, not jittered


def test_torchvision_detection(torchvision: Any) -> None:
    v2, tv = torchvision.transforms.v2, torchvision.tv_tensors
    pipeline = v2.Compose(
        [
            v2.RandomHorizontalFlip(p=1.0),
            RandomUnderwater(**EVERYTHING),
            v2.ToDtype(torch.float32, scale=True),
        ]
    )
    image, label = tv.Image(picture(dtype=torch.uint8)), object()
    boxes = tv.BoundingBoxes([[1, 2, 9, 12]], format="XYXY", canvas_size=(H, W))
    target = {"boxes": boxes, "distance": tv.Mask(distances() + 1), "label": label}
    for sample in ((image, target), [image, target]):
        seen, moved = pipeline(sample)
        assert type(seen) is tv.Image
        assert not torch.equal(seen, image.flip(-1) / 255)
        assert type(moved) is dict
        assert list(moved) == list(target)
        assert type(moved["boxes"]) is tv.BoundingBoxes
        assert moved["boxes"].tolist() == [[W - 9, 2, W - 1, 12]]
        assert type(moved["distance"]) is tv.Mask
        assert torch.equal(moved["distance"], target["distance"].flip(-1))
        assert moved["label"] is label
