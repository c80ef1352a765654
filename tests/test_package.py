import doctest
import importlib
import pkgutil
import re
import subprocess
import sys
import types
from importlib.util import find_spec
from pathlib import Path

import pytest

import uwaug

ROOT = Path(__file__).parent.parent
MODULES = sorted(
    {"uwaug"}
    | {
        m.name
        for m in pkgutil.walk_packages(uwaug.__path__, "uwaug.")
        if not m.name.endswith("__main__")
    }
)
HEAVY = (
    "colour", "cv2", "jerlov", "matplotlib", "onnx", "onnxruntime", "onnxscript", "pydantic", "rich", "scipy",
    "skimage", "torchvision", "typer",
)  # fmt: skip


def test_import_is_light() -> None:
    code = "import sys, torch, kornia; before = set(sys.modules); import uwaug; print(*sorted(set(sys.modules) - before))"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert "uwaug" in loaded
    assert {name.split(".")[0] for name in loaded}.isdisjoint(HEAVY)


def test_heavy_packages_are_heavy() -> None:
    # a misspelt name would never be found loaded
    assert [name for name in HEAVY if name != "torchvision" and find_spec(name) is None] == []


def test_import_is_silent() -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", "import uwaug"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout + done.stderr == ""


def test_all_is_sorted_and_complete() -> None:
    names = uwaug.__all__
    assert names == sorted(
        names, key=lambda n: (not n.isupper(), n[0].islower(), n)
    )  # as ruff sorts: constants, classes, the rest
    assert len(set(names)) == len(names)
    public = {
        n
        for n, value in vars(uwaug).items()
        if not n.startswith("_") and (not isinstance(value, types.ModuleType) or n in names)
    }
    assert set(names) == public


@pytest.mark.parametrize(
    "name",
    [
        "Water",
        "Medium",
        "PointSpread",
        "form_image",
        "Terms",
        "Underwater",
        "gaussian_random_field",
        "distance",
        "load_preset",
    ],
)
def test_names_that_others_rely_on(name: str) -> None:
    assert name in uwaug.__all__


def test_version_is_a_release() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+", uwaug.__version__)


def test_typed() -> None:
    assert (Path(uwaug.__file__).parent / "py.typed").exists()


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_there_are_examples_in_docstrings() -> None:
    finder = doctest.DocTestFinder()
    examples = {
        name: sum(len(t.examples) for t in finder.find(importlib.import_module(name)))
        for name in MODULES
    }
    assert sum(examples.values()) >= 20


def test_every_public_function_says_what_it_does() -> None:
    undocumented = [
        n
        for n in uwaug.__all__
        if callable(value := getattr(uwaug, n)) and not (value.__doc__ or "").strip()
    ]
    assert undocumented == []


def test_readme_blocks_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(
        r"^```python\n(.*?)^```",
        (ROOT / "README.md").read_text(encoding="utf-8"),
        re.DOTALL | re.MULTILINE,
    )
    assert blocks, "the README shows no Python"
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "readme"}
    for number, block in enumerate(blocks):
        exec(compile(block, f"README.md, block {number}", "exec"), names)
