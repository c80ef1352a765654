import copy
import io
import math
import pickle

import pytest
import torch
from referees import reference
from scenes import MEDIA, coastal, distances, picture
from torch import Tensor

from uwaug.formation.colour import linear_to_srgb, srgb_to_linear
from uwaug.formation.demand import EVERY_SIDE
from uwaug.formation.development import Development
from uwaug.formation.model import form_image
from uwaug.formation.underwater import Underwater
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import JERLOV_TYPES, Water


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
    expected = linear_to_srgb(linear(srgb_to_linear(image), z))
    torch.testing.assert_close(srgb(image, z), expected, rtol=0, atol=1e-6)
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
    degrade = Underwater(coastal(vertical_depth=0.0), (0.0, 20.0))
    image = picture()
    result = degrade(image, torch.zeros(1, 1, 32, 40))
    torch.testing.assert_close(result, image, rtol=0, atol=2e-6)


def test_planned_at_each_call() -> None:
    medium, image, z = coastal(), picture(), distances()
    free = Underwater(medium, distance_range=None, color_space="linear")
    assert free.plan((32, 40)) is None
    expected = form_image(image, z, medium).image
    torch.testing.assert_close(free(image, z), expected, rtol=0, atol=1e-6)
    assert "planned at each call" in repr(free)


@pytest.mark.filterwarnings("ignore:.*the blur is planned for")
def test_beyond_its_range_only_widths_stop() -> None:
    medium = coastal()
    degrade = Underwater(medium, distance_range=(1.0, 3.0), color_space="linear")
    image = torch.full((1, 3, 32, 40), 0.6)
    for z in (0.0, 0.1, 9.0, 1e3):
        distance = torch.full((1, 1, 32, 40), z)
        expected = form_image(image, distance, medium).image
        torch.testing.assert_close(degrade(image, distance), expected, rtol=0, atol=2e-6)


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
    single = copy.deepcopy(degrade).float()(image, z)
    double = copy.deepcopy(degrade).double()(image.double(), z.double())
    torch.testing.assert_close(single, expected, rtol=0, atol=1e-5)
    torch.testing.assert_close(double.float(), expected, rtol=0, atol=1e-5)


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


def test_tensors_move_with_the_module() -> None:
    law = PointSpread(torch.tensor([1.5]), torch.tensor([0.7]))
    for learnable in (False, True):
        moved = Underwater(coastal(point_spread=law), learnable=learnable).to("meta").medium
        tensors = (*moved.tensors(), moved.point_spread.scale, moved.point_spread.exponent)
        assert {t.device.type for t in tensors if isinstance(t, Tensor)} == {"meta"}


# PyTorch's own compiler calls it
@pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:.*script_method:DeprecationWarning")
def test_compiles_whole() -> None:
    torch._dynamo.reset()
    # few blurs, on the image's own grid and on a coarse one: each takes the compiler a second
    medium = coastal(point_spread=PointSpread(3.0, 0.6))
    degrade = Underwater(medium, (1.0, 2.0), learnable=True)
    assert {cell == 1 for cell in degrade.plan((32, 40)).cells} == {True, False}
    image, field = picture(), 0.95 + 0.1 * torch.rand(1, 1, 32, 40)
    z = 1.1 + 0.7 * torch.rand(1, 1, 32, 40)
    compiled = torch.compile(degrade, fullgraph=True)
    expected, result = degrade(image, z, field), compiled(image, z, field)
    torch.testing.assert_close(result, expected, rtol=0, atol=2e-5)
    weight = torch.rand(1, 3, 32, 40)
    parameters = list(degrade.parameters())
    gradients = [torch.autograd.grad((r * weight).sum(), parameters) for r in (expected, result)]
    for a, b in zip(*gradients, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-3)


