"""Phase functions, and the g and μ that they come to."""

import numpy as np
import pytest
from refusing import refusals

from uwaug import Scattering
from uwaug.optics import scattering

ANGLE = scattering._nodes()


def henyey_greenstein(angle: np.ndarray, cosine: float) -> np.ndarray:
    return (1 - cosine**2) / (4 * np.pi) / (1 + cosine**2 - 2 * cosine * np.cos(angle)) ** 1.5


@pytest.mark.parametrize("cosine", [0.0, 0.85, 0.924, 0.95])
def test_g_goes_with_the_mean_cosine(cosine: float) -> None:
    degrees = np.concatenate([[0.0], np.geomspace(1e-3, 180, 4000)])
    values = henyey_greenstein(np.radians(degrees), cosine)
    for unit in (1.0, 1e-3):
        g = Scattering.of_table(degrees, unit * values).g
        assert g == pytest.approx(0.05 * (1 - cosine) / 0.076, rel=1e-3)


def test_mu_by_the_sum_over_all_directions() -> None:
    # light of (1 − .8 s)^−2 that is scattered into a level ray, and on a plate that faces it
    rng = np.random.default_rng(0)
    ahead, up, _ = directions = rng.standard_normal((3, 1_000_000))
    ahead, up = ahead / np.linalg.norm(directions, axis=0), up / np.linalg.norm(directions, axis=0)
    radiance, phase = (1 - 0.8 * up) ** -2, henyey_greenstein(np.arccos(ahead), 0.7)
    plate = 4 * (radiance * ahead.clip(0)).mean()
    found = scattering._of(henyey_greenstein(ANGLE, 0.7))
    mu = (4 * np.pi * (radiance * phase).mean() - (1 - found.g)) / plate
    assert found.mu == pytest.approx(mu, rel=0.01)


def test_petzold_sends_183_of_10000_back() -> None:
    degrees, values = scattering._petzold(None)
    angle = np.radians(degrees[degrees >= 90])
    back = 2 * np.pi * np.trapezoid(values[degrees >= 90] * np.sin(angle), angle)
    assert back == pytest.approx(0.0183, abs=3e-4)
    assert Scattering.petzold().g == pytest.approx(Scattering.CALIBRATED.g, abs=1e-3)
    clear, coast = (Scattering.petzold(name) for name in ("AUTEC 8", "HAOCE 5"))
    assert clear.g > Scattering.petzold().g > coast.g
    # of transport with HAOCE 5 and this g, see `Scattering`
    assert coast.mu == pytest.approx(0.066, abs=0.01)


test_what_is_refused = refusals(
    (Scattering.of_table, [0.1, 180], [1], "angles and values"),
    (Scattering.of_table, [5, 180], [2, 1], "angles.*5 to 180"),
    (Scattering.of_table, [0.1, 90, 80, 180], [3, 2, 2, 1], "angles must rise"),
    (Scattering.of_table, [0.1, 90, 180], [3, 0, 1], "values"),
    (Scattering.of_table, [0.1, 1, 180], [1e4, 1, 1], r"values.*θ\^-4"),
    (Scattering.petzold, "Atlantis", "HAOCE 11"),
    error=(ValueError, KeyError),
)
