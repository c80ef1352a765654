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


def close(ours: Tensor, theirs: Tensor, tolerance: float) -> None:
    torch.testing.assert_close(ours, theirs, rtol=0, atol=tolerance)


def flat(value: float) -> Tensor:
    """Distances, all the same."""
    return torch.full((1, 1, 32, 40), value)


TAILS = PointSpread(0.03 * 60.0, 0.62, "exponential")
RANGES: dict[str, tuple[Medium, dict[str, Any]]] = {
    **{name: (make(), {}) for name, make in MEDIA.items()},
    # a wide range costs no accuracy
    "I, all": (Medium.from_water("I", point_spread=TAILS), {"distance_range": (0.0, math.inf)}),
    "9C, far": (Medium.from_water("9C", point_spread=TAILS), {"distance_range": (0.0, 1e4)}),
    "9C, all": (Medium.from_water("9C", point_spread=TAILS), {"distance_range": (0.0, math.inf)}),
}


@pytest.mark.parametrize("name", RANGES)
def test_linear_light_is_form_image(name: str) -> None:
    (medium, options), image, z = RANGES[name], picture(64, 64), distances(64, 64)
    field = 0.7 + 0.6 * rand(1, 1, 64, 64).float()
    result = Underwater(medium, color_space="linear", **options)(image, z, field)
    exact = form_image(image.double(), (z * field).double(), medium, tolerance=0.0002).image
    assert reference.psnr(result, exact) >= 54


def test_srgb_is_decoded_encoded_and_clipped_to_what_files_hold() -> None:
    image, z = picture(), distances()
    linear, srgb = (Underwater(coastal(), color_space=c) for c in ("linear", "srgb"))
    close(srgb(image, z), linear_to_srgb(linear(srgb_to_linear(image), z)), 2e-6)
    bright = Medium.from_water("III", mu=0.6)
    light = form_image(srgb_to_linear(image), 10 * z, bright).image
    assert light.max() > 1.1
    out = Underwater(bright, (0.1, 80.0))(image, 10 * z)
    assert out.max() == 1
    close(out, linear_to_srgb(light).clamp(0, 1), 2e-3)
    assert Underwater(bright, (0.1, 80.0), color_space="linear")(image, 10 * z).max() > 1.1
    # a picture above 1 keeps its headroom, and the other of the batch does not get it
    surface = Medium.from_water("III", vertical_depth=0.0)
    both = torch.cat([image, torch.full_like(image, 3.0)])
    out = Underwater(surface, (0.0, 20.0))(both, flat(1e-3))
    assert out[0].max() <= 1
    assert out[1].max() == pytest.approx(3.0, abs=0.02)


def test_open_water_is_the_veil_and_no_water_is_the_picture() -> None:
    veil = linear_to_srgb(coastal().veil_weights.sum(-1)).float()[0]
    result = Underwater(coastal())(picture(), flat(math.inf))
    close(result, veil[:, None, None].expand(1, 3, 32, 40), 2e-6)
    surface = Underwater(coastal(vertical_depth=0.0), (0.0, 20.0))
    close(surface(picture(), flat(0.0)), picture(), 2e-6)


@pytest.mark.filterwarnings("ignore:.*the blur is planned for")
def test_beyond_its_range_only_widths_stop() -> None:
    medium, image = coastal(), torch.full((1, 3, 32, 40), 0.6)
    degrade = Underwater(medium, distance_range=(1.0, 3.0), color_space="linear")
    for z in (0.0, 0.1, 9.0, 1e3):
        close(degrade(image, flat(z)), form_image(image, flat(z), medium).image, 3e-6)


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


def test_batches_pictures_without_one_and_empty_ones() -> None:
    degrade = Underwater(coastal())
    image, z, field = picture(batch=2), distances(batch=2), 0.7 + 0.6 * rand(2, 1, 32, 40).float()
    close(degrade(image[1], z[1], field[1]), degrade(image, z, field)[1], 1e-6)
    assert Underwater(MEDIA["batch"]())(image[0], z[0]).shape == (2, 3, 32, 40)
    for camera in (uwaug.Development(), uwaug.Development(metered=True)):
        degrade = Underwater(coastal(), development=camera)
        for empty in ((image[:0], z[:0]), (image[..., :0, :], z[..., :0, :])):
            assert degrade(*empty).shape == empty[0].shape


@pytest.mark.parametrize("metered", [False, True])
def test_bytes_in_bytes_out(metered: bool) -> None:
    pixels, z = (255 * picture()).round().byte(), distances()
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
        close(degrade(image, z), expected, 1e-6)
    for cast in (copy.deepcopy(degrade).float(), copy.deepcopy(degrade).double()):
        close(cast(image, z), expected, 1e-5)


# ---- states


WATER = Medium.from_water("7C", vertical_depth=2.0)
SETTINGS = {
    **{name: Setting(make()) for name, make in MEDIA.items()},
    "another water": Setting(WATER),
    "shape of widths": Setting(coastal(point_spread=PointSpread(1.2, 0.8, "exponential"))),
    "unit of widths": Setting(coastal(point_spread=PointSpread(1.2, 0.8, unit="paper"))),
    "snow": Setting(WATER.with_snow(uwaug.MarineSnow(50_000, seed=2))),
    "light": Setting(WATER, uwaug.Light([uwaug.Lamp(power=2.0)], daylight=0.3, pitch=20.0)),
    "development": Setting(WATER, development=uwaug.Development(metered=True, tone=1.3)),
    "view": Setting(WATER, uwaug.Light(pitch=20.0), view=uwaug.View(20.0)),
    "color space": Setting(WATER, color_space="linear"),
}
LEARNED: list[tuple[str, Any]] = [
    *((name, True) for name in (*MEDIA, "snow")),
    ("water", ["width"]),
]


