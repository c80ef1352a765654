import copy
import json
import math
import pickle
import subprocess
import sys
from collections import OrderedDict, defaultdict
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import kornia
import numpy as np
import pytest
import torch
from torch import Tensor

import uwaug.degrade
import uwaug.transforms
from uwaug import (
    JERLOV_TYPES,
    Camera,
    Medium,
    PointSpread,
    RandomUnderwater,
    Water,
    form_image,
    load_preset,
)
from uwaug.colour import linear_to_srgb, srgb_to_linear
from uwaug.distance import fill_unknown, from_inverse, from_relative
from uwaug.field import gaussian_random_field

H, W = 24, 33
TANK = Water([400, 550, 700], [0.5, 0.2, 0.7], [1.3, 1.1, 1.0], [0.7, 0.3, 0.8], name="tank")
LASERS = Camera([450, 550, 600], [[0, 0, 1], [0, 1, 0], [1, 0, 0]], name="lasers")
EVERYTHING = {
    "mixing": (0.0, 1.0), "visibility": (1.5, 9.0), "vertical_depth": (0.5, 8.0), "g": (0.1, 0.4), "mu": (0.2, 0.35),
    "blur_factor": (0.5, 3.0),
}  # fmt: skip


def brightness(image: Tensor) -> Tensor:
    """Stands for a depth network."""
    return image.mean(-3, keepdim=True)


# in a plane, in relative and in inverse distance, 0…1 is a map as good as any
OPTIONS: dict[str, dict[str, Any]] = {
    "survey": {},
    "one water": {"waters": "7C"},
    "weights": {"waters": {"II": 3.0, "9C": 0, TANK: 1.5}},
    "everything random": EVERYTHING,
    "cameras": {"cameras": ["sigma sdmerill (npl)", LASERS]},
    "calibrated": {"point_spread": PointSpread.calibrated(28.6), "g": 0.05, "mu": 0.075},
    "heavy tails": {"point_spread": PointSpread(1.0, 0.6, "exponential")},
    "no blur": {"point_spread": PointSpread.none(), "tolerance": 0.01},
    "no field": {"field_probability": 0.0},
    "fields": {"field_probability": 0.5, "field_range": [0.3, 1.7]},
    "relative": {
        "distance_kind": "relative",
        "near": (0.0, 1.0),
        "far": (4.0, 8.0),
        "gamma": (1.0, 3.0),
    },
    "inverse": {"distance_kind": "inverse", "near": (0.5, 1.0), "far": 8.0},
    "plane": {"distance": 3.0},
    "planes": {"distance": (1.0, 4.0)},
    "network": {"distance": brightness, "distance_kind": "inverse"},
    "half": {"p": 0.5},
    "batch": {"same_on_batch": True, **EVERYTHING},
    "fill": {"unknown": "fill"},
    "keys": {"image_key": "rgb", "distance_key": "range"},
    "light": {"color_space": "linear", "order": "source"},
}


@pytest.fixture(scope="module", params=OPTIONS)
def options(request: pytest.FixtureRequest) -> dict[str, Any]:
    return OPTIONS[request.param]


def picture(batch: int | None = None, dtype: torch.dtype = torch.float32) -> Tensor:
    generator = torch.Generator().manual_seed(7)
    image = torch.rand(*(() if batch is None else (batch,)), 3, H, W, generator=generator)
    return (255 * image).round().byte() if dtype == torch.uint8 else image.to(dtype)


def distances(batch: int | None = None) -> Tensor:
    generator = torch.Generator().manual_seed(8)
    return 1e-3 + 0.999 * torch.rand(
        *(() if batch is None else (batch,)), 1, H, W, generator=generator
    )


def leaves(aug: RandomUnderwater, batch: int | None = None) -> tuple[Tensor, ...]:
    """What a transform takes: image and map, or image alone."""
    return (picture(batch), distances(batch)) if aug.distance is None else (picture(batch),)


def result(aug: RandomUnderwater, batch: int | None = None, key: int = 0) -> Tensor:
    out = aug.at(1, 2, key)(*leaves(aug, batch))
    return out[0] if isinstance(out, tuple) else out


def same(a: Any, b: Any) -> bool:
    return type(a) is type(b) and a.dtype == b.dtype and a.shape == b.shape and torch.equal(a, b)


# Contracts that hold for all options


@pytest.mark.parametrize("batch", [None, 3], ids=["single", "batch"])
def test_replay_is_bit_exact(options: dict[str, Any], batch: int | None) -> None:
    aug = RandomUnderwater(**options)
    image, *rest = leaves(aug, batch)
    distance = rest[0] if rest else None
    for seed in range(2):
        torch.manual_seed(seed)
        record = aug.make_params(image)
        first = aug.transform(image, distance, record)
        torch.manual_seed(seed)
        drawn = aug(image, distance)[0] if rest else aug(image)
        assert same(first, drawn)
        assert same(first, aug.transform(image, distance, record))
        read = json.loads(json.dumps(record, allow_nan=False))
        assert read == record
        assert same(first, aug.transform(image, distance, read))
        assert same(first, aug.transform(image, distance, pickle.loads(pickle.dumps(record))))
        assert same(first, pickle.loads(pickle.dumps(aug)).transform(image, distance, read))
        for threads in (1, 3):
            before = torch.get_num_threads()
            torch.set_num_threads(threads)
            assert same(first, aug.transform(image, distance, record))
            assert torch.get_num_threads() == threads
            torch.set_num_threads(before)
        assert first.isfinite().all()


