"""Which files of a folder are pictures, and where their maps are."""

import os
import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from uwaug.files import find_items
from uwaug.files.items import delay_of, left_out


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def touch(names: str) -> None:
    for name in names.split():
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).touch()


def names(pictures: str, maps: str | None = None, exclude: Sequence[str] = ()) -> dict[str, str]:
    """The map of each picture, "" for none."""
    items = find_items(pictures, maps, exclude=exclude)
    return {item.name: item.distance.as_posix() if item.distance else "" for item in items}


NFC, NFD = (unicodedata.normalize(form, "épave") for form in ("NFC", "NFD"))
OWN = {"b_RGB.png": "d/b_RGB", "rgb.png": "d/depth.png"}
INDEPTH = {"indepth/1.png": "d/indepth/1", "indepth/rgb.png": "d/indepth/depth.png"}
Z, SWAP = "{stem}_z.png", "{stem:rgb=depth}.png"
FOUND: list[tuple[str, str, str | None, dict[str, str]]] = [
    # files, pictures, maps, and what is found
    ("d/1.png d/notes.txt", "d", None, {"1.png": ""}),
    ("d/1.png m/2.tif", "d/1.png", "m/2.tif", {"1.png": "m/2.tif"}),
    ("d/2.PNG d/z.png", "d", "d/z.png", {"2.PNG": "d/z.png"}),
    ("d/2.PNG d/2_z.png", "d", Z, {"2.PNG": "d/2_z.png"}),
    ("d/a.png d/b.png m/a.npy", "d", "m", {"a.png": "m/a.npy", "b.png": "m/b"}),  # is missing
    ("d/r/2.png d/m/r/2.png", "d", "d/m", {"r/2.png": "d/m/r/2.png"}),
    ("d/images/a/1.jpg d/z/a/1.png", "d", "d/z", {"images/a/1.jpg": "d/z/a/1.png"}),
    ("d/images/a/0.png d/z/a/0_z.png", "d", f"d/z/{Z}", {"images/a/0.png": "d/z/a/0_z.png"}),
    ("d/r/b.jpg m/r/b_z.png", "d", f"m/{Z}", {"r/b.jpg": "m/r/b_z.png"}),
    ("d/r/b.jpg m/r/b_z.png", "d", "m/{stem}_z", {"r/b.jpg": "m/r/b_z.png"}),
    ("d/rgb_0.jpg m/depth_0.png", "d", f"m/{SWAP}", {"rgb_0.jpg": "m/depth_0.png"}),
    ("d/s/rgb/0.png d/s/depth/0.png", "d", f"d/{SWAP}", {"s/rgb/0.png": "d/s/depth/0.png"}),
    # maps without pictures are no pictures of a pattern
    ("d/rgb_0.png d/depth_0.png d/depth_1.png", "d", SWAP, {"rgb_0.png": "d/depth_0.png"}),
    # a part of a word is no name of maps
    ("d/indepth/rgb.png d/indepth/depth.png d/indepth/1.png", "d", SWAP, INDEPTH),
    # a picture is not its own map
    ("d/b_RGB.png d/b_depth.png d/rgb.png d/depth.png", "d", SWAP, OWN),
    ("voc/JPEGImages/1.jpg voc/SegmentationClass/1.png", "voc", None, {"JPEGImages/1.jpg": ""}),
    ("voc/SegmentationClass/1.png", "voc/SegmentationClass", None, {"1.png": ""}),
    ("d/@home.png d/@eaDir/1.png d/.hidden.png d/.trash/b.png", "d", None, {"@home.png": ""}),
    ("d/._a.png", "d/._a.png", None, {"._a.png": ""}),
    # names in their normal form
    ("d/0.JPG m/0.NPY", "d", "m", {"0.JPG": "m/0.NPY"}),
    ("d/0.JPG m/0_z.PNG", "d", f"m/{Z}", {"0.JPG": "m/0_z.PNG"}),
    (f"d/{NFD}.png m/{NFC}.npy", "d", "m", {f"{NFD}.png": f"m/{NFC}.npy"}),
    (f"d/{NFC}/1.png m/{NFD}/1.npy", "d", "m", {f"{NFC}/1.png": f"m/{NFD}/1.npy"}),
    ("d/a+b.png m/a%2Bb.npy", "d", "m", {"a+b.png": "m/a%2Bb.npy"}),
    ("d/%E8.png d/%E9.png m/%E9.npy", "d", "m", {"%E8.png": "m/%E8", "%E9.png": "m/%E9.npy"}),
    # then names with a mark
    ("d/1.png m/1_depth.npy", "d", "m", {"1.png": "m/1_depth.npy"}),
    ("d/1.png m/1_depth.npy m/1.png", "d", "m", {"1.png": "m/1.png"}),
]


