"""Cameras: responses, weights, names and files."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusing import refusals

from uwaug import Camera, load_camera

NIKON = "Nikon 5100 (NPL)"
SIGMA = "Sigma SDMerill (NPL)"
ROWS = "400,0,1,2\n500,0,3,0\n700,4,1,0\n"


def toy(**changes):
    values = {
        "wavelengths": [400, 500, 700],
        "response": [[0, 1, 2], [0, 3, 0], [4, 1, 0]],
        "name": "toy",
    }
    return Camera(**values | changes)


def test_weights_are_rectangles_of_responses_between_and_dark_outside():
    grid = [300, 400, 450, 600, 700, 700.5]
    samples = np.array([[0, 0, 0], [0, 1, 2], [0, 2, 1], [2, 2, 0], [4, 1, 0], [0, 0, 0]])
    widths = np.array([100, 75, 100, 125, 50.25, 0.5])
    areas = samples * widths[:, None]
    np.testing.assert_allclose(toy().weights(grid), areas / areas.sum(axis=0), rtol=1e-14)
    single = Camera([500, 600], [[1, 2, 3], [3, 2, 1]]).weights([550])
    np.testing.assert_array_equal(single, [[1, 1, 1]])


@given(st.lists(st.floats(380, 780), min_size=2, max_size=40, unique=True))
def test_weights_sum_to_one_and_do_not_depend_on_the_scale_of_the_response(grid):
    grid = np.array([*sorted(grid), 790.0, 800.0])
    camera = Camera([380, 800], [[1, 2, 1], [1, 0.5, 3]])
    weights = camera.weights(grid)
    np.testing.assert_allclose(weights.sum(axis=0), 1, rtol=1e-14)
    assert weights.min() >= 0
    np.testing.assert_allclose(
        Camera([380, 800], camera.response * 1e3).weights(grid), weights, rtol=1e-12
    )


def test_names_and_values_are_those_of_colour_science():
    options = np.get_printoptions()
    import colour

    np.set_printoptions(**options)  # which it sets for the whole process
    assert list(colour.MSDS_CAMERA_SENSITIVITIES) == [NIKON, SIGMA]
    for name, entry in colour.MSDS_CAMERA_SENSITIVITIES.items():
        camera = load_camera(name)
        np.testing.assert_array_equal(camera.wavelengths, entry.wavelengths)
        np.testing.assert_array_equal(camera.response, entry.values)
    assert load_camera(camera) is camera
    assert load_camera("NIKON 5100 NPL") is load_camera("Nikon5100(NPL)") is load_camera(NIKON)


@pytest.mark.parametrize("text", [ROWS, '\ufeff"lambda","r (rel.)","Green","b"\r\n' + ROWS])
def test_csv(tmp_path, text):
    path = tmp_path / "toy.csv"
    path.write_text(text)
    assert load_camera(path) == load_camera(str(path)) == toy()


test_what_is_refused = refusals(
    (lambda: toy(response=np.ones((3, 4))), r"shape \(3, 3\).*got \(3, 4\)"),
    (lambda: toy(response=[[1] * 3, [np.nan, 1, np.inf], [1] * 3]), "nan at 500 nm, and 2 of 9"),
    (lambda: toy(response=[[0, 1, 0]] * 3), "no response in red and blue"),
    (load_camera, "Nikon D90", "Nikon 5100"),
    (load_camera, 5100, "5100"),
)