def test_replay_in_another_process(tmp_path: Path) -> None:
    augs = {name: RandomUnderwater(**o) for name, o in OPTIONS.items() if name != "network"}
    records = {name: aug.make_params(picture(2)) for name, aug in augs.items()}
    (tmp_path / "records.json").write_text(json.dumps(records))
    inputs = {name: leaves(aug, 2) for name, aug in augs.items()}
    (tmp_path / "augs.pickle").write_bytes(pickle.dumps((augs, inputs)))
    code = """
import json, pickle, sys, torch
augs, inputs = pickle.load(open("augs.pickle", "rb"))
records = json.load(open("records.json"))
results = {name: aug.transform(*(*inputs[name], None)[:2], records[name]) for name, aug in augs.items()}
torch.save(results, "results.pt")
"""
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)
    for name, theirs in torch.load(tmp_path / "results.pt").items():
        image, *rest = inputs[name]
        assert same(
            theirs, augs[name].transform(image, rest[0] if rest else None, records[name])
        ), name


def test_threads_do_not_show() -> None:
    # sizes at which exp2 and pow, left to themselves, differ in the last bit
    aug, before = RandomUnderwater(), torch.get_num_threads()
    image, distance = torch.rand(3, 203, 301), 1 + 4 * torch.rand(1, 203, 301)
    record = aug.make_params(image)
    try:
        results = []
        for threads in (1, 2, 3, 5):
            torch.set_num_threads(threads)
            results.append(aug.transform(image, distance, record))
    finally:
        torch.set_num_threads(before)
    assert all(same(results[0], other) for other in results[1:])


def test_batch_is_its_pictures_one_by_one(options: dict[str, Any]) -> None:
    if options.get("same_on_batch"):
        return
    aug = RandomUnderwater(**options)
    image, *rest = leaves(aug, 3)
    record = aug.make_params(image)
    assert len(record["samples"]) == 3
    whole = aug.transform(image, rest[0] if rest else None, record)
    for i, sample in enumerate(record["samples"]):
        single = aug.transform(image[i], rest[0][i] if rest else None, {"samples": [sample]})
        assert same(whole[i], single)


def test_copies_and_pickles(options: dict[str, Any]) -> None:
    aug = RandomUnderwater(**options)
    for twin in (copy.deepcopy(aug), copy.copy(aug), pickle.loads(pickle.dumps(aug))):
        assert same(result(aug, 2), result(twin, 2))
        assert repr(twin) == repr(aug)


def test_repr_builds_the_transform(options: dict[str, Any]) -> None:
    aug = RandomUnderwater(**options)
    text = (
        repr(aug)
        .replace(repr(TANK), "TANK")
        .replace(repr(LASERS), "LASERS")
        .replace(repr(brightness), "brightness")
    )
    twin = eval(text)
    assert repr(twin) == repr(aug)
    assert same(result(aug, 2), result(twin, 2))


def test_repr_shows_what_was_changed() -> None:
    assert repr(RandomUnderwater()) == "RandomUnderwater()"
    assert repr(RandomUnderwater(["1C", "7C"], p=0.5)) == "RandomUnderwater(['1C', '7C'], p=0.5)"
    assert repr(RandomUnderwater({"1C": 2.0, "7C": 1})) == "RandomUnderwater({'1C': 2.0, '7C': 1})"
    assert (
        repr(RandomUnderwater(g=(0.1, 0.3), waters=JERLOV_TYPES[1:]))
        == "RandomUnderwater(g=(0.1, 0.3))"
    )


class Sample(NamedTuple):
    image: Tensor
    distance: Tensor
    label: int


@pytest.mark.parametrize("batch", [None, 2], ids=["single", "batch"])
def test_structure_identity_and_no_mutation(options: dict[str, Any], batch: int | None) -> None:
    aug = RandomUnderwater(**{**options, "p": 1.0})
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
    for sample in (
        (image, distance, label, boxes),
        [image, distance, label, boxes],
        Sample(image, distance, 3),
    ):
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


@pytest.mark.parametrize(
    "dtype", [torch.uint8, torch.float16, torch.bfloat16, torch.float32, torch.float64]
)
@pytest.mark.parametrize("batch", [None, 2], ids=["single", "batch"])
def test_types(options: dict[str, Any], dtype: torch.dtype, batch: int | None) -> None:
    aug = RandomUnderwater(**{**options, "distance": options.get("distance", 3.0)})
    image = picture(batch, dtype)
    record = aug.make_params(image)
    out = aug.transform(image, None, record)
    assert out.dtype == dtype
    assert out.shape == image.shape
    assert out.is_contiguous()
    if dtype == torch.uint8:
        exact = aug.transform(image / 255, None, record)
        assert same(out, (exact * 255).round().clamp(0, 255).byte())
    else:
        exact = aug.transform(image.double(), None, record)
        digits = {torch.float16: 6e-4, torch.bfloat16: 5e-3, torch.float32: 2e-5, torch.float64: 0}[
            dtype
        ]
        # the curve from light to sRGB is steep at black
        assert (out.double() - exact).abs().max() <= digits


def test_half_precision_maps() -> None:
    aug, image, distance = RandomUnderwater(), picture(), 1 + 4 * distances()
    record = aug.make_params(image)
    exact = aug.transform(image, distance, record)
    for dtype, error in ((torch.float16, 2e-3), (torch.bfloat16, 2e-2), (torch.float64, 1e-6)):
        assert (aug.transform(image, distance.to(dtype), record) - exact).abs().max() < error
        half = aug.transform(image.to(dtype), distance.to(dtype), record)
        assert half.dtype == dtype
        assert (half - exact).abs().max() < 2 * error


