"""The table of a run: read from a file, proposed for a folder, refused where it is ambiguous."""

import os
import re
import unicodedata
from pathlib import Path
from typing import Any

import pytest

import uwaug.files
from uwaug.files import Row, propose, read_table, write_table
from uwaug.files.table import in_words, require_rows


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def touch(names: str) -> None:
    for name in names.split():
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).touch()


def columns(rows: list[Row], *names: str) -> list[Any]:
    cells = [[getattr(row, name) for name in names] for row in rows]
    plain = [[c.as_posix() if isinstance(c, Path) else c for c in line] for line in cells]
    return [line[0] for line in plain] if len(names) == 1 else [tuple(line) for line in plain]


# Proposed for a folder

NFC, NFD = (unicodedata.normalize(form, "épave") for form in ("NFC", "NFD"))
Z = "m/{folder}/{stem}_z.png"
MAPS: list[tuple[str, str, str | None, dict[str, str | None]]] = [
    # files, pictures, maps, and what is proposed
    ("d/1.png m/2.tif", "d/1.png", "m/2.tif", {"1.png": "m/2.tif"}),
    ("d/2.PNG d/3.jpg m.npy", "d", "m.npy", {"2.PNG": "m.npy", "3.jpg": "m.npy"}),
    ("d/r/2.png d/m/r/2.png", "d", "d/m", {"r/2.png": "d/m/r/2.png"}),
    ("d/1.0001.png m/1.0001.npy m/1.npy", "d", "m", {"1.0001.png": "m/1.0001.npy"}),
    # a pattern
    (
        "d/r/b.jpg d/c.jpg m/r/b_z.png m/c_z.png",
        "d",
        Z,
        {"r/b.jpg": "m/r/b_z.png", "c.jpg": "m/c_z.png"},
    ),
    ("d/b.png d/b_z.png", "d", "d/{stem}_z.png", {"b.png": "d/b_z.png"}),
    ("ds/val/b.png of_val.npy", "ds", "of_{split}.npy", {"val/b.png": "of_val.npy"}),
    # a picture is not its own map
    ("d/b.png d/b.npy", "d", "d", {"b.png": "d/b.npy"}),
    ("d/a.png d/b.png m/b.png", "d", "m", {"a.png": None, "b.png": "m/b.png"}),
    # names in their normal form, and no others
    ("d/0.JPG m/0.NPY", "d", "m", {"0.JPG": "m/0.NPY"}),
    ("d/0.JPG m/0_z.PNG", "d", Z, {"0.JPG": "m/0_z.PNG"}),
    (f"d/{NFD}.png m/{NFC}.npy", "d", "m", {f"{NFD}.png": f"m/{NFC}.npy"}),
    (f"d/{NFC}/1.png m/{NFD}/1.npy", "d", "m", {f"{NFC}/1.png": f"m/{NFD}/1.npy"}),
    (
        "d/1.png d/a+b.png d/A.png m/1.npy m/a%2Bb.npy m/a.npy",
        "d",
        "m",
        {"1.png": "m/1.npy", "a+b.png": None, "A.png": None},
    ),
    ("d/x.png d/images/x.png m/x.npy", "d", "m", {"x.png": "m/x.npy", "images/x.png": None}),
    # what is no picture of a person
    ("d/@home.png d/n.txt d/@eaDir/1.png d/.2.png d/.trash/b.png", "d", None, {"@home.png": None}),
]


@pytest.mark.parametrize("files, pictures, maps, expected", MAPS)
def test_maps_of_a_folder(
    files: str, pictures: str, maps: str | None, expected: dict[str, str | None]
) -> None:
    touch(files)
    assert dict(columns(propose(pictures, maps), "name", "distance")) == expected
    if maps is not None:
        absolute = {n: file and f"{Path.cwd()}/{file}" for n, file in expected.items()}
        rows = propose(pictures, f"{Path.cwd()}/{maps}")
        assert dict(columns(rows, "name", "distance")) == absolute


def test_labels_of_a_folder() -> None:
    touch("ds/images/val/1.jpg ds/images/2.jpg ds/labels/val/1.txt ds/labels/classes.txt all.json")
    touch("m/2_mask.png valid/3.jpg valid/own.json train/4.jpg train/own.json")
    for labels, expected in {
        "ds/labels": [None, "ds/labels/val/1.txt"],
        "all.json": ["all.json"] * 2,
        "m/{stem}_mask.png": ["m/2_mask.png", None],
    }.items():
        assert columns(propose("ds/images", labels=labels), "labels") == expected
    rows = propose(".", labels="{folder}/own.json")
    assert columns(rows, "labels")[-2:] == ["train/own.json", "valid/own.json"]


