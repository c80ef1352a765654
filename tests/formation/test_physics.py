"""Our random walk against an independent one (tabulated figures), and against what is known in
closed form.
"""

import itertools

import numpy as np
import pytest

pytest.importorskip("cv2")

from referees.transport import ABSORPTION, Spread, henyey_greenstein, petzold, spread, survey, walk

from benchmarks.accuracy.physics import CALIBRATED, FORMER, PAPER, STATIONS, Law, mean_error
from uwaug.optics.point_spread import PointSpread

PHOTONS = 100_000
MEASURED = list(itertools.chain(*STATIONS.values()))
# Henyey–Greenstein mean cosine, a/b, b·z: forward share, effective g, quantiles 25, 50, 75, 90 % of
# the tangent
TABLE = [
    (0.85, 1.0, 0.5, 0.21444, 0.08147, (0.048503, 0.117656, 0.256422, 0.506241)),
    (0.924, 0.4, 1.0, 0.399512, 0.03679, (0.031402, 0.076881, 0.175897, 0.369247)),
    (0.924, 0.1, 5.0, 0.482368, 0.04412, (0.10408, 0.211276, 0.41004, 0.742703)),
]


@pytest.mark.parametrize("asymmetry, absorption, lengths, forward, g, quantiles", TABLE)
def test_agrees_with_an_independent_walk(
    asymmetry: float, absorption: float, lengths: float, forward: float, g: float, quantiles: tuple
) -> None:
    ours = spread(walk(henyey_greenstein(asymmetry).sample, lengths, PHOTONS), absorption)
    assert ours.forward == pytest.approx(forward, rel=0.005)
    assert ours.figures["g"] == pytest.approx(g, rel=0.03, abs=5e-4)
    tangents = [ours.figures[name] for name in ("q25", "q50", "q75", "q90")]
    assert tangents == pytest.approx(quantiles, rel=0.02)


@pytest.mark.parametrize("station", MEASURED)
def test_petzold_samples_what_was_measured(station: str) -> None:
    import jerlov

    measured = jerlov.petzold_scattering(station)
    cosine, sine = petzold(station).sample((np.arange(1_000_000) + 0.5) / 1e6)
    angle = np.degrees(np.arctan2(sine, cosine))
    # the report's own integrals, which its tables do not reproduce to the last digit
    assert (angle < 0.1).mean() == pytest.approx(measured.fraction_below_0_1_deg, rel=0.05)
    assert (angle > 90).mean() == pytest.approx(measured.backscatter_ratio, rel=0.06)


@pytest.fixture(scope="module")
def truths() -> dict[str, list[Spread]]:
    """What the calibrated law is fitted to, from fewer photons."""
    spreads = survey([henyey_greenstein(0.924), *map(petzold, MEASURED)], 5_000)
    walks = itertools.chain(*(spreads[name] for name in MEASURED))
    own = [s for s in walks if s.absorption not in ABSORPTION]
    return {"HG 0.924": spreads["HG 0.924"], "Petzold": own, "both": [*spreads["HG 0.924"], *own]}


def test_the_calibrated_law_ships_and_is_nearer_than_one_gaussian(truths) -> None:
    law = PointSpread.calibrated()
    assert CALIBRATED.shape == law.shape
    assert CALIBRATED.widths == ((1.0, pytest.approx(law.scale), law.exponent),)
    for truth, share in (("HG 0.924", 0.75), ("Petzold", 0.62), ("both", 0.65)):
        errors = (mean_error(law, truths[truth]) for law in (CALIBRATED, FORMER, PAPER))
        calibrated, former, paper = errors
        assert calibrated < share * former
        assert former < 0.4 * paper


@pytest.mark.parametrize(
    "width, exponent, g",
    [(0.7, 1.0, 1.0), (1.4, 1.0, 1.0), (1.0, 0.5, 1.0), (1.0, 1.4, 1.0), (1, 1, 0.6), (1, 1, 1.4)],
)
def test_another_width_exponent_or_g_is_worse(width, exponent, g, truths) -> None:
    ((share, scale, power),) = CALIBRATED.widths
    changed = Law(CALIBRATED.g * g, ((share, scale * width, power * exponent),), CALIBRATED.shape)
    assert mean_error(changed, truths["both"]) > 1.05 * mean_error(CALIBRATED, truths["both"])
