"""A blur of a different width at every pixel, from a planned stack of a few fixed-width Gaussian blurs.

The image is blurred at K fixed widths and combined per pixel with weights W_k(σ), ΣW_k = 1. A plan holds the widths,
the grid of each and the weights as polynomials of v = ½ log(σ² + ½): logarithmic for wide blurs, linear in σ² for
narrow ones, so that σ = 0 is the image itself and every gradient is finite. (An exponential shape is linear in σ there:
v = log(σ + ½) needs 10 blurs where the other needs 16.) The weights are the least-squares fit, over
a picture's frequencies (power ∝ 1/f²), of the K transfer functions to the wanted one; any point spread that is a
mixture of Gaussians thus comes from the same stack.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug import checks
from uwaug.banded import PERIOD, Array, Banded, along_columns, along_rows, operators, sampled_parameter
from uwaug.medium import Shape

__all__ = ["NO_BLUR", "BlurPlan", "octave_steps", "plan_blur", "varying_blur"]

Chain = tuple[tuple[int, Banded, Banded], ...]  # (axis, matrix, its transpose), in the order of use

_CONTRAST = 0.25
"""Standard deviation of the picture that errors refer to, on a scale of 0…1."""

_V_FLOOR = 0.5
"""px² or, of an exponential shape, px: keeps v finite at σ = 0."""

# How a plan is chosen. In brackets: the blurs that 30 Gaussian + 30 exponential plans (ten ranges of σ from 0…0.5 to
# 0…200 px, tolerances .01, .002, .0005) need in all, and what other values would make of it. Today: 182 + 244.
_PLANNED = 0.48  # of the tolerance is the planned RMSE, so that .002 gives 60 dB and .0005 72 dB
_PLANNED_AT_MOST = 0.6  # where _MOST_NODES are not enough: sharp tails of an exponential shape
_MOST_NODES = 24
_PLACES = 33  # of the range at which the weights are fitted (17: 180 + 245; 65: 182 + 244)
_NOISE = 3  # the planned RMSE may have so many times the error of a single blur (1: 263 + 257; 10: 178 + 244)
_NARROWEST = 0.6  # px, the least width beside σ = 0: narrower ones need kernels of 3 px too (.75: 240; 1: 314)
_NARROWEST_SHARE = 0.7  # of the widest σ, if that is less (1: 203)
_IDENTITY_BELOW = 0.75  # px: σ = 0, the image itself, is among the blurs if the range begins below (never: 393 + 337)
# An exponential shape of σ mixes Gaussians of σ/|N(0, 1)|: beyond x·σ lies .8/x of its light.
_TAIL = 0.4  # the widest blur is _TAIL/target·σ (.2: 241; .8: 246 exponential)
_WIDEST = 0.75  # of the picture's longest side, wider ones all give the mean (.375: 300, four plans fail; 1.5: 257)
_CORE = 0.5  # of the narrowest σ begin the blurs of an exponential shape (.25: 257; 1: 349, six plans fail)
_NARROWEST_EXPONENTIAL = 0.3  # px (.2 and .5: 247)

_STRIP = 200_000  # samples of a strip; 50_000 takes a fifth longer (calls), 400_000 a tenth at 1024² (caches)


@dataclass(frozen=True)
class BlurPlan:
    """How a spatially varying blur is computed: a value, made by `plan_blur`.

    Attributes:
        sigma_min, sigma_max: widths served, px; a pixel outside is given the nearer end.
        sigmas: the K fixed widths, px; 0 is the image itself.
        cells: grid cell of each, px; 1 is the image's own grid.
        coefficients: K polynomials in v over the range, as Chebyshev series; they sum to 1.
        reach: kernels are cut at reach·σ.
        error: predicted RMSE over the range, on a picture with a standard deviation of 0.25.
        shape: of the blur that a pixel asks for.
    """

    sigma_min: float
    sigma_max: float
    sigmas: tuple[float, ...]
    cells: tuple[float, ...]
    coefficients: tuple[tuple[float, ...], ...]
    reach: float
    error: float
    shape: Shape = "gaussian"

    def __str__(self) -> str:
        if self.sigmas == (0.0,):
            return "no blur (it would not show)"
        widths = []
        for sigma, cell in zip(self.sigmas, self.cells, strict=True):
            widths.append(f"{sigma:.3g}" if cell == 1 else f"{sigma:.3g}/{cell:.2g}")
        span = f"{self.sigma_min:.3g}…{self.sigma_max:.3g} px"
        decibel = -20 * math.log10(self.error)
        return f"{len(self.sigmas)} blurs for σ {span} ({', '.join(widths)}), {decibel:.0f} dB"


NO_BLUR = BlurPlan(0.0, 0.0, (0.0,), (1.0,), ((1.0,),), 0.0, 0.0)


def octave_steps(value: float, per_octave: int, rounding: Callable[[float], int]) -> float:
    """`value` rounded to a power of 2^(1/per_octave), so that similar values share a plan."""
    return float(2.0 ** (rounding(per_octave * math.log2(value)) / per_octave))


def _v(sigma: float, shape: Shape) -> float:
    if shape == "exponential":
        return math.log(sigma + _V_FLOOR)
    return 0.5 * math.log(sigma * sigma + _V_FLOOR)


def _sigma(v: float, shape: Shape) -> float:
    if shape == "exponential":
        return max(math.exp(v) - _V_FLOOR, 0.0)
    return math.sqrt(max(math.exp(2 * v) - _V_FLOOR, 0.0))


def range_in_v(plan: BlurPlan) -> tuple[float, float]:
    """A plan's range of widths, in v. (No method: those of a plan cannot be compiled.)"""
    return _v(plan.sigma_min, plan.shape), _v(plan.sigma_max, plan.shape)