TIMES = "m/1305031102.160104.png m/1305031102.193437.png"
DEPTH_FIRST = "# depth, colour\n1.16 m/2.png 1.17 d/1.png 9.5\n"
LISTED: list[tuple[str, str, dict[str, str]]] = [
    # a list of pictures and maps, maps beside it, and what is found
    ("1.17 d/1.png 1.16 m/2.png\n1.2 d/3.png 1.1 m/4.png", "m/2.png", {"1.png": "m/2.png"}),
    (DEPTH_FIRST, "m/2.png", {"1.png": "m/2.png"}),
    ("\ufeffD:\\tum\\d\\1.png;D:\\tum\\m\\2.pfm\r\n", "m/2.pfm", {"1.png": "m/2.pfm"}),
]


@pytest.mark.parametrize("text, maps, found", LISTED)
def test_maps_by_a_list(text: str, maps: str, found: dict[str, str]) -> None:
    touch(f"d/1.png d/2.png {maps}")
    Path("pairs.txt").write_text(text, encoding="utf-8")
    assert names("d", "pairs.txt") == {**found, "2.png": "pairs.txt/2.png"}  # which has none
    Path("pairs.txt").write_text("1.png\n")
    with pytest.raises(ValueError, match=r"no line of pairs.txt has it and a map"):
        find_items("d", "pairs.txt")


def test_lists_of_other_scenes_with_the_same_names() -> None:
    touch("s1/d/1.png s1/d/2.png s0/m/1.png s1/m/2.png scene_01/d/1.png scene_02/m/1.png")
    Path("a.txt").write_text("s1/d/2.png s1/m/2.png\ns0/d/1.png s0/m/1.png")
    assert names("s1/d", "a.txt") == {"1.png": "a.txt/1.png", "2.png": "s1/m/2.png"}
    touch("s0/d/9.png s0/m/2.png")
    Path("s0/of_all.txt").write_text("s1/d/2.png s1/m/2.png")  # from above the list
    assert names("s1/d", "s0/of_all.txt")["2.png"] == "s1/m/2.png"
    Path("a.txt").write_text("scene_02/d/1.png scene_02/m/1.png")
    with pytest.raises(ValueError, match=r"no line of a.txt has it and a map"):
        find_items("scene_01/d", "a.txt")


@pytest.mark.parametrize(
    "picture, found",
    [
        ("1305031102.175304.png", "m/1305031102.160104.png"),
        ("1305031102.179304.png", "m/1305031102.193437.png"),
        ("1305031102179.jpg", "m/1305031102.193437.png"),
        ("1305031102161104000.jpg", "m/1305031102.160104.png"),
        ("left-1305031102161104000.jpg", "m/left-1305031102161104000"),  # more than a time
        ("1305031102.260104.png", "m/1305031102.260104"),  # is too far away
    ],
)
def test_maps_of_the_nearest_time(picture: str, found: str) -> None:
    touch(f"d/1305031102.195437.png d/{picture} {TIMES}")
    assert names("d", "m")[picture] == found
    count = 1 + Path(found).is_file()
    said = delay_of(find_items("d", "m"))
    assert re.fullmatch(rf"{count} pictures have .* times, 1?\d ms away at most", said)


@pytest.mark.parametrize("of", ["1.000{}", "400638133393{}"])
def test_where_maps_have_the_names_of_pictures_a_missing_one_is_missing(of: str) -> None:
    touch(" ".join(f"d/{of.format(n)}.png m/{of.format(n)}.npy" for n in range(4)))
    Path(f"m/{of.format(2)}.npy").unlink()
    assert names("d", "m") == {
        f"{of.format(n)}.png": f"m/{of.format(n)}" + ".npy" * (n != 2) for n in range(4)
    }


