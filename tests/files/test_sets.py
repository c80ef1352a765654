"""Data sets as people lay them out, degraded: trainers find every label that there was."""

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filing import metres, pixels, save
from PIL import Image

H, W = 24, 32
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(path: str, text: str) -> None:
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(text)


def degraded(run: Run, pictures: str, labels: str, out: str, *more: str) -> str:
    flags = ("--labels", labels, "--out", out, "--contrast", ".6", "--workers", "1")
    flags += () if "--distance" in more else ("--distance", "2")
    code, said, err = run("degrade", pictures, *flags, *more)
    assert code == 0, err
    return said


# Roboflow, for YOLO

SPLITS = {"train": 3, "valid": 2, "test": 1}


def roboflow() -> None:
    text = "train: ../train/images\nval: ../valid/images\ntest: ../test/images\n"
    names = "nc: 2\nnames: ['sea urchin', 'fish']\nroboflow:\n  license: CC BY 4.0\n"
    write("ds/data.yaml", text + names)
    write("ds/README.dataset.txt", "A set.\n")
    for split, count in SPLITS.items():
        for number in range(count):
            name = f"{split}-{number}_jpg.rf.0a1b2c"
            save(f"ds/{split}/images/{name}.jpg", pixels(H, W, seed=number))
            boxes = [f"{k % 2} 0.5 0.5 0.4 0.{k + 1}\n" for k in range(2 * number + 2)]
            write(f"ds/{split}/labels/{name}.txt", "".join(boxes) if number < 2 else "")


def as_ultralytics(data: str, split: str) -> list[list[str]]:
    """The objects of each picture of a split, found as Ultralytics does."""
    import yaml

    place = Path(data).parent / yaml.safe_load(Path(data).read_text())[split]
    pictures = sorted(place.iterdir()) if place.is_dir() else place.read_text().split()
    objects = []
    for picture in pictures:
        path = picture if place.is_dir() else place.parent / picture
        assert Path(path).is_file()
        label = "/labels/".join(str(path).rsplit("/images/", 1)).rsplit(".", 1)[0] + ".txt"
        objects.append(Path(label).read_text().splitlines())
    return objects


def test_roboflow(run: Run) -> None:
    roboflow()
    out = degraded(run, "ds", "ds", "wet")
    assert "14 of 14 labels kept" in out
    before = Path("ds/data.yaml").read_text().replace("../", "")
    write("ds/here.yaml", before)
    for split in ("train", "val", "test"):
        assert as_ultralytics("wet/data.yaml", split) == as_ultralytics("ds/here.yaml", split)
    assert "names:\n- sea urchin\n- fish\n" in Path("wet/data.yaml").read_text()


# COCO, a file for each split


def coco(file: str, names: list[str], **more: Any) -> int:
    """A file of some pictures; gives the number of its objects."""
    box = {"bbox": [2, 3, 9.5, 8], "category_id": 1, "iscrowd": 0, "area": 76}
    images = [
        {"id": 7 + n, "file_name": name, "width": W, "height": H} for n, name in enumerate(names)
    ]
    content = {"images": images, "categories": [{"id": 1, "name": "fish"}], **more}
    content["annotations"] = [
        {**box, "id": 2 * n + k, "image_id": 7 + n} for n in range(len(names)) for k in range(2)
    ]
    write(file, json.dumps(content))
    return 2 * len(names)


def counted(torchvision: Any, root: str, file: str) -> int:
    """How many objects torchvision finds in pictures that it can open."""
    pytest.importorskip("pycocotools")
    dataset = torchvision.datasets.CocoDetection(root, file)
    return sum(len(target) for image, target in dataset if image.size == (W, H))


def test_coco_with_a_split_each(run: Run, torchvision: Any) -> None:
    for split, count in {"train2017": 3, "val2017": 2}.items():
        for number in range(count):
            save(f"ds/{split}/{number}.jpg", pixels(H, W, seed=number))
        file = f"instances_{split}.json"
        there = coco(f"ds/annotations/{file}", [f"{number}.jpg" for number in range(count)])
        pictures, labels = f"ds/{split}", f"ds/annotations/{file}"
        assert counted(torchvision, pictures, labels) == there
        out = degraded(run, pictures, labels, f"wet/{split}")
        assert f"{there} of {there} labels kept" in out
        assert counted(torchvision, f"wet/{split}", f"wet/{split}/{file}") == there
    # all pictures and the file of one split: the others get none of its labels
    out = degraded(run, "ds", labels, "both")
    assert "belong to 2 of 5 pictures, not to train2017/0.jpg" in out
    assert counted(torchvision, "both", f"both/{file}") == there


