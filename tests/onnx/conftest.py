"""Files that all these tests share, with the modules they were exported from.

Not verified as they are written: `test_files_agree_with_float64_eager` does that.
"""

import os
from pathlib import Path

import pytest
from exporting import FAR, NEAR, PAPERS
from filelock import FileLock

from uwaug import JERLOV_TYPES, Medium, PointSpread, Underwater, Water, load_preset
from uwaug.onnx import export_onnx


@pytest.fixture(scope="session")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("onnx")


@pytest.fixture(scope="session")
def shared(tmp_path_factory) -> Path:
    """A folder of all workers: what one has exported serves the others."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


def exported(module: Underwater, path: Path, **given: str) -> tuple[Path, Underwater]:
    with FileLock(f"{path}.lock"):
        if not path.exists():
            export_onnx(module, path, verify=False, **given)
    return path, module


@pytest.fixture(scope="session")
def frozen(shared) -> tuple[Path, Underwater]:
    """The survey preset as it comes: linear values, no field."""
    module = load_preset("survey", water="7C").module(sides=(32, 1024))
    return exported(module, shared / "frozen.onnx")


@pytest.fixture(scope="session")
def quantised(shared) -> tuple[Path, Underwater]:
    """uint8 in and out, sRGB, with a field; wide blurs of a known exponent below one half."""
    law = PointSpread(9.0, 0.45, reference_size=None)
    medium = Medium.from_water(Water.jerlov("II"), g=0.066, mu=0.1, point_spread=law)
    module = Underwater(medium, (0.5, 12.0))
    return exported(module, shared / "uint8.onnx", field="input", image="uint8")


@pytest.fixture(scope="session")
def waters(shared) -> tuple[Path, Underwater]:
    """One file for the ten types and the paper's presets: parameters and field as inputs, linear
    values.
    """
    media = [load_preset("survey", water=name).medium for name in JERLOV_TYPES]
    media += [load_preset(name).medium for name in PAPERS]
    module = Underwater(Medium.stack(media), (NEAR, FAR), color_space="linear", sides=(32, 1024))
    return exported(module, shared / "waters.onnx", parameters="inputs", field="input")


@pytest.fixture(scope="session")
def calibrated(shared) -> tuple[Path, Underwater]:
    """Heavy tails, sRGB: the calibrated preset, for small pictures."""
    module = load_preset("calibrated").module(sides=(32, 144))
    return exported(module, shared / "calibrated.onnx")


@pytest.fixture(scope="session")
def encoded(shared) -> tuple[Path, Underwater]:
    """Parameters as inputs, sRGB, uint8, no field, px of the image at hand."""
    law = PointSpread(2.0, 1.0)
    module = Underwater(Medium.from_water(Water.jerlov("3C"), point_spread=law), (NEAR, FAR))
    return exported(module, shared / "encoded.onnx", parameters="inputs", image="uint8")
