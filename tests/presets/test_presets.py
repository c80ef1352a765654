import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scenes import rand

import uwaug
from uwaug import Lamp, Light, Medium, PointSpread, RandomUnderwater, RandomWater, Underwater
from uwaug.distance import Metres, Relative
from uwaug.fitting import Fit, load_fit
from uwaug.fitting.data import Geometry
from uwaug.formation import Setting
from uwaug.optics.view import WIDE
from uwaug.presets import list_presets, load_preset
from uwaug.presets.files import preset_path

NAMES = sorted({*list_presets()} - {"night", "wet"})  # which differ from picture to picture
KEPT = np.load(Path(__file__).parent.parent / "data" / "presets.npz")
IMAGE, T, FIELD = (torch.from_numpy(KEPT[key]) for key in ("image", "t", "field"))

# a, b, G at g = 1, G at g = .2 of the four turbidities, as the paper prints them
TANK = [
    ("0.72 0.77 1.00", "9.5 10.25 13.25", "10.22 11.02 14.25", "2.62 2.82 3.65"),
    ("1.06 1.14 1.47", "15.58 16.81 21.73", "16.64 17.95 23.20", "4.17 4.50 5.82"),
    ("1.39 1.50 1.94", "21.66 23.37 30.21", "23.05 24.87 32.15", "5.73 6.18 7.99"),
    ("1.56 1.69 2.18", "24.70 26.65 34.45", "26.26 28.34 36.63", "6.50 7.02 9.07"),
]

# g, μ, scale of the blur, and which column G is printed in
TANK_MODELS = {
    "proposed": (0.2, 0.3, 0.3, 3),
    "adjusted": (0.2, 0.2, 0.0, 3),
    "reference": (1.0, 1.0, 0.0, 2),
}

# g, μ, scale of the blur, near, far, gamma, field: as printed
PRINTED = {
    "survey": (0.2, 0.3, 0.3, 1.0, 5.0, 1.0, (0.7, 1.3)),
    "examples-1": (0.3, 0.3, 0.8, 0.5, 10.0, 5.0, (0.3, 1.7)),
    "examples-2": (0.3, 0.3, 0.8, 0.5, 7.0, 4.0, (0.3, 1.7)),
    "examples-3": (0.3, 0.3, 0.8, 0.5, 10.0, 4.0, (0.3, 1.7)),
    "examples-4": (0.3, 0.3, 0.8, 0.25, 2.0, 2.5, (0.3, 1.7)),
    "depth-scaling-1": (0.2, 0.3, 0.3, 0.0, 20.0, 1, (0.7, 1.3)),
    "depth-scaling-3": (0.2, 0.3, 0.3, 0.0, 20.0, 3, (0.7, 1.3)),
    "depth-scaling-6": (0.2, 0.3, 0.3, 0.0, 20.0, 6, (0.7, 1.3)),
}


def numbers(cells: str) -> torch.Tensor:
    return torch.tensor([float(v) for v in cells.split()], dtype=torch.float64)


def ranges(preset: RandomUnderwater) -> tuple:
    z = preset.distance
    return z.near, z.far, z.gamma, preset.water.field


def medium_of(preset: RandomUnderwater) -> Medium:
    return preset.module().medium


def metres(preset: RandomUnderwater, t: torch.Tensor) -> torch.Tensor:
    """Distances of a map, whose ends are not random."""
    source = preset.distance
    return source.metres(t, torch.empty(3, *t.shape[-2:]), source.drawn(lambda name: 0.0))


def same(first: Medium, second: Medium) -> bool:
    pairs = zip(*(medium.without_lamps().tensors() for medium in (first, second)), strict=True)
    return first.law == second.law and all(torch.equal(x, y) for x, y in pairs)


def edited(folder: Path, preset: str | Path, pattern: str, replacement: str) -> Path:
    """A preset with its first match of a pattern replaced, as a file of one's own."""
    text = preset_path(preset).read_text(encoding="utf-8")
    text, count = re.subn(pattern, replacement, text, count=1, flags=re.MULTILINE)
    assert count == 1
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_printed_row_has_a_preset():
    tank = [f"tank-{model}-{i}" for model in TANK_MODELS for i in (1, 2, 3, 4)]
    assert sorted([*tank, *PRINTED, "calibrated"]) == NAMES


