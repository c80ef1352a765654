import json
from pathlib import Path

import pytest
import torch

import uwaug
from uwaug import Medium, PointSpread, Underwater
from uwaug.onnx import OnnxUnderwater, check_onnx, export_onnx, read_metadata, read_module

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
        assert again.demand == module.demand
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
    path = export_onnx(module, folder / "learned.onnx")
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