@pytest.mark.parametrize(
    "picture, split",
    [
        ("ds/images/train/1.jpg", "train"),
        ("ds/valid/images/1.jpg", "val"),
        ("ds/train/a/test/1.jpg", "test"),
        ("ds/val2017/1.jpg", "val"),
        ("ds/Training/1.jpg", "train"),
        ("ds/trains/train.jpg", ""),
        ("ds/train1/1.jpg", ""),
    ],
)
def test_a_split_is_a_folder_of_that_name_with_a_year_or_without(picture: str, split: str) -> None:
    touch(picture)
    for source in ("ds", Path(picture).parent):
        assert columns(propose(source), "split") == [split]


@pytest.mark.parametrize(
    "names, times",
    [
        ("{}0.png", [110, 120, 130, 510]),
        ("dive_2_{}.png", [11, 12, 13, 51]),
        ("170000{}.0001.png", [17000011.0001, 17000012.0001, 17000013.0001, 17000051.0001]),
        ("170000{0}.{0}.png", [0, 1, 2, 3]),
        ("{0}-of-{0}.png", [0, 1, 2, 3]),  # two numbers vary
    ],
)
def test_the_time_of_a_frame_is_the_number_that_varies(names: str, times: list[float]) -> None:
    numbers = (51, 11, 13, 12)
    touch(" ".join(f"{film}/{names.format(n)}" for n in numbers for film in ("a/b", "c")))
    rows = propose(".", sequence=True)
    assert columns(rows, "film") == ["a/b"] * 4 + ["c"] * 4
    assert columns(rows[:4], "time") == times
    assert [row.name for row in rows[:4]] == [f"a/b/{names.format(n)}" for n in (11, 12, 13, 51)]


@pytest.mark.parametrize(
    "files, maps, labels, message",
    [
        ("d/1.JPG d/1.png m/1.npy", "m", None, r"m/1\.npy may be of 1\.JPG or 1\.png"),
        ("d/a/1.png d/b/1.png m/1.npy", "m/{stem}.npy", None, r"may be of a/1\.png or b/1\.png"),
        ("d/1.png m/1.npy m/1.png", "m", None, r"may have m/1\.npy or m/1\.png: give a pattern"),
        ("d/1.png m/1.h5", "m", None, r"m has a file for no picture: expected such as m/1, "),
        ("d/1.png m/1.npy", "m/{name}.npy", None, r"has \{name\}: expected \{stem\}, \{folder\}"),
        ("d/1.png l/frame_1.txt", None, "l", r"labels: l has a file for no picture: .*column lab"),
        ("d/1.heic d/2.MP4", None, None, r"no pictures in d: .*1 \.heic, 1 \.mp4: make PNG of"),
    ],
)
def test_what_a_folder_does_not_say_is_refused(
    files: str, maps: str | None, labels: str | None, message: str
) -> None:
    touch(files)
    with pytest.raises(ValueError, match=message):
        propose("d", maps, labels)


def test_what_is_not_there_and_what_is_no_picture() -> None:
    touch("d/1.png")
    for options in ({"distance": "nowhere"}, {"labels": "nowhere.json"}):
        with pytest.raises(FileNotFoundError):
            propose("d", **options)  # type: ignore[arg-type]
    with pytest.raises(FileNotFoundError):
        propose("nowhere")
    touch("d/2.heic")
    with pytest.raises(ValueError, match=r"d/2\.heic: make PNG of them"):
        propose("d/2.heic")


def test_links_to_folders_are_followed() -> None:
    touch("store/train/1.png store/train/deep/2.png ds/images/val/3.png")
    Path("ds/images/train").symlink_to(Path("store/train").absolute())
    Path("ds/test").symlink_to("images/val")  # pictures that are there twice are two
    there = ["images/train/1.png", "images/train/deep/2.png", "images/val/3.png", "test/3.png"]
    assert columns(propose("ds"), "name") == there
    apart = ["store/train/deep", "ds/test"]
    assert columns(propose("ds", exclude=apart), "name")[0] == "images/train/1.png"
    # loops: to itself, to a folder above, and by another link
    Path("ds/images/val/here").symlink_to(Path("ds/images/val").absolute())
    Path("store/train/up").symlink_to(Path("ds").absolute())
    Path("store/train/round").symlink_to(Path("ds/images").absolute())
    assert columns(propose("ds"), "name") == there


