from dataclasses import replace

import pytest
import torch
from texts import require_room

from uwaug import Water, load_preset
from uwaug.figures import demo as plots
from uwaug.figures.demo import preset_case
from uwaug.light.geometry import focal_of
from uwaug.presets.scene import Scene


@pytest.mark.parametrize("name", plots.PICTURES)
def test_no_text_overlaps_or_leaves_the_picture(small, name, monkeypatch):
    assert require_room(lambda: plots.PICTURES[name](small), monkeypatch) > 10


@pytest.mark.parametrize("name", plots.own_pictures())
@pytest.mark.parametrize(
    ("shape", "nearest", "farthest", "rest"),
    [
        ((40, 30), 0.31, 0.38, 0.38),  # a portrait of what is near
        ((10, 30), 3.0, 3.0, torch.inf),  # panoramas
        ((6, 60), 12.0, 170.0, torch.inf),
        ((60, 6), 2.0, 2.0, 2.0),
    ],
)
def test_nor_in_scenes_of_other_shapes_and_distances(
    name, shape, nearest, farthest, rest, monkeypatch
):
    z = torch.linspace(nearest, farthest, shape[0] * shape[1]).reshape(1, *shape)
    z[0, 0] = rest
    note = "Drawn at 1000×500 of 20000×10000 px. 0.0017 % of the distances were unknown."
    scene = Scene(torch.rand(3, *shape), z, None, note)
    case = preset_case(load_preset("tank-proposed-4"))
    draw = plots.own_pictures(case)[name]
    assert require_room(lambda: draw(scene), monkeypatch) > 10


def test_a_preset_is_drawn_as_its_module_degrades(small, monkeypatch):
    """The sum of the terms, with the preset's own colour space, exposure and field."""
    preset = load_preset("survey")
    shown = {}
    monkeypatch.setattr(plots, "show", lambda _, picture, label: shown.update({label: picture}))
    fields = []
    monkeypatch.setattr(plots, "show_field", lambda _, field, span: fields.append((field, span)))
    case = preset_case(preset)
    case = case._replace(setup=replace(case.setup, exposure=1.0))
    plots.draw_terms(small, case)
    ((field, span),) = fields
    assert span == preset.field_range
    wanted = replace(preset, exposure=1.0).module()(small.image, small.distance, field)
    torch.testing.assert_close(shown["I   image"], wanted, rtol=0, atol=2e-3)


def test_both_sheets_show_one_look_of_a_water(small, monkeypatch):
    shown = {}
    monkeypatch.setattr(plots, "show", lambda _, picture, label: shown.update({label: picture}))
    fields = []
    monkeypatch.setattr(plots, "show_field", lambda _, field, span: fields.append(span))
    for draw in plots.own_pictures(Water.jerlov("3C")).values():
        draw(small)
    assert fields == [(1.0, 1.0)]  # nobody has asked for uneven water
    (contact,) = (picture for label, picture in shown.items() if label.startswith("3C "))
    torch.testing.assert_close(shown["I   image"], contact, rtol=0, atol=1e-2)


def test_lamps_shine_into_the_view_that_a_scene_has(small, monkeypatch):
    """A scene of one's own is drawn with its focal length, and with a view 60° wide without."""
    shown = {}
    monkeypatch.setattr(plots, "show", lambda _, picture, label: shown.update({label: picture}))
    preset = load_preset("jaffe-1990")
    case = preset_case(preset)._replace(field_range=(1.0, 1.0))
    wide = focal_of(None, small.image.shape[-1])
    for focal_px in (None, 4 * wide):
        scene = replace(small, focal_px=focal_px)
        plots.own_pictures(case)["2-terms.jpg"](scene)
        wanted = preset.module(focal_px=focal_px or wide)(small.image, small.distance)
        torch.testing.assert_close(shown["I   image"], wanted, rtol=0, atol=5e-3)
