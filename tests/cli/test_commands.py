import csv
import inspect
import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image

import uwaug
from uwaug.cli.choices import with_tables
from uwaug.cli.degrade import degrade
from uwaug.distance import MadeUp, Metres, Plane, Relative
from uwaug.transforms.random_underwater import SEVERITIES


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Two pictures, and their maps as a depth camera writes them: mm, with holes."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    for name in ("a", "b"):
        picture = rng.integers(0, 255, (24, 32, 3), np.uint8)
        depth = np.linspace(1000, 4000, 24 * 32).reshape(24, 32).astype(np.uint16)
        depth[3:5, 4:9] = 0
        for path, values in ((f"photos/{name}.png", picture), (f"depth/{name}.png", depth)):
            (tmp_path / path).parent.mkdir(exist_ok=True)
            Image.fromarray(values).save(tmp_path / path)
    return tmp_path


MAPS = ("--distance", "depth", "--unit", "mm", "--holes", "behind", "--workers", "1")


def test_the_example_of_degrade_runs_on_a_depth_cameras_maps(folder, run):
    code, out, err = run("degrade", "photos", *MAPS, "--out", "wet", "--sheet")
    assert (code, err) == (0, "")
    assert "2 of 2 pictures written to wet" in out
    assert {path.name for path in (folder / "wet").iterdir()} == {
        *("a.png", "a.png.json", "b.png", "b.png.json"),
        *("index.csv", "table.csv", "sheet.jpg", "uwaug-run.json"),
    }
    with open("wet/index.csv", newline="") as file:
        assert [row["status"] for row in csv.DictReader(file)] == ["written", "written"]
    # the table beside the results makes them again
    line = ("degrade", "wet/table.csv", *MAPS[2:], "--out", "again")
    assert run(*line)[0] == 0
    assert written(folder / "again") == written(folder / "wet")


def test_a_dry_run_shows_rows_and_what_has_none(folder, run):
    for n in range(8):
        Image.new("RGB", (32, 24)).save(f"photos/c{n}.png")
    before = sorted(folder.rglob("*"))
    code, out, err = run("degrade", "photos", *MAPS, "--dry-run", "--out", "wet")
    assert (code, err) == (0, "")
    counts, header, *rows = out.splitlines()
    assert counts == "10 pictures; 2 have maps, 8 have none: c0.png, c1.png and others"
    assert header == "name,picture,distance,labels,split,film,time"
    assert rows[0] == "a.png,photos/a.png,depth/a.png,,,,"
    assert len(rows) == 8
    assert sorted(folder.rglob("*")) == before
    code, _, err = run("degrade", "photos", *MAPS, "--out", "wet")
    assert code == 2
    assert "8 of 10 pictures have no map, such as c0.png: write it in the column distance" in err
    assert sorted(folder.rglob("*")) == before


def test_a_dry_run_refuses_what_the_run_would(folder, run):
    tables = {
        "name\nx.png\nx.png": "two rows are called x.png",
        "film,time\nf,1\nf,": "has none: give each of its rows one",
    }
    for text, words in tables.items():
        header, *cells = text.split("\n")
        rows = [f"photos/{n}.png,{cell}" for n, cell in zip("ab", cells, strict=True)]
        (folder / "t.csv").write_text("\n".join([f"picture,{header}", *rows]))
        code, _, err = run("degrade", "t.csv", "--dry-run", "--out", "wet")
        assert (code, words in err) == (2, True)


def test_a_table_says_maps_labels_films_and_splits(folder, run):
    rows = ("photos/b.png,depth/a.png,valid,f", "photos/a.png,depth/a.png,,f")
    text = "\n".join(["picture,distance,split,film", *rows])
    (folder / "t.csv").write_text(text)
    code, out, err = run("degrade", "t.csv", *MAPS[2:], "--set", "drift=.5", "--out", "wet")
    assert (code, err) == (0, "")
    assert out.startswith("2 pictures; 2 have maps; 1 are of val, 1 are of no split; 1 film\n")
    assert "val gets wet, too" in out
    records = [json.loads(Path(f"wet/photos/{n}.png.json").read_text()) for n in "ba"]
    assert [r["params"]["samples"][0]["moved"] for r in records] == [0, 0.5]
    for flags in (("--distance", "depth"), ("--labels", "depth"), ("--sequence",)):
        code, _, err = run("degrade", "t.csv", *flags, "--out", "other")
        assert (code, f"t.csv is a table, which says it: leave out {flags[0]}" in err) == (2, True)


def test_pictures_that_stay_dry(folder, run):
    for n in range(6):
        Image.new("RGB", (32, 24), (n, 90, 60)).save(f"photos/c{n}.png")
    flags = ("--distance", "2", "--set", "p=0.4", "--workers", "1", "--sheet", "--out", "wet")
    code, out, err = run("degrade", "photos", *flags)
    assert (code, err) == (0, "")
    assert "8 of 8 pictures written" in out
    records = [json.loads(path.read_text()) for path in Path("wet").glob("*.png.json")]
    dry = [r["row"]["name"] for r in records if not r["params"]["samples"][0]["applied"]]
    assert 0 < len(dry) < 8
    for name in dry:
        made, photo = (np.array(Image.open(f"{place}/{name}")) for place in ("wet", "photos"))
        assert np.array_equal(made, photo)


