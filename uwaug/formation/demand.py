"""What a medium asks of the blur over a range of distances, and the plans for it."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.compiled import compiled
from uwaug._support.types import Array, Shape
from uwaug.blur.plan import NO_BLUR, BlurPlan, octave_steps, plan_blur
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium

SIDES = (32, 2160)
"""px: short sides from a thumbnail's to that of a 4K picture, what the command line exports for."""

EVERY_SIDE = (1, 16384)
"""px: short sides of all pictures. Also the largest that a plan may be asked for."""

_LONGEST = 4
"""Sides: no picture is longer than 4 of the largest short side that a plan for all sizes serves."""

_SLACK = 1.4
"""Times what the strongest pixel allows: few are as strong, and linear light has less contrast than
the plan assumes. At 1.75 a picture of nothing but forward scatter fell below 60 dB at a tolerance
of .002.
"""

_FINEST = 1e-5
"""What a bright exposure asks for at most: with a gain of 1000, all but the darkest is white."""

_FOR_SLOPES = 0.0005
"""Blur tolerance wherever a medium is learned, however weak its forward scatter is: a slope in the
width is relative. Against the exact model (48 × 48 px, widths of 2…11 and 1…20 px, five waters) the
gradient of a loss to the scale is then within .5 %, at .002 within 2 %, at what the picture asks
for within 7 %, and up to 170 % where it nearly vanishes. To fit weights to value and slope alike
gains nothing: what is missing is not in the span of so few blurs.
"""

_LEAST_LEARNED = 0.5
"""px. A plan for widths that are learned reaches as far as this at least, so that they can grow."""

_MARGIN = 1.1
"""By which a plan for gradients goes beyond the widths at hand, as half of the slope is missing at
its very end. With 1.4 gradients are no better, with 1 the slope of the picture is 4 % off instead
of 2 % (7C, 9C).
"""

_WIDEST = 8
"""Longest sides: wider blurs all give the mean."""

_STEPS = np.linspace(0, 1, 65)
"""Of the logarithm of distance, where forward scatter is looked at."""


class Weights(NamedTuple):
    """A medium of B rows as arrays in double precision: rates (BxK, BxL), weights of the three
    curves (Bx3xK, Bx3xL, Bx3xL), of which the first two have nine rows for surfaces with spectra.
    """

    beta: Array
    direct: Array
    G: Array
    signal: Array
    veil: Array

    @staticmethod
    def of(medium: Medium) -> "Weights":
        """Those of a medium."""
        direct, signal = medium.direct_weights.flatten(1, -2), medium.signal_weights.flatten(1, -2)
        return Weights(
            *map(_array_of, (medium.beta, direct, medium.G, signal, medium.veil_weights))
        )

    def seen_by(self, gain: Array) -> "Weights":
        """As seen by a camera that multiplies channels (B or 1, 3), or mixes them (…, 3, 3)."""
        beta, G = self.beta, self.G
        if len(gain) > len(beta):
            beta, G = beta.repeat(len(gain), 0), G.repeat(len(gain), 0)
        if gain.ndim == 2 and self.direct.shape[1] == 3:
            gain = gain[..., None]
            return Weights(beta, gain * self.direct, G, gain * self.signal, gain * self.veil)
        matrix = gain if gain.ndim == 3 else gain[..., None] * np.eye(3)
        direct, signal = _mixed(matrix, self.direct), _mixed(matrix, self.signal)
        return Weights(beta, direct, G, signal, matrix @ self.veil)


def _array_of(values: Tensor) -> Array:
    return values.detach().cpu().double().contiguous().numpy()


def _mixed(matrix: Array, weights: Array) -> Array:
    """Weights (Bx3xK, or Bx9xK of matrices) as seen by a camera that mixes channels: Bx9xK."""
    if weights.shape[1] == 3:
        mixed = matrix[..., None] * weights[:, None]
    else:
        mixed = matrix @ weights.reshape(len(weights), 3, -1)
    return mixed.reshape(len(mixed), 9, -1)


