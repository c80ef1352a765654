"""What a module's state dict holds and refuses, and how the module is cast."""

import copy
import io
import json

import pytest
import torch
from scenes import LAW, coastal, distances, picture
from torch import nn

import uwaug
from uwaug import Development, Medium, PointSpread, Underwater, Water, form_image
from uwaug.formation import Scene, Setup


def start(water: str = "3C", law: PointSpread = LAW, **options: object) -> Underwater:
    medium = Medium.from_water(Water.jerlov(water), point_spread=law)
    return Underwater(medium, **options)


KINDS = [
    ({}, {"color_space": "linear"}, "color_space is srgb there and linear here"),
    ({"order": "source"}, {}, "order is source there and line_of_sight here"),
    ({"sides": (32, 64)}, {"sides": (32, 96)}, r"sides is \[32, 64\] there and \(32, 96\)"),
    ({"exposure": "auto"}, {}, "exposure is auto there and none here"),
    ({"distance_range": None}, {}, "demand is None there"),
    ({"development": Development(tone=2.0)}, {}, "development is .* there"),
    ({}, {"development": Development(tone=2.0)}, "development is .* there"),
    ({}, {"tolerance": 0.001}, "tolerance is .* there"),
    ({"law": PointSpread(1.2, 0.6)}, {}, ""),
    ({"law": PointSpread(1.2, 0.8, "exponential")}, {}, ""),
    ({"law": PointSpread(1.2, 0.8, reference_size=512.0)}, {}, ""),
]
DEMANDS = [  # what learns plans anew
    ({"distance_range": (0.1, 2.0)}, {}, "demand is .* there and .* here"),
    ({"law": PointSpread(3.0, 0.8)}, {}, ""),
    # of as many rates
    ({"water": "5C", "sides": (32, 512)}, {"sides": (32, 512)}, "demand is .* there and .* here"),
]


@pytest.mark.parametrize(
    ("learnable", "there", "here", "message"),
    [(False, *case) for case in (*KINDS, *DEMANDS)] + [(True, *case) for case in KINDS],
)
def test_the_state_of_another_kind_of_module_is_refused(learnable, there, here, message):
    theirs = start(learnable=learnable, **there)
    mine = start(learnable=learnable, **here)
    before = mine(picture(), distances()).detach()
    with pytest.raises(ValueError, match=f"state_dict is of an Underwater .*: .*{message}"):
        mine.load_state_dict(theirs.state_dict())
    assert torch.equal(mine(picture(), distances()), before)


def test_a_plan_made_anew_while_learning_comes_with_the_state():
    first, second = start(learnable=True), start(learnable=True)
    with torch.no_grad():
        first.coefficients.raw_scale += 20.0
    expected = first(picture(), distances())
    assert first.demand != second.demand
    second.load_state_dict(first.state_dict())
    assert first.demand == second.demand
    assert torch.equal(second(picture(), distances()), expected)


def test_a_state_is_refused_inside_a_network_too():
    theirs = nn.Sequential(nn.Conv2d(3, 3, 1), start())
    mine = nn.Sequential(nn.Conv2d(3, 3, 1), start(color_space="linear"))
    with pytest.raises(ValueError, match="color_space"):
        mine.load_state_dict(theirs.state_dict())


def test_what_a_state_holds_is_used():
    # one number for all media is of the module; one for each is of its state
    law = PointSpread(torch.tensor([1.5]), torch.tensor([0.7]))
    module = Underwater(coastal(point_spread=law), color_space="linear")
    assert {"coefficients.scale", "coefficients.exponent"} <= set(module.state_dict())
    assert not [name for name in start().state_dict() if "scale" in name or "exponent" in name]
    state = module.state_dict()
    state["coefficients.scale"] = torch.tensor([1.0])
    state["coefficients.exponent"] = torch.tensor([0.9])
    buffer = io.BytesIO()
    torch.save(state, buffer)
    buffer.seek(0)
    module.load_state_dict(torch.load(buffer))
    law = PointSpread(torch.tensor([1.0]), torch.tensor([0.9]))
    expected = form_image(picture(), distances(), coastal(point_spread=law)).image
    torch.testing.assert_close(module(picture(), distances()), expected, rtol=0, atol=2e-3)
    assert module.medium.point_spread.scale == 1.0


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
@pytest.mark.parametrize("learnable", [False, True])
def test_half_precision_is_of_the_picture_alone(dtype, learnable):
    module = start(learnable=learnable)
    image, z = picture(), distances()
    expected = module(image, z)
    narrow = nn.Sequential(copy.deepcopy(module)).to(dtype)[0]
    assert torch.equal(narrow(image, z), expected)
    result = narrow(image.to(dtype), z)
    assert result.dtype == dtype
    torch.testing.assert_close(result.float(), expected, rtol=0, atol=0.005)
    if learnable:
        result.sum().backward()
        assert all(parameter.grad.isfinite().all() for parameter in narrow.parameters())


def test_one_picture_with_several_fields_gives_as_many():
    module, image, z = start(color_space="linear"), picture()[0], distances()[0]
    field = 0.7 + 0.6 * torch.rand(3, 1, 32, 40)
    result = module(image, z, field)
    assert result.shape == (3, 3, 32, 40)
    assert torch.equal(result, module(image[None], z[None], field))
    assert form_image(image, z, coastal(), field).image.shape == (3, 3, 32, 40)
    assert module(image, z, field[:1]).shape == (3, 32, 40)


def test_a_medium_is_made_once_and_follows_its_buffers() -> None:
    module = Underwater(Medium.from_water("II"), color_space="linear")
    image, z = torch.rand(1, 3, 16, 16), torch.full((1, 1, 16, 16), 3.0)
    first, before = module.medium, module(image, z)
    assert module.medium is first
    module.coefficients.beta.data.mul_(2)  # behind autograd's back
    after = module(image, z)
    assert not torch.equal(after, before)
    module.load_state_dict(Underwater(Medium.from_water("II"), color_space="linear").state_dict())
    assert torch.equal(module(image, z), before)
    module.to(torch.float32)
    assert module.medium is not first
    assert module.medium.beta.dtype == torch.float32


def test_a_setup_is_plain_values_and_back() -> None:
    lamp = uwaug.Light.lamp((0.4, -0.2, 0.0), (-0.1, 0.0, 1.0), 4.0, 40.0)
    media = Medium.stack([Medium.from_water(kind) for kind in ("II", "7C")])
    for setup in (
        Setup(media, exposure=1.5, tolerance=0.01, order="source"),
        Setup(media[0], lamp, "auto", "linear", 50.0, (20.0, 10.0)),
    ):
        again = Setup.from_dict(json.loads(json.dumps(setup.to_dict())))
        assert again.to_dict() == setup.to_dict()
        image, z = torch.rand(3, 24, 40), torch.full((1, 24, 40), 2.0)
        pictures = [Scene.of(image, z, s).picture() for s in (setup, again)]
        torch.testing.assert_close(*pictures, rtol=0, atol=1e-6)
    values = Setup(media).to_dict()
    for name, value in (("exposure", "dim"), ("order", "first"), ("color_space", "rgb")):
        with pytest.raises(ValueError, match=f"{name} must be one of"):
            Setup.from_dict({**values, name: value})
