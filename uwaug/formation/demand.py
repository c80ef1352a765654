"""The blur that a medium needs over a range of distances: widths, tolerance and plans."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.compiled import compiled
from uwaug._support.types import Array
from uwaug.blur.plan import NO_BLUR, BlurPlan, octave_steps, planned
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import Law
from uwaug.optics.view import WIDE, Size, View
from uwaug.optics.weights import Weights

SIDES = (32, 2160)  # short sides, px, for which the command line exports: thumbnails to 4K
EVERY_SIDE = (1, 16384)  # short sides, px, of all pictures that a plan may be asked for
_LONGEST_SIDES = 4  # longest side of a picture, in largest short sides of a plan for all sizes
# Blur tolerance over what the pixel with most scatter allows: few have as much, and linear light
# has less contrast than the plan assumes. At 1.75 a picture of forward scatter alone fell below
# 60 dB at a tolerance of .002.
_SLACK = 1.4
_MIN_TOLERANCE = 1e-5  # of blurs in a bright exposure: with a gain of 1000 nearly all is white
# Largest blur tolerance where a medium is learned, however weak its forward scatter: a slope in the
# width is relative. Against the exact model (48 × 48 px, widths of 2…11 and 1…20 px, five waters)
# the gradient of a loss to the scale is then within .5 %. At .002 it is within 2 %.
_LEARNED_TOLERANCE = 0.0005
_LEARNED_REACH_PX = 0.5  # smallest end of a plan for widths that are learned, so that they can grow
_LEARNED_MARGIN = 1.1  # of a plan for gradients, half of whose slope is missing at its very end
_NEAR_SHARE = 0.02  # share by which a width may leave a plan before it shows
_WIDEST_SIDES = 8  # widest blur, in longest sides: wider ones all give the mean
_LOG_STEPS = np.linspace(0, 1, 65)  # in distance, at which forward scatter is sampled


@dataclass(frozen=True)
class BlurDemand:
    """The blur that a medium needs over a range of distances, before the image size is known."""

    low: float  # smallest width that shows, in units of the law; 0 if none does
    high: float  # largest one
    blur_tolerance: float  # of the blur before it is weighted with forward scatter
    law: Law
    view: View = WIDE
    learned: bool = False  # True to plan a blur even if none shows, as the width is learned

    @property
    def serves_every_size(self) -> bool:
        """True if pictures of any size need the same blur."""
        return self.high == 0 or self.law == Law("gaussian", "px")

    def covers(self, other: "BlurDemand") -> bool:
        """True if a plan for this demand serves another one of the same law."""
        wide_enough = self.low <= other.low and other.high <= self.high
        return wide_enough and self.blur_tolerance <= other.blur_tolerance

    def holds(self, other: "BlurDemand") -> bool:
        """True if the widths of another demand of the same law lie within this one's, or near."""
        low, high = self.low * (1 - _NEAR_SHARE), self.high * (1 + _NEAR_SHARE)
        return other.high == 0 or (low <= other.low and other.high <= high)

    def plan(self, size: Size, *, shared: bool = False) -> BlurPlan:
        """The plan for an image of (height, width) `size`; `shared` rounds the ends of the range
        outwards to half octaves, so that similar demands share a plan and its matrices.
        """
        return self._plan(size, size, shared)

    def plan_all(self, sides: tuple[int, int]) -> BlurPlan:
        """One plan for all images of short `sides`, px, and of long ones up to 4 times as much."""
        smallest, largest = sides
        return self._plan((smallest, smallest), (largest, _LONGEST_SIDES * largest), False)

    def _plan(self, smallest: Size, largest: Size, shared: bool) -> BlurPlan:
        if self.high == 0 and not self.learned:
            return NO_BLUR
        longest = max(largest)
        low = self.low * self.law.pixels(smallest, self.view)
        high = self.high * self.law.pixels(largest, self.view)
        high = min(high, float(_WIDEST_SIDES * longest))
        if self.learned:
            high = max(high, _LEARNED_REACH_PX)
        if high < 1e-6:
            return NO_BLUR
        if shared:
            high = octave_steps(high, 2, math.ceil)
            low = octave_steps(low, 2, math.floor) if low > 0.2 else 0.0
        low = min(low, high)
        return planned(low, high, self.blur_tolerance, self.law.shape, longest, shared)


def blur_demand(
    medium: Medium,
    distance_range: tuple[float, float],
    tolerance: float = 0.002,
    *,
    view: View = WIDE,
    learned: bool = False,
    margin: float = 1.0,
) -> BlurDemand:
    """The blur that a medium needs where forward scatter exceeds the tolerance.

    Args:
        medium: any batch; the demand covers all rows.
        distance_range: (nearest, farthest) of m·z, m; 0 ≤ nearest ≤ farthest, inf allowed.
        tolerance: as of `uwaug.form_image`.
        view: of the camera.
        learned: True to plan for gradients to the medium: finer, and even if no blur shows now.
        margin: factor by which the range of widths is widened either way.
    """
    checks.tolerance(tolerance)
    learns_width = learned and checks.records(medium.scale, medium.exponent)
    demand = demand_of(medium.weights(), medium.law, distance_range, tolerance, view, learned)
    is_learned = learns_width or (learned and demand.high > 0)
    low, high = demand.low / margin, demand.high * margin
    return replace(demand, low=low, high=high, learned=is_learned)


