"""Maps that are no metres, and what is said of them."""

import re
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from uwaug._support.once import muted
from uwaug.distance import doubts
from uwaug.distance.doubts import question

H, W = 120, 32


def floor() -> Tensor:
    """Distances (1xHxW, m) of a floor that ends at a wall."""
    return (2 / torch.linspace(0.1, 1, H)).clamp(max=9.0)[:, None].expand(1, H, W).clone()


def unit(z: Tensor) -> Tensor:
    return (z - z.min()) / (z.max() - z.min())


def holed(z: Tensor, value: float) -> Tensor:
    z[..., 3:6, 4:9] = value
    return z


FALSE: dict[str, tuple[Callable[[Tensor], Tensor], str]] = {
    "mm": (lambda z: 1000 * z, "median of .* millimetres"),
    "relative": (unit, "0…1, which looks relative"),
    "inverse, with a hole": (lambda z: holed(unit(1 / z), torch.nan), "0…1, which looks relative"),
    "divided by 65535": (lambda z: (100 * unit(z)).round() / 255, "0…1, which looks relative"),
    "the end of 16 bits in mm": (lambda z: holed(z, 65.535), "are 65.535, a gap away"),
    "the end of half precision": (lambda z: holed(z, 65504.0), "are 65504, a gap away"),
}
TRUE: dict[str, Callable[[Tensor], Tensor]] = {
    "metres": lambda z: z,
    "a sky": lambda z: holed(z, torch.inf),
    "near a lens": lambda z: z / 10,
    "holes": lambda z: holed(z, 0.0),
    "a wall": lambda z: torch.full_like(z, 65.0),
    "far": lambda z: 90 * z,
    "nothing": lambda z: torch.full_like(z, torch.nan),
    "no pixels": lambda z: z[..., :0],
}


@pytest.mark.parametrize("name", FALSE)
def test_each_falsification_is_named_alone_and_among_true_maps(name: str) -> None:
    falsified, said = FALSE[name]
    z = falsified(floor())
    for maps in (z, [floor(), z, z], torch.stack([floor(), z])):
        (sentence,) = doubts(maps)
        assert re.search(said, sentence)


@pytest.mark.parametrize("name", TRUE)
def test_true_maps_are_not_doubted(name: str) -> None:
    assert doubts([TRUE[name](floor()), floor()]) == []


@pytest.mark.usefixtures("nothing_is_said")
def test_a_process_says_once_of_its_first_maps_that_they_are_relative() -> None:
    with muted():
        question(unit(floor()))  # a trial, which does not count
    question(floor())
    with pytest.warns(UserWarning, match="0…1") as said:
        question(unit(floor()), stacklevel=1)
    assert said[0].filename == __file__
    question(unit(floor()))  # silent: a warning would be an error


@pytest.mark.usefixtures("nothing_is_said")
def test_later_maps_are_not_looked_at() -> None:
    for _ in range(8):
        question(floor())
    question(unit(floor()))  # silent
