"""What `uwaug degrade` says to files and wishes that it cannot serve, and that nothing is left."""

import os
import re
import resource
import shutil
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from filing import H, W, content, metres, pixels, save, save_pair, words
from PIL import Image

from uwaug.optics.water import JERLOV_TYPES

WATER = ("--water", "3C")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Where each test works: a good picture, and its distances."""
    monkeypatch.chdir(tmp_path)
    save_pair("good.png")
    return tmp_path


def degraded(run, *arguments: str, distance: str = "z.npy"):
    """Exit code, and what stands on standard error."""
    code, _, err = run("degrade", *arguments, "--distance", distance, "--out", "out", *WATER)
    assert "Traceback" not in err
    return code, err


def nothing_was_made() -> bool:
    """Besides the index, which says so."""
    return not Path("out").exists() or set(content("out")) <= {"index.csv", "index.parquet"}


def grey(path: str) -> None:
    save(path, pixels()[..., 0])


def inks(path: str) -> None:
    Image.fromarray(pixels()).convert("CMYK").save(path)


def loop(path: str) -> None:
    os.symlink(path, path)


def truncated(path: str) -> None:
    whole = save(path, pixels(200, 200)).read_bytes()
    Path(path).write_bytes(whole[: len(whole) // 2])


def swollen(path: str) -> None:
    """As one with a wrong size in its head, and the right sum of its bits."""
    whole = bytearray(save(path, pixels()).read_bytes())
    whole[16:24] = struct.pack(">II", 12000, 12000)
    whole[29:33] = struct.pack(">I", zlib.crc32(whole[12:29]))
    Path(path).write_bytes(whole)


def pipe(path: str) -> None:
    os.mkfifo(path)


PICTURES = {
    "empty": ("a.png", lambda path: Path(path).touch(), 1, "is empty"),
    "text": ("a.png", lambda path: Path(path).write_text("hello"), 1, "is no picture and no map"),
    "truncated PNG": ("a.png", truncated, 1, "truncated"),
    "truncated JPEG": ("a.jpg", truncated, 1, "truncated"),
    "truncated WebP": ("a.webp", truncated, 1, "a.webp"),
    "truncated .npy": ("a.npy", truncated, 1, "a.npy"),
    "truncated TIFF": ("a.tif", truncated, 1, "a.tif"),
    "CMYK": ("a.jpg", inks, 1, "got CMYK: save it as RGB"),
    "grey": ("a.png", grey, 1, "got grey: save it as RGB"),
    "not a number": (
        "a.npy",
        lambda path: save(path, np.full((H, W, 3), np.nan, np.float32)),
        1,
        "NaN at 576",
    ),
    "whole numbers of 32 bits": (
        "a.npy",
        lambda path: save(path, pixels().astype(np.int32)),
        1,
        "expected 8 or 16 bit",
    ),
    "0…255 as floats": (
        "a.npy",
        lambda path: save(path, pixels().astype(np.float32)),
        1,
        "divide a 0…255 image by 255",
    ),
    "no pixels": ("a.npy", lambda path: save(path, np.zeros((0, W, 3))), 1, "holds no pixels"),
    "a size that it cannot hold": ("a.png", swollen, 1, "12000 × 12000 px cannot be held in"),
    "unknown end": ("a.gif", lambda path: Image.fromarray(pixels()).save(path), 1, ".png, .jpg"),
    "missing": ("a.png", lambda _: None, 1, "No such file"),
    "empty folder": ("a.png", lambda path: Path(path).mkdir(), 2, "no pictures in a.png"),
    "link to itself": ("a.png", loop, 1, "symbolic links"),
    "pipe": ("a.png", pipe, 1, "no regular file"),
}


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_that_are_refused(run, name):
    path, make, expected, words = PICTURES[name]
    make(path)
    code, err = degraded(run, path)
    assert code == expected
    assert words in err
    assert path in err
    assert nothing_was_made()


def holed(value: float) -> np.ndarray:
    z = metres()
    z[:3] = value
    return z


MAPS = {
    "missing": (None, [], "z"),
    "NaN": (holed(np.nan), [], "NaN at 48"),
    "zero": (holed(0), [], "zero at 48"),
    "negative": (holed(-1), [], "negative at 48"),
    "none known": (np.zeros((H, W), np.float32), ["--unknown", "fill"], "at least one known pixel"),
    "colours": (pixels().astype(np.float32), [], "one channel, got colour"),
    "8 bits": (pixels()[..., 0], [], "expected 16 bit or floating point"),
    "millimetres": (metres() * 1000, [], "try --distance-unit mm"),
    "turned": (metres(W, H), [], "is 12×16 but the picture 16×12"),
    "cropped": (metres(H, W - 4), [], "of one view"),
    "text": ("hello", [], "is no picture and no map"),
    "empty": ("", [], "is empty"),
    "constant inverse": (
        np.ones((H, W), np.float32),
        ["--distance-kind", "inverse"],
        "constant",
    ),
    "relative beyond 1": (metres(), ["--distance-kind", "relative"], "must lie in [0, 1]"),
}


@pytest.mark.parametrize("name", MAPS)
def test_distances_that_are_refused(run, name):
    values, options, words = MAPS[name]
    Path("z.npy").unlink()
    if isinstance(values, str):
        Path("z.npy").write_text(values)
    elif values is not None:
        save("z.npy", values)
    code, err = degraded(run, "good.png", *options, distance="{stem}.npy" if not words else "z.npy")
    assert code == 1
    assert words in err
    assert "z.npy" in err
    assert nothing_was_made()


COMMANDS = {
    "no input": ([], "expected a picture"),
    "no water": (["good.png"], "expected one of water, preset, fit and random, got none"),
    "water and fit": (
        ["good.png", *WATER, "--fit", "f.json"],
        "one of water, preset, fit and random, got water and fit",
    ),
    "water and random": (["good.png", *WATER, "--random"], "got water and random"),
    "unknown preset": (["good.png", "--preset", "nowhere"], "survey"),
    "preset is missing": (["good.png", "--preset", "no.toml"], "no.toml"),
    "fit is missing": (["good.png", "--fit", "no.json"], "no.json"),
    "fit is none": (["good.png", "--fit", "good.png"], "good.png"),
    "severity and contrast": (
        ["good.png", *WATER, "--severity", "3", "--contrast", ".5"],
        "--severity and --contrast",
    ),
    "severity 6": (["good.png", *WATER, "--severity", "6"], "severity"),
    "contrast and visibility": (
        ["good.png", *WATER, "--contrast", ".5", "--visibility", "4"],
        "contrast",
    ),
    "no number": (["good.png", *WATER, "--visibility", "far"], "--visibility"),
    "negative": (["good.png", *WATER, "--visibility", "-2"], "visibility"),
    "unit": (["good.png", *WATER, "--distance-unit", "miles"], "--distance-unit must be"),
    "kind": (["good.png", *WATER, "--distance-kind", "far"], "--distance-kind"),
    "unknown": (["good.png", *WATER, "--unknown", "ignore"], "unknown must be"),
    "disparity without focal length": (
        ["good.png", *WATER, "--distance-kind", "disparity"],
        "--focal-px is missing",
    ),
    "planar without focal length": (["good.png", *WATER, "--planar"], "--focal-px is missing"),
    "planar relative": (
        ["good.png", *WATER, "--planar", "--distance-kind", "relative", "--focal-px", "9"],
        "--planar would do nothing",
    ),
    "baseline of metres": (["good.png", *WATER, "--baseline", ".1"], "--baseline would do nothing"),
    "offset of metres": (["good.png", *WATER, "--offset-px", "3"], "--offset-px would do nothing"),
    "unit of relative distances": (
        ["good.png", *WATER, "--distance-kind", "relative", "--distance-unit", "mm"],
        "--distance-unit would do nothing",
    ),
    "near of a fit of metres": (["good.png", *WATER, "--depth", "1:2:3"], "--vertical-depth"),
    "format": (["good.png", *WATER, "--format", "bmp"], ".png, .jpg"),
    "variants": (["good.png", *WATER, "--variants", "0"], "variants"),
    "workers": (["good.png", *WATER, "--workers", "0"], "--workers"),
    "network and distance": (
        ["good.png", *WATER, "--depth-network", "no.onnx"],
        "--depth-network takes the place of --distance",
    ),
    "record and pictures": (["good.png", "good.png", "--from", "a.json"], "all from the record"),
    "record and water": ([*WATER, "--from", "a.json"], "all from the record"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_that_are_refused(run, name):
    arguments, words = COMMANDS[name]
    before = content(".")
    code, out, err = run("degrade", *arguments, "--distance", "z.npy", "--out", "out")
    # 1 where a file is at fault
    at_fault = name in ("preset is missing", "fit is missing", "fit is none")
    assert (code, out) == (1 if at_fault else 2, "")
    assert words in err
    assert content(".") == before


def test_an_unknown_water_lists_the_ten(run):
    code, out, err = run("degrade", "good.png", "--distance", "3", "--out", "out", "--water", "4C")
    assert (code, out) == (2, "")
    assert "water must be one of" in err
    assert "got '4C'" in err
    assert all(water in err for water in JERLOV_TYPES)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("colour = 3", "unknown key colour; there are waters"),
        ("unknown = 'fill'", "unknown key unknown"),
        ("waters = ", "is no TOML"),
        ("waters = '12C'", "12C"),
        ("point_spread = { width = 2 }", "unexpected keyword argument 'width'"),
        ("point_spread = { exponent = 2 }", "missing 1 required positional argument: 'scale'"),
        ("point_spread = 3", "point_spread must be a uwaug.PointSpread"),
    ],
)
def test_options_that_are_refused(run, text, words):
    Path("o.toml").write_text(text)
    code, _, err = run(
        "degrade", "good.png", "--distance", "3", "--out", "out", "--random", "--options", "o.toml"
    )
    assert code == (1 if err.startswith("Error: o.toml: ") else 2)
    assert words in err


@pytest.mark.parametrize("distance", ["nan", "inf", "-1", "0"])
def test_metres_that_are_none(run, distance):
    code, err = degraded(run, "good.png", distance=distance)
    assert code == 2
    assert "distance must be" in err


def test_a_pattern_with_other_words(run):
    code, err = degraded(run, "good.png", distance="{nmae}.npy")
    assert (code, "{stem} or {name}, got '{nmae}.npy'" in err) == (2, True)


def test_of_a_folder_of_maps_none_or_two_fit(run):
    save("all/a.png", pixels())
    save("all/b.png", pixels())
    save("maps/a.npy", metres())
    save("maps/a.tif", metres())
    code, err = degraded(run, "all", distance="maps")
    assert code == 1
    assert "2 of 2 pictures failed" in err
    assert "found maps/a.npy, maps/a.tif" in err
    assert "found none" in err
    assert nothing_was_made()


def test_one_bad_picture_does_not_stop_the_rest(run):
    for name in "abc":
        save(f"all/{name}.png", pixels())
    Path("all/b.png").write_bytes(b"")
    code, err = degraded(run, "all")
    assert code == 1
    assert "1 of 3 pictures failed:\n  all/b.png" in err
    pictures = {name for name in content("out") if name.endswith(".png")}
    assert pictures == {"a.png", "c.png"}
    lines = Path("out/index.csv").read_text().splitlines()
    assert [line.split(",")[9] for line in lines] == ["status", "done", "failed", "done"]


# Two of one name, and what is there


def test_two_pictures_with_one_output(run):
    save("one/a.png", pixels())
    save("two/a.png", pixels())
    code, err = degraded(run, "one/a.png", "two/a.png")
    assert code == 2
    assert "one/a.png and two/a.png have one" in err
    save("one/A.jpg", pixels())
    code, err = degraded(run, "one", "--format", "png")
    assert (code, "have one output" in err) == (2, True)
    assert "give a manifest with a column output" in err


def test_the_same_picture_twice(run):
    code, err = degraded(run, "good.png", "good.png")
    assert (code, "good.png was given twice" in err) == (2, True)


def test_terms_that_would_be_written_over_another_picture(run):
    save("all/a.png", pixels())
    save("all/a_direct.png", pixels(seed=1))
    code, err = degraded(run, "all", "--keep-terms", "--force")
    assert code == 2
    assert "a_direct.png" in err


def test_a_sheet_that_would_be_written_over_a_picture(run):
    save("all/sheet.jpg", pixels())
    code, err = degraded(run, "all", "--sheet", "--force")
    assert (code, "all/sheet.jpg would be written to out/sheet.jpg" in err) == (2, True)
    save("out/sheet.jpg", pixels())
    code, err = degraded(run, "good.png", "--sheet")
    assert (code, "out/sheet.jpg exists: --force" in err) == (2, True)


def test_pictures_are_not_written_over_themselves(run):
    save("all/a.png", pixels())
    before = content(".")
    arguments = ("--distance", "3", "--out", "all", *WATER, "--force")
    code, _, err = run("degrade", "all", *arguments)
    assert (code, "folder of its own" in err) == (2, True)
    os.symlink("all", "same")
    code, _, err = run("degrade", "same", *arguments)
    assert (code, "folder of its own" in err) == (2, True)
    code, _, err = run("degrade", "all", *arguments, "--format", "jpg")
    assert (code, "folder of its own" in err) == (2, True)
    Path("same").unlink()
    assert content(".") == before


def test_nothing_is_written_over(run):
    save("out/good.png", pixels(seed=1))
    before = content("out")
    code, err = degraded(run, "good.png")
    assert (code, "out/good.png exists: --resume" in err) == (2, True)
    # what is there is none of a run's
    code, err = degraded(run, "good.png", "--resume")
    assert (code, "out/good.png exists" in err) == (1, True)
    assert content("out").items() >= before.items()
    Path("out/good.png").rename("out/good.png.json")
    code, err = degraded(run, "good.png")
    assert (code, "is no record of uwaug" in err) == (1, True)
    assert degraded(run, "good.png", "--force")[0] == 0


def test_an_index_that_is_no_index_stays(run):
    Path("out").mkdir()
    Path("out/index.csv").write_text("mine,alone\n")
    code, err = degraded(run, "good.png")
    assert (code, "out/index.csv is no index of uwaug" in err) == (1, True)
    assert content("out") == {"index.csv": b"mine,alone\n"}


# Lists


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("picture,id\ngood.png,1\n", "expected a column input, got picture, id"),
        ("", "expected a column input, got none"),
        ("input,id\n,1\n", "line 2 has no input"),
        ("input,output\ngood.png,../a.png\n", "output must lie in the folder of the run"),
        ("input,output\ngood.png,/a.png\n", "output must lie in the folder of the run"),
        ("input,distance\ngood.png,-2\n", "distance must be"),
        ("input,id\ngood.png,x\ngood2.png,x\n", "have one id"),
        ("input,output\ngood.png,a.png\ngood2.png,a.png\n", "have one output"),
        ("input\ngood\x00.png\n", "list.csv"),
    ],
)
def test_lists_that_are_refused(run, text, words):
    Path("list.csv").write_text(text)
    save("good2.png", pixels())
    code, err = degraded(run, "list.csv")
    assert code == (1 if err.startswith("Error: list.csv: ") else 2)
    assert words in err
    assert nothing_was_made()


def test_a_list_of_missing_pictures_tells_each(run):
    Path("list.csv").write_text("input\nnowhere.png\ngood.png\n")
    code, err = degraded(run, "list.csv")
    assert code == 1
    assert "1 of 2 pictures failed" in err
    assert "nowhere.png" in err


@pytest.mark.parametrize("text", [b"", b"PAR1 and no more", b"PAR1" + bytes(64) + b"PAR1"])
def test_broken_parquet(run, text):
    Path("list.parquet").write_bytes(text)
    code, err = degraded(run, "list.parquet")
    assert (code, "list.parquet: is no Parquet file" in err) == (1, True)


def test_parquet_without_input(run):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    pq.write_table(pa.table({"picture": ["good.png"]}), "list.parquet")
    code, err = degraded(run, "list.parquet")
    assert (code, "expected a column input, got picture" in err) == (1, True)


# Where nothing can be written


def test_out_is_a_file(run):
    Path("out").write_text("")
    code, err = degraded(run, "good.png")
    assert code == 1
    assert "out" in err
    assert Path("out").is_file()


def _fails(command: list[str]) -> bool:
    return subprocess.run(command, capture_output=True, check=False).returncode != 0


@pytest.fixture
def mounted(folder):
    """Mount a file system at `out`; skip where that is not permitted."""

    def mount(*arguments: str) -> None:
        Path("out").mkdir()
        command = ["mount", *arguments, str(folder / "out")]
        if shutil.which("mount") is None or _fails(command):
            pytest.skip("mounting is not permitted")

    yield mount
    subprocess.run(["umount", str(folder / "out")], capture_output=True, check=False)


def test_out_is_read_only(run, mounted):
    mounted("-t", "tmpfs", "-o", "ro,size=1m", "tmpfs")
    code, err = degraded(run, "good.png")
    assert code == 1
    assert "cannot write to the folder" in err
    assert "Read-only file system" in err


def test_the_disk_is_full(run, mounted):
    mounted("-t", "tmpfs", "-o", "size=64k", "tmpfs")
    for name in "ab":
        save(f"all/{name}.png", pixels(500, 500))
    save("all/c.png", pixels())
    code, err = degraded(run, "all", "--workers", "1", distance="3")
    assert code == 1
    assert "No space left on device" in err
    assert "2 of 3 pictures failed" in err
    assert {name for name in content("out") if "csv" not in name and "parquet" not in name} == {
        "c.png",
        "c.png.json",
    }


def test_files_may_not_be_so_large(run):
    """The same where no file system can be mounted."""
    save("good.png", pixels(120, 160))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        code, err = degraded(run, "good.png", distance="3")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert code == 1
    assert "File too large" in err
    assert "good.png" in err
    assert nothing_was_made()


def test_a_note_of_a_median_beyond_200_m(run):
    save("z.npy", metres() * 100)
    code, out, _ = run("degrade", "good.png", "--distance", "z.npy", "--out", "out", *WATER)
    assert code == 0
    assert re.search(r"median distance 2[45]\d m: is the unit of the file mm\?", out)


def test_words_of_16_bits_are_no_metres(run):
    save("z.png", words()[..., 0])
    code, err = degraded(run, "good.png", distance="z.png")
    assert (code, "try --distance-unit mm" in err) == (1, True)
