import copy
import io
import math
import pickle

import numpy as np
import pytest
import reference
import torch
from torch import Tensor

from uwaug.colour import linear_to_srgb, srgb_to_linear
from uwaug.formation import form_image
from uwaug.module import Underwater
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import JERLOV_TYPES, Water

LAW = PointSpread(1.2, 0.8)


def picture(height: int = 32, width: int = 40, batch: int = 1) -> Tensor:
    return (
        torch.from_numpy(
            np.stack([reference.picture(height, width, seed) for seed in range(batch)])
        )
        .clamp(0, 1)
        .float()
    )


def distances(height: int = 32, width: int = 40, batch: int = 1) -> Tensor:
    return 0.5 + 5 * torch.rand(batch, 1, height, width, generator=torch.Generator().manual_seed(1))


def coastal(**kwargs: object) -> Medium:
    return Medium.from_water(Water.jerlov("3C"), **{"point_spread": LAW, **kwargs})


MEDIA = {
    "water": coastal,
    "clear": lambda: Medium.from_water(Water.jerlov("I")),
    "no blur": lambda: coastal(point_spread=PointSpread.none()),
    "exponent per image": lambda: coastal(
        point_spread=PointSpread(torch.tensor([1.5]), torch.tensor([0.6]))
    ),
    "g = 1": lambda: coastal(g=1.0),
    "no veil": lambda: coastal(mu=0.0),
    "all bands": lambda: coastal(tolerance=0),
    "coefficients": lambda: Medium.from_coefficients(
        (0.6, 0.3, 0.25), (0.4, 0.1, 0.0), (0.1, 0.3, 0.4), b_mean=0.3, point_spread=LAW
    ),
    "float32": lambda: Medium.from_coefficients(
        torch.tensor([0.6, 0.3, 0.2]),
        (0.4, 0.1, 0.1),
        (0.1, 0.3, 0.4),
        b_mean=0.3,
        point_spread=LAW,
    ),
    "batch": lambda: Medium.stack(
        [Medium.from_water(Water.jerlov(t), point_spread=LAW) for t in ("I", "9C")]
    ),
}


@pytest.fixture(params=MEDIA)
def medium(request: pytest.FixtureRequest) -> Medium:
    return MEDIA[request.param]()


def test_linear_light_is_form_image(medium: Medium) -> None:
    image, z, field = picture(), distances(), 0.7 + 0.6 * torch.rand(1, 1, 32, 40)
    degrade = Underwater(medium, color_space="linear")
    for order in ("line_of_sight", "source"):
        degrade = Underwater(medium, color_space="linear", order=order)
        expected = form_image(image, z, medium, field, order=order).image
        assert reference.psnr(degrade(image, z, field), expected) >= 54


def test_srgb_is_decoded_and_encoded() -> None:
    image, z = picture(), distances()
    linear, srgb = (Underwater(coastal(), color_space=c) for c in ("linear", "srgb"))
    torch.testing.assert_close(
        srgb(image, z), linear_to_srgb(linear(srgb_to_linear(image), z)), rtol=0, atol=1e-6
    )
    assert (srgb(image, z) - linear(image, z)).abs().max() > 0.05
    assert Underwater(coastal()).color_space == "srgb"


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_results_of_pictures_are_pictures(type: str) -> None:
    result = Underwater(Medium.from_water(Water.jerlov(type), mu=0.3))(picture(), distances())
    assert result.isfinite().all()
    assert result.min() >= 0
    assert result.max() <= 1.5


def test_open_water_is_the_veil() -> None:
    degrade = Underwater(coastal())
    veil = linear_to_srgb(coastal().veil_weights.sum(-1)).float()[0]
    result = degrade(picture(), torch.full((1, 1, 32, 40), math.inf))
    torch.testing.assert_close(result, veil[:, None, None].expand(1, 3, 32, 40), rtol=0, atol=1e-6)


def test_no_water_in_between() -> None:
    surface = coastal(vertical_depth=0.0)
    image = picture()
    torch.testing.assert_close(
        Underwater(surface)(image, torch.zeros(1, 1, 32, 40)), image, rtol=0, atol=2e-6
    )


