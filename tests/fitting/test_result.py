import json

import numpy as np
import pytest
import torch
from fitted import COLOURS, medium, seen

import uwaug


@pytest.fixture(scope="module")
def known():
    return seen(medium())


@pytest.fixture(scope="module", params=["gaussian", "veil", "attenuation", "haze"])
def found(request, known):
    return uwaug.fit(*known, model=request.param, pixels=2000)


def test_medium_forms_what_was_fitted(found, known):
    clean, _, z = known
    light = uwaug.form_image(clean.double() / 255, z.double(), found.medium, tolerance=1e-4)
    natural = found.structure.natural(torch.from_numpy(found.theta))
    z_far = torch.tensor([2.0, 5.0], dtype=torch.float64)
    wanted = torch.exp(-natural.beta[0][:, None] * z_far)
    torch.testing.assert_close(found.medium.transmission(z_far)[0], wanted)
    if found.structure.shape is None:
        assert light.forward.abs().max() == 0
    else:
        assert light.forward.abs().max() > 0.01
    veil = natural.source[0] / natural.G[0].clamp(min=1e-9)
    grown = veil[:, None] * (1 - torch.exp(-natural.G[0][:, None] * z_far))
    torch.testing.assert_close(found.medium.backscatter(z_far)[0], grown, rtol=1e-6, atol=1e-9)


def test_width_of_the_medium_is_that_of_the_fit(known):
    found = uwaug.fit(*known, model="gaussian", pixels=2000)
    size = tuple(known.clean.shape[-2:])
    at = torch.full((1, 1, 1, 1), found.structure.geometry.reference, dtype=torch.float64)
    sigma = float(found.medium.width(at, size))
    assert sigma == pytest.approx(found.parameters["width"].value, rel=1e-9)
    # twice the picture, twice the px
    assert float(found.medium.width(at, (2 * size[0], 2 * size[1]))) == pytest.approx(2 * sigma)


def test_residuals_are_pictures(found, known):
    (residual,) = found.residual
    assert residual.shape == known.clean.shape
    assert float(residual.nanmean().abs()) < 0.1
    if found.model == "gaussian":
        assert float(residual[~residual.isnan()].square().mean().sqrt()) < 0.012


def test_saved_and_loaded(found, tmp_path):
    path = tmp_path / "fit.json"
    found.save(path)
    again = uwaug.fitting.Fit.load(path)
    assert again.parameters == found.parameters
    assert again.candidates == found.candidates
    assert (again.message, again.noise, again.model) == (found.message, found.noise, found.model)
    assert again.summary() == found.summary()
    np.testing.assert_array_equal(again.theta, found.theta)
    for mine, theirs in zip(again.medium.tensors(), found.medium.tensors(), strict=True):
        torch.testing.assert_close(mine, theirs, rtol=0, atol=0)
    with pytest.raises(ValueError, match="has no pictures"):
        _ = again.residual
    assert list(tmp_path.iterdir()) == [path]


def test_files_that_are_no_fits(found, tmp_path):
    path = tmp_path / "fit.json"
    with pytest.raises(FileNotFoundError):
        uwaug.fitting.Fit.load(path)
    path.write_text("{")
    with pytest.raises(ValueError, match=r"fit\.json: not a fit"):
        uwaug.fitting.Fit.load(path)
    path.write_text("[]")
    with pytest.raises(ValueError, match=r"not a fit: expected a file written by Fit\.save"):
        uwaug.fitting.Fit.load(path)
    found.save(path)
    values = json.loads(path.read_text())
    for name, value, match in (
        ("uwaug_fit", 99, "expected a fit of format 1, got format 99"),
        ("theta", [1.0], "theta and covariance must hold"),
        ("model", "magic", "KeyError"),
        ("parameters", None, "not a fit"),
    ):
        path.write_text(json.dumps({**values, name: value}))
        with pytest.raises(ValueError, match=match):
            uwaug.fitting.Fit.load(path)


def test_samples_spread_as_the_errors(known):
    found = uwaug.fit(*known, model="gaussian", pixels=2000)
    media = found.sample(4000, torch.Generator().manual_seed(0))
    assert len(media) == 4000
    for c, colour in enumerate(COLOURS):
        one = found.parameters[f"beta_{colour}"]
        rates = media.beta[:, c]
        assert float(rates.mean()) == pytest.approx(one.value, abs=0.1 * one.error)
        assert float(rates.std()) == pytest.approx(one.error, rel=0.06)
    degrade = uwaug.Underwater(found.sample(2), (0.5, 6.0))
    assert degrade(known.clean, known.distance).shape == (2, *known.clean.shape)
    for count in (0, -1, 2.0):
        with pytest.raises(ValueError, match="count must be a whole number ≥ 1"):
            found.sample(count)


def test_a_fit_is_exported_and_learnt_on(known, tmp_path):
    found = uwaug.fit(*known, model="gaussian", pixels=2000)
    degrade = uwaug.Underwater(found.medium, (0.5, 6.0), learnable=True)
    degrade(known.clean.float() / 255, known.distance).mean().backward()
    assert all(one.grad.isfinite().all() for one in degrade.parameters())
    fixed = uwaug.Underwater(found.medium, (0.5, 6.0), sides=(32, 64))
    uwaug.onnx.export_onnx(fixed, tmp_path / "fit.onnx")


def test_repr_and_text(found):
    assert repr(found).startswith(f"Fit({found.model!r}, β = ")
    assert str(found) == found.summary()
    names, matrix = found.correlation
    assert matrix.shape == (len(names), len(names))
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    assert found.history[-1] <= found.history[0]
