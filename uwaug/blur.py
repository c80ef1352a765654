"""A Gaussian blur of a different width at every pixel, from a planned stack of a few fixed-width blurs.

The image is blurred at K fixed widths and combined per pixel with weights W_k(σ), ΣW_k = 1. A plan holds the widths,
the grid of each and the weights as polynomials of v = ½ log(σ² + ½): logarithmic for wide blurs, linear in σ² for
narrow ones, so that σ = 0 is the image itself and every gradient is finite. (An exponential shape is linear in σ there:
v = log(σ + ½) needs 10 blurs where the other needs 16.) The weights are the least-squares fit, over
a picture's frequencies (power ∝ 1/f²), of the K transfer functions to the wanted one; any point spread that is a
mixture of Gaussians thus comes from the same stack.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug.banded import (
    PERIOD,
    Banded,
    along_columns,
    along_rows,
    gaussian_rows,
    operators,
    sampled_parameter,
)
from uwaug.water import Array

Chain = tuple[tuple[int, Banded, Banded], ...]  # (axis, matrix, its transpose), in the order of use
Shape = Literal["gaussian", "exponential"]

_CONTRAST = 0.25  # standard deviation of the picture that errors refer to, on a scale of 0…1
_V_FLOOR = 0.5  # px² or, of an exponential shape, px: keeps v finite at σ = 0
_MOST_NODES = 24
_WIDEST = 0.75  # of the picture's longest side: the widest Gaussian to make up an exponential shape
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
        widths = ", ".join(f"{s:.3g}" if c == 1 else f"{s:.3g}/{c:.2g}" for s, c in zip(self.sigmas, self.cells))
        decibel = -20 * math.log10(self.error)
        return (
            f"{len(self.sigmas)} blurs for σ {self.sigma_min:.3g}…{self.sigma_max:.3g} px ({widths}), {decibel:.0f} dB"
        )


NO_BLUR = BlurPlan(0.0, 0.0, (0.0,), (1.0,), ((1.0,),), 0.0, 0.0)


def _v(sigma: float, shape: Shape = "gaussian") -> float:
    return math.log(sigma + _V_FLOOR) if shape == "exponential" else 0.5 * math.log(sigma * sigma + _V_FLOOR)


def _sigma(v: float, shape: Shape = "gaussian") -> float:
    return max(math.exp(v) - _V_FLOOR, 0.0) if shape == "exponential" else math.sqrt(max(math.exp(2 * v) - _V_FLOOR, 0))


def ends(plan: BlurPlan) -> tuple[float, float]:
    """A plan's range in v. (No method: those of a plan cannot be compiled.)"""
    return _v(plan.sigma_min, plan.shape), _v(plan.sigma_max, plan.shape)


@lru_cache(maxsize=8)
def _frequencies(longest: float = 512.0) -> tuple[Array, Array]:
    """Frequencies of a picture whose longest side is `longest` px, (2, F) in cycles per px, and the amplitude (F,)
    each has if power falls as 1/f².
    """
    radius, angle = np.geomspace(0.5 / longest, math.sqrt(0.5), 48), np.array([0.0, math.pi / 8, math.pi / 4])
    f = np.stack([np.outer(radius, np.cos(angle)).ravel(), np.outer(radius, np.sin(angle)).ravel()])
    f = f[:, (f <= 0.5).all(0)]
    # rings at equal steps of log f hold equal power: area ∝ f·df, power density ∝ 1/f²
    amplitude: Array = np.full(f.shape[1], _CONTRAST / math.sqrt(f.shape[1]))
    return f, amplitude


@lru_cache(maxsize=8)
def _cosines(longest: float) -> Array:
    """cos(2πfn) at those frequencies for the taps n = 1…32 of a sampled Gaussian of up to 4 px, (2, 32, F)."""
    f, _ = _frequencies(longest)
    cosines: Array = np.cos(2 * np.pi * f[:, None] * np.arange(1, 33)[:, None])
    return cosines


@lru_cache(maxsize=8)
def _mixture(longest: float) -> tuple[Array, Array]:
    """Widths in equal steps of their logarithm, and transfer functions, of Gaussians to mix an exponential shape of."""
    widths = np.geomspace(0.05, 1e5, 400)
    return widths, _transfer(widths, "gaussian", longest)


