import math

import pytest
import torch
from torch import Tensor

import uwaug
from uwaug.fitting.veil import fit_veil
from uwaug.formation.colour import linear_to_srgb

H, W = 90, 120
DISTANCE = torch.linspace(0.8, 8.0, H * W).reshape(1, H, W)
VEIL, G = (0.1, 0.35, 0.45), (0.5, 0.35, 0.4)


def scene(darkest: float = 0.0) -> Tensor:
    """Patches of linear light, some of them black, at every distance."""
    generator = torch.Generator().manual_seed(1)
    patches = torch.rand(3, 18, 24, generator=generator) ** 2
    patches[:, torch.rand(18, 24, generator=generator) < 0.1] = 0
    light = patches.repeat_interleave(5, 1).repeat_interleave(5, 2)
    return darkest + (1 - darkest) * light


def water(veil: tuple[float, ...] = VEIL, G: tuple[float, ...] = G) -> uwaug.Medium:
    beta = [rate + 0.1 for rate in G]
    return uwaug.Medium.from_coefficients(beta, G, veil)


def seen(
    medium: uwaug.Medium,
    distance: Tensor = DISTANCE,
    noise: float = 0.01,
    darkest: float = 0.0,
    seed: int = 0,
) -> Tensor:
    light = uwaug.form_image(scene(darkest), distance, medium).image
    generator = torch.Generator().manual_seed(seed)
    light = light + noise * torch.randn(light.shape, generator=generator)
    return (linear_to_srgb(light).clamp(0, 1) * 255).round().to(torch.uint8)


def test_finds_the_veil() -> None:
    found = fit_veil(seen(water()), DISTANCE)
    assert found.veil.tolist() == pytest.approx(VEIL, rel=0.07)
    assert found.G.tolist() == pytest.approx(G, rel=0.15)
    z = torch.linspace(1, 8, 20)
    truth = water().backscatter(z)
    assert found.backscatter(z).shape == truth.shape
    assert (found.backscatter(z) - truth).abs().max() < 0.01
    assert found.source.tolist() == pytest.approx((found.veil * found.G).tolist())
    assert set(found.errors) == set(found.parameters)
    for one in found.parameters.values():
        assert 0 < one.error < 0.3 * one.value
    assert found.message.startswith("An estimate")
    assert "veil_red" in found.summary()
    assert "V(0) = 0.09" in repr(found)


def test_its_medium_degrades() -> None:
    found = fit_veil(seen(water()), DISTANCE)
    torch.testing.assert_close(found.medium.beta, found.medium.G)
    again = uwaug.Underwater(found.medium)(scene(), DISTANCE)
    assert again.shape == scene().shape


def test_nothing_black_is_too_much_veil() -> None:
    """The one way in which the estimate errs that no picture tells."""
    black, grey = fit_veil(seen(water()), DISTANCE), fit_veil(seen(water(), darkest=0.1), DISTANCE)
    z = torch.tensor(1.0)
    assert (grey.backscatter(z) > black.backscatter(z) + 0.01).all()


def test_chance_does_not_matter() -> None:
    one, other = fit_veil(seen(water()), DISTANCE), fit_veil(seen(water()), DISTANCE)
    assert torch.equal(one.veil, other.veil)
    assert one.errors == other.errors
    third = fit_veil(seen(water(), seed=1), DISTANCE, seed=1)
    for c, colour in enumerate(("red", "green", "blue")):
        apart = abs(float(third.veil[c] - one.veil[c]))
        assert 0 < apart < 4 * one.errors[f"veil_{colour}"]


def test_a_straight_line_has_no_end() -> None:
    thin = water(veil=(2.0, 4.0, 5.0), G=(0.02, 0.01, 0.01))
    found = fit_veil(seen(thin), DISTANCE)
    assert found.veil.isnan().all()
    assert found.G.isnan().all()
    assert "Not identified: veil and G of red" in found.message
    assert "straight line at 7" in found.message
    assert found.source.tolist() == pytest.approx((0.04, 0.04, 0.05), rel=0.2)
    z = torch.tensor([2.0, 6.0])
    assert (found.backscatter(z) - thin.backscatter(z)).abs().max() < 0.02
    assert "?" in repr(found)


