import math
from collections.abc import Sequence
from pathlib import Path

import pytest
import torch
from texts import require_room

import uwaug
from uwaug.fitting import Fit, Patch, fit_patches, load_fit, read_patches

RATES, VEIL, GAIN = (0.4, 0.22, 0.26), (0.1, 0.28, 0.35), (2.0, 3.0, 4.0)
EXPOSURES = {"near": 1.0, "far": 0.7, "shade": 1.3}
METRES = {"near": (1.4, 2.6, 4.1, 5.5), "far": (4.7, 6.1, 7.6, 9.3), "shade": (3.0, 5.2, 8.0)}
GREYS = (0.03, 0.08, 0.14, 0.2, 0.26)
LINEAR = {"color_space": "linear"}
HEADER = "picture,chart,distance,air_red,air_green,air_blue,red,green,blue"


def charts(seed: int, *, uneven: float = 0.25, noise: float = 0.03, tape: float = 0) -> list[Patch]:
    """Patches as `uwaug.Underwater` shows them, at distances off by a share `tape`."""
    rng, patches = torch.Generator().manual_seed(seed), []
    water = uwaug.Underwater(
        uwaug.Medium.from_coefficients(RATES, RATES, VEIL), color_space="linear"
    )

    def normal(*size: int) -> torch.Tensor:
        return torch.randn(*size, generator=rng)

    for picture, metres in METRES.items():
        for k, z in enumerate(metres):
            light = math.exp(uneven * float(normal(1)))
            true_z = z * math.exp(tape * float(normal(1)))
            board = light * torch.tensor(GAIN)[:, None, None] * torch.tensor(GREYS)
            board = water(board, torch.full((1, 1, len(GREYS)), true_z))[:, 0].T
            for grey, light_of_grey in zip(GREYS, board, strict=True):
                seen = EXPOSURES[picture] * light_of_grey * (1 + noise * normal(3))
                patches.append(Patch(picture, str(k), z, (grey,) * 3, tuple(seen.tolist())))
    return patches


def of(fit: Fit, kind: str, names: Sequence[str] = ("red", "green", "blue")) -> list[float | None]:
    return [fit.parameters[f"{kind}_{name}"].value for name in names]


def test_finds_water_exposures_and_light() -> None:
    fit = fit_patches(charts(0, uneven=0, noise=0.001), **LINEAR)
    assert of(fit, "beta") == pytest.approx(RATES, rel=0.02)
    assert of(fit, "veil") == pytest.approx(VEIL, rel=0.02)
    assert of(fit, "gain") == pytest.approx(GAIN, rel=0.05)
    assert of(fit, "exposure", [*EXPOSURES]) == pytest.approx([*EXPOSURES.values()], rel=0.02)
    assert of(fit, "light", ["near/0", "far/3"]) == pytest.approx([1, 1], abs=0.05)
    # the mean of eleven lights, which are off by what is said and not by what few charts show
    gain = fit.parameters["gain_green"]
    assert gain.error == pytest.approx(gain.value * 0.3 / 11**0.5, rel=0.02)
    z = torch.tensor([2.0, 6.0])
    truth = uwaug.Medium.from_coefficients(RATES, RATES, VEIL)
    torch.testing.assert_close(
        fit.medium.backscatter(z).float(), truth.backscatter(z).float(), atol=0.003, rtol=0
    )


@pytest.mark.parametrize("tape", [0.0, 0.1])
def test_intervals_hold_the_truth(tape: float) -> None:
    inside = []
    for seed in range(4):
        fit = fit_patches(charts(seed, tape=tape), distance_error=tape, **LINEAR)
        for kind, truth in (("beta", RATES), ("veil", VEIL)):
            for colour, right in zip(("red", "green", "blue"), truth, strict=True):
                number = fit.parameters[f"{kind}_{colour}"]
                if number.low is not None and number.high is not None:
                    inside.append(number.low <= right <= number.high)
    assert len(inside) > 14
    assert sum(inside) >= 0.85 * len(inside)


def test_a_chart_in_the_shade_is_told_and_leaves_the_rates_alone() -> None:
    patches = [
        p._replace(water=tuple(0.4 * (x - v) + v for x, v in zip(p.water, ends, strict=True)))
        if (p.picture, p.chart) == ("near", "2")
        else p
        for p in charts(1, uneven=0.02)
        for ends in [
            [v * (1 - math.exp(-g * p.distance)) for v, g in zip(VEIL, RATES, strict=True)]
        ]
    ]
    fit, alike = fit_patches(patches, **LINEAR), fit_patches(patches, uneven=0, **LINEAR)
    error = [max(abs(x.medium.G[0] - torch.tensor(RATES)).tolist()) for x in (fit, alike)]
    assert error[0] < 0.04
    assert error[0] < 0.5 * error[1]
    assert fit.parameters["light_near/2"].value == pytest.approx(0.4, abs=0.1)
    assert any("near/2 by 0.4" in note for note in fit.notes)


def test_clipped_values_do_not_count() -> None:
    patches = charts(2, uneven=0, noise=0)
    patches[4] = patches[4]._replace(water=(math.nan, math.nan, patches[4].water[2]))
    assert of(fit_patches(patches, **LINEAR), "beta") == pytest.approx(RATES, rel=0.01)


