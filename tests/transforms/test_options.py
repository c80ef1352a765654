import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from augmenting import LASERS, LIGHTS, TANK, H, W, brightness, distances, picture, result, same
from torch import Tensor

from uwaug import (
    JERLOV_TYPES,
    Constituents,
    Light,
    PointSpread,
    RandomUnderwater,
    Water,
    load_preset,
)
from uwaug.distance.convert import from_relative
from uwaug.transforms.random_underwater import WATERS

NAMES = {
    "Constituents": Constituents,
    "LASERS": LASERS,
    "LIGHTS": LIGHTS,
    "Light": Light,
    "PointSpread": PointSpread,
    "RandomUnderwater": RandomUnderwater,
    "TANK": TANK,
    "brightness": brightness,
}


def test_repr_and_dict_make_the_transform(options: dict[str, Any]) -> None:
    aug = RandomUnderwater(**options)
    text = repr(aug)
    for name in ("TANK", "LASERS", "LIGHTS", "brightness"):
        text = text.replace(repr(NAMES[name]), name)
    twin = eval(text, NAMES.copy())
    assert repr(twin) == repr(aug)
    assert same(result(aug), result(twin))
    if callable(aug.distance):
        with pytest.raises(NotImplementedError, match=r"distance cannot be written.*brightness"):
            aug.to_dict()
        return
    plain = json.loads(json.dumps(aug.to_dict()))
    twin = RandomUnderwater.from_dict(plain)
    assert twin.to_dict() == aug.to_dict() == plain
    assert same(result(aug), result(twin))


def test_repr_shows_what_was_changed() -> None:
    assert repr(RandomUnderwater()) == "RandomUnderwater()"
    assert repr(RandomUnderwater(["1C", "7C"], p=0.5)) == "RandomUnderwater(['1C', '7C'], p=0.5)"
    assert repr(RandomUnderwater({"1C": 2.0, "7C": 1})) == "RandomUnderwater({'1C': 2.0, '7C': 1})"
    aug = RandomUnderwater(g=(0.1, 0.3), waters=WATERS)
    assert repr(aug) == "RandomUnderwater(g=(0.1, 0.3))"


def test_defaults_of_old_are_the_calibrated_model() -> None:
    aug = RandomUnderwater.hazy()
    preset = load_preset("calibrated", water="7C")
    assert preset.medium.notes[0].endswith("g = 0.05, μ = 0.075")
    assert (aug.g, aug.mu) == (0.05, 0.075)
    assert (aug.contrast, aug.visibility, aug.exposure) == ((0.1, 0.6), None, "auto")
    assert aug.surfaces == "grey"
    sample = aug.make_params(picture())["samples"][0]
    assert not {"color_matrix", "white_balance", "gamut", "compensation"} & set(sample)


def test_a_water_of_nothing_says_what_it_can_reach() -> None:
    aug = RandomUnderwater(waters="I", contrast=0.03)
    image, z = torch.rand(3, 20, 30), torch.full((1, 20, 30), 3.0)
    with pytest.raises(
        ValueError, match=r"contrast=0.03 is out of reach of water 'I'.*0\.\d+ at 3 m"
    ):
        aug(image, z)


def test_visibility_takes_the_place_of_contrast() -> None:
    aug = RandomUnderwater(visibility=(2.0, 5.0))
    sample = aug.make_params(picture())["samples"][0]
    assert "contrast" not in sample
    assert 2 <= sample["visibility"] <= 5
    with pytest.raises(ValueError, match=r"visibility.*contrast.*one of them"):
        RandomUnderwater(visibility=5.0, contrast=0.3)


@pytest.mark.parametrize("name", ["survey", "calibrated"])
def test_from_a_preset(name: str) -> None:
    aug = RandomUnderwater.from_preset(name, water="3C", distance_kind="relative", gamma=2.0)
    preset = load_preset(name, water="3C")
    assert list(aug.spectra) == ["3C"]
    assert (aug.near, aug.far, aug.gamma) == (preset.near, preset.far, 2.0)
    assert (aug.contrast, aug.exposure, aug.color_space) == (None, "none", preset.color_space)
    image, t = picture(), distances()
    record = aug.make_params(image)
    generator = torch.Generator().manual_seed(record["samples"][0]["field_seed"])
    field = preset.field((1, 1, H, W), generator)
    expected = preset.module()(image, from_relative(t, preset.near, preset.far, 2.0), field)
    torch.testing.assert_close(aug.transform(image, t, record), expected, rtol=0, atol=3e-3)
    assert repr(RandomUnderwater.from_preset(name, visibility=3.0)).count("visibility=3.0") == 1
    with pytest.raises(ValueError, match=r"'tank-proposed-1'.*no spectra.*module"):
        RandomUnderwater.from_preset("tank-proposed-1")


