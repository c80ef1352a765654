"""Samples as loaders give them: structures, classes of tensors, pipelines."""

import itertools
import json
from collections import OrderedDict, defaultdict
from typing import Any, NamedTuple

import pytest
import torch
from augmenting import OPTIONS, H, W, distances, leaves, picture, result, same
from torch import Tensor

from uwaug import KeepVisible, RandomUnderwater
from uwaug.distance import MadeUp, Network, Plane


class Sample(NamedTuple):
    image: Tensor
    distance: Tensor
    label: int


@pytest.mark.parametrize("batch", [None, 2], ids=["single", "batch"])
@pytest.mark.parametrize("name", ["default", "keys", "plane"])
def test_the_same_structure_comes_back(name: str, batch: int | None) -> None:
    aug = RandomUnderwater(**OPTIONS[name])
    image, *maps = inputs = leaves(aug, batch)
    kept, expected = [x.clone() for x in inputs], result(aug, batch)
    assert not torch.equal(expected, image)
    label, boxes = object(), [torch.zeros(2, 4)]
    rest = {"label": label, "boxes": boxes, **dict(zip(aug.keys[1:], maps, strict=False))}
    named = {aug.keys[0]: image, **rest}
    for sample in (named, OrderedDict(named), defaultdict(list, named)):
        out = aug.at(1, 2, 0)(sample)
        assert type(out) is type(sample)
        assert list(out) == list(sample)
        assert all(out[k] is sample[k] for k in rest)
        assert same(out[aug.keys[0]], expected)
    listed, named_tuple = [image, *maps, label, boxes], Sample(image, maps[0] if maps else "a", 3)
    for sample in (tuple(listed), listed, named_tuple, (image, rest, "more"), [image, rest]):
        out = aug.at(1, 2, 0)(sample)
        assert type(out) is type(sample)
        assert all(a is b for a, b in zip(out[1:], sample[1:], strict=True))
        assert same(out[0], expected)
    assert all(torch.equal(a, b) for a, b in zip(inputs, kept, strict=True))


CALLS: list[Any] = [
    lambda aug, image, z: aug(image, {"distance": z}),
    lambda aug, image, z: aug({"image": image, "distance": z}),
    lambda aug, image, z: aug.transform(image, z, aug.make_params(image)),
    lambda aug, image, z: aug.contrast_left(image, z, aug.make_params(image)),
]


def test_a_map_that_nothing_reads_is_refused() -> None:
    for source, call in itertools.product((MadeUp(), Plane(3.0), Network(torch.mean)), CALLS):
        with pytest.raises(ValueError, match=r"distance: a map came, which .* not"):
            call(RandomUnderwater(distance=source), picture(2), distances(2))


def test_what_else_stands_after_a_picture_is_no_map() -> None:
    masks = torch.zeros(1, H, W).long(), torch.rand(H, W), torch.rand(1, H, W)
    for label in (torch.tensor(3), torch.rand(5), *masks, {"a": 0}):
        degraded, same_label = RandomUnderwater(distance=3.0)(picture(), label)
        assert same_label is label
        assert not torch.equal(degraded, picture())


class Photo(Tensor):
    """Wrapped and unwrapped as torchvision's tv_tensors are."""


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
@pytest.mark.parametrize("batch", [None, 2], ids=["single", "batch"])
def test_subclasses_come_back(batch: int | None, dtype: torch.dtype) -> None:
    aug = RandomUnderwater().at(0, 0, 0)
    image, distance = picture(batch, dtype), distances(batch) + 1
    out, _ = aug(image.as_subclass(Photo), distance.as_subclass(Photo))
    assert type(out) is Photo
    assert same(aug(image, distance)[0], out.as_subclass(Tensor))


def test_refused_samples() -> None:
    for sample, message in (
        ({"image": picture(), "depth": 0}, "no 'distance', only 'image', 'depth': see keys"),
        ((picture(), {"depth": 1}), "dict in second place has no 'distance', only 'depth'"),
        ((), "sample is empty"),
        (picture(), "distance is missing"),
        # whatever is drawn
        ((picture(), distances()[:, 9:]), "height and width must agree"),
    ):
        for share in (0.0, 1.0):
            with pytest.raises(ValueError, match=message):
                RandomUnderwater(p=share)(sample)


@pytest.mark.parametrize("kind", ["Image", "Video"])
def test_a_second_picture_stays_dry_for_no_one_in_silence(torchvision: Any, kind: str) -> None:
    left, right = (getattr(torchvision.tv_tensors, kind)(picture(2)) for _ in range(2))
    aug = RandomUnderwater(distance=3.0)
    for sample in ({"image": left, "stereo": [right]}, (left, {"stereo": [right]})):
        where = r"sample\['stereo'\]\[0\]" if isinstance(sample, dict) else r"\[1\]\['stereo'\]"
        with pytest.raises(ValueError, match=rf"{where}.* is a second picture"):
            aug(sample)
    clean = right.as_subclass(Tensor)
    assert aug({"image": left, "clean": clean})["clean"] is clean


