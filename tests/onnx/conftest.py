"""Two files that all these tests share, with the modules they were exported from."""

import os
from pathlib import Path

import pytest
from exporting import COARSE, FAR, NEAR
from filelock import FileLock

from uwaug import Development, Medium, PointSpread, Sensor, Underwater
from uwaug.onnx import export_onnx

File = tuple[Path, Underwater]


def exported(tmp_path_factory, name: str, module: Underwater, **options: bool) -> File:
    """Write a file once for all workers."""
    folder = tmp_path_factory.getbasetemp()
    folder = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder
    path = folder / name
    with FileLock(f"{path}.lock"):
        if not path.exists():
            export_onnx(module, path, **options)
    return path, module


@pytest.fixture(scope="session")
def frozen(tmp_path_factory) -> File:
    """sRGB, surfaces with spectra, a whole development, noise; a blur wider than a picture."""
    law = PointSpread(40.0, 0.62, "exponential")
    medium = Medium.from_water("7C", g=0.05, point_spread=law, surfaces="spectral")
    noise = Sensor(2000, seed=4)
    development = Development(0.5, 0.5, 1.2, 0.7, 1.1, metered=True, noise=noise)
    module = Underwater(medium, (NEAR, FAR), 0.1, sides=(32, 144), development=development)
    return exported(tmp_path_factory, "frozen.onnx", module)


@pytest.fixture(scope="session")
def waters(tmp_path_factory) -> File:
    """One file for many waters: the coefficients are inputs, values linear."""
    media = [Medium.from_water(name) for name in ("I", "II", "1C", "7C")]
    module = Underwater(Medium.stack(media), (NEAR, FAR), COARSE, "linear", sides=(32, 518))
    return exported(tmp_path_factory, "waters.onnx", module, coefficients=True)
