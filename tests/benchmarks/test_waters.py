"""From one water to another: halves that share no film, and nets that see water on top."""

import numpy as np
import pytest
import torch

from benchmarks.evidence import waters
from benchmarks.evidence.net import score
from benchmarks.evidence.sets import Crops, Sets


def crops() -> Crops:
    """Twelve crops each of five films, of which every second has a bright middle."""
    rng, count = np.random.default_rng(0), 60
    labels = np.arange(count) % 2
    images = rng.integers(0, 60, (count, 48, 48, 3), dtype=np.uint8)
    images[labels == 1, 16:32, 16:32] += 150
    films = np.arange(count) // 12
    light = np.tile((0.1, 0.2, 0.3), (count, 1))
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
    answers = waters.asked(waters.DEFAULTS, learnt, {"test": test}, [], 0)["test"]
    pictures, labels = seen[0]
    count = len(learnt.labels)
    assert pictures.shape == (4 * count, 3, 48, 48)
    assert labels.tolist() == learnt.labels.tolist() * 4
    assert (pictures[count:].float() - pictures[:count].repeat(3, 1, 1, 1)).abs().mean() > 5
    assert score(answers, test.labels) > 0.9


@pytest.mark.parametrize("arm", waters.ON_TOP)
def test_arms_change_pictures_and_are_timed(arm: str) -> None:
    shown = [np.full((60, 80, 3), (20, 90, 60), np.uint8)]
    some = crops()
    images = torch.from_numpy(some.images[:4]).permute(0, 3, 1, 2) / 255
    changed = waters.ON_TOP[arm](shown)(images, torch.full((4, 1, 48, 48), 3.0))
    assert changed.shape == images.shape
    assert (changed - images).abs().mean() > 0.02 or arm == waters.AS_THEY_ARE
    real = Sets([], {"fjord": some}, {"fjord": shown})
    assert waters.costs(real, [arm])[arm] >= 0


@pytest.mark.parametrize("arm", waters.PREPARED)
def test_tests_are_prepared_as_what_is_learnt(arm: str, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(waters, "STEPS", 1)
    monkeypatch.setattr(waters, "answers", lambda net, test, balanced: seen.append(test.images))
    waters.asked(arm, crops(), {"test": crops()}, [], 0)
    assert (seen[0] == waters.PREPARED[arm][1](crops())).all()
    assert (seen[0] != crops().images).mean() > 0.5


TRAINED = waters.trained