def test_grades_and_maps(folder, run):
    line = ("degrade", "photos", *MAPS, "--out")
    code, out, err = run(*line, "graded", "--severity", "all")
    assert (code, err) == (0, "")
    for level, contrast in SEVERITIES.items():
        assert f"2 of 2 pictures written to {Path('graded', str(level))}" in out
        record = json.loads(Path(f"graded/{level}/a.png.json").read_text())
        assert record["params"]["samples"][0]["water"]["contrast"] == contrast
        assert record["truth"] is None
    code, out, err = run(*line, "pairs", "--severity", "3", "--maps", "npy")
    assert (code, err) == (0, "")
    assert written(folder / "pairs") == written(folder / "graded" / "3")
    truth = json.loads(Path("pairs/a.png.json").read_text())["truth"]
    signal, veil, z = (np.load(f"pairs/maps/a_{name}.npy") for name in ("signal", "veil", "z"))
    assert (signal.shape, z.shape) == ((24, 32, 3), (24, 32))
    light = (signal + veil) @ np.array(truth["gain"]).T
    assert np.isfinite(light).all()
    Path("pairs/maps/a_veil.npy").unlink()  # it is missed
    assert run(*line, "pairs", "--severity", "3", "--maps", "npy", "--resume")[0] == 0
    assert np.array_equal(np.load("pairs/maps/a_veil.npy"), veil)
    assert run(*line, "pairs", "--water", "II", "--force")[0] == 0
    assert not list(Path("pairs/maps").iterdir())  # they were of another water


def written(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix == ".png"}


def test_pictures_alone_get_distances_that_are_made_up(folder, run):
    bare = ("degrade", "photos", "--variants", "2", "--workers", "1", "--out")
    code, out, err = run(*bare, "wet", "--sheet")
    assert (code, err) == (0, "")
    assert out.count("are guessed") == 1
    assert "not to measure or restore by" in out
    assert "4 of 4 pictures written to wet" in out
    assert (folder / "wet/sheet.jpg").is_file()
    # said explicitly, by one process, they are the same; and nobody is told twice
    code, out, _ = run(*bare, "again", "--distance", "made-up", "--set", "distance.cue=network")
    assert code == 0
    assert "guessed" not in out
    assert len(written(folder / "wet")) == 4
    assert written(folder / "wet") == written(folder / "again")
    assert run("degrade", "wet/b_2.png.json", "--out", "b.png")[0] == 0
    assert (folder / "b.png").read_bytes() == (folder / "wet/b_2.png").read_bytes()
    (folder / "wet/b_2.png").unlink()
    code, out, _ = run(*bare, "wet", "--resume")
    assert code == 0
    assert "1 of 4 pictures written to wet, 3 were there" in out
    assert written(folder / "wet") == written(folder / "again")


def test_the_help_of_degrade_groups_its_flags(run):
    code, out, err = run("degrade", "--help")
    assert (code, err) == (0, "")
    _, *boxes = re.split("╭─ (\\w+) ─+╮", out)
    assert boxes[::2] == ["Arguments", *("Output", "Distance", "Water", "Run", "Films", "Labels")]
    flags = {
        title: re.findall(r"^│ [* ]*--([\w-]+)", box, re.MULTILINE)
        for title, box in zip(boxes[::2], boxes[1::2], strict=True)
    }
    assert flags["Labels"] == ["labels", "classes", "min-contrast"]
    assert "focal-px" in flags["Distance"]
    names = {name.rstrip("_").replace("_", "-") for name in inspect.signature(degrade).parameters}
    every = [name for group in flags.values() for name in group]
    assert sorted(every) == sorted(names - {"context", "pictures"} | {"help"})


def test_a_record_takes_no_other_options(folder, run):
    assert run("degrade", "photos/a.png", "--distance", "3", "--out", "wet")[0] == 0
    record = "wet/a.png.json"
    code, _, err = run("degrade", record, "--water", "9C", "--seed", "0", "--out", "b.png")
    assert code == 2
    assert "a.png.json is a record, which says all but --out: not --seed, --water" in err
    assert not (folder / "b.png").exists()


def test_options_reach_the_transform(folder, run):
    (folder / "options.toml").write_text(
        "[water]\nmixing = [0, 1]\n[development]\nsaturation = 1.2\n"
    )
    code, _, err = run(
        *("degrade", "photos/a.png", "--distance", "3", "--out", "wet", "--workers", "1"),
        *("--water", "3C", "--water", "II", "--contrast", ".2:.5", "--options", "options.toml"),
        *("--set", "water.vertical_depth=0:5", "--set", "development.tone=1"),
        *("--set", "water.field=none", "--set", "water.snow.density=500:5000"),
        *("--set", "development.noise.full_well=2000:9000", "--set", "quality=80"),
    )
    assert (code, err) == (0, "")
    recipe = json.loads((folder / "wet/a.png.json").read_text())["recipe"]
    transform = uwaug.RandomUnderwater.from_dict(recipe["transform"])
    water = transform.water
    assert water.waters == ("3C", "II")
    assert (water.contrast, water.vertical_depth) == ((0.2, 0.5), (0, 5))
    assert (water.mixing, water.field) == ((0, 1), None)
    assert water.snow == uwaug.MarineSnow((500, 5000))
    assert (transform.development.noise, recipe["quality"]) == (uwaug.Sensor((2000, 9000)), 80)
    assert (transform.development.saturation, transform.development.tone) == (1.2, 1)
    assert transform.distance == uwaug.distance.Plane(3.0)