@lru_cache(maxsize=8)
def _frequencies(longest: float) -> Array:
    """Frequencies of a picture whose longest side is `longest` px, (2, F), in cycles per px.

    Rings at equal steps of log f hold equal power: area ∝ f·df, power density ∝ 1/f².
    """
    radius = np.geomspace(0.5 / longest, math.sqrt(0.5), 48)
    angle = np.array([0.0, math.pi / 8, math.pi / 4])
    f = np.stack([np.outer(radius, np.cos(angle)).ravel(), np.outer(radius, np.sin(angle)).ravel()])
    return np.asarray(f[:, (f <= 0.5).all(0)])


@lru_cache(maxsize=8)
def _cosines(longest: float) -> Array:
    """cos(2πfn) at those frequencies for the taps n = 1…32 of a sampled Gaussian of up to 4 px, (2, 32, F)."""
    taps = np.arange(1, 33)[:, None]
    return np.asarray(np.cos(2 * np.pi * _frequencies(longest)[:, None] * taps))


def _gaussian_transfer(sigmas: Array, longest: float) -> Array:
    """Transfer functions (S, F) of sampled Gaussians, at the frequencies of a picture."""
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
    """Widths in equal steps of their logarithm, and transfer functions, of Gaussians to mix an exponential shape of."""
    widths = np.geomspace(0.05, 1e5, 400)
    return widths, _gaussian_transfer(widths, longest)


def _exponential_transfer(sigmas: Array, longest: float) -> Array:
    """Transfer functions (S, F) of exponential shapes: mixtures of Gaussians of widths σ/|N(0, 1)|."""
    widths, transfers = _mixture(longest)
    x = np.maximum(sigmas, 1e-9)[:, None] / widths  # |N(0, 1)| distributed
    shares = math.sqrt(2 / math.pi) * x * np.exp(-0.5 * x * x) * math.log(widths[1] / widths[0])
    sharp = np.array([[math.erfc(sigma / widths[0] / math.sqrt(2))] for sigma in sigmas])
    return np.asarray(sharp + shares @ transfers)


