"""Three exported files: what they compute, and what they refuse to be checked as."""

import json
import os
import subprocess
import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch
from exporting import FAR, NEAR, PAPERS, apart, bare, eager, scene, stored_tensors

import uwaug
from uwaug import JERLOV_TYPES, Light, Medium, Underwater, load_preset
from uwaug.onnx import OnnxUnderwater, check, check_onnx, parameters_of, read_metadata, read_module
from uwaug.onnx.check import limit_of

# by its version: without the package, "onnx" would be the folder of these tests
onnx = pytest.importorskip("onnx", minversion="1.17")
onnxruntime = pytest.importorskip("onnxruntime")

FILES = ["frozen", "waters", "lamp"]


@pytest.mark.parametrize("name", FILES)
def test_files_agree_with_float64_eager(request, name) -> None:
    path, module = request.getfixturevalue(name)
    report = check_onnx(path, module)
    large = json.loads(read_metadata(path)["uwaug_sides_px"])[1] > 144
    assert report.cases == 2 * (7 * 7 + (module.light is None) + large)
    assert 0 < report.worst <= (1.0 if name == "lamp" else 1e-5)
    assert "optimisations o" in report.where
    # taps of blurs much wider than a picture, and of an exposure the pixels that it looks at
    assert path.stat().st_size < 250_000
    assert (path.stat().st_mode & 0o777) == 0o666 & ~target_umask()
    content = path.read_bytes()
    assert b"site-packages" not in content
    assert str(Path(uwaug.__file__).parent).encode() not in content


def target_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


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


# beyond the planned distances too; of one strip of rows, and of several
@pytest.mark.filterwarnings("ignore:.* that the blur is planned for")
@pytest.mark.parametrize("name", FILES)
def test_module_and_file_are_one_function(request, name) -> None:
    path, module = request.getfixturevalue(name)
    run, again = OnnxUnderwater(path), read_module(path)
    medium = module.medium[3] if name == "waters" else None
    for size in [(1, 1), (1, 7), (200, 3), (16, 17), (33, 57), (64, 64), (363, 517)]:
        image, distance, field = scene(1, *size)
        maps = {"distance": distance}
        if name == "lamp":
            image = (image * 255).round().to(torch.uint8)
        if name != "frozen":
            maps["field"] = field
        given = maps if medium is None else {**maps, "medium": medium}
        expected = eager(module, image, **given)
        assert apart(run(image, **given), expected) <= (1 if name == "lamp" else 1e-5)
        if medium is None:
            assert torch.equal(again(image, **maps), module(image, **maps))


def test_one_file_serves_every_type_and_preset(waters) -> None:
    path, module = waters
    run, (image, distance, field) = OnnxUnderwater(path, threads=1), scene()
    media = [load_preset("survey", water=name).medium for name in JERLOV_TYPES]
    media += [load_preset(name).medium for name in PAPERS]
    for medium in media:
        result = run(image, distance, field, medium)
        assert apart(result, eager(module, image, distance, field, medium)) <= 1e-5
        assert apart(result, image) > 0.05


def test_a_medium_for_each_image(waters) -> None:
    path, module = waters
    image, distance, field = scene(3)
    media = Medium.stack([load_preset("survey", water=name).medium for name in ("I", "3C", "9C")])
    run = OnnxUnderwater(path)
    result = run(image, distance, field, media)
    expected = eager(module, image, distance, field, media)
    assert apart(result, expected) <= 1e-5
    for i in range(3):
        row = slice(i, i + 1)
        alone = run(image[row], distance[row], field[row], media[i])
        assert apart(result[row], alone) == 0
    one = run(image[0], distance[0], field[0], media)
    assert one.shape == image.shape
    assert run(image[0], distance[0], field[0], media[0]).shape == image[0].shape
    # the runner takes one picture after the other; the file a batch
    together = {"image": image, "distance": distance, "field": field, **parameters_of(media)}
    assert apart(run.session(together), expected) <= 1e-5


@pytest.mark.parametrize("size", [(1, 70_001), (363, 517)])
def test_strips_are_one_picture(waters, size) -> None:
    """Two strips and more, the last of which goes beyond the end, of a whole batch."""
    path, module = waters
    image, distance, field = scene(2, *size)
    media = module.medium[3]
    given = {"image": image, "distance": distance, "field": field}
    given |= {name: x.expand(2, *x.shape[1:]) for name, x in parameters_of(media).items()}
    expected = eager(module, image, distance, field, media)
    assert apart(OnnxUnderwater(path, threads=1).session(given), expected) <= 1e-5


def test_singular_distances(frozen) -> None:
    path, module = frozen
    image, distance, _ = scene(1, 40, 40)
    run = OnnxUnderwater(path)
    # open water, the lens itself; beyond the planned range widths stop growing, curves stay exact
    for metres in (torch.inf, 0.0, 1e-3, 0.1, 20.0, 1e3):
        z = torch.full_like(distance, metres)
        assert apart(run(image, z), eager(module, image, z)) <= 1e-5


def test_negative_and_unknown_distances_give_a_picture(waters) -> None:
    # the graph cannot raise
    path, module = waters
    image, distance, field = scene(1, 40, 40)
    medium = module.medium[3]
    inputs = {"image": image, "field": field, **parameters_of(medium)}
    session = OnnxUnderwater(path).session
    below, unknown = distance.clone(), distance.clone()
    below[..., :20, :], unknown[..., 3, 4] = -1.0, torch.nan
    expected = eager(module, image, below.clamp(min=0), field, medium)
    assert apart(session({**inputs, "distance": below}), expected) <= 1e-5
    result = session({**inputs, "distance": unknown})
    assert result.isnan().nonzero().tolist() == [[0, c, 3, 4] for c in range(3)]


