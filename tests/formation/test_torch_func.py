"""`torch.func` and forward mode, through a module that blurs."""

from collections.abc import Callable

import pytest
import torch
from scenes import rand
from torch import Tensor
from torch.autograd import forward_ad
from torch.func import functional_call, grad, hessian, jacfwd, jacrev, jvp, vmap

from uwaug.formation.model import form_image
from uwaug.formation.underwater import Underwater
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

Parameters = dict[str, Tensor]
# torch's own forward mode
pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")

IMAGE, Z = rand(1, 3, 20, 24), 1 + 3 * rand(1, 1, 20, 24, seed=1)


def medium(scale: Tensor | float = 4.0) -> Medium:
    """Widths from below 1 px, on the image's own grid, to beyond 3 px, on a coarse one."""
    return Medium.from_coefficients(
        (0.62, 0.41, 0.48),
        (0.30, 0.15, 0.20),
        (0.10, 0.28, 0.33),
        b_mean=0.3,
        point_spread=PointSpread(scale),
    )


@pytest.fixture(scope="module")
def degrade() -> Underwater:
    return Underwater(medium(), color_space="linear", learnable=True)


@pytest.fixture(scope="module")
def parameters(degrade: Underwater) -> Parameters:
    return {name: value.detach().clone() for name, value in degrade.named_parameters()}


@pytest.fixture(scope="module")
def picture(degrade: Underwater) -> Callable[[Parameters], Tensor]:
    return lambda parameters: functional_call(degrade, parameters, (IMAGE, Z))


def changed(parameters: Parameters, by: float) -> tuple[Parameters, Parameters]:
    """Parameters with a random direction added, `by` times; and the direction."""
    direction, moved = {}, {}
    for seed, (name, value) in enumerate(parameters.items()):
        direction[name] = rand(*value.shape, seed=seed).to(value) - 0.5
        moved[name] = value + by * direction[name]
    return moved, direction


def test_other_parameters_make_another_picture(degrade, parameters, picture) -> None:
    same, moved = picture(parameters), picture(changed(parameters, 0.1)[0])
    torch.testing.assert_close(same, degrade(IMAGE, Z).detach(), rtol=0, atol=1e-12)
    assert (moved - same).abs().max() > 0.01


def test_gradients_are_those_of_backward(degrade, parameters, picture) -> None:
    def loss(p: Parameters) -> Tensor:
        return picture(p).square().mean()

    degrade.zero_grad()
    degrade(IMAGE, Z).square().mean().backward()
    forth, back = jacfwd(loss)(parameters), jacrev(loss)(parameters)
    found = grad(loss)(parameters)
    for name, value in degrade.named_parameters():
        for one in (found, forth, back):
            torch.testing.assert_close(one[name], value.grad, rtol=1e-9, atol=1e-12)


def test_tangents_are_central_differences(parameters, picture) -> None:
    step = 1e-5
    (up, direction), (down, _) = (changed(parameters, by) for by in (step, -step))
    _, tangent = jvp(picture, (parameters,), (direction,))
    numeric = (picture(up) - picture(down)) / (2 * step)
    torch.testing.assert_close(tangent, numeric, rtol=0, atol=1e-8)


def test_jacobians_of_single_values(parameters, picture) -> None:
    def corner(p: Parameters) -> Tensor:
        return picture(p)[0, :, :2, 5]

    forth, back = jacfwd(corner)(parameters), jacrev(corner)(parameters)
    for name, value in back.items():
        torch.testing.assert_close(forth[name], value, rtol=1e-9, atol=1e-12)


def test_hessian_of_a_width() -> None:
    def loss(scale: Tensor) -> Tensor:
        return form_image(IMAGE, Z, medium(scale)).image.square().sum()

    scale, step = torch.tensor([4.0], dtype=torch.float64), 1e-3
    slopes = [grad(loss)(scale + by) for by in (step, -step)]
    expected = float(slopes[0] - slopes[1]) / (2 * step)
    assert float(hessian(loss)(scale)) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("plain", [False, True], ids=["jvp", "dual_level"])
@pytest.mark.parametrize("color_space", ["linear", "srgb"])
@pytest.mark.parametrize("order", ["line_of_sight", "source"])
def test_tangents_of_image_and_distance(order, color_space, plain) -> None:
    # without gradients, in strips that know no tangents, they would be lost
    along, forth = rand(*IMAGE.shape, seed=5), 0.1 * rand(*Z.shape, seed=6)
    degrade = Underwater(medium(), color_space=color_space, order=order)
    step = 1e-5
    up, down = (degrade(IMAGE + by * along, Z + by * forth) for by in (step, -step))
    if plain:
        with forward_ad.dual_level():
            dual = degrade(forward_ad.make_dual(IMAGE, along), forward_ad.make_dual(Z, forth))
            tangent = forward_ad.unpack_dual(dual).tangent
    else:
        _, tangent = jvp(degrade, (IMAGE, Z), (along, forth))
    torch.testing.assert_close(tangent, (up - down) / (2 * step), rtol=0, atol=1e-7)


def test_curvature_in_srgb() -> None:
    degrade = Underwater(medium())

    def loss(shift: Tensor) -> Tensor:
        return degrade(IMAGE, Z + shift).square().mean()

    shift, step = torch.zeros((), dtype=Z.dtype), 1e-5
    slopes = [grad(loss)(shift + by) for by in (step, -step)]
    expected = float(slopes[0] - slopes[1]) / (2 * step)
    assert float(hessian(loss)(shift)) == pytest.approx(expected, rel=1e-3)


def test_mapping_is_refused(parameters, picture) -> None:
    degrade = Underwater(medium())
    with pytest.raises(NotImplementedError, match=r"distance is mapped over.*give a batch"):
        vmap(lambda z: degrade(IMAGE, z))(Z.expand(2, 1, 1, 20, 24))
    with pytest.raises(NotImplementedError, match=r"image is mapped over.*give a batch"):
        vmap(lambda image: degrade(image, Z))(IMAGE.expand(2, 1, 3, 20, 24))
    doubled = {name: torch.stack([value, value]) for name, value in parameters.items()}
    with pytest.raises(NotImplementedError, match=r"medium's beta is mapped.*Medium\.stack"):
        vmap(picture)(doubled)
