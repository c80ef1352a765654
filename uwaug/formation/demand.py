"""The blur that a medium needs over a range of distances: widths, tolerance and plans."""

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
"""Short sides, px, from a thumbnail's to a 4K picture's, for which the command line exports."""

EVERY_SIDE = (1, 16384)
"""Short sides, px, of all pictures that a plan may be asked for."""

_LONGEST_SIDES = 4
"""Longest side of a picture, in largest short sides of a plan for all sizes."""

_SLACK = 1.4
"""Blur tolerance over what the pixel with most scatter allows: few have as much, and linear light
has less contrast than the plan assumes. At 1.75 a picture of forward scatter alone fell below 60 dB
at a tolerance of .002.
"""

_MIN_TOLERANCE = 1e-5
"""Smallest blur tolerance for a bright exposure: with a gain of 1000, all but the darkest is white.
"""

_LEARNED_TOLERANCE = 0.0005
"""Largest blur tolerance where a medium is learned, however weak its forward scatter: a slope in
the width is relative. Against the exact model (48 × 48 px, widths of 2…11 and 1…20 px, five waters)
the gradient of a loss to the scale is then within .5 %. At .002 it is within 2 %.
"""

_LEARNED_REACH_PX = 0.5
"""Smallest end of a plan for widths that are learned, so that they can grow."""

_LEARNED_MARGIN = 1.1
"""Factor by which a plan for gradients goes beyond the widths at hand, as half of the slope is
missing at its very end.
"""

_WIDEST_SIDES = 8
"""Widest blur, in longest sides: wider ones all give the mean."""

_LOG_STEPS = np.linspace(0, 1, 65)
"""Places in the logarithm of distance at which forward scatter is sampled."""


class Weights(NamedTuple):
    """Arrays of a medium of B rows in double precision: rates (BxK, BxL) and weights of the three
    curves (Bx3xK, Bx3xL, Bx3xL), of which the first two have nine rows for surfaces with spectra.
    """

    beta: Array
    direct: Array
    G: Array
    signal: Array
    veil: Array

    @staticmethod
    def of(medium: Medium) -> "Weights":
        """The arrays of a medium."""
        direct, signal = medium.direct_weights.flatten(1, -2), medium.signal_weights.flatten(1, -2)
        tensors = (medium.beta, direct, medium.G, signal, medium.veil_weights)
        return Weights(*(x.detach().cpu().double().contiguous().numpy() for x in tensors))

    def seen_by(self, gain: Array) -> "Weights":
        """The medium before a camera that multiplies channels (B or 1, 3), or mixes them by
        matrices (B or 1, 3, 3).
        """
        beta, G = self.beta, self.G
        if len(gain) > len(beta):
            beta, G = beta.repeat(len(gain), 0), G.repeat(len(gain), 0)
        if gain.ndim == 2 and self.direct.shape[1] == 3:
            gain = gain[..., None]
            return Weights(beta, gain * self.direct, G, gain * self.signal, gain * self.veil)
        matrix = gain if gain.ndim == 3 else gain[..., None] * np.eye(3)
        direct, signal = _mixed(matrix, self.direct), _mixed(matrix, self.signal)
        return Weights(beta, direct, G, signal, matrix @ self.veil)


def _mixed(matrix: Array, weights: Array) -> Array:
    """Weights (Bx3xK, or Bx9xK of matrices) after a matrix (Bx3x3) that mixes channels: Bx9xK."""
    if weights.shape[1] == 3:
        mixed = matrix[..., None] * weights[:, None]
    else:
        mixed = matrix @ weights.reshape(len(weights), 3, -1)
    return mixed.reshape(len(mixed), 9, -1)


