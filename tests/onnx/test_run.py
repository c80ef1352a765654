"""The runner of exported files."""

import copy
import multiprocessing
import os
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from exporting import Pictures, scene, without_graph
from torch.utils.data import DataLoader

from uwaug import MarineSnow, Medium, PointSpread, Underwater
from uwaug.onnx import OnnxUnderwater, check_onnx, read_metadata

# by its version: without the package, "onnx" would be the folder of these tests
pytest.importorskip("onnx", minversion="1.17")
pytest.importorskip("onnxruntime")

MEDIUM = Medium.from_water("7C")


def test_it_has_the_shapes_of_the_module(frozen) -> None:
    path, module = frozen
    run = OnnxUnderwater(path)
    image, distance = scene(2)
    for i, d in (
        (image[:1], distance),
        (image, distance[0]),
        (image[0], distance[0]),
        (image[:0], distance[:0]),
        (image[..., :0], distance[..., :0]),
    ):
        assert run(i, d).shape == module(i, d).shape


def test_arrays_and_other_types_are_taken(frozen) -> None:
    run, (image, distance) = OnnxUnderwater(frozen[0], threads=1), scene(1)
    wanted = run(image, distance)
    of_array = run(image.numpy(), distance.double().numpy())
    assert isinstance(of_array, np.ndarray)
    np.testing.assert_array_equal(of_array, wanted.numpy())
    torch.testing.assert_close(run(image.double(), distance), wanted, rtol=0, atol=0)
    of_bytes, exact = (255 * image).byte(), frozen[1]((255 * image).byte(), distance)
    assert run(of_bytes, distance).dtype == torch.uint8
    assert (run(of_bytes, distance).int() - exact.int()).abs().max() <= 1
    np.testing.assert_array_equal(run(of_bytes.numpy(), distance), run(of_bytes, distance))


def test_what_does_not_suit_a_file_is_refused(frozen, waters) -> None:
    image, distance = scene(2)
    run, serve = OnnxUnderwater(frozen[0]), OnnxUnderwater(waters[0])
    absolute = replace(MEDIUM, law=PointSpread(1.0).law)
    spectral = Medium.from_water("7C", surfaces="spectral")
    wide = replace(MEDIUM, scale=6 * MEDIUM.scale)
    for call, message in (
        (lambda: run(image, distance, MEDIUM), "the file takes none: export with coefficients"),
        (lambda: serve(image, distance), "medium: the file needs one"),
        (lambda: serve(image, distance, absolute), r"its law must be Law\(.*, got Law"),
        (lambda: serve(image, distance, MEDIUM.with_snow(MarineSnow())), "marine snow, which no"),
        (lambda: serve(image, distance, wide), "its widths lie beyond the plan of the file"),
        (lambda: serve(image, distance, spectral), "medium must be of grey surfaces"),
        (lambda: run(255 * image, distance), "divide a 0…255 image by 255"),
        (lambda: run(image, distance[..., 1:]), r"distance is \(45, 61\) but image is \(45, 62\)"),
        (lambda: run(image, -distance), "negative"),
        (lambda: run(torch.cat([image, image[:1]]), distance), "batch sizes must agree or be 1"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            call()


def test_a_file_of_spectra_takes_media_of_grey_surfaces(tmp_path, monkeypatch) -> None:
    module = Underwater(Medium.from_water("7C", surfaces="spectral"), sides=(32, 144))
    path = without_graph(tmp_path / "a.onnx", module, uwaug_coefficients="inputs")
    run = OnnxUnderwater(path)
    given: dict[str, torch.Tensor] = {}
    monkeypatch.setattr(run, "session", lambda rows: given.update(rows) or rows["image"])
    run(*scene(1), medium=MEDIUM)
    for name in ("direct_weights", "signal_weights"):
        assert given[name].shape[:3] == (1, 3, 3)


def test_copies_after_use_and_in_a_worker(frozen) -> None:
    run, (image, distance) = OnnxUnderwater(frozen[0], threads=1), scene(4)
    here = torch.stack([run(image[i], distance[i]) for i in range(4)])
    for copied in (copy.deepcopy(run), pickle.loads(pickle.dumps(run))):
        assert torch.equal(copied(image[0], distance[0]), here[0])
    loader = DataLoader(Pictures(run), 2, num_workers=1, multiprocessing_context="spawn")
    torch.testing.assert_close(torch.cat(list(loader)), here, rtol=0, atol=1e-6)


def test_a_forked_process_opens_its_own(frozen) -> None:
    """What it inherits has no threads."""
    run, (image, distance) = OnnxUnderwater(frozen[0], threads=2), scene(1)
    wanted = run(image, distance)
    found: Any = multiprocessing.get_context("fork").Queue()
    work = multiprocessing.get_context("fork").Process(
        target=lambda: found.put(run(image, distance).numpy())
    )
    work.start()
    np.testing.assert_allclose(found.get(timeout=60), wanted.numpy(), atol=1e-6)
    work.join(60)
    assert work.exitcode == 0


NETWORK = '{"setting": {"kind": "Network", "model": "stranger/a:b.onnx"}}'
DAMAGED = {
    None: "has no metadata of",
    "[" * 100_000: "its metadata are damaged",
    "{}": "its metadata are damaged",
    '{"setting": 1, "sides": [9, 3]}': "its metadata are damaged",
    NETWORK: r"its metadata are damaged .*kind must be Setting, got 'Network'",
}


def test_other_files_are_refused(tmp_path) -> None:
    path = tmp_path / "a.onnx"
    for metadata, message in DAMAGED.items():
        without_graph(path, Underwater(MEDIUM, sides=(32, 64)), uwaug_module=metadata)
        for call in (OnnxUnderwater, check_onnx):
            with pytest.raises(ValueError, match=rf"a\.onnx: {message}"):
                call(path)
    os.mkfifo(tmp_path / "pipe.onnx")
    (tmp_path / "no.onnx").write_text("no model")
    for call in (read_metadata, OnnxUnderwater):
        with pytest.raises(OSError, match="path must be a regular file"):
            call(tmp_path / "pipe.onnx")
        with pytest.raises(ValueError, match="ONNX Runtime cannot load it"):
            call(tmp_path / "no.onnx")
        with pytest.raises(FileNotFoundError):
            call(tmp_path / "missing.onnx")