def test_survey_is_the_papers() -> None:
    survey = RandomUnderwater.survey(distance_kind="relative")
    preset = RandomUnderwater.from_preset("survey", distance_kind="relative")
    assert survey.waters == dict.fromkeys(JERLOV_TYPES[1:], 1)
    numbers = "g mu vertical_depth contrast exposure point_spread near far gamma field_range"
    for name in numbers.split():
        assert getattr(survey, name) == getattr(preset, name), name


def test_listed_twice_counts_twice() -> None:
    assert RandomUnderwater(["7C", "7C", "1C"]).waters == {"7C": 2, "1C": 1}


def test_camera_from_a_file(tmp_path: Path) -> None:
    table = tmp_path / "lasers.csv"
    table.write_text("450,0,0,1\n550,0,1,0\n600,1,0,0\n")
    aug = RandomUnderwater(cameras=table)
    assert aug.make_params(picture())["samples"][0]["camera"] == "lasers"
    assert same(result(aug), result(RandomUnderwater(cameras=LASERS)))
    assert same(result(aug), result(RandomUnderwater(cameras=str(table))))


def test_water_from_a_file_and_by_its_contents(tmp_path: Path) -> None:
    rows = zip(TANK.wavelengths, TANK.a, TANK.b, TANK.kd, strict=True)
    table = tmp_path / "tank.csv"
    table.write_text("".join(f"{nm},{a},{b},{kd}\n" for nm, a, b, kd in rows))
    for waters in (table, str(table), [table], {table: 2.0}):
        aug = RandomUnderwater(waters)
        assert aug.make_params(picture())["samples"][0]["waters"] == ["tank"]
        assert same(result(aug), result(RandomUnderwater(TANK)))
    lake = "chlorophyll=5,cdom=0.3"
    of_text = result(RandomUnderwater(lake))
    water = Water.from_constituents(chlorophyll=5, cdom=0.3)
    assert same(of_text, result(RandomUnderwater(water)))
    assert same(of_text, result(RandomUnderwater(Constituents(chlorophyll=5, cdom=0.3))))


# Severity


def contrast(image: Tensor) -> float:
    weights = image.new_tensor([0.2126, 0.7152, 0.0722]).view(3, 1, 1)
    return float((image * weights).sum(-3).std())


def test_severity_grows(motorcycle: Any) -> None:
    image, distance = motorcycle.srgb[:, ::2, ::2].float(), motorcycle.distance[:, ::2, ::2].float()
    losses = []
    for level in range(1, 6):
        aug = RandomUnderwater.severity(level)
        results = [aug.at(0, 0, i)(image, distance)[0] for i in range(6)]
        losses.append(1 - np.mean([contrast(r) for r in results]) / contrast(image))
    assert np.diff(losses).min() > 0.05
    # as the docstring says
    np.testing.assert_allclose(losses, [0.16, 0.36, 0.52, 0.67, 0.79], atol=0.04)


