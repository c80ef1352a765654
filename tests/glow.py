"""Where plankton glows that `test_added_term.py` has put into the image: glow·(1 − e^−z)."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from scenes import coefficients, distances, picture
from torch import Tensor

import uwaug
from uwaug import Development, Medium, RandomUnderwater, RandomWater, Underwater, fast
from uwaug.formation.colour import LUMINANCE
from uwaug.formation.development import exposed

IMAGE, DISTANCE = 0.5 * picture(48, 64), distances(48, 64)
J, Z = IMAGE.double(), DISTANCE.double()
GLOW = torch.tensor([[0.1, 0.2, 0.3]], dtype=torch.float64)
ARRIVING = GLOW[..., None, None] * -torch.expm1(-Z)


def glowing(medium: Medium, glow: Tensor = GLOW) -> Medium:
    return replace(medium, glow=glow.expand(len(medium), 3))


CLEAR = coefficients()
WATERS = {
    "grey": CLEAR,
    "spectral": Medium.from_water("II", surfaces="spectral"),
    "batch": Medium.stack([CLEAR, coefficients(4)]),
}
LIT = {"light": uwaug.Light((uwaug.Lamp((0.4, 0.0, 0.0), 2.0),), daylight=0.3)}
DEVELOPED = {"development": Development(exposure=1.0, saturation=1.2, gamut=0.5)}
WAYS = {
    "linear": lambda medium: Underwater(medium, None, color_space="linear")(IMAGE, DISTANCE),
    "planned": lambda medium: Underwater(medium)(IMAGE, DISTANCE),
    "bytes": lambda medium: Underwater(medium)((255 * IMAGE).byte(), DISTANCE) / 255,
    "developed": lambda medium: Underwater(medium, **DEVELOPED)(IMAGE, DISTANCE),
    "under a lamp": lambda medium: Underwater(medium, None, **LIT)(IMAGE, DISTANCE),
}


@pytest.mark.parametrize("water", WATERS)
def test_in_pictures_and_their_terms(water: str) -> None:
    medium, glow = WATERS[water], glowing(WATERS[water])
    for way in WAYS.values():
        brighter = way(glow) - way(medium)
        assert brighter.mean() > 0.03
        assert brighter.min() > -0.005
    terms = uwaug.form_image(J, Z, glow)
    torch.testing.assert_close(terms.glow, ARRIVING.expand_as(terms.glow))
    torch.testing.assert_close(sum(terms), terms.image, rtol=0, atol=1e-14)


def test_the_loops_form_it_and_the_meter_sees_it() -> None:
    medium = glowing(WATERS["spectral"])
    degrade = Underwater(medium, None, development=Development(metered=True, saturation=1.2))
    assert fast.can(IMAGE, DISTANCE, replace(degrade.setting, medium=medium))
    torch.testing.assert_close(degrade(IMAGE, DISTANCE).double(), degrade(J, Z), rtol=0, atol=1e-5)
    gains = [float(Development(metered=True).gain(J, Z, m)) for m in (CLEAR, glowing(CLEAR))]
    assert gains[1] < 0.7 * gains[0]


def test_it_takes_contrast() -> None:
    luminance = torch.tensor(LUMINANCE, dtype=torch.float64)
    terms = uwaug.form_image(torch.full_like(J, 0.18), Z, CLEAR)
    direct, image = (luminance @ x.flatten(2) for x in (terms.direct, terms.image))
    wanted = direct / (image + luminance @ ARRIVING.flatten(2))
    left = uwaug.contrast_left(Z, glowing(CLEAR)).flatten(2)[:, 0]
    torch.testing.assert_close(left, wanted)
    aug = RandomUnderwater(RandomWater(glowing(CLEAR), field=None))
    left = aug.contrast_left(IMAGE[0], DISTANCE[0], aug.make_params(IMAGE[0])).flatten().double()
    torch.testing.assert_close(left, wanted[0], rtol=1e-3, atol=1e-3)


def test_in_copies_and_records() -> None:
    medium = glowing(CLEAR)
    both = Medium.stack([medium, CLEAR])
    assert torch.equal(both.glow, torch.cat([GLOW, 0 * GLOW]))
    assert torch.equal(medium.expand(3).glow, GLOW.expand(3, 3))
    for twin in (both[0], medium.as_coefficients(), medium.under_lamp()):
        assert torch.equal(twin.glow, GLOW)
    with pytest.raises(ValueError, match=r"Medium\.glow must have shape \(1, 3\), got \(2, 3\)"):
        replace(CLEAR, glow=GLOW.expand(2, 3))
    for gain in ([[2.0]], [[1.0, 2.0, 3.0]], torch.rand(1, 3, 3).tolist()):
        gains = torch.tensor(gain, dtype=torch.float64)
        wanted = exposed(medium.image(Z, J, J), gains)
        torch.testing.assert_close(medium.brightened(gains).image(Z, J, J), wanted)
    plain = RandomUnderwater(medium).to_dict()
    again = RandomUnderwater.from_dict(json.loads(json.dumps(plain)))
    assert torch.equal(again.water.waters.glow, GLOW)


def test_where_a_medium_is_learned_or_fitted() -> None:
    module = Underwater(glowing(CLEAR), None, learnable=True)
    fixed = Underwater(glowing(CLEAR), None)(IMAGE, DISTANCE)
    torch.testing.assert_close(module(IMAGE, DISTANCE), fixed, rtol=0, atol=2e-3)
    other = Underwater(CLEAR, None, learnable=True)
    other.load_state_dict(module.state_dict())
    torch.testing.assert_close(other(IMAGE, DISTANCE), module(IMAGE, DISTANCE))
    other(IMAGE, DISTANCE).sum().backward()
    assert all(p.grad.isfinite().all() for p in other.parameters())
    # fits know none, and take it for veil
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
    for medium in (water, glowing(water, 2 * GLOW)):
        expected = Underwater(medium, (0.5, 6.0))(IMAGE, DISTANCE)
        torch.testing.assert_close(run(IMAGE, DISTANCE, medium), expected, rtol=0, atol=2e-5)
