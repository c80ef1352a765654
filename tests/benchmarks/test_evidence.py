import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("cv2")
pytest.importorskip("scipy")

from benchmarks.evidence import arms, colours, net, sets, stand_ins, tasks, training
from benchmarks.evidence.arms import DEFAULTS, through_camera


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sets")
    stand_ins.write(folder)
    return folder


@pytest.fixture(scope="module")
def real(data: Path) -> sets.Sets:
    return sets.cut(data)


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


def test_a_resample_is_scored_as_its_crops_are() -> None:
    rng = np.random.default_rng(0)
    labels, picked = rng.integers(0, 3, 40), rng.integers(0, 40, 40)
    often = np.bincount(picked, minlength=40)[None].astype(float)
    colours_of, fish = rng.normal(size=(40, 3)), rng.normal(size=(40, 2)).round(1)
    for answers, truth in ((colours_of, labels), (fish, labels // 2)):
        resampled = net.scores(answers, truth, often)
        assert resampled[0] == pytest.approx(net.score(answers[picked], truth[picked]))


def test_intervals_of_films_are_wider_where_films_differ() -> None:
    # the arm is right in one film of three, the reference nowhere
    films = np.repeat([0, 1, 2], 40)
    labels = np.arange(120) % 2
    blank = np.zeros((120, 48, 48, 3), np.uint8)
    blocks, judges = np.arange(120) // 4, np.zeros(120, bool)
    crops = sets.Crops(blank, labels, np.ones((120, 3)), blocks, films, judges)
    right = np.where(films[:, None] == 0, np.eye(2)[labels], 0.0)
    rows = net.table({"arm": [right], "none": [np.zeros((120, 2))]}, crops, "none")
    assert rows["arm"]["difference"] > 0.1
    (low, high), (lowest, highest) = rows["arm"]["blocks"], rows["arm"]["films"]
    assert lowest == 0 < low < high < highest


def test_crops_are_where_the_boxes_are(real: sets.Sets) -> None:
    # three are numbered as the rendered ones
    assert len(real.crops["buoys"].labels) == 3 * stand_ins.PICTURES - 3
    # every fourth is a penguin
    assert len(real.crops["aquaria"].labels) == 2 * 9
    for name in ("aquaria", "deepfish", "fjord"):
        crops = real.crops[name]
        assert crops.labels.tolist() == [1, 0] * (len(crops.labels) // 2)
        middles = crops.images[:, 20:28, 20:28].mean((1, 2, 3))
        assert middles[crops.labels == 1].min() > 120 > middles[crops.labels == 0].max()


def test_no_crop_shows_a_letterbox(real: sets.Sets) -> None:
    for name in ("deepfish", "fjord"):
        rows = real.crops[name].images.mean((2, 3))
        assert rows.min() > sets.BLACK
        assert all(picture.mean((1, 2)).min() > sets.BLACK for picture in real.references[name])


def test_no_two_parts_share_a_film(real: sets.Sets) -> None:
    for name in sets.SHOWN:
        crops = real.crops[name]
        judging, choosing = (set(crops.films[crops.judges == part]) for part in (True, False))
        assert judging
        assert choosing
        assert not judging & choosing
        blocks = set(crops.blocks[crops.judges]) & set(crops.blocks[~crops.judges])
        assert not blocks


def test_the_fjord_is_ordered_by_number_and_not_by_folder(data: Path) -> None:
    pictures = list(sets._fjord_pictures(data / sets.WILD / "datasets/fish4knowledge"))
    names = [f"{number}_jpg.jpg" for number in range(stand_ins.FJORD_PICTURES)]
    assert [picture.path.name for picture in pictures] == names
    assert [picture.film for picture in pictures] == [0] * 66 + [1] * 6


def test_small_crops_are_no_mosaics() -> None:
    ramp = np.tile(np.arange(0, 240, 10, np.uint8)[:, None], (24, 1, 3))
    crop = sets._cut(ramp.reshape(24, 24, 3), np.zeros(2), 12.0)
    assert np.diff(crop[24, :, 0].astype(int)).max() < 5


def test_a_set_without_crops_is_told(data: Path, tmp_path: Path) -> None:
    shutil.copytree(data, tmp_path / "sets")
    shutil.rmtree(tmp_path / "sets" / sets.WILD / "datasets/labels")
    with pytest.raises(SystemExit, match="deepfish"):
        sets.cut(tmp_path / "sets")


def test_a_kit_is_read_as_it_was_cut(real: sets.Sets, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="is missing: git clone"):
        sets.load(tmp_path)
    for name, crops in real.crops.items():
        arrays = {"images": crops.images, "labels": crops.labels, "light": crops.light}
        films = {} if name == "aquaria" else {"films": crops.films}
        np.savez(tmp_path / f"{name}.npz", **arrays, **films, numbers=np.arange(len(crops.labels)))
    with pytest.raises(SystemExit, match=r"buoys_0\.jpg is missing"):
        sets.load(tmp_path)
    for name, pictures in real.references.items():
        for index, picture in enumerate(pictures):
            stand_ins.save(picture / 255, tmp_path / f"references/{name}_{index}.jpg")
    with pytest.raises(SystemExit, match="land: no photographs"):
        sets.load(tmp_path)
    stand_ins.save(real.land[0], tmp_path / "land/0.jpg")
    kit = sets.load(tmp_path)
    for name, crops in real.crops.items():
        for part in ("images", "labels", "light", "films", "judges"):
            np.testing.assert_array_equal(getattr(kit.crops[name], part), getattr(crops, part))
    (tmp_path / "fjord.npz").unlink()
    with pytest.raises(SystemExit, match=r"fjord\.npz is missing"):
        sets.load(tmp_path)


def test_missing_repositories_are_named_with_the_cure(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"robosub.* is missing: git clone .* checkout 6664557"):
        sets.require(tmp_path)
    for name in sets.SETS:
        (tmp_path / name).mkdir()
    with pytest.raises(SystemExit, match="checkout 6664557"):
        sets.require(tmp_path)


def test_grey_world_makes_the_mean_grey() -> None:
    image = np.full((1, 48, 48, 3), (40, 120, 130), np.uint8)
    light = (image[:, 0, 0] / 255) ** 2.2
    nothing = np.zeros(1, int)
    crops = sets.Crops(image, nothing, light, nothing, nothing, nothing == 1)
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


def test_by_hand_far_things_and_open_water_are_in_the_veil() -> None:
    torch.manual_seed(0)
    distances = torch.tensor([0.5, 4.0, torch.inf]).expand(40, 1, 1, 3)
    seen = arms.by_hand(torch.ones(40, 3, 1, 3), distances)
    near, far, endless = seen[:, 0, 0].mean(0)  # red, of which the veil has little
    assert near > far + 0.2
    assert far == endless


@pytest.mark.parametrize("change", [arms.transferred, arms.matched, arms.fourier_adapted])
def test_rivals_bring_pictures_near_to_what_they_are_shown(change) -> None:
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(3, 48, 48, generator=generator)
    green = torch.tensor([0.1, 0.5, 0.4])[:, None, None]
    reference = green + 0.1 * torch.rand(3, 48, 48, generator=generator)
    changed = change(image, reference)
    apart = (changed.mean((1, 2)) - reference.mean((1, 2))).abs().max()
    assert apart < 0.1 < (image.mean((1, 2)) - reference.mean((1, 2))).abs().max()
    assert changed.std((1, 2)).min() > 0.01
    assert change(torch.full_like(image, 0.5), reference).isfinite().all()


def test_the_camera_is_the_same_for_all_arms() -> None:
    pictures = torch.rand(2, 3, 48, 48, generator=torch.Generator().manual_seed(0))
    seen = [through_camera(pictures, np.random.default_rng(3)) for _ in range(2)]
    assert torch.equal(*seen)
    assert seen[0].dtype == torch.uint8


def test_each_draw_of_a_picture_is_another_and_keeps_its_label() -> None:
    rng = np.random.default_rng(0)
    pool, _ = tasks.painted_balls([stand_ins.patches(rng)], 5, rng)
    pictures, labels = arms.degraded(arms.ours(), pool, draws=2, seed=0)
    assert labels.tolist() == 2 * pool.labels.tolist()
    assert (pictures[:5].float() - pictures[5:].float()).abs().mean((1, 2, 3)).min() > 1


@pytest.mark.filterwarnings("ignore:even the nearest draws")
def test_like_looks_at_what_it_is_shown(real: sets.Sets) -> None:
    rng = np.random.default_rng(0)
    pool, _ = tasks.painted_balls(real.land, 9, rng)
    teal = np.array([0.3, 0.9, 1.0])
    dim, bright = (np.tile(level * teal, (48, 48, 1)).astype(np.uint8) for level in (25, 250))
    seen = [
        arms.degraded(arms.like([shown], pool, 90), pool, draws=1, seed=0)[0].float().mean()
        for shown in (dim, bright)
    ]
    assert seen[0] + 20 < seen[1]


def test_arms_are_trained_scored_and_tabled(
    real: sets.Sets, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ["no water", "Li 2020", DEFAULTS, "FDA"]
    size = training.QUICK._replace(nets=2)
    results = training.measured(real, size, names, tmp_path)
    tables = results["tables"]
    for title in ("buoys", "buoys, grey-world", "deepfish", "fjord, grey-world"):
        assert list(tables[title]) == names
        row = tables[title][DEFAULTS]
        assert len(row["nets"]) == 2
        assert row["difference"] == 0 == row["blocks"][0] == row["films"][1]
    # what is shown pictures has nets for each test set
    kept = {path.name for path in tmp_path.glob("FDA*")}
    assert {"FDA, deepfish, 0.npz", "FDA, fjord, 0.npz"} < kept
    capsys.readouterr()
    assert training.measured(real, size, names, tmp_path) == results
    assert "  deepfish: " not in capsys.readouterr().out  # no net was trained
