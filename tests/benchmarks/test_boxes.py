"""What a detector is scored and tuned by."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from benchmarks.evidence import boxes


def test_a_free_box_is_hit_once_and_an_ignored_region_counts_neither_way() -> None:
    def overlaps(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, ...]:
        pair = torch.from_numpy(first), torch.from_numpy(second)
        sides = first[:, 2:] - first[:, :2]
        shares = boxes.overlap(*pair).numpy()
        return shares * 100, shares, sides.prod(1)

    truth = SimpleNamespace(
        boxes=np.array([[0.0, 0, 10, 10]]), ignore=np.array([[50.0, 0, 60, 10]])
    )
    of_scores = {0.9: 0.0, 0.8: 1.0, 0.7: 50.0, 0.6: 30.0}  # score: left end
    found = np.array([[left, 0, left + 10, 10, score] for score, left in of_scores.items()])
    rows = boxes.matched(truth, found[::-1], overlaps)
    assert rows.tolist() == [[0.9, 1], [0.8, 0], [0.6, 0]]


def test_average_precision_is_the_area_under_the_best_precisions_also_of_resamples() -> None:
    hits = [np.array([[0.9, 1], [0.5, 0]]), np.array([[0.7, 0], [0.3, 1]]), np.zeros((0, 2))]
    counts = np.array([1, 2, 1])
    weights = np.array([[1.0, 1, 1], [1, 0, 0], [0, 2, 0], [0, 0, 1]])
    of_all, first, second, third = boxes.average_precisions(hits, counts, weights)
    # precision is 1 up to a recall of 1/4 and 1/2 up to 1/2: 26 and 25 of 101 levels
    assert of_all == pytest.approx((26 + 25 / 2) / 101)
    assert first == 1
    assert second == pytest.approx(51 / 2 / 101)
    assert third == 0


def test_answers_that_are_right_cost_less_and_every_box_gets_anchors() -> None:
    truth = torch.tensor([[16.0, 16, 48, 56], [40, 8, 56, 30]])
    kinds = torch.tensor([1, 0])
    middles, strides = boxes.anchors(64)
    generator = torch.Generator().manual_seed(0)
    logits = torch.full((1, len(middles), 3), -4.0)
    sizes = torch.rand(1, len(middles), 2, generator=generator) * 30 + 5
    wrong = torch.cat([middles[None], sizes, logits], 2)
    corners = torch.cat([wrong[0, :, :2] - sizes[0] / 2, wrong[0, :, :2] + sizes[0] / 2], 1)
    own, of = boxes.assigned(corners, logits[0], truth, kinds, middles, strides)
    assert sorted(set(of.tolist())) == [0, 1]
    right = wrong.clone()
    right[0, own, :2] = (truth[of, :2] + truth[of, 2:]) / 2
    right[0, own, 2:4] = truth[of, 2:] - truth[of, :2]
    right[0, own, 4] = 4.0
    right[0, own, 5 + kinds[of]] = 4.0
    losses = [float(boxes.loss_of(x, [(truth, kinds)], 64)) for x in (wrong, right)]
    assert losses[1] < losses[0] / 2
