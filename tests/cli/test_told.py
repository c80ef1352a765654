"""What `uwaug degrade` says of pictures that will disappoint, and of maps before it begins."""

import csv
import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from filing import H, W, content, metres, pixels, save

WATER = ("--water", "3C")
ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Five pictures with maps of a room in mm, as depth cameras write them."""
    monkeypatch.chdir(tmp_path)
    for number in range(5):
        save(f"photos/{number}.png", pixels(seed=number))
        save(f"depth/{number}.png", room(1000 + number))
    return tmp_path


def room(scale: float) -> np.ndarray:
    """HxW, uint16: 1 to 4 m, in numbers of which `scale` are 1 m."""
    return (metres() * scale).astype(np.uint16)


@pytest.mark.parametrize("unknown", [False, True])
def test_what_maps_hold_is_asked_for_at_once(run, unknown):
    if unknown:
        for number in range(1, 5):
            map = room(1000)
            map[0] = 0
            save(f"depth/{number}.png", map)
    given = ("photos", "--distance", "depth", "--random", "--variants", "3", "--out", "out")
    code, out, err = run("degrade", *given)
    assert (code, out) == (1, "")
    assert "depth/0.png and 4 more: the median is 2" in err
    assert "farther than one sees: try --distance-unit mm" in err
    assert ("depth/1.png and 3 more: unknown (0 or NaN) at up to 8.33 %" in err) == unknown
    assert ("--unknown behind suits" in err) == unknown
    # so that the cure needs no --force
    assert not Path("out").exists()
    cured = ("--distance-unit", "mm", *(["--unknown", "fill"] if unknown else []))
    assert run("degrade", *given, *cured)[0] == 0


def test_what_a_failure_says_would_help_helps(run):
    """A picture of a map without unknown pixels is the same whatever these get."""
    for number in (1, 3):
        map = room(1000)
        map[0] = 0
        save(f"depth/{number}.png", map)
    given = ("photos", "--distance", "depth", "--distance-unit", "mm", *WATER, "--out", "out")
    code, _, err = run("degrade", *given)
    assert (code, "2 of 5 pictures failed" in err, "--unknown fill" in err) == (1, True, True)
    before = content("out")
    code, out, _ = run("degrade", *given, "--resume", "--unknown", "fill")
    assert (code, "2 of 5 pictures, 3 were there" in out) == (0, True)
    after = content("out")
    assert {name: after[name] for name in before if name != "index.csv"}.items() <= before.items()
    code, out, _ = run("degrade", *given[:-1], "whole", "--unknown", "fill")
    pictures = {name: data for name, data in content("whole").items() if name.endswith(".png")}
    assert pictures == {name: data for name, data in after.items() if name.endswith(".png")}
    # those with filled pixels would not be the same
    code, _, err = run("degrade", *given, "--resume", "--unknown", "far")
    assert (code, err.count("--unknown far, was fill")) == (1, 1)
    assert "2 of 5 pictures failed" in err
    # what is cured by skipping leaves filled pictures as they are
    code, out, _ = run("degrade", *given, "--resume", "--unknown", "skip")
    assert (code, "0 of 5 pictures, 5 were there" in out) == (0, True)
    code, out, _ = run("degrade", *given[:-1], "skipped", "--unknown", "skip")
    assert pictures.items() <= content("skipped").items()


def test_one_bad_map_of_many_fails_alone(run):
    given = ("photos", "--distance", "depth", "--distance-unit", "cm", *WATER, "--out", "out")
    for number in (0, 1, 2, 4):
        save(f"depth/{number}.png", room(100))
    save("depth/3.png", np.full((H, W), 0, np.uint16))
    code, out, err = run("degrade", *given)
    assert (code, "4 of 5 pictures" in out, "1 of 5 pictures failed" in err) == (1, True, True)


def test_equal_reasons_and_notes_are_one_line(run):
    for number in range(5):
        save(f"depth/{number}.png", np.full((H, W, 3), 7, np.uint8))
    drawn = (*WATER, "--visibility", "3:5", "--variants", "3")
    code, _, err = run("degrade", "photos", "--distance", "depth", *drawn, "--out", "out")
    assert code == 1
    (line,) = err.splitlines()[1:]
    assert line.startswith("  15 × expected distances in one channel, got ")
    assert line.endswith("(first: depth/0.png)")


@pytest.mark.parametrize(
    ("near", "far", "part"),
    [(20.0, 40.0, "half"), (1.0, 4.0, "a fifth"), (0.2, 1.0, None)],
)
def test_a_blank_picture_is_told_of(run, near, far, part):
    save("z.npy", np.linspace(near, far, H * W, dtype=np.float32).reshape(H, W))
    code, out, _ = run("degrade", "photos", "--distance", "z.npy", *WATER, "--out", "out")
    assert code == 0
    notes = json.loads(Path("out/0.png.json").read_text())["notes"]
    with open("out/index.csv", newline="") as file:
        lines = [line["notes"] for line in csv.DictReader(file)]
    if part is None:
        assert (notes, lines, "Note" in out) == ([], [""] * 5, False)
        return
    words = f"less than 3 % of the contrast is left on {part} of the picture or more: "
    unit = "--distance-unit mm, or " if near > 8 else ""
    assert [note.startswith(words) for note in notes] == [True]
    assert lines == notes * 5
    assert f"Note: 5 × {words}{unit}clearer water, such as --visibility 10" in out


def test_the_cure_of_a_blank_picture_is_for_what_was_given(run):
    given = ("degrade", "photos/0.png", "--distance")
    run(*given, "40", *WATER, "--out", "out")
    out = run(*given, "40", *WATER, "--out", "metres")[1]
    assert ": clearer water, such as --visibility 10 or --contrast 0.3?" in out
    drawn = ("--random", "--visibility", "2", "--variants", "2", "--out", "drawn")
    out = run(*given, "40", *drawn)[1]
    assert ": other draws, such as --contrast 0.3:0.8?" in out
    assert "(first: 0.png)" not in out  # but which of the two
    assert "(first: 0_0.png)" in out or "(first: 0_1.png)" in out


def test_open_water_is_no_disappointment(run):
    map = np.full((H, W), 1.0, np.float32)
    map[: H // 2] = np.inf
    save("z.npy", map)
    _, out, _ = run("degrade", "photos", "--distance", "z.npy", *WATER, "--out", "out")
    assert "Note" not in out


def test_commands_of_the_readme_show_something(run, monkeypatch):
    """On maps in mm, with holes, as they are printed."""
    monkeypatch.setattr("uwaug.cli.console._PAUSE", 1e9)  # how long it takes is another matter
    map = room(1000)
    map[0, :3] = 0
    save("photo.jpg", pixels())
    save("depth.png", map)
    for number in range(5):
        save(f"depth/{number}.png", map)
    text = (ROOT / "README.md").read_text()
    commands = [line for line in text.splitlines() if line.startswith("uwaug degrade ")]
    assert len(commands) == 3
    for command in commands:
        code, _, err = run(*shlex.split(command)[1:])
        assert (code, err) == (0, ""), command
    record = json.loads(Path("under.jpg.json").read_text())
    assert record["contrast"] > 0.3
    assert record["notes"] == []
    assert len([name for name in content("underwater") if name.endswith(".png")]) == 15


def test_commands_of_the_guide_show_something(run):
    save("photo.jpg", pixels())
    Path("own.csv").write_text("400,0.5,1.3,0.7\n550,0.2,1.1,0.3\n700,0.7,1.0,0.8\n")
    text = (ROOT / "uwaug/cli/README.md").read_text()
    lines = [line.partition("  #")[0] for line in text.splitlines()]
    commands = [line for line in lines if line.startswith("uwaug degrade photo.jpg --distance 3")]
    assert len(commands) == 4
    for command in commands:
        code, out, err = run(*shlex.split(command)[1:])
        assert (code, err) == (0, ""), command
        assert "less than" not in out, command


def test_a_sheet_shows_what_there_is(run):
    """Although all that it would have shown has failed."""
    pytest.importorskip("matplotlib")
    for number in range(12):
        save(f"many/{number:02}.png", pixels())
        if number not in (5, 10):
            Path(f"many/{number:02}.png").write_bytes(b"")
    given = ("--distance", "1", *WATER, "--workers", "1", "--out", "out", "--sheet")
    code, out, _ = run("degrade", "many", *given)
    assert (code, "2 of 12 pictures" in out) == (1, True)
    assert Path("out/sheet.jpg").exists()


def test_variants_that_would_be_alike(run):
    given = ("degrade", "photos", "--distance", "3", "--variants", "2", "--out", "out")
    for water in (("--water", "3C"), ("--preset", "mcglamery-1980")):
        code, _, err = run(*given, *water)
        words = "--variants 2 would be the same picture each time: nothing is drawn: give a range"
        assert (code, f"{words}, such as --visibility 3:10" in err) == (2, True)
    assert run(*given, "--water", "3C", "--vertical-depth", "0:15")[0] == 0


def test_where_two_pictures_cannot_go(run):
    save("one.png", pixels())
    given = ("--distance", "3", *WATER, "--out", "two.png")
    for inputs in (["one.png", "--variants", "2"], ["one.png", "photos/1.png"]):
        code, _, err = run("degrade", *inputs, *given)
        assert (code, ", or a folder, got 2 pictures: make" in err) == (2, True)


def test_which_water_is_asked_for(run):
    given = ("degrade", "photos", "--distance", "3", "--out", "out")
    code, _, err = run(*given)
    expected = "expected --water, --preset, --fit or --random, got none of them"
    assert (code, err) == (2, f"Error: {expected}\n")
    code, _, err = run(*given, "--visibility", "5")
    cure = ": --visibility names no water: add --random, or one such as --water 3C"
    assert (code, err) == (2, f"Error: {expected}{cure}\n")