def test_planned_at_each_call() -> None:
    medium, image, z = coastal(), picture(), distances()
    free = Underwater(medium, distance_range=None, color_space="linear")
    assert free.plan((32, 40)) is None
    torch.testing.assert_close(
        free(image, z), form_image(image, z, medium).image, rtol=0, atol=1e-6
    )
    assert "planned at each call" in repr(free)


def test_beyond_its_range_only_widths_stop() -> None:
    medium = coastal()
    degrade = Underwater(medium, distance_range=(1.0, 3.0), color_space="linear")
    image = torch.full((1, 3, 32, 40), 0.6)
    for z in (0.0, 0.1, 9.0, 1e3):
        distance = torch.full((1, 1, 32, 40), z)
        torch.testing.assert_close(
            degrade(image, distance), form_image(image, distance, medium).image, rtol=0, atol=2e-6
        )


@pytest.mark.parametrize("far", [20.0, 1e4, math.inf])
def test_a_wide_range_costs_no_accuracy(far: float) -> None:
    image, z = picture(64, 64), distances(64, 64)
    for water in ("I", "II", "9C"):
        medium = Medium.from_water(Water.jerlov(water), point_spread=PointSpread.calibrated(60.0))
        degrade = Underwater(medium, distance_range=(0.0, far), color_space="linear")
        expected = form_image(image.double(), z.double(), medium, tolerance=0.0002).image
        assert reference.psnr(degrade(image, z), expected) >= 54


def test_images_without_a_batch_and_batches() -> None:
    degrade = Underwater(coastal())
    image, z, field = picture(batch=2), distances(batch=2), 0.7 + 0.6 * torch.rand(2, 1, 32, 40)
    both = degrade(image, z, field)
    torch.testing.assert_close(degrade(image[1], z[1], field[1]), both[1], rtol=0, atol=1e-6)
    assert Underwater(MEDIA["batch"]())(image[0], z[0]).shape == (2, 3, 32, 40)
    assert degrade(image[:0], z[:0]).shape == (0, 3, 32, 40)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16, torch.float64])
def test_types(dtype: torch.dtype) -> None:
    degrade = Underwater(coastal())
    image, z = picture().to(dtype), distances().to(dtype)
    result = degrade(image, z)
    assert result.dtype == dtype
    exact = Underwater(coastal())(image.double(), z.double())
    assert (result.double() - exact).abs().max() < (1e-9 if dtype == torch.float64 else 0.005)


@pytest.mark.parametrize("learnable", [False, True])
def test_autocast_changes_nothing(learnable: bool) -> None:
    degrade, image, z = Underwater(coastal(), learnable=learnable), picture(), distances()
    expected = degrade(image, z)
    with torch.autocast("cpu", torch.bfloat16):
        result = degrade(image, z)
    torch.testing.assert_close(result, expected, rtol=0, atol=1e-6)


def test_the_module_can_be_cast() -> None:
    degrade, image, z = Underwater(coastal()), picture(), distances()
    expected = degrade(image, z)
    torch.testing.assert_close(
        copy.deepcopy(degrade).float()(image, z), expected, rtol=0, atol=1e-5
    )
    torch.testing.assert_close(
        copy.deepcopy(degrade).double()(image.double(), z.double()).float(),
        expected,
        rtol=0,
        atol=1e-5,
    )


def test_nothing_to_learn_by_default(medium: Medium) -> None:
    degrade = Underwater(medium)
    assert list(degrade.parameters()) == []
    assert not degrade(picture(), distances()).requires_grad


def test_learning_starts_at_the_medium(medium: Medium) -> None:
    fixed, learnable = (Underwater(medium, learnable=flag) for flag in (False, True))
    image, z = picture(), distances()
    assert reference.psnr(learnable(image, z).detach(), fixed(image, z)) >= 54  # their plans differ
    start = learnable.medium
    for name, value, given in zip(
        ("beta", "direct", "G", "signal", "veil", "b_mean"),
        start.tensors(),
        medium.tensors(),
        strict=True,
    ):
        torch.testing.assert_close(
            value.detach().to(given.dtype), given, rtol=1e-5, atol=2e-6, msg=name
        )
    for name in ("scale", "exponent"):
        value, given = (
            torch.as_tensor(getattr(m.point_spread, name)).double().expand(len(medium))
            for m in (start, medium)
        )
        torch.testing.assert_close(value.detach(), given, rtol=1e-5, atol=2e-6)


