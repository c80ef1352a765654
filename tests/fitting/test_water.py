import pytest
import torch
from fitted import Known, scene, seen

import uwaug
import uwaug.fitting.jerlov
from uwaug.fitting import Fit, fit_water
from uwaug.optics.scattering import Scattering

NOISE = "What is left is not noise"


def medium_of(water: uwaug.Water | str, depth: float, **options: object) -> uwaug.Medium:
    """With the constants that `fit_water` takes, of the scene at a seventh of its size."""
    known = {"g": Scattering.CALIBRATED.g, "surfaces": "spectral"}
    known["point_spread"] = uwaug.PointSpread.calibrated(0.866 * 105)
    return uwaug.Medium.from_water(water, vertical_depth=depth, **{**known, **options})


def test_finds_type_visibility_and_depth(water: Fit, known: Known) -> None:
    assert water.model == "3C"
    visibility, depth = (water.parameters[name] for name in ("visibility", "vertical_depth"))
    assert visibility.value == pytest.approx(5, rel=0.02)
    assert depth.value == pytest.approx(3, abs=0.1)
    assert abs(visibility.value - 5) < 4 * visibility.error
    assert abs(depth.value - 3) < 4 * depth.error
    assert water.water is not None
    assert water.water.visibility() == pytest.approx(visibility.value)
    assert {tried.name for tried in water.candidates} == set(uwaug.JERLOV_TYPES)
    behind = [tried.behind for tried in water.candidates]
    assert behind == sorted(behind)
    assert "All others explain the picture worse" in water.notes[0]
    assert "visibility 4.9" in water.summary() or "visibility 5" in water.summary()
    assert not any(NOISE in note for note in water.notes)


@pytest.mark.parametrize(
    ("kind", "depth", "gain"), [("II", 6.0, 1.0), ("1C", 8.0, 0.6), ("7C", 1.0, 0.6)]
)
def test_what_uwaug_has_made(kind: str, depth: float, gain: float) -> None:
    """Exposure is the medium's: it makes the observed picture."""
    clean, z = scene(step=4)
    law = uwaug.PointSpread.calibrated(0.866 * clean.shape[-1])
    water = medium_of(kind, depth, point_spread=law).brightened(torch.tensor([gain]))
    observed = uwaug.Underwater(water)(clean, z)
    fit = fit_water(clean, observed, z, pixels=1500)
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


def test_what_is_known_is_given(two: None) -> None:
    paper = {"g": 0.2, "surfaces": "grey", "point_spread": uwaug.PointSpread.paper()}
    observed = seen(medium_of("3C", 1.0, **paper))
    fit = fit_water(*observed, vertical_depth=1.0, pixels=500, **paper)
    depth = fit.parameters["vertical_depth"]
    assert (depth.value, depth.state) == (1.0, "fixed")
    assert fit.parameters["contents"].value == pytest.approx(1, rel=0.02)
    assert fit.medium.point_spread == uwaug.PointSpread.paper()


@pytest.mark.parametrize("wrong", ["no Jerlov water", "distances"])
def test_what_the_types_do_not_explain_is_said(two: None, wrong: str) -> None:
    clean, observed, z = seen(medium_of("3C", 2.0))
    if wrong == "distances":
        z = z + 0.5
    else:
        grey = uwaug.Medium.from_coefficients((0.3,) * 3, (0.2,) * 3, (0.5,) * 3)
        clean, observed, z = seen(grey)
    fit = fit_water(clean, observed, z, pixels=1000)
    assert any(NOISE in note for note in fit.notes)