@pytest.mark.parametrize("turbidity", [1, 2, 3, 4])
@pytest.mark.parametrize("model", TANK_MODELS)
def test_tank_rows(model, turbidity):
    g, mu, scale, column = TANK_MODELS[model]
    row = TANK[turbidity - 1]
    a, b = (numbers(cells) for cells in row[:2])
    preset = load_preset(f"tank-{model}-{turbidity}")
    medium = medium_of(preset)
    assert [f"{v:.2f}" for v in medium.G[0].tolist()] == row[column].split()
    # where a and b, each rounded in print, give the printed G but for their rounding
    assert (a + g * b - medium.G[0]).abs().max() <= 0.005 * (2 + g) + 1e-12
    torch.testing.assert_close(medium.beta[0], a + b)
    veil = medium.veil_weights.sum(-1)[0]
    torch.testing.assert_close(veil, mu * b / medium.G[0], rtol=0, atol=1e-7)
    torch.testing.assert_close(medium.b_mean[0], b.mean(), rtol=0, atol=1e-6)
    assert torch.equal(medium.signal(torch.tensor(0.0)), torch.ones(1, 3))
    assert (float(medium.scale), float(medium.exponent)) == (scale or 0.0, 1.0)
    assert medium.law.unit == ("paper" if scale else "px")
    assert ranges(preset) == (0.3, 0.7, 1.0, (0.3, 1.7))
    assert preset.development.color_space == "linear"


@pytest.mark.parametrize("name", PRINTED)
@pytest.mark.parametrize("water", [None, "IA"])
def test_spectral_rows(name, water):
    g, mu, scale, *rest = PRINTED[name]
    preset = load_preset(name, water=water)
    kind = water or {"s": "7C", "e": "5C", "d": "II"}[name[0]]
    law = PointSpread.paper(scale)
    expected = Medium.from_water(kind, vertical_depth=1.0, g=g, mu=mu, point_spread=law)
    assert same(medium_of(preset), expected)
    assert ranges(preset) == tuple(rest)
    assert preset.development.color_space == "linear"


def test_calibrated_has_the_calibrated_law():
    preset, law = load_preset("calibrated"), PointSpread.calibrated()
    medium = medium_of(preset)
    assert (float(medium.scale), float(medium.exponent)) == (law.scale, law.exponent)
    assert (medium.law, preset.development.color_space) == (law.law, "srgb")
    for kind in uwaug.JERLOV_TYPES:  # below a white plate
        assert medium_of(load_preset("calibrated", water=kind)).veil_weights.sum(-1).max() < 1


@pytest.mark.filterwarnings("ignore:less than 3 % of the contrast")
def test_wet_pictures_get_water_in_two_of_three_draws():
    augment = load_preset("wet")
    image = torch.rand(3, 12, 16)
    wet = sum(augment.at(0, 0, i)(image) is not image for i in range(300))
    assert 170 < wet < 230
    least, most = augment.distance.reach()
    assert 0 < least < most < 5


@pytest.mark.parametrize("name", NAMES)
def test_pictures_of_presets(name):
    preset = load_preset(name)
    module = preset.module()
    z, (thin, dense) = preset.distance, preset.water.field
    assert module.distance_range == (z.near * thin, z.far * dense)
    result = module(IMAGE.double() / 255, metres(preset, T.double()), FIELD.double())
    assert np.abs(result.numpy() - KEPT[name]).max() < 1e-5
    # the transform makes the picture of its module
    expected = module(IMAGE, metres(preset, T)).int()
    even = replace(preset, water=replace(preset.water, field=None))
    of_metres = replace(even, distance=Metres())
    for made in (even(IMAGE, T)[0], of_metres(IMAGE, metres(preset, T))[0]):
        assert (made.int() - expected).abs().max() <= 1


