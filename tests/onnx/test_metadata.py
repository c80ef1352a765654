import json
import os

import pytest
import torch
from exporting import FAR, NEAR, bare, scene

import uwaug
from uwaug import Development, Light, Medium, PointSpread, Underwater, load_preset
from uwaug.onnx import OnnxUnderwater, check_onnx, read_metadata, read_module
from uwaug.onnx.graph import Options

# by its version: without the package, "onnx" would be the folder of these tests
onnx = pytest.importorskip("onnx", minversion="1.17")
pytest.importorskip("onnxruntime")

pytestmark = pytest.mark.filterwarnings("ignore:.* that the blur is planned for")


@pytest.fixture
def survey() -> Underwater:
    return load_preset("survey", water="7C").module(sides=(32, 1024))


def test_metadata(survey, tmp_path) -> None:
    metadata = read_metadata(bare(tmp_path / "a.onnx", survey, Options(image="uint8")))
    assert metadata["uwaug_version"] == uwaug.__version__
    assert metadata["uwaug_water"].startswith("7C: 3 + 2 rates")
    assert json.loads(metadata["uwaug_distance_range_m"]) == list(survey.distance_range)
    assert json.loads(metadata["uwaug_sides_px"]) == [32, 1024]
    assert float(metadata["uwaug_tolerance"]) == 0.002
    assert (metadata["uwaug_color_space"], metadata["uwaug_parameters"]) == ("linear", "frozen")
    assert (metadata["uwaug_field"], metadata["uwaug_image"]) == ("none", "uint8")
    assert metadata["uwaug_minimum_size"] == "1x1"
    assert metadata["uwaug_plan"] == str(survey.plan((512, 512)))
    assert "metres" in metadata["uwaug_units"]


def learned() -> Underwater:
    law = PointSpread(torch.tensor([1.5]), torch.tensor([0.8]))
    medium = Medium.from_coefficients(
        (1.0, 0.8, 0.9), (0.4, 0.3, 0.5), (0.1, 0.3, 0.4), b_mean=0.5, point_spread=law
    )
    return Underwater(medium, (1.0, 4.0), learnable=True)


def lit() -> Underwater:
    light = Light.ambient() + Light.lamp((0.3, -0.2, 0.0), (0, 0, 1), power=4.0, cone=40.0)
    medium = Medium.from_water("7C", vertical_depth=10.0)
    options = {"light": light, "focal_px": 70.0, "centre": (10.0, 9.0), "exposure": 1.0}
    return Underwater(medium, (NEAR, FAR), sides=(32, 64), **options)


def developed() -> Underwater:
    medium = Medium.from_water("II", vertical_depth=5.0, surfaces="spectral", color_matrix=0.6)
    development = Development(-0.5, 0.6, 1.2, 0.4, 0.8, 1.1)
    return Underwater(medium, (NEAR, FAR), sides=(32, 64), development=development)


@pytest.mark.parametrize(
    "module",
    [
        lambda: load_preset("survey", water="7C").module(sides=(32, 1024)),
        lambda: load_preset("calibrated").module(sides=(32, 144)),
        lambda: Underwater(Medium.stack([load_preset("survey").medium] * 2), (NEAR, FAR), 0.01),
        learned,
        lit,
        developed,
    ],
    ids=["survey", "calibrated", "stack", "learned", "lamp", "developed"],
)
def test_the_module_comes_back_from_its_file(module, tmp_path) -> None:
    module = module()
    if module.sides is None:
        module = Underwater(module.medium, module.distance_range, 0.01, sides=(32, 100))
    options = Options() if len(module.medium) == 1 else Options(parameters="inputs")
    again = read_module(bare(tmp_path / "a.onnx", module, options))
    assert again.plan((64, 80)) == module.plan((64, 80))
    for name in ("sides", "distance_range", "color_space", "exposure", "tolerance", "pinhole"):
        assert getattr(again, name) == getattr(module, name), name
    assert again.medium.notes == module.medium.notes
    assert str(again.medium.point_spread) == str(module.medium.point_spread)
    image, distance, _ = scene(len(module.medium))
    torch.testing.assert_close(again(image, distance), module(image, distance), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ({"uwaug_module": None}, "its metadata lack uwaug_module: export it again"),
        ({"uwaug_format": None}, "no metadata"),
        (
            {"uwaug_format": "99", "uwaug_version": "7.1"},
            r"format 99 from uwaug 7\.1, but this version reads format 2",
        ),
    ],
)
def test_metadata_of_another_file_are_refused(survey, tmp_path, metadata, message) -> None:
    path = bare(tmp_path / "a.onnx", survey, **metadata)
    calls = (read_metadata, OnnxUnderwater, read_module, lambda p: check_onnx(p, survey))
    for call in calls:
        with pytest.raises(ValueError, match=rf"a\.onnx: .*{message}"):
            call(path)


@pytest.mark.parametrize(
    "metadata",
    [
        {"uwaug_module": "[" * 100_000},
        {"uwaug_module": "{}"},
        {"uwaug_module": '{"medium": NaN}'},
        {"uwaug_sides_px": "[9, 3]"},
        {"uwaug_tolerance": "x"},
        {"uwaug_color_space": "rgb"},
        {"uwaug_image": "float64"},
    ],
)
def test_damaged_metadata_are_refused(survey, tmp_path, metadata) -> None:
    path = bare(tmp_path / "a.onnx", survey, **metadata)
    for call in (OnnxUnderwater, read_module, lambda p: check_onnx(p, survey)):
        with pytest.raises(ValueError, match=r"a\.onnx: its metadata are damaged"):
            call(path)


def test_what_is_no_model_is_refused(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe.onnx")
    (tmp_path / "no.onnx").write_text("no model")
    for call in (read_metadata, OnnxUnderwater, read_module):
        with pytest.raises(OSError, match=r"path must be a file, but .* is no regular file"):
            call(tmp_path / "pipe.onnx")
        with pytest.raises(ValueError, match="ONNX Runtime cannot load it"):
            call(tmp_path / "no.onnx")
        with pytest.raises(FileNotFoundError):
            call(tmp_path / "missing.onnx")
