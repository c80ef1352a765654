import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from exporting import COARSE, FAR, NEAR, apart, eager, scene

import uwaug
from uwaug import Medium, PointSpread, Underwater, load_preset
from uwaug.onnx import (
    OnnxUnderwater,
    export_onnx,
    export_program,
    parameters_of,
    read_module,
)
from uwaug.onnx.export import Graph

# by its version: without the package, "onnx" would be the folder of these tests
onnx = pytest.importorskip("onnx", minversion="1.17")
pytest.importorskip("onnxruntime")


def test_verify_refuses_a_wrong_graph_and_leaves_nothing(tmp_path, monkeypatch) -> None:
    path = tmp_path / "wrong.onnx"
    path.write_text("old")
    curves = Graph.__init__

    def wrong(self, *arguments, **options) -> None:
        curves(self, *arguments, **options)
        self.weights *= 1.001

    monkeypatch.setattr(Graph, "__init__", wrong)
    module = Underwater(Medium.from_water("7C"), (NEAR, FAR), sides=(32, 48), tolerance=COARSE)
    message = f"{re.escape(str(path))}: differs from float64 eager"
    with pytest.raises(ValueError, match=message) as info:
        export_onnx(module, path)
    assert ".part" not in str(info.value)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_file_names_no_place_of_this_machine(frozen) -> None:
    content = frozen[0].read_bytes()
    assert b"site-packages" not in content
    assert str(Path(uwaug.__file__).parent).encode() not in content


def test_free_sizes_have_names(waters) -> None:
    def shape(value) -> list:
        return [d.dim_param or d.dim_value for d in value.type.tensor_type.shape.dim]

    graph = onnx.load(waters[0]).graph
    shapes = {value.name: shape(value) for value in (*graph.input, *graph.output)}
    assert shapes == {
        "image": ["batch", 3, "height", "width"],
        "distance": ["batch", 1, "height", "width"],
        "field": ["batch", 1, "height", "width"],
        "beta": ["batch", "rates"],
        "direct_weights": ["batch", 3, "rates"],
        "G": ["batch", "scatter_rates"],
        "signal_weights": ["batch", 3, "scatter_rates"],
        "veil_weights": ["batch", 3, "scatter_rates"],
        "b_mean": ["batch"],
        "scale": ["batch"],
        "exponent": ["batch"],
        "output": ["batch", 3, "height", "width"],
    }