@pytest.mark.filterwarnings("ignore:less than 3 % of the contrast")
@pytest.mark.parametrize("lamps", [(), (Lamp((0.3, -0.3, 0.0)),)])
def test_a_module_is_as_deep_as_its_transform_by_lamps_and_by_daylight(lamps):
    law = PointSpread(0.03 * 30, 0.62, "exponential")
    water = RandomWater("9C", **{**RandomWater.PLAIN, "vertical_depth": 12.0, "point_spread": law})
    plain = uwaug.RandomDevelopment.PLAIN
    metered = uwaug.RandomDevelopment(**{**plain, "metered": True})
    transform = RandomUnderwater(water, light=Light(lamps), development=metered)
    image, z = rand(3, 20, 24).float(), torch.full((1, 20, 24), 2.0)
    made, expected = transform(image, z)[0], transform.module()(image, z)
    assert (made - expected).square().mean().sqrt() < 1e-3  # of noise, by other plans


# ------------------------------------------------------------------------ files of one's own


def test_water_and_camera_in_place_of_the_files(tmp_path):
    response = [[0, 0, 1], [0, 1, 1], [1, 1, 0], [1, 0, 0]]
    camera = uwaug.Camera([400, 500, 600, 700], response, "box")
    ours = medium_of(load_preset("survey", camera=camera))
    paper = {"g": 0.2, "mu": 0.3, "point_spread": PointSpread.paper()}
    assert same(ours, Medium.from_water("7C", camera, **paper))
    (tmp_path / "box.csv").write_text("wavelength,R,G,B\n400,0,0,1\n550,0,1,0\n700,1,0,0\n")
    (tmp_path / "harbour.csv").write_text("wavelength,a,b,kd\n400,.5,1,.7\n700,.7,1,.8\n")
    lines = 'waters = "harbour.csv"\ncamera = "box.csv"'
    path = edited(tmp_path, "survey", r"^waters = .*\ncamera = .*", lines)
    theirs = Medium.from_water(tmp_path / "harbour.csv", tmp_path / "box.csv", **paper)
    for given in (path, str(path)):
        assert same(medium_of(load_preset(given)), theirs)
    several = edited(tmp_path, path, r"^waters = .*", 'waters = ["harbour.csv", "II"]')
    assert load_preset(several).water.names == ["harbour", "II"]
    contents = edited(tmp_path, "survey", r"^waters = .*", "waters = {chlorophyll = [1, 9]}")
    assert load_preset(contents).water.waters == (uwaug.Constituents(chlorophyll=(1, 9)),)
    assert load_preset(contents, water="II").water.waters == "II"
    # what is left out is as in the library
    path.write_text('water = "II"\n[distance]\nkind = "Relative"\nfar = 2\n')
    ours = RandomUnderwater("II", distance=Relative(far=2))
    assert load_preset(path).to_dict() == ours.to_dict()


TEXT = preset_path("survey").read_text(encoding="utf-8")
LINES = sorted({*re.findall(r"^\w+(?= =)", TEXT, re.MULTILINE)} - {"kind", "scale"})
DRAWN = ["color_matrix", "exposure", "gamut", "light", "mu", "noise", "saturation", "tone"]
DRAWN += ["vertical_depth", "waters", "white_balance"]
"""What differs from picture to picture where a line is left out."""


@pytest.mark.filterwarnings("ignore:less than 3 % of the contrast")
@pytest.mark.parametrize("line", LINES)
def test_a_line_that_is_left_out_makes_no_module_or_the_same_picture(tmp_path, line):
    preset = load_preset(edited(tmp_path, "survey", rf"^{line} = .*\n", ""))
    if line in DRAWN:
        with pytest.raises(ValueError, match=rf"{line.replace('light', 'light.share')}\b.*fix"):
            preset.module()
        return
    preset = replace(preset, water=replace(preset.water, field=None))
    record = preset.make_params(IMAGE, torch.Generator().manual_seed(0))
    scenes = preset.scenes(IMAGE, T, record)  # placed in their water, where an end is left out
    z = metres(preset, T) if preset.distance.has_size else scenes.metres[0]
    assert (scenes.formed().int() - preset.module()(IMAGE, z).int()).abs().max() <= 1


