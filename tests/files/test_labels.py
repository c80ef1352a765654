"""Labels beside pictures: read, judged, written where trainers look, read again."""

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

H, W = 6, 8
SIZE = (H, W)
SQUARE = [[2, 1, 5, 1, 5, 4, 2, 4]]  # columns 2…4, rows 1…3
MIXED = round((2 * 0.9 + 0.01) / 3, 4)
"""Of the square: two of its three columns are in the left half."""

LEFT = torch.full((1, H, W), 0.9)
LEFT[..., W // 2 :] = 0.01
"""A map of contrast."""

RIGHT = np.zeros(SIZE, bool)
RIGHT[2:5, 5:7] = True

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


def coco(folder: Path, **changes: Any) -> Path:
    path = folder / "instances.json"
    path.write_text(json.dumps({**COCO, **changes}))
    return path


def runs(**segmentation: Any) -> dict[str, Any]:
    return {"annotations": [ANNOTATIONS[0] | {"segmentation": segmentation}]}


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def opened(source: Path, *names: str) -> Labels:
    """The labels of pictures of some names, in a folder beside the labels."""
    return open_labels(source, [Item(name, source.parent / "photos" / name) for name in names])


def done(picture: Path, name: str, place: str, objects: Sequence[Judged] = ()) -> Result:
    """What became of a picture."""
    return Result(Item(name, picture), 0, place, "written", objects=objects)


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
    told = labels.finish(pictures, out)
    if notes is not None:
        notes += told
    return [list(picture.objects) for picture in pictures]


def test_coco(tmp_path: Path) -> None:
    before = coco(tmp_path).read_bytes()
    objects, _ = labelled(
        tmp_path / "instances.json", ["reef/a.jpg", "photos/b.jpg"], tmp_path / "out"
    )
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
    assert (tmp_path / "instances.json").read_bytes() == before
    with pytest.raises(ValueError, match="is read, and would be written over"):
        labelled(tmp_path / "instances.json", ["b.jpg"], tmp_path)


def test_coco_of_several_pictures_from_one(tmp_path: Path) -> None:
    labels = opened(coco(tmp_path), "b.jpg")
    objects = judged(labels, "b.jpg", LEFT, None)
    (tmp_path / "o").mkdir()
    pictures = [done(tmp_path / "b.jpg", "b.jpg", f"b_{i}.png", objects) for i in (1, 2)]
    labels.finish(pictures, tmp_path / "o")
    written = json.loads((tmp_path / "o/instances.json").read_text())
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
        pixels = np.flatnonzero(np.diff(np.r_[0, mask.flatten("F"), 0]))
        runs = np.diff(np.r_[0, pixels]).tolist()
        runs += [mask.size - sum(runs)]
    entry = {"id": 1, "image_id": 1, "segmentation": {"size": [40, 30], "counts": runs}}
    image = {"id": 1, "file_name": "a.jpg"}
    labels = opened(coco(tmp_path, images=[image], annotations=[entry]), "a.jpg")
    ((_, found),) = labels.objects("a.jpg", (40, 30))
    assert np.array_equal(found, mask)


YOLO = """\
3 0.25 0.5 0.5 1

1 0.75 0.5 0.5 1.0
0 0.25 0.16667 0.625 0.16667 0.625 0.66667 0.25 0.66667"""


def test_yolo(tmp_path: Path) -> None:
    write(tmp_path / "ds/labels/train/1.txt", YOLO)
    write(tmp_path / "ds/labels/val/2.txt", " \n")
    names = ["images/train/1.png", "images/val/2.png", "images/val/background.png"]
    first, *others = labelled(tmp_path / "ds/labels", names, tmp_path / "out")
    assert first == [(1, 0.9, True), (3, 0.01, False), (4, MIXED, True)]
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
        ("train/1.png", "labels/train/1.txt", "images/train/1.png"),
        ("train/images/1.png", "labels/train/1.txt", "train/images/1.png"),
        ("train/images/1.png", "labels/train/labels/1.txt", "train/images/1.png"),
        ("images/a/images/1.png", "labels/images/a/1.txt", "images/a/images/1.png"),
        ("images.png", "labels/images.txt", "images/images.png"),
    ],
)
def test_trainers_find_labels(tmp_path: Path, name: str, label: str, place: str) -> None:
    write(tmp_path / label, "0 .5 .5 1 1\n")
    ((one,),) = labelled(tmp_path / "labels", [name], tmp_path / "out")
    assert opened(tmp_path / "labels", name).place(name) == place
    # as Ultralytics' img2label_paths
    picture = str(tmp_path / "out" / place)
    images, labels = f"{os.sep}images{os.sep}", f"{os.sep}labels{os.sep}"
    assert Path(labels.join(picture.rsplit(images, 1)).rsplit(".", 1)[0] + ".txt").is_file()
    assert one.contrast == pytest.approx((0.9 + 0.01) / 2)


