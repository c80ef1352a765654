"""`uwaug degrade`: what it makes of pictures in files, and what it keeps of them."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
import torch
from filing import H, W, content, metres, pixels, save, save_pair, words
from networks import mean_of_channels
from PIL import Image

import uwaug
from uwaug.distance.convert import along_ray, from_disparity, from_inverse, from_relative
from uwaug.io.read import read_picture, read_picture_file
from uwaug.jobs import Degrader, Item, Recipe, Sidecar
from uwaug.jobs.sidecar import sidecar_path

ORIENTATION, MAKER = 0x0112, 0x010F
PROFILE = b"\0" * 36 + b"acsp" + b"\0" * 88


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Where each test works: a picture, and its distances."""
    monkeypatch.chdir(tmp_path)
    save_pair("a.png")
    return tmp_path


@pytest.fixture
def made(run):
    """Degrade what must go well; return what is printed."""

    def call(*arguments: str, distance: str | None = "z.npy", water: str = "3C") -> str:
        given = [] if distance is None else ["--distance", distance]
        kind = [] if "--random" in arguments else ["--water", water]
        code, out, err = run("degrade", *arguments, *given, *kind, "--out", "out")
        assert (code, err) == (0, "")
        return out

    return call


def in_water(image, z) -> torch.Tensor:
    """A picture as `--water 3C` shows it, by the transform."""
    fixed = {"contrast": None, "vertical_depth": 1.0, "field_probability": 0.0}
    return uwaug.RandomUnderwater("3C", **fixed).at(0, 0, "a.png")(image, z)[0]


def metric(values=None) -> torch.Tensor:
    return torch.from_numpy(metres() if values is None else values)[None]


# What becomes of a picture


def test_the_same_as_by_the_transform(made):
    made("a.png", "--random", "--seed", "7", "--variants", "2")
    image = read_picture("a.png")
    for variant in (0, 1):
        transform = uwaug.RandomUnderwater().at(7, variant, "a.png")
        expected, _ = transform(image, metric())
        assert torch.equal(read_picture(f"out/a_{variant + 1}.png"), expected)
    assert content("out")["a_1.png"] != content("out")["a_2.png"]


def test_options_of_the_transform(made):
    Path("o.toml").write_text('waters = ["II", "7C"]\nmixing = [0.0, 1.0]\nfield_probability = 1.0')
    made("a.png", "--random", "--options", "o.toml", "--visibility", "3:5", "--depth", "2")
    transform = uwaug.RandomUnderwater(
        ["II", "7C"],
        mixing=(0, 1),
        field_probability=1.0,
        visibility=(3, 5),
        vertical_depth=2.0,
    )
    expected, _ = transform.at(0, 0, "a.png")(read_picture("a.png"), metric())
    assert torch.equal(read_picture("out/a.png"), expected)


def test_one_picture_into_one_file(run):
    arguments = ("--distance", "3", "--water", "3C", "--out", "there/b.png")
    small = [one.replace("3C", "3c") for one in arguments]
    code, out, err = run("degrade", "a.png", *small)
    assert (code, err) == (0, "")
    assert "1 of 1 pictures" in out
    assert set(content("there")) == {"b.png", "b.png.json"}
    assert torch.equal(
        read_picture("there/b.png"), in_water(read_picture("a.png"), metric() * 0 + 3)
    )


def test_a_picture_of_one_pixel(made):
    save("a.png", pixels(1, 1))
    made("a.png", distance="3")
    assert read_picture("out/a.png").shape == (3, 1, 1)


# What is kept of its file


@pytest.mark.parametrize("end", ["jpg", "webp", "png"])
def test_orientation_is_honoured_and_the_rest_of_exif_kept(made, end):
    exif = Image.Exif()
    exif[ORIENTATION], exif[MAKER] = 6, "maker"
    lossless = {"lossless": True} if end == "webp" else {}
    save(f"a.{end}", pixels(W, H), exif=exif, icc_profile=PROFILE, **lossless)
    made(f"a.{end}")
    with Image.open(f"out/a.{end}") as found:
        assert found.size == (W, H)
        kept = found.getexif()
        assert (kept.get(MAKER), kept.get(ORIENTATION)) == ("maker", None)
        assert found.info["icc_profile"] == PROFILE
    if end == "png":
        stood = torch.from_numpy(np.rot90(pixels(W, H), -1).copy()).permute(2, 0, 1)
        assert torch.equal(read_picture("out/a.png"), in_water(stood, metric()))


def test_a_profile_is_kept_in_tiff(made):
    save("a.tif", words(), photometric="rgb", iccprofile=PROFILE)
    made("a.tif")
    assert read_picture_file("out/a.tif").profile == PROFILE


