"""A plan for the distances at hand."""

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.torch_func import transformed
from uwaug._support.types import Order
from uwaug.blur.plan import BlurPlan
from uwaug.formation.demand import blur_demand, spent
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium

__all__ = ["farthest_seen", "plan_at_hand", "plan_between"]

_ROOM = 1.1
"""By which a plan for gradients goes beyond the widths at hand. With 1.4 gradients are no better,
with 1 the slope of the picture is 4 % off instead of 2 % (7C, 9C).
"""


def plan_at_hand(z: Tensor, medium: Medium, tolerance: float, order: Order) -> BlurPlan:
    """The plan for these very distances, rounded so that similar ones share it."""
    low, high = checks.extent(z) if z.numel() else (0.0, 0.0)
    end = farthest_seen(medium, order)
    if high >= end < FARTHEST:
        shows = z.detach()[z < end]
        high = float(shows.max()) if shows.numel() else low
    return plan_between((low, high), (z.shape[-2], z.shape[-1]), medium, tolerance, order)


def farthest_seen(medium: Medium, order: Order) -> float:
    """The distance from which on a pixel asks nothing of the blur; `FARTHEST` if there is none."""
    # no light is scattered from beyond where all is spent, and in the line of sight none passes
    return spent(medium) if order == "line_of_sight" else FARTHEST


def plan_between(
    distances: tuple[float, float],
    size: tuple[int, int],
    medium: Medium,
    tolerance: float,
    order: Order,
) -> BlurPlan:
    """The plan for these effective distances, m, in a picture of (height, width) `size`."""
    learned = torch.is_grad_enabled() and medium.requires_grad
    learned = learned or transformed()
    # at the very end of a plan half of the slope is missing
    margin = _ROOM if learned else 1.0
    demand = blur_demand(medium, distances, tolerance, order=order, learned=learned, margin=margin)
    return demand.plan(size, shared=True)