@dataclass(frozen=True)
class BlurDemand:
    """What a medium asks of the blur over a range of distances, before the image size is known.

    Attributes:
        low, high: range of widths that show, px of the point spread's own scale; both 0 if none
            does.
        blur_tolerance: of the blurred picture before it is weighted with forward scatter; the
            weaker the scatter, the larger.
        shape, reference_size: of the point spread.
        learned: whether the width is to be learned: a blur is planned even if none shows.
    """

    low: float
    high: float
    blur_tolerance: float
    shape: Shape
    reference_size: float | None
    learned: bool = False

    @property
    def serves_every_size(self) -> bool:
        """Whether pictures of any size ask for the same blur."""
        return self.high == 0 or (self.reference_size is None and self.shape == "gaussian")

    def covers(self, other: "BlurDemand") -> bool:
        """Whether this leaves nothing to be wished by another, of the same law."""
        wide_enough = self.low <= other.low and other.high <= self.high
        return wide_enough and self.blur_tolerance <= other.blur_tolerance

    def plan(self, size: tuple[int, int], *, shared: bool = False) -> BlurPlan:
        """The plan for an image of (height, width) `size`.

        `shared` rounds the ends of the range outwards to half octaves, so that similar demands
        share a plan and its matrices: for media that change from call to call.
        """
        return self._plan(min(size), min(size), max(size), shared)

    def plan_all(self, sides: tuple[int, int]) -> BlurPlan:
        """One plan for all images whose short side lies in `sides`, px, and no side beyond 4 times
        the larger.
        """
        return self._plan(*sides, _LONGEST * sides[1], shared=False)

    def _plan(self, smallest: int, largest: int, longest: int, shared: bool) -> BlurPlan:
        reference = self.reference_size
        low = self.low * (1.0 if reference is None else smallest / reference)
        high = min(
            self.high * (1.0 if reference is None else largest / reference),
            float(_WIDEST * longest),
        )
        if self.learned:
            high = max(high, _LEAST_LEARNED)
        if high < 1e-6:
            return NO_BLUR
        if shared:
            high = octave_steps(high, 2, math.ceil)
            low = octave_steps(low, 2, math.floor) if low > 0.2 else 0.0
        low = min(low, high)
        return plan_blur(low, high, self.blur_tolerance, self.shape, longest, shared=shared)


def blur_demand(
    medium: Medium,
    distance_range: tuple[float, float],
    tolerance: float = 0.002,
    *,
    learned: bool = False,
    margin: float = 1.0,
    seen: Weights | None = None,
) -> BlurDemand:
    """What a medium needs of the blur over a range of effective distances, and no more.

    Ignores distances at which forward scatter is below the tolerance. The weaker the scatter, the
    larger the blur error allowed.

    Args:
        medium: any batch; the demand covers all rows.
        distance_range: (nearest, farthest) of m·z, m; 0 ≤ nearest ≤ farthest, inf allowed.
        tolerance: RMSE of the blur that may pass, in linear light, on pictures with power ∝ 1/f²;
            single pixels may be off by 3 to 5 times as much.
        learned: plan for gradients to the medium: finer, as slopes are wanted too, and even if
            forward scatter or its width is invisible now; its gradient is not negligible.
        margin: widen the range of widths by this factor either way, for parameters that will be
            learned.
        seen: the medium as a camera sees it, if not as it is.
    """
    checks.tolerance(tolerance)
    law = medium.point_spread
    near, far = max(distance_range[0], 0.0), min(distance_range[1], FARTHEST)
    weights = Weights.of(medium) if seen is None else seen
    first, last, strength = _scattered(*weights[:4], near, far, tolerance, learned)
    traced = learned and law.requires_grad
    if strength == 0:
        learns = learned and traced
        return BlurDemand(0.0, 0.0, tolerance, law.shape, law.reference_size, learns)
    widths = widths_at(medium, np.array([first, last]), None)
    low, high = float(widths.min()), float(widths.max())
    # in half octaves, so that similar media may share a plan
    slack = _SLACK * octave_steps(1 / strength, 2, math.floor)
    blur_tolerance = min(tolerance * slack, _FOR_SLOPES if learned else 0.5)
    blur_tolerance = max(blur_tolerance, min(tolerance, _FINEST))
    learns = learned and (traced or high > 0)
    return BlurDemand(
        low / margin, high * margin, blur_tolerance, law.shape, law.reference_size, learns
    )


def widths_at(medium: Medium, z: Array, size: tuple[int, int] | None) -> Array:
    """The widths, px, of all rows at distances (N), m, in double precision."""
    law, b_mean = medium.point_spread, medium.b_mean.detach().cpu().double().numpy()
    if not law.has_tensors:
        widths: Array = law.sigma(b_mean[:, None] * z, size)
        return widths
    with torch.no_grad():
        distances = torch.from_numpy(z).to(medium.beta.device)[None, None, None]
        return medium.width(distances, size).flatten(1).cpu().numpy()


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
    """Between which distances forward scatter shows, and the most of it, of the medium and the
    channel that have most; 0 if none does. Of what is learned, direct light counts where there is
    no scatter.
    """
    scattered, direct = np.zeros(len(_STEPS)), np.zeros(len(_STEPS))
    least = max(near, 1e-3)
    far = max(min(far, _farthest_blurred(G, signal_weights)), least)
    z = least * (far / least) ** _STEPS
    for row in range(len(beta)):
        left = direct_weights[row] @ np.exp(-beta[row][:, None] * z)
        _take_most(direct, left)
        _take_most(scattered, signal_weights[row] @ np.exp(-G[row][:, None] * z) - left)
    if learned and scattered.max() <= tolerance:
        scattered = np.maximum(scattered, direct)
    shown = np.flatnonzero(scattered > tolerance)
    if len(shown) == 0:
        return near, far, 0.0
    first, last = max(shown[0] - 1, 0), min(shown[-1] + 1, len(z) - 1)
    return near if first == 0 else z[first], z[last], scattered.max()


