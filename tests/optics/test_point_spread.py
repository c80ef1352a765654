import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water


def test_width_laws() -> None:
    lengths = torch.tensor([0.0, 0.5, 2.0, 8.0], dtype=torch.float64).reshape(1, 1, 1, 4)
    for law, scale, exponent, size in (
        (PointSpread.paper(), 0.3 * 259 / 518, 1.0, (259, 300)),
        (PointSpread.paper(0.8), 0.8, 1.0, (800, 518)),
        (PointSpread.calibrated(400.0), 12.0, 0.62, (64, 64)),
        (PointSpread(3.0, 2.0), 3.0, 2.0, (9, 9)),
        (PointSpread.none(), 0.0, 1.0, (9, 9)),
    ):
        expected = scale * lengths**exponent
        width = law.sigma(lengths, size)
        assert width[..., 0] < 0.05  # px; where the law has an infinite slope it may start above 0
        torch.testing.assert_close(width[..., 1:], expected[..., 1:], rtol=1e-12, atol=0)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.floats(0, 100), st.floats(0.05, 3), st.floats(0, 1e9))
def test_width_grows_with_distance_and_is_finite(scale: float, exponent: float, z: float) -> None:
    lengths = torch.tensor([z, 2 * z + 1e-3], dtype=torch.float64).reshape(1, 1, 1, 2)
    lengths.requires_grad_()
    width = PointSpread(scale, exponent).sigma(lengths, (100, 100))
    width.sum().backward()
    assert width.isfinite().all()
    assert lengths.grad.isfinite().all()
    assert (width.diff() >= 0).all()


@pytest.mark.parametrize(
    "arguments, match",
    [
        ({"scale": -1.0}, "scale.*-1"),
        ({"scale": math.nan}, "scale.*nan"),
        ({"scale": math.inf}, "scale.*inf"),
        ({"scale": 1.0, "exponent": 0.0}, "exponent.*0"),
        ({"scale": 1.0, "exponent": -1.0}, "exponent.*-1"),
        ({"scale": 1.0, "shape": "lorentzian"}, "shape.*lorentzian"),
        ({"scale": 1.0, "reference_size": 0.0}, "reference_size.*0"),
        ({"scale": 1.0, "reference_size": math.nan}, "reference_size.*nan"),
        ({"scale": 1.0, "reference_size": math.inf}, "reference_size.*inf"),
    ],
)
def test_point_spread_rejects(arguments: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        PointSpread(**arguments)


@pytest.mark.parametrize("focal", [0.0, -3.0, math.inf, math.nan])
def test_calibrated_wants_a_focal_length(focal: float) -> None:
    with pytest.raises(ValueError, match="focal_px"):
        PointSpread.calibrated(focal)


def test_calibrated_media_of_several_cameras_stack() -> None:
    laws = [PointSpread.calibrated(focal) for focal in (200.0, 400.0, 900.0)]
    medium = Medium.stack([Medium.from_water(Water.jerlov("II"), point_spread=law) for law in laws])
    z = torch.tensor([0.5, 3.0], dtype=torch.float64).reshape(1, 1, 1, 2)
    for i, law in enumerate(laws):
        expected = Medium.from_water(Water.jerlov("II"), point_spread=law).width(z, (64, 64))
        torch.testing.assert_close(medium.width(z, (64, 64))[i : i + 1], expected)
        assert medium[i].point_spread.shape == law.shape == "exponential"
