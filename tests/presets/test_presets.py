import os
import re

import pytest
import torch
from presetting import edited, same

from uwaug import (
    JERLOV_TYPES,
    Camera,
    Development,
    Medium,
    PointSpread,
    RandomUnderwater,
    Underwater,
    Water,
)
from uwaug.presets import Preset, list_presets, load_preset, published_systems
from uwaug.presets.files import bundled_preset

NAMES = list_presets()

# a, b, G at g = 1, G at g = .2 of the four turbidities, as the paper prints them
TANK = [
    ("0.72 0.77 1.00", "9.5 10.25 13.25", "10.22 11.02 14.25", "2.62 2.82 3.65"),
    ("1.06 1.14 1.47", "15.58 16.81 21.73", "16.64 17.95 23.20", "4.17 4.50 5.82"),
    ("1.39 1.50 1.94", "21.66 23.37 30.21", "23.05 24.87 32.15", "5.73 6.18 7.99"),
    ("1.56 1.69 2.18", "24.70 26.65 34.45", "26.26 28.34 36.63", "6.50 7.02 9.07"),
]
# model: g, μ, φ/b̄, and which of the two G
TANK_MODELS = {
    "proposed": (0.2, 0.3, 0.3, 3),
    "adjusted": (0.2, 0.2, 0.0, 3),
    "reference": (1.0, 1.0, 0.0, 2),
}

# g, μ, φ/b̄, d, near, far, γ, field
PRINTED = {
    "survey": (0.2, 0.3, 0.3, 1.0, 1.0, 5.0, 1.0, (0.7, 1.3)),
    "examples-1": (0.3, 0.3, 0.8, 1.0, 0.5, 10.0, 5.0, (0.3, 1.7)),
    "examples-2": (0.3, 0.3, 0.8, 1.0, 0.5, 7.0, 4.0, (0.3, 1.7)),
    "examples-3": (0.3, 0.3, 0.8, 1.0, 0.5, 10.0, 4.0, (0.3, 1.7)),
    "examples-4": (0.3, 0.3, 0.8, 1.0, 0.25, 2.0, 2.5, (0.3, 1.7)),
    "depth-scaling-1": (0.2, 0.3, 0.3, 1.0, 0.0, 20.0, 1, (0.7, 1.3)),
    "depth-scaling-3": (0.2, 0.3, 0.3, 1.0, 0.0, 20.0, 3, (0.7, 1.3)),
    "depth-scaling-6": (0.2, 0.3, 0.3, 1.0, 0.0, 20.0, 6, (0.7, 1.3)),
}

SPECTRAL = bundled_preset("survey")


def numbers(cells: str) -> torch.Tensor:
    return torch.tensor([float(v) for v in cells.split()], dtype=torch.float64)


def ranges(preset: Preset) -> tuple:
    return preset.near, preset.far, preset.gamma, preset.field_range


def test_every_printed_row_has_a_preset_beside_the_librarys_own_and_others_systems():
    tank = [f"tank-{model}-{i}" for model in TANK_MODELS for i in (1, 2, 3, 4)]
    assert sorted([*tank, *PRINTED, "calibrated", *published_systems()]) == NAMES


@pytest.mark.parametrize("turbidity", [1, 2, 3, 4])
@pytest.mark.parametrize("model", TANK_MODELS)
def test_tank_rows(model, turbidity):
    g, mu, scale, column = TANK_MODELS[model]
    row = TANK[turbidity - 1]
    a, b = (numbers(cells) for cells in row[:2])
    preset = load_preset(f"tank-{model}-{turbidity}")
    medium = preset.medium
    assert [f"{v:.2f}" for v in medium.G[0].tolist()] == row[column].split()
    # where a and b, each rounded in print, give the printed G but for their rounding
    assert (a + g * b - medium.G[0]).abs().max() <= 0.005 * (2 + g) + 1e-12
    torch.testing.assert_close(medium.beta[0], a + b)
    torch.testing.assert_close(medium.veil_weights.sum(-1)[0], mu * b / medium.G[0])
    torch.testing.assert_close(medium.b_mean[0], b.mean())
    # no K_d is printed: full light
    assert torch.equal(medium.signal(torch.tensor(0.0)), torch.ones(1, 3))
    assert medium.point_spread == PointSpread(scale, 1.0, reference_size=518)
    assert preset.vertical_depth == 0.5
    assert ranges(preset) == (0.3, 0.7, 1.0, (0.3, 1.7))
    assert preset.color_space == "linear"


