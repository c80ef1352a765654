"""`uwaug demo`, `uwaug plot` and `uwaug compare`."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import uwaug
from uwaug.figures.demo import PICTURES, draw_terms, preset_case
from uwaug.presets.files import bundled_preset
from uwaug.presets.scene import own_scene


@pytest.fixture
def files(tmp_path, monkeypatch) -> Path:
    """A picture of 30×20 px and its distances, in the folder where the command runs."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)).save("a.png")
    np.save("a.npy", np.linspace(1, 4, 600, dtype=np.float32).reshape(20, 30))
    return tmp_path


PLOT = ("plot", "--image", "a.png", "--distance")


def test_demo_on_the_real_scene(run, tmp_path):
    out = tmp_path / "new" / "folder"
    code, stdout, stderr = run("demo", "--out", str(out))
    assert (code, stderr) == (0, "")
    assert sorted(path.name for path in out.iterdir()) == list(PICTURES)
    lines = stdout.splitlines()
    timed = [line for line in lines if re.match(r".* \(\d+\.\d s\)$", line)]
    assert [line.split()[0] for line in timed] == [str(out / name) for name in PICTURES]
    assert sum(line.startswith("    Medium(") for line in lines) == 10 + 1 + 2
    assert "g = 0.05, μ = 0.075" in stdout
    assert re.fullmatch(rf"5 pictures in {re.escape(str(out))}, \d+\.\d s", lines[-1])
    for path in out.iterdir():
        with Image.open(path) as picture:
            assert picture.format == {".jpg": "JPEG", ".png": "PNG"}[path.suffix]
            assert picture.width == 1400
    assert sum(path.stat().st_size for path in out.iterdir()) < 1.2e6


def test_demo_draws_over_its_own_files_only(run, small, tmp_path):
    (tmp_path / "2-terms.jpg").write_text("old")
    # what a demo left that was killed
    (tmp_path / f".uwaug-{'0a' * 8}.part").write_text("half")
    assert run("demo", "--out", str(tmp_path))[0] == 0
    assert (tmp_path / "2-terms.jpg").stat().st_size > 1000
    (tmp_path / "thesis.tex").write_text("mine")
    code, out, err = run("demo", "--out", str(tmp_path))
    assert (code, out) == (2, "")
    assert err.startswith(f"Error: {tmp_path} holds other files, such as thesis.tex: ")
    assert run("demo", "--out", str(tmp_path), "--force")[0] == 0
    assert (tmp_path / "thesis.tex").read_text() == "mine"


@pytest.mark.parametrize(
    ("options", "medium"),
    [
        ([], "Medium(1C: "),
        (["--preset", "survey", "--water", "iii"], "Medium(III: "),
        (["--preset", "tank-adjusted-1"], "Medium(coefficients: "),
    ],
)
def test_two_sheets_in_the_water_asked_for(run, files, options, medium):
    code, out, err = run(*PLOT, "a.npy", "--out", "drawn", *options)
    assert (code, err) == (0, "")
    names = sorted(path.name for path in (files / "drawn").iterdir())
    assert names == ["1-waters.jpg", "2-terms.jpg"]
    media = [line.strip() for line in out.splitlines() if line.startswith("    Medium(")]
    assert len(media) == 11
    assert media[-1].startswith(medium)
    for name in names:
        with Image.open(files / "drawn" / name) as sheet:
            assert sheet.width == 1400


def test_a_preset_shines_its_lamp():
    """The terms are those of the preset's own light, and not of daylight."""
    scene = own_scene(torch.rand(3, 20, 30), torch.full((1, 20, 30), 2.0))
    case = preset_case(uwaug.load_preset("jaffe-1990", water="7C"))
    daylight = case._replace(setup=replace(case.setup, light=None))
    by_lamp, by_day = (draw_terms(scene, c).figure for c in (case, daylight))
    assert "its own light" in case.setting
    drawn, other = (figure.axes[7].images[0].get_array() for figure in (by_lamp, by_day))
    assert np.abs(np.subtract(drawn, other, dtype=float)).max() > 0.05 * np.max(other)


def test_a_preset_whose_surfaces_have_spectra(files):
    """The curves are those of a white surface."""
    text = bundled_preset("calibrated").read_text()
    Path("mine.toml").write_text(text.replace("[medium]\n", '[medium]\nsurfaces = "spectral"\n'))
    scene = own_scene(torch.rand(3, 20, 30), torch.full((1, 20, 30), 2.0))
    presets = [uwaug.load_preset(name) for name in ("mine.toml", "calibrated")]
    spectral, grey = (draw_terms(scene, preset_case(preset)).figure for preset in presets)
    assert "spectra" in preset_case(presets[0]).setting
    for line, of_grey in zip(spectral.axes[3].lines, grey.axes[3].lines, strict=True):
        np.testing.assert_allclose(line.get_ydata(), of_grey.get_ydata(), atol=0.15)


def test_what_was_done_to_the_files_is_said(run, files):
    np.save("holes.npy", np.where(np.arange(600).reshape(20, 30) % 4, 2500, 0).astype(np.uint16))
    code, out, err = run(*PLOT, "holes.npy", "--distance-unit", "mm", "--out", "drawn")
    assert (code, err) == (0, "")
    assert out.splitlines()[-1] == "25 % of the distances were unknown and are filled."


def test_a_picture_is_not_written_over(run, files):
    Image.open("a.png").save("1-waters.jpg")
    before = Path("1-waters.jpg").read_bytes()
    arguments = ("--image", "1-waters.jpg", "--distance", "a.npy", "--out", ".", "--force")
    code, _, err = run("plot", *arguments)
    assert (code, err.startswith("Error: 1-waters.jpg is read, and would be")) == (2, True)
    assert Path("1-waters.jpg").read_bytes() == before


def test_a_comparison_with_its_table(run, files):
    pytest.importorskip("phasecongruency")
    systems = ("--system", "ismiroglou-2025", "--system", "jaffe-1990")
    arguments = ("--image", "a.png", "--distance", "a.npy", "--water", "7c", *systems)
    arguments += ("--out", "s.jpg", "--table", "s.csv")
    code, out, err = run("compare", *arguments)
    assert (code, err) == (0, "")
    assert out.splitlines()[1].startswith("ismiroglou-2025")
    assert "s.csv" in out.splitlines()[-1]
    with Image.open("s.jpg") as sheet:
        assert sheet.width == 1400
    assert len(Path("s.csv").read_text().splitlines()) == 3
    assert run("compare", *arguments)[0] == 2
    assert run("compare", *arguments, "--force")[::2] == (0, "")
