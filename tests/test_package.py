import doctest
import importlib
import pkgutil
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

import uwaug

ROOT = Path(__file__).parent.parent
FOUND = {module.name for module in pkgutil.walk_packages(uwaug.__path__, "uwaug.")}
GUIDES = [ROOT / "README.md", *sorted(ROOT.glob("[!.]*/**/*.md"))]
COPIED_FIRST = [ROOT / "README.md", ROOT / "uwaug" / "GUIDE.md"]
FEW_TYPES = ("3C", "5C")  # to fit each takes a second
MODULES = sorted({"uwaug"} | {name for name in FOUND if not name.endswith("__main__")})
HEAVY = {
    *("albumentations", "colour", "cv2", "deepinv", "jerlov", "kornia", "matplotlib", "onnx"),
    *("onnxruntime", "onnxscript", "rich", "scipy", "skimage", "torchvision", "typer"),
}


IMPORTS = """
import io, os, sys, time
from contextlib import redirect_stdout, suppress

def loaded():
    return {name.partition(".")[0] for name in sys.modules}

if os.fork() == 0:
    from uwaug.cli.app import main

    os.environ |= {"COMP_WORDS": "uwaug plot --preset s", "COMP_CWORD": "3"}
    for line in ("--help", "--version", "degrade --help", "preset show --help", ""):
        sys.argv = ["uwaug", *line.split()]
        os.environ["_UWAUG_COMPLETE"] = "" if line else "complete_bash"
        with redirect_stdout(io.StringIO()) as out, suppress(SystemExit):
            main()
    assert out.getvalue().split() == ["survey"], out.getvalue()
    print(*sorted(loaded()))
    sys.exit()
os.wait()
import torch
before, start = loaded(), time.process_time()
import uwaug
print(time.process_time() - start)
print(*sorted(loaded() - before))
uwaug.RandomUnderwater, uwaug.fit, uwaug.load_preset, uwaug.onnx.export_onnx
uwaug.Medium.from_water("3C")  # for which nobody waits for a compiler
print(*sorted(loaded() - before))
"""


def test_imports() -> None:
    # whatever is warned of is an error
    command = [sys.executable, "-W", "error", "-c", IMPORTS]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    command_line, seconds, face, rooms = (line.split() for line in done.stdout.splitlines())
    # typer needs rich
    assert not ({"torch", "numpy"} | HEAVY - {"typer", "rich"}) & set(command_line)
    assert float(seconds[0]) < 0.1
    assert "uwaug" in face
    assert not HEAVY & set(face)
    assert not ({"numba"} | HEAVY - {"jerlov", "skimage"}) & set(rooms)
    # a misspelt name would never be found loaded
    assert all(find_spec(name) for name in HEAVY)


def test_the_face_shows_what_its_stub_names() -> None:
    stub = (Path(uwaug.__file__).parent / "__init__.pyi").read_text()
    assert sorted(uwaug.__all__) == sorted(re.findall(r"import \w+ as (\w+)", stub))
    assert all(getattr(uwaug, name).__doc__ for name in uwaug.__all__)


def test_a_release_is_typed_and_cited() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+", uwaug.__version__)
    citation = yaml.safe_load((ROOT / "uwaug" / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == uwaug.__version__
    assert (Path(uwaug.__file__).parent / "py.typed").exists()


def test_an_index_shows_no_link_to_a_file_that_it_does_not_have() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for rule in project["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(rule["pattern"], rule["replacement"], text)
    targets = re.findall(r"\]\(([^)]*)\)", text)
    assert "https://arxiv.org/abs/2509.15011" in targets
    assert [target for target in targets if not target.startswith(("https://", "#"))] == []


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, torchvision: Any
) -> None:
    monkeypatch.chdir(tmp_path)  # and deepinv imports torchvision
    monkeypatch.setattr("uwaug.fitting.jerlov.JERLOV_TYPES", FEW_TYPES)
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def blocks_of(guide: Path, folder: Path) -> Iterator[tuple[str, Path]]:
    """Each Python block of a guide, with an empty folder for it."""
    text = guide.read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    for number, block in enumerate(blocks):
        own = folder / str(number)
        own.mkdir()
        yield block, own


IN_NEW_PROCESSES = f"""
import os, sys
import torch
from uwaug.fitting import jerlov

jerlov.JERLOV_TYPES = {FEW_TYPES}
for folder in sys.argv[1:]:
    if os.fork() == 0:
        os.chdir(folder)
        exec(open("block.py", encoding="utf-8").read(), {{"__name__": "__main__"}})
        sys.exit()
    if os.wait()[1]:
        sys.exit(folder + "/block.py failed")
"""


def test_blocks_that_are_copied_first_run_each_in_a_new_process(tmp_path: Path) -> None:
    folders = []
    for guide in COPIED_FIRST:
        (tmp_path / guide.name).mkdir()
        for block, folder in blocks_of(guide, tmp_path / guide.name):
            (folder / "block.py").write_text(block, encoding="utf-8")
            folders.append(str(folder))
    assert len(folders) == 6
    command = [sys.executable, "-c", IN_NEW_PROCESSES, *folders]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "guide",
    [guide for guide in GUIDES if guide not in COPIED_FIRST],
    ids=lambda path: str(path.relative_to(ROOT)),
)
def test_each_block_of_a_guide_runs_alone(
    guide: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from uwaug.onnx import export_onnx

    def exported(module: uwaug.Underwater, path: str) -> Path:
        module.tolerance = 0.1  # few blurs, as to export each takes a second
        module._plan_anew()
        return export_onnx(module, path)

    monkeypatch.setattr(uwaug.onnx, "export_onnx", exported)
    monkeypatch.setattr("uwaug.fitting.jerlov.JERLOV_TYPES", FEW_TYPES)
    for block, folder in blocks_of(guide, tmp_path):
        monkeypatch.chdir(folder)
        torch.manual_seed(0)  # as many draw their pictures
        exec(compile(block, str(guide.relative_to(ROOT)), "exec"), {"__name__": "readme"})


def test_links_between_guides_lead_somewhere() -> None:
    for guide in GUIDES:
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", guide.read_text(encoding="utf-8")):
            assert "://" in link or (guide.parent / link).exists(), f"{guide}: {link}"