def test_lists_with_a_picture_twice_and_with_names_alone() -> None:
    touch(f"d/1305031102.175304.png {TIMES} d/2.png m/1.png m/2.png m/3.png d/3.png")
    lines = [f"d/1305031102.175304.png {name}" for name in reversed(TIMES.split())]
    Path("m/list.txt").write_text("\n".join([*lines, "1.png 2.png", "2.png 3.png"]))
    listed = names("d", "m/list.txt")
    assert listed["1305031102.175304.png"] == "m/1305031102.160104.png"  # the nearer one
    assert listed["2.png"] == "m/3.png"  # read in one order


@pytest.mark.parametrize(
    "files, maps, message",
    [
        ("m/0.h5 m/1.h5 m/notes.txt", "m", r"m/15.200, ending in .*; found 2 files ending in .h5"),
        ("k/1.png", "m", "there are no files in m"),
        ("m/15.23000.png m/15.11000.png", "m", r"found m/15.23000.png, 30 ms away"),
        ("m/15.20000.png", "m/{stem}_z", r"m/15.200_z, .*found 1 files ending in .png"),
    ],
)
def test_what_is_there_in_place_of_maps_is_said(files: str, maps: str, message: str) -> None:
    touch(f"d/15.200.png {files}")
    with pytest.raises(ValueError, match=message):
        find_items("d", maps)


@pytest.mark.parametrize("files, pictures, maps, found", FOUND)
def test_items(files: str, pictures: str, maps: str | None, found: dict[str, str]) -> None:
    touch(files)
    assert names(pictures, maps) == found
    if maps and "/" in maps:
        here = str(Path.cwd())
        absolute = {name: f"{here}/{place}" for name, place in found.items()}
        assert names(pictures, f"{here}/{maps}") == absolute


def test_links_to_folders_are_followed() -> None:
    touch("store/train/1.png store/train/deep/2.png ds/images/val/3.png")
    Path("ds/images/train").symlink_to(Path("store/train").absolute())
    Path("ds/test").symlink_to("images/val")  # pictures that are there twice are two
    there = ["images/train/1.png", "images/train/deep/2.png", "images/val/3.png", "test/3.png"]
    assert list(names("ds")) == there
    apart = ["store/train/deep", "ds/test"]
    assert list(names("ds", exclude=apart)) == ["images/train/1.png"]
    # loops: to itself, to a folder above, and by another link
    Path("ds/images/val/here").symlink_to(Path("ds/images/val").absolute())
    Path("store/train/up").symlink_to(Path("ds").absolute())
    Path("store/train/round").symlink_to(Path("ds/images").absolute())
    assert list(names("ds")) == there


def test_a_map_is_of_one_picture() -> None:
    touch("d/1.JPG d/1.png d/2.png m/1.npy m/2.npy")
    with pytest.raises(ValueError, match=r"m/1\.npy may be of d/1\.JPG or d/1\.png"):
        find_items("d", "m")
    assert len(names("d", "m/2.npy")) == 3  # one for all


def test_nothing_is_found() -> None:
    touch("ds/deep/2.png ds/maps/deep/notes.txt")
    with pytest.raises(ValueError, match=r"ds/maps has no map for any picture: .*ds/maps/deep/2,"):
        find_items("ds", "ds/maps")
    with pytest.raises(ValueError, match="no pictures in ds/maps"):
        find_items("ds/maps")
    with pytest.raises(FileNotFoundError):
        find_items("nowhere")


def test_what_cannot_be_read_is_no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    touch("ds/0.png ds/lost+found/1.png")
    for pipe in ("ds/0.png.json", "ds/uwaug-run.json"):
        os.mkfifo(pipe)
    listed = Path.iterdir

    def iterdir(path: Path) -> Any:
        if path.name == "lost+found":
            raise PermissionError(path)
        return listed(path)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    assert names("ds") == {"0.png": ""}


@pytest.mark.parametrize(
    "ends", [".hdr .mpo .insp", ".GPR .srw .3fr", ".mts .m2ts .wmv .insv .vob"]
)
def test_all_that_cameras_write_is_named(ends: str) -> None:
    touch(" ".join(["ds/0.png", *(f"ds/1{end}" for end in ends.split())]))
    told = left_out(Path("ds"))
    assert all(f"1 {end.lower()}: " in told for end in ends.split())