def _transfer(sigmas: Array, shape: Shape, longest: float = 512.0) -> Array:
    """Transfer functions (S, F), at the frequencies of a picture, that pixels of widths `sigmas` ask for."""
    f, _ = _frequencies(longest)
    if shape == "exponential":
        widths, transfers = _mixture(longest)
        x = np.maximum(sigmas, 1e-9)[:, None] / widths  # |N(0, 1)| distributed
        shares = math.sqrt(2 / math.pi) * x * np.exp(-0.5 * x * x) * math.log(widths[1] / widths[0])
        sharp = np.array([[math.erfc(s / widths[0] / math.sqrt(2))] for s in sigmas])
        exponential: Array = sharp + shares @ transfers
        return exponential
    # wider than 4 px, sampling no longer shows
    transfer: Array = np.exp(-2 * (np.pi * sigmas[:, None]) ** 2 * (f**2).sum(0))
    narrow = sigmas <= 4
    weights = np.exp(-0.5 * (np.arange(1, 33) / np.maximum(sampled_parameter(sigmas[narrow]), 0.01)[:, None]) ** 2)
    axes = (1 + 2 * weights @ _cosines(longest)) / (1 + 2 * weights.sum(1, keepdims=True))
    transfer[narrow] = axes[0] * axes[1]
    return transfer