def test_half_grown_is_said_to_be_uncertain() -> None:
    clear = water(G=(0.1, 0.1, 0.1))
    assert "the veil is far from its end" in fit_veil(seen(clear), DISTANCE).message
    assert "far from its end" not in fit_veil(seen(water()), DISTANCE).message


def test_open_water_shows_the_end() -> None:
    distance = DISTANCE.clone()
    distance[:, :20] = math.inf
    veil = (0.3, 0.35, 0.45)
    clear = water(veil, G=(0.08, 0.06, 0.07))
    found = fit_veil(seen(clear, distance), distance)
    assert found.farthest == math.inf
    assert found.veil.tolist() == pytest.approx(veil, rel=0.02)
    assert found.G.tolist() == pytest.approx((0.08, 0.06, 0.07), rel=0.1)


def test_several_pictures_field_and_mask() -> None:
    near, far = DISTANCE / 2, DISTANCE
    pictures = [seen(water(), near), seen(water(), far)]
    field = torch.full_like(DISTANCE, 0.5)
    found = fit_veil(pictures, [far, far], field=[field, 2 * field])
    assert found.G.tolist() == pytest.approx(G, rel=0.15)
    bad = pictures[1].clone()
    bad[:, :, :60] = 5  # an edge that is no water
    mask = torch.zeros(1, H, W, dtype=torch.bool)
    mask[..., 60:] = True
    masked, whole = fit_veil(bad, far, mask=mask), fit_veil(bad, far)
    assert masked.veil.tolist() == pytest.approx(VEIL, rel=0.1)
    assert (whole.backscatter(torch.tensor(6.0)) < 0.1).all()


def test_unit_of_light_and_distance() -> None:
    """Linear light may be of any scale."""
    light = uwaug.form_image(scene(), DISTANCE, water()).image
    one = fit_veil(light, DISTANCE, color_space="linear")
    bright = fit_veil(50 * light, DISTANCE, color_space="linear")
    torch.testing.assert_close(bright.veil, 50 * one.veil, rtol=1e-3, atol=0)
    torch.testing.assert_close(bright.G, one.G, rtol=1e-3, atol=0)
    far = fit_veil(light, 3 * DISTANCE, color_space="linear")
    torch.testing.assert_close(3 * far.G, one.G, rtol=1e-3, atol=0)


@pytest.mark.parametrize(
    "change, error, message",
    [
        ({"distance": torch.full_like(DISTANCE, 3.0)}, ValueError, "distance is flat"),
        ({"distance": 1000 * DISTANCE}, ValueError, "must be in metres"),
        ({"distance": torch.full_like(DISTANCE, torch.nan)}, ValueError, "only 0 pixels"),
        ({"distance": DISTANCE[..., :5]}, ValueError, "distance is"),
        ({"observed": torch.zeros(3, H, W)}, ValueError, "10800 black in observed"),
        ({"observed": torch.rand(H, W)}, ValueError, "observed must have shape"),
        ({"observed": "picture"}, TypeError, "observed"),
        ({"observed": 300 * torch.rand(3, H, W)}, ValueError, "observed reaches"),
        ({"bins": 2}, ValueError, r"bins must be in \[3"),
        ({"share": 0.9}, ValueError, "share must be in"),
        ({"color_space": "rgb"}, ValueError, "color_space must be one of"),
    ],
)
def test_refuses(change: dict[str, object], error: type[Exception], message: str) -> None:
    given = {"observed": seen(water()), "distance": DISTANCE, **change}
    with pytest.raises(error, match=message):
        fit_veil(**given)


def test_refuses_two_distances() -> None:
    distance = torch.where(DISTANCE < 4, 2.0, 6.0) + 1e-3 * DISTANCE
    with pytest.raises(ValueError, match="steps of distance hold 50 pixels, expected 3"):
        fit_veil(seen(water(), distance), distance)
