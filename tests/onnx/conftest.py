"""Three files that all these tests share, with the modules they were exported from.

Not verified as they are written: `test_files_agree_with_float64_eager` does that.
"""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from exporting import COARSE, FAR, NEAR, PAPERS
from filelock import FileLock

from uwaug import JERLOV_TYPES, Light, Medium, PointSpread, Underwater, load_preset
from uwaug.onnx import export_onnx

File = tuple[Path, Underwater]


@pytest.fixture(scope="session")
def exported(tmp_path_factory) -> Callable[..., File]:
    """Write a file once for all workers."""
    folder = tmp_path_factory.getbasetemp()
    folder = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder

    def export(name: str, module: Underwater, **options: str) -> File:
        path = folder / name
        with FileLock(f"{path}.lock"):
            if not path.exists():
                export_onnx(module, path, verify=False, **options)
        return path, module

    return export


@pytest.fixture(scope="session")
def frozen(exported) -> File:
    """sRGB, heavy tails, an automatic exposure: four blurs, one wider than a picture."""
    medium = load_preset("calibrated").medium
    module = Underwater(medium, (NEAR, FAR), COARSE, exposure="auto", sides=(32, 144))
    return exported("frozen.onnx", module)


@pytest.fixture(scope="session")
def waters(exported) -> File:
    """One file for the ten types and the paper's presets: parameters and field as inputs, linear
    values.
    """
    media = [load_preset("survey", water=name).medium for name in JERLOV_TYPES]
    media += [load_preset(name).medium for name in PAPERS]
    module = Underwater(Medium.stack(media), (NEAR, FAR), COARSE, "linear", sides=(32, 1024))
    return exported("waters.onnx", module, parameters="inputs", field="input")


@pytest.fixture(scope="session")
def lamp(exported) -> File:
    """uint8 under daylight, a lamp and a sun, with a field; a kernel of few taps."""
    medium = Medium.from_water("7C", vertical_depth=10.0, point_spread=PointSpread(0.7))
    light = Light.ambient() + Light.lamp((0.3, -0.2, 0.0), (-0.05, 0.05, 1.0), power=4.0, cone=40.0)
    light += Light.parallel(40, 20, gradient=0.2)
    options = {"light": light, "focal_px": 70.0, "exposure": 1.0, "sides": (1, 144)}
    module = Underwater(medium, (NEAR, FAR), COARSE, **options)
    return exported("lamp.onnx", module, field="input", image="uint8")
