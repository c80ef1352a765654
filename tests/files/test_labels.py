"""Labels beside pictures: read, judged, written where trainers look, read again."""

import io
import json
import os
import pickle
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import torch
import yaml
from filing import content, pixels, save
from PIL import Image

from uwaug.files.formats import FORMATS, open_labels
from uwaug.files.items import Item
from uwaug.files.labels import Judged, Labels, judged
from uwaug.files.summary import Result
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


def png(values: Any, *palette: int) -> bytes:
    file, image = io.BytesIO(), Image.fromarray(values)
    if palette:
        image.putpalette(palette)
    image.save(file, "PNG")
    return file.getvalue()


def write(path: Path, content: str | bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def opened(source: Path, *names: str) -> Labels:
    """The labels of pictures of some names, in a folder beside the labels."""
    return open_labels(source, [Item(name, source.parent / "photos" / name) for name in names])


def done(picture: Path, name: str, place: str, objects: Sequence[Judged] = ()) -> Result:
    """What became of a picture."""
    return Result(Item(name, picture), 0, place, "written", objects=objects)


def finish(labels: Labels, pictures: Sequence[Result], out: Path) -> list[str]:
    """Write the lists of a run; gives what is told."""
    lists, notes = labels.lists(pictures)
    for name, text in lists.items():
        write(out / name, text)
    return notes


def labelled(
    source: Path,
    names: list[str],
    out: Path,
    least: float | None = 0.05,
    notes: list[str] | None = None,
) -> list[list[Judged]]:
    """What a run does with the labels of some pictures, each in a process of its own."""
    labels, pictures = opened(source, *names), []
    out.mkdir(exist_ok=True)
    for name in names:
        own = pickle.loads(pickle.dumps(labels.only(name)))
        objects = judged(own, name, LEFT, least)
        place = labels.place(name)
        own.write(name, place, {one.key for one in objects if not one.kept}, out)
        pictures.append(done(source.parent / "photos" / name, name, place, objects))
    told = finish(labels, pictures, out)
    if notes is not None:
        notes += told
    return [list(picture.objects) for picture in pictures]


# What stands in files says their format


@pytest.mark.parametrize("format", FORMATS)
def test_a_format_says_what_it_reads(
    format: type[Labels], tmp_path: Path, run: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ValueError, match=f"{re.escape(format.reads)}.*: no file such as .*1.txt"):
        opened(tmp_path, "1.jpg")
    monkeypatch.setenv("COLUMNS", "250")
    assert format.reads in run("degrade", "--help")[1]


def test_files_beside_labels_are_of_no_format(tmp_path: Path) -> None:
    masks = tmp_path / "masks"
    save(masks / "1.png", np.full(SIZE, 3, np.uint8))
    for name in ("labelmap.txt", "classes.txt", "readme.txt", "train.txt"):
        write(masks / name, ALL)
    write(masks / "1.txt", "a fish above sand\n")  # a caption
    write(masks / "1.xml", "<annotations><image/></annotations>")  # of CVAT
    write(masks / "export.json", coco())
    (objects,) = labelled(masks, ["1.jpg"], tmp_path / "out")
    assert objects == [(3, pytest.approx(0.455), True)]
    assert not (tmp_path / "out/data.yaml").exists()
    assert (tmp_path / "out/labelmap.txt").read_bytes() == (masks / "labelmap.txt").read_bytes()


def test_a_picture_is_no_mask_of_its_own(tmp_path: Path) -> None:
    picture = save(tmp_path / "images/1.png", np.full(SIZE, 9, np.uint8))
    with pytest.raises(ValueError, match="belong to no picture"):
        open_labels(tmp_path, [Item("images/1.png", picture)])
    save(tmp_path / "labels/1.png", np.full(SIZE, 3, np.uint8))
    labels = open_labels(tmp_path, [Item("images/1.png", picture)])
    assert [one.key for one in judged(labels, "images/1.png", LEFT, None)] == [3]


def test_without_a_limit_labels_stay_as_they_are(tmp_path: Path) -> None:
    write(tmp_path / "labels/1.txt", "0 .75 .5 .5 1")
    assert labelled(tmp_path / "labels", ["1.png"], tmp_path / "out", None) == [[(1, 0.01, True)]]
    assert (tmp_path / "out/labels/1.txt").read_text() == "0 .75 .5 .5 1"


VOC = """<annotation><folder>a</folder><filename>1.jpg</filename><path>/home/me/1.jpg</path>
<size><width>8</width><height>6</height><depth>3</depth></size>
<object><name>near</name><bndbox><xmin>1</xmin><ymin>1</ymin><xmax>4</xmax><ymax>6</ymax></bndbox>
<part><name>fin</name><bndbox><xmin>7</xmin><ymin>1</ymin><xmax>8</xmax><ymax>6</ymax></bndbox></part>
</object><object><name>far</name><bndbox><ymin>1.0</ymin><xmin>5.0</xmin><xmax>8.0</xmax>
<ymax>6.0</ymax></bndbox></object></annotation>"""
HALVES = np.repeat(np.uint8([[0] * 4 + [1] * 4]), H, 0)
SHARES = "expected a class, and shares"
POINTS = "numbers are polygons, or have keypoints: say kpt_shape"
PANOPTIC = {"image_id": 1, "file_name": "a.png", "segments_info": [{"id": 3226956}]}
SAME = {"images": [IMAGES[0], IMAGES[1] | {"id": 1}]}


def first(**changes: Any) -> str:
    """A COCO file whose first image has one object that is changed."""
    return coco(annotations=[ANNOTATIONS[0] | changes])


def image(**changes: Any) -> str:
    """One whose first image is changed, and has no object."""
    return coco(images=[IMAGES[0] | changes], annotations=[])


REFUSED: list[tuple[str, str | bytes, str]] = [
    # file, what it holds, and what is said of it
    ("a.json", "[" * 100_000, "is no COCO file"),
    ("a.json", coco(images=None), "is no COCO file"),
    ("a.json", coco(annotations=[{"id": 1, "image_id": 9}]), "is no COCO file: KeyError.9"),
    ("a.json", coco(images=[{"id": 1}]), "is no COCO file: KeyError.'file_name'"),
    ("a.json", coco(**SAME), "is no COCO file: .* an id of its own"),
    ("a.json", coco(annotations=[{"id": 7, "image_id": 1}]), "annotation 7: KeyError.'bbox'"),
    ("a.json", first(bbox=[1, 2]), "annotation 7: ValueError"),
    ("a.json", first(segmentation=[[0, 1, 2]]), "annotation 7"),
    ("a.json", first(segmentation={"size": SIZE, "counts": [40]}), "annotation 7: .*reshape"),
    ("a.json", first(segmentation={"size": [W, H], "counts": [48]}), r"7: .*lengths of \[8, 6\]"),
    ("a.json", image(width=99), "is of 99×6 px, its picture of 8×6"),
    ("a.json", image(width=H, height=W), "is of 6×8 px, .*, as EXIF .* exchange width"),
    ("a.json", image(file_name="b.jpg"), r"no image .* reef/a.jpg in its split \(there are b.jpg"),
    ("a.json", coco(annotations=[PANOPTIC]), "is a panoptic file: give the folder of its PNGs"),
    ("labels/reef/a.txt", f"{ALL}0 10 20 30 40", f"line 2: {SHARES} of width and height"),
    ("labels/reef/a.txt", f"{ALL}0 nan .5 .5 .5", f"line 2: {SHARES}"),
    ("labels/reef/a.txt", f"{ALL}0 .5 .5", f"line 2: {SHARES}"),
    ("labels/reef/a.txt", f"{ALL}0 .5 .5 .5", f"line 2: {SHARES}"),
    ("labels/reef/a.txt", f"{ALL}fish", "line 2: "),
    ("labels/reef/a.txt", f"{ALL}0 a b c d", "line 2: could not convert"),
    ("labels/reef/a.txt", f"{ALL}0 .5 .5 .2 .2 7", f"line 2: {SHARES}"),
    ("labels/reef/a.txt", f"{ALL}0 .1 .15 .16 .2 .05 .1 2 .12 .2 2", "line 2: .*need a kpt_shape"),
    ("labels/reef/a.txt", f"{ALL}0 .1 .15 .16 .2 .05 .1 1", "line 2: .*need a kpt_shape"),
    ("labels/reef/a.txt", "0 .25 .5 .4 .9 .2 .5 2 .3 .6 1", POINTS),
    ("labels/reef/a.txt", "0 .25 .5 .4 .9 .2 .5", POINTS),
    ("labels/reef/a.txt", "fish .5 .5 1 1\n", "a.txt: could not convert"),
    ("labels/reef/a.xml", "<annotations/>", "a.xml: expected an annotation"),
    ("labels/reef/a.xml", "<annotation", "a.xml: is no XML file"),
    ("labels/reef/a.xml", VOC.replace("<xmin>1</xmin>", ""), "object 1: bndbox must be four"),
    ("labels/reef/a.xml", VOC.replace("5.0", "a"), "object 2: bndbox must be four numbers"),
    ("labels/reef/a.xml", VOC.replace("<width>8", "<width>9"), "is of 9×6 px, its picture of 8×6"),
    ("labels/reef/a.png", png(np.zeros((3, 4), np.uint8)), "is of 4×3 px, its picture of 8×6 px"),
    ("labels/reef/a.png", png(pixels(40, 40)), "a.png: .* colours are"),
    (
        "labels/reef/a.png",
        png(HALVES, 0, 150, 0, 0, 0, 0),
        r"0 is \(0, 150, 0\), and 1 is black: which is backgr",
    ),
]


@pytest.mark.parametrize("name, held, message", REFUSED)
def test_files_that_are_refused(tmp_path: Path, name: str, held: str | bytes, message: str) -> None:
    path = write(tmp_path / name, held)
    source = path if path.suffix == ".json" else tmp_path / "labels"
    with pytest.raises(ValueError, match=message) as refused:
        judged(opened(source, "reef/a.jpg"), "reef/a.jpg", LEFT, None)
    assert str(path) in str(refused.value)


# COCO


def test_coco(tmp_path: Path) -> None:
    file = write(tmp_path / "instances.json", coco())
    objects, _ = labelled(file, ["reef/a.jpg", "photos/b.jpg"], tmp_path / "out")
    found = [(7, 0.9, True), (8, 0.01, False), (9, MIXED, True), (10, 0.0, False)]
    assert objects == found
    written = json.loads((tmp_path / "out/instances.json").read_text())
    assert written["info"] == COCO["info"]
    # trainers find the pictures by their places
    assert written["images"] == [IMAGES[0], {**IMAGES[1], "file_name": "photos/b.jpg"}]
    left = {entry["id"]: entry for entry in written["annotations"]}
    assert left == {
        7: {**ANNOTATIONS[0], "contrast": 0.9},
        9: {**ANNOTATIONS[2], "contrast": MIXED},
        11: {**ANNOTATIONS[4], "contrast": 0.9},
    }
    assert file.read_text() == coco()
    labelled(file, ["b.jpg"], tmp_path / "out")
    assert len(json.loads((tmp_path / "out/instances.json").read_text())["images"]) == 1


def test_pictures_and_images_that_stand_alone_are_left_out_and_counted(tmp_path: Path) -> None:
    file, notes = write(tmp_path / "a.json", coco()), []
    objects = labelled(file, ["b.jpg", "more.jpg"], tmp_path / "out", notes=notes)
    assert objects == [[(11, 0.9, True)], []]
    assert notes == [f"1 of 2 images of {file} have no picture here"]
    written = json.loads((tmp_path / "out/a.json").read_text())
    assert [image["file_name"] for image in written["images"]] == ["b.jpg"]


def test_coco_of_several_pictures_from_one(tmp_path: Path) -> None:
    labels = opened(write(tmp_path / "a.json", coco()), "b.jpg")
    objects = judged(labels, "b.jpg", LEFT, None)
    (tmp_path / "o").mkdir()
    pictures = [done(tmp_path / "b.jpg", "b.jpg", f"b_{i}.png", objects) for i in (1, 2)]
    finish(labels, pictures, tmp_path / "o")
    written = json.loads((tmp_path / "o/a.json").read_text())
    images = [(one["id"], one["file_name"]) for one in written["images"]]
    assert images == [(1, "b_1.png"), (2, "b_2.png")]
    assert [(one["id"], one["image_id"]) for one in written["annotations"]] == [(1, 1), (2, 2)]


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
    labels = opened(write(tmp_path / "a.json", file), "a.jpg")
    ((_, found),) = labels.objects("a.jpg", (40, 30))
    assert np.array_equal(found, mask)


@pytest.mark.parametrize(
    "changes, contrast",
    [
        ({"bbox": [-20, -20, 10, 10]}, 0.0),  # outside
        ({"segmentation": [[1.1, 1.1, 1.3, 1.1, 1.3, 1.2]]}, 0.9),  # a sliver
        ({"segmentation": [[]]}, 0.9),  # none, so that the box counts
    ],
)
def test_odd_objects(tmp_path: Path, changes: dict[str, Any], contrast: float) -> None:
    labels = opened(write(tmp_path / "a.json", first(**changes)), "reef/a.jpg")
    assert judged(labels, "reef/a.jpg", LEFT, None) == [(7, contrast, True)]


def owners(file: Path, *pictures: Path, root: Path) -> dict[str, int]:
    """The id of the image that each picture has."""
    items = [Item(picture.relative_to(root).as_posix(), picture) for picture in pictures]
    labels = open_labels(file, items)
    return {name: image["id"] for name, (image, _) in labels.of.items()}


@pytest.mark.parametrize(
    "file_name, picture, is_of_it",
    [
        ("images/x.jpg", "ds/images/x.jpg", True),
        ("images\\x.jpg", "ds/images/x.jpg", True),
        (".\\images\\train\\x.jpg", "ds/images/train/x.jpg", True),
        ("images/x.jpg", "photos/x.jpg", True),
        ("./x.jpg", "photos/deep/x.jpg", True),
        ("JPEGImages/x.jpg", "ds/images/x.jpg", True),
        ("/home/me/ds/images/x.jpg", "ds/images/x.jpg", True),
        ("C:\\me\\reef\\x.jpg", "elsewhere/reef/x.jpg", True),
        ("reef/x.jpg", "wreck/x.jpg", False),
        ("a/frames/x.jpg", "b/frames/x.jpg", False),
        ("/home/me/reef/x.jpg", "wreck/x.jpg", False),
        ("ax.jpg", "x.jpg", False),
        ("X.jpg", "x.jpg", False),
        ("x.JPG", "photos/x.jpg", True),
        ("e\u0301 1.jpg", "photos/\xe9 1.jpg", True),
        ("images/a%201.jpg", "photos/a 1.jpg", True),
    ],
)
def test_file_names_as_tools_write_them(
    tmp_path: Path, file_name: str, picture: str, is_of_it: bool
) -> None:
    images = [{"id": 3, "file_name": file_name}]
    file, path = write(tmp_path / "a.json", coco(images=images, annotations=[])), tmp_path / picture
    for root in (path.parent, tmp_path):
        if is_of_it:
            assert owners(file, path, root=root) == {path.relative_to(root).as_posix(): 3}
            continue
        with pytest.raises(ValueError, match=r"no image has the file_name .*x.jpg"):
            owners(file, path, root=root)


@pytest.mark.parametrize(
    "file",
    [
        "annotations/instances_train2017.json",
        "train.json",
        "train/_annotations.coco.json",
        "labels/training/all.json",
    ],
)
def test_a_file_of_train_labels_no_picture_of_val(tmp_path: Path, file: str) -> None:
    images = [{"id": 3, "file_name": "1.jpg"}]
    path = write(tmp_path / file, json.dumps({"images": images, "annotations": []}))
    pictures = [tmp_path / place / "1.jpg" for place in ("train", "val2017", "valid", "test")]
    assert owners(path, *pictures, root=tmp_path) == {"train/1.jpg": 3}
    with pytest.raises(ValueError, match=r"no image has the file_name 1.jpg in its split"):
        owners(path, pictures[1], root=pictures[1].parent)


def test_an_image_without_a_folder_is_of_the_picture_that_no_other_names(tmp_path: Path) -> None:
    images = [{"id": 0, "file_name": "1.jpg"}, {"id": 1, "file_name": "reef/1.jpg"}]
    file = write(tmp_path / "a.json", coco(images=images, annotations=[]))
    pictures = [tmp_path / "ds" / name for name in ("1.jpg", "reef/1.jpg")]
    assert owners(file, *pictures, root=tmp_path / "ds") == {"1.jpg": 0, "reef/1.jpg": 1}


def test_an_image_is_of_one_picture(tmp_path: Path) -> None:
    def of(*names: str) -> Path:
        images = [{"id": number, "file_name": name} for number, name in enumerate(names)]
        return write(tmp_path / "a.json", coco(images=images, annotations=[]))

    pictures = [tmp_path / place / "1.jpg" for place in ("reef", "wreck")]
    with pytest.raises(ValueError, match=r"1.jpg may be .*reef/1.jpg or .*wreck/1.jpg: give"):
        owners(of("1.jpg"), *pictures, root=tmp_path)
    # whoever does as it says
    assert owners(of("1.jpg"), pictures[0], root=pictures[0].parent) == {"1.jpg": 0}
    names = ("reef/1.jpg", "wreck/1.jpg")
    assert owners(of(*names), *pictures, root=tmp_path) == {names[0]: 0, names[1]: 1}


# YOLO


YOLO = """\
3 0.25 0.5 0.5 1

1 0.75 0.5 0.5 1.0
0 0.25 0.16667 0.625 0.16667 0.625 0.66667 0.25 0.66667"""


def test_yolo(tmp_path: Path) -> None:
    write(tmp_path / "ds/labels/train/1.txt", YOLO)
    write(tmp_path / "ds/labels/val/2.txt", " \n")
    names = ["images/train/1.png", "images/val/2.png", "images/val/background.png"]
    one, *others = labelled(tmp_path / "ds/labels", names, tmp_path / "out")
    assert one == [(1, 0.9, True), (3, 0.01, False), (4, MIXED, True)]
    assert others == [[], []]
    found = {name: data.decode() for name, data in content(tmp_path / "out").items()}
    lines = YOLO.splitlines()
    assert found == {
        "labels/train/1.txt": f"{lines[0]}\n\n{lines[3]}\n",
        "labels/val/2.txt": " \n",
        "train.txt": "./images/train/1.png\n",
        "val.txt": "./images/val/2.png\n./images/val/background.png\n",
        "data.yaml": "train: train.txt\nval: val.txt\nnc: 4\n",
    }


@pytest.mark.parametrize(
    "name, label, place",
    [
        ("1.png", "labels/1.txt", "images/1.png"),
        ("1.png", "labels/1.TXT", "images/1.png"),
        ("train/1.png", "labels/train/1.txt", "images/train/1.png"),
        ("train/images/1.png", "labels/train/1.txt", "train/images/1.png"),
        ("train/images/1.png", "labels/train/labels/1.txt", "train/images/1.png"),
        ("images/a/images/1.png", "labels/images/a/1.txt", "images/a/images/1.png"),
        ("images.png", "labels/images.txt", "images/images.png"),
    ],
)
def test_trainers_find_labels(tmp_path: Path, name: str, label: str, place: str) -> None:
    write(tmp_path / label, ALL)
    ((one,),) = labelled(tmp_path / "labels", [name], tmp_path / "out")
    assert opened(tmp_path / "labels", name).place(name) == place
    # as Ultralytics' img2label_paths
    picture = str(tmp_path / "out" / place)
    images, labels = f"{os.sep}images{os.sep}", f"{os.sep}labels{os.sep}"
    assert Path(labels.join(picture.rsplit(images, 1)).rsplit(".", 1)[0] + ".txt").is_file()
    assert one.contrast == pytest.approx((0.9 + 0.01) / 2)


CRABS = ["fish", "crab: red"]
NO_VAL = "data.yaml has no val: add a folder of dry pictures to validate on"
KEPT = """\
# some of COCO
path: ../datasets/reef  # root
train: images/train
val:
- images/val
names:
  0: fish
  1: "crab: red"

kpt_shape: [1, 3]
download: |
  import os
  path: none
"""
QUOTED = '"train": here\nval: there\n"names": ["fish", "crab: red"]\nnc: 2'
ROWS = "names:\n- fish\n- 'crab: red'\nnc: 2\npath:\n  a: folder\n\n  b: another\n"
OTHER = {"fish.yaml": "train: a\nnames: [fish, 'crab: red']\n"}
DESCRIBED: dict[str, tuple[dict[str, str], dict[str, Any], str]] = {
    # files beside the folder of labels, what is said in data.yaml but for splits, what is told
    "all but places": (
        {"data.yaml": KEPT},
        {"names": dict(enumerate(CRABS)), "kpt_shape": [1, 3]},
        NO_VAL,
    ),
    "one line": ({"data.yaml": f"{{train: a, names: {CRABS}, nc: 2}}"}, {"nc": 2}, ""),
    "rows": ({"data.yaml": ROWS}, {"nc": 2}, ""),
    "quoted": ({"data.yaml": QUOTED}, {"nc": 2}, ""),
    "another name": (OTHER, {}, "classes are those of {folder}/fish.yaml"),
    "above": ({"../fish.yml": OTHER["fish.yaml"]}, {}, "classes are those of"),
    "among labels": ({"labels/set.yaml": OTHER["fish.yaml"]}, {}, "classes are those of"),
    "beside others": ({**OTHER, "args.yaml": "epochs: 3\n", "odd.yml": "names: [fish"}, {}, ""),
    "lines": ({"labels/classes.txt": "fish\ncrab: red\n\n"}, {}, ""),
    "lines above": ({"obj.names": "fish\ncrab: red\n"}, {}, ""),
    "lines of two": (
        {"labels/classes.txt": "fish\ncrab: red\n", "obj.names": "cod\nray\n"},
        {},
        "classes are those of {folder}/labels/classes.txt, not of {folder}/obj.names",
    ),
    "beside lines of others": (
        {"data.yaml": "names: {0: fish, 1: 'crab: red'}", "labels/classes.txt": "cod\nray\n"},
        {"names": dict(enumerate(CRABS))},
        "classes are those of {folder}/data.yaml, not of {folder}/labels/classes.txt",
    ),
    "lines of another": ({"_darknet.labels": "fish\ncrab: red\n"}, {}, ""),
    "a gap": ({"obj.names": "cod\n\nray\n\n"}, {"names": ["cod", "", "ray"]}, ""),
    "none": (
        {"labels/2.txt": "4.0 .25 .5 .5 1\n"},
        {"names": None, "nc": 5},
        "no names of classes",
    ),
}


@pytest.mark.parametrize("case", DESCRIBED)
def test_classes_and_what_else_is_said_of_a_data_set(tmp_path: Path, case: str) -> None:
    files, said, told = DESCRIBED[case]
    folder = tmp_path / "data/ds"
    # a box, and a keypoint that is no part of it
    line = "0 .25 .5 .5 1 .9 .9 2\n" if "kpt_shape" in said else "0 .25 .5 .5 1\n"
    write(folder / "labels/1.txt", line)
    for name, text in files.items():
        write(folder / name, text)
    names, notes = [f"{number}.png" for number in (1, 2)], []
    (one,), _ = labelled(folder / "labels", names, tmp_path / "out", notes=notes)
    assert one.contrast == 0.9
    expected = {"train": "train.txt", "names": CRABS, **said}
    found = yaml.safe_load((tmp_path / "out/data.yaml").read_text())
    assert found == {name: value for name, value in expected.items() if value is not None}
    if told:
        assert any(told.format(folder=folder) in note for note in notes)
    else:
        assert not any("no names" in note for note in notes)


BOMB = "- &a0 [x,x,x]\n" + "".join(f"- &a{n} [{f'*a{n - 1},' * 9}]\n" for n in range(1, 30))


@pytest.mark.parametrize("text", ["names: [fish", "- fish", BOMB])
def test_what_is_no_data_yaml(tmp_path: Path, text: str) -> None:
    path = write(tmp_path / "data.yaml", text)
    write(tmp_path / "labels/1.txt", ALL)
    with pytest.raises(ValueError, match=re.escape(f"{path}: ")):
        opened(tmp_path / "labels", "1.png")


def test_two_descriptions_are_one_too_many(tmp_path: Path) -> None:
    for name in ("fish.yaml", "crabs.yaml"):
        write(tmp_path / name, "names: [a]\n")
    write(tmp_path / "labels/1.txt", ALL)
    with pytest.raises(ValueError, match=r"more than one .yaml has names: call one data.yaml"):
        opened(tmp_path / "labels", "1.png")
    (tmp_path / "fish.yaml").rename(tmp_path / "data.yaml")
    opened(tmp_path / "labels", "1.png")


EMPTY = "no picture is of the split {0}: {0}.txt lists nothing"
PLACES = "train: [../reef/images, wreck\\images]\nval: ./harbour/images/\ntest: empty\n"
SPLITS: dict[str, tuple[str, dict[str, str], list[str]]] = {
    # data.yaml, the split of each picture, what is told
    "folders": (
        "",
        {
            **{"1.png": "train", "reef/1.png": "train", "valley/1.png": "train"},
            **{"val2017/1.png": "val", "test/1.png": "test"},
        },
        [],
    ),
    **{
        name: ("", {"train/1.png": "train", "val/3.png": "val", f"{name}/2.png": "test"}, [])
        for name in ("Test", "test_set", "testing", "TEST_DATA")
    },
    "no val": ("", {"train/1.png": "train"}, [NO_VAL]),
    "no train": ("", {"val/1.png": "val"}, [EMPTY.format("train")]),
    "described": (
        PLACES,
        {
            **{"reef/images/1.png": "train", "wreck/images/1.png": "train"},
            **{"harbour/images/1.png": "val", "other/images/train/1.png": ""},
        },
        [
            "1 pictures are of no split, and in no list, such as ./other/images/train/1.png",
            EMPTY.format("test"),
        ],
    ),
    "described, below folders called so, too": (
        "train: train\nval: val\n",
        {"images/train/1.png": "train", "images/val/2.png": "val"},
        [],
    ),
    "by lists": (
        "train: train.txt\nval: val.txt\n",
        {"images/train/1.png": "train", "images/val/2.png": "val"},
        [],
    ),
}


@pytest.mark.parametrize("case", SPLITS)
def test_splits(tmp_path: Path, case: str) -> None:
    text, pictures, notes = SPLITS[case]
    root = tmp_path / "train/val/ds"
    write(root / "data.yaml", f"{text}names: [fish]\n")
    for name, split in pictures.items():
        own = name.replace("images", "labels") if "images" in name else f"labels/{name}"
        write((root / own).with_suffix(".txt"), ALL)
        if ".txt" in text:
            write(root / f"{split}.txt", f"./{name}\n" if split == "train" else f"{root}/{name}\n")
    labels = open_labels(root, [Item(name, root / name) for name in pictures])
    (tmp_path / "out").mkdir()
    places = {name: labels.place(name) for name in pictures}
    told = finish(
        labels, [done(root / name, name, places[name]) for name in pictures], tmp_path / "out"
    )
    assert [note for note in told if not note.startswith("classes are those of")] == notes
    for split in {*pictures.values()} - {""}:
        listed = [f"./{places[name]}" for name, own in pictures.items() if own == split]
        assert (tmp_path / f"out/{split}.txt").read_text().splitlines() == listed
    if EMPTY.format("test") in notes:
        assert (tmp_path / "out/test.txt").read_text() == ""


DRY: dict[str, tuple[str, list[str]]] = {
    # what data.yaml says; the dry pictures to validate on, below its folder
    "a folder": ("val: images/val", ["images/val"]),
    "an absolute one": ("val: {ds}/images/val", ["images/val"]),
    "below a path": ("path: images\nval: val", ["images/val"]),
    "below a path of another machine": ("path: /content/ds\nval: images/val", ["images/val"]),
    "as Roboflow's": ("val: ../valid/images", ["valid/images"]),
    "a list": ("val: lists/val.txt", ["lists/val.txt"]),
    "two": ("val: [images/val, valid/images]", ["images/val", "valid/images"]),
    "one of two": ("val: [images/val, elsewhere]", []),
    "elsewhere": ("val: /content/ds/images/val", []),
    "none": ("path: images", []),
}


@pytest.mark.parametrize("case", DRY)
def test_what_one_validates_on_stays_dry(tmp_path: Path, case: str) -> None:
    text, places = DRY[case]
    ds = tmp_path / "ds"
    for name in ("images/val/2.png", "valid/images/2.png", "images/train/1.png"):
        save(ds / name, pixels())
    write(ds / "lists/val.txt", "../images/val/2.png\n")
    write(ds / "labels/train/1.txt", ALL)
    write(ds / "data.yaml", f"train: images/train\n{text.format(ds=ds)}\nnames: [fish]\n")
    labels = open_labels(ds / "labels/train", [Item("1.png", ds / "images/train/1.png")])
    (tmp_path / "wet").mkdir()
    picture = done(ds / "images/train/1.png", "1.png", labels.place("1.png"))
    *_, told = finish(labels, [picture], tmp_path / "wet")
    found = yaml.safe_load((tmp_path / "wet/data.yaml").read_text())
    assert not (tmp_path / "wet/val.txt").exists()
    dry = [str(ds / place) for place in places]
    assert found.get("val", []) == dry
    assert told == (f"val is dry: {', '.join(dry)}" if dry else NO_VAL)


@pytest.mark.parametrize(
    "line, end",
    [
        ("/content/drive/MyDrive/fish/{}", "\n"),
        ("D:\\annotated\\{}  ", "\r\n\r\n"),
        ("data/{}", "\n"),
        ("../ds/{}", ""),
    ],
)
@pytest.mark.parametrize("folder", ["images", "obj_train_data", "deep/images/sea"])
def test_lists_that_another_machine_has_written(
    tmp_path: Path, line: str, end: str, folder: str
) -> None:
    names = [f"{folder}/{number}.png" for number in range(3)]
    where = "D:\\fish\\lists\\" if "\\" in line else "/fish/lists/"
    write(tmp_path / "data.yaml", f"train: {where}train.txt\nval: {where}val.txt\nnames: [fish]\n")
    for name in names:
        write((tmp_path / name.replace("images", "labels")).with_suffix(".txt"), ALL)
    for split, listed, coding in (("train", names[:2], "utf-8-sig"), ("val", names[2:], "utf-16")):
        paths = [name.replace("/", "\\") if "\\" in line else name for name in listed]
        text = "".join(line.format(path) + (end or "\n") for path in paths)
        (tmp_path / "lists").mkdir(exist_ok=True)
        (tmp_path / f"lists/{split}.txt").write_bytes(text.encode(coding))
    labels = opened(tmp_path, *names)
    assert isinstance(labels, Yolo)
    assert labels.splits == {names[0]: ["train"], names[1]: ["train"], names[2]: ["val"]}
    assert labels.only(names[0]).splits == {}  # is sent with each picture


PAIR = "images/0.png images/1.png"
OF_LISTS: list[tuple[str, str, str, Any]] = [
    # lines of train, and of val; pictures; their splits, or why they are refused
    ("/a/images/0.png", "/a/photos/1.png", PAIR, "of the list of val, is the end of no picture"),
    ("/a/deep/0.png", "/a/images/1.png", PAIR, "of the list of train, is the end of no picture"),
    ("/a/images/0.png", "", PAIR, [["train"], []]),  # an empty list says that nothing is of it
    ("/a/images/0.png", "/b/images/0.png", PAIR, "may be /a/images/0.png or /b/images/0.png"),
    ("/a/images/0.png ./images/1.png", "/a/images/0.png", PAIR, [["train", "val"], ["train"]]),
    ("/c/images/0.png", "", "a/images/0.png b/images/0.png", r"may be .*a/images.* or .*b/images"),
    # a list of train names no picture of val
    ("/c/train/images/0.png", "", "val/images/0.png a/images/0.png", [[], ["train"]]),
    # other pictures of the same names
    (
        "/data/a/images/0.png /data/b/images/1.png",
        "/data/b/images/2.png",
        "b/images/0.png b/images/1.png b/images/2.png",
        [[], ["train"], ["val"]],
    ),
]


@pytest.mark.parametrize("train, val, names, expected", OF_LISTS)
def test_whose_a_line_is(tmp_path: Path, train: str, val: str, names: str, expected: Any) -> None:
    write(tmp_path / "data.yaml", "train: train.txt\nval: val.txt\nnames: [fish]\n")
    write(tmp_path / "train.txt", "\n".join(train.split()))
    write(tmp_path / "val.txt", val)
    for name in names.split():
        write((tmp_path / name.replace("images", "labels")).with_suffix(".txt"), ALL)
    if isinstance(expected, str):
        with pytest.raises(ValueError, match=expected):
            opened(tmp_path, *names.split())
        return
    labels = opened(tmp_path, *names.split())
    assert isinstance(labels, Yolo)
    assert list(labels.splits.values()) == expected


def test_folders_that_another_machine_has_named(tmp_path: Path) -> None:
    write(
        tmp_path / "data.yaml", "train: /content/a/images\nval: D:\\x\\b\\images\nnames: [fish]\n"
    )
    names = ["a/images/0.png", "b/images/1.png", "c/images/2.png"]
    write(tmp_path / "a/labels/0.txt", ALL)
    labels = opened(tmp_path, *names)
    assert isinstance(labels, Yolo)
    assert list(labels.splits.values()) == [["train"], ["val"], []]


POSES = {
    "0 .25 .5 .4 .9 .2 .5 2 .3 .6 1": [2, 3],
    "0 .25 .5 .4 .9 .2 .5 1": [1, 3],
    "0 .25 .5 .4 .9 .2 .5": [1, 2],
    "0 .25 .5 .4 .9 .2 .5 .3 .6": [2, 2],
}


@pytest.mark.parametrize("line", POSES)
def test_keypoints_of_which_the_number_is_said(tmp_path: Path, line: str) -> None:
    write(tmp_path / "ds/labels/1.txt", f"{line}\n")
    with pytest.raises(ValueError, match=POINTS):
        opened(tmp_path / "ds/labels", "1.png")
    # whoever does as it says
    write(tmp_path / "ds/labels/data.yaml", f"names: [fish]\nkpt_shape: {POSES[line]}\n")
    ((one,),) = labelled(tmp_path / "ds/labels", ["1.png"], tmp_path / "out")
    assert one.contrast == pytest.approx(0.9)
    assert (tmp_path / "out/labels/1.txt").read_text() == f"{line}\n"


def test_keypoints_by_any_description(tmp_path: Path) -> None:
    write(tmp_path / "fish-pose.yaml", "kpt_shape: [2, 3]\nnames: [fish]\n")
    lines = "0 .25 .5 .4 .9 .9 .5 2 .3 .6 1\n0 .75 .5 .4 .9 .7 .5 2 .8 .6 0 .97\n"
    path = write(tmp_path / "labels/1.txt", lines)
    ((seen, hidden),) = labelled(tmp_path / "labels", ["1.png"], tmp_path / "out", None)
    assert (seen.contrast, hidden.contrast) == (0.9, 0.01)
    assert (tmp_path / "out/labels/1.txt").read_text() == lines.replace(" .97", "")
    path.write_text("0 .25 .5 .4 .9 .9 .5 2\n")
    with pytest.raises(ValueError, match="a box and 2 keypoints of 3 numbers each, got 8 numbers"):
        judged(opened(tmp_path / "labels", "1.png"), "1.png", LEFT, None)


def test_polygons_are_no_keypoints(tmp_path: Path) -> None:
    square = "0 .25 .16667 .625 .16667 .625 .66667 .25 .66667\n"
    write(tmp_path / "labels/1.txt", square)
    other = write(tmp_path / "labels/2.txt", "0 .5 .5 .5 .9 .1 .9\n")
    names = ["1.png", "2.png"]
    ((one,), _) = labelled(tmp_path / "labels", names, tmp_path / "out")
    assert one.contrast == MIXED
    other.write_text(square)  # which may be a box with points, until a description says otherwise
    with pytest.raises(ValueError, match="or of polygons nothing but names") as refused:
        opened(tmp_path / "labels", *names)
    assert "in " + str(tmp_path / "labels/data.yaml") in str(refused.value)
    write(tmp_path / "labels/data.yaml", "names: [fish]\n")
    assert labelled(tmp_path / "labels", names, tmp_path / "out") == [[one], [one]]


def test_a_sixth_number_is_a_confidence(tmp_path: Path) -> None:
    write(tmp_path / "labels/1.txt", "0 .25 .5 .5 1 .91\n1 .75 .5 .5 1 1\n")
    write(tmp_path / "labels/2.txt", "0 .25 .5 .5 1\n1 .75 .5 .5 1\n")
    with_them, without = labelled(tmp_path / "labels", ["1.png", "2.png"], tmp_path / "out", None)
    assert with_them == without == [(1, 0.9, True), (2, 0.01, True)]
    # trainers refuse lines of six numbers
    written = [(tmp_path / f"out/labels/{number}.txt").read_bytes() for number in (1, 2)]
    assert written[0] == written[1]


# Pascal VOC


def names_in(file: Path) -> list[str]:
    return [entry.findtext("name", "") for entry in ElementTree.parse(file).iter("object")]


@pytest.mark.parametrize(
    "name, labels, file",
    [
        ("1.jpg", "voc/Annotations", "voc/Annotations/1.xml"),
        ("1.jpg", "voc", "voc/Annotations/1.xml"),
        ("JPEGImages/1.jpg", "voc", "voc/Annotations/1.xml"),
        ("train/1.jpg", "voc", "voc/train/1.xml"),
        ("1.jpg", "box", "box/1.xml"),
    ],
)
def test_voc(tmp_path: Path, name: str, labels: str, file: str) -> None:
    write(tmp_path / file, VOC)
    ((near, far),) = labelled(tmp_path / labels, [name], tmp_path / "out")
    assert (near, far) == ((1, 0.9, True), (2, 0.01, False))
    own = name.removeprefix("JPEGImages/").removesuffix(".jpg")
    assert names_in(tmp_path / f"out/Annotations/{own}.xml") == ["near"]
    assert opened(tmp_path / labels, name).place(name) == f"JPEGImages/{own}.jpg"
    assert (tmp_path / "out/ImageSets/Main/train.txt").read_text() == f"{own}\n"


@pytest.mark.parametrize("size", ["", "<size><width>0</width><height>0</height></size>"])
def test_voc_without_a_size(tmp_path: Path, size: str) -> None:
    stated = VOC[VOC.index("<size>") : VOC.index("<object>")]
    write(tmp_path / "voc/1.xml", VOC.replace(stated, size))
    assert len(judged(opened(tmp_path / "voc", "1.jpg"), "1.jpg", LEFT, None)) == 2


def test_lists_of_a_class_that_is_lost(tmp_path: Path) -> None:
    write(tmp_path / "voc/Annotations/1.xml", VOC)
    for name, line in (("train", "1"), ("near_train", "1  1"), ("far_train", "1  1")):
        write(tmp_path / f"voc/ImageSets/Main/{name}.txt", f"{line}\n")
    labelled(tmp_path / "voc", ["1.jpg"], tmp_path / "out")
    written = tmp_path / "out/ImageSets/Main"
    assert {path.stem: path.read_text() for path in written.iterdir()} == {
        "train": "1\n",
        "near_train": "1  1\n",
        "far_train": "1 -1\n",
    }


def test_voc_of_variants_and_lists(tmp_path: Path) -> None:
    lists = {"train": "reef 1\n", "val": "2\n", "fish_train": "reef 1  1\n2 -1\n9  1\n"}
    for own, text in {**lists, "test": "9\n"}.items():
        write(tmp_path / f"voc/ImageSets/Main/{own}.txt", f"\ufeff{text}")
    for name in ("reef 1", "2"):
        write(tmp_path / f"voc/Annotations/{name}.xml", VOC)
    labels = opened(tmp_path / "voc/Annotations", "reef 1.jpg", "2.jpg")
    pictures = []
    (tmp_path / "out").mkdir()
    for name, variant in (("reef 1", 1), ("reef 1", 2), ("2", 1)):
        place = f"JPEGImages/{name}_{variant}.jpg"
        labels.write(f"{name}.jpg", place, (), tmp_path / "out")
        pictures.append(done(tmp_path, f"{name}.jpg", place))
    told = finish(labels, pictures, tmp_path / "out")
    written = tmp_path / "out/ImageSets/Main"
    assert {path.stem: path.read_text() for path in written.iterdir()} == {
        "train": "reef 1_1\nreef 1_2\n",
        "val": "2_1\n",
        "fish_train": "reef 1_1  1\nreef 1_2  1\n2_1 -1\n",
        "test": "",
    }
    assert told == ["no picture is in the list test.txt"]
    root = ElementTree.parse(tmp_path / "out/Annotations/2_1.xml").getroot()
    assert (root.findtext("filename"), root.findtext("path")) == ("2_1.jpg", "2_1.jpg")
    assert names_in(tmp_path / "out/Annotations/2_1.xml") == ["near", "far"]


# Masks


@pytest.mark.parametrize("ending", ["png", "bmp", "tif"])
def test_masks_of_one_bit_are_black_and_white(tmp_path: Path, ending: str) -> None:
    values = np.zeros(SIZE, bool)
    values[:, 0] = True
    (tmp_path / "masks").mkdir()
    Image.fromarray(values).save(tmp_path / f"masks/1.{ending}")
    (objects,) = labelled(tmp_path / "masks", ["1.jpg"], tmp_path / "out")
    assert objects == [(255, 0.9, True)]
    with Image.open(tmp_path / "out/labels/1.png") as written:
        assert np.array_equal(written.convert("L"), 255 * values)


def test_masks_of_several_pages_are_refused(tmp_path: Path) -> None:
    pages = [Image.fromarray(np.full(SIZE, value, np.uint8)) for value in (1, 2)]
    (tmp_path / "masks").mkdir()
    pages[0].save(tmp_path / "masks/1.tif", save_all=True, append_images=pages[1:])
    with pytest.raises(ValueError, match="expected one mask, got 2"):
        labelled(tmp_path / "masks", ["1.jpg"], tmp_path / "out")


@pytest.mark.parametrize("dtype, palette", [("uint8", False), ("uint8", True), ("uint16", False)])
def test_masks(tmp_path: Path, dtype: str, palette: bool) -> None:
    values = np.zeros(SIZE, dtype)
    values[:, 0], values[:, -1], values[1:4, 2:5] = 5, 200, 7
    (tmp_path / "masks").mkdir()
    image = Image.fromarray(values)
    if palette:
        image.putpalette([255, 0, 0] * 20)
    image.save(tmp_path / "masks/1.png")
    (objects,) = labelled(tmp_path / "masks", ["1.jpg"], tmp_path / "out")
    assert objects == [(5, 0.9, True), (7, MIXED, True), (200, 0.01, False)]
    with Image.open(tmp_path / "out/labels/1.png") as written:
        assert written.getpalette() == image.getpalette()
        assert np.array_equal(written, np.where(values == 200, 0, values))


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
    mask = np.zeros(SIZE, np.uint8)
    for column, value in enumerate(values):
        mask[:, -1 - column] = value
    save(tmp_path / "masks/1.png", mask)
    save(tmp_path / "masks/2.png", np.where(mask == 255, mask, 0).astype(np.uint8))
    notes: list[str] = []
    objects, alone = labelled(tmp_path / "masks", ["1.jpg", "2.jpg"], tmp_path / "out", notes=notes)
    assert [one.key for one in objects] == keys
    ignored = 255 in values and 255 not in keys
    assert [one.key for one in alone] == ([255] if 255 in keys else [])
    assert ["255" in note for note in notes] == [True] * ignored
    with Image.open(tmp_path / "out/labels/1.png") as written:  # all is far
        assert np.array_equal(written, np.where(mask == 255, 255 * ignored, 0))


def test_255_says_nothing_in_masks_that_nobody_looked_at(tmp_path: Path) -> None:
    names = [f"{i:03}.jpg" for i in range(40)]
    mask = np.zeros(SIZE, np.uint8)
    mask[:, -1] = 1
    for name in names:
        save(tmp_path / "masks" / name.replace("jpg", "png"), mask)
    mask[:, -2] = 255
    save(tmp_path / "masks/001.png", mask)
    objects = labelled(tmp_path / "masks", names, tmp_path / "out")
    assert [[label.key for label in of] for of in objects] == [[1]] * 40
    with Image.open(tmp_path / "out/labels/001.png") as written:
        assert np.unique(written).tolist() == [0, 255]


def test_masks_in_colour(tmp_path: Path) -> None:
    mask = np.zeros((*SIZE, 3), np.uint8)
    mask[:, 0], mask[:, 1], mask[:, -1] = (128, 0, 0), (224, 224, 192), (0, 128, 0)
    save(tmp_path / "cvat/SegmentationClass/1.png", mask)
    grey = np.repeat(mask[..., :1], 3, 2)  # an image library's way to write one channel
    save(tmp_path / "cvat/SegmentationClass/2.png", grey)
    write(tmp_path / "cvat/labelmap.txt", "fish:128,0,0::\n")
    colours, values = labelled(tmp_path / "cvat", ["1.jpg", "2.jpg"], tmp_path / "out")
    assert colours == [(0x008000, 0.01, False), (0x800000, 0.9, True)]
    assert values == [(128, 0.9, True), (224, 0.9, True)]
    mask[:, -1] = 0
    with Image.open(tmp_path / "out/labels/1.png") as written:
        assert np.array_equal(written, mask)
    assert (tmp_path / "out/labelmap.txt").read_text() == "fish:128,0,0::\n"


# Text


@pytest.mark.parametrize("code, words", [("cp1252", "Müll\nHöhle\n"), ("cp950", "海參\n")])
def test_text_in_another_code_page_is_named(tmp_path: Path, code: str, words: str) -> None:
    write(tmp_path / "labels/1.txt", ALL)
    for name in ("classes.txt", "data.yaml"):
        file = write(tmp_path / "labels" / name, "")
        file.write_bytes(b"names: " * (name != "classes.txt") + words.encode(code))
        with pytest.raises(ValueError, match=rf"{name}: is no"):
            opened(tmp_path / "labels", "1.png")
        file.unlink()


OTHERS = {
    "lvis.json": '{"images": [{"id": 1, "coco_url": "http://a/train/1.jpg"}], "annotations": []}',
    "vis.json": '{"videos": [{"id": 1, "file_names": ["1.jpg"]}], "annotations": []}',
    "sa/1.json": '{"image": {"file_name": "1.jpg"}, "annotations": []}',
    "all.jsonl": '{"image": "1.jpg", "boxes": []}\n{"image": "2.jpg", "boxes": []}\n',
    "MOT17/gt.txt": "1,1,4,5,20,30,1,1,1\n",
    "dota/1.txt": "imagesource:GoogleEarth\ngsd:0.1\n1 1 9 1 9 9 1 9 ship 0\n",
    "kitti/1.txt": "Car 0.00 0 -1.58 58 17 61 20 1.6 1.6 3.6 -6 1.7 46 -1.5\n",
    "visdrone/1.txt": "684,8,273,116,0,0,0,0\n",
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_formats_are_named_with_a_cure(tmp_path: Path, name: str) -> None:
    write(tmp_path / name, OTHERS[name])
    with pytest.raises(ValueError, match=r"/gt\.txt is MOT's" if "MOT" in name else name):
        opened(tmp_path / name.partition("/")[0], "1.jpg")
    is_text = name.endswith("/1.txt")
    others = (
        "expected class cx cy w h; DOTA, KITTI" if is_text else "LVIS .*YouTube-VIS, SA-1B, .*MOT"
    )
    with pytest.raises(ValueError, match=rf"{name}: .*{others}"):
        opened(tmp_path / (name.partition("/")[0] if "/1." in name else name), "1.jpg")


@pytest.mark.parametrize(
    "file, pattern",
    [
        ("1.bmp", ""),
        ("1_segmentation.gif", ""),
        ("1_mask.TIF", ""),
        ("1-labels.png", "{stem}-labels.png"),
        ("sub/1_gt.bmp", "{stem}_gt.bmp"),
    ],
)
def test_masks_by_other_names(tmp_path: Path, file: str, pattern: str) -> None:
    values = np.zeros(SIZE, np.uint8)
    values[:, 0], values[:, -1] = 1, 2
    (tmp_path / "masks/sub").mkdir(parents=True)
    Image.fromarray(values).save(tmp_path / "masks" / file)
    name = "sub/1.jpg" if "sub" in file else "1.jpg"
    (objects,) = labelled(tmp_path / "masks" / pattern, [name], tmp_path / "out")
    assert [one.key for one in objects] == [1, 2]
    with Image.open(tmp_path / "out/labels" / name.replace("jpg", "png")) as written:
        assert np.array_equal(written, np.where(values == 2, 0, values))
    with pytest.raises(ValueError, match=r"no file such as .*found 1 files ending in \."):
        opened(tmp_path / "masks", "2.jpg")


@pytest.mark.parametrize("stated", ["a%20b.jpg", "/data/local-files/?d=reef%2Fa%20b.jpg"])
def test_names_in_percent_signs_are_those_of_pictures(tmp_path: Path, stated: str) -> None:
    image = {"id": 1, "file_name": stated}
    write(tmp_path / "l.json", json.dumps({"images": [image], "annotations": []}))
    assert list(opened(tmp_path / "l.json", "reef/a b.jpg").of) == ["reef/a b.jpg"]
    write(tmp_path / "voc/Annotations/a b.xml", VOC)
    write(tmp_path / "voc/ImageSets/Main/val.txt", "a%20b\n")
    labelled(tmp_path / "voc", ["a b.jpg"], tmp_path / "out")
    assert (tmp_path / "out/ImageSets/Main/val.txt").read_text() == "a b\n"
