"""What an exported file computes, that it is a trace of `form`, and that a wrong one is refused."""

import json
import re
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from exporting import COARSE, FAR, NEAR, in_water, scene, without_graph

import uwaug
from uwaug import Development, Lamp, Light, MarineSnow, Medium, PointSpread, Underwater, View
from uwaug.onnx import (
    OnnxUnderwater,
    check_onnx,
    coefficients_of,
    export_onnx,
    input_rows,
    read_metadata,
)
from uwaug.onnx.blurs import Blurs
from uwaug.onnx.check import plan_of
from uwaug.onnx.export import Graph

# by its version: without the package, "onnx" would be the folder of these tests
onnx = pytest.importorskip("onnx", minversion="1.17")
pytest.importorskip("onnxruntime")

MEDIUM = Medium.from_coefficients((1.0, 0.8, 0.9), (0.4, 0.3, 0.5), (0.1, 0.3, 0.4))
CLEAR = Underwater(MEDIUM, (1.0, 5.0))  # without a blur, as to export each takes seconds
LIGHT = Light([Lamp((0.3, -0.2, 0.0), power=40.0, aim=(-0.05, 0.05, 1.0), cone=40.0)], pitch=10.0)


def with_shapes(path: Path) -> "onnx.ModelProto":
    """A file with the shapes that ONNX Runtime's symbolic inference finds."""
    from onnxruntime.tools.symbolic_shape_infer import SymbolicShapeInference

    return SymbolicShapeInference.infer_shapes(onnx.load(path), auto_merge=True)


@pytest.mark.parametrize("name", ["frozen", "waters"])
def test_files_agree_with_float64_eager(request, name) -> None:
    path, module = request.getfixturevalue(name)
    report = check_onnx(path)
    assert report.cases == 18
    assert 0 < report.worst <= 2e-5 * max(1, module.development.brightening)
    model = onnx.load(path)
    operators = {entry.domain: entry.version for entry in model.opset_import}
    assert (model.ir_version, operators[""]) == (8, 18)  # both of ONNX Runtime 1.14, of 2023
    content = path.read_bytes()
    assert len(content) < 500_000
    assert b"site-packages" not in content
    assert str(Path(uwaug.__file__).parent).encode() not in content


def test_inputs_are_named_and_explained(waters) -> None:
    def shape(value) -> list:
        return [d.dim_param or d.dim_value for d in value.type.tensor_type.shape.dim]

    graph = onnx.load(waters[0]).graph
    values = (*graph.input, *graph.output)
    pictures = {"image": 3, "distance": 1, "output": 3}
    weights = ["batch", 3, "scatter_rates"]
    assert {value.name: shape(value) for value in values} == {
        **{name: ["batch", count, "height", "width"] for name, count in pictures.items()},
        **{"beta": ["batch", "rates"], "direct_weights": ["batch", 3, "rates"]},
        **{"G": ["batch", "scatter_rates"], "signal_weights": weights, "veil_weights": weights},
        **{name: ["batch"] for name in ("b_mean", "scale", "exponent")},
    }
    assert all(value.doc_string for value in values)


def test_metadata_are_the_arguments_of_the_module(frozen, tmp_path) -> None:
    path, module = frozen
    metadata = read_metadata(path)
    assert metadata["uwaug_version"] == uwaug.__version__
    assert metadata["uwaug_plan"] == str(plan_of(module))
    again = OnnxUnderwater(path).module
    assert repr(again) == repr(module)
    torch.testing.assert_close(again.medium.tensors(), module.medium.tensors())
    # of one that has taken a state
    module = Underwater(Medium.from_water("II"), sides=(32, 64))
    other = Underwater(Medium.from_water("9C"), view=33.0, light=LIGHT, color_space="linear")
    module.load_state_dict(other.state_dict())
    path = without_graph(tmp_path / "a.onnx", module)
    assert read_metadata(path)["uwaug_water"].startswith("9C")
    setting = OnnxUnderwater(path).module.setting
    assert (setting.view, setting.light, setting.color_space) == (View(33.0), LIGHT, "linear")


# beyond the planned distances too
@pytest.mark.filterwarnings("ignore:.* that the blur is planned for")
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (16, 17), (163, 217)])
def test_module_and_file_are_one_function(frozen, size) -> None:
    path, module = frozen
    image, distance = scene(1, *size)
    result = OnnxUnderwater(path, threads=1)(image, 1.5 * distance)
    # two routes in single precision
    torch.testing.assert_close(result, module(image, 1.5 * distance), rtol=0, atol=1e-4)


