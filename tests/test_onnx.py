import copy
import json
import os
import pickle
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

import uwaug
from uwaug import JERLOV_TYPES, Medium, PointSpread, Underwater, Water, list_presets, load_preset
from uwaug.blur.plan import BlurPlan
from uwaug.blur.stack import blurred
from uwaug.onnx import (
    OnnxUnderwater,
    check_onnx,
    export_onnx,
    export_program,
    parameters_of,
    read_metadata,
    read_module,
)
from uwaug.onnx.export import Graph
from uwaug.onnx.graph import _blur

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

NEAR, FAR = 0.25, 10.0
PAPERS = [name for name in list_presets() if name != "calibrated"]  # whose law has another shape


def scene(
    batch: int = 2, height: int = 45, width: int = 62, seed: int = 0
) -> tuple[Tensor, Tensor, Tensor]:
    rng = torch.Generator().manual_seed(seed)
    image = torch.rand(batch, 3, height, width, generator=rng)
    distance = NEAR + (FAR - NEAR) * torch.rand(batch, 1, height, width, generator=rng) ** 2
    return image, distance, 0.3 + 1.4 * torch.rand(batch, 1, height, width, generator=rng)


@pytest.fixture(scope="session")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("onnx")


@pytest.fixture(scope="session")
def frozen(folder) -> tuple[Path, Underwater]:
    """The survey preset as it comes: linear values, no field."""
    module = load_preset("survey", water="7C").module()
    return export_onnx(module, folder / "frozen.onnx"), module


@pytest.fixture(scope="session")
def quantised(folder) -> tuple[Path, Underwater]:
    """uint8 in and out, sRGB, with a field; wide blurs of a known exponent below one half."""
    law = PointSpread(9.0, 0.45, reference_size=None)
    module = Underwater(
        Medium.from_water(Water.jerlov("II"), g=0.066, mu=0.1, point_spread=law), (0.5, 12.0)
    )
    return export_onnx(module, folder / "uint8.onnx", field="input", image="uint8"), module


@pytest.fixture(scope="session")
def waters(folder) -> tuple[Path, Underwater]:
    """One file for the ten types and the paper's presets: parameters and field as inputs, linear values."""
    media = [load_preset("survey", water=name).medium for name in JERLOV_TYPES]
    media += [load_preset(name).medium for name in PAPERS]
    module = Underwater(Medium.stack(media), (NEAR, FAR), color_space="linear")
    return export_onnx(module, folder / "waters.onnx", parameters="inputs", field="input"), module


@pytest.fixture(scope="session")
def calibrated(folder) -> tuple[Path, Underwater]:
    """Heavy tails, sRGB: the calibrated preset, for small pictures."""
    module = load_preset("calibrated").module()
    return export_onnx(module, folder / "calibrated.onnx", sides=(32, 144)), module


@pytest.fixture(scope="session")
def encoded(folder) -> tuple[Path, Underwater]:
    """Parameters as inputs, sRGB, uint8, no field, px of the image at hand."""
    law = PointSpread(2.0, 1.0)
    module = Underwater(Medium.from_water(Water.jerlov("3C"), point_spread=law), (NEAR, FAR))
    return export_onnx(module, folder / "encoded.onnx", parameters="inputs", image="uint8"), module


def reference(
    path: Path, module: Underwater, image: Tensor, distance: Tensor, **given: object
) -> Tensor:
    """Float64 eager through the public model, with the file's plan."""
    sides = json.loads(read_metadata(path)["uwaug_sides_px"])
    plan = module.demand.plan_all(tuple(sides))
    field, medium = given.get("field"), given.get("medium", module.medium)
    j = image.double()
    if image.dtype == torch.uint8:
        j = j / 255
    if module.color_space == "srgb":
        j = torch.where(j <= 0.04045, j / 12.92, ((j + 0.055) / 1.055) ** 2.4)
    terms = uwaug.form_image(
        j, distance.double(), medium, None if field is None else field.double(), plan=plan
    )
    out = terms.image
    if module.color_space == "srgb":
        out = torch.where(
            out <= 0.0031308, out * 12.92, 1.055 * out.clamp(min=1e-9) ** (1 / 2.4) - 0.055
        )
    return (255 * out).round().clamp(0, 255) if image.dtype == torch.uint8 else out