def test_autocast_and_grad_mode_do_not_show() -> None:
    aug, image, distance = RandomUnderwater(), picture().requires_grad_(), distances() + 1
    record = aug.make_params(image)
    expected = aug.transform(image, distance, record)
    assert not expected.requires_grad
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert same(aug.transform(image, distance, record), expected)
    with torch.inference_mode():
        assert same(aug.transform(image.detach(), distance, record), expected)


class Photo(Tensor):
    """Wrapped and unwrapped as torchvision's tv_tensors are."""


class Map(Tensor):
    pass


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
@pytest.mark.parametrize("batch", [None, 2], ids=["single", "batch"])
def test_subclasses_come_back(batch: int | None, dtype: torch.dtype) -> None:
    aug = RandomUnderwater()
    image, distance = (
        picture(batch, dtype).as_subclass(Photo),
        (distances(batch) + 1).as_subclass(Map),
    )
    out, same_map = aug.at(0, 0, 0)(image, distance)
    assert type(out) is Photo
    assert same_map is distance
    assert type(distance) is Map
    plain, _ = aug.at(0, 0, 0)(picture(batch, dtype), distances(batch) + 1)
    assert type(plain) is Tensor
    assert same(plain, out.as_subclass(Tensor))
    assert type(aug({"image": image, "distance": distance})["image"]) is Photo


def test_torch_compile_replays_every_record(options: dict[str, Any]) -> None:
    # the graph is what counts; that inductor runs it is tested below
    torch.compiler.reset()
    aug = RandomUnderwater(**{**options, "p": 1.0})
    compiled = torch.compile(aug.transform, fullgraph=True, backend="eager")
    image, *rest = leaves(aug)
    distance = rest[0] if rest else None
    for _ in range(3):
        record = aug.make_params(image)
        assert same(compiled(image, distance, record), aug.transform(image, distance, record))


@pytest.mark.filterwarnings("ignore:.*torch.jit.script_method.*:DeprecationWarning")  # torch's own
def test_torch_compile_whole_batches() -> None:
    torch.compiler.reset()
    aug = RandomUnderwater("7C", g=(0.1, 0.3), p=0.7)
    compiled = torch.compile(aug.transform, fullgraph=True, backend="aot_eager")
    image, distance = picture(3), distances(3) + 1
    record = aug.make_params(image)
    for _ in range(12):  # more than the graphs that PyTorch would make
        fresh = aug.make_params(image)
        for old, new in zip(record["samples"], fresh["samples"], strict=True):
            new["applied"] = old["applied"]
        assert same(compiled(image, distance, fresh), aug.transform(image, distance, fresh))
    with pytest.raises(ValueError, match="NaN"):
        compiled(image, distance * math.nan, record)


# What is computed


@pytest.mark.parametrize("kind", ["metric", "relative", "inverse", "plane", "fill"])
@pytest.mark.parametrize("color_space", ["srgb", "linear"])
def test_transform_is_form_image(kind: str, color_space: str) -> None:
    options: dict[str, Any] = {"color_space": color_space, **EVERYTHING}
    if kind in ("relative", "inverse"):
        options |= {"distance_kind": kind, "near": (0.5, 1.0), "far": (3.0, 6.0)}
    elif kind != "metric":
        options |= {"distance": (1.0, 4.0)} if kind == "plane" else {"unknown": "fill"}
    aug = RandomUnderwater(["II", "7C", TANK], **options)
    image, given = picture(2), distances(2) * (1 if "distance_kind" in options else 5)
    if kind == "fill":
        given[:, :, 3:5, 4:9] = torch.tensor([math.nan, 0, -1, 0, 0])
    record = aug.make_params(image)
    out = aug.transform(image, None if kind == "plane" else given, record)
    for i, s in enumerate(record["samples"]):
        # visibility is scaled on the bands of the medium, where pure water is no broken line of 25 nm pieces
        first, second = (
            (TANK if name == "tank" else Water.jerlov(name)).at(np.arange(400, 701, 5))
            for name in s["waters"]
        )
        water = first.mix(second, s["mixing"]).with_visibility(s["visibility"])
        law = PointSpread.paper(0.3 * s["blur_factor"])
        medium = Medium.from_water(
            water,
            s["camera"],
            vertical_depth=s["vertical_depth"],
            g=s["g"],
            mu=s["mu"],
            point_spread=law,
        )
        generator = torch.Generator().manual_seed(s["field_seed"])
        low, high = s["field_range"]
        field = gaussian_random_field((H, W), low=low, high=high, generator=generator)[0]
        z = given[i]
        if kind == "relative":
            z = from_relative(z, s["near"], s["far"], s["gamma"])
        elif kind == "inverse":
            z = from_inverse(z, s["near"], s["far"])
        elif kind == "plane":
            z = torch.full_like(z, s["distance"])
        elif kind == "fill":
            z = fill_unknown(z)
        light = srgb_to_linear(image[i]) if color_space == "srgb" else image[i]
        expected = form_image(light, z, medium, field).image
        expected = linear_to_srgb(expected) if color_space == "srgb" else expected
        torch.testing.assert_close(out[i], expected, rtol=0, atol=1e-5)


