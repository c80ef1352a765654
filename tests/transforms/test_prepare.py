import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import kornia
import numpy as np
import pytest
import torch
from augmenting import EVERYTHING, TANK, H, W, distances, picture, same
from torch import Tensor

import uwaug.transforms.prepare
from uwaug import Medium, PointSpread, RandomUnderwater, Water, form_image
from uwaug.distance.convert import fill_unknown, from_inverse, from_relative
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear
from uwaug.formation.exposure import metering_points
from uwaug.formation.field import gaussian_random_field
from uwaug.transforms.prepare import kept_medium


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
    options: dict[str, Any] = {"field_probability": 0.0, "tolerance": 1e-4}
    aug = RandomUnderwater.hazy(waters=["II", "7C"], focal_px=focal_px, **options)
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


def test_it_is_said_once_that_nothing_is_left_to_see(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uwaug.transforms.prepare, "_LOOKS", 4)
    monkeypatch.setattr(uwaug.transforms.prepare, "_looked", [])
    good = RandomUnderwater()
    blank = RandomUnderwater("3C", contrast=None, field_probability=0.0)
    image, distance = picture(), torch.full((1, H, W), 3.0)
    # what lies far away is hidden in many a good draw, and open water shows nothing anyway
    distance[:, : H // 4], distance[:, H // 2 :] = 12.0, math.inf
    good(image, distance)
    words = r"less than 3 % of .*distance is 30 m, the visibility 3\.35 m: are distances metres\?"
    with pytest.warns(UserWarning, match=words):
        blank(image, 10 * distance.clamp(max=3.0))
    blank(image, 10 * distance.clamp(max=3.0))
    # a few pictures tell: a look takes time
    monkeypatch.setattr(uwaug.transforms.prepare, "_looked", [None] * 4)
    blank(image, 10 * distance)


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


def test_resolved_records_may_be_edited() -> None:
    aug = RandomUnderwater()
    image, distance = picture(2), 1 + 4 * distances(2)
    record = aug.make_params(image)
    out = aug.transform(image, distance, record)
    resolved = aug.resolve(image, distance, record)
    # what was used serves another picture: the gain is kept
    resolved["samples"][0]["used"]["gain"] /= 4
    dark = aug.transform(image, distance, resolved)
    assert dark[0].mean() < 0.7 * out[0].mean()
    assert same(dark[1], out[1])


def test_half_precision_maps() -> None:
    aug, image, distance = RandomUnderwater.hazy(), picture(), 1 + 4 * distances()
    record = aug.make_params(image)
    exact = aug.transform(image, distance, record)
    for dtype, error in ((torch.float16, 2e-3), (torch.bfloat16, 2e-2), (torch.float64, 1e-6)):
        assert (aug.transform(image, distance.to(dtype), record) - exact).abs().max() < error
        half = aug.transform(image.to(dtype), distance.to(dtype), record)
        assert half.dtype == dtype
        assert (half - exact).abs().max() < 2 * error


@contextmanager
def setting(get: Callable[[], Any], set: Callable[[Any], Any], value: Any) -> Iterator[None]:
    """A setting of the process, put back at the end."""
    before = get()
    set(value)
    try:
        yield
        assert get() == value
    finally:
        set(before)


SETTINGS: dict[str, Callable[[], Any]] = {
    "autocast": lambda: torch.autocast("cpu", dtype=torch.bfloat16),
    "inference": torch.inference_mode,
    **{
        f"{n} threads": partial(setting, torch.get_num_threads, torch.set_num_threads, n)
        for n in (1, 2, 3, 5)
    },
    **{
        precision: partial(
            setting,
            torch.get_float32_matmul_precision,
            torch.set_float32_matmul_precision,
            precision,
        )
        for precision in ("high", "medium")
    },
    **{
        str(dtype): partial(setting, torch.get_default_dtype, torch.set_default_dtype, dtype)
        for dtype in (torch.float64, torch.bfloat16)
    },
}


@pytest.mark.parametrize("name", SETTINGS)
def test_settings_of_the_process_do_not_show(name: str) -> None:
    # a size at which exp2 and pow, left to themselves, differ in the last bit
    generator = torch.Generator().manual_seed(4)
    image = torch.rand(3, 203, 301, generator=generator)
    distance = 1 + 4 * torch.rand(1, 203, 301, generator=generator)
    aug = RandomUnderwater("9C")
    record = aug.make_params(image)
    expected = aug.transform(image.requires_grad_(), distance, record)
    assert not expected.requires_grad
    with SETTINGS[name]():
        assert same(aug.transform(image.detach(), distance, record), expected)


def test_layouts_replay() -> None:
    # views with height, width and channels in this order, as files give them, at a size where
    # kernels' paths differ
    generator = torch.Generator().manual_seed(3)
    aug, image = RandomUnderwater("7C"), torch.rand(500, 741, 3, generator=generator)
    distance = (1 + 4 * torch.rand(741, 500, generator=generator)).T[None]
    view = image.permute(2, 0, 1)
    record = aug.make_params(view)
    expected = aug.transform(view.contiguous(), distance.contiguous(), record)
    assert same(aug.transform(view, distance, record), expected)
    last = view[None].to(memory_format=torch.channels_last)
    assert same(aug.transform(last, distance, record)[0], expected)


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
def test_field_spans_what_was_asked(bounds: tuple[float, float]) -> None:
    image, distance = picture(3), distances(3) + 1

    def fields(**options: Any) -> list[Tensor]:
        aug = RandomUnderwater(**options)
        z = aug.in_water(image, distance, aug.make_params(image), lambda wet: wet.scene.z)
        return [z[i][0] / distance[i] for i in range(3)]

    drawn = fields(field_range=bounds)
    for field in drawn:
        assert field.min().item() == pytest.approx(bounds[0])
        assert field.max().item() == pytest.approx(bounds[1])
    assert torch.allclose(drawn[0], drawn[1]) == (bounds[0] == bounds[1])
    assert all((field == 1).all() for field in fields(field_probability=0.0))


def test_media_are_shared() -> None:
    # a transform with few waters and fixed numbers builds few media, however many pictures
    kept_medium.cache_clear()
    aug = RandomUnderwater.survey(waters=["7C", "1C"])
    for i in range(20):
        aug.at(0, 0, i)(picture(), distances() + 1)
    assert kept_medium.cache_info().misses == 2


@pytest.mark.parametrize("name", ["mixing", "visibility", "vertical_depth", "g", "mu", "contrast"])
def test_media_that_come_once_are_not_kept(name: str) -> None:
    # they would pin the heap between the pictures of a loader
    kept_medium.cache_clear()
    options = {"contrast": None, "vertical_depth": 1.0, "g": 0.1, "mu": 0.1, name: (0.5, 0.9)}
    aug = RandomUnderwater(["7C", "1C"], **options)
    for i in range(3):
        aug.at(0, 0, i)(picture(), distances() + 1)
    assert kept_medium.cache_info().currsize == 0


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
