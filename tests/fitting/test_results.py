"""Results as media, as modules, as files and as pictures; those of all kinds."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from fitted import COLOURS
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.text import Text
from texts import require_room

import uwaug
from uwaug.fitting import Candidate, Fit, Parameter, SeriesFit, WaterFit
from uwaug.formation.colour import linear_to_srgb

OLD = Path(__file__).parent / "e9c0d46"
"""Written by uwaug at commit e9c0d46."""

KINDS = ["auto", "series", "water", "veil"]


@pytest.fixture(params=KINDS)
def result(request):
    return request.getfixturevalue(request.param)


# ---- files


def test_saved_and_loaded(result, tmp_path):
    path = tmp_path / "fit.json"
    result.save(path)
    again = type(result).load(path)
    assert again.summary() == result.summary() == str(result)
    assert repr(again) == repr(result)
    assert again.parameters == result.parameters
    assert again.candidates == result.candidates
    assert again.errors == result.errors
    mine, theirs = (x.media if isinstance(x, SeriesFit) else x.medium for x in (again, result))
    for a, b in zip(mine.tensors(), theirs.tensors(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(("name", "kind"), [("fit", Fit), ("series", SeriesFit)])
def test_files_of_old_are_read(name, kind, tmp_path):
    old = json.loads((OLD / f"{name}.json").read_text())
    result = kind.load(OLD / f"{name}.json")
    result.save(tmp_path / "new.json")
    new = json.loads((tmp_path / "new.json").read_text())
    assert set(old) - set(new) <= {"correlation"}  # follows from the rest
    assert all(new[key] == old[key] for key in set(new) - {"uwaug"})
    if name == "fit":
        names, matrix = result.correlation
        assert names == old["correlation"]["names"]
        np.testing.assert_allclose(matrix, old["correlation"]["matrix"], atol=1e-9)


def test_files_that_are_none(haze, tmp_path):
    path = tmp_path / "fit.json"
    with pytest.raises(FileNotFoundError):
        Fit.load(path)
    haze.save(path)
    values = json.loads(path.read_text())
    for text, match in (
        ("{", r"fit\.json: not a fit"),
        ("[]", "not a fit: AttributeError"),
        ("{}", "not a fit: ValueError: expected uwaug_fit 1, got none"),
        (json.dumps({**values, "uwaug_fit": 99}), "expected uwaug_fit 1, got uwaug_fit 99"),
        (json.dumps({**values, "theta": [1.0]}), "theta and covariance must hold 6 numbers"),
        (json.dumps({**values, "theta": [-1.0] * 6}), "theta must lie within its bounds"),
        (json.dumps({**values, "model": "magic"}), "KeyError"),
        (json.dumps({**values, "parameters": None}), "not a fit"),
        ((OLD / "series.json").read_text(), "expected uwaug_fit 1, got uwaug_series 1"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=match):
            Fit.load(path)


def test_numbers_of_numpy_are_saved(hazy, tmp_path):
    numbers = {"fixed": {"veil_red": np.float32(0.1)}, "g": np.float32(0.1)}
    fit = uwaug.fit(*hazy, model="haze", focal_px=np.float32(300), pixels=1000, **numbers)
    fit.save(tmp_path / "fit.json")
    assert Fit.load(tmp_path / "fit.json").parameters == fit.parameters


def test_a_file_has_no_pictures(haze, tmp_path):
    haze.save(tmp_path / "fit.json")
    with pytest.raises(ValueError, match="has no pictures"):
        _ = Fit.load(tmp_path / "fit.json").residual


# ---- media


@pytest.mark.parametrize("name", ["gaussian", "haze"])
def test_medium_forms_what_was_fitted(request, name):
    fit = request.getfixturevalue(name)
    pair = fit.pairs[0]
    light = uwaug.form_image(pair.clean, pair.z, fit.medium, tolerance=1e-4)
    assert (light.forward.abs().max() > 0.01) == (name == "gaussian")
    c = fit.fitted.coefficients(torch.from_numpy(fit.theta))
    z = torch.tensor([2.0, 5.0], dtype=torch.float64)
    torch.testing.assert_close(fit.medium.transmission(z)[0], torch.exp(-c.beta[0][:, None] * z))
    grown = c.veil[0][:, None] * (1 - torch.exp(-c.G[0][:, None] * z))
    torch.testing.assert_close(fit.medium.backscatter(z)[0], grown, rtol=1e-6, atol=1e-9)
    (residual,) = fit.residual
    assert residual.shape == pair.clean.shape
    assert float(residual[~residual.isnan()].square().mean().sqrt()) < 0.012


def test_width_of_the_medium_is_that_of_the_fit(gaussian):
    h, w = gaussian.pairs[0].size
    at = torch.full((1, 1, 1, 1), gaussian.fitted.geometry.reference, dtype=torch.float64)
    sigma = float(gaussian.medium.width(at, (h, w)))
    assert sigma == pytest.approx(gaussian.parameters["width"].value, rel=1e-9)
    # twice the picture, twice the px
    assert float(gaussian.medium.width(at, (2 * h, 2 * w))) == pytest.approx(2 * sigma)


def test_module_serves_the_distances_of_the_fit(gaussian):
    module = gaussian.module(sides=(32, 128))
    geometry = gaussian.fitted.geometry
    near, far = 0.2 * geometry.reference, 1.5 * geometry.farthest
    assert module.distance_range == pytest.approx((near, far))
    pair = gaussian.pairs[0]
    light = uwaug.form_image(pair.clean.float(), pair.z.float(), gaussian.medium).image
    picture = module(linear_to_srgb(pair.clean).float(), pair.z.float())
    assert (picture - linear_to_srgb(light)).abs().max() < 0.02


def test_a_summary_says_what_its_numbers_are(gaussian, haze):
    lines = {line.split()[0]: line for line in gaussian.summary().splitlines() if line.strip()}
    assert lines["width"].endswith(f"px  σ at {gaussian.fitted.geometry.reference:.3g} m")
    assert lines["veil_red"].endswith("of white, V(0)")
    assert lines["beta_red"].endswith(" 1/m")
    lines = {line.split()[0]: line for line in haze.summary().splitlines() if line.strip()}
    assert lines["beta_red"].endswith("1/m  of direct and forward light together")
    assert "β of the water, may be larger: it is not identified" in haze.message
    assert "of direct and forward" not in gaussian.summary()


def test_the_ends_of_an_interval_are_told_apart(gaussian):
    sharp = Parameter(0.3, 1e-9, 0.3 - 2e-9, 0.3 + 2e-9, "1/m", "free")
    assert "0.299999998 … 0.300000002" in replace(gaussian, parameters={"G_red": sharp}).summary()


def test_samples_spread_as_the_errors(gaussian):
    media = gaussian.sample(4000, torch.Generator().manual_seed(0))
    assert len(media) == 4000
    for c, colour in enumerate(COLOURS):
        number = gaussian.parameters[f"beta_{colour}"]
        rates = media.beta[:, c]
        assert float(rates.mean()) == pytest.approx(number.value, abs=0.1 * number.error)
        assert float(rates.std()) == pytest.approx(number.error, rel=0.06)
    for count in (0, -1, 2.0):
        with pytest.raises(ValueError, match="count must be a whole number ≥ 1"):
            gaussian.sample(count)


def test_correlation_and_history(gaussian):
    names, matrix = gaussian.correlation
    assert matrix.shape == (len(names), len(names))
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    assert gaussian.history[-1] <= gaussian.history[0]


# ---- pictures


@pytest.fixture(scope="session")
def many(once):
    """Four pairs, with a wide one and one too narrow for a colour bar."""

    def fitted():
        water = uwaug.Medium.from_coefficients((0.5, 0.2, 0.3), (0.5, 0.2, 0.3), (0.1, 0.3, 0.4))
        pairs = []
        for seed, (height, width) in enumerate([(60, 80), (90, 30), (40, 120), (60, 80)]):
            rng = torch.Generator().manual_seed(seed)
            clean = 0.1 + 0.8 * torch.rand(3, height, width, generator=rng)
            z = torch.linspace(1, 6, height * width).reshape(1, height, width)
            seen = uwaug.Underwater(water)(clean, z)
            z[:, : height // 4, : width // 4] = torch.nan  # is not known
            noise = 0.02 * torch.randn(seen.shape, generator=rng)
            pairs.append((clean, (seen + noise).clamp(0, 1), z))
        clean, observed, distance = (list(column) for column in zip(*pairs, strict=True))
        options = {"model": "veil", "gain": "channels", "relative": True, "pixels": 2000}
        return uwaug.fit(clean, observed, distance, **options)

    fit = once("many", fitted)
    # at the longest: as many candidates as there may be, and every doubt
    candidates = tuple(Candidate(name, 24, 1.1, 2.4e6, 9.7e4) for name in "abcdefg")
    message = "\n".join(["a sentence that goes on and on, " * 8] * 6)
    return replace(fit, candidates=candidates, message=message)


@pytest.fixture(scope="module")
def sheet(many):
    return many.plot()


def axes_of(figure, label):
    return [axis for axis in figure.axes if label in axis.get_title(loc="left")]


@pytest.mark.parametrize("name", ["many", *KINDS, "loaded"])
def test_no_text_overlaps_or_leaves_the_picture(request, name, tmp_path, monkeypatch):
    if name == "loaded":
        fit = Fit.load(OLD / "fit.json")
    else:
        fit = request.getfixturevalue(name)
    assert require_room(fit.plot, monkeypatch, margin=10) > 20


def test_pictures_are_those_of_the_fit(haze):
    figure = haze.plot()
    usable = haze.pairs[0].usable[0].numpy()
    (observed,) = axes_of(figure, "Observed")
    shown = np.asarray(observed.images[0].get_array())
    wanted = linear_to_srgb(haze.pairs[0].observed).clamp(0, 1).permute(1, 2, 0)
    np.testing.assert_allclose(shown, wanted.numpy(), atol=1e-6)
    (rendered,) = axes_of(figure, "Rendered by")
    shown = np.asarray(rendered.images[0].get_array())
    wanted = linear_to_srgb(haze.rendered[0]).clamp(0, 1).permute(1, 2, 0)
    np.testing.assert_allclose(shown[..., :3], wanted.numpy(), atol=1e-6)
    assert (shown[..., 3] == usable).all()
    for axis, wanted in zip(axes_of(figure, "Rendered −"), haze.residual[0], strict=True):
        shown = np.ma.filled(axis.images[0].get_array(), np.nan)
        np.testing.assert_array_equal(shown, wanted.numpy())


@pytest.mark.parametrize("gain", ["free", "fixed", "matrix"])
def test_a_fit_of_waters_shows_its_pictures(water, gain):
    """Observed, rendered, and what is left, under any of the three cameras."""
    theta = water.theta[:-1]  # all but the exposure
    if gain == "free":
        theta = np.append(theta, 0.7)
    pairs = [pair._replace(observed=0.7 * pair.observed) for pair in water.pairs]
    pairs = water.pairs if gain == "fixed" else tuple(pairs)
    fit = replace(water, fitted=replace(water.fitted, gain=gain), theta=theta, pairs=pairs)
    (residual,) = fit.residual
    rms = residual[residual.isfinite()].square().mean().sqrt()
    assert rms < 2 * water.rms
    assert torch.equal(fit.rendered[0], fit.formed()[0][0])


def test_the_sheet_of_a_fit_of_waters(water, tmp_path):
    figure = water.plot()
    for label in ("Observed", "Rendered by", "Rendered − observed, blue"):
        assert axes_of(figure, label)
    water.save(tmp_path / "water.json")
    assert not axes_of(WaterFit.load(tmp_path / "water.json").plot(), "Observed")


def test_the_candidate_that_was_chosen_is_bold(many):
    tried = tuple(Candidate(name, 9, 1.1, 0.0, 0.0) for name in ("veil", "veil + gain"))
    figure = replace(many, candidates=tried).plot()
    bold = {text.get_text() for text in figure.findobj(Text) if text.get_fontweight() == "bold"}
    assert bold & {"veil", "veil + gain"} == {"veil + gain"}


def test_what_is_not_shown_is_not_rendered_and_chance_stays(many, monkeypatch):
    before = torch.get_rng_state()
    formed, form_image = [], uwaug.form_image

    def counted(*arguments):
        formed.append(arguments)
        return form_image(*arguments)

    monkeypatch.setattr("uwaug.fitting.results.form_image", counted)
    many.plot()
    assert len(formed) == 3
    assert torch.equal(before, torch.get_rng_state())


def test_what_does_not_count_is_grey(sheet):
    canvas = FigureCanvasAgg(sheet)
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())[..., :3] / 255
    for axis in axes_of(sheet, "1: Rendered by") + axes_of(sheet, "1: Distance"):
        # pixel (7, 10) of 60×80, whose distance is not known
        x, y = axis.transData.transform((10, 7))
        np.testing.assert_allclose(picture[-int(y), int(x)], to_rgb("#9a9a9a"), atol=0.01)


def test_one_scale_for_all_residuals(many, sheet):
    residuals = axes_of(sheet, "Rendered −")
    assert len(residuals) == 9
    (limits,) = {axis.images[0].get_clim() for axis in residuals}
    assert limits[0] == -limits[1] < 0
    values = torch.cat([part.flatten() for part in many.residual[:3]])
    assert 0 < (values[values.isfinite()].abs() > limits[1]).float().mean() < 0.02
    texts = [text.get_text() for text in sheet.findobj(Text)]
    (caption,) = [text for text in texts if f"±{limits[1]:g}." in text]
    assert caption.startswith("3 of 4 pairs. ")
    # β, G, veil, source and four gains
    rows = ["β  [1/unit]", "G  [1/unit]", "veil", "source  [1/unit]", "gain 1", "gain 4"]
    assert all(row in texts for row in rows)


def test_curves_and_their_bands(many, sheet):
    waters = many.sample(200, generator=torch.Generator().manual_seed(0))
    labels = ("what is left of direct", "scattered forward", "veil")
    for label, curve in zip(labels, ("transmission", "signal", "backscatter"), strict=True):
        (axis,) = axes_of(sheet, label)
        bands = [x for x in axis.collections if len(x.get_paths()[0].vertices) > 100]
        assert (len(axis.lines), len(bands)) == (3, 3)
        for c, (line, band) in enumerate(zip(axis.lines, bands, strict=True)):
            z = torch.from_numpy(line.get_xdata())
            expected = getattr(many.medium, curve)(z)[0, c].numpy()
            np.testing.assert_allclose(line.get_ydata(), expected, atol=1e-9)
            samples = getattr(waters, curve)(z)[:, c].numpy()
            low, high = np.quantile(samples[:, -1], (0.025, 0.975))
            ends = band.get_paths()[0].vertices
            ends = ends[ends[:, 0] == float(z[-1]), 1]
            np.testing.assert_allclose([ends.min(), ends.max()], [low, high], atol=1e-9)
            assert low < high


def test_odd_sheets(haze):
    whole = haze.pairs[0]
    sea = whole._replace(z=torch.full_like(whole.z, 1e9))
    assert axes_of(replace(haze, pairs=(sea,)).plot(), "Distance: open water")
    told = {
        "0.54728 ± 0.00061": (0.54728, 0.00061, "free"),
        "12.3 ± 1.5": (12.3456, 1.5, "free"),
        "0.30000 ± 0.00001": (0.3, 1e-9, "free"),
        "0.02 (fixed)": (0.02, None, "fixed"),
        "0 (at bound)": (4.3e-18, None, "at bound"),
        "not identified": (None, None, "not identified"),
    }
    more = [Parameter(x, error, None, None, "1", state) for x, error, state in told.values()]
    numbers = {f"gain_{i}": number for i, number in enumerate([*more, *more[:1] * 34])}
    figure = replace(haze, parameters={**haze.parameters, **numbers}).plot()
    # β, veil, source and ten gains
    texts = {text.get_text() for text in figure.findobj(Text)}
    assert texts >= {"and 30 more, see the summary", *told}
