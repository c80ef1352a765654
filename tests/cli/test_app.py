"""What all commands have in common: help, completion, exit codes, errors in flags."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from PIL import Image

import uwaug
from uwaug.cli import choices, distances
from uwaug.cli.app import EXAMPLES, app
from uwaug.cli.console import FLAGS, in_flags, status

COMMANDS = (
    "demo",
    "plot",
    "compare",
    "degrade",
    "fit",
    "waters",
    "preset",
    "export",
    "check",
    "warm-up",
)


def test_version(run):
    assert run("--version") == (0, f"uwaug {uwaug.__version__}\n", "")


def test_help_names_every_command(run):
    code, out, _ = run("--help")
    assert code == 0
    assert all(f"│ {command} " in out for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command(run, command):
    code, out, err = run(command, "-h")
    assert (code, err) == (0, "")
    assert f"uwaug {command}" in out


@pytest.mark.parametrize(
    "example", [*EXAMPLES.values(), "degrade a.jpg --distance 3 --random --out b"]
)
def test_examples_are_commands(run, example):
    """Each is taken as it stands, and stands in the help."""
    from typer.main import get_command

    name, *arguments = example.split()
    command = get_command(app).commands[name]
    given = command.make_context(name, [*arguments]).params
    assert arguments[-1] in map(str, given.values())
    if example in EXAMPLES.values():
        assert example in " ".join(run(name, "-h")[1].split())


def test_flags_of_degrade_are_grouped(run):
    out = run("degrade", "-h")[1]
    panels = re.findall(r"╭─ (\w+).* ─+╮", out)
    assert panels == [
        "Arguments",
        "Options",
        "Water",
        "Distances",
        "Drawn",
        "Camera",
        "Output",
        "Labels",
        "Run",
    ]
    for flag in ("--vertical-depth", "--ignore-index", "--replay", "--keep-terms", "--shards"):
        assert flag in out


def options_of(command: Any) -> set[str]:
    own = {flag for parameter in command.params for flag in parameter.opts}
    return own.union(*(options_of(inner) for inner in getattr(command, "commands", {}).values()))


def test_errors_name_flags_that_there_are():
    from typer.main import get_command

    assert set(FLAGS.values()) <= options_of(get_command(app))


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ("vertical_depth must be finite", "--vertical-depth must be finite"),
        ("water must be one of I, IA", "--water must be one of I, IA"),
        ("other options (seed=3, was 0)", "other options (--seed 3, was 0)"),
        ("near: what is near in water", "--near: what is near in water"),
        ("the light that is near in water", "the light that is near in water"),
        ("1 of 4 pixels: try unknown='fill'", "1 of 4 pixels: try --unknown fill"),
        ('far.npy: 3000 m: try unit="mm"', "far.npy: 3000 m: try --distance-unit mm"),
        (
            "visibility and contrast: got visibility = 3.0",
            "--visibility and --contrast: got --visibility 3.0",
        ),
        ("min_contrast and void would do", "--min-contrast and --ignore-index would do"),
        ("contrast=(0.2, 0.8) would do", "--contrast 0.2:0.8 would do"),
        (
            "contrast must be a number or a range (low, high) with low ≤ high, in [0.001, 1]",
            "--contrast must be a number or a range LOW:HIGH, in [0.001, 1]",
        ),
        ("distance is flat: contrast is low", "--distance is flat: contrast is low"),
        ("own.toml: near = 3 is key of a table", "own.toml: near = 3 is key of a table"),
        ("own.toml: color_space: expected srgb", "own.toml: color_space: expected srgb"),
    ],
)
def test_arguments_become_flags(message, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("own.toml").touch()
    Path("far.npy").touch()
    assert in_flags(message) == said


def words_of(command: str, flag: str) -> list[str]:
    """The words that a shell completes a flag with."""
    from click import Context
    from typer.main import get_command

    option = next(x for x in get_command(app).commands[command].params if flag in x.opts)
    context = Context(get_command(app))
    return [item.value for item in option.shell_complete(context, "")]


NO_DISPARITY = {"planar": False, "focal_px": None, "baseline": None, "offset_px": 0.0}
DISTANCE_FLAGS = {
    "--distance",
    "--distance-kind",
    "--distance-unit",
    "--unknown",
    "--planar",
    "--focal-px",
    "--baseline",
    "--offset-px",
}


@pytest.mark.parametrize("command", ["degrade", "plot", "compare", "fit"])
def test_distances_have_one_dialect(command):
    """The same flags in every command that reads distances, in one group of its help."""
    from typer.main import get_command

    options = get_command(app).commands[command].params
    named = {x.opts[0] for x in options if getattr(x, "rich_help_panel", "") == "Distances"}
    scaled = {"--near", "--far", "--gamma"} if command != "fit" else set()
    own = {"--depth-network"} if command == "degrade" else set()
    assert named == DISTANCE_FLAGS | scaled | own


def test_words_of_flags_are_the_librarys():
    from uwaug.fitting.models import MODELS, CameraGain, Correction, Gain
    from uwaug.formation.demand import SIDES
    from uwaug.io import UNITS
    from uwaug.io.distances import Kind
    from uwaug.io.write import FORMATS
    from uwaug.optics.surfaces import Surfaces

    assert uwaug.JERLOV_TYPES == choices.WATERS
    assert get_args(choices.FitModel) == ("auto", *MODELS)
    assert set(get_args(choices.Gain)) == {"auto", *get_args(Gain), *get_args(CameraGain)}
    assert get_args(choices.Correction) == get_args(Correction)
    assert get_args(choices.Surfaces) == get_args(Surfaces)
    assert {FORMATS[f".{name}"] for name in choices.PICTURE_FORMATS} == set(FORMATS.values())
    assert get_args(get_args(distances.Kind)[0]) == get_args(Kind)
    assert words_of("plot", "--distance-unit") == list(UNITS)
    assert words_of("plot", "--unknown") == ["error", "fill", "behind", "skip", "far"]
    for unit in words_of("degrade", "--distance-unit"):
        distances.format_of("metric", unit, "fill", **NO_DISPARITY)
    for unknown in words_of("degrade", "--unknown"):
        distances.format_of("metric", "m", unknown, **NO_DISPARITY)
    assert SIDES == choices.SIDES


@pytest.mark.parametrize("arguments", [["demi"], ["demo", "--size", "3"], ["waters", "II"]])
def test_wrong_use_is_exit_code_2_without_traceback(run, arguments):
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert "Error" in err
    assert "Traceback" not in err


@pytest.fixture
def files(tmp_path, monkeypatch) -> Path:
    """A picture with distances, and files that are broken, in the folder where commands run."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)).save("a.png")
    np.save("a.npy", np.linspace(1, 4, 600, dtype=np.float32).reshape(20, 30))
    np.save("b.npy", np.ones((20, 31), np.float32))
    np.save("mm.npy", np.full((20, 30), 2500, np.uint16))
    np.save("open.npy", np.full((20, 30), np.inf, np.float32))
    for name in ("bad.png", "bad.toml", "bad.json", "bad.onnx"):
        Path(name).write_text("no [file")
    for name in ("folder.toml", "folder.onnx"):
        Path(name).mkdir()
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


