import math
from typing import Any

import kornia
import numpy as np
import pytest
import torch
from augmenting import EVERYTHING, TANK, H, W, distances, picture, same
from torch import Tensor

import uwaug.degrade
from uwaug import Medium, PointSpread, RandomUnderwater, Water, form_image
from uwaug.colour import linear_to_srgb, srgb_to_linear
from uwaug.distance import fill_unknown, from_inverse, from_relative
from uwaug.field import gaussian_random_field


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
        # visibility is scaled on the bands of the medium, where pure water is no broken line of
        # 25 nm pieces
        bands = np.arange(400, 701, 5)
        waters = [TANK if name == "tank" else Water.jerlov(name) for name in s["waters"]]
        first, second = (water.at(bands) for water in waters)
        water = first.mix(second, s["mixing"]).with_visibility(s["visibility"])
        law = PointSpread.paper(0.3 * s["blur_factor"])
        numbers = {name: s[name] for name in ("vertical_depth", "g", "mu")}
        medium = Medium.from_water(water, s["camera"], **numbers, point_spread=law)
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


# the curve from light to sRGB is steep at black
ROUNDING = {torch.float16: 6e-4, torch.bfloat16: 5e-3, torch.float32: 2e-5, torch.float64: 0}


@pytest.mark.parametrize("dtype", [torch.uint8, *ROUNDING])
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
        assert (out.double() - exact).abs().max() <= ROUNDING[dtype]


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


def test_layouts() -> None:
    aug = RandomUnderwater()
    image, distance = picture(2), distances(2) + 1
    record = aug.make_params(image)
    expected = aug.transform(image, distance, record)
    last = image.to(memory_format=torch.channels_last)
    turned = image.transpose(2, 3).contiguous().transpose(2, 3)
    for other in (last, turned):
        out = aug.transform(other, distance, record)
        torch.testing.assert_close(out, expected, rtol=0, atol=1e-6)


def test_open_water_is_the_veil() -> None:
    aug = RandomUnderwater("7C")
    distance = torch.full((1, H, W), math.inf)
    record = aug.make_params(picture())
    out = aug.transform(picture(), distance, record)
    assert out.isfinite().all()
    assert (out.flatten(1).std(1) < 1e-6).all()


def test_relative_distance_0_is_near() -> None:
    t = torch.zeros(1, H, W)
    aug = RandomUnderwater(distance_kind="relative", near=0.0, vertical_depth=0.0)
    torch.testing.assert_close(aug(picture(), t)[0], picture(), rtol=0, atol=1e-4)


def test_padding_is_unknown() -> None:
    rotation = kornia.augmentation.RandomRotation((40.0, 40.0), p=1.0)
    turn = kornia.augmentation.AugmentationSequential(rotation, data_keys=["input", "mask"])
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


def test_media_are_shared() -> None:
    # a transform with few waters and fixed numbers builds few media, however many pictures
    uwaug.degrade._kept_medium.cache_clear()
    aug = RandomUnderwater(["7C", "1C"])
    for i in range(20):
        aug.at(0, 0, i)(picture(), distances() + 1)
    assert uwaug.degrade._kept_medium.cache_info().misses == 2


@pytest.mark.parametrize("name", ["mixing", "visibility", "vertical_depth", "g", "mu"])
def test_media_that_come_once_are_not_kept(name: str) -> None:
    # they would pin the heap between the pictures of a loader
    uwaug.degrade._kept_medium.cache_clear()
    aug = RandomUnderwater(["7C", "1C"], **{name: (0.5, 0.9)})
    for i in range(3):
        aug.at(0, 0, i)(picture(), distances() + 1)
    assert uwaug.degrade._kept_medium.cache_info().currsize == 0
