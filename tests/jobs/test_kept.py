"""`uwaug degrade`: what is the user's stays, and what was made stays true."""

import csv
import json
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
from filing import H, W, content, metres, pixels, save

WATER = ("--water", "3C")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Two pictures with their maps."""
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b"):
        save(f"all/{name}.png", pixels(seed=ord(name)))
        save(f"maps/{name}.npy", metres())
    return tmp_path


def went_well(run, *arguments: str) -> str:
    code, out, err = run("degrade", *arguments)
    assert (code, err) == (0, "")
    return out


def refused(run, *arguments: str) -> str:
    code, _, err = run("degrade", *arguments)
    assert code == 2
    return err


def coco(path: str, *names: str) -> None:
    images, marks = [], []
    for i, name in enumerate(names):
        images.append({"id": i, "file_name": name, "height": H, "width": W})
        marks.append({"id": i, "image_id": i, "category_id": 1, "bbox": [1, 1, 5, 5]})
    Path(path).write_text(json.dumps({"images": images, "annotations": marks}))


def labelled(path: str) -> list[str]:
    return sorted(image["file_name"] for image in json.loads(Path(path).read_text())["images"])


def test_a_rehearsal_writes_nothing_anywhere(run, monkeypatch, tmp_path):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    save("deep/in/it/a.png", pixels())
    save("marks/in/it/a.txt".replace(".txt", ".png"), np.ones((H, W), np.uint8))
    went_well(
        run, "deep", "--distance", "3", *WATER, "--labels", "marks", "--out", "out", "--dry-run"
    )
    assert not Path("out").exists()
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("changed", ["all/a.png", "maps/a.npy", "marks/a.png"])
def test_resume_sees_other_content_of_the_same_size(run, changed):
    for name in ("a", "b"):
        save(f"marks/{name}.png", np.ones((H, W), np.uint8))
    given = ("all", "--distance", "maps", *WATER, "--labels", "marks", "--out", "out")
    went_well(run, *given)
    size = os.path.getsize(changed)
    values = {"all": pixels(seed=ord("a")), "maps": metres() * 3, "marks": np.ones((H, W))}
    found = np.array(values[changed.split("/")[0]])
    found = np.roll(found, 1, 0) if changed == "all/a.png" else found
    if changed == "marks/a.png":
        found = np.full((H, W), 2)
    save(changed, found.astype(np.float32 if changed.endswith("npy") else np.uint8))
    Path(changed).write_bytes(Path(changed).read_bytes().ljust(size, b"\0"))
    code, _, err = run("degrade", *given, "--resume")
    assert (code, "a.png exists" in err) == (1, True)


def test_a_file_of_labels_keeps_those_of_earlier_runs(run):
    coco("marks.json", "a.png", "b.png")
    given = ("--distance", "3", *WATER, "--labels", "marks.json", "--out", "out")
    went_well(run, "all/a.png", *given)
    assert labelled("out/marks.json") == ["a.png"]
    assert "marks.json exists" not in run("degrade", "all/b.png", *given)[2]
    assert labelled("out/marks.json") == ["a.png", "b.png"]


def test_a_file_of_labels_of_somebody_else_is_kept(run):
    coco("marks.json", "a.png")
    Path("out").mkdir()
    Path("out/marks.json").write_text("mine")
    given = ("all/a.png", "--distance", "3", *WATER, "--labels", "marks.json", "--out", "out")
    assert "out/marks.json exists" in refused(run, *given, "--resume")
    assert Path("out/marks.json").read_text() == "mine"


def test_labels_that_are_nowhere_are_missed(run):
    save("marks/other.png", np.ones((H, W), np.uint8))
    given = ("all", "--distance", "3", *WATER, "--labels", "marks", "--out", "out")
    code, _, err = run("degrade", *given)
    assert (code, "none of the pictures has labels in" in err) == (1, True)


def test_what_is_read_is_not_written_over(run):
    np.save("maps/a", metres())
    save("maps/a.png", (1000 * metres()).astype(np.uint16))
    os.remove("maps/a.npy")
    before = content("maps")
    given = ("--distance", "maps", "--distance-unit", "mm", *WATER, "--out", "maps", "--force")
    assert "would be written over what is read" in refused(run, "all/a.png", *given)
    assert content("maps") == before
    Path("all/list.csv").write_text("input,output\na.png,b.png\nb.png,c.png\n")
    given = ("--distance", "3", *WATER, "--out", "all", "--force")
    before = content("all")
    assert "would be written over what is read" in refused(run, "all/list.csv", *given)
    assert content("all") == before


def test_two_pictures_do_not_get_one_map_by_their_names(run, tmp_path):
    save("other/a.png", pixels())
    lines = f"input,output\n{tmp_path}/all/a.png,1.png\n{tmp_path}/other/a.png,2.png\n"
    Path("list.csv").write_text(lines)
    err = refused(run, "list.csv", "--distance", "maps", *WATER, "--out", "out")
    assert "have one map, maps/a.npy: give a manifest with a column distance" in err


def test_maps_and_results_are_no_pictures(run):
    save("beside/a.png", pixels())
    save("beside/a_depth.png", (1000 * metres()).astype(np.uint16))
    given = ("--distance", "{stem}_depth.png", "--distance-unit", "mm", *WATER)
    assert went_well(run, "beside", *given, "--out", "beside/wet").startswith("1 of 1")
    assert went_well(run, "beside", *given, "--out", "beside/wet2").startswith("1 of 1")


def test_a_name_that_no_text_holds_fails_alone(run):
    Path(os.fsdecode(b"all/\xfc.png")).write_bytes(Path("all/a.png").read_bytes())
    code, out, err = run("degrade", "all", "--distance", "3", *WATER, "--out", "out")
    assert (code, "2 of 3" in out, "is not UTF-8: rename it" in err) == (1, True, True)
    assert Path("out/index.csv").exists()


def test_an_index_is_a_list(run):
    went_well(run, "all", "--distance", "maps", *WATER, "--out", "out")
    went_well(run, "out/index.csv", *WATER, "--out", "again")
    assert content("again")["a.png"] == content("out")["a.png"]
    with open("again/index.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["distance"] for row in rows] == ["../maps/a.npy", "../maps/b.npy"]


def test_a_record_holds_from_any_folder(run, monkeypatch, tmp_path):
    assert run("preset", "copy", "survey", "mine.toml")[0] == 0
    given = ("all/a.png", "--distance", "maps/a.npy", "--preset", "mine.toml", "--out", "out")
    went_well(run, *given)
    Path("all").rename("moved")
    Path("elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    record = ("--from", "../out/a.png.json", "--out", "again")
    code, _, err = run("degrade", *record)
    assert (code, "if it was moved, name it" in err) == (1, True)
    assert "the same bytes" in went_well(run, "../moved/a.png", *record)


def test_force_leaves_labels_that_no_run_has_written(run):
    given = ("all/a.png", "--distance", "3", *WATER, "--out", "out")
    went_well(run, *given)
    save("out/labels/a.png", np.ones((H, W), np.uint8))
    before = content("out/labels")
    went_well(run, *given, "--force")
    code, _, err = run("degrade", *given, "--labels", "out/labels", "--force")
    assert (code, "the labels' own file" in err) == (1, True)
    assert content("out/labels") == before


def test_force_leaves_nothing_of_the_picture_before(run):
    save("marks/a.png", np.ones((H, W), np.uint8))
    given = ("all/a.png", "--distance", "3", *WATER, "--out", "out")
    went_well(run, *given, "--labels", "marks", "--keep-terms")
    assert {"a_direct.png", "labels/a.png"} <= set(content("out"))
    went_well(run, *given, "--force")
    assert not {"a_direct.png", "labels/a.png"} & set(content("out"))