PLOT = "plot a.png --distance"
COMPARE = "compare a.png --distance"
DEGRADE = "degrade a.png --out x.png --distance"
FIT = "fit --out x.json --clean a.png --observed a.png --distance a.npy"


@pytest.mark.parametrize(
    ("code", "arguments", "message"),
    [
        # a file that is not there
        (1, f"{PLOT} no.npy", "No such file"),
        (1, f"{PLOT} a.npy --preset no.toml", "No such file"),
        (1, f"{COMPARE} no.npy --out x.png", "No such file"),
        (1, f"{COMPARE} a.npy --out x.png --system no.toml", "No such file"),
        (1, "degrade no.png --distance 3 --water II --out x.png", "No such file"),
        (1, f"{DEGRADE} 3 --preset no.toml", "No such file"),
        (1, f"{DEGRADE} 3 --fit no.json", "No such file"),
        (1, f"{DEGRADE} 3 --random --options no.toml", "No such file"),
        (1, "degrade --replay no.json --out x.png", "No such file"),
        (1, f"{FIT} --mask no.png", "No such file"),
        (1, "fit --series no.csv --out x.json", "No such file"),
        (1, "export --preset no.toml --out x.onnx", "No such file"),
        (1, "export --fit no.json --out x.onnx", "No such file"),
        (1, "check no.onnx", "No such file"),
        (1, "preset show no.toml", "No such file"),
        (1, f"{DEGRADE} no/ --water II", "Error: no/: No such file"),
        # a file that is not what it should be
        (1, "plot bad.png --distance a.npy", "bad.png"),
        (1, f"{PLOT} mm.npy", "try --distance-unit mm"),
        (1, f"{PLOT} b.npy", "b.npy: is 31×20 but the picture 30×20"),
        (1, f"{PLOT} open.npy", "some pixel above 0 m that is not open water"),
        (1, "compare bad.png --distance a.npy --out x.png", "bad.png"),
        (1, f"{COMPARE} a.npy --out x.png --system bad.toml", "bad.toml: not a TOML file"),
        (1, "degrade bad.png --distance 3 --water II --out x.png", "is no picture and no map"),
        (1, f"{DEGRADE} mm.npy --water II", "try --distance-unit mm"),
        (1, f"{DEGRADE} 3 --preset bad.toml", "bad.toml: not a TOML file"),
        (1, f"{DEGRADE} 3 --fit bad.json", "bad.json: not a fit"),
        (1, f"{DEGRADE} 3 --random --options bad.toml", "bad.toml: is no TOML"),
        (1, f"{FIT} --mask bad.png", "bad.png"),
        (1, "export --preset bad.toml --out x.onnx", "bad.toml: not a TOML file"),
        (1, "export --fit bad.json --out x.onnx", "bad.json: not a fit"),
        (1, "check bad.onnx", "bad.onnx: ONNX Runtime cannot load it"),
        (1, "check .", "is a folder"),
        (1, "preset show bad.toml", "bad.toml: not a TOML file"),
        # a place where nothing can be written
        (1, f"{COMPARE} a.npy --out no/x.png", "there is no folder no"),
        (1, "fit --out no/x.json --clean a.png --observed a.png --distance a.npy", "no folder no"),
        (1, "export --preset survey --out no/x.onnx", "there is no folder no"),
        (1, "export --preset survey --out folder.onnx --force", "is a folder"),
        (1, "preset copy survey no/x.toml", "there is no folder no"),
        (1, "preset copy survey folder.toml --force", "is a folder"),
        (1, "demo --out a.png", "cannot write to a.png: Not a directory"),
        # a name that is unknown, or has no use here
        (2, f"{PLOT} a.npy --water 10C", "--water must be one of I, IA"),
        (2, f"{PLOT} a.npy --preset no", "no preset is called 'no'"),
        (2, f"{PLOT} a.npy --preset tank-adjusted-1 --water II", "which no water or camera"),
        (2, f"{PLOT} a.npy --distance-unit ft", "--distance-unit must be"),
        (2, f"{PLOT} a.npy --unknown gone", "--unknown must be one of error, fill"),
        (2, f"{PLOT} a.npy --distance-kind relative", "--near is missing: relative distances"),
        (2, f"{PLOT} a.npy --near 1", "--near would do nothing: --distance-kind is 'metric'"),
        (2, f"{PLOT} 3 --planar --focal-px 9", "--planar would do nothing"),
        (2, f"{PLOT} 0", "--distance must be finite and > 0"),
        (2, "plot --distance 3", "expected a picture"),
        (2, f"{PLOT} 3 --image a.png", "--image is an older spelling"),
        (2, f"{COMPARE} a.npy --out x.png --water 10C", "--water must be one of I, IA"),
        (2, f"{COMPARE} a.npy --out x.png --unknown 0", "--unknown must be finite and > 0"),
        (2, f"{COMPARE} a.npy --out x.png --system nobody", "no preset is called 'nobody'"),
        (2, f"{COMPARE} a.npy --out x.png --system survey --system survey", "each once"),
        (
            2,
            f"{DEGRADE} 3 --random --water 3C",
            "expected one of --water, --preset, --fit and --ra",
        ),
        (2, f"{DEGRADE} 3 --fit f.json --random", "--random, got --fit and --random"),
        (2, f"{DEGRADE} 3 --water 10C", f"--water must be one of {', '.join(choices.WATERS)}"),
        (2, f"{DEGRADE} 3 --preset no", "no preset is called 'no'"),
        (2, f"{DEGRADE} 3 --preset hou-2020 --water II", "transmission, which no water replaces"),
        (2, f"{DEGRADE} 3 --random --severity 6", "--severity"),
        (2, f"{DEGRADE} 3 --random --vertical-depth x", "--vertical-depth"),
        (2, f"{DEGRADE} 3 --random --depth 1:2:3", "--vertical-depth"),
        (2, f"{DEGRADE} a.npy --water II --distance-unit miles", "--distance-unit must be"),
        (2, f"{DEGRADE} a.npy --water II --distance-kind far", "--distance-kind"),
        (2, f"{DEGRADE} 3 --water II --format bmp", ".png, .jpg"),
        (2, f"{DEGRADE} 3 --water II --variants 0", "--variants"),
        (2, f"{DEGRADE} 3 --water II --workers 0", "--workers"),
        (2, f"{DEGRADE} 3 --random --seed -1", "--seed"),
        (2, f"{DEGRADE} 3 --random --seed 1{'0' * 23}", "--seed"),
        (2, f"{DEGRADE} a.npy --water II --near 1", "--near would do nothing: --distance-kind is"),
        (2, f"{DEGRADE} 3 --preset hou-2020 --far 5", "--far would do nothing: --distance-kind is"),
        (2, f"{FIT} --model fog", "--model"),
        (2, f"{FIT} --seed -1", "--seed"),
        (2, f"{FIT} --focal-px 0", "--focal-px must be finite and > 0"),
        (2, f"{FIT} --model calibrated", "--focal-px: the calibrated width law needs"),
        (2, f"{FIT} --unknown fill", "--unknown fill: expected skip, far or metres"),
        (2, f"{FIT} --distance-kind relative", "--distance-kind"),
        (2, f"{FIT} --distance-kind disparity", "--focal-px is missing"),
        (2, f"{FIT} --distance-unit ft", "--distance-unit must be"),
        (2, "export --preset no --out x.onnx", "no preset is called 'no'"),
        (2, "export --preset survey --water 10C --out x.onnx", "10C"),
        (2, "export --preset survey --sides 64 32 --out x.onnx", "--sides must be whole numbers"),
        (2, "preset show no", "no preset is called 'no'; there are akkaynak-2018, calibrated"),
        (2, "preset copy bad.toml x.toml", "no preset is called 'bad.toml'"),
        # a file that would be lost, or has a wrong name
        (2, f"{PLOT} a.npy --out .", "holds other files, such as a.npy"),
        (2, f"{COMPARE} a.npy --out a.png --force", "a.png is read, and would be written over"),
        (2, f"{COMPARE} a.npy --out x.gif", "--out must end in .png or .jpg"),
        (2, f"{COMPARE} a.npy --out x.png --table x.txt", "--table must end in .csv or .json"),
        (2, f"{COMPARE} a.npy --out bad.png", "bad.png exists"),
        (2, f"{DEGRADE} 3 --water II --out bad.png", "bad.png exists"),
        (2, f"{FIT} --out bad.json", "bad.json exists"),
        (2, f"{FIT} --report a.png --force", "a.png is read"),
        (2, f"{FIT} --out x.png --report ./x.png", "--report and --out are one file"),
        (2, "export --preset survey --out bad.onnx", "bad.onnx exists"),
        (2, "export --preset survey --out 7C.txt", "--out must end in .onnx, got 7C.txt"),
        (2, "preset copy survey x.txt", "must end in .toml"),
        # what is like a number and is none, or has no use here
        (2, f"{DEGRADE} 3m --water II", "--distance: expected metres without a unit, such as 3"),
        (2, f"{PLOT} 3m", "--distance: expected metres without a unit, such as 3"),
        (2, f"{COMPARE} 2,5 --out x.png", "--distance: expected metres without a unit"),
        (2, f"{DEGRADE} 5:1 --water II", "--distance: expected a range, low first, got 5:1"),
        (2, f"{PLOT} 1:5", "--distance: 1:5 is a range: uwaug degrade draws from it"),
        (2, f"{COMPARE} 1:5 --out x.png", "--distance: 1:5 is a range"),
        (2, "fit --out x.json --clean a.png --observed a.png --distance 1:5", "1:5 is a range"),
        (2, f"{DEGRADE} 1:5 --preset hou-2020", "--distance 1.0:5.0 would do nothing"),
        (2, f"{DEGRADE} 1:5 --water II --distance-unit mm", "--distance-unit would do nothing"),
        (2, f"{DEGRADE} 3 --random --exposure bright", "expected auto, none, stops, or a range"),
        # flags that do not go together, or are missing
        (2, "degrade a.png --out x.png --water II", "--distance is missing: a.png has no"),
        (2, f"{DEGRADE} 3", "expected --water, --preset, --fit or --random, got none"),
        (2, "degrade --out x --distance 3 --water II", "expected a picture, a folder"),
        (2, "degrade a.png a.png --out x --distance 3 --water II", "a.png was given twice"),
        (2, f"{DEGRADE} 3 --water II --planar --focal-px 40", "--planar would do nothing"),
        (2, f"{DEGRADE} 3 --water II --distance-unit mm", "--distance-unit would do nothing"),
        (2, f"{DEGRADE} 3 --water II --distance-kind inverse", "--distance-kind would do nothing"),
        (2, f"{DEGRADE} a.npy --water II --planar", "--focal-px is missing"),
        (2, f"{DEGRADE} a.npy --water II --baseline .1", "--baseline would do nothing"),
        (2, f"{DEGRADE} 3 --water II --depth-network no.onnx", "takes the place of --distance"),
        (2, f"{DEGRADE} 3 --water II --ray a:1 --workers 2", "has its own"),
        (2, f"{DEGRADE} 3 --water II --shards s", "--shards in its place, got both"),
        (2, "degrade a.png a.png --replay r.json --out x", "all from the record"),
        (2, "degrade --water II --replay r.json --out x", "all from the record"),
        (2, f"{DEGRADE} 3 --random --contrast .3 --severity 2", "--severity and --contrast"),
        (2, "fit --clean a.png --out x.json", "a fit needs --clean, --observed and --distance"),
        (2, "fit --series s.csv --gain free --out x.json", "--series takes the place of pairs"),
        (2, f"{FIT} --clean a.png --clean a.png", "--clean: expected one or as many as observed"),
        (2, "export --out x.onnx", "expected --preset or --fit, got neither"),
        (2, "export --fit bad.json --preset survey --out x.onnx", "--preset or --fit, got both"),
        (2, "export --fit bad.json --water 7C --out x.onnx", "--water takes the place"),
    ],
)
def test_exit_codes(run, files, code, arguments, message):
    """1 for files, 2 for wrong use, in every command; and nothing is written."""
    before = contents(files)
    got, _, err = run(*arguments.split())
    assert got == code, err
    assert message in err
    assert "Traceback" not in err
    assert contents(files) == before


