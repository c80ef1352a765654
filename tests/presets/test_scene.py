import pytest
import torch

from uwaug.presets.scene import motorcycle, own_scene


def test_the_motorcycle_is_where_it_was_measured():
    scene = motorcycle()
    assert scene.image.shape == (3, 500, 741)
    assert 0 <= scene.image.min() < scene.image.max() <= 1
    assert scene.distance.shape == (1, 500, 741)
    # largest and least disparity of the benchmark, 59.9 and 7.2 px
    assert scene.distance.min() > 994.978 * 0.193001 / (59.91 + 31.086)
    assert scene.distance.max() < 994.978 * 0.193001 / (7.19 + 31.086) * 1.15


def test_a_large_picture_is_reduced_in_light_and_its_distances_stay_measured_ones():
    black_and_white = torch.tensor([0, 255], dtype=torch.uint8).repeat(3, 1000, 1000)
    z = torch.where(torch.arange(2000) < 1000, 2.0, 5.0).expand(1, 1000, 2000)
    scene = own_scene(black_and_white, z)
    assert scene.image.shape == (3, 500, 1000)
    assert scene.note == "Drawn at 1000×500 of 2000×1000 px."
    # half of the light, not half of the sRGB value
    torch.testing.assert_close(scene.image, torch.full((3, 500, 1000), 0.7354), rtol=0, atol=1e-3)
    assert set(scene.distance.unique().tolist()) == {2.0, 5.0}
    small = own_scene(scene.image[:, :9, :9], scene.distance[:, :9, :9])
    torch.testing.assert_close(small.image, scene.image[:, :9, :9])
    assert small.note == ""


@pytest.mark.parametrize(
    ("image", "distance", "message"),
    [
        (torch.zeros(3, 8, 9), torch.ones(1, 9, 8), "height and width must agree"),
        (torch.zeros(3, 8, 81), torch.ones(1, 8, 81), "81×8 px are too narrow, crop it"),
        (torch.zeros(3, 8, 9), torch.full((1, 8, 9), torch.nan), "expected metres ≥ 0"),
        (torch.full((3, 8, 9), 255.0), torch.ones(1, 8, 9), "255"),
    ],
)
def test_what_cannot_be_drawn(image, distance, message):
    with pytest.raises(ValueError, match=message):
        own_scene(image, distance)
