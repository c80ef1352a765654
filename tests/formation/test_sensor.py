"""The noise of a sensor: its photon transfer curve, and where its randomness comes from."""

from typing import Any

import pytest
import torch
from scenes import coefficients, rand, stepped
from torch import Tensor

from uwaug import Development, Medium, Sensor, Underwater

AIR = Medium.from_coefficients([0.0] * 3, [0.0] * 3, [0.0] * 3)
WELL, READ = 800.0, 4.0


def taken(light: Tensor, seed: int | None = 1, **camera: Any) -> Tensor:
    """Linear pictures (Bx3xHxW) of a sensor."""
    development = Development(noise=Sensor(WELL, READ, seed), **camera)
    degrade = Underwater(AIR, color_space="linear", development=development)
    return degrade(light, torch.ones_like(light[:, :1]))


@pytest.mark.parametrize("loops", ["0", "1"])
@pytest.mark.parametrize("stops", [0.0, 3.0, -1.0])
def test_the_photon_transfer_curve(
    loops: str, stops: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The variance of electrons is their number and that of reading, within 2 %: so a stop less of
    light and a stop more of exposure doubles what photons add.
    """
    monkeypatch.setenv("UWAUG_FAST", loops)
    levels = torch.tensor([0.0, 1e-3, 0.01, 0.03, 0.1, 0.3, 1.0])
    picture = taken(levels.reshape(-1, 1, 1, 1).expand(-1, 3, 200, 200), exposure=stops)
    electrons = picture.double() * WELL / 2**stops
    mean, variance = electrons.mean((1, 2, 3)), electrons.var((1, 2, 3))
    number = WELL * levels.double()
    torch.testing.assert_close(variance, number + READ**2, rtol=0.025, atol=0)
    error = ((number + READ**2) / electrons[0].numel()).sqrt()
    assert ((mean - number).abs() < 4 * error).all()


def test_white_balance_and_saturation_come_after() -> None:
    """They mix the noise of channels, which are independent on the sensor."""
    light = torch.full((1, 3, 300, 300), 0.2)
    covariance = torch.cov(taken(light, saturation=0.5)[0].flatten(1).double())
    mixing = 0.5 * (torch.eye(3) + torch.tensor([0.2126, 0.7152, 0.0722]).expand(3, 3)).double()
    expected = (0.2 / WELL + (READ / WELL) ** 2) * mixing @ mixing.T
    torch.testing.assert_close(covariance, expected, rtol=0.02, atol=3e-6)


def test_nothing_repeats() -> None:
    """Neither channels, nor rows, nor columns, nor pictures are alike."""
    noise = taken(torch.full((2, 3, 256, 256), 0.5)).double() - 0.5
    shifted = [noise.roll((y, x), (-2, -1)) for y in range(9) for x in range(9) if y or x]
    for other in (*shifted, noise.roll(1, 1), noise.roll(1, 0)):
        assert ((noise * other).mean() / noise.var()).abs() < 0.01


def test_where_randomness_comes_from() -> None:
    light = rand(2, 3, 20, 30).float()
    assert torch.equal(taken(light), taken(light))
    assert torch.equal(taken(light)[:1], taken(light[:1]))
    assert not torch.equal(taken(light), taken(light, 2))
    torch.manual_seed(3)
    first, second = taken(light, None), taken(light, None)
    assert not torch.equal(first, second)
    torch.manual_seed(3)
    assert torch.equal(taken(light, None), first)


def test_to_gradients_noise_is_constant() -> None:
    image, z = rand(1, 3, 8, 9).double().requires_grad_(), stepped(1, 1, 8, 9).requires_grad_()

    def slopes(noise: Sensor | None) -> tuple[Tensor, ...]:
        camera = Development(exposure=1.0, noise=noise)
        degrade = Underwater(coefficients(), color_space="linear", development=camera)
        return torch.autograd.grad(degrade(image, z).sum(), (image, z))

    torch.testing.assert_close(slopes(Sensor(WELL, 0.0, 1)), slopes(None))