@pytest.mark.parametrize("name", PRINTED)
@pytest.mark.parametrize("water", [None, "IA", Water.jerlov("9C")], ids=str)
def test_spectral_rows(name, water):
    g, mu, scale, depth, *rest = PRINTED[name]
    preset = load_preset(name, water=water)
    kind = water or {"s": "7C", "e": "5C", "d": "II"}[name[0]]
    expected = Medium.from_water(
        kind if isinstance(kind, Water) else Water.jerlov(kind),
        vertical_depth=depth,
        g=g,
        mu=mu,
    )
    assert same(preset.medium, expected)
    assert preset.medium.notes == expected.notes
    assert preset.medium.point_spread == PointSpread.paper(scale)
    assert preset.vertical_depth == depth
    assert ranges(preset) == tuple(rest)
    assert preset.color_space == "linear"
    assert preset.source.startswith("arXiv:2509.15011")


def test_calibrated_is_the_width_law_for_60_degrees_across():
    preset = load_preset("calibrated")
    law, size = preset.medium.point_spread, (518, 691)
    expected = PointSpread.calibrated(691 / 2 / torch.tensor(30.0).deg2rad().tan().item())
    z = torch.tensor([0.5, 1.0, 4.0]).reshape(1, 1, 1, 3)
    torch.testing.assert_close(law.sigma(z, size), expected.sigma(z, size), rtol=1e-3, atol=0)
    assert (law.shape, law.exponent) == (expected.shape, expected.exponent)
    assert "g = 0.05, μ = 0.075" in repr(preset.medium)
    assert preset.color_space == "srgb"


def test_shape_of_the_point_spread(tmp_path):
    assert load_preset("survey").medium.point_spread.shape == "gaussian"  # if the file does not say
    heavy = edited(tmp_path, "survey", r"^exponent = .*", 'exponent = 1.0\nshape = "exponential"')
    assert load_preset(heavy).medium.point_spread == PointSpread(0.3, 1.0, "exponential", 518)


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_calibrated_veil_stays_below_a_white_plate(type):
    assert load_preset("calibrated", water=type).medium.veil_weights.sum(-1).max() < 1


@pytest.mark.parametrize("name", NAMES)
def test_every_preset_runs(name):
    preset = load_preset(name)
    image, t = torch.rand(2, 3, 20, 24), torch.rand(2, 1, 20, 24)
    z = preset.distance(t)
    torch.testing.assert_close(z, preset.near + (preset.far - preset.near) * t**preset.gamma)
    field = preset.field(z.shape)
    low, high = preset.field_range
    torch.testing.assert_close(torch.stack([field.min(), field.max()]), torch.tensor([low, high]))
    degrade = preset.module(focal_px=40.0)
    assert isinstance(degrade, Underwater)
    assert degrade.color_space == preset.color_space
    assert degrade.distance_range == (preset.near * low, preset.far * high)
    result = degrade(image, z, field)
    assert result.shape == image.shape
    assert result.isfinite().all()
    assert (result - image).abs().max() > 0.05


