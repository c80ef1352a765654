"""The benchmark of made-up distances: scenes, training and measures."""

import csv
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

pytest.importorskip("scipy")

from benchmarks.depth import measures, pairs, scenes, train
from uwaug.distance import cue


@pytest.mark.parametrize("shape", scenes.SHAPES)
def test_scenes_have_distances_and_open_water_behind(shape) -> None:
    rng = np.random.default_rng(0)
    made = [scenes.scene(rng, shape) for _ in range(12)]
    for picture, log, is_open in made:
        assert picture.shape == (*shape, 3)
        assert picture.dtype == np.uint8
        assert log.shape == is_open.shape == shape
        assert bool(np.isfinite(log).all())
        if is_open.any() and not is_open.all():
            assert log[is_open].min() > log[~is_open].max() - 0.01
    assert 0.1 < np.mean([is_open.any() for *_, is_open in made]) < 0.95
    again = scenes.scene(np.random.default_rng(0), shape)
    assert all(map(np.array_equal, again, made[0]))


def folder_of_pairs(folder: Path) -> Path:
    """Six ramps, far above, of two sources; a corner is unknown."""
    rng = np.random.default_rng(0)
    levels = np.linspace(65535, 1, 96).round().astype(np.uint16)[:, None].repeat(128, 1)
    levels[:20, :20] = 0
    with (folder / "table.csv").open("w") as table:
        rows = csv.writer(table)
        rows.writerow(["name", "low", "high"])
        for name in (f"{source}_{number}" for source in ("one", "other") for number in range(3)):
            rows.writerow([name, "0", "2"])
            Image.fromarray(rng.integers(0, 256, (96, 128, 3), np.uint8)).save(
                folder / f"{name}.jpg"
            )
            Image.fromarray(levels).save(folder / f"{name}.png")
    return folder


def test_measures_of_maps_that_are_right_wrong_and_open(tmp_path) -> None:
    some = pairs.read(folder_of_pairs(tmp_path))
    assert {pair.source for pair in some} == {"one", "other"}
    assert np.isnan(some[0].log[:20, :20]).all()
    assert some[0].log[0, 50] == pytest.approx(2.0)
    right = measures.judged(measures.ramp, some)
    assert right["rank"] == pytest.approx(1.0)
    assert right["pairs"] == pytest.approx(1.0)
    assert right["false steps, %"] == right["wrong open water, %"] == 0.0
    wrong = measures.judged(lambda picture, seed: measures.ramp(picture, seed)[::-1], some)
    assert wrong["rank"] == pytest.approx(-1.0)

    def half_open(picture, seed):
        z = measures.ramp(picture, seed).copy()
        z[48:] = np.inf
        return z

    assert measures.judged(half_open, some)["wrong open water, %"] > 40

    def striped(picture, seed):
        return measures.ramp(picture, seed) * np.where(np.arange(128) % 16 < 8, 1, 3)

    some[0].log[:, 64:] = 1.0  # calm
    rng = np.random.default_rng(0)
    found = measures.compared(some[0], striped(torch.zeros(3, 96, 128), 0), rng)
    assert found["false steps, %"] > 5


def test_training_writes_weights_that_are_read(tmp_path, capsys) -> None:
    (tmp_path / "pairs").mkdir()
    folder = folder_of_pairs(tmp_path / "pairs")
    train.main(True, tmp_path / "cue.f16", folder, without=("other",))
    assert (tmp_path / "cue.f16").stat().st_size == cue.WEIGHTS.stat().st_size
    said = capsys.readouterr().out
    assert "3 real pairs, 3 kept to judge by" in said
    assert "rank" in said