def test_pictures_like_a_photograph(folder, run, monkeypatch):
    few = partial(uwaug.like, draws=30, keep=2)
    monkeypatch.setattr("uwaug.files.prepare.like", few)
    murky = np.random.default_rng(1).integers(0, 90, (24, 32, 3), np.uint8)
    murky[..., 1] += 60
    Image.fromarray(murky).save(folder / "green.png")
    line = ("degrade", "photos", *MAPS, "--like", "green.png", "--contrast", ".2:.5", "--out")
    code, out, err = run(*line, "wet")
    assert (code, err) == (0, "looking for waters like the photographs\n")
    assert re.search("like green.png: (near|fair|far from all that was tried): ", out)
    assert "2 of 2 pictures written to wet" in out
    recipe = json.loads((folder / "wet/a.png.json").read_text())["recipe"]
    transform = uwaug.RandomUnderwater.from_dict(recipe["transform"])
    contrasts = [row["water"]["contrast"] for row in transform.conditions.rows]
    assert [0.2 <= contrast <= 0.5 for contrast in contrasts] == [True, True]
    # a folder, and more of them; the real ones stand on the sheet
    (folder / "dives/more").mkdir(parents=True)
    for name in ("dives/a.png", "dives/more/b.png"):
        Image.fromarray(murky).save(folder / name)
    code, out, _ = run(*line, "both", "--like", "dives", "--sheet")
    assert "like 3 photographs: " in out
    recipe = json.loads((folder / "both/a.png.json").read_text())["recipe"]
    assert len(recipe["transform"]["conditions"]["rows"]) == 6
    with Image.open(folder / "both/sheet.jpg") as sheet:
        shown = np.asarray(sheet, float)[12:, 12:]
    # two pairs, and below them the real ones
    assert shown.shape == (2 * 246, 4 * 252, 3)
    for x in range(0, 3 * 252, 252):
        picture = shown[304:476, x + 4 : x + 236].mean((0, 1))
        assert abs(picture - murky.mean((0, 1))).max() < 8
    # the same draws are kept again, and a record makes the same picture
    assert "2 were there" in run(*line, "wet", "--resume")[1]
    assert run("degrade", "wet/b.png.json", "--out", "b.png")[0] == 0
    assert (folder / "b.png").read_bytes() == (folder / "wet/b.png").read_bytes()


def test_a_preset_degrades_as_its_module(folder, run):
    flags = ("--distance", "0.5", "--preset", "tank-proposed-1", "--set", "water.field=none")
    assert run("degrade", "photos/a.png", *flags, "--out", "tank", "--workers", "1")[0] == 0
    image = torch.from_numpy(np.array(Image.open("photos/a.png"))).permute(2, 0, 1)
    module = uwaug.load_preset("tank-proposed-1").module()
    wanted = module(image, torch.full((1, 24, 32), 0.5)).permute(1, 2, 0)
    made = torch.from_numpy(np.array(Image.open("tank/a.png")))
    assert (made.int() - wanted.int()).abs().max() <= 1


@pytest.mark.parametrize(
    ("flags", "source"),
    [
        ("", MadeUp()),
        ("--distance 1:5", Plane((1.0, 5.0))),
        ("--distance depth --unit mm --holes behind", Metres("behind")),
        (
            "--distance depth --set distance.kind=Relative --set distance.holes=fill",
            Relative(holes="fill"),
        ),
    ],
)
@pytest.mark.parametrize("preset", ["survey", "tank-proposed-1"])
def test_a_preset_takes_distances_of_all_kinds(folder, run, preset, flags, source):
    line = ("degrade", "photos/a.png", "--preset", preset, *flags.split(), "--out", "wet")
    code, _, err = run(*line)
    assert (code, err) == (0, "")
    recipe = json.loads((folder / "wet/a.png.json").read_text())["recipe"]
    transform = uwaug.RandomUnderwater.from_dict(recipe["transform"])
    wanted = replace(uwaug.load_preset(preset), distance=source)
    assert transform.to_dict() == wanted.to_dict()


@pytest.mark.parametrize(
    ("flags", "source"), [("", Plane((0.5, 4.0))), ("--distance made-up", MadeUp())]
)
def test_a_preset_that_reads_no_maps_has_distances(folder, run, flags, source):
    line = ("degrade", "photos/a.png", "--preset", "wet", *flags.split(), "--out", "wet")
    code, out, err = run(*line)
    assert (code, err) == (0, "")
    assert "guessed" not in out.split("\n")[1] or flags
    transform = json.loads((folder / "wet/a.png.json").read_text())["recipe"]["transform"]
    assert uwaug.RandomUnderwater.from_dict(transform).distance == source


