"""What a camera does between sensor and file, against plain NumPy; by every engine."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from referees import developed as referee
from referees import spectral
from scenes import distances, picture, rand, stepped
from torch import Tensor

import uwaug._support.tiles
import uwaug.blur.tiled
import uwaug.formation.loops.render
from uwaug import Development, Light, Medium, PointSpread, Underwater, Water, form_image, fused
from uwaug.formation import Scene, Setup
from uwaug.formation.development import compressed, curved
from uwaug.formation.exposure import metering_points

STAGES = {
    "compensation": {"compensation": -1.3},
    "white balance": {"white_balance": 0.7},
    "full white balance": {"white_balance": 1.0},
    "no white balance": {"white_balance": -0.4},
    "more saturation": {"saturation": 1.7},
    "grey": {"saturation": 0.0},
    "black point": {"black_point": 0.8},
    "gamut": {"gamut": 1.0},
    "half of gamut": {"gamut": 0.5},
    "more contrast": {"tone": 1.6},
    "less contrast": {"tone": 0.6},
    "all": {
        "compensation": 0.5,
        "white_balance": 0.6,
        "saturation": 1.4,
        "black_point": 0.5,
        "gamut": 0.8,
        "tone": 1.3,
    },
}
ALL = Development(**STAGES["all"])


def spectral_medium(**options: Any) -> Medium:
    return Medium.from_water("II", **{"surfaces": "spectral", "vertical_depth": 6.0, **options})


def spectral_medium_of(water: str, **options: Any) -> Medium:
    return Medium.from_water(water, surfaces="spectral", **options)


MEDIA = {"grey": lambda **o: Medium.from_water("1C", **o), "spectral": spectral_medium}


def module_of(
    medium: Medium, development: Development | dict[str, float] = ALL, **options: Any
) -> Underwater:
    chosen = development if isinstance(development, Development) else Development(**development)
    return Underwater(medium, **{"color_space": "linear", "development": chosen, **options})


def coloured(height: int, width: int) -> Tensor:
    """Pictures of pure and dim colours, in double precision."""
    image = picture(height, width).double()
    return image * torch.tensor([1.3, 0.8, 0.3]).double().reshape(3, 1, 1) ** 1.5


# Each stage


@pytest.mark.parametrize("exposure", ["none", 1.0, "auto"])
@pytest.mark.parametrize("medium", MEDIA)
@pytest.mark.parametrize("stage", STAGES)
def test_stages(stage: str, medium: str, exposure: Any) -> None:
    water = MEDIA[medium](point_spread=PointSpread.none())
    image, z = coloured(20, 26), stepped(1, 1, 20, 26)
    plain = module_of(water, {}, exposure=exposure)(image, z)[0].numpy()
    ours = module_of(water, STAGES[stage], exposure=exposure)(image, z)[0].numpy()
    looks = metering_points(20, 26, image.device).numpy()
    wanted = referee.Camera(**STAGES[stage]).develop(plain, looks)
    np.testing.assert_allclose(ours, wanted, rtol=0, atol=1e-10)
    changes = stage not in ("gamut", "half of gamut", "no white balance")
    assert bool(np.abs(ours - plain).max() > 1e-3) >= changes, "a stage that does nothing"


def test_the_gamut_is_left_underwater() -> None:
    """So that the tests of it test something."""
    image, z = coloured(20, 26), stepped(1, 1, 20, 26)
    assert module_of(spectral_medium(), {})(image, z).min() < -1e-3
    assert module_of(spectral_medium(), {"gamut": 1.0})(image, z).min() >= 0


@pytest.mark.parametrize("by_loops", [False, True])
@pytest.mark.parametrize("space", ["srgb", "linear"])
@pytest.mark.parametrize("medium", MEDIA)
def test_neutral_does_nothing(medium: str, space: Any, by_loops: bool) -> None:
    water = MEDIA[medium]()
    neutral = Development(0.0, 0.0, 1.0, 0.0, 0.0, 1.0)
    with torch.no_grad(), fused.use(by_loops):
        ours, plain = (
            Underwater(water, color_space=space, **options)(picture(), distances())
            for options in ({"development": neutral}, {})
        )
    assert torch.equal(ours, plain)


def test_white_balance_makes_grey_and_keeps_luminance() -> None:
    image, z = coloured(64, 90), torch.full((1, 1, 64, 90), 2.0).double()
    plain, ours = (
        module_of(spectral_medium(), {"white_balance": share})(image, z) for share in (0.0, 1.0)
    )
    means, before = ours.mean((0, 2, 3)), plain.mean((0, 2, 3))
    weights = torch.from_numpy(referee.LUMINANCE)
    assert before.max() > 3 * before.min()
    # measured on 8192 looks, without the blur
    torch.testing.assert_close(means, means.mean().expand(3), rtol=0.05, atol=0)
    torch.testing.assert_close(weights @ means, weights @ before, rtol=0.05, atol=0)


@pytest.mark.parametrize("depth", [5.0, 10.0, 13.0, 15.0])
def test_white_balance_of_colours_out_of_the_gamut(depth: float) -> None:
    """From 8 m on the mean of red is negative: no gain brings it to the others."""
    medium = spectral_medium(vertical_depth=depth, g=0.05, mu=0.075)
    image = coloured(64, 90).mean(-3, keepdim=True).expand(1, 3, 64, 90)
    z = torch.full((1, 1, 64, 90), 2.0).double()
    plain, ours = (
        module_of(medium, {"white_balance": share}, exposure="auto")(image, z).clamp(min=0)
        for share in (0.0, 1.0)
    )
    weights = torch.from_numpy(referee.LUMINANCE)
    before, after = (weights @ light.mean((0, 2, 3)) for light in (plain, ours))
    torch.testing.assert_close(after, before, rtol=0.05, atol=0)


@pytest.mark.parametrize("options", [{"compensation": 10.0}, {"compensation": 8.0}])
@pytest.mark.parametrize("planned", [None, (0.1, 20.0)])
def test_bright_exposures_ask_for_no_more_blurs_than_there_are(options: Any, planned: Any) -> None:
    image, z = coloured(64, 90), distances(64, 90).double()
    light = module_of(spectral_medium(), options, distance_range=planned, exposure="auto")(image, z)
    assert light.isfinite().all()


def test_a_planned_blur_knows_of_saturation() -> None:
    plain, vivid = (
        module_of(spectral_medium(), {"saturation": s}, distance_range=(0.1, 20.0)).demand
        for s in (1.0, 4.0)
    )
    assert plain is not None
    assert vivid is not None
    assert vivid.blur_tolerance == plain.blur_tolerance / 4


# Gamut and tone


def test_the_gamut_compression_is_exact_inside_and_monotone() -> None:
    values = torch.linspace(-3, 1, 4001, dtype=torch.float64)
    for brightest in (1e-3, 0.4, 1.0, 20.0):
        colours = torch.stack([torch.ones_like(values), values, values]) * brightest
        light = colours[None, :, None]
        for share in (0.3, 1.0):
            out = compressed(light, share)[0, :, 0]
            inside = values >= 0.25
            assert torch.equal(out[:, inside], colours[:, inside])
            assert torch.equal(out[0], colours[0])
            assert (out[1].diff() > 0).all()
            assert out[1].min() >= (0 if share == 1 else -3 * brightest)
        below = compressed(light, 1.0)[0, 1, 0]
        assert below.min() > 0


def test_the_gamut_compression_has_no_jump_where_light_ends() -> None:
    """The black point leaves pixels without light."""
    colour = torch.tensor([0.0, -0.3, -0.7], dtype=torch.float64).reshape(1, 3, 1, 1)
    above, at, below = (
        compressed(colour + torch.tensor([shift, 0, 0]).double().reshape(1, 3, 1, 1), 0.6)
        for shift in (1e-9, 0.0, -1e-9)
    )
    torch.testing.assert_close(above, at, rtol=0, atol=1e-8)
    torch.testing.assert_close(below, at, rtol=0, atol=1e-8)


@pytest.mark.parametrize("contrast", [0.25, 0.5, 0.9, 1.1, 2.0, 4.0])
def test_tone_is_a_curve(contrast: float) -> None:
    light = torch.linspace(-6, 6, 24_001, dtype=torch.float64)
    out = curved(light, contrast)
    assert (out.diff() > 0).all(), "monotone, beyond white too"
    torch.testing.assert_close(out, -out.flip(0), rtol=0, atol=1e-9)
    fixed = torch.tensor([0.0, 0.18, 1.0], dtype=torch.float64)
    torch.testing.assert_close(curved(fixed, contrast), fixed, rtol=0, atol=1e-12)
    x = torch.tensor(0.18, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(curved(x, contrast), x)
    grey = 0.18**contrast
    k = 0.82 * grey / (0.18 - grey)
    assert float(slope) == pytest.approx(contrast * k / (grey + k))
    steps = (out.diff() / light.diff())[(light[1:] - 1).abs() < 0.0098]  # between two points
    assert steps.max() < 1.05 * steps.min(), "no bend at white"
    light = torch.logspace(-6, 1, 7000, dtype=torch.float64)
    steepest = (curved(light, contrast).diff() / light.diff()).max()
    gain = Development(tone=contrast).gain
    assert 0.98 * steepest <= gain <= 2 * steepest


# Gradients


@pytest.mark.parametrize("exposure", ["none", "auto"])
@pytest.mark.parametrize("medium", MEDIA)
def test_gradients(medium: str, exposure: Any) -> None:
    degrade = module_of(MEDIA[medium](), ALL, exposure=exposure)
    image, z = coloured(5, 6).requires_grad_(), stepped(1, 1, 5, 6).requires_grad_()
    assert torch.autograd.gradcheck(degrade, (image, z))


@pytest.mark.parametrize("stage", ["gamut", "less contrast", "all"])
def test_gradients_of_black_and_bright_pictures(stage: str) -> None:
    degrade = module_of(spectral_medium(), STAGES[stage], distance_range=None)
    for colour in ([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [30.0, 0.0, 0.0], [-1.0, 0.0, -2.0]):
        light = torch.tensor(colour).reshape(1, 3, 1, 1).repeat(1, 1, 6, 7).requires_grad_()
        z = torch.zeros(1, 1, 6, 7).requires_grad_()
        degrade(light, z).sum().backward()
        assert light.grad is not None
        assert light.grad.isfinite().all()
        assert z.grad is not None
        assert z.grad.isfinite().all()


def test_gradients_of_single_precision() -> None:
    image, z = coloured(16, 20), stepped(1, 1, 16, 20)
    for medium in MEDIA.values():
        for development in ({**STAGES["all"], "saturation": 1.0}, STAGES["all"]):
            degrade, slopes = module_of(medium(), development), []
            for dtype in (torch.float32, torch.float64):
                leaf = image.to(dtype, copy=True).requires_grad_()
                degrade(leaf, z.to(dtype)).square().sum().backward()
                assert leaf.grad is not None
                slopes.append(leaf.grad.double())
            torch.testing.assert_close(*slopes, rtol=1e-3, atol=2e-4)


# Engines


@pytest.mark.parametrize("exposure", ["none", "auto"])
@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("medium", MEDIA)
def test_loops_are_what_pytorch_is(medium: str, stage: str, exposure: Any) -> None:
    pytest.importorskip("numba")
    image, z = 1.4 * coloured(33, 70), stepped(1, 1, 33, 70)
    image, z = image.float().double(), z.float().double()
    for space in ("linear", "srgb"):
        degrade = module_of(MEDIA[medium](), STAGES[stage], exposure=exposure, color_space=space)
        with torch.no_grad(), fused.use(True):
            ours, exact = degrade(image.float(), z.float()), degrade(image, z)
        # below black, where curves of less contrast are steep, sRGB shows nothing
        dark = 1e-4 if STAGES[stage].get("tone", 1) < 1 else 1e-5
        torch.testing.assert_close(ours.double(), exact, rtol=1e-5, atol=dark)


def test_pictures_of_a_batch_are_developed_one_by_one() -> None:
    images = torch.cat([picture(40, 50), 0.2 * picture(40, 50).flip(1)])
    # without a blur, which is planned for all of a batch
    law = PointSpread.none()
    waters = Medium.stack(
        [spectral_medium(point_spread=law), spectral_medium_of("7C", point_spread=law)]
    )
    z = stepped(2, 1, 40, 50).float()
    for by_loops, exposure in itertools.product((False, True), ("none", "auto")):
        with torch.no_grad(), fused.use(by_loops):
            together = module_of(waters, exposure=exposure)(images, z)
            for n in range(2):
                alone = module_of(waters[n], exposure=exposure)(images[n], z[n])
                torch.testing.assert_close(alone, together[n], rtol=0, atol=1e-6)
                # and not with the numbers of the other
                other = module_of(waters[n], exposure=exposure)(images[1 - n], z[1 - n])
                assert (other - together[n]).abs().max() > 0.05


@pytest.mark.parametrize("by_loops", [False, True])
@pytest.mark.parametrize("stage", ["all", "black point", "more saturation"])
@pytest.mark.parametrize("medium", MEDIA)
def test_strips_are_the_whole(
    medium: str, stage: str, by_loops: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, z = coloured(331, 257).float(), stepped(1, 1, 331, 257).float()
    degrade = module_of(MEDIA[medium](), STAGES[stage], exposure="auto")
    with torch.no_grad(), fused.use(by_loops):
        whole = degrade(image, z)
        monkeypatch.setattr(uwaug._support.tiles, "LARGE", 1)
        monkeypatch.setattr(uwaug._support.tiles, "_BAND", 20_000)
        monkeypatch.setattr(uwaug.blur.tiled, "_STRIP", 20_000)
        monkeypatch.setattr(uwaug.formation.loops.render, "_BAND", 20_000)
        setup = Setup(degrade.medium, development=degrade.development)
        engine = Scene.of(image, z, setup).engine
        assert engine == ("fused-rows" if by_loops else "tile-rows")
        torch.testing.assert_close(degrade(image, z), whole, rtol=0, atol=2e-5)


@pytest.mark.parametrize("exposure", ["none", 0.7, "auto"])
@pytest.mark.parametrize("parameters", ["frozen", "inputs"])
@pytest.mark.parametrize("medium", MEDIA)
def test_graphs_are_the_module(medium: str, parameters: Any, exposure: Any) -> None:
    from uwaug.onnx.graph import Graph, Options, parameters_of

    image, z = coloured(45, 62).float(), stepped(1, 1, 45, 62).float()
    for stage in ("all", "white balance", "black point", "more saturation"):
        options = {"exposure": exposure, "sides": (32, 160), "tolerance": 0.02}
        degrade = module_of(MEDIA[medium](), STAGES[stage], **options)
        graph = Graph(degrade, Options(parameters))
        given = () if parameters == "frozen" else parameters_of(degrade.medium).values()
        with torch.no_grad():
            exact = degrade(image.double(), z.double())
            ours = graph(image, z, *given)
        torch.testing.assert_close(ours.double(), exact, rtol=0, atol=1e-4)


def test_a_file_is_the_module(tmp_path: Path) -> None:
    """With weights as inputs, and an exposure and a white balance that it computes of each
    picture.
    """
    pytest.importorskip("onnxruntime")
    from uwaug.onnx import OnnxUnderwater, export_onnx

    options = {"exposure": "auto", "sides": (32, 160), "tolerance": 0.02, "color_space": "srgb"}
    degrade = module_of(spectral_medium(), **options)
    path = export_onnx(degrade, tmp_path / "a.onnx", verify=False, parameters="inputs")
    run = OnnxUnderwater(path)
    for seed, size in enumerate([(45, 62), (80, 50)]):
        image = rand(1, 3, *size, seed=seed).float() ** 2
        z = stepped(1, 1, *size, seed=seed).float()
        with torch.no_grad():
            exact = degrade(image.double(), z.double())
        ours = run(image, z, medium=degrade.medium)
        torch.testing.assert_close(ours.double(), exact, rtol=0, atol=2e-4)


# Terms and lights


@pytest.mark.parametrize("medium", MEDIA)
def test_terms_add_up_to_what_is_linear(medium: str) -> None:
    image, z = coloured(20, 26), stepped(1, 1, 20, 26)
    linear = Development(compensation=0.5, white_balance=0.6, saturation=1.4)
    options = {"exposure": "auto", "color_space": "linear"}
    setup = Setup(MEDIA[medium](), development=linear, **options)
    scene = Scene.of(image, z, setup)
    parts = scene.term_pictures()
    torch.testing.assert_close(sum(parts.values()), scene.picture())
    torch.testing.assert_close(scene.terms().image, scene.picture())
    # the rest is done to the sum
    whole = Scene.of(image, z, Setup(MEDIA[medium](), development=ALL, **options))
    terms = whole.term_pictures()
    assert (sum(terms.values()) - whole.picture()).abs().max() > 0.01


@pytest.mark.parametrize("water", ["I", "III", "1C", "7C"])
def test_pictures_are_those_of_the_bands(water: str) -> None:
    """Terms of colours with spectra, with a field, against a picture of each wavelength."""
    image = coloured(14, 18)
    z, field = stepped(1, 1, 14, 18, far=4.0), 0.6 + 0.8 * rand(1, 1, 14, 18)
    law, depth = PointSpread(1.5), 3.0
    medium = spectral_medium_of(water, vertical_depth=depth, point_spread=law)
    path = (z * field)[0, 0].numpy()
    sigma = 1.5 * float(medium.b_mean) * path
    bands = spectral.bands_of(Water.jerlov(water), depth=depth, g=0.2, mu=0.3)
    exact = spectral.terms(image[0].numpy(), path, bands, spectral.eye(), sigma)
    terms = form_image(image, z, medium, field)
    # of three channels, each curve within the tolerance
    peak = float(image.sum(1).max())
    for ours, wanted in zip(terms, exact, strict=True):
        assert np.abs(ours[0].numpy() - wanted).max() <= 2 * 0.002 * peak
    (J,) = image.numpy()
    grey = form_image(image, z, Medium.from_water(water, vertical_depth=depth), field).image
    assert np.abs(grey[0].numpy() - sum(exact)).max() > 0.05, J.shape


@pytest.mark.parametrize("tint", [(0.1, 0.5, 1.0), (1.0, 0.1, 0.05)], ids=["warm", "blue"])
@pytest.mark.parametrize("water", ["II", "7C"])
def test_lamps_are_those_of_the_bands(water: str, tint: tuple[float, ...]) -> None:
    """Spectrum of the lamp × that of the surface, both ways through the water."""
    J, axis, place = coloured(14, 18)[0].numpy(), [400.0, 520.0, 700.0], (0.4, -0.3, 0.0)
    bands = spectral.bands_of(Water.jerlov(water), depth=3.0, g=0.2, mu=0.3)
    lamp = spectral.Lamp61(np.array(place), 3.0, np.interp(spectral.BANDS, axis, tint))
    z, arrives, veil = spectral.lit_wall(J, 1.5, 20.0, bands, spectral.eye(), lamp)
    medium = spectral_medium_of(water, vertical_depth=3.0, point_spread=PointSpread.none())
    light = Light.lamp(place, (0, 0, 1), 3.0, cone=180.0, spectrum=(axis, tint))
    distance = torch.from_numpy(z)[None, None]
    terms = form_image(torch.from_numpy(J)[None], distance, medium, light=light, focal_px=20.0)
    ours = (terms.direct + terms.forward)[0].numpy()
    np.testing.assert_allclose(ours, arrives, rtol=0, atol=0.003)
    np.testing.assert_allclose(terms.backscatter[0].numpy(), veil, rtol=0.005, atol=0.001)
    raised = module_of(medium, ALL, light=light, focal_px=20.0)(torch.from_numpy(J)[None], distance)
    looks = metering_points(14, 18, distance.device).numpy()
    wanted = referee.Camera(**STAGES["all"]).develop(arrives + veil, looks)
    np.testing.assert_allclose(raised[0].numpy(), wanted, rtol=0.01, atol=0.01)


def test_the_sun_and_the_sky_of_spectral_water() -> None:
    """Of one surface they are gains of its light and its veil, as of grey ones."""
    image, z = coloured(14, 18), stepped(1, 1, 14, 18)
    medium = spectral_medium(tolerance=0)
    sun = Light.parallel(40.0, 30.0, diffuse=0.3, gradient=0.4)
    lit, plain = (form_image(image, z, medium, light=light, focal_px=20.0) for light in (sun, None))
    grey = Medium.from_water("II", vertical_depth=6.0)
    shades = form_image(torch.ones_like(image), z, grey, light=sun, focal_px=20.0)
    level = form_image(torch.ones_like(image), z, grey)
    for name in ("direct", "backscatter"):
        ratio = getattr(shades, name) / getattr(level, name)
        torch.testing.assert_close(getattr(lit, name), ratio * getattr(plain, name))


# Refusals


@pytest.mark.parametrize(
    "name, value",
    [
        ("compensation", 11.0),
        ("white_balance", 1.5),
        ("saturation", -0.1),
        ("black_point", 1.1),
        ("gamut", float("nan")),
        ("tone", 0.1),
    ],
)
def test_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"development: {name} must be in .*, got {value}"):
        Development(**{name: value})
