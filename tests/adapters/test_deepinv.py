from typing import Any

import pytest
import torch
from torch import Tensor

import uwaug


@pytest.fixture
def deepinv(torchvision: Any) -> Any:  # which deepinv imports
    return pytest.importorskip("deepinv")


@pytest.fixture
def physics(deepinv: Any) -> Any:
    from uwaug.adapters.deepinv import UnderwaterPhysics

    medium = uwaug.Medium.from_water("3C", vertical_depth=2, surfaces="spectral")
    camera = uwaug.Development(metered=True)
    return UnderwaterPhysics(uwaug.Underwater(medium, development=camera), metres())


def metres() -> Tensor:
    return torch.linspace(1, 3, 24).expand(1, 1, 16, 24).contiguous()


def scene() -> Tensor:
    return 0.1 + 0.6 * torch.rand(2, 3, 16, 24, generator=torch.Generator().manual_seed(0))


def test_pictures_of_the_module_and_new_distances(physics: Any) -> None:
    x, farther = scene(), metres() + 1
    assert torch.equal(physics(x), physics.water(x, metres()))
    expected = physics.water(x, farther)
    assert torch.equal(physics(x, distance=farther), expected)
    assert torch.equal(physics(x), expected)  # kept, as in deepinv's own
    physics.update(distance=metres())
    assert torch.equal(physics(x), physics.water(x, metres()))


def test_noise_and_sensor_come_after_the_water(deepinv: Any, physics: Any) -> None:
    noise = deepinv.physics.GaussianNoise(0.02, rng=torch.Generator().manual_seed(1))
    physics.set_noise_model(noise)
    off = physics(scene()) - physics.A(scene())
    assert 0.018 < float(off.std()) < 0.022


def test_slopes_are_those_of_differences_and_can_be_learned_through(physics: Any) -> None:
    physics.double()
    x, v = scene().double(), torch.rand_like(scene()).double()
    step = 1e-6 * torch.randn_like(x)
    rise = ((physics.A(x + step) - physics.A(x - step)) / 2 * v).sum()
    product = physics.A_vjp(x, v)
    assert not product.requires_grad  # no graph grows in a loop over steps
    assert torch.allclose((product * step).sum(), rise, rtol=1e-5)
    # an unrolled step: gradients to what went in, and to parameters
    physics.water = uwaug.Underwater(
        uwaug.Medium.from_water("3C").as_coefficients(), learnable=["rates", "veil"]
    )
    physics.double()
    x.requires_grad_()
    physics.A_vjp(x, physics.A(x) - v).square().sum().backward()
    assert x.grad.abs().min() > 0
    assert all(p.grad.abs().max() > 0 for p in physics.parameters())


def test_the_inverse_comes_near_the_scene(deepinv: Any) -> None:
    from uwaug.adapters.deepinv import UnderwaterPhysics

    physics, x = UnderwaterPhysics(uwaug.Medium.from_water("1C"), metres()), scene()
    y = physics(x)
    assert (physics.A_dagger(y) - x).square().mean() < 0.36 * (y - x).square().mean()
    assert torch.allclose(physics.A_dagger(y, x_init=x), x, atol=1e-4)
