"""The share of an object's contrast that is left: against pictures, spectra and light transport."""

import math

import numpy as np
import pytest
import torch
from referees.reference import spectral_curves
from torch import Tensor

from uwaug import Light, Medium, PointSpread, Water, contrast, form_image
from uwaug.formation.colour import LUMINANCE, srgb_to_linear

WATER = Water.jerlov("5C")
Z = torch.tensor([0.0, 0.01, 0.5, 1.0, 2.0, 5.0, 12.0, 60.0, math.inf]).double().reshape(1, 1, -1)


def luminance(light: Tensor) -> Tensor:
    return (light * torch.tensor(LUMINANCE).to(light).reshape(3, 1, 1)).sum(-3, keepdim=True)


LAMP = Light.lamp((0.3, -0.2, 0.0), (-0.3, 0.2, 0.7), 4.0, 60.0)


@pytest.mark.parametrize(
    "mean, light",
    [
        (0.05, None),
        (0.9, None),
        (0.18, LAMP),
        (0.18, LAMP + Light.ambient(0.5)),
        (0.18, Light.parallel(20, 150)),
    ],
)
def test_a_rendered_pattern_has_it(mean: float, light: Light | None) -> None:
    """A chequered plate, through the model itself, with a blur much wider than the chequers. What a
    lamp does not reach has none; its fog takes some.
    """
    depth = 1.0 if light is None else 8.0
    law = PointSpread(12.0, 1e-3)
    medium = Medium.from_water(WATER, vertical_depth=depth, mu=0.1, point_spread=law)
    rows, columns = torch.meshgrid(torch.arange(64), torch.arange(64), indexing="ij")
    chequers = (1 - 2 * ((rows + columns) % 2)).double()
    z = torch.full((1, 64, 64), 0.7).double()
    z[..., 32:] = 0.9
    lit = {"light": light, "focal_px": 64.0}
    left = contrast(medium, z, reflectance=mean, **lit)
    plates = (mean * (1 + sign * 0.5 * chequers).expand(3, -1, -1) for sign in (1, -1))
    one, other = (luminance(form_image(x, z, medium, **lit).image) for x in plates)
    measured = (one - other).abs() / (one + other) / 0.5
    bound = 1e-3 if light is None else 2e-3
    torch.testing.assert_close(measured, left, rtol=0, atol=bound)
    if light is None:
        assert left.min() > 0.05
    elif light is LAMP:
        assert (left - contrast(medium, z)).abs().max() > 0.05


def test_against_spectra() -> None:
    z = Z[0, 0, :-2].numpy()
    numbers = {"g": 0.05, "mu": 0.075}
    medium = Medium.from_water(WATER, vertical_depth=3.0, **numbers)
    direct, signal, veil = spectral_curves(WATER, z, depth=3.0, **numbers)
    seen = np.array(LUMINANCE)
    expected = seen @ direct * 0.18 / (seen @ (signal * 0.18 + veil))
    found = contrast(medium, Z[..., :-2])[0, 0].numpy()
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.003)


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
def test_from_the_lens_to_open_water(dtype: torch.dtype) -> None:
    found = contrast(Medium.from_water(WATER), Z.to(dtype)).double().flatten()
    assert found[0] == pytest.approx(1, abs=1e-3)
    assert (found.diff() <= 0).all()
    assert found[-1] == 0


def test_an_exposure_changes_nothing() -> None:
    medium = Medium.from_water(WATER, vertical_depth=4.0)
    brighter = medium.brightened(torch.tensor([7.0]))
    torch.testing.assert_close(contrast(brighter, Z), contrast(medium, Z))


def test_without_veil_it_is_the_direct_share() -> None:
    beta, G = (0.6, 0.6, 0.6), (0.2, 0.2, 0.2)
    medium = Medium.from_coefficients(beta, G, (0, 0, 0))
    torch.testing.assert_close(
        contrast(medium, Z), torch.exp(-0.4 * Z).where(Z < 60, 0), atol=1e-9, rtol=0
    )


def test_batches() -> None:
    media = Medium.stack([Medium.from_water(Water.jerlov(name)) for name in ("II", "7C")])
    maps = torch.rand(2, 1, 4, 5) * 5
    both = contrast(media, maps)
    assert both.shape == (2, 1, 4, 5)
    for i in range(2):
        torch.testing.assert_close(both[i], contrast(media[i], maps[i]))
    assert contrast(media, maps[0]).shape == (2, 1, 4, 5)
    assert contrast(media[0], maps[0]).shape == (1, 4, 5)
    assert contrast(media[0], maps).shape == (2, 1, 4, 5)


