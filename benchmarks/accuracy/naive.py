"""The model with one part done the usual way, for `stability`, and the published recipe.

All other parts of a method are done with care, so that a column of the matrix shows what that one
part does: open water is 1e9 m away (but for bins and tents, whose range ends at the farthest pixel
that is not), the veil is −expm1, widths have a floor, blurs come from a planned stack, edges are
mirrored.
"""

import math
from collections.abc import Callable

import kornia
import numpy as np
import torch
import torch.nn.functional as F
from referees.conditions import FARTHEST, Case, Method, spread
from referees.reference import matched
from torch import Tensor

from benchmarks import recipe
from uwaug.blur.plan import plan_blur
from uwaug.blur.stack import mixed, node_weights

Gaussian = Callable[[Tensor, float], Tensor]


class NotApplicableError(Exception):
    """The method has no such thing."""


def _model(
    case: Case,
    *,
    blur: Callable[[Tensor, Tensor, Tensor], Tensor] | None = None,
    mean_attenuation: bool = False,
    printed_sign: bool = False,
    plain_veil: bool = False,
    plain_powers: bool = False,
) -> Tensor:
    if case.colours is not None:
        raise NotApplicableError
    raw, farthest = case.distance, min(FARTHEST, torch.finfo(case.distance.dtype).max)
    z = (raw if mean_attenuation else raw.clamp(max=farthest)) * case.field
    least = 0.0 if plain_veil else 1e-6
    beta, G, veil, light, b_mean = map(spread, _coefficients(case, least))
    image = case.image
    if case.srgb:
        image = _decode(image) if plain_powers else kornia.color.rgb_to_linear_rgb(image)

    def transmission(rate: Tensor) -> Tensor:
        if mean_attenuation:
            return torch.exp(-(-torch.log(torch.exp(-rate * raw)) / raw) * z)
        return torch.exp(-rate * z)

    direct, signal = transmission(beta), transmission(G)
    share = signal - (torch.exp(beta * z) if printed_sign else direct)
    length = b_mean * (z if plain_powers else z.clamp(min=1e-6))
    # bins know no farthest distance: z = +∞ is an infinite width
    length = torch.where(raw.isinf(), raw, length) if blur in (_hard_bins, _tent) else length
    sigma = spread(case.scale) * length ** spread(case.exponent)
    shown = (light * signal.detach() > 1e-4).any(1, keepdim=True)
    scattered = (blur or _stack)(image, sigma, shown)
    risen = 1 - torch.exp(-G * z) if plain_veil else -torch.expm1(-G * z)
    total = light * direct * image + light * share * scattered + veil * risen
    if case.srgb:
        total = _encode(total) if plain_powers else kornia.color.linear_rgb_to_rgb(total)
    return total


def _coefficients(case: Case, least: float) -> tuple[Tensor, ...]:
    """β, G, B∞ = μ·b·E/G, E and the mean of b, from spectra if the case has them."""
    if case.spectra is None:
        return case.beta, case.G, case.veil, case.light, case.b_mean
    a, b, kd = (torch.tensor(v, dtype=case.image.dtype) for v in case.spectra[:3])
    light, G = torch.exp(-kd * case.spectra.depth), (a + case.spectra.g * b).clamp(min=least)
    return a + b, G, case.spectra.mu * b * light / G, light, b.mean()


def _decode(x: Tensor) -> Tensor:
    return torch.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def _encode(x: Tensor) -> Tensor:
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def _gaussian(
    image: Tensor,
    sigma: float,
    border: str = "symmetric",
    radius: int | None = None,
    corrected: bool = True,
) -> Tensor:
    """One blur, separable; `corrected`: of the width `sigma`, not merely with that parameter."""
    if border == "symmetric":
        sigma = min(sigma, 4.0 * max(image.shape[-2:]))  # wider ones give the mean
    radius = max(1, math.ceil(4 * sigma)) if radius is None else radius
    parameter = max(float(matched(np.array([sigma]))[0]), 1e-3) if corrected else sigma
    taps = torch.exp(-0.5 * (torch.arange(-radius, radius + 1) / torch.tensor(parameter)) ** 2)
    kernel = (taps / taps.sum()).to(image.dtype)
    for _ in range(2):  # along rows, transposed, twice
        b, c, h, w = image.shape
        if border == "symmetric":
            index = torch.arange(-radius, w + radius) % (2 * w)
            padded = image[..., torch.minimum(index, 2 * w - 1 - index)]
        else:
            padded = F.pad(image, (radius, radius, 0, 0), mode=border)
        lines = F.conv1d(padded.reshape(b * c * h, 1, -1), kernel.view(1, 1, -1))
        image = lines.reshape(b, c, h, w).mT
    return image