def test_defaults_are_the_survey() -> None:
    aug, preset = RandomUnderwater(distance_kind="relative"), load_preset("survey", water="7C")
    assert list(aug.waters) == [t for t in JERLOV_TYPES if t != "I"]
    assert set(aug.waters.values()) == {1}
    assert (aug.near, aug.far, aug.gamma) == (preset.near, preset.far, preset.gamma)
    assert aug.field_range == preset.field_range
    assert aug.vertical_depth == preset.vertical_depth
    assert aug.point_spread == preset.medium.point_spread
    assert (aug.g, aug.mu, aug.field_probability, aug.mixing, aug.visibility, aug.blur_factor) == (
        0.2,
        0.3,
        1,
        0,
        None,
        1,
    )
    # and so the picture is the preset's
    aug = RandomUnderwater("7C", distance_kind="relative", color_space="linear")
    image, t = picture(), distances()
    record = aug.make_params(image)
    generator = torch.Generator().manual_seed(record["samples"][0]["field_seed"])
    expected = preset.module()(image, preset.distance(t), preset.field((1, 1, H, W), generator))
    torch.testing.assert_close(aug.transform(image, t, record), expected, rtol=0, atol=2e-3)


def test_p_0_returns_the_input() -> None:
    for options in ({}, {"same_on_batch": True}, {"distance": (1.0, 2.0)}):
        aug = RandomUnderwater(p=0.0, **options)
        for batch in (None, 3):
            image = picture(batch, torch.uint8)
            assert aug(image, distances(batch))[0] is image
            assert aug({"image": image, "distance": distances(batch)})["image"] is image
    calls = []
    aug = RandomUnderwater(p=0.0, distance=calls.append)
    image = picture(3)
    assert aug(image) is image
    assert not calls


def test_p_leaves_some_pictures_alone() -> None:
    seen = []
    aug = RandomUnderwater(p=0.5, distance=lambda x: seen.append(len(x)) or brightness(x) + 1)
    image = picture(40)
    record = aug.make_params(image)
    applied = torch.tensor([s["applied"] for s in record["samples"]])
    assert 5 < applied.sum() < 35
    out = aug.transform(image, None, record)
    assert torch.equal((out != image).flatten(1).any(1), applied)
    assert seen == [applied.sum()]


def test_same_on_batch() -> None:
    aug = RandomUnderwater(same_on_batch=True, **EVERYTHING)
    image, distance = picture().repeat(3, 1, 1, 1), (distances() + 1).repeat(3, 1, 1, 1)
    assert len(aug.make_params(image)["samples"]) == 1
    out, _ = aug(image, distance)
    assert torch.equal(out[0], out[1])
    assert torch.equal(out[0], out[2])
    out, _ = RandomUnderwater(**EVERYTHING)(image, distance)
    assert not torch.equal(out[0], out[1])


def test_record_of_one_picture_serves_a_batch() -> None:
    aug = RandomUnderwater(**EVERYTHING)
    image, distance = picture(3), distances(3) + 1
    record = aug.make_params(image[0])
    out = aug.transform(image, distance, record)
    for i in range(3):
        assert same(out[i], aug.transform(image[i], distance[i], record))


def test_one_map_serves_a_batch() -> None:
    aug = RandomUnderwater()
    image, distance = picture(3), distances() + 1
    record = aug.make_params(image)
    whole = aug.transform(image, distance.expand(3, 1, H, W), record)
    assert same(whole, aug.transform(image, distance, record))
    assert same(whole, aug.transform(image, distance[None], record))


def test_empty_batches_and_tiny_pictures() -> None:
    aug = RandomUnderwater(**EVERYTHING)
    image = picture(0)
    assert aug(image, distances(0))[0] is image
    for size in ((1, 1), (1, 9), (7, 1), (2, 3)):
        out, _ = aug(torch.rand(3, *size), torch.rand(1, *size) + 0.5)
        assert out.shape == (3, *size)
        assert out.isfinite().all()


def test_layouts() -> None:
    aug = RandomUnderwater()
    image, distance = picture(2), distances(2) + 1
    record = aug.make_params(image)
    expected = aug.transform(image, distance, record)
    for other in (
        image.to(memory_format=torch.channels_last),
        image.transpose(2, 3).contiguous().transpose(2, 3),
    ):
        torch.testing.assert_close(
            aug.transform(other, distance, record), expected, rtol=0, atol=1e-6
        )


def test_open_water_is_the_veil() -> None:
    aug = RandomUnderwater("7C")
    distance = torch.full((1, H, W), math.inf)
    record = aug.make_params(picture())
    out = aug.transform(picture(), distance, record)
    assert out.isfinite().all()
    assert (out.flatten(1).std(1) < 1e-6).all()


def test_map_or_plane_or_network() -> None:
    image, distance = picture(), distances() + 1
    aug = RandomUnderwater(distance=3.0)
    plane = aug.at(0, 0, 0)(image)
    assert isinstance(plane, Tensor)
    # in a dict a map goes before; in a tuple nothing is taken for one
    assert not torch.equal(aug.at(0, 0, 0)({"image": image, "distance": distance})["image"], plane)
    assert same(aug.at(0, 0, 0)({"image": image})["image"], plane)
    assert same(aug.at(0, 0, 0)({"image": image, "distance": None})["image"], plane)
    assert same(aug.at(0, 0, 0)(image, distance)[0], plane)
    assert same(RandomUnderwater().at(0, 0, 0)(image, torch.full((1, H, W), 3.0))[0], plane)
    network = RandomUnderwater(distance=brightness, distance_kind="relative")
    expected = RandomUnderwater(distance_kind="relative").at(0, 0, 0)(image, brightness(image))[0]
    assert same(network.at(0, 0, 0)(image), expected)
    assert torch.equal(network.at(0, 0, 0)(image[None])[0], expected)
    seen: list[Tensor] = []
    RandomUnderwater(distance=lambda x: seen.append(x) or brightness(x) + 1)(
        picture(dtype=torch.uint8)
    )
    assert seen[0].shape == (3, H, W)
    assert seen[0].is_floating_point()
    assert seen[0].max() <= 1
    module = torch.nn.Conv2d(3, 1, 1)
    out = RandomUnderwater(distance=torch.nn.Sequential(module, torch.nn.Softplus()))(image)
    assert out.isfinite().all()
    assert not out.requires_grad