def test_a_camera_that_develops_spectral_surfaces(tmp_path):
    numbers = {"compensation": 0.5, "white_balance": 0.6, "gamut": 1.0}
    lines = "\n".join(f"{name} = {value}" for name, value in numbers.items())
    spectral = 'surfaces = "spectral"\ncolor_matrix = 0.7\n'
    path = edited(tmp_path, "calibrated", r"^\[field\]", f"[development]\n{lines}\n[field]")
    path.write_text(path.read_text().replace("[medium]\n", f"[medium]\n{spectral}"))
    preset, plain = load_preset(path, water="II"), load_preset("calibrated", water="II")
    law = plain.medium.point_spread
    medium = Medium.from_water(
        "II", g=0.05, mu=0.075, point_spread=law, surfaces="spectral", color_matrix=0.7
    )
    image, z = torch.rand(3, 20, 24), torch.full((1, 20, 24), 3.0)
    development = Development(**numbers)
    expected = Underwater(medium, (0.7, 6.5), development=development)(image, z)
    assert torch.equal(preset.module()(image, z), expected)
    drawn = RandomUnderwater.from_preset(path, water="II", field_probability=0.0)
    assert (drawn(image, z)[0] - expected).abs().max() < 2e-3
    grey = RandomUnderwater.from_preset(path, water="II", surfaces="grey", field_probability=0.0)
    assert (grey(image, z)[0] - expected).abs().max() > 0.02
    assert (plain.module()(image, z) - expected).abs().max() > 0.05


def test_field_takes_a_generator():
    preset = load_preset("survey")
    first, second = (preset.field((8, 8), torch.Generator().manual_seed(3)) for _ in range(2))
    assert torch.equal(first, second)


@pytest.mark.parametrize("name", ["Survey", "tank", "configs/survey"])
def test_unknown_name_lists_the_known(name):
    message = rf"no preset is called '{name}'; there are akkaynak-2018, .*, tank-reference-4"
    with pytest.raises(ValueError, match=message):
        load_preset(name)


def test_water_and_camera_take_the_place_of_spectra_only(tmp_path):
    camera = Camera([400, 500, 600, 700], [[0, 0, 1], [0, 1, 1], [1, 1, 0], [1, 0, 0]], "box")
    assert not same(load_preset("survey", camera=camera).medium, load_preset("survey").medium)
    for override in ({"water": "II"}, {"camera": camera}):
        message = r"preset tank-adjusted-2: holds coefficients for red, green and blue"
        with pytest.raises(ValueError, match=message):
            load_preset("tank-adjusted-2", **override)
    with pytest.raises(ValueError, match=r"preset survey: water must be one of I, .*; got '11C'"):
        load_preset("survey", water="11C")
    with pytest.raises(ValueError, match=r"preset survey: no camera is called 'D90'"):
        load_preset("survey", camera="D90")


def test_own_file_with_its_own_camera(tmp_path):
    (tmp_path / "box.csv").write_text("wavelength,R,G,B\n400,0,0,1\n550,0,1,0\n700,1,0,0\n")
    path = tmp_path / "mine.toml"
    path.write_text(SPECTRAL.read_text().replace("Nikon 5100 (NPL)", "box.csv"))
    for given in (path, str(path)):
        preset = load_preset(given)
        assert preset.name == "mine"
        assert same(preset.medium, load_preset("survey", camera=tmp_path / "box.csv").medium)


def test_own_file_with_a_water_of_ones_own(tmp_path):
    """A CSV file beside the preset's, or contents."""
    (tmp_path / "harbour.csv").write_text("wavelength,a,b,kd\n400,.5,1,.7\n700,.7,1,.8\n")
    path = tmp_path / "mine.toml"
    for type, water in (
        ("harbour.csv", tmp_path / "harbour.csv"),
        ("chlorophyll=5,cdom=0.3", "chlorophyll=5,cdom=0.3"),
    ):
        path.write_text(SPECTRAL.read_text().replace('type = "7C"', f'type = "{type}"'))
        preset = load_preset(path)
        assert same(preset.medium, load_preset("survey", water=water).medium)
        assert preset.spectral["waters"].name in ("harbour", type)
        assert same(load_preset(path, water="II").medium, load_preset("survey", water="II").medium)
    (tmp_path / "harbour.csv").unlink()
    path.write_text(SPECTRAL.read_text().replace('type = "7C"', 'type = "harbour.csv"'))
    with pytest.raises(FileNotFoundError, match=r"harbour\.csv"):
        load_preset(path)


