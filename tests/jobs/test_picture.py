"""One picture: what is made of it, what is kept of its file, and how it is made again."""

import csv
import json
import os
import resource
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch
from filing import H, W, content, metres, pixels, save, save_pair, words
from networks import mean_of_channels
from PIL import Image

import uwaug
import uwaug._support.tiles
from uwaug import fused
from uwaug.distance.convert import along_ray, from_disparity, from_inverse, from_relative
from uwaug.formation.loops import backend
from uwaug.io import DistanceFormat, read_picture, read_picture_file
from uwaug.jobs import Degrader, Item, Items, Recipe, Sidecar, labelled, replay
from uwaug.jobs.index import index_of
from uwaug.jobs.sidecar import sidecar_path
from uwaug.light.geometry import focal_of
from uwaug.transforms.params import DEVELOPED

UNDEVELOPED = dict.fromkeys(("color_matrix", *DEVELOPED)) | {"mu": 0.075}
FIXED = {**UNDEVELOPED, "contrast": None, "vertical_depth": 1.0, "field_probability": 0.0}
Z = Path("z.npy")
FAINT = (
    "less than 3 % of the contrast is left on a fifth of the picture or more: "
    "clearer water, such as visibility=10 or contrast=0.3?"
)
"""Of 1 to 4 m in water of type 3C."""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A picture, and its distances."""
    monkeypatch.chdir(tmp_path)
    save_pair("a.png")
    return tmp_path


def item_of(name: str = "a.png", distance=Z, output: str | None = None, variant: int = 0) -> Item:
    output = Path("out", output or name)
    return Item(name, Path(name), distance, output, variant, name=name, out=Path("out"))


def made(item: Item | None = None, *, resume=False, force=False, **recipe) -> Sidecar:
    """What stands beside a picture in water of type 3C, or as the recipe says."""
    recipe = Recipe(**({"water": "3C"} | recipe)).resolved()
    (item,) = labelled([item or item_of()], recipe.open_labels())
    return Degrader(recipe, resume=resume, force=force).write(item)


def failed(item: Item, **recipe) -> str:
    """The reason; nothing is left."""
    before = content(".")
    result = Degrader(Recipe(**({"water": "3C"} | recipe)))(item)
    assert result.status == "failed"
    assert content(".") == before
    return result.reason


def in_water(image, z, **options) -> torch.Tensor:
    """A picture in water of type 3C, by the transform."""
    return uwaug.RandomUnderwater("3C", **{**FIXED, **options}).at(0, 0, "a.png")(image, z)[0]


def metric(values=None) -> torch.Tensor:
    return torch.from_numpy(metres() if values is None else values)[None]


# What becomes of a picture


def test_the_same_as_by_the_transform():
    options = {"waters": ["II", "7C"], "mixing": [0.0, 1.0], "visibility": [3, 5]}
    for variant in (0, 1):
        item = item_of(output=f"{variant}.png", variant=variant)
        made(item, water=None, random=True, seed=7, options=options)
        transform = uwaug.RandomUnderwater(["II", "7C"], mixing=(0.0, 1.0), visibility=(3, 5))
        expected, _ = transform.at(7, variant, "a.png")(read_picture("a.png"), metric())
        assert torch.equal(read_picture(f"out/{variant}.png"), expected)
    assert content("out")["0.png"] != content("out")["1.png"]


def test_orientation_is_honoured_and_the_rest_kept():
    exif = Image.Exif()
    exif[0x0112], exif[0x010F] = 6, "maker"
    save("a.png", pixels(W, H, 4), exif=exif)
    sidecar = made()
    with Image.open("out/a.png") as image:
        assert dict(image.getexif()) == {0x010F: "maker"}
    turned = np.rot90(pixels(W, H, 4), -1)
    stood = torch.from_numpy(turned[..., :3].copy()).permute(2, 0, 1)
    assert torch.equal(read_picture("out/a.png"), in_water(stood, metric()))
    assert np.array_equal(read_picture_file("out/a.png").alpha, turned[..., 3])
    assert sidecar.notes == [
        "the picture was turned as its EXIF says; its map is taken as turned already",
        FAINT,
    ]


@pytest.mark.parametrize("name", ["b.png", "b.tif"])
def test_16_bits_stay_16_bits(name):
    save(name, words(), **({"photometric": "rgb"} if name == "b.tif" else {}))
    made(item_of(name))
    file = read_picture_file(f"out/{name}")
    assert file.bits == 16
    expected = in_water(torch.from_numpy(words().transpose(2, 0, 1) / np.float32(65535)), metric())
    assert (file.image - expected).abs().max() < 0.51 / 65535


def test_what_a_format_does_not_keep_is_noted():
    save("b.png", words(4))
    notes = made(item_of("b.png", output="b.jpg")).notes
    losses = ["JPEG does not keep: 16 bits (it has 8)", "JPEG does not keep: alpha"]
    assert notes == [FAINT, *losses]


# What maps hold


def test_what_maps_hold():
    image, t = read_picture("a.png"), (metres() - 1) / 3
    save("t.npy", t.astype(np.float32))
    mm = (metres() * 1000).astype(np.uint16)
    save("mm.png", mm)
    ends = {"near": 1, "far": 6}
    disparity = DistanceFormat("disparity", focal_px=20, baseline_m=0.4, offset_px=1.5)
    planar = DistanceFormat(unit="mm", planar=True, focal_px=20)
    read_mm = torch.from_numpy((mm.astype(np.float64) * 0.001).astype(np.float32))[None]
    t_map = torch.from_numpy(t.astype(np.float32))[None]
    cases = (
        ("t.npy", DistanceFormat("relative"), {**ends, "gamma": 2}, from_relative(t_map, 1, 6, 2)),
        ("z.npy", DistanceFormat("inverse"), ends, from_inverse(metric(), 1.0, 6.0)),
        ("z.npy", disparity, {}, along_ray(from_disparity(metric(), 20, 0.4, 1.5), 20)),
        ("mm.png", planar, {}, along_ray(read_mm, 20)),
    )
    for number, (file, format, options, z) in enumerate(cases):
        output = f"{number}.png"
        made(item_of(distance=Path(file), output=output), distance=format, options=options)
        found = read_picture(f"out/{output}").int() - in_water(image, z).int()
        assert found.abs().max() <= (1 if format.kind == "relative" else 0), format


def test_a_depth_network():
    format = DistanceFormat("inverse", network=mean_of_channels("n.onnx"))
    sidecar = made(item_of(distance=None), distance=format, options={"near": 1, "far": 6})
    image = read_picture("a.png")
    inverse = uwaug.distance.DepthNetwork("n.onnx")(image / 255)
    assert torch.equal(read_picture("out/a.png"), in_water(image, from_inverse(inverse, 1.0, 6.0)))
    assert sidecar.distance is None
    Path("n.onnx.data").write_bytes(b"weights in a file of their own")
    content = Recipe(random=True, distance=format).resolved().content
    assert {Path(path).name for path in content} == {"n.onnx", "n.onnx.data"}


@pytest.mark.parametrize("unknown", ["fill", "far", 3.5, "skip"])
def test_unknown_distances(unknown):
    holed = metres()
    holed[:2, :5] = np.nan
    holed[3] = 0
    save("z.npy", holed)
    made(distance=DistanceFormat(unknown=unknown))
    expected = in_water(read_picture("a.png"), metric(holed), unknown=unknown)
    assert torch.equal(read_picture("out/a.png"), expected)


def test_a_picture_without_distances_is_left_as_it_is():
    save("z.npy", metres() * 0)
    sidecar = made(distance=DistanceFormat(unknown="skip"))
    assert torch.equal(read_picture("out/a.png"), read_picture("a.png"))
    assert (sidecar.water, sidecar.contrast) == ("none", 1.0)
    (sample,) = sidecar.drawn["samples"]
    assert not sample["applied"]
    assert "path" not in sample  # nothing has formed it
    assert replay(sidecar, Path("again/a.png")) == sidecar


# Known waters


def fitted() -> Any:
    """A fit in f.json, of pictures in a water that is known."""
    clean = torch.rand(3, 32, 32, generator=torch.Generator().manual_seed(0))
    z = torch.linspace(1, 6, 32 * 32).reshape(1, 32, 32)
    medium = uwaug.Medium.from_coefficients(*[(0.5, 0.2, 0.15)] * 2, (0.1, 0.3, 0.4))
    observed = uwaug.form_image(clean, z, medium).image
    uwaug.fit(clean, observed, z, color_space="linear", model="haze").save("f.json")
    return uwaug.fitting.Fit.load("f.json").medium


def test_known_waters_are_seen_by_any_camera_in_any_light():
    medium, image, z = fitted(), read_picture("a.png"), metric()
    place = {"position": (0.3, 0, 0), "direction": (0, 0, 1), "power": 2}
    cases = (
        ({}, {}),
        ({"exposure": 1.5}, {"exposure": 1.5}),
        ({"exposure": "auto"}, {"exposure": "auto"}),
        ({"light": [{"kind": "lamp", **place}]}, {"light": uwaug.Light.lamp(**place)}),
    )
    for number, (options, arguments) in enumerate(cases):
        item = item_of(output=f"{number}.png")
        sidecar = made(item, water=None, fit="f.json", options=options)
        expected = uwaug.Underwater(medium, (1, 4), focal_px=focal_of(None, W), **arguments)(
            image[None], z[None]
        )[0]
        found = read_picture(f"out/{number}.png").int()
        assert (found - expected.int()).abs().max() <= 1
        assert sidecar.drawn == {"path": "eager" if "light" in options else fused.path()}
        again = replay(sidecar, Path("again", f"{number}.png"))
        assert again.sha256 == sidecar.sha256
    assert len({path.read_bytes() for path in Path("out").glob("*.png")}) == len(cases)
    with pytest.raises(ValueError, match=r"visibility=3 would do nothing: fit .* is one known"):
        made(water=None, fit="f.json", options={"visibility": 3}, force=True)
    lights = {"light": [{"kind": "lamp", **place, "power": [1.0, 4.0]}]}
    with pytest.raises(ValueError, match="light must be for one picture, got one for 2"):
        made(water=None, fit="f.json", options=lights, force=True)


@pytest.mark.parametrize(
    ("recipe", "engine"),
    [({"preset": "mcglamery-1980"}, "eager"), ({"random": True}, "fused-rows")],
)
def test_large_pictures_in_all_waters(recipe, engine, monkeypatch):
    """Formed in bands of rows, and recorded so; contrast and terms as of the whole picture."""
    save("a.png", pixels(150, 130))
    save("z.npy", metres(150, 130))
    recipe = {"water": None, "keep_terms": True, "labels": "marks", **recipe}
    save("marks/a.png", np.ones((150, 130), np.uint8))
    whole = made(**recipe)
    before = {path.name: read_picture(path).int() for path in Path("out").glob("a*.png")}
    monkeypatch.setattr(uwaug._support.tiles, "LARGE", 1)
    tiled = made(force=True, **recipe)
    for name, picture in before.items():
        assert (read_picture(f"out/{name}").int() - picture).abs().max() <= 1
    assert tiled.contrast == pytest.approx(whole.contrast, abs=2e-5)
    (seen,), (expected,) = tiled.labels["objects"], whole.labels["objects"]
    assert seen["contrast"] == pytest.approx(expected["contrast"], abs=1e-4)
    (drawn,) = tiled.drawn.get("samples", [tiled.drawn])
    assert drawn["path"] == engine


# What stands beside it


def decoded(path: str) -> np.ndarray:
    v = tifffile.imread(path).astype(np.float64)
    size = abs(v)
    return np.sign(v) * np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)


def test_terms_add_up_in_linear_light():
    save("a.tif", pixels().astype(np.float32) / 255, photometric="rgb")
    made(item_of("a.tif"), keep_terms=True)
    terms = [decoded(f"out/a_{term}.tif") for term in ("direct", "forward", "backscatter")]
    assert all(term.max() > 0.001 for term in terms)
    assert min(term.min() for term in terms) < 0  # out of sRGB
    np.testing.assert_allclose(sum(terms).clip(0), decoded("out/a.tif"), atol=2e-6)


def test_the_index_tells_all_and_keeps_what_other_runs_have_made():
    for name in ("a.png", "b.png"):
        save(name, pixels(seed=ord(name[0])))
        result = Degrader(Recipe(random=True))(item_of(name))
        with index_of(Path("out")) as index:
            index.add(result)
    first, second = Items([Path("out/index.csv")], None, Path("again"))
    assert (first.id, second.id) == ("b.png", "a.png")
    assert first.distance.resolve() == Z.resolve()
    _, line, _ = csv.reader(Path("out/index.csv").read_text().splitlines())
    sidecar = result.sidecar
    shown = [sidecar.water, f"{sidecar.visibility:.4g}", f"{sidecar.contrast:.4g}"]
    assert line == [
        *("b.png", "0", "../b.png", "../z.npy", "b.png"),
        *shown,
        *(f"{result.seconds:.3f}", "done", "", ""),
    ]
    Path("out/index.csv").write_text("mine,alone\n")
    with pytest.raises(ValueError, match="is no index of uwaug"), index_of(Path("out")):
        pass
    assert Path("out/index.csv").read_text() == "mine,alone\n"


def test_an_index_that_was_cut_off_or_damaged():
    for name in ("a.png", "b.png"):
        save(name, pixels())
    path = Path("out/index.csv")
    results = [Degrader(Recipe(water="3C"))(item_of(name)) for name in ("a.png", "b.png")]
    with index_of(Path("out")) as index:
        for result in results:
            index.add(result)
    whole = path.read_bytes()
    for kept in range(len(whole.split(b"\n")[0]) + 1, len(whole), 6):
        path.write_bytes(whole[:kept])
        with index_of(Path("out")):
            pass
        lines = list(csv.DictReader(path.read_text().splitlines()))
        assert [line["output"] for line in lines] == ["a.png", "b.png"][: len(lines)]
    path.write_bytes(whole + b"\xff")
    with pytest.raises(ValueError, match=r"index\.csv: is damaged"), index_of(Path("out")):
        pass
    assert path.read_bytes() == whole + b"\xff"


def test_an_index_tells_nothing_of_pictures_that_are_being_written_over():
    for name in ("a.png", "b.png"):
        save(name, pixels())
        result = Degrader(Recipe(water="3C"))(item_of(name))
        with index_of(Path("out")) as index:
            index.add(result)
    with pytest.raises(KeyboardInterrupt), index_of(Path("out"), [item_of("a.png")]):
        raise KeyboardInterrupt
    (line,) = csv.DictReader(Path("out/index.csv").read_text().splitlines())
    assert line["output"] == "b.png"


# Again


@pytest.mark.parametrize("how", [{"water": "3C"}, {"water": None, "random": True, "seed": 5}])
def test_a_sidecar_makes_the_same_bytes(how):
    save("marks/a.png", np.ones((H, W), np.uint8))
    first = made(item_of(variant=1), keep_terms=True, labels="marks", **how)
    sidecar = Sidecar.read(Path("out/a.png.json"))
    assert sidecar == first
    again = replay(sidecar, Path("again/a.png"))
    assert again == sidecar
    assert content("again") == content("out")
    assert len(content("again")) == 7
    with pytest.raises(FileExistsError, match="exists"):
        replay(sidecar, Path("again/a.png"))


FORMAT_1 = Path(__file__).with_name("format-1")
"""Pictures and sidecars that earlier versions have written: "random" that of commit e9c0d46, the
others that of 9e03a52.
"""


@pytest.mark.parametrize("name", ["random", "visibility", "water", "preset"])
def test_a_sidecar_of_format_1_makes_the_same_picture(name):
    shutil.copytree(FORMAT_1, ".", dirs_exist_ok=True)
    sidecar = Sidecar.read(Path(f"{name}.png.json"))
    recipe = Recipe.from_json(sidecar.recipe)
    item = Item("a.png", Path("a.png"), Z, Path("again.png"), 0)
    again = Degrader(recipe).write(item, sidecar.drawn)
    # another kind of CPU may round a value to the next of 255
    difference = read_picture("again.png").int() - read_picture(f"{name}.png").int()
    assert difference.abs().max() <= 1
    assert again.water == sidecar.water
    assert again.visibility == pytest.approx(sidecar.visibility)


@pytest.mark.parametrize("name", ["a.png", "z.npy", "p.toml", "marks/a.png"])
def test_a_sidecar_of_files_that_have_changed(name):
    preset = Path(__file__).parents[2] / "configs/survey.toml"
    Path("p.toml").write_text(preset.read_text())
    save("marks/a.png", np.ones((H, W), np.uint8))
    sidecar = made(water=None, preset="p.toml", labels="marks")
    if name == "p.toml":
        Path(name).write_text(preset.read_text() + "\n")
    else:
        values = {"a.png": pixels(seed=3), "z.npy": metres() + 1}
        save(name, values.get(name, np.full((H, W), 2, np.uint8)))
    with pytest.raises(ValueError, match=f"{name} has changed since the record was written"):
        replay(sidecar, Path("again/a.png"))
    assert not Path("again").exists()


def test_sidecars_that_are_none():
    for text in ("", "{}", '{"format": 1}', "[1]"):
        Path("r.json").write_text(text)
        with pytest.raises(ValueError, match=r"r\.json: is no record of a picture"):
            Sidecar.read(Path("r.json"))
    Path("r.json").write_text("[" * 200_000)
    with pytest.raises(ValueError, match=r"r\.json: is no record of a picture: .* nest too deep"):
        Sidecar.read(Path("r.json"))


OBJECT = {"key": 1, "contrast": 0.5, "ignored": False}
LABELS = {"picture": "a.png", "output": "a.png", "objects": [OBJECT]}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, ["?"]) for name in ("id", "variant", "input", "distance", "recipe", "contrast")),
        ("recipe", {"content": "a.toml"}),
        ("label_file", "marks/a.png"),
        ("labels", LABELS | {"picture": ["a.png"]}),
        ("labels", LABELS | {"objects": {}}),
        ("labels", LABELS | {"objects": [OBJECT | {"key": []}]}),
    ],
)
def test_a_sidecar_of_other_kinds_is_none(name, value):
    made()
    path = Path("out/a.png.json")
    content = json.loads(path.read_text())
    path.write_text(json.dumps({**content, "labels": LABELS}))
    assert Sidecar.read(path).labels == LABELS
    path.write_text(json.dumps({**content, name: value}))
    with pytest.raises(ValueError, match=r"a\.png\.json: is no record of a picture"):
        Sidecar.read(path)


@pytest.mark.parametrize("output", ["../../escaped.png", "/escaped.png", "..", "", 3])
def test_a_sidecar_does_not_say_where_to_write(output):
    made()
    path = Path("out/a.png.json")
    path.write_text(json.dumps({**json.loads(path.read_text()), "output": output}))
    with pytest.raises(ValueError, match=r"a\.png\.json: output must be a name without folders"):
        Sidecar.read(path)


def test_an_index_gives_names_back_to_the_letter():
    save(" b .png", pixels())
    item = item_of(" b .png", output=" c .png")
    result = Degrader(Recipe(water="3C"))(item)
    with index_of(Path("out")) as index:
        index.add(result)
    (again,) = Items([Path("out/index.csv")], None, Path("again"))
    assert (again.id, again.output) == (" b .png", Path("again/ c .png"))
    assert again.input.resolve() == Path(" b .png").resolve()


# What is kept, and what is written over


def test_resume_keeps_what_is_there_and_only_that():
    first = made()
    degrader = Degrader(Recipe(water="3C"), resume=True)
    kept = degrader(item_of())
    assert (kept.status, kept.sidecar) == ("kept", first)
    Path("out/a.png").unlink()
    assert degrader(item_of()).status == "done"


@pytest.mark.parametrize("changed", ["a.png", "z.npy", "marks/a.png"])
def test_resume_sees_other_content_of_the_same_size(changed):
    save("marks/a.png", np.ones((H, W), np.uint8))
    made(labels="marks")
    data = bytearray(Path(changed).read_bytes())
    data[-1] ^= 1
    Path(changed).write_bytes(data)
    with pytest.raises(FileExistsError, match=r"a\.png exists"):
        made(labels="marks")
    recipe = Recipe(water="3C", labels="marks").resolved()
    (item,) = labelled([item_of()], recipe.open_labels())
    result = Degrader(recipe, resume=True)(item)
    what = {"a.png": "picture", "z.npy": "distance"}.get(changed, "label file")
    reason = f"out/a.png exists, but was made of another {what}: remove the picture to make it anew"
    assert (result.status, result.reason) == ("failed", reason)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda: Path("out/a.png").write_bytes(bytes(Path("out/a.png").stat().st_size)), "bytes"),
        (lambda: Path("out/labels/a.png").unlink(), "out/labels/a.png is gone"),
        (lambda: Path("out/labels/a.contrast.json").unlink(), "a.contrast.json is gone"),
        (lambda: Path("out/a_direct.png").unlink(), "out/a_direct.png is gone"),
        (lambda: Path("out/a_direct.png").write_bytes(b""), "a_direct.png is not as it was"),
        (lambda: Path("out/labels/a.png").write_bytes(b""), "labels/a.png is not as it was"),
        (lambda: Path("marks/a.png").unlink(), "was made of another label file"),
    ],
)
def test_resume_keeps_only_what_is_whole(change, why):
    for name in ("a", "b"):
        save(f"marks/{name}.png", np.ones((H, W), np.uint8))
    recipe = {"labels": "marks", "keep_terms": True}
    first = made(**recipe)
    before = content("out")
    opened = Recipe(water="3C", **recipe).resolved()

    def again(**how) -> Any:
        (item,) = labelled([item_of()], opened.open_labels())
        return Degrader(opened, resume=True, **how)(item)

    assert again().sidecar == first
    change()
    result = again()
    assert result.status == "failed"
    assert result.reason.startswith("out/a.png exists, but ")
    assert why in result.reason
    assert again(force=True).status == "done"
    if "label" not in why:
        assert content("out") == before


def test_records_that_do_not_tell_of_files_beside_are_kept():
    """Those of earlier versions."""
    save("marks/a.png", np.ones((H, W), np.uint8))
    first = made(labels="marks")
    path = Path("out/a.png.json")
    record = json.loads(path.read_text())
    assert set(record.pop("beside")) == {"a.png", "a.contrast.json"}
    path.write_text(json.dumps(record))
    recipe = Recipe(water="3C", labels="marks").resolved()
    (item,) = labelled([item_of()], recipe.open_labels())
    kept = Degrader(recipe, resume=True)(item)
    assert (kept.status, kept.sidecar) == ("kept", replace(first, beside={}))


def test_resume_sees_labels_that_have_come():
    Path("marks").mkdir()
    save("marks/b.png", np.ones((H, W), np.uint8))
    made(labels="marks")
    save("marks/a.png", np.ones((H, W), np.uint8))
    recipe = Recipe(water="3C", labels="marks").resolved()
    (item,) = labelled([item_of()], recipe.open_labels())
    assert "was made of another label file" in Degrader(recipe, resume=True)(item).reason


def test_resume_says_what_other_versions_have_made():
    first = made()
    replace(first, torch="1.0").write(Path("out/a.png.json"))
    kept = Degrader(Recipe(water="3C").resolved(), resume=True)(item_of())
    assert kept.status == "kept"
    said = "made by uwaug 0.1.0 and torch 1.0: not by those of this run"
    assert kept.sidecar.notes == [FAINT, said]


def test_a_picture_that_was_left_as_it_is_has_no_terms():
    save("z.npy", metres() * 0)
    recipe = Recipe(water="3C", keep_terms=True, distance=DistanceFormat(unknown="skip"))
    for resume, status in ((False, "done"), (True, "kept")):
        assert Degrader(recipe, resume=resume)(item_of()).status == status


def test_force_leaves_the_labels_of_a_longer_name():
    """Of f.left.png when it comes to f.png."""
    for name in ("f.left", "f"):
        save(f"{name}.png", pixels())
        Path("marks").mkdir(exist_ok=True)
        Path(f"marks/{name}.txt").write_text("0 .5 .5 .4 .4\n")
    for force in (False, True, True):
        for name in ("f.left.png", "f.png"):
            made(item_of(name), labels="marks", force=force)
    names = {"f.txt", "f.left.txt", "f.contrast.json", "f.left.contrast.json"}
    assert set(content("out/labels")) == names


def test_a_record_names_what_made_its_picture_where_the_loops_do_not_load(monkeypatch):
    first = made() if fused.path() == "fused" else None

    def broken(name: str) -> None:
        raise RuntimeError("a cache of half a file")

    monkeypatch.setattr(backend, "_numba", True)
    monkeypatch.setattr(backend, "_switched", None)
    monkeypatch.setattr(backend, "_ready", set())
    monkeypatch.setattr(backend, "_failure", "")
    monkeypatch.setattr(backend, "_compile", broken)
    monkeypatch.delenv(backend.VARIABLE, raising=False)
    save("b.png", pixels())
    sidecar = made(item_of("b.png"))
    assert sidecar.drawn["samples"][0]["path"] == "eager"
    if first is not None:
        again = Degrader(Recipe(water="3C")).write(item_of(output="again.png"), first.drawn)
        assert again.drawn["samples"][0]["path"] == "eager"


def test_nothing_of_the_users_is_written_over():
    for path in ("out/a.png", "out/a.png.json", "out/a_direct.png", "out/labels/a.png"):
        save("marks/a.png", np.ones((H, W), np.uint8))
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).write_text("mine")
        with pytest.raises(FileExistsError, match=f"{path} exists"):
            made(keep_terms=True, labels="marks")
        assert Path(path).read_text() == "mine"
        Path(path).unlink()
    made(keep_terms=True, labels="marks")


def test_force_leaves_labels_that_no_run_has_written():
    made()
    save("out/labels/a.png", np.ones((H, W), np.uint8))
    before = content("out/labels")
    made(force=True)
    with pytest.raises(ValueError, match="the labels' own file"):
        made(labels="out/labels", force=True)
    assert content("out/labels") == before


def test_force_leaves_nothing_of_the_picture_before():
    save("marks/a.png", np.ones((H, W), np.uint8))
    made(labels="marks", keep_terms=True)
    assert {"a_direct.png", "labels/a.png"} <= set(content("out"))
    made(force=True)
    assert set(content("out")) == {"a.png", "a.png.json"}


@pytest.mark.parametrize("stuck", ["labels/a.txt", "labels/a.contrast.json"])
def test_force_that_fails_leaves_a_picture_its_labels(stuck):
    Path("marks").mkdir()
    Path("marks/a.txt").write_text("0 .5 .5 .4 .4\n")
    made(labels="marks")
    before = content("out")
    kept = Path("out", stuck).rename("kept")
    Path("out", stuck).mkdir()
    with pytest.raises(OSError, match="is a folder"):
        made(labels="marks", force=True, water="7C")
    Path("out", stuck).rmdir()
    kept.rename(Path("out", stuck))
    assert content("out") == before


def test_an_old_picture_is_not_taken_for_that_of_a_new_sidecar(monkeypatch):
    """Stopped between the two, when their sizes are alike."""
    save("b.npy", pixels())
    made(item_of("b.npy"))
    recipe, move = Recipe(water="7C"), Path.replace

    def stopped(part, target):
        if not str(target).endswith(".json"):
            raise KeyboardInterrupt
        return move(part, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", stopped)
        with pytest.raises(KeyboardInterrupt):
            Degrader(recipe, force=True)(item_of("b.npy"))
    assert sidecar_path(Path("out/b.npy")).exists()
    assert Degrader(recipe, resume=True)(item_of("b.npy")).status == "done"


# What is refused


def test_pictures_that_are_refused():
    save("floats.npy", pixels().astype(np.float32))
    for name, reason in (
        ("floats.npy", "divide a 0…255 image by 255"),
        ("none.png", "No such file"),
    ):
        said = failed(item_of(name))
        assert reason in said
        assert name in said
    assert "a.gif: expected a name that ends in .png" in failed(item_of(output="a.gif"))
    assert failed(item_of()._replace(problem="odd")) == "odd"


@pytest.mark.parametrize(
    "value, format, words",
    [
        (np.nan, {}, "NaN at 48"),
        (0, {}, "zero at 48"),
        (-1, {}, "negative at 48"),
        (np.nan, {"kind": "inverse"}, "NaN at 48"),
        (2, {"kind": "relative"}, r"must lie in \[0, 1\]"),
    ],
)
def test_distances_that_are_refused(value, format, words):
    z = metres() / 4
    z[:3] = value
    save("z.npy", z)
    said = failed(item_of(), distance=DistanceFormat(**format))
    assert "a.png with z.npy: " in said
    assert words.replace("\\", "") in said


def test_metres_are_of_no_other_kind():
    said = failed(item_of(distance=3), distance=DistanceFormat("inverse"))
    assert "distance=3 is metres, but distance_kind is 'inverse'" in said
    assert "no distances: give a file, metres, or a depth network" in failed(item_of(distance=None))


def test_files_may_not_be_so_large():
    """As where the disk is full."""
    save("a.png", pixels(120, 160))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        result = Degrader(Recipe(water="3C"))(item_of(distance=3))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert result.reason == "out/a.png: File too large"
    assert os.listdir("out") == []


@pytest.mark.parametrize(
    "recipe, words",
    [
        ({}, "expected one of water, preset, fit and random, got none"),
        ({"water": "3C", "fit": "f.json"}, "got water and fit"),
        ({"water": "3C", "random": True}, "got water and random"),
        ({"random": True, "min_contrast": 0.1}, "there are no labels"),
        ({"random": True, "options": {"waters": "12C"}}, "12C"),
        ({"preset": "nowhere"}, "survey"),
    ],
)
def test_recipes_that_are_none(recipe, words):
    with pytest.raises(ValueError, match=words):
        Recipe(**recipe).resolved()


def test_recipes_as_json():
    recipe = Recipe(random=True, options={"light": [{"kind": "ambient"}]}, seed=3).resolved()
    values = json.loads(json.dumps(recipe.to_json()))
    assert "depth" in values
    assert Recipe.from_json(values) == recipe
    assert replace(recipe, seed=4) != recipe
    with pytest.raises(ValueError, match="they differ in odd"):
        Recipe.from_json({**values, "odd": 1})
