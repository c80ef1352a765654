from collections.abc import Callable, Sequence

import numpy as np
import pytest
import torch
import uwaug.fitting.water
from torch import Tensor
from uwaug.fitting.inputs import pairs_of
from uwaug.fitting.pixels import gather
from uwaug.fitting.spectral import Grid, OneType, Optics, SpectralProblem
from uwaug.fitting.water import fit_water

import uwaug
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear
from uwaug.optics.camera import load_camera
from uwaug.optics.curves import curves

DISTANCE = torch.linspace(1.2, 6.0, 70 * 90).reshape(1, 70, 90)


def scene() -> Tensor:
    """Patches of random colour, with a grain."""
    generator = torch.Generator().manual_seed(1)
    patches = torch.rand(3, 14, 18, generator=generator) ** 2
    grain = torch.rand(3, 70, 90, generator=generator)
    return 0.8 * patches.repeat_interleave(5, 1).repeat_interleave(5, 2) + 0.15 * grain


def observed(medium: uwaug.Medium, gain: float = 1.0, noise: float = 0.01, seed: int = 0) -> Tensor:
    light = uwaug.form_image(srgb_to_linear(scene()), DISTANCE, medium).image
    generator = torch.Generator().manual_seed(seed)
    light = gain * light + noise * torch.randn(light.shape, generator=generator)
    return (linear_to_srgb(light).clamp(0, 1) * 255).round().to(torch.uint8)


def medium_of(water: uwaug.Water | str, depth: float) -> uwaug.Medium:
    return uwaug.Medium.from_water(water, vertical_depth=depth, tolerance=0)


