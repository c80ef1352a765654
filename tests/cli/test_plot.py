from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import uwaug
from uwaug.figures.cases import preset_case
from uwaug.figures.demo import draw_terms
from uwaug.presets.scene import own_scene


@pytest.fixture
def files(tmp_path, monkeypatch) -> Path:
    """A picture of 30×20 px and its distances, in the folder where the command runs."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)).save("a.png")
    np.save("a.npy", np.linspace(1, 4, 600, dtype=np.float32).reshape(20, 30))
    np.save("b.npy", np.ones((20, 31), np.float32))
    np.save("mm.npy", np.full((20, 30), 2500, np.uint16))
    np.save("open.npy", np.full((20, 30), np.inf, np.float32))
    return tmp_path


PLOT = ("plot", "--image", "a.png", "--distance")


@pytest.mark.parametrize(
    ("options", "waters"),
    [
        ([], "Medium(1C: "),
        (["--water", "7C"], "Medium(7C: "),
        (["--preset", "survey", "--water", "III"], "Medium(III: "),
        (["--preset", "tank-adjusted-1"], "Medium(coefficients: "),
    ],
)
def test_two_sheets_in_the_water_asked_for(run, files, options, waters):
    code, out, err = run(*PLOT, "a.npy", "--out", "drawn", *options)
    assert (code, err) == (0, "")
    names = sorted(path.name for path in (files / "drawn").iterdir())
    assert names == ["1-waters.jpg", "2-terms.jpg"]
    media = [line.strip() for line in out.splitlines() if line.startswith("    Medium(")]
    assert len(media) == 11
    assert media[-1].startswith(waters)
    for name in names:
        with Image.open(files / "drawn" / name) as sheet:
            assert sheet.width == 1400


def test_a_preset_shines_its_lamp(files):
    """The terms are those of the preset's own light, and not of daylight."""
    scene = own_scene(torch.rand(3, 20, 30), torch.full((1, 20, 30), 2.0))
    case = preset_case(uwaug.load_preset("jaffe-1990", water="7C"))
    lit, dark = (draw_terms(scene, one).figure for one in (case, case._replace(light=None)))
    assert "its own light" in case.setting
    drawn, other = (figure.axes[7].images[0].get_array() for figure in (lit, dark))
    assert np.abs(np.subtract(drawn, other, dtype=float)).max() > 0.05 * np.max(other)


def test_what_was_done_to_the_files_is_said(run, files):
    np.save("holes.npy", np.where(np.arange(600).reshape(20, 30) % 4, 2500, 0).astype(np.uint16))
    code, out, err = run(*PLOT, "holes.npy", "--distance-unit", "mm", "--out", "drawn")
    assert (code, err) == (0, "")
    assert out.splitlines()[-1] == "25 % of the distances were unknown and are filled."


@pytest.mark.parametrize(
    ("code", "arguments", "message"),
    [
        (1, "b.npy", "distance is (20, 31) but image is (20, 30): height and width must agree"),
        (1, "mm.npy", "try --distance-unit mm"),
        (1, "open.npy", "some pixel above 0 m that is not open water"),
        (1, "missing.npy", "No such file"),
        (1, "a.npy --preset missing.toml", "No such file"),
        (2, "a.npy --distance-unit ft", "--distance-unit must be one of m, cm, mm, um"),
        (2, "a.npy --water 10C", "10C"),
        (2, "a.npy --preset no", "no preset is called 'no'"),
        (2, "a.npy --preset tank-adjusted-1 --water II", "which no water or camera replaces"),
        (2, "a.npy --out .", ". holds other files, such as a.npy"),
    ],
)
def test_wrong_use_writes_nothing(run, files, code, arguments, message):
    before = sorted(path.name for path in files.iterdir())
    got, out, err = run(*PLOT, *arguments.split())
    assert (got, out) == (code, "")
    assert err.startswith("Error: ")
    assert message in err
    assert err.count("\n") == 1
    assert sorted(path.name for path in files.iterdir()) == before


def test_a_picture_is_not_written_over(run, files):
    Image.open("a.png").save("1-waters.jpg")
    before = Path("1-waters.jpg").read_bytes()
    arguments = ("--image", "1-waters.jpg", "--distance", "a.npy", "--out", ".", "--force")
    code, _, err = run("plot", *arguments)
    assert (code, err.startswith("Error: 1-waters.jpg is read, and would be")) == (2, True)
    assert Path("1-waters.jpg").read_bytes() == before