SIDES = (24, 33), (16, 40), (30, 20)
CROPS = [torch.rand(3, *side, generator=torch.Generator().manual_seed(4)) for side in SIDES]
CROPS_Z = [torch.linspace(0.5, 4.0, h * w).reshape(1, h, w) for h, w in SIDES]


def call_of_list(
    aug: RandomUnderwater, structure: str, crops: list[Any], maps: list[Tensor]
) -> Any:
    if structure == "dict":
        return aug({"image": crops, "distance": maps, "boxes": 3})["image"]
    if not aug.distance.reads_maps:
        return aug(crops)
    return (aug((crops, maps, [1, 2, 3])) if structure == "tuple" else aug(crops, tuple(maps)))[0]


@pytest.mark.parametrize("structure", ["inputs", "tuple", "dict"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_list_of_pictures_is_a_batch_of_any_sizes(structure: str, count: int) -> None:
    aug, crops, maps = RandomUnderwater(["II", "7C"], p=0.7), CROPS[:count], CROPS_Z[:count]
    torch.manual_seed(11)
    wet = call_of_list(aug, structure, crops, maps)
    assert type(wet) is list
    torch.manual_seed(11)
    record = json.loads(json.dumps(aug.make_params(crops)))
    assert len(record["samples"]) == count
    again = aug.transform(crops, maps, record)
    for crop, z, sample, *both in zip(crops, maps, record["samples"], wet, again, strict=True):
        alone = aug.transform(crop, z, {"samples": [sample]})
        assert all(same(out, alone) for out in both)
        assert torch.equal(alone, crop) != sample["applied"]


def test_a_list_of_tv_tensors_is_a_batch(torchvision: Any) -> None:
    images = [torchvision.tv_tensors.Image(crop) for crop in CROPS]
    wet = RandomUnderwater(distance=MadeUp())(images)
    assert [type(out) for out in wet] == [type(image) for image in images]
    assert not any(map(torch.equal, wet, images))


def test_a_target_stays_as_it_is_and_a_third_picture_is_refused() -> None:
    aug, (image, clean, third) = RandomUnderwater(distance=3.0), (picture() for _ in range(3))
    batches = [x.expand(2, -1, -1, -1) for x in (image, clean, third)]
    for first, second in ((image, clean), batches[:2]):
        for sample in ((first, second), (first, second, torch.zeros(3, H, W).bool(), "name")):
            wet, untouched = aug(sample)[:2]
            assert untouched is second
            assert not torch.equal(wet, first)
    wet = aug(batches[:2])  # a loader's list of two batches is a pair, too
    assert wet[1] is batches[1]
    for sample in ((image, clean, third), (image, clean, 7, third), batches):
        with pytest.raises(
            ValueError, match=r"sample\[\d\] is a third picture, .*a batch is a list"
        ):
            aug(sample)


def test_maps_beside_a_list_that_reads_none_stay_as_they_are() -> None:
    wet, maps = RandomUnderwater("II", distance=3.0)(CROPS, CROPS_Z)
    assert maps is CROPS_Z
    assert not any(map(torch.equal, wet, CROPS))


def test_refused_lists() -> None:
    aug, ready = RandomUnderwater("II"), RandomUnderwater("II", distance=3.0)
    for call, message in (
        (lambda: aug(CROPS, CROPS_Z[:2]), "distance has 2 maps but image is a list of 3"),
        (lambda: aug(CROPS), "distance is missing"),
        (lambda: ready.transform(CROPS, None, ready.make_params(picture(2))), "2 samples"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


@pytest.mark.parametrize("keys", [[5, "reef/3.png", 0], torch.tensor([4, 9, 2])])
def test_each_picture_of_a_batch_has_its_own_key(keys: Any) -> None:
    aug, images, maps = RandomUnderwater(["II", "3C"], p=0.8), picture(3), distances(3) + 1
    wet, _ = aug.at(1, 2, keys)(images, maps)
    listed, _ = aug.at(1, 2, keys)(CROPS, CROPS_Z)
    for i, key in enumerate(keys):
        alone, _ = aug.at(1, 2, key)(images[i], maps[i])
        assert float((wet[i] - alone).abs().max()) <= 1e-6
        assert same(listed[i], aug.at(1, 2, key)(CROPS[i], CROPS_Z[i])[0])
    record = aug.make_params(images, aug.generator_of(1, 2, keys))
    assert same(aug.transform(images, maps, record), wet)


def test_keys_are_as_many_as_pictures() -> None:
    aug, boxes = RandomUnderwater(distance=3.0), {"boxes": torch.tensor([[1.0, 1.0, 9.0, 9.0]])}
    keep = KeepVisible(aug, 0.0)
    for transform, inputs in ((aug, (picture(3),)), (aug, (CROPS,)), (keep, (picture(), boxes))):
        for keys in ([0, 1], [0, 1, 2, 3]):
            with pytest.raises(ValueError, match=rf"index has {len(keys)} keys but image has "):
                transform.at(0, 0, keys)(*inputs)
    alone, _ = keep.at(0, 0, [6])(picture(), boxes)
    assert same(alone, aug.at(0, 0, 6)(picture()))