@pytest.mark.parametrize("preset", ["survey", "tank-proposed-1"])
def test_the_file_of_a_preset_is_a_file_of_options(folder, run, preset):
    np.save("t.npy", np.linspace(0, 1, 24 * 32).reshape(24, 32))
    (folder / "p.toml").write_text(run("preset", "show", preset)[1])
    line = "degrade photos/a.png --distance t.npy --options p.toml --out wet"
    code, _, err = run(*line.split())
    assert (code, err) == (0, "")
    record = json.loads((folder / "wet/a.png.json").read_text())
    transform = uwaug.load_preset(preset)
    assert record["recipe"]["transform"] == transform.to_dict()


def test_a_table_of_another_kind_takes_the_place_of_one(tmp_path):
    (tmp_path / "mine.toml").write_text('[distance]\nkind = "Metres"\n[water]\nmu = 0.03\n')
    preset = {"distance": {"kind": "Relative", "near": 1.0}, "water": {"g": 0.05}}
    assert with_tables(preset, tmp_path / "mine.toml") == {
        "distance": {"kind": "Metres"},
        "water": {"g": 0.05, "mu": 0.03},
    }


def test_tables_of_a_file_of_options_lie_beside_it(folder, run):
    (folder / "own").mkdir()
    water = "wavelength,a,b,kd\n400,.5,1,.7\n700,.7,1,.8\n"
    (folder / "own/harbour.csv").write_text(water)
    (folder / "own/o.toml").write_text('water = "harbour.csv"\n')
    line = ("degrade", "photos/a.png", "--plain", "--distance", "2", "--out", "wet")
    assert run(*line, "--options", "own/o.toml")[0] == 0
    (sample,) = json.loads((folder / "wet/a.png.json").read_text())["params"]["samples"]
    assert sample["water"] == {"waters": ["harbour"], "mixing": 0, "vertical_depth": 0, "g": 0.2}


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("degrade nowhere --out wet", "nowhere"),
        ("degrade photos --distance depth --unit miles --out wet", "Error: --unit must be one of"),
        ("degrade photos --distance 3 --contrast 2 --out wet", "Error: --contrast must be"),
        ("degrade photos --variants=0 --out wet", "Error: --variants must be 1 or more"),
        ("degrade photos --min-contrast 2 --out wet", "Error: --min-contrast must be in [0, 1]"),
        ("degrade photos --set drift=.1 --out wet", "is of films: give --sequence"),
        ("degrade photos --sequence --set motion=fast --out wet", "motion must be three numbers"),
        ("page --distance nowhere.npy --unit mm --out page.html", "of a picture: give --image"),
        (
            "fit --clean a.png --observed b.png --distance z.npy --out f.json --model waters "
            "--gain fixed",
            "--gain fixed needs --clean, and another model",
        ),
        (
            "fit --clean a.png --observed b.png --distance 3 --out f.json --mu .02",
            "--mu is of --model waters",
        ),
        (
            "fit --clean a.png --observed b.png --distance 3 --out f.json --darkest 0",
            "--darkest is of fits without --clean",
        ),
        ("fit --observed b.png --distance 3 --out f.json --model waters", "needs --clean"),
        ("degrade photos --set vertical_depth=1 --out wet", "has no 'vertical_depth', only water,"),
        ("degrade photos --out depth", "depth is not empty, and of no run"),
        (
            "degrade photos --set water.contarst=.3 --out wet",
            "RandomWater has no 'contarst', only waters, visibility, ",
        ),
        ("degrade photos --distance depth --set distance.kind=inverse --out wet", "mean Inverse?"),
        ("degrade photos --options night.toml --out wet", "did you mean light?"),
        ("degrade photos --contrast .3 --set water.contrast.low=1 --out wet", "0.3, no table"),
        ("degrade photos --plain --water 3C --out wet", "give both, one --water and --distance"),
        ("degrade photos --plain --preset survey --distance 3 --out wet", "exclude each other"),
        ("degrade photos --distance 3 --water 4C --out wet", "water must be one of"),
        ("degrade photos --distance 3 --preset nothing --out wet", "nothing"),
        ("degrade photos --like nothing.png --out wet", "nothing.png"),
        ("degrade photos --severity 6 --out wet", "1 (mild) to 5 (severe), or all, got '6'"),
        ("degrade photos --severity 2 --set water.contrast=.5 --out wet", "--severity is a contr"),
        ("degrade photos --severity 2 --options murk.toml --out wet", "--severity is a contrast"),
        ("degrade photos --maps png --out wet", "maps must be"),
        ("export --out x.onnx", "expected one preset"),
        ("export survey --preset survey --out x.onnx", "expected one preset"),
        ("export nothing --out x.onnx", "nothing"),
        ("export --preset survey --out x.bin", ".onnx"),
        ("plot photos/a.png --distance depth/b.png", "is the unit mm"),
        ("plot photos/a.png --distance 3 --out a.jpg", "--out must be a folder"),
        ("demo --out demo.png", "--out must be a folder"),
        ("depth photos --network none.onnx --out maps.png", "--out must be a folder"),
        ("compare photos/a.png --distance 3 --out sheets", "--out must end in .png or .jpg"),
        # nothing is invented for pixels without a distance unless that is asked for
        *(
            (f"{command} --distance depth/a.png --unit mm {flags}", "--holes")
            for command, flags in (
                ("degrade photos", "--out wet"),
                ("plot photos/a.png", ""),
                ("compare photos/a.png", "--out a.png"),
                ("page --image photos/a.png", ""),
                ("fit --clean photos/a.png --observed photos/b.png", "--out fit.json"),
            )
        ),
        ("degrade photos --distance depth --unit mm --out wet", "--holes behind"),
        ("degrade photos --unit mm --out wet", "distance is missing"),
        ("degrade photos --view 20 --focal-px 40 --out wet", "degrees and focal_px say the same"),
        ("preset show nothing", "nothing"),
        ("plot photos/a.png --distance 3 --holes near", "Error: --holes must be one of"),
        ("check photos/a.png", "a.png"),
        ("page --out page.htm", "--out must end in .html"),
        ("page --water 4C --out page.html", "water must be one of"),
        ("page --image photos/a.png --distance depth/b.png --out page.html", "a median of"),
    ],
)
def test_what_is_refused_in_one_line(folder, run, line, words):
    (folder / "night.toml").write_text("[ligth]\ndaylight = 0.2\n")
    (folder / "murk.toml").write_text("[water]\ncontrast = 0.4\n")
    code, _, err = run(*line.split())
    assert code in (1, 2)
    assert err.startswith("Error: ")
    assert words in err
    assert "Traceback" not in err


