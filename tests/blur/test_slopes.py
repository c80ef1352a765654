"""Gradients to the width, against differences of the exact model."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from referees import reference
from referees.terms import expected
from torch import Tensor

from uwaug import Medium, PointSpread, Underwater, Water, form_image
from uwaug._support.types import Shape

SIDE, NEAR, FAR = 48, 1.0, 5.5  # px, m


def exact(image: Tensor, z: Tensor, medium: Medium) -> Tensor:
    """The model with a blur that is exact at every pixel."""
    return torch.from_numpy(sum(expected(image[0], z[0, 0], medium)))[None]


def scene() -> tuple[Tensor, Tensor]:
    """A picture at 1…5.5 m."""
    image = torch.from_numpy(reference.picture(SIDE, SIDE))[None].clamp(0, 1)
    steps = np.kron(np.random.default_rng(0).random((4, 4)), np.ones((SIDE // 4, SIDE // 4)))
    share = 0.6 * steps + 0.4 * np.linspace(0, 1, SIDE**2).reshape(SIDE, SIDE)
    share = (share - share.min()) / (share.max() - share.min())
    return image, torch.from_numpy(NEAR + (FAR - NEAR) * share)[None, None]


def with_scale(medium: Medium, scale: float | Tensor) -> Medium:
    return replace(medium, scale=torch.as_tensor(scale, dtype=torch.float64).reshape(1))


@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
@pytest.mark.parametrize("name", ["7C", "1C", "II"])
def test_the_slope_in_the_width_is_that_of_the_exact_model(name: str, shape: Shape) -> None:
    image, z = scene()
    medium = Medium.from_water(Water.jerlov(name), tolerance=1e-4)
    # widths of 2.1…11 px
    exponent = math.log(11 / 2.1) / math.log(FAR / NEAR)
    law = PointSpread(2.1 / (float(medium.b_mean) * NEAR) ** exponent, exponent, shape)
    medium = Medium.from_water(Water.jerlov(name), tolerance=1e-4, point_spread=law)
    wider, more, less = (
        exact(image, z, with_scale(medium, times * law.scale)) for times in (1.3, 1.001, 0.999)
    )
    other = Medium.from_water(Water.jerlov("5C"), point_spread=law)
    for target in (image, wider, exact(image, z, other)):
        losses = [(picture - target).square().mean() for picture in (more, less)]
        right = float(losses[0] - losses[1]) / (0.002 * law.scale)
        scale = torch.tensor([law.scale], dtype=torch.float64, requires_grad=True)
        loss = (form_image(image, z, with_scale(medium, scale)).image - target).square().mean()
        (ours,) = torch.autograd.grad(loss, scale)
        assert float(ours) == pytest.approx(right, rel=0.03)


@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
@pytest.mark.parametrize("scale", [0.0, 1e-3, 0.01, 0.1])
@pytest.mark.parametrize("name", ["7C", "I"])
def test_a_narrow_width_can_be_learned(name: str, scale: float, shape: Shape) -> None:
    # no blur would show, but its slope does
    image, z = scene()
    width = torch.tensor([scale], dtype=torch.float64, requires_grad=True)
    exponent = torch.tensor([1.0], dtype=torch.float64, requires_grad=True)
    medium = Medium.from_water(Water.jerlov(name), point_spread=PointSpread(1.0, 1.0, shape))
    medium = replace(medium, scale=width, exponent=exponent)
    form_image(image, z, medium).image.square().sum().backward()
    assert width.grad is not None
    assert exponent.grad is not None
    assert bool(width.grad.isfinite().all())
    if scale >= 0.01:
        assert float(width.grad.abs()) > 0


@pytest.mark.parametrize("start", [0.05, 0.1, 0.5, 2.5])
def test_a_width_is_learned_from_far_away(start: float) -> None:
    # ends of the plan, an octave from the start, are no ends for what is learned
    image, z = scene()
    truth = Medium.from_coefficients(
        (0.62, 0.41, 0.48),
        (0.30, 0.15, 0.20),
        (0.10, 0.28, 0.33),
        b_mean=0.3,
        point_spread=PointSpread(4.0),
    )
    with torch.no_grad():
        observed = form_image(image, z, truth, tolerance=1e-4).image
    begun = with_scale(truth, 4.0 * start)
    degrade = Underwater(begun, (0.5, 6.0), color_space="linear", learnable=["width"])
    optimiser = torch.optim.LBFGS(degrade.parameters(), max_iter=60, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        value = (degrade(image, z) - observed).square().mean()
        value.backward()
        return value.detach()

    optimiser.step(loss)
    learned = degrade.medium.scale.detach()
    assert float(learned) == pytest.approx(4.0, rel=0.02)
    # the module that is exported plans for what was learned, and so does one that loads its state
    assert degrade.demand.high >= float(learned) * 0.3 * 6.0
    loaded = Underwater(begun, (0.5, 6.0), color_space="linear", learnable=["width"])
    loaded.load_state_dict(degrade.state_dict())
    with torch.no_grad():
        assert (loaded(image, z) - degrade(image, z)).square().mean().sqrt() <= 0.0005