REFUSED = {
    "survey": [
        (r"^type = .*", 'type = "harbour"', "9C, contents, the name of a CSV file, got 'harbour'"),
        (r"^type = .*", 'type = "algae=3"', "water.type: "),
        (r"^vertical_depth_m", "vertical_depth_cm", "is no key; did you mean vertical_depth_m?"),
        (r"^mu =", "haze =", "medium.haze is no key; there are vertical_depth_m, g, mu"),
        (r"^\[field\]", "[noise]", "noise is no key; there are source, color_space, medium"),
        (r"^far_m = .*", "", "distance.far_m is missing"),
        (r"^g = .*", 'g = "0.2"', "medium.g: Input should be a valid number, got '0.2'"),
        (r"^g = .*", "g = true", "medium.g: Input should be a valid number, got True"),
        (r"^g = .*", "g = 1979-05-27", "medium.g: Input should be a valid number, got '1979"),
        (r"^g = .*", "g = 20", "medium.g must be in [0, 1], got 20"),
        (r"^vertical_depth_m = .*", "vertical_depth_m = inf", "must be finite and ≥ 0, got inf"),
        (r"^far_m = .*", "far_m = 1.0", "distance.far_m must be > near_m = 1.0, got 1.0"),
        (r"^far_m = .*", "far_m = nan", "distance.far_m must be finite and ≥ 0, got nan"),
        (r"^gamma = .*", "gamma = 0", "distance.gamma must be finite and ≥ 0.001, got 0"),
        (r"^low = .*", "low = 0", "field.low must be finite and > 0, got 0"),
        (r"^high = .*", "high = 0.5", "field.high must be ≥ low = 0.7, got 0.5"),
        (r"^scale_px = .*", "scale_px = -1", "point_spread.scale_px must be finite and ≥ 0"),
        (r"^short_side_px = .*", "short_side_px = 0", "short_side_px must be finite and > 0"),
        (r"^color_space = .*", 'color_space = "sRGB"', "should be 'srgb' or 'linear', got 'sRGB'"),
        (r"^type = .*", 'type = "11C"', "water.type must be one of I, IA"),
        (r"^\[water\]", "[coefficients]", "coefficients.a_per_m is missing"),
        (r"^\[water\]", "water", "not a TOML file"),
        (r"^mu = (.*)", r"mu = \1\ncolor_matrix = 0.5", "medium.color_matrix would do nothing"),
        (
            r"^\[field\]",
            "[development]\ngamut = 2.0\n[field]",
            "development.gamut must be in [0, 1]",
        ),
        (r"^\[field\]", "[development]\ngamma = 2.0\n[field]", "did you mean gamut?"),
    ],
    "tank-proposed-1": [
        (
            r"^G_per_m = .*",
            "G_per_m = [2.62, 2.82, 3.68]",
            "G_per_m is 3.68 in blue, but a + g·b = 1.0 + 0.2·13.25",
        ),
        (r"^a_per_m = .*", "a_per_m = [0.72, 0.77]", "coefficients.a_per_m.2 is missing"),
        (r"^b_per_m = .*", "b_per_m = [9.5, 10.25, -1.0]", "coefficients.b_per_m must be finite"),
        (r"^G_per_m = .*", "G_per_m = [0.0, 2.82, 3.65]", "coefficients.G_per_m must be > 0"),
        (r"^\[medium\]", '[water]\ntype = "II"\ncamera = "x"\n[medium]', "give one of these"),
        ("^mu = (.*)", r'mu = \1\ndims = "veil"', "medium: dims is for the tab"),
        ("^mu = (.*)", r'mu = \1\nsurfaces = "spectral"', "medium.surfaces must be grey where"),
    ],
    "jaffe-1990": [
        ("^forward = .*", 'forward = "J"', "medium.forward: Input should be 'image'"),
        ("^forward = ", "foward = ", "foward is no key; did you mean forward?"),
        ("^power = 10.0", "power = [1.0, 4.0]", "light must be for one picture, got one for 2"),
    ],
    "ueda-2019": [
        ("^downwelling = .*", 'downwelling = "b"', "medium.downwelling: Input should"),
        ("^downwelling = .*", 'dims = "veil"', "medium.dims must be both or direct"),
        ("^low = .0.4", "low = [0.6", "veil.high must be ≥ low = (0.6, 0.7, 0.7)"),
        ("^low = .0.4", "low = [-1.0", "veil.low must be finite and ≥ 0, got -1.0"),
    ],
    "li-2020": [
        ("^depth_range_m = .*", "depth_range_m = [5.0, 6.0]", "hold vertical_depth_m"),
        ('^type = "II"', 'type = "2"', "channels.type must be one of I, IA, IB, II"),
        ("^II = .0.80", "II = [0.0", "left_per_m.II must be in (0, 1], got 0.0"),
        ("^surface_light = .*", "surface_light = -1.0", "surface_light must be finite"),
        ("^downwelling = .*", "", "medium.downwelling must be beam or none here"),
        ("^downwelling = (.*)", r'downwelling = \1\nforward = "direct"', "forward must"),
        (r"^\[veil\]", "[viel]", "viel is no key; did you mean veil?"),
    ],
    "slurpp-2025": [
        ("^II = .0", "II = [-1", "channels.beta_per_m.II must be finite and ≥ 0"),
    ],
    "hou-2020": [
        ("^left = .0.35", "left = [1.35", "channels.left must be in (0, 1], got 1.35"),
        ("^left = ", 'type = "II"\nleft = ', "channels.left is all: type and surface"),
        ("^downwelling = .*", 'downwelling = "beam"', "downwelling must be none here"),
        ("^left = .*", "", "left_per_m, left: give one of these three"),
        (r"^\[veil\].*\nlow.*\nhigh.*\n", "", "veil is missing: channels have no scattering"),
    ],
}
"""What takes the place of a pattern in a preset's file, and what is said of it."""


