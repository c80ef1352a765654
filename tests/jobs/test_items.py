"""Which pictures a run degrades, where distances are, and what is refused before it begins."""

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from filing import content, metres, pixels, save

from uwaug.jobs import Degrader, Item, Items, Recipe, preflight

RECIPE = Recipe(water="3C")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Two pictures in folders, with their maps."""
    monkeypatch.chdir(tmp_path)
    for name in ("one/a", "two/a"):
        save(f"all/{name}.png", pixels(seed=len(name)))
        save(f"maps/{name}.npy", metres())
    return tmp_path


def listed(*inputs: str, distance: str | None = "3", out: str = "out", **options) -> list[Item]:
    return list(Items([Path(name) for name in inputs], distance, Path(out), **options))


def checked(*inputs: str, distance: str | None = "3", out: str = "out", recipe=RECIPE, **options):
    how = {name: options.pop(name) for name in ("resume", "force") if name in options}
    items = Items([Path(name) for name in inputs], distance, Path(out), **options)
    preflight(items, recipe, **how)
    return items


def written(item: Item, recipe: Recipe = RECIPE) -> None:
    Degrader(recipe).write(item._replace(distance=3.0))


# Where pictures and distances are


def test_pictures_of_a_folder_by_their_paths():
    items = Items([Path("all")], "maps", Path("out"), variants=2, ending=".jpg")
    assert len(items) == 4
    assert [item.id for item in items] == ["one/a.png"] * 2 + ["two/a.png"] * 2
    names = [item.output.as_posix() for item in items]
    assert names == [
        f"out/{folder}/a_{variant}.jpg" for folder in ("one", "two") for variant in (1, 2)
    ]
    assert [item.distance for item in items][::2] == [
        Path("maps/one/a.npy"),
        Path("maps/two/a.npy"),
    ]


@pytest.mark.parametrize(
    "distance, found",
    [
        ("2.5", 2.5),
        ("z.npy", Path("z.npy")),
        ("{stem}_z.npy", Path("all/one/a_z.npy")),
        ("maps/{stem}.npy", Path("maps/a.npy")),
        ("maps/{name}.npy", Path("maps/one/a.npy")),
    ],
)
def test_where_distances_are(distance, found):
    save("z.npy", metres())
    assert listed("all", distance=distance)[0].distance == found
    assert listed("all", distance=None, unmapped=True)[0].distance is None


def test_of_a_folder_of_maps_none_or_two_fit():
    save("maps/one/a.tif", metres())
    os.remove("maps/two/a.npy")
    one, two = listed("all", distance="maps")
    assert one.problem.endswith("found maps/one/a.npy, maps/one/a.tif")
    assert two.problem.endswith("found none")


@pytest.mark.parametrize("end", ["csv", "parquet"])
def test_manifests(end, folder):
    lines = [
        {"input": "all/one/a.png", "id": "x", "distance": "maps/one/a.npy", "output": "x/1.jpg"},
        {"input": f"{folder}/all/two/a.png", "id": "", "distance": "2.5", "output": ""},
    ]
    if end == "csv":
        with open("list.csv", "w", encoding="utf-8-sig", newline="") as file:
            writer = csv.DictWriter(file, lines[0])
            writer.writeheader()
            writer.writerows(lines)
    else:
        pa = pytest.importorskip("pyarrow")
        import pyarrow.parquet as pq

        pq.write_table(pa.Table.from_pylist(lines), "list.parquet")
    one, two = listed(f"list.{end}", distance=None)
    assert (one.id, one.distance) == ("x", Path("maps/one/a.npy"))
    assert one.output == Path("out/x/1.jpg")
    assert (two.id, two.distance) == (f"{folder}/all/two/a.png", 2.5)
    assert (two.output, two.name) == (Path("out/a.png"), "a.png")


def test_maps_links_and_results_are_no_pictures():
    save("beside/a.png", pixels())
    save("beside/a_depth.png", pixels())
    Path("beside/again").symlink_to("..")
    distance = "{stem}_depth.png"
    (item,) = listed("beside", distance=distance, out="beside/wet")
    written(item)
    assert len(listed("beside", distance=distance, out="beside/wet")) == 1
    assert len(listed("beside", distance=distance, out="beside/wet2")) == 1
    os.remove("beside/wet/a.png.json")
    assert len(listed("beside", distance=distance, out="beside/wet2")) == 2


def test_the_folder_of_a_run_holds_no_pictures():
    """Nor does one inside: its sheets, terms and masks have no records."""
    save("all/wet/sheet.jpg", pixels())
    save("all/wet/labels/a.png", pixels())
    Path("all/wet/index.csv").write_text("id,variant,input,distance,output,water\n")
    assert [item.id for item in listed("all")] == ["one/a.png", "two/a.png"]
    with pytest.raises(ValueError, match=r"all/wet holds what a run has written: give the folder"):
        listed("all/wet")
    Path("all/wet/index.csv").write_text("input\n")
    assert len(listed("all")) == 4


def test_masks_of_a_run_that_was_killed_are_no_pictures():
    save("all/wet/labels/a.png", pixels())
    Path("all/wet/labels/a.contrast.json").touch()
    assert [item.id for item in listed("all")] == ["one/a.png", "two/a.png"]


def test_terms_are_no_pictures():
    written(listed("all/one/a.png", out="wet")[0], Recipe(water="3C", keep_terms=True))
    assert len(list(Path("wet").glob("*.png"))) == 4
    save("wet/b_direct.png", pixels())
    assert [item.id for item in listed("wet")] == ["b_direct.png"]


def test_masks_are_no_pictures():
    for name in ("a", "b"):
        save(f"all/masks/{name}.png", np.ones((4, 4), np.uint8))
    save("all/masks/c.jpg", pixels())
    items = listed("all", labels="all/masks")
    assert [item.id for item in items] == ["masks/c.jpg", "one/a.png", "two/a.png"]
    # YOLO's may lie beside their pictures
    Path("all/one/a.txt").touch()
    assert len(listed("all/one", labels="all/one")) == 1


@pytest.mark.parametrize("pattern", ["all/maps/{stem}.png", "all/maps/{name}.png"])
def test_maps_of_a_pattern_are_no_pictures(pattern, monkeypatch):
    save("all/maps/one/a.png", metres().astype(np.uint16))
    save("all/maps/a.png", metres().astype(np.uint16))
    names = {item.id for item in listed("all", distance=pattern)}
    assert names == {"one/a.png", "two/a.png"} | (
        {"maps/one/a.png"} if "stem" in pattern else set()
    )
    monkeypatch.chdir("all")
    names = {item.id for item in listed(".", distance="maps/{name}.png")}
    assert names == {"one/a.png", "two/a.png"}


def test_a_folder_is_walked_once(monkeypatch):
    walks, walk = [], os.walk
    monkeypatch.setattr(os, "walk", lambda folder: walks.append(folder) or walk(folder))
    items = checked("all", distance="maps")
    assert len(list(items)) == len(items) == 2
    assert len(walks) == 1


def test_a_name_that_no_text_holds_is_a_problem():
    save(os.fsdecode(b"odd/\xfc.png"), pixels())
    (item,) = listed("odd")
    assert "is not UTF-8: rename it" in item.problem


@pytest.mark.parametrize("name", ["01", "2024_01", "1_0", "٣", "3"])
def test_a_folder_called_like_a_number_is_no_metres(name):
    for number in ("one", "two"):
        save(f"{name}/{number}/a.npy", metres())
    if name != "3":
        assert listed("all", distance=name)[0].distance == Path(name, "one/a.npy")
        return
    with pytest.raises(ValueError, match=r"write \./3 for it, or 3\.0 for metres"):
        listed("all", distance=name)
    assert listed("all", distance="3.0")[0].distance == 3
    assert listed("all", distance="./3")[0].distance == Path("3/one/a.npy")


@pytest.mark.parametrize("end", ["csv", "CSV", "parquet"])
def test_manifests_keep_names_to_the_letter(end):
    save(" a .png", pixels())
    line = {"input": " a .png", "distance": "01", "output": " b .png"}
    if end == "parquet":
        pa = pytest.importorskip("pyarrow")
        import pyarrow.parquet as pq

        pq.write_table(pa.Table.from_pylist([line]), "list.parquet")
    else:
        # a space behind a comma is none of the next name, unless it is quoted
        Path(f"list.{end}").write_text('input, output, distance\n" a .png"," b .png", 01\n')
    (item,) = listed(f"list.{end}", distance=None)
    assert (item.input, item.distance) == (Path(" a .png"), Path("01"))
    assert item.output == Path("out/ b .png")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("picture,id\na.png,1\n", "expected a column input, got picture, id"),
        ("", "expected a column input, got none"),
        ("input,id\n,1\n", "line 2 has no input"),
        ("input,output\na.png,../b.png\n", r"output must lie in .* the run, got \.\./b\.png"),
        ("input,output\na.png,/b.png\n", "output must lie in the folder of the run, got /b.png"),
        ("input,distance\na.png,-2\n", "distance must be"),
        ("input\na\x00.png\n", "list.csv"),
    ],
)
def test_manifests_that_are_refused(text, words):
    Path("list.csv").write_text(text)
    with pytest.raises(ValueError, match=words):
        listed("list.csv")


def test_parquet_that_is_refused():
    for text in (b"", b"PAR1 and no more", b"PAR1" + bytes(64) + b"PAR1"):
        Path("list.parquet").write_bytes(text)
        with pytest.raises(ValueError, match=r"list\.parquet: is no Parquet file"):
            listed("list.parquet")


@pytest.mark.parametrize("distance", ["nan", "inf", "-1", "0"])
def test_metres_that_are_none(distance):
    with pytest.raises(ValueError, match="distance must be"):
        listed("all", distance=distance)


def test_what_is_not_there():
    with pytest.raises(ValueError, match=r"expected \{stem\} or \{name\}, got '\{nmae\}.npy'"):
        listed("all", distance="{nmae}.npy")
    with pytest.raises(ValueError, match=r"a\.png has no distances"):
        listed("all", distance=None)
    for missing in (("nowhere.png",), ("all", "nowhere.csv")):
        with pytest.raises(FileNotFoundError):
            listed(*missing)
    os.mkfifo("pipe.png")
    with pytest.raises(OSError, match="is no regular file"):
        listed("pipe.png")
    Path("empty").mkdir()
    with pytest.raises(ValueError, match=r"no pictures in empty: expected \.png"):
        checked("empty")


def test_beside_a_folder_of_labels_pictures_lie_where_trainers_look():
    for name in ("images/train/1", "reef/2"):
        save(f"ds/{name}.png", pixels())
    save("ds/depth/train/1.npy", metres())
    save("ds/depth/reef/2.npy", metres())
    Path("ds/labels").mkdir()
    given = {"distance": "ds/depth", "labels": "ds/labels"}
    first, second = listed("ds", **given, variants=2)[::2]
    assert (first.problem, second.problem) == (None, None)
    assert first.place.as_posix() == "images/train/1_1.png"
    assert first.labels_path.as_posix() == "out/labels/train/1_1.png"
    assert second.place.as_posix() == "images/reef/2_1.png"
    assert second.labels_path.as_posix() == "out/labels/reef/2_1.png"
    # one file that is named lies where it is named
    (alone,) = listed("ds/reef/2.png", distance="3", labels="ds/labels", name="b.jpg")
    assert alone.place.as_posix() == "b.jpg"
    assert alone.labels_path.as_posix() == "out/labels/b.jpg"


@pytest.mark.parametrize("inside", [False, True])
def test_a_file_that_is_named_has_its_labels_where_trainers_look(folder, monkeypatch, inside):
    """In a folder called images, of whatever path."""
    Path("y/images/val").mkdir(parents=True)
    save("b.png", pixels())
    out = "y/images/val"
    if inside:
        monkeypatch.chdir(out)
        out = ""
    given = {"distance": "3", "out": out, "name": "3.png", "labels": folder}
    (alone,) = listed(f"{folder}/b.png", **given)
    assert alone.place.as_posix() == "3.png"
    assert Path(alone.labels_path).absolute() == folder / "y/labels/val/3.png"


# What is refused before it begins


def test_pictures_that_get_in_each_others_way():
    for inputs, words in (
        (("all/one/a.png", "all/two/a.png"), "all/one/a.png and all/two/a.png have one id"),
        (("all/one/a.png", "all/one/a.png"), "all/one/a.png was given twice"),
    ):
        with pytest.raises(ValueError, match=words):
            checked(*inputs)
    save("alike/A.jpg", pixels())
    save("alike/a.png", pixels())
    with pytest.raises(ValueError, match=r"one output, .*: give a manifest with a column"):
        checked("alike", ending=".png")
    save("terms/a.png", pixels())
    save("terms/a_direct.png", pixels())
    with pytest.raises(ValueError, match="have one output"):
        checked("terms", recipe=Recipe(water="3C", keep_terms=True), force=True)
    checked("terms")


def test_pictures_that_would_share_a_file_of_labels():
    save("alike/a.jpg", pixels())
    save("alike/a.png", pixels())
    checked("alike")
    Path("marks").mkdir()
    recipe = Recipe(water="3C", labels="marks")
    with pytest.raises(ValueError, match=r"a\.jpg and alike/a\.png have one output, .*/a\.txt"):
        checked("alike", recipe=recipe, force=True)
    save("beside/f.png", pixels())
    save("beside/f.left.png", pixels())
    checked("beside", recipe=recipe)


def test_a_picture_in_place_of_a_mask():
    Path("marks").mkdir()
    Path("list.csv").write_text("input,output\nall/one/a.png,1.png\nall/two/a.png,labels/1.png\n")
    with pytest.raises(ValueError, match=r"have one output, .*/labels/1\.png"):
        checked("list.csv", recipe=Recipe(water="3C", labels="marks"), force=True)
    checked("list.csv")


def test_two_pictures_do_not_get_one_map_by_their_names(folder):
    lines = "".join(f"{folder}/all/{name}/a.png,{name}.png\n" for name in ("one", "two"))
    Path("list.csv").write_text("input,output\n" + lines)
    save("flat/a.npy", metres())
    with pytest.raises(ValueError, match=r"have one map, flat/a.npy: .* a column distance"):
        checked("list.csv", distance="flat")


def test_what_is_read_is_not_written_over():
    Path("all/list.csv").write_text("input,output\none/a.png,two/a.png\ntwo/a.png,b.png\n")
    with pytest.raises(ValueError, match="would be written over what is read"):
        checked("all/list.csv", out="all", force=True)
    save("maps/one/a.png", pixels())
    with pytest.raises(ValueError, match="would be written over what is read"):
        checked("all/one/a.png", distance="maps/one/a.png", out="maps/one", force=True)
    os.symlink("all", "same")
    for given, out in (("all", "all"), ("same", "all")):
        with pytest.raises(ValueError, match="expected a folder of its own"):
            checked(given, out=out, force=True, ending=".jpg")


def test_what_is_there_stays_unless_forced():
    (item,) = listed("all/one/a.png")
    written(item)
    with pytest.raises(FileExistsError, match=r"out/a\.png exists"):
        checked("all/one/a.png")
    checked("all/one/a.png", force=True)
    checked("all/one/a.png", resume=True)
    with pytest.raises(ValueError, match=r"was made with other options \(water=.*, was .*\)"):
        checked("all/one/a.png", resume=True, recipe=Recipe(water="7C"))


def test_a_link_that_points_nowhere_stays():
    Path("out").mkdir()
    Path("out/a.png").symlink_to("../outside.png")
    with pytest.raises(FileExistsError, match=r"out/a\.png exists"):
        checked("all/one/a.png")
    with pytest.raises(FileExistsError, match=r"out/a\.png exists"):
        written(listed("all/one/a.png")[0])
    assert not Path("outside.png").exists()


def test_a_camera_that_has_changed_is_another_recipe():
    """Of a preset, which names it: pictures of two cameras would be one set."""
    preset = Path(__file__).parents[2] / "configs/survey.toml"
    lines = preset.read_text().splitlines()
    own = ['camera = "cam.csv"' if line.startswith("camera") else line for line in lines]
    assert own != lines
    Path("mine.toml").write_text("\n".join(own))
    rows = [f"{nm},{nm - 390},{abs(nm - 540) + 1},{710 - nm}" for nm in range(400, 701, 10)]
    Path("cam.csv").write_text("\n".join(["wavelength,red,green,blue", *rows]))
    recipe = Recipe(preset="mine.toml").resolved()
    written(listed("all/one/a.png")[0], recipe)
    checked("all/one/a.png", resume=True, recipe=Recipe(preset="mine.toml").resolved())
    Path("cam.csv").write_text("\n".join(["wavelength,red,green,blue", *rows, ""]))
    changed = Recipe(preset="mine.toml").resolved()
    with pytest.raises(ValueError, match=r"cam\.csv has changed since out/a\.png was made of it"):
        checked("all/one/a.png", resume=True, recipe=changed)


def test_a_file_of_labels_of_somebody_else_stays():
    Path("coco.json").write_text("{}")
    Path("out").mkdir()
    Path("out/coco.json").write_text("mine")
    recipe = Recipe(water="3C", labels="coco.json")
    for how in ({}, {"resume": True}):
        with pytest.raises(FileExistsError, match=r"out/coco\.json exists"):
            checked("all", recipe=recipe, **how)
    with pytest.raises(FileExistsError, match=r"out/coco\.json exists"):
        checked("all/one/a.png", recipe=recipe, name="b.png")
    Path("out/index.csv").touch()
    checked("all", recipe=recipe)
    assert set(content("out")) == {"coco.json", "index.csv"}