def test_compiles_for_every_size() -> None:
    # from the second size on, the compiler takes height and width for symbols
    torch._dynamo.reset()
    degrade = Underwater(coastal(point_spread=PointSpread(2.0, 0.6, reference_size=40.0)))
    compiled = torch.compile(degrade, fullgraph=True, backend="eager")
    for height, width, batch in ((32, 40, 1), (48, 56, 1), (20, 30, 2), (7, 9, 3)):
        image, z = picture(height, width, batch), distances(height, width, batch)
        torch.testing.assert_close(compiled(image, z), degrade(image, z), rtol=0, atol=2e-5)


@pytest.mark.parametrize(
    ("exposure", "development", "next_one"),
    [
        ("auto", Development(), Development(white_balance=0.5)),
        ("none", Development(0.3), Development(-0.5)),
        ("none", Development(white_balance=0.5), Development()),
        ("none", Development(tone=1.3), Development(tone=0.8)),
    ],
)
def test_compiles_with_one_development_after_another(exposure, development, next_one) -> None:
    # from the second one on, the compiler takes its numbers for symbols
    torch._dynamo.reset()
    image, z = picture(32, 40, 2), distances(32, 40, 2)
    for each in (development, next_one):
        degrade = Underwater(coastal(), exposure=exposure, development=each)
        compiled = torch.compile(degrade, fullgraph=True, backend="eager")
        torch.testing.assert_close(compiled(image, z), degrade(image, z), rtol=0, atol=2e-5)


def test_compiles_with_one_width_law_after_another() -> None:
    torch._dynamo.reset()
    image, z = picture(32, 40), distances(32, 40)
    for law in (PointSpread.none(), PointSpread(2.0, 0.6), PointSpread(3.0, 0.7)):
        degrade = Underwater(coastal(point_spread=law), learnable=True)
        compiled = torch.compile(degrade, fullgraph=True, backend="eager")
        torch.testing.assert_close(compiled(image, z), degrade(image, z), rtol=0, atol=2e-5)


@pytest.mark.parametrize("exposure", ["none", "auto"])
def test_a_picture_is_the_same_whether_its_gradient_is_wanted(exposure) -> None:
    degrade = Underwater(coastal(), None, exposure=exposure)
    image, z = picture(60, 80), distances(60, 80)
    torch.testing.assert_close(degrade(image.clone().requires_grad_(), z), degrade(image, z))


def test_repr_says_what_is_modelled_and_what_is_skipped() -> None:
    text = repr(Underwater(coastal()))
    for part in ("3C", "rates", "0.1…20 m", "blurs for σ", "dB"):
        assert part in text
    for part in ("tolerance=0.002", "srgb", "line_of_sight"):
        assert part in text
    assert "at 512 px" in repr(Underwater(coastal(point_spread=PointSpread.paper(0.8))))
    assert "no blur" in repr(Underwater(coastal(g=1.0, tolerance=0.0005)))
    assert "no blur" in repr(Underwater(coastal(point_spread=PointSpread(0.001))))
    assert "source" in repr(Underwater(coastal(), order="source", color_space="linear"))
    assert "learn" in repr(Underwater(coastal(), learnable=True))


def test_the_plan_depends_on_size_and_range() -> None:
    degrade = Underwater(coastal(point_spread=PointSpread.paper(0.8)))
    large, small = degrade.plan((1036, 2000)), degrade.plan((518, 700))
    assert large.sigma_max == pytest.approx(2 * small.sigma_max)
    near = Underwater(coastal(), distance_range=(0.1, 1.0)).plan((100, 100))
    assert near.sigma_max < Underwater(coastal()).plan((100, 100)).sigma_max


def test_with_sides_pictures_of_all_sizes_share_a_plan():
    medium = coastal(point_spread=PointSpread.paper(0.8))
    degrade = Underwater(medium, sides=(32, 700))
    plans = {degrade.plan(size) for size in ((1, 1), (33, 40), (700, 900), (3000, 4000))}
    assert plans == {degrade.demand.plan_all((32, 700))}
    assert "for short sides of 32…700 px" in repr(degrade)
    sized = Underwater(medium)
    assert sized.sides is None
    assert sized.plan((33, 40)) != sized.plan((700, 900))


