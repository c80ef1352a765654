import math
import pickle
import sys
from typing import Any

import numpy as np
import pytest
import torch
from networks import mean_of_channels, save
from onnx import TensorProto, helper
from PIL import Image
from scenes import rand

from uwaug.distance import Network, from_inverse
from uwaug.distance.network import _ADDRESS, _TRIED

SMALL = _ADDRESS, _TRIED


def side_lengths(path, shape) -> str:
    """1000·height + width of the input, at every pixel."""
    nodes = [
        helper.make_node("Shape", ["x"], ["h"], start=2, end=3),
        helper.make_node("Shape", ["x"], ["w"], start=3, end=4),
        helper.make_node("Constant", [], ["thousand"], value_ints=[1000]),
        helper.make_node("Mul", ["h", "thousand"], ["rows"]),
        helper.make_node("Add", ["rows", "w"], ["sides"]),
        helper.make_node("Cast", ["sides"], ["number"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMean", ["x", "axis"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
        helper.make_node("Add", ["nothing", "number"], ["y"]),
    ]
    return save(path, nodes, shape)


@pytest.mark.parametrize("keepdims", [0, 1])
def test_normalises_and_keeps_pixels_in_place(tmp_path, keepdims) -> None:
    image = rand(2, 3, 5, 7).float()
    path = mean_of_channels(tmp_path / "n.onnx", keepdims=keepdims)
    network = Network(path, short_side=5, multiple=1)
    mean, std = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
    normalised = (image.numpy() - mean[:, None, None]) / std[:, None, None]
    expected = normalised.mean(1, keepdims=True)
    depth = network(image)
    assert depth.shape == (2, 1, 5, 7)
    np.testing.assert_allclose(depth.numpy(), expected, atol=1e-5)
    np.testing.assert_allclose(network(image[1]).numpy(), expected[1], atol=1e-5)
    assert network(image[:0]).shape == (0, 1, 5, 7)
    assert network(image.double()).dtype == torch.float64
    assert not network(image.requires_grad_()).requires_grad


@pytest.mark.parametrize(
    "shape, size, options, seen",
    [
        ((1, 3, "h", "w"), (100, 150), {}, (518, 784)),
        ((1, 3, "h", "w"), (60, 40), {"short_side": 64, "multiple": 32}, (96, 64)),
        ((1, 3, "h", "w"), (10, 400), {"short_side": 28}, (14, 112)),
        ((1, 3, "h", "w"), (1, 3000), {}, (14, 2072)),
        ((1, 3, 21, 33), (60, 40), {}, (21, 33)),
        (("b", 3, 21, "w"), (20, 40), {"short_side": 20, "multiple": 5}, (21, 40)),
    ],
)
def test_gives_the_network_the_size_it_needs(tmp_path, shape, size, options, seen) -> None:
    network = Network(side_lengths(tmp_path / "n.onnx", shape), **options)
    depth = network(torch.rand(3, *size))
    assert depth.shape == (1, *size)
    assert torch.equal(depth.round(), torch.full((1, *size), 1000.0 * seen[0] + seen[1]))


def test_resizing_keeps_the_orientation(tmp_path) -> None:
    path = mean_of_channels(tmp_path / "n.onnx", shape=(1, 3, 32, 48))
    rows, columns = torch.linspace(0.2, 0.6, 64)[:, None], torch.linspace(0, 0.3, 80)
    image = (rows + columns).expand(3, 64, 80).clone()
    depth = Network(path, mean=(0, 0, 0), std=(1, 1, 1))(image)
    assert (depth[0] - image[0])[2:-2, 2:-2].abs().max() < 2e-3
    assert from_inverse(depth, 1.0, 5.0)[0, -1, -1].item() == pytest.approx(1.0)


def test_pickles_with_and_without_a_session(tmp_path) -> None:
    network = Network(mean_of_channels(tmp_path / "n.onnx"), short_side=6, multiple=3)
    image = rand(3, 6, 9)
    before = pickle.loads(pickle.dumps(network))
    expected = network(image)
    after = pickle.loads(pickle.dumps(network))
    assert torch.equal(before(image), expected)
    assert torch.equal(after(image), expected)


@pytest.mark.parametrize(
    "image, message",
    [
        (torch.arange(256.0).expand(3, 2, 256), r"in \[0, 1\], got 0 to 255: divide by 255"),
        (torch.full((3, 2, 2), math.nan), r"image must lie in \[0, 1\], got NaN only"),
        (torch.zeros(3, 8, 8, dtype=torch.uint8), r"a floating-point tensor, got torch\.uint8"),
        (torch.zeros(8, 8, 3), r"must have shape \(3, H, W\) or \(B, 3, H, W\), got"),
        (torch.zeros(1, 1, 3, 8, 8), r"must have shape \(3, H, W\) or \(B, 3, H, W\), got"),
    ],
)
def test_refused_images(tmp_path, image, message) -> None:
    network = Network(mean_of_channels(tmp_path / "n.onnx"))
    with pytest.raises((TypeError, ValueError), match=message):
        network(image)


@pytest.fixture
def hub(tmp_path, monkeypatch) -> list[Any]:
    """A hub that has one network, or the errors that are put into the list; and its requests."""
    asked: list[Any] = []
    path = mean_of_channels(tmp_path / "n.onnx")

    def download(*file: str, revision: str | None) -> str:
        if asked and isinstance(asked[-1], Exception):
            raise asked[-1]
        asked.append((*file, revision))
        return path

    monkeypatch.setattr("huggingface_hub.hf_hub_download", download)
    return asked


@pytest.mark.parametrize(
    "model, expected",
    [
        ("depth-anything-v2-small", (*SMALL[0].split(":"), SMALL[1])),
        ("me/mine:a/b.onnx", ("me/mine", "a/b.onnx", None)),
    ],
)
def test_files_of_the_hub(hub, model, expected) -> None:
    network = Network(model, short_side=28)
    assert not hub  # as a stranger's preset may name any
    assert network(torch.rand(3, 28, 42)).shape == (1, 28, 42)
    assert hub == [expected]


def test_what_the_hub_does_not_give(hub, run, tmp_path, monkeypatch) -> None:
    hub.append(RuntimeError("401 Error.\n\nGated: log in"))
    with pytest.raises(
        FileNotFoundError, match=r"me/mine:b could not be .*: 401 Error. Gated: log"
    ):
        Network("me/mine:b")(torch.rand(3, 8, 8))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "photos").mkdir()
    Image.new("RGB", (8, 8)).save("photos/a.png")
    code, _, err = run("degrade", "photos", "--distance", "depth-anything", "--out", "wet")
    assert code == 1
    assert err.startswith(f"Error: {SMALL[0]} could not be fetched: 401 Error.")
    assert not (tmp_path / "wet").exists()


@pytest.mark.parametrize(
    "module, words", [("onnxruntime", r"\[onnx\]"), ("huggingface_hub", r"_hub is .*\[hub\]")]
)
def test_says_what_to_install(tmp_path, monkeypatch, module, words) -> None:
    path = mean_of_channels(tmp_path / "n.onnx")
    model = path if module == "onnxruntime" else "depth-anything-v2-small"
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=words):
        Network(model)(torch.rand(3, 8, 8))


