"""Labelled data sets through `uwaug degrade`: what a trainer finds afterwards."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filing import H, W, content, pixels, save

WATER = ("--water", "II", "--visibility", "8:9")
LINES = "0 0.5 0.5 0.4 0.4\n2 0.25 0.25 0.2 0.2\n"
NAMES = ("train/1", "train/2", "val/1")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A data set as YOLO's are, with maps in mm."""
    monkeypatch.chdir(tmp_path)
    for seed, name in enumerate(NAMES):
        save(f"ds/images/{name}.png", pixels(seed=seed))
        save(f"ds/depth/{name}.png", np.full((H, W), 3000, np.uint16))
        path = Path(f"ds/labels/{name}.txt")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(LINES)
    Path("ds/data.yaml").write_text("path: ds\ntrain: images/train\nval: images/val\nnc: 3\n")
    return tmp_path


@pytest.fixture
def degrade(run):
    """Degrade what must go well; return what is printed."""

    def call(*arguments: str) -> str:
        code, out, err = run("degrade", *arguments, *WATER)
        assert (code, err) == (0, "")
        return out

    return call


def img2label_paths(pictures: list[str]) -> list[str]:
    """Ultralytics 8.4, `ultralytics.data.utils`, in its words."""
    sa, sb = f"{os.sep}images{os.sep}", f"{os.sep}labels{os.sep}"
    return [sb.join(x.rsplit(sa, 1)).rsplit(".", 1)[0] + ".txt" for x in pictures]


def trained_with(description: str) -> dict[str, list[str]]:
    """The text of the labels that Ultralytics finds, by the folders that a data.yaml names; a
    picture without labels is missing.
    """
    yaml = pytest.importorskip("yaml")
    root = Path(description).absolute().parent
    said = yaml.safe_load(Path(description).read_text())
    assert (said["nc"], "path" in said) == (3, False)
    texts = {}
    for split in ("train", "val"):
        pictures = [str(path) for path in (root / said[split]).rglob("*.png")]
        labels = [Path(path) for path in img2label_paths(pictures)]
        texts[split] = [path.read_text() for path in labels if path.exists()]
        assert len(texts[split]) == len(pictures) > 0
    return texts


@pytest.mark.parametrize(
    ("inputs", "maps", "labels", "out"),
    [
        ("ds", "ds/depth", "ds/labels", "out"),
        ("ds/images", "ds/depth", "ds/labels", "out"),
        ("ds", "ds/depth", "ds/labels", "images/out"),
    ],
)
def test_a_trainer_finds_all_labels(degrade, inputs, maps, labels, out):
    given = ("--distance", maps, "--distance-unit", "mm", "--labels", labels, "--variants", "2")
    assert "6 of 6 pictures" in degrade(inputs, *given, "--out", out)
    expected = {"train": [LINES] * 4, "val": [LINES] * 2}
    assert trained_with(f"{out}/data.yaml") == expected
    before = content(out)
    assert "6 were there" in degrade(inputs, *given, "--out", out, "--resume")
    assert "6 of 6 pictures" in degrade(inputs, *given, "--out", out, "--force")
    after = content(out)
    for files in (before, after):
        del files["index.csv"]  # it has seconds
    assert after == before


def test_of_one_folder_of_pictures_at_a_time(degrade):
    for split in ("train", "val"):
        labels = ("--labels", f"ds/labels/{split}")
        degrade(f"ds/images/{split}", "--distance", "3", *labels, "--out", f"out/{split}")
        assert Path(f"out/{split}/labels/1.txt").read_text() == LINES
        _, said = Path(f"out/{split}/data.yaml").read_text().split("\n", 1)
        assert said == 'train: "images"\n# val: has no pictures of its own\nval: "images"\nnc: 3\n'