def apart(got: Tensor, wanted: Tensor) -> float:
    return float((got.double() - wanted.double()).abs().max())


# What it must show


@pytest.mark.parametrize("name", ["frozen", "quantised", "waters", "calibrated", "encoded"])
def test_files_agree_with_float64_eager(request, name) -> None:
    path, module = request.getfixturevalue(name)
    report = check_onnx(path, module)
    large = json.loads(read_metadata(path)["uwaug_sides_px"])[1] > 144
    assert report.cases == 2 * (7 * 7 + large)
    assert 0 < report.worst <= (1.0 if name in ("quantised", "encoded") else 1e-5)
    assert "optimisations o" in report.where
    # the taps of blurs much wider than a picture are written out
    assert path.stat().st_size < 200_000
    assert (path.stat().st_mode & 0o777) == 0o666 & ~target_umask()


def target_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@pytest.mark.parametrize("name", JERLOV_TYPES)
def test_one_file_serves_every_type(waters, name) -> None:
    path, module = waters
    image, distance, field = scene()
    medium = load_preset("survey", water=name).medium
    got = OnnxUnderwater(path, threads=1)(image, distance, field, medium)
    assert apart(got, reference(path, module, image, distance, field=field, medium=medium)) <= 1e-5
    assert apart(got, image) > 0.05


@pytest.mark.parametrize("name", PAPERS)
def test_one_file_serves_every_preset(waters, name) -> None:
    path, module = waters
    preset = load_preset(name)
    image, _, field = scene(1, 40, 53)
    distance = preset.distance(torch.rand(1, 1, 40, 53, generator=torch.Generator().manual_seed(1)))
    got = OnnxUnderwater(path, threads=1)(image, distance, field, preset.medium)
    assert (
        apart(got, reference(path, module, image, distance, field=field, medium=preset.medium))
        <= 1e-5
    )


def test_the_calibrated_law_comes_back_from_its_file(calibrated) -> None:
    path, module = calibrated
    law = module.medium.point_spread
    assert law.shape == "exponential"
    assert read_module(path).medium.point_spread == law
    assert read_module(path).plan((64, 80)) == module.plan((64, 80))


def test_a_medium_for_each_image(waters) -> None:
    path, module = waters
    image, distance, field = scene(3)
    media = Medium.stack([load_preset("survey", water=name).medium for name in ("I", "3C", "9C")])
    run = OnnxUnderwater(path)
    got = run(image, distance, field, media)
    assert apart(got, reference(path, module, image, distance, field=field, medium=media)) <= 1e-5
    for i in range(3):
        assert (
            apart(
                got[i : i + 1],
                run(image[i : i + 1], distance[i : i + 1], field[i : i + 1], media[i]),
            )
            == 0
        )
    one = run(image[0], distance[0], field[0], media)
    assert one.shape == image.shape
    assert run(image[0], distance[0], field[0], media[0]).shape == image[0].shape


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (200, 3), (64, 64), (99, 131)])
def test_frozen_file_at_other_sizes(frozen, size) -> None:
    path, module = frozen
    image, distance, _ = scene(1, *size)
    got = OnnxUnderwater(path, threads=1)(image, distance)
    assert apart(got, reference(path, module, image, distance)) <= 1e-5
    # the module plans for each size: another plan, within the tolerance of the blur
    if min(size) >= 32:
        assert apart(got, module(image, distance)) < 10 * module.tolerance


def test_uint8(quantised, encoded) -> None:
    image, distance, field = scene(2)
    levels = (image * 255).round().to(torch.uint8)
    path, module = quantised
    got = OnnxUnderwater(path)(levels, distance, field)
    assert got.dtype == torch.uint8
    assert apart(got, reference(path, module, levels, distance, field=field)) <= 1
    path, module = encoded
    medium = Medium.from_water(Water.jerlov("9C"), point_spread=PointSpread(1.0, 0.8))
    got = OnnxUnderwater(path)(levels, distance, medium=medium)
    assert apart(got, reference(path, module, levels, distance, medium=medium)) <= 1
    assert apart(got, levels) > 20


