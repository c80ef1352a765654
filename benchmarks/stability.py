"""Where methods fail: each method under each hard condition, its value and its gradient against float64.

`python -m benchmarks.stability` prints the matrix, draws it and writes results/stability.json.

A method is the whole model with one part done the usual way: the mean attenuation −ln T/z, 1 − exp for the veil,
    e^(+βz) as the paper
prints it, hard bins, tent weights between bins, reflect padding, sampled kernels. "right" is within the tolerance of
the model (.002, or the rounding of the number format), or an error that names its argument where there is no right
value. Gradients are those of a random weighting of the picture with respect to image, distance, rates, veil and width,
along one direction, against a difference quotient of the exact model.
"""

import argparse
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import kornia
import numpy as np
import torch
from torch import Tensor

import uwaug
from benchmarks.baselines import published
from benchmarks.harness import save
from uwaug.banded import gaussian_rows

BINS = 30
TOLERANCE = 0.002


@dataclass(frozen=True)
class Case:
    """One scene: image (B, 3, H, W), distance (B, 1, H, W), coefficients per channel (3), width σ = scale·z in px."""

    image: Tensor
    distance: Tensor
    beta: Tensor
    G: Tensor
    veil: Tensor
    scale: Tensor
    dtype: torch.dtype = torch.float32
    autocast: bool = False
    impossible: bool = False  # there is no right value: an error is

    def to(self, dtype: torch.dtype) -> "Case":
        """All tensors in `dtype`."""
        return replace(self, **{n: getattr(self, n).to(dtype) for n in _LEAVES})


_LEAVES = ("image", "distance", "beta", "G", "veil", "scale")


def _case(**changes: Any) -> Case:
    rng = torch.Generator().manual_seed(0)
    size = changes.pop("size", (16, 16))
    usual: dict[str, Any] = {
        "image": torch.rand(1, 3, *size, generator=rng, dtype=torch.float64),
        "distance": 1 + 4 * torch.rand(1, 1, *size, generator=rng, dtype=torch.float64),
        "beta": torch.tensor([0.6, 0.5, 0.7], dtype=torch.float64),
        "G": torch.tensor([0.2, 0.15, 0.3], dtype=torch.float64),
        "veil": torch.tensor([0.3, 0.4, 0.5], dtype=torch.float64),
        "scale": torch.tensor(0.5, dtype=torch.float64),
    }
    return Case(**{**usual, **changes})


def conditions() -> dict[str, Case]:
    """Every condition, by name."""
    usual = _case()
    z, three = usual.distance, torch.ones(3, dtype=torch.float64)
    half = torch.arange(16).expand(1, 1, 16, 16) < 8
    far = torch.where(half, torch.tensor(1.0, dtype=torch.float64), torch.tensor(5.0, dtype=torch.float64))
    extremes = (usual.image > 0.5).double()
    return {
        "usual": usual,
        "z = 0": replace(usual, distance=torch.where(half, torch.zeros_like(z), z)),
        "z = 1 µm, J = 0": replace(usual, image=0 * usual.image, distance=torch.full_like(z, 1e-6)),
        "z = +inf": replace(usual, distance=torch.where(half, torch.full_like(z, math.inf), z)),
        "z NaN": replace(usual, distance=torch.where(half, torch.full_like(z, math.nan), z), impossible=True),
        "z < 0": replace(usual, distance=torch.where(half, -z, z), impossible=True),
        "constant z": replace(usual, distance=torch.full_like(z, 3.0)),
        "far plane": replace(usual, distance=far),
        "step of 50 m": replace(usual, distance=torch.where(half, z, z + 50)),
        "β = 0": replace(usual, beta=0 * three, G=0 * three),
        "G = 0": replace(usual, G=0 * three),
        "g = 1": replace(usual, G=usual.beta.clone()),
        "μ = 0": replace(usual, veil=0 * three),
        "depth 1e4": replace(usual, beta=1e4 * three, G=1e3 * three),
        "σ = 0": replace(usual, scale=torch.tensor(0.0, dtype=torch.float64)),
        "σ = 0.05 px": replace(usual, scale=torch.tensor(0.02, dtype=torch.float64)),
        "σ ≫ image": replace(usual, scale=torch.tensor(200.0, dtype=torch.float64)),
        "1×1": _case(size=(1, 1)),
        "1×9": _case(size=(1, 9)),
        "7×5": _case(size=(7, 5)),
        "J = 0 and 1": replace(usual, image=extremes),
        "J > 1, J < 0": replace(usual, image=30 * usual.image - 5),
        "batch 0": replace(usual, image=usual.image[:0], distance=z[:0]),
        "batch of 3": replace(usual, image=usual.image.repeat(3, 1, 1, 1), distance=torch.cat([z, z / 2, z / 4])),
        "channels last": replace(usual, image=usual.image.to(memory_format=torch.channels_last)),
        "float64": replace(usual, dtype=torch.float64),
        "float16": replace(usual, dtype=torch.float16),
        "bfloat16": replace(usual, dtype=torch.bfloat16),
        "autocast": replace(usual, autocast=True),
    }


