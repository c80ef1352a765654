"""Samples as loaders give them: structures, classes of tensors, pipelines."""

import itertools
from collections import OrderedDict, defaultdict
from typing import Any, NamedTuple

import pytest
import torch
from augmenting import OPTIONS, H, W, distances, leaves, picture, result, same
from torch import Tensor

from uwaug import RandomUnderwater
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
