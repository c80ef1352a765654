import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest
import torch

pytest.importorskip("cv2")
pytest.importorskip("scipy")

from referees.conditions import Case, Method, conditions, exact

from benchmarks.accuracy import naive, stability
from benchmarks.figures import matrix_chart

CASES: dict[str, Case] = {}
for group in conditions().values():
    CASES |= group


def judged(method: Method, name: str = "usual", **changes: object) -> tuple[str, str]:
    case = replace(CASES[name], **changes)
    verdicts = stability.judge(method, case, stability.right(case))
    return verdicts["value"], verdicts["gradient"]


@pytest.mark.parametrize("name", CASES)
def test_uwaug_is_right_everywhere(name: str) -> None:
    assert judged(stability.ours, name) == ("right", "right")


def test_so_is_the_model_that_they_are_held_against() -> None:
    singular = ("z = 0 in part", "z = +∞ in part", "σ ∝ √z at z = 0", "sRGB 0 and 1, z = 0")
    for name in ("usual", "batch of 2 media", *singular):
        assert judged(lambda c: exact(c.to(torch.float64)), name)[0] == "right", name


def spoilt(c: Case, **changes: object) -> torch.Tensor:
    return stability.ours(replace(c, **changes))


def with_nan(c: Case) -> torch.Tensor:
    out = stability.ours(c).clone()
    out[..., 0, 0] = torch.nan
    return out


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


WRONG = {
    "1 % too bright": (lambda c: 1.01 * stability.ours(c), "usual", r"off by 0.00\d+", "right"),
    "one NaN": (with_nan, "usual", "NaN", "right"),
    "exception": (fails, "usual", "RuntimeError", "RuntimeError"),
    "another shape": (
        lambda c: stability.ours(c)[..., 1:, :],
        "usual",
        "wrong shape",
        "wrong shape",
    ),
    "no gradients": (lambda c: stability.ours(c).detach(), "usual", "right", "none"),
    "no gradient of the width": (
        lambda c: spoilt(c, scale=c.scale.detach()),
        "usual",
        "right",
        r"off by (0\.9.*|1)",
    ),
    "no gradient of the field": (
        lambda c: spoilt(c, field=c.field.detach()),
        "usual",
        "right",
        r"off by (0\.9.*|1)",
    ),
    "NaN gradient": (
        lambda c: spoilt(c, image=Clipped.apply(c.image)),
        "J = 0 and 1",
        "right",
        "NaN",
    ),
    "picture from NaN": (
        lambda c: spoilt(c, distance=c.distance.nan_to_num(1.0)),
        "z NaN in part",
        "silent",
        "silent",
    ),
    "NaN from NaN": (lambda c: c.image * c.distance, "z NaN in part", "NaN", "NaN"),
    "an error that says nothing": (complains, "z NaN in part", "ValueError", "ValueError"),
    "a faint veil": (
        lambda c: 1.1 * stability.ours(c),
        "z = 1 µm, J = 0",
        r"off by 0\.0\d+",
        "right",
    ),
    "dice": (
        lambda c: stability.ours(c) + 1e-6 * torch.rand(()),
        "deterministic, twice",
        "not repeatable",
        "right",
    ),
    "contiguous only": (
        lambda c: stability.ours(c) * c.image.is_contiguous(),
        "channels last",
        "off.*",
        "off.*",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_the_judge_tells_wrong_from_right(name: str) -> None:
    method, condition, value, gradient = WRONG[name]
    found = judged(method, condition)
    assert re.fullmatch(value, found[0]), found
    assert re.fullmatch(gradient, found[1]), found


def test_deterministic_algorithms_are_switched_back() -> None:
    before = torch.are_deterministic_algorithms_enabled()
    judged(fails, "deterministic, twice")
    assert torch.are_deterministic_algorithms_enabled() == before


@pytest.mark.parametrize("name", naive.METHODS)
def test_naive_methods_are_the_model_but_for_one_part(name: str) -> None:
    # where that part does not matter, they are right: no strawmen
    harmless = {"published": "β = G = 0", "e^+βz": "β = G = 0"}.get(name, "usual")
    assert judged(naive.METHODS[name], harmless)[0] == "right"


def test_the_chart_is_small_and_marks_every_cell() -> None:
    verdicts = ["right", "off by 0.06", "off by 3e+15", "NaN", "silent", "ValueError"]
    verdicts += ["none", "n/a", "not repeatable"]
    rows = {}
    for v in verdicts:
        method, ours = {"value": v, "gradient": v}, {"value": "right", "gradient": v}
        rows[v] = {"a method": method, "uwaug": ours}
    picture = matrix_chart.svg({"all": list(rows)}, rows)
    root = ElementTree.fromstring(picture)
    marks = [t.text for t in root.iter("{http://www.w3.org/2000/svg}text")]
    assert [marks.count(m) for m in (".06", "≫1", "NaN", "??", "err", "–")] == [4, 3, 6, 4, 7, 7]
    failed = {"value": "NaN", "gradient": "NaN"}
    columns = {str(column): failed for column in range(10)}
    worst = {str(row): columns for row in range(50)}
    assert len(matrix_chart.svg({"all": list(worst)}, worst)) < 100_000
