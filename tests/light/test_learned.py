"""Numbers of a light that are learned, and the states of modules that have one."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from scenes import rand
from torch import Tensor

import uwaug
from uwaug import Light, Medium, Underwater, form_image

MEDIUM = Medium.from_water("5C", vertical_depth=3.0)
FOCAL = 50.0


def scene() -> tuple[Tensor, Tensor]:
    return rand(3, 20, 30).float(), 0.5 + 2 * rand(1, 20, 30, seed=1).float()


def lamp(**options: Any) -> Light:
    values = {"position": (0.4, -0.3, 0.0), "direction": (-0.1, 0.1, 1.0), "power": 3.0, **options}
    return Light.lamp(**values)


LEARNED: dict[str, tuple[Any, Callable[[Tensor], Light]]] = {
    "power": (2.0, lambda p: lamp(power=p)),
    "position": ((0.4, 0.0, 0.0), lambda p: lamp(position=p)),
    "direction": ((0.4, 0.0, 1.0), lambda p: lamp(direction=p)),
    "cone": (40.0, lambda p: lamp(cone=p)),
    "elevation": (40.0, lambda p: Light.parallel(p, 20.0)),
    "azimuth": ((20.0,), lambda p: Light.parallel(30.0, p)),
    "gradient": (0.2, lambda p: Light.ambient(gradient=p)),
}


@pytest.mark.parametrize("name", LEARNED)
def test_a_module_is_trained_for_several_steps(name: str) -> None:
    """It always shines with what its numbers are at the time."""
    start, make = LEARNED[name]
    number = torch.tensor(start, requires_grad=True)
    image, z = scene()
    module = Underwater(MEDIUM, light=make(number), focal_px=FOCAL)
    optimiser = torch.optim.SGD([number], lr=1.0)
    first = module(image, z).detach()
    for _ in range(3):
        optimiser.zero_grad()
        module(image, z).mean().backward()
        assert number.grad is not None
        assert number.grad.abs().max() > 0
        optimiser.step()
    assert not torch.equal(module(image, z), first)
    again = Underwater(MEDIUM, light=make(number), focal_px=FOCAL)
    torch.testing.assert_close(module(image, z), again(image, z))


@pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")
def test_torch_func_sees_a_lamp() -> None:
    """Its numbers, and the water around it."""
    image, z = scene()

    def mean(power: Tensor) -> Tensor:
        return form_image(image, z, MEDIUM, light=lamp(power=power), focal_px=FOCAL).image.mean()

    power = torch.tensor(2.0)
    found = torch.func.grad(mean)(power)
    power.requires_grad_()
    mean(power).backward()
    torch.testing.assert_close(found, power.grad)
    _, slope = torch.func.jvp(mean, (power.detach(),), (torch.tensor(1.0),))
    torch.testing.assert_close(slope, found)


def test_states_of_other_lights_are_refused() -> None:
    """However alike they look in print."""
    red, blue = (([400, 700], shares) for shares in ([0.0, 1.0], [1.0, 0.0]))
    left, right = (
        torch.tensor([[0.4, 0, 0], [-0.4, 0, 0]]),
        torch.tensor([[0.1, 0, 0], [0.2, 0, 0]]),
    )
    pairs = [
        (lamp(spectrum=red), lamp(spectrum=blue)),
        (lamp(position=left), lamp(position=right)),
        (Light.parallel(20, 30), Light.parallel(20, 40)),
        (Light.parallel(20, 30), None),
    ]
    for one, other in pairs:
        modules = [Underwater(MEDIUM, light=light, focal_px=FOCAL) for light in (one, other)]
        for mine, theirs in (modules, modules[::-1]):
            with pytest.raises((ValueError, RuntimeError), match="light is"):
                mine.load_state_dict(theirs.state_dict())
    narrow, wide = (Underwater(MEDIUM, light=lamp(), focal_px=px) for px in (FOCAL, 20.0))
    with pytest.raises(ValueError, match=r"camera is \[20.0, None\] there"):
        narrow.load_state_dict(wide.state_dict())
    again = Underwater(MEDIUM, light=lamp(), focal_px=FOCAL)
    again.load_state_dict(narrow.state_dict())


def test_numbers_of_a_lamp_are_for_one_batch() -> None:
    with pytest.raises(ValueError, match=r"batch sizes must agree or be 1.*'position': 3"):
        lamp(position=torch.zeros(3, 3), power=torch.ones(2))
    with pytest.raises(ValueError, match=r"batch sizes must agree.*'azimuth': 2"):
        Light.parallel(torch.ones(3), torch.ones(2))


def test_pictures_without_pixels() -> None:
    for light in (lamp(), Light.parallel(20, 30)):
        module = Underwater(MEDIUM, light=light, focal_px=FOCAL)
        for shape in ((0, 3, 4, 5), (1, 3, 0, 5), (1, 3, 4, 0)):
            image = torch.zeros(shape)
            assert module(image, image[:, :1]).shape == shape


@pytest.mark.parametrize("name", ["jaffe-1990", "mcglamery-1980"])
def test_modules_with_a_lamp_are_cast(name: str) -> None:
    image, z = scene()
    z = z.clamp(1.0, 5.0)  # what the systems plan for
    module = uwaug.load_preset(name).module(focal_px=28.0)
    first = module(image, z)
    exact = module.double()(image.double(), z.double())
    torch.testing.assert_close(exact.float(), first, rtol=0, atol=2e-5)
    assert torch.equal(module.float()(image, z), first)
    assert module.half()(image.half(), z.half()).dtype == torch.float16
