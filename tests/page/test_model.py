"""The page's functions in V8, against the package."""

import base64
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from py_mini_racer import MiniRacer
from skimage.data import chelsea

import uwaug
import uwaug.page
from uwaug.distance import cue, fill_unknown
from uwaug.distance.sizes import brought_to
from uwaug.formation.colour import decoded
from uwaug.formation.development import exposed
from uwaug.formation.image import blurred_as_seen, form
from uwaug.page.tables import plan_of_page, tables
from uwaug.transforms import random_water
from uwaug.transforms.appearance import water_features
from uwaug.transforms.conditions import photographed

HEIGHT, WIDTH = 40, 52
WATERS, PICTURES = 16, 4
MIXTURE = {"water", "other", "share"}
CONTENTS = {"chlorophyll": (0.1, 20), "cdom": (0.02, 3), "minerals": (0.02, 5)}
OF_WATER = {
    "contrast": (0.05, 0.9),
    "vertical_depth": (0, 20),
    "g": (0, 0.4),
    "mu": (0, 0.6),
    "color_matrix": (0, 1),
}
OF_CAMERA = {"exposure": (-2, 1), "white_balance": (-0.5, 1), "saturation": (0, 2), "gamut": (0, 1)}
RANGES = {**CONTENTS, **OF_WATER, **OF_CAMERA, "pitch": (-40, 40), "blur": (0, 2)}


def settings_of(rng: np.random.Generator) -> dict[str, Any]:
    types = list(uwaug.JERLOV_TYPES)
    settings: dict[str, Any] = {name: rng.uniform(*ends) for name, ends in RANGES.items()}
    settings |= {"times": 10 ** rng.uniform(-1, 1), "tone": 1.0, "full_well": 0, "read_noise": 0}
    settings["share"] = float(rng.choice([0.0, round(rng.uniform(), 2)]))
    settings["water"] = str(rng.choice([*types, *["contents"] * 6]))
    settings["other"] = str(rng.choice(types))
    return settings | ({"contrast": None} if rng.uniform() < 0.2 else {})


def twin_of(settings: dict[str, Any]) -> uwaug.RandomUnderwater:
    """The transform that the settings stand for."""
    water = f"{1 - settings['share']}*{settings['water']}+{settings['share']}*{settings['other']}"
    if settings["water"] == "contents":
        water = ",".join(f"{name}={settings[name]}" for name in CONTENTS)
    elif not settings["share"]:
        water = settings["water"]
    law = uwaug.PointSpread.calibrated()
    blur = replace(law, scale=law.scale * settings["blur"])
    of_water, of_camera = ({n: settings[n] for n in names} for names in (OF_WATER, OF_CAMERA))
    return uwaug.RandomUnderwater(
        uwaug.RandomWater(water, field=None, point_spread=blur, **of_water),
        light=uwaug.Light(pitch=settings["pitch"]),
        development=uwaug.RandomDevelopment(**of_camera, tone=settings["tone"], noise=None),
    )


def js(values: Any) -> str:
    """Numbers as JavaScript writes them."""
    return str(values.flatten().tolist()).replace("inf", "Infinity").replace("nan", "NaN")