def test_another_white_balance_is_told() -> None:
    red = (1.6, 1.0, 1.0)
    patches = [
        p._replace(water=tuple(x * gain for x, gain in zip(p.water, red, strict=True)))
        if p.picture == "far"
        else p
        for p in charts(1, uneven=0.1, noise=0.01)
    ]
    assert any("has another cast" in note for note in fit_patches(patches, **LINEAR).notes)
    assert not any("cast" in note for note in fit_patches(charts(1), **LINEAR).notes)


def test_a_preset_is_for_pictures_of_any_exposure(tmp_path: Path) -> None:
    fit_patches(charts(3, noise=0.01), **LINEAR).save(tmp_path / "fit.json")
    image = torch.rand(3, 48, 64, generator=torch.Generator().manual_seed(0))
    wet = uwaug.load_preset(tmp_path / "fit.json")(image, torch.full((1, 48, 64), 1.0))[0]
    assert wet.mean() == pytest.approx(float(image.mean()), abs=0.1)
    assert (wet > 0.999).float().mean() < 0.05


def test_is_a_fit_like_any_other(tmp_path: Path) -> None:
    patches = charts(3, noise=0.01)
    fit = fit_patches(patches, model="veil", **LINEAR)
    fit.save(tmp_path / "fit.json")
    again = load_fit(tmp_path / "fit.json")
    assert again.summary() == fit.summary()
    assert "light_far/1" in again.summary()
    assert again.module()(torch.rand(3, 8, 8), torch.full((1, 8, 8), 4.0)).isfinite().all()


def test_a_figure_shows_each_patch_by_distance(monkeypatch: pytest.MonkeyPatch) -> None:
    patches = charts(3)
    patches[4] = patches[4]._replace(water=(math.nan, *patches[4].water[1:]))
    fit = fit_patches(patches, **LINEAR)
    shown, curves, _ = fit.plot().axes
    for c, points in enumerate(shown.collections):
        measured, fitted = torch.from_numpy(points.get_offsets().filled(math.nan)).T
        seen = [p.water[c] if p.water[c] < 1 else math.nan for p in patches]  # else clipped
        assert measured.tolist() == pytest.approx(seen, nan_ok=True)
        assert points.get_array()[5:].tolist() == [p.distance for p in patches[5:]]
        assert 0 < (fitted / measured - 1).abs().nanmedian() < 0.03
    # their height is not the gain of the charts
    assert [line.get_ydata()[0] for line in curves.lines[:3]] == pytest.approx([1, 1, 1])
    assert require_room(fit.plot, monkeypatch, margin=10) > 10


def test_a_table_says_the_same_with_commas_and_semicolons(tmp_path: Path) -> None:
    patches = charts(4)
    comma, semicolon = tmp_path / "a.csv", tmp_path / "b.csv"
    rows = [[p.picture, p.chart, p.distance, *p.air, *p.water] for p in patches]
    rows[0][-1] = ""  # clipped
    comma.write_text("\n".join([HEADER, *(",".join(map(str, row)) for row in rows)]))
    cells = [";".join(str(cell).replace(".", ",") for cell in row) for row in rows]
    cells.append(8 * ";")  # as spreadsheets write below a table
    semicolon.write_text("\n".join([HEADER.replace(",", ";"), *cells]), "utf-8-sig")
    first, *others = read_patches(comma)
    assert math.isnan(first.water[2])
    assert others == patches[1:]
    assert read_patches(semicolon)[1:] == others


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEADER.replace("air_blue", "blue_air"), "expected a column air_blue"),
        (f"{HEADER}\na,1,2,.1,.1,.1,.2,.2,x", "line 2: expected numbers"),
        (f"{HEADER}\na,1,1,5,.1,.1,.1,.2,.2,.2", "line 2: expected numbers"),
        (f"{HEADER}\na,1,2,.1", "line 2: expected numbers"),
        (f"{HEADER}\na,1,,.1,.1,.1,.2,.2,.2", "line 2: expected numbers"),
    ],
)
def test_refuses_a_table(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "charts.csv").write_text(text)
    with pytest.raises(ValueError, match=words):
        read_patches(tmp_path / "charts.csv")


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        ({"distance": 3.0}, LINEAR, "distance must be several"),
        ({"distance": math.nan}, LINEAR, "distance must be several"),
        ({"distance": math.inf}, LINEAR, "distance must be several"),
        ({"chart": "a"}, LINEAR, "chart near/a lies at 1.4 to 5.5 m"),
        ({"air": (math.nan,) * 3}, LINEAR, "air"),
        ({"air": (90.0, 90.0, 90.0)}, LINEAR, "air, brightest must be in"),
        ({"water": (4095.0, 4095.0, 4095.0)}, LINEAR, "water, brightest must be in"),
        ({"air": (120.0, 90.0, 80.0)}, {"color_space": "srgb"}, "divide"),
        ({"distance": 420.0}, LINEAR, "distance must be several, 0…100 m"),
        ({"water": (math.nan, 0.2, 0.2)}, LINEAR, "only 0 have a value"),
        ({}, {"uneven": -1, **LINEAR}, "uneven"),
        ({}, {"model": "auto", **LINEAR}, "model"),
    ],
)
def test_refuses(change: dict[str, object], options: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        fit_patches([patch._replace(**change) for patch in charts(5)], **options)


def test_refuses_an_empty_table() -> None:
    with pytest.raises(ValueError, match="distance must be several"):
        fit_patches([], **LINEAR)