def test_demo_draws_the_scene(small, run, tmp_path):
    code, out, err = run("demo", "--out", str(tmp_path / "demo"))
    assert (code, err.count("drawing ")) == (0, 2)
    assert "2 pictures" in out
    assert len(list((tmp_path / "demo").iterdir())) == 2


def test_plot_and_compare_draw_a_picture_of_ones_own(folder, run):
    scene = ("photos/a.png", "--distance", "depth/a.png", "--unit", "mm", "--holes", "behind")
    code, out, err = run("plot", *scene, "--water", "3C")
    assert (code, err) == (0, "drawing 1-waters.jpg\ndrawing 2-terms.jpg\n")
    assert "unknown" in out  # what was done to holes
    systems = ("--system", "akkaynak-2018", "--system", "UWCNN")
    assert run("compare", *scene, *systems, "--out", "systems.jpg")[0] == 0
    assert (folder / "systems.jpg").stat().st_size > 0


NIGHT = """
water = {vertical_depth = 30, waters = "II"}
view = {degrees = 40}
light = {daylight = 0.2, lamps = [{power = 2.0, cone = 45.0}]}
"""


@pytest.mark.parametrize("flags", [(), ("--water", "7C"), ("--coefficients",)])
def test_options_of_a_file_are_exported(flags, folder, run, monkeypatch):
    def written(module, path, **options):
        modules.append(module)
        path.touch()

    modules = []
    monkeypatch.setattr("uwaug.onnx.export_onnx", written)
    Path("night.toml").write_text(NIGHT)
    line = ("export", "calibrated", "--options", "night.toml", *flags, "--out", "night.onnx")
    code, out, err = run(*line)
    assert (code, err) == (0, "")
    assert len(modules[0].medium) == (15 if "--coefficients" in flags else 1)
    assert ("7C: " if "7C" in flags else "II: ") in out
    assert "30 m deep, g = 0.05" in out
    lamp = uwaug.light.Lamp(power=2.0, cone=45.0)
    assert modules[0].light == uwaug.Light([lamp], daylight=0.2)
    assert modules[0].view.degrees == 40


def test_a_veil_is_estimated_without_a_clean_picture(folder, run):
    z = torch.linspace(1, 9, 48 * 64).reshape(1, 48, 64)
    clean = torch.rand(3, 48, 64, generator=torch.Generator().manual_seed(0)) ** 4
    medium = uwaug.Medium.from_coefficients((0.4,) * 3, (0.4,) * 3, (0.1, 0.3, 0.4))
    np.save("z.npy", z[0].numpy())
    np.save("wet.npy", uwaug.Underwater(medium)(clean, z).permute(1, 2, 0).numpy())
    line = ("fit", "--observed", "wet.npy", "--distance", "z.npy", "--model", "veil")
    for flags, state in (((), "not identified"), (("--darkest", "0"), "free")):
        code, out, _ = run(*line, *flags, "--out", "veil.json", "--force", "--figure", "veil.png")
        assert code == 0
        number = json.loads((folder / "veil.json").read_text())["parameters"]["G_red"]
        assert number["state"] == state
        assert ("darkest=0 (--darkest 0), would tell" in out) == (not flags)