def test_one_file_serves_many_waters_at_once(waters) -> None:
    path, module = waters
    run, (image, distance) = OnnxUnderwater(path, threads=1), scene(3)
    media = Medium.stack([Medium.from_water(name) for name in ("III", "3C", "5C")])
    result = run(image, distance, media)
    exact = in_water(module, media, image, distance)
    torch.testing.assert_close(result.double(), exact, rtol=0, atol=1e-5)
    for i in range(3):
        alone = run(image[i], distance[i], media[i])
        torch.testing.assert_close(result[i], alone, rtol=0, atol=1e-6)
    # the file itself, as anybody runs it
    inputs = {"image": image, "distance": distance, **coefficients_of(media)}
    (raw,) = run.session.opened.run(None, {name: row.numpy() for name, row in inputs.items()})
    torch.testing.assert_close(torch.from_numpy(raw), result, rtol=0, atol=0)


def half_of(path: Path) -> OnnxUnderwater:
    """A file's copy in half precision, as the guide makes it."""
    from onnxruntime.transformers import float16

    kept = [*float16.DEFAULT_OP_BLOCK_LIST, "ScatterElements"]
    with warnings.catch_warnings():  # of numbers that are rounded
        warnings.simplefilter("ignore")
        half = float16.convert_float_to_float16(
            onnx.load(path), keep_io_types=True, op_block_list=kept
        )
    onnx.save(half, path.with_name("half.onnx"))
    return OnnxUnderwater(path.with_name("half.onnx"))


@pytest.mark.parametrize(("coefficients", "space"), [(False, "srgb"), (True, "linear")])
def test_a_file_with_a_lamp(tmp_path, coefficients, space) -> None:
    of_water = {"vertical_depth": 10.0, "point_spread": PointSpread.none()}
    surfaces = "spectral" if coefficients else "grey"
    medium = Medium.from_water("7C", surfaces=surfaces, **of_water)
    lit = {"light": LIGHT, "development": Development(metered=space == "srgb")}
    module = Underwater(medium, (NEAR, FAR), COARSE, space, sides=(1, 144), **lit)
    path = export_onnx(module, tmp_path / "lamp.onnx", coefficients=coefficients)
    run, (image, distance) = OnnxUnderwater(path), scene(1)
    if not coefficients:
        assert check_onnx(path).worst < 2e-4  # by its metadata alone
        assert (run(image, distance) - module(image, distance)).abs().max() < 2e-4
        off = half_of(path)(image, distance) - run(image, distance)
        assert 0.001 < off.abs().max() < 0.015
        assert off.square().mean().sqrt() < 0.0005
        with pytest.raises(ValueError, match="light: the file takes none"):
            run(image, distance, light=LIGHT)
        return
    with_shapes(path)
    lamp = replace(LIGHT.lamps[0], power=1.5, color=(1.0, 0.7, 0.4))
    other = Medium.from_water("II", point_spread=PointSpread.none())
    for light in (LIGHT, Light([lamp], pitch=-25.0), Light([replace(lamp, power=0.0)], pitch=0.0)):
        options = {**lit, "light": light, "sides": (1, 144)}
        exact = Underwater(other, (NEAR, FAR), COARSE, space, **options)(image, distance)
        apart = run(image, distance, other, light) - exact
        assert apart.abs().max() < 2e-5 * exact.max()
    for light in (Light([lamp]), Light(pitch=3.0), Light([replace(lamp, cone=30.0)], pitch=3.0)):
        with pytest.raises(ValueError, match=r"light: the file takes .* with other powers"):
            run(image, distance, other, light)


