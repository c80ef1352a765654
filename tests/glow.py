"""Where plankton glows that `test_added_term.py` has put into the image: glow·(1 − e^−z)."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from scenes import coefficients, distances, picture
from torch import Tensor

import uwaug
from uwaug import (
    Development,
    KeepVisible,
    Lamp,
    Light,
    Medium,
    RandomDevelopment,
    RandomUnderwater,
    RandomWater,
    Underwater,
    contrast_left,
    fast,
    form_image,
)
from uwaug._support.codec import from_plain, to_plain
from uwaug.formation.colour import LUMINANCE
from uwaug.formation.development import exposed

IMAGE, DISTANCE = 0.5 * picture(48, 64), distances(48, 64)
GLOW = torch.tensor([[0.1, 0.2, 0.3]], dtype=torch.float64)
ARRIVING = GLOW[..., None, None] * -torch.expm1(-DISTANCE.double())
LIGHT = Light((Lamp((0.4, 0.0, 0.0), 2.0),), daylight=0.3)
DEVELOPED = Development(exposure=1.0, saturation=1.2, gamut=0.5)


def glowing(medium: Medium, glow: Tensor = GLOW) -> Medium:
    return replace(medium, glow=glow.expand(len(medium), 3))


def drawn(medium: Medium) -> Tensor:
    """A picture of `RandomUnderwater` in this water."""
    development = RandomDevelopment(metered=False)
    augment = RandomUnderwater(medium, development=development, light=None)
    record = augment.make_params(IMAGE[0], torch.Generator().manual_seed(3))
    return augment.transform(IMAGE[0], DISTANCE[0], record)


CLEAR = coefficients()
WATERS = {
    "grey": CLEAR,
    "spectral": Medium.from_water("II", surfaces="spectral"),
    "batch": Medium.stack([CLEAR, coefficients(4)]),
}
WAYS = {
    "linear": lambda medium: Underwater(medium, None, color_space="linear")(IMAGE, DISTANCE),
    "planned": lambda medium: Underwater(medium)(IMAGE, DISTANCE),
    "bytes": lambda medium: Underwater(medium)((255 * IMAGE).byte(), DISTANCE) / 255,
    "developed": lambda medium: Underwater(medium, development=DEVELOPED)(IMAGE, DISTANCE),
    "under a lamp": lambda medium: Underwater(medium, None, light=LIGHT)(IMAGE, DISTANCE),
    "drawn": lambda medium: drawn(medium[0]),
}


@pytest.mark.parametrize("water", WATERS)
@pytest.mark.parametrize("way", WAYS)
def test_in_pictures(way: str, water: str) -> None:
    medium = WATERS[water]
    brighter = WAYS[way](glowing(medium)) - WAYS[way](medium)
    assert brighter.mean() > 0.03
    assert brighter.min() > -0.005
    if way == "linear":
        torch.testing.assert_close(brighter, ARRIVING.float().expand_as(brighter))


def test_the_loops_form_it_too() -> None:
    medium = glowing(WATERS["spectral"])
    degrade = Underwater(medium, None, development=Development(metered=True, saturation=1.2))
    assert fast.can(IMAGE, DISTANCE, replace(degrade.setting, medium=medium))
    exact = degrade(IMAGE.double(), DISTANCE.double())
    torch.testing.assert_close(degrade(IMAGE, DISTANCE).double(), exact, rtol=0, atol=1e-5)


def test_the_meter_sees_it() -> None:
    J, z = IMAGE.double(), DISTANCE.double()
    gains = [float(Development(metered=True).gain(J, z, m)) for m in (CLEAR, glowing(CLEAR))]
    assert gains[1] < 0.7 * gains[0]


@pytest.mark.parametrize("water", WATERS)
def test_terms_add_up(water: str) -> None:
    image, z = IMAGE.double(), DISTANCE.double()
    terms = form_image(image, z, glowing(WATERS[water]))
    torch.testing.assert_close(terms.glow, ARRIVING.expand_as(terms.glow))
    torch.testing.assert_close(sum(terms), terms.image, rtol=0, atol=1e-14)
    assert len(list(terms)) == 4


def test_it_takes_contrast() -> None:
    z, luminance = DISTANCE.double(), torch.tensor(LUMINANCE, dtype=torch.float64)
    terms = form_image(torch.full_like(z, 0.18).expand(-1, 3, -1, -1), z, CLEAR)
    of = {name: luminance @ getattr(terms, name).flatten(2) for name in ("direct", "image")}
    wanted = of["direct"] / (of["image"] + luminance @ ARRIVING.flatten(2))
    torch.testing.assert_close(contrast_left(z, glowing(CLEAR)).flatten(2)[:, 0], wanted)
    near = torch.full_like(DISTANCE[0], 1.5)
    target = {"boxes": torch.tensor([[4.0, 4.0, 40.0, 40.0]])}
    for medium, seen in ((CLEAR, 1), (glowing(CLEAR), 0)):
        least = float(contrast_left(near, CLEAR).mean()) * 0.8
        keep = KeepVisible(RandomUnderwater(RandomWater(medium, field=None)), least)
        assert len(keep(IMAGE[0], near, target)[2]["boxes"]) == seen


def test_in_copies() -> None:
    medium = glowing(CLEAR)
    both = Medium.stack([medium, CLEAR])
    assert torch.equal(both.glow, torch.cat([GLOW, 0 * GLOW]))
    assert torch.equal(both[0].glow, GLOW)
    assert torch.equal(medium.expand(3).glow, GLOW.expand(3, 3))
    assert medium.to(torch.float32).glow.dtype == torch.float32
    assert torch.equal(medium.as_coefficients().glow, GLOW)
    assert torch.equal(medium.under_lamp().glow, GLOW)
    with pytest.raises(ValueError, match=r"Medium\.glow must have shape \(1, 3\), got \(2, 3\)"):
        replace(CLEAR, glow=GLOW.expand(2, 3))


@pytest.mark.parametrize("gain", [[[2.0]], [[1.0, 2.0, 3.0]], torch.rand(1, 3, 3).tolist()])
def test_a_gain_multiplies_it(gain: Any) -> None:
    medium, gains, J = glowing(CLEAR), torch.tensor(gain, dtype=torch.float64), IMAGE.double()
    wanted = exposed(medium.image(DISTANCE.double(), J, J), gains)
    torch.testing.assert_close(medium.brightened(gains).image(DISTANCE.double(), J, J), wanted)


def test_in_records() -> None:
    medium = glowing(CLEAR)
    plain = json.loads(json.dumps(to_plain(medium)))
    assert torch.equal(from_plain(plain, Medium).glow, GLOW)
    del plain["glow"]
    assert torch.equal(from_plain(plain, Medium).glow, 0 * GLOW)
    augment = RandomUnderwater(medium)
    again = RandomUnderwater.from_dict(json.loads(json.dumps(augment.to_dict())))
    assert torch.equal(again.water.waters.glow, GLOW)


def test_where_a_medium_is_learned() -> None:
    module = Underwater(glowing(CLEAR), None, learnable=True)
    fixed = Underwater(glowing(CLEAR), None)(IMAGE, DISTANCE)
    torch.testing.assert_close(module(IMAGE, DISTANCE), fixed, rtol=0, atol=2e-3)
    other = Underwater(CLEAR, None, learnable=True)
    other.load_state_dict(module.state_dict())
    torch.testing.assert_close(other(IMAGE, DISTANCE), module(IMAGE, DISTANCE))
    other(IMAGE, DISTANCE).sum().backward()
    assert all(p.grad.isfinite().all() for p in other.parameters())


def test_fits_know_none_and_take_it_for_veil() -> None:
    G, veil = (0.5, 0.3, 0.2), (0.1, 0.3, 0.4)
    observed = Underwater(glowing(Medium.from_coefficients(G, G, veil)), None)(IMAGE, DISTANCE)
    fit = uwaug.fit(IMAGE, observed, DISTANCE, model="veil", gain="fixed", progress=False)
    assert not fit.medium.glow.any()
    assert (fit.medium.veil_weights.sum(-1) - torch.tensor(veil)).abs().max() > 0.02


def test_in_files_whose_coefficients_are_inputs(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    from uwaug.onnx import OnnxUnderwater, export_onnx

    water = Medium.from_coefficients((1.0, 0.8, 0.9), (0.4, 0.3, 0.5), (0.1, 0.3, 0.4))
    module = Underwater(glowing(water), (0.5, 6.0))
    run = OnnxUnderwater(export_onnx(module, tmp_path / "glow.onnx", coefficients=True))
    for medium in (water, glowing(water), glowing(water, 2 * GLOW)):
        expected = Underwater(medium, (0.5, 6.0))(IMAGE, DISTANCE)
        pictures = run(IMAGE, DISTANCE, medium)
        torch.testing.assert_close(pictures, expected, rtol=0, atol=2e-5)
