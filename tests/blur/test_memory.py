"""Peak memory of a picture of new size, in a process of its own."""

from pathlib import Path

import pytest

pytest.importorskip("cv2")
pytest.importorskip("matplotlib")

from benchmarks.speed import scaling, soak

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/clear_refs").exists(), reason="/proc of Linux tells the peak"
)


@pytest.mark.parametrize("height, width, most", [(64, 20000, 7.0), (20000, 64, 5.0)])
def test_a_first_call_takes_a_few_times_its_input(height: int, width: int, most: float) -> None:
    (found,) = scaling.long_shapes([(height, width)])
    assert found["peak_per_input"] <= most


def test_a_line_of_pixels_takes_megabytes() -> None:
    (found,) = scaling.long_shapes([(1, 30000)])
    assert found["peak_mib"] <= 20


def test_the_soak_runs() -> None:
    held = soak.soak(16, 40, [2, 6])
    assert len(held["mib"]) == 2
    assert held["growth"] <= soak.WANTED
    assert soak.pace(16, 24, 2, 1)["ratio"] > 0