def test_what_is_hidden_is_no_line(degrade):
    for name in NAMES:
        # one of two objects lies beyond the water
        map = np.full((H, W), 3000, np.uint16)
        map[: H // 2, : W // 2] = 60000
        save(f"ds/depth/{name}.png", map)
    given = ("--distance-unit", "mm", "--labels", "ds/labels", "--min-contrast", "0.05")
    said = degrade("ds", "--distance", "ds/depth", *given, "--out", "out")
    assert "3 of 6 objects left out, below --min-contrast 0.05\n3 of 3 pictures in out" in said
    first = LINES.splitlines(keepends=True)[0]
    assert trained_with("out/data.yaml") == {"train": [first] * 2, "val": [first]}


def test_terms_would_be_pictures_to_a_trainer(run):
    given = ("--distance", "3", "--labels", "ds/labels", "--keep-terms", *WATER)
    for files in (("ds/images", "--out", "out"), ("ds/images/val/1.png", "--out", "images/1.png")):
        code, _, err = run("degrade", *files, *given)
        assert (code, "--keep-terms must be left out" in err) == (2, True)
        assert not Path(files[-1]).exists()


def test_a_file_of_its_own_says_where_its_label_is(degrade):
    given = ("ds/images/val/1.png", "--distance", "3", "--labels", "ds/labels/val")
    said = degrade(*given, "--out", "y/images/3.png")
    assert said.startswith("wrote y/images/3.png, labels in y/labels: ")
    (label,) = img2label_paths(["y/images/3.png".replace("y", str(Path("y").absolute()), 1)])
    assert Path(label).read_text() == LINES


def test_a_data_yaml_of_somebody_else_stays(run, degrade):
    save("out/data.yaml.png", pixels())
    Path("out/data.yaml").write_text("mine")
    given = ("ds/images", "--distance", "3", "--labels", "ds/labels", "--out", "out")
    code, _, err = run("degrade", *given, *WATER)
    assert (code, "out/data.yaml exists" in err) == (2, True)
    assert Path("out/data.yaml").read_text() == "mine"
    degrade(*given, "--force")
    assert len(trained_with("out/data.yaml")["train"]) == 2


def test_what_a_user_says_in_data_yaml_stays(run, degrade):
    """Until it has another name, or all is written over."""
    given = ("ds/images/train", "--distance", "3", "--labels", "ds/labels/train", "--out", "out")
    degrade(*given)
    written = Path("out/data.yaml")
    first = written.read_text()
    edited = first.replace("nc: 3", "names: [a, b, c]")
    written.write_text(edited)
    save("ds/images/train/9.png", pixels(seed=9))
    for more in ((), ("--resume",)):
        code, _, err = run("degrade", *given, *WATER, *more)
        assert (code, "out/data.yaml is not as a run has written it" in err) == (2, True)
        assert written.read_text() == edited
    written.rename("out/mine.yaml")
    assert "1 of 3 pictures, 2 were there" in degrade(*given, "--resume")
    assert written.read_text() == first
    assert Path("out/mine.yaml").read_text() == edited
    written.write_text(edited)
    degrade(*given, "--force")
    assert written.read_text() == first


def coco(names: list[str]) -> dict[str, Any]:
    """A COCO file with a box in each picture."""
    images = [{"id": n, "file_name": name, "height": H, "width": W} for n, name in enumerate(names)]
    boxes = [
        {"id": n, "image_id": n, "category_id": 1, "bbox": [2, 1, 6, 5]} for n in range(len(names))
    ]
    return {"images": images, "annotations": boxes, "categories": [{"id": 1, "name": "fish"}]}


def test_a_coco_file_is_of_one_least_contrast(degrade, run):
    Path("marks.json").write_text(json.dumps(coco(["1.png", "2.png", "3.png"])))
    for name in ("train/1", "train/2"):
        labels = ("--labels", "marks.json", "--min-contrast", "0.9")
        said = degrade(f"ds/images/{name}.png", "--distance", "3", *labels, "--out", "out")
        assert "1 of 1 objects marked as ignored, below --min-contrast 0.9\n" in said
    before = content("out")
    save("3.png", pixels())
    for more in ((), ("--min-contrast", "0.1"), ("--force",)):
        given = ("3.png", "--distance", "3", "--labels", "marks.json", *more, "--out", "out")
        code, _, err = run("degrade", *given, *WATER)
        assert (code, "has labels with --min-contrast 0.9, and this run has" in err) == (2, True)
    assert content("out") == before


def test_a_coco_file_is_of_all_pictures_of_a_folder(degrade, run):
    names = [*(f"{name}.png" for name in NAMES), "4.png"]
    file = coco(names)
    boxes = file["annotations"]
    labels = Path("ds/marks.json")
    labels.write_text(json.dumps(file))
    given = ("--distance", "3", "--labels", str(labels))

    def named() -> set[str]:
        written = json.loads(Path("out/marks.json").read_text())
        return {image["file_name"] for image in written["images"]}

    degrade("ds/images", *given, "--out", "out")
    save("4.png", pixels(seed=9))
    degrade("4.png", *given, "--out", "out/4.png")
    assert named() == set(names)
    Path("out/train/1.png").unlink()
    save("more/train/2.png", pixels(seed=8))
    degrade("more", *given, "--out", "out", "--force")
    assert named() == {"train/2.png", "val/1.png"}
    assert "train/1.png" not in Path("out/index.csv").read_text()
    boxes[1]["bbox"] = [4, 1, 6, 5]
    labels.write_text(json.dumps(file))
    code, _, err = run("degrade", "more", *given, *WATER, "--out", "out", "--force")
    assert (code, "marks.json has changed since" in err) == (2, True)


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_a_coco_file_as_pycocotools_reads_it(degrade):
    coco = pytest.importorskip("pycocotools.coco")
    images: list[Any] = []
    annotations: list[Any] = []
    for number, name in enumerate(NAMES, 7):
        images.append({"id": number, "file_name": f"{name}.png", "height": H, "width": W})
        corners = [2.0, 1.0, 8.0, 1.0, 8.0, 6.0]
        annotations.append(
            {
                "id": number,
                "image_id": number,
                "category_id": 1,
                "bbox": [2, 1, 6, 5],
                "area": 15.0,
                "iscrowd": 0,
                "segmentation": [corners],
            }
        )
    categories = [{"id": 1, "name": "fish"}]
    file = {"images": images, "annotations": annotations, "categories": categories}
    Path("ds/marks.json").write_text(json.dumps(file))
    given = ("--distance", "3", "--labels", "ds/marks.json", "--variants", "2")
    degrade("ds/images", *given, "--out", "out")
    read = coco.COCO("out/marks.json")
    assert len(read.getImgIds()) == len(read.getAnnIds()) == 6
    for image in read.loadImgs(read.getImgIds()):
        assert Path("out", image["file_name"]).is_file()
        (entry,) = read.loadAnns(read.getAnnIds(imgIds=image["id"]))
        assert 0 < entry["contrast"] < 1
        mask = read.annToMask(entry)
        assert mask.shape == (H, W)
        assert mask.sum() > 0


def test_one_description_is_of_one_folder_of_labels(degrade, run):
    degrade("ds/images", "--distance", "3", "--labels", "ds/labels", "--out", "out")
    before = Path("out/data.yaml").read_text()
    save("b/images/other/9.png", pixels(seed=9))
    Path("b/labels/other").mkdir(parents=True)
    Path("b/labels/other/9.txt").write_text(LINES)
    given = ("--distance", "3", "--labels", "b/labels", "--out", "out")
    code, _, err = run("degrade", "b/images", *given, *WATER)
    assert (code, "one data.yaml cannot tell of both" in err) == (2, True)
    assert Path("out/data.yaml").read_text() == before