NO_ADDRESS = r"model must be an ONNX file, depth-anything-v2-small, or owner/name:file"
REFUSED: list[tuple[Any, dict[str, Any], str]] = [
    ("missing.onnx", {}, NO_ADDRESS),
    ("me/mine/b.onnx", {}, NO_ADDRESS),
    ("depth-anything-v3", {}, NO_ADDRESS),
    ((1, 3, "h", "w"), {"short_side": 0}, "short_side must be finite and ≥ 1, got 0"),
    ((1, 3, "h", "w"), {"multiple": 0}, "multiple must be finite and ≥ 1, got 0"),
    ((1, 8, 8, 3), {}, r"must take \(1, 3, h, w\) of floating point, got"),
    ((1, 4, 8, 8), {}, r"must take \(1, 3, h, w\)"),
    ((3, 8, 8), {}, r"must take \(1, 3, h, w\)"),
    (b"root:x:0:0", {}, "n.onnx: ONNX Runtime cannot load it"),
    ("three channels", {}, r"must give \(1, h, w\) or .*, got \(1, 3, 518, 518\)"),
]


@pytest.mark.parametrize("model, options, message", REFUSED)
def test_refused_networks(hub, tmp_path, model, options, message) -> None:
    path = tmp_path / "n.onnx"
    if isinstance(model, tuple):
        model = mean_of_channels(path, model)
    elif isinstance(model, bytes):
        path.write_bytes(model)
        model = path
    elif model == "three channels":
        copied = helper.make_node("Identity", ["x"], ["y"])
        model = save(path, [copied], (1, 3, "h", "w"), 4)
    with pytest.raises((FileNotFoundError, ValueError), match=message):
        Network(model, **options)(torch.rand(3, 8, 8))
    assert not hub


def test_sides_without_numbers_are_free(tmp_path) -> None:
    network = Network(mean_of_channels(tmp_path / "n.onnx", ("b", "c", "h", "w")))
    assert network(torch.rand(3, 8, 8)).shape == (1, 8, 8)
