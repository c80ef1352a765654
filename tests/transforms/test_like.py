"""`like`: draws that are kept as they look like a photograph."""

import json
import pickle
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from augmenting import QUIET, RAW, flat, same
from torch import Tensor

import uwaug
from uwaug import MarineSnow, RandomLight, RandomUnderwater, RandomWater, Sensor, View
from uwaug.distance import MadeUp
from uwaug.formation.colour import srgb_to_linear
from uwaug.transforms import Conditions, RandomDevelopment
from uwaug.transforms.appearance import WATER_FEATURES, unlikeness, water_features
from uwaug.transforms.conditions import laid_over

H, W = 32, 48
FEW: dict[str, Any] = {"draws": 90, "keep": 3}


def pictures(count: int, seed: int = 0) -> Tensor:
    """Coloured patches on a ramp of light."""
    patches = torch.rand(count, 3, 4, 6, generator=torch.Generator().manual_seed(seed))
    grown = torch.nn.functional.interpolate(patches, (H, W))
    return grown * torch.linspace(0.3, 1, W)


def maps(count: int) -> Tensor:
    return torch.linspace(1, 6, H * W).reshape(1, 1, H, W).repeat(count, 1, 1, 1)


def in_water(water: str, contrast: float) -> Tensor:
    """What stands for a photograph: another picture in one water."""
    noun = RandomWater(water, contrast=contrast)
    augment = RandomUnderwater(noun, light=None, development=QUIET, conditions=None)
    wet: Tensor = augment.at(0, 0, 5)(pictures(1, 9), maps(1))[0][0]
    return wet


def far(augment: RandomUnderwater) -> float:
    """How far draws on other pictures are from the photograph, in standard deviations."""
    goal, found = water_features(GREEN.permute(1, 2, 0).numpy()), []
    for i, (image, z) in enumerate(zip(pictures(18, 3), maps(18), strict=True)):
        numbers = water_features(augment.at(0, 0, i)(image, z)[0].permute(1, 2, 0).numpy())
        off = [(numbers[name] - goal[name]) / WATER_FEATURES[name][0] for name in goal]
        found.append(sum(x * x for x in off) ** 0.5)
    return sum(found) / len(found)


GREEN = in_water("9C", 0.1)


@cache
def green() -> RandomUnderwater:
    return uwaug.like(GREEN, pictures(4), maps(4), **FEW)


def conditions(augment: RandomUnderwater) -> Conditions:
    assert augment.conditions is not None
    return augment.conditions


def test_draws_look_like_the_photograph() -> None:
    assert far(green()) < 0.75 * far(RandomUnderwater())
    nearness = conditions(green()).nearness
    assert nearness is not None
    assert nearness.kept < 0.8 * nearness.drawn
    assert f"{nearness.kept:.2f}" in str(nearness)


@pytest.mark.parametrize(("blue", "is_far"), [(-0.8, False), (-0.5, False), (1.0, True)])
def test_another_hue_is_far_however_near_the_rest_is(blue: float, is_far: bool) -> None:
    names = list(WATER_FEATURES)
    photograph = np.zeros(len(names))
    photograph[names.index("log_RG")] = -1.5
    photograph[names.index("log_BG")] = -0.8  # a green of 143°
    draw = photograph.copy()
    draw[names.index("log_BG")] = blue
    assert (unlikeness(draw, photograph) >= 1) == is_far


@pytest.mark.filterwarnings("ignore:even the nearest")
def test_a_hue_that_no_water_has_is_far() -> None:
    purple = GREEN[[1, 0, 1]]
    assert str(conditions(uwaug.like(purple, pictures(4), maps(4), **FEW)).nearness).endswith(
        "; colour: far"
    )


def test_water_is_kept_and_the_rest_is_drawn_anew() -> None:
    noisy = RandomDevelopment(noise=Sensor((2000, 9000)))
    snowy = RandomWater(snow=MarineSnow((500, 5000)))
    augment = RandomUnderwater(snowy, distance=MadeUp(), development=noisy)
    found = uwaug.like(GREEN, pictures(2), augment=augment, **FEW)
    assert not any("seed" in name for kept in conditions(found).rows for name in flat(kept))
    samples = [flat(sample) for sample in found.make_params(pictures(40))["samples"]]
    for name in ("water.clearness", "water.snow.density", "development.noise.full_well"):
        assert len({sample[name] for sample in samples}) == 3
    seeds = ("water.field_seed", "water.snow.seed", "development.noise.seed")
    for name in (*seeds, "distance.scene", "distance.near_left"):
        assert len({sample[name] for sample in samples}) == 40
    assert (found.water, found.development) == (snowy, noisy)


def test_it_is_written_and_read_as_any_other() -> None:
    image, z = pictures(1, 5)[0], maps(1)[0]
    record = json.loads(json.dumps(green().make_params(image)))
    read = RandomUnderwater.from_dict(json.loads(json.dumps(green().to_dict())))
    for twin in (read, pickle.loads(pickle.dumps(green()))):
        assert "nearness" not in twin.to_dict()["conditions"]
        assert same(twin.transform(image, z, record), green().transform(image, z, record))
        assert same(twin.at(1, 2, 3)(image, z)[0], green().at(1, 2, 3)(image, z)[0])


