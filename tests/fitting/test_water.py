from pathlib import Path
from typing import Any, Literal

import pytest
import torch
from fitted import scene, seen

import uwaug
import uwaug.fitting.jerlov
from uwaug.fitting import Fit, fit_water
from uwaug.formation.colour import srgb_to_linear
from uwaug.optics.scattering import Scattering
from uwaug.optics.surfaces import Surfaces

NOISE = "What is left is not noise"


def medium_of(water: uwaug.Water | str, depth: float, **options: object) -> uwaug.Medium:
    """With the constants that `fit_water` takes."""
    known = {"g": Scattering.CALIBRATED.g, "point_spread": uwaug.PointSpread.calibrated()}
    options = {**known, "surfaces": "spectral", **options}
    return uwaug.Medium.from_water(water, vertical_depth=depth, **options)


def test_finds_type_visibility_and_depth(water: Fit) -> None:
    assert water.model == "3C"
    for name, truth, most in (("visibility", 5, 0.1), ("vertical_depth", 3, 0.1)):
        number = water.parameters[name]
        assert abs(number.value - truth) < min(most, 4 * number.error)
    assert water.water is not None
    assert water.water.visibility() == pytest.approx(water.parameters["visibility"].value)
    tried = {f"{name}, {kind}" for name in uwaug.JERLOV_TYPES for kind in ("grey", "spectral")}
    assert {candidate.name for candidate in water.candidates} == tried
    assert not any(NOISE in note for note in water.notes)


@pytest.mark.parametrize(("kind", "depth", "gain"), [("II", 6.0, 1.0), ("3C", 1.0, 0.6)])
def test_what_uwaug_has_made(kind: str, depth: float, gain: float, two: None) -> None:
    """Exposure is the medium's: it makes the observed picture."""
    clean, z = scene()
    water = medium_of(kind, depth).brightened(torch.tensor([gain]))
    observed = uwaug.Underwater(water)(clean, z)
    fit = fit_water(clean, observed, z, pixels=1000)
    assert fit.model == kind
    truth = {"contents": 1.0, "vertical_depth": depth, "gain": gain}
    for name, value in truth.items():
        assert fit.parameters[name].value == pytest.approx(value, rel=0.03)
    again = uwaug.Underwater(fit.medium)(clean, z)
    assert (again.double() - observed.double()).abs().mean() < 1


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves few types, for the sake of time."""
    monkeypatch.setattr(uwaug.fitting.jerlov, "JERLOV_TYPES", ("II", "3C"))


def test_depth_that_is_not_identified(two: None) -> None:
    """To a camera of one band, depth is a gain."""
    narrow = uwaug.Camera([540, 550, 560], [[0, 0, 0], [1, 1, 1], [0, 0, 0]])
    options = {"camera": narrow, "surfaces": "grey"}
    fit = fit_water(*seen(medium_of("3C", 2.0, **options)), pixels=500, **options)
    assert fit.parameters["vertical_depth"].state == "not identified"
    wanted = uwaug.Water.jerlov("3C").visibility()
    assert fit.parameters["visibility"].value == pytest.approx(wanted, rel=0.1)


def test_white_balance_is_no_water_if_it_is_free(two: None) -> None:
    balanced = medium_of("3C", 5.0).brightened(torch.tensor([[2.2, 1.0, 1.4]]))
    known = {"vertical_depth": 5.0, "surfaces": "spectral", "pixels": 500}
    fit = fit_water(*seen(balanced), balance="free", **known)
    assert fit_water(*seen(balanced), **known).model != "3C"
    assert fit.model == "3C"
    gains = [fit.parameters[f"gain_{colour}"].value for colour in ("red", "green", "blue")]
    assert gains == pytest.approx([2.2, 1.0, 1.4], rel=0.15)
    assert fit.parameters["contents"].value == pytest.approx(1, rel=0.03)


@pytest.mark.parametrize(
    "given",
    [
        {"g": 0.2, "surfaces": "grey", "point_spread": uwaug.PointSpread.paper()},
        {"g": 0.03, "mu": 0.02, "surfaces": "grey"},  # of a phase function of one's own
    ],
)
def test_what_is_known_is_given(two: None, given: dict[str, Any]) -> None:
    water = medium_of("3C", 1.0, **given)
    fit = fit_water(*seen(water), vertical_depth=1.0, pixels=500, **given)
    depth = fit.parameters["vertical_depth"]
    assert (fit.model, depth.value, depth.state) == ("3C", 1.0, "fixed")
    assert fit.parameters["contents"].value == pytest.approx(1, rel=0.03)
    assert fit.medium.law == water.law
    assert not any("hardly that type" in note for note in fit.notes)


def test_a_fit_has_the_view_of_its_pictures(two: None, tmp_path: Path) -> None:
    """At 22° blurs are wider than a fifth of the picture."""
    (clean, z), view = scene(), uwaug.View(22.0)
    observed = uwaug.Underwater(medium_of("3C", 2.0), view=view)(clean, z)
    fit = fit_water(clean, observed, z, view=view, surfaces="spectral", pixels=1000)
    assert (fit.model, fit.setting.view) == ("3C", view)
    fit.save(tmp_path / "fit.json")
    preset = uwaug.load_preset(tmp_path / "fit.json")
    for made in (fit.module()(clean, z), preset(clean, z)[0]):
        assert (made.int() - observed.int()).abs().max() <= 4
    light = srgb_to_linear(observed / 255)
    assert (fit.rendered()[0] - light).square().mean().sqrt() < 0.003


def test_contents_far_from_those_of_a_type_are_doubted(two: None) -> None:
    clear = medium_of(uwaug.Water.jerlov("3C").with_contents(0.2), 3.0)
    fit = fit_water(*seen(clear), surfaces="spectral", pixels=500)
    assert (fit.model, any("hardly that type" in note for note in fit.notes)) == ("3C", True)


@pytest.mark.parametrize("surfaces", ["grey", "spectral"])
def test_surfaces_are_told_and_depth_is_in_its_interval(two: None, surfaces: Surfaces) -> None:
    """Of a picture as `uwaug degrade --plain` makes it, by the default tolerance, in 8 bits."""
    clean, z = scene()
    plain = medium_of("3C", 4.0, surfaces=surfaces)
    fit = fit_water(clean, uwaug.Underwater(plain)(clean, z), z, pixels=1000)
    assert (fit.model, fit.adequate) == ("3C", True)
    assert fit.notes[0].startswith(f"Jerlov type 3C, {surfaces}")
    depth = fit.parameters["vertical_depth"]
    assert depth.high - 0.2 < depth.low <= 4 <= depth.high


@pytest.mark.parametrize("wrong", ["no Jerlov water", "distances", "surfaces"])
def test_no_type_is_named_that_does_not_explain_the_picture(two: None, wrong: str) -> None:
    water = medium_of("3C", 2.0)
    if wrong == "no Jerlov water":
        water = uwaug.Medium.from_coefficients((0.3,) * 3, (0.2,) * 3, (0.5,) * 3)
    clean, observed, z = seen(water, noise=0.002)
    surfaces: Surfaces | Literal["auto"] = "grey" if wrong == "surfaces" else "auto"
    fit = fit_water(clean, observed, z + (wrong == "distances") / 2, surfaces=surfaces, pixels=500)
    assert any(NOISE in note for note in fit.notes)
    assert (fit.model, fit.adequate) == ("no Jerlov type", False)
