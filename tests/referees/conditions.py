"""The hard conditions for the stability matrix, and what is right in each: the model in float64,
pixel by pixel.

Nothing of the model comes from uwaug, so that nothing is measured against itself.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import cv2
import jerlov
import numpy as np
import torch
from torch import Tensor

from referees.reference import gaussian_rows, matched

FARTHEST = 1e9  # m: stands for z = +∞, at which every product with 0 would be NaN
WAVELENGTHS = (600.0, 550.0, 450.0)  # nm, of R, G, B, where a condition is given by spectra


class Spectra(NamedTuple):
    """Water as it is found in a table, one value for each of R, G and B; may hold NaN."""

    a: tuple[float, ...]
    b: tuple[float, ...]
    kd: tuple[float, ...]
    depth: float = 0.0
    g: float = 0.2
    mu: float = 0.3
    jerlov: str = ""  # the name of the water, if it has one


@dataclass(frozen=True)
class Case:
    """One condition. Tensors are in float64; rates, veil and light are (3) or (B, 3), the width
    law's () or (B).
    """

    image: Tensor
    distance: Tensor
    field: Tensor  # multiplies the distance
    beta: Tensor
    G: Tensor
    veil: Tensor  # at infinite distance
    light: Tensor
    b_mean: Tensor
    scale: Tensor  # σ = scale·(b_mean·z)^exponent, px
    exponent: Tensor
    source: Tensor | None = None  # μ·b·E = veil·G, where G may be 0
    # if the water is given so; `beta` to `b_mean` then hold what it should come to
    spectra: Spectra | None = None
    # 3x3: what raw channels see of the picture's colours, where surfaces have spectra
    colours: Tensor | None = None
    srgb: bool = False
    dtype: torch.dtype = torch.float32
    layout: Literal["", "channels last", "sliced"] = ""
    autocast: bool = False
    repeat: bool = False  # with deterministic algorithms, twice
    alone: bool = False  # every gradient in a run of its own
    error: str = ""  # there is no right value, but an error that has this word

    @property
    def leaves(self) -> tuple[str, ...]:
        """Inputs that have gradients: not those that are computed from spectra."""
        return LEAVES if self.spectra is None else OF_SPECTRA

    @property
    def peak(self) -> float:
        """Brightest value of the picture, at least 1."""
        return max(1.0, float(self.image.abs().max())) if self.image.numel() else 1.0

    @property
    def raw(self) -> "Case":
        """The same in raw channels, each of which depends on itself alone."""
        if self.colours is None:
            return self
        return replace(self, image=mixed(self.colours, self.image), colours=None)

    def to(self, dtype: torch.dtype) -> "Case":
        """All tensors in `dtype`."""
        return replace(self, **{n: getattr(self, n).to(dtype) for n in LEAVES})


Method = Callable[[Case], Tensor]
LEAVES = ("image", "distance", "field", "beta", "G", "veil", "light", "b_mean", "scale", "exponent")
OF_SPECTRA = ("image", "distance", "field", "scale", "exponent")


def spread(value: Tensor) -> Tensor:
    """A parameter in the shape that multiplies pictures: (3) → (1, 3, 1, 1), (B) → (B, 1, 1, 1),
    () → (1, 1, 1, 1).
    """
    return value.reshape(-1, 3 if value.shape[-1:] == (3,) else 1, 1, 1)


def mixed(matrix: Tensor, pictures: Tensor) -> Tensor:
    """A matrix (3x3) times the colours of pictures (Bx3xHxW)."""
    return torch.einsum("ij,bjhw->bihw", matrix.to(pictures), pictures)


def exact(case: Case, published: bool = False) -> Tensor:
    """The model: exponentials of each pixel, and each pixel's own Gaussian.

    As `published` it blurs light that is weighted already, and the veil's distance is smoothed.
    """
    if case.colours is not None:
        return mixed(torch.linalg.inv(case.colours), exact(case.raw, published))
    image, z = case.image, case.distance.clamp(max=FARTHEST) * case.field
    image = _decode(image) if case.srgb else image
    direct, signal = (torch.exp(-spread(rate) * z) for rate in (case.beta, case.G))
    share = spread(case.light) * (signal - direct)
    sigma = spread(case.scale) * (spread(case.b_mean) * z) ** spread(case.exponent)
    if published:
        blurred = own_gaussians(share * image, sigma)
        z = _smooth(case.distance) * case.field
    else:
        blurred = share * own_gaussians(image, sigma)
    source = case.veil * case.G if case.source is None else case.source
    depth = spread(case.G) * z
    # (1 − e^−x)/x, 1 at 0
    fraction = torch.where(depth > 0, -torch.expm1(-depth) / torch.where(depth > 0, depth, 1), 1)
    total = spread(case.light) * direct * image + blurred + spread(source) * z * fraction
    return _encode(total) if case.srgb else total


def _smooth(distance: Tensor) -> Tensor:
    planes = distance[:, 0].clamp(max=FARTHEST).numpy()
    smooth = [cv2.GaussianBlur(plane, (21, 21), 60) for plane in planes]
    return torch.from_numpy(np.stack(smooth))[:, None]


def own_gaussians(image: Tensor, sigma: Tensor) -> Tensor:
    """`image` (B, C, H, W) with every pixel blurred by a Gaussian of its own `sigma` (B, 1, H, W),
    edges mirrored.
    """
    h, w = image.shape[-2:]
    at = torch.arange(h * w)
    out = []
    for picture, widths in zip(image, sigma.expand(len(image), -1, -1, -1), strict=True):
        flat = widths.detach().flatten()
        parameters = matched(flat.numpy())
        rows, columns = (
            torch.from_numpy(gaussian_rows(centres.numpy(), parameters, size))
            for centres, size in ((at // w, h), (at % w, w))
        )
        blurred = torch.stack([((rows @ channel) * columns).sum(1) for channel in picture])
        out.append(blurred.reshape(-1, h, w))
    return torch.stack(out) if out else image


def _decode(x: Tensor) -> Tensor:
    return torch.where(x > 0.04045, ((x.clamp(min=0.04) + 0.055) / 1.055) ** 2.4, x / 12.92)


def _encode(x: Tensor) -> Tensor:
    return torch.where(x > 0.0031308, 1.055 * x.clamp(min=0.003) ** (1 / 2.4) - 0.055, 12.92 * x)


def _scene(height: int = 24, width: int = 24, batch: int = 1) -> dict[str, Tensor]:
    """A picture with details of all sizes, before a slanted ground with a box on it, 1…5 m."""
    rng = torch.Generator().manual_seed(0)
    image = torch.zeros(batch, 3, height, width, dtype=torch.float64)
    for cells in (2, 4, 8, 16):
        size = (min(cells, height), min(cells, width))
        grid = torch.rand(batch, 3, *size, generator=rng, dtype=torch.float64)
        image += 0.25 * torch.nn.functional.interpolate(grid, (height, width), mode="nearest")
    y, x = torch.linspace(0, 1, height)[:, None], torch.linspace(0, 1, width)
    on_box = (x - 0.5).abs() + (y - 0.6).abs() < 0.3
    z = torch.where(on_box, 1.5, 5 - 3 * y - x).double().expand(batch, 1, -1, -1)
    return {"image": image, "distance": z.clone(), "field": torch.ones_like(z)}


def _case(*size: int, **changes: Any) -> Case:
    usual: dict[str, Any] = {
        **_scene(*size),
        "beta": (0.6, 0.5, 0.7),
        "G": (0.2, 0.15, 0.3),
        "veil": (0.3, 0.4, 0.5),
        "light": (0.8, 0.9, 1.0),
        "b_mean": 1.0,
        "scale": 0.5,
        "exponent": 1.0,
    }
    given = {**usual, **changes}
    tensors = {n: torch.as_tensor(given[n], dtype=torch.float64) for n in LEAVES}
    return Case(**{**given, **tensors})


def _spectral(spectra: Spectra, repaired: Spectra | None = None, **changes: Any) -> Case:
    """A case whose water is given by spectra; `repaired` are those that it should be computed
    with.
    """
    right = repaired or spectra
    a, b, kd = (torch.tensor(v, dtype=torch.float64) for v in (right.a, right.b, right.kd))
    light, G = torch.exp(-kd * right.depth), a + right.g * b
    source = right.mu * b * light
    coefficients = {
        "beta": a + b,
        "G": G,
        "veil": source / G,
        "light": light,
        "source": source,
        "b_mean": b.mean(),
    }
    return _case(**coefficients, spectra=spectra, **changes)


def _jerlov_5c() -> tuple[Spectra, Spectra]:
    """Type 5C as the package `jerlov` has it, NaN at 600 nm, and with that cell from other
    tables.
    """

    def read(quantity: str, source: str = "solonenko2015") -> tuple[float, ...]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            spectrum = getattr(jerlov.water("5C", source=source), quantity)
            return tuple(map(float, spectrum(np.array(WAVELENGTHS))))

    a, b, kd = read("a"), read("b"), read("kd")
    raw = Spectra(a, b, kd, depth=1.0, jerlov="5C")
    a, kd = (read("a", "williamson2022")[0], *a[1:]), (read("kd", "jerlov1976")[0], *kd[1:])
    return raw, raw._replace(a=a, kd=kd)


def conditions() -> dict[str, dict[str, Case]]:
    """Every condition, by group and name."""
    usual = _case()
    z, zero, infinite = usual.distance, (0.0,) * 3, torch.full_like(usual.distance, math.inf)
    half = torch.arange(z.shape[-1]).expand_as(z) < z.shape[-1] // 2
    near = torch.where(z > 3, z, 0)
    extremes = (usual.image > 0.5).double()
    a, b, kd, nan = (0.3, 0.1, 0.2), (0.5, 0.5, 0.6), (0.35, 0.15, 0.25), math.nan
    two = {
        "beta": [[0.6, 0.5, 0.7], [2.0, 1.8, 2.2]],
        "G": [[0.2, 0.15, 0.3], [0.6, 0.5, 0.7]],
        "veil": [[0.3, 0.4, 0.5], [0.5, 0.0, 0.4]],
        "light": [[0.8, 0.9, 1.0], [0.2, 0.3, 0.2]],
        "b_mean": [1.0, 1.5],
        "scale": [0.5, 0.2],
        "exponent": [1.0, 0.6],
    }

    def where(inside: Any, **changes: Any) -> Case:
        given = torch.as_tensor(inside, dtype=z.dtype)
        return replace(usual, distance=torch.where(half, given, z), **changes)

    groups = {
        "distance": {
            "usual": usual,
            "z = 0": replace(usual, distance=0 * z),
            "z = 0 in part": where(0.0),
            "z = 1 µm, J = 0": replace(usual, image=0 * usual.image, distance=0 * z + 1e-6),
            "z = +∞": replace(usual, distance=infinite),
            "z = +∞ in part": where(math.inf),
            "z NaN in part": where(math.nan, error="distance"),
            "z < 0 in part": where(-z, error="distance"),
            "one z": replace(usual, distance=torch.full_like(z, 3.0)),
            "one far plane": where(6.0),
            "step of 50 m": where(z + 50),
        },
        "water": {
            "β = G = 0": _case(beta=zero, G=zero),
            "G = 0": _case(G=zero),
            "G = 0, z = +∞": _case(G=zero, distance=infinite),
            "a = b = 0 (B∞ = 0/0)": _spectral(Spectra(zero, zero, zero), scale=0.0),
            "a = g = 0 (B∞ = b/0)": _spectral(Spectra(zero, b, kd, 1.0, g=0.0)),
            "g = 1": _spectral(Spectra(a, b, kd, 1.0, g=1.0)),
            "g = 0": _spectral(Spectra(a, b, kd, 1.0, g=0.0)),
            "μ = 0": _spectral(Spectra(a, b, kd, 1.0, mu=0.0)),
            "optical depth 1e4": _case(beta=(1e4, 9e3, 8e3), G=(3e3, 2e3, 1e3)),
            "K_d·d = 500": _spectral(Spectra(a, b, (0.5,) * 3, 1000.0)),
            "table with NaN cells": _spectral(*_jerlov_5c()),
            "own spectra with NaN": _spectral(
                Spectra((nan, *a[1:]), b, kd), Spectra(a, b, kd), error="a must be finite"
            ),
        },
        "surfaces": {},
        "width": {
            "σ = 0": _case(scale=0.0),
            "σ = .05 px": _case(scale=0.02),
            "σ = .3 px": _case(scale=0.1),
            "σ ∝ √z at z = 0": _case(exponent=0.5, distance=near),
            "σ ≫ image": _case(scale=200.0),
        },
        "picture": {
            "1×1": _case(1, 1),
            "1×9": _case(1, 9),
            "7×5": _case(7, 5),
            "J = 0 and 1": replace(usual, image=extremes),
            "sRGB 0 and 1, z = 0": replace(usual, image=extremes, distance=near, srgb=True),
            "J > 1 and < 0": replace(usual, image=30 * usual.image - 5),
            "batch of 0": replace(usual, image=usual.image[:0], distance=z[:0], field=z[:0]),
            "batch of 2 media": _case(24, 24, 2, **two),
        },
        "computing": {
            "float64": replace(usual, dtype=torch.float64),
            "float16": replace(usual, dtype=torch.float16),
            "bfloat16": replace(usual, dtype=torch.bfloat16),
            "autocast": replace(usual, autocast=True),
            "channels last": replace(usual, layout="channels last"),
            "not contiguous": replace(usual, layout="sliced"),
            "deterministic, twice": replace(usual, repeat=True),
            "each gradient alone": replace(usual, alone=True),
        },
    }
    every = {name: case for group in groups.values() for name, case in group.items()}
    return {**groups, "surfaces": _coloured(every)}


def _coloured(plain: dict[str, Case]) -> dict[str, Case]:
    """Surfaces with spectra: of three wavelengths, a medium is one of three channels between two
    matrices.
    """
    seen = [[0.7, 0.25, 0.05], [0.2, 0.7, 0.1], [0.05, 0.3, 0.65]]
    # the reflectances of Mallett and Yuksel (2019) at `WAVELENGTHS`
    basis = [
        [0.94925303, 0.0412304345, 0.00951653539],
        [0.00640057277, 0.973351116, 0.0202483114],
        [0.0119861636, 0.0309885719, 0.957025265],
    ]
    mixed = ["z = 0", "z = +∞ in part", "σ ∝ √z at z = 0", "β = G = 0", "G = 0, z = +∞"]
    mixed += ["optical depth 1e4", "J = 0 and 1", "J > 1 and < 0", "batch of 2 media", "float16"]
    reflected = ["g = 1", "a = g = 0 (B∞ = b/0)", "μ = 0", "K_d·d = 500"]
    cases = {"colours": replace(plain["usual"], colours=torch.tensor(seen, dtype=torch.float64))}
    for names, matrix in ((mixed, seen), (reflected, basis)):
        for name in names:
            colours = torch.tensor(matrix, dtype=torch.float64)
            cases[f"colours, {name.partition(' (')[0]}"] = replace(plain[name], colours=colours)
    return cases
