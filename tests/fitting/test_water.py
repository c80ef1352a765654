from collections.abc import Callable

import pytest
import torch
from fitted import Known, scene, seen

import uwaug
import uwaug.fitting.api
from uwaug import Scattering
from uwaug.fitting import WaterFit, fit_water
from uwaug.jobs import Recipe

FOCAL_PX = 0.866 * 105
"""Of a view 60° wide, as `fit_water` takes it of the scene."""


def medium_of(water: uwaug.Water | str, depth: float, **options: object) -> uwaug.Medium:
    """With the constants that `fit_water` takes."""
    known = {"g": Scattering.CALIBRATED.g, "mu": Scattering.CALIBRATED.mu, "surfaces": "spectral"}
    known["point_spread"] = uwaug.PointSpread.calibrated(FOCAL_PX)
    return uwaug.Medium.from_water(water, vertical_depth=depth, tolerance=0, **{**known, **options})


@pytest.fixture
def only(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Leaves few candidates, for the sake of time."""

    def leave(*candidates: tuple[str, ...]) -> None:
        monkeypatch.setattr(uwaug.fitting.api, "_TYPES", candidates)

    return leave


def test_finds_type_visibility_and_depth(water: WaterFit, known: Known) -> None:
    assert water.type == "3C"
    assert "mixing" not in water.parameters
    assert not any("3C" in tried.name for tried in water.types if "+" in tried.name)
    assert water.visibility == pytest.approx(5, rel=0.02)
    assert water.vertical_depth == pytest.approx(3, abs=0.1)
    assert abs(water.visibility - 5) < 4 * water.errors["visibility"]
    assert abs(water.vertical_depth - 3) < 4 * water.errors["vertical_depth"]
    assert water.water.visibility() == pytest.approx(water.visibility)
    names = [tried.name for tried in water.types]
    assert set(names) >= set(uwaug.JERLOV_TYPES)
    behind = [tried.behind for tried in water.types]
    assert behind == sorted(behind)
    assert water.types[names.index("9C")].told_apart
    assert water.types[names.index("3C")].error < 1.1
    assert "No " not in water.message
    assert "Jerlov type 3C, visibility" in water.summary()
    truth = medium_of(uwaug.Water.jerlov("3C").with_visibility(5), 3.0)
    clean, _, z = known
    again, first = (uwaug.form_image(clean / 255, z, x).image for x in (water.medium, truth))
    assert (again - first).abs().max() < 0.01
    aug = uwaug.RandomUnderwater(waters=[water.water])
    assert aug(clean, z)[0].shape == clean.shape


def test_mixture(only: Callable[..., None]) -> None:
    only(("1C",), ("3C",), ("1C", "3C"))
    truth = uwaug.Water.jerlov("1C").mix(uwaug.Water.jerlov("3C"), 0.4)
    said: list[str] = []
    fit = fit_water(*seen(medium_of(truth, 3.0)), pixels=1000, progress=said.append)
    assert said[-3:] == ["fitting 1C", "fitting 3C", "fitting 1C + 3C"]
    assert fit.type == "1C + 3C"
    assert fit.parameters["mixing"].value == pytest.approx(0.4, abs=0.1)
    assert fit.visibility == pytest.approx(truth.visibility(), rel=0.02)
    assert fit.errors["mixing"] < 0.05


def test_gain_and_depth_of_two_pictures(only: Callable[..., None]) -> None:
    only(("5C",), ("7C",))
    water = medium_of("5C", 2.0)
    both = [seen(water, gain=gain, seed=i) for i, gain in enumerate((1.3, 0.8))]
    pictures = [picture.observed for picture in both]
    fit = fit_water(both[0].clean, pictures, both[0].distance, gain="free", pixels=1000)
    assert fit.type == "5C"
    gains = [fit.parameters[f"gain_{i}"].value for i in (1, 2)]
    assert gains == pytest.approx([1.3, 0.8], rel=0.05)
    assert fit.vertical_depth == pytest.approx(2, abs=0.3)
    assert fit.visibility == pytest.approx(uwaug.Water.jerlov("5C").visibility(), rel=0.02)
    assert set(fit.errors) >= {"gain_1", "gain_2", "vertical_depth"}


def test_depth_that_is_not_identified(only: Callable[..., None]) -> None:
    """To a camera of one band, depth is a gain."""
    only(("3C",))
    narrow = uwaug.Camera([540, 550, 560], [[0, 0, 0], [1, 1, 1], [0, 0, 0]])
    water = medium_of("3C", 2.0, camera=narrow, surfaces="grey")
    fit = fit_water(*seen(water), camera=narrow, surfaces="grey", pixels=500)
    assert fit.vertical_depth is None
    assert "Not identified: vertical_depth" in fit.message
    assert fit.visibility == pytest.approx(uwaug.Water.jerlov("3C").visibility(), rel=0.1)


def test_no_jerlov_water(only: Callable[..., None]) -> None:
    only(("II",), ("3C",))
    grey = uwaug.Medium.from_coefficients((0.3,) * 3, (0.2,) * 3, (0.5,) * 3)
    fit = fit_water(*seen(grey), pixels=500)
    assert "No Jerlov water explains this picture" in fit.message
    assert "uwaug.fit" in fit.message


def test_calibrated_law_and_known_depth(only: Callable[..., None]) -> None:
    only(("3C",))
    law = uwaug.PointSpread.calibrated(40.0)
    water = medium_of("3C", 1.0, point_spread=law, surfaces="grey")
    known = {"vertical_depth": 1.0, "pixels": 500, "surfaces": "grey", "gain": "fixed"}
    fit = fit_water(*seen(water), focal_px=40.0, **known)
    assert fit.parameters["vertical_depth"].state == "fixed"
    assert fit.vertical_depth == 1.0
    assert "vertical_depth" not in fit.errors
    assert fit.visibility == pytest.approx(uwaug.Water.jerlov("3C").visibility(), rel=0.02)
    assert fit.medium.point_spread == law
    assert "widest blur" not in fit.message
    wide = fit_water(*seen(water), focal_px=900.0, **known)
    assert "widest blur" in wide.message


@pytest.mark.parametrize(
    "change, message",
    [
        ({"observed": torch.rand(3, 71, 105) * 1e-4}, "observed: only .* lie above the noise"),
        ({"gain": "channels"}, "gain must be one of fixed, free"),
        ({"g": 1.5}, r"g must be in \[0, 1\]"),
        ({"vertical_depth": -1.0}, "vertical_depth must be"),
        ({"focal_px": 50.0, "point_spread": uwaug.PointSpread.paper()}, "expected one of the two"),
        ({"camera": "Kodak"}, "no camera is called"),
    ],
)
def test_refuses(known: Known, change: dict[str, object], message: str) -> None:
    inputs = dict(zip(("clean", "observed", "distance"), known, strict=True))
    with pytest.raises(ValueError, match=message):
        fit_water(**{**inputs, **change})


@pytest.mark.parametrize(
    "type, options",
    [
        ("II", {"vertical_depth": 6.0}),
        ("1C", {"visibility": 6.0, "vertical_depth": 8.0}),
        ("7C", {}),
    ],
)
def test_what_degrade_has_made(
    only: Callable[..., None], type: str, options: dict[str, float]
) -> None:
    """`uwaug degrade --water` and `fit_water` agree, with the defaults of both."""
    only(("IB",), ("II",), ("1C",), ("5C",), ("7C",), ("II", "III"), ("5C", "7C"))
    clean, z = scene(step=4)
    degraded = Recipe(water=type, options=options).open().degrade(clean, z, None, 0)
    used = degraded.drawn["samples"][0]["used"]
    fit = fit_water(clean, degraded.image, z, pixels=3000)
    assert fit.type == type
    assert "No " not in fit.message
    assert "The model misses something" not in fit.message
    for name, error in fit.errors.items():
        truth = used["gain" if name == "gain_1" else name]
        assert abs(fit.parameters[name].value - truth) < 3 * error
        assert error < 0.02 * truth


def test_wrong_distances_are_said(only: Callable[..., None]) -> None:
    only(("II",))
    clean, z = scene(step=4)
    degraded = Recipe(water="II").open().degrade(clean, z, None, 0)
    fit = fit_water(clean, degraded.image, z + 0.3, pixels=1500)
    assert "The model misses something, such as wrong distances" in fit.message


def test_depth_that_looks_like_an_exposure_is_said(only: Callable[..., None]) -> None:
    """In 9C as deep as an exposure allows: "8 m" is 4.8 m then, and was found to be 2 ± .3 m."""
    only(("9C",))
    clean, z = scene(step=4)
    said = {}
    for depth in (1.0, 8.0):
        wet = Recipe(water="9C", options={"vertical_depth": depth}).open()
        fit = fit_water(clean, wet.degrade(clean, z, None, 0).image, z, pixels=1500)
        said[depth] = "Depth and exposure do nearly the same" in fit.message
    assert said == {1.0: False, 8.0: True}


@pytest.mark.parametrize("development", [{"white_balance": 0.7}, {"tone": 1.3}])
def test_a_developed_picture_is_no_water(
    only: Callable[..., None], development: dict[str, float]
) -> None:
    only(("II",), ("1C",), ("5C",))
    clean, z = scene(step=4)
    options = {"visibility": 6.0, "vertical_depth": 4.0, **development}
    degraded = Recipe(water="1C", options=options).open().degrade(clean, z, None, 0)
    fit = fit_water(clean, degraded.image, z, pixels=2000)
    assert "No Jerlov water explains this picture" in fit.message
    assert 'give gain="matrix"' in fit.message
    if "white_balance" in development:
        fit = fit_water(clean, degraded.image, z, gain="matrix", pixels=2000)
        assert fit.type == "1C"
        assert "No " not in fit.message
        assert fit.visibility == pytest.approx(6.0, abs=3 * fit.errors["visibility"])
        assert fit.errors["vertical_depth"] > 0.1