def test_learning_wants_equal_light_in_direct_and_signal() -> None:
    # one parameter stands for both; a medium in which they differ would start as another one
    given = coastal()
    medium = Medium(given.beta, 0.8 * given.direct_weights, *given.tensors()[2:], point_spread=LAW)
    with pytest.raises(ValueError, match="direct_weights"):
        Underwater(medium, learnable=True)


def test_every_parameter_learns_and_stays_positive(medium: Medium) -> None:
    degrade = Underwater(medium, learnable=True)
    image, z = picture(), distances()
    optimiser = torch.optim.SGD(degrade.parameters(), lr=50.0)
    for _ in range(3):
        optimiser.zero_grad()
        degrade(image, z).square().sum().backward()
        for name, parameter in degrade.named_parameters():
            if name == "source.raw_scale" and degrade.plan(
                (image.shape[-2], image.shape[-1])
            ).sigmas == (0.0,):
                continue  # no blur is planned, as none would show
            assert parameter.grad is not None, name
            assert parameter.grad.isfinite().all(), name
        optimiser.step()
    learned = degrade.medium
    assert all((t >= 0).all() for t in learned.tensors())
    assert (torch.as_tensor(learned.point_spread.scale) >= 0).all()
    assert degrade(image, z).isfinite().all()
    at_zero = (m.detach() for m in (learned.direct_weights.sum(-1), learned.signal_weights.sum(-1)))
    torch.testing.assert_close(*at_zero, rtol=1e-6, atol=1e-9)


def test_learning_finds_another_water() -> None:
    image, z = picture(24, 24, 2), distances(24, 24, 2)
    observed = Underwater(
        Medium.from_coefficients((0.5, 0.2, 0.3), (0.2, 0.1, 0.12), (0.1, 0.3, 0.4)),
        color_space="linear",
    )(image, z)
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


def test_state_dict_round_trip(medium: Medium) -> None:
    for learnable in (False, True):
        first = Underwater(medium, learnable=learnable)
        with torch.no_grad():
            for tensor in first.state_dict().values():
                if tensor.is_floating_point():
                    tensor.mul_(1.1)
        second = Underwater(medium, learnable=learnable)
        image, z = picture(), distances()
        assert not torch.equal(first(image, z), second(image, z))
        buffer = io.BytesIO()
        torch.save(first.state_dict(), buffer)
        buffer.seek(0)
        second.load_state_dict(torch.load(buffer))
        assert torch.equal(first(image, z), second(image, z))


@pytest.mark.parametrize("learnable", [False, True])
def test_copies_survive(medium: Medium, learnable: bool) -> None:
    degrade = Underwater(medium, learnable=learnable)
    image, z = picture(), distances()
    expected = degrade(image, z).detach()
    for twin in (copy.deepcopy(degrade), pickle.loads(pickle.dumps(degrade))):
        assert torch.equal(twin(image, z).detach(), expected)
        assert repr(twin) == repr(degrade)


@pytest.mark.parametrize("learnable", [False, True])
def test_a_learned_medium_starts_another_module(learnable: bool) -> None:
    # its tensors carry the gradients of the first module: the second must own its tensors, and be copied and saved
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


def test_tensors_move_with_the_module() -> None:
    law = PointSpread(torch.tensor([1.5]), torch.tensor([0.7]))
    for learnable in (False, True):
        moved = Underwater(coastal(point_spread=law), learnable=learnable).to("meta").medium
        tensors = (*moved.tensors(), moved.point_spread.scale, moved.point_spread.exponent)
        assert {t.device.type for t in tensors if isinstance(t, Tensor)} == {"meta"}


