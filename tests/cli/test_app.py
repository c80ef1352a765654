import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exporting import stored_tensors

from uwaug import JERLOV_TYPES, Water, __version__, load_camera
from uwaug.cli import app as cli
from uwaug.figures import demo as plots

COMMANDS = ("demo", "plot", "degrade", "waters", "preset", "export", "check")


def test_version(run):
    assert run("--version") == (0, f"uwaug {__version__}\n", "")


def test_help_names_every_command(run):
    code, out, _ = run("--help")
    assert code == 0
    assert all(f"\n  {command} " in out for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command(run, command):
    code, out, err = run(command, "-h")
    assert (code, err) == (0, "")
    assert f"uwaug {command}" in out


@pytest.mark.parametrize("arguments", [["demi"], ["demo", "--size", "3"], ["waters", "II"]])
def test_wrong_use_is_exit_code_2_without_traceback(run, arguments):
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert err.strip().splitlines()[-1].startswith("Error: ")
    assert "Traceback" not in err


def test_waters(run):
    code, out, err = run("waters")
    assert (code, err) == (0, "")
    rows = {line.split()[1]: line for line in out.splitlines() if re.match(r"│ \w+ ", line)}
    assert list(rows) == list(JERLOV_TYPES)
    assert all(f" {Water.jerlov(t).visibility():.1f} " in row for t, row in rows.items())
    nm = np.arange(400, 701, 5)
    response = load_camera("Nikon 5100 (NPL)").at(nm)
    for type, row in rows.items():
        water = Water.jerlov(type)
        for spectrum in (water.a + water.b, water.kd):
            means = np.interp(nm, water.wavelengths, spectrum) @ response / response.sum(axis=0)
            assert "  ".join(f"{v:.3f}" for v in means) in row
    doubts = out[out.index("doubtful") :]
    assert "5C: a at 600–700 nm: Williamson & Hollins 2022 (misprinted" in doubts
    assert "Jerlov I: b at 300–700 nm: suspect" in doubts
    assert "9C" not in doubts


def test_demo_on_the_real_scene(run, tmp_path):
    out = tmp_path / "new" / "folder"
    code, stdout, stderr = run("demo", "--out", str(out))
    assert (code, stderr) == (0, "")
    assert sorted(path.name for path in out.iterdir()) == list(plots.PICTURES)
    lines = stdout.splitlines()
    timed = [line for line in lines if re.match(r".* \(\d+\.\d s\)$", line)]
    assert [line.split()[0] for line in timed] == [str(out / name) for name in plots.PICTURES]
    assert sum(line.startswith("    Medium(") for line in lines) == 10 + 1 + 2
    assert "g = 0.05, μ = 0.075" in stdout
    assert re.fullmatch(rf"5 pictures in {re.escape(str(out))}, \d+\.\d s", lines[-1])
    from PIL import Image

    for path in out.iterdir():
        with Image.open(path) as picture:
            assert picture.format == {".jpg": "JPEG", ".png": "PNG"}[path.suffix]
            assert picture.width == 1400
    assert sum(path.stat().st_size for path in out.iterdir()) < 1.2e6


def test_demo_draws_over_its_own_files_only(run, small, tmp_path):
    (tmp_path / "2-terms.jpg").write_text("old")
    # what a demo left that was killed
    (tmp_path / f".uwaug-{'0a' * 8}.part").write_text("half")
    assert run("demo", "--out", str(tmp_path))[0] == 0
    assert (tmp_path / "2-terms.jpg").stat().st_size > 1000
    (tmp_path / "thesis.tex").write_text("mine")
    code, out, err = run("demo", "--out", str(tmp_path))
    assert (code, out) == (2, "")
    assert err.startswith(f"Error: {tmp_path} holds other files, such as thesis.tex: ")
    assert err.count("\n") == 1
    assert run("demo", "--out", str(tmp_path), "--force")[0] == 0
    assert (tmp_path / "thesis.tex").read_text() == "mine"


def test_demo_cannot_write(run, small, tmp_path):
    path = tmp_path / "file"
    path.write_text("")
    code, out, err = run("demo", "--out", str(path))
    assert (code, out, err) == (1, "", f"Error: cannot write to {path}: Not a directory\n")


def test_demo_without_matplotlib(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    code, _, err = run("demo")
    assert code == 1
    assert err.endswith('pip install ".[plot]" in a checkout of uwaug\n')
    assert err.count("\n") == 1


def test_export_and_check(run, tmp_path):
    pytest.importorskip("onnxruntime")
    out = tmp_path / "7C.onnx"
    options = ("--preset", "survey", "--water", "7C", "--image", "uint8", "--sides", "32", "700")
    arguments = ("export", *options, "--out", str(out))
    code, stdout, stderr = run(*arguments)
    assert (code, stderr) == (0, "")
    said = rf"{re.escape(str(out))}  \(\d+ KiB\)\n    Medium\(7C: .*\n    \d blurs for σ "
    assert re.match(said, stdout)
    assert [path.name for path in tmp_path.iterdir()] == ["7C.onnx"]
    before = out.read_bytes()
    code, stdout, stderr = run(*arguments)
    assert (code, stdout) == (2, "")
    assert stderr == f"Error: {out} exists: choose another file, or --force to write over it\n"
    code, stdout, stderr = run(*arguments, "--field", "maybe", "--force")
    assert (code, stdout) == (2, "")
    assert stderr.startswith("Error: field must be one of none, input, got 'maybe'")
    assert out.read_bytes() == before

    code, stdout, stderr = run("check", str(out))
    assert (code, stderr) == (0, "")
    said = rf"{re.escape(str(out))}: 102 cases, largest difference [01] of 255 \(.*×.*×.*\)\n"
    assert re.fullmatch(said, stdout)
    from uwaug.onnx import read_module

    assert read_module(out).sides == (32, 700)
    import onnx

    model = onnx.load(out)
    wrong = next(tensor for tensor in stored_tensors(model) if tuple(tensor.dims) == (1, 3, 6))
    values = onnx.numpy_helper.to_array(wrong) * np.float32(1.05)
    wrong.CopyFrom(onnx.numpy_helper.from_array(values, wrong.name))
    onnx.save(model, out)
    code, stdout, stderr = run("check", str(out))
    assert (code, stdout) == (1, "")
    assert re.fullmatch(r"Error: .*differs from float64 eager by \d+ \(limit 1\) at .*\n", stderr)


@pytest.mark.parametrize(
    ("code", "arguments", "message"),
    [
        (2, "export --preset no --out a.onnx", "no preset is called 'no'"),
        (2, "export --preset survey --water 10C --out a.onnx", "10C"),
        (2, "export --preset survey --sides 64 32 --out a.onnx", "sides must be whole numbers"),
        (1, "export --preset no.toml --out a.onnx", "No such file"),
        (1, "export --preset tank-adjusted-1 --out missing/a.onnx", "there is no folder"),
        (1, "export --preset tank-adjusted-1 --out . --force", "is a folder"),
        (1, "check a.onnx", "No such file"),
        (1, "check b.onnx", "b.onnx: ONNX Runtime cannot load it"),
        (1, "check .", "is a folder"),
    ],
)
def test_wrong_export_and_check(run, tmp_path, monkeypatch, code, arguments, message):
    pytest.importorskip("onnxruntime")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "b.onnx").write_text("no model")
    got, stdout, stderr = run(*arguments.split())
    assert (got, stdout) == (code, "")
    assert stderr.startswith("Error: ")
    assert message in stderr
    assert stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["b.onnx"]


def test_export_without_the_extra(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    code, _, stderr = run("export", "--preset", "survey", "--out", str(tmp_path / "a.onnx"))
    cure = 'pip install ".[onnx]" in a checkout of uwaug'
    assert (code, stderr) == (1, f"Error: onnx is missing: ONNX needs {cure}\n")


def module(folder: Path, *arguments: str, **options: Any) -> subprocess.CompletedProcess[bytes]:
    """Run `python -m uwaug` in a process of its own."""
    command = [sys.executable, "-m", "uwaug", *arguments]
    return subprocess.run(command, cwd=folder, stderr=subprocess.PIPE, check=False, **options)


def test_as_a_module_it_has_its_own_name(tmp_path):
    done = module(tmp_path, "--version", stdout=subprocess.PIPE)
    assert (done.returncode, done.stdout.decode()) == (0, f"uwaug {__version__}\n")
    done = module(tmp_path, "demi")
    assert done.returncode == 2
    assert done.stderr.startswith(b"Usage: uwaug [OPTIONS]")


def test_a_shell_asks_for_completions(tmp_path):
    asked = {"_UWAUG_COMPLETE": "complete_bash", "COMP_WORDS": "uwaug plot --water 7"}
    environment = {**os.environ, **asked, "COMP_CWORD": "3"}
    done = module(tmp_path, env=environment, stdout=subprocess.PIPE)
    assert (done.stdout, done.stderr) == (b"7C\n", b"")


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ("uwaug pr", ["preset"]),
        ("uwaug preset ", ["list", "show", "copy"]),
        ("uwaug preset copy tank-adjusted-", [f"tank-adjusted-{i}" for i in range(1, 5)]),
        ("uwaug preset show sur", ["survey"]),
        ("uwaug export --preset sur", ["survey"]),
        ("uwaug export --water I", ["I", "IA", "IB", "II", "III"]),
        ("uwaug plot --preset cal", ["calibrated"]),
        ("uwaug plot --preset own.to", []),  # the shell goes on with files
    ],
)
def test_completions(run, monkeypatch, words, wanted):
    monkeypatch.setenv("_UWAUG_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
    assert run()[1].split() == wanted


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_a_console_of_another_encoding(encoding, tmp_path):
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    done = module(tmp_path, "waters", env=environment, stdout=subprocess.PIPE)
    assert (done.returncode, done.stderr) == (0, b"")
    assert "Jerlov I" in done.stdout.decode(encoding)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device of Linux")
def test_a_console_that_takes_nothing(tmp_path):
    with open("/dev/full", "wb") as full:
        done = module(tmp_path, "preset", "list", stdout=full)
    assert done.returncode == 1
    assert done.stderr == b"Error: cannot write to the console: No space left on device\n"


def test_progress_is_said_on_a_terminal_alone(monkeypatch):
    from rich.console import Console

    seen = []
    monkeypatch.setattr(Console, "is_terminal", property(lambda _: True))
    monkeypatch.setattr("rich.status.Status.update", lambda _, step: seen.append(step))
    with cli._said() as say:
        say("tracing")
    assert seen == ["tracing"]
    monkeypatch.setattr(Console, "is_terminal", property(lambda _: False))
    with cli._said() as say:
        say("checking")
    assert seen == ["tracing"]
