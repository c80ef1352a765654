"""Scenes that all these tests share, and their fits."""

import pytest
from fitted import HAZE, STONES, Known, medium, seen, veil_water, veiled

import uwaug
from uwaug.fitting import Fit, fit_veil, fit_water
from uwaug.optics.scattering import Scattering


@pytest.fixture(scope="session")
def known() -> Known:
    """The scene in a water that scatters forward."""
    return seen(medium())


@pytest.fixture(scope="session")
def hazy() -> Known:
    """The scene in a water that does not."""
    return seen(medium(**HAZE))


@pytest.fixture(scope="session")
def auto(known: Known) -> Fit:
    """All candidates, tried on the scattering water."""
    return uwaug.fit(*known, pixels=2000)


@pytest.fixture(scope="session")
def haze(hazy: Known) -> Fit:
    """The model that made the picture without forward scatter."""
    return uwaug.fit(*hazy, model="haze", pixels=2000)


@pytest.fixture(scope="session")
def water() -> Fit:
    """All types, tried on a 3C in which one sees 5 m."""
    truth = uwaug.Medium.from_water(
        uwaug.Water.jerlov("3C").with_contrast(0.02, 5),
        vertical_depth=3.0,
        g=Scattering.CALIBRATED.g,
        point_spread=uwaug.PointSpread.calibrated(),
        surfaces="spectral",
        tolerance=0,
    )
    return fit_water(*seen(truth), pixels=1000)


@pytest.fixture(scope="session")
def veil() -> Fit:
    """The veil in front of stones."""
    return fit_veil(veiled(veil_water()), STONES, darkest=0.0)