def test_what_cannot_be_read_is_no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    touch("ds/0.png ds/lost+found/1.png")
    for pipe in ("ds/0.png.json", "ds/uwaug-run.json"):
        os.mkfifo(pipe)
    listed = os.scandir

    def scandir(path: Path) -> Any:
        if Path(path).name == "lost+found":
            raise PermissionError(path)
        return listed(path)

    monkeypatch.setattr(os, "scandir", scandir)
    assert columns(propose("ds"), "name") == ["0.png"]


# Read from a file


def test_a_table_is_read() -> None:
    Path("ds").mkdir()
    head = "film, split ,Picture,time,distance,labels,note"
    text = f"{head}\nf,valid,a/1.png,2.5,z.npy,l.json,x\n,,2.png,,,,\n"
    for written in (text, f"\ufeff{text}".replace(",", ";").replace("\n", "\r\n")):
        Path("ds/t.csv").write_text(written, encoding="utf-8", newline="")
        files = (Path("ds/a/1.png"), Path("ds/z.npy"), Path("ds/l.json"))
        first = Row("a/1.png", *files, "val", "f", 2.5)
        assert read_table("ds/t.csv") == [first, Row("2.png", Path("ds/2.png"))]
    Path("ds/metadata.csv").write_text("file_name,text\n1.png,a fish\n")  # as Hugging Face has it
    assert read_table("ds/metadata.csv") == [Row("1.png", Path("ds/1.png"))]


def test_a_depth_beside_distances_is_left_alone() -> None:
    Path("t.csv").write_text("picture,distance,depth\n1.png,1.npy,12\n")
    assert read_table("t.csv") == [Row("1.png", Path("1.png"), Path("1.npy"))]


def test_names_are_paths_below_the_table_or_below_what_holds_all_pictures() -> None:
    Path("ds").mkdir()
    Path("ds/t.csv").write_text("picture\nx/1.png\n../ds/y/2.png\n")
    assert columns(read_table("ds/t.csv"), "name") == ["x/1.png", "y/2.png"]
    Path("ds/t.csv").write_text(f"picture,name\n../o/x/1.png,\n{Path.cwd()}/o/y/2.png,n.jpg\n")
    assert columns(read_table("ds/t.csv"), "name") == ["x/1.png", "n.jpg"]


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "expected a column picture"),
        ("picture,Distances\n1.png,1.npy\n", "expected a column distance, .* got distances"),
        ("picture,depth\n1.png,1.npy\n", "expected a column distance, .* got depth"),
        ("picture,split,splits\n1.png,val,val\n", "expected a column split, .* got splits"),
        ("image,depth\n1.png,1.npy\n", "expected a column picture, .* got image, depth"),
        ("picture\n", "and rows below it, got picture"),
        ("picture,distance\n1.png\n", "line 2: has 1 cells and the first line 2"),
        ('picture\n"1.png\n', "is no line of CSV"),
        ("picture,film\n,f\n", "line 2: picture is empty"),
        ("picture,split\n1.png,\n2.png,dev\n", "line 3: split must be one of train, training, val"),
        ("picture,time\n1.png,noon\n", "line 2: time must be a number, got noon"),
        ("picture,time\n1.png,nan\n", "line 2: time must be a number, got nan"),
    ],
)
def test_what_is_no_table(text: str, message: str) -> None:
    Path("t.csv").write_text(text)
    with pytest.raises(ValueError, match=rf"t\.csv: .*{message}"):
        read_table("t.csv")


def test_what_is_written_is_read_from_anywhere() -> None:
    touch("d/a,b.png d/é;.png d/m.npy l.json real/deep/x")
    Path("out").symlink_to("real/deep")
    rows = [
        Row("a,b.png", Path("d/a,b.png").absolute(), Path("d/m.npy"), None, "val", "f", 0.1),
        Row('"é".png', Path("d/é;.png"), None, Path("l.json"), "", "f", 3.0),
    ]
    write_table("out/t.csv", rows)
    again = read_table("out/t.csv")
    plain = [row._replace(picture=None, distance=None, labels=None) for row in rows]  # type: ignore[arg-type]
    assert [row._replace(picture=None, distance=None, labels=None) for row in again] == plain  # type: ignore[arg-type]
    for one, other in zip(rows, again, strict=True):
        for column in ("picture", "distance", "labels"):
            file, twin = getattr(one, column), getattr(other, column)
            assert file is twin is None or file.samefile(twin)


# Refused before a run


