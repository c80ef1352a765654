"""From one water to another: halves that share no film, and nets that see water on top."""

import numpy as np
import pytest

from benchmarks.evidence import waters
from benchmarks.evidence.net import score
from benchmarks.evidence.sets import Crops


def crops() -> Crops:
    """Twelve crops each of five films, of which every second has a bright middle."""
    rng, count = np.random.default_rng(0), 60
    labels = np.arange(count) % 2
    images = rng.integers(0, 60, (count, 48, 48, 3), dtype=np.uint8)
    images[labels == 1, 16:32, 16:32] += 150
    films = np.arange(count) // 12
    light = np.full((count, 3), 0.2)
    return Crops(images, labels, light, np.arange(count) // 4, films, np.zeros(count, bool))


def test_halves_share_no_film() -> None:
    halves = [waters.half(crops(), which) for which in (0, 1)]
    assert not {*halves[0].films} & {*halves[1].films}
    assert sorted(len(half.labels) for half in halves) == [24, 36]


def test_nets_learn_from_crops_with_water_on_top(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waters, "STEPS", 40)
    seen = []
    monkeypatch.setattr(
        waters, "trained", lambda x, y, *rest: seen.append((x, y)) or TRAINED(x, y, *rest)
    )
    learnt, test = (waters.half(crops(), which) for which in (0, 1))
    answers = waters.asked(waters.DEFAULTS, learnt, {"test": test}, 0)["test"]
    pictures, labels = seen[0]
    count = len(learnt.labels)
    assert pictures.shape == (4 * count, 3, 48, 48)
    assert labels.tolist() == learnt.labels.tolist() * 4
    assert (pictures[count:].float() - pictures[:count].repeat(3, 1, 1, 1)).abs().mean() > 5
    assert score(answers, test.labels) > 0.9


TRAINED = waters.trained
