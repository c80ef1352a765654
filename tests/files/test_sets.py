"""Data sets as people lay them out, degraded: trainers find every label that there was."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from filing import metres, pixels, save

from uwaug.files.record import record_of

H, W = 24, 32
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(path: str, text: str) -> None:
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(text)


def degraded(run: Run, pictures: str, *more: str) -> str:
    flags = ("--out", "wet", "--contrast", ".6", "--workers", "1")
    flags += () if "--distance" in more or pictures.endswith(".csv") else ("--distance", "2")
    code, said, err = run("degrade", pictures, *flags, *more)
    assert code == 0, err
    return said


def boxes(number: int) -> str:
    """YOLO's boxes of a picture that has this number: no two pictures have the same."""
    return f"{number % 2} 0.5 0.5 0.4 0.{number + 1}\n" * (number + 1)


def as_ultralytics(data: str, split: str) -> list[tuple[str, str]]:
    """Name and labels of each picture of a split, found as Ultralytics does."""
    place = Path(data).parent / yaml.safe_load(Path(data).read_text())[split]
    pictures = sorted(place.iterdir()) if place.is_dir() else place.read_text().split()
    labels = []
    for picture in pictures:
        path = picture if place.is_dir() else place.parent / picture
        assert Path(path).is_file()
        file = "/labels/".join(str(path).rsplit("/images/", 1)).rsplit(".", 1)[0] + ".txt"
        labels.append((Path(path).stem, Path(file).read_text() if Path(file).exists() else ""))
    return labels


YOLO = [
    # paths of pictures and labels below ds, by split; flags
    ("{}/images/", "{}/labels/", "ds", "ds/{split}/labels/{stem}.txt"),  # Roboflow
    ("images/{}/", "labels/{}/", "ds/images", "ds/labels"),  # Ultralytics
]


@pytest.mark.parametrize("pictures, labels, source, given", YOLO)
def test_yolo(run: Run, pictures: str, labels: str, source: str, given: str) -> None:
    number, expected = 0, {}
    write("ds/data.yaml", "train: a\nval: b\ntest: c\nnc: 2\nnames: ['sea urchin', 'fish']\n")
    write("ds/README.dataset.txt", "A set.\n")
    for split, count in {"train": 3, "valid": 2, "test": 1}.items():
        for _ in range(count):
            name = f"{number}_jpg.rf.0a1b2c"
            save(f"ds/{pictures.format(split)}{name}.jpg", pixels(H, W, seed=number))
            if number != 1:  # a background
                write(f"ds/{labels.format(split)}{name}.txt", boxes(number))
            expected.setdefault(split, []).append((name, boxes(number) if number != 1 else ""))
            number += 1
    said = degraded(run, source, "--labels", given)
    assert "19 of 19 labels kept" in said
    assert "5 have labels, 1 have none" in said
    for split, old in {"train": "train", "val": "valid", "test": "test"}.items():
        assert as_ultralytics("wet/data.yaml", split) == expected[old]
    description = yaml.safe_load(Path("wet/data.yaml").read_text())
    assert description["names"] == ["sea urchin", "fish"]


# COCO


def coco(file: str, pictures: dict[str, int], **more: Any) -> int:
    """A file of pictures, of which each has a number and so many boxes of its own."""
    images, annotations = [], []
    for number, (name, count) in enumerate(pictures.items()):
        images.append({"id": 7 + number, "file_name": name, "width": W, "height": H})
        for k in range(count):
            box = {"bbox": [k, 3, 9.5, 8], "category_id": 1, "iscrowd": 0, "area": 76}
            annotations.append({**box, "id": 100 * number + k, "image_id": 7 + number})
    content = {"images": images, "categories": [{"id": 1, "name": "fish"}], **more}
    write(file, json.dumps({**content, "annotations": annotations}))
    return len(annotations)


def as_torchvision(torchvision: Any, root: str, file: str) -> dict[str, int]:
    """How many objects torchvision finds for each picture that it can open."""
    pytest.importorskip("pycocotools")
    dataset = torchvision.datasets.CocoDetection(root, file)
    assert all(image.size == (W, H) for image, _ in dataset)
    names = [dataset.coco.loadImgs(number)[0]["file_name"] for number in dataset.ids]
    return {Path(name).stem: len(target) for name, (_, target) in zip(names, dataset, strict=True)}


SETS = [
    # pictures by split, files of labels, file_names, and roots of pictures
    ("{}/{}.jpg", "{}/_annotations.coco.json", "{1}.jpg", "{}"),  # RF-DETR
    ("images/{}/{} b.jpg", "../a/{}.json", "ds/images/{0}/{1} b.jpg", ""),
]


@pytest.mark.parametrize("picture, labels, stated, root", SETS)
def test_coco_with_a_file_for_each_split(
    run: Run, torchvision: Any, picture: str, labels: str, stated: str, root: str
) -> None:
    total, expected = 0, {}
    for split, count in {"train": 3, "valid": 2}.items():
        counts = {}
        for number in range(count):
            save(f"ds/{picture.format(split, number)}", pixels(H, W, seed=number))
            counts[stated.format(split, number)] = 1 + number + count
        total += coco(f"ds/{labels.format(split)}", counts)
        expected[split] = {Path(name).stem: boxes for name, boxes in counts.items()}
    assert f"{total} of {total} labels kept" in degraded(
        run, "ds", "--labels", f"ds/{labels.format('{split}')}"
    )
    for split, counts in expected.items():
        file = f"wet/{labels.format(split).removeprefix('../a/')}"
        assert as_torchvision(torchvision, f"wet/{root.format(split)}", file) == counts


@pytest.mark.parametrize(
    "source, stated, root",
    [("ds", "{0}/{1}.jpg", "wet/images"), ("ds/images", "{1}.jpg", "wet")],
)
def test_coco_in_one_file_for_three_splits(
    run: Run, torchvision: Any, source: str, stated: str, root: str
) -> None:
    counts, number = {}, 0
    for split in ("train", "val", "test"):
        for _ in range(2):
            save(f"ds/images/{split}/{number}.jpg", pixels(H, W, seed=number))
            counts[stated.format(split, number)] = number
            number += 1
    coco("ds/all.json", counts, info={"contributor": "a renderer"})
    assert "15 of 15 labels kept" in degraded(run, source, "--labels", "ds/all.json")
    expected = {str(n): n for n in range(number)}
    assert as_torchvision(torchvision, root, "wet/all.json") == expected


# A table


def test_a_table_of_a_layout_of_ones_own(run: Run) -> None:
    lines = ["picture,distance,labels,split"]
    for number in range(3):
        save(f"training/image_2/{number}.png", pixels(H, W, seed=number))
        save(f"depth/{9 - number}.npy", metres(H, W) + number)
        write(f"boxes/b{number}.txt", boxes(number))
        split = "train" if number else "val"
        cells = f"training/image_2/{number}.png,depth/{9 - number}.npy,boxes/b{number}.txt,{split}"
        lines.append(cells)
    write("table.csv", "\n".join(lines))
    assert "6 of 6 labels kept" in degraded(run, "table.csv")
    assert as_ultralytics("wet/data.yaml", "val") == [("0", boxes(0))]
    assert as_ultralytics("wet/data.yaml", "train") == [("1", boxes(1)), ("2", boxes(2))]
    for number in range(3):
        record = record_of(Path(f"wet/images/training/image_2/{number}.png"))
        assert record is not None
        assert Path(record["row"]["distance"]).stem == str(9 - number)
