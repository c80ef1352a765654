"""Where trainers look for labels, and what they are told."""

from pathlib import Path, PurePosixPath
from typing import Any

import pytest

from uwaug.labels import open_labels
from uwaug.labels.layout import description_of, label_place, picture_place, splits_of


@pytest.mark.parametrize(
    ("place", "picture", "label"),
    [
        ("images/train/1.png", "images/train/1.png", "labels/train/1.png"),
        ("train/images/1.png", "train/images/1.png", "train/labels/1.png"),
        ("images/a/images/1.png", "images/a/images/1.png", "images/a/labels/1.png"),
        ("train/1.png", "images/train/1.png", "labels/train/1.png"),
        ("images.png", "images/images.png", "labels/images.png"),
    ],
)
def test_places(place: str, picture: str, label: str) -> None:
    written = picture_place(PurePosixPath(place))
    assert written == PurePosixPath(picture)
    assert label_place(written) == PurePosixPath(label)


def test_splits() -> None:
    places = ["images/train/1.png", "images/train/deep/2.png", "images/val/1.png"]
    assert splits_of(places) == {"train": ["images/train"], "val": ["images/val"]}
    exported = ["test/images/1.png", "valid/images/1.png", "train/images/1.png"]
    folders = {
        split: [f"{name}/images"]
        for split, name in zip(("train", "val", "test"), ("train", "valid", "test"), strict=True)
    }
    assert splits_of(exported) == folders
    assert splits_of(["images/1.png"]) == {"train": ["images"]}
    reefs = ["images/reef/1.png", "images/bank/1.png", "images/val2017/1.png"]
    assert splits_of(reefs) == {"train": ["images/bank", "images/reef"], "val": ["images/val2017"]}
    assert splits_of(["1.png"]) == {}


def test_names_that_begin_like_a_split() -> None:
    for name in ("valley", "testudo", "training_pool", "trainer"):
        assert splits_of([f"images/{name}/1.png"]) == {"train": [f"images/{name}"]}
    for name in ("val", "valid", "validation", "val2017", "val_2"):
        assert splits_of([f"images/{name}/1.png"]) == {"val": [f"images/{name}"]}


def test_folders_in_folders() -> None:
    """Trainers take a folder with all below it: none twice, and none for another split."""
    assert splits_of(["images/1.png", "images/reef/2.png"]) == {"train": ["images"]}
    with pytest.raises(ValueError, match="images: has pictures right in it, and those of val"):
        splits_of(["images/1.png", "images/val/2.png"])


BEFORE = """\
# COCO, some of it
path: ../datasets/reef  # root
train: images/train
val:
  - images/val
names:
  0: fish
  1: "crab: red"

kpt_shape: [17, 3]
download: |
  import os
  path: none
"""


def described(folder: Path, *outputs: str) -> str:
    """The data.yaml of some pictures with labels."""
    source = open_labels(folder / "labels")
    records: list[Any] = [
        {"picture": output, "objects": [], "output": output} for output in outputs
    ]
    (folder / "out").mkdir(exist_ok=True)
    (written,) = source.write_run(iter(records), folder / "out")
    assert written == folder / "out/data.yaml"
    return written.read_text()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "labels/train").mkdir(parents=True)
    (tmp_path / "labels/train/1.txt").write_text("4 0.5 0.5 0.1 0.1\n1 0.5 0.5 0.1 0.1\n")
    return tmp_path


def test_what_a_data_yaml_says_but_for_places_is_kept(folder: Path) -> None:
    yaml = pytest.importorskip("yaml")
    (folder / "data.yaml").write_text(BEFORE)
    outputs = ["images/train/1.png", "images/val/1.png", "images/a: 'ü 🐟\"/1.png"]
    text = described(folder, *outputs)
    assert yaml.safe_load(text) == {
        "train": ["images/a: 'ü 🐟\"", "images/train"],
        "val": "images/val",
        "names": {0: "fish", 1: "crab: red"},
        "kpt_shape": [17, 3],
    }


@pytest.mark.parametrize("labels", ["labels", "labels/train", "train/labels"])
def test_a_data_yaml_lies_above_its_labels(labels: str, tmp_path: Path) -> None:
    folder = tmp_path / "deep/ds"
    (folder / labels).mkdir(parents=True)
    (tmp_path / "deep/other.yaml").write_text("names: [a]\n")
    (folder / "settings.yaml").write_text("train: images\nlearning: {names: [a]}\n")
    assert description_of(folder / labels) is None
    (folder / "data.yaml").write_text("# mine\nnames:\n- a\n")
    assert description_of(folder / labels) == folder / "data.yaml"


def test_classes_are_named_or_counted(folder: Path) -> None:
    text = described(folder, "images/train/1.png")
    # 4 is the largest
    assert text.splitlines()[-1] == "nc: 5"
    # trainers insist on val
    assert text.splitlines()[-2] == 'val: "images/train"'
    (folder / "classes.txt").write_text("fish\ncrab\n")
    assert described(folder, "images/train/1.png").splitlines()[-1] == 'names: ["fish", "crab"]'
    (folder / "reef.yaml").write_text("names: [a]\n")
    assert described(folder, "images/train/1.png").splitlines()[-1] == "names: [a]"
    # which of them is meant?
    (folder / "bank.yaml").write_text("names: [b]\n")
    assert described(folder, "images/train/1.png").splitlines()[-1] == 'names: ["fish", "crab"]'
    (folder / "data.yaml").write_text("names: [c]\n")
    assert described(folder, "images/train/1.png").splitlines()[-1] == "names: [c]"


def test_a_data_yaml_is_not_written_over_the_labels_own(folder: Path) -> None:
    (folder / "data.yaml").write_text("nc: 1\n")
    source = open_labels(folder / "labels")
    record = {"picture": "1.png", "objects": [], "output": "images/1.png"}
    with pytest.raises(ValueError, match="is the labels' own file"):
        source.write_run([record], folder)
    # nothing is said of a picture by itself
    assert source.write_run([record | {"output": "1.png"}], folder) == []