def plan_blur(
    sigma_min: float, sigma_max: float, tolerance: float = 0.002, shape: Shape = "gaussian", longest: float = 512.0
) -> BlurPlan:
    """Choose the fewest blurs that serve all widths in a range.

    Args:
        sigma_min, sigma_max: range of widths, px, 0 ≤ sigma_min ≤ sigma_max.
        tolerance: largest error that may pass, on a scale of 0…1; the planned RMSE is half of it, so that .002 gives 60
            dB and .0005 72 dB on a picture with a standard deviation of .25.
        shape: what a pixel of width σ asks for. "gaussian": exp(−2π²σ²f²). "exponential": exp(−2πσf), the classical
            transfer function of McGlamery (1980) and Jaffe (1990), whose point spread ∝ (r² + σ²)^(−3/2) has half of
            its energy beyond 1.7 σ and no finite variance. Below 2 px both shapes are what samples can hold: a sampled
            Gaussian, and the mixture of those, of widths σ/|N(0, 1)|, that an exponential is.
        longest: longest side of the images, px. An exponential shape needs no blurs much wider than that, and no waves
            longer than twice it are planned for. Gaussians do not depend on it.

    Raises:
        ValueError: if the range, the longest side or the tolerance is not as above, or the tolerance needs more than
            24 blurs.
    """
    if not 0 <= sigma_min <= sigma_max < math.inf:
        raise ValueError(f"expected 0 ≤ sigma_min ≤ sigma_max, finite, in px; got {sigma_min} and {sigma_max}")
    checks.tolerance(tolerance)
    checks.one_of("shape", shape, get_args(Shape))
    checks.within("longest", longest, 1)
    # in octaves, so that sizes share plans; the fine detail of a tiny picture would ask too much of narrow blurs
    octave = max(octave_steps(longest, 1, math.ceil), 256.0) if shape == "exponential" else 512.0
    return _plan_blur(float(sigma_min), float(sigma_max), float(tolerance), shape, octave)


@lru_cache(maxsize=1024)
def _plan_blur(sigma_min: float, sigma_max: float, tolerance: float, shape: Shape, longest: float) -> BlurPlan:
    target = _PLANNED * tolerance
    places, wanted = _wanted(sigma_min, sigma_max, shape, longest)
    if np.sqrt(((wanted - _amplitude(longest)) ** 2).sum(1)).max() <= target:
        return NO_BLUR
    for count in range(1, _MOST_NODES + 1):
        sigmas = _nodes(count, sigma_min, sigma_max, target, shape, longest)
        coefficients, error = _fit(sigmas, places, wanted, target / _NOISE, longest)
        if error <= target or (count == _MOST_NODES and error <= _PLANNED_AT_MOST * tolerance):
            break
    else:
        raise ValueError(f"tolerance {tolerance} needs more than {_MOST_NODES} blurs for σ {sigma_min}…{sigma_max} px")
    decibel = -20 * math.log10(target)
    # grid samples per σ: 70 dB at 1.1, 84 at 1.5
    density = min(max(1.1 + (decibel - 60) / 40, 1.0), 3.0)
    return BlurPlan(
        sigma_min=sigma_min,
        sigma_max=sigma_max,
        sigmas=sigmas,
        cells=tuple(_cell(sigma / density) for sigma in sigmas),
        coefficients=tuple(map(tuple, coefficients.tolist())),
        # 60 dB at 3, 84 at 4
        reach=min(max(3 + (decibel - 60) / 24, 2.5), 8.0),
        error=error,
        shape=shape,
    )


def _amplitude(longest: float) -> float:
    """Of each frequency of the picture that errors refer to."""
    return _CONTRAST / math.sqrt(_frequencies(longest).shape[1])


def _wanted(sigma_min: float, sigma_max: float, shape: Shape, longest: float) -> tuple[Array, Array]:
    """Places in the range, −1…1 (denser towards its ends, where the fit is worst), and the picture (P, F) wanted there.

    A single width has a single place.
    """
    start, end = _v(sigma_min, shape), _v(sigma_max, shape)
    places = np.ones(1) if end - start < 1e-6 else -np.cos(np.linspace(0, np.pi, _PLACES))
    v = end + 0.5 * (end - start) * (places - 1)
    sigmas = np.array([_sigma(x, shape) for x in v])
    transfer = _exponential_transfer if shape == "exponential" else _gaussian_transfer
    return places, transfer(sigmas, longest) * _amplitude(longest)


