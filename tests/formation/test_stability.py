"""All conditions in which methods fail, by the judge of the stability matrix."""

import re
from dataclasses import replace

import pytest
import torch

pytest.importorskip("cv2")

from referees.conditions import Case, Method, conditions, exact

from benchmarks.accuracy import naive, stability

CASES: dict[str, Case] = {}
for group in conditions().values():
    CASES |= group


def judged(method: Method, name: str = "usual") -> tuple[str, str]:
    verdicts = stability.judge(method, CASES[name], stability.right(CASES[name]))
    return verdicts["value"], verdicts["gradient"]


@pytest.mark.parametrize("name", CASES)
def test_uwaug_is_right_everywhere(name: str) -> None:
    assert judged(stability.ours, name) == ("right", "right")


@pytest.mark.parametrize("name", ["batch of 2 media", "z = +∞ in part", "sRGB 0 and 1, z = 0"])
def test_so_is_the_model_that_it_is_held_against(name: str) -> None:
    assert judged(lambda c: exact(c.to(torch.float64)), name)[0] == "right"


def spoilt(c: Case, **changes: object) -> torch.Tensor:
    return stability.ours(replace(c, **changes))


def fails(c: Case) -> torch.Tensor:
    raise RuntimeError("out of luck")


def complains(c: Case) -> torch.Tensor:
    raise ValueError("no idea what is wrong")


class Clipped(torch.autograd.Function):
    """Right in value; its gradient is NaN where the input is 0."""

    @staticmethod
    def forward(ctx, x):
        ctx.save_for_backward(x)
        return x.clone()

    @staticmethod
    def backward(ctx, grad):
        (x,) = ctx.saved_tensors
        return grad * x / x


# a method, a condition, and what is to be found of value and gradient
WRONG: list[tuple[Method, str, str, str]] = [
    (lambda c: 1.01 * stability.ours(c), "usual", r"off by 0.00\d+", "right"),
    (fails, "usual", "RuntimeError", "RuntimeError"),
    (lambda c: stability.ours(c)[..., 1:, :], "usual", "wrong shape", "wrong shape"),
    (lambda c: stability.ours(c).detach(), "usual", "right", "none"),
    (lambda c: spoilt(c, scale=c.scale.detach()), "usual", "right", r"off by (0\.9.*|1)"),
    (lambda c: spoilt(c, image=Clipped.apply(c.image)), "J = 0 and 1", "right", "NaN"),
    (lambda c: spoilt(c, distance=c.distance.nan_to_num()), "z NaN in part", "silent", "silent"),
    (lambda c: c.image * c.distance, "z NaN in part", "NaN", "NaN"),
    (complains, "z NaN in part", "ValueError", "ValueError"),
    (
        lambda c: stability.ours(c) + 1e-6 * torch.rand(()),
        "deterministic, twice",
        "not repeatable",
        "right",
    ),
    (lambda c: stability.ours(c) * c.image.is_contiguous(), "channels last", "off.*", "off.*"),
]


@pytest.mark.parametrize("method, condition, value, gradient", WRONG)
def test_the_judge_tells_wrong_from_right(
    method: Method, condition: str, value: str, gradient: str
) -> None:
    before = torch.are_deterministic_algorithms_enabled()
    found = judged(method, condition)
    assert re.fullmatch(value, found[0]), found
    assert re.fullmatch(gradient, found[1]), found
    assert torch.are_deterministic_algorithms_enabled() == before


@pytest.mark.parametrize("name", naive.METHODS)
def test_naive_methods_are_the_model_but_for_one_part(name: str) -> None:
    # where that part does not matter, they are right: no strawmen
    harmless = {"published": "β = G = 0", "e^+βz": "β = G = 0"}.get(name, "usual")
    assert judged(naive.METHODS[name], harmless)[0] == "right"
