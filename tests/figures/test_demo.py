from dataclasses import replace

import pytest
import torch

from uwaug import Lamp, Light, Medium, PointSpread, Underwater, Water, load_preset, published
from uwaug.figures import comparison, demo
from uwaug.figures.demo import preset_case, water_case
from uwaug.formation.colour import decoded
from uwaug.presets.scene import Scene


@pytest.fixture
def shown(monkeypatch):
    """What stands on the sheets that are drawn, by the first word above it."""
    cells, draw = {}, demo.sheet_of

    def remembered(scene, drawn, heading, caption):
        cells.update({words.split()[0]: (picture, words) for picture, words in drawn})
        cells["caption"] = caption
        return draw(scene, drawn, heading, caption)

    monkeypatch.setattr(demo, "sheet_of", remembered)
    monkeypatch.setattr(comparison, "sheet_of", remembered)
    return cells


@pytest.mark.parametrize(
    ("shape", "ends", "rest", "words"),
    [
        ((40, 30), (0.31, 0.38), 0.38, "0.31 m (yellow) to 0.38 m (violet)"),
        ((6, 60), (12.0, 170.0), torch.inf, "12 m (yellow) to 170 m, open water (violet)"),
    ],
)
def test_scenes_of_any_shape_and_distance_are_drawn(shown, shape, ends, rest, words):
    z = torch.linspace(*ends, shape[0] * shape[1]).reshape(1, *shape)
    z[0, -1, 0] = rest
    scene = Scene(torch.rand(3, *shape), z, note="Drawn at 1000×500 of 20000×10000 px.")
    case = preset_case("tank-proposed-4", load_preset("tank-proposed-4"))
    for drawn in (demo.draw_waters(scene), demo.draw_terms(scene, case)):
        assert drawn.width < 1400
        assert shown["z"][1].endswith(words)


def test_the_terms_are_those_of_the_picture_beside_them(shown, small):
    for case in (
        preset_case("survey", load_preset("survey")),
        water_case(Water.jerlov("1C"), small),
    ):
        demo.draw_terms(small, case._replace(field_range=(1.0, 1.0)))
        direct, forward, backscatter, image = (shown[name][0] for name in "DFBI")
        if case.module.color_space == "linear":
            total = direct + forward + backscatter
            torch.testing.assert_close(total, image, atol=5e-3, rtol=0)
        else:  # no term is brighter than all of them
            for term in (direct, forward, backscatter):
                assert (term.clamp(0, 1) <= image + 0.05).all()


def test_the_terms_are_blurred_by_the_view_of_the_scene(shown, small):
    case = water_case(Water.jerlov("3C"), small)
    medium = Medium.from_water("3C", g=0.1, point_spread=PointSpread.calibrated())
    module = Underwater(medium, None, view=small.view)  # no colour leaves sRGB
    demo.draw_terms(small, case._replace(module=module))
    total = sum(decoded(shown[name][0], "srgb") for name in "DFB")
    torch.testing.assert_close(total.clamp(0, 1), decoded(shown["I"][0], "srgb"), atol=2e-3, rtol=0)


def test_a_preset_with_lamps_is_not_shown_by_daylight():
    lit = replace(load_preset("survey"), light=Light((Lamp((0.3, 0.0, 0.0)),)))
    with pytest.raises(ValueError, match="night: sheets of terms are by daylight"):
        preset_case("night", lit)


def test_systems_are_compared_in_one_water(shown, small):
    comparison.draw_comparison(small, "7C", ["akkaynak-2018", "hou-2020"])
    z = small.distance
    own = demo.in_waters([Water.jerlov("7C")], small)(small.image, z)
    theirs = published.akkaynak_2018(small.image, z, "7C")
    for name, wanted in (("no", small.image), ("uwaug", own), ("akkaynak-2018", theirs)):
        picture, words = shown[name]
        assert float((picture - wanted).abs().max()) < 1e-5
        assert words.endswith("({:.2f} {:.2f} {:.2f})".format(*wanted.mean((1, 2)).tolist()))
    assert "hou-2020" in shown


def test_a_water_of_spectra_is_drawn_by_all_that_take_spectra(shown, small):
    comparison.draw_comparison(small, "chlorophyll=2")
    assert {*published.systems()} - {*shown} == {"li-2020", "slurpp-2025"}
    with pytest.raises(ValueError, match=r"water must be one of I, .*'chlorophyll=2"):
        comparison.draw_comparison(small, "chlorophyll=2", ["hou-2020", "UWCNN"])
