"""Plans of a varying blur: number, widths and weights of fixed blurs that serve a range of widths.

An image is blurred at K fixed widths and combined per pixel with weights W_k(σ), ΣW_k = 1. A plan
holds the widths, the grid of each, and the weights as polynomials of v = ½ log(σ² + ½). That is
logarithmic for wide blurs and linear in σ² for narrow ones: σ = 0 is the image itself, and every
gradient is finite. For an exponential shape v is log(σ + ½).

The weights are the least-squares fit, over a picture's frequencies (power ∝ 1/f²), of the K
transfer functions to the wanted one. Any mixture of Gaussians thus comes from the same stack.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import get_args

import numpy as np

from uwaug._support import checks
from uwaug._support.types import Array, Shape
from uwaug.blur.kernels import PERIOD, sampled_parameter

V_FLOOR = 0.5  # keeps v finite at σ = 0: px² of a Gaussian, px of an exponential shape
_CONTRAST = 0.25  # standard deviation of the picture that errors refer to (0…1)

# What other values make of the number of blurs: benchmarks/CHOICES.md, "Plans of the blur".
_PLANNED_SHARE = 0.48  # planned RMSE over the tolerance: .002 gives 60 dB and .0005 72 dB
_PLANNED_SHARE_AT_MOST = 0.6  # the same where _MOST_NODES are not enough, as for sharp tails
_MOST_NODES = 32  # blurs of a stack, beside σ = 0
_PLACES = 33  # in the range, at which the weights are fitted
_BLUR_ERRORS = 3  # errors of a single blur that make up the planned RMSE
_IDENTITY_BELOW_PX = 0.75  # a range from below this has σ = 0 among its blurs
# The least width beside σ = 0: px, or a share of the widest σ if that is less.
_NARROWEST_PX, _NARROWEST_SHARE = 0.6, 0.7
# An exponential shape of σ mixes Gaussians of widths σ/|N(0, 1)|, and .8/x of its light lies beyond
# x·σ. Its widest blur is _TAIL/target·σ.
_TAIL = 0.4
_WIDEST_SIDES = 0.75  # the widest blur in longest sides; wider ones all give the mean
_CORE_SHARE = 0.5  # the narrowest blur as a share of the narrowest σ
_NARROWEST_EXPONENTIAL_PX = 0.3  # the narrowest blur beside σ = 0
_STEP_DB = 6  # to which shared plans round the error of grids and kernels


@dataclass(frozen=True, eq=False)
class BlurPlan:
    """Plan of a spatially varying blur, made by `plan_blur`, once for each range."""

    sigma_min: float  # this and the next: range of widths, px; pixels outside get the nearer end
    sigma_max: float
    sigmas: tuple[float, ...]  # the K fixed widths, px; 0 is the image itself
    cells: tuple[float, ...]  # grid cell of each, px; 1 is the image's grid
    coefficients: tuple[tuple[float, ...], ...]  # weights as K Chebyshev series in v, of sum 1
    reach: float  # kernels are cut at reach·σ
    error: float  # predicted RMSE over the range, on a picture with a standard deviation of 0.25
    shape: Shape = "gaussian"  # of the blur at a pixel

    def __str__(self) -> str:
        if self.sigmas == (0.0,):
            return "no blur (it would not show)"
        blurs = zip(self.sigmas, self.cells, strict=True)
        widths = [f"{x:.3g}" if cell == 1 else f"{x:.3g}/{cell:.2g}" for x, cell in blurs]
        span = f"{self.sigma_min:.3g}…{self.sigma_max:.3g} px"
        decibel = -20 * math.log10(self.error)
        return f"{len(self.sigmas)} blurs for σ {span} ({', '.join(widths)}), {decibel:.0f} dB"


NO_BLUR = BlurPlan(0.0, 0.0, (0.0,), (1.0,), ((1.0,),), 0.0, 0.0)


def plan_blur(
    sigma_min: float,
    sigma_max: float,
    tolerance: float = 0.002,
    shape: Shape = "gaussian",
    longest: float = 512.0,
    *,
    shared: bool = False,
) -> BlurPlan:
    """Choose the fewest blurs that serve all widths in a range.

    Args:
        sigma_min, sigma_max: range of widths, px, 0 ≤ sigma_min ≤ sigma_max.
        tolerance: RMSE of the blur that may pass, in linear light, on pictures with power ∝ 1/f².
            Single pixels may be off by 3 to 5 times as much. Half of it is planned.
        shape: transfer function at width σ. "gaussian": exp(−2π²σ²f²). "exponential": exp(−2πσf),
            of McGlamery (1980) and Jaffe (1990); its point spread ∝ (r² + σ²)^(−3/2) has half of
            its energy beyond 1.7 σ and no finite variance. Below 2 px both are as samples hold
            them: a sampled Gaussian, and a mixture of those of widths σ/|N(0, 1)|.
        longest: longest side of the images, px. An exponential shape needs no blurs much wider and
            no waves longer than twice that. Gaussians do not depend on it.
        shared: take widths from half octaves, and round the error of grids and kernels, so that
            plans of many media share a few dozen blurs. Plans then have 4 % more blurs.

    Raises:
        ValueError: if the range, the longest side or the tolerance is not as above, or the
            tolerance needs more than 32 blurs.
    """
    if not 0 <= sigma_min <= sigma_max < math.inf:
        expected = "0 ≤ sigma_min ≤ sigma_max, finite, in px"
        raise ValueError(f"expected {expected}; got {sigma_min} and {sigma_max}")
    checks.tolerance(tolerance)
    checks.one_of("shape", shape, get_args(Shape))
    checks.within("longest", longest, 1)
    return planned(float(sigma_min), float(sigma_max), float(tolerance), shape, longest, shared)


def planned(
    low: float, high: float, tolerance: float, shape: Shape, longest: float, shared: bool
) -> BlurPlan:
    """As `plan_blur`, unchecked."""
    # in octaves, so that sizes share plans; a tiny picture would ask too much of narrow blurs
    octave = max(octave_steps(longest, 1, math.ceil), 256.0) if shape == "exponential" else 512.0
    return _plan_blur(low, high, tolerance, shape, octave, shared)


@lru_cache(maxsize=1024)
def _plan_blur(
    low: float, high: float, tolerance: float, shape: Shape, longest: float, shared: bool
) -> BlurPlan:
    target = _PLANNED_SHARE * tolerance
    places, wanted = _wanted(low, high, shape, longest)
    if np.sqrt(((wanted - _amplitude(longest)) ** 2).sum(1)).max() <= target:
        return NO_BLUR
    for count in range(1, _MOST_NODES + 1):
        sigmas = _nodes(count, low, high, target, shape, longest)
        if shared and low < high:
            sigmas = _snapped(sigmas)
        coefficients, error = _fit(sigmas, places, wanted, target / _BLUR_ERRORS, longest)
        last_resort = count == _MOST_NODES and error <= _PLANNED_SHARE_AT_MOST * tolerance
        if error <= target or last_resort:
            break
    else:
        widths = f"widths of {low:.3g}…{high:.3g} px need more than {_MOST_NODES} blurs"
        cure = "ask for a larger tolerance, or for a smaller range of distances or widths"
        raise ValueError(f"{widths} for an RMSE of {tolerance:.3g} of the blurred picture: {cure}")
    decibel = -20 * math.log10(target)
    if shared:
        decibel = _STEP_DB * math.ceil(decibel / _STEP_DB)
    # Grids and kernels err by a third of the plan each, 9.5 dB less: a grid of 1.1 samples per σ
    # by 70 dB and one of 1.5 by 84; a kernel cut at 3 σ by 70 and one cut at 3.5 σ by 85.
    density = min(max(1.1 + (decibel - 60) / 40, 1.0), 3.0)
    # the half picture, which grids read, errs by 90 dB at 4 px and by σ⁻⁴
    halved_from = 0.4 * 10 ** (decibel / 80)
    return BlurPlan(
        sigma_min=low,
        sigma_max=high,
        sigmas=sigmas,
        cells=tuple(_cell(x / density) if x > halved_from else 1.0 for x in sigmas),
        coefficients=tuple(map(tuple, coefficients.tolist())),
        reach=min(max(3 + (decibel - 60) / 24, 2.5), 8.0),
        error=error,
        shape=shape,
    )


def _wanted(low: float, high: float, shape: Shape, longest: float) -> tuple[Array, Array]:
    """Places in the range, −1…1, and the wanted amplitudes (P, F) at each."""
    # places lie denser towards the ends, where the fit is worst
    start, end = _v(low, shape), _v(high, shape)
    places = np.ones(1) if end - start < 1e-6 else -np.cos(np.linspace(0, np.pi, _PLACES))
    v = end + 0.5 * (end - start) * (places - 1)
    sigmas = np.array([_sigma(x, shape) for x in v])
    transfer = _exponential_transfer if shape == "exponential" else _gaussian_transfer
    return places, transfer(sigmas, longest) * _amplitude(longest)


def _nodes(
    count: int, low: float, high: float, target: float, shape: Shape, longest: float
) -> tuple[float, ...]:
    """Widths (px) of a stack: `count` of them, and 0 if the range begins near it."""
    if shape == "exponential":
        first, last = _CORE_SHARE * low, min(_TAIL / target * high, _WIDEST_SIDES * longest)
        narrowest = _NARROWEST_EXPONENTIAL_PX
    else:
        first, last, narrowest = low, high, min(_NARROWEST_PX, _NARROWEST_SHARE * high)
    start, end = _v(max(first, narrowest), "gaussian"), _v(max(last, narrowest), "gaussian")
    # .3 equal steps of v : .7 Chebyshev nodes, to the power 1.1
    steps = (np.arange(count) + 0.5) / count
    steps = (0.3 * steps + 0.35 * (1 - np.cos(np.pi * steps))) ** 1.1
    identity = (0.0,) if first < _IDENTITY_BELOW_PX else ()
    return (*identity, *(_sigma(start + (end - start) * step, "gaussian") for step in steps))


def _snapped(sigmas: tuple[float, ...]) -> tuple[float, ...]:
    """Round widths to half octaves, or to finer steps where two would become one."""
    steps, snapped = 1, tuple[float, ...]()
    while len(set(snapped)) < len(set(sigmas)):
        steps *= 2
        snapped = tuple(octave_steps(sigma, steps, round) if sigma else 0.0 for sigma in sigmas)
    return snapped


def _fit(
    sigmas: tuple[float, ...], places: Array, wanted: Array, noise: float, longest: float
) -> tuple[Array, float]:
    """Weights of the blurs as Chebyshev series over the range (K, degree + 1), and their RMSE. The
    noise of a single blur is the ridge that keeps similar ones from large opposite weights.
    """
    k = len(sigmas)
    basis = _gaussian_transfer(np.array(sigmas), longest) * _amplitude(longest)
    # ΣW = 1 leaves k − 1 of the weights free: W = start + change @ free
    change = np.concatenate([np.eye(k - 1), -np.ones((1, k - 1))])
    start = np.zeros((k, len(places)))
    start[-1] = 1
    system = np.concatenate([basis.T @ change, noise * change])
    sides = np.concatenate([(wanted - basis[-1]).T, -noise * start])
    # first over the frequencies, at each place; then along the range
    free = np.linalg.lstsq(system, sides, rcond=1e-12)[0]
    degree = 0 if len(places) == 1 or k == 1 else k + (sigmas[0] == 0)
    powers = np.polynomial.chebyshev.chebvander(places, degree)
    fitted = np.linalg.lstsq(powers, free.T, rcond=None)[0].T
    residual = system @ (fitted @ powers.T) - sides
    last = -fitted.sum(0, keepdims=True)
    last[0, 0] += 1
    return np.concatenate([fitted, last]), float(np.sqrt((residual**2).sum(0).mean()))


def _cell(widest: float) -> float:
    """Pitch of a grid, `widest` px at most, that divides the period or is a multiple of it."""
    if widest < 2:
        return 1.0
    if widest < PERIOD:
        return PERIOD / math.ceil(PERIOD / widest)
    return float(PERIOD * (widest // PERIOD))


def octave_steps(value: float, per_octave: int, rounding: Callable[[float], int]) -> float:
    """Round a value to a power of 2^(1/per_octave), so that similar values share a plan."""
    return float(2.0 ** (rounding(per_octave * math.log2(value)) / per_octave))


def place_line(plan: BlurPlan) -> tuple[float, float]:
    """Slope and offset of the place, −1…1, of a width in a plan's range: the argument of series.

    The place is slope·ln(1 + x) + offset, with x = 2σ² of a Gaussian, as 2v = ln ½ + ln(1 + 2σ²),
    and x = 2σ of an exponential shape, as v = ln ½ + ln(1 + 2σ). Both are 0 for a single width.
    """
    # no method, as methods of a plan cannot be compiled
    low, high = _v(plan.sigma_min, plan.shape), _v(plan.sigma_max, plan.shape)
    if low == high:
        return 0.0, 0.0
    slope = (2 if plan.shape == "exponential" else 1) / (high - low)
    return slope, slope * math.log(V_FLOOR) - (low + high) / (high - low)


def _v(sigma: float, shape: Shape) -> float:
    if shape == "exponential":
        return math.log(sigma + V_FLOOR)
    return 0.5 * math.log(sigma * sigma + V_FLOOR)


def _sigma(v: float, shape: Shape) -> float:
    if shape == "exponential":
        return max(math.exp(v) - V_FLOOR, 0.0)
    return math.sqrt(max(math.exp(2 * v) - V_FLOOR, 0.0))


def _amplitude(longest: float) -> float:
    """Amplitude of each frequency of the picture that errors refer to."""
    return _CONTRAST / math.sqrt(_frequencies(longest).shape[1])


@lru_cache(maxsize=8)
def _frequencies(longest: float) -> Array:
    """Frequencies (2, F), in cycles per px, of a picture whose longest side is `longest` px."""
    # rings at equal steps of log f hold equal power: area ∝ f·df, power density ∝ 1/f²
    radius = np.geomspace(0.5 / longest, math.sqrt(0.5), 48)
    angle = np.array([0.0, math.pi / 8, math.pi / 4])
    f = np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))])
    f = f.reshape(2, -1)
    return np.asarray(f[:, (f <= 0.5).all(0)])


@lru_cache(maxsize=8)
def _cosines(longest: float) -> Array:
    """Cosines cos(2πfn) (2, 32, F) for the taps n = 1…32 of a Gaussian of up to 4 px."""
    taps = np.arange(1, 33)[:, None]
    return np.asarray(np.cos(2 * np.pi * _frequencies(longest)[:, None] * taps))


def _gaussian_transfer(sigmas: Array, longest: float) -> Array:
    """Transfer functions (S, F) of sampled Gaussians at the frequencies of a picture."""
    squares = (_frequencies(longest) ** 2).sum(0)
    # wider than 4 px, sampling no longer shows
    transfer = np.exp(-2 * (np.pi * sigmas[:, None]) ** 2 * squares)
    narrow = sigmas <= 4
    parameter = np.maximum(sampled_parameter(sigmas[narrow]), 0.01)[:, None]
    weights = np.exp(-0.5 * (np.arange(1, 33) / parameter) ** 2)
    axes = (1 + 2 * weights @ _cosines(longest)) / (1 + 2 * weights.sum(1, keepdims=True))
    transfer[narrow] = axes[0] * axes[1]
    return np.asarray(transfer)


@lru_cache(maxsize=8)
def _mixture(longest: float) -> tuple[Array, Array]:
    """Widths, in equal steps of their logarithm, and transfer functions of Gaussians to mix."""
    widths = np.geomspace(0.05, 1e5, 400)
    return widths, _gaussian_transfer(widths, longest)


def _exponential_transfer(sigmas: Array, longest: float) -> Array:
    """Transfer functions (S, F) of exponentials: mixtures of Gaussians of widths σ/|N(0, 1)|."""
    widths, transfers = _mixture(longest)
    x = np.maximum(sigmas, 1e-9)[:, None] / widths  # |N(0, 1)| distributed
    step = math.log(widths[1] / widths[0])
    shares = math.sqrt(2 / math.pi) * x * np.exp(-0.5 * x * x) * step
    # all below the first width counts as sharp, so that half of its step is left
    shares[:, 0] *= 0.5
    sharp = np.array([[math.erfc(sigma / widths[0] / math.sqrt(2))] for sigma in sigmas])
    return np.asarray(sharp + shares @ transfers)
