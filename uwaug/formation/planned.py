"""What a module plans its blur for: the range of distances and of picture sizes."""

import math
from typing import Any

from uwaug._support import checks
from uwaug.blur.plan import BlurPlan
from uwaug.formation.demand import BlurDemand

__all__ = [
    "EVERY_SIDE",
    "SIDES",
    "alike",
    "distances",
    "plan_all",
    "plan_one",
    "same_plan",
    "serves_every_size",
    "sides_of",
]

SIDES = (32, 2160)
"""px: short sides from a thumbnail's to that of a 4K picture, what the command line exports for."""

EVERY_SIDE = (1, 16384)
"""px: short sides of all pictures. Also the largest that a plan may be asked for."""


def distances(given: Any) -> tuple[float, float]:
    """A `distance_range`; refuses what is none."""
    near, far = checks.pair("distance_range", given, "(nearest, farthest) in metres")
    if not 0 <= near < far:
        expected = "0 ≤ nearest < farthest in metres"
        raise ValueError(f"distance_range must be {expected}, got {given}")
    return near, far


def sides_of(given: Any) -> tuple[int, int]:
    """A range of short sides; refuses what is none."""
    smallest, largest = checks.pair("sides", given, "(smallest, largest) short side in px")
    whole = smallest.is_integer() and largest.is_integer()
    if not (whole and 1 <= smallest <= largest <= EVERY_SIDE[1]):
        expected = f"whole numbers, 1 ≤ smallest ≤ largest short side ≤ {EVERY_SIDE[1]} px"
        raise ValueError(f"sides must be {expected}, got {given}")
    return int(smallest), int(largest)


def serves_every_size(demand: BlurDemand) -> bool:
    """Whether pictures of any size ask for the same blur."""
    return demand.high == 0 or (demand.reference_size is None and demand.shape == "gaussian")


def alike(mine: Any, theirs: Any) -> bool:
    """Equal, numbers to 1e-6: the last digits depend on the processor."""
    if isinstance(mine, dict) and isinstance(theirs, dict):
        return mine.keys() == theirs.keys() and all(alike(mine[key], theirs[key]) for key in mine)
    if isinstance(mine, list | tuple) and isinstance(theirs, list | tuple):
        return len(mine) == len(theirs) and all(map(alike, mine, theirs))
    if isinstance(mine, float) and isinstance(theirs, float):
        return math.isclose(mine, theirs, rel_tol=1e-6, abs_tol=1e-6)
    return bool(mine == theirs)


def plan_one(demand: BlurDemand, height: int, width: int) -> BlurPlan:
    """The plan for pictures of one size."""
    return demand.plan((height, width))


def plan_all(demand: BlurDemand, sides: tuple[int, int]) -> BlurPlan:
    """The plan for pictures whose short side lies in `sides`."""
    return demand.plan_all(sides)


def same_plan(plan: BlurPlan) -> BlurPlan:
    """The plan itself, for a compiler."""
    return plan


# what torch.compiler.assume_constant_result does, without its import of torch._dynamo (.7 s)
_MARKED: tuple[Any, ...] = (plan_one, plan_all, same_plan)
for _function in _MARKED:
    _function._dynamo_marked_constant = True
