import math
import pickle
import sys
from typing import Any

import pytest
import torch
from networks import mean_of_channels, save
from onnx import helper
from PIL import Image
from scenes import rand
from torch import Tensor

from uwaug._support.onnx_session import Session
from uwaug.distance import Network, from_inverse
from uwaug.distance.network import _ADDRESS, _TRIED

SMALL = _ADDRESS, _TRIED


@pytest.mark.parametrize("keepdims", [0, 1])
def test_normalises_and_keeps_pixels_in_place(tmp_path, keepdims) -> None:
    image = rand(2, 3, 5, 7).float()
    path = mean_of_channels(tmp_path / "n.onnx", keepdims=keepdims)
    network = Network(path, short_side=5, multiple=1)
    mean, std = torch.tensor([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]])[:, :, None, None]
    expected = ((image - mean) / std).mean(1, keepdim=True)
    unopened = pickle.loads(pickle.dumps(network))
    depth = network(image)
    torch.testing.assert_close(depth, expected, rtol=0, atol=1e-5)
    torch.testing.assert_close(network(image[1]), expected[1], rtol=0, atol=1e-5)
    assert network(image[:0]).shape == (0, 1, 5, 7)
    assert network(image.double()).dtype == torch.float64
    assert not network(image.requires_grad_()).requires_grad
    for copied in (unopened, pickle.loads(pickle.dumps(network))):
        assert torch.equal(copied(image), depth)


@pytest.mark.parametrize(
    "shape, size, options, seen",
    [
        ((1, 3, "h", "w"), (100, 150), {}, (518, 784)),
        ((1, 3, "h", "w"), (60, 40), {"short_side": 64, "multiple": 32}, (96, 64)),
        ((1, 3, "h", "w"), (10, 400), {"short_side": 28}, (14, 112)),
        ((1, 3, "h", "w"), (1, 3000), {}, (14, 2072)),
        ((1, 3, 21, 33), (60, 40), {}, (21, 33)),
        (("b", "c", 21, "w"), (20, 40), {"short_side": 20, "multiple": 5}, (21, 40)),
    ],
)
def test_gives_the_network_the_size_it_needs(
    tmp_path, monkeypatch, shape, size, options, seen
) -> None:
    network = Network(mean_of_channels(tmp_path / "n.onnx", shape), **options)
    asked: list[Any] = []
    ask = Session.__call__

    def spied(session, inputs):
        asked.extend(tuple(x.shape) for x in inputs.values())
        return ask(session, inputs)

    monkeypatch.setattr(Session, "__call__", spied)
    assert network(torch.rand(3, *size)).shape == (1, *size)
    assert asked == [(1, 3, *seen)]


def test_resizing_keeps_the_orientation(tmp_path) -> None:
    path = mean_of_channels(tmp_path / "n.onnx", shape=(1, 3, 32, 48))
    rows, columns = torch.linspace(0.2, 0.6, 64)[:, None], torch.linspace(0, 0.3, 80)
    image = (rows + columns).expand(3, 64, 80).clone()
    depth = Network(path, mean=(0, 0, 0), std=(1, 1, 1))(image)
    assert (depth[0] - image[0])[2:-2, 2:-2].abs().max() < 2e-3
    assert from_inverse(depth, 1.0, 5.0)[0, -1, -1].item() == pytest.approx(1.0)


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
    monkeypatch.chdir(tmp_path)
    (tmp_path / "photos").mkdir()
    Image.new("RGB", (8, 8)).save("photos/a.png")
    code, _, err = run("degrade", "photos", "--distance", "depth-anything", "--out", "wet")
    assert code == 1
    assert err.startswith(f"Error: {SMALL[0]} could not be fetched: 401 Error. Gated: log")
    assert not (tmp_path / "wet").exists()


ANY_SIDES = (1, 3, "h", "w")
PICTURE = torch.rand(3, 8, 8)


@pytest.mark.parametrize("module", ["onnxruntime", "huggingface_hub"])
def test_says_what_to_install(tmp_path, monkeypatch, module) -> None:
    path = mean_of_channels(tmp_path / "n.onnx")
    model = path if module == "onnxruntime" else "depth-anything-v2-small"
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=r"\[onnx\]|\[hub\]"):
        Network(model)(PICTURE)


NO_ADDRESS = r"model must be an ONNX file, depth-anything-v2-small, or owner/name:file"
REFUSED: list[tuple[Any, dict[str, Any], Tensor, str]] = [
    ("missing.onnx", {}, PICTURE, NO_ADDRESS),
    ("depth-anything-v3", {}, PICTURE, NO_ADDRESS),
    (ANY_SIDES, {"short_side": 0}, PICTURE, "short_side must be finite and ≥ 1, got 0"),
    (ANY_SIDES, {"multiple": 0}, PICTURE, "multiple must be finite and ≥ 1, got 0"),
    ((1, 8, 8, 3), {}, PICTURE, r"must take \(1, 3, h, w\) of floating point, got"),
    ((1, 4, 8, 8), {}, PICTURE, r"must take \(1, 3, h, w\)"),
    (b"root:x:0:0", {}, PICTURE, "n.onnx: ONNX Runtime cannot load it"),
    ("three channels", {}, PICTURE, r"must give \(1, h, w\) or .*, got \(1, 3, 518, 518\)"),
    (ANY_SIDES, {}, 255 * PICTURE.ceil(), r"in \[0, 1\], got 255 to 255: divide by 255"),
    (ANY_SIDES, {}, math.nan * PICTURE, r"image must lie in \[0, 1\], got NaN only"),
    (ANY_SIDES, {}, PICTURE.byte(), r"a floating-point tensor, got torch\.uint8"),
    (ANY_SIDES, {}, PICTURE.movedim(0, -1), r"must have shape \(3, H, W\) or \(B, 3, H, W\)"),
    (ANY_SIDES, {}, PICTURE[None, None], r"must have shape \(3, H, W\) or \(B, 3, H, W\)"),
]


@pytest.mark.parametrize("model, options, picture, message", REFUSED)
def test_what_is_refused(hub, tmp_path, model, options, picture, message) -> None:
    path = tmp_path / "n.onnx"
    if isinstance(model, tuple):
        model = mean_of_channels(path, model)
    elif isinstance(model, bytes):
        path.write_bytes(model)
        model = path
    elif model == "three channels":
        copied = helper.make_node("Identity", ["x"], ["y"])
        model = save(path, [copied], (1, 3, "h", "w"), 4)
    with pytest.raises((FileNotFoundError, TypeError, ValueError), match=message):
        Network(model, **options)(picture)
    assert not hub
