"""`uwaug degrade`: its flags, its exit codes, and what it prints."""

import csv
import json
import re
import shutil
import subprocess
import tempfile
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from filing import H, W, content, metres, pixels, save, save_pair
from PIL import Image

import uwaug
import uwaug.cli.run
from uwaug._support.atomic import held
from uwaug.formation.scene import Scene
from uwaug.io import read_picture
from uwaug.jobs import Sidecar
from uwaug.jobs.ray import Shards
from uwaug.light.geometry import focal_of
from uwaug.presets.files import bundled_preset
from uwaug.transforms.random_underwater import SEVERITIES

WATER = ("--water", "3C")
DRAWN = (*WATER, "--visibility", "3:5")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A good picture, and its distances."""
    monkeypatch.chdir(tmp_path)
    save_pair("good.png")
    return tmp_path


@pytest.fixture
def degrade(run):
    """Degrade what must go well; return what is printed."""

    def call(*arguments: str) -> str:
        code, out, err = run("degrade", *arguments)
        assert (code, err) == (0, "")
        return out

    return call


def degraded(run, *arguments: str, distance: str = "z.npy"):
    """Exit code, and what stands on standard error."""
    code, _, err = run("degrade", *arguments, "--distance", distance, "--out", "out", *WATER)
    assert "Traceback" not in err
    return code, err


# What flags say


def test_flags_are_options_of_the_transform(degrade):
    Path("o.toml").write_text('waters = ["II", "7C"]\nmixing = [0.0, 1.0]\nfield_probability = 1.0')
    given = ("--random", "--options", "o.toml", "--visibility", "3:5", "--vertical-depth", "2")
    degrade("good.png", "--distance", "z.npy", *given, "--seed", "7", "--out", "out")
    transform = uwaug.RandomUnderwater(
        ["II", "7C"], mixing=(0, 1), field_probability=1.0, visibility=(3, 5), vertical_depth=2.0
    )
    z = torch.from_numpy(metres())[None]
    expected, _ = transform.at(7, 0, "good.png")(read_picture("good.png"), z)
    assert torch.equal(read_picture("out/good.png"), expected)


def test_a_range_of_metres_puts_each_picture_on_a_plane(degrade):
    Path("2").mkdir()  # a range is no path, whatever is called as its ends are
    degrade("good.png", "--distance", "2:6", "--random", "--variants", "3", "--out", "out")
    transform, metres_of = uwaug.RandomUnderwater(distance=(2.0, 6.0)), []
    for variant in range(3):
        record = Sidecar.read(Path(f"out/good_{variant + 1}.png.json"))
        (sample,) = record.drawn["samples"]
        metres_of.append(sample["distance"])
        expected = transform.transform(read_picture("good.png"), None, record.drawn)
        assert torch.equal(read_picture(f"out/good_{variant + 1}.png"), expected)
    assert len(set(metres_of)) == 3
    assert all(2 <= z <= 6 for z in metres_of)
    again = degrade("--replay", "out/good_2.png.json", "--out", "again")
    assert "the same bytes" in again
    resumed = degrade(
        *("good.png", "--distance", "2:6", "--random", "--variants", "3", "--out", "out"),
        "--resume",
    )
    assert "3 were there" in resumed


def test_a_range_in_one_water_and_in_a_preset(degrade):
    for water in (WATER, ("--preset", "survey")):
        degrade("good.png", "--distance", "2:6", *water, "--out", f"out-{water[0]}")
        (sample,) = Sidecar.read(Path(f"out-{water[0]}/good.png.json")).drawn["samples"]
        assert 2 <= sample["distance"] <= 6


def test_lamps_as_the_guide_writes_them(degrade):
    guide = Path(uwaug.__file__).parent / "cli" / "README.md"
    (toml,) = re.findall(r"```toml\n(.*?)```", guide.read_text(encoding="utf-8"), re.DOTALL)
    Path("night.toml").write_text(toml, encoding="utf-8")
    given = ("good.png", "--distance", "z.npy", "--water", "1C", "--vertical-depth", "30")
    degrade(*given, "--options", "night.toml", "--out", "night.png")
    lamp = uwaug.Light.lamp((-0.4, -0.2, 0.0), (0.15, 0.1, 1.0), power=2.0, cone=45.0)
    scene_light = Sidecar.read(Path("night.png.json")).recipe["options"]["light"]
    assert repr(uwaug.Light.from_list(scene_light)) == repr(lamp + uwaug.Light.ambient())
    degrade(*given, "--out", "day.png")
    assert not torch.equal(read_picture("night.png"), read_picture("day.png"))


def test_a_water_of_ones_own_by_its_file(degrade, run):
    """It is found in capitals too, and named as it was typed."""
    Path("Harbour.CSV").write_text("wavelength,a,b,kd\n400,.5,1,.7\n700,.7,1,.8\n")
    degrade("good.png", "--distance", "z.npy", "--water", "Harbour.CSV", "--out", "out")
    assert Sidecar.read(Path("out/good.png.json")).water.endswith("Harbour")
    code, _, err = run("degrade", "good.png", "--distance", "3", "--water", "no.Csv", "--out", "x")
    assert (code, "no.Csv" in err) == (1, True)


def test_a_presets_own_water_belongs_to_its_pictures(degrade, run):
    """A picture of another water is not made again for it, nor kept beside new ones."""
    spectra = "wavelength,a,b,kd\n400,.5,1,.7\n700,.7,1,.8\n"
    Path("mine").mkdir()
    Path("mine/harbour.csv").write_text(spectra)
    preset = bundled_preset("survey").read_text(encoding="utf-8")
    Path("mine/own.toml").write_text(preset.replace('type = "7C"', 'type = "harbour.csv"'))
    given = ("good.png", "--distance", "z.npy", "--preset", "mine/own.toml", "--out", "out")
    degrade(*given)
    assert Sidecar.read(Path("out/good.png.json")).water == "harbour"
    assert "1 were there" in degrade(*given, "--resume")
    Path("mine/harbour.csv").write_text(spectra.replace(".8", ".9"))
    code, _, err = run("degrade", "--replay", "out/good.png.json", "--out", "again")
    assert (code, "harbour.csv has changed" in err) == (1, True)
    code, _, err = run("degrade", *given, "--resume")
    assert (code, "harbour.csv has changed since out/good.png" in err) == (2, True)


def test_a_replay_takes_nothing_else_and_leaves_what_it_reads(degrade, run):
    degrade("good.png", "--distance", "2", *WATER, "--out", "out")
    replay, before = ("--replay", "out/good.png.json"), Path("good.png").read_bytes()
    for more in (("--variants", "2"), ("--resume",), ("--format", "jpg"), ("--distance", "5")):
        code, _, err = run("degrade", *replay, *more, "--out", "again")
        assert (code, "--distance would do nothing" in err or "all from the record" in err) == (
            2,
            True,
        )
    code, _, err = run("degrade", *replay, "--out", ".", "--force")
    assert (code, "good.png is read, and would be written over" in err) == (1, True)
    assert Path("good.png").read_bytes() == before


def test_what_fit_waters_has_written(degrade, run):
    """`--fit` takes both kinds of files."""
    rng = torch.Generator().manual_seed(0)
    clean = 0.1 + 0.8 * torch.rand(3, 40, 60, generator=rng)
    z = torch.linspace(1, 6, 2400).reshape(1, 40, 60)
    water = uwaug.Medium.from_water("3C", g=0.05, mu=0.075, vertical_depth=2.0)
    fit = uwaug.fitting.fit_water(
        clean, uwaug.Underwater(water)(clean, z), z, gain="fixed", vertical_depth=2.0
    )
    fit.save("water.json")
    degrade("good.png", "--distance", "z.npy", "--fit", "water.json", "--out", "out.npy")
    expected = uwaug.Underwater(fit.medium)(
        read_picture("good.png") / 255, torch.from_numpy(metres())[None]
    )
    assert (read_picture("out.npy") / 255 - expected).abs().max() < 0.01
    assert Sidecar.read(Path("out.npy.json")).water == f"fit {fit.type}"
    assert uwaug.fitting.load_fit("water.json").module((32, 200)).sides == (32, 200)
    Path("half.json").write_text(Path("water.json").read_text()[:900])
    code, _, err = run("degrade", "good.png", "--distance", "3", "--fit", "half.json", "--out", "x")
    assert (code, "half.json: not a water: " in err) == (1, True)


CAMERA = {
    "exposure": "auto",
    "compensation": -0.5,
    "white_balance": 0.6,
    "saturation": 1.2,
    "black_point": 0.5,
    "gamut": 0.8,
    "tone": 1.1,
}


def flags(options: dict) -> list[str]:
    """Options as flags of the command line; a range as LOW:HIGH."""
    arguments = []
    for name, value in options.items():
        text = ":".join(map(str, value)) if isinstance(value, tuple) else str(value)
        arguments += [f"--{name.replace('_', '-')}", text]
    return arguments


@pytest.mark.parametrize("water", [["--random"], ["--water", "II"], ["--preset", "survey"]])
@pytest.mark.parametrize(
    "options",
    [
        {"surfaces": "grey"},
        {"surfaces": "spectral", "color_matrix": (0.2, 0.6), **CAMERA, "compensation": (-1.0, 0.5)},
    ],
)
def test_flags_of_the_camera(degrade, water, options):
    given = ("good.png", "--distance", "z.npy", *water)
    degrade(*given, *flags(options), "--seed", "7", "--out", "out")
    if water[0] == "--preset":
        transform = uwaug.RandomUnderwater.from_preset("survey", **options)
    elif water[0] == "--water":
        neutral = dict.fromkeys(("color_matrix", *CAMERA)) | {"exposure": "auto"}
        in_nature = {"contrast": None, "vertical_depth": 1.0, "field_probability": 0.0}
        in_nature["mu"] = 0.075
        transform = uwaug.RandomUnderwater("II", **{**neutral, **in_nature, **options})
    else:
        transform = uwaug.RandomUnderwater(**options)
    z = torch.from_numpy(metres())[None]
    expected, _ = transform.at(7, 0, "good.png")(read_picture("good.png"), z)
    assert torch.equal(read_picture("out/good.png"), expected)
    degrade(*given, "--seed", "7", "--out", "plain")
    same = torch.equal(read_picture("plain/good.png"), expected)
    assert same == (water[0] == "--preset" and options == {"surfaces": "grey"})


def test_known_water_is_developed(degrade, run):
    given = ("good.png", "--distance", "z.npy", "--preset", "mcglamery-1980")
    degrade(*given, *flags(CAMERA), "--out", "out")
    preset = uwaug.load_preset("mcglamery-1980")
    developed = {name: value for name, value in CAMERA.items() if name != "exposure"}
    setup = replace(preset.setup(focal_of(None, W)), exposure="auto")
    setup = replace(setup, development=uwaug.Development(**developed))
    z = torch.from_numpy(metres())[None]
    expected = Scene.of(read_picture("good.png"), z, setup).picture()
    assert (read_picture("out/good.png").int() - expected.int()).abs().max() <= 1
    assert "the same bytes" in degrade("--from", "out/good.png.json", "--out", "again")
    for wrong in (["--gamut", "0.5:1"], ["--surfaces", "spectral"]):
        code, _, err = run("degrade", *given, *wrong, "--out", "wrong")
        assert (code, "would do nothing: mcglamery-1980 is one known medium" in err) == (2, True)


@pytest.mark.parametrize(
    ("given", "options"),
    [
        (["--hazy"], {}),
        (["--hazy", "--visibility", "3:5"], {"visibility": (3.0, 5.0)}),
        (["--random", "--severity", "2"], {"contrast": SEVERITIES[2]}),
    ],
)
def test_the_defaults_of_old_by_name(degrade, given, options):
    degrade("good.png", "--distance", "z.npy", *given, "--out", "out")
    transform = uwaug.RandomUnderwater.hazy(**options)
    z = torch.from_numpy(metres())[None]
    expected, _ = transform.at(0, 0, "good.png")(read_picture("good.png"), z)
    assert torch.equal(read_picture("out/good.png"), expected)


def test_flags_are_what_maps_hold(degrade):
    mm = (metres() * 1000).astype(np.uint16)
    mm[0] = 0
    save("z.png", mm)
    given = ("--planar", "--focal-px", "20", "--distance-unit", "mm", "--unknown", "3.5")
    degrade("good.png", "--distance", "z.png", *given, *WATER, "--out", "out")
    recipe = Sidecar.read(Path("out/good.png.json")).recipe
    assert recipe["options"] == {"focal_px": 20.0}
    said = {name: recipe["depth"][name] for name in ("kind", "unit", "planar", "unknown")}
    assert said == {"kind": "metric", "unit": "mm", "planar": True, "unknown": 3.5}


def test_one_picture_into_one_file(degrade):
    given = ("--distance", "3", "--water", "3c", "--out", "there/b.jpg")
    said = degrade("good.png", *given)
    look = r"3C, visibility 3\.\d m, fine detail keeps \d\.\d % of its contrast, \d+\.\d s\n"
    assert re.search(rf"wrote there/b\.jpg: {look}", said)
    assert set(content("there")) == {"b.jpg", "b.jpg.json"}


def test_a_folder_its_index_and_one_more_run(degrade):
    for name in ("b/1.png", "2.png"):
        save(f"all/{name}", pixels(seed=len(name)))
    given = ("--distance", "3", *WATER, "--format", "tif")
    assert "2 of 2 pictures" in degrade("all", *given, "--out", "all/wet")
    assert "0 of 2 pictures, 2 were there" in degrade("all", *given, "--out", "all/wet", "--resume")
    degrade("good.png", *given, "--out", "all/wet")
    with open("all/wet/index.csv", newline="") as file:
        outputs = {line["output"]: line["status"] for line in csv.DictReader(file)}
    assert outputs == {"2.tif": "kept", "b/1.tif": "kept", "good.tif": "done"}


def test_a_rehearsal_writes_nothing_anywhere(degrade, monkeypatch, tmp_path):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    save("deep/in/it/a.png", pixels())
    save("marks/in/it/a.png", np.ones((H, W), np.uint8))
    before = content(".")
    given = ("--distance", "3", *DRAWN, "--labels", "marks", "--variants", "3", "--out", "out")
    out = degrade("deep", *given, "--dry-run")
    assert "deep/in/it/a.png + 3.0 → out/images/in/it/a_3.png" in out
    assert "3 pictures, about" in out
    assert content(".") == before


def test_a_sheet(degrade, run):
    pytest.importorskip("matplotlib")
    degrade("good.png", "--distance", "3", *WATER, "--out", "out", "--sheet")
    with Image.open("out/sheet.jpg") as sheet:
        assert sheet.width > 500
    save("all/sheet.jpg", pixels())
    code, err = degraded(run, "all", "--sheet", "--force")
    assert (code, "all/sheet.jpg would be written to out/sheet.jpg" in err) == (2, True)
    Path("out/good.png").unlink()
    code, err = degraded(run, "good.png", "--sheet")
    assert (code, "out/sheet.jpg exists: --force" in err) == (2, True)
    Path("mine").mkdir()
    Path("mine/sheet.jpg").write_bytes(b"of somebody")
    given = ("--distance", "3", *WATER, "--out", "mine", "--sheet", "--resume")
    code, _, err = run("degrade", "good.png", *given)
    assert (code, "mine/sheet.jpg exists: --force" in err) == (2, True)


def test_a_record_holds_from_any_folder(degrade, run, monkeypatch):
    degrade("good.png", "--distance", "z.npy", *WATER, "--out", "out")
    Path("good.png").rename("moved.png")
    Path("elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    record = ("--from", "../out/good.png.json")
    code, _, err = run("degrade", *record, "--out", "again")
    assert (code, "if it was moved, name it" in err) == (1, True)
    assert "the same bytes" in degrade("../moved.png", *record, "--out", "again")
    assert "in another format" in degrade("../moved.png", *record, "--out", "again/a.tif")
    code, _, err = run("degrade", *record, "--out", "../out", "--force")
    assert (code, "is the first one" in err) == (2, True)


def test_drawn_contents_are_recorded_and_come_back(degrade):
    given = ("--distance", "z.npy", "--water", "chlorophyll=1:20,cdom=0.3", "--variants", "2")
    degrade("good.png", *given, "--out", "out")
    names = {Sidecar.read(path).water for path in Path("out").glob("*.json")}
    assert len(names) == 2
    drawn = [uwaug.Constituents.parse(name) for name in names]
    ranges = uwaug.Constituents(chlorophyll=(1, 20), cdom=0.3)
    assert all(ranges.holds(contents) for contents in drawn)
    record = next(iter(Path("out").glob("*.json")))
    assert "the same bytes" in degrade("--from", str(record), "--out", "again")


def test_a_water_of_ones_own(degrade, run, monkeypatch):
    rows = "400,0.5,1.3,0.7\n550,0.2,1.1,0.3\n700,0.7,1.0,0.8\n"
    Path("tank.csv").write_text("nm,a,b,kd\n" + rows)
    Path("o.toml").write_text('waters = ["tank.csv"]')
    degrade("good.png", "--distance", "z.npy", "--water", "tank.csv", "--out", "out")
    random = ("--random", "--options", "o.toml")
    degrade("good.png", "--distance", "z.npy", *random, "--out", "drawn")
    Path("elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    records = [
        ("--from", f"../{out}/good.png.json", "--out", f"{out}.png") for out in ("out", "drawn")
    ]
    for record in records:
        assert Sidecar.read(Path(record[1])).water.endswith("tank")
        assert "the same bytes" in degrade(*record)
    Path("../tank.csv").write_text(rows.replace("0.5", "0.6"))
    for record in records:
        code, _, err = run("degrade", *record, "--force")
        assert (code, "tank.csv has changed since the record was written" in err) == (1, True)


# Labels


def labelled(path: str) -> list[str]:
    return sorted(image["file_name"] for image in json.loads(Path(path).read_text())["images"])


def test_a_file_of_labels_keeps_those_of_earlier_runs(degrade):
    images, marks = [], []
    for i, name in enumerate(("a.png", "b.png")):
        save(name, pixels(seed=i))
        images.append({"id": i, "file_name": name, "height": H, "width": W})
        marks.append({"id": i, "image_id": i, "category_id": 1, "bbox": [1, 1, 5, 5]})
    Path("marks.json").write_text(json.dumps({"images": images, "annotations": marks}))
    given = ("--distance", "3", *WATER, "--labels", "marks.json", "--out", "out")
    degrade("a.png", *given)
    assert labelled("out/marks.json") == ["a.png"]
    degrade("b.png", *given)
    assert labelled("out/marks.json") == ["a.png", "b.png"]


def test_labels_that_are_nowhere_are_missed(run):
    save("marks/other.png", np.ones((H, W), np.uint8))
    code, err = degraded(run, "good.png", "--labels", "marks")
    assert (code, "none of the pictures has labels in" in err) == (1, True)


# What is refused


@pytest.mark.parametrize("out", [["v.heic"], ["v.jpg", "--variants", "2"], ["run.v2"]])
def test_a_file_that_cannot_be_the_output_is_no_folder(run, out):
    arguments = ("degrade", "good.png", "--distance", "3", *DRAWN, "--out", *out)
    code, _, err = run(*arguments)
    assert (code, f"--out {out[0]}: expected the file of one picture" in err) == (2, True)
    Path(out[0]).mkdir()
    assert run(*arguments)[0] == 0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("colour = 3", "unknown key colour; there are waters"),
        ("unknown = 'fill'", "unknown key unknown"),
        ("waters = ", "is no TOML"),
        ("waters = " + "[" * 100_000, "o.toml: is no TOML: its brackets or keys nest too deeply"),
        ("waters = '12C'", "12C"),
        ("point_spread = { width = 2 }", "unexpected keyword argument 'width'"),
    ],
)
def test_options_that_are_refused(run, text, words):
    Path("o.toml").write_text(text)
    given = ("--distance", "3", "--out", "out", "--random", "--options", "o.toml")
    code, _, err = run("degrade", "good.png", *given)
    assert code == (1 if err.startswith("Error: o.toml: ") else 2)
    assert words in err


# What fails


def test_what_is_passed_over_or_lost_is_said(degrade):
    for name in ("1.gif", "deep/2.gif", "3.BMP"):
        save(f"all/{name}", pixels())
    Path("all/notes.txt").touch()
    first, second = (Image.fromarray(pixels(seed=seed)) for seed in (0, 1))
    first.save("all/moving.png", save_all=True, append_images=[second])
    said = degrade("all", "--distance", "3", *WATER, "--out", "out")
    assert "Note: 1 .bmp passed over: save them as .png" in said
    assert "Note: 2 .gif passed over" in said
    assert "moving.png: not kept: 1 more frame" in said
    assert ".txt" not in said


def test_a_list_may_end_in_capitals(run):
    Path("list.CSV").write_text("input\ngood.png\n")
    given = ("list.CSV", "--distance", "3", *WATER, "--out", "out.png")
    code, _, err = run("degrade", *given)
    assert (code, "--out out.png: expected the file of one picture" in err) == (2, True)


def test_a_name_without_room_for_its_record_fails_alone(run):
    for name in ("good.png", f"{'L' * 247}.png", f"{'M' * 251}.png"):
        save(f"all/{name}", pixels())
    Path("maps").mkdir()
    save("maps/good.npy", metres())
    for given in (("--variants", "2", *DRAWN[2:]), ("--format", "tiff"), ("--keep-terms",)):
        code, err = degraded(run, "all", *given, "--force")
        assert (code, "Traceback" in err, "File name too long" in err) == (1, False, True)
        assert any(name.startswith("good") for name in content("out"))
    code, err = degraded(run, "all", "--force", distance="maps")
    assert (code, "2 of 3 pictures failed" in err) == (1, True)


def test_what_fails_is_told_at_the_end(run):
    for name in "abc":
        save(f"all/{name}.png", pixels())
    Path("all/b.png").write_bytes(b"")
    code, err = degraded(run, "all")
    assert (code, "1 of 3 pictures failed:\n  all/b.png: is empty" in err) == (1, True)
    lines = Path("out/index.csv").read_text().splitlines()
    assert [line.split(",")[9] for line in lines] == ["status", "done", "failed", "done"]
    code, err = degraded(run, "all/b.png", "--dry-run")
    assert (code, "b.png: is empty" in err) == (1, True)


@pytest.mark.parametrize(
    ("make", "path", "words"),
    [
        (lambda path: path.symlink_to(path), "a.png", "symbolic links"),
        (lambda path: path.write_text("input\n\x00\n"), "list.csv", "list.csv: line 2 is no text"),
        (lambda path: path.write_text("{}"), "r.json", "is no record of a picture"),
    ],
)
def test_files_at_fault(run, folder, make, path, words):
    make(folder / path)
    given = ["--from", path] if path == "r.json" else [path, "--distance", "3", *WATER]
    code, _, err = run("degrade", *given, "--out", "out")
    assert (code, words in err, path in err) == (1, True, True)
    assert not Path("out").exists() or set(content("out")) == {"index.csv"}


def test_two_runs_at_once_into_one_folder(run):
    """An index and a file of labels would keep the pictures of one of them."""
    save("all/a.png", pixels())
    Path("out").mkdir()
    with held(Path("out")):
        code, err = degraded(run, "all")
        assert (code, "out: another run writes to this folder: wait" in err) == (1, True)
        assert content("out") == {}
    assert degraded(run, "all")[0] == 0
    with held(Path("out"), shared=True):
        arguments = ("degrade", "good.png", "--distance", "3", *WATER, "--out", "out/b.png")
        assert run(*arguments)[0] == 0


def test_only_a_run_that_has_its_folder_alone_tidies_it(degrade):
    part = Path(f"out/deep/.uwaug-{'0' * 16}.part")
    save("out/deep/a.png", pixels())
    part.touch()
    given = ("good.png", "--distance", "3", *WATER, "--resume", "--out")
    degrade(*given, "out/b.png")
    assert part.exists()
    degrade(*given, "out")
    assert not part.exists()


def test_shards_that_are_nowhere(run, monkeypatch):
    """As those in the memory of other processes."""
    pytest.importorskip("ray")
    monkeypatch.setattr(uwaug.cli.run, "connected", lambda *_: nullcontext(2))
    monkeypatch.setattr(Shards, "write", lambda *_, **__: None)
    given = ("--distance", "3", *WATER, "--ray", "local", "--shards", "place")
    code, out, err = run("degrade", "good.png", *given)
    assert (code, "0 of 1 pictures in place" in out) == (1, True)
    assert "place: 1 of 1 pictures are not there: is it the same place on all machines?" in err


def test_what_is_there_stays(run):
    save("out/good.png", pixels(seed=1))
    before = content("out")
    code, err = degraded(run, "good.png")
    assert (code, "out/good.png exists: --resume to go on, --force" in err) == (2, True)
    # what is there is none of a run's
    code, err = degraded(run, "good.png", "--resume")
    assert (code, "out/good.png exists" in err) == (1, True)
    assert content("out").items() >= before.items()
    assert degraded(run, "good.png", "--force")[0] == 0
    code, err = degraded(run, "good.png", "--resume", "--severity", "2")
    assert (code, "was made with other options (" in err) == (2, True)


# Where nothing can be written


def test_out_is_a_file(run):
    Path("out").write_text("")
    code, err = degraded(run, "good.png")
    assert (code, "out" in err) == (1, True)
    assert Path("out").is_file()


@pytest.fixture
def mounted(folder):
    """Mount a file system at `out`; skip where that is not permitted."""

    def mount(*arguments: str) -> None:
        Path("out").mkdir()
        command = ["mount", *arguments, str(folder / "out")]
        if shutil.which("mount") is None or subprocess.run(command, check=False).returncode:
            pytest.skip("mounting is not permitted")

    yield mount
    subprocess.run(["umount", str(folder / "out")], capture_output=True, check=False)


def test_out_is_read_only(run, mounted):
    mounted("-t", "tmpfs", "-o", "ro,size=1m", "tmpfs")
    code, err = degraded(run, "good.png")
    assert (code, "cannot write to the folder" in err, "Read-only" in err) == (1, True, True)


def test_the_disk_is_full(run, mounted):
    mounted("-t", "tmpfs", "-o", "size=64k", "tmpfs")
    for name in "ab":
        save(f"all/{name}.png", pixels(500, 500))
    save("all/c.png", pixels())
    code, err = degraded(run, "all", "--workers", "1", distance="3")
    assert code == 1
    assert "No space left on device" in err
    assert "2 of 3 pictures failed" in err
    assert set(content("out")) == {"c.png", "c.png.json", "index.csv"}