def test_alpha_is_kept(made):
    bits8, bits16 = pixels(channels=4), words(4)
    save("a.png", bits8)
    save("b.png", bits16)
    save("c.tif", bits16, photometric="rgb", extrasamples=["unassalpha"])
    made("a.png", "b.png", "c.tif")
    assert np.array_equal(read_picture_file("out/a.png").alpha, bits8[..., 3])
    for name in ("b.png", "c.tif"):
        assert np.array_equal(read_picture_file(f"out/{name}").alpha, bits16[..., 3])


@pytest.mark.parametrize("name", ["b.png", "b.tif"])
def test_16_bits_stay_16_bits(made, name):
    save(name, words(), **({"photometric": "rgb"} if name == "b.tif" else {}))
    made(name)
    found = read_picture_file(f"out/{name}")
    assert found.bits == 16
    expected = in_water(torch.from_numpy(words().transpose(2, 0, 1) / np.float32(65535)), metric())
    assert (found.image - expected).abs().max() < 0.51 / 65535
    assert (found.image * 255 % 1).std() > 0.1


def test_floats_of_npy(made):
    light = np.random.default_rng(0).random((H, W, 3), dtype=np.float32)
    save("b.npy", light)
    made("b.npy")
    found = np.load("out/b.npy")
    assert found.dtype == np.float32
    expected = in_water(torch.from_numpy(light.transpose(2, 0, 1)), metric())
    assert np.array_equal(found, expected.numpy())


@pytest.mark.parametrize("end", ["png", "jpg", "webp", "tif", "npy", "JPG"])
def test_formats(made, end):
    made("a.png", "--format", end)
    (name,) = (name for name in content("out") if name.startswith("a.") and "json" not in name)
    assert name == f"a.{end.lower()}"
    found = read_picture(f"out/{name}").float()
    lossy = end.lower() in ("jpg", "webp")
    expected = in_water(read_picture("a.png"), metric()).float()
    assert (found - expected).abs().mean() <= (8 if lossy else 0)


# Where distances are


def from_(image, name="out/a.png") -> None:
    assert torch.equal(read_picture(name), image)


@pytest.mark.parametrize(
    "distance", ["maps", "maps/{stem}.npy", "{stem}_depth.npy", "z.npy", "maps/{name}.npy"]
)
def test_where_distances_are(made, distance):
    for path in ("maps/a.npy", "a_depth.npy"):
        save(path, metres())
    made("a.png", distance=distance)
    from_(in_water(read_picture("a.png"), metric()))


def test_maps_of_pictures_in_folders(made):
    save("all/one/a.png", pixels())
    save("all/two/a.png", pixels())
    save("maps/one/a.npy", metres())
    save("maps/two/a.tif", metres() * 2)
    made("all", distance="maps")
    records = [Sidecar.read(Path(f"out/{name}/a.png.json")) for name in ("one", "two")]
    assert [record.id for record in records] == ["one/a.png", "two/a.png"]
    assert [Path(record.distance.path).name for record in records] == ["a.npy", "a.tif"]
    Path("maps/two/a.tif").unlink()
    save("maps/two/a.npy", metres() * 2)
    before = content("out")
    made("all", "--force", distance="maps/{name}.npy")
    assert content("out")["two/a.png"] == before["two/a.png"]