def test_singular_distances(frozen) -> None:
    path, module = frozen
    image, distance, _ = scene(1, 40, 40)
    run = OnnxUnderwater(path)
    far = torch.full_like(distance, torch.inf)
    open_water = module.medium.veil_weights.sum(-1).float()[..., None, None].expand_as(image)
    assert apart(run(image, far), open_water) < 1e-6
    assert (
        apart(run(image, torch.zeros_like(distance)), reference(path, module, image, 0 * distance))
        < 1e-6
    )
    # beyond the planned range widths stop growing, curves stay exact: the same in both
    for z in (1e-3, 0.1, 20.0, 1e4):
        z = torch.full_like(distance, z)
        assert apart(run(image, z), reference(path, module, image, z)) <= 1e-5
    # the graph cannot raise
    session = onnxruntime.InferenceSession(path)
    below, unknown = distance.clone(), distance.clone()
    below[..., :20, :], unknown[..., 3, 4] = -1.0, torch.nan
    (got,) = session.run(None, {"image": image.numpy(), "distance": below.numpy()})
    assert apart(torch.from_numpy(got), reference(path, module, image, below.clamp(min=0))) <= 1e-5
    (got,) = session.run(None, {"image": image.numpy(), "distance": unknown.numpy()})
    assert np.argwhere(np.isnan(got)).tolist() == [[0, c, 3, 4] for c in range(3)]


def test_no_blur_and_one_blur(folder) -> None:
    coefficients = {
        "beta": (1.0, 0.8, 0.9),
        "G": (0.4, 0.3, 0.5),
        "veil": (0.1, 0.3, 0.4),
        "b_mean": 0.5,
    }
    for law, sigmas in ((PointSpread.none(), (0.0,)), (PointSpread(4.0, 1e-3), None)):
        module = Underwater(Medium.from_coefficients(**coefficients, point_spread=law), (1.0, 4.0))
        plan = module.plan((512, 512))
        assert (
            (plan.sigmas == sigmas) if sigmas else (min(plan.sigmas) > 1 and len(plan.sigmas) <= 2)
        )
        path = export_onnx(module, folder / "few.onnx")
        assert read_metadata(path)["uwaug_plan"] == str(plan)
        assert check_onnx(path, read_module(path)).worst < 1e-5


@pytest.mark.parametrize(
    "cell", [1.0, 16 / 9, 2.0, 16 / 7, 16 / 5, 4.0, 8.0, 16.0, 32.0, 48.0, 400.0]
)
def test_blurs_of_the_graph_are_those_of_the_stack(cell) -> None:
    sigma = 1.3 if cell == 1 else 1.2 * cell
    plan = BlurPlan(sigma, sigma, (sigma,), (cell,), ((1.0,),), 3.0, 1e-3)
    for h, w in [
        (1, 1),
        (2, 40),
        (15, 16),
        (17, 31),
        (33, 32),
        (64, 101),
        *((n, 41 - n) for n in range(3, 30, 4)),
    ]:
        image = torch.rand(2, 3, h, w, generator=torch.Generator().manual_seed(h))
        got = _blur(sigma, cell, 3.0)(image)
        torch.testing.assert_close(
            got.double(), blurred(image.double(), plan)[0], rtol=0, atol=2e-6
        )


# The check itself


@pytest.fixture
def altered(frozen, tmp_path):
    """Write a changed copy of the frozen file."""

    def write(change) -> Path:
        model = onnx.load(frozen[0])
        change(model)
        onnx.save(model, tmp_path / "altered.onnx")
        return tmp_path / "altered.onnx"

    return write


def weights(model) -> list:
    return [
        t
        for t in model.graph.initializer
        if t.data_type == onnx.TensorProto.FLOAT and np.prod(t.dims) >= 3
    ]


