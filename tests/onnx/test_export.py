import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from exporting import FAR, NEAR, apart, scene

from uwaug import Medium, PointSpread, Underwater
from uwaug.onnx import OnnxUnderwater, export, export_onnx, export_program, parameters_of
from uwaug.onnx.graph import Graph

# by its version: without the package, "onnx" would be the folder of these tests
onnx = pytest.importorskip("onnx", minversion="1.17")
pytest.importorskip("onnxruntime")


@pytest.fixture(scope="module")
def clear() -> Underwater:
    """Without a blur, as to export each takes seconds."""
    medium = Medium.from_coefficients((1.0, 0.8, 0.9), (0.4, 0.3, 0.5), (0.1, 0.3, 0.4))
    return Underwater(medium, (1.0, 5.0))


def test_verify_refuses_a_wrong_graph_and_leaves_nothing(clear, tmp_path, monkeypatch) -> None:
    path = tmp_path / "wrong.onnx"
    path.write_text("old")
    right = Graph.__init__

    def wrong(self, *arguments) -> None:
        right(self, *arguments)
        self.weights *= 1.001

    monkeypatch.setattr(Graph, "__init__", wrong)
    message = f"{re.escape(str(path))}: differs from float64 eager"
    with pytest.raises(ValueError, match=message) as info:
        export_onnx(clear, path)
    assert ".part" not in str(info.value)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_progress_a_link_and_an_opset(clear, tmp_path) -> None:
    said: list[str] = []
    link, target = tmp_path / "link.onnx", tmp_path / "target.onnx"
    link.symlink_to(target)
    assert export_onnx(clear, link, opset=19, progress=said.append) == link
    assert said[:2] == ["tracing", "translating and optimising"]
    assert said[2:] == [f"checking, case {i + 1} of 51" for i in range(51)]
    assert link.is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.onnx", "target.onnx"]
    assert OnnxUnderwater(link).metadata == OnnxUnderwater(target).metadata
    assert {entry.domain: entry.version for entry in onnx.load(link).opset_import}[""] == 19


def test_an_opset_that_the_exporter_cannot_write_is_refused(clear, tmp_path, monkeypatch) -> None:
    # the exporter writes 18 then, and says so in its log alone
    monkeypatch.setattr(onnx.defs, "onnx_opset_version", lambda: 1000)
    with pytest.raises(ValueError, match="opset 99: the installed exporter can write up to 18"):
        export_onnx(clear, tmp_path / "a.onnx", opset=99)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"parameters": "free"}, "parameters must be one of"),
        ({"field": True}, "field must be one of"),
        ({"image": "float64"}, "image must be one of"),
        ({"opset": 17}, "opset must be ≥ 18"),
        ({"opset": 99}, "opset must be ≤ "),
    ],
)
def test_wrong_options(clear, tmp_path, options, message) -> None:
    with pytest.raises(ValueError, match=message):
        export_onnx(clear, tmp_path / "a.onnx", **options)
    assert list(tmp_path.iterdir()) == []


def test_where_it_cannot_write(clear, tmp_path, monkeypatch) -> None:
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        export_onnx(clear, tmp_path / "missing" / "a.onnx")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        export_onnx(clear, tmp_path)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    path = tmp_path / "a.onnx"
    with monkeypatch.context() as patch:
        patch.setattr(export, "_model", lambda *_: onnx.ModelProto())
        patch.setattr(onnx, "save", full)
        message = f"No space left on device: '{re.escape(str(path))}'"
        with pytest.raises(OSError, match=message):
            export_onnx(clear, path)

    def denied(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", denied)
    message = f"cannot write to the folder {tmp_path}: Permission denied"
    with pytest.raises(PermissionError, match=message):
        export_onnx(clear, path)
    assert list(tmp_path.iterdir()) == []


def test_program_saved_and_loaded(tmp_path) -> None:
    media = [
        Medium.from_water(name, point_spread=PointSpread(2.0, exponent))
        for name, exponent in (("I", 1.0), ("3C", 0.8), ("9C", 0.7))
    ]
    module = Underwater(Medium.stack(media), (NEAR, FAR), tolerance=0.05)
    program = export_program(module, parameters="inputs", field="input")
    torch.export.save(program, tmp_path / "a.pt2")
    loaded = torch.export.load(tmp_path / "a.pt2").module()
    for batch, height, width in ((1, 1, 1), (1, 33, 64), (3, 40, 35)):
        image, distance, field = scene(batch, height, width)
        medium = Medium.stack(media[:batch])
        with torch.no_grad():
            result = loaded(image, distance, field, *parameters_of(medium).values())
            plan = module.plan((height, width))
            expected = module.formed(image, distance, field, medium, plan)
        assert apart(result, expected) <= 2e-5


@pytest.mark.parametrize("missing", ["onnx", "onnxscript", "onnxruntime"])
def test_a_missing_package_is_named(missing, clear, frozen, tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    message = rf'{missing} is missing: pip install "\.\[onnx\]"'
    with pytest.raises(ImportError, match=message):
        export_onnx(clear, tmp_path / "a.onnx")
    assert list(tmp_path.iterdir()) == []
    if missing == "onnxruntime":
        with pytest.raises(ImportError, match=message):
            OnnxUnderwater(frozen[0])
    if missing == "onnx":
        assert OnnxUnderwater(frozen[0])(*scene(1)[:2]).shape == (1, 3, 45, 62)


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run Python code in a process of its own."""
    command = [sys.executable, "-c", code]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)


def test_without_any_of_the_extra_the_rest_works(tmp_path) -> None:
    code = (
        "import sys\n"
        "class Block:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name.split('.')[0] in ('onnx', 'onnxscript', 'onnxruntime'):\n"
        "            raise ModuleNotFoundError(f'No module named {name!r}', name=name)\n"
        "sys.meta_path.insert(0, Block())\n"
        "import uwaug, uwaug.onnx\n"
        "module = uwaug.load_preset('survey').module()\n"
        "try:\n"
        "    uwaug.onnx.export_onnx(module, 'a.onnx')\n"
        "except ImportError as error:\n"
        "    print(error)\n"
    )
    done = run(code, tmp_path)
    cure = 'pip install ".[onnx]" in a checkout of uwaug'
    assert done.stdout == f"onnx is missing: {cure}\n"
    assert done.stderr == ""


def test_exporting_is_silent_and_imports_are_lazy(tmp_path) -> None:
    code = (
        "import sys, uwaug, uwaug.onnx\n"
        "assert not {'onnx', 'onnxscript', 'onnxruntime'} & set(sys.modules)\n"
        "medium = uwaug.Medium.from_coefficients((1.0,) * 3, (0.5,) * 3, (0.2,) * 3)\n"
        "uwaug.onnx.export_onnx(uwaug.Underwater(medium, (1.0, 5.0)), 'a.onnx')\n"
    )
    done = run(code, tmp_path)
    assert done.stdout + done.stderr == ""
    assert [p.name for p in tmp_path.iterdir()] == ["a.onnx"]