@pytest.mark.parametrize(
    ("name", "pattern", "replacement", "message"),
    [(name, *row) for name, rows in REFUSED.items() for row in rows],
)
def test_error_names_file_and_key(tmp_path, name, pattern, replacement, message):
    path = edited(tmp_path, name, pattern, replacement)
    with pytest.raises(ValueError, match=re.escape(message)) as error:
        load_preset(path)
    assert str(error.value).startswith(f"{path}: ")


def test_all_errors_are_told_at_once(tmp_path):
    path = tmp_path / "mine.toml"
    text = SPECTRAL.read_text().replace("mu = 0.3", 'mu = "x"')
    path.write_text(text.replace("far_m = 5.0", "far = 5.0"))
    message = r"medium\.mu: .*; distance\.far_m is missing; distance\.far is no key"
    with pytest.raises(ValueError, match=message) as error:
        load_preset(path)
    assert "\n" not in str(error.value)


def test_light_falls_with_depth_in_a_preset_with_coefficients(tmp_path):
    path = edited(tmp_path, "tank-proposed-1", r"^kd_per_m = .*", "kd_per_m = [1.0, 2.0, 0.0]")
    medium = load_preset(path).medium
    light = torch.exp(torch.tensor([[-0.5, -1.0, 0.0]], dtype=torch.float64))
    torch.testing.assert_close(medium.signal(torch.tensor(0.0, dtype=torch.float64)), light)
    full = load_preset("tank-proposed-1").medium.veil_weights.sum(-1)
    torch.testing.assert_close(medium.veil_weights.sum(-1), full * light)


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 5000, ".".join("a" * 5000) + " = 1"], ids=["brackets", "keys"]
)
def test_deep_nesting_is_an_error_of_value(tmp_path, text):
    path = tmp_path / "deep.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"deep\.toml: not a"):
        load_preset(path)


def test_a_pipe_is_refused_before_it_is_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(OSError, match=r"path must be a file, but .* is no regular file"):
        load_preset(tmp_path / "pipe.toml")


def test_sides_are_passed_on():
    module = load_preset("survey").module(sides=(32, 700))
    assert module.sides == (32, 700)
    assert module.plan((33, 40)) == module.plan((700, 900))
    assert load_preset("survey").module().sides is None
