"""Labels beside pictures: read, judged, written where trainers look, read again."""

import json
import os
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from filing import content
from PIL import Image

from uwaug.files.formats import FORMATS, open_labels
from uwaug.files.items import Item
from uwaug.files.labels import Judged, Labelled, Labels, judged

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
        pictures.append(Labelled(source.parent / "photos" / name, name, place, objects))
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
    pictures = [Labelled(tmp_path / "b.jpg", "b.jpg", f"b_{i}.png", objects) for i in (1, 2)]
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
        ({"annotations": [{"id": 7, "image_id": 1}]}, "annotation 7: KeyError.'bbox'"),
        ({"annotations": [ANNOTATIONS[0] | {"bbox": [1, 2]}]}, "annotation 7: ValueError"),
        ({"annotations": [ANNOTATIONS[0] | {"segmentation": [[0, 1, 2]]}]}, "annotation 7"),
        (runs(size=[H, W], counts=[40]), "annotation 7: ValueError.*reshape"),
        (runs(size=[W, H], counts=[48]), r"annotation 7: .*run lengths of \[8, 6\] px"),
        ({"images": [IMAGES[0] | {"width": 99}], "annotations": []}, r"is \(6, 99\) there but"),
        ({"images": IMAGES[1:], "annotations": []}, r"no image .* reef/a.jpg \(there are b.jpg"),
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
        match=r"labels must be a COCO file .* a folder of YOLO.* or a folder of .* masks",
    ):
        opened(tmp_path, "a.jpg")
    (tmp_path / "a.json").write_text("[" * 100_000)
    with pytest.raises(ValueError, match="is no COCO file"):
        opened(tmp_path / "a.json", "a.jpg")
    Image.fromarray(np.zeros((3, 4), np.uint8)).save(tmp_path / "a.png")
    with pytest.raises(ValueError, match=r"is \(3, 4\) but its picture \(6, 8\) px"):
        judged(opened(tmp_path, "a.png"), "a.png", LEFT, None)