def test_a_field_of_any_numbers_gives_a_picture(lamp) -> None:
    # the graph cannot raise: what is negative counts as 0, as in distances
    path, module = lamp
    image, distance, field = scene(1)
    image = (image * 255).round().to(torch.uint8)
    field[..., :9], distance[..., 5:20], field[..., 15:30] = -1.0, torch.inf, torch.inf
    distance[..., 25:40] = 0.0
    inputs = {"image": image, "distance": distance, "field": field}
    (result,) = onnxruntime.InferenceSession(path).run(
        None, {name: x.numpy() for name, x in inputs.items()}
    )
    expected = eager(module, image, distance, field.clamp(0, 1e9))
    assert apart(torch.from_numpy(result), expected) <= 1


def test_plain_runtime_without_uwaug_and_torch(frozen, tmp_path) -> None:
    path, module = frozen
    image, distance, _ = scene(1, 50, 70)
    np.savez(tmp_path / "in.npz", image=image, distance=distance)
    code = (
        "import sys, numpy as np, onnxruntime as ort\n"
        "file, inputs, result = sys.argv[1:]\n"
        "session = ort.InferenceSession(file)\n"
        "np.save(result, session.run(None, dict(np.load(inputs)))[0])\n"
        "assert not {'torch', 'uwaug'} & set(sys.modules)\n"
    )
    files = (path, tmp_path / "in.npz", tmp_path / "out.npy")
    command = [sys.executable, "-c", code, *map(str, files)]
    subprocess.run(command, check=True, capture_output=True)
    result = torch.from_numpy(np.load(tmp_path / "out.npy"))
    assert apart(result, eager(module, image, distance)) <= 1e-5


# What a check refuses


def weights(model) -> list:
    numbers = [t for t in stored_tensors(model) if t.data_type == onnx.TensorProto.FLOAT]
    return [t for t in numbers if np.prod(t.dims) >= 3]


def test_any_altered_weight_is_refused(waters, tmp_path, monkeypatch) -> None:
    path, module = waters
    every = list(check._cases(check.stored_in(path, read_metadata(path))))
    monkeypatch.setattr(check, "_cases", lambda stored: every[-8:])
    count = len(weights(onnx.load(path)))
    assert count >= 8
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


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        ([("Identity", ["image"], "output")], r"differs from float64 eager by .* at .*×.*×"),
        (
            [("Sub", ["image", "image"], "zero"), ("Div", ["zero", "zero"], "output")],
            r"differs .* by inf .* at .*×.*×",
        ),
        (
            [("Transpose", ["image"], "output")],
            r"gives \(1, 1, 3, 1\), not \(1, 3, 1, 1\), at constant, 1×1×1",
        ),
        (
            [("Reshape", ["image", "distance"], "output")],
            r"onnx\.checker refuses it|cannot load it",
        ),
    ],
    ids=["identity", "nan", "shape", "invalid"],
)
def test_a_wrong_graph_is_refused(tmp_path, monkeypatch, nodes, message) -> None:
    cases = check._cases
    monkeypatch.setattr(check, "_cases", lambda stored: islice(cases(stored), 20))
    module = load_preset("tank-adjusted-1").module()
    path = bare(tmp_path / "wrong.onnx", module, nodes=nodes)
    with pytest.raises(ValueError, match=message):
        check_onnx(path, module)


def test_the_wrong_module_is_refused(frozen, monkeypatch) -> None:
    path, module = frozen
    wider = Underwater(module.medium, (0.5, 60.0), exposure="auto", sides=(32, 144))
    message = r"made for 5 blurs .*, but module asks for .*: it is from another module or"
    with pytest.raises(ValueError, match=message):
        check_onnx(path, wider)
    # at equal parameters only the curve of the encoding differs
    cases = check._cases
    monkeypatch.setattr(check, "_cases", lambda stored: islice(cases(stored), 20))
    options = {"exposure": "auto", "sides": (32, 144)}
    linear = Underwater(module.medium, (NEAR, FAR), module.tolerance, "linear", **options)
    with pytest.raises(ValueError, match="differs from float64 eager"):
        check_onnx(path, linear)


def test_a_module_that_changes_nothing_cannot_be_checked(tmp_path) -> None:
    clear = Medium.from_coefficients((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    module = Underwater(clear, (1.0, 2.0), color_space="linear")
    path = bare(tmp_path / "clear.onnx", module)
    with pytest.raises(ValueError, match="a graph that returns its input would pass"):
        check_onnx(path, module)


def test_a_check_allows_what_single_precision_costs() -> None:
    """Of a published system's lamp: else its file would be refused for PyTorch's own rounding."""
    module = load_preset("jaffe-1990").module(focal_px=1870.0)
    image, ramp = scene(1, 144, 145)[0], torch.linspace(0, 1, 145).expand(1, 1, 144, 145)
    z = torch.where(ramp > 0.5, 5.0, 1.0)
    exact = module.formed(
        image.double(), z.double(), None, module.medium.to(torch.float64), module.plan((144, 145))
    )
    largest = apart(module(image, z), exact)
    plain = Underwater(Medium.from_water("7C"), (NEAR, FAR))
    assert limit_of(plain) == 1e-5 < largest < limit_of(module) == 2e-4
    level = Underwater(plain.medium, (NEAR, FAR), light=Light.ambient(0.5))
    assert limit_of(level) == 1e-5