@pytest.mark.parametrize("law", [PointSpread(40.0, 0.5), PointSpread.none()])
def test_a_law_that_knows_no_size_has_one_plan_anyway(law):
    degrade = Underwater(coastal(point_spread=law))
    assert degrade.sides == EVERY_SIDE
    assert degrade.plan((1, 1)) == degrade.plan((4000, 6000))
    # an exponential shape asks for no blurs much wider than the picture
    assert Underwater(coastal(point_spread=PointSpread.calibrated(60.0))).sides is None


@pytest.mark.parametrize(
    "change, error, message",
    [
        ({"color_space": "rgb"}, ValueError, "color_space.*rgb"),
        ({"order": "backwards"}, ValueError, "order.*backwards"),
        ({"tolerance": 0.0}, ValueError, "tolerance.*0"),
        ({"tolerance": math.nan}, ValueError, "tolerance.*nan"),
        ({"distance_range": (5.0, 1.0)}, ValueError, r"distance_range.*\(5.0, 1.0\)"),
        ({"distance_range": (-1.0, 1.0)}, ValueError, r"distance_range.*-1"),
        ({"distance_range": (math.nan, 1.0)}, ValueError, r"distance_range.*nan"),
        ({"sides": (64, 32)}, ValueError, r"sides must be whole numbers, 1 ≤ smallest ≤ largest"),
        ({"sides": (0, 32)}, ValueError, r"sides must be .*, got \(0, 32\)"),
        ({"sides": (32, 1e6)}, ValueError, r"≤ 16384 px, got \(32, 1000000.0\)"),
        ({"sides": (32, 64.5)}, ValueError, r"sides must be whole numbers"),
        ({"sides": (32, math.nan)}, ValueError, r"sides must be whole numbers"),
        ({"sides": 512}, TypeError, r"sides must be \(smallest, largest\) .*, got 512"),
        ({"sides": ()}, TypeError, r"sides must be \(smallest, largest\) .*, got \(\)"),
        ({"sides": ("a", "b")}, TypeError, r"sides must be \(smallest, largest\)"),
        ({"distance_range": 5.0}, TypeError, r"distance_range must be .* in metres, got 5\.0"),
        ({"distance_range": (1, 2, 3)}, TypeError, r"distance_range must be .* got \(1, 2, 3\)"),
        ({"distance_range": None, "sides": (32, 64)}, ValueError, "sides need a distance_range"),
    ],
)
def test_construction_rejects(change, error, message) -> None:
    with pytest.raises(error, match=message):
        Underwater(coastal(), **change)


def test_construction_wants_a_medium() -> None:
    with pytest.raises(TypeError, match="medium"):
        Underwater(Water.jerlov("7C"))


def test_forward_rejects_what_form_image_rejects() -> None:
    """Of whose refusals there is a table in test_inputs.py; and pictures of 0…255."""
    degrade = Underwater(coastal())
    with pytest.raises(ValueError, match=r"image reaches 2\d\d.*255"):
        degrade(255 * picture(), distances())
    with pytest.raises(TypeError, match=r"image.*int32"):
        degrade((255 * picture()).int(), distances())
    with pytest.raises(ValueError, match=r"distance.*NaN"):
        degrade(picture(), distances() * math.nan)


@pytest.mark.parametrize("exposure", ["none", "auto"])
def test_bytes_in_bytes_out(exposure: str) -> None:
    image, z = picture(), distances()
    pixels = (255 * image).round().byte()
    degrade = Underwater(coastal(), exposure=exposure)
    out = degrade(pixels, z)
    assert out.dtype == torch.uint8
    exact = degrade(pixels / 255, z)
    torch.testing.assert_close(out, (255 * exact).round().byte(), rtol=0, atol=0)
    assert degrade(pixels[0], z[0]).shape == pixels[0].shape
    with pytest.raises(TypeError, match="image must be a floating-point tensor, got"):
        form_image(pixels, z, coastal())