def plan_blur(
    sigma_min: float, sigma_max: float, tolerance: float = 0.002, shape: Shape = "gaussian", longest: float = 512.0
) -> BlurPlan:
    """Choose the fewest blurs that serve all widths in a range.

    The widths lie between equal steps of v and Chebyshev nodes (¼ : ¾), within 1 dB of the best that a search found.

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
    if not 0 < tolerance < 1:
        raise ValueError(f"tolerance must lie in (0, 1) (image scale 0…1), got {tolerance}")
    if shape not in get_args(Shape):
        raise ValueError(f"shape must be one of {get_args(Shape)}, got {shape!r}")
    if not 1 <= longest < math.inf:
        raise ValueError(f"longest must be a finite number of px ≥ 1, got {longest}")
    # in octaves, so that sizes share plans; the fine detail of a tiny picture would ask too much of narrow blurs
    octave = max(2.0 ** math.ceil(math.log2(longest)), 256.0) if shape == "exponential" else 512.0
    return _plan_blur(float(sigma_min), float(sigma_max), float(tolerance), shape, octave)


@lru_cache(maxsize=1024)
def _plan_blur(sigma_min: float, sigma_max: float, tolerance: float, shape: Shape, longest: float) -> BlurPlan:
    _, amplitude = _frequencies(longest)
    target = 0.48 * tolerance
    start, end = _v(sigma_min, shape), _v(sigma_max, shape)
    constant = end - start < 1e-6
    # denser towards the ends of the range, where the fit is worst
    grid = np.zeros(1) if constant else -np.cos(np.linspace(0, np.pi, 33))
    v = end + 0.5 * (end - start) * (grid if constant else grid - 1)
    wanted = _transfer(np.array([_sigma(x, shape) for x in v]), shape, longest) * amplitude
    if np.sqrt(((wanted - amplitude) ** 2).sum(1)).max() <= target:
        return NO_BLUR
    first, last, narrowest = sigma_min, sigma_max, min(0.6, 0.7 * sigma_max)
    if shape == "exponential":  # it mixes Gaussians of σ/|N(0, 1)|: beyond x·σ lies .8/x of the light
        first, last, narrowest = 0.5 * sigma_min, min(0.4 / target * sigma_max, _WIDEST * longest), 0.3
    identity = (0.0,) if first < 0.75 else ()
    low, high = _v(max(first, narrowest)), _v(max(last, narrowest))
    decibel = -20 * math.log10(target)
    # what a blur of the stack may itself be off by, through its grid and where its kernel is cut; as the strength of a
    # ridge it also keeps the weights of blurs that hardly differ from growing against each other
    noise = target / 3
    density = min(max(1.1 + (decibel - 60) / 40, 1.0), 3.0)  # grid samples per σ: 70 dB at 1.1, 84 at 1.5
    chebyshev = np.polynomial.chebyshev.chebvander
    for k in range(1, _MOST_NODES + 1):
        steps = (np.arange(k) + 0.5) / k
        steps = (0.3 * steps + 0.35 * (1 - np.cos(np.pi * steps))) ** 1.1
        sigmas = (*identity, *(_sigma(low + (high - low) * s) for s in steps))
        basis = _transfer(np.array(sigmas), "gaussian", longest) * amplitude
        # W_last = 1 − ΣW: fit the others to differences, first over f, then along v
        change = np.concatenate([np.eye(len(sigmas) - 1), -np.ones((1, len(sigmas) - 1))])  # W = e_last + change @ free
        system = np.concatenate([basis.T @ change, noise * change])
        alone = np.zeros((len(sigmas), len(v)))
        alone[-1] = 1
        sides = np.concatenate([(wanted - basis[-1]).T, -noise * alone])
        free = np.linalg.lstsq(system, sides, rcond=1e-12)[0]
        degree = 0 if constant or len(sigmas) == 1 else len(sigmas) + len(identity)
        powers = chebyshev(grid, degree)
        fitted = np.linalg.lstsq(powers, free.T, rcond=None)[0].T
        residual = system @ (fitted @ powers.T) - sides
        error = float(np.sqrt((residual**2).sum(0).mean()))
        # sharp tails of an exponential shape may stay short of half the tolerance, but not of all of it
        if error <= target or (k == _MOST_NODES and error <= 0.6 * tolerance):
            break
    else:
        raise ValueError(f"tolerance {tolerance} needs more than {_MOST_NODES} blurs for σ {sigma_min}…{sigma_max} px")
    last_row = -fitted.sum(0)
    last_row[0] += 1
    return BlurPlan(
        sigma_min=sigma_min,
        sigma_max=sigma_max,
        sigmas=sigmas,
        cells=tuple(_cell(s / density) for s in sigmas),
        coefficients=tuple(tuple(float(c) for c in row) for row in (*fitted, last_row)),
        reach=min(max(3 + (decibel - 60) / 24, 2.5), 8.0),
        error=error,
        shape=shape,
    )


def _cell(widest: float) -> float:
    """The pitch of a grid, px, at most `widest`, so that a period holds whole cells or a cell whole periods."""
    if widest < 2:
        return 1.0
    return PERIOD / math.ceil(PERIOD / widest) if widest < PERIOD else float(PERIOD * (widest // PERIOD))


def node_weights(variance: Tensor, plan: BlurPlan) -> Tensor:
    """Weights of a plan's blurs at every pixel.

    Args:
        variance (Bx1xHxW tensor): σ² in px², finite, ≥ 0.
        plan: from `plan_blur`.

    Returns:
        (BxKxHxW) weights that sum to 1 over K.
    """
    degree = len(plan.coefficients[0]) - 1
    if degree == 0:
        return variance.new_tensor(plan.coefficients)[:, :, None].expand(len(variance), -1, *variance.shape[-2:])
    low, high = ends(plan)
    slope = (2 if plan.shape == "exponential" else 1) / (high - low)
    offset = slope * math.log(_V_FLOOR) - (low + high) / (high - low)
    # v = log ½ + log1p(2σ), and 2v = log ½ + log1p(2σ²); the root's slope stays finite
    x = variance.clamp(min=1e-12).sqrt() if plan.shape == "exponential" else variance
    x = torch.log1p(x * (1 / _V_FLOOR)).mul_(slope).add_(offset).clamp(-1, 1)
    b, _, h, w = x.shape
    terms = [x]
    if degree > 1:
        terms.append(torch.addcmul(x.new_tensor(-1.0), x, x, value=2))
    for _ in range(degree - 2):
        terms.append(torch.mul(terms[-1], x).mul_(2).sub_(terms[-2]))  # Chebyshev
    coefficients = x.new_tensor(plan.coefficients).expand(b, -1, -1)
    powers = torch.cat(terms, 1).reshape(b, degree, h * w)
    return torch.baddbmm(coefficients[..., :1], coefficients[..., 1:], powers).reshape(b, -1, h, w)


@torch.library.custom_op("uwaug::node_blur", mutates_args=())
def _node_blur(x: Tensor, sigma: float, cell: float, reach: float, adjoint: bool) -> Tensor:
    """One blur of a stack on x (H, N, W), or its adjoint: an operator of its own, which torch.compile keeps whole."""
    chain = _chain(sigma, cell, reach, x.shape[0], x.shape[2], x.dtype, x.device)
    x = x.contiguous()
    if adjoint:
        return _products(x, [(axis, transpose) for axis, _, transpose in reversed(chain)])
    return _products(x, [(axis, matrix) for axis, matrix, _ in chain])


@_node_blur.register_fake
def _(x: Tensor, sigma: float, cell: float, reach: float, adjoint: bool) -> Tensor:
    return torch.empty_like(x, memory_format=torch.contiguous_format)


def _remember(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    ctx.arguments = inputs[1:]


def _node_blur_backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
    *arguments, adjoint = ctx.arguments
    return _node_blur(gradient, *arguments, not adjoint), None, None, None, None


_node_blur.register_autograd(_node_blur_backward, setup_context=_remember)


def _products(x: Tensor, chain: Iterable[tuple[int, Banded]]) -> Tensor:
    for axis, matrix in chain:
        h, n, w = x.shape
        if axis == 0:
            x = along_rows(matrix, x.reshape(h, n * w)).reshape(-1, n, w)
        else:
            x = along_columns(matrix, x.reshape(h * n, w)).reshape(h, n, -1)
    return x


def _chain(
    sigma: float, cell: float, reach: float, height: int, width: int, dtype: torch.dtype, device: torch.device
) -> Chain:
    """Products of one blur of a stack, in the order that needs the fewest operations."""
    rows = operators(0, height, sigma, cell, reach, dtype, device)
    columns = operators(1, width, sigma, cell, reach, dtype, device)
    if cell == 1:
        return ((0, *rows[0]), (1, *columns[0]))
    return ((0, *rows[0]), (1, *columns[0]), (1, *columns[1]), (0, *rows[1]))


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
    chains = [
        _chain(sigma, cell, plan.reach, h, w, x.dtype, x.device) if sigma > 0 else ()
        for sigma, cell in zip(plan.sigmas, plan.cells)
    ]
    # all that cannot be had a few rows at a time is small: on the coarse grids, rows are few
    sources = [
        _products(x, [(axis, matrix) for axis, matrix, _ in chain[:-1]]) if len(chain) > 2 else x for chain in chains
    ]
    for rows in row_strips(c, h, w):
        strips = []
        for chain, source in zip(chains, sources):
            strip = source[rows]
            if chain:
                along = chain[-1] if len(chain) > 2 else chain[0]
                strip = along_rows(along[1], source.reshape(len(source), -1), rows.start, rows.stop).reshape(-1, c, w)
            if len(chain) == 2:
                strip = _products(strip, [chain[1][:2]])
            strips.append(strip.transpose(0, 1)[None])
        yield rows, strips


def blurred(image: Tensor, plan: BlurPlan) -> list[Tensor]:
    """The plan's blurs of a batch: K tensors like `image` (BxCxHxW), differentiable."""
    b, c, h, w = image.shape
    x = image.permute(2, 0, 1, 3).reshape(h, b * c, w)
    return [
        (_node_blur(x, sigma, cell, plan.reach, False) if sigma > 0 else x).reshape(h, b, c, w).permute(1, 2, 0, 3)
        for sigma, cell in zip(plan.sigmas, plan.cells)
    ]


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
        if not isinstance(value, Tensor) or not value.is_floating_point():
            got = value.dtype if isinstance(value, Tensor) else type(value).__name__
            raise TypeError(f"{name} must be a floating-point tensor, got {got}")
        if value.ndim != 4 or channels not in (None, value.shape[1]):
            raise ValueError(f"{name} must have shape (B, {channels or 'C'}, H, W), got {tuple(value.shape)}")
    if sigma.shape[-2:] != image.shape[-2:] or (len(sigma) != len(image) and 1 not in (len(sigma), len(image))):
        raise ValueError(f"image is {tuple(image.shape)} but sigma is {tuple(sigma.shape)}: sizes must agree")
    if image.numel() == 0 or sigma.numel() == 0:
        return image.clone() if len(sigma) else image[:0].clone()
    compiling = torch.compiler.is_compiling()
    if not compiling and not (bool((sigma.detach() >= 0).all()) and bool(sigma.detach().isfinite().all())):
        raise ValueError("sigma must be finite and ≥ 0 px everywhere; it holds a negative, infinite or NaN value")
    dtype = torch.promote_types(torch.promote_types(image.dtype, sigma.dtype), torch.float32)
    with torch.autocast(image.device.type, enabled=False):
        widths = sigma.to(dtype)
        if plan is None:
            plan = plan_blur(float(widths.detach().min()), float(widths.detach().max()), tolerance)
        return weighted_sum(node_weights(widths**2, plan), blurred(image.to(dtype), plan)).to(image.dtype)


