"""Labels beside pictures: read, judged, written, read again."""

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from uwaug.labels import CocoLabels, LabelSource, MaskLabels, YoloLabels, open_labels, with_contrast

H, W = 6, 8
SIZE = (H, W)
SQUARE = [[2, 1, 5, 1, 5, 4, 2, 4]]  # columns 2…4, rows 1…3


def seen() -> Tensor:
    """A map of contrast: .9 in the left half, .01 in the right."""
    left = torch.full((1, H, W), 0.9)
    left[..., W // 2 :] = 0.01
    return left


def runs(mask: np.ndarray) -> list[int]:
    """COCO's run lengths, one pixel after the other."""
    counts, inside = [0], False
    for pixel in mask.flatten("F").tolist():
        if pixel != inside:
            counts.append(0)
            inside = pixel
        counts[-1] += 1
    return counts


RIGHT = np.zeros(SIZE, bool)
RIGHT[2:5, 5:7] = True

ANNOTATIONS: list[dict[str, Any]] = [
    {"id": 7, "image_id": 1, "category_id": 3, "bbox": [0, 0, 4, 6], "area": 24, "iscrowd": 0},
    {"id": 8, "image_id": 1, "category_id": 3, "bbox": [4, 0, 99, 6], "mine": {"kept": [1]}},
    {"id": 9, "image_id": 1, "category_id": 1, "bbox": [2, 1, 3, 3], "segmentation": SQUARE},
    {
        "id": 10,
        "image_id": 1,
        "category_id": 1,
        "bbox": [0, 0, 8, 6],
        "segmentation": {"size": [H, W], "counts": runs(RIGHT)},
    },
    {"id": 11, "image_id": 2, "category_id": 1, "bbox": [0, 0, 2, 2], "iscrowd": 1},
]
IMAGES = [
    {"id": 1, "file_name": "reef/a.jpg", "height": H, "width": W, "license": 4},
    {"id": 2, "file_name": "b.jpg", "height": H, "width": W},
    {"id": 3, "file_name": "sand/a.jpg", "height": H, "width": W},
]
COCO = {"info": {"year": 2026}, "images": IMAGES, "annotations": ANNOTATIONS, "categories": [{}]}


def coco(folder: Path, **changes: Any) -> Path:
    path = folder / "instances.json"
    path.write_text(json.dumps({**COCO, **changes}))
    return path


def judged(source: LabelSource, picture: str, output: str, least: float | None = 0.05) -> Any:
    """A record as it comes back from a file, of labels as a worker gets them."""
    labels = pickle.loads(pickle.dumps(source.labels_of(picture)))
    record = json.loads(json.dumps(with_contrast(labels, seen(), least)))
    return record | {"output": output}


def test_coco_is_judged_by_segmentation_or_box(tmp_path: Path) -> None:
    record = judged(open_labels(coco(tmp_path)), "reef/a.png", "a.png")
    assert record["picture"] == "reef/a.jpg"
    values = [(one["key"], one["contrast"], one["ignored"]) for one in record["objects"]]
    # the square: two of its three columns are in the left half
    mixed = round((2 * 0.9 + 0.01) / 3, 4)
    assert values == [(7, 0.9, False), (8, 0.01, True), (9, mixed, False), (10, 0.01, True)]


def test_coco_round_trip(tmp_path: Path) -> None:
    source = open_labels(coco(tmp_path))
    before = (tmp_path / "instances.json").read_bytes()
    out = tmp_path / "out"
    out.mkdir()
    records = [judged(source, "b.jpg", "b_deep.png"), judged(source, "reef/a.jpg", "reef/a.png")]
    assert source.labels_of("b.jpg").write(records[0], out / "b.png") == []
    (written,) = source.write_run(iter(records), out)
    found = json.loads(written.read_text())
    assert found["info"] == COCO["info"]
    assert found["categories"] == COCO["categories"]
    assert [image["file_name"] for image in found["images"]] == ["b_deep.png", "reef/a.png"]
    assert found["images"][1] == {**IMAGES[0], "file_name": "reef/a.png"}
    by_id = {entry["id"]: entry for entry in found["annotations"]}
    assert by_id[7] == {**ANNOTATIONS[0], "contrast": 0.9}
    assert by_id[8] == {**ANNOTATIONS[1], "contrast": 0.01, "iscrowd": 1}
    assert by_id[11] == {**ANNOTATIONS[4], "contrast": 0.9}
    assert "ignore" not in by_id[8]
    assert (tmp_path / "instances.json").read_bytes() == before
    again = open_labels(written)
    assert judged(again, "reef/a.png", "x")["objects"] == records[1]["objects"]


def test_coco_of_several_pictures_from_one(tmp_path: Path) -> None:
    source = CocoLabels.read(coco(tmp_path))
    outputs = ["a_1.png", "a_0.png"]
    records = [judged(source, "reef/a.jpg", output, None) for output in outputs]
    found = source.assembled(records)
    assert [image["file_name"] for image in found["images"]] == ["a_0.png", "a_1.png"]
    assert [image["id"] for image in found["images"]] == [1, 2]
    assert [image["source_id"] for image in found["images"]] == [1, 1]
    assert [entry["id"] for entry in found["annotations"]] == list(range(1, 9))
    assert [entry["image_id"] for entry in found["annotations"]] == [1] * 4 + [2] * 4
    assert [entry["source_id"] for entry in found["annotations"]] == [7, 8, 9, 10] * 2
    assert not any(entry.get("iscrowd") for entry in found["annotations"])


def test_pictures_are_found_by_path_name_or_stem(tmp_path: Path) -> None:
    source = open_labels(coco(tmp_path))
    assert source.labels_of("b.png").picture == "b.jpg"
    assert source.labels_of(Path("deep") / "b.jpg").picture == "b.jpg"
    assert source.labels_of("sand/a.jpg").objects(SIZE) == []
    assert source.labels_of("train/sand/a.jpg").picture == "sand/a.jpg"
    with pytest.raises(ValueError, match=r"no image 'wreck/a.jpg'"):
        source.labels_of("wreck/a.jpg")
    with pytest.raises(ValueError, match=r"'a.jpg' may be any of reef/a.jpg, sand/a.jpg"):
        source.labels_of("a.jpg")
    with pytest.raises(ValueError, match=r"no image 'wreck.jpg' \(there are b.jpg, reef/a.jpg"):
        source.labels_of("wreck.jpg")


def test_compressed_run_lengths(tmp_path: Path) -> None:
    """Written by pycocotools 2.0.11."""
    mask = np.zeros((6, 7), bool)
    mask[1:4, 2:5] = mask[5, 6] = mask[0, 0] = True
    packed = {"size": [6, 7], "counts": "01<2G000:N"}
    image = {"id": 1, "file_name": "a.jpg", "height": 6, "width": 7}
    entry = {**ANNOTATIONS[3], "segmentation": packed}
    source = open_labels(coco(tmp_path, images=[image], annotations=[entry]))
    ((_, region),) = source.labels_of("a.jpg").objects((6, 7))
    assert region.mask is not None
    assert np.array_equal(region.mask, mask)


def without(name: str) -> dict[str, Any]:
    return {key: value for key, value in ANNOTATIONS[0].items() if key != name}


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"images": {}}, "expected COCO's format, with a list of 'images'"),
        ({"annotations": [without("id")]}, r"the id None of annotations\[0\] is missing"),
        (
            {"images": [{"id": [1]}]},
            r"the id \[1\] of images\[0\] must be a whole number or a name",
        ),
        ({"annotations": [ANNOTATIONS[0] | {"id": 1.5}]}, r"the id 1\.5 .* must be a whole number"),
        (
            {"annotations": [ANNOTATIONS[0] | {"image_id": [1]}]},
            r"annotation 7: image_id \[1\], wh",
        ),
        ({"annotations": [ANNOTATIONS[0]] * 2}, r"the id 7 of annotations\[1\] is used twice"),
        ({"annotations": [{"id": 1, "image_id": 9}]}, "annotation 1: image_id 9, which no image"),
        ({"images": [{"id": 1}]}, r"image_id 2|image 1: expected a file_name, got None"),
        ({"annotations": [without("bbox")]}, "annotation 7: bbox: expected a list of .*got None"),
        (
            {"annotations": [ANNOTATIONS[0] | {"bbox": [1, 2, 3]}]},
            r"annotation 7: expected a bbox \[x, y, width, height\], got 3 numbers",
        ),
        (
            {"annotations": [ANNOTATIONS[0] | {"segmentation": [[0, 0, 1, 1]]}]},
            "annotation 7: expected three corners or more.*, got 4 numbers",
        ),
        (
            {"annotations": [ANNOTATIONS[0] | {"segmentation": {"size": [6, 8], "counts": [40]}}]},
            r"annotation 7: expected run lengths of \[6, 8\] px, got 40 px",
        ),
        ({"images": [IMAGES[0] | {"width": 99}], "annotations": []}, "was it resized, or turned"),
    ],
)
def test_bad_coco_files(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = coco(tmp_path, **changes)
    with pytest.raises(ValueError, match=message) as refused:
        judged(open_labels(path), "reef/a.jpg", "a.png")
    assert str(path) in str(refused.value)


def test_a_file_that_nests_without_end(tmp_path: Path) -> None:
    (tmp_path / "deep.json").write_text("[" * 100_000)
    with pytest.raises(ValueError, match=r"deep\.json: expected JSON: .* nest too deeply"):
        open_labels(tmp_path / "deep.json")


def test_records_of_other_labels_are_refused(tmp_path: Path) -> None:
    source = CocoLabels.read(coco(tmp_path))
    record = judged(source, "reef/a.jpg", "a.png")
    with pytest.raises(ValueError, match=r"annotation 10: 'a.png' was judged without it"):
        source.assembled([record | {"objects": record["objects"][:3]}])
    with pytest.raises(ValueError, match=r"a record of 'other.jpg', which is no image of it"):
        source.assembled([record | {"picture": "other.jpg"}])
    with pytest.raises(ValueError, match="is the labels' own file: choose another output folder"):
        source.write_run([record], tmp_path)


LINES = "0 0.25 0.5 0.5 1\n\n3 0.75 0.5 0.5 1.0\n2  0.25 0.17 0.625 0.17 0.625 0.66 0.25 0.66 \n"


def yolo(folder: Path, text: str = LINES) -> YoloLabels:
    (folder / "labels/reef").mkdir(parents=True, exist_ok=True)
    (folder / "labels/reef/a.txt").write_text(text)
    source = open_labels(folder / "labels")
    assert isinstance(source, YoloLabels)
    return source


def test_yolo_round_trip(tmp_path: Path) -> None:
    source = yolo(tmp_path)
    labels = source.labels_of("reef/a.jpg")
    record = judged(source, "reef/a.jpg", "x")
    assert source.write_run([record], tmp_path) == []
    out = tmp_path / "out"
    out.mkdir()
    text, values = labels.write(record, out / "a_v1.png")
    assert text == out / "a_v1.txt"
    first, _, _, polygon = LINES.splitlines()
    assert text.read_text() == f"{first}\n{polygon}\n"
    assert values == out / "a_v1.contrast.json"
    mixed = round((2 * 0.9 + 0.01) / 3, 4)
    assert json.loads(values.read_text()) == [
        {"line": 1, "contrast": 0.9, "ignored": False},
        {"line": 3, "contrast": 0.01, "ignored": True},
        {"line": 4, "contrast": mixed, "ignored": False},
    ]
    everything = judged(source, "reef/a.jpg", "x", None)
    text, _ = labels.write(everything, out / "all.png")
    assert text.read_text().split() == LINES.split()


@pytest.mark.parametrize("columns", [24, 12, 51])
def test_yolo_boxes_with_keypoints(columns: int, tmp_path: Path) -> None:
    """12 points of two numbers, 4 or 17 of three: they are no corners of a polygon."""
    keypoints = " ".join(["0.9"] * columns)
    source = yolo(tmp_path, f"0 0.3 0.5 0.2 0.4 {keypoints}\n")
    (tmp_path / "data.yaml").write_text("names: [fish]\nkpt_shape: [12, 2]\n")
    plain = yolo(tmp_path / "plain", "0 0.3 0.5 0.2 0.4\n")
    first, second = (x.labels_of("reef/a.png").objects((40, 60)) for x in (source, plain))
    assert first == second
    record = judged(source, "reef/a.jpg", "x", None)
    text, _ = source.labels_of("reef/a.jpg").write(record, tmp_path / "a_v1.png")
    assert text.read_text().endswith(keypoints + "\n")


def test_yolo_pictures_without_objects(tmp_path: Path) -> None:
    source = yolo(tmp_path, "")
    (tmp_path / "out").mkdir()
    for picture, written in (("reef/a.jpg", ["a.contrast.json", "a.txt"]), ("reef/b.jpg", [])):
        labels = source.labels_of(picture)
        assert labels.objects(SIZE) == []
        record = with_contrast(labels, seen(), 0.5)
        files = labels.write(record, tmp_path / "out/a.png")
        assert sorted(file.name for file in files) == written
    assert (tmp_path / "out/a.txt").read_text() == ""


def test_labels_may_lie_flat(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(LINES)
    assert len(open_labels(tmp_path).labels_of("deep/reef/a.jpg").objects(SIZE)) == 3


def test_labels_in_folders_are_of_the_pictures_in_them(tmp_path: Path) -> None:
    """Another picture's labels would be worse than none."""
    for name in ("1.txt", "train/1.txt", "labels/val/1.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(LINES)
    source = open_labels(tmp_path)
    found = {}
    for picture in ("1.png", "b/1.png", "images/train/1.png", "images/val/1.png", "images/b/1.png"):
        file = source.labels_of(picture).file
        found[picture] = file and Path(file).relative_to(tmp_path).as_posix()
    assert found == {
        "1.png": "1.txt",
        "b/1.png": None,
        "images/train/1.png": "train/1.txt",
        "images/val/1.png": "labels/val/1.txt",
        "images/b/1.png": None,
    }


def test_objects_outside_the_picture_have_no_contrast(tmp_path: Path) -> None:
    outside = [[9, 0, 3, 3], [2, 2, 0, 3], [0, 0, 4, 6]]
    rows = [ANNOTATIONS[0] | {"id": i, "bbox": box} for i, box in enumerate(outside)]
    found = judged(open_labels(coco(tmp_path, annotations=rows)), "reef/a.jpg", "x")["objects"]
    assert [(one["contrast"], one["ignored"]) for one in found] == [
        (0.0, True),
        (0.0, True),
        (0.9, False),
    ]
    source = yolo(tmp_path, "0 1.5 0.5 0.1 0.1\n0 0.5 0.5 0 0.1\n")
    for least, ignored in ((0.05, True), (None, False)):
        found = judged(source, "reef/a.jpg", "x", least)["objects"]
        assert [(one["contrast"], one["ignored"]) for one in found] == [(0.0, ignored)] * 2


def test_inputs_are_never_overwritten(tmp_path: Path) -> None:
    source = yolo(tmp_path)
    labels, record = source.labels_of("reef/a.jpg"), judged(source, "reef/a.jpg", "x")
    with pytest.raises(ValueError, match="is the labels' own file"):
        labels.write(record, tmp_path / "labels/reef/a.png")
    assert (tmp_path / "labels/reef/a.txt").read_text() == LINES


@pytest.mark.parametrize(
    "line, message",
    [
        ("fish 0.5 0.5 0.1 0.1", r"expected a class \(0, 1, …\) first, got 'fish'"),
        ("-1 0.5 0.5 0.1 0.1", "expected a class"),
        ("0 0.5 0.5 0.1", r"expected class cx cy w h, or .*, got 4 columns"),
        ("0 0.5 0.5 0.1 0.1 0.9", "got 6 columns"),
        ("0 0.5 0.5 0.1 wide", "could not convert string to float: 'wide'"),
        ("0 0.5 0.5 nan 0.1", "expected shares of the picture's width and height, 0…1, got nan"),
        ("0 320 240 50 50", "got 320: divide px by width and height"),
    ],
)
def test_bad_yolo_lines(line: str, message: str, tmp_path: Path) -> None:
    source = yolo(tmp_path, f"0 0.5 0.5 0.1 0.1\n{line}\n")
    with pytest.raises(ValueError, match=message) as refused:
        judged(source, "reef/a.jpg", "x")
    assert str(refused.value).startswith(f"{tmp_path / 'labels/reef/a.txt'}, line 2: ")


def masks(folder: Path, values: np.ndarray, void: int | None = None, mode: str = "") -> MaskLabels:
    (folder / "masks").mkdir(exist_ok=True)
    image = Image.fromarray(values)
    if mode == "P":
        image.putpalette([0, 0, 0, 255, 0, 0, 0, 255, 0] + [9] * 759)
    image.save(folder / "masks/a.png")
    source = open_labels(folder / "masks", void=void)
    assert isinstance(source, MaskLabels)
    return source


def instances(dtype: Any = np.uint8) -> np.ndarray:
    values = np.zeros(SIZE, dtype)
    values[1:3, 0:2], values[4, 2:6], values[1:3, 6:8] = 1, 2, 5
    return values


@pytest.mark.parametrize("dtype, gone", [(np.uint8, 255), (np.uint16, 65535)])
def test_masks_round_trip(dtype: Any, gone: int, tmp_path: Path) -> None:
    source = masks(tmp_path, instances(dtype))
    labels, record = source.labels_of("reef/a.jpg"), judged(source, "reef/a.jpg", "x")
    assert source.write_run([record], tmp_path) == []
    (tmp_path / "out").mkdir()
    written, values = labels.write(record, tmp_path / "out/a_0.jpg")
    found, expected = np.asarray(Image.open(written)), instances(dtype)
    expected[expected == 5] = gone
    assert found.dtype == dtype
    assert np.array_equal(found, expected)
    assert json.loads(values.read_text()) == [
        {"value": 1, "contrast": 0.9, "ignored": False},
        {"value": 2, "contrast": 0.455, "ignored": False},
        {"value": 5, "contrast": 0.01, "ignored": True},
    ]
    again = open_labels(tmp_path / "out", void=gone).labels_of("a_0.jpg")
    assert [one.key for one in again.objects(SIZE)] == [1, 2]


def test_masks_keep_their_palette(tmp_path: Path) -> None:
    source = masks(tmp_path, instances(), mode="P")
    labels, record = source.labels_of("a.jpg"), judged(source, "a.jpg", "x")
    (tmp_path / "out").mkdir()
    written, _ = labels.write(record, tmp_path / "out/a.jpg")
    with Image.open(written) as image, Image.open(tmp_path / "masks/a.png") as before:
        assert image.mode == "P"
        assert image.getpalette() == before.getpalette()
        expected = np.where(instances() == 5, 255, instances())
        assert np.array_equal(np.asarray(image), expected)


def test_255_in_use_is_refused_only_where_it_would_be_needed(tmp_path: Path) -> None:
    values = np.where(instances() == 1, 255, instances()).astype(np.uint8)
    (tmp_path / "out").mkdir()
    target = tmp_path / "out/a.png"
    source = masks(tmp_path, values)
    labels = source.labels_of("a.jpg")
    with pytest.raises(ValueError, match="255 marks what is ignored, but it is a value in use"):
        labels.write(judged(source, "a.jpg", "x"), target)
    assert len(labels.write(judged(source, "a.jpg", "x", None), target)) == 2
    known = masks(tmp_path, values, void=255)
    labels = known.labels_of("a.jpg")
    assert [one.key for one in labels.objects(SIZE)] == [2, 5]
    assert len(labels.write(judged(known, "a.jpg", "x"), target)) == 2


def test_bad_masks(tmp_path: Path) -> None:
    source = masks(tmp_path, instances())
    with pytest.raises(ValueError, match=r"it is \(6, 8\) but the picture \(12, 16\) px"):
        source.labels_of("a.jpg").objects((12, 16))
    colour = masks(tmp_path, np.zeros((*SIZE, 3), np.uint8))
    with pytest.raises(ValueError, match=r"expected one channel of whole numbers, .*, got RGB"):
        colour.labels_of("a.jpg").objects(SIZE)


def test_what_is_no_source(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="labels: there is nothing at"):
        open_labels(tmp_path / "none")
    with pytest.raises(ValueError, match=r"labels must be a COCO file .* got"):
        open_labels(tmp_path)
    (tmp_path / "a.txt").touch()
    (tmp_path / "a.png").touch()
    with pytest.raises(ValueError, match="a folder with both"):
        open_labels(tmp_path)
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(ValueError, match="expected JSON"):
        open_labels(tmp_path / "a.json")
    with pytest.raises(ValueError, match="void is a value of masks"):
        open_labels(coco(tmp_path), void=255)


def test_the_map_must_be_the_pictures(tmp_path: Path) -> None:
    labels = open_labels(coco(tmp_path)).labels_of("b.jpg")
    with pytest.raises(ValueError, match=r"image 'b.jpg' is \(6, 8\) there but \(3, 3\) px"):
        with_contrast(labels, torch.ones(1, 3, 3))
    with pytest.raises(ValueError, match=r"min_contrast must be in \[0, 1\], got 5"):
        with_contrast(labels, seen(), 5)
