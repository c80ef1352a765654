import json
from pathlib import Path
from typing import Any

import pytest
import torch
from augmenting import LIGHTS
from inputs import rand
from PIL import Image
from torch import Tensor

import uwaug
from uwaug import Light, RandomUnderwater
from uwaug.light.text import light_of_tables

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
    assert plain == lit


def test_the_light_shines() -> None:
    image, z = scene()
    options: dict[str, Any] = {"exposure": 0.0, "vertical_depth": 60.0, "waters": "5C"}
    options |= {"contrast": None, "field_probability": 0.0}
    torch.manual_seed(0)
    dark = RandomUnderwater(**options)(image, z)[0]
    torch.manual_seed(0)
    lit = RandomUnderwater(**options, light=LAMP)(image, z)[0]
    assert dark.max() < 0.01
    assert lit.max() > 0.1


def test_daylight_of_its_own_is_the_default() -> None:
    image, z = scene()
    pictures = []
    for light in (None, Light.ambient()):
        aug = RandomUnderwater(light=light, vertical_depth=2.0)
        torch.manual_seed(0)
        pictures.append(aug(image, z)[0])
    assert torch.equal(*pictures)


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


def test_large_pictures_say_that_they_take_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uwaug.strips, "LARGE", 100)
    image, z = scene()
    with pytest.raises(ValueError, match=r"light: a picture of 0\.0001 megapixels"):
        RandomUnderwater(light=LAMP)(image, z)


def test_lights_of_tables() -> None:
    lamp = {"kind": "lamp", "position": [0.4, -0.2, 0.0], "direction": [-0.1, 0.0, 1.0]}
    light = light_of_tables([{"kind": "ambient", "gain": 0.5}, {**lamp, "power": 4.0}])
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
            light_of_tables(table)


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