def test_splits_are_those_of_folders(tmp_path: Path) -> None:
    write(tmp_path / "labels/1.txt", "0 .5 .5 1 1\n")
    names = ["1.png", "reef/1.png", "val2017/1.png", "valley/1.png", "test/1.png"]
    labelled(tmp_path / "labels", names, tmp_path / "out")
    found = {
        split: (tmp_path / f"out/{split}.txt").read_text() for split in ("train", "val", "test")
    }
    assert found == {
        "train": "./images/1.png\n./images/reef/1.png\n./images/valley/1.png\n",
        "val": "./images/val2017/1.png\n",
        "test": "./images/test/1.png\n",
    }


def test_what_a_data_yaml_says_but_for_places_is_kept(tmp_path: Path) -> None:
    text = """\
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
    write(tmp_path / "ds/data.yaml", text)
    # a box, and a keypoint that is no part of it
    write(tmp_path / "ds/labels/1.txt", "0 .25 .5 .5 1 .9 .9 2\n")
    ((one,),) = labelled(tmp_path / "ds/labels", ["1.png"], tmp_path / "out")
    assert one.contrast == 0.9
    assert yaml.safe_load((tmp_path / "out/data.yaml").read_text()) == {
        "train": "train.txt",
        "val": "val.txt",
        "names": {0: "fish", 1: "crab: red"},
        "kpt_shape": [1, 3],
    }


@pytest.mark.parametrize(
    "text",
    [
        "{train: images/train, val: images/val, names: [fish, 'crab: red'], nc: 2}\n",
        "names:\n- fish\n- 'crab: red'\nnc: 2\npath:\n  a: folder\n\n  b: another\n",
        '"train": here\nval: there\n"names": ["fish", "crab: red"]\nnc: 2',
    ],
)
def test_data_yaml_in_any_style(tmp_path: Path, text: str) -> None:
    write(tmp_path / "ds/data.yaml", text)
    write(tmp_path / "ds/labels/1.txt", "0 .25 .5 .5 1\n")
    labelled(tmp_path / "ds/labels", ["1.png"], tmp_path / "out")
    assert yaml.safe_load((tmp_path / "out/data.yaml").read_text()) == {
        "train": "train.txt",
        "val": "val.txt",
        "names": ["fish", "crab: red"],
        "nc": 2,
    }


@pytest.mark.parametrize("text", ["names: [fish", "- fish"])
def test_what_is_no_data_yaml(tmp_path: Path, text: str) -> None:
    path = write(tmp_path / "data.yaml", text)
    write(tmp_path / "labels/1.txt", "0 .25 .5 .5 1\n")
    with pytest.raises(ValueError, match=r"data\.yaml: ") as refused:
        labelled(tmp_path / "labels", ["1.png"], tmp_path / "out")
    assert str(path) in str(refused.value)


@pytest.mark.parametrize("format", FORMATS)
def test_a_format_says_what_it_reads(
    format: type[Labels], tmp_path: Path, run: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ValueError, match=re.escape(format.reads)):
        opened(tmp_path, "1.jpg")
    monkeypatch.setenv("COLUMNS", "250")
    assert format.reads in run("degrade", "--help")[1]


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
        assert np.array_equal(written, np.where(values == 200, 0, values))


def test_without_a_limit_labels_stay_as_they_are(tmp_path: Path) -> None:
    write(tmp_path / "labels/1.txt", "0 .75 .5 .5 1")
    assert labelled(tmp_path / "labels", ["1.png"], tmp_path / "out", None) == [[(1, 0.01, True)]]
    assert (tmp_path / "out/labels/1.txt").read_text() == "0 .75 .5 .5 1"


def test_slivers_and_what_lies_outside(tmp_path: Path) -> None:
    outside = {**ANNOTATIONS[0], "bbox": [-20, -20, 10, 10]}
    sliver = {**ANNOTATIONS[2], "segmentation": [[1.1, 1.1, 1.3, 1.1, 1.3, 1.2]]}
    labels = opened(coco(tmp_path, annotations=[outside, sliver]), "reef/a.jpg")
    assert judged(labels, "reef/a.jpg", LEFT, None) == [(7, 0.0, True), (9, 0.9, True)]


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"images": None}, "is no COCO file"),
        ({"annotations": [{"id": 1, "image_id": 9}]}, "is no COCO file: KeyError.9"),
        ({"images": [{"id": 1}]}, "is no COCO file: KeyError.'file_name'"),
        ({"images": [IMAGES[0], IMAGES[1] | {"id": 1}]}, "is no COCO file: .* an id of its own"),
        ({"annotations": [{"id": 7, "image_id": 1}]}, "annotation 7: KeyError.'bbox'"),
        ({"annotations": [ANNOTATIONS[0] | {"bbox": [1, 2]}]}, "annotation 7: ValueError"),
        ({"annotations": [ANNOTATIONS[0] | {"segmentation": [[0, 1, 2]]}]}, "annotation 7"),
        (runs(size=[H, W], counts=[40]), "annotation 7: ValueError.*reshape"),
        (runs(size=[W, H], counts=[48]), r"annotation 7: .*run lengths of \[8, 6\] px"),
        (
            {"images": [IMAGES[0] | {"width": 99}], "annotations": []},
            "is of 99×6 px, its picture of 8×6",
        ),
        (
            {"images": IMAGES[1:], "annotations": []},
            r"no image .* reef/a.jpg in its split \(there are b.jpg",
        ),
    ],
)
def test_bad_coco_files(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = coco(tmp_path, **changes)
    with pytest.raises(ValueError, match=message) as refused:
        judged(opened(path, "reef/a.jpg"), "reef/a.jpg", LEFT, None)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize(
    "line, message",
    [
        ("0 10 20 30 40", "expected a class, and shares of width and height"),
        ("0 nan .5 .5 .5", "expected a class, and shares"),
        ("0 .5 .5", "expected a class, and shares"),
        ("0 .5 .5 .5", "expected a class, and shares"),
        ("fish", ""),
        ("0 .5 .5 .2 .2 7", "expected a class, and shares"),
        ("0 .1 .15 .16 .2 .05 .1 2 .12 .2 2", "keypoints need a kpt_shape in data.yaml"),
        ("0 .1 .15 .16 .2 .05 .1 1", "keypoints need a kpt_shape in data.yaml"),
        ("0 a b c d", "could not convert"),
    ],
)
def test_bad_yolo_files(tmp_path: Path, line: str, message: str) -> None:
    path = write(tmp_path / "labels/1.txt", f"0 .5 .5 1 1\n{line}\n")
    with pytest.raises(ValueError, match=f"line 2: .*{message}") as refused:
        judged(opened(tmp_path / "labels", "1.png"), "1.png", LEFT, None)
    assert str(path) in str(refused.value)


def test_folders_without_labels(tmp_path: Path) -> None:
    with pytest.raises(
        ValueError,
        match=r"must be a COCO file .* a folder of YOLO.* of .* masks: no file such .*a.txt",
    ):
        opened(tmp_path, "a.jpg")
    (tmp_path / "a.json").write_text("[" * 100_000)
    with pytest.raises(ValueError, match="is no COCO file"):
        opened(tmp_path / "a.json", "a.jpg")
    Image.fromarray(np.zeros((3, 4), np.uint8)).save(tmp_path / "a.png")
    with pytest.raises(ValueError, match=r"a.png: is of 4×3 px, its picture of 8×6 px"):
        judged(opened(tmp_path, "a.png"), "a.png", LEFT, None)


# What stands in files says their format


def test_files_beside_labels_are_of_no_format(tmp_path: Path) -> None:
    masks = tmp_path / "masks"
    save(masks / "1.png", np.full(SIZE, 3, np.uint8))
    for name in ("labelmap.txt", "classes.txt", "readme.txt", "train.txt"):
        write(masks / name, "0 .5 .5 1 1\n")
    write(masks / "1.txt", "a fish above sand\n")  # a caption
    write(masks / "1.xml", "<annotations><image/></annotations>")  # of CVAT
    write(masks / "export.json", json.dumps(COCO))
    (objects,) = labelled(masks, ["1.jpg"], tmp_path / "out")
    assert objects == [(3, pytest.approx(0.455), True)]
    assert not (tmp_path / "out/data.yaml").exists()
    assert (tmp_path / "out/labelmap.txt").read_bytes() == (masks / "labelmap.txt").read_bytes()


def test_labels_of_no_format_say_why(tmp_path: Path) -> None:
    save(tmp_path / "1.png", pixels(40, 40))
    write(tmp_path / "1.txt", "fish .5 .5 1 1\n")
    write(tmp_path / "1.xml", "<annotations/>")
    expected = "1.txt: could not convert .*1.xml: expected an annotation .*1.png: .* colours are"
    with pytest.raises(ValueError, match=expected):
        opened(tmp_path, "1.jpg")
    write(tmp_path / "1.xml", "<annotation")
    with pytest.raises(ValueError, match=r"1.xml: is no XML file"):
        opened(tmp_path, "1.jpg")


def test_a_picture_is_no_mask_of_its_own(tmp_path: Path) -> None:
    picture = save(tmp_path / "images/1.png", np.full(SIZE, 9, np.uint8))
    with pytest.raises(ValueError, match="belong to no picture"):
        open_labels(tmp_path, [Item("images/1.png", picture)])
    save(tmp_path / "labels/1.png", np.full(SIZE, 3, np.uint8))
    labels = open_labels(tmp_path, [Item("images/1.png", picture)])
    assert [one.key for one in judged(labels, "images/1.png", LEFT, None)] == [3]


# YOLO


@pytest.mark.parametrize("place", ["fish.yaml", "ds/fish.yml", "ds/labels/dataset.yaml"])
def test_names_of_any_yaml(tmp_path: Path, place: str) -> None:
    write(tmp_path / place, "train: a\nnames: {0: fish, 1: crab}\n")
    write(tmp_path / "ds/labels/args.yaml", "epochs: 3\n")
    write(tmp_path / "ds/labels/odd.yml", "names: [fish")
    write(tmp_path / "ds/labels/1.txt", "0 .25 .5 .5 1\n")
    labelled(tmp_path / "ds/labels", ["1.png"], tmp_path / "out")
    content = yaml.safe_load((tmp_path / "out/data.yaml").read_text())
    assert content == {"train": "train.txt", "val": "val.txt", "names": {0: "fish", 1: "crab"}}


@pytest.mark.parametrize(
    "place", ["labels/classes.txt", "labels/train/classes.txt", "obj.names", "_darknet.labels"]
)
def test_names_of_classes_in_a_file(tmp_path: Path, place: str) -> None:
    write(tmp_path / place, "fish\nsea urchin\n\n")
    write(tmp_path / "labels/train/1.txt", "0 .25 .5 .5 1\n")
    notes: list[str] = []
    labelled(tmp_path / "labels", ["train/1.png"], tmp_path / "out", notes=notes)
    content = yaml.safe_load((tmp_path / "out/data.yaml").read_text())
    assert content["names"] == ["fish", "sea urchin"]
    assert not any("classes" in note for note in notes)


def test_classes_without_names_are_counted_and_told(tmp_path: Path) -> None:
    write(tmp_path / "labels/1.txt", "4.0 .25 .5 .5 1\n")
    notes: list[str] = []
    labelled(tmp_path / "labels", ["1.png"], tmp_path / "out", notes=notes)
    assert yaml.safe_load((tmp_path / "out/data.yaml").read_text())["nc"] == 5
    assert "no names of classes were found" in notes[-1]


def test_two_descriptions_are_one_too_many(tmp_path: Path) -> None:
    for name in ("fish.yaml", "crabs.yaml"):
        write(tmp_path / name, "names: [a]\n")
    write(tmp_path / "labels/1.txt", "0 .25 .5 .5 1\n")
    with pytest.raises(ValueError, match=r"more than one .yaml has names: call one data.yaml"):
        opened(tmp_path / "labels", "1.png")
    (tmp_path / "fish.yaml").rename(tmp_path / "data.yaml")
    opened(tmp_path / "labels", "1.png")


POSES = {
    "0 .25 .5 .4 .9 .2 .5 2 .3 .6 1": [2, 3],
    "0 .25 .5 .4 .9 .2 .5 1": [1, 3],
    "0 .25 .5 .4 .9 .2 .5": [1, 2],
    "0 .25 .5 .4 .9 .2 .5 .3 .6": [2, 2],
}


@pytest.mark.parametrize("line", POSES)
def test_keypoints_are_asked_for(tmp_path: Path, line: str) -> None:
    write(tmp_path / "ds/labels/1.txt", f"{line}\n")
    with pytest.raises(ValueError, match=r"numbers are polygons, or have keypoints: say kpt_shape"):
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


def test_splits_are_those_of_the_description(tmp_path: Path) -> None:
    text = "train: [../reef/images, wreck\\images]\nval: ./harbour/images/\ntest: empty\n"
    write(tmp_path / "photos/data.yaml", f"{text}names: [fish]\n")
    names = [f"{place}/images/1.png" for place in ("reef", "wreck", "harbour", "other")]
    for name in names:
        write(tmp_path / "photos" / name.replace("images/1.png", "labels/1.txt"), "0 .5 .5 1 1\n")
    labels = open_labels(
        tmp_path / "photos", [Item(name, tmp_path / "photos" / name) for name in names]
    )
    (tmp_path / "out").mkdir()
    told = labels.finish(
        [done(tmp_path / "photos" / name, name, name) for name in names], tmp_path / "out"
    )
    splits = {
        split: (tmp_path / f"out/{split}.txt").read_text() for split in ("train", "val", "test")
    }
    assert splits == {
        "train": "./reef/images/1.png\n./wreck/images/1.png\n",
        "val": "./harbour/images/1.png\n",
        "test": "",
    }
    assert told == [
        "1 pictures are of no split, and in no list, such as ./other/images/1.png",
        "no picture is of the split test: test.txt lists nothing",
    ]


@pytest.mark.parametrize("folder", ["Test", "test_set", "testing", "TEST_DATA"])
def test_splits_of_folders_in_any_spelling(tmp_path: Path, folder: str) -> None:
    names = ["train/1.png", f"{folder}/2.png"]
    for name in names:
        write((tmp_path / "labels" / name).with_suffix(".txt"), "0 .5 .5 1 1\n")
    labelled(tmp_path / "labels", names, tmp_path / "out")
    lists = [(tmp_path / f"out/{split}.txt").read_text() for split in ("train", "test")]
    assert lists == [f"./images/{name}\n" for name in names]


def test_names_of_another_file_are_told_with_it(tmp_path: Path) -> None:
    write(tmp_path / "ds/labels/1.txt", "2 .5 .5 1 1\n")
    write(tmp_path / "fish.yaml", "names: [cod, eel, ray]\n")
    notes: list[str] = []
    labelled(tmp_path / "ds/labels", ["1.png"], tmp_path / "out", notes=notes)
    assert notes[0] == f"classes are those of {tmp_path / 'fish.yaml'}"
    (tmp_path / "fish.yaml").unlink()
    write(tmp_path / "ds/obj.names", "cod\n\nray\n\n")
    labelled(tmp_path / "ds/labels", ["1.png"], tmp_path / "again")
    assert yaml.safe_load((tmp_path / "again/data.yaml").read_text())["names"] == ["cod", "", "ray"]


@pytest.mark.parametrize("as_lists", [False, True])
def test_splits_of_a_data_set_below_a_folder_called_train(tmp_path: Path, as_lists: bool) -> None:
    root, names = tmp_path / "train/ds", ["images/train/1.png", "images/val/2.png"]
    for name in names:
        write((root / name.replace("images", "labels")).with_suffix(".txt"), "0 .5 .5 1 1\n")
    end = ".txt" if as_lists else ""
    write(root / "data.yaml", f"train: train{end}\nval: val{end}\nnames: [fish]\n")
    if as_lists:
        write(root / "train.txt", f"./{names[0]}\n")
        write(root / "val.txt", f"{root}/{names[1]}\n")
    labels = open_labels(root / "labels", [Item(name, root / name) for name in names])
    (tmp_path / "out").mkdir()
    told = labels.finish([done(root / n, n, n) for n in names], tmp_path / "out")
    lists = [(tmp_path / f"out/{split}.txt").read_text() for split in ("train", "val")]
    assert lists == [f"./{name}\n" for name in names]
    assert told == []


@pytest.mark.parametrize("split, other", [("train", "those of train"), ("val", "nothing")])
def test_an_empty_split_is_told(tmp_path: Path, split: str, other: str) -> None:
    write(tmp_path / f"labels/{split}/1.txt", "0 .5 .5 1 1\n")
    notes: list[str] = []
    labelled(tmp_path / "labels", [f"{split}/1.png"], tmp_path / "out", notes=notes)
    empty = {"train": "val", "val": "train"}[split]
    assert notes[0] == f"no picture is of the split {empty}: {empty}.txt lists {other}"


# COCO


def test_images_without_a_picture_are_counted(tmp_path: Path) -> None:
    coco(tmp_path)
    notes: list[str] = []
    labelled(tmp_path / "instances.json", ["reef/a.jpg"], tmp_path / "out", notes=notes)
    assert notes == [f"1 of 2 images of {tmp_path / 'instances.json'} have no picture here"]


def owners(file: Path, *pictures: Path, root: Path) -> dict[str, int]:
    """The id of the image that each picture has."""
    items = [Item(picture.relative_to(root).as_posix(), picture) for picture in pictures]
    labels = open_labels(file, items)
    return {name: image["id"] for name, (image, _) in labels.of.items()}


@pytest.mark.parametrize(
    "file_name, picture",
    [
        ("images/x.jpg", "ds/images/x.jpg"),
        ("images\\x.jpg", "ds/images/x.jpg"),
        (".\\images\\train\\x.jpg", "ds/images/train/x.jpg"),
        ("images/x.jpg", "photos/x.jpg"),
        ("./x.jpg", "photos/deep/x.jpg"),
        ("JPEGImages/x.jpg", "ds/images/x.jpg"),
        ("/home/me/ds/images/x.jpg", "ds/images/x.jpg"),
        ("C:\\me\\reef\\x.jpg", "elsewhere/reef/x.jpg"),
    ],
)
def test_file_names_as_tools_write_them(tmp_path: Path, file_name: str, picture: str) -> None:
    file = coco(tmp_path, images=[{"id": 3, "file_name": file_name}], annotations=[])
    path = tmp_path / picture
    assert owners(file, path, root=path.parent) == {"x.jpg": 3}
    assert owners(file, path, root=tmp_path) == {picture: 3}


@pytest.mark.parametrize(
    "file_name, picture",
    [
        ("reef/x.jpg", "wreck/x.jpg"),
        ("a/frames/x.jpg", "b/frames/x.jpg"),
        ("/home/me/reef/x.jpg", "wreck/x.jpg"),
        ("ax.jpg", "x.jpg"),
    ],
)
def test_pictures_of_another_folder_are_others(
    tmp_path: Path, file_name: str, picture: str
) -> None:
    file = coco(tmp_path, images=[{"id": 3, "file_name": file_name}], annotations=[])
    with pytest.raises(ValueError, match=r"no image has the file_name x.jpg"):
        owners(file, tmp_path / picture, root=(tmp_path / picture).parent)


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
    path = write(tmp_path / file, "")
    path.write_text(json.dumps({"images": [{"id": 3, "file_name": "1.jpg"}], "annotations": []}))
    pictures = [tmp_path / place / "1.jpg" for place in ("train", "val2017", "valid", "test")]
    assert owners(path, *pictures, root=tmp_path) == {"train/1.jpg": 3}
    with pytest.raises(ValueError, match=r"no image has the file_name 1.jpg in its split"):
        owners(path, pictures[1], root=pictures[1].parent)


def test_an_image_is_of_one_picture(tmp_path: Path) -> None:
    file = coco(tmp_path, images=[{"id": 3, "file_name": "1.jpg"}], annotations=[])
    pictures = [tmp_path / place / "1.jpg" for place in ("reef", "wreck")]
    with pytest.raises(ValueError, match=r"1.jpg may be reef/1.jpg or wreck/1.jpg: give the pic"):
        owners(file, *pictures, root=tmp_path)
    # whoever does as it says
    assert owners(file, pictures[0], root=pictures[0].parent) == {"1.jpg": 3}
    images = [{"id": n, "file_name": f"{place}/1.jpg"} for n, place in enumerate(("reef", "wreck"))]
    both = coco(tmp_path, images=images, annotations=[])
    assert owners(both, *pictures, root=tmp_path) == {"reef/1.jpg": 0, "wreck/1.jpg": 1}


def test_a_picture_that_is_not_listed_stays_out_of_the_file(tmp_path: Path) -> None:
    objects = labelled(coco(tmp_path), ["b.jpg", "more.jpg"], tmp_path / "out")
    assert objects == [[(11, 0.9, True)], []]
    written = json.loads((tmp_path / "out/instances.json").read_text())
    assert [image["file_name"] for image in written["images"]] == ["b.jpg"]


def test_an_empty_segmentation_is_none(tmp_path: Path) -> None:
    entry = ANNOTATIONS[0] | {"segmentation": [[]]}
    labels = opened(coco(tmp_path, annotations=[entry]), "reef/a.jpg")
    assert judged(labels, "reef/a.jpg", LEFT, None) == [(7, 0.9, True)]


def test_sizes_of_before_a_picture_was_turned(tmp_path: Path) -> None:
    file = coco(tmp_path, images=[{**IMAGES[1], "height": W, "width": H}], annotations=[])
    with pytest.raises(ValueError, match=r"is of 6×8 px, .* of 8×6 px, as EXIF .* exchange width"):
        judged(opened(file, "b.jpg"), "b.jpg", LEFT, None)


# Pascal VOC

VOC = """<annotation><folder>a</folder><filename>1.jpg</filename><path>/home/me/1.jpg</path>
<size><width>8</width><height>6</height><depth>3</depth></size>
<object><name>near</name><bndbox><xmin>1</xmin><ymin>1</ymin><xmax>4</xmax><ymax>6</ymax></bndbox>
<part><name>fin</name><bndbox><xmin>7</xmin><ymin>1</ymin><xmax>8</xmax><ymax>6</ymax></bndbox></part>
</object><object><name>far</name><bndbox><ymin>1.0</ymin><xmin>5.0</xmin><xmax>8.0</xmax>
<ymax>6.0</ymax></bndbox></object></annotation>"""


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
    written = tmp_path / f"out/Annotations/{own}.xml"
    assert names_in(written) == ["near"]
    assert opened(tmp_path / labels, name).place(name) == f"JPEGImages/{own}.jpg"
    assert (tmp_path / "out/ImageSets/Main/train.txt").read_text() == f"{own}\n"


def test_voc_of_variants_and_lists(tmp_path: Path) -> None:
    lists = {"train": "1\n", "val": "2\n", "fish_train": "1  1\n2 -1\n9  1\n", "test": "9\n"}
    for own, text in lists.items():
        write(tmp_path / f"voc/ImageSets/Main/{own}.txt", text)
    for number in (1, 2):
        write(tmp_path / f"voc/Annotations/{number}.xml", VOC)
    labels = opened(tmp_path / "voc/Annotations", "1.jpg", "2.jpg")
    pictures = []
    (tmp_path / "out").mkdir()
    for number, variant in ((1, 1), (1, 2), (2, 1)):
        place = f"JPEGImages/{number}_{variant}.jpg"
        labels.write(f"{number}.jpg", place, (), tmp_path / "out")
        pictures.append(done(tmp_path, f"{number}.jpg", place))
    told = labels.finish(pictures, tmp_path / "out")
    written = tmp_path / "out/ImageSets/Main"
    assert {path.stem: path.read_text() for path in written.iterdir()} == {
        "train": "1_1\n1_2\n",
        "val": "2_1\n",
        "fish_train": "1_1  1\n1_2  1\n2_1 -1\n",
        "test": "",
    }
    assert told == ["no picture is in the list test.txt"]
    root = ElementTree.parse(tmp_path / "out/Annotations/1_2.xml").getroot()
    assert (root.findtext("filename"), root.findtext("path")) == ("1_2.jpg", "1_2.jpg")
    assert names_in(tmp_path / "out/Annotations/1_2.xml") == ["near", "far"]


def test_names_with_spaces_in_lists_of_voc(tmp_path: Path) -> None:
    names = ["reef 2", "GOPR 0003", "dive 1"]
    text = "\ufeff" + "".join(f"{name}\n" for name in names)
    write(tmp_path / "voc/ImageSets/Main/train.txt", text)
    write(tmp_path / "voc/ImageSets/Main/fish_train.txt", "reef 2  1\nGOPR 0003 -1\n")
    for name in names:
        write(tmp_path / f"voc/Annotations/{name}.xml", VOC)
    labelled(tmp_path / "voc/Annotations", [f"{name}.jpg" for name in names], tmp_path / "out")
    written = tmp_path / "out/ImageSets/Main"
    assert (written / "train.txt").read_text().splitlines() == names
    assert (written / "fish_train.txt").read_text() == "reef 2  1\nGOPR 0003 -1\n"


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("<xmin>1</xmin>", "", "object 1: expected a bndbox of four numbers"),
        ("<xmin>5.0</xmin>", "<xmin>a</xmin>", "object 2: expected a bndbox of four numbers"),
        ("<width>8</width>", "<width>9</width>", "is of 9×6 px, its picture of 8×6 px"),
    ],
)
def test_bad_voc_files(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = write(tmp_path / "voc/1.xml", VOC.replace(old, new))
    with pytest.raises(ValueError, match=message) as refused:
        judged(opened(tmp_path / "voc", "1.jpg"), "1.jpg", LEFT, None)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize("size", ["", "<size><width>0</width><height>0</height></size>"])
def test_voc_without_a_size(tmp_path: Path, size: str) -> None:
    stated = VOC[VOC.index("<size>") : VOC.index("<object>")]
    write(tmp_path / "voc/1.xml", VOC.replace(stated, size))
    assert len(judged(opened(tmp_path / "voc", "1.jpg"), "1.jpg", LEFT, None)) == 2


# Masks


def test_a_palette_whose_black_is_not_the_background_is_refused(tmp_path: Path) -> None:
    colours = np.zeros((*SIZE, 3), np.uint8)
    colours[:, :3] = (0, 150, 0)
    (tmp_path / "masks").mkdir()
    mask = Image.fromarray(colours).quantize(4)
    order = [1, 0] if mask.getpixel((W - 1, 0)) == 0 else [0, 1]  # black second
    mask.remap_palette(order).save(tmp_path / "masks/1.png")
    with pytest.raises(ValueError, match=r"0 is \(0, 150, 0\), and 1 is black: which is backgr"):
        opened(tmp_path / "masks", "1.png")


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
    keys = [
        [label.key for label in of] for of in labelled(tmp_path / "masks", names, tmp_path / "out")
    ]
    assert keys == [[1]] * 40
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


def test_a_palette_stays(tmp_path: Path) -> None:
    image = Image.fromarray(np.repeat(np.uint8([[1, 2, 3, 3, 0, 0, 0, 9]]), H, 0))
    image.putpalette([10, 20, 30] * 10)
    (tmp_path / "masks").mkdir()
    image.save(tmp_path / "masks/1.png")
    labelled(tmp_path / "masks", ["1.jpg"], tmp_path / "out")
    with Image.open(tmp_path / "out/labels/1.png") as written:
        assert written.getpalette() == image.getpalette()
        assert np.array_equal(np.unique(written), [0, 1, 2, 3])
