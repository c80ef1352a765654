import copy
import math
import pickle

import pytest
import torch
from referees import reference
from scenes import LAW, MEDIA, coastal, distances, picture
from torch import Tensor

from uwaug.formation.underwater import Underwater
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread


@pytest.fixture(params=MEDIA)
def medium(request: pytest.FixtureRequest) -> Medium:
    return MEDIA[request.param]()


def test_nothing_to_learn_by_default(medium: Medium) -> None:
    degrade = Underwater(medium)
    assert list(degrade.parameters()) == []
    assert not degrade(picture(), distances()).requires_grad


def test_learning_starts_at_the_medium(medium: Medium) -> None:
    fixed, learnable = (Underwater(medium, learnable=flag) for flag in (False, True))
    image, z = picture(), distances()
    assert reference.psnr(learnable(image, z).detach(), fixed(image, z)) >= 54  # their plans differ


def test_learning_wants_equal_light_in_direct_and_signal() -> None:
    # one parameter stands for both; a medium in which they differ would start as another one
    given = coastal()
    medium = Medium(given.beta, 0.8 * given.direct_weights, *given.tensors()[2:], point_spread=LAW)
    with pytest.raises(ValueError, match="direct_weights"):
        Underwater(medium, learnable=True)


def test_every_parameter_learns_and_stays_positive(medium: Medium) -> None:
    degrade = Underwater(medium, learnable=True)
    image, z = picture(), distances()
    size = (image.shape[-2], image.shape[-1])
    optimiser = torch.optim.SGD(degrade.parameters(), lr=50.0)
    for _ in range(3):
        optimiser.zero_grad()
        degrade(image, z).square().sum().backward()
        for name, parameter in degrade.named_parameters():
            if name == "coefficients.raw_scale" and degrade.plan(size).sigmas == (0.0,):
                continue  # no blur is planned, as none would show
            assert parameter.grad is not None, name
            assert parameter.grad.isfinite().all(), name
        optimiser.step()
    learned = degrade.medium
    assert all((t >= 0).all() for t in learned.tensors())
    assert (torch.as_tensor(learned.point_spread.scale) >= 0).all()
    assert degrade(image, z).isfinite().all()
    # at distance 0
    direct = learned.direct_weights.sum(-1).detach()
    signal = learned.signal_weights.sum(-1).detach()
    torch.testing.assert_close(direct, signal, rtol=1e-6, atol=1e-9)


def test_learning_finds_another_water() -> None:
    image, z = picture(24, 24, 2), distances(24, 24, 2)
    truth = Medium.from_coefficients((0.5, 0.2, 0.3), (0.2, 0.1, 0.12), (0.1, 0.3, 0.4))
    observed = Underwater(truth, color_space="linear")(image, z)
    start = Medium.from_coefficients((0.3,) * 3, (0.15,) * 3, (0.2,) * 3)
    degrade = Underwater(start, color_space="linear", learnable=True)
    optimiser = torch.optim.LBFGS(degrade.parameters(), max_iter=60, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        value = (degrade(image, z) - observed).square().mean()
        value.backward()
        return value.detach()

    first = float(loss())
    optimiser.step(loss)
    assert float(loss()) < 1e-3 * first


def test_gradients_reach_every_input() -> None:
    degrade = Underwater(coastal(), learnable=True)
    image, z, field = picture().requires_grad_(), distances(), torch.ones(1, 1, 32, 40)
    z[0, 0, 0, :3] = torch.tensor([0.0, math.inf, 1e-20])
    with torch.no_grad():
        image[0, :, 1, :3] = torch.tensor([0.0, 1.0, 1e-20])
    z, field = z.requires_grad_(), field.requires_grad_()
    degrade(image, z, field).sum().backward()
    for leaf in (image, z, field, *degrade.parameters()):
        assert leaf.grad.isfinite().all()
    assert image.grad.abs().max() > 0
    assert z.grad.abs().max() > 0


@pytest.mark.parametrize("learnable", [False, True])
def test_a_learned_medium_starts_another_module(learnable: bool) -> None:
    # its tensors carry the gradients of the first module: the second must own its tensors, and be
    # copied and saved
    law = PointSpread(torch.tensor([1.5]), torch.tensor([0.7], requires_grad=True))
    first = Underwater(coastal(point_spread=law), learnable=True)
    second = Underwater(first.medium, learnable=learnable)
    image, z = picture(), distances()
    assert reference.psnr(second(image, z).detach(), first(image, z).detach()) >= 54
    if not learnable:
        assert not second(image, z).requires_grad
    for twin in (copy.deepcopy(second), pickle.loads(pickle.dumps(second))):
        assert torch.equal(twin(image, z), second(image, z))
    assert all(v.is_leaf for v in second.state_dict(keep_vars=True).values())
