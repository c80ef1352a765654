import time
from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("cv2")
pytest.importorskip("matplotlib")
pytest.importorskip("scipy")

from referees import published
from referees.exact import blur_exact

import uwaug
from benchmarks.accuracy import surfaces
from benchmarks.figures import charts, gallery, knobs, reef, summary
from benchmarks.harness import race
from benchmarks.speed import blurs, frontier

#            0          1          2          3          4          5
POINTS = [(1.0, 0.5), (2.0, 0.1), (3.0, 0.2), (4.0, 0.01), (4.0, 0.02), (9.0, 0.0)]


def test_front_agrees_with_its_definition() -> None:
    generator = torch.Generator().manual_seed(0)
    points = [tuple(p) for p in torch.randint(0, 12, (60, 2), generator=generator).tolist()]

    def beaten(p: tuple[float, ...]) -> bool:
        return any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points)

    assert sorted(frontier.pareto(points)) == [i for i, p in enumerate(points) if not beaten(p)]


@pytest.mark.parametrize(
    ("ours", "slower", "best"), [(0, 0.0, 0), (2, 0.5, 1), (3, 0.0, 3), (4, 0.0, 4), (5, 0.0, 5)]
)
def test_excess_is_the_time_over_the_fastest_as_accurate(
    ours: int, slower: float, best: int
) -> None:
    assert frontier.excess(POINTS, ours) == (pytest.approx(slower), best)


def test_a_near_tie_in_accuracy_counts_against_us() -> None:
    assert frontier.excess([(1.0, 0.1005), (2.0, 0.1)], 1) == (1.0, 0)
    assert frontier.excess([(1.0, 0.102), (2.0, 0.1)], 1) == (0.0, 1)


def test_verdict() -> None:
    entries = []
    for i, (time_ms, rmse) in enumerate(POINTS):
        entry = {"name": str(i), "default": i == 2, "psnr_db": None}
        entries.append({**entry, "median_ms": time_ms, "rmse": rmse})
    panel = frontier.judged(entries)
    assert [e["front"] for e in panel["entries"]] == [True, True, False, True, False, True]
    verdict = panel["verdict"]
    assert (verdict["on_front"], verdict["within_10_percent"]) == (False, False)
    assert verdict["beaten_by"] == "1"
    assert verdict["slower_than_front"] == pytest.approx(0.5)


def test_a_slow_rival_does_not_cut_the_race_short() -> None:
    times = race({"ours": lambda: None, "slow": lambda: time.sleep(0.02)}, 9, 0.01, "ours")
    assert times["slow"]["rounds"] == 3 < times["ours"]["rounds"] <= 9


def test_errors_are_of_the_image() -> None:
    exact = torch.rand(1, 3, 16, 16, generator=torch.Generator().manual_seed(0)).double()
    assert frontier.errors(exact, exact) == {"max": 0.0, "rmse": 0.0, "psnr_db": None, "ssim": 1.0}
    wrong = frontier.errors(exact + 0.01, exact)
    assert wrong["psnr_db"] == pytest.approx(40)
    assert wrong["max"] == pytest.approx(0.01)


def test_tiles_are_the_exact_blur() -> None:
    rng = torch.Generator().manual_seed(0)
    image = torch.rand(1, 3, 70, 70, generator=rng)
    sigma = 0.5 + 3 * torch.rand(1, 1, 70, 70, generator=rng)
    whole = blur_exact(image[0], sigma[0, 0]).reshape(1, 3, 70, 70)
    torch.testing.assert_close(blurs.exact(image, sigma)[0], whole, rtol=0, atol=1e-13)


def test_guides_show_what_was_measured() -> None:
    assert sorted(sum(summary.PAGES.values(), ())) == sorted(summary.SECTIONS)
    for page, names in summary.PAGES.items():
        text = page.read_text()
        assert summary.updated(text, names) == text
        for name in names:
            message = f"expected the markers of figures: {name} once, found them 0 times"
            with pytest.raises(ValueError, match=message):
                summary.updated(text.replace(f"<!-- /figures: {name} -->", ""), names)