def test_any_altered_weight_is_refused(frozen, tmp_path) -> None:
    path, module = frozen
    count = len(weights(onnx.load(path)))
    assert count >= 10
    for i in range(count):
        model = onnx.load(path)
        tensor = weights(model)[i]
        values = onnx.numpy_helper.to_array(tensor).copy()
        values.flat[values.size // 2] += (
            0.1  # the first and last of a kernel or a series may not show
        )
        tensor.CopyFrom(onnx.numpy_helper.from_array(values, tensor.name))
        onnx.save(model, tmp_path / "altered.onnx")
        with pytest.raises(
            ValueError, match=r"differs from float64 eager by .* \(limit 1e-05\) at .*×.*×"
        ):
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
    other = load_preset("survey", water="9C").module()
    with pytest.raises(
        ValueError,
        match=r"made for 5 blurs .*, but module asks for .*: it is from another module or",
    ):
        check_onnx(frozen[0], other)
    # at equal parameters only the curve of the encoding differs
    with pytest.raises(ValueError, match="differs from float64 eager"):
        check_onnx(
            frozen[0], Underwater(frozen[1].medium, frozen[1].distance_range, color_space="srgb")
        )


def test_a_module_that_changes_nothing_cannot_be_checked(folder) -> None:
    clear = Medium.from_coefficients((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    path = folder / "clear.onnx"
    with pytest.raises(ValueError, match="a graph that returns its input would pass"):
        export_onnx(Underwater(clear, (1.0, 2.0), color_space="linear"), path)
    assert not list(folder.glob("*clear*"))


def test_verify_refuses_a_wrong_graph_and_leaves_nothing(frozen, tmp_path, monkeypatch) -> None:
    path = tmp_path / "wrong.onnx"
    path.write_text("old")
    curves = Graph.__init__

    def wrong(self, *arguments, **options) -> None:
        curves(self, *arguments, **options)
        self.weights *= 1.001

    monkeypatch.setattr(Graph, "__init__", wrong)
    with pytest.raises(ValueError, match="differs from float64 eager"):
        export_onnx(frozen[1], path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


# Files


def test_metadata(frozen) -> None:
    path, module = frozen
    found = read_metadata(path)
    assert found["uwaug_version"] == uwaug.__version__
    assert found["uwaug_water"].startswith("7C: 3 + 3 rates")
    assert json.loads(found["uwaug_distance_range_m"]) == list(module.distance_range)
    assert json.loads(found["uwaug_sides_px"]) == [32, 1024]
    assert float(found["uwaug_tolerance"]) == 0.002
    assert (found["uwaug_color_space"], found["uwaug_parameters"]) == ("linear", "frozen")
    assert (found["uwaug_field"], found["uwaug_image"], found["uwaug_minimum_size"]) == (
        "none",
        "float32",
        "1x1",
    )
    assert "blurs for σ" in found["uwaug_plan"]
    assert "metres" in found["uwaug_units"]


def test_the_module_comes_back_from_the_file(frozen, waters) -> None:
    for path, module in (frozen, waters):
        again = read_module(path)
        assert again.demand == module.demand
        assert all(
            torch.equal(a, b)
            for a, b in zip(again.medium.tensors(), module.medium.tensors(), strict=True)
        )
        assert again.medium.notes == module.medium.notes
        assert str(again.medium.point_spread) == str(module.medium.point_spread)
        assert again.color_space == module.color_space


def test_a_learned_module_comes_back_from_the_file(folder) -> None:
    law = PointSpread(torch.tensor([1.5]), torch.tensor([0.8]))
    medium = Medium.from_coefficients(
        (1.0, 0.8, 0.9), (0.4, 0.3, 0.5), (0.1, 0.3, 0.4), b_mean=0.5, point_spread=law
    )
    module = Underwater(medium, (1.0, 4.0), learnable=True)
    path = export_onnx(module, folder / "learned.onnx")
    assert check_onnx(path, read_module(path)).worst < 1e-5


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


def test_a_file_of_another_format_is_refused(altered, tmp_path) -> None:
    def other(model) -> None:
        for entry in model.metadata_props:
            entry.value = {"uwaug_format": "99", "uwaug_version": "7.1"}.get(entry.key, entry.value)

    for call in (read_metadata, OnnxUnderwater, read_module, lambda p: check_onnx(p, uwaug)):
        with pytest.raises(
            ValueError, match=r"format 99 from uwaug 7\.1, but this version reads format 2"
        ):
            call(altered(other))
        with pytest.raises(ValueError, match="no metadata"):
            call(altered(lambda model: model.ClearField("metadata_props")))
    (tmp_path / "no.onnx").write_text("no model")
    with pytest.raises(ValueError, match="ONNX Runtime cannot load it"):
        OnnxUnderwater(tmp_path / "no.onnx")
    with pytest.raises(FileNotFoundError):
        OnnxUnderwater(tmp_path / "missing.onnx")


def test_where_it_cannot_write(frozen, tmp_path, monkeypatch) -> None:
    module = frozen[1]
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        export_onnx(module, tmp_path / "missing" / "a.onnx")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        export_onnx(module, tmp_path)

    def denied(**_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(tempfile, "mkstemp", denied)
    with pytest.raises(
        PermissionError, match=f"cannot write to the folder {tmp_path}: Permission denied"
    ):
        export_onnx(module, tmp_path / "a.onnx")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"parameters": "free"}, "parameters must be one of"),
        ({"field": True}, "field must be one of"),
        ({"image": "float64"}, "image must be one of"),
        ({"sides": (64, 32)}, "sides must be 1 ≤ smallest"),
        ({"sides": (0, 32)}, "sides must be 1 ≤ smallest"),
        ({"opset": 17}, "opset must be ≥ 18"),
    ],
)
def test_wrong_options(frozen, tmp_path, options, message) -> None:
    with pytest.raises(ValueError, match=message):
        export_onnx(frozen[1], tmp_path / "a.onnx", **options)
    assert list(tmp_path.iterdir()) == []