def test_mask_after_kornia() -> None:
    flip = kornia.augmentation.AugmentationSequential(
        kornia.augmentation.RandomHorizontalFlip(p=1.0), data_keys=["input", "mask"]
    )
    image, distance, aug = picture(2), distances(2) + 1, RandomUnderwater()
    moved = flip(image, distance)
    assert isinstance(moved, list)
    out, z = aug.at(0, 0, 0)(moved)
    assert z is moved[1]
    assert torch.equal(z, distance.flip(-1))
    assert same(out, aug.at(0, 0, 0)(image.flip(-1), distance.flip(-1))[0])


def test_padding_is_unknown() -> None:
    turn = kornia.augmentation.AugmentationSequential(
        kornia.augmentation.RandomRotation((40.0, 40.0), p=1.0), data_keys=["input", "mask"]
    )
    moved = turn(picture(2), distances(2) + 1)
    with pytest.raises(ValueError, match=r"distance.* zero at \d+ of.*unknown='fill'"):
        RandomUnderwater()(moved)
    out, _ = RandomUnderwater(unknown="fill")(moved)
    assert out.isfinite().all()
    # where 0 is a distance, padding must be NaN
    t = distances()
    t[..., :5] = math.nan
    for kind in ("relative", "inverse"):
        with pytest.raises(ValueError, match=r"distance.*NaN at [1-9]\d*"):
            RandomUnderwater(distance_kind=kind)(picture(), t)
        out, _ = RandomUnderwater(distance_kind=kind, unknown="fill")(picture(), t)
        assert out.isfinite().all()


def test_relative_distance_0_is_near() -> None:
    t = torch.zeros(1, H, W)
    aug = RandomUnderwater(distance_kind="relative", near=0.0, vertical_depth=0.0)
    torch.testing.assert_close(aug(picture(), t)[0], picture(), rtol=0, atol=1e-4)


# Keys


def test_at_depends_on_its_key_alone() -> None:
    aug = RandomUnderwater(**EVERYTHING)
    keys = [(seed, epoch, index) for seed in range(2) for epoch in range(2) for index in range(3)]
    draw = {key: aug.at(*key) for key in keys}
    state = torch.get_rng_state()
    first = {key: draw[key](picture(), distances() + 1)[0] for key in keys}
    assert torch.equal(torch.get_rng_state(), state)
    torch.manual_seed(99)
    again = {key: draw[key](picture(), distances() + 1)[0] for key in reversed(keys)}
    assert all(same(first[key], again[key]) for key in keys)
    assert len({t.sum().item() for t in first.values()}) == len(keys)
    assert same(
        first[1, 0, 2], aug.at(np.int64(1), torch.tensor(0), 2)(picture(), distances() + 1)[0]
    )
    assert not torch.equal(first[1, 0, 2], aug.at(10, 2, 0)(picture(), distances() + 1)[0])
    pickle.loads(pickle.dumps(draw[keys[0]]))


def test_the_global_generator_decides_otherwise() -> None:
    aug = RandomUnderwater(**EVERYTHING)
    torch.manual_seed(5)
    a, b = (aug(picture(), distances() + 1)[0] for _ in range(2))
    torch.manual_seed(5)
    assert same(a, aug(picture(), distances() + 1)[0])
    assert not torch.equal(a, b)


def test_new_draws_go_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    aug = RandomUnderwater(**EVERYTHING)

    def records() -> list[Any]:
        return [aug.make_params(picture(b), torch.Generator().manual_seed(3)) for b in (None, 4)]

    before = records()
    monkeypatch.setattr(uwaug.draw, "_DRAWS", (*uwaug.draw._DRAWS, "new"))
    assert records() == before


# Distributions: 4000 draws from a fixed seed. A test at the 1 % level each; they either pass for good or never.

DRAWN = {
    **EVERYTHING,
    "distance_kind": "relative",
    "near": (0.5, 2.0),
    "far": (3.0, 9.0),
    "gamma": (1.0, 4.0),
    "distance": (0.5, 7.0),
}
RANGES = [name for name, value in DRAWN.items() if isinstance(value, tuple)]
WEIGHTS = {"II": 3.0, "1C": 1.0, "5C": 0.0, "9C": 2.0, TANK: 0.5}


@pytest.fixture(scope="module")
def drawn() -> list[dict[str, Any]]:
    aug = RandomUnderwater(
        WEIGHTS, p=0.3, field_probability=0.8, cameras=[LASERS, "Nikon 5100 (NPL)"], **DRAWN
    )
    generator = torch.Generator().manual_seed(20)
    one = [aug.make_params(picture(), generator)["samples"][0] for _ in range(1000)]
    return one + aug.make_params(torch.empty(3000, 3, 1, 1), generator)["samples"]


@pytest.mark.parametrize("name", RANGES)
def test_ranges_are_drawn_uniformly(name: str, drawn: list[dict[str, Any]]) -> None:
    from scipy.stats import kstest, loguniform, uniform

    low, high = DRAWN[name]
    law = loguniform(low, high) if name == "visibility" else uniform(low, high - low)
    values = [s[name] for s in drawn]
    assert low <= min(values)
    assert max(values) <= high
    assert kstest(values, law.cdf).pvalue > 0.01


