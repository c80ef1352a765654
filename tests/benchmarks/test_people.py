"""People that the network of made-up distances learns from, and is judged by."""

import numpy as np

from benchmarks.depth import people


def test_a_cut_out_lies_at_one_distance_before_what_it_hides() -> None:
    rng = np.random.default_rng(0)
    log = np.linspace(2, 0, 96)[:, None].repeat(128, 1)
    maps = (np.zeros((96, 128, 3), np.uint8), log, log > 1.8, np.ones((96, 128)))
    cut = np.full((60, 20, 4), 255, np.uint8)
    found = 0
    for draw in range(20):
        rgb, changed, is_open, weight = people.pasted(rng, maps, cut, stands=draw % 2 == 0)
        there = weight > 1
        if not there.any():  # it had no place
            continue
        found += 1
        assert np.ptp(changed[there]) == 0
        assert (changed[there] <= log[there] + 0.05).all()
        assert (changed[~there] == log[~there]).all()
        assert (rgb[there] > 0).all()
        assert not is_open[there].any()
    assert found > 10


def test_who_was_chosen() -> None:
    trained = {name for use in ("train", "sky") for name, _ in people.chosen(use)}
    judged = people.chosen("judge")
    assert len(judged) == len(set(judged)) == 40
    assert not trained & {name for name, _ in judged}
