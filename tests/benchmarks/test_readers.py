"""Crops of tags, and distances of the boards that nets learn to read."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from benchmarks.evidence import net, readers, wet_tags
from benchmarks.evidence.tasks import SIDE
from benchmarks.evidence.waters import PRESET


def test_a_crop_has_the_tag_in_its_middle_whatever_its_place_and_size() -> None:
    for middle, side in ((100.0, 20), (60.0, 40)):
        quad = middle + side / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        picture = np.zeros((200, 200, 3), np.float32)
        first, last = int(middle - side / 2), int(middle + side / 2)
        picture[first:last, first:last] = 1
        (square,) = readers.squares(quad[None])
        assert square.tolist() == [first, first, last, last]
        plain = readers.crop(picture, square)[..., 0]
        assert plain.mean() == pytest.approx(1 / readers.AROUND**2, rel=0.08)
        inside = np.flatnonzero(plain[SIDE // 2] > 0.5)
        assert inside.mean() == pytest.approx(SIDE / 2, abs=1)
        assert readers.crop(picture, square, scale=2).mean() < plain.mean() / 3
        moved = np.flatnonzero(readers.crop(picture, square, shift=(0.1, 0))[SIDE // 2, :, 0] > 0.5)
        assert moved.mean() == pytest.approx(0.6 * SIDE, abs=1)


def test_boards_are_planes_upon_the_nearest_of_what_they_cover(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    width, height = readers.SIZE
    ramp = np.broadcast_to(np.linspace(1, 2, width), (height, width))
    monkeypatch.setattr(readers, "made_up", lambda image, rng: np.where(ramp < 1.9, ramp, np.inf))
    corners = np.array([[-20, -20], [20, -20], [20, 20], [-20, 20]])
    quads = np.array([[100, 100], [355, 200]])[:, None] + corners

    def tag_scene(photograph: np.ndarray, *_: object, **__: object) -> tuple[np.ndarray, ...]:
        return photograph, quads, np.array([3, 7])

    photograph = np.zeros((480, 640, 3), np.uint8)
    scenes, maps = readers.scenes_of(SimpleNamespace(tag_scene=tag_scene), [photograph], 0)
    assert len(scenes) == len(maps) == readers.DRAWS
    (metres,) = maps[0]
    board = metres[75:126, 75:126]
    assert board.unique().numel() == 1
    assert float(board[0, 0]) == pytest.approx(np.percentile(ramp[0, 72:129], 20), abs=0.01)
    assert metres[180:220, 335:375].max() < 1.9  # half of it before open water
    assert metres[0].isinf().any()
    names = readers.degraded(lambda images, distances: images, scenes[:1], maps[:1], 0)[1]
    assert names.tolist() == [3] * readers.VIEWS + [7] * readers.VIEWS


def test_tags_are_turned_and_never_mirrored() -> None:
    picture = torch.arange(3 * 4 * 4).reshape(1, 3, 4, 4)
    torch.manual_seed(0)
    turns = readers.turned(picture.repeat(40, 1, 1, 1))
    assert {x.numpy().tobytes() for x in turns} == {
        picture[0].rot90(angle, (1, 2)).contiguous().numpy().tobytes() for angle in range(4)
    }


def test_green_is_stretched_and_all_else_forgotten() -> None:
    rng = np.random.default_rng(0)
    crops = rng.integers(60, 90, (2, 48, 48, 3)).astype(np.uint8)
    crops[..., 0] = 255
    grey = readers.green(crops)
    assert (grey.min((1, 2, 3)) == 0).all()
    assert (grey.max((1, 2, 3)) == 255).all()
    assert (grey == grey[..., :1]).all()
    assert readers.green(crops // 2 + 60) == pytest.approx(grey, abs=20)


def test_arms_are_compared_by_the_means_of_their_nets() -> None:
    scores = {name: np.array(nets)[:, None].repeat(401, 1) for name, nets in NETS.items()}
    row = net.compared(scores, "one")["two"]
    assert row["nets"] == [0.5, 0.7]
    assert (row["score"], row["difference"]) == pytest.approx((0.6, 0.4))
    # one net twice, or the other
    assert row["interval"] == pytest.approx([0.5, 0.7])
    assert row["blocks"] == pytest.approx([0.3, 0.5])
    # nets of one seed are resampled together
    assert net.compared(scores, "paired")["two"]["blocks"] == pytest.approx([0.1, 0.1])


NETS = {"two": [0.5, 0.7], "one": [0.2], "paired": [0.4, 0.6]}


def test_a_film_is_learnt_as_it_is_and_with_water_on_top(monkeypatch: pytest.MonkeyPatch) -> None:
    corners = 2 * np.array([[100, 60], [130, 60], [130, 90], [100, 90]])
    frame = np.full((2 * readers.SIZE[1], 2 * readers.SIZE[0], 3), 120, np.uint8)
    scenes = wet_tags.learnt_of([(frame, [readers.Tag("block", 50.0, 60.0, True, 3, corners)])])
    assert scenes[0].boxes.tolist() == [[100, 60, 130, 90]]
    seen = []

    monkeypatch.setattr(wet_tags, "trained", lambda x, names, *_: seen.extend([x.float(), names]))
    monkeypatch.setattr(wet_tags, "logits", lambda model, crops: torch.eye(readers.IDS)[:2])
    crops = torch.zeros(2, 3, SIDE, SIDE, dtype=torch.uint8)
    assert wet_tags.asked(PRESET, scenes, [], crops, 0).tolist() == [0, 1]
    dry, wet = seen[0].split([readers.VIEWS, wet_tags.DRAWS * readers.VIEWS])
    assert (dry - 120).abs().max() < 5
    assert (wet - 120).abs().mean() > 5
    assert seen[1].tolist() == [3] * readers.VIEWS * (1 + wet_tags.DRAWS)