def _stack(image: Tensor, sigma: Tensor, shown: Tensor, gaussian: Gaussian = _gaussian) -> Tensor:
    """As uwaug does it, but the blurs themselves; planned for the widths of pixels whose light
    arrives.
    """
    if not image.numel():
        return image
    sigma = sigma.float().abs().nan_to_num(0.0).clamp(max=1e6)
    widths = sigma.detach()[shown].clamp(max=8.0 * max(image.shape[-2:]))
    low, high = (float(v) for v in widths.aminmax()) if widths.numel() else (1.0, 1.0)
    plan = plan_blur(0.9 * low, 1.1 * high, 0.0005)
    blurs = [gaussian(image, s) if s > 0 else image for s in plan.sigmas]
    return mixed(blurs, node_weights(sigma, plan).to(image.dtype))


def _hard_bins(image: Tensor, sigma: Tensor, shown: Tensor) -> Tensor:
    edges, out = (
        torch.linspace(0, float(sigma.max()), recipe.BINS + 1).tolist(),
        torch.zeros_like(image),
    )
    for k in range(recipe.BINS):
        inside = sigma >= edges[k]
        if k < recipe.BINS - 1:
            inside &= sigma < edges[k + 1]
        out = out + _gaussian(image, (edges[k] + edges[k + 1]) / 2) * inside
    return out


def _tent(image: Tensor, sigma: Tensor, shown: Tensor) -> Tensor:
    """Linear in σ between the edges of the bins."""
    step, out = max(float(sigma.max()) / recipe.BINS, 1e-9), torch.zeros_like(image)
    lower = (sigma.detach() / step).floor().clamp(max=recipe.BINS - 1)
    part = sigma / step - lower
    for k in range(recipe.BINS + 1):
        weight = (1 - part) * (lower == k) + part * (lower == k - 1)
        out = out + weight * (_gaussian(image, k * step) if k else image)
    return out


def _reflect(image: Tensor, sigma: Tensor, shown: Tensor) -> Tensor:
    return _stack(image, sigma, shown, lambda j, s: _gaussian(j, s, "reflect"))


def _sampled(image: Tensor, sigma: Tensor, shown: Tensor) -> Tensor:
    """Kernels of 15×15 samples, as published, whatever the width."""
    return _stack(image, sigma, shown, lambda j, s: _gaussian(j, s, radius=7, corrected=False))


def published(case: Case) -> Tensor:
    """The recipe takes one float32 picture at a time, as an array, and σ ∝ z: no gradients,
    formats, layouts.
    """
    small = case.image.dtype.itemsize < 4
    if case.colours is not None:
        raise NotApplicableError
    no_array = case.autocast or case.layout or case.repeat or case.alone or small
    if no_array or case.srgb or not len(case.image) or bool((case.exponent != 1).any()):
        raise NotApplicableError
    out = []
    for i, picture in enumerate(case.image):
        bands, (z, field) = _bands(case, i), (_array(v[i, 0]) for v in (case.distance, case.field))
        result = recipe.published(_array(picture.permute(1, 2, 0)), z, field, bands)
        out.append(torch.from_numpy(result).permute(2, 0, 1))
    return torch.stack(out)


def _bands(case: Case, i: int) -> recipe.Bands:
    """Three bands, each seen by one channel: those of picture `i`."""
    *rates, b_mean = _coefficients(case, 0.0)
    beta, G, veil, light = (_array(v[i] if v.ndim == 2 else v) for v in rates)
    scale = float(case.scale.reshape(-1)[i % case.scale.numel()])
    phi = scale * float(b_mean[i] if b_mean.ndim == 1 else b_mean)
    return recipe.Bands(beta, G, veil, light, np.eye(3, dtype=np.float32), phi)


def _array(x: Tensor) -> recipe.Array:
    return np.ascontiguousarray(x.detach().float().numpy())


METHODS: dict[str, Method] = {
    "−ln T/z": lambda c: _model(c, mean_attenuation=True),
    "1 − e^−Gz": lambda c: _model(c, plain_veil=True),
    "e^+βz": lambda c: _model(c, printed_sign=True),
    "bare x^p": lambda c: _model(c, plain_powers=True),
    "hard bins": lambda c: _model(c, blur=_hard_bins),
    "tent weights": lambda c: _model(c, blur=_tent),
    "reflect padding": lambda c: _model(c, blur=_reflect),
    "sampled kernels": lambda c: _model(c, blur=_sampled),
    "published": published,
}