def exact(case: Case) -> Tensor:
    """The model in float64: exponentials of each pixel, and each pixel's own Gaussian."""
    z = case.distance.clamp(max=1e9)
    rate = lambda v: v.view(1, 3, 1, 1)  # noqa: E731
    direct = torch.exp(-rate(case.beta) * z)
    share = torch.exp(-rate(case.G) * z) - direct
    b, _, h, w = z.shape
    blurred = torch.empty(b, 3, h, w, dtype=torch.float64)
    index = torch.arange(h * w, dtype=torch.float64)
    for i in range(b):
        sigma = (case.scale * z[i].flatten()).clamp(max=50.0 * (h + w))
        rows, columns = gaussian_rows(index // w, sigma, h), gaussian_rows(index % w, sigma, w)
        for c in range(3):
            blurred[i, c] = ((rows @ case.image[i, c]) * columns).sum(1).view(h, w)
    return direct * case.image + share * blurred - rate(case.veil) * torch.expm1(-rate(case.G) * z)


def ours(case: Case) -> Tensor:
    """Uwaug as it comes."""
    law = uwaug.PointSpread(case.scale)
    medium = uwaug.Medium.from_coefficients(case.beta, case.G, case.veil, b_mean=1.0, point_spread=law)
    return uwaug.form_image(case.image, case.distance, medium).image


def _usual(
    case: Case,
    blur: Callable[[Tensor, Tensor], Tensor] | None = None,
    transmission: Callable[[Tensor, Tensor], Tensor] = lambda rate, z: torch.exp(-rate * z),
    veil: Callable[[Tensor, Tensor], Tensor] = lambda rate, z: -torch.expm1(-rate * z),
    printed: bool = False,
) -> Tensor:
    z, rate = case.distance, lambda v: v.view(1, 3, 1, 1)
    direct = transmission(rate(case.beta), z)
    share = transmission(rate(case.G), z) - (torch.exp(rate(case.beta) * z) if printed else direct)
    scattered = (blur or _stack)(case.image, case.scale * z)
    return direct * case.image + share * scattered + rate(case.veil) * veil(rate(case.G), z)


def _stack(image: Tensor, sigma: Tensor) -> Tensor:
    return uwaug.varying_blur(image, sigma.clamp(max=1e4))


def _levels(sigma: Tensor) -> Tensor:
    return torch.linspace(0, 1, BINS + 1, dtype=sigma.dtype) * sigma.max()


def _at(image: Tensor, sigma: Tensor, border: str = "replicate") -> Tensor:
    size = 2 * max(1, math.ceil(3 * float(sigma.detach()))) + 1
    widths = sigma.reshape(1, 1).expand(1, 2)
    return kornia.filters.gaussian_blur2d(image, (size, size), widths.to(image.dtype), border)  # type: ignore[no-any-return]


def _hard_bins(image: Tensor, sigma: Tensor, border: str = "replicate") -> Tensor:
    edges, out = _levels(sigma), torch.zeros_like(image)
    for low, high in pairwise(edges):
        inside = (sigma >= low) & (sigma < high)
        out = out + _at(image, (low + high) / 2, border) * inside
    return out


def _tent(image: Tensor, sigma: Tensor) -> Tensor:
    levels = _levels(sigma)
    step, out = levels[1] - levels[0], torch.zeros_like(image)
    for level in levels:
        weight = torch.relu(1 - (sigma - level).abs() / step)
        out = out + weight * (image if float(level.detach()) == 0 else _at(image, level))
    return out


METHODS: dict[str, Callable[[Case], Tensor]] = {
    "−ln T / z": lambda c: _usual(c, transmission=lambda r, z: torch.exp(-(-torch.log(torch.exp(-r * z)) / z) * z)),
    "1 − exp": lambda c: _usual(c, veil=lambda r, z: 1 - torch.exp(-r * z)),
    "e^(+βz)": lambda c: _usual(c, printed=True),
    "hard bins": lambda c: _usual(c, _hard_bins),
    "tent weights": lambda c: _usual(c, _tent),
    "reflect padding": lambda c: _usual(c, lambda j, s: _hard_bins(j, s, "reflect")),
    "published": lambda case: _published(case),  # noqa: PLW0108 - defined below
    "uwaug": ours,
}


def _published(case: Case) -> Tensor:
    """The recipe takes float32 arrays: there are no gradients, batches or other formats."""
    out = []
    eye = np.eye(3, dtype=np.float32)
    beta, G, veil = (v.detach().float().numpy() for v in (case.beta, case.G, case.veil))
    for image, z in zip(case.image.detach().float(), case.distance.detach().float()):
        ones = np.ones(z.shape[1:], np.float32)
        picture = np.ascontiguousarray(image.permute(1, 2, 0).numpy())
        result = published(
            picture, z[0].numpy(), ones, response=eye, beta=beta, G=G, light=np.ones(3, np.float32),
            light_rgb=np.ones(3, np.float32), veil=veil, phi=float(case.scale),
        )  # fmt: skip
        out.append(torch.from_numpy(result).permute(2, 0, 1))
    return torch.stack(out) if out else torch.zeros(0, 3, *case.image.shape[-2:])


def _rounding(dtype: torch.dtype, reference: Tensor) -> float:
    peak = max(1.0, float(reference.abs().max())) if reference.numel() else 1.0
    return peak * {torch.float16: 2e-3, torch.bfloat16: 1.6e-2}.get(dtype, 1e-5)


def judge(method: Callable[[Case], Tensor], case: Case) -> dict[str, str]:
    """Verdict on value and gradient: "right", "off by …", "NaN", or the name of the exception."""
    inputs = replace(case.to(case.dtype), image=case.image.to(case.dtype))
    leaves = {name: getattr(inputs, name).clone().requires_grad_() for name in _LEAVES}
    weights = torch.rand(case.image.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    try:
        with torch.autocast("cpu", enabled=case.autocast):
            out = method(replace(inputs, **leaves))
    except Exception as error:
        named = isinstance(error, (ValueError, TypeError)) and "distance" in str(error)
        verdict = "right" if case.impossible and named else type(error).__name__
        return {"value": verdict, "gradient": verdict}
    if case.impossible:
        return {"value": "no error", "gradient": "no error"}
    reference = exact(case)
    return {"value": _value(out, reference, case), "gradient": _gradient(out, leaves, weights, case)}


def _value(out: Tensor, reference: Tensor, case: Case) -> str:
    if out.shape != reference.shape:
        return "wrong shape"
    if not reference.numel():
        return "right"
    difference = out.detach().double() - reference
    if not bool(difference.isfinite().all()):
        return "NaN"
    peak = max(1.0, float(case.image.abs().max()))
    error = float(difference.square().mean().sqrt())
    small = float(reference.abs().max())
    relative = error / small if small < 1e-3 else 0.0  # a faint veil must be right to its own scale, too
    if error <= TOLERANCE * peak + _rounding(case.dtype, reference) and relative <= 0.02:
        return "right"
    return f"off by {max(error, relative):.2g}"


def _gradient(out: Tensor, leaves: dict[str, Tensor], weights: Tensor, case: Case) -> str:
    if not out.requires_grad:
        return "none"
    if not out.numel():
        return "right"
    grads = torch.autograd.grad((out.double() * weights).sum(), list(leaves.values()), allow_unused=True)
    given = {n: torch.zeros_like(v) if g is None else g for (n, v), g in zip(leaves.items(), grads)}
    if not all(bool(g.isfinite().all()) for g in given.values()):
        return "NaN"
    rng = torch.Generator().manual_seed(2)
    worst = 0.0
    for name in _LEAVES:
        value = getattr(case, name)
        direction = (
            torch.rand(value.shape, generator=rng, dtype=torch.float64) * value.isfinite()
        )  # inwards where z = 0
        step = 1e-6
        ahead = replace(case, **{name: torch.where(value.isfinite(), value + step * direction, value)})
        slope = float(((exact(ahead) - exact(case)) * weights).sum()) / step
        found = float((given[name].double() * direction).sum())
        peak = max(1.0, float(case.image.abs().max()))
        scale = max(abs(slope), 0.02 * peak * weights.numel() * (1 if name in ("image", "veil") else 0.1))
        worst = max(worst, abs(found - slope) / scale)
    rounding = {torch.float16: 0.05, torch.bfloat16: 0.2}.get(case.dtype, 0.0)
    return "right" if worst <= 0.1 + rounding else f"off by {worst:.2g}"


def matrix(names: list[str] | None = None) -> dict[str, dict[str, dict[str, str]]]:
    """{condition: {method: verdicts}}."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        np.seterr(all="ignore")
        return {
            condition: {name: judge(method, case) for name, method in METHODS.items()}
            for condition, case in conditions().items()
            if names is None or condition in names
        }


def _draw(result: dict[str, dict[str, dict[str, str]]]) -> Path:
    """The matrix as a picture: value in the upper, gradient in the lower triangle of each cell."""
    from matplotlib.figure import Figure

    colours = {"right": "#3a9d5d", "off": "#e9b44c", "none": "#d9d9d9"}
    rows, columns = list(result), list(METHODS)
    figure = Figure(figsize=(9, 0.27 * len(rows) + 1.5), layout="constrained")
    axes = figure.add_subplot()
    for y, condition in enumerate(rows):
        for x, method in enumerate(columns):
            verdicts = result[condition][method]
            for key, corner in (
                ("value", [(x, y), (x + 1, y), (x, y + 1)]),
                ("gradient", [(x + 1, y), (x + 1, y + 1), (x, y + 1)]),
            ):
                colour = colours.get(verdicts[key].split()[0], "#c8413b")
                axes.fill(*zip(*corner), color=colour, edgecolor="white", linewidth=0.8)
    axes.set(xlim=(0, len(columns)), ylim=(len(rows), 0))
    axes.set_xticks([i + 0.5 for i in range(len(columns))], columns)
    axes.set_yticks([i + 0.5 for i in range(len(rows))], rows)
    axes.xaxis.tick_top()
    axes.tick_params(length=0, labelsize=8)
    for side in axes.spines.values():
        side.set_visible(False)
    axes.set_xlabel(
        "upper left: value, lower right: gradient; green right, yellow wrong, red NaN, exception or silence, grey none",
        fontsize=8,
    )
    path = Path(__file__).parent / "figures" / "stability.svg"
    figure.savefig(path, metadata={"Date": None})
    return path


def main(quick: bool = False) -> None:
    """Print, draw and save the matrix."""
    result = matrix()
    for condition, row in result.items():
        print(f"{condition:14}" + " ".join(f"{m}: {v['value']} / {v['gradient']};" for m, v in row.items()))
    mine = [(c, row["uwaug"]) for c, row in result.items() if set(row["uwaug"].values()) != {"right"}]
    print(f"uwaug: {len(result) - len(mine)} of {len(result)} conditions right in value and gradient {mine}")
    if not quick:
        print(_draw(result))
        print(save("stability", {"matrix": result}))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="print only")
    main(parser.parse_args().quick)
