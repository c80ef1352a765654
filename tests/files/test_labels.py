"""Labels beside pictures: read, judged, written where trainers look, read again."""

import io
import json
import os
import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from filing import content, pixels, save
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from uwaug.files.formats import ENDINGS, open_labels
from uwaug.files.labels import Judged, judged
from uwaug.files.summary import Result
from uwaug.files.table import Row
from uwaug.files.yolo import Yolo

H, W = 6, 8
SIZE = (H, W)
SQUARE = [[2, 1, 5, 1, 5, 4, 2, 4]]  # columns 2…4, rows 1…3
MIXED = round((2 * 0.9 + 0.01) / 3, 4)
"""Of the square: two of its three columns are in the left half."""

LEFT = torch.full((1, H, W), 0.9)
LEFT[..., W // 2 :] = 0.01
"""A map of contrast."""

ANNOTATIONS: list[dict[str, Any]] = [
    {"id": 7, "image_id": 1, "category_id": 3, "bbox": [0, 0, 4, 6], "iscrowd": 0},
    {"id": 8, "image_id": 1, "category_id": 3, "bbox": [4, 0, 99, 6], "mine": {"kept": [1]}},
    {"id": 9, "image_id": 1, "category_id": 1, "bbox": [2, 1, 3, 3], "segmentation": SQUARE},
    {"id": 10, "image_id": 1, "bbox": [90, 90, 8, 6]},
    {"id": 11, "image_id": 2, "category_id": 1, "bbox": [0, 0, 2, 2], "iscrowd": 1},
]
IMAGES = [
    {"id": 1, "file_name": "reef/a.jpg", "height": H, "width": W, "license": 4},
    {"id": 2, "file_name": "b.jpg", "height": H, "width": W},
]
COCO = {"info": {"year": 2026}, "images": IMAGES, "annotations": ANNOTATIONS}
ALL = "0 .5 .5 1 1\n"
"""YOLO's box of a whole picture."""


def coco(**changes: Any) -> str:
    return json.dumps({**COCO, **changes})


def named(*file_names: str) -> str:
    """A COCO file of images without objects, with ids from 0 on."""
    images = [{"id": number, "file_name": name} for number, name in enumerate(file_names)]
    return coco(images=images, annotations=[])


def png(values: Any, *palette: int) -> bytes:
    file, image = io.BytesIO(), Image.fromarray(values)
    if palette:
        image.putpalette(palette)
    image.save(file, "PNG")
    return file.getvalue()


def values_of(*columns: tuple[int, int]) -> Any:
    """Values of a mask (HxW, int), by columns."""
    values = np.zeros(SIZE, np.int32)
    for column, value in columns:
        values[:, column] = value
    return values


def write(path: Path, content: str | bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def rows(source: Path, *names: str, split: str = "") -> list[Row]:
    """Pictures below "photos", with the labels of a file for all, or of a folder of files."""
    table = []
    for name in names:
        stem = source / os.path.splitext(name)[0]
        files = [file for end in ENDINGS if (file := stem.with_name(stem.name + end)).exists()]
        labels = source if source.suffix else next(iter(files), None)
        table.append(Row(name, source.parent / "photos" / name, labels=labels, split=split))
    return table


def labelled(
    table: Sequence[Row],
    out: Path,
    least: float | None = 0.05,
    classes: str | Path | None = None,
    notes: list[str] | None = None,
) -> list[list[Judged]]:
    """What a run does with the labels of some pictures, each in a process of its own."""
    labels, results = open_labels(table, classes), []
    out.mkdir(exist_ok=True)
    for row in table:
        own = pickle.loads(pickle.dumps(labels.only(row.name)))
        objects = judged(own, row.name, LEFT, least)
        place = labels.place(row.name)
        own.write(row.name, place, {label.key for label in objects if not label.kept}, out)
        results.append(Result(row, 0, place, "written", objects=objects))
    lists, told = labels.lists(results)
    for name, text in lists.items():
        write(out / name, text)
    if notes is not None:
        notes += told
    return [list(result.objects) for result in results]


# What is none


HALVES = np.repeat(np.uint8([[0] * 4 + [1] * 4]), H, 0)
POINTS = "numbers are polygons, or have keypoints"
SAME = [IMAGES[0], IMAGES[1] | {"id": 1}]


def first(**changes: Any) -> str:
    """A COCO file whose first image has one object that is changed."""
    return coco(annotations=[ANNOTATIONS[0] | changes])


def pages() -> bytes:
    file, (one, two) = io.BytesIO(), (Image.fromarray(np.full(SIZE, n, np.uint8)) for n in (1, 2))
    one.save(file, "TIFF", save_all=True, append_images=[two])
    return file.getvalue()


REFUSED: list[tuple[str, str | bytes, str]] = [
    # file, what it holds, and what is said of it
    ("a.xml", "<annotation/>", r"expected COCO's .*\.json.*\.txt.*\.png.*, got .*a\.xml"),
    ("a.json", "[" * 100_000, "is no COCO file"),
    ("a.json", '{"videos": [], "annotations": []}', "is no COCO file"),
    ("a.json", coco(annotations=[{"id": 1, "image_id": 9}]), "is no COCO file: KeyError.9"),
    ("a.json", coco(images=[{"id": 1, "coco_url": "a"}]), "is no COCO file.*LVIS"),
    ("a.json", coco(images=SAME, annotations=[]), "is no COCO file: .* an id of its own"),
    ("a.json", coco(annotations=[{"id": 7, "image_id": 1}]), "annotation 7: KeyError.'bbox'"),
    ("a.json", first(segmentation=[[0, 1, 2]]), "annotation 7"),
    ("a.json", first(segmentation={"size": SIZE, "counts": [40]}), "annotation 7: .*reshape"),
    ("a.json", first(segmentation={"size": [W, H], "counts": [48]}), r"7: .*lengths of \[8, 6\]"),
    ("a.json", coco(images=[IMAGES[0] | {"width": 99}], annotations=[]), "is of 99×6 px, .* 8×6"),
    ("a.json", coco(images=[IMAGES[0] | {"width": H, "height": W}], annotations=[]), "EXIF turns"),
    ("a.json", named("b.jpg"), r"no file_name is the end .*reef/a.jpg, got b.jpg"),
    ("labels/reef/a.txt", f"{ALL}0 10 20 30 40", "line 2: expected a class, and shares of width"),
    ("labels/reef/a.txt", f"{ALL}0 nan .5 .5 .5", "line 2: expected"),
    ("labels/reef/a.txt", f"{ALL}0 .5 .5 .5", "line 2: expected"),
    ("labels/reef/a.txt", f"{ALL}0 a b c d", "line 2: could not convert"),
    ("labels/reef/a.txt", f"{ALL}0 .5 .5 .2 .2 7", "line 2: expected"),
    ("labels/reef/a.txt", f"{ALL}0 .1 .15 .16 .2 .05 .1 2 .12 .2 2", "line 2: .*need a kpt_shape"),
    ("labels/reef/a.txt", "0 .25 .5 .4 .9 .2 .5 2 .3 .6 1", POINTS),
    ("labels/reef/a.txt", "Car 0.00 0 -1.58 58 17 61 20 1.6 1.6", "expected class cx cy w h, as"),
    ("labels/reef/a.txt", "Müll 1 1 1 1".encode("cp1252"), "is no text in UTF-8"),
    ("labels/reef/a.png", png(np.zeros((3, 4), np.uint8)), "is of 4×3 px, its picture of 8×6 px"),
    ("labels/reef/a.png", png(pixels(40, 40)), "a.png: .* colours are"),
    ("labels/reef/a.png", png(np.zeros((*SIZE, 4), np.uint8)), "one channel, or RGB, got RGBA"),
    ("labels/reef/a.tif", pages(), "expected one mask, got 2"),
    ("labels/reef/a.png", png(HALVES, 0, 150, 0, 0, 0, 0), "black is not number 0"),
]


@pytest.mark.parametrize("name, held, message", REFUSED)
def test_files_that_are_refused(tmp_path: Path, name: str, held: str | bytes, message: str) -> None:
    path = write(tmp_path / name, held)
    source = tmp_path / "labels" if "/" in name else path
    with pytest.raises(ValueError, match=message) as refused:
        judged(open_labels(rows(source, "reef/a.jpg")), "reef/a.jpg", LEFT, None)
    assert str(source) in str(refused.value)


def test_labels_of_two_formats_and_classes_of_masks_are_refused(tmp_path: Path) -> None:
    write(tmp_path / "labels/1.txt", ALL)
    write(tmp_path / "labels/2.png", png(HALVES))
    with pytest.raises(ValueError, match=r"one of these for all rows, got .*1\.txt and .*2\.png"):
        open_labels(rows(tmp_path / "labels", "1.jpg", "2.jpg"))
    with pytest.raises(ValueError, match=r"classes \(--classes\) are of YOLO's labels, got .*png"):
        open_labels(rows(tmp_path / "labels", "2.jpg"), tmp_path / "data.yaml")


def test_one_damaged_file_is_left_to_its_picture(tmp_path: Path) -> None:
    for number in range(3):
        write(tmp_path / f"labels/{number}.txt", ALL)
        write(tmp_path / f"masks/{number}.png", png(HALVES))
    write(tmp_path / "labels/0.txt", "damaged")
    write(tmp_path / "masks/0.png", b"damaged")
    for source in (tmp_path / "labels", tmp_path / "masks"):
        labels = open_labels(rows(source, *(f"{number}.jpg" for number in range(3))))
        assert len(judged(labels, "1.jpg", LEFT, None)) == 1
        with pytest.raises((ValueError, OSError)):
            judged(labels, "0.jpg", LEFT, None)


# COCO


def test_coco(tmp_path: Path) -> None:
    file = write(tmp_path / "instances.json", coco())
    table = rows(file, "reef/a.jpg", "photos/b.jpg")
    objects, _ = labelled(table, tmp_path / "out")
    expected = [(7, 0.9, True), (8, 0.01, False), (9, MIXED, True), (10, 0.0, False)]
    assert objects == expected
    written = json.loads((tmp_path / "out/instances.json").read_text())
    assert written["info"] == COCO["info"]
    # trainers find the pictures by their places
    assert written["images"] == [IMAGES[0], {**IMAGES[1], "file_name": "photos/b.jpg"}]
    kept = {entry["id"]: entry for entry in written["annotations"]}
    assert kept == {
        7: {**ANNOTATIONS[0], "contrast": 0.9},
        9: {**ANNOTATIONS[2], "contrast": MIXED},
        11: {**ANNOTATIONS[4], "contrast": 0.9},
    }
    assert file.read_text() == coco()


def test_pictures_and_images_that_stand_alone_are_left_out_and_counted(tmp_path: Path) -> None:
    file, notes = write(tmp_path / "a.json", coco()), []
    background = Row("sand.jpg", tmp_path / "sand.jpg")
    table = [*rows(file, "b.jpg", "more.jpg"), background]
    assert labelled(table, tmp_path / "out", notes=notes) == [[(11, 0.9, True)], [], []]
    assert notes == [
        f"1 pictures have no image in {file}, such as more.jpg",
        f"1 of 2 images of {file} have no picture here",
    ]
    written = json.loads((tmp_path / "out/a.json").read_text())
    assert [image["file_name"] for image in written["images"]] == ["b.jpg"]


def test_coco_of_several_pictures_from_one(tmp_path: Path) -> None:
    (row,) = rows(write(tmp_path / "a.json", coco()), "b.jpg")
    labels = open_labels([row, row._replace(name="c.jpg")])  # two rows of one picture
    objects = judged(labels, "b.jpg", LEFT, None)
    results = [Result(row, i, f"b_{i}.png", "written", objects=objects) for i in (1, 2)]
    written = json.loads(labels.lists(results)[0]["a.json"])
    images = [(image["id"], image["file_name"]) for image in written["images"]]
    assert images == [(1, "b_1.png"), (2, "b_2.png")]
    annotations = [(entry["id"], entry["image_id"]) for entry in written["annotations"]]
    assert annotations == [(1, 1), (2, 2)]


def test_a_file_that_has_changed_since_is_not_written_again(tmp_path: Path) -> None:
    (row,) = rows(write(tmp_path / "a.json", coco()), "b.jpg")
    with pytest.raises(ValueError, match=r"has changed since b\.jpg was written"):
        open_labels([row]).lists([Result(row, 0, "b.jpg", "skipped", objects=[Judged(9, 1, True)])])


@pytest.mark.parametrize("compressed", [False, True])
def test_run_lengths_as_of_pycocotools(tmp_path: Path, compressed: bool) -> None:
    coders = pytest.importorskip("pycocotools.mask")
    mask = np.random.default_rng(0).random((40, 30)) > 0.7
    packed = coders.encode(np.asfortranarray(mask.astype(np.uint8)))
    runs: Any = packed["counts"].decode()
    if not compressed:
        changes = np.flatnonzero(np.diff(np.r_[0, mask.flatten("F"), 0]))
        runs = np.diff(np.r_[0, changes]).tolist()
        runs += [mask.size - sum(runs)]
    entry = {"id": 1, "image_id": 1, "segmentation": {"size": [40, 30], "counts": runs}}
    file = coco(images=[{"id": 1, "file_name": "a.jpg"}], annotations=[entry])
    labels = open_labels(rows(write(tmp_path / "a.json", file), "a.jpg"))
    ((_, inside),) = labels.objects("a.jpg", (40, 30))
    assert np.array_equal(inside, mask)


@pytest.mark.parametrize(
    "changes, contrast",
    [
        ({"bbox": [-20, -20, 10, 10]}, 0.0),  # outside
        ({"segmentation": [[1.1, 1.1, 1.3, 1.1, 1.3, 1.2]]}, 0.9),  # a sliver
        ({"segmentation": [[]]}, 0.9),  # none, so that the box counts
    ],
)
def test_odd_objects(tmp_path: Path, changes: dict[str, Any], contrast: float) -> None:
    labels = open_labels(rows(write(tmp_path / "a.json", first(**changes)), "reef/a.jpg"))
    assert judged(labels, "reef/a.jpg", LEFT, None) == [(7, contrast, True)]


@pytest.mark.parametrize(
    "file_name, picture, is_of_it",
    [
        ("images/x.jpg", "ds/images/x.jpg", True),
        ("images\\x.jpg", "ds/images/x.jpg", True),
        ("./x.jpg", "photos/deep/x.jpg", True),
        ("x.JPG", "photos/x.jpg", True),
        ("e\u0301 1.jpg", "photos/\xe9 1.jpg", True),
        ("{folder}/x.jpg", "x.jpg", True),
        ("images/x.jpg", "photos/x.jpg", False),
        ("/home/me/ds/images/x.jpg", "ds/images/x.jpg", False),
        ("C:\\me\\reef\\x.jpg", "elsewhere/reef/x.jpg", False),
        ("ax.jpg", "x.jpg", False),
        ("X.jpg", "x.jpg", False),
    ],
)
def test_a_file_name_is_the_end_of_a_path(
    tmp_path: Path, file_name: str, picture: str, is_of_it: bool
) -> None:
    file = write(tmp_path / "a.json", named(file_name.format(folder=tmp_path)))
    row = Row(picture, tmp_path / picture, labels=file)
    if is_of_it:
        assert open_labels([row]).of.keys() == {picture}
    else:
        with pytest.raises(ValueError, match="no file_name is the end of a path such as"):
            open_labels([row])


PATHS = st.lists(st.sampled_from("ab"), max_size=3).map(lambda folders: "/".join([*folders, "x"]))


@given(st.sets(PATHS, min_size=1, max_size=4), st.lists(PATHS, min_size=1, max_size=4))
def test_an_image_is_of_one_picture_and_a_picture_of_one_image(
    tmp_path_factory: pytest.TempPathFactory, pictures: set[str], file_names: list[str]
) -> None:
    folder = tmp_path_factory.mktemp("coco")
    file = write(folder / "a.json", named(*file_names))
    table = [Row(name, folder / name, labels=file) for name in sorted(pictures)]
    fits = {
        (row.name, number)
        for row in table
        for number, name in enumerate(file_names)
        if f"{folder}/{row.name}".endswith(f"/{name}")
    }
    is_unique = len({name for name, _ in fits}) == len({number for _, number in fits}) == len(fits)
    if not fits or not is_unique:
        with pytest.raises(ValueError, match=r"may be|no file_name"):
            open_labels(table)
    else:
        of = open_labels(table).of
        assert {(name, of[name].image["id"]) for name in of} == fits


def test_file_names_stay_apart_where_a_table_names_results_anew(tmp_path: Path) -> None:
    file = write(tmp_path / "a.json", named("1.jpg", "2.jpg"))
    table = [Row(f"{n}/x.jpg", tmp_path / f"{n}.jpg", labels=file) for n in (1, 2)]
    labelled(table, tmp_path / "out")
    written = json.loads((tmp_path / "out/a.json").read_text())
    assert [image["file_name"] for image in written["images"]] == ["1/x.jpg", "2/x.jpg"]


# YOLO


YOLO = """\
3 0.25 0.5 0.5 1

1 0.75 0.5 0.5 1.0
0 0.25 0.16667 0.625 0.16667 0.625 0.66667 0.25 0.66667"""
NO_VAL = "data.yaml has no val: add a folder of dry pictures to validate on"
NUMBERS = "no data.yaml: classes are numbers; classes (--classes) names them"


def test_yolo(tmp_path: Path) -> None:
    labels, notes = tmp_path / "ds/labels", []
    write(labels / "images/train/1.txt", YOLO)
    write(labels / "images/2.txt", " \n")
    table = [
        *rows(labels, "images/train/1.png"),
        *rows(labels, "images/2.png", "images/background.png", split="val"),
    ]
    objects, *others = labelled(table, tmp_path / "out", notes=notes)
    assert objects == [(1, 0.9, True), (3, 0.01, False), (4, MIXED, True)]
    assert others == [[], []]
    written = {name: data.decode() for name, data in content(tmp_path / "out").items()}
    description = yaml.safe_load(written.pop("data.yaml"))
    names = {number: str(number) for number in range(4)}
    assert description == {"train": "train.txt", "val": "val.txt", "names": names}
    lines = YOLO.splitlines()
    assert written == {
        "labels/train/1.txt": f"{lines[0]}\n\n{lines[3]}\n",
        "labels/2.txt": " \n",
        "train.txt": "./images/train/1.png\n",
        "val.txt": "./images/2.png\n./images/background.png\n",
    }
    assert notes == [NUMBERS]


def test_a_set_without_train_or_val_is_told_of(tmp_path: Path) -> None:
    write(tmp_path / "labels/a.txt", ALL)
    notes: list[str] = []
    table = rows(tmp_path / "labels", "a.png", "b.png", split="test")
    labelled(table, tmp_path / "out", notes=notes)
    assert (tmp_path / "out/train.txt").read_text() == ""
    assert (tmp_path / "out/test.txt").read_text() == "./images/a.png\n./images/b.png\n"
    assert notes == ["no picture is of the split train: train.txt is empty", NO_VAL, NUMBERS]


@pytest.mark.parametrize(
    "name, place, labels",
    [
        ("1.png", "images/1.png", "labels/1.txt"),
        ("train/images/1.png", "train/images/1.png", "train/labels/1.txt"),
        ("images/a/images/1.png", "images/a/images/1.png", "images/a/labels/1.txt"),
        ("a.b.png", "images/a.b.png", "labels/a.b.txt"),
    ],
)
def test_labels_lie_where_ultralytics_looks(name: str, place: str, labels: str) -> None:
    yolo = Yolo({})
    assert yolo.place(name) == place
    assert yolo.files(place, Path()) == [Path(labels)]


def test_a_background_takes_no_labels_of_another(tmp_path: Path) -> None:
    (row,) = rows(write(tmp_path / "1.txt", ALL), "1.png")
    background = Row("1.jpg", tmp_path / "1.jpg")
    with pytest.raises(ValueError, match=r"1.png and 1.jpg would both have the labels labels/1"):
        open_labels([row, background])


PLACED = "path: a\nval: b\ndownload: |\n  import os\n"
DESCRIBED: list[tuple[dict[str, str], str | None, str | None]] = [
    # files beside the folder of labels; the one that is named; the one that is taken
    ({"data.yaml": f"{PLACED}names: {{0: fish, 1: 'crab: red'}}\nnc: 2"}, None, "data.yaml"),
    ({"data.yaml": "names: [a]", "labels/data.yaml": "names: [b]"}, None, "labels/data.yaml"),
    ({"data.yaml": "names: [a]", "x.yml": "{train: c, names: [b]}"}, "x.yml", "x.yml"),
    ({"../data.yaml": "names: [a]", "coco.yaml": "names: [b]"}, None, None),
]


@pytest.mark.parametrize("files, classes, taken", DESCRIBED)
def test_classes_are_of_one_file(
    tmp_path: Path, files: dict[str, str], classes: str | None, taken: str | None
) -> None:
    folder, notes = tmp_path / "data/ds", []
    write(folder / "labels/train/1.txt", ALL)
    for name, text in files.items():
        write(folder / name, text.encode("utf-16" if name.startswith("labels") else "utf-8-sig"))
    table, source = rows(folder / "labels/train", "1.png"), classes and folder / classes
    labelled(table, tmp_path / "out", classes=source, notes=notes)
    written = yaml.safe_load((tmp_path / "out/data.yaml").read_text())
    expected = yaml.safe_load(files[taken]) if taken else {"names": {0: "0"}}
    for key in ("path", "val", "download"):
        expected.pop(key, None)
    assert written == {**expected, "train": "train.txt"}
    told = f"classes are those of {folder / taken}" if taken else NUMBERS
    assert notes == [NO_VAL, told]


@pytest.mark.parametrize("text", ["names: [fish", "- fish", "epochs: 3"])
def test_what_is_no_data_yaml(tmp_path: Path, text: str) -> None:
    path = write(tmp_path / "data.yaml", text)
    write(tmp_path / "labels/1.txt", ALL)
    with pytest.raises(ValueError, match=rf"{path}: (is no YAML|has no names)"):
        open_labels(rows(tmp_path / "labels", "1.png"))


DRY = [
    # what data.yaml says; the dry pictures to validate on, below its folder
    ("val: images/val", ["images/val"]),
    ("val: {ds}/images/val", ["images/val"]),
    ("path: images\nval: val", ["images/val"]),
    ("path: /content/ds\nval: images/val", ["images/val"]),
    ("val: ../valid/images", ["valid/images"]),  # Roboflow
    ("val: [images/val, lists/val.txt]", ["images/val", "lists/val.txt"]),
    ("val: [images/val, elsewhere]", []),
    ("path: images", []),
]


@pytest.mark.parametrize("text, places", DRY)
def test_what_one_validates_on_stays_dry(tmp_path: Path, text: str, places: list[str]) -> None:
    ds, notes = tmp_path / "ds", []
    for name in ("images/val/2.png", "valid/images/2.png"):
        save(ds / name, pixels())
    write(ds / "lists/val.txt", "../images/val/2.png\n")
    write(ds / "labels/train/1.txt", ALL)
    write(ds / "data.yaml", f"train: images/train\n{text.format(ds=ds)}\nnames: [fish]\n")
    labelled(rows(ds / "labels/train", "1.png"), tmp_path / "wet", notes=notes)
    written = yaml.safe_load((tmp_path / "wet/data.yaml").read_text())
    assert not (tmp_path / "wet/val.txt").exists()
    dry = [str(ds / place) for place in places]
    assert written.get("val", []) == dry
    assert notes[0] == (f"val is dry: {', '.join(dry)}" if dry else NO_VAL)


LEAKS = [
    # data.yaml; the list val.txt; splits of images/a/1.png and images/b/2.png; is that refused
    ("val: images/b", "", ("", ""), True),
    ("val: images/b", "", ("", "train"), True),
    ("val: images/b", "", ("", "val"), False),
    ("val: images\ntrain: images", "", ("", ""), False),  # as COCO128 has it
    ("val: [images/c, images/b]", "", ("val", "test"), True),
    ("val: val.txt", "./images/b/2.png\n\n", ("", ""), True),
    ("val: val.txt", "./images/b/2.png\n\n", ("train", "val"), False),
    ("val: val.txt", "\n", ("", ""), False),
]


@pytest.mark.parametrize("text, lines, splits, refused", LEAKS)
def test_what_one_validates_on_is_not_trained_on(
    tmp_path: Path, text: str, lines: str, splits: tuple[str, str], refused: bool
) -> None:
    write(tmp_path / "data.yaml", f"{text}\nnames: [fish]\n")
    write(tmp_path / "val.txt", lines)
    table = []
    for name, split in zip(("a/1", "b/2"), splits, strict=True):
        picture = save(tmp_path / f"images/{name}.png", pixels())
        labels = write(tmp_path / f"labels/{name}.txt", ALL)
        table.append(Row(f"images/{name}.png", picture, labels=labels, split=split))
    if refused:
        with pytest.raises(ValueError, match=r"data\.yaml: images/b/2\.png is of val"):
            open_labels(table)
    else:
        open_labels(table)


@pytest.mark.parametrize(
    "line, shape",
    [
        ("0 .25 .5 .4 .9 .2 .5 2 .3 .6 1", [2, 3]),
        ("0 .25 .5 .4 .9 .2 .5", [1, 2]),
        ("0 .25 .5 .4 .9 .2 .5 .3 .6", [2, 2]),
    ],
)
def test_keypoints_of_which_the_number_is_said(tmp_path: Path, line: str, shape: Any) -> None:
    write(tmp_path / "ds/labels/1.txt", f"{line} .97\n{line}\n")  # with confidence, or without
    table = rows(tmp_path / "ds/labels", "1.png")
    with pytest.raises(ValueError, match=f"{tmp_path / 'ds/labels'}: .*{POINTS}"):
        open_labels(table)
    # whoever does as it says
    classes = write(tmp_path / "fish.yaml", f"names: [fish]\nkpt_shape: {shape}\n")
    (boxes,) = labelled(table, tmp_path / "out", classes=classes)
    assert [box.contrast for box in boxes] == pytest.approx([0.9, 0.9])
    assert (tmp_path / "out/labels/1.txt").read_text() == f"{line}\n{line}\n"
    classes.write_text("names: [fish]\nkpt_shape: [9, 3]\n")
    with pytest.raises(ValueError, match="line 1: expected a class, a box and 9 keypoints of 3"):
        labelled(table, tmp_path / "out", classes=classes)


def test_polygons_are_no_keypoints(tmp_path: Path) -> None:
    square = "0 .25 .16667 .625 .16667 .625 .66667 .25 .66667\n"
    write(tmp_path / "labels/1.txt", square)
    other = write(tmp_path / "labels/2.txt", "0 .5 .5 .5 .9 .1 .9\n")
    table = rows(tmp_path / "labels", "1.png", "2.png")
    ((label,), _) = labelled(table, tmp_path / "out")
    assert label.contrast == MIXED
    other.write_text(square)  # which may be a box with points, until a description says otherwise
    with pytest.raises(ValueError, match=POINTS):
        open_labels(table)
    write(tmp_path / "data.yaml", "names: [fish]\n")
    assert labelled(table, tmp_path / "out") == [[label], [label]]


def test_a_sixth_number_is_a_confidence(tmp_path: Path) -> None:
    write(tmp_path / "labels/1.txt", "0 .25 .5 .5 1 .91\n1 .75 .5 .5 1 1\n")
    write(tmp_path / "labels/2.txt", "0 .25 .5 .5 1\n1 .75 .5 .5 1\n")
    table = rows(tmp_path / "labels", "1.png", "2.png")
    with_them, without = labelled(table, tmp_path / "out", None)
    assert with_them == without == [(1, 0.9, True), (2, 0.01, True)]
    # trainers refuse lines of six numbers
    written = [(tmp_path / f"out/labels/{number}.txt").read_bytes() for number in (1, 2)]
    assert written[0] == written[1]


# Masks


def of_colours(values: Any) -> Any:
    """A mask in colour (HxWx3, uint8)."""
    return np.stack([values >> 16, values >> 8 & 255, values & 255], -1).astype(np.uint8)


RED = [255, 0, 0] * 20
BOTH = values_of((0, 5), (2, 7), (7, 200))
KEYS = [(5, 0.9, True), (7, 0.9, True), (200, 0.01, False)]
MASKS: dict[str, tuple[Any, list[int], str, list[tuple[int, float, bool]]]] = {
    # pixels, palette, ending, and objects
    **{f"8 bits {end}": (BOTH.astype(np.uint8), [], end, KEYS) for end in (".png", ".gif")},
    "palette": (BOTH.astype(np.uint8), RED, ".png", KEYS),
    **{f"16 bits {end}": (BOTH.astype(np.uint16), [], end, KEYS) for end in (".png", ".tif")},
    **{f"1 bit {end}": (BOTH > 100, [], end, [(255, 0.01, False)]) for end in (".png", ".bmp")},
    "colour": (
        of_colours(values_of((0, 0x800000), (1, 0xE0E0C0), (7, 0x008000))),
        [],
        ".png",
        [(0x008000, 0.01, False), (0x800000, 0.9, True)],  # the third is to be ignored
    ),
    "grey in colour": (np.repeat(BOTH[..., None], 3, 2).astype(np.uint8), [], ".png", KEYS),
}


@pytest.mark.parametrize("case", MASKS)
def test_masks(tmp_path: Path, case: str) -> None:
    mask, palette, end, expected = MASKS[case]
    (tmp_path / "masks").mkdir()
    image = Image.fromarray(mask)
    if palette:
        image.putpalette(palette)
    image.save(tmp_path / f"masks/1{end}", optimize=False)  # which would renumber a GIF
    (objects,) = labelled(rows(tmp_path / "masks", "1.jpg"), tmp_path / "out")
    assert objects == expected
    far = np.zeros(SIZE, bool)
    far[:, -1] = True
    far = far[..., None] if mask.ndim == 3 else far
    with Image.open(tmp_path / "out/labels/1.png") as written:
        assert written.getpalette() == (image.getpalette() if palette else None)
        pixels = np.array(written.convert("L") if mask.dtype == bool else written)
    assert np.array_equal(pixels, np.where(far, 0, mask * 255 if mask.dtype == bool else mask))


@pytest.mark.parametrize(
    "values, keys",
    [
        ((1, 255), [1]),
        ((2, 18, 255), [2, 18]),
        ((255,), [255]),
        ((85, 170, 255), [85, 170, 255]),
        ((1, 2, 254), [1, 2, 254]),
    ],
)
def test_255_beside_small_values_says_nothing(
    tmp_path: Path, values: tuple[int, ...], keys: list[int]
) -> None:
    mask = values_of(*((-1 - column, value) for column, value in enumerate(values)))
    save(tmp_path / "masks/1.png", mask.astype(np.uint8))
    save(tmp_path / "masks/2.png", np.where(mask == 255, mask, 0).astype(np.uint8))
    objects, alone = labelled(rows(tmp_path / "masks", "1.jpg", "2.jpg"), tmp_path / "out")
    assert [label.key for label in objects] == keys
    is_ignored = 255 in values and 255 not in keys
    assert [label.key for label in alone] == ([255] if 255 in keys else [])
    with Image.open(tmp_path / "out/labels/1.png") as written:  # all is far
        assert np.array_equal(written, np.where(mask == 255, 255 * is_ignored, 0))