def test_a_haze_of_encoded_values_is_fitted_and_made_again(folder, run):
    z = torch.linspace(0.5, 5, 48 * 64).reshape(1, 48, 64)
    clean = torch.rand(3, 12, 16, generator=torch.Generator().manual_seed(0))
    clean = clean.repeat_interleave(4, 1).repeat_interleave(4, 2)  # neighbours are alike
    beta, veil = torch.tensor([[0.3, 0.1, 0.2], [0.1, 0.5, 0.6]])[:, :, None, None]
    observed = clean * torch.exp(-beta * z) - veil * torch.expm1(-beta * z)
    np.save("z.npy", z[0].numpy())
    for name, values in (("clean", clean), ("observed", observed)):
        np.save(f"{name}.npy", (255 * values).round().byte().permute(1, 2, 0).numpy())
    line = ("fit", "--clean", "clean.npy", "--observed", "observed.npy", "--distance", "z.npy")
    _, out, _ = run(*line, "--model", "haze", "--out", "light.json")
    assert "--color-space linear" in out
    cured = ("--model", "haze", "--color-space", "linear", "--out", "values.json")
    code, out, _ = run(*line, *cured)
    assert code == 0
    assert "--color-space" not in out
    numbers = json.loads((folder / "values.json").read_text())["parameters"]
    assert numbers["beta_red"]["value"] == pytest.approx(0.3, rel=0.01)
    flags = ("--distance", "z.npy", "--preset", "values.json", "--out", "again")
    assert run("degrade", "clean.npy", *flags)[0] == 0
    assert np.abs(np.load("again/clean.npy").astype(int) - np.load("observed.npy")).max() <= 2
    for line in ("degrade clean.npy --distance 3 --out b", "export --out fit.onnx"):
        code, _, err = run(*line.split(), "--preset", "values.json", "--water", "II")
        assert (code, "holds coefficients: no water or camera replaces them" in err) == (2, True)


@pytest.mark.parametrize("quality", [None, 95, 75, 30, 20])
def test_what_a_fit_of_waters_takes_for_known_is_given(folder, run, monkeypatch, quality):
    given, wet = {}, "b.jpg" if quality else "b.png"

    def fit_water(*pictures, **options):
        given.update(options)
        raise ValueError("seen")

    monkeypatch.setattr("uwaug.fitting.fit_water", fit_water)
    Image.open("photos/b.png").save(wet, quality=quality)
    scene = ("--clean", "photos/a.png", "--observed", wet, "--distance", "3")
    options = ("--camera", "mine.csv", "--g", ".1", "--mu", "0.02", "--focal-px", "300")
    options += ("--balance", "free")
    assert "seen" in run("fit", *scene, "--out", "f.json", "--model", "waters", *options)[2]
    assert (given["camera"], given["g"], given["mu"]) == ("mine.csv", 0.1, 0.02)
    assert (given["view"].focal_px, given["balance"]) == (300, "free")
    assert given["jpeg"] == (quality and pytest.approx(quality, abs=1))


def test_a_fit_leaves_out_what_it_is_told_to(folder, run):
    line = ("fit", "--clean", "photos/a.png", "--observed", "photos/b.png", "--out", "fit.json")
    maps = ("--distance", "depth/a.png", "--unit", "mm", "--model", "haze")
    code, _, err = run(*line, *maps)
    assert code == 1
    assert "depth/a.png: unknown at 10 of 768 pixels: --holes none leaves them out" in err
    assert run(*line, *maps, "--holes", "none")[0] == 0
    # the largest number of 16 bits stands for unknown, as everywhere
    depth = np.array(Image.open("depth/a.png"))
    Image.fromarray(np.where(depth > 0, depth, 65535).astype(np.uint16)).save("depth/a.png")
    assert "unknown at 10 of 768" in run(*line, *maps, "--force")[2]
    assert run(*line, *maps, "--holes", "none", "--force")[0] == 0
    assert json.loads((folder / "fit.json").read_text())["geometry"]["farthest"] < 4


