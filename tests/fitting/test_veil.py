import math

import pytest
import torch
from fitted import STONES, as_bytes, medium, scene, stones, veil_water, veiled

import uwaug
from uwaug.fitting import fit_veil
from uwaug.formation.colour import srgb_to_linear

BLACK = {"darkest": 0.0}  # what is known of the stones: at each distance some are black
VEIL, G = (0.1, 0.35, 0.45), (0.5, 0.35, 0.4)


def test_finds_the_veil(veil: uwaug.fitting.VeilFit) -> None:
    assert veil.veil.tolist() == pytest.approx(VEIL, rel=0.07)
    assert veil.G.tolist() == pytest.approx(G, rel=0.15)
    z = torch.linspace(1, 8, 20)
    truth = veil_water().backscatter(z)
    assert veil.backscatter(z).shape == truth.shape
    assert (veil.backscatter(z) - truth).abs().max() < 0.01
    assert veil.source.tolist() == pytest.approx((veil.veil * veil.G).tolist())
    assert set(veil.errors) == set(veil.parameters)
    for number in veil.parameters.values():
        assert 0 < number.error < 0.25 * number.value
    assert veil.message.startswith("An estimate")
    assert "far from its end" not in veil.message
    assert "veil_red" in veil.summary()
    assert "V(0) = 0.09" in repr(veil)
    torch.testing.assert_close(veil.medium.beta, veil.medium.G)


def test_nothing_black_is_too_much_veil(veil: uwaug.fitting.VeilFit) -> None:
    """The one way in which the estimate errs that no picture tells."""
    grey = fit_veil(veiled(veil_water(), darkest=0.1), STONES)
    z = torch.tensor(1.0)
    assert (grey.backscatter(z) > veil.backscatter(z) + 0.01).all()


@pytest.mark.parametrize("floor", [0.0, 0.05, 0.1, 0.2])
def test_intervals_count_what_dark_surfaces_may_reflect(floor: float) -> None:
    """Of the bundled scene, whose surfaces nowhere reflect less than `floor`: G_red would be .85
    ± .04 at .05, for a true .3.
    """
    clean, z = scene(step=4)
    light = floor + (1 - floor) * srgb_to_linear(clean.double() / 255)
    G, veil = (0.30, 0.15, 0.20), (0.10, 0.28, 0.33)
    water = uwaug.Medium.from_coefficients((0.62, 0.41, 0.48), G, veil)
    fit = fit_veil(as_bytes(uwaug.form_image(light, z.double(), water).image), z)
    truth = {"G": G, "veil": veil, "source": [x * y for x, y in zip(G, veil, strict=True)]}
    for name, number in fit.parameters.items():
        kind, _, colour = name.partition("_")
        right = truth[kind][("red", "green", "blue").index(colour)]
        assert number.low is None or number.low <= right <= number.high, name
    assert "up to 0.05 of white" in fit.message


def test_what_is_known_of_dark_surfaces_narrows(veil: uwaug.fitting.VeilFit) -> None:
    usual = fit_veil(veiled(veil_water()), STONES)
    assert usual.errors["G_blue"] > 2 * veil.errors["G_blue"]
    assert "G_red" not in usual.errors  # as dark as the veil of red
    assert usual.G[2].item() == veil.G[2].item()


def test_a_scene_without_anything_dark_tells_no_growth() -> None:
    """Of surfaces of .5 to 1 the darkest are as light at 2 m as at 5."""
    clean, z = scene(3)
    bright, usual = (
        as_bytes(uwaug.form_image(srgb_to_linear(values), z.double(), medium()).image)
        for values in (0.5 + clean.double() / 510, clean.double() / 255)
    )
    fit = fit_veil(bright, z)
    assert fit.G.isnan().all()
    assert fit.source.isnan().all()
    assert "the water is very turbid, or nothing in view is black" in fit.message
    assert "very turbid" not in fit_veil(usual, z).message


def test_chance_does_not_matter(veil: uwaug.fitting.VeilFit) -> None:
    again = fit_veil(veiled(veil_water()), STONES, **BLACK)
    assert torch.equal(again.veil, veil.veil)
    assert again.errors == veil.errors
    third = fit_veil(veiled(veil_water(), seed=1), STONES, seed=1, **BLACK)
    for c, colour in enumerate(("red", "green", "blue")):
        apart = abs(float(third.veil[c] - veil.veil[c]))
        assert 0 < apart < 4 * veil.errors[f"veil_{colour}"]