def rows_of(*lines: str) -> list[Row]:
    """Rows of name, map, labels, film; - for none."""
    rows = []
    for line in lines:
        name, *files, film = (cell.strip("-") for cell in line.split())
        cells = [Path(file) if file else None for file in files]
        rows.append(Row(name, Path("d", name), *cells, film=film))
    return rows


@pytest.mark.parametrize(
    "lines, message",
    [
        (
            ("1.png z.npy - -", "2.png z.npy - -", "3.png - - -"),
            r"column distance: .*/z\.npy is of 1\.png and 2\.png",
        ),
        (
            ("1.png - l.txt -", "2.png - l.txt -", "3.png - - -"),
            r"column labels: .*/l\.txt is of 1\.png and 2\.png",
        ),
        (("1.png ./z.npy - -", "2.png a/../z.npy - f", "3.png - - -"), "column distance: "),
        (("1.png z.npy - -", "2.png y.npy - -", "9.png y.npy - -"), "9.png"),
        (("1.png x.npy - -", "2.png y.npy - -"), "column distance: 2 of its files are not there"),
        (("1.png - - -", "1.png - - -"), "two rows are called 1.png"),
        (("../1.png - - -",), "name: expected a path below the folder of the run"),
        (("1 - - -",), "name: expected a path below .*, got 1"),
    ],
)
def test_tables_that_would_make_a_mistake_are_refused(lines: tuple[str, ...], message: str) -> None:
    touch("d/1.png d/2.png d/3.png 1.png d/1 z.npy l.txt a/a")
    with pytest.raises(ValueError, match=message):
        require_rows(rows_of(*lines))


@pytest.mark.parametrize(
    "lines",
    [
        ("1.png z.npy l.txt -", "2.png z.npy l.txt -"),  # shared by all
        ("1.png z.npy - f", "2.png z.npy - f", "3.png - - -"),  # by a film
        ("1.png - l.json -", "2.png - l.json -", "3.png - - -"),  # COCO
    ],
)
def test_files_of_several_pictures(lines: tuple[str, ...]) -> None:
    touch("d/1.png d/2.png d/3.png z.npy l.txt l.json")
    require_rows(rows_of(*lines))


def test_a_missing_map_is_named_with_the_column_to_write() -> None:
    touch("d/1.png d/2.png d/3.png z.npy")
    rows = rows_of("1.png z.npy - -", "2.png - - -", "3.png - - -")
    require_rows(rows)
    expected = "distance is missing: 2 of 3 pictures have no map, such as 2.png: .*column distance"
    with pytest.raises(ValueError, match=expected):
        require_rows(rows, with_maps=True)


def test_what_a_table_has_in_words() -> None:
    touch(" ".join(f"ds/{split}/{n}.png" for split in ("train", "val") for n in range(3)))
    assert in_words(propose("ds/train")) == "3 pictures; 3 are of train"
    touch("m/train/0.npy m/val/0.npy m/val/1.npy m/val/2.npy l/val/1.txt")
    first, second = in_words(propose("ds", "m", "l", sequence=True)).splitlines()
    assert first.split("; ") == [
        *("6 pictures", "4 have maps, 2 have none: train/1.png, train/2.png"),
        "1 have labels, 5 have none: train/0.png, train/1.png and others",
        *("3 are of train, 3 are of val", "2 films, each in its own water"),
    ]
    assert second == "val gets wet, too"


def test_the_layouts_of_the_manual() -> None:
    guide = Path(uwaug.files.__file__).with_name("README.md").read_text(encoding="utf-8")
    (block,) = (b for b in re.findall(r"```python\n(.*?)```", guide, re.DOTALL) if "TUM" in b)
    touch("rgb/1.50.png rgb/1.90.png depth/1.49.png depth/1.93.png images/7.jpg labels/7.txt")
    touch("image_2/03.png image_3/03.png z/image_2/03.npy z/image_3/03.npy")
    touch("lists/val.txt")
    Path("lists/val.txt").write_text("/content/fish/images/7.jpg\n")
    exec(block, {})
    assert columns(read_table("table.csv"), *Row._fields) == [
        ("1.50.png", "rgb/1.50.png", "depth/1.49.png", None, "", "tum", 1.5),
        ("1.90.png", "rgb/1.90.png", "depth/1.93.png", None, "", "tum", 1.9),
        ("image_2/03.png", "image_2/03.png", "z/image_2/03.npy", None, "", "rig", 3),
        ("image_3/03.png", "image_3/03.png", "z/image_3/03.npy", None, "", "rig", 3),
        ("7.jpg", "images/7.jpg", None, "labels/7.txt", "val", "", None),
    ]
