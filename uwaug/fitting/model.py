"""Pictures as functions of a few numbers θ, coefficients for each colour, and their slopes.

    I = light·(T_β·(J − soft) + T_G·soft) + source·(1 − e^(−Gz))/G

with T_β = e^(−βz), T_G = e^(−Gz), soft = J blurred with σ = width·(z/reference)^exponent, and
source = G·V(0), the growth of the veil at the lens. Pictures are rendered by `Medium`, as any other
image is; slopes are written out.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import Array, Shape
from uwaug.blur.stack import mixed, node_slopes, node_weights
from uwaug.fitting.data import Geometry, Pixels
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import Law, PointSpread
from uwaug.optics.view import WIDE
from uwaug.optics.scattering import Scattering

COLOURS = ("red", "green", "blue")
MAX_OPTICAL_DEPTH = 40.0  # to the median distance: more than any picture survives
MAX_GAIN = 1e4  # the least gain is one over it
# px, σ at the median distance, below which a blur is hardly told from none. In pictures of the
# default tolerance β is 40 % too small at .2 px, 10 % at .45, right at .7. A blur of .13 px was
# taken for .68 px.
NARROW_PX = 0.8
EXPONENTS = (0.2, 3.0)  # least and largest exponent of a width law
_MAX_G_OVER_BETA = 4.0  # without forward scatter, where nothing ties the two together
_MIN_G = 1e-9  # 1/m; takes the place of smaller G, where the veil has no end
_MIN_LENGTHS = 1e-2  # scattering lengths to the median distance, in a width law
_MIN_WIDTH_PX = 1e-9  # takes the place of smaller widths, by which slopes are divided
_REPORT_STEP = 1e-5  # step of θ, relative, of a difference quotient


class Bounds(NamedTuple):
    """Least and largest value of a fitted number, and where a fit may begin."""

    low: float
    high: float
    begin: float


class Quantity(NamedTuple):
    """A reported quantity.

    Attributes:
        name, unit: its name and unit.
        resolution: smallest change that shows in the picture.
        follows: name of the number of θ; where that is at a bound, the quantity is, too.
    """

    name: str
    unit: str
    resolution: float
    follows: str


class Model(Protocol):
    """A picture as a function of θ, as fits need it.

    Attributes:
        offset: linear light by which all pixels of a colour may be off alike, whatever the noise.
    """

    offset: float = 0.0

    @property
    def name(self) -> str:
        """Name of the candidate."""

    @property
    def bounds(self) -> Mapping[str, Bounds]:
        """Bounds of each fitted number, by name, in the order of θ."""

    @property
    def quantities(self) -> list[Quantity]:
        """The reported quantities."""

    def render(self, theta: Array, pixels: Pixels) -> Tensor:
        """Pixels (1x3x1xN) in linear light."""

    def slopes(self, theta: Array, pixels: Pixels) -> Array:
        """Derivatives of the 3·N values by θ (3·N x numbers)."""

    def report(self, theta: Array) -> Array:
        """Value of each of `quantities`."""

    def hidden(self, theta: Array) -> Sequence[str]:
        """Names of quantities that pictures of these numbers do not tell, whatever their errors."""
        return ()

    def shown(self, theta: Array) -> Mapping[str, float]:
        """Values for a table of candidates, by name."""
        return {}


def report_slopes(model: Model, theta: Array) -> Array:
    """Derivatives of the reported values by θ (quantities x numbers), by differences."""
    columns = []
    for i, bound in enumerate(model.bounds.values()):
        step = _REPORT_STEP * max(abs(theta[i]), abs(bound.begin), 0.01)
        up, down = theta.copy(), theta.copy()
        up[i], down[i] = min(theta[i] + step, bound.high), max(theta[i] - step, bound.low)
        columns.append((model.report(up) - model.report(down)) / (up[i] - down[i]))
    return np.array(columns).T


class ModelSpec(NamedTuple):
    """A model of `uwaug.fit`.

    Attributes:
        name: its name.
        separate_veil: True if the veil has a coefficient G, False if it has that of direct light.
        shape: shape of the point spread, whose law has a width and an exponent; None without
            forward scatter.
        words: the terms of the model, in words.
    """

    name: str
    separate_veil: bool
    shape: Shape | None
    words: str


_SPECS = (
    ModelSpec("haze", False, None, "direct light and veil, one coefficient for both"),
    ModelSpec("veil", True, None, "direct light and veil, a coefficient for each"),
    ModelSpec("gaussian", True, "gaussian", "forward scatter too, a Gaussian"),
    ModelSpec("exponential", True, "exponential", "forward scatter too, an exponential"),
)
MODELS = {spec.name: spec for spec in _SPECS}  # from the fewest numbers to the most


class Coefficients(NamedTuple):
    """Coefficients of a picture; 3 numbers each, but for the width law.

    Attributes:
        beta: attenuation of the direct light, 1/m.
        G: attenuation of signal and veil, 1/m.
        source: growth of the veil at the lens, G·V(0), 1/m; all that shows of the veil where G is
            small.
        light: light of a white surface in front of the lens: daylight, exposure and white balance
            together.
        width: σ at the reference distance, px.
        exponent: exponent of the width law.
    """

    beta: Array
    G: Array
    source: Array
    light: Array
    width: float
    exponent: float


def picture_slopes(
    c: Coefficients, pixels: Pixels, shape: Shape | None, reference: float
) -> dict[str, Tensor]:
    """Derivatives of the picture (1x3x1xN) by each of the `Coefficients`; colours do not mix."""
    beta, G, source, light = (torch.from_numpy(x).reshape(1, 3, 1, 1) for x in c[:4])
    z = pixels.z
    direct, signal = torch.exp(-beta * z), torch.exp(-G * z)
    soft = by_width = by_exponent = torch.zeros_like(pixels.clean)
    if shape is not None:
        sigma = c.width * (z / reference) ** c.exponent
        plan, blurs = pixels.stacks[shape]
        soft = mixed(blurs, node_weights(sigma, plan))
        by_log = light * (signal - direct) * mixed(blurs, node_slopes(sigma, plan)) * sigma
        by_width = by_log / max(c.width, _MIN_WIDTH_PX)
        by_exponent = by_log * (z / reference).log()
    sharp = direct * (pixels.clean - soft)
    return {
        "beta": -z * light * sharp,
        "G": -z * light * signal * soft - source * z * z * _growth_slope(G * z),
        "source": z * _growth(G * z),
        "light": sharp + signal * soft,
        "width": by_width,
        "exponent": by_exponent,
    }


def _growth(x: Tensor) -> Tensor:
    """(1 − e^−x)/x."""
    small = x < 1e-4
    safe = torch.where(small, 1.0, x)
    return torch.where(small, 1 - x / 2, -torch.expm1(-safe) / safe)


def _growth_slope(x: Tensor) -> Tensor:
    """(1 − e^−x·(1 + x))/x², the derivative of −(1 − e^−x)/x."""
    small = x < 1e-2
    safe = torch.where(small, 1.0, x)
    series = 0.5 - x / 3 + x * x / 8 - x**3 / 30 + x**4 / 144
    return torch.where(small, series, (1 - torch.exp(-safe) * (1 + safe)) / (safe * safe))


@dataclass(frozen=True)
class CoefficientModel(Model):
    """A water by coefficients for each colour.

    θ holds β, share (G/β), source and the logarithm of light of each colour, width and exponent.
    Pictures tell share and source apart better than G and V(0).

    Attributes:
        spec: terms of the model.
        geometry: distances and sizes of the pictures.
        gain: True if the light is fitted, False if it is that of the clean picture.
        fixed: known numbers, by the names of `fixable`.
    """

    spec: ModelSpec
    geometry: Geometry
    gain: bool
    fixed: Mapping[str, float]

    @property
    def name(self) -> str:
        """Name of the candidate."""
        return self.spec.name + self.gain * " + gain"

    @property
    def fixable(self) -> tuple[str, ...]:
        """Names of the numbers that may be fixed."""
        kinds = ("beta", "G", "veil") if self.spec.separate_veil else ("beta", "veil")
        names = [f"{kind}_{colour}" for kind in kinds for colour in COLOURS]
        return (*names, *(("width", "exponent") if self.spec.shape else ()))

    @cached_property
    def bounds(self) -> dict[str, Bounds]:
        """Bounds of each fitted number, by name, in the order of θ."""
        reference, widest = self.geometry.reference, self.geometry.widest
        opaque, scatters = MAX_OPTICAL_DEPTH / reference, self.spec.shape is not None
        bounds = {}
        for colour in COLOURS:
            # forward scatter takes no light away: beta is no less than a fixed G
            low = self.fixed.get(f"G_{colour}", 0.0) if scatters else 0.0
            high, begin = max(opaque, 2 * low), max(1 / reference, low)
            bounds[f"beta_{colour}"] = Bounds(low, high, begin)
        if self.spec.separate_veil:
            share = Bounds(0.0, 1.0 if scatters else _MAX_G_OVER_BETA, 0.5)
            bounds |= {f"share_{colour}": share for colour in COLOURS}
        source = Bounds(0.0, opaque, 0.2 / reference)
        bounds |= {f"source_{colour}": source for colour in COLOURS}
        if self.gain:
            light = Bounds(-math.log(MAX_GAIN), math.log(MAX_GAIN), 0.0)
            bounds |= {f"light_{colour}": light for colour in COLOURS}
        if scatters:
            bounds["width"] = Bounds(0.0, widest, 0.1 * widest)
            bounds["exponent"] = Bounds(*EXPONENTS, 1.0)
        kind_in_theta = {"G": "share", "veil": "source"}
        for name in self.fixed:
            kind, _, colour = name.partition("_")
            del bounds["_".join(filter(None, (kind_in_theta.get(kind, kind), colour)))]
        return bounds

    def coefficients(self, theta: Array) -> Coefficients:
        """Coefficients of the picture at θ."""
        values = dict(self.fixed) | dict(zip(self.bounds, theta.tolist(), strict=True))

        def three(kind: str, defaults: Array) -> Array:
            rows = zip(COLOURS, defaults.tolist(), strict=True)
            return np.array([values.get(f"{kind}_{colour}", value) for colour, value in rows])

        beta = three("beta", np.zeros(3))
        G = three("G", three("share", np.ones(3)) * beta)
        source = three("source", G * three("veil", np.zeros(3)))
        light = np.exp(three("light", np.zeros(3)))
        return Coefficients(
            beta, G, source, light, values.get("width", 0.0), values.get("exponent", 1.0)
        )

    def start(self, numbers: Mapping[str, float]) -> Array:
        """θ of numbers by the names of `bounds`; the others are where a fit may begin."""
        return np.array([numbers.get(name, bound.begin) for name, bound in self.bounds.items()])

    def medium(self, theta: Array) -> Medium:
        """The water as `uwaug.Underwater` takes it: a batch of one."""
        c, reference = self.coefficients(theta), self.geometry.reference
        positive_G = c.G.clip(min=_MIN_G)
        rows = (c.beta, positive_G, c.light, c.source / positive_G)
        beta, G, light, veil = (torch.from_numpy(x)[None] for x in rows)
        if self.spec.shape is None and self.spec.separate_veil:
            return _without_scatter(beta, G, light, veil)
        beta = beta.maximum(G)
        if self.spec.shape is None:
            return Medium.from_coefficients(beta, beta, veil, light=light)
        b = float((beta - G).mean()) / (1 - Scattering.CALIBRATED.g)
        b = max(b, _MIN_LENGTHS / reference)
        scale = c.width / (b * reference) ** c.exponent
        unit = Law(unit="paper").pixels(self.geometry.size, WIDE)
        law = PointSpread(float(scale / unit), float(c.exponent), self.spec.shape, "paper")
        return Medium.from_coefficients(beta, G, veil, b_mean=b, point_spread=law, light=light)

    def render(self, theta: Array, pixels: Pixels) -> Tensor:
        """Pixels (1x3x1xN) in linear light."""
        medium, soft = self.medium(theta), pixels.clean
        if self.spec.shape is not None:
            widths = medium.in_pixels(pixels.size, WIDE).width(pixels.z)
            soft = pixels.softened(self.spec.shape, widths)
        return medium.image(pixels.z, pixels.clean, soft)

    def slopes(self, theta: Array, pixels: Pixels) -> Array:
        """Derivatives of the 3·N values by θ (3·N x numbers)."""
        c = self.coefficients(theta)
        by = picture_slopes(c, pixels, self.spec.shape, self.geometry.reference)
        beta, G = (torch.from_numpy(x).reshape(1, 3, 1, 1) for x in (c.beta, c.G))
        # G follows β unless it is fixed; source follows G if the veil is fixed
        G_by_beta, source_by_G = G / beta.clamp(min=1e-12), torch.zeros(1, 3, 1, 1).double()
        if not self.spec.separate_veil:
            G_by_beta = torch.ones_like(G)
        for i, colour in enumerate(COLOURS):
            source_by_G[:, i] = self.fixed.get(f"veil_{colour}", 0.0)
            if f"G_{colour}" in self.fixed:
                G_by_beta[:, i] = 0.0
        by_G = by["G"] + source_by_G * by["source"]
        by |= {
            "beta": by["beta"] + G_by_beta * by_G,
            "share": beta * by_G,
            "light": torch.from_numpy(c.light).reshape(1, 3, 1, 1) * by["light"],
        }
        jacobian = np.zeros((3, pixels.z.shape[-1], len(self.bounds)))
        for column, name in enumerate(self.bounds):
            kind, _, colour = name.partition("_")
            # a number of one colour moves no other
            rows = [COLOURS.index(colour)] if colour else [0, 1, 2]
            jacobian[rows, :, column] = by[kind][0, rows, 0]
        return jacobian.reshape(-1, len(self.bounds))

    @cached_property
    def quantities(self) -> list[Quantity]:
        """The reported quantities: fitted and fixed numbers, and what follows from them."""
        farthest = self.geometry.farthest
        rate, light = 0.1 / farthest, 0.02  # 1/m and 1: the smallest changes that show
        kinds = [("beta", "1/m", rate, "beta")]
        if self.spec.separate_veil:
            kinds.append(("G", "1/m", rate, "share"))
        kinds += [("veil", "1", light, "source"), ("source", "1/m", light / farthest, "source")]
        if self.gain:
            kinds.append(("gain", "1", light, "light"))
        rows = []
        for kind, unit, resolution, follows in kinds:
            for colour in COLOURS:
                rows.append(Quantity(f"{kind}_{colour}", unit, resolution, f"{follows}_{colour}"))
        if self.spec.shape:
            rows.append(Quantity("width", "px", 0.2, "width"))
            rows.append(Quantity("exponent", "1", 0.2, "exponent"))
        return rows

    def report(self, theta: Array) -> Array:
        """Value of each of `quantities`."""
        c = self.coefficients(theta)
        rows = [c.beta]
        if self.spec.separate_veil:
            rows.append(c.G)
        rows += [c.source / (c.G + _MIN_G), c.source]
        if self.gain:
            rows.append(c.light)
        if self.spec.shape:
            rows.append(np.array([c.width, c.exponent]))
        return np.concatenate(rows)

    def hidden(self, theta: Array) -> Sequence[str]:
        """Names of β and the width law, where the blur is hardly told from none."""
        if self.spec.shape is None or self.coefficients(theta).width >= NARROW_PX:
            return ()
        return ("beta_red", "beta_green", "beta_blue", "width", "exponent")


def _without_scatter(beta: Tensor, G: Tensor, light: Tensor, veil: Tensor) -> Medium:
    """A medium (of 1x3 tensors) without forward scatter, T_G = T_β, whose veil has separate rates
    G.
    """
    medium = Medium.from_coefficients(beta, beta, veil, light=light)
    zeros = torch.zeros_like(medium.veil_weights)
    return replace(
        medium,
        G=torch.cat([beta, G], 1),
        signal_weights=torch.cat([medium.signal_weights, zeros], 2),
        veil_weights=torch.cat([zeros, medium.veil_weights], 2),
        notes=("fitted: direct light and veil, no forward scatter",),
    )
