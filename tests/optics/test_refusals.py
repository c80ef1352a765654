"""What media and width laws refuse, beside what their own tests say."""

import re

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from uwaug.formation.underwater import Underwater
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water

NUMBERS = ((0.5,) * 3, (0.2,) * 3, (0.3,) * 3)


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


@pytest.mark.parametrize(
    "value, match",
    [
        (torch.tensor([1.0, -2.0, 3.0]), r"scale must be finite and ≥ 0, got \[1.0, -2.0, 3.0\]"),
        (torch.tensor([1.0, torch.nan]), "scale must be finite and ≥ 0, got .*nan"),
        (torch.tensor(torch.inf), "scale must be finite and ≥ 0, got inf"),
        (torch.ones(3, 1), r"scale must be a number or a floating-point tensor \(B,\).*\(3, 1\)"),
        (torch.ones(3, dtype=torch.int64), "scale must be a number or .* got torch.int64"),
        ("a", "scale must be finite and ≥ 0, got 'a'"),
        (None, "scale must be finite and ≥ 0, got None"),
        ([1.0], r"scale must be finite and ≥ 0, got \[1.0\]"),
    ],
)
def test_a_width_law_refuses(value: object, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        PointSpread(value)


def test_an_exponent_is_positive() -> None:
    with pytest.raises(ValueError, match=r"exponent must be finite and ≥ 0.001, got \[0.0\]"):
        PointSpread(1.0, torch.zeros(1))


def test_stacks_of_anything_that_can_be_iterated() -> None:
    media = [Medium.from_coefficients(*NUMBERS) for _ in range(3)]
    assert len(Medium.stack(medium for medium in media)) == 3
    with pytest.raises(TypeError, match=r"media must be a uwaug.Medium, got str"):
        Medium.stack("7C")


def test_slices_of_media() -> None:
    beta = torch.arange(1.0, 13.0).reshape(4, 3)
    law = PointSpread(torch.arange(4.0))
    medium = Medium.from_coefficients(beta, beta / 2, beta / 3, point_spread=law)
    for part in (slice(0, 2), slice(1, None), slice(None, None, 2), slice(-2, None)):
        torch.testing.assert_close(medium[part].beta, beta[part])
        torch.testing.assert_close(medium[part].point_spread.scale, torch.arange(4.0)[part])
        assert medium[part].notes == medium.notes[part]
    with pytest.raises(IndexError, match=re.escape("medium slice(4, 9, None) of 4")):
        medium[4:9]
    with pytest.raises(TypeError, match="str"):
        medium["a"]


@pytest.mark.parametrize("name", ["vertical_depth", "g", "mu"])
def test_numbers_that_are_to_be_learned(name: str) -> None:
    message = f"{name} must be a number, got a tensor; to learn .* learnable=True"
    with pytest.raises(TypeError, match=message):
        Medium.from_water("7C", **{name: torch.tensor(0.5, requires_grad=True)})


def test_visibility_is_no_tensor() -> None:
    water, value = Water.jerlov("7C"), torch.tensor(0.5)
    for ask in (water.with_visibility, lambda metres: water.with_contrast(0.5, metres)):
        with pytest.raises(TypeError, match="metres must be a number, got a tensor"):
            ask(value)
    with pytest.raises(TypeError, match="contrast must be a number, got a tensor"):
        water.with_contrast(value, 2.0)
    with pytest.raises(TypeError, match="t must be a number, got a tensor"):
        water.mix(water, value)


def test_a_module_wants_a_medium() -> None:
    with pytest.raises(TypeError, match=r"medium must be .*Medium, got str; see Medium.from_water"):
        Underwater("II")


SILLY = st.floats(0, 1e300) | st.sampled_from([0.0, 5e-324, 1e-300, 1e-9, 1e150])


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.lists(SILLY, min_size=6, max_size=6), st.floats(0, 1e6), st.floats(0, 1), st.floats(0, 1))
@pytest.mark.filterwarnings("error")
def test_silly_waters_pass_in_silence(
    values: list[float], depth: float, g: float, mu: float
) -> None:
    water = Water([400, 700], values[:2], values[2:4], values[4:])
    medium = Medium.from_water(water, vertical_depth=depth, g=g, mu=mu)
    assert all(not t.isnan().any() for t in medium.tensors())
    assert all((t >= 0).all() for t in medium.tensors())