# Pascal VOC


def test_voc(run: Run, torchvision: Any) -> None:
    box = "<bndbox><xmin>3</xmin><ymin>4</ymin><xmax>12</xmax><ymax>9</ymax></bndbox>"
    for number in range(3):
        save(f"VOCdevkit/VOC2012/JPEGImages/2008_{number}.jpg", pixels(H, W, seed=number))
        objects = f"<object><name>crab</name><difficult>0</difficult>{box}</object>" * (number + 1)
        size = f"<size><width>{W}</width><height>{H}</height><depth>3</depth></size>"
        write(
            f"VOCdevkit/VOC2012/Annotations/2008_{number}.xml",
            f"<annotation><filename>2008_{number}.jpg</filename>{size}{objects}</annotation>",
        )
    lists = {"train": "2008_0\n2008_2\n", "val": "2008_1\n", "trainval": "2008_0\n2008_1\n"}
    for split, text in lists.items():
        write(f"VOCdevkit/VOC2012/ImageSets/Main/{split}.txt", text)
    source = "VOCdevkit/VOC2012"
    out = degraded(run, source, source, f"wet/{source}", "--variants", "2")
    assert "12 of 12 labels kept" in out

    def counts(root: str, split: str) -> list[int]:
        dataset = torchvision.datasets.VOCDetection(root, image_set=split)
        assert all(image.size == (W, H) for image, _ in dataset)
        return [len(target["annotation"]["object"]) for _, target in dataset]

    assert counts(".", "train") == [1, 3]
    assert counts("wet", "train") == [1, 1, 3, 3]
    assert counts("wet", "val") == [2, 2]
    assert counts("wet", "trainval") == [1, 1, 2, 2]


# CVAT's segmentation masks


def classes_in(masks: str, labelmap: str) -> Counter[str]:
    """How many masks have pixels of a class, by its colour."""
    lines = [line.split(":") for line in Path(labelmap).read_text().splitlines()[1:]]
    classes = {tuple(map(int, colour.split(","))): name for name, colour, *_ in lines}
    found: Counter[str] = Counter()
    for path in sorted(Path(masks).glob("*.png")):
        with Image.open(path) as image:
            colours = image.convert("RGB").getcolors()
            found.update(classes[colour] for _, colour in colours or ())
    return found


def test_cvat_masks(run: Run) -> None:
    write("task/labelmap.txt", "# label:color_rgb:parts:actions\nbackground:0,0,0::\n")
    with open("task/labelmap.txt", "a") as file:
        file.write("fish:128,0,0::\nsand:0,128,128::\n")
    write("task/ImageSets/Segmentation/default.txt", "0\n1\n")
    for number in range(2):
        save(f"task/JPEGImages/{number}.jpg", pixels(H, W, seed=number))
        mask = np.zeros((H, W, 3), np.uint8)
        mask[12:], mask[3:9, 5 * number : 20] = (0, 128, 128), (128, 0, 0)
        save(f"task/SegmentationClass/{number}.png", mask)
    out = degraded(run, "task/JPEGImages", "task", "wet")
    assert "4 of 4 labels kept" in out
    assert {path.stem for path in Path("wet/images").glob("*.jpg")} == {"0", "1"}
    before = classes_in("task/SegmentationClass", "task/labelmap.txt")
    assert classes_in("wet/labels", "wet/labelmap.txt") == before
    assert before == {"background": 2, "fish": 2, "sand": 2}
    # masks are no pictures
    out = degraded(run, "task", "task", "all")
    assert "2 of 2 pictures written" in out
    assert classes_in("all/labels/JPEGImages", "all/labelmap.txt") == before


# Blender