def test_parameters_are_independent(drawn: list[dict[str, Any]]) -> None:
    values = np.array(
        [
            [s[name] for name in RANGES] + [*(w == "II" for w in s["waters"]), s["applied"]]
            for s in drawn
        ]
    )
    correlation = np.corrcoef(values.T) - np.eye(values.shape[1])
    assert np.abs(correlation).max() < 4 / math.sqrt(len(drawn))


@pytest.mark.parametrize("which", [0, 1], ids=["first", "second"])
def test_waters_are_drawn_by_weight(which: int, drawn: list[dict[str, Any]]) -> None:
    from scipy.stats import chisquare

    counts = {
        name: sum(s["waters"][which] == name for s in drawn) for name in ("II", "1C", "9C", "tank")
    }
    assert sum(counts.values()) == len(drawn)  # 5C has no weight
    expected = np.array([3.0, 1.0, 2.0, 0.5]) / 6.5 * len(drawn)
    assert chisquare(list(counts.values()), expected).pvalue > 0.01


def test_all_types_occur() -> None:
    from scipy.stats import chisquare

    samples = RandomUnderwater(JERLOV_TYPES).make_params(
        torch.empty(3000, 3, 1, 1), torch.Generator().manual_seed(1)
    )
    counts = [sum(s["waters"] == [t] for s in samples["samples"]) for t in JERLOV_TYPES]
    assert sum(counts) == 3000
    assert chisquare(counts).pvalue > 0.01


def test_camera_from_a_file(tmp_path: Path) -> None:
    table = tmp_path / "lasers.csv"
    table.write_text("450,0,0,1\n550,0,1,0\n600,1,0,0\n")
    aug = RandomUnderwater(cameras=table)
    assert aug.make_params(picture())["samples"][0]["camera"] == "lasers"
    assert same(result(aug), result(RandomUnderwater(cameras=LASERS)))
    assert same(result(aug), result(RandomUnderwater(cameras=str(table))))


def test_listed_twice_counts_twice() -> None:
    assert RandomUnderwater(["7C", "7C", "1C"]).waters == {"7C": 2, "1C": 1}


def test_probabilities(drawn: list[dict[str, Any]]) -> None:
    from scipy.stats import binomtest

    for count, share in (
        (sum(s["applied"] for s in drawn), 0.3),
        (sum(s["field_seed"] is not None for s in drawn), 0.8),
        (sum(s["camera"] == "lasers" for s in drawn), 0.5),
    ):
        assert binomtest(count, len(drawn), share).pvalue > 0.01
    seeds = [s["field_seed"] for s in drawn if s["field_seed"] is not None]
    assert len(set(seeds)) == len(seeds)


@pytest.mark.parametrize("bounds", [(0.7, 1.3), (0.0, 2.5), (1.2, 1.2)])
def test_field_spans_what_was_asked(
    bounds: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Tensor] = []
    prepare = uwaug.degrade.prepare
    monkeypatch.setattr(uwaug.degrade, "prepare", lambda *a: seen.append(a[3]) or prepare(*a))
    RandomUnderwater(field_range=bounds)(picture(5), distances(5) + 1)
    assert len(seen) == 5
    for field in seen:
        assert field.min().item() == pytest.approx(bounds[0])
        assert field.max().item() == pytest.approx(bounds[1])
    if bounds[0] < bounds[1]:
        assert not torch.equal(seen[0], seen[1])
    seen.clear()
    RandomUnderwater(field_probability=0.0)(picture(), distances() + 1)
    assert seen == [None]


# Severity


def contrast(image: Tensor) -> float:
    return float((image * image.new_tensor([0.2126, 0.7152, 0.0722]).view(3, 1, 1)).sum(-3).std())


def test_severity_grows(motorcycle: Any) -> None:
    image, distance = motorcycle.srgb[:, ::2, ::2].float(), motorcycle.distance[:, ::2, ::2].float()
    losses = []
    for level in range(1, 6):
        aug = RandomUnderwater.severity(level)
        results = [aug.at(0, 0, i)(image, distance)[0] for i in range(6)]
        losses.append(1 - np.mean([contrast(r) for r in results]) / contrast(image))
    assert np.diff(losses).min() > 0.05
    # as the docstring says
    np.testing.assert_allclose(losses, [0.46, 0.62, 0.75, 0.84, 0.93], atol=0.02)


def test_severity_takes_options() -> None:
    aug = RandomUnderwater.severity(3, waters="7C", distance=(1.0, 2.0), p=0.5)
    assert repr(aug) == "RandomUnderwater(['7C'], visibility=5.0, distance=(1.0, 2.0), p=0.5)"
    for level in (0, 6, 2.5, "3"):
        with pytest.raises(ValueError, match=f"level.*1 to 5.*{level}"):
            RandomUnderwater.severity(level)


# Errors