def _nodes(
    count: int, sigma_min: float, sigma_max: float, target: float, shape: Shape, longest: float
) -> tuple[float, ...]:
    """The widths of a stack: `count` of them between equal steps of v and Chebyshev nodes, and 0 if that is wanted."""
    first, last, narrowest = sigma_min, sigma_max, min(_NARROWEST, _NARROWEST_SHARE * sigma_max)
    if shape == "exponential":
        first, last = _CORE * sigma_min, min(_TAIL / target * sigma_max, _WIDEST * longest)
        narrowest = _NARROWEST_EXPONENTIAL
    low, high = (_v(max(sigma, narrowest), "gaussian") for sigma in (first, last))
    # .3 equal : .7 Chebyshev, to the power 1.1 (equal: 241 + 305; Chebyshev: 182 + 263; power 1: 188 + 246)
    steps = (np.arange(count) + 0.5) / count
    steps = (0.3 * steps + 0.35 * (1 - np.cos(np.pi * steps))) ** 1.1
    identity = (0.0,) if first < _IDENTITY_BELOW else ()
    return (*identity, *(_sigma(low + (high - low) * step, "gaussian") for step in steps))


def _fit(sigmas: tuple[float, ...], places: Array, wanted: Array, noise: float, longest: float) -> tuple[Array, float]:
    """Weights of the blurs as Chebyshev series over the range, (K, degree + 1), and the RMSE that is left.

    noise: error budget of a single blur (coarse grid, truncated kernel). Also the ridge strength, which stops similar
    blurs from getting large opposite weights.
    """
    k = len(sigmas)
    basis = _gaussian_transfer(np.array(sigmas), longest) * _amplitude(longest)
    # ΣW = 1 leaves k − 1 of the weights free: W = (0, …, 0, 1) + change @ free
    change = np.concatenate([np.eye(k - 1), -np.ones((1, k - 1))])
    alone = np.zeros((k, len(places)))
    alone[-1] = 1
    system = np.concatenate([basis.T @ change, noise * change])
    sides = np.concatenate([(wanted - basis[-1]).T, -noise * alone])
    # first over the frequencies, at each place; then along the range
    free = np.linalg.lstsq(system, sides, rcond=1e-12)[0]
    # a degree less: 189 + 246 blurs, two more: 178 + 244
    degree = 0 if len(places) == 1 or k == 1 else k + (sigmas[0] == 0)
    powers = np.polynomial.chebyshev.chebvander(places, degree)
    fitted = np.linalg.lstsq(powers, free.T, rcond=None)[0].T
    residual = system @ (fitted @ powers.T) - sides
    last = -fitted.sum(0, keepdims=True)
    last[0, 0] += 1
    return np.concatenate([fitted, last]), float(np.sqrt((residual**2).sum(0).mean()))