def test_modules_that_cannot_be_exported(frozen, tmp_path) -> None:
    medium = frozen[1].medium
    with pytest.raises(ValueError, match="module has no distance_range"):
        export_onnx(Underwater(medium, None), tmp_path / "a.onnx")
    with pytest.raises(ValueError, match="must be 'line_of_sight'"):
        export_onnx(Underwater(medium, (1.0, 5.0), order="source"), tmp_path / "a.onnx")
    with pytest.raises(ValueError, match="module holds 2 media"):
        export_onnx(Underwater(Medium.stack([medium] * 2), (1.0, 5.0)), tmp_path / "a.onnx")
    with pytest.raises(TypeError, match=r"module must be a uwaug\.Underwater, got Medium"):
        export_onnx(medium, tmp_path / "a.onnx")


# The runner


def test_runner_refuses_what_the_file_does_not_take(frozen, waters) -> None:
    image, distance, field = scene(2)
    run, serve = OnnxUnderwater(frozen[0]), OnnxUnderwater(waters[0])
    medium = load_preset("survey").medium
    with pytest.raises(
        ValueError, match="field: the file takes none, as it was exported with field='none'"
    ):
        run(image, distance, field)
    with pytest.raises(ValueError, match="medium: the file takes none"):
        run(image, distance, medium=medium)
    with pytest.raises(ValueError, match="field: the file needs one"):
        serve(image, distance, medium=medium)
    with pytest.raises(
        ValueError, match="medium: the file needs one, as it was exported with parameters='inputs'"
    ):
        serve(image, distance, field)
    law = replace(medium.point_spread, reference_size=None)
    with pytest.raises(
        ValueError, match=r"medium: its point spread is .* but the file is for shape"
    ):
        serve(image, distance, field, replace(medium, point_spread=law))
    with pytest.raises(
        ValueError, match=r"its point spread is exponential .* but the file is for shape 'gaussian'"
    ):
        serve(image, distance, field, load_preset("calibrated").medium)
    with pytest.raises(
        TypeError, match=r"image must be torch\.float32 for this file, got torch\.uint8"
    ):
        run(image.to(torch.uint8), distance)
    with pytest.raises(ValueError, match=r"distance is \(45, 61\) but image is \(45, 62\)"):
        run(image, distance[..., 1:])
    with pytest.raises(ValueError, match="image must have shape"):
        run(image[:, :2], distance)
    with pytest.raises(ValueError, match="NaN or negative"):
        run(image, distance * torch.nan)
    with pytest.raises(ValueError, match="batch sizes must agree or be 1"):
        run(torch.cat([image, image[:1]]), distance)


def test_runner_has_the_shapes_of_the_module(frozen) -> None:
    path, module = frozen
    run = OnnxUnderwater(path)
    image, distance, _ = scene(2)
    for i, d in (
        (image, distance),
        (image[:1], distance),
        (image, distance[0]),
        (image[0], distance[0]),
        (image[0], distance),
        (image[0], distance[:1]),
        (image[:0], distance[:0]),
        (image[..., :0], distance[..., :0]),
    ):
        assert run(i, d).shape == module(i, d).shape
    assert "7C" in repr(run)