class Page:
    """The page's model, with a scene."""

    def __init__(self) -> None:
        self.engine = MiniRacer()
        folder = Path(uwaug.page.__file__).parent
        for name in ("model.js", "maps.js", "holes.js", "like.js"):
            self.engine.eval((folder / name).read_text().replace("export ", ""))
        self.engine.eval(f"const tables = {json.dumps(tables())}")
        weights = list(base64.b64decode(tables()["cue"]["weights"]))
        layers = f"layersOf(tables.cue.shapes, Uint8Array.from({weights}))"
        self.engine.eval(f"const cue = {{ ...tables.cue, layers: {layers} }}")
        rng = np.random.default_rng(3)
        blocks = rng.integers(0, 256, (3, HEIGHT // 8, WIDTH // 4)).repeat(8, 1).repeat(4, 2)
        noisy = (blocks + rng.integers(-20, 20, blocks.shape)).clip(0, 255)
        self.image = torch.from_numpy(noisy.astype(np.uint8))
        z = np.exp(rng.uniform(np.log(0.5), np.log(9), (HEIGHT // 4, WIDTH // 4)))
        self.distance = torch.from_numpy(z.repeat(4, 0).repeat(4, 1).astype(np.float32))[None]
        self.distance[0, :4] = math.inf
        rgba = np.concatenate([noisy, np.full_like(noisy[:1], 255)]).transpose(1, 2, 0)
        self.engine.eval(f"const pixels = Uint8Array.from({js(rgba)})")
        self.engine.eval(f"const distance = Float32Array.from({js(self.distance)})")
        self.engine.eval(f"const scene = sceneOf(pixels, distance, {WIDTH}, {HEIGHT}, tables)")

    def __call__(self, expression: str) -> Any:
        return json.loads(self.engine.eval(f"JSON.stringify({expression})"))

    def twin(self, settings: dict[str, Any]) -> Any:
        """Distances and setting of the package."""
        twin, maps = twin_of(settings), self.distance.double() * settings["times"]
        scenes = twin.scenes(self.image, maps, twin.make_params(self.image))
        return scenes.z, scenes.scenes[0]

    def use(self, settings: dict[str, Any]) -> None:
        self.engine.eval(f"var s = {json.dumps(settings)}, water = waterTable(scene, s, tables);")
        self.engine.eval("var gain = gainOf(scene, water, s, tables)")


@pytest.fixture(scope="module")
def page() -> Page:
    return Page()


@pytest.fixture
def every_band(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums of all bands."""
    monkeypatch.setattr(random_water, "_CURVES", 0.0)


def test_waters_are_those_of_the_package(page: Page, every_band: None) -> None:
    rng = np.random.default_rng(0)
    for _ in range(WATERS):
        settings = settings_of(rng)
        z, scene = page.twin(settings)
        medium, clarity = scene.setting.medium, scene.clarity.record()
        page.use(settings)
        depth = float(medium.notes[0].split(", ")[2].split(" m")[0])
        assert page("water.depth") == pytest.approx(depth, rel=1e-5)
        assert page("water.contents") == pytest.approx(clarity["contents"], rel=1e-6)
        assert page("water.visibility") == pytest.approx(clarity["visibility"], rel=1e-6)
        size = page("scene.K") + 21
        rows = np.array(page("Array.from(water.table)")).reshape(-1, size)[:, -21:]
        near, step = page("[scene.near, scene.step]")
        places = np.array([0, 100, 500, 900, 1023])
        metres = torch.from_numpy(near * np.exp(places * step) * settings["times"])
        curves = medium.curves(metres[None, None, None])
        parts = (curves.direct, curves.scatter, curves.veil)
        truth = torch.cat([part.reshape(-1, len(places)) for part in parts]).T
        np.testing.assert_allclose(rows[places], truth, rtol=0, atol=1e-5)
        far = medium.curves(z.amax().reshape(1, 1, 1, 1)).veil.flatten()
        np.testing.assert_allclose(rows[1024, 18:], far, rtol=0, atol=1e-5)


def test_contents_end_where_those_of_the_package_do(page: Page, every_band: None) -> None:
    odd = {"water": "I", "share": 0.0, "contrast": 0.05, "times": 0.02}
    settings = settings_of(np.random.default_rng(5)) | odd
    page.use(settings)
    _, scene = page.twin(settings)
    assert page("water.contents") == scene.clarity.record()["contents"] == 2.0**12


def test_pictures_are_those_of_the_package(page: Page, every_band: None) -> None:
    rng = np.random.default_rng(1)
    for _ in range(PICTURES):
        settings = settings_of(rng)
        settings["contrast"] = settings["contrast"] or 0.5
        z, scene = page.twin(settings)
        setting = scene.setting
        development = setting.development
        medium = setting.medium.in_pixels((z.shape[-2], z.shape[-1]), setting.view)
        J = decoded(page.image[None], "srgb").double()
        soft = blurred_as_seen(J, z.double(), medium, plan_of_page())
        light = setting.light
        assert isinstance(light, uwaug.Light)
        T = light.curves(medium, z.double(), setting.view)
        gain = development.gain(J, z.double(), medium, T)
        arriving = development.shaped(exposed(medium.image(z.double(), J, soft, T), gain))
        page.use(settings)
        matrix = gain if gain.ndim == 3 else torch.diag_embed(gain.expand(1, 3))
        assert np.array(page("gain")) == pytest.approx(matrix[0].numpy(), rel=1e-5, abs=1e-6)
        page.engine.eval(f"var exact = new Float32Array({3 * WIDTH * HEIGHT})")
        page.engine.eval("var picture = form(scene, water, gain, s, { exact }, tables)")
        exact = torch.tensor(page("Array.from(exact)")).reshape(HEIGHT, WIDTH, 3).permute(2, 0, 1)
        brightest = max(float(gain.abs().max()), 1.0)
        torch.testing.assert_close(exact.double(), arriving[0], rtol=1e-5, atol=1e-5 * brightest)
        # with a tone, and as bytes
        settings["tone"] = float(rng.uniform(0.5, 2.5))
        shown = replace(development, tone=settings["tone"])
        toned = replace(setting, medium=setting.medium.to(z), development=shown)
        truth = form(page.image[None], z, toned, plan=plan_of_page())[0]
        page.use(settings)
        page.engine.eval("var picture = form(scene, water, gain, s, {}, tables)")
        pixels = np.array(page("Array.from(picture.pixels)")).reshape(HEIGHT, WIDTH, 4)[..., :3]
        off = np.abs(pixels - truth.permute(1, 2, 0).numpy().astype(int))
        assert off.max() <= 1
        assert (off > 0).mean() < 0.02


def test_what_is_left_of_contrast(page: Page, every_band: None) -> None:
    settings = settings_of(np.random.default_rng(2)) | {"contrast": 0.4, "times": 1.0}
    twin = twin_of(settings)
    left = twin.contrast_left(page.image, page.distance, twin.make_params(page.image))
    page.use(settings)
    lights = "Array.from(scene.place, p => lightAt(p, water, scene.K, tables))"
    detail, surface, veil = np.array(page(lights)).T
    rise = np.array(page("Array.from(water.rise)"))
    shown = detail / (surface + rise * veil)
    # of the nearest place in the table
    assert shown == pytest.approx(left.flatten().numpy(), abs=3e-3)


def test_noise_follows_the_photon_transfer_curve(page: Page) -> None:
    settings = settings_of(np.random.default_rng(4)) | {"contrast": 0.8, "gamut": 0.0}
    pictures = []
    for well in (0, 1000):
        page.use(settings | {"full_well": well, "read_noise": 5})
        page.engine.eval(f"var exact = new Float32Array({3 * WIDTH * HEIGHT})")
        page.engine.eval("gain = [[1,0,0],[0,1,0],[0,0,1]]")
        page.engine.eval("form(scene, water, gain, s, { exact }, tables)")
        pictures.append(np.array(page("Array.from(exact)")))
    clean, noisy = pictures
    share = (noisy - clean) / np.sqrt(clean.clip(0) / 1000 + (5 / 1000) ** 2)
    assert share.mean() == pytest.approx(0, abs=0.05)
    assert share.std() == pytest.approx(1, abs=0.03)


def test_maps(page: Page) -> None:
    def metres(values: str = "[0, 1000, 2000, 4000]", **said: Any) -> list[float]:
        page.engine.eval(f"var map = {{ width: 2, height: 2, most: 65535, values: {values} }}")
        asked = {"holds": "metres", "unit": 0.001, "near": 1, "far": 4, "holes": "far", **said}
        made = f"metresOf(map, 2, 2, {json.dumps(asked)})"
        shown: list[float] = page(f"Array.from({made}, z => z < Infinity ? z : -1)")
        return [round(z, 6) for z in shown]

    assert metres() == [-1, 1, 2, 4]
    assert metres(holes="3") == [3, 1, 2, 4]
    assert metres("[1000, 65535, 2000, 4000]", holes="3") == [1, 3, 2, 4]
    values = torch.tensor([[0.0, 1000, 2000, 4000]])
    relative = uwaug.distance.from_relative(values / 65535, 1, 4)
    assert metres(holds="relative") == pytest.approx(relative.flatten().tolist(), rel=1e-5)
    inverse = uwaug.distance.from_inverse(values, 1, 4)
    assert metres(holds="inverse") == pytest.approx(inverse.flatten().tolist(), rel=1e-5)
    assert metres("[NaN, 0, 65535, 0]", holds="relative", holes="2") == [2, 1, 4, 1]
    # of a larger map the nearest
    page.engine.eval("var map = { width: 4, height: 1, most: 1, values: [1, 2, 3, 4] }")
    said = json.dumps({"holds": "metres", "unit": 1, "holes": "error"})
    assert page(f"Array.from(metresOf(map, 2, 1, {said}))") == [2, 4]
    for asked, words in (
        ({"holes": "error"}, "1 pixels have no distance"),
        ({"unit": 1}, "is the unit mm"),
        ({"values": "[5, 5, 5, 5]", "holds": "inverse"}, "this one is flat"),
        ({"values": "[5, -5, 5, 5]", "holds": "relative"}, "are these metres, or inverse"),
    ):
        with pytest.raises(Exception, match=words):
            metres(**asked)


def test_a_picture_looks_as_it_does_in_the_package(page: Page) -> None:
    rng = np.random.default_rng(6)
    picture = rng.integers(0, 200, (16, 24, 3)).repeat(8, 0).repeat(8, 1)
    picture += rng.integers(0, 56, picture.shape)
    picture[40:80, 40:120] //= 6
    picture[..., 0] //= 2
    alpha = np.full_like(picture[..., :1], 255)
    rgba = js(np.concatenate([picture, alpha], -1))
    page.engine.eval(f"var seen = {{pixels: Uint8Array.from({rgba}), width: 192, height: 128}}")
    expected = list(water_features(picture / 255).values())
    assert page("featuresOf(seen)") == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_holes_get_what_is_behind_as_in_the_package(page: Page) -> None:
    """Shadows beside a box, specks, a frame, a wide hole before open water."""
    z = torch.linspace(3, 5, 80).expand(1, 60, 80).clone()
    z[:, :20] = torch.inf
    z[:, 25:45, 30:50] = 1.5
    holed = z.clone()
    holed[:, 25:45, 50:62] = 0  # a shadow
    holed[:, 45:48, 28:50] = torch.nan
    holed[:, 10:30, 5:25] = -1  # wide
    holed[:, :, :2] = 0  # a frame
    specks = torch.rand(z.shape, generator=torch.Generator().manual_seed(0)) < 0.01
    holed[specks] = 0
    page.engine.eval(f"var holed = Float32Array.from({js(holed)})")
    filled = page("Array.from(filledFromBehind(holed, 60, 80), z => z < Infinity ? z : 1e9)")
    truth = fill_unknown(holed, behind=True).clamp(max=1e9).flatten()
    off, holes = abs(torch.tensor(filled) / truth - 1), ~(holed > 0).flatten()
    assert (off[holes] < 0.02).float().mean() > 0.99  # of two sides as near, either
    assert off[~holes].max() == 0
    assert page("filledFromBehind(Float32Array.of(1, 2), 1, 2).length") == 2
    with pytest.raises(Exception, match="no pixel of the map has a distance"):
        page("filledFromBehind(Float32Array.of(0, NaN), 1, 2)")


def test_small_maps_are_brought_to_size_as_in_the_package(page: Page) -> None:
    z = 2 + torch.rand(1, 5, 7, generator=torch.Generator().manual_seed(0))
    z[..., 1:3, 2:4] = 1.2
    z[..., 4, 6] = torch.inf
    page.engine.eval(f"var map = {{width: 7, height: 5, most: 1, values: {js(z)}}}")
    said = json.dumps({"holds": "metres", "unit": 1, "holes": "error"})
    made = page(f"Array.from(metresOf(map, 28, 20, {said}), z => z < 1e9 ? z : 1e9)")
    expected = brought_to((20, 28), z).clamp(max=1e9)
    assert torch.allclose(torch.tensor(made).reshape(1, 20, 28), expected, rtol=1e-5)


def test_the_network_of_made_up_distances_says_what_it_says_in_the_package(page: Page) -> None:
    picture = torch.rand(3, 64, 96, generator=torch.Generator().manual_seed(0))
    page.engine.eval(f"const planes = Float32Array.from({js(picture)})")
    shown = page("Array.from(guessed({ height: 64, width: 96, values: planes }, cue).values)")
    convolve = cue.layers_of(cue.learnt())
    answer = cue.decoded(cue.encoded(picture[None], convolve), convolve)
    torch.testing.assert_close(torch.tensor(shown), answer.flatten(), rtol=1e-4, atol=1e-4)


def test_made_up_distances(page: Page) -> None:
    """Another map for another number, from near to far, and the same for the same."""
    picture = np.pad(chelsea()[::5, ::5], ((0, 0), (0, 0), (0, 1)), constant_values=255)
    height, width = picture.shape[:2]
    page.engine.eval(f"const drawn = Uint8Array.from({js(picture)})")
    maps = []
    for seed in (0, 1, 2, 0):
        made = f"madeUp(drawn, {width}, {height}, randomOf({seed}), cue)"
        shown = page(f"Array.from({made}, z => z < Infinity ? z : 1e9)")
        z = np.array(shown).reshape(height, width)
        assert z.min() == pytest.approx(1, rel=0.2)
        assert (z < 8.01).mean() > 0.4
        assert np.median(z[20:45, 25:65]) < np.median(z[:20, 75:])  # a cat's face, and behind it
        maps.append(z)
    assert not np.array_equal(maps[0], maps[1])
    assert np.array_equal(maps[0], maps[3])


def test_draws_are_conditions_of_the_package(page: Page) -> None:
    names = ("condition", "other condition", "between", "pitch")
    for shares in np.random.default_rng(4).uniform(size=(20, 4)).tolist():
        page.engine.eval(f"var shares = {shares}")
        drawn = page("drawnBy(() => shares.shift(), { g: 0.3 }, ['tone'], tables.draws)")
        row = photographed().picked(dict(zip(names, shares, strict=True)).__getitem__)
        expected = {**row["water"]["waters"][0], **row["water"], **row["development"], "g": 0.3}
        medians = 1.1 * (60 / 1.1) ** expected["clearness"]
        expected |= {"contrast": 0.02 ** (1 / medians), "pitch": -25 + 40 * shares[3]}
        expected |= {"white_balance": max(expected["white_balance"], 0)}
        assert drawn.keys() == expected.keys() - {"waters", "clearness", "noise", "tone"} | MIXTURE
        for name in drawn.keys() - MIXTURE:
            assert drawn[name] == pytest.approx(expected[name], rel=0.03)