def test_a_straight_line_has_no_end() -> None:
    thin = veil_water(veil=(2.0, 4.0, 5.0), G=(0.02, 0.01, 0.01))
    fit = fit_veil(veiled(thin), STONES, **BLACK)
    assert fit.veil.isnan().all()
    assert fit.G.isnan().all()
    assert "Not identified: veil_red, veil_green, veil_blue, G_red" in fit.message
    assert "In red, green, blue the veil still grows as a straight line at 7" in fit.message
    assert fit.source.tolist() == pytest.approx((0.04, 0.04, 0.05), rel=0.2)
    z = torch.tensor([2.0, 6.0])
    assert (fit.backscatter(z) - thin.backscatter(z)).abs().max() < 0.02
    assert "?" in repr(fit)


def test_half_grown_is_said_to_be_uncertain() -> None:
    clear = veil_water(G=(0.1, 0.1, 0.1))
    assert "the veil is far from its end" in fit_veil(veiled(clear), STONES, **BLACK).message


def test_open_water_shows_the_end() -> None:
    distance = STONES.clone()
    distance[:, :20] = math.inf
    veil = (0.3, 0.35, 0.45)
    clear = veil_water(veil, G=(0.08, 0.06, 0.07))
    fit = fit_veil(veiled(clear, distance), distance, **BLACK)
    assert fit.farthest == math.inf
    assert fit.veil.tolist() == pytest.approx(veil, rel=0.02)
    assert fit.G.tolist() == pytest.approx((0.08, 0.06, 0.07), rel=0.1)


def test_several_pictures_field_and_mask() -> None:
    near, far = STONES / 2, STONES
    pictures = [veiled(veil_water(), near), veiled(veil_water(), far)]
    field = torch.full_like(STONES, 0.5)
    fit = fit_veil(pictures, [far, far], field=[field, 2 * field], **BLACK)
    assert fit.G.tolist() == pytest.approx(G, rel=0.15)
    bad = pictures[1].clone()
    bad[:, :, :60] = 5  # an edge that is no water
    mask = torch.zeros(1, 90, 120, dtype=torch.bool)
    mask[..., 60:] = True
    masked, whole = fit_veil(bad, far, mask=mask, **BLACK), fit_veil(bad, far, **BLACK)
    assert masked.veil.tolist() == pytest.approx(VEIL, rel=0.1)
    assert (whole.backscatter(torch.tensor(6.0)) < 0.1).all()


def test_unit_of_light_and_distance() -> None:
    """Linear light may be of any scale."""
    light = uwaug.form_image(stones(), STONES, veil_water()).image
    one = fit_veil(light, STONES, color_space="linear", **BLACK)
    bright = fit_veil(50 * light, STONES, color_space="linear", **BLACK)
    torch.testing.assert_close(bright.veil, 50 * one.veil, rtol=1e-3, atol=0)
    torch.testing.assert_close(bright.G, one.G, rtol=1e-3, atol=0)
    far = fit_veil(light, 3 * STONES, color_space="linear", **BLACK)
    torch.testing.assert_close(3 * far.G, one.G, rtol=1e-3, atol=0)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"distance": STONES[..., :5]}, "distance is .* but observed is"),
        ({"observed": torch.zeros(3, 90, 120)}, "10800 black in observed"),
        ({"observed": torch.full((3, 90, 120), 0.4)}, "one colour everywhere"),
        ({"darkest": 1.5}, r"darkest must be in \[0, 1\]"),
    ],
)
def test_refuses(change: dict[str, object], message: str) -> None:
    inputs = {"observed": veiled(veil_water()), "distance": STONES, **change}
    with pytest.raises(ValueError, match=message):
        fit_veil(**inputs)


def test_refuses_two_distances() -> None:
    distance = torch.where(STONES < 4, 2.0, 6.0) + 1e-3 * STONES
    with pytest.raises(ValueError, match="steps of distance hold 50 pixels, expected 3"):
        fit_veil(veiled(veil_water(), distance), distance)