REFUSED = [
    ("survey", r"^waters = .*", 'waters = "swamp"', "water must be one of I, IA"),
    ("survey", r"^mu =", "haze =", "RandomWater has no 'haze', only waters, visibility,"),
    ("survey", r"^\[development\]", "[noise]", "RandomUnderwater has no 'noise', only water,"),
    ("survey", r"^light = .*", "lihgt = 1", "did you mean light?"),
    ("survey", r"^kind = .*", "", "distance must be a uwaug.Source, got dict; give Metres,"),
    ("survey", r"^g = .*", 'g = "0.2"', "g must be a number, got"),
    ("survey", r"^far = .*", "far = 1.0", "near must lie below far, got near = 1.0 and far = 1.0"),
    ("survey", r"^far = .*", "far = nan", "far must be a number or a range"),
    ("survey", r"^\[water\]", "water", "not a TOML file"),
    ("tank-proposed-1", r"^beta = .*", "beta = [0.72, 0.77]", "beta must have shape (3,)"),
    ("tank-proposed-1", r"^veil = .*", "", "Medium: Medium.from_coefficients() missing 1"),
    ("tank-proposed-1", r'^kind = "Medium"', "", "Water has no 'beta'"),
]
"""What takes the place of a pattern in a preset's file, and what is said of it."""
ARGUMENTS: list[tuple[str, dict[str, Any], str]] = [
    ("Survey", {}, "preset must be one of calibrated, depth-scaling-1.*got 'Survey'"),
    ("tank-adjusted-2", {"water": "II"}, "holds coefficients"),
    ("tank-adjusted-2", {"camera": "x"}, "holds coefficients"),
    ("survey", {"water": "11C"}, "water must be one of I, "),
    ("survey", {"camera": "D90"}, "camera must be one of"),
]


def test_refusals_name_the_file_and_the_key(tmp_path):
    for name, pattern, replacement, message in REFUSED:
        path = edited(tmp_path, name, pattern, replacement)
        with pytest.raises(ValueError, match=re.escape(message)) as error:
            load_preset(path)
        assert str(error.value).startswith(f"{path}: ")
    for name, options, message in ARGUMENTS:
        with pytest.raises(ValueError, match=message):
            load_preset(name, **options)
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(OSError, match=r"path must be a regular file"):
        load_preset(tmp_path / "pipe.toml")


def test_files_of_windows(tmp_path: Path) -> None:
    path, text = tmp_path / "own.toml", '# Höhle\nwater = "3C"\n'
    for code in ("utf-8-sig", "utf-16"):
        path.write_text(text, encoding=code)
        assert load_preset(path).water.waters == "3C"
    nested = "a=" + "[" * 50_000 + "]" * 50_000
    for code, written, said in (("cp1252", text, "no text in UTF-8"), ("utf-8", nested, "not a T")):
        path.write_text(written, encoding=code)
        with pytest.raises(ValueError, match=rf"own\.toml: .*{said}"):
            load_preset(path)


def test_a_stored_setting_is_a_preset_of_all_of_it(tmp_path: Path) -> None:
    """Of a file that a fit has written: medium, snow, light, view, development, colour space."""
    setting = Setting(
        Medium.from_water("7C", vertical_depth=2.0).with_snow(uwaug.MarineSnow(9000, seed=3)),
        Light([Lamp((0.2, 0.1, 0.0), 2.0)], daylight=0.4, pitch=8.0),
        uwaug.Development(exposure=0.3, saturation=1.2, tone=1.1),
        uwaug.View(32.0),
        "linear",
    )
    path, geometry = tmp_path / "fit.json", Geometry(1.0, 2.0, 4.0, (20, 24), 4.0)
    Fit("7C", {}, np.zeros((0, 0)), setting, geometry, 0.01, ()).save(path)
    image, z = 0.8 * rand(3, 20, 24).float(), torch.linspace(1.5, 4, 480).reshape(1, 20, 24)
    expected = Underwater.of(setting, None)(image, z)
    for made in (load_preset(path)(image, z)[0], load_fit(path).module()(image, z)):
        assert (made - expected).square().mean().sqrt() < 2e-3
    plain = {"light": None, "development": uwaug.Development(), "view": WIDE}
    for name, value in plain.items():
        without = Underwater.of(replace(setting, **{name: value}), None)(image, z)
        assert (without - expected).abs().max() > 0.02, name
