import json
from pathlib import Path
from typing import Any

import pytest
import torch
from augmenting import LIGHTS
from PIL import Image
from scenes import rand
from torch import Tensor

import uwaug
from uwaug import KeepVisible, Light, Medium, RandomUnderwater
from uwaug.optics.bands import Forward

LAMP = Light.lamp((0.4, -0.2, 0.0), (-0.1, 0.0, 1.0), 4.0, 40.0)


def scene() -> tuple[Tensor, Tensor]:
    return rand(3, 30, 44).float(), 0.5 + 4 * rand(1, 30, 44, seed=1).float()


def test_lights_are_drawn_and_replayed() -> None:
    aug = RandomUnderwater(light=LIGHTS)
    image, z = scene()
    found = set()
    for seed in range(12):
        torch.manual_seed(seed)
        record = json.loads(json.dumps(aug.make_params(image)))
        found.add(record["samples"][0]["light"])
        once, again = (aug.transform(image, z, record) for _ in range(2))
        assert torch.equal(once, again)
        resolved = aug.resolve(image, z, record)
        assert torch.equal(aug.transform(image, z, resolved), once)
    assert found == {0, 1}


def test_draws_without_a_light_stay_what_they_were() -> None:
    """A light takes the last of the random numbers."""
    image, _ = scene()
    samples = []
    for aug in (RandomUnderwater(), RandomUnderwater(light=LIGHTS)):
        torch.manual_seed(3)
        samples.append(aug.make_params(image)["samples"][0])
    plain, lit = samples
    assert lit.pop("light") in (0, 1)
    assert lit.pop("path") == "eager"  # what forms a picture under a lamp
    del plain["path"]
    assert plain == lit


def test_wrong_lights_are_refused() -> None:
    with pytest.raises(TypeError, match=r"light must be a uwaug\.Light, got int"):
        RandomUnderwater(light=[3])  # type: ignore[list-item]
    with pytest.raises(ValueError, match="light: expected a Light or several"):
        RandomUnderwater(light=[])
    two = Light.lamp((0, 0, 0), (0, 0, 1), power=torch.ones(2))
    with pytest.raises(ValueError, match="light must be for one picture, got one for 2"):
        RandomUnderwater(light=two)
    aug, (image, z) = RandomUnderwater(light=LIGHTS), scene()
    record = aug.make_params(image)
    record["samples"][0]["light"] = 2
    with pytest.raises(ValueError, match="light must be a whole number below 2, got 2"):
        aug.transform(image, z, record)
    with pytest.raises(ValueError, match="they differ in light"):
        RandomUnderwater().transform(image, z, record)


def test_lights_of_tables() -> None:
    lamp = {"kind": "lamp", "position": [0.4, -0.2, 0.0], "direction": [-0.1, 0.0, 1.0]}
    light = Light.from_list([{"kind": "ambient", "gain": 0.5}, {**lamp, "power": 4.0}])
    assert repr(light).startswith(
        "Light.ambient(gain=0.5, gradient=0.0) + Light.lamp(position=(0.4"
    )
    for table, message in (
        ([{"kind": "candle"}], "light.kind must be one of"),
        ([{"kind": "ambient", "gian": 1.0}], "light of kind 'ambient'.*gian"),
        ([{**lamp, "power": -1.0}], "light of kind 'lamp': power must be"),
        ({"kind": "lamp"}, "light: expected tables"),
    ):
        with pytest.raises(ValueError, match=message):
            Light.from_list(table)


def test_degrade_takes_a_light_from_a_file(run: Any, tmp_path: Path) -> None:
    picture = tmp_path / "a.png"
    Image.fromarray((scene()[0] * 255).byte().permute(1, 2, 0).numpy()).save(picture)
    options = tmp_path / "options.toml"
    options.write_text(
        'waters = ["5C"]\nvertical_depth = 40.0\n[[light]]\nkind = "lamp"\n'
        "position = [0.3, 0.0, 0.0]\ndirection = [0.0, 0.0, 1.0]\npower = 3.0\n"
    )
    arguments = ("--distance", "2", "--random", "--options", str(options))
    code, _, said = run("degrade", str(picture), "--out", str(tmp_path / "out.png"), *arguments)
    assert code == 0, said


LAMPS = ("mcglamery-1980", "jaffe-1990")


