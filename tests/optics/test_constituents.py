"""Waters by what is in them: against the Jerlov types, pure water and the equations."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edited import edited_copy, run_in
from hypothesis import given
from hypothesis import strategies as st
from refusing import refusals

from uwaug import Constituents, Water

# chlorophyll, CDOM and minerals that come nearest to the tables of a source, by fits of a, b, K_d
SOLONENKO = {
    "I": (0, 0.0077, 0),
    "IA": (0.00059, 0.012, 0),
    "IB": (0.032, 0.0085, 0.033),
    "II": (0, 0, 0.49),
    "III": (0, 0, 1.2),
    "1C": (0, 0.09, 0.54),
    "3C": (0, 0.1, 1.6),
    "5C": (0, 0.25, 2),
    "7C": (0.94, 0.44, 3),
    "9C": (3.9, 0.9, 3.3),
}
WILLIAMSON = {
    "IB": (0.21, 0.0075, 0.002),
    "II": (0.35, 0.023, 0.0072),
    "III": (0.74, 0.06, 0),
    "1C": (0.98, 0.11, 0.1),
    "3C": (1.8, 0.17, 0.17),
    "5C": (4, 0.26, 0.29),
}
NM = np.arange(400.0, 701.0, 25.0)


def of(chlorophyll: float, cdom: float, minerals: float) -> Water:
    return Water.from_constituents(chlorophyll=chlorophyll, cdom=cdom, minerals=minerals)


@pytest.mark.parametrize(
    "source, contents, mean, worst",
    [
        # RMS of the logarithm of a, b, K_d, as the module says
        ("solonenko2015", SOLONENKO, (0.105, 0.07, 0.08), (0.24, 0.2, 0.105)),
        ("williamson2022", WILLIAMSON, (0.105, 0.03, 0.14), (0.175, 0.045, 0.225)),
    ],
)
def test_near_the_jerlov_types(
    source: str, contents: dict[str, tuple[float, float, float]], mean: Any, worst: Any
) -> None:
    apart = []
    for type, amounts in contents.items():
        table, model = Water.jerlov(type, source).at(NM), of(*amounts).at(NM)
        pairs = ((model.a, table.a), (model.b, table.b), (model.kd, table.kd))
        apart.append([np.sqrt(np.mean(np.log(mine / theirs) ** 2)) for mine, theirs in pairs])
    assert (np.mean(apart, axis=0) < mean).all()
    assert (np.max(apart, axis=0) < worst).all()


def test_nothing_is_pure_water() -> None:
    water, jerlov = Water.from_constituents(), Water.jerlov("I")
    pure = jerlov.with_contents(0)
    assert water.contrast(20) == pytest.approx(pure.contrast(20), rel=0.1)
    np.testing.assert_allclose(water.kd, (water.a + water.b / 2) / 0.9, rtol=1e-12)


def test_the_equations_by_hand() -> None:
    pure, at_440 = of(0, 0, 0), np.array([440.0])
    w, water = pure.at(at_440), of(4, 0.5, 2).at(at_440)
    a = w.a + 0.052019 * 4**0.634965 + 0.5 + 2 * 0.041 * math.exp(0.0123 * 3)
    b = w.b + 0.347 * 4**0.766 + 2 * 1.1513 * (400 / 440) ** 1.7
    lost = a + w.b / 2
    kd = np.sqrt(lost**2 + 0.1925 * lost * (b - w.b)) / 0.9
    np.testing.assert_allclose([water.a, water.b, water.kd], [a, b, kd], rtol=1e-6)
    # little phytoplankton scatters more blue: (λ/660)^((log₁₀ C − .3)/2), at most ^−1
    for chlorophyll, slope in ((0.2, (math.log10(0.2) - 0.3) / 2), (0.001, -1.0)):
        b = of(chlorophyll, 0, 0).at(at_440).b - w.b
        assert b == pytest.approx(0.347 * chlorophyll**0.766 * (440 / 660) ** slope, rel=1e-9)


@given(st.floats(1e-3, 50), st.floats(1, 30), st.fixed_dictionaries({"cdom": st.floats(0, 1)}))
def test_draws_lie_in_their_ranges(low: float, ratio: float, shares: dict[str, float]) -> None:
    ranges = Constituents(chlorophyll=3, cdom=(low, low * ratio))
    drawn = ranges.drawn(shares.__getitem__)
    assert ranges.holds(drawn)
    cdom = pytest.approx(low * ratio ** shares["cdom"], rel=1e-9)
    assert drawn == {"chlorophyll": 3, "cdom": cdom, "minerals": 0}
    assert Constituents.parse(ranges.name) == ranges
    for other in ({"chlorophyll": 3.001}, {"minerals": 1.0}, {"salt": 1.0}):
        assert not ranges.holds({**drawn, **other})
    assert not ranges.holds({"chlorophyll": 3})


NO_CONTENT = [-1.0, math.nan, math.inf, 1e5, "5", (1, 2)]
NO_RANGE = [-1, (0, 2), (3, 2), math.nan, (1, math.inf), "5", (1, 2, 3)]
NO_TEXT = ["", "=", "cdom", "cdom=", "cdom=1:2:3", "cdom=1,cdom=2", "a=1"]


test_what_is_refused = refusals(
    *(
        (lambda x: Water.from_constituents(cdom=x), x, r"cdom must be in \[0, 1")
        for x in NO_CONTENT
    ),
    *((lambda x: Constituents(cdom=x), x, "cdom must be") for x in NO_RANGE),
    *((Constituents.parse, x, "expected a water such as") for x in NO_TEXT),
)


# A content that is added as the house README says: a line of `UNITS`, a field, its terms

FIELD = "float | tuple[float, float] = number(0.0, 0.0, MAX_CONTENT, logarithmic=True)\n"
BUBBLES = {
    "optics/constituents.py": {
        '    "minerals": "g/m³",\n': '    "minerals": "g/m³",\n    "bubbles": "1/cm³",\n',
        f"    minerals: {FIELD}": f"    minerals: {FIELD}    bubbles: {FIELD}",
        'amounts["minerals"] * SCATTERED_BY_MINERALS\n': (
            'amounts["minerals"] * SCATTERED_BY_MINERALS + 0.1 * amounts["bubbles"]\n'
        ),
    }
}
SEEN = """
import numpy as np, pytest, torch, uwaug

plain, foamy = (uwaug.load_water(text) for text in ("chlorophyll=2", "chlorophyll=2,bubbles=3"))
np.testing.assert_allclose(foamy.b, plain.b + 0.3, rtol=1e-12)
assert (foamy.kd > plain.kd).all()
assert foamy == uwaug.Water.from_constituents(chlorophyll=2, bubbles=3)
with pytest.raises(ValueError, match=r"bubbles must be in \\[0, 10000\\], got -1"):
    uwaug.Water.from_constituents(bubbles=-1)

image, distance = torch.rand(3, 8, 8), torch.full((1, 8, 8), 3.0)
water = uwaug.RandomWater("chlorophyll=2,bubbles=1:9", contrast=None)
augment = uwaug.RandomUnderwater(water)
record = augment.make_params(image, torch.Generator().manual_seed(0))
(amounts,) = record["samples"][0]["water"]["waters"]
assert 1 < amounts["bubbles"] < 9
left = augment.contrast_left(image, distance, record)
amounts["bubbles"] = 1.0
assert (left < augment.contrast_left(image, distance, record)).all()
"""


def test_a_content_that_is_added_scatters(tmp_path: Path) -> None:
    edited_copy(tmp_path, BUBBLES)
    run_in(tmp_path, "-c", SEEN, UWAUG_FAST="0")
