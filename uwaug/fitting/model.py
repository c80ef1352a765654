"""The picture as a function of a few numbers θ, and its slopes: coefficients for each colour.

    I = light·(T_β·(J − soft) + T_G·soft) + source·(1 − e^(−Gz))/G

with T_β = e^(−βz), T_G = e^(−Gz), soft = J blurred with σ = width·(z/reference)^exponent, and
source = G·V(0), the growth of the veil at the lens. Pictures are rendered by the `Medium` of the
numbers, as any other image is; slopes are written out.
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
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.scattering import Scattering

COLOURS = ("red", "green", "blue")
MAX_OPTICAL_DEPTH = 40.0  # to the median distance: more than any picture survives
MOST_GAIN = 1e4  # and one over it the least
# px, σ at the median distance, below which a blur is hardly told from none: in pictures of the
# default tolerance β is 40 % too small at .2 px, 10 % at .45, right at .7; and one of .13 px was
# taken for .68 px.
NARROW_PX = 0.8
EXPONENTS = (0.2, 3.0)  # of a width law: least and largest
_MAX_G_OVER_BETA = 4.0  # where no light is scattered forward and nothing ties the two together
_MIN_G = 1e-9  # 1/m, stands for smaller G, where the veil has no end
_MIN_LENGTHS = 1e-2  # scattering lengths to the median distance, that a width law counts by
_MIN_WIDTH = 1e-9  # px, stands for less: slopes by the width are proportional to it
_REPORT_STEP = 1e-5  # of θ, for a difference that stands for the slope of what is reported


class Bounds(NamedTuple):
    """Least and largest value of a number that is fitted, and where a fit may begin."""

    low: float
    high: float
    begin: float


class Quantity(NamedTuple):
    """What is reported.

    Attributes:
        name, unit: of the quantity.
        resolution: the least change of it that shows in the picture.
        follows: the number of θ at whose bounds it is at the end of what it may be.
    """

    name: str
    unit: str
    resolution: float
    follows: str


class Model(Protocol):
    """What a fit asks of a picture as a function of θ."""

    @property
    def name(self) -> str:
        """Of the candidate."""

    @property
    def bounds(self) -> Mapping[str, Bounds]:
        """Bounds of each number that is fitted, by name, in the order of θ."""

    @property
    def quantities(self) -> list[Quantity]:
        """What is reported."""

    def render(self, theta: Array, pixels: Pixels) -> Tensor:
        """The pixels (1x3x1xN) in linear light."""

    def slopes(self, theta: Array, pixels: Pixels) -> Array:
        """Derivatives of the 3·N values by θ (3·N x numbers)."""

    def report(self, theta: Array) -> Array:
        """The value of each of `quantities`."""

    def hidden(self, theta: Array) -> Sequence[str]:
        """The quantities that pictures of these numbers do not tell, whatever their errors."""
        return ()

    def shown(self, theta: Array) -> Mapping[str, float]:
        """What a table of candidates says of each."""
        return {}


def report_slopes(model: Model, theta: Array) -> Array:
    """Derivatives of what a model reports by θ (quantities x numbers), by differences."""
    columns = []
    for i, bound in enumerate(model.bounds.values()):
        step = _REPORT_STEP * max(abs(theta[i]), abs(bound.begin), 0.01)
        up, down = theta.copy(), theta.copy()
        up[i], down[i] = min(theta[i] + step, bound.high), max(theta[i] - step, bound.low)
        columns.append((model.report(up) - model.report(down)) / (up[i] - down[i]))
    return np.array(columns).T


class ModelSpec(NamedTuple):
    """One of the candidates.

    Attributes:
        name: what it is called.
        own_veil: whether the veil has a coefficient G of its own, or that of the direct light.
        shape: of the point spread, whose law has a width and an exponent; None if no light is
            scattered forward.
        words: what it models.
    """

    name: str
    own_veil: bool
    shape: Shape | None
    words: str


_SPECS = (
    ModelSpec("haze", False, None, "direct light and veil, one coefficient for both"),
    ModelSpec("veil", True, None, "direct light and veil, a coefficient for each"),
    ModelSpec("gaussian", True, "gaussian", "forward scatter too, a Gaussian"),
    ModelSpec("exponential", True, "exponential", "forward scatter too, an exponential"),
)
MODELS = {spec.name: spec for spec in _SPECS}  # by name, from the fewest numbers to the most


class Coefficients(NamedTuple):
    """What the picture depends on; 3 numbers each, but for the width law.

    Attributes:
        beta: attenuation of the direct light, 1/m.
        G: attenuation of signal and veil, 1/m.
        source: growth of the veil at the lens, G·V(0), 1/m: what is seen of the veil where G is
            small.
        light: of a white surface in front of the lens: daylight that is left, exposure and white
            balance together.
        width: σ at the reference distance, px.
        exponent: of the width law.
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
        by_width = by_log / max(c.width, _MIN_WIDTH)
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

    θ holds β, share (G/β), source and the logarithm of light of each colour, width and exponent: G
    as a share of β, and the veil by its slope at the lens, are told apart better than G and V(0).

    Attributes:
        spec: the candidate.
        geometry: of the pictures.
        gain: whether the light is fitted, or that of the clean picture.
        fixed: numbers that are known, by the names of `fixable`.
    """

    spec: ModelSpec
    geometry: Geometry
    gain: bool
    fixed: Mapping[str, float]

    @property
    def name(self) -> str:
        """Of the candidate."""
        return self.spec.name + self.gain * " + gain"

    @property
    def fixable(self) -> tuple[str, ...]:
        """The names of numbers that may be given instead of fitted."""
        kinds = ("beta", "G", "veil") if self.spec.own_veil else ("beta", "veil")
        names = [f"{kind}_{colour}" for kind in kinds for colour in COLOURS]
        return (*names, *(("width", "exponent") if self.spec.shape else ()))

    @cached_property
    def bounds(self) -> dict[str, Bounds]:
        """Bounds of each number that is fitted, by name, in the order of θ."""
        reference, widest = self.geometry.reference, self.geometry.widest
        thickest, scatters = MAX_OPTICAL_DEPTH / reference, self.spec.shape is not None
        bounds = {}
        for colour in COLOURS:
            # forward scatter takes no light away: with a G that is known, beta is no less
            least = self.fixed.get(f"G_{colour}", 0.0) if scatters else 0.0
            most, begin = max(thickest, 2 * least), max(1 / reference, least)
            bounds[f"beta_{colour}"] = Bounds(least, most, begin)
        if self.spec.own_veil:
            share = Bounds(0.0, 1.0 if scatters else _MAX_G_OVER_BETA, 0.5)
            bounds |= {f"share_{colour}": share for colour in COLOURS}
        slope = Bounds(0.0, thickest, 0.2 / reference)
        bounds |= {f"source_{colour}": slope for colour in COLOURS}
        if self.gain:
            most = math.log(MOST_GAIN)
            bounds |= {f"light_{colour}": Bounds(-most, most, 0.0) for colour in COLOURS}
        if scatters:
            bounds["width"] = Bounds(0.0, widest, 0.1 * widest)
            bounds["exponent"] = Bounds(*EXPONENTS, 1.0)
        stands_for = {"G": "share", "veil": "source"}
        for name in self.fixed:
            kind, _, colour = name.partition("_")
            del bounds["_".join(filter(None, (stands_for.get(kind, kind), colour)))]
        return bounds

    def coefficients(self, theta: Array) -> Coefficients:
        """What the picture depends on."""
        values = dict(self.fixed) | dict(zip(self.bounds, theta.tolist(), strict=True))

        def three(kind: str, otherwise: Array) -> Array:
            rows = zip(COLOURS, otherwise.tolist(), strict=True)
            return np.array([values.get(f"{kind}_{colour}", value) for colour, value in rows])

        beta = three("beta", np.zeros(3))
        G = three("G", three("share", np.ones(3)) * beta)
        source = three("source", G * three("veil", np.zeros(3)))
        light = np.exp(three("light", np.zeros(3)))
        return Coefficients(
            beta, G, source, light, values.get("width", 0.0), values.get("exponent", 1.0)
        )

    def start(self, numbers: Mapping[str, float]) -> Array:
        """θ where a fit begins, by the names of `bounds`; what is not given, at its beginning."""
        return np.array([numbers.get(name, bound.begin) for name, bound in self.bounds.items()])

    def medium(self, theta: Array) -> Medium:
        """The water as `uwaug.Underwater` takes it: a batch of one."""
        c, reference = self.coefficients(theta), self.geometry.reference
        least = c.G.clip(min=_MIN_G)
        rows = (c.beta, least, c.light, c.source / least)
        beta, G, light, veil = (torch.from_numpy(x)[None] for x in rows)
        if self.spec.shape is None and self.spec.own_veil:
            return _without_scatter(beta, G, light, veil)
        beta = beta.maximum(G)
        if self.spec.shape is None:
            return Medium.from_coefficients(beta, beta, veil, light=light)
        b = float((beta - G).mean()) / (1 - Scattering.CALIBRATED.g)
        b = max(b, _MIN_LENGTHS / reference)
        # σ = width·(z/reference)^exponent
        scale = c.width / (b * reference) ** c.exponent
        law = PointSpread(scale, c.exponent, self.spec.shape, float(min(self.geometry.size)))
        return Medium.from_coefficients(beta, G, veil, b_mean=b, point_spread=law, light=light)

    def render(self, theta: Array, pixels: Pixels) -> Tensor:
        """The pixels (1x3x1xN) in linear light."""
        medium, soft = self.medium(theta), pixels.clean
        if self.spec.shape is not None:
            soft = pixels.softened(self.spec.shape, medium.width(pixels.z, pixels.size))
        return medium.image(pixels.z, pixels.clean, soft)

    def slopes(self, theta: Array, pixels: Pixels) -> Array:
        """Derivatives of the 3·N values by θ (3·N x numbers)."""
        c = self.coefficients(theta)
        by = picture_slopes(c, pixels, self.spec.shape, self.geometry.reference)
        beta, G = (torch.from_numpy(x).reshape(1, 3, 1, 1) for x in (c.beta, c.G))
        # what is fixed does not follow: G goes with β, unless it is given; source with G, if the
        # veil is
        of_veil, of_G = torch.zeros(1, 3, 1, 1).double(), G / beta.clamp(min=1e-12)
        if not self.spec.own_veil:
            of_G = torch.ones_like(G)
        for i, colour in enumerate(COLOURS):
            of_veil[:, i] = self.fixed.get(f"veil_{colour}", 0.0)
            if f"G_{colour}" in self.fixed:
                of_G[:, i] = 0.0
        by_G = by["G"] + of_veil * by["source"]
        by |= {
            "beta": by["beta"] + of_G * by_G,
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
        """What is reported: those that are fitted or fixed, and what follows from them."""
        distance = self.geometry.farthest
        rate, shows = 0.1 / distance, 0.02
        kinds = [("beta", "1/m", rate, "beta")]
        if self.spec.own_veil:
            kinds.append(("G", "1/m", rate, "share"))
        kinds += [("veil", "1", shows, "source"), ("source", "1/m", shows / distance, "source")]
        if self.gain:
            kinds.append(("gain", "1", shows, "light"))
        rows = []
        for kind, unit, resolution, follows in kinds:
            for colour in COLOURS:
                rows.append(Quantity(f"{kind}_{colour}", unit, resolution, f"{follows}_{colour}"))
        if self.spec.shape:
            rows.append(Quantity("width", "px", 0.2, "width"))
            rows.append(Quantity("exponent", "1", 0.2, "exponent"))
        return rows

    def report(self, theta: Array) -> Array:
        """The value of each of `quantities`."""
        c = self.coefficients(theta)
        rows = [c.beta, *([c.G] if self.spec.own_veil else ()), c.source / (c.G + _MIN_G), c.source]
        rows += [c.light] if self.gain else []
        return np.concatenate([*rows, [c.width, c.exponent] if self.spec.shape else []])

    def hidden(self, theta: Array) -> Sequence[str]:
        """β and the width, where the blur is hardly told from none."""
        if self.spec.shape is None or self.coefficients(theta).width >= NARROW_PX:
            return ()
        return ("beta_red", "beta_green", "beta_blue", "width", "exponent")


def _without_scatter(beta: Tensor, G: Tensor, light: Tensor, veil: Tensor) -> Medium:
    """A medium (numbers are 1x3) in which all light that leaves the line of sight is lost, T_G =
    T_β, and whose veil has rates of its own.
    """
    medium = Medium.from_coefficients(beta, beta, veil, light=light)
    none = torch.zeros_like(medium.veil_weights)
    return replace(
        medium,
        G=torch.cat([beta, G], 1),
        signal_weights=torch.cat([medium.signal_weights, none], 2),
        veil_weights=torch.cat([none, medium.veil_weights], 2),
        notes=("fitted: direct light and veil, no forward scatter",),
    )