@pytest.mark.parametrize(
    ("package", "arguments", "extra"),
    [
        ("matplotlib", "demo", "plot"),
        ("matplotlib", f"{FIT} --report x.png", "plot"),
        ("phasecongruency", f"{COMPARE} a.npy --out x.png", "compare"),
        ("onnx", "export --preset survey --out x.onnx", "onnx"),
        ("ray.data", f"{DEGRADE} 3 --water II --ray local", "ray"),
    ],
)
def test_a_missing_package_is_named(run, files, monkeypatch, package, arguments, extra):
    monkeypatch.setitem(sys.modules, package, None)
    code, out, err = run(*arguments.split())
    assert (code, out) == (1, "")
    assert f'pip install ".[{extra}]" in a checkout of uwaug' in err


def module(folder: Path, *arguments: str, **options: Any) -> subprocess.CompletedProcess[bytes]:
    """Run `python -m uwaug` in a process of its own."""
    command = [sys.executable, "-m", "uwaug", *arguments]
    return subprocess.run(command, cwd=folder, stderr=subprocess.PIPE, check=False, **options)


def test_as_a_module_it_has_its_own_name(tmp_path):
    done = module(tmp_path, "demi")
    assert done.returncode == 2
    assert done.stderr.startswith(b"Usage: uwaug [OPTIONS]")


