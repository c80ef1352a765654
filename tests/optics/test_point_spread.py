import math
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread


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
        ((-1.0,), "scale must be finite and ≥ 0, got -1"),
        (("a",), "scale must be finite and ≥ 0, got 'a'"),
        ((torch.tensor([1.0, -2.0]),), r"scale must be finite and ≥ 0, got \[1.0, -2.0\]"),
        ((torch.ones(3, 1),), r"scale must be a number or a floating-point tensor.*\(3, 1\)"),
        ((torch.ones(3, dtype=torch.int64),), "scale must be a number or .* got torch.int64"),
        ((1.0, 0.0), "exponent must be finite and ≥ 0.001, got 0"),
        ((1.0, 1.0, "lorentzian"), "shape.*lorentzian"),
        ((1.0, 1.0, "gaussian", math.nan), "reference_size.*nan"),
    ],
)
def test_a_width_law_refuses(arguments: tuple[Any, ...], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        PointSpread(*arguments)


def three(law: PointSpread) -> Medium:
    beta = torch.full((3, 3), 0.5)
    return Medium.from_coefficients(beta, beta / 2, beta / 3, b_mean=0.3, point_spread=law)


@pytest.mark.parametrize("name", ["scale", "exponent"])
@pytest.mark.parametrize("count", [1, 2, 4])
def test_a_width_law_has_a_number_for_each_medium(name: str, count: int) -> None:
    law = PointSpread(**{"scale": 1.0, name: torch.ones(count)})
    message = rf"PointSpread.{name} must have shape \(\) or \(3,\), .* got \({count},\)"
    with pytest.raises(ValueError, match=message):
        three(law)


def test_a_width_law_may_hold_one_number_or_one_for_each() -> None:
    for value in (torch.tensor(1.5), torch.tensor([1.0, 2.0, 3.0])):
        medium = three(PointSpread(value))
        width = medium.width(torch.full((1, 1, 1, 1), 2.0), (9, 9))
        torch.testing.assert_close(width.flatten(), (0.6 * value).expand(width.numel()))
        assert len(medium[1:]) == 2