def _cell(widest: float) -> float:
    """The pitch of a grid, px, at most `widest`, so that a period holds whole cells or a cell whole periods."""
    if widest < 2:
        return 1.0
    return PERIOD / math.ceil(PERIOD / widest) if widest < PERIOD else float(PERIOD * (widest // PERIOD))


def node_weights(sigma: Tensor, plan: BlurPlan) -> Tensor:
    """Weights of a plan's blurs at every pixel.

    Args:
        sigma (Bx1xHxW tensor): widths, px, finite, ≥ 0.
        plan: from `plan_blur`.

    Returns:
        (BxKxHxW) weights that sum to 1 over K.
    """
    degree = len(plan.coefficients[0]) - 1
    coefficients = sigma.new_tensor(plan.coefficients)
    if degree == 0:
        return coefficients[:, :, None].expand(len(sigma), -1, *sigma.shape[-2:])
    # where in the range, −1…1. v = log ½ + log1p(2σ) of an exponential shape, else 2v = log ½ + log1p(2σ²)
    low, high = range_in_v(plan)
    exponential = plan.shape == "exponential"
    slope = (2 if exponential else 1) / (high - low)
    offset = slope * math.log(_V_FLOOR) - (low + high) / (high - low)
    x = sigma * (1 / _V_FLOOR) if exponential else sigma * sigma * (1 / _V_FLOOR)
    x = torch.log1p(x).mul_(slope).add_(offset).clamp(-1, 1)
    # Chebyshev polynomials by their recurrence, T_n = 2x·T_(n−1) − T_(n−2)
    twice = 2 * x
    terms = [torch.ones_like(x), x]
    for _ in range(degree - 1):
        terms.append((twice * terms[-1]).sub_(terms[-2]))
    b, _, h, w = x.shape
    powers = torch.cat(terms, 1).reshape(b, degree + 1, h * w)
    return (coefficients[None] @ powers).reshape(b, -1, h, w)


@torch.library.custom_op("uwaug::node_blur", mutates_args=())
def _node_blur(x: Tensor, sigma: float, cell: float, reach: float, adjoint: bool) -> Tensor:
    """One blur of a stack on x (H, N, W), or its adjoint: an operator of its own, which torch.compile keeps whole."""
    chain = _chain(sigma, cell, reach, x.shape[0], x.shape[2], x.dtype, x.device)
    if adjoint:
        chain = tuple((axis, transpose, matrix) for axis, matrix, transpose in reversed(chain))
    return _products(x.contiguous(), chain)


@_node_blur.register_fake
def _(x: Tensor, sigma: float, cell: float, reach: float, adjoint: bool) -> Tensor:
    return torch.empty_like(x, memory_format=torch.contiguous_format)


def _remember(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    ctx.arguments = inputs[1:]


def _node_blur_backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
    *arguments, adjoint = ctx.arguments
    return _node_blur(gradient, *arguments, not adjoint), None, None, None, None


_node_blur.register_autograd(_node_blur_backward, setup_context=_remember)


def _products(x: Tensor, chain: Chain) -> Tensor:
    """Apply the matrices of a chain in turn to x (H, N, W)."""
    for axis, matrix, _ in chain:
        h, n, w = x.shape
        if axis == 0:
            x = along_rows(matrix, x.reshape(h, n * w)).reshape(-1, n, w)
        else:
            x = along_columns(matrix, x.reshape(h * n, w)).reshape(h, n, -1)
    return x


def _chain(
    sigma: float, cell: float, reach: float, height: int, width: int, dtype: torch.dtype, device: torch.device
) -> Chain:
    """Products of one blur of a stack, in the order that needs the fewest operations; none for σ = 0."""
    if sigma == 0:
        return ()
    rows = operators(0, height, sigma, cell, reach, dtype, device)
    columns = operators(1, width, sigma, cell, reach, dtype, device)
    if cell == 1:
        return ((0, *rows[0]), (1, *columns[0]))
    return ((0, *rows[0]), (1, *columns[0]), (1, *columns[1]), (0, *rows[1]))


def _stages(chain: Chain) -> tuple[Chain, Banded | None, Chain]:
    """A chain in three: what is done up front, the product that gives a few rows at a time, what these rows still need.

    On a coarse grid all but the last product is done up front: those intermediates live on coarse grids and are small.
    """
    if not chain:
        return (), None, ()
    return (chain[:-1], chain[-1][1], ()) if len(chain) > 2 else ((), chain[0][1], chain[1:])


def row_strips(channels: int, height: int, width: int) -> Iterator[slice]:
    """Rows of an image, a strip at a time."""
    rows = PERIOD * max(1, _STRIP // (PERIOD * channels * width))
    return (slice(first, min(first + rows, height)) for first in range(0, height, rows))


def blurred_rows(image: Tensor, plan: BlurPlan) -> Iterator[tuple[slice, list[Tensor]]]:
    """The plan's blurs of one image, a strip of rows at a time so that what follows stays in the cache. Not for
    gradients.

    Args:
        image (CxHxW tensor): float32 or float64.
        plan: from `plan_blur`.

    Yields:
        the rows, and K tensors (1xCxRxW): `image` blurred by each of `plan.sigmas`.
    """
    c, h, w = image.shape
    x = image.transpose(0, 1).contiguous()
    sources, last = [], []
    for sigma, cell in zip(plan.sigmas, plan.cells, strict=True):
        before, along, after = _stages(_chain(sigma, cell, plan.reach, h, w, x.dtype, x.device))
        sources.append(_products(x, before))
        last.append((along, after))
    for rows in row_strips(c, h, w):
        strips = []
        for source, (along, after) in zip(sources, last, strict=True):
            strip = source[rows]
            if along is not None:
                flat = along_rows(along, source.reshape(len(source), -1), rows.start, rows.stop)
                strip = _products(flat.reshape(-1, c, w), after)
            strips.append(strip.transpose(0, 1)[None])
        yield rows, strips


def blurred(image: Tensor, plan: BlurPlan) -> list[Tensor]:
    """The plan's blurs of a batch: K tensors like `image` (BxCxHxW), differentiable."""
    b, c, h, w = image.shape
    x = image.permute(2, 0, 1, 3).reshape(h, b * c, w)
    stack = []
    for sigma, cell in zip(plan.sigmas, plan.cells, strict=True):
        blur = _node_blur(x, sigma, cell, plan.reach, False) if sigma > 0 else x
        stack.append(blur.reshape(h, b, c, w).permute(1, 2, 0, 3))
    return stack


def varying_blur(image: Tensor, sigma: Tensor, plan: BlurPlan | None = None, tolerance: float = 0.002) -> Tensor:
    """Blur every pixel with a Gaussian of its own width; edges are half-sample symmetric.

    Args:
        image (BxCxHxW tensor): float32 or float64, any scale.
        sigma (Bx1xHxW tensor): widths, px, finite, ≥ 0.
        plan: from `plan_blur`; by default one for the range of `sigma`.
        tolerance: of the default plan, see `plan_blur`.

    Returns:
        (BxCxHxW) tensor of the image's dtype, differentiable in both. Half precision is computed in float32.

    Raises:
        TypeError, ValueError: if types or sizes do not suit, or a width is negative, infinite or NaN.
    """
    for name, value, channels in (("image", image, None), ("sigma", sigma, 1)):
        checks.floating(name, value)
        if value.ndim != 4 or channels not in (None, value.shape[1]):
            raise ValueError(f"{name} must have shape (B, {channels or 'C'}, H, W), got {tuple(value.shape)}")
    if sigma.shape[-2:] != image.shape[-2:] or (len(sigma) != len(image) and 1 not in (len(sigma), len(image))):
        raise ValueError(f"image is {tuple(image.shape)} but sigma is {tuple(sigma.shape)}: sizes must agree")
    if image.numel() == 0 or sigma.numel() == 0:
        return image.clone() if len(sigma) else image[:0].clone()
    known = torch.compiler.is_compiling() or bool(((sigma.detach() >= 0) & sigma.detach().isfinite()).all())
    if not known:
        raise ValueError("sigma must be finite and ≥ 0 px everywhere; it holds a negative, infinite or NaN value")
    dtype = torch.promote_types(torch.promote_types(image.dtype, sigma.dtype), torch.float32)
    with torch.autocast(image.device.type, enabled=False):
        widths = sigma.to(dtype)
        if plan is None:
            low, high = widths.detach().aminmax()
            plan = plan_blur(float(low), float(high), tolerance)
        return mixed(blurred(image.to(dtype), plan), node_weights(widths, plan)).to(image.dtype)


def mixed(stack: list[Tensor], weights: Tensor) -> Tensor:
    """Σ_k weights[:, k]·stack[k], for K images (BxCxHxW) and weights (BxKxHxW)."""
    shares = torch.split(weights, 1, 1)  # gradients of slices would each fill all K with zeros
    total = shares[0] * stack[0]
    for share, image in zip(shares[1:], stack[1:], strict=True):
        total.addcmul_(share, image)
    return total
