from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("cv2")
pytest.importorskip("scipy")

from benchmarks.evidence import colours, net, sets, stand_ins, tasks, training
from benchmarks.evidence.arms import DEFAULTS, through_camera


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sets")
    stand_ins.write(folder)
    return folder


def test_an_area_under_the_curve_is_the_share_of_pairs_in_order() -> None:
    rng = np.random.default_rng(0)
    labels, answers = rng.integers(0, 2, 40), rng.integers(0, 5, (40, 2)).astype(float)
    margin = answers[:, 1] - answers[:, 0]
    pairs = margin[labels == 1][:, None] - margin[labels == 0]
    expected = (pairs > 0).mean() + (pairs == 0).mean() / 2
    assert net.score(answers, labels) == pytest.approx(expected)


def test_recall_counts_each_class_alike() -> None:
    labels = np.array([0, 0, 0, 1, 2])
    assert net.score(np.eye(3)[[0, 0, 0, 2, 2]], labels) == pytest.approx(2 / 3)


def test_crops_are_where_the_boxes_are(data: Path) -> None:
    coloured, grey = sets.buoys(data)
    # number 1500 is one of the rendered ones
    assert len(coloured.labels) + len(grey.labels) == 3 * stand_ins.PICTURES - 1
    deepfish, fjord = sets.wild(data)
    for crops in (deepfish, fjord, sets.aquaria(data)):
        assert crops.labels.tolist() == [1, 0] * stand_ins.PICTURES
        middles = crops.images[:, 20:28, 20:28].mean((1, 2, 3))
        assert middles[crops.labels == 1].min() > 120 > middles[crops.labels == 0].max()
    assert set(deepfish.judges) == {True, False}


def test_grey_world_makes_the_mean_grey() -> None:
    image = np.full((1, 48, 48, 3), (40, 120, 130), np.uint8)
    light = (image[:, 0, 0] / 255) ** 2.2
    crops = sets.Crops(image, np.zeros(1), light, np.zeros(1), np.zeros(1, bool))
    balanced = net.grey_world(crops)
    assert np.ptp(balanced.astype(int)) <= 1


def test_no_ball_is_behind_what_is_behind_it() -> None:
    rng = np.random.default_rng(0)
    pool, radii = tasks.painted_balls([stand_ins.patches(rng)], 30, rng)
    near = torch.where(radii[:, None] < 1, pool.distances, torch.inf).amin((1, 2, 3))
    assert torch.equal(near, pool.distances.amin((1, 2, 3)))
    open_water = pool.distances.amax((1, 2, 3)) == torch.inf
    assert 0.4 < open_water.float().mean() < 1
    assert pool.labels.bincount().tolist() == [10, 10, 10]


def test_balls_are_measured_against_their_rings() -> None:
    radii = torch.linspace(0, 3, 48).expand(3, 48, 48)
    water, ball = torch.tensor(colours.REAL["ring"]), torch.tensor([0.5, 0.1, 0.1])
    images = torch.where(radii[:, None] < 1, ball[:, None, None], water[:, None, None])
    found = colours.ball_less_ring(images, radii, torch.arange(3))
    np.testing.assert_allclose(found["red"], ball - water, atol=1e-6)
    np.testing.assert_allclose(found["ring"], water, atol=1e-6)
    assert found["dark"] == 1


def test_the_camera_is_the_same_for_all_arms() -> None:
    pictures = torch.rand(2, 3, 48, 48, generator=torch.Generator().manual_seed(0))
    seen = [through_camera(pictures, np.random.default_rng(3)) for _ in range(2)]
    assert torch.equal(*seen)
    assert seen[0].dtype == torch.uint8


def test_missing_sets_are_named_with_the_cure(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"robosub.* is missing: git clone .* checkout 6664557"):
        sets.require(tmp_path)
    for name in sets.SETS:
        (tmp_path / name).mkdir()
    with pytest.raises(SystemExit, match="checkout 6664557"):
        sets.require(tmp_path)


def test_arms_are_trained_scored_and_tabled(data: Path) -> None:
    steps = {"colour": 2, "fish": 2}
    arms = ["no water", "Li 2020", DEFAULTS]
    found = training.measured(data, seeds=2, balls=9, steps=steps, arms=arms)
    for title in ("buoys", "buoys, grey-world", "grey pool", "DeepFish", "fjord, grey-world"):
        assert list(found[title]) == arms
        row = found[title][DEFAULTS]
        assert len(row["seeds"]) == 2
        assert row["difference"] == 0 == row["interval"][0] == row["interval"][1]