def demand_of(
    weights: Weights,
    law: Law,
    distance_range: tuple[float, float],
    tolerance: float,
    view: View = WIDE,
    learned: bool = False,
) -> BlurDemand:
    """`blur_demand` of a medium as arrays, before a camera. Nothing is checked."""
    near, far = max(distance_range[0], 0.0), min(distance_range[1], FARTHEST)
    first, last, strength = _scattered(*weights[:4], near, far, tolerance, learned)
    if strength == 0:
        return BlurDemand(0.0, 0.0, tolerance, law, view)
    widths = weights.widths(np.array([first, last]))
    # in half octaves, so that similar media may share a plan
    slack = _SLACK * octave_steps(1 / strength, 2, math.floor)
    blur_tolerance = min(tolerance * slack, _LEARNED_TOLERANCE if learned else 0.5)
    blur_tolerance = max(blur_tolerance, min(tolerance, _MIN_TOLERANCE))
    return BlurDemand(float(widths.min()), float(widths.max()), blur_tolerance, law, view)


@compiled
def _scattered(
    beta: Array,
    direct_weights: Array,
    G: Array,
    signal_weights: Array,
    near: float,
    far: float,
    tolerance: float,
    learned: bool,
) -> tuple[float, float, float]:
    """Nearest and farthest distance, m, at which forward scatter shows, and the largest scatter, or
    0. If it is learned, direct light stands for scatter that does not show.
    """
    scattered, direct = np.zeros(len(_LOG_STEPS)), np.zeros(len(_LOG_STEPS))
    nearest = max(near, 1e-3)
    far = max(min(far, _farthest_blurred(G, signal_weights)), nearest)
    z = nearest * (far / nearest) ** _LOG_STEPS
    for row in range(len(beta)):
        T = direct_weights[row] @ np.exp(-beta[row][:, None] * z)
        _raise_to(direct, T)
        _raise_to(scattered, signal_weights[row] @ np.exp(-G[row][:, None] * z) - T)
    if learned and scattered.max() <= tolerance:
        scattered = np.maximum(scattered, direct)
    places = np.flatnonzero(scattered > tolerance)
    if len(places) == 0:
        return near, far, 0.0
    first, last = max(places[0] - 1, 0), min(places[-1] + 1, len(z) - 1)
    return near if first == 0 else z[first], z[last], scattered.max()


@compiled
def _raise_to(largest: Array, T: Array) -> None:
    """Raise `largest` (N) to the most light that transmittances (3xN, or 9xN of matrices) add to
    any scene, or take from it.
    """
    count = len(T) // 3
    for row in range(0, len(T), count):
        for n in range(len(largest)):
            # with the colour in 0…1 that adds up all that is positive, or negative
            positive = negative = 0.0
            for j in range(row, row + count):
                positive += max(T[j, n], 0.0)
                negative -= min(T[j, n], 0.0)
            largest[n] = max(largest[n], positive, negative)


@compiled
def _farthest_blurred(G: Array, signal_weights: Array) -> float:
    """Distance, m, beyond which no signal is left to blur; `FARTHEST` if there is none."""
    slowest = math.inf
    for row in range(len(G)):
        for k in range(G.shape[1]):
            if np.any(signal_weights[row, :, k] != 0):
                slowest = min(slowest, G[row, k])
    return FARTHEST if slowest <= 0 else min(40 / slowest, FARTHEST)


def plan_for(z: Tensor, medium: Medium, size: Size, tolerance: float) -> BlurPlan:
    """The plan for distances z, m, in a picture of (height, width) `size` of a medium whose widths
    are px; similar distances share it, and gradients of the medium take a finer one.
    """
    learned = torch.is_grad_enabled() and medium.requires_grad
    margin = _LEARNED_MARGIN if learned else 1.0
    ends = blurred_between(z, medium.weights())
    demand = blur_demand(medium, ends, tolerance, learned=learned, margin=margin)
    return demand.plan(size, shared=True)


def blurred_between(z: Tensor, weights: Weights) -> tuple[float, float]:
    """Nearest distance of a map, m, and the farthest at which blurs may show."""
    nearest, farthest = checks.extent(z)
    end = _farthest_blurred(weights.G, weights.signal)
    if farthest >= end < FARTHEST:
        blurred = z.detach()[z.detach() < end]
        farthest = float(blurred.max()) if blurred.numel() else nearest
    return nearest, max(farthest, nearest)


def constant_plan(
    demand: BlurDemand, sides: tuple[int, int] | None, height: int, width: int
) -> BlurPlan:
    """The plan of a demand for pictures of one size, or for all whose short side lies in `sides`,
    px. A compiler takes it for a constant.
    """
    return demand.plan((height, width)) if sides is None else demand.plan_all(sides)


# as torch.compiler.assume_constant_result does, without its import of torch._dynamo (.7 s)
_CONSTANT: Any = constant_plan
_CONSTANT._dynamo_marked_constant = True


def distance_range_of(value: Any) -> tuple[float, float]:
    """Check a `distance_range`."""
    near, far = checks.pair("distance_range", value, "(nearest, farthest) in metres")
    if not 0 <= near < far:
        raise ValueError(f"distance_range must be 0 ≤ nearest < farthest in metres, got {value}")
    return near, far


def sides_of(value: Any) -> tuple[int, int]:
    """Check a range of short sides, px."""
    smallest, largest = checks.pair("sides", value, "(smallest, largest) short side in px")
    whole = smallest.is_integer() and largest.is_integer()
    if not (whole and 1 <= smallest <= largest <= EVERY_SIDE[1]):
        expected = f"whole numbers, 1 ≤ smallest ≤ largest ≤ {EVERY_SIDE[1]} px"
        raise ValueError(f"sides must be {expected}, got {value}")
    return int(smallest), int(largest)