def test_the_same_seed_keeps_the_same_draws() -> None:
    torch.manual_seed(123)
    rows = conditions(green()).rows
    assert conditions(uwaug.like(GREEN, pictures(4), maps(4), **FEW)).rows == rows
    assert conditions(uwaug.like(GREEN, pictures(4), maps(4), seed=1, **FEW)).rows != rows


def test_draws_spread_over_all_photographs_and_serve_each_other() -> None:
    blue, red = in_water("II", 0.3), torch.tensor([1.0, 0, 0])[:, None, None].expand(3, H, W)
    water = RandomWater(["II", "9C"], contrast=(0.07, 0.4))
    augment = RandomUnderwater(water, development=RAW)
    made = []

    class Counting(RandomUnderwater):
        def transform(self, *inputs: Any) -> Any:
            made.append(1)
            return augment.transform(*inputs)

    counting = Counting(water, development=RAW, p=0.0)  # which looks at all the same
    with pytest.warns(UserWarning, match="nearest draws look unlike.*greener"):
        found = uwaug.like(
            iter([GREEN, blue, red, blue]), pictures(4), maps(4), augment=counting, **FEW
        )
    nearness = conditions(found).nearness
    names = [row["water"]["waters"][0] for row in conditions(found).rows]
    assert nearness is not None
    assert len(names) == 4 * FEW["keep"]
    assert set(names[:3]) == {"9C"}
    assert "II" in names[3:6]
    assert nearness.far() == [2]
    assert max(nearness.of_each[0], nearness.of_each[1]) < 0.8 * nearness.drawn
    # the first takes FEW["draws"], each of three others the half without new ones, or less
    assert FEW["draws"] < len(made) <= FEW["draws"] * (1 + 3 * 0.3) + 3


@pytest.mark.filterwarnings("ignore:even the nearest")
def test_a_photograph_is_srgb_where_pictures_are_linear_light() -> None:
    linear = RandomUnderwater("9C", development=RandomDevelopment(color_space="linear"))
    dim = 0.4 * GREEN  # taken for linear light, it lies .26 off
    found = uwaug.like(dim, srgb_to_linear(pictures(2)), maps(2), augment=linear, **FEW)
    seen = uwaug.like(dim, pictures(2), maps(2), augment=RandomUnderwater("9C"), **FEW)
    drawn = [getattr(conditions(augment).nearness, "drawn", None) for augment in (found, seen)]
    # but for what resampling in linear light changes
    assert drawn[0] == pytest.approx(drawn[1], rel=0.07)


def liked(**options: Any) -> Any:
    given = {"reference": GREEN, "pictures": pictures(2), "distance": maps(2), **FEW, **options}
    return lambda: uwaug.like(**given)


def keeping(*kept: dict[str, Any]) -> Any:
    rows = [{"water": each} for each in kept]
    return lambda: RandomUnderwater("9C", conditions=Conditions(rows))


REFUSED = [
    (liked(reference=torch.rand(1, H, W)), "reference must have shape"),
    (liked(reference=[]), "reference: expected at least one"),
    (liked(reference=255 * torch.rand(3, H, W)), "reference reaches"),
    (liked(pictures=torch.zeros(3, H, W, dtype=torch.int32)), "pictures must be a floating"),
    (liked(distance=maps(3)), "3 maps for 2 pictures"),
    (liked(distance=None, augment=RandomUnderwater()), "distance is missing"),
    (liked(augment="II"), "augment must be a uwaug.RandomUnderwater"),
    (liked(draws=44), "draws must be 15 times keep"),
    (liked(keep=0), "keep"),
    (keeping({"waters": ["II"]}), "params"),
    (keeping({"g": 3.0}), "params"),
    (keeping({"salt": 3.0}), "params"),
    (keeping(), "at least one"),
]


@pytest.mark.parametrize(("call", "words"), REFUSED)
def test_what_is_refused(call: Any, words: str) -> None:
    with pytest.raises((TypeError, ValueError), match=words):
        call()


def test_kept_daylight_has_no_lamps() -> None:
    (sample,) = RandomUnderwater(light=RandomLight(share=1.0)).make_params(pictures(1))["samples"]
    assert "rig" in sample["light"]
    assert laid_over(sample, {"light": {"pitch": 3.0}})["light"] == {"pitch": 3.0}


@pytest.mark.filterwarnings("ignore:even the nearest draws")
def test_small_pictures_are_seen_as_the_whole_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    angles, transform = set(), RandomUnderwater.transform

    def looked(self: RandomUnderwater, image: Tensor, *rest: Any) -> Tensor:
        angles.add(round(self.view.focal(image.shape[-1]) / image.shape[-1], 6))
        return transform(self, image, *rest)

    monkeypatch.setattr(RandomUnderwater, "transform", looked)
    augment = RandomUnderwater(view=View(focal_px=277.0))
    large = torch.nn.functional.interpolate(pictures(2), (8 * H, 8 * W))
    like = uwaug.like(GREEN, large, maps(2), augment=augment, **FEW)
    assert angles == {round(277 / (8 * W), 6)}
    assert like.view == augment.view
