"""`uwaug demo`, `uwaug plot` and `uwaug compare`."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import uwaug
from uwaug.distance import along_ray, from_disparity, from_inverse, from_relative
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


PLOT = ("plot", "a.png", "--distance")


def test_demo_on_the_real_scene(run, tmp_path):
    out = tmp_path / "new" / "folder"
    code, stdout, stderr = run("demo", "--out", str(out))
    assert (code, stderr) == (0, "")
    assert sorted(path.name for path in out.iterdir()) == list(PICTURES)
    lines = stdout.splitlines()
    named = [re.sub(r"  \(\d+ KiB\)$", "", line) for line in lines[:-1]]
    assert named == [str(out / name) for name in PICTURES]
    assert re.fullmatch(r"5 pictures, \d+\.\d s", lines[-1])
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
    ("options", "heading"),
    [
        ([], "Jerlov 1C"),
        (["--water", "7c"], "Jerlov 7C"),
        (["--preset", "survey", "--water", "iii"], "preset survey, III"),
        (["--preset", "tank-adjusted-1"], "preset tank-adjusted-1"),
    ],
)
def test_two_sheets_in_the_water_asked_for(run, files, options, heading, monkeypatch):
    from uwaug.figures import demo

    headings = []

    def noted(*args, **kwargs):
        headings.append(args[3])
        return drawn(*args, **kwargs)

    drawn = demo.sheet
    monkeypatch.setattr(demo, "sheet", noted)
    code, out, err = run(*PLOT, "a.npy", "--out", "drawn", *options)
    assert (code, err) == (0, "")
    names = sorted(path.name for path in (files / "drawn").iterdir())
    assert names == ["1-waters.jpg", "2-terms.jpg"]
    assert headings == ["One scene in ten waters", f"The terms of the image, {heading}"]
    assert [line.partition("  ")[0] for line in out.splitlines()[:-1]] == [
        str(Path("drawn") / name) for name in names
    ]
    for name in names:
        with Image.open(files / "drawn" / name) as sheet:
            assert sheet.width == 1400


def test_a_preset_shines_its_lamp():
    """The terms are those of the preset's own light, and not of daylight."""
    scene = own_scene(torch.rand(3, 20, 30), torch.full((1, 20, 30), 2.0))
    case = preset_case(uwaug.load_preset("jaffe-1990", water="7C"))
    daylight = case._replace(setup=replace(case.setup, light=None))
    by_lamp, by_day = (draw_terms(scene, c) for c in (case, daylight))
    assert "its own light" in case.setting
    drawn, other = (figure.axes[7].images[0].get_array() for figure in (by_lamp, by_day))
    assert np.abs(np.subtract(drawn, other, dtype=float)).max() > 0.05 * np.max(other)


def test_a_preset_whose_surfaces_have_spectra(files):
    """The curves are those of a white surface."""
    text = bundled_preset("calibrated").read_text()
    Path("mine.toml").write_text(text.replace("[medium]\n", '[medium]\nsurfaces = "spectral"\n'))
    scene = own_scene(torch.rand(3, 20, 30), torch.full((1, 20, 30), 2.0))
    presets = [uwaug.load_preset(name) for name in ("mine.toml", "calibrated")]
    spectral, grey = (draw_terms(scene, preset_case(preset)) for preset in presets)
    assert "spectra" in preset_case(presets[0]).setting
    for line, of_grey in zip(spectral.axes[3].lines, grey.axes[3].lines, strict=True):
        np.testing.assert_allclose(line.get_ydata(), of_grey.get_ydata(), atol=0.15)


def test_what_was_done_to_the_files_is_said(run, files):
    np.save("holes.npy", np.where(np.arange(600).reshape(20, 30) % 4, 2500, 0).astype(np.uint16))
    code, out, err = run(*PLOT, "holes.npy", "--distance-unit", "mm", "--out", "drawn")
    assert (code, err) == (0, "")
    assert (
        out.splitlines()[-1]
        == "25 % of the distances were unknown and are filled with what is behind."
    )


@pytest.fixture
def drawn_scene(monkeypatch):
    """What `uwaug plot` would draw: only the scene is looked at, and nothing drawn."""
    from uwaug.cli import figures

    scenes = []
    monkeypatch.setattr(figures, "_draw_into", lambda out, scene, pictures: scenes.append(scene))
    return scenes


