"""Pictures that lie beyond what a blur was planned for, and what to say of it."""

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.blur.plan import difference
from uwaug.formation.demand import BlurDemand, blur_demand
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium

__all__ = ["beyond_plan"]

_FEW = 0.01
"""Share of the pixels that may lie beyond a plan without a word."""


def beyond_plan(
    z: Tensor,
    medium: Medium,
    planned: tuple[float, float],
    demand: BlurDemand,
    tolerance: float,
) -> str:
    """What to say of distances beyond a plan, if the error shows; else nothing.

    Args:
        z (Bx1xHxW tensor): effective distances.
        planned: range of distances, m, that `demand` is for.
        tolerance: as for `blur_demand`.
    """
    if not z.numel():
        return ""
    near, far = planned
    low, high = checks.extent(z)
    if near <= low and high <= far:
        return ""
    with torch.no_grad():
        outside = {"nearer": z < near, "farther": (z > far) & (z < FARTHEST)}
    said = []
    for where, pixels in outside.items():
        share = float(pixels.double().mean())
        if share <= _FEW:
            continue
        low, high = checks.extent(z[pixels])
        wanted = blur_demand(medium, (low, high), tolerance)
        error = _error(demand, wanted, (z.shape[-2], z.shape[-1]))
        # a width of 0: nothing is scattered there
        if wanted.high > 0 and error > wanted.blur_tolerance:
            said.append(f"{share:.0%} of the pixels lie {where}")
    if not said:
        return ""
    return (
        f"{' and '.join(said)} than the {near:g}…{far:g} m that the blur is planned for, and get "
        "the width of its end; plan for them with Underwater(…, distance_range=(near, far)), or "
        "with None for each call"
    )


def _error(demand: BlurDemand, wanted: BlurDemand, size: tuple[int, int]) -> float:
    """RMSE of a picture that is given the nearest widths of a plan for `demand`."""
    scale = 1.0 if demand.reference_size is None else min(size) / demand.reference_size
    worst = 0.0
    for width in (wanted.low, wanted.high):
        given = min(max(width, demand.low), demand.high)
        apart = difference(given * scale, width * scale, demand.shape, max(size))
        worst = max(worst, apart)
    return worst
