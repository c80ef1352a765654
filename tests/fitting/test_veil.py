import math

import pytest
import torch
from fitted import STONES, as_bytes, medium, scene, stones, veil_water, veiled

import uwaug
from uwaug.fitting import Fit, fit_veil
from uwaug.formation.colour import srgb_to_linear

BLACK = {"darkest": 0.0}  # what is known of the stones: at each distance some are black
VEIL, G = (0.1, 0.35, 0.45), (0.5, 0.35, 0.4)


def values(fit: Fit, kind: str) -> list[float]:
    return [fit.parameters[f"{kind}_{colour}"].value for colour in ("red", "green", "blue")]


def at(fit: Fit, *metres: float) -> torch.Tensor:
    return fit.medium.backscatter(torch.tensor(metres, dtype=torch.float64))


def test_finds_the_veil(veil: Fit) -> None:
    assert values(veil, "veil") == pytest.approx(VEIL, rel=0.07)
    assert values(veil, "G") == pytest.approx(G, rel=0.15)
    z = torch.linspace(1, 8, 20)
    assert (veil.medium.backscatter(z) - veil_water().backscatter(z)).abs().max() < 0.01
    assert all(0 < veil.errors[name] < 0.25 * x.value for name, x in veil.parameters.items())
    assert veil.notes[0].startswith("An estimate")
    torch.testing.assert_close(veil.medium.beta, veil.medium.G)
    distance = torch.stack([STONES / 2, STONES])
    pictures = torch.stack([veiled(veil_water(), z) for z in distance])
    assert values(fit_veil(pictures, distance, **BLACK), "G") == pytest.approx(G, rel=0.15)


def test_nothing_black_is_too_much_veil(veil: Fit) -> None:
    """The one way in which the estimate errs that no picture tells."""
    grey = fit_veil(veiled(veil_water(), darkest=0.1), STONES)
    assert (at(grey, 1.0) > at(veil, 1.0) + 0.01).all()


@pytest.mark.parametrize("floor", [0.05, 0.2])
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
        if number.low is not None and number.high is not None:
            assert number.low <= right <= number.high, name
    assert "within an error of 0.05 of white" in fit.notes[0]


def test_a_scene_without_anything_dark_tells_no_growth() -> None:
    """Of surfaces of .5 to 1 the darkest are as light at 2 m as at 5."""
    clean, z = scene(3)
    light = srgb_to_linear(0.5 + clean.double() / 510)
    fit = fit_veil(as_bytes(uwaug.form_image(light, z.double(), medium()).image), z)
    assert values(fit, "G") == values(fit, "source") == [None] * 3
    assert "the water is very turbid, or nothing in view is black" in fit.summary()


def test_a_straight_line_has_no_end() -> None:
    thin = veil_water(veil=(2.0, 4.0, 5.0), G=(0.02, 0.01, 0.01))
    fit = fit_veil(veiled(thin), STONES, **BLACK)
    assert values(fit, "veil") == values(fit, "G") == [None] * 3
    assert "In red, green, blue the veil still grows as a straight line at 7" in fit.summary()
    assert values(fit, "source") == pytest.approx((0.04, 0.04, 0.05), rel=0.2)
    there = thin.backscatter(torch.tensor([2.0, 6.0]))
    assert (at(fit, 2.0, 6.0) - there).abs().max() < 0.02


def test_open_water_shows_the_end() -> None:
    distance = STONES.clone()
    distance[:, :20] = math.inf
    veil, rates = (0.3, 0.35, 0.45), (0.08, 0.06, 0.07)
    fit = fit_veil(veiled(veil_water(veil, G=rates), distance), distance, **BLACK)
    assert values(fit, "veil") == pytest.approx(veil, rel=0.02)
    assert values(fit, "G") == pytest.approx(rates, rel=0.1)


def test_unit_of_light_and_distance() -> None:
    """Linear light may be of any scale."""
    light = uwaug.form_image(stones(), STONES, veil_water()).image
    pairs = ((light, STONES), (50 * light, STONES), (light, 3 * STONES))
    usual, bright, far = (fit_veil(*pair, color_space="linear", **BLACK) for pair in pairs)
    assert values(bright, "veil") == pytest.approx([50 * x for x in values(usual, "veil")])
    assert values(bright, "G") == pytest.approx(values(usual, "G"))
    assert [3 * x for x in values(far, "G")] == pytest.approx(values(usual, "G"), rel=1e-3)