def test_rows_for_another_language_are_what_a_file_takes(waters) -> None:
    media = {name: Medium.from_water(name) for name in ("9C", "I")}
    assert len({coefficients_of(medium)["G"].shape for medium in media.values()}) == 2
    rows = json.loads(json.dumps(input_rows(media)))
    session, (image, distance) = OnnxUnderwater(waters[0], threads=1).session.opened, scene(2)
    assert {"image", "distance", *rows["inputs"]} == {x.name for x in session.get_inputs()}
    assert "1/m" in rows["inputs"]["beta"]
    batch = {
        key: np.concatenate([np.array(row[key], np.float32) for row in rows["waters"].values()])
        for key in rows["inputs"]
    }
    (result,) = session.run(None, {"image": image.numpy(), "distance": distance.numpy(), **batch})
    for place, medium in enumerate(media.values()):
        exact = in_water(waters[1], medium, image[place : place + 1], distance[place : place + 1])
        np.testing.assert_allclose(result[place], exact[0].numpy(), rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", ["frozen", "waters"])
def test_other_tools_of_the_runtime_follow_a_file(request, tmp_path, name) -> None:
    """Its symbolic inference of shapes, and what prepares a file for quantisation."""
    from onnxruntime.quantization.shape_inference import quant_pre_process

    path, module = request.getfixturevalue(name)
    assert len(with_shapes(path).graph.value_info) > 100
    quant_pre_process(path, tmp_path / "prepared.onnx")
    medium = module.medium[0] if len(module.medium) > 1 else None
    outputs = [
        OnnxUnderwater(file, threads=1)(*scene(2), medium)
        for file in (path, tmp_path / "prepared.onnx")
    ]
    torch.testing.assert_close(*outputs, rtol=0, atol=2e-5)


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (23, 16), (65, 130)])
def test_blurs_of_a_graph_are_those_of_the_package(size) -> None:
    from uwaug.blur import plan_blur
    from uwaug.blur.stack import varying_blur

    light = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(0))
    # narrow ones, grids within a period, and cells of several periods
    for low, high in ((0.3, 2.0), (1.0, 30.0), (20.0, 400.0)):
        plan = plan_blur(low, high)
        widths = low + (high - low) * light[:, :1]
        exact = varying_blur(light, widths, plan)
        torch.testing.assert_close(Blurs(plan)(light, widths), exact, rtol=0, atol=2e-6)


def test_a_wrong_graph_is_refused_and_leaves_nothing(tmp_path, monkeypatch) -> None:
    path = tmp_path / "wrong.onnx"
    path.write_text("old")
    right = Graph.forward
    monkeypatch.setattr(Graph, "forward", lambda self, *values: 1.001 * right(self, *values))
    message = f"{re.escape(str(path))}: differs from float64 eager"
    with pytest.raises(ValueError, match=message) as info:
        export_onnx(CLEAR, path)
    assert ".part" not in str(info.value)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_graph_that_returns_its_input_is_refused(tmp_path) -> None:
    with pytest.raises(ValueError, match="differs from float64 eager"):
        check_onnx(without_graph(tmp_path / "a.onnx", CLEAR), CLEAR)
    nothing = Medium.from_coefficients((0.0,) * 3, (0.0,) * 3, (0.0,) * 3)
    module = Underwater(nothing, (1.0, 5.0))
    with pytest.raises(ValueError, match="too little to check"):
        check_onnx(without_graph(tmp_path / "b.onnx", module), module)


ANY = Medium.from_water("II")
REFUSED = [
    (uwaug.RandomUnderwater(), r"module must be a uwaug\.Underwater, got RandomUnderwater"),
    (Underwater(MEDIUM, None), r"no plan of the blur .*distance_range=.*sides="),
    (Underwater(ANY, (1.0, 5.0)), "no plan of the blur"),
    (Underwater(Medium.stack([MEDIUM] * 2), (1.0, 5.0)), "holds 2 media: give coefficients"),
    (Underwater(MEDIUM.with_snow(MarineSnow(seed=5)), (1.0, 5.0)), "marine snow, which no"),
]


def test_what_cannot_be_exported(tmp_path, monkeypatch) -> None:
    for module, message in REFUSED:
        with pytest.raises((TypeError, ValueError), match=message):
            export_onnx(module, tmp_path / "a.onnx")
    with pytest.raises(FileNotFoundError, match="No such file or directory"):
        export_onnx(CLEAR, tmp_path / "missing" / "a.onnx")
    for missing in ("onnx", "onnxscript", "onnxruntime"):
        with monkeypatch.context() as lacking:
            lacking.setitem(sys.modules, missing, None)
            with pytest.raises(ImportError, match=rf"{missing} is missing: pip install"):
                export_onnx(CLEAR, tmp_path / "a.onnx")
    monkeypatch.setattr("uwaug.onnx.export.EXPORTS", False)
    with pytest.raises(ImportError, match=r"needs torch ≥ 2\.13"):
        export_onnx(CLEAR, tmp_path / "a.onnx")
    assert list(tmp_path.iterdir()) == []
