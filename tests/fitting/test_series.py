import json

import numpy as np
import pytest
import torch
from fitted import COLOURS, medium, seen

import uwaug

LEVELS = (0.5, 1.0, 2.0, 4.0)
A = np.array([0.15, 0.03, 0.02])
M = np.array([0.06, 0.07, 0.08])
K = np.array([0.12, 0.10, 0.09])
B0, SHARE = 0.02, 0.12


def tank(bend=0.0, levels=LEVELS):
    """One scene at several turbidities; scattering bends away from a line."""
    pairs = []
    for i, level in enumerate(levels):
        b = B0 + K * level * (1 + bend * level)
        G = A + SHARE * b
        veil = M * b / G
        numbers = {"beta": (A + b).tolist(), "G": G.tolist(), "veil": veil.tolist()}
        law = uwaug.PointSpread(3.0 * b.mean() ** 0.8, 0.8)
        pairs.append(tuple(seen(medium(law, **numbers), seed=i)))
    return pairs


@pytest.fixture(scope="module")
def found():
    return uwaug.fitting.fit_series(tank(), LEVELS, model="gaussian", pixels=12_000)


def test_what_all_turbidities_share(found):
    for c, colour in enumerate(COLOURS):
        a, m = found.parameters[f"a_{colour}"], found.parameters[f"m_{colour}"]
        assert a.value == pytest.approx(A[c], abs=4 * a.error)
        assert m.value == pytest.approx(M[c], abs=4 * m.error)
        assert a.error < 0.01
    g = found.parameters["g"]
    assert g.value == pytest.approx(SHARE, abs=4 * g.error)
    assert found.parameters["exponent"].value == pytest.approx(0.8, abs=0.1)


def test_scattering_on_a_line(found):
    for c, colour in enumerate(COLOURS):
        line = found.lines[colour]
        assert line.k == pytest.approx(K[c], abs=4 * line.k_error)
        assert line.b0 == pytest.approx(B0, abs=4 * line.b0_error)
        assert line.probability > 1e-3
        at_level = found.parameters[f"b_{colour}_3"]
        assert at_level.value == pytest.approx(B0 + 2 * K[c], abs=4 * at_level.error)
    assert "Model 'gaussian'" in found.message


def test_scattering_off_a_line():
    found = uwaug.fitting.fit_series(tank(bend=0.3), LEVELS, model="gaussian", pixels=12_000)
    assert all(line.probability < 1e-6 for line in found.lines.values())
    assert "does not follow turbidity on a line in red, green, blue" in found.message


def test_two_turbidities_are_no_test():
    pairs = tank(levels=(1.0, 3.0))
    # in another order, and one of them twice
    turbidity = [3.0, 1.0, 3.0]
    found = uwaug.fitting.fit_series(
        [pairs[1], pairs[0], pairs[1]], turbidity, model="veil", pixels=6000
    )
    assert found.levels == (1.0, 3.0)
    assert found.structure.level == (1, 0, 1)
    assert found.lines["red"].probability is None
    assert "a third would test it" in found.message


def test_models_are_compared():
    pairs = tank(levels=(0.5, 2.0))
    said = []
    found = uwaug.fitting.fit_series(pairs, (0.5, 2.0), pixels=4000, progress=said.append)
    assert found.model == "gaussian"
    assert [one.name for one in found.candidates] == ["veil", "gaussian", "exponential"]
    assert "fitting 'gaussian' to all" in said


def test_media(found):
    media = found.media
    assert len(media) == len(LEVELS)
    torch.testing.assert_close(
        media.beta[0], torch.from_numpy(A + B0 + 0.5 * K), rtol=0.02, atol=0.0
    )
    between = found.medium(1.5)
    torch.testing.assert_close(
        between.beta[0], torch.from_numpy(A + B0 + 1.5 * K), rtol=0.02, atol=0.0
    )
    image, z = torch.rand(3, 20, 30), torch.full((1, 20, 30), 2.0)
    assert uwaug.Underwater(media, (1.0, 3.0))(image, z).shape == (4, 3, 20, 30)
    with pytest.raises(ValueError, match="turbidity must be finite and ≥ 0"):
        found.medium(-1)


def test_saved_and_loaded(found, tmp_path):
    path = tmp_path / "series.json"
    found.save(path)
    again = uwaug.fitting.SeriesFit.load(path)
    assert again.summary() == found.summary()
    assert again.lines == found.lines
    torch.testing.assert_close(again.media.beta, found.media.beta, rtol=0, atol=0)
    values = json.loads(path.read_text())
    path.write_text(json.dumps({**values, "uwaug_series": 7}))
    with pytest.raises(ValueError, match="expected format 1, got 7"):
        uwaug.fitting.SeriesFit.load(path)
    path.write_text("{}")
    with pytest.raises(ValueError, match="not a series"):
        uwaug.fitting.SeriesFit.load(path)


def test_drawn(found):
    figure = found.plot()
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    assert titles[0] == "b, and b₀ + k·turbidity"
    assert len(figure.axes) == 3


def test_refusals():
    pairs = tank(levels=(1.0, 3.0))
    with pytest.raises(ValueError, match="a number for each pair, got 1 for 2 pairs"):
        uwaug.fitting.fit_series(pairs, [1.0])
    with pytest.raises(ValueError, match=r"at least two values, got \[1\.0\]"):
        uwaug.fitting.fit_series(pairs, [1.0, 1.0])
    with pytest.raises(ValueError, match=r"turbidity\[1\] must be finite and ≥ 0, got -1"):
        uwaug.fitting.fit_series(pairs, [1.0, -1])
    with pytest.raises(TypeError, match=r"pairs\[0\] must be \(clean, observed, distance\)"):
        uwaug.fitting.fit_series([pairs[0][:2], pairs[1]], [1.0, 2.0])
    with pytest.raises(ValueError, match="model must be one of auto, veil"):
        uwaug.fitting.fit_series(pairs, [1.0, 2.0], model="haze")