@pytest.mark.parametrize(
    ("words", "completions"),
    [
        ("uwaug pr", ["preset"]),
        ("uwaug preset ", ["list", "show", "copy"]),
        ("uwaug preset copy tank-adjusted-", [f"tank-adjusted-{i}" for i in range(1, 5)]),
        ("uwaug export --preset sur", ["survey"]),
        ("uwaug export --water I", ["I", "IA", "IB", "II", "III"]),
        ("uwaug plot --water 7", ["7C"]),
        ("uwaug fit --model au", ["auto"]),
        ("uwaug fit --gain ", ["auto", "fixed", "free", "channels", "matrix"]),
        ("uwaug fit --unknown ", ["skip", "far"]),
        ("uwaug degrade --distance-unit ", ["m", "cm", "mm", "um"]),
        ("uwaug compare --distance-unit c", ["cm"]),
        ("uwaug plot --distance-kind ", ["metric", "relative", "inverse", "disparity"]),
        ("uwaug degrade --unknown f", ["fill", "far"]),
        ("uwaug degrade --severity ", ["1", "2", "3", "4", "5"]),
        ("uwaug degrade --exposure ", ["auto", "none"]),
        ("uwaug degrade --format ", ["png", "jpg", "webp", "tif", "npy"]),
        ("uwaug degrade --surfaces ", ["grey", "spectral"]),
        ("uwaug degrade --ray ", ["local", "auto"]),
        ("uwaug export --parameters ", ["frozen", "inputs"]),
        ("uwaug plot --preset own.to", []),  # the shell goes on with files
    ],
)
def test_completions(run, monkeypatch, words, completions):
    monkeypatch.setenv("_UWAUG_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
    assert run()[1].split() == completions


def test_a_console_of_another_encoding(tmp_path):
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = module(tmp_path, "waters", env=environment, stdout=subprocess.PIPE)
    assert (done.returncode, done.stderr) == (0, b"")
    assert "Jerlov I" in done.stdout.decode("ascii")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device of Linux")
def test_a_console_that_takes_nothing(tmp_path):
    with open("/dev/full", "wb") as full:
        done = module(tmp_path, "preset", "list", stdout=full)
    assert done.returncode == 1
    assert done.stderr == b"Error: cannot write to the console: No space left on device\n"


def test_progress_is_said_on_a_terminal_alone(monkeypatch):
    from rich.console import Console

    steps = []
    monkeypatch.setattr("rich.status.Status.update", lambda _, step: steps.append(step))
    for terminal in (True, False):
        monkeypatch.setattr(Console, "is_terminal", property(lambda _, answer=terminal: answer))
        with status() as say:
            say("tracing")
        assert steps == ["tracing"]
