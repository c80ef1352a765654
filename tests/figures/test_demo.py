from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from texts import require_room

from uwaug import Lamp, Light, Water, load_preset, published
from uwaug.figures import comparison, demo
from uwaug.figures.demo import preset_case, water_case
from uwaug.presets.scene import Scene


@pytest.mark.parametrize("name", demo.PICTURES)
def test_no_text_overlaps_or_leaves_the_picture(small, name, monkeypatch):
    assert require_room(lambda: demo.PICTURES[name](small), monkeypatch) > 10


@pytest.mark.parametrize("name", ["1-waters.jpg", "2-terms.jpg"])
@pytest.mark.parametrize(
    ("shape", "nearest", "farthest", "rest"),
    [
        ((40, 30), 0.31, 0.38, 0.38),  # a portrait of what is near
        ((6, 60), 12.0, 170.0, torch.inf),  # a panorama
        ((60, 6), 2.0, 2.0, 2.0),
    ],
)
def test_nor_in_scenes_of_other_shapes_and_distances(
    name, shape, nearest, farthest, rest, monkeypatch
):
    z = torch.linspace(nearest, farthest, shape[0] * shape[1]).reshape(1, *shape)
    z[0, 0] = rest
    note = "Drawn at 1000×500 of 20000×10000 px. 0.0017 % of the distances were unknown."
    scene = Scene(torch.rand(3, *shape), z, note=note)
    draw = demo.own_pictures(preset_case("tank-proposed-4", load_preset("tank-proposed-4")))[name]
    assert require_room(lambda: draw(scene), monkeypatch) > 10


def test_the_terms_are_those_of_the_picture_beside_them(small, monkeypatch):
    shown = {}
    monkeypatch.setattr(demo, "show", lambda _, picture, label: shown.update({label: picture}))
    for case in (
        preset_case("survey", load_preset("survey")),
        water_case(Water.jerlov("1C"), small),
    ):
        demo.draw_terms(small, case._replace(field_range=(1.0, 1.0)))
        terms = [shown[name] for name in ("D   direct", "F   forward scatter", "B   backscatter")]
        if case.module.color_space == "linear":
            torch.testing.assert_close(sum(terms), shown["I   image"], atol=5e-3, rtol=0)
        else:  # no term is brighter than all of them
            assert all((term.clamp(0, 1) <= shown["I   image"] + 0.05).all() for term in terms)


def test_a_preset_with_lamps_is_not_shown_by_daylight():
    lit = replace(load_preset("survey"), light=Light((Lamp((0.3, 0.0, 0.0)),)))
    with pytest.raises(ValueError, match="night: sheets of terms are by daylight"):
        preset_case("night", lit)


def test_systems_are_compared_in_one_water(small, monkeypatch):
    systems = ["akkaynak-2018", "hou-2020"]
    figures = []

    def draw():
        figures.append(comparison.draw_comparison(small, "7C", systems, stretch=0.2))
        return figures[0]

    assert require_room(draw, monkeypatch) >= 5
    caption = figures[0].texts[1].get_text()
    assert "in brackets the means of red, green and blue, 0…1" in caption
    assert "uwaug: scene 5 m deep" in caption
    assert "Distances times 0.2." in caption
    axes, z = figures[0].axes, 0.2 * small.distance
    titles = ["no water", "uwaug", *systems]
    assert [axis.get_title("left").split("  ")[0] for axis in axes[:4]] == titles
    own = demo.in_waters([Water.jerlov("7C")], small)(small.image, z)
    theirs = published.akkaynak_2018(small.image, z, "7C")
    for axis, wanted in ((axes[1], own), (axes[2], theirs)):
        assert np.abs(axis.images[0].get_array() - wanted.permute(1, 2, 0).numpy()).max() < 1e-5


def test_a_stretch_that_is_no_factor_is_refused(small):
    with pytest.raises(ValueError, match="stretch must be finite and > 0, got 0"):
        comparison.draw_comparison(small, "7C", stretch=0)


@pytest.mark.parametrize("shape", [(20, 30), (30, 20), (6, 60)])
def test_names_of_systems_do_not_run_into_each_other(shape, monkeypatch):
    scene = Scene(
        torch.rand(3, *shape), torch.linspace(1, 4, shape[0] * shape[1]).reshape(1, *shape)
    )
    systems = ["ismiroglou-reference-2025", "ismiroglou-2025", "slurpp-2025", "mcglamery-1980"]
    draw = partial(comparison.draw_comparison, scene, "II", systems)
    assert require_room(draw, monkeypatch) >= 7