@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda r: pickle.loads(pickle.dumps(r))], ids=["deepcopy", "pickle"]
)
def test_runner_copies_after_use(frozen, copied) -> None:
    image, distance, _ = scene(1)
    run = OnnxUnderwater(frozen[0], threads=1)
    before = run(image, distance)
    again = copied(run)
    assert again.session._opened is None
    assert torch.equal(again(image, distance), before)


class _Pictures(Dataset):
    def __init__(self, run: OnnxUnderwater) -> None:
        self.run, self.scene = run, scene(4)

    def __len__(self) -> int:
        return 4

    def __getitem__(self, i: int) -> Tensor:
        return self.run(self.scene[0][i], self.scene[1][i])


def test_runner_in_a_worker(frozen) -> None:
    run = OnnxUnderwater(frozen[0], threads=1)
    loader = DataLoader(
        _Pictures(run), batch_size=2, num_workers=1, multiprocessing_context="spawn"
    )
    image, distance, _ = scene(4)
    assert apart(torch.cat(list(loader)), run(image, distance)) == 0


# Other ways


def test_program_saved_and_loaded(waters, tmp_path) -> None:
    path, module = waters
    program = export_program(module, parameters="inputs", field="input")
    torch.export.save(program, tmp_path / "a.pt2")
    loaded = torch.export.load(tmp_path / "a.pt2").module()
    for batch, height, width in ((1, 1, 1), (1, 33, 64), (3, 40, 35)):
        image, distance, field = scene(batch, height, width)
        media = Medium.stack(
            [load_preset("survey", water=t).medium for t in ("I", "3C", "9C")[:batch]]
        )
        with torch.no_grad():
            got = loaded(image, distance, field, *parameters_of(media).values())
        assert (
            apart(got, reference(path, module, image, distance, field=field, medium=media)) <= 1e-5
        )


def test_plain_runtime_without_uwaug_and_torch(frozen, tmp_path) -> None:
    path, module = frozen
    image, distance, _ = scene(1, 50, 70)
    np.savez(tmp_path / "in.npz", image=image, distance=distance)
    code = (
        "import sys, numpy as np, onnxruntime as ort\n"
        f"session, given = ort.InferenceSession({str(path)!r}), dict(np.load({str(tmp_path / 'in.npz')!r}))\n"
        f"np.save({str(tmp_path / 'out.npy')!r}, session.run(None, given)[0])\n"
        "assert not {'torch', 'uwaug'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    got = torch.from_numpy(np.load(tmp_path / "out.npy"))
    assert apart(got, reference(path, module, image, distance)) <= 1e-5


@pytest.mark.parametrize("missing", ["onnx", "onnxscript", "onnxruntime"])
def test_a_missing_package_is_named(missing, frozen, tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    message = rf'{missing} is missing: ONNX needs pip install "uwaug\[onnx\]"'
    with pytest.raises(ImportError, match=message):
        export_onnx(frozen[1], tmp_path / "a.onnx")
    assert list(tmp_path.iterdir()) == []
    if missing == "onnxruntime":
        with pytest.raises(ImportError, match=message):
            OnnxUnderwater(frozen[0])
    if missing == "onnx":
        assert OnnxUnderwater(frozen[0])(*scene(1)[:2]).shape == (1, 3, 45, 62)


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
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert (done.stdout, done.stderr) == (
        'onnx is missing: ONNX needs pip install "uwaug[onnx]"\n',
        "",
    )


def test_exporting_is_silent_and_imports_are_lazy(tmp_path) -> None:
    code = (
        "import sys, uwaug, uwaug.onnx\n"
        "assert not {'onnx', 'onnxscript', 'onnxruntime'} & set(sys.modules)\n"
        "medium = uwaug.Medium.from_coefficients((1.0, 1.0, 1.0), (0.5, 0.5, 0.5), (0.2, 0.2, 0.2))\n"
        "uwaug.onnx.export_onnx(uwaug.Underwater(medium, (1.0, 5.0)), 'a.onnx')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout + done.stderr == ""
    assert [p.name for p in tmp_path.iterdir()] == ["a.onnx"]