@pytest.mark.parametrize(
    ("distance", "flags", "expected"),
    [
        ("3", (), lambda z: torch.full_like(z, 3.0)),
        ("0.5", ("--focal-px", "40"), lambda z: torch.full_like(z, 0.5)),
        ("a.npy", ("--distance-unit", "0.5"), lambda z: z / 2),
        ("a.npy", ("--planar", "--focal-px", "40"), lambda z: along_ray(z, 40.0)),
        (
            "a.npy",
            ("--distance-kind", "inverse", "--near", "1", "--far", "8"),
            lambda z: from_inverse(z, 1.0, 8.0),
        ),
        (
            "share.npy",
            ("--distance-kind", "relative", "--near", "1", "--far", "8", "--gamma", "2"),
            lambda z: from_relative((z - 1) / 3, 1.0, 8.0, 2.0),
        ),
        (
            "a.npy",
            ("--distance-kind", "disparity", "--focal-px", "40", "--baseline", "0.1"),
            lambda z: along_ray(from_disparity(z, 40.0, 0.1), 40.0),
        ),
        ("holes.npy", ("--unknown", "7"), lambda z: torch.where(z > 2, z, 7.0)),
        ("holes.npy", ("--unknown", "far"), lambda z: torch.where(z > 2, z, torch.inf)),
    ],
)
def test_distances_as_degrade_reads_them(run, files, drawn_scene, distance, flags, expected):
    z = torch.from_numpy(np.load("a.npy"))[None]
    np.save("share.npy", ((z - 1) / 3)[0].numpy())
    np.save("holes.npy", torch.where(z > 2, z, 0.0)[0].numpy())
    code, _, err = run(*PLOT, distance, *flags)
    assert (code, err) == (0, "")
    (scene,) = drawn_scene
    torch.testing.assert_close(scene.distance, expected(z), rtol=1e-5, atol=1e-5)


def test_unknown_distances_may_be_refused(run, files, drawn_scene):
    np.save("holes.npy", np.pad(np.full((20, 29), 2.5, np.float32), ((0, 0), (0, 1))))
    code, _, err = run(*PLOT, "holes.npy", "--unknown", "error")
    assert (code, drawn_scene) == (1, [])
    assert err.startswith("Error: holes.npy: distance must be above 0 m")
    assert "use --unknown fill" in err


def test_a_map_of_another_size_is_resampled_and_said_so(run, files, drawn_scene):
    np.save("half.npy", np.load("a.npy")[::2, ::2])
    code, out, _ = run(*PLOT, "half.npy")
    assert code == 0
    assert "Note: half.npy: distances of 15×10 px, resampled to 30×20" in out
    assert drawn_scene[0].distance.shape == (1, 20, 30)


def test_the_older_spelling_of_a_picture(run, files, drawn_scene):
    assert run("plot", "--image", "a.png", "--distance", "a.npy")[::2] == (0, "")
    assert run(*PLOT, "a.npy")[::2] == (0, "")
    assert torch.equal(drawn_scene[0].image, drawn_scene[1].image)


def test_a_picture_is_not_written_over(run, files):
    Image.open("a.png").save("1-waters.jpg")
    before = Path("1-waters.jpg").read_bytes()
    arguments = ("1-waters.jpg", "--distance", "a.npy", "--out", ".", "--force")
    code, _, err = run("plot", *arguments)
    assert (code, err.startswith("Error: 1-waters.jpg is read, and would be")) == (2, True)
    assert Path("1-waters.jpg").read_bytes() == before


def test_a_comparison_says_how_much_was_filled(run, files, monkeypatch):
    pytest.importorskip("phasecongruency")
    from uwaug.figures import comparison

    captions = []
    sheet = comparison.paper.sheet

    def captioned(*args, **kwargs):
        captions.append(args[4])
        return sheet(*args, **kwargs)

    monkeypatch.setattr(comparison.paper, "sheet", captioned)
    np.save("b.npy", np.where(np.arange(600).reshape(20, 30) % 4, 2.5, 0).astype(np.float32))
    arguments = ("--system", "jaffe-1990", "--out", "s.png")
    assert run("compare", "a.png", "--distance", "b.npy", *arguments)[0] == 0
    assert captions[0].partition("\n")[2].startswith("25 % of the distances were unknown")


def test_a_comparison_with_its_table(run, files):
    pytest.importorskip("phasecongruency")
    systems = ("--system", "ismiroglou-2025", "--system", "jaffe-1990")
    arguments = ("a.png", "--distance", "a.npy", "--water", "7c", *systems)
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
