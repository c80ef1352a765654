import pytest

from uwaug.scene import motorcycle


def test_the_motorcycle_is_where_it_was_measured():
    scene = motorcycle()
    assert scene.image.shape == (3, 500, 741)
    assert 0 <= scene.image.min() < scene.image.max() <= 1
    assert scene.distance.shape == (1, 500, 741)
    # largest and least disparity of the benchmark, 59.9 and 7.2 px
    assert scene.distance.min() > 994.978 * 0.193001 / (59.91 + 31.086)
    assert scene.distance.max() < 994.978 * 0.193001 / (7.19 + 31.086) * 1.15
    row, column = 250, 300  # near the axis, where depth and distance agree
    from skimage.data import stereo_motorcycle

    disparity = float(stereo_motorcycle()[2][row, column])
    depth = 994.978 * 0.193001 / (disparity + 31.086)
    assert float(scene.distance[0, row, column]) == pytest.approx(depth, rel=1e-3)