@pytest.mark.parametrize("name, learnable", [*((name, False) for name in SETTINGS), *LEARNED])
def test_a_state_brings_the_whole_setting(name: str, learnable: Any) -> None:
    """Picture, and the name that a person reads; from a file, and averaged with its like, as by an
    EMA. So do copies.
    """
    setting = SETTINGS[name]
    if learnable:
        setting = replace(setting, medium=setting.medium.as_coefficients())
    begun = coefficients(1) if learnable else Medium.from_water("9C")
    if setting.medium.is_spectral:  # which takes only its like
        begun = coastal(surfaces="spectral", vertical_depth=4.0)
    own = Underwater(begun.expand(len(setting.medium)), None, learnable=learnable)
    parts = {part: getattr(setting, part) for part in ("light", "development", "view")}
    space = setting.color_space
    other = Underwater(setting.medium, None, color_space=space, learnable=learnable, **parts)
    image, z = picture(), distances()
    expected = other(image, z).detach()
    assert (own(image, z) - expected).abs().max() > 0.01
    buffer = io.BytesIO()
    torch.save(other.state_dict(), buffer)
    buffer.seek(0)
    state = {key: 0.3 * x + 0.7 * x for key, x in torch.load(buffer).items()}
    own.load_state_dict(state)
    close(own(image, z).detach(), expected, 2e-6)
    for twin in (copy.deepcopy(own), pickle.loads(pickle.dumps(own))):
        assert torch.equal(twin(image, z), own(image, z))
    assert repr(own) == repr(other)
    assert own.medium.notes == other.medium.notes == setting.medium.notes
    assert {t.device.type for t in copy.deepcopy(own).to("meta").medium.tensors()} == {"meta"}
    with pytest.raises(RuntimeError, match=r"Missing key.*_extra_state"):
        own.load_state_dict({key: x for key, x in state.items() if "_extra_state" not in key})


def test_a_pitch_that_learns_takes_the_value_of_a_state() -> None:
    pitch = torch.tensor([5.0], requires_grad=True)
    own = Underwater(WATER, light=uwaug.Light(pitch=pitch))
    own.load_state_dict(Underwater(WATER, light=uwaug.Light(pitch=[30.0])).state_dict())
    assert pitch.tolist() == [30.0]
    own(picture(), distances()).sum().backward()
    assert pitch.grad.abs() > 0


# ---- plans


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
    # an exponential shape asks for no blurs much wider than the picture
    assert Underwater(coastal(point_spread=PointSpread(1.8, 0.62, "exponential"))).sides is None
    for law in (PointSpread(40.0, 0.5), PointSpread.none()):  # which know no size
        degrade = Underwater(coastal(point_spread=law))
        assert degrade.sides == EVERY_SIDE
        assert degrade.plan((1, 1)) == degrade.plan((4000, 6000))


# ---- compilers and derivatives

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
    rates, law = ((0.6, 0.5, 0.4), (0.2, 0.1, 0.1), (0.3,) * 3), PointSpread(3.0)
    medium = Medium.from_coefficients(*rates, b_mean=1.0, point_spread=law)
    # few blurs: each takes the compiler a second
    degrade = Underwater(medium, (1.0, 2.0), tolerance=0.02, learnable=["rates"])
    image, z = picture(), 1.1 + 0.7 * rand(1, 1, 32, 40).float()
    compiled = torch.compile(degrade, fullgraph=True)
    expected, result = degrade(image, z), compiled(image, z)
    close(result, expected, 2e-5)
    parameters, weight = list(degrade.parameters()), rand(1, 3, 32, 40, seed=2).float()
    slopes = [torch.autograd.grad((r * weight).sum(), parameters) for r in (expected, result)]
    torch.testing.assert_close(*slopes, rtol=1e-3, atol=1e-3)


@needs_compiler
def test_compiles_for_every_size() -> None:
    # from the second size on, the compiler takes height and width for symbols
    torch._dynamo.reset()
    degrade = Underwater(coastal(point_spread=PointSpread(26.0, 0.6, unit="paper")))
    compiled = torch.compile(degrade, fullgraph=True, backend="eager")
    for size in ((32, 40, 1), (48, 56, 1), (7, 9, 3)):
        image, z = picture(*size), distances(*size)
        close(compiled(image, z), degrade(image, z), 2e-5)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.filterwarnings("ignore:.torch.jit.script:DeprecationWarning")  # forward, by torch
def test_torch_func_differentiates_as_autograd_does(dtype: torch.dtype) -> None:
    degrade = Underwater(Medium.from_water("9C"))
    image = torch.rand(1, 3, 20, 30, dtype=dtype)
    z = torch.linspace(1, 4, 30, dtype=dtype).repeat(1, 1, 20, 1)

    def patch(image: Tensor, z: Tensor) -> Tensor:
        return degrade(image, z)[0, :, ::9, ::15].flatten()

    for argument in (0, 1):
        expected = torch.autograd.functional.jacobian(patch, (image, z))[argument]
        for jacobian in (torch.func.jacrev, torch.func.jacfwd):
            assert (jacobian(patch, argument)(image, z) - expected).abs().max() < 1e-5