def test_presets_and_waters_are_listed(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    listed = run("preset", "list")[1]
    assert all(name in listed for name in uwaug.list_presets())
    assert "arXiv:2509.15011, table 2" in listed
    waters = run("waters")[1]
    assert all(name in waters for name in uwaug.JERLOV_TYPES)
    rows = json.loads(run("waters", "--json")[1])
    assert {*uwaug.JERLOV_TYPES, "harbour"} <= set(rows["waters"])
    medium = uwaug.load_preset("survey", water="7C").module().medium
    (rates,) = rows["waters"]["7C"]["beta"]
    assert [*filter(None, rates)] == medium.beta[0].float().tolist()


def test_waters_of_ones_own_are_listed_and_compared(folder, run):
    (folder / "site.csv").write_text("nm;a;b;kd\n400;0,1;0,2;0,1\n700;0,6;0,1;0,7\n")
    (folder / "green.csv").write_text("nm,a,b,kd\n450,.1,.2,.1\n640,.6,.1,.7\n")
    code, out, _ = run("waters", "site.csv", "green.csv", "chlorophyll=5")
    assert code == 0
    assert "site, yours" in out
    assert "green, yours" in out
    code, _, err = run("waters", "nowhere.csv")
    assert (code, "nowhere.csv" in err) == (1, True)
    scene = ("photos/a.png", "--distance", "3", "--water", "site.csv", "--out", "systems.jpg")
    code, _, err = run("compare", *scene, "--system", "UWCNN")
    assert (code, "water must be one of I, IA" in err) == (2, True)
    assert run("compare", *scene, "--system", "jaffe-1990", "--system", "hou-2020")[0] == 0


@pytest.mark.parametrize("name", sorted({*uwaug.list_presets()} - {"night", "wet"}))
def test_what_is_shown_of_a_preset_is_its_file(run, tmp_path, name):
    code, out, _ = run("preset", "show", name)
    assert code == 0
    (tmp_path / "mine.toml").write_text(out)
    shown = uwaug.load_preset(tmp_path / "mine.toml")
    assert shown.to_dict() == uwaug.load_preset(name).to_dict()
    assert f"# It comes to {shown.module().medium}" in out


def test_of_a_preset_that_draws_no_medium_is_shown(run, tmp_path):
    (tmp_path / "mine.toml").write_text('[water]\nwaters = ["II", "7C"]\n')
    code, out, _ = run("preset", "show", str(tmp_path / "mine.toml"))
    assert (code, out) == (0, '[water]\nwaters = ["II", "7C"]\n')


def test_a_film_without_maps_is_a_plane(folder, run):
    code, out, _ = run("degrade", "photos", "--sequence", "--workers", "1", "--out", "wet")
    assert code == 0
    assert "made up from each frame would flicker" in out
    records = [json.loads(path.read_text()) for path in (folder / "wet").glob("*.png.json")]
    samples = [record["params"]["samples"][0] for record in records]
    assert len({sample["development"]["noise"].pop("seed") for sample in samples}) == 2
    for noun in ("water", "distance", "light", "development"):
        assert samples[0][noun] == samples[1][noun]
    assert 1 <= samples[0]["distance"]["distance"] <= 5
    flags = ("--sequence", "--distance", "made-up", "--out", "again")
    code, _, err = run("degrade", "photos", *flags)
    assert code == 2
    assert "flicker: give files, or metres" in err


def test_other_formats_are_told_of(folder, run):
    for name in ("c.webp", "d.WEBP", "e.HEIC", "f.nef", "g.MP4"):
        (folder / "photos" / name).touch()
    code, out, _ = run("degrade", "photos", "--workers", "1", "--out", "wet")
    assert code == 0
    told, *_ = (line for line in out.splitlines() if line.startswith("left out"))
    expected = "left out, as such files are not read: 1 .heic, 1 .mp4, 1 .nef, 2 .webp: make PNG of"
    assert told.startswith(expected)


@pytest.mark.parametrize("orientation", [1, 3, 6])
def test_pictures_that_exif_turns_are_told_where_maps_or_labels_are(folder, run, orientation):
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    (folder / "turned").mkdir()
    Image.new("RGB", (8, 8), (90, 60, 30)).save(folder / "turned/c.jpg", exif=exif)
    np.save(folder / "z.npy", np.full((8, 8), 3.0))
    (folder / "boxes").mkdir()
    (folder / "boxes/c.txt").write_text("0 .5 .5 .5 .5\n")
    told = "1 pictures, such as c.jpg, are upright by EXIF alone"
    for number, flags in enumerate((("--distance", "z.npy"), ("--labels", "boxes"))):
        code, out, _ = run("degrade", "turned", *flags, "--out", f"wet{number}")
        assert code == 0
        assert (told in out) == (orientation != 1)
    code, out, _ = run("degrade", "turned", "--out", "without")
    assert (code, told in out) == (0, False)


def test_maps_among_pictures_are_doubted(folder, run):
    (folder / "all/d").mkdir(parents=True)
    Image.new("RGB", (60, 40), (90, 60, 30)).save(folder / "all/a.png")
    line = ("degrade", "all", "--workers", "1", "--distance", "2", "--out")
    assert "unlike others" not in run(*line, "alone")[1]
    Image.fromarray(np.full((40, 60), 3000, np.uint16)).save(folder / "all/d/a.png")
    code, out, _ = run(*line, "both")
    assert (code, "d/a.png is grey and of 16 bits, unlike others: a map?" in out) == (0, True)
    assert "unlike others" not in run("degrade", "all/d", *line[2:], "grey")[1]


def test_the_view_that_exif_says_is_offered(folder, run):
    exif = Image.Exif()
    exif[ExifTags.IFD.Exif] = {ExifTags.Base.FocalLengthIn35mmFilm: 35}
    (folder / "taken").mkdir()
    for name, size in (("a.jpg", (60, 40)), ("b.jpg", (40, 60))):
        Image.new("RGB", size, (90, 60, 30)).save(folder / "taken" / name, exif=exif)
    line = ("degrade", "taken", "--workers", "1", "--distance", "2", "--out")
    told = "EXIF says 35 mm on film of 35 mm, as of b.jpg: --focal-px 58 would take it"
    code, out, _ = run(*line, "wet")
    assert (code, told in out) == (0, True)
    assert "EXIF" not in run(*line, "seen", "--focal-px", "58")[1]
    record = json.loads((folder / "wet/a.jpg.json").read_text())
    assert "view" not in record["recipe"]["transform"]
    with Image.open("wet/a.jpg") as image:
        kept = image.getexif().get_ifd(ExifTags.IFD.Exif)
    assert kept == {ExifTags.Base.FocalLengthIn35mmFilm: 35}
    assert run("degrade", "wet/a.jpg.json", "--out", "again.jpg")[0] == 0
    assert (folder / "again.jpg").read_bytes() == (folder / "wet/a.jpg").read_bytes()
    exif[ExifTags.IFD.Exif] = {ExifTags.Base.FocalLengthIn35mmFilm: 70}  # a zoom has no one view
    Image.new("RGB", (60, 40)).save(folder / "taken/c.jpg", exif=exif)
    assert "EXIF" not in run(*line, "zoomed")[1]


def test_plain_pictures_have_nothing_random(folder, run):
    """`--water 3C --contrast .4` alone draws a depth, a white balance, a tone, a saturation."""
    (folder / "options.toml").write_text("[development]\ntone = 1.2\n")
    line = ("degrade", "photos/a.png", "--plain", "--water", "3C", "--distance", "2", "--out")
    assert run(*line, "wet", "--seed", "1")[0] == 0
    assert run(*line, "again", "--seed", "2")[0] == 0
    set_ = ("degrade", "photos/a.png", "--plain", "--set", "water=3C", "--distance", "2", "--out")
    assert run(*set_, "set")[0] == 0
    assert written(folder / "wet") == written(folder / "again") == written(folder / "set")
    law = uwaug.PointSpread.calibrated()
    water = uwaug.Medium.from_water("3C", vertical_depth=0.0, g=0.2, point_spread=law)
    image = torch.from_numpy(np.array(Image.open("photos/a.png"))).permute(2, 0, 1)
    wanted = uwaug.Underwater(water)(image, torch.full((1, 24, 32), 2.0)).permute(1, 2, 0)
    made = torch.from_numpy(np.array(Image.open("wet/a.png")))
    assert (made.int() - wanted.int()).abs().max() <= 2
    # what is named is done, and nothing else
    named = ("--contrast", ".5", "--set", "water.vertical_depth=3", "--options", "options.toml")
    assert run(*line, "named", *named)[0] == 0
    (sample,) = json.loads((folder / "named/a.png.json").read_text())["params"]["samples"]
    water = {"waters": ["3C"], "contrast": 0.5, "mixing": 0, "vertical_depth": 3, "g": 0.2}
    assert sample["water"] == water
    camera = {"exposure": 0, "white_balance": 0, "saturation": 1, "gamut": 0, "tone": 1.2}
    assert (sample["light"], sample["development"]) == ({}, camera)


@pytest.mark.parametrize(
    ("flags", "focal"), [(("--view", "75"), uwaug.View(75).focal(32)), (("--focal-px", "20"), 20.0)]
)
def test_planar_depth_of_a_folder_becomes_distance_along_the_ray(folder, run, flags, focal):
    planar = torch.linspace(1, 4, 24 * 32).reshape(1, 24, 32)
    np.save("planar.npy", planar[0].numpy())
    np.save("along.npy", uwaug.distance.along_ray(planar, focal)[0].numpy())
    line = ("degrade", "photos/a.png", "--plain", "--water", "3C", "--distance")
    is_planar = ("planar.npy", "--set", "distance.planar=true", "--out")
    assert run(*line, *is_planar, "a", *flags)[0] == 0
    assert run(*line, "along.npy", "--out", "b", *flags)[0] == 0
    assert run(*line, "planar.npy", "--out", "c", *flags)[0] == 0
    assert "planar maps need the camera's view" in run(*line, *is_planar, "d")[2]
    made, wanted, flat = (np.array(Image.open(f"{n}/a.png")).astype(int) for n in "abc")
    assert np.abs(made - wanted).max() == 0
    assert np.abs(flat - wanted).max() > 5


def test_a_medium_of_coefficients_has_grades(folder, run):
    line = ("degrade", "photos/a.png", "--preset", "tank-proposed-1", "--distance", "2", "--out")
    assert run(*line, "wet", "--severity", "all")[0] == 0
    records = [Path(f"wet/{level}/a.png.json") for level in SEVERITIES]
    shares = [json.loads(path.read_text())["contrast"] for path in records]
    assert shares == sorted(set(shares), reverse=True)
    assert shares[0] > 4 * shares[-1]


def test_charts_at_known_distances_become_a_preset(folder, run):
    lines = ["chart,distance,air_red,air_green,air_blue,red,green,blue"]
    for chart, z in enumerate((1.5, 3.0, 5.0, 8.0)):
        for grey in (0.03, 0.1, 0.2, 0.3):
            seen = [
                grey * np.exp(-g * z) - v * np.expm1(-g * z) for g, v in ((0.4, 0.1), (0.2, 0.3))
            ]
            lines.append(",".join(map(str, (chart, z, grey, grey, grey, *seen, seen[1]))))
    (folder / "charts.csv").write_text("\n".join(lines))
    flags = ("--color-space", "linear", "--figure", "water.png", "--out", "water.json")
    code, out, _ = run("fit-patches", "charts.csv", *flags)
    assert code == 0
    assert "beta_red" in out
    numbers = json.loads((folder / "water.json").read_text())["parameters"]
    assert numbers["beta_red"]["value"] == pytest.approx(0.4, rel=0.05)
    assert (folder / "water.png").stat().st_size > 1000
    assert run("degrade", "photos", *MAPS, "--preset", "water.json", "--out", "alike")[0] == 0
    (folder / "charts.csv").write_text("\n".join(lines[:6]))
    code, _, err = run("fit-patches", "charts.csv", *flags, "--force")
    assert (code, "expected at least 12" in err) == (2, True)
