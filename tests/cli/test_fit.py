"""`uwaug fit`, and `uwaug export` of a fit."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import uwaug
from uwaug.cli.series import read_series
from uwaug.io.distances import read_distance
from uwaug.io.read import read_picture

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


def test_nothing_is_written_over_unasked(run, scene, monkeypatch):
    monkeypatch.setattr(uwaug, "fit", lambda *_, **__: pytest.fail("worked before it looked"))
    cure = "exists: choose another file, or --force to write over it"
    for name in ("fit.json", "fit.png"):
        Path(name).write_text("old")
        arguments = ["fit", *PAIR, *FAST, "--out", "fit.json", "--report", "fit.png"]
        assert run(*arguments) == (2, "", f"Error: {name} {cure}\n")
        assert Path(name).read_text() == "old"
        Path(name).unlink()


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
            return "found"

        def save(self, path: Path) -> None:
            path.write_text("{}")

    def fit(**options: object) -> Found:
        seen.update(options)
        return Found()

    monkeypatch.setattr(uwaug, "fit", fit)
    two = ["--observed", "observed-2.png", "--distance", "z-2.png", "--mask", "mask.png"]
    options = ["--gain", "free", "--color-space", "linear", "--focal-px", "70", "--seed", "3"]
    code, out, err = run("fit", *PAIR, *two, *FAST, *options, "--out", "fit.json")
    assert (code, out, err) == (0, "found\n\nfit.json  (0 KiB)\n", "")
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


def test_what_jpeg_does_is_said(run, scene):
    assert "JPEG" not in run("fit", *PAIR, *FAST, "--out", "fit.json")[1]
    Image.open("observed.png").save("observed.JPG", quality=95)
    lossy = [word.replace("observed.png", "observed.JPG") for word in PAIR]
    code, out, _ = run("fit", *lossy, *FAST, "--out", "lossy.json")
    assert code == 0
    assert "Note: observed.JPG: JPEG blurs colours" in out


def test_one_clean_picture_serves_two(run, scene):
    two = ["--observed", "observed-2.png", "--distance", "z-2.png"]
    code, out, err = run("fit", *PAIR, *two, *FAST, "--gain", "free", "--out", "fit.json")
    assert (code, err) == (0, "")
    assert "gain_2 " in out
    written = json.loads(Path("fit.json").read_text())
    assert written["structure"]["geometry"]["pairs"] == 2


@pytest.mark.parametrize(
    "code, arguments, message",
    [
        (2, PAIR[:4], "--distance is missing: a fit needs"),
        (2, [*PAIR, *PAIR, *PAIR[:2]], "got 3 of --clean, 2 of --observed, 2 of --distance"),
        (2, [*PAIR, *PAIR, *PAIR, "--mask", "a", "--mask", "b"], "3 of --distance, 2 of --mask"),
        (2, [*PAIR, "--model", "fog"], "--model must be one of auto, attenuation, haze"),
        (2, [*PAIR, "--model", "calibrated"], "needs --focal-px"),
        (2, [*PAIR, "--gain", "auto"], "--gain must be one of fixed, free, channels"),
        (2, [*PAIR, "--color-space", "rgb"], "--color-space must be one of srgb, linear"),
        (2, [*PAIR, "--distance-unit", "ft"], "--distance-unit must be one of m, cm, mm, um"),
        (2, [*PAIR, "--focal-px", "0"], "--focal-px must be finite and > 0 px"),
        (2, [*PAIR, "--seed", "-1"], "--seed must be finite and ≥ 0"),
        (2, [*PAIR, "--report", "fit.pdf"], "--report must end in .png or .jpg, got fit.pdf"),
        (2, [*PAIR, "--out", "a.png", "--report", "./a.png"], "--report and --out are one file"),
        (1, [*PAIR, "--report", "no/fit.png"], "there is no folder no"),
        (1, [*PAIR, "--out", "no/fit.json"], "there is no folder no"),
        (1, [*PAIR, "--out", ".", "--force"], "is a folder"),
        (1, [*PAIR], "z.png: its median is 3500 m if it is in m"),
        (1, [*PAIR], "try --distance-unit mm"),
        (1, [*PAIR, *FAST, "--mask", "clean.png"], "clean.png: expected a mask in one channel"),
        (1, [*PAIR[:-1], "no.png"], "No such file or directory: 'no.png'"),
        (1, [*PAIR[:3], "clean.png", *PAIR[4:], *FAST], "are the same picture"),
        (1, [*PAIR[:-1], "flat.npy", *FAST[2:]], "distance is flat"),
        (1, [*PAIR[:-1], "small.npy", *FAST[2:]], "they must be aligned"),
    ],
)
def test_wrong_fits(run, scene, code, arguments, message):
    np.save("flat.npy", np.full((60, 80), 2.0))
    np.save("small.npy", np.full((6, 8), 2.0))
    before = names(scene)
    if "--out" not in arguments:
        arguments = [*arguments, "--out", "fit.json"]
    got, out, err = run("fit", *arguments)
    assert (got, out) == (code, "")
    assert err.startswith("Error: ")
    assert message in err
    assert err.count("\n") == 1
    assert names(scene) == before


def test_without_an_output(run, scene):
    code, out, err = run("fit", *PAIR)
    assert (code, out) == (2, "")
    assert "Missing option '--out'" in err


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


def test_files_of_a_series(table):
    files, turbidity = read_series(table)
    assert turbidity == [1.0, 2.0]
    assert files == {
        "clean": [Path("tank/clean.png")] * 2,
        "observed": [Path("tank/seen-1.png"), Path("tank/seen-2.png")],
        "distance": [Path("tank/z.npy")] * 2,
    }


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
        (HEAD + "a,b,c,1\n", "No such file or directory: 'a'"),
    ],
)
def test_wrong_series(run, scene, text, message):
    Path("a.csv").write_text(text)
    code, out, err = run("fit", "--series", "a.csv", "--out", "fit.json")
    assert (code, out) == (1, "")
    assert message in err
    assert err.count("\n") == 1
    assert not Path("fit.json").exists()


@pytest.mark.parametrize("beside", [PAIR, ["--gain", "free"], ["--focal-px", "70"]])
def test_a_series_stands_alone(run, scene, beside):
    code, out, err = run("fit", "--series", "a.csv", *beside, "--out", "fit.json")
    assert (code, out) == (2, "")
    assert err.startswith("Error: --series takes the place of pairs of one water: expected no ")


def test_a_report_without_matplotlib(run, scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    code, out, err = run("fit", *PAIR, *FAST, "--out", "fit.json", "--report", "fit.png")
    cure = 'not installed: pip install ".[plot]" in a checkout of uwaug'
    assert (code, out) == (1, "")
    assert err == f"Error: a report is drawn with matplotlib, which is {cure}\n"
    assert not Path("fit.json").exists()


def test_a_report_that_cannot_be_written_leaves_the_fit(run, scene, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", "fit.png")

    monkeypatch.setattr("uwaug._support.sheet.save", full)
    code, out, err = run("fit", *PAIR, *FAST, "--out", "fit.json", "--report", "fit.png")
    assert (code, err) == (1, "Error: [Errno 28] No space left on device: 'fit.png'\n")
    assert out.startswith("Model 'haze'")
    assert uwaug.fitting.Fit.load("fit.json").model == "haze"


def test_progress_is_said(run, scene, monkeypatch):
    from rich.console import Console

    said = []
    monkeypatch.setattr(Console, "is_terminal", property(lambda _: True))
    monkeypatch.setattr("rich.status.Status.update", lambda _, step: said.append(step))
    assert run("fit", *PAIR, *FAST, "--out", "fit.json")[0] == 0
    assert said[0] == "reading the pictures"
    assert "fitting 'haze', 1 of 1" in said


def test_help(run):
    code, out, err = run("fit", "-h")
    assert (code, err) == (0, "")
    assert "uwaug fit" in out
    assert all(f"--{name} " in out for name in ("clean", "observed", "distance", "out", "report"))
    assert "\n  fit " in run("-h")[1]


def test_export_of_a_fit(run, scene):
    pytest.importorskip("onnxruntime")
    assert run("fit", *PAIR, *FAST, "--out", "fit.json")[0] == 0
    code, out, err = run("export", "--fit", "fit.json", "--out", "a.onnx", "--sides", "32", "200")
    assert (code, err) == (0, "")
    assert out.startswith("a.onnx  (")
    from uwaug.onnx import OnnxUnderwater, read_module

    found = uwaug.fitting.Fit.load("fit.json")
    module = read_module("a.onnx")
    # of distances spread over 1…6 m: .2 × the median, 1.5 × the farthest
    assert module.distance_range == pytest.approx((0.7, 1.5 * 5.75), rel=0.02)
    torch.testing.assert_close(module.medium.beta, found.medium.beta.float(), check_dtype=False)
    clean, z = read_picture("clean.png") / 255, read_distance("z.png", "mm")
    wanted = uwaug.Underwater(found.medium)(clean, z)
    seen = OnnxUnderwater("a.onnx")(clean[None], z[None])
    np.testing.assert_allclose(np.asarray(seen)[0], wanted.numpy(), atol=1e-4)


@pytest.mark.parametrize(
    "code, arguments, message",
    [
        (2, "", "expected --preset or --fit, got neither"),
        (2, "--fit fit.json --preset survey", "expected --preset or --fit, got both"),
        (2, "--fit fit.json --water 7C", "--water takes the place of a preset's"),
        (2, "--fit fit.json --sides 64 32", "sides must be whole numbers"),
        (1, "--fit no.json", "No such file"),
        (1, "--fit fit.json", "fit.json: not a fit"),
    ],
)
def test_wrong_exports(run, tmp_path, monkeypatch, code, arguments, message):
    monkeypatch.chdir(tmp_path)
    Path("fit.json").write_text("{}")
    got, out, err = run("export", *arguments.split(), "--out", "a.onnx")
    assert (got, out) == (code, "")
    assert err.startswith("Error: ")
    assert message in err
    assert err.count("\n") == 1
    assert names(tmp_path) == ["fit.json"]
