import json
import math
import threading
from typing import Any

import kornia
import numpy as np
import pytest
import torch
from augmenting import EVERYTHING, TANK, H, W, distances, picture, same
from torch import Tensor

import uwaug.transforms.prepare
from uwaug import Medium, PointSpread, RandomUnderwater, Water, form_image
from uwaug._support.deterministic import reproducible
from uwaug.distance.convert import fill_unknown, from_inverse, from_relative
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear
from uwaug.formation.exposure import metering_points
from uwaug.formation.field import gaussian_random_field


@pytest.mark.parametrize("kind", ["metric", "relative", "inverse", "plane", "fill"])
@pytest.mark.parametrize("color_space", ["srgb", "linear"])
def test_transform_is_form_image(kind: str, color_space: str) -> None:
    options: dict[str, Any] = {"color_space": color_space, **EVERYTHING}
    if kind in ("relative", "inverse"):
        options |= {"distance_kind": kind, "near": (0.5, 1.0), "far": (3.0, 6.0)}
    elif kind != "metric":
        options |= {"distance": (1.0, 4.0)} if kind == "plane" else {"unknown": "fill"}
    aug = RandomUnderwater.survey(waters=["II", "7C", TANK], **options)
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
        if color_space == "srgb":
            expected = linear_to_srgb(expected).clamp(0, 1)
        torch.testing.assert_close(out[i], expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("focal_px", [None, 40.0])
def test_default_is_the_calibrated_model_exposed(focal_px: float | None) -> None:
    aug = RandomUnderwater(["II", "7C"], focal_px=focal_px, field_probability=0.0, tolerance=1e-4)
    image, distance = picture(2), 1 + 4 * distances(2)
    record = aug.resolve(image, distance, aug.make_params(image))
    out = aug.transform(image, distance, record)
    for i, s in enumerate(record["samples"]):
        used, z = s["used"], distance[i]
        water = Water.jerlov(s["waters"][0]).at(np.arange(400, 701, 5))
        middle = z.flatten()[metering_points(H, W, z.device)].median()
        # the share of luminance contrast that is left at the middle distance, as drawn
        scaled = water.with_visibility(used["visibility"])
        assert scaled.contrast(float(middle)) == pytest.approx(s["contrast"], rel=1e-4)
        law = PointSpread.calibrated(focal_px or W / 2 / math.tan(math.radians(30)))
        numbers = {"vertical_depth": used["vertical_depth"], "g": s["g"], "mu": s["mu"]}
        assert numbers["vertical_depth"] <= s["vertical_depth"]
        medium = Medium.from_water(scaled, **numbers, point_spread=law, tolerance=1e-4)
        light = srgb_to_linear(image[i])
        expected = used["gain"] * form_image(light, z, medium, tolerance=1e-4).image
        expected = linear_to_srgb(expected).clamp(0, 1)
        torch.testing.assert_close(out[i], expected, rtol=0, atol=2e-3)


def test_contrast_stops_at_pure_water() -> None:
    aug = RandomUnderwater("1C", contrast=0.9, field_probability=0.0)
    image, distance = picture(), torch.full((1, H, W), 30.0)
    used = aug.resolve(image, distance, aug.make_params(image))["samples"][0]["used"]
    assert used["contents"] == 0
    assert used["visibility"] == pytest.approx(88.3, abs=0.1)
    # and open water alone has no middle distance
    distance.fill_(math.inf)
    used = aug.resolve(image, distance, aug.make_params(image))["samples"][0]["used"]
    assert used["contents"] == 1


def test_resolved_records_replay_and_may_be_edited() -> None:
    aug = RandomUnderwater()
    image, distance = picture(2), 1 + 4 * distances(2)
    record = aug.make_params(image)
    out = aug.transform(image, distance, record)
    resolved = json.loads(json.dumps(aug.resolve(image, distance, record)))
    assert same(aug.transform(image, distance, resolved), out)
    assert "used" not in record["samples"][0]
    # what was used serves another picture: the gain is kept
    resolved["samples"][0]["used"]["gain"] /= 4
    dark = aug.transform(image, distance, resolved)
    assert dark[0].mean() < 0.7 * out[0].mean()
    assert same(dark[1], out[1])


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
        assert same(aug.transform(other, distance, record), expected)


def test_arrays_as_files_give_them_replay() -> None:
    # views with height, width and channels in this order, at a size where kernels' paths differ
    aug = RandomUnderwater("7C")
    generator = torch.Generator().manual_seed(3)
    image = torch.rand(500, 741, 3, generator=generator).permute(2, 0, 1)
    distance = (1 + 4 * torch.rand(741, 500, generator=generator)).T[None]
    record = aug.make_params(image)
    expected = aug.transform(image.contiguous(), distance.contiguous(), record)
    assert same(aug.transform(image, distance, record), expected)


@pytest.mark.parametrize("precision", ["high", "medium"])
def test_matmul_precision_does_not_show(precision: str) -> None:
    aug, image, distance = RandomUnderwater("9C"), picture(), distances() + 1
    record = aug.make_params(image)
    expected = aug.transform(image, distance, record)
    before = torch.get_float32_matmul_precision()
    try:
        torch.set_float32_matmul_precision(precision)
        assert same(aug.transform(image, distance, record), expected)
        assert torch.get_float32_matmul_precision() == precision
    finally:
        torch.set_float32_matmul_precision(before)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float16, torch.bfloat16])
