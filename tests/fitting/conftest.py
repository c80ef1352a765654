"""Scenes that all these tests share, and their fits, each made by one worker for all."""

import pickle
from collections.abc import Callable
from typing import Any

import pytest
from filelock import FileLock
from fitted import HAZE, LEVELS, STONES, Known, medium, seen, tank, veil_water, veiled

import uwaug


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[], Any]], Any]:
    """What a function makes, by name: made by the first worker that asks for it."""
    folder = tmp_path_factory.getbasetemp()
    if folder.name.startswith("popen-"):
        folder = folder.parent

    def made(name: str, make: Callable[[], Any]) -> Any:
        path = folder / f"{name}.pickle"
        with FileLock(f"{path}.lock"):
            if not path.exists():
                path.write_bytes(pickle.dumps(make()))
        return pickle.loads(path.read_bytes())

    return made


@pytest.fixture(scope="session")
def known() -> Known:
    """The scene in a water that scatters forward."""
    return seen(medium())


@pytest.fixture(scope="session")
def hazy() -> Known:
    """The scene in a water that does not."""
    return seen(medium(**HAZE))


@pytest.fixture(scope="session")
def auto(once, known) -> uwaug.fitting.Fit:
    """All candidates, tried on the scattering water."""
    return once("auto", lambda: uwaug.fit(*known, focal_px=70.0, pixels=2000))


@pytest.fixture(scope="session")
def gaussian(once, known) -> uwaug.fitting.Fit:
    """The model that made the picture."""
    return once("gaussian", lambda: uwaug.fit(*known, model="gaussian", pixels=4000))


@pytest.fixture(scope="session")
def haze(once, hazy) -> uwaug.fitting.Fit:
    """The model that made the picture without forward scatter."""
    return once("haze", lambda: uwaug.fit(*hazy, model="haze", pixels=2000))


@pytest.fixture(scope="session")
def series(once) -> uwaug.fitting.SeriesFit:
    """The model that made the pictures of a tank."""
    options = {"model": "gaussian", "pixels": 5000}
    return once("series", lambda: uwaug.fitting.fit_series(tank(), LEVELS, **options))


@pytest.fixture(scope="session")
def water(once) -> uwaug.fitting.WaterFit:
    """All types and mixtures, tried on a 3C of 5 m."""
    truth = uwaug.Water.jerlov("3C").with_visibility(5)
    constants = uwaug.Scattering.CALIBRATED
    medium = uwaug.Medium.from_water(
        truth,
        vertical_depth=3.0,
        g=constants.g,
        mu=constants.mu,
        point_spread=uwaug.PointSpread.calibrated(0.866 * 105),
        surfaces="spectral",
        tolerance=0,
    )
    return once("water", lambda: uwaug.fitting.fit_water(*seen(medium), pixels=500))


@pytest.fixture(scope="session")
def veil(once) -> uwaug.fitting.VeilFit:
    """The veil in front of stones."""
    return once("veil", lambda: uwaug.fitting.fit_veil(veiled(veil_water()), STONES, darkest=0.0))
