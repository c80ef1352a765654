"""The sheet of a fit shows what the fit holds, legibly."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from uwaug.fitting.drawing import _scale, _told
from uwaug.fitting.report import Candidate, Parameter
from uwaug.fitting.result import Fit

import uwaug
from uwaug.formation.colour import linear_to_srgb

WATER = uwaug.Medium.from_coefficients((0.5, 0.2, 0.3), (0.5, 0.2, 0.3), (0.1, 0.3, 0.4))


def pair(height: int, width: int, seed: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """A picture of noise in water; the upper left of its distances is not known."""
    rng = torch.Generator().manual_seed(seed)
    clean = 0.1 + 0.8 * torch.rand(3, height, width, generator=rng)
    z = torch.linspace(1, 6, height * width).reshape(1, height, width)
    seen = uwaug.Underwater(WATER)(clean, z)
    z[:, : height // 4, : width // 4] = torch.nan
    noise = 0.02 * torch.randn(seen.shape, generator=rng)
    return clean, (seen + noise).clamp(0, 1), z


@pytest.fixture(scope="module")
def one() -> Fit:
    return uwaug.fit(*pair(60, 80, 0), model="haze")


@pytest.fixture(scope="module")
def many() -> Fit:
    """Four pairs, with a wide one and one too narrow for a colour bar."""
    pairs = [pair(60, 80, 1), pair(90, 30, 2), pair(40, 120, 3), pair(60, 80, 4)]
    clean, observed, distance = (list(column) for column in zip(*pairs, strict=True))
    found = uwaug.fit(clean, observed, distance, model="veil", gain="channels", relative=True)
    # at the longest: as many candidates as there may be, and every doubt
    candidates = tuple(Candidate(name, 24, 1.1, 2.4e6, 9.7e4) for name in "abcdefg")
    message = "\n".join(["a sentence that goes on and on, " * 8] * 6)
    return replace(found, candidates=candidates, message=message)


@pytest.fixture
def sheet(request: pytest.FixtureRequest, tmp_path: Path) -> Fit:
    """One pair, many, or a fit without its pictures."""
    if request.param != "loaded":
        return request.getfixturevalue(request.param)
    request.getfixturevalue("one").save(tmp_path / "fit.json")
    return Fit.load(tmp_path / "fit.json")


def axes_of(figure: Figure, label: str) -> list[Axes]:
    return [one for one in figure.axes if label in one.get_title(loc="left")]


@pytest.mark.parametrize("sheet", ["one", "many", "loaded"], indirect=True)
def test_no_text_overlaps_or_leaves_the_picture(
    sheet: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn, draw = [], Text.draw

    def remembered(text: Text, renderer: object) -> None:
        drawn.append(text)
        draw(text, renderer)

    monkeypatch.setattr(Text, "draw", remembered)
    figure = sheet.plot()
    FigureCanvasAgg(figure).draw()
    texts = [text for text in drawn if text.get_text() and text.get_visible()]
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts]
    assert len(boxes) > 40
    for label, box in boxes:
        assert box.x0 >= 0, label
        assert box.y0 >= 0, label
        assert box.x1 <= figure.bbox.x1, label
        assert box.y1 <= figure.bbox.y1, label
    for (first, a), (second, b) in combinations(boxes, 2):
        assert not (a.x0 < b.x1 and b.x0 < a.x1 and a.y0 < b.y1 and b.y0 < a.y1), (first, second)


def test_pictures_are_those_of_the_fit(one: Fit) -> None:
    figure = one.plot()
    usable = one.pairs[0].usable[0].numpy()
    (observed,) = axes_of(figure, "Observed")
    shown = np.asarray(observed.images[0].get_array())
    wanted = linear_to_srgb(one.pairs[0].observed).clamp(0, 1).permute(1, 2, 0)
    np.testing.assert_allclose(shown, wanted.numpy(), atol=1e-6)
    (rendered,) = axes_of(figure, "Rendered by")
    shown = np.asarray(rendered.images[0].get_array())
    wanted = linear_to_srgb(one.rendered[0]).clamp(0, 1).permute(1, 2, 0)
    np.testing.assert_allclose(shown[..., :3], wanted.numpy(), atol=1e-6)
    assert (shown[..., 3] == usable).all()
    residuals = axes_of(figure, "Rendered −")
    for axis, wanted in zip(residuals, one.residual[0], strict=True):
        shown = np.ma.filled(axis.images[0].get_array(), np.nan)
        np.testing.assert_array_equal(shown, wanted.numpy())


def test_the_candidate_that_was_chosen_is_bold(many: Fit) -> None:
    tried = tuple(Candidate(name, 9, 1.1, 0.0, 0.0) for name in ("veil", "veil + gain"))
    texts = replace(many, candidates=tried).plot().texts
    bold = {text.get_text() for text in texts if text.get_fontweight() == "bold"}
    assert many.model == "veil"
    assert bold & {"veil", "veil + gain"} == {"veil + gain"}


def test_what_is_not_shown_is_not_rendered(many: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    formed, form_image = [], uwaug.form_image

    def counted(*arguments: object) -> object:
        formed.append(arguments)
        return form_image(*arguments)

    monkeypatch.setattr("uwaug.fitting.result.form_image", counted)
    many.plot()
    assert len(formed) == 3


def test_what_does_not_count_is_grey(one: Fit) -> None:
    figure = one.plot()
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())[..., :3] / 255
    for axis in axes_of(figure, "Rendered") + axes_of(figure, "Distance"):
        # pixel (7, 10) of 60×80, whose distance is not known
        x, y = axis.transData.transform((10, 7))
        np.testing.assert_allclose(picture[-int(y), int(x)], to_rgb("#9a9a9a"), atol=0.01)


def test_one_scale_for_all_residuals(many: Fit) -> None:
    figure = many.plot()
    residuals = axes_of(figure, "Rendered −")
    assert len(residuals) == 9
    (limits,) = {axis.images[0].get_clim() for axis in residuals}
    assert limits[0] == -limits[1] < 0
    values = torch.cat([part.flatten() for part in many.residual[:3]])
    beyond = (values[values.isfinite()].abs() > limits[1]).float().mean()
    assert 0 < beyond < 0.02
    texts = [text.get_text() for text in figure.texts]
    (caption,) = [text for text in texts if f"±{limits[1]:g}." in text]
    assert caption.startswith("3 of 4 pairs. ")
    # β, G, veil, source and four gains
    rows = ["β  [1/unit]", "G  [1/unit]", "veil", "source  [1/unit]", "gain 1", "gain 4"]
    assert all(row in texts for row in rows)


def test_curves_and_their_bands(many: Fit) -> None:
    before = torch.get_rng_state()
    figure = many.plot()
    assert torch.equal(before, torch.get_rng_state())
    waters = many.sample(200, generator=torch.Generator().manual_seed(0))
    labels = ("what is left of direct", "scattered forward", "veil")
    for label, curve in zip(labels, ("transmission", "signal", "backscatter"), strict=True):
        (cell,) = axes_of(figure, label)
        (axis,) = cell.child_axes
        bands = [one for one in axis.collections if len(one.get_paths()[0].vertices) > 100]
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


def test_a_fit_without_pictures_has_curves_alone(one: Fit, tmp_path: Path) -> None:
    one.save(tmp_path / "fit.json")
    figure = Fit.load(tmp_path / "fit.json").plot()
    assert [axis.get_title(loc="left")[-4:] for axis in figure.axes] == ["ight", "ward", "veil"]


def test_a_picture_of_open_water_alone(one: Fit) -> None:
    whole = one.pairs[0]
    water = whole._replace(z=torch.full_like(whole.z, 1e9))
    figure = replace(one, pairs=(water,)).plot()
    assert axes_of(figure, "Distance: open water")


def test_too_many_parameters_are_cut_short(one: Fit) -> None:
    more = {f"gain_{i}": Parameter(1.0, 0.1, 0.8, 1.2, "1", "free") for i in range(40)}
    figure = replace(one, parameters={**one.parameters, **more}).plot()
    # β, veil, source and ten gains
    assert "and 30 more, see the summary" in [text.get_text() for text in figure.texts]


@pytest.mark.parametrize(
    "largest, scale", [(0.0, 0.002), (0.004, 0.005), (0.011, 0.02), (0.2, 0.2), (0.7, 1.0)]
)
def test_scale(largest: float, scale: float) -> None:
    residual = torch.tensor([largest, -largest, torch.nan]).repeat(100)
    assert _scale([residual, torch.zeros(1)]) == pytest.approx(scale)


@pytest.mark.parametrize(
    "numbers, told",
    [
        ((0.54728, 0.00061, "free"), "0.54728 ± 0.00061"),
        ((12.3456, 1.5, "free"), "12.3 ± 1.5"),
        ((123.456, 15.2, "free"), "123 ± 15"),
        ((0.3, 1e-9, "free"), "0.30000 ± 0.00001"),
        ((0.02, None, "fixed"), "0.02 (fixed)"),
        ((4.3e-18, None, "at bound"), "0 (at bound)"),
        ((None, None, "not identified"), "not identified"),
    ],
)
def test_numbers_have_the_digits_that_their_errors_leave(numbers, told) -> None:
    value, error, state = numbers
    assert _told(Parameter(value, error, None, None, "1", state)) == told