def test_the_authors_loops_are_the_published_recipe() -> None:
    rng = np.random.default_rng(0)
    image, distance = rng.random((30, 40, 3)), 1 + 4 * rng.random((30, 40))
    field, bands = 0.7 + 0.6 * rng.random((30, 40)), published.doubled(published.bands("7C"))
    loops = published.authors(image, distance, field, bands)
    np.testing.assert_allclose(loops, published.published(image, distance, field, bands), atol=1e-6)
    assert np.abs(loops - image).max() > 0.1


# what is committed; `.ci/run` runs the benchmarks themselves
FRONTIER = summary.load("frontier")


def test_every_panel_has_one_default_and_a_front() -> None:
    panels = FRONTIER["panels"].values()
    parts = {panel["part"].split()[0] for panel in panels}
    assert parts == {"blur", "spectra", "number", "forward"}
    for panel in panels:
        judged = frontier.judged([entry | {"front": None} for entry in panel["entries"]])
        assert judged == {name: panel[name] for name in ("entries", "verdict")}
        assert sum(entry["default"] for entry in panel["entries"]) == 1
        assert panel["verdict"]["psnr_db"] > 60


def test_charts_are_drawn(tmp_path: Path) -> None:
    # to place the labels of all panels takes seconds
    shown = [
        (len(panel["entries"]), name)
        for name, panel in FRONTIER["panels"].items()
        if (panel["size"], panel["threads"]) == charts.SHOWN
    ]
    panels = {name: FRONTIER["panels"][name] for _, name in sorted(shown)[:3]}
    assert len(panels) == 3
    path = tmp_path / "frontier.png"
    charts.frontier_figure({**FRONTIER, "panels": panels}).savefig(path, dpi=30)
    assert path.stat().st_size > 5000


def test_galleries_hold_a_picture_for_each() -> None:
    found = gallery.main(quick=True)
    systems = len(uwaug.published.systems()) - 1
    assert len(found["systems"].axes) == 2 + 2 * systems
    assert len(found["reds"].axes) == 2 * len(gallery.DEPTHS)


def test_thick_water_hides_fish_of_the_reef(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reef, "CELLS", 160)
    small = reef.reef.__wrapped__(width=120)
    image, distance, boxes = small
    assert image.shape == (3, 80, 120)
    assert image.min() >= 0
    assert image.max() <= 1
    assert distance.isinf().any()
    for left, top, right, bottom in boxes.int().tolist():
        assert distance[0, top:bottom, left:right].min() < 6.2
    monkeypatch.setattr(gallery, "reef", lambda: small)
    sheet = gallery.detection()
    dotted = [sum(p.get_linestyle() == ":" for p in axis.patches) for axis in sheet.axes]
    assert dotted == sorted(dotted)
    assert dotted[0] == 0 < dotted[-1] < len(boxes)


def test_each_row_of_the_sheet_of_ranges_changes_the_picture() -> None:
    image = torch.rand(3, 24, 36, generator=torch.Generator().manual_seed(0))
    distance = torch.linspace(1, 5, 24 * 36).reshape(1, 24, 36)
    for name, five in knobs.values().items():
        pictures = [knobs.at(name, value, image, distance) for value in (five[0], five[-1])]
        assert (pictures[0] - pictures[1]).abs().max() > 0.02, name


def test_colours_are_refereed() -> None:
    checker = np.stack(list(surfaces.samples()["ColorChecker"].values()))
    assert checker.shape == (24, 61)
    at_lens = surfaces.seen(checker, uwaug.Water.jerlov("III"), 0.0, 0.0)
    for colours in at_lens.values():
        np.testing.assert_allclose(colours, at_lens["truth"], rtol=0, atol=1e-7)
    rows = surfaces.errors(checker, ("III",))
    table = surfaces.summary(rows)
    assert 2 * table[surfaces.BASIS]["worst"] < table[surfaces.CHANNEL]["worst"]
    assert table[surfaces.BASIS]["mean"] < 0.012
    assert all(row["depth_m"] < 25 or row["distance_m"] < 8 for row in rows), "where it is dark"
    surfaces.draw(None)