@dataclass(frozen=True)
class BlurDemand:
    """The blur that a medium needs over a range of distances, before the image size is known.

    Attributes:
        low, high: smallest and largest width that shows, px at the point spread's reference size;
            both 0 if none does.
        blur_tolerance: tolerance of the blurred picture before it is weighted with forward scatter;
            the weaker the scatter, the larger.
        shape, reference_size: shape and reference size of the point spread.
        learned: True to plan a blur even if none shows, as the width is learned.
    """

    low: float
    high: float
    blur_tolerance: float
    shape: Shape
    reference_size: float | None
    learned: bool = False

    @property
    def serves_every_size(self) -> bool:
        """True if pictures of any size need the same blur."""
        return self.high == 0 or (self.reference_size is None and self.shape == "gaussian")

    def covers(self, other: "BlurDemand") -> bool:
        """True if a plan for this demand serves another one of the same law."""
        wide_enough = self.low <= other.low and other.high <= self.high
        return wide_enough and self.blur_tolerance <= other.blur_tolerance

    def plan(self, size: tuple[int, int], *, shared: bool = False) -> BlurPlan:
        """The plan for an image of (height, width) `size`.

        `shared` rounds the ends of the range outwards to half octaves, so that similar demands
        share a plan and its matrices: for media that change from call to call.
        """
        return self._plan(min(size), min(size), max(size), shared)

    def plan_all(self, sides: tuple[int, int]) -> BlurPlan:
        """One plan for all images whose short side lies in `sides`, px, and whose long side is 4
        times the larger of these at most.
        """
        return self._plan(*sides, _LONGEST_SIDES * sides[1], shared=False)

    def _plan(self, smallest: int, largest: int, longest: int, shared: bool) -> BlurPlan:
        reference = self.reference_size
        low = self.low * (1.0 if reference is None else smallest / reference)
        high = min(
            self.high * (1.0 if reference is None else largest / reference),
            float(_WIDEST_SIDES * longest),
        )
        if self.learned:
            high = max(high, _LEARNED_REACH_PX)
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
    """The blur that a medium needs over a range of effective distances, and no more.

    Distances at which forward scatter is below the tolerance do not count. The weaker the scatter,
    the larger the blur error that is allowed.

    Args:
        medium: any batch; the demand covers all rows.
        distance_range: (nearest, farthest) of m·z, m; 0 ≤ nearest ≤ farthest, inf allowed.
        tolerance: RMSE of the blur that may pass, in linear light, on pictures with power ∝ 1/f²;
            single pixels may be off by 3 to 5 times as much.
        learned: True to plan for gradients to the medium: finer, as slopes are wanted, and even if
            forward scatter or its width is invisible now.
        margin: factor by which the range of widths is widened either way, for widths that are
            learned.
        seen: the medium before a camera; None for the medium as it is.
    """
    checks.tolerance(tolerance)
    law = medium.point_spread
    near, far = max(distance_range[0], 0.0), min(distance_range[1], FARTHEST)
    weights = Weights.of(medium) if seen is None else seen
    first, last, strength = _scattered(*weights[:4], near, far, tolerance, learned)
    learns_width = learned and law.requires_grad
    if strength == 0:
        return BlurDemand(0.0, 0.0, tolerance, law.shape, law.reference_size, learns_width)
    widths = widths_at(medium, np.array([first, last]), None)
    low, high = float(widths.min()), float(widths.max())
    # in half octaves, so that similar media may share a plan
    slack = _SLACK * octave_steps(1 / strength, 2, math.floor)
    blur_tolerance = min(tolerance * slack, _LEARNED_TOLERANCE if learned else 0.5)
    blur_tolerance = max(blur_tolerance, min(tolerance, _MIN_TOLERANCE))
    learns_width |= learned and high > 0
    return BlurDemand(
        low / margin, high * margin, blur_tolerance, law.shape, law.reference_size, learns_width
    )


def widths_at(medium: Medium, z: Array, size: tuple[int, int] | None) -> Array:
    """Widths (BxN), px, of a medium of B rows at distances (N), m, in double precision."""
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
    """Nearest and farthest distance, m, at which forward scatter shows, and the largest scatter of
    any medium and channel; 0 if none shows. If it is learned, direct light stands for scatter that
    does not show.
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
    """Distance, m, beyond which a pixel needs no blur, as all of the signal has faded below any
    tolerance; `FARTHEST` if there is none.
    """
    slowest = math.inf
    for row in range(len(G)):
        for k in range(G.shape[1]):
            if np.any(signal_weights[row, :, k] != 0):
                slowest = min(slowest, G[row, k])
    return FARTHEST if slowest <= 0 else min(40 / slowest, FARTHEST)


def plan_for(z: Tensor, medium: Medium, size: tuple[int, int], tolerance: float) -> BlurPlan:
    """The plan for effective distances z, m, in a picture of (height, width) `size`, rounded so
    that similar distances share it. Gradients of the medium take a finer plan.
    """
    weights = Weights.of(medium)
    return plan_between(blurred_between(z, weights), medium, size, tolerance, weights)


def plan_between(
    ends: tuple[float, float],
    medium: Medium,
    size: tuple[int, int],
    tolerance: float,
    weights: Weights,
) -> BlurPlan:
    """`plan_for` between two distances, m, of a medium before a camera."""
    learned = torch.is_grad_enabled() and medium.requires_grad
    margin = _LEARNED_MARGIN if learned else 1.0
    demand = blur_demand(medium, ends, tolerance, learned=learned, margin=margin, seen=weights)
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
        expected = "0 ≤ nearest < farthest in metres"
        raise ValueError(f"distance_range must be {expected}, got {value}")
    return near, far


def sides_of(value: Any) -> tuple[int, int]:
    """Check a range of short sides, px."""
    smallest, largest = checks.pair("sides", value, "(smallest, largest) short side in px")
    whole = smallest.is_integer() and largest.is_integer()
    if not (whole and 1 <= smallest <= largest <= EVERY_SIDE[1]):
        expected = f"whole numbers, 1 ≤ smallest ≤ largest short side ≤ {EVERY_SIDE[1]} px"
        raise ValueError(f"sides must be {expected}, got {value}")
    return int(smallest), int(largest)
