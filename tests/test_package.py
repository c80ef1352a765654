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
FOUND = {module.name for module in pkgutil.walk_packages(uwaug.__path__, "uwaug.")}
MODULES = sorted({"uwaug"} | {name for name in FOUND if not name.endswith("__main__")})
HEAVY = (
    "albumentations",
    "colour",
    "cv2",
    "datasets",
    "jerlov",
    "matplotlib",
    "onnx",
    "onnxruntime",
    "onnxscript",
    "phasecongruency",
    "pydantic",
    "rich",
    "scipy",
    "skimage",
    "torchvision",
    "typer",
    "webdataset",
)


def output(*arguments: str) -> str:
    """What Python writes to stdout and stderr in a process of its own."""
    command = [sys.executable, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout + done.stderr


def test_import_is_light() -> None:
    code = "import sys, torch, kornia; before = set(sys.modules); import uwaug\n"
    code += "print(*sorted(set(sys.modules) - before))"
    loaded = output("-c", code).split()
    assert "uwaug" in loaded
    assert {name.split(".")[0] for name in loaded}.isdisjoint(HEAVY)


def test_heavy_packages_are_heavy() -> None:
    # a misspelt name would never be found loaded
    assert [name for name in HEAVY if find_spec(name) is None] == []


def test_import_is_silent() -> None:
    assert output("-W", "error", "-c", "import uwaug") == ""


def test_the_package_imports_neither_the_command_line_nor_what_it_needs():
    code = "import sys, uwaug.presets\n"
    code += "print(*{'typer', 'rich', 'pydantic', 'matplotlib', 'skimage'} & set(sys.modules))"
    assert output("-c", code) == "\n"


def test_all_is_sorted_and_complete() -> None:
    names = uwaug.__all__
    # as ruff sorts: constants, classes, the rest
    assert names == sorted(names, key=lambda n: (not n.isupper(), n[0].islower(), n))
    assert len(set(names)) == len(names)
    public = set()
    for name, value in vars(uwaug).items():
        module = isinstance(value, types.ModuleType)
        if not name.startswith("_") and (not module or name in names):
            public.add(name)
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
    finder, count = doctest.DocTestFinder(), 0
    for name in MODULES:
        for found in finder.find(importlib.import_module(name)):
            count += len(found.examples)
    assert count >= 20


def test_every_public_function_says_what_it_does() -> None:
    functions = [n for n in uwaug.__all__ if callable(getattr(uwaug, n))]
    assert [n for n in functions if not (getattr(uwaug, n).__doc__ or "").strip()] == []


def test_readme_blocks_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert blocks, "the README shows no Python"
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "readme"}
    for number, block in enumerate(blocks):
        exec(compile(block, f"README.md, block {number}", "exec"), names)