def test_a_render_with_its_depth(run: Run, torchvision: Any) -> None:
    exr = pytest.importorskip("OpenEXR")
    for number in range(2):
        save(f"coco_data/images/00000{number}.png", pixels(H, W, seed=number))
        z = metres(H, W)
        z[:6] = 1e10  # Blender's sky
        Path("coco_data/depth").mkdir(exist_ok=True)
        file = exr.File({"type": exr.scanlineimage}, {"Z": z})
        file.write(f"coco_data/depth/00000{number}.exr")
    names = [f"images/00000{number}.png" for number in range(2)]
    there = coco("coco_data/coco_annotations.json", names, info={"contributor": "a renderer"})
    labels = "coco_data/coco_annotations.json"
    out = degraded(run, "coco_data", labels, "wet", "--distance", "coco_data/depth")
    assert f"{there} of {there} labels kept" in out
    assert counted(torchvision, "coco_data", labels) == there
    assert counted(torchvision, "wet", "wet/coco_annotations.json") == there


# A COCO file for each split, below one folder


@pytest.mark.parametrize(
    "picture, labels, stated",
    [
        ("{}/{}.jpg", "{}/_annotations.coco.json", "{1}.jpg"),  # RF-DETR
        ("images/{}/{}.jpg", "annotations/instances_{}.json", "{1}.jpg"),  # DUO
        ("images/{}/{} b.jpg", "annotations/{}.json", "{0}/{1}%20b.jpg"),
    ],
)
def test_coco_files_below_a_folder(run: Run, picture: str, labels: str, stated: str) -> None:
    there = 0
    for split, count in {"train": 3, "valid": 2}.items():
        for number in range(count):
            save(f"ds/{picture.format(split, number)}", pixels(H, W, seed=number))
        names = [stated.format(split, number) for number in range(count)]
        there += coco(f"ds/{labels.format(split)}", names)
    said = degraded(run, "ds", "ds", "wet", "--variants", "2")
    assert f"{2 * there} of {2 * there} labels kept" in said
    assert "a folder of COCO files, belong to 5 of 5 pictures" in said
    for split, count in {"train": 3, "valid": 2}.items():
        content = json.loads(Path(f"wet/{labels.format(split)}").read_text())
        assert len(content["annotations"]) == 4 * count
        place = picture.format(split, "").rpartition("/")[0]
        above = place if stated == "{1}.jpg" else place.rpartition("/")[0]
        assert all(Path(f"wet/{above}/{i['file_name']}").is_file() for i in content["images"])
        assert len({image["file_name"] for image in content["images"]}) == 2 * count
    # what a run wrote beside them is of no split of theirs
    assert "belong to 5 of 5" in degraded(run, "ds", "ds", "ds/again")
    assert "belong to 5 of 5" in degraded(run, "ds", "ds", "third")


def test_two_files_that_label_one_picture_are_refused(run: Run) -> None:
    save("ds/0.png", pixels(H, W))
    for name in ("instances", "keypoints"):
        coco(f"ds/annotations/{name}.json", ["0.png"])
    flags = ("--labels", "ds/annotations", "--out", "wet", "--distance", "2")
    code, _, err = run("degrade", "ds", *flags)
    assert code != 0
    assert "keypoints.json is one of two that label 0.png: give one" in " ".join(err.split())


@pytest.mark.parametrize("name", ["valid.txt", "val.txt"])
def test_lists_of_darknet_are_splits(name: str, run: Run) -> None:
    for number in range(3):
        save(f"ds/obj/f_{number}.png", pixels(H, W, seed=number))
        write(f"ds/obj/f_{number}.txt", "0 .5 .5 .3 .3\n")
    write("ds/obj.names", "fish\n")
    write("ds/train.txt", "data/obj/f_0.png\ndata/obj/f_2.png\n")
    write(f"ds/{name}", "data/obj/f_1.png\n")
    degraded(run, "ds", "ds", "wet")
    assert Path("wet/train.txt").read_text().count("f_") == 2
    assert Path("wet/val.txt").read_text() == "./images/obj/f_1.png\n"


@pytest.mark.parametrize("split", ["dev", "minival"])
def test_a_folder_of_dev_is_validation(split: str, run: Run) -> None:
    for place in ("train", split):
        save(f"ds/images/{place}/a.png", pixels(H, W))
        write(f"ds/labels/{place}/a.txt", "0 .5 .5 .3 .3\n")
    degraded(run, "ds/images", "ds/labels", "wet")
    assert Path("wet/val.txt").read_text() == f"./images/{split}/a.png\n"
