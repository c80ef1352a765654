import copy
import json
import math
import os
import random
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
import torch

import uwaug
from uwaug import Medium, PointSpread, Underwater
from uwaug.onnx import OnnxUnderwater, check, check_onnx, export_onnx, read_metadata, read_module

# by its version: without the package, "onnx" would be the folder of these tests
onnx = pytest.importorskip("onnx", minversion="1.17")
pytest.importorskip("onnxruntime")


def test_metadata(frozen) -> None:
    path, module = frozen
    found = read_metadata(path)
    assert found["uwaug_version"] == uwaug.__version__
    assert found["uwaug_water"].startswith("7C: 3 + 2 rates")
    assert json.loads(found["uwaug_distance_range_m"]) == list(module.distance_range)
    assert json.loads(found["uwaug_sides_px"]) == [32, 1024]
    assert float(found["uwaug_tolerance"]) == 0.002
    assert (found["uwaug_color_space"], found["uwaug_parameters"]) == ("linear", "frozen")
    assert (found["uwaug_field"], found["uwaug_image"]) == ("none", "float32")
    assert found["uwaug_minimum_size"] == "1x1"
    assert "blurs for σ" in found["uwaug_plan"]
    assert "metres" in found["uwaug_units"]


def test_the_module_comes_back_from_the_file(frozen, waters) -> None:
    for path, module in (frozen, waters):
        again = read_module(path)
        assert again.plan((64, 80)) == module.plan((64, 80))
        assert (again.sides, again.distance_range) == (module.sides, module.distance_range)
        pairs = zip(again.medium.tensors(), module.medium.tensors(), strict=True)
        assert all(torch.equal(a, b) for a, b in pairs)
        assert again.medium.notes == module.medium.notes
        assert str(again.medium.point_spread) == str(module.medium.point_spread)
        assert again.color_space == module.color_space


def test_a_learned_module_comes_back_from_the_file(folder) -> None:
    law = PointSpread(torch.tensor([1.5]), torch.tensor([0.8]))
    medium = Medium.from_coefficients(
        (1.0, 0.8, 0.9), (0.4, 0.3, 0.5), (0.1, 0.3, 0.4), b_mean=0.5, point_spread=law
    )
    module = Underwater(medium, (1.0, 4.0), learnable=True)
    path = export_onnx(module, folder / "learned.onnx", verify=False)
    assert check_onnx(path, read_module(path)).worst < 1e-5


def test_the_calibrated_law_comes_back_from_its_file(calibrated) -> None:
    path, module = calibrated
    law = module.medium.point_spread
    assert law.shape == "exponential"
    assert read_module(path).medium.point_spread == law
    assert read_module(path).plan((64, 80)) == module.plan((64, 80))


@pytest.fixture
def altered(frozen, tmp_path):
    """Write a changed copy of the frozen file."""

    def write(change) -> Path:
        model = onnx.load(frozen[0])
        change(model)
        onnx.save(model, tmp_path / "altered.onnx")
        return tmp_path / "altered.onnx"

    return write


def changed(value: Any, rng: random.Random) -> Any:
    """A copy of JSON in which one thing, somewhere, is another."""
    odd = [None, True, -1, 0, 2.5, 1e9, 1e308, 5e-324, math.nan, math.inf, 10**400, "x", "9" * 5000]
    odd += [[], {}, [[]], [0.1, 2], {"shape": 1}, [[[[0.0]]]]]
    if isinstance(value, (dict, list)) and value and rng.random() < 0.9:
        value = copy.copy(value)
        key = rng.choice(list(value) if isinstance(value, dict) else range(len(value)))
        if rng.random() < 0.2:
            del value[key]
        else:
            value[key] = changed(value[key], rng)
        return value
    if isinstance(value, float) and rng.random() < 0.5:
        return value * rng.choice([-1.0, 0.5, 1e3, 1e-9])
    return rng.choice(odd)


def altered_entry(entry: Any, rng: random.Random) -> None:
    """Alter what an entry of the metadata says."""
    try:
        value = json.loads(entry.value)
    except ValueError:
        entry.value = rng.choice(["", "x", entry.value[:-1], "inputs", "nan"])
        return
    entry.value = json.dumps(changed(value, rng))
    if rng.random() < 0.1:
        at = rng.randrange(len(entry.value))
        entry.value = entry.value[:at] + rng.choice('[]{},:0-e"') + entry.value[at + 1 :]


def test_altered_metadata_are_errors_of_value(altered, monkeypatch) -> None:
    whole = check._cases
    # the widest blurs and the smallest pictures find all there is to find
    monkeypatch.setattr(check, "_cases", lambda stored: islice(whole(stored), 2))
    refused = 0
    for seed in range(400):
        rng = random.Random(seed)

        def alter(model, rng=rng) -> None:
            entries = [e for e in model.metadata_props if e.key.startswith("uwaug_")]
            module = next(e for e in entries if e.key == "uwaug_module")
            altered_entry(module if rng.random() < 0.7 else rng.choice(entries), rng)

        path = altered(alter)
        with suppress(OSError, ValueError):
            OnnxUnderwater(path)
            check_onnx(path, read_module(path))
            refused -= 1
        refused += 1
    assert refused > 200


def test_lacking_metadata_are_named(altered) -> None:
    def without(model) -> None:
        kept = [e for e in model.metadata_props if e.key != "uwaug_module"]
        del model.metadata_props[:]
        model.metadata_props.extend(kept)

    path = altered(without)
    message = r"altered\.onnx: its metadata lack uwaug_module: export it again"
    for call in (read_metadata, OnnxUnderwater, read_module):
        with pytest.raises(ValueError, match=message):
            call(path)


def test_a_deeply_nested_entry_is_refused(altered) -> None:
    def nested(model) -> None:
        for entry in model.metadata_props:
            if entry.key == "uwaug_module":
                entry.value = "[" * 100_000

    path = altered(nested)
    for call in (OnnxUnderwater, read_module):
        with pytest.raises(ValueError, match="its metadata are damaged"):
            call(path)


def test_a_pipe_is_refused_before_it_is_opened(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe.onnx")
    for call in (read_metadata, OnnxUnderwater, read_module):
        with pytest.raises(OSError, match=r"path must be a file, but .* is no regular file"):
            call(tmp_path / "pipe.onnx")


def test_a_file_of_another_format_is_refused(altered, tmp_path) -> None:
    newer = {"uwaug_format": "99", "uwaug_version": "7.1"}

    def other(model) -> None:
        for entry in model.metadata_props:
            entry.value = newer.get(entry.key, entry.value)

    for call in (read_metadata, OnnxUnderwater, read_module, lambda p: check_onnx(p, uwaug)):
        message = r"format 99 from uwaug 7\.1, but this version reads format 2"
        with pytest.raises(ValueError, match=message):
            call(altered(other))
        with pytest.raises(ValueError, match="no metadata"):
            call(altered(lambda model: model.ClearField("metadata_props")))
    (tmp_path / "no.onnx").write_text("no model")
    with pytest.raises(ValueError, match="ONNX Runtime cannot load it"):
        OnnxUnderwater(tmp_path / "no.onnx")
    with pytest.raises(FileNotFoundError):
        OnnxUnderwater(tmp_path / "missing.onnx")