@pytest.mark.parametrize("end", ["csv", "parquet"])
def test_lists(made, end):
    save("far/b.png", pixels(seed=1))
    lines = [
        {"input": "a.png", "id": "first", "distance": "z.npy", "output": "x/one.jpg"},
        {"input": str(Path("far/b.png").absolute()), "id": "", "distance": "2.5", "output": ""},
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
    made(f"list.{end}", distance=None)
    assert {"x/one.jpg", "x/one.jpg.json", "b.png", "b.png.json"} < set(content("out"))
    assert Sidecar.read(Path("out/x/one.jpg.json")).id == "first"
    assert Sidecar.read(Path("out/b.png.json")).distance == 2.5


def test_a_link_that_leads_back_ends(made):
    save("all/a.png", pixels())
    Path("all/again").symlink_to("..")
    made("all", distance="3")
    assert {name for name in content("out") if name.endswith("png")} == {"a.png"}


def test_out_inside_the_input_is_no_input(run):
    save("all/a.png", pixels())
    for more in ([], ["--resume"], ["--force"]):
        arguments = ["--distance", "3", "--water", "3C", "--out", "all/wet", *more]
        code, out, err = run("degrade", "all", *arguments)
        assert (code, err) == (0, "")
        assert "of 1 pictures" in out


# What maps hold


def test_relative_distances(made):
    t = ((metres() - 1) / 3 * 65535).astype(np.uint16)
    save("z.png", t)
    made(
        "a.png",
        *("--distance-kind", "relative", "--near", "1", "--far", "6", "--gamma", "2"),
        distance="z.png",
    )
    z = from_relative(torch.from_numpy(t.astype(np.float32) / np.float32(65535))[None], 1, 6, 2)
    found = read_picture("out/a.png").int() - in_water(read_picture("a.png"), z).int()
    assert found.abs().max() <= 1


def test_inverse_distances(made):
    made("a.png", "--distance-kind", "inverse", "--near", "1", "--far", "6")
    from_(in_water(read_picture("a.png"), from_inverse(metric(), 1.0, 6.0)))


def test_disparities(made):
    options = ("--focal-px", "20", "--baseline", ".4", "--offset-px", "1.5")
    made("a.png", "--distance-kind", "disparity", *options)
    z = along_ray(from_disparity(metric(), 20, 0.4, 1.5), 20)
    transform = uwaug.RandomUnderwater(
        "3C", contrast=None, vertical_depth=1.0, field_probability=0.0, focal_px=20.0
    )
    expected, _ = transform.at(0, 0, "a.png")(read_picture("a.png"), z)
    from_(expected)


def test_planar_depth_in_millimetres(made):
    mm = (metres() * 1000).astype(np.uint16)
    save("z.png", mm)
    options = ("--planar", "--focal-px", "20", "--distance-unit", "mm")
    made("a.png", *options, distance="z.png")
    z = along_ray(torch.from_numpy((mm.astype(np.float64) * 0.001).astype(np.float32))[None], 20)
    record = Sidecar.read(Path("out/a.png.json"))
    assert record.recipe["options"] == {"focal_px": 20.0}
    transform = uwaug.RandomUnderwater(
        "3C", contrast=None, vertical_depth=1.0, field_probability=0.0, focal_px=20.0
    )
    from_(transform.at(0, 0, "a.png")(read_picture("a.png"), z)[0])


def test_a_depth_network(made):
    path = mean_of_channels("n.onnx")
    made("a.png", "--depth-network", path, "--near", "1", "--far", "6", distance=None)
    image = read_picture("a.png")
    inverse = uwaug.distance.DepthNetwork(path)(image / 255)
    from_(in_water(image, from_inverse(inverse, 1.0, 6.0)))
    assert Sidecar.read(Path("out/a.png.json")).distance is None


@pytest.mark.parametrize("unknown", ["fill", "far", "3.5", "skip"])
@pytest.mark.parametrize("value", [0, np.nan])
def test_unknown_distances(made, unknown, value):
    holed = metres()
    holed[:2, :5] = value
    save("z.npy", holed)
    made("a.png", "--unknown", unknown)
    given = float(unknown) if unknown[0].isdigit() else unknown
    fixed = {"contrast": None, "vertical_depth": 1.0, "field_probability": 0.0}
    transform = uwaug.RandomUnderwater("3C", **fixed, unknown=given)
    expected, _ = transform.at(0, 0, "a.png")(read_picture("a.png"), metric(holed))
    from_(expected)


def test_a_picture_without_distances_is_left_as_it_is(made):
    save("z.npy", metres() * 0)
    made("a.png", "--unknown", "skip")
    from_(read_picture("a.png"))
    record = Sidecar.read(Path("out/a.png.json"))
    assert (record.water, record.contrast) == ("none", 1.0)


def test_distances_of_another_size(made):
    save("z.npy", metres(H // 2, W // 2))
    out = made("a.png")
    note = f"distances of {W // 2}×{H // 2} px, resampled to {W}×{H}"
    assert f"Note: a.png: {note}" in out
    assert Sidecar.read(Path("out/a.png.json")).notes == [note]
    near = metres(H // 2, W // 2).repeat(2, 0).repeat(2, 1)
    from_(in_water(read_picture("a.png"), metric(near)))


# What stands beside it


def decoded(path: str) -> np.ndarray:
    v = tifffile.imread(path).astype(np.float64)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def test_terms_add_up_in_linear_light(made):
    save("a.tif", pixels().astype(np.float32) / 255, photometric="rgb")
    made("a.tif", "--keep-terms")
    terms = [decoded(f"out/a_{term}.tif") for term in ("direct", "forward", "backscatter")]
    assert all(term.max() > 0.001 for term in terms)
    np.testing.assert_allclose(sum(terms), decoded("out/a.tif"), atol=2e-6)


def test_the_index_tells_all(made):
    save("all/b.png", pixels(seed=1))
    made("all", "a.png", "--random")
    with open("out/index.csv", newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["output"] for line in lines] == ["b.png", "a.png"]
    for line in lines:
        record = Sidecar.read(Path("out", line["output"] + ".json"))
        assert line["water"] == record.water
        assert float(line["visibility"]) == pytest.approx(record.visibility, rel=1e-3)
        assert 0 < float(line["contrast"]) < 1
        assert (line["status"], line["reason"]) == ("done", "")


def test_the_index_keeps_what_other_runs_have_made(made):
    made("a.png")
    save("b.png", pixels(seed=1))
    made("b.png")
    with open("out/index.csv", newline="") as file:
        assert {line["id"] for line in csv.DictReader(file)} == {"a.png", "b.png"}


def test_a_rehearsal_writes_nothing(made, folder):
    before = content(".")
    out = made("a.png", "--dry-run", "--variants", "3")
    assert "a.png + z.npy → out/a_3.png" in out
    assert "3 pictures, about" in out
    assert content(".") == before
    assert not Path("out").exists()


def test_a_rehearsal_fails_as_the_run_would(run):
    Path("a.png").write_bytes(b"")
    arguments = ("--distance", "3", "--water", "3C", "--out", "out", "--dry-run")
    code, _, err = run("degrade", "a.png", *arguments)
    assert (code, "a.png: is empty" in err) == (1, True)


def test_a_sheet(made):
    pytest.importorskip("matplotlib")
    made("a.png", "--sheet")
    with Image.open("out/sheet.jpg") as sheet:
        assert sheet.width > 500
    assert set(content("out")) >= {"a.png", "sheet.jpg"}


# Again


@pytest.mark.parametrize("how", [["--water", "3C"], ["--random", "--seed", "5"]])
def test_a_record_makes_the_same_bytes(run, how):
    given = ("--distance", "z.npy", "--out", "out", "--variants", "2", "--keep-terms")
    assert run("degrade", "a.png", *given, *how)[0] == 0
    code, out, err = run("degrade", "--from", "out/a_2.png.json", "--out", "again")
    assert (code, err) == (0, "")
    assert "the same bytes" in out
    before, after = content("out"), content("again")
    assert len(after) == 5
    for name in after:
        if not name.endswith(".json"):
            assert after[name] == before[name]
    assert json.loads(after["a_2.png.json"]) == json.loads(before["a_2.png.json"])
    code, _, err = run("degrade", "--from", "out/a_2.png.json", "--out", "again")
    assert (code, "exists" in err) == (1, True)
    code, _, err = run("degrade", "--from", "out/a_2.png.json", "--out", "out", "--force")
    assert (code, "is the first one" in err) == (2, True)


@pytest.mark.parametrize("name", ["a.png", "z.npy"])
def test_a_record_of_files_that_have_changed(made, run, name):
    made("a.png")
    save(name, pixels(seed=3) if name == "a.png" else metres() + 1)
    code, _, err = run("degrade", "--from", "out/a.png.json", "--out", "again")
    assert code == 1
    assert f"{name} has changed since the record was written" in err
    assert not Path("again").exists()


def test_records_that_are_none(run):
    for text in ("", "{}", '{"format": 1}', "[1]"):
        Path("r.json").write_text(text)
        code, _, err = run("degrade", "--from", "r.json", "--out", "again")
        assert (code, "r.json: is no record of a picture" in err) == (1, True)


def test_resume_keeps_what_is_there_and_only_that(made):
    save("b.png", pixels(seed=1))
    made("a.png", "b.png")
    before = content("out")
    Path("out/b.png").unlink()
    out = made("a.png", "b.png", "--resume")
    assert "1 of 2 pictures, 1 were there" in out
    after = content("out")
    for name in ("a.png", "b.png", "a.png.json", "b.png.json"):
        assert after[name] == before[name]


def test_resume_of_another_recipe_writes_nothing_over(made, run):
    made("a.png")
    before = content("out")["a.png"]
    arguments = ("--distance", "z.npy", "--out", "out", "--resume", "--water")
    code, _, err = run("degrade", "a.png", *arguments, "7C")
    assert (code, "out/a.png was made with other options (water)" in err) == (2, True)
    assert content("out")["a.png"] == before


def test_an_old_picture_is_not_taken_for_that_of_a_new_record(made, monkeypatch):
    """Stopped between the two, when their sizes are alike."""
    save("b.npy", pixels())
    made("b.npy")
    row = Item("b.npy", Path("b.npy"), Path("z.npy"), Path("out/b.npy"))
    recipe = Recipe(water="7C")

    def stopped(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", _only_records(Path.replace, stopped))
        with pytest.raises(KeyboardInterrupt):
            Degrader(recipe, force=True)(row)
    assert sidecar_path(row.output).exists()
    assert Degrader(recipe, resume=True)(row).status == "done"


def _only_records(replace, stopped):
    def call(part, target):
        return replace(part, target) if str(target).endswith(".json") else stopped()

    return call
