import json
import os

import numpy as np
import pytest
from exporting import stored_tensors

from uwaug import Medium, Underwater, load_preset
from uwaug.onnx import check_onnx, export_onnx, read_metadata

# by its version: without the package, "onnx" would be the folder of these tests
onnx = pytest.importorskip("onnx", minversion="1.17")
pytest.importorskip("onnxruntime")


@pytest.mark.parametrize("name", ["frozen", "quantised", "waters", "calibrated", "encoded"])
def test_files_agree_with_float64_eager(request, name) -> None:
    path, module = request.getfixturevalue(name)
    report = check_onnx(path, module)
    large = json.loads(read_metadata(path)["uwaug_sides_px"])[1] > 144
    assert report.cases == 2 * (7 * 7 + 1 + large)
    assert 0 < report.worst <= (1.0 if name in ("quantised", "encoded") else 1e-5)
    assert "optimisations o" in report.where
    # the taps of blurs much wider than a picture are written out
    assert path.stat().st_size < 200_000
    assert (path.stat().st_mode & 0o777) == 0o666 & ~target_umask()


def target_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def weights(model) -> list:
    numbers = [t for t in stored_tensors(model) if t.data_type == onnx.TensorProto.FLOAT]
    return [t for t in numbers if np.prod(t.dims) >= 3]


def test_any_altered_weight_is_refused(frozen, tmp_path) -> None:
    path, module = frozen
    count = len(weights(onnx.load(path)))
    assert count >= 10
    for i in range(count):
        model = onnx.load(path)
        tensor = weights(model)[i]
        values = onnx.numpy_helper.to_array(tensor).copy()
        # the first and last of a kernel or a series may not show
        values.flat[values.size // 2] += 0.1
        tensor.CopyFrom(onnx.numpy_helper.from_array(values, tensor.name))
        onnx.save(model, tmp_path / "altered.onnx")
        message = r"differs from float64 eager by .* \(limit 1e-05\) at .*×.*×"
        with pytest.raises(ValueError, match=message):
            check_onnx(tmp_path / "altered.onnx", module)


@pytest.mark.parametrize("name", ["frozen", "quantised"])
def test_a_graph_that_passes_the_image_through_is_refused(request, name, tmp_path) -> None:
    path, module = request.getfixturevalue(name)
    model = onnx.load(path)
    del model.graph.node[:], model.graph.initializer[:]
    model.graph.node.append(onnx.helper.make_node("Identity", ["image"], ["output"]))
    onnx.save(model, tmp_path / "through.onnx")
    with pytest.raises(ValueError, match=r"differs from float64 eager by .* at .*×.*×"):
        check_onnx(tmp_path / "through.onnx", module)


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        (
            [("Sub", ["x", "x"], "zero"), ("Div", ["zero", "zero"], "output")],
            r"differs .* by inf .* at .*×.*×",
        ),
        (
            [("Transpose", ["x"], "output")],
            r"gives \(1, 1, 3, 1\), not \(1, 3, 1, 1\), at constant, 1×1×1",
        ),
        ([("Reshape", ["x", "distance"], "output")], r"onnx\.checker refuses it|cannot load it"),
    ],
    ids=["nan", "shape", "invalid"],
)
def test_a_broken_graph_is_refused(frozen, tmp_path, nodes, message) -> None:
    path, module = frozen
    model = onnx.load(path)
    next(n for n in model.graph.node if "output" in n.output).output[0] = "x"
    for kind, inputs, output in nodes:
        model.graph.node.append(onnx.helper.make_node(kind, inputs, [output]))
    for dim in model.graph.output[0].type.tensor_type.shape.dim:
        dim.Clear()
    onnx.save(model, tmp_path / "broken.onnx")
    with pytest.raises(ValueError, match=message):
        check_onnx(tmp_path / "broken.onnx", module)


def test_the_wrong_module_is_refused(frozen, waters) -> None:
    other = load_preset("survey", water="9C").module(sides=(32, 1024))
    message = r"made for 5 blurs .*, but module asks for .*: it is from another module or"
    with pytest.raises(ValueError, match=message):
        check_onnx(frozen[0], other)
    # at equal parameters only the curve of the encoding differs
    path, module = frozen
    options = {"color_space": "srgb", "sides": module.sides}
    encoded = Underwater(module.medium, module.distance_range, **options)
    with pytest.raises(ValueError, match="differs from float64 eager"):
        check_onnx(path, encoded)


def test_a_module_that_changes_nothing_cannot_be_checked(folder) -> None:
    clear = Medium.from_coefficients((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    path = folder / "clear.onnx"
    with pytest.raises(ValueError, match="a graph that returns its input would pass"):
        export_onnx(Underwater(clear, (1.0, 2.0), color_space="linear"), path)
    assert not list(folder.glob("*clear*"))
