"""Coefficients as parameters."""

import math

import pytest
import torch
from referees import reference
from scenes import coefficients, distances, picture
from torch import Tensor

from uwaug import Medium, PointSpread, Underwater
from uwaug.formation import LearnableMedium

Z = torch.cat([torch.zeros(1), torch.logspace(-6, 6, 400), torch.tensor([math.inf])]).double()
NUMBERS = ((0.6, 0.3, 0.25), (0.4, 0.1, 0.08), (0.1, 0.3, 0.4))
MEDIA = {
    "coefficients": coefficients,
    "clear": lambda: Medium.from_coefficients((0.1, 0.0, 0.2), (0.0,) * 3, (0.0, 0.2, 0.3)),
    "batch": lambda: Medium.stack([coefficients(1), coefficients(2)]),
    "of surfaces": lambda: Medium.from_water("7C", surfaces="spectral").as_coefficients(),
}


@pytest.mark.parametrize("name", MEDIA)
def test_learning_starts_at_the_medium(name: str) -> None:
    medium = MEDIA[name]()
    begun = LearnableMedium(medium)()
    for name in ("transmission", "signal", "backscatter"):
        curves = [getattr(which, name)(Z).detach() for which in (begun, medium)]
        # farther on, a rate of 0, which begins as 1e-6/m, can be told from it
        near = Z <= 20
        torch.testing.assert_close(curves[0][..., near], curves[1][..., near], rtol=0, atol=4e-5)
    fixed, learnable = (Underwater(medium, learnable=flag) for flag in (False, True))
    image, z = picture(), distances()
    assert reference.psnr(learnable(image, z).detach(), fixed(image, z)) >= 54  # plans differ


@pytest.mark.parametrize("name", MEDIA)
@pytest.mark.parametrize("strength", [0.3, 30.0])
def test_whatever_is_learned_is_a_medium(name: str, strength: float) -> None:
    learnable = LearnableMedium(MEDIA[name]().to(torch.float64))
    torch.manual_seed(int(strength))
    with torch.no_grad():
        for parameter in learnable.parameters():
            parameter += strength * torch.randn_like(parameter)
        learned = learnable()
    assert all(((t >= 0) & t.isfinite()).all() for t in learned.tensors())
    assert (learned.beta >= learned.G).all()


def test_the_veil_has_a_limit_as_its_rate_falls_to_0() -> None:
    learnable = LearnableMedium(Medium.from_coefficients(*NUMBERS))
    z = torch.tensor([0.0, 0.5, 5.0], dtype=torch.float64)
    slope = torch.tensor(NUMBERS[1]).double() * torch.tensor(NUMBERS[2]).double()
    for raw in (-20.0, -100.0, -700.0):
        with torch.no_grad():
            learnable.raw_G.fill_(raw)
        veil = learnable().backscatter(z)
        torch.testing.assert_close(veil[0].detach(), slope[:, None] * z, rtol=1e-6, atol=1e-7)
        veil.sum().backward()
        assert all(p.grad is None or p.grad.isfinite().all() for p in learnable.parameters())


def test_coefficients_are_recovered() -> None:
    image, z = picture(24, 24, 2), distances(24, 24, 2)
    truth = Medium.from_coefficients((0.5, 0.2, 0.3), (0.2, 0.1, 0.12), (0.1, 0.3, 0.4))
    observed = Underwater(truth, color_space="linear")(image, z)
    start = Medium.from_coefficients((0.3,) * 3, (0.15,) * 3, (0.2,) * 3)
    degrade = Underwater(start, color_space="linear", learnable=["rates", "veil"])
    optimiser = torch.optim.LBFGS(degrade.parameters(), max_iter=300, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        value = 1e3 * (degrade(image, z) - observed).square().mean()
        value.backward()
        return value.detach()

    optimiser.step(loss)
    # without a blur, direct and scattered light are told apart by nothing: β does not show
    learned = degrade.medium
    torch.testing.assert_close(learned.G.detach(), truth.G, rtol=0.02, atol=0)
    found = learned.veil_weights.sum(-1).detach()
    torch.testing.assert_close(found, truth.veil_weights.sum(-1), rtol=0.02, atol=0)


@pytest.mark.parametrize("learned", ["rates", "veil", "width"])
def test_what_is_known_stays(learned: str) -> None:
    begun = Medium.from_coefficients(*NUMBERS, b_mean=1.0, point_spread=PointSpread(2.0, 0.9))
    degrade = Underwater(begun, (0.5, 6.0), learnable=[learned])
    optimiser = torch.optim.AdamW(degrade.parameters(), lr=0.1, weight_decay=0.1)
    for _ in range(3):
        optimiser.zero_grad()
        degrade(picture(24, 32), distances(24, 32)).square().mean().backward()
        optimiser.step()

    def parts(medium: Medium) -> dict[str, Tensor]:
        width = medium.scale.double()
        rates = torch.cat([medium.beta, medium.G])
        return {"rates": rates, "veil": medium.veil_weights.sum(-1), "width": width}

    before, after = parts(begun), parts(degrade.medium)
    for part, value in after.items():
        moved = float((value.detach() - before[part]).abs().max())
        assert moved > 1e-3 if part == learned else moved < 1e-6, part


def test_gradients_reach_every_input_and_are_finite() -> None:
    degrade = Underwater(coefficients(), learnable=True)
    image, z, field = picture(), distances(), torch.ones(1, 1, 32, 40)
    assert not Underwater(degrade.medium)(image, z).requires_grad  # begins another, by its numbers
    z[0, 0, 0, :3] = torch.tensor([0.0, math.inf, 1e-20])
    image[0, :, 1, :3] = torch.tensor([0.0, 1.0, 1e-20])
    leaves = [leaf.requires_grad_() for leaf in (image, z, field)]
    degrade(image, z, field).sum().backward()
    for leaf in (*leaves, *degrade.parameters()):
        assert leaf.grad.isfinite().all()
        assert leaf.grad.abs().max() > 0
