"""The module: color spaces, plans, types, states, compiling."""

import copy
import io
import math
import pickle
from dataclasses import replace
from typing import Any

import pytest
import torch
from packaging.version import Version
from referees import reference
from scenes import MEDIA, coastal, coefficients, distances, picture, rand
from torch import Tensor

import uwaug
from uwaug import Medium, PointSpread, Underwater, form_image
from uwaug.formation import Setting
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear
from uwaug.formation.demand import EVERY_SIDE


@pytest.fixture(params=MEDIA)
def medium(request: pytest.FixtureRequest) -> Medium:
    return MEDIA[request.param]()


def test_linear_light_is_form_image(medium: Medium) -> None:
    image, z, field = picture(), distances(), 0.7 + 0.6 * rand(1, 1, 32, 40).float()
    degrade = Underwater(medium, color_space="linear")
    expected = form_image(image, z * field, medium).image
    assert reference.psnr(degrade(image, z, field), expected) >= 54


def test_srgb_is_decoded_and_encoded() -> None:
    image, z = picture(), distances()
    linear, srgb = (Underwater(coastal(), color_space=c) for c in ("linear", "srgb"))
    expected = linear_to_srgb(linear(srgb_to_linear(image), z))
    torch.testing.assert_close(srgb(image, z), expected, rtol=0, atol=2e-6)
    assert (srgb(image, z) - linear(image, z)).abs().max() > 0.05


def test_srgb_is_clipped_to_what_files_hold() -> None:
    bright = Medium.from_water("III", mu=0.6)
    image, z = picture(), 10 * distances()
    light = form_image(srgb_to_linear(image), z, bright).image
    assert light.max() > 1.1
    out = Underwater(bright, (0.1, 80.0))(image, z)
    assert out.max() == 1
    torch.testing.assert_close(out, linear_to_srgb(light).clamp(0, 1), rtol=0, atol=2e-3)
    assert Underwater(bright, (0.1, 80.0), color_space="linear")(image, z).max() > 1.1
    # a picture above 1 keeps its headroom, and the other of the batch does not get it
    near = torch.full((1, 1, 32, 40), 1e-3)
    surface = Medium.from_water("III", vertical_depth=0.0)
    out = Underwater(surface, (0.0, 20.0))(torch.cat([image, torch.full_like(image, 3.0)]), near)
    assert out[0].max() <= 1
    assert out[1].max() == pytest.approx(3.0, abs=0.02)


def test_open_water_is_the_veil_and_no_water_is_the_picture() -> None:
    veil = linear_to_srgb(coastal().veil_weights.sum(-1)).float()[0]
    result = Underwater(coastal())(picture(), torch.full((1, 1, 32, 40), math.inf))
    torch.testing.assert_close(result, veil[:, None, None].expand(1, 3, 32, 40), rtol=0, atol=2e-6)
    surface = Underwater(coastal(vertical_depth=0.0), (0.0, 20.0))
    result = surface(picture(), torch.zeros(1, 1, 32, 40))
    torch.testing.assert_close(result, picture(), rtol=0, atol=2e-6)


@pytest.mark.filterwarnings("ignore:.*the blur is planned for")
def test_beyond_its_range_only_widths_stop() -> None:
    medium, image = coastal(), torch.full((1, 3, 32, 40), 0.6)
    degrade = Underwater(medium, distance_range=(1.0, 3.0), color_space="linear")
    for z in (0.0, 0.1, 9.0, 1e3):
        distance = torch.full((1, 1, 32, 40), z)
        expected = form_image(image, distance, medium).image
        torch.testing.assert_close(degrade(image, distance), expected, rtol=0, atol=3e-6)


