"""`uwaug fit`."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import uwaug
from uwaug.io import read_distance, read_picture

PAIR = ["--clean", "clean.png", "--observed", "observed.png", "--distance", "z.png"]
FAST = ["--distance-unit", "mm", "--model", "haze"]


def save(path: str, image: torch.Tensor) -> None:
    pixels = (image * 255).round().to(torch.uint8).permute(1, 2, 0)
    Image.fromarray(pixels.numpy()).save(path)


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """A scene, as it is in a water at two distances, in files of the working folder."""
    monkeypatch.chdir(tmp_path)
    rng = torch.Generator().manual_seed(0)
    clean = 0.1 + 0.8 * torch.rand(3, 60, 80, generator=rng)
    save("clean.png", clean)
    water = uwaug.Medium.from_coefficients((0.5, 0.2, 0.3), (0.5, 0.2, 0.3), (0.1, 0.3, 0.4))
    for suffix, far in (("", 6), ("-2", 9)):
        z = torch.linspace(1, far, 4800).reshape(1, 60, 80)
        noise = 0.01 * torch.randn(clean.shape, generator=rng)
        save(f"observed{suffix}.png", (uwaug.Underwater(water)(clean, z) + noise).clamp(0, 1))
        millimetres = (z[0] * 1000).round().numpy().astype(np.uint16)
        Image.fromarray(millimetres).save(f"z{suffix}.png")
    return tmp_path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_fit(run, scene):
    before = names(scene)
    code, out, err = run("fit", *PAIR, *FAST, "--out", "fit.json", "--report", "fit.png")
    assert (code, err) == (0, "")
    expected = uwaug.fit(
        read_picture("clean.png"),
        read_picture("observed.png"),
        read_distance("z.png", "mm"),
        model="haze",
    )
    summary, files = out.rsplit("\n\n", 1)
    assert summary == expected.summary()
    assert [line.split()[0] for line in files.splitlines()] == ["fit.json", "fit.png"]
    found = uwaug.fitting.Fit.load("fit.json")
    assert found.parameters == expected.parameters
    assert found.parameters["beta_red"].value == pytest.approx(0.5, rel=0.05)
    with Image.open("fit.png") as picture:
        assert (picture.format, picture.width) == ("PNG", 1400)
    assert names(scene) == sorted([*before, "fit.json", "fit.png"])


def test_force(run, scene):
    Path("fit.json").write_text("old")
    Path("fit.jpg").write_text("old")
    report = ["--report", "fit.jpg", "--force"]
    assert run("fit", *PAIR, *FAST, "--out", "fit.json", *report)[0] == 0
    assert uwaug.fitting.Fit.load("fit.json").model == "haze"
    with Image.open("fit.jpg") as picture:
        assert picture.format == "JPEG"


def test_options_arrive(run, scene, monkeypatch):
    mask = np.zeros((60, 80), dtype=np.uint8)
    mask[:, :60] = 255
    Image.fromarray(mask).save("mask.png")
    seen = {}

    class Found:
        def summary(self) -> str:
            return 'found; give gain="channels", or focal_px=…; vertical_depth'

        def save(self, path: Path) -> None:
            path.write_text("{}")

    def fit(**options: object) -> Found:
        seen.update(options)
        return Found()

    monkeypatch.setattr(uwaug, "fit", fit)
    two = ["--observed", "observed-2.png", "--distance", "z-2.png", "--mask", "mask.png"]
    options = ["--gain", "free", "--color-space", "linear", "--focal-px", "70", "--seed", "3"]
    options += ["--shading", "fixed", "--tone", "free"]
    code, out, err = run("fit", *PAIR, *two, *FAST, *options, "--out", "fit.json")
    assert (code, out, err) == (
        0,
        "found; give --gain channels, or --focal-px …; vertical_depth\n\nfit.json  (0 KiB)\n",
        "",
    )
    assert {name: len(seen[name]) for name in ("clean", "observed", "distance", "mask")} == {
        "clean": 1,
        "observed": 2,
        "distance": 2,
        "mask": 1,
    }
    assert float(seen["distance"][1].max()) == pytest.approx(9, abs=1e-3)
    assert int(seen["mask"][0].sum()) == 60 * 60
    assert (seen["model"], seen["gain"], seen["color_space"]) == ("haze", "free", "linear")
    assert (seen["focal_px"], seen["seed"]) == (70.0, 3)
    assert (seen["shading"], seen["tone"]) == ("fixed", "free")


@pytest.mark.parametrize(
    ("distance", "flags", "expected"),
    [
        ("z.png", ("--distance-unit", "0.001"), lambda z: z),
        (
            "z.png",
            ("--distance-unit", "mm", "--planar", "--focal-px", "70"),
            lambda z: uwaug.distance.along_ray(z, 70.0),
        ),
        ("holes.npy", (), lambda z: torch.where(z > 2, z, 0.0)),
        ("holes.npy", ("--unknown", "far"), lambda z: torch.where(z > 2, z, torch.inf)),
        ("3", (), lambda z: torch.full_like(z, 3.0)),
        (
            "z.png",
            ("--distance-kind", "disparity", "--focal-px", "70", "--baseline", "0.1"),
            lambda z: uwaug.distance.along_ray(
                uwaug.distance.from_disparity(1000 * z, 70.0, 0.1), 70.0
            ),
        ),
    ],
)
def test_distances_as_degrade_reads_them(run, scene, monkeypatch, distance, flags, expected):
    z = read_distance("z.png", "mm")
    np.save("holes.npy", torch.where(z > 2, z, 0.0)[0].numpy())
    seen = {}

    def fit(**options: object) -> None:
        seen.update(options)
        raise ValueError("seen enough")

    monkeypatch.setattr(uwaug, "fit", fit)
    pair = ["--clean", "clean.png", "--observed", "observed.png", "--distance", distance]
    assert "seen enough" in run("fit", *pair, *flags, "--out", "fit.json")[2]
    (given,) = seen["distance"]
    torch.testing.assert_close(given, expected(z), rtol=1e-4, atol=1e-4)


def test_a_plane_tells_too_little(run, scene):
    pair = ["--clean", "clean.png", "--observed", "observed.png", "--distance", "3"]
    code, _, err = run("fit", *pair, "--out", "fit.json")
    assert code == 2
    assert "Traceback" not in err
    assert "distance" in err


def test_a_map_of_another_size_is_resampled_and_said_so(run, scene):
    Image.open("z.png").resize((40, 30), Image.Resampling.NEAREST).save("half.png")
    pair = ["--clean", "clean.png", "--observed", "observed.png", "--distance", "half.png"]
    code, out, _ = run("fit", *pair, *FAST, "--out", "fit.json")
    assert code == 0
    assert "Note: half.png: distances of 40×30 px, resampled to 80×60" in out


def test_what_jpeg_does_is_said(run, scene):
    assert "JPEG" not in run("fit", *PAIR, *FAST, "--out", "fit.json")[1]
    Image.open("observed.png").save("observed.JPG", quality=95)
    lossy = [word.replace("observed.png", "observed.JPG") for word in PAIR]
    code, out, _ = run("fit", *lossy, *FAST, "--out", "lossy.json")
    assert code == 0
    assert "Note: observed.JPG: JPEG blurs colours" in out


@pytest.fixture
def table(scene):
    """The scene in two turbidities of one water, as a CSV in a folder of its own lists them."""
    Path("tank").mkdir()
    rows = ["\ufeffclean, observed, distance, turbidity, note"]
    clean = read_picture("clean.png")[:, ::2, ::2] / 255
    z = read_distance("z.png", "mm")[:, ::2, ::2]
    save("tank/clean.png", clean)
    np.save("tank/z.npy", z[0].numpy())
    for turbidity in (1.0, 2.0):
        b = torch.tensor([0.1, 0.1, 0.1]) * turbidity
        G = torch.tensor([0.25, 0.05, 0.1]) + 0.5 * b
        water = uwaug.Medium.from_coefficients(G, G, 0.2 * b / G)
        name = f"seen-{turbidity:g}.png"
        save(f"tank/{name}", uwaug.Underwater(water)(clean, z))
        rows.append(f"clean.png, {name}, z.npy, {turbidity:g}, sunny")
    path = Path("tank/series.csv")
    path.write_text("\n".join(rows), encoding="utf-8")
    return path


def test_series_of_planar_depth(run, table, monkeypatch):
    rows = {}

    def fit_series(pairs: list, turbidity: list, **options: object) -> None:
        rows[tuple(turbidity)] = pairs
        raise ValueError("seen enough")

    monkeypatch.setattr(uwaug.fitting, "fit_series", fit_series)
    flags = ("--planar", "--focal-px", "35", "--distance-unit", "cm")
    assert "seen enough" in run("fit", "--series", str(table), *flags, "--out", "f.json")[2]
    z = torch.from_numpy(np.load("tank/z.npy"))[None] / 100
    for _, _, distance in rows[1.0, 2.0]:
        torch.testing.assert_close(distance, uwaug.distance.along_ray(z, 35.0))
    code, _, err = run("fit", "--series", str(table), "--focal-px", "35", "--out", "f.json")
    assert (code, "--focal-px beside it" in err) == (2, True)


def test_series(run, table):
    options = ["--model", "veil", "--report", "fit.png"]
    code, out, err = run("fit", "--series", str(table), *options, "--out", "fit.json")
    assert (code, err) == (0, "")
    found = uwaug.fitting.SeriesFit.load("fit.json")
    assert found.levels == (1.0, 2.0)
    summary, files = out.rsplit("\n\n", 1)
    assert summary == found.summary()
    assert [line.split()[0] for line in files.splitlines()] == ["fit.json", "fit.png"]
    with Image.open("fit.png") as picture:
        assert picture.format == "PNG"


HEAD = "clean,observed,distance,turbidity\n"


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "expected the columns clean, observed, distance, turbidity, got none"),
        ("clean,observed,turbidity\n", "got clean, observed, turbidity"),
        (HEAD, "holds no pictures: expected a line for each"),
        (HEAD + "a,b,c,1\na,b,c\n", "line 3 has no turbidity"),
        (HEAD + "a,,c,1\n", "line 2 has no observed"),
        (HEAD + "a,b,c,clear\n", "turbidity must be a number, got 'clear' in line 2"),
        (HEAD + "a,b,c,1\n", "Error: a: No such file or directory"),
    ],
)
def test_wrong_series(run, scene, text, message):
    Path("a.csv").write_text(text)
    code, out, err = run("fit", "--series", "a.csv", "--out", "fit.json")
    assert (code, out) == (1, "")
    assert message in err
    assert err.count("\n") == 1
    assert not Path("fit.json").exists()


def test_a_report_that_cannot_be_written_leaves_the_fit(run, scene, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", "fit.png")

    monkeypatch.setattr("uwaug._support.drawing.save", full)
    code, out, err = run("fit", *PAIR, *FAST, "--out", "fit.json", "--report", "fit.png")
    assert (code, err) == (1, "Error: fit.png: No space left on device\n")
    assert out.startswith("Model 'haze'")
    assert uwaug.fitting.Fit.load("fit.json").model == "haze"


def test_waters(run, scene, monkeypatch):
    """What `uwaug degrade` has made of a file is named by `uwaug fit --waters`."""
    monkeypatch.setattr("uwaug.fitting.api._TYPES", (("1C",), ("7C",)))
    distance = ["--distance", "z.png", "--distance-unit", "mm"]
    made = ["--water", "7C", "--visibility", "4", "--depth", "2", "--out", "wet.png"]
    assert run("degrade", "clean.png", *distance, *made)[0] == 0
    pair = ["--clean", "clean.png", "--observed", "wet.png", *distance]
    code, out, err = run("fit", "--waters", *pair, "--out", "fit.json", "--report", "fit.png")
    assert (code, err) == (0, "")
    found = uwaug.fitting.WaterFit.load("fit.json")
    assert out.startswith(found.summary())
    assert found.type == "7C"
    assert found.visibility == pytest.approx(4, abs=3 * found.errors["visibility"])
    assert found.vertical_depth == pytest.approx(2, abs=3 * found.errors["vertical_depth"])
    known = ["--depth", "2", "--surfaces", "grey", "--gain", "fixed"]
    known += ["--camera", "Sigma SDMerill (NPL)"]
    assert run("fit", "--waters", *pair, *known, "--out", "other.json")[0] == 0
    other = uwaug.fitting.WaterFit.load("other.json")
    assert (other.fitted.surfaces, other.fitted.gain) == ("grey", "fixed")
    assert other.fitted.camera.name.startswith("Sigma")
    assert other.parameters["vertical_depth"].state == "fixed"
    code, coefficients, _ = run("fit", *pair, *FAST, "--out", "coefficients.json")
    assert (code, "Note: wet.png: uwaug made it" in coefficients) == (0, True)
    assert "uwaug made it" not in out


@pytest.mark.parametrize(
    "flags, message",
    [
        (["--waters", "--tone", "free"], "--shading and --tone are for coefficients"),
        (["--waters", "--model", "haze"], "--waters takes the place of --model"),
        (["--camera", "Nikon 5100 (NPL)"], "--camera.* for --waters"),
        (["--waters", "--gain", "channels"], "gain must be one of fixed, free, matrix"),
    ],
)
def test_flags_that_do_not_suit(run, scene, flags, message):
    code, _, err = run("fit", *PAIR, "--distance-unit", "mm", *flags, "--out", "fit.json")
    assert code != 0
    assert re.search(message, " ".join(err.split()))