@pytest.mark.parametrize(
    "options, match",
    [
        ({"waters": []}, "waters.*at least one"),
        ({"waters": {}}, "waters.*at least one"),
        ({"waters": ["7C", "8C"]}, "one of I, IA.*'8C'"),
        ({"waters": {"7C": -1.0, "1C": 2.0}}, r"waters.*weights.*\[-1.0, 2.0\]"),
        ({"waters": {"7C": 0.0}}, r"waters.*weights.*\[0.0\]"),
        ({"waters": {"7C": math.nan}}, "waters.*weights.*nan"),
        ({"waters": ["7C", Water.jerlov("7C")]}, "waters.*name of its own"),
        ({"cameras": []}, "cameras.*at least one"),
        ({"cameras": "Kodak"}, "no camera.*Kodak"),
        ({"cameras": [LASERS, LASERS]}, "cameras.*name of its own"),
        ({"g": ()}, r"g must be.*got \(\)"),
        ({"g": (0.1, 0.2, 0.3)}, r"g must be.*got \(0.1, 0.2, 0.3\)"),
        ({"g": "much"}, "g must be.*got 'much'"),
        ({"g": (0.3, 0.2)}, r"g must be.*low ≤ high.*got \(0.3, 0.2\)"),
        ({"mu": 1.5}, r"mu must be.*\[0, 1\].*1.5"),
        ({"mixing": (-0.1, 1.0)}, r"mixing must be.*\(-0.1, 1.0\)"),
        ({"vertical_depth": -1}, "vertical_depth.*≥ 0.*-1"),
        ({"vertical_depth": math.inf}, "vertical_depth.*finite.*inf"),
        ({"blur_factor": math.nan}, "blur_factor.*nan"),
        ({"visibility": 0.0}, "visibility.*≥ 0.001.*0.0"),
        (
            {"visibility": (5.0, 500.0)},
            r"visibility=\(5.0, 500.0\) does not suit water 'IA'.*pure water",
        ),
        ({"waters": "I", "visibility": 5.0}, "visibility=5.0 does not suit water 'I'"),
        ({"field_range": (1.3, 0.7)}, r"field_range.*low ≤ high.*\(1.3, 0.7\)"),
        ({"field_range": (-0.1, 1.0)}, r"field_range.*≥ 0.*\(-0.1, 1.0\)"),
        ({"p": 1.1}, "p must be a probability.*1.1"),
        ({"p": math.nan}, "p must be a probability.*nan"),
        ({"field_probability": -0.5}, "field_probability must be.*-0.5"),
        ({"distance_kind": "disparity"}, r"distance_kind must be one of metric, .*'disparity'"),
        ({"unknown": "ignore"}, "unknown must be one of.*'ignore'"),
        ({"color_space": "rgb"}, "color_space must be one of.*'rgb'"),
        ({"order": "backwards"}, "order must be one of.*'backwards'"),
        ({"near": 0.5}, "near would do nothing.*'metric', got 0.5"),
        ({"distance_kind": "inverse", "gamma": 2.0}, "gamma would do nothing.*'inverse', got 2.0"),
        ({"mu": None}, "mu must be.*None"),
        ({"g": abs}, "g must be.*abs"),
        (
            {"distance_kind": "relative", "near": (1.0, 6.0)},
            r"near must lie below far.*\(1.0, 6.0\).*5.0",
        ),
        ({"distance_kind": "relative", "gamma": 0.0}, "gamma must be.*0.0"),
        ({"distance_kind": "relative", "far": math.inf}, "far must be.*inf"),
        ({"distance_kind": "inverse", "near": 0.0}, "near must lie above 0 m.*0.0"),
        ({"distance": (3.0, 1.0)}, r"distance must be.*\(3.0, 1.0\)"),
        ({"distance": "far"}, "distance must be.*'far'"),
        ({"tolerance": 0.0}, r"tolerance must lie in \(0, 1\).*0.0"),
        ({"tolerance": math.nan}, "tolerance.*nan"),
    ],
)
def test_construction_rejects(options: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        RandomUnderwater(**options)


def test_point_spread_must_be_one() -> None:
    with pytest.raises(TypeError, match="point_spread must be a uwaug.PointSpread, got float"):
        RandomUnderwater(point_spread=0.3)


@pytest.mark.parametrize(
    "image, distance, error, match",
    [
        (
            picture(),
            distances()[:, :20],
            ValueError,
            rf"distance is \(20, {W}\) but image is \({H}, {W}\)",
        ),
        (picture(3), distances(2), ValueError, "distance is a batch of 2 but image is one of 3"),
        (picture(), distances(2), ValueError, "distance is a batch of 2 but image is one of 1"),
        (
            picture(),
            distances()[0],
            ValueError,
            rf"distance must have shape \(1, H, W\).*\({H}, {W}\)",
        ),
        (
            picture(),
            distances().expand(3, H, W),
            ValueError,
            rf"distance must have shape.*\(3, {H}, {W}\)",
        ),
        (
            255 * picture(),
            distances(),
            ValueError,
            r"image reaches 2\d\d.*: expected 0…1; divide a 0…255 image by 255",
        ),
        (
            picture()[:1],
            distances(),
            ValueError,
            rf"image must have shape \(3, H, W\).*\(1, {H}, {W}\)",
        ),
        (
            picture(4).transpose(0, 1),
            distances(3),
            ValueError,
            rf"image must have.*\(3, 4, {H}, {W}\)",
        ),
        (picture()[0], distances(), ValueError, rf"image must have shape.*\({H}, {W}\)"),
        (
            picture().long(),
            distances(),
            TypeError,
            "image must be a floating-point tensor, got torch.int64; or uint8",
        ),
        (picture().numpy(), distances(), TypeError, "image must be.*ndarray.*Convert"),
        (
            picture(),
            distances() - 0.5,
            ValueError,
            r"distance must be above 0 m.* negative at [1-9]\d*.*unknown='fill'",
        ),
        (
            picture(),
            distances() * math.nan,
            ValueError,
            rf"distance must be above 0 m.*NaN at {H * W}",
        ),
        (
            picture(),
            (1000 * distances()).int(),
            TypeError,
            "distance must be a floating.*int32.*millimetres by 1000",
        ),
        (
            picture(),
            distances().numpy(),
            TypeError,
            "distance must be a floating-point tensor, got ndarray",
        ),
        (picture(), None, ValueError, "distance is missing"),
    ],
)
def test_inputs_are_checked(image: Any, distance: Any, error: type[Exception], match: str) -> None:
    for aug in (RandomUnderwater(), RandomUnderwater(same_on_batch=True)):
        with pytest.raises(error, match=match):
            aug(image, distance)


def test_shapes_are_checked_whatever_is_drawn() -> None:
    with pytest.raises(ValueError, match="height and width must agree"):
        RandomUnderwater(p=0.0)(picture(), distances()[:, 1:])


@pytest.mark.parametrize(
    "options, sample, match",
    [
        (
            {},
            {"image": picture(), "depth": distances()},
            "no 'distance', only 'image', 'depth'.*distance_key",
        ),
        (
            {},
            {"rgb": picture(), "distance": distances()},
            "no 'image', only 'rgb', 'distance'.*image_key",
        ),
        ({"distance": 2.0}, {"rgb": picture()}, "no 'image', only 'rgb'"),
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


def test_nothing_at_all() -> None:
    with pytest.raises(ValueError, match="sample is empty"):
        RandomUnderwater()()


def changed(**values: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda record: {"samples": [{**record["samples"][0], **values}]}


@pytest.mark.parametrize(
    "change, error, match",
    [
        (
            lambda r: {"samples": r["samples"] * 2},
            ValueError,
            "params has 2 samples but image is a batch of 3",
        ),
        (lambda r: {"samples": []}, ValueError, "params has 0 samples but image is a batch of 3"),
        (lambda r: r["samples"], TypeError, "params must be a record from make_params"),
        (lambda r: None, TypeError, "params must be a record.*None"),
        (changed(waters=["II"]), ValueError, "params asks for 'II', but this transform has 7C, 9C"),
        (
            changed(camera="Kodak"),
            ValueError,
            "params asks for 'Kodak', but this transform has Nikon",
        ),
        (
            lambda r: {"samples": [{"applied": True}]},
            ValueError,
            "params is of a transform with other options.*camera",
        ),
    ],
)
def test_records_are_checked(
    change: Callable[[Any], Any], error: type[Exception], match: str
) -> None:
    aug = RandomUnderwater(["7C", "9C"])
    with pytest.raises(error, match=match):
        aug.transform(picture(3), distances(3), change(aug.make_params(picture())))


def test_records_of_other_transforms() -> None:
    plain, scaled = RandomUnderwater(), RandomUnderwater(distance_kind="relative")
    for one, other in ((plain, scaled), (scaled, plain)):
        with pytest.raises(
            ValueError, match=r"params is of a transform with other options.* far, gamma, near"
        ):
            one.transform(picture(), distances(), other.make_params(picture()))
    with pytest.raises(ValueError, match=r"other options.* visibility"):
        plain.transform(
            picture(), distances(), RandomUnderwater(visibility=3.0).make_params(picture())
        )


def test_record_is_plain() -> None:
    aug = RandomUnderwater([TANK, "7C"], cameras=[LASERS], distance=(1.0, 2.0), **EVERYTHING)

    def walk(value: Any) -> Iterator[Any]:
        parts = (
            value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        )
        yield value
        for part in parts:
            yield from walk(part)

    record = aug.make_params(picture(4))
    assert {type(v) for v in walk(record)} <= {dict, list, str, bool, int, float}
    assert list(record) == ["samples"]


def test_media_are_shared() -> None:
    # a transform with few waters and fixed numbers builds few media, however many pictures
    uwaug.degrade._medium.cache_clear()
    aug = RandomUnderwater(["7C", "1C"])
    for i in range(20):
        aug.at(0, 0, i)(picture(), distances() + 1)
    assert uwaug.degrade._medium.cache_info().misses == 2


# torchvision, where it is installed; what it does with tensors is tested with subclasses of our own above


@pytest.fixture(scope="module")
def torchvision() -> Any:
    if find_spec("torchvision") is None:
        pytest.skip("torchvision is not installed")
    try:
        import torchvision
    except RuntimeError:
        # built for another torch: without its compiled part, its Python part misses two operators
        torch.library.define(
            "torchvision::nms", "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"
        )
        torch.library.define(
            "torchvision::qnms", "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"
        )
        import torchvision
    import torchvision.transforms.v2

    return torchvision


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
    for sample in (
        (image, distance, label),
        {"image": image, "distance": distance, "label": label},
    ):
        out = pipeline(sample)
        seen, z, same_label = out.values() if isinstance(out, dict) else out
        assert type(out) is type(sample)
        assert same_label is label
        assert type(seen) is tv.Image
        assert type(z) is tv.Mask
        assert seen.shape == (3, 20, 28)
        assert seen.isfinite().all()
        assert set(z.flatten().tolist()) <= values  # moved, not jittered
    seen, z, _ = pipeline(image, distance, label)
    assert type(seen) is tv.Image
    assert type(z) is tv.Mask


def test_torchvision_padding(torchvision: Any) -> None:
    v2, tv = torchvision.transforms.v2, torchvision.tv_tensors
    image, distance = tv.Image(picture()), tv.Mask(distances() + 1)
    padded = v2.Pad(4)(image, distance)
    with pytest.raises(ValueError, match="zero"):
        RandomUnderwater()(padded)
    out, _ = RandomUnderwater(unknown="fill")(padded)
    assert out.isfinite().all()
    relative = v2.Pad(4, fill={tv.Image: 0, tv.Mask: math.nan})(image, tv.Mask(distances()))
    out, _ = RandomUnderwater(distance_kind="relative", unknown="fill")(relative)
    assert out.isfinite().all()
