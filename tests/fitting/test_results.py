"""Results as files, as modules and as pictures."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from texts import require_room

from uwaug.fitting import load_fit
from uwaug.formation.colour import linear_to_srgb
from uwaug.optics.view import WIDE


@pytest.fixture(params=["auto", "haze", "water", "veil"])
def result(request):
    return request.getfixturevalue(request.param)


def test_saved_and_loaded(result, tmp_path):
    path = tmp_path / "fit.json"
    result.save(path)
    assert list(tmp_path.iterdir()) == [path]
    again = load_fit(path)
    assert again.summary() == result.summary() == str(result)
    for name in ("parameters", "errors", "water", "geometry", "candidates", "remainder"):
        assert getattr(again, name) == getattr(result, name)
    np.testing.assert_array_equal(again.covariance, result.covariance)
    assert again.medium.law == result.medium.law
    x, z = torch.rand(3, 30, 40), torch.rand(1, 30, 40) + 1
    torch.testing.assert_close(again.module()(x, z), result.module()(x, z))
    with pytest.raises(ValueError, match="has no clean pictures"):
        again.rendered()


def test_files_that_are_none(haze, tmp_path):
    path = tmp_path / "fit.json"
    with pytest.raises(FileNotFoundError):
        load_fit(path)
    haze.save(path)
    plain = json.loads(path.read_text())
    without = {key: x for key, x in plain.items() if key != "setting"}
    for data in ([], {**plain, "kind": "Medium"}, {**plain, "colour": 1}, without):
        path.write_text(json.dumps(data))
        with pytest.raises(ValueError, match=r"fit\.json: not a fit"):
            load_fit(path)


def test_the_module_makes_the_picture(auto, known):
    module, geometry = auto.module(sides=(32, 128)), auto.geometry
    planned = 0.2 * geometry.reference, 1.5 * geometry.farthest
    assert module.distance_range == pytest.approx(planned)
    picture = module(known.clean.float() / 255, known.distance)
    assert (picture - linear_to_srgb(auto.rendered()[0])).abs().max() < 0.02
    left = auto.rendered()[0] - auto.pictures.observed[0]
    assert float(left[:, auto.pictures.usable[0, 0]].square().mean().sqrt()) < 0.012


def test_width_of_the_medium_is_that_of_the_fit(auto):
    height, width = auto.geometry.size
    at = torch.full((1, 1, 1, 1), auto.geometry.reference, dtype=torch.float64)
    for times in (1, 2):  # twice the picture, twice the px
        medium = auto.medium.in_pixels((times * height, times * width), WIDE)
        wanted = times * auto.parameters["width"].value
        assert float(medium.width(at)) == pytest.approx(wanted, rel=1e-9)


def test_no_text_overlaps_or_leaves_the_picture(result, monkeypatch):
    long = replace(result, notes=(*result.notes, *["a sentence that goes on and on, " * 8] * 3))
    assert require_room(long.plot, monkeypatch, margin=10) > 10


def test_a_sheet_shows_what_is_left(auto):
    usable = auto.pictures.usable.clone()
    usable[..., :20, :30] = False
    figure = replace(auto, pictures=replace(auto.pictures, usable=usable)).plot()
    (axis,) = (x for x in figure.axes if "Observed −" in x.get_title(loc="left"))
    for c, bars in enumerate(axis.containers):
        shown = bars.lines[0].get_ydata()
        assert shown.tolist() == [row.mean[c] for row in auto.remainder]
    pictures = [x.images[0].get_array() for x in figure.axes if x.images]
    wanted = (auto.pictures.observed[0], auto.rendered()[0].double().where(usable[0], 1.0))
    for shown, light in zip(pictures, wanted, strict=True):
        picture = linear_to_srgb(light.clamp(0, 1)).permute(1, 2, 0)
        np.testing.assert_allclose(np.asarray(shown), picture.numpy(), atol=1e-6)