@compiled
def _take_most(most: Array, T: Array) -> None:
    """Raise `most` (N) to the light that transmittances (3xN, or 9xN of matrices) make of any
    scene, or take.
    """
    each = len(T) // 3
    for row in range(0, len(T), each):
        for n in range(len(most)):
            # with the colour in 0…1 that adds up all that is positive, or negative
            made = taken = 0.0
            for j in range(row, row + each):
                made += max(T[j, n], 0.0)
                taken -= min(T[j, n], 0.0)
            most[n] = max(most[n], made, taken)


@compiled
def _farthest_blurred(G: Array, signal_weights: Array) -> float:
    """The distance, m, from which on a pixel asks nothing of the blur, as all of the signal has
    faded below any tolerance; `FARTHEST` if there is none.
    """
    slowest = math.inf
    for row in range(len(G)):
        for k in range(G.shape[1]):
            if np.any(signal_weights[row, :, k] != 0):
                slowest = min(slowest, G[row, k])
    return FARTHEST if slowest <= 0 else min(40 / slowest, FARTHEST)


def plan_for(z: Tensor, medium: Medium, size: tuple[int, int], tolerance: float) -> BlurPlan:
    """The plan for effective distances z, m, in a picture of (height, width) `size`, rounded so
    that similar ones share it. Gradients of the medium take a finer one.
    """
    seen = Weights.of(medium)
    return plan_between(blurred_between(z, seen), medium, size, tolerance, seen)


def plan_between(
    ends: tuple[float, float],
    medium: Medium,
    size: tuple[int, int],
    tolerance: float,
    seen: Weights,
) -> BlurPlan:
    """As `plan_for`, of a medium as a camera sees it, between two distances, m."""
    learned = torch.is_grad_enabled() and medium.requires_grad
    margin = _MARGIN if learned else 1.0
    demand = blur_demand(medium, ends, tolerance, learned=learned, margin=margin, seen=seen)
    return demand.plan(size, shared=True)


def blurred_between(z: Tensor, seen: Weights) -> tuple[float, float]:
    """The nearest distance of a map, m, and the farthest of those at which blurs may show."""
    nearest, farthest = checks.extent(z)
    end = _farthest_blurred(seen.G, seen.signal)
    if farthest >= end < FARTHEST:
        blurred = z.detach()[z.detach() < end]
        farthest = float(blurred.max()) if blurred.numel() else nearest
    return nearest, max(farthest, nearest)


def constant_plan(
    demand: BlurDemand, sides: tuple[int, int] | None, height: int, width: int
) -> BlurPlan:
    """The plan of a demand for pictures of one size, or for all whose short side lies in `sides`; a
    compiler takes it for a constant.
    """
    return demand.plan((height, width)) if sides is None else demand.plan_all(sides)


# what torch.compiler.assume_constant_result does, without its import of torch._dynamo (.7 s)
_CONSTANT: Any = constant_plan
_CONSTANT._dynamo_marked_constant = True


def distance_range_of(value: Any) -> tuple[float, float]:
    """A `distance_range`; refuses what is none."""
    near, far = checks.pair("distance_range", value, "(nearest, farthest) in metres")
    if not 0 <= near < far:
        expected = "0 ≤ nearest < farthest in metres"
        raise ValueError(f"distance_range must be {expected}, got {value}")
    return near, far


def sides_of(value: Any) -> tuple[int, int]:
    """A range of short sides; refuses what is none."""
    smallest, largest = checks.pair("sides", value, "(smallest, largest) short side in px")
    whole = smallest.is_integer() and largest.is_integer()
    if not (whole and 1 <= smallest <= largest <= EVERY_SIDE[1]):
        expected = f"whole numbers, 1 ≤ smallest ≤ largest short side ≤ {EVERY_SIDE[1]} px"
        raise ValueError(f"sides must be {expected}, got {value}")
    return int(smallest), int(largest)
