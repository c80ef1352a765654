"""The share of an object's contrast that is left: against pictures, spectra and light transport."""

import math

import numpy as np
import pytest
import torch
from referees.reference import spectral_curves
from torch import Tensor

from uwaug import Medium, PointSpread, Water, contrast_left, form_image
from uwaug.formation.colour import LUMINANCE

WATER = Water.jerlov("5C")
Z = torch.tensor([0.0, 0.01, 0.5, 1.0, 2.0, 5.0, 12.0, 60.0, math.inf]).double().reshape(1, 1, -1)


def luminance(light: Tensor) -> Tensor:
    return (light * torch.tensor(LUMINANCE).to(light).reshape(3, 1, 1)).sum(-3, keepdim=True)


def test_against_spectra() -> None:
    z, numbers = Z[0, 0, :-2].numpy(), {"g": 0.05, "mu": 0.075}
    medium = Medium.from_water(WATER, vertical_depth=3.0, **numbers)
    direct, signal, veil = spectral_curves(WATER, z, depth=3.0, **numbers)
    seen = np.array(LUMINANCE)
    expected = seen @ direct * 0.18 / (seen @ (signal * 0.18 + veil))
    ours = contrast_left(Z[..., :-2], medium)[0, 0].numpy()
    np.testing.assert_allclose(ours, expected, rtol=0, atol=0.003)


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
def test_from_the_lens_to_open_water(dtype: torch.dtype) -> None:
    shares = contrast_left(Z.to(dtype), Medium.from_water(WATER)).double().flatten()
    assert shares[0] == pytest.approx(1, abs=1e-3)
    assert (shares.diff() <= 0).all()
    assert shares[-1] == 0


def test_batches() -> None:
    media = Medium.stack([Medium.from_water(Water.jerlov(name)) for name in ("II", "7C")])
    maps = torch.rand(2, 1, 4, 5) * 5
    both = contrast_left(maps, media)
    for i in range(2):
        torch.testing.assert_close(both[i], contrast_left(maps[i], media[i]))
    assert contrast_left(maps[0], media).shape == contrast_left(maps, media[0]).shape == both.shape


def test_gradients() -> None:
    water, z = Medium.from_water(WATER), Z[..., 1:7].clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda z: contrast_left(z, water), z)
    everywhere = Z.clone().requires_grad_()
    for medium in (water, Medium.from_coefficients((0.6,) * 3, (0.2,) * 3, (0, 0, 0))):
        (slope,) = torch.autograd.grad(contrast_left(everywhere, medium).sum(), everywhere)
        assert (slope.isfinite() & (slope <= 0)).all()


def test_a_rendered_pattern_has_it() -> None:
    """A chequered plate, through the model itself, with a blur much wider than the chequers."""
    medium = Medium.from_water(WATER, mu=0.1, point_spread=PointSpread(12.0, 1e-3))
    chequers = 1 - 2 * (torch.arange(64)[:, None] + torch.arange(64)).remainder(2).double()
    z = torch.where(torch.arange(64) < 32, 0.7, 0.9).double().expand(1, 64, 64)
    left = contrast_left(z, medium)
    plates = (0.18 * (1 + sign * 0.5 * chequers).expand(3, -1, -1) for sign in (1, -1))
    bright, dark = (luminance(form_image(plate, z, medium).image) for plate in plates)
    measured = (bright - dark).abs() / (bright + dark) / 0.5
    torch.testing.assert_close(measured, left, rtol=0, atol=1e-3)
    assert left.min() > 0.05
