"""What guides say was measured is what results hold, and their verdicts and scores are sums that
are right. Benchmarks themselves are run by hand, and in `.ci/run` with `--quick`.
"""

import numpy as np
import pytest
import torch

from benchmarks.evidence import net, sets
from benchmarks.figures import summary
from benchmarks.speed import frontier


def test_the_guide_shows_what_was_measured() -> None:
    text = summary.PAGE.read_text()
    assert summary.updated(text) == text
    for name in summary.SECTIONS:
        with pytest.raises(ValueError, match=f"figures: {name} once, found them 0 times"):
            summary.updated(text.replace(f"<!-- /figures: {name} -->", ""))


def test_every_panel_has_one_default_and_a_front() -> None:
    panels = summary.load("frontier")["panels"].values()
    parts = {panel["part"].split()[0] for panel in panels}
    assert parts == {"blur", "spectra", "number", "forward"}
    for panel in panels:
        judged = frontier.judged([entry | {"front": None} for entry in panel["entries"]])
        assert judged == {name: panel[name] for name in ("entries", "verdict")}
        assert sum(entry["default"] for entry in panel["entries"]) == 1
        assert panel["verdict"]["psnr_db"] > 60


def test_front_agrees_with_its_definition() -> None:
    generator = torch.Generator().manual_seed(0)
    points = [tuple(p) for p in torch.randint(0, 12, (60, 2), generator=generator).tolist()]

    def beaten(p: tuple[float, ...]) -> bool:
        return any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points)

    assert sorted(frontier.pareto(points)) == [i for i, p in enumerate(points) if not beaten(p)]


@pytest.mark.parametrize(
    ("ours", "slower", "best"),
    [(0, 0.0, 0), (2, 0.5, 1), (3, 0.0, 3), (4, 0.0, 4), (5, 0.0, 5), (6, 0.5, 1)],
)
def test_excess_is_the_time_over_the_fastest_as_accurate(
    ours: int, slower: float, best: int
) -> None:
    # the last is a near tie in accuracy, which counts against us
    points = [(1.0, 0.5), (2.0, 0.1), (3.0, 0.2), (4.0, 0.01), (4.0, 0.02), (9.0, 0.0)]
    points.append((3.0, 0.0995))
    assert frontier.excess(points, ours) == (pytest.approx(slower), best)


def test_scores_are_areas_under_curves_and_mean_recalls_also_of_resamples() -> None:
    rng = np.random.default_rng(0)
    labels, answers = rng.integers(0, 2, 40), rng.integers(0, 5, (40, 2)).astype(float)
    margin = answers[:, 1] - answers[:, 0]
    pairs = margin[labels == 1][:, None] - margin[labels == 0]
    in_order = (pairs > 0).mean() + (pairs == 0).mean() / 2
    assert net.score(answers, labels) == pytest.approx(in_order)
    assert net.score(np.eye(3)[[0, 0, 0, 2, 2]], np.array([0, 0, 0, 1, 2])) == pytest.approx(2 / 3)
    picked = rng.integers(0, 40, 40)
    often = np.bincount(picked, minlength=40)[None].astype(float)
    of_colours = rng.normal(size=(40, 3)), rng.integers(0, 3, 40)
    for given, truth in (of_colours, (answers, labels)):
        resampled = net.scores(given, truth, often)
        assert resampled[0] == pytest.approx(net.score(given[picked], truth[picked]))


def test_intervals_of_films_are_wider_where_films_differ() -> None:
    # the arm is right in one film of three, the reference nowhere
    films, labels = np.repeat([0, 1, 2], 40), np.arange(120) % 2
    blank, judges = np.zeros((120, 48, 48, 3), np.uint8), np.zeros(120, bool)
    crops = sets.Crops(blank, labels, np.ones((120, 3)), np.arange(120) // 4, films, judges)
    right = np.where(films[:, None] == 0, np.eye(2)[labels], 0.0)
    rows = net.table({"arm": [right], "none": [np.zeros((120, 2))]}, crops, "none")
    assert rows["arm"]["difference"] > 0.1
    (low, high), (lowest, highest) = rows["arm"]["blocks"], rows["arm"]["films"]
    assert lowest == 0 < low < high < highest