@pytest.mark.parametrize("name", LAMPS)
def test_presets_with_a_lamp(name: str) -> None:
    preset = uwaug.load_preset(name, water="7C")
    image, z = torch.rand(3, 24, 32), torch.linspace(1, 3, 24 * 32).reshape(1, 24, 32)
    with pytest.raises(ValueError, match="focal_px is missing"):
        preset.module()
    seen = preset.module(focal_px=28.0)(image, z)
    light = uwaug.Underwater(
        preset.medium, (preset.near, preset.far), light=preset.light, focal_px=28.0
    )
    torch.testing.assert_close(seen, light(image, z), rtol=0, atol=0)
    assert (seen - uwaug.Underwater(preset.medium)(image, z)).abs().max() > 0.05


@pytest.mark.parametrize("forward", ["image", "direct"])
def test_what_a_lamps_light_scatters_forward(forward: Forward) -> None:
    beta, G = torch.tensor([0.9, 0.6, 0.5]), torch.tensor([0.5, 0.3, 0.2])
    medium = Medium.from_coefficients(beta, G, (0.1,) * 3, b_mean=0.4, forward=forward)
    light = uwaug.Light.lamp((0.4, -0.3, 0.0), (0.0, 0.0, 1.0), power=5.0)
    z = torch.linspace(1, 4, 24 * 32).reshape(1, 24, 32)
    terms = uwaug.form_image(torch.rand(3, 24, 32) + 0.1, z, medium, light=light, focal_px=28.0)
    b, g = beta[:, None, None], G[:, None, None]
    ratio = (torch.exp((b - g) * z) - 1) * (torch.exp(-b * z) if forward == "direct" else 1)
    torch.testing.assert_close(terms.forward, ratio * terms.direct, rtol=1e-4, atol=1e-6)


def test_objects_are_judged_under_their_light() -> None:
    """At night, what a lamp shows can be seen, and what it does not reach cannot."""
    lamp = Light.lamp((0.3, 0.0, 0.0), (-0.5, 0.0, 1.0), 8.0, 25.0)
    night: dict[str, Any] = {"waters": "II", "contrast": None, "vertical_depth": 30.0}
    augment = RandomUnderwater.hazy(light=lamp, field_probability=0.0, focal_px=30.0, **night)
    image, z = rand(3, 40, 60).float(), torch.full((1, 40, 60), 1.0)
    boxes = torch.tensor([[2.0, 12.0, 14.0, 28.0], [50.0, 12.0, 59.0, 28.0]])
    target = {"boxes": boxes, "labels": torch.tensor([1, 2])}
    _, _, found = KeepVisible(augment, 0.1, flag=True)(image, z, target)
    assert found["contrast"][0] > 0.1
    assert found["contrast"][1] < 0.01
    medium = Medium.from_water("II", vertical_depth=30.0, g=0.05, mu=0.075)
    left = uwaug.contrast(medium, z, light=lamp, focal_px=30.0)[0]
    expected = [float(left[12:28, first:last].mean()) for first, last in ((2, 14), (50, 59))]
    torch.testing.assert_close(found["contrast"], torch.tensor(expected).float())


@pytest.mark.parametrize("light", [Light.ambient(), Light.parallel(40.0, 0.0)])
def test_daylight_goes_no_deeper_than_an_exposure_makes_up_for(light: Light) -> None:
    image, z = scene()
    depths = []
    for one in (None, light, light + LAMP):
        aug = RandomUnderwater("7C", light=one, vertical_depth=60.0, contrast=None)
        resolved = aug.resolve(image, z, aug.make_params(image))
        depths.append(resolved["samples"][0]["used"]["vertical_depth"])
    assert depths[0] < 10
    assert depths[1] == depths[0]
    assert depths[2] == 60


@pytest.mark.parametrize("light", [Light.ambient(0.5), Light.parallel(89.0, 0.0, diffuse=0.9)])
def test_an_exposure_keeps_the_veil_of_daylight_below_white(light: Light) -> None:
    """Also where a lamp is lit; a dark veil leaves the exposure free."""
    image, z = torch.ones(3, 24, 32), torch.zeros(1, 24, 32)
    z[:, :3] = torch.inf
    medium = Medium.from_water("7C", vertical_depth=2.0, mu=0.3, g=0.05)
    for one in (light, light + Light.lamp((0.3, 0, 0), (0, 0, 1), 1e-3)):
        degrade = uwaug.Underwater(
            medium, None, light=one, focal_px=28.0, exposure="auto", color_space="linear"
        )
        assert degrade(image, z)[:, :3].max() == pytest.approx(1, abs=0.01)