@pytest.fixture
def only(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Leaves few candidates, for the sake of time."""

    def leave(*candidates: tuple[str, ...]) -> None:
        monkeypatch.setattr(uwaug.fitting.water, "_CANDIDATES", candidates)

    return leave


def test_finds_type_visibility_and_depth() -> None:
    truth = uwaug.Water.jerlov("3C").with_visibility(5)
    picture = observed(medium_of(truth, 3.0))
    lines: list[str] = []
    found = fit_water(scene(), picture, DISTANCE, pixels=500, progress=lines.append)
    assert found.type == "3C"
    assert found.mixing is None
    assert found.gain == ()
    assert not any("3C" in one.name for one in found.types if "+" in one.name)
    assert found.visibility == pytest.approx(5, rel=0.02)
    assert found.vertical_depth == pytest.approx(3, abs=0.1)
    assert abs(found.visibility - 5) < 4 * found.errors["visibility"]
    assert abs(found.vertical_depth - 3) < 4 * found.errors["vertical_depth"]
    assert found.water.visibility() == pytest.approx(found.visibility)
    names = [one.name for one in found.types]
    assert set(names) >= set(uwaug.JERLOV_TYPES)
    behind = [one.behind for one in found.types]
    assert behind == sorted(behind)
    assert found.types[names.index("9C")].told_apart
    assert found.types[names.index("3C")].error < 1.1
    assert "No " not in found.message
    assert "Jerlov type 3C, visibility" in found.summary()
    assert len(lines) > 19
    again = uwaug.form_image(srgb_to_linear(scene()), DISTANCE, found.medium).image
    first = uwaug.form_image(srgb_to_linear(scene()), DISTANCE, medium_of(truth, 3.0)).image
    assert (again - first).abs().max() < 0.01
    aug = uwaug.RandomUnderwater(waters=[found.water])
    assert aug(scene(), DISTANCE)[0].shape == scene().shape


def test_mixture(only: Callable[..., None]) -> None:
    only(("1C",), ("3C",), ("1C", "3C"))
    truth = uwaug.Water.jerlov("1C").mix(uwaug.Water.jerlov("3C"), 0.4)
    found = fit_water(scene(), observed(medium_of(truth, 3.0)), DISTANCE, pixels=1000)
    assert found.type == "1C + 3C"
    assert found.mixing == pytest.approx(0.4, abs=0.1)
    assert found.visibility == pytest.approx(truth.visibility(), rel=0.02)
    assert found.errors["mixing"] < 0.05


def test_gain_and_depth_of_two_pictures(only: Callable[..., None]) -> None:
    only(("5C",), ("7C",))
    water = medium_of("5C", 2.0)
    pictures = [observed(water, gain, seed=i) for i, gain in enumerate((1.3, 0.8))]
    found = fit_water(scene(), pictures, DISTANCE, gain="free", pixels=1000)
    assert found.type == "5C"
    assert found.gain == pytest.approx((1.3, 0.8), rel=0.05)
    assert found.vertical_depth == pytest.approx(2, abs=0.3)
    assert found.visibility == pytest.approx(uwaug.Water.jerlov("5C").visibility(), rel=0.02)
    assert set(found.errors) >= {"gain_1", "gain_2", "vertical_depth"}


def test_depth_that_is_not_identified(only: Callable[..., None]) -> None:
    """To a camera of one band, depth is a gain."""
    only(("3C",))
    narrow = uwaug.Camera([540, 550, 560], [[0, 0, 0], [1, 1, 1], [0, 0, 0]])
    water = uwaug.Medium.from_water("3C", narrow, vertical_depth=2.0, tolerance=0)
    found = fit_water(scene(), observed(water), DISTANCE, camera=narrow, gain="free", pixels=500)
    assert found.vertical_depth is None
    assert "Not identified: vertical depth" in found.message
    assert found.visibility == pytest.approx(uwaug.Water.jerlov("3C").visibility(), rel=0.1)


def test_no_jerlov_water(only: Callable[..., None]) -> None:
    only(("II",), ("3C",))
    grey = uwaug.Medium.from_coefficients((0.3,) * 3, (0.2,) * 3, (0.5,) * 3)
    found = fit_water(scene(), observed(grey), DISTANCE, pixels=500)
    assert "No Jerlov water explains this picture" in found.message
    assert "uwaug.fit" in found.message


def test_calibrated_law_and_known_depth(only: Callable[..., None]) -> None:
    only(("3C",))
    law = uwaug.PointSpread.calibrated(40.0)
    water = uwaug.Medium.from_water("3C", g=0.05, mu=0.075, point_spread=law, tolerance=0)
    known = {"vertical_depth": 1.0, "pixels": 500}
    found = fit_water(scene(), observed(water), DISTANCE, focal_px=40.0, **known)
    assert found.parameters["vertical_depth"].state == "fixed"
    assert found.vertical_depth == 1.0
    assert "vertical_depth" not in found.errors
    assert found.visibility == pytest.approx(uwaug.Water.jerlov("3C").visibility(), rel=0.02)
    assert found.medium.point_spread == law
    assert "widest blur" not in found.message
    wide = fit_water(scene(), observed(water), DISTANCE, focal_px=900.0, **known)
    assert "widest blur" in wide.message


def problem_of(names: Sequence[str], **options: object) -> SpectralProblem:
    picture = observed(medium_of("3C", 3.0), noise=0.0)
    pairs = pairs_of(scene(), picture, DISTANCE, None, None, "srgb")
    pixels = gather(pairs, ["gaussian"], 600, np.random.default_rng(0))
    optics = Optics(load_camera("Nikon 5100 (NPL)"), 0.2, 0.3, uwaug.PointSpread.paper())
    waters = tuple(uwaug.Water.jerlov(name) for name in names)
    structure = OneType(waters, optics, None, ((70, 90),), pixels.reference, gain=True)
    return SpectralProblem(structure, pixels)


def test_model_is_that_of_form_image() -> None:
    problem = problem_of(["3C"])
    light = problem.model(np.array([0.0, 3.0, 1.0]))
    # what remains is the rounding to 8 bits, and two tolerances of blurs
    assert (light - problem.pixels.observed).abs().max() < 0.006
    assert (light - problem.pixels.observed).std() < 0.0015


def test_slopes_are_those_of_wider_differences() -> None:
    problem = problem_of(["1C", "3C"])
    theta = np.array([0.2, 0.4, 2.0, 1.1])
    _, jacobian = problem.linearised(theta)
    for i in range(4):
        step = np.zeros(4)
        step[i] = 1e-3
        wide = (problem.residual(theta + step) - problem.residual(theta - step)) / 2e-3
        assert np.abs(jacobian[:, i] - wide).max() < 1e-3 * np.abs(wide).max()


def test_grid_holds_the_curves_to_open_water() -> None:
    problem = problem_of(["II"])
    z = problem.pixels.z.clone()
    z[..., :5] = 1e9
    z[..., 5:10] = 300.0
    pixels = problem.pixels.__class__(**{**vars(problem.pixels), "z": z})
    grid, sums = Grid.of(pixels), medium_of("II", 2.0).sums(exact_at_lens=True)
    for exact, at_nodes in zip(curves(sums, z), curves(sums, grid.z), strict=True):
        assert (at_nodes @ grid.weights - exact).abs().max() < 1e-6


@pytest.mark.parametrize(
    "change, message",
    [
        ({"distance": torch.full_like(DISTANCE, 3.0)}, "distance is flat"),
        ({"distance": 1000 * DISTANCE}, "must be in metres"),
        ({"distance": torch.full_like(DISTANCE, torch.nan)}, "only 0 pixels can be used"),
        ({"observed": scene()}, "the same picture"),
        ({"observed": torch.rand(3, 70, 90) * 1e-4}, "observed: only .* lie above the noise"),
        ({"gain": "channels"}, "gain must be one of fixed, free"),
        ({"g": 1.5}, r"g must be in \[0, 1\]"),
        ({"vertical_depth": -1.0}, "vertical_depth must be"),
        ({"focal_px": 50.0, "point_spread": uwaug.PointSpread.paper()}, "expected one of the two"),
        ({"pixels": 10}, r"pixels must be in \[500"),
        ({"camera": "Kodak"}, "no camera is called"),
        ({"color_space": "rgb"}, "color_space must be one of"),
    ],
)
def test_refuses(change: dict[str, object], message: str) -> None:
    picture = observed(medium_of("3C", 2.0))
    given = {"clean": scene(), "observed": picture, "distance": DISTANCE, **change}
    with pytest.raises(ValueError, match=message):
        fit_water(**given)