def test_where_it_cannot_write(frozen, tmp_path, monkeypatch) -> None:
    module = frozen[1]
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        export_onnx(module, tmp_path / "missing" / "a.onnx")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        export_onnx(module, tmp_path)

    def denied(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", denied)
    message = f"cannot write to the folder {tmp_path}: Permission denied"
    with pytest.raises(PermissionError, match=message):
        export_onnx(module, tmp_path / "a.onnx")
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
def test_wrong_options(frozen, tmp_path, options, message) -> None:
    with pytest.raises(ValueError, match=message):
        export_onnx(frozen[1], tmp_path / "a.onnx", **options)
    assert list(tmp_path.iterdir()) == []


def test_a_module_that_plans_for_each_size_is_refused(tmp_path) -> None:
    message = r"module has no sides and .*: give Underwater\(…, sides=\(32, 2160\)\), so that"
    for name in ("survey", "calibrated"):
        with pytest.raises(ValueError, match=message):
            export_onnx(load_preset(name).module(), tmp_path / "a.onnx")
        with pytest.raises(ValueError, match=message):
            export_program(load_preset(name).module())


def test_progress_and_a_link(frozen, tmp_path) -> None:
    said: list[str] = []
    link, target = tmp_path / "link.onnx", tmp_path / "target.onnx"
    link.symlink_to(target)
    export_onnx(load_preset("tank-adjusted-1").module(), link, progress=said.append)
    assert said[:2] == ["tracing", "translating and optimising"]
    cases = said[2:]
    assert cases == [f"checking, case {i + 1} of {len(cases)}" for i in range(len(cases))]
    assert len(cases) == 51
    assert link.is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.onnx", "target.onnx"]
    assert OnnxUnderwater(link).metadata == OnnxUnderwater(target).metadata


def test_an_opset_that_the_exporter_cannot_write_is_refused(tmp_path, monkeypatch) -> None:
    # the exporter writes 18 then, and says so in its log alone
    monkeypatch.setattr(onnx.defs, "onnx_opset_version", lambda: 1000)
    module = load_preset("tank-adjusted-1").module()
    with pytest.raises(ValueError, match="opset 99: the installed exporter can write up to 18"):
        export_onnx(module, tmp_path / "a.onnx", opset=99)
    assert list(tmp_path.iterdir()) == []
    path = export_onnx(module, tmp_path / "a.onnx", opset=19, verify=False)
    assert {entry.domain: entry.version for entry in onnx.load(path).opset_import}[""] == 19


def test_a_full_disk_is_named_with_the_path(frozen, tmp_path, monkeypatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(onnx, "save", full)
    path = tmp_path / "a.onnx"
    with pytest.raises(OSError, match=f"No space left on device: '{re.escape(str(path))}'"):
        export_onnx(load_preset("tank-adjusted-1").module(), path)
    assert list(tmp_path.iterdir()) == []


def test_modules_that_cannot_be_exported(frozen, tmp_path) -> None:
    medium = frozen[1].medium
    with pytest.raises(ValueError, match="module has no distance_range"):
        export_onnx(Underwater(medium, None), tmp_path / "a.onnx")
    with pytest.raises(ValueError, match="must be 'line_of_sight'"):
        export_onnx(Underwater(medium, (1.0, 5.0), order="source"), tmp_path / "a.onnx")
    two = Underwater(Medium.stack([medium] * 2), (1.0, 5.0))
    with pytest.raises(ValueError, match="module holds 2 media"):
        export_onnx(two, tmp_path / "a.onnx")
    with pytest.raises(TypeError, match=r"module must be a uwaug\.Underwater, got Medium"):
        export_onnx(medium, tmp_path / "a.onnx")


# Other ways


def test_program_saved_and_loaded(waters, tmp_path) -> None:
    path, module = waters
    program = export_program(module, parameters="inputs", field="input")
    torch.export.save(program, tmp_path / "a.pt2")
    loaded = torch.export.load(tmp_path / "a.pt2").module()
    for batch, height, width in ((1, 1, 1), (1, 33, 64), (3, 40, 35)):
        image, distance, field = scene(batch, height, width)
        names = ("I", "3C", "9C")[:batch]
        media = Medium.stack([load_preset("survey", water=name).medium for name in names])
        with torch.no_grad():
            got = loaded(image, distance, field, *parameters_of(media).values())
        expected = eager(path, module, image, distance, field=field, medium=media)
        assert apart(got, expected) <= 1e-5


def test_plain_runtime_without_uwaug_and_torch(frozen, tmp_path) -> None:
    path, module = frozen
    image, distance, _ = scene(1, 50, 70)
    np.savez(tmp_path / "in.npz", image=image, distance=distance)
    code = (
        "import sys, numpy as np, onnxruntime as ort\n"
        "file, given, result = sys.argv[1:]\n"
        "session = ort.InferenceSession(file)\n"
        "np.save(result, session.run(None, dict(np.load(given)))[0])\n"
        "assert not {'torch', 'uwaug'} & set(sys.modules)\n"
    )
    files = (path, tmp_path / "in.npz", tmp_path / "out.npy")
    command = [sys.executable, "-c", code, *map(str, files)]
    subprocess.run(command, check=True, capture_output=True)
    got = torch.from_numpy(np.load(tmp_path / "out.npy"))
    assert apart(got, eager(path, module, image, distance)) <= 1e-5


@pytest.mark.parametrize("missing", ["onnx", "onnxscript", "onnxruntime"])
def test_a_missing_package_is_named(missing, frozen, tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    message = rf'{missing} is missing: pip install "\.\[onnx\]"'
    with pytest.raises(ImportError, match=message):
        export_onnx(frozen[1], tmp_path / "a.onnx")
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


@pytest.mark.parametrize(
    ("exposure", "parameters"), [("auto", "frozen"), ("auto", "inputs"), (1.5, "frozen")]
)
def test_an_exposure_is_exported(exposure, parameters, tmp_path) -> None:
    medium = Medium.from_water("7C", vertical_depth=5.0, point_spread=PointSpread(0.8))
    module = Underwater(medium, (0.3, 6.0), exposure=exposure, tolerance=COARSE)
    path = export_onnx(module, tmp_path / "exposed.onnx", parameters=parameters, verify=False)
    assert read_module(path).exposure == exposure
    given = {} if parameters == "frozen" else {"medium": medium}
    # single precision would look at other pixels of the largest
    for size in ((363, 517), (144, 145), (33, 45), (1, 1), (3, 70)):
        image, distance, _ = scene(2, *size)
        distance = distance.clamp(0.3, 6.0)  # what the blur is planned for
        got = OnnxUnderwater(path)(image, distance, **given)
        assert apart(got, module(image, distance)) <= 2e-5