def test_severity_takes_options() -> None:
    aug = RandomUnderwater.severity(3, waters="7C", distance=(1.0, 2.0), p=0.5)
    hazy = RandomUnderwater.hazy(waters="7C", contrast=0.35, distance=(1.0, 2.0), p=0.5)
    assert repr(aug) == repr(hazy)
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
        ({"waters": "salt=3"}, "expected a water such as chlorophyll=5.*'salt=3'"),
        ({"waters": "cdom=3:1"}, r"cdom must be a number ≥ 0 or .*got \(3.0, 1.0\)"),
        (
            {"waters": "cdom=1:3", "visibility": 100.0},
            "visibility=100 does not suit water 'cdom=1'",
        ),
        ({"waters": {"7C": -1.0, "1C": 2.0}}, r"waters.*weights.*\[-1.0, 2.0\]"),
        ({"waters": {"7C": 0.0}}, r"waters.*weights.*\[0.0\]"),
        ({"waters": {"7C": math.nan}}, "waters.*weights.*nan"),
        ({"waters": ["7C", Water.jerlov("7C")]}, "waters.*name of its own"),
        ({"cameras": []}, "cameras.*at least one"),
        ({"cameras": "Kodak"}, "no camera.*Kodak"),
        ({"exposure": "bright"}, "exposure must be one of none, auto.*'bright'"),
        ({"focal_px": 0.0}, "focal_px must be.*> 0 px.*0.0"),
        ({"focal_px": 500.0, "point_spread": PointSpread.none()}, "focal_px would do nothing.*500"),
        ({"light": []}, "light: expected a Light or several"),
        # a range, and the domain of each quantity
        ({"g": ()}, r"g must be.*got \(\)"),
        ({"g": (0.1, 0.2, 0.3)}, r"g must be.*got \(0.1, 0.2, 0.3\)"),
        ({"g": "much"}, "g must be.*got 'much'"),
        ({"g": abs}, "g must be.*abs"),
        ({"mu": None}, "mu must be.*None"),
        ({"g": (0.3, 0.2)}, r"g must be.*low ≤ high.*got \(0.3, 0.2\)"),
        ({"mixing": (-0.1, 1.0)}, r"mixing must be.*\[0, 1\].*\(-0.1, 1.0\)"),
        ({"contrast": 0.0}, "contrast must be.*0.0"),
        ({"exposure": (0.0, 99.0)}, r"exposure must be.*stops.*\(0.0, 99.0\)"),
        ({"vertical_depth": math.inf}, "vertical_depth.*finite and ≥ 0 m.*inf"),
        ({"blur_factor": math.nan}, "blur_factor.*nan"),
        ({"field_range": (-0.1, 1.0)}, r"field_range.*≥ 0.*\(-0.1, 1.0\)"),
        ({"distance": "far"}, "distance must be.*'far'"),
        ({"visibility": (5.0, 500.0)}, "visibility=500 does not suit water 'IB'.*pure water"),
        ({"p": math.nan}, "p must be in .0, 1.*nan"),
        ({"field_probability": -0.5}, "field_probability must be.*-0.5"),
        ({"distance_kind": "disparity"}, r"distance_kind must be one of metric, .*'disparity'"),
        ({"unknown": "ignore"}, "unknown must be one of.*'ignore'"),
        ({"color_space": "rgb"}, "color_space must be one of.*'rgb'"),
        ({"order": "backwards"}, "order must be one of.*'backwards'"),
        ({"tolerance": 0.0}, r"tolerance must lie in \(0, 1\).*0.0"),
        ({"near": 0.5}, "near would do nothing.*'metric', got 0.5"),
        ({"distance_kind": "inverse", "gamma": 2.0}, "gamma would do nothing.*'inverse', got 2.0"),
        ({"distance_kind": "inverse", "near": 0.0}, "near must lie above 0 m.*0.0"),
        (
            {"distance_kind": "relative", "near": (1.0, 6.0)},
            r"near must lie below far.*\(1.0, 6.0\).*5.0",
        ),
    ],
)
def test_construction_rejects(options: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        RandomUnderwater(**options)


def test_point_spread_must_be_one() -> None:
    with pytest.raises(TypeError, match=r"point_spread must be a uwaug\.PointSpread, got float"):
        RandomUnderwater(point_spread=0.3)


# Options as JSON and TOML hold them


def test_options_as_people_write_them() -> None:
    law = {"scale": 2.0, "exponent": 0.6}
    lights = [
        {"kind": "ambient", "gain": 0.2},
        {"kind": "lamp", "position": [0.3, 0, 0], "direction": [0, 0, 1]},
    ]
    aug = RandomUnderwater.from_dict({"g": [0.1, 0.2], "point_spread": law, "light": lights})
    light = Light.ambient(0.2) + Light.lamp((0.3, 0.0, 0.0), (0.0, 0.0, 1.0))
    expected = RandomUnderwater(g=(0.1, 0.2), point_spread=PointSpread(2.0, 0.6), light=light)
    assert aug.to_dict() == expected.to_dict()
    assert aug.g == (0.1, 0.2)


@pytest.mark.parametrize(
    "options, match",
    [
        ({"point_spread": {"exponent": 0.6}}, "point_spread: .*scale"),
        ({"point_spread": {"scale": 1.0, "width": 2}}, "point_spread: .*width"),
        ({"light": [{"kind": "moon"}]}, "light.kind must be one of"),
        ({"cameras": {"uwaug": "Kodak"}}, "cameras: unknown or missing: 'Kodak'"),
    ],
)
def test_tables_that_do_not_suit(options: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        RandomUnderwater.from_dict(options)
