"""All frames of a clip in one water."""

import json
from itertools import pairwise

import pytest
import torch
from augmenting import QUIET

from uwaug import RandomDevelopment, RandomUnderwater, RandomWater, Sensor
from uwaug.distance import MadeUp
from uwaug.formation.field import random_fields
from uwaug.optics.view import WIDE
from uwaug.presets.scene import motorcycle

STEP = 20
WIDTH = 240


@pytest.fixture(scope="module")
def frames():
    """A pan to the right, and a move towards the scene."""
    scene = motorcycle()
    image = (scene.image[:, 100:340] * 255).byte()
    distance = scene.distance[:, 100:340].float()
    views = [slice(STEP * t, STEP * t + WIDTH) for t in range(8)]
    pan = [(image[..., view], distance[..., view]) for view in views]
    dolly = [(image[..., :WIDTH], (1 - 0.03 * t) * distance[..., :WIDTH]) for t in range(8)]
    return pan, dolly


def clip(augment, frames, seed, drift=0.0, motion=(0.0, 0.0, 0.0)):
    generator = torch.Generator().manual_seed(seed)
    params = augment.make_params(frames[0][0], generator)
    record = json.loads(json.dumps(augment.for_clip(params, *frames[0])))
    for t, frame in enumerate(frames):
        record["samples"][0] |= {"moved": drift * t, "motion": [step * t for step in motion]}
        yield augment.transform(*frame, record).float()


@pytest.mark.parametrize("drift", [0.0, 0.004])
def test_what_two_frames_share_changes_by_two_levels_at_most(frames, drift):
    pan, dolly = frames
    for seed in range(4):
        augment = RandomUnderwater(light=None, development=QUIET)  # lamps move with the camera
        panned = list(clip(augment, pan, seed, drift))
        pairs = [(a[..., STEP:], b[..., :-STEP]) for a, b in pairwise(panned)]
        moved = list(clip(augment, dolly, seed, drift))
        for one, other in pairs + list(pairwise(moved)):
            assert float((one.mean((1, 2)) - other.mean((1, 2))).abs().max()) <= 2
        for one, other in pairs:  # a twelfth of the width apart, in a field that stays
            changes = (one - other).abs().amax(0).flatten()
            assert changes.quantile(0.5) <= 2
            assert changes.quantile(0.99) <= 12


def test_a_field_stays_in_the_water_where_a_camera_moves(frames):
    pan, _ = frames
    augment = RandomUnderwater(light=None, development=QUIET)
    changes = []
    for sign in (1, 0, -1):
        params = augment.make_params(pan[0][0], torch.Generator().manual_seed(2))
        median = augment.for_clip(params, *pan[0])["samples"][0]["measured"]["median"]
        step = sign * STEP * median / WIDE.focal(WIDTH)
        panned = list(clip(augment, pan, 2, motion=(step, 0.0, 0.0)))
        pairs = [(a[..., STEP:-9], b[..., : -STEP - 9]) for a, b in pairwise(panned)]
        changes.append(sum(float((a - b).abs().mean()) for a, b in pairs))
    assert 2 * changes[0] < changes[1] < changes[2]


def test_the_first_frame_is_that_of_a_still(frames):
    first = frames[0][0]
    augment = RandomUnderwater()
    params = augment.make_params(first[0], torch.Generator().manual_seed(3))
    record = augment.for_clip(params, *first)
    still, frame = (augment.transform(*first, each) for each in (params, record))
    assert int((still.int() - frame.int()).abs().max()) <= 1
    # all frames at once, and by PyTorch for gradients
    batch = torch.stack([image for image, _ in frames[0]])
    maps = torch.stack([z for _, z in frames[0]])
    together = augment.transform(batch, maps, record)
    alone = [augment.transform(*each, record) for each in frames[0]]
    assert torch.equal(together, torch.stack(alone))
    image = (first[0] / 255).requires_grad_()
    slow = augment.transform(image, first[1], record)
    assert float((slow.detach() * 255 - frame).abs().max()) < 1.5


def test_a_field_moves_as_a_whole():
    like = torch.zeros(1)
    ways = [(0.0, 0.0), (12.0, -5.0)]
    still, moved = random_fields([5, 5], (60, 90), 0.7, 1.3, like, ways).split(1)
    shared = still[..., 5:, :-12], moved[..., :-5, 12:]
    inside = (shared[1] > 0.7) & (shared[1] < 1.3)
    torch.testing.assert_close(shared[0][inside], shared[1][inside], atol=1e-5, rtol=0)
    assert float((still - moved).abs().max()) > 0.05


def test_a_whole_clip_is_settled_on_its_middle_frame(frames):
    augment = RandomUnderwater(development=RandomDevelopment(noise=Sensor(2000, 3)))
    batch, maps = (torch.stack(each) for each in zip(*frames[0], strict=True))
    params = augment.make_params(batch[0])
    record, middle = augment.for_clip(params, batch, maps), augment.for_clip(params, *frames[0][4])
    samples = record["samples"] + middle["samples"]
    seeds = [sample["development"]["noise"].pop("seed") for sample in samples]
    assert len(set(seeds[:8])) == 8
    assert samples == middle["samples"] * 9


def test_a_video_is_a_film(torchvision, frames):
    v2, tv = torchvision.transforms.v2, torchvision.tv_tensors
    batch, maps = (torch.stack(each) for each in zip(*frames[1], strict=True))
    augment, video = RandomUnderwater(development=QUIET), tv.Video(batch)
    for key in range(3):
        record = augment.make_params(video, torch.Generator().manual_seed(key))
        film = augment.for_clip(record, batch[4], maps[4])
        made = augment.transform(video, maps, record)
        assert type(made) is tv.Video
        assert torch.equal(made.as_subclass(torch.Tensor), augment.transform(batch, maps, film))
        # a record that has been settled stays
        assert torch.equal(augment.transform(video, maps, film), made)
        left = augment.contrast_left(video, maps, record)
        assert torch.equal(left, augment.contrast_left(batch, maps, film))
    made, z = v2.Compose([v2.RandomHorizontalFlip(1.0), augment])(video, tv.Mask(maps))
    assert (type(made), made.shape, z.shape) == (tv.Video, batch.shape, maps.shape)
    # pictures in a batch have a water each, those of a film one
    twice = batch[:1].repeat(2, 1, 1, 1)
    for pictures, alike in ((tv.Video(twice), True), (twice, False)):
        (first, second), _ = augment.at(0, 0, 0)(pictures, maps[0])
        assert torch.equal(first, second) == alike
    assert RandomUnderwater(p=0.0, distance=3)(video) is video
    with pytest.raises(ValueError, match="made up from each frame, a film would flicker"):
        RandomUnderwater(distance=MadeUp())(video)


def test_a_frame_is_as_saturated_as_its_picture() -> None:
    """Vivid water, whose saturation is held by the meter."""
    aug = RandomUnderwater(RandomWater("7C", color_matrix=1.0), light=None)
    image, z = torch.full((3, 24, 33), 0.7), torch.full((1, 24, 33), 2.0)
    for key in range(8):
        params = aug.make_params(image, aug.generator_of(0, 0, key))
        film = aug.for_clip(params, image, z)
        alone, frame = (aug.transform(image, z, record) for record in (params, film))
        torch.testing.assert_close(frame, alone, rtol=0, atol=1e-5)