def test_default_dtype_does_not_show(dtype: torch.dtype) -> None:
    aug, image, distance = RandomUnderwater(), picture(), distances() + 1
    record = aug.make_params(image)
    expected = aug.transform(image, distance, record)
    before = torch.get_default_dtype()
    try:
        torch.set_default_dtype(dtype)
        assert same(aug.transform(image, distance, record), expected)
    finally:
        torch.set_default_dtype(before)


def test_threads_are_given_back_to_all() -> None:
    """Threads that enter while another is inside get back what there was before the first."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    first_in, may_leave, seen = threading.Event(), threading.Event(), []

    def hold() -> None:
        with reproducible():
            first_in.set()
            may_leave.wait(10)
        seen.append(torch.get_num_threads())

    def pass_through() -> None:
        first_in.wait(10)
        with reproducible():
            seen.append(-torch.get_num_threads())
        seen.append(torch.get_num_threads())
        may_leave.set()

    try:
        workers = [threading.Thread(target=hold), threading.Thread(target=pass_through)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        later: list[int] = []
        fresh = threading.Thread(target=lambda: later.append(torch.get_num_threads()))
        fresh.start()
        fresh.join()
    finally:
        torch.set_num_threads(before)
    assert seen == [-1, 2, 2]
    assert later == [2]


def test_open_water_is_the_veil() -> None:
    aug = RandomUnderwater("7C")
    distance = torch.full((1, H, W), math.inf)
    record = aug.make_params(picture())
    out = aug.transform(picture(), distance, record)
    assert out.isfinite().all()
    assert (out.flatten(1).std(1) < 1e-6).all()


def test_relative_distance_0_is_near() -> None:
    t = torch.zeros(1, H, W)
    aug = RandomUnderwater.survey(distance_kind="relative", near=0.0, vertical_depth=0.0)
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
    prepare = uwaug.transforms.prepare.prepare
    monkeypatch.setattr(
        uwaug.transforms.prepare, "prepare", lambda *a: seen.append(a[3]) or prepare(*a)
    )
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
    uwaug.transforms.prepare._kept_medium.cache_clear()
    aug = RandomUnderwater.survey(waters=["7C", "1C"])
    for i in range(20):
        aug.at(0, 0, i)(picture(), distances() + 1)
    assert uwaug.transforms.prepare._kept_medium.cache_info().misses == 2


@pytest.mark.parametrize("name", ["mixing", "visibility", "vertical_depth", "g", "mu", "contrast"])
def test_media_that_come_once_are_not_kept(name: str) -> None:
    # they would pin the heap between the pictures of a loader
    uwaug.transforms.prepare._kept_medium.cache_clear()
    options = {"contrast": None, "vertical_depth": 1.0, "g": 0.1, "mu": 0.1, name: (0.5, 0.9)}
    aug = RandomUnderwater(["7C", "1C"], **options)
    for i in range(3):
        aug.at(0, 0, i)(picture(), distances() + 1)
    assert uwaug.transforms.prepare._kept_medium.cache_info().currsize == 0


# What unknown pixels get


@pytest.mark.parametrize("instead", ["far", 7.5, np.float32(2.0), 3])
@pytest.mark.parametrize("kind", ["metric", "relative", "inverse"])
def test_unknown_pixels_get_what_was_asked(instead: Any, kind: str) -> None:
    options: dict[str, Any] = {} if kind == "metric" else {"near": 1.0, "far": 4.0}
    aug = RandomUnderwater("7C", unknown=instead, distance_kind=kind, **options)
    given = distances(2) + (1 if kind == "metric" else 0)
    given[0, :, 3:9, 5:20] = math.nan
    given[1] = math.nan
    z = {
        "metric": lambda: given,
        "relative": lambda: from_relative(given, 1.0, 4.0),
        "inverse": lambda: torch.stack([from_inverse(given[0], 1.0, 4.0), given[1]]),
    }[kind]()
    known = torch.where(z > 0, z, math.inf if instead == "far" else float(instead))
    record = aug.make_params(picture(2))
    metric = RandomUnderwater("7C")
    bare = {"near", "far", "gamma"}
    samples = [{k: v for k, v in s.items() if k not in bare} for s in record["samples"]]
    expected = metric.transform(picture(2), known, {"samples": samples})
    assert same(aug.transform(picture(2), given, record), expected)


def silent_maps(kind: str) -> Tensor:
    """Three maps; the middle one tells nothing."""
    maps = distances(3) + (1 if kind == "metric" else 0)
    maps[0, :, 2:4, 5:9] = math.nan
    maps[1] = 0.5 if kind == "inverse" else math.nan
    if kind == "metric":
        maps[1, :, ::2] = 0.0
        maps[1, :, ::3] = -1.0
    return maps


@pytest.mark.parametrize("same_on_batch", [False, True])
@pytest.mark.parametrize("kind", ["metric", "relative", "inverse"])
def test_a_picture_whose_map_tells_nothing_is_skipped(kind: str, same_on_batch: bool) -> None:
    options = {"distance_kind": kind, "same_on_batch": same_on_batch}
    aug, fill = (RandomUnderwater(unknown=u, **options) for u in ("skip", "fill"))
    image, maps = picture(3), silent_maps(kind)
    drawn = aug.make_params(image, torch.Generator().manual_seed(1))
    told = aug.resolve(image, maps, drawn)
    assert [s["applied"] for s in told["samples"]] == [True, False, True]
    out = aug.transform(image, maps, drawn)
    assert same(out, aug.transform(image, maps, told))
    assert same(out[1], image[1])
    others = {"samples": [told["samples"][i] for i in (0, 2)]}
    assert same(out[[0, 2]], fill.transform(image[[0, 2]], maps[[0, 2]], others))
    with pytest.raises(ValueError, match=r"^picture 1 of 3, counted from 0: .*unknown='skip'"):
        fill.transform(image, maps, drawn)
    levels = picture(3, torch.uint8)
    assert same(aug.transform(levels, maps, drawn)[1], levels[1])
    assert same(aug(image[1], maps[1])[0], image[1])


def applied(image: Tensor, maps: Tensor, **options: Any) -> list[bool]:
    aug = RandomUnderwater(**options)
    samples = aug.resolve(image, maps, aug.make_params(image))["samples"]
    return [sample["applied"] for sample in samples]


def test_records_say_what_is_skipped_only_where_it_is() -> None:
    image, maps = picture(3), silent_maps("metric")
    for unknown in ("far", 3.0):
        assert applied(image, maps, unknown=unknown) == [True] * 3
    assert applied(image, maps, unknown="skip", p=0.0) == [False] * 3
    assert applied(image[1], maps[1], unknown="skip") == [False]
    assert applied(image, maps[1], unknown="skip") == [False] * 3
    with pytest.raises(ValueError, match="height and width must agree"):
        applied(image, maps[..., 1:], unknown="skip")


def test_refusals_name_the_picture() -> None:
    maps = distances(3) + 1
    maps[2, 0, 4, 5] = math.nan
    with pytest.raises(ValueError, match=r"^picture 2 of 3, counted from 0: distance must be ab"):
        RandomUnderwater()(picture(3), maps)
    with pytest.raises(ValueError, match=r"^distance must be above 0 m"):
        RandomUnderwater()(picture(), maps[2])
    image = picture(3)
    image[1, 0, 0, 0] = math.nan
    with pytest.raises(ValueError, match=r"^picture 1 of 3, counted from 0: image is NaN at 1 and"):
        RandomUnderwater()(image, distances(3) + 1)


@pytest.mark.parametrize("unknown", [0, -1.0, math.nan, math.inf, True, None, "ignore", [3.0]])
def test_what_unknown_may_be(unknown: Any) -> None:
    with pytest.raises(ValueError, match="unknown must be"):
        RandomUnderwater(unknown=unknown)


@pytest.mark.parametrize("color_space", ["srgb", "linear"])
def test_what_no_picture_and_no_map_of_metres_holds(color_space: Any) -> None:
    aug = RandomUnderwater(color_space=color_space)
    with pytest.raises(ValueError, match=r"distance must be in metres.*divide by 1000"):
        aug(picture(), 1000 * (distances() + 2))
    holed = 1000 * (distances() + 2)
    holed[:, :8] = 0.0
    for unknown in ("fill", "far", 4.0, "skip"):
        with pytest.raises(ValueError, match=r"distance must be in metres.*divide by 1000"):
            RandomUnderwater(color_space=color_space, unknown=unknown)(picture(), holed)
    for value in (math.nan, math.inf, -math.inf):
        image = picture()
        image[2, 3, 4] = value
        with pytest.raises(ValueError, match=r"image is NaN at . and infinite at . of .* values"):
            aug(image, distances() + 1)
