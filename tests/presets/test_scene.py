import pytest
import torch

from uwaug.presets.scene import motorcycle, motorcycle_depth, own_scene


def test_the_motorcycle_is_where_it_was_measured():
    """Along rays through the optical axis, which is not the middle of the picture."""
    scene, (_, depth) = motorcycle(), motorcycle_depth()
    assert scene.image.shape == (3, 500, 741)
    assert 0 <= scene.image.min() < scene.image.max() <= 1
    # largest and least disparity of the benchmark, 59.9 and 7.2 px
    assert depth.min() >= 994.978 * 0.193001 / (59.91 + 31.086)
    assert depth.max() <= 994.978 * 0.193001 / (7.19 + 31.086)
    x, y = (torch.arange(741) - 311.193) / 994.978, (torch.arange(500) - 254.877) / 994.978
    along = (1 + x**2 + y[:, None] ** 2).sqrt() * depth
    torch.testing.assert_close(scene.distance, along, check_dtype=False)


def test_a_large_picture_is_reduced_in_light_and_its_distances_stay_measured_ones():
    black_and_white = torch.tensor([0, 255], dtype=torch.uint8).repeat(3, 1000, 1000)
    z = torch.where(torch.arange(2000) < 1000, 2.0, 5.0).expand(1, 1000, 2000)
    scene = own_scene(black_and_white, z)
    assert scene.note == "Drawn at 1000×500 of 2000×1000 px."
    # half of the light, not half of the sRGB value
    torch.testing.assert_close(scene.image, torch.full((3, 500, 1000), 0.7354), rtol=0, atol=1e-3)
    assert set(scene.distance.unique().tolist()) == {2.0, 5.0}
    small = own_scene(scene.image[:, :9, :9], scene.distance[:, :9, :9])
    torch.testing.assert_close(small.image, scene.image[:, :9, :9])


def test_what_cannot_be_drawn():
    for image, distance, message in (
        (torch.zeros(3, 8, 9), torch.ones(1, 9, 8), "height and width must agree"),
        (torch.zeros(3, 8, 81), torch.ones(1, 8, 81), "81×8 px are too narrow, crop it"),
        (torch.zeros(3, 8, 9), torch.full((1, 8, 9), torch.nan), "expected metres ≥ 0"),
        (torch.full((3, 8, 9), 255.0), torch.ones(1, 8, 9), "255"),
    ):
        with pytest.raises(ValueError, match=message):
            own_scene(image, distance)