@pytest.mark.parametrize("far", [20.0, 1e4, math.inf])
def test_a_wide_range_costs_no_accuracy(far: float) -> None:
    image, z = picture(64, 64), distances(64, 64)
    for water in ("I", "9C"):
        medium = Medium.from_water(
            water, point_spread=PointSpread(0.03 * 60.0, 0.62, "exponential")
        )
        degrade = Underwater(medium, distance_range=(0.0, far), color_space="linear")
        expected = form_image(image.double(), z.double(), medium, tolerance=0.0002).image
        assert reference.psnr(degrade(image, z), expected) >= 54


@pytest.mark.parametrize(
    "near, far, factor, warned",
    [(0.1, 0.5, 1.0, True), (10, 20, 1.0, True), (1, 2, 0.1, True), (1, 5, 1.2, False)],
)
def test_pixels_beyond_the_plan_are_told_of_once(
    near: float, far: float, factor: float, warned: bool, recwarn: pytest.WarningsRecorder
) -> None:
    degrade = Underwater(coastal(), (0.7, 6.5))
    image, z = rand(1, 3, 36, 40).float(), near + (far - near) * rand(1, 1, 36, 40).float()
    z[..., 30:, :] = math.inf  # open water does not count
    for _ in range(2):
        degrade(image, z, torch.full_like(z, factor))
    assert len(recwarn) == warned
    if warned:
        (told,) = recwarn
        assert "of the pixels lie outside of the 0.7…6.5 m" in str(told.message)
        assert told.filename == __file__


def test_images_without_a_batch_and_batches() -> None:
    degrade = Underwater(coastal())
    image, z, field = picture(batch=2), distances(batch=2), 0.7 + 0.6 * rand(2, 1, 32, 40).float()
    both = degrade(image, z, field)
    torch.testing.assert_close(degrade(image[1], z[1], field[1]), both[1], rtol=0, atol=1e-6)
    assert Underwater(MEDIA["batch"]())(image[0], z[0]).shape == (2, 3, 32, 40)
    assert degrade(image[:0], z[:0]).shape == (0, 3, 32, 40)


@pytest.mark.parametrize("metered", [False, True])
def test_bytes_in_bytes_out(metered: bool) -> None:
    image, z = picture(), distances()
    pixels = (255 * image).round().byte()
    degrade = Underwater(coastal(), development=uwaug.Development(metered=metered))
    out, exact = degrade(pixels, z), degrade(pixels / 255, z)
    assert out.dtype == torch.uint8
    assert (out - 255 * exact).abs().max() < 0.501
    assert degrade(pixels[0], z[0]).shape == pixels[0].shape