def weighted_sum(weights: Tensor, images: list[Tensor]) -> Tensor:
    """Σ_k weights[:, k]·images[k], for weights (BxKxHxW) and K images (BxCxHxW)."""
    shares = torch.split(weights, 1, 1)  # gradients of slices would each fill all K with zeros
    total = shares[0] * images[0]
    for share, image in zip(shares[1:], images[1:]):
        total.addcmul_(share, image)
    return total


def blur_exact(image: Tensor, sigma: Tensor, at: Tensor | None = None) -> Tensor:
    """The reference: each pixel from its own sampled, normalised Gaussian, in float64. Slow: no stack, no grids, cut at
    8σ.

    Args:
        image (CxHxW tensor): any float type.
        sigma (HxW tensor): widths, px, ≥ 0.
        at (P int64 tensor): flat indices of the pixels wanted; all by default.

    Returns:
        (CxP) float64 tensor.
    """
    c, h, w = image.shape
    at = torch.arange(h * w) if at is None else at
    image, flat = image.double(), sigma.double().flatten()
    out = image.new_empty(c, len(at))
    order = flat[at].argsort()  # neighbours in width share the reach of their kernels
    for chunk in torch.split(order, 2048):
        pixels = at[chunk]
        rows = gaussian_rows(pixels // w, flat[pixels], h)
        columns = gaussian_rows(pixels % w, flat[pixels], w)
        for channel in range(c):
            out[channel, chunk] = ((rows @ image[channel]) * columns).sum(1)
    return out