def test_the_scenes_own_light() -> None:
    medium = Medium.from_water(WATER)
    light = srgb_to_linear(torch.rand(3, 4, 5))
    light[:, 0, 0] = 0
    z = torch.full((1, 4, 5), 1.5)
    found = contrast(medium, z, reflectance=light)
    direct, signal, veil = (
        f(z)[0] for f in (medium.transmission, medium.signal, medium.backscatter)
    )
    expected = luminance(direct * light) / luminance(signal * light + veil)
    torch.testing.assert_close(found, expected)
    assert found[0, 0, 0] == 0
    same = contrast(medium, z, reflectance=torch.full((1, 4, 5), 0.18))
    torch.testing.assert_close(same, contrast(medium, z))


def test_gradients() -> None:
    medium = Medium.from_water(WATER)
    z = Z[..., 1:7].clone().requires_grad_()
    light = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda z, x: contrast(medium, z, reflectance=x), (z, light))
    everywhere = Z.clone().requires_grad_()
    clear = Medium.from_coefficients((0.6,) * 3, (0.2,) * 3, (0, 0, 0))
    for one in (medium, clear):
        (slope,) = torch.autograd.grad(contrast(one, everywhere).sum(), everywhere)
        assert slope.isfinite().all()
        assert (slope <= 0).all()


@pytest.mark.parametrize(
    "distance, reflectance, error, message",
    [
        (torch.ones(4, 5), 0.18, ValueError, r"distance must have shape .*: give distance\[None\]"),
        (torch.ones(1, 4, 5).int(), 0.18, TypeError, "distance must be a floating-point tensor"),
        (-torch.ones(1, 4, 5), 0.18, ValueError, "distance is NaN at 0 and negative at 20 of 20"),
        (torch.full((1, 4, 5), 2500.0), 0.18, ValueError, "divide by 1000: millimetres"),
        (torch.ones(3, 1, 4, 5), 0.18, ValueError, "batch sizes must agree or be 1"),
        (torch.ones(1, 4, 5), -0.1, ValueError, "reflectance must be finite and ≥ 0, got -0.1"),
        (torch.ones(1, 4, 5), -torch.ones(1), ValueError, "reflectance falls to -1"),
        (torch.ones(1, 4, 5), torch.ones(7), ValueError, r"reflectance is \(7,\): expected what"),
    ],
)
def test_refusals(
    distance: Tensor, reflectance: float | Tensor, error: type[Exception], message: str
) -> None:
    media = Medium.stack([Medium.from_water(WATER)] * 2)
    with pytest.raises(error, match=message):
        contrast(media, distance, reflectance=reflectance)


def test_a_medium_is_needed() -> None:
    with pytest.raises(TypeError, match=r"medium must be a uwaug\.Medium, got Water"):
        contrast(WATER, Z)  # type: ignore[arg-type]


def test_against_monte_carlo_pictures() -> None:
    """The share is right for detail up to 1° (2 px of these pictures), and a lower bound."""
    pytest.importorskip("cv2")
    from benchmarks.accuracy.contrast import PERIODS_PX, pictures

    rows = pictures()
    assert len(rows) == 6
    for row in rows:
        fine, *coarser = row["measured"]
        assert PERIODS_PX[0] == 2
        assert fine == pytest.approx(row["said"], abs=0.02)
        assert [fine, *coarser] == sorted([fine, *coarser])
        assert fine > row["said"] - 0.002
    # what a veil, a share or a rate that is wrong would miss by
    assert max(row["said"] for row in rows) - min(row["said"] for row in rows) > 0.4


def test_a_light_that_does_not_suit_is_named() -> None:
    medium, z = Medium.from_water(WATER), torch.ones(2, 1, 4, 5)
    with pytest.raises(ValueError, match="focal_px is missing"):
        contrast(medium, z, light=LAMP)
    with pytest.raises(TypeError, match=r"light must be a uwaug\.Light, got str"):
        contrast(medium, z, light="lamp")  # type: ignore[arg-type]
    three = Light.lamp((0, 0, 0), (0, 0, 1), power=torch.ones(3))
    with pytest.raises(ValueError, match=r"batch sizes must agree.*'light': 3"):
        contrast(medium, z, light=three, focal_px=5.0)
    assert contrast(medium, z[0], light=three, focal_px=5.0).shape == (3, 1, 4, 5)