@pytest.mark.parametrize("switch", ["0", "1"])
def test_autocast_and_casts_change_nothing(switch: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UWAUG_FAST", switch)
    degrade, image, z = Underwater(coastal()), picture(), distances()
    expected = degrade(image, z)
    with torch.autocast("cpu", torch.bfloat16):
        torch.testing.assert_close(degrade(image, z), expected, rtol=0, atol=1e-6)
    for cast in (copy.deepcopy(degrade).float(), copy.deepcopy(degrade).double()):
        torch.testing.assert_close(cast(image, z), expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("learnable", [False, True])
def test_states_and_copies(medium: Medium, learnable: bool) -> None:
    medium = medium.as_coefficients() if learnable else medium
    first, second = (Underwater(medium, learnable=learnable) for _ in range(2))
    with torch.no_grad():
        for tensor in (*first.buffers(), *first.parameters()):
            tensor.mul_(1.1)
    first.load_state_dict(first.state_dict())  # the blur is planned for it
    image, z = picture(), distances()
    expected = first(image, z).detach()
    assert not torch.equal(second(image, z).detach(), expected)
    buffer = io.BytesIO()
    torch.save(first.state_dict(), buffer)
    buffer.seek(0)
    second.load_state_dict(torch.load(buffer))
    for twin in (second, copy.deepcopy(first), pickle.loads(pickle.dumps(first))):
        assert torch.equal(twin(image, z).detach(), expected)
    assert {t.device.type for t in second.to("meta").medium.tensors()} == {"meta"}


WATER = Medium.from_water("7C", vertical_depth=2.0)
SETTINGS = {
    "water": Setting(WATER),
    "shape of widths": Setting(coastal(point_spread=PointSpread(1.2, 0.8, "exponential"))),
    "unit of widths": Setting(coastal(point_spread=PointSpread(1.2, 0.8, unit="paper"))),
    "snow": Setting(WATER.with_snow(uwaug.MarineSnow(50_000, seed=2))),
    "light": Setting(WATER, uwaug.Light([uwaug.Lamp(power=2.0)], daylight=0.3, pitch=20.0)),
    "development": Setting(WATER, development=uwaug.Development(metered=True, tone=1.3)),
    "view": Setting(WATER, uwaug.Light(pitch=20.0), view=uwaug.View(20.0)),
    "color space": Setting(WATER, color_space="linear"),
}


LEARNED = [("water", parts) for parts in (True, ["rates"], ["veil"], ["width"])]


@pytest.mark.parametrize(
    ("name", "learnable"), [(name, False) for name in SETTINGS] + [*LEARNED, ("snow", True)]
)
def test_a_state_brings_the_whole_setting(name: str, learnable: Any) -> None:
    """Picture, and the name that a person reads; averaged with its like, as by an EMA, too."""
    setting = SETTINGS[name]
    if learnable:
        setting = replace(setting, medium=setting.medium.as_coefficients())
    options = {"distance_range": None, "learnable": learnable}
    own = Underwater(coefficients() if learnable else Medium.from_water("II"), **options)
    other = Underwater(
        setting.medium,
        **options,
        light=setting.light,
        development=setting.development,
        view=setting.view,
        color_space=setting.color_space,
    )
    image, z = picture(), distances()
    expected = other(image, z).detach()
    assert (own(image, z) - expected).abs().max() > 0.01
    state = {key: 0.3 * x + 0.7 * x for key, x in other.state_dict().items()}
    own.load_state_dict(state)
    torch.testing.assert_close(own(image, z).detach(), expected, rtol=0, atol=2e-6)
    assert repr(own) == repr(other)
    assert own.medium.notes == other.medium.notes == setting.medium.notes
    with pytest.raises(RuntimeError, match=r"Missing key.*_extra_state"):
        own.load_state_dict({key: x for key, x in state.items() if "_extra_state" not in key})


def test_a_pitch_that_learns_takes_the_value_of_a_state() -> None:
    pitch = torch.tensor([5.0], requires_grad=True)
    own = Underwater(WATER, light=uwaug.Light(pitch=pitch))
    own.load_state_dict(Underwater(WATER, light=uwaug.Light(pitch=[30.0])).state_dict())
    assert pitch.tolist() == [30.0]
    own(picture(), distances()).sum().backward()
    assert pitch.grad.abs() > 0


def test_what_it_says_of_itself() -> None:
    said = repr(Underwater(coastal(), development=uwaug.Development(tone=1.2)))
    parts = ("3C", "distance_range=(0.1, 20.0)", "blurs for σ", "tolerance=0.002, srgb", "tone=1.2")
    assert [part for part in parts if part not in said] == []
    assert "at 512 px" in repr(Underwater(coastal(point_spread=PointSpread.paper(0.8))))
    assert "distance_range=None" in repr(Underwater(coastal(), distance_range=None))
    assert "no blur" in repr(Underwater(coastal(point_spread=PointSpread(0.001))))


def test_plans_of_sizes_and_ranges() -> None:
    medium = coastal(point_spread=PointSpread.paper(0.8))
    sized = Underwater(medium)
    large, small = sized.plan((1036, 2000)), sized.plan((518, 700))
    assert sized.sides is None
    assert large.sigma_max == pytest.approx(2 * small.sigma_max)
    near = Underwater(medium, distance_range=(0.1, 1.0)).plan((518, 700))
    assert near.sigma_max < small.sigma_max
    shared = Underwater(medium, sides=(32, 700))
    plans = {shared.plan(size) for size in ((1, 1), (33, 40), (700, 900), (3000, 4000))}
    assert plans == {shared.demand.plan_all((32, 700))}
    assert "sides=(32, 700)" in repr(shared)


@pytest.mark.parametrize("law", [PointSpread(40.0, 0.5), PointSpread.none()])
def test_a_law_that_knows_no_size_has_one_plan_anyway(law: PointSpread) -> None:
    degrade = Underwater(coastal(point_spread=law))
    assert degrade.sides == EVERY_SIDE
    assert degrade.plan((1, 1)) == degrade.plan((4000, 6000))
    # an exponential shape asks for no blurs much wider than the picture
    assert Underwater(coastal(point_spread=PointSpread(1.8, 0.62, "exponential"))).sides is None


needs_compiler = pytest.mark.skipif(
    Version(torch.__version__) < Version("2.13"),
    reason="torch.compile takes the module whole from torch 2.13 on",
)


# PyTorch's own compiler calls it
@pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:.*script_method:DeprecationWarning")
@needs_compiler
def test_compiles_whole() -> None:
    torch._dynamo.reset()
    medium = Medium.from_coefficients(
        (0.6, 0.5, 0.4), (0.2, 0.1, 0.1), (0.3,) * 3, b_mean=1.0, point_spread=PointSpread(3.0)
    )
    # few blurs: each takes the compiler a second
    degrade = Underwater(medium, (1.0, 2.0), tolerance=0.02, learnable=["rates"])
    image, z = picture(), 1.1 + 0.7 * rand(1, 1, 32, 40).float()
    compiled = torch.compile(degrade, fullgraph=True)
    expected, result = degrade(image, z), compiled(image, z)
    torch.testing.assert_close(result, expected, rtol=0, atol=2e-5)
    parameters, weight = list(degrade.parameters()), rand(1, 3, 32, 40, seed=2).float()
    slopes = [torch.autograd.grad((r * weight).sum(), parameters) for r in (expected, result)]
    for ours, theirs in zip(*slopes, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-3, atol=1e-3)


@needs_compiler
def test_compiles_for_every_size() -> None:
    # from the second size on, the compiler takes height and width for symbols
    torch._dynamo.reset()
    degrade = Underwater(coastal(point_spread=PointSpread(26.0, 0.6, unit="paper")))
    compiled = torch.compile(degrade, fullgraph=True, backend="eager")
    for height, width, batch in ((32, 40, 1), (48, 56, 1), (7, 9, 3)):
        image, z = picture(height, width, batch), distances(height, width, batch)
        torch.testing.assert_close(compiled(image, z), degrade(image, z), rtol=0, atol=2e-5)


def test_an_empty_picture() -> None:
    for development in (uwaug.Development(), uwaug.Development(metered=True)):
        degrade: Any = Underwater(coastal(), development=development)
        for shape in ((0, 8, 8), (2, 0, 8)):
            empty = torch.zeros(shape[0], 3, *shape[1:])
            assert degrade(empty, torch.zeros(shape[0], 1, *shape[1:])).shape == empty.shape


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.filterwarnings("ignore:.torch.jit.script:DeprecationWarning")  # forward, by torch
def test_torch_func_differentiates_as_autograd_does(dtype: torch.dtype) -> None:
    degrade = Underwater(Medium.from_water("9C"))
    image, z = torch.rand(1, 3, 20, 30, dtype=dtype), torch.linspace(1, 4, 30, dtype=dtype)
    z = z.repeat(1, 1, 20, 1)

    def patch(image: Tensor, z: Tensor) -> Tensor:
        return degrade(image, z)[0, :, ::9, ::15].flatten()

    for argument in (0, 1):
        expected = torch.autograd.functional.jacobian(patch, (image, z))[argument]
        for jacobian in (torch.func.jacrev, torch.func.jacfwd):
            assert (jacobian(patch, argument)(image, z) - expected).abs().max() < 1e-5
