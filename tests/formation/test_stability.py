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


def fails(c: Case) -> torch.Tensor:
    raise RuntimeError("out of luck")


def filled(c: Case) -> torch.Tensor:
    return stability.ours(replace(c, distance=c.distance.nan_to_num()))


# a method, a condition, and what is to be found of value and gradient
WRONG: list[tuple[Method, str, str, str]] = [
    (lambda c: 1.01 * stability.ours(c), "usual", r"off by 0.00\d+", "right"),
    (fails, "usual", "RuntimeError", "RuntimeError"),
    (lambda c: stability.ours(c)[..., 1:, :], "usual", "wrong shape", "wrong shape"),
    (lambda c: stability.ours(c).detach(), "usual", "right", "none"),
    (lambda c: stability.ours(c) + 0 * c.image.sqrt(), "J = 0 and 1", "right", "NaN"),
    (filled, "z NaN in part", "silent", "silent"),
    (lambda c: c.image * c.distance, "z NaN in part", "NaN", "NaN"),
    (lambda c: stability.ours(c) + 1e-6 * torch.rand(()), "deterministic, twice",
     "not repeatable", "right"),
    (lambda c: stability.ours(c) * c.image.is_contiguous(), "channels last", "off.*", "off.*"),
]  # fmt: skip


@pytest.mark.parametrize("method, condition, value, gradient", WRONG)
def test_the_judge_tells_wrong_from_right(
    method: Method, condition: str, value: str, gradient: str
) -> None:
    before = torch.are_deterministic_algorithms_enabled()
    found = judged(method, condition)
    assert re.fullmatch(f"{value}, {gradient}", ", ".join(found))
    assert torch.are_deterministic_algorithms_enabled() == before


@pytest.mark.parametrize("name", naive.METHODS)
def test_naive_methods_are_the_model_but_for_one_part(name: str) -> None:
    # where that part does not matter, they are right: no strawmen
    harmless = {"published": "β = G = 0", "e^+βz": "β = G = 0"}.get(name, "usual")
    assert judged(naive.METHODS[name], harmless)[0] == "right"