@pytest.mark.filterwarnings(
    "ignore:.*torch.jit.script:DeprecationWarning"
)  # PyTorch's own compiler calls it
@pytest.mark.filterwarnings("ignore:.*script_method:DeprecationWarning")
def test_compiles_whole() -> None:
    torch._dynamo.reset()
    degrade = Underwater(coastal(point_spread=PointSpread(2.0, 0.6)), learnable=True)
    image, z, field = picture(), distances(), 0.7 + 0.6 * torch.rand(1, 1, 32, 40)
    compiled = torch.compile(degrade, fullgraph=True)
    expected, result = degrade(image, z, field), compiled(image, z, field)
    torch.testing.assert_close(result, expected, rtol=0, atol=2e-5)
    weight = torch.rand(1, 3, 32, 40)
    parameters = list(degrade.parameters())
    gradients = [torch.autograd.grad((r * weight).sum(), parameters) for r in (expected, result)]
    for a, b in zip(*gradients, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-3)
    with torch.no_grad():
        torch.testing.assert_close(compiled(image, z, field), expected, rtol=0, atol=2e-5)


def test_compiles_for_every_size() -> None:
    # from the second size on, the compiler takes height and width for symbols
    torch._dynamo.reset()
    degrade = Underwater(coastal(point_spread=PointSpread(2.0, 0.6, reference_size=40.0)))
    compiled = torch.compile(degrade, fullgraph=True, backend="eager")
    for height, width, batch in ((32, 40, 1), (48, 56, 1), (20, 30, 2), (7, 9, 3)):
        image, z = picture(height, width, batch), distances(height, width, batch)
        torch.testing.assert_close(compiled(image, z), degrade(image, z), rtol=0, atol=2e-5)


def test_repr_says_what_is_modelled_and_what_is_skipped() -> None:
    text = repr(Underwater(coastal()))
    for part in (
        "3C",
        "rates",
        "0.1…20 m",
        "blurs for σ",
        "dB",
        "tolerance=0.002",
        "srgb",
        "line_of_sight",
    ):
        assert part in text
    assert "at 512 px" in repr(Underwater(coastal(point_spread=PointSpread.paper(0.8))))
    assert "no blur" in repr(Underwater(coastal(g=1.0, tolerance=0.0005)))
    assert "no blur" in repr(Underwater(coastal(point_spread=PointSpread(0.001))))
    assert "source" in repr(Underwater(coastal(), order="source", color_space="linear"))
    assert "learn" in repr(Underwater(coastal(), learnable=True))


def test_the_plan_depends_on_size_and_range() -> None:
    degrade = Underwater(coastal(point_spread=PointSpread.paper(0.8)))
    assert degrade.plan((1036, 2000)).sigma_max == pytest.approx(
        2 * degrade.plan((518, 700)).sigma_max
    )
    near = Underwater(coastal(), distance_range=(0.1, 1.0)).plan((100, 100))
    assert near.sigma_max < Underwater(coastal()).plan((100, 100)).sigma_max


@pytest.mark.parametrize(
    "change, match",
    [
        ({"color_space": "rgb"}, "color_space.*rgb"),
        ({"distance_range": (5.0, 1.0)}, r"distance_range.*\(5.0, 1.0\)"),
        ({"distance_range": (-1.0, 1.0)}, r"distance_range.*-1"),
        ({"distance_range": (math.nan, 1.0)}, r"distance_range.*nan"),
        ({"order": "backwards"}, "order.*backwards"),
        ({"tolerance": 0.0}, "tolerance.*0"),
        ({"tolerance": -1.0}, "tolerance.*-1"),
        ({"tolerance": math.nan}, "tolerance.*nan"),
    ],
)
def test_construction_rejects(change: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Underwater(coastal(), **change)


def test_construction_wants_a_medium() -> None:
    with pytest.raises(TypeError, match="medium"):
        Underwater(Water.jerlov("7C"))


@pytest.mark.parametrize(
    "image, distance, error, match",
    [
        (255 * picture(), distances(), ValueError, r"image reaches 2\d\d.*255"),
        ((255 * picture()).byte(), distances(), TypeError, "image.*uint8"),
        (picture(), distances() * math.nan, ValueError, "distance.*NaN"),
        (picture(), -distances(), ValueError, "distance.*negative"),
        (picture(), distances(16, 40), ValueError, r"distance.*\(16, 40\)"),
    ],
    ids=["0…255", "bytes", "nan", "negative", "size"],
)
def test_forward_rejects(
    image: Tensor, distance: Tensor, error: type[Exception], match: str
) -> None:
    with pytest.raises(error, match=match):
        Underwater(coastal())(image, distance)
