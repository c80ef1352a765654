import pytest
import torch
from fitted import COLOURS, LEVELS, TANK, tank

import uwaug
from uwaug.fitting import fit_series


def test_what_all_turbidities_share(series):
    for c, colour in enumerate(COLOURS):
        a, m = series.parameters[f"a_{colour}"], series.parameters[f"m_{colour}"]
        assert a.value == pytest.approx(TANK["a"][c], abs=4 * a.error)
        assert m.value == pytest.approx(TANK["m"][c], abs=4 * m.error)
        assert a.error < 0.01
    g = series.parameters["g"]
    assert g.value == pytest.approx(TANK["g"], abs=4 * g.error)
    assert series.parameters["exponent"].value == pytest.approx(0.8, abs=0.1)


def test_scattering_on_a_line(series):
    for c, colour in enumerate(COLOURS):
        line = series.lines[colour]
        assert line.k == pytest.approx(TANK["k"][c], abs=4 * line.k_error)
        assert line.b0 == pytest.approx(TANK["b0"], abs=4 * line.b0_error)
        assert line.probability > 1e-3
        at_level = series.parameters[f"b_{colour}_3"]
        assert at_level.value == pytest.approx(
            TANK["b0"] + 2 * TANK["k"][c], abs=4 * at_level.error
        )
    assert "Model 'gaussian'" in series.message
    assert "follows turbidity on a line, within" in series.message


def test_scattering_off_a_line():
    fit = fit_series(tank(bend=0.3), LEVELS, model="gaussian", pixels=1500)
    assert all(line.probability < 1e-6 for line in fit.lines.values())
    assert "does not follow turbidity on a line in red, green, blue" in fit.message


def test_models_are_compared_and_two_turbidities_are_no_test():
    pairs, said = tank(levels=(0.5, 2.0)), []
    # in another order, and one of them twice
    fit = fit_series(
        [pairs[1], pairs[0], pairs[1]], [2.0, 0.5, 2.0], pixels=1500, progress=said.append
    )
    assert fit.model == "gaussian"
    assert [tried.name for tried in fit.candidates] == ["veil", "gaussian", "exponential"]
    assert "fitting 'gaussian' to all" in said
    assert fit.levels == (0.5, 2.0)
    assert fit.fitted.level == (1, 0, 1)
    assert fit.lines["red"].probability is None
    assert "a third would test it" in fit.message


def test_media(series):
    def beta(level):
        return torch.from_numpy(TANK["a"] + TANK["b0"] + level * TANK["k"])

    assert len(series.media) == len(LEVELS)
    torch.testing.assert_close(series.media.beta[0], beta(0.5), rtol=0.02, atol=0.0)
    torch.testing.assert_close(series.medium(1.5).beta[0], beta(1.5), rtol=0.02, atol=0.0)
    image, z = torch.rand(3, 20, 30), torch.full((1, 20, 30), 2.0)
    assert uwaug.Underwater(series.media, (1.0, 3.0))(image, z).shape == (4, 3, 20, 30)
    with pytest.raises(ValueError, match="turbidity must be finite and ≥ 0"):
        series.medium(-1)


def test_refusals():
    pair = (torch.rand(3, 30, 30),) * 3
    for pairs, turbidity, error, match in (
        ([pair] * 2, [1.0], ValueError, "a number for each pair, got 1 for 2 pairs"),
        ([pair] * 2, [1.0, 1.0], ValueError, r"at least two values, got \[1\.0\]"),
        ([pair] * 2, [1.0, -1], ValueError, r"turbidity\[1\] must be finite and ≥ 0, got -1"),
        ([pair[:2], pair], [1.0, 2.0], TypeError, r"pairs\[0\] must be \(clean, observed, dist"),
    ):
        with pytest.raises(error, match=match):
            fit_series(pairs, turbidity)
    with pytest.raises(ValueError, match="model must be one of auto, veil"):
        fit_series([pair] * 2, [1.0, 2.0], model="haze")
