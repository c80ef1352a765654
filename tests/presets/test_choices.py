"""The choices that published systems make, and what is refused of them."""

import json
import re

import numpy as np
import pytest
import torch
from PIL import Image

from uwaug import Medium, PointSpread, Underwater, Water, form_image, load_preset
from uwaug.light.geometry import focal_of

THREE = (0.5, 0.4, 0.3)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"downwelling": "Kd"}, "downwelling must be one of kd, beam, none, got 'Kd'"),
        ({"downwelling": None}, "downwelling must be one of kd, beam, none, got None"),
        ({"dims": "signal"}, "dims must be one of both, direct, veil, got 'signal'"),
        ({"veil_rate": "beam"}, "veil_rate must be one of G, beta, got 'beam'"),
        ({"forward": "J"}, "forward must be one of image, direct, got 'J'"),
    ],
)
def test_unknown_choices_are_refused(option, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        Medium.from_water("II", **option)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"veil_rate": (0.1, -0.1, 0.1)}, "veil_rate must be finite and ≥ 0"),
        ({"veil_rate": (0.1, float("inf"), 0.1)}, "veil_rate must be finite and ≥ 0"),
        ({"veil_rate": 0.1}, "veil_rate must have shape (3,) or (B, 3), got ()"),
        ({"veil_rate": torch.ones(2, 3), "light": torch.ones(3, 3)}, "batch sizes must agree"),
        ({"forward": "D"}, "forward must be one of image, direct, got 'D'"),
    ],
)
def test_coefficients_that_are_refused(option, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        Medium.from_coefficients(THREE, THREE, THREE, **option)


@pytest.mark.parametrize(
    ("transmission", "veil", "message"),
    [
        ((0.5, 1.1, 0.5), THREE, "transmission must be in [0, 1], got [[0.5, 1.1, 0.5]]"),
        ((0.5, -0.1, 0.5), THREE, "transmission must be finite and ≥ 0"),
        (THREE, (0.5, float("nan"), 0.5), "veil must be finite and ≥ 0"),
        ((0.5, 0.5), THREE, "transmission must have shape (3,) or (B, 3), got (2,)"),
    ],
)
def test_transmissions_that_are_refused(transmission, veil, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        Medium.from_transmission(transmission, veil)


def test_veils_that_are_refused():
    medium = Medium.stack([Medium.from_water("II"), Medium.from_water("7C")])
    with pytest.raises(ValueError, match="curve must be one of veil, signal, got 'G'"):
        medium.with_veil(THREE, curve="G")
    with pytest.raises(ValueError, match="veil must be finite and ≥ 0"):
        medium.with_veil((0.5, -0.5, 0.5))
    with pytest.raises(ValueError, match="batch sizes must agree or be 1"):
        medium.with_veil(torch.ones(3, 3))
    clear = Medium.from_coefficients(THREE, THREE, (0.5, 0.0, 0.5))
    with pytest.raises(
        ValueError, match=r'own veil, which is 0, or negative .*: try curve="signal"'
    ):
        clear.with_veil(THREE)
    deep = Medium.from_coefficients(THREE, THREE, THREE, light=(0.0, 1.0, 1.0))
    with pytest.raises(ValueError, match=r"own signal, which is 0, .*: no light is left"):
        deep.with_veil(THREE, curve="signal")
    assert clear.with_veil(THREE, curve="signal").veil_weights.sum() == pytest.approx(sum(THREE))


@pytest.mark.parametrize("curve", ["veil", "signal"])
def test_a_given_veil_keeps_its_curve(curve):
    medium = Medium.stack([Medium.from_water("II"), Medium.from_water("7C")])
    veil = torch.tensor([[0.1, 0.2, 0.3], [0.4, 0.0, 2.0]], dtype=torch.float64)
    changed = medium.with_veil(veil, curve)
    assert changed.notes == medium.notes
    z = torch.linspace(0, 20, 30, dtype=torch.float64)
    signal = medium.signal(z)
    come = 1 - signal / signal[..., :1]
    if curve == "veil":
        come = medium.backscatter(z) / medium.veil_weights.sum(-1)[..., None]
    exact = veil[..., None] * come
    torch.testing.assert_close(changed.backscatter(z), exact, rtol=0, atol=1e-12)
    assert torch.equal(changed.signal(z), signal)
    # its own veil changes nothing
    again = medium.with_veil(medium.veil_weights.sum(-1))
    torch.testing.assert_close(again.veil_weights, medium.veil_weights)


def test_one_water_with_several_veils_and_their_gradients():
    veil = torch.tensor([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], requires_grad=True)
    media = Medium.from_water("II").with_veil(veil)
    assert len(media) == 2
    assert len(media.notes) == 2
    image, z = torch.rand(3, 8, 9), torch.full((1, 8, 9), torch.inf)
    open_water = form_image(image, z, media).image
    torch.testing.assert_close(open_water[:, :, 0, 0], veil.detach())
    open_water.sum().backward()
    torch.testing.assert_close(veil.grad, torch.full((2, 3), 72.0))


def test_gradients_of_a_transmission():
    t = torch.tensor(THREE, dtype=torch.float64, requires_grad=True)
    image, z = torch.rand(3, 4, 5, dtype=torch.float64), torch.ones(1, 4, 5, dtype=torch.float64)
    form_image(image, z, Medium.from_transmission(t, THREE)).image.sum().backward()
    exact = (image - torch.tensor(THREE, dtype=torch.float64)[:, None, None]).sum((1, 2))
    torch.testing.assert_close(t.grad, exact)


def test_coefficients_with_a_rate_of_their_own_keep_gradients_and_batches():
    rate = torch.rand(2, 3, dtype=torch.float64).add(0.1).requires_grad_()
    medium = Medium.from_coefficients((0.9,) * 3, THREE, THREE, veil_rate=rate, forward="direct")
    assert len(medium) == 2
    z = torch.rand(1, 1, 4, 5, dtype=torch.float64)
    medium.backscatter(z).sum().backward()
    assert (rate.grad > 0).all()
    stacked = Medium.stack([medium, Medium.from_water("II", point_spread=PointSpread.none())])
    torch.testing.assert_close(stacked.signal(z)[:2], medium.signal(z))


def test_what_dims_what():
    water = Water([400, 550, 700], [0.1] * 3, [0.3] * 3, [0.2] * 3)

    def at_lens_and_far(**options: str) -> tuple[float, float]:
        medium = Medium.from_water(water, vertical_depth=5.0, **options)
        return float(medium.signal(torch.zeros(()))[0, 0]), float(medium.veil_weights[0, 0].sum())

    veil, kd, beam = 0.3 * 0.3 / 0.16, np.exp(-1.0), np.exp(-2.0)
    assert at_lens_and_far() == pytest.approx((kd, veil * kd), rel=1e-6)
    assert at_lens_and_far(dims="direct") == pytest.approx((kd, veil), rel=1e-6)
    assert at_lens_and_far(dims="veil") == pytest.approx((1, veil * kd), rel=1e-6)
    assert at_lens_and_far(downwelling="beam") == pytest.approx((beam, veil * beam), rel=1e-6)
    assert at_lens_and_far(downwelling="none") == pytest.approx((1, veil), rel=1e-6)
    assert at_lens_and_far(veil_rate="beta") == pytest.approx((kd, veil * 0.4 * kd), rel=1e-6)


def test_choices_are_said():
    plain = Medium.from_water("II").notes[0]
    assert plain.endswith("g = 0.2, μ = 0.3")
    chosen = Medium.from_water("II", forward="direct", dims="veil").notes[0]
    assert chosen.endswith("g = 0.2, μ = 0.3, dims = veil, forward = direct")


def test_forward_scatter_from_D_is_not_learned():
    medium = Medium.from_coefficients((0.9,) * 3, THREE, THREE, forward="direct")
    with pytest.raises(ValueError, match='forward="direct" cannot be learned'):
        Underwater(medium, learnable=True)
    given = Medium.from_coefficients((0.9,) * 3, THREE, THREE, veil_rate=(0.8,) * 3)
    learned = Underwater(given, learnable=True).medium
    z = torch.linspace(0, 9, 20, dtype=torch.float64)
    torch.testing.assert_close(learned.backscatter(z).detach(), given.backscatter(z))


# ----------------------------------------------------------------- preset files


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("hou-2020", {"water": "II"}, "holds one transmission, which no water replaces"),
        (
            "li-2020",
            {"water": "11C"},
            "water must be one of I, IA, IB, II, III, 1C, 3C, 5C, 7C, 9C",
        ),
        ("li-2020", {"water": Water.jerlov("II")}, "has no spectra: water must be one of I"),
        ("li-2020", {"camera": "Nikon 5100 (NPL)"}, "no water or camera replaces"),
        ("jaffe-1990", {"tolerance": 2.0}, "tolerance must lie in (0, 1)"),
    ],
)
def test_waters_that_are_refused(name, options, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        load_preset(name, **options)


# ----------------------------------------------------------------- the command


@pytest.mark.parametrize("name", ["jaffe-1990", "li-2020", "akkaynak-2018"])
def test_degrade_takes_a_system_and_a_water(run, tmp_path, name):
    generator = np.random.default_rng(0)
    picture = generator.integers(0, 256, (20, 24, 3), dtype=np.uint8)
    Image.fromarray(picture).save(tmp_path / "a.png")
    arguments = [str(tmp_path / "a.png"), "--distance", "3", "--preset", name, "--water", "7C"]
    code, _, err = run("degrade", *arguments, "--out", str(tmp_path / "b.png"))
    assert (code, err) == (0, "")
    made = torch.from_numpy(np.array(Image.open(tmp_path / "b.png"))).permute(2, 0, 1)
    image = torch.from_numpy(picture).permute(2, 0, 1).contiguous()
    preset = load_preset(name, water="7C")
    expected = preset.module(focal_px=focal_of(None, 24))(image, torch.full((1, 20, 24), 3.0))
    assert (made.int() - expected.int()).abs().max() <= 1
    record = json.loads((tmp_path / "b.png.json").read_text())
    assert name in json.dumps(record)
