"""Pictures as functions of a few numbers θ: coefficients of each colour and a width law. The
equation is that of `Medium.image` alone; slopes are its differences.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from torch import Tensor

from uwaug._support.types import Array, Shape
from uwaug.fitting.data import Geometry, Pixels
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import Law, PointSpread
from uwaug.optics.scattering import Scattering
from uwaug.optics.view import WIDE

COLOURS = ("red", "green", "blue")
VISIBLE_LIGHT = 0.002  # of linear light, the least that shows: half of a step of 8 bits
NORMAL = 1.96  # standard errors to either end of a 95 % interval
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
_STEP = 1e-7  # of a difference quotient, in units of where a fit may begin


class Bounds(NamedTuple):
    """Least and largest value of a fitted number, and where a fit may begin."""

    low: float
    high: float
    begin: float


class Quantity(NamedTuple):
    name: str
    unit: str
    resolution: float  # smallest change that shows in the picture
    follows: str  # name of the number of θ; where that is at a bound, the quantity is, too


class Model(Protocol):
    """A picture as a function of θ, as fits need it."""

    offset: float = 0.0  # linear light by which all pixels of a colour may be off alike

    @property
    def spreads(self) -> Array:
        """Standard deviations about 0 of the last numbers of θ, for what is known of them."""
        return np.empty(0)

    @property
    def name(self) -> str: ...

    @property
    def bounds(self) -> Mapping[str, Bounds]: ...

    @property
    def quantities(self) -> list[Quantity]: ...

    def render(self, theta: Array, pixels: Pixels) -> Tensor: ...

    def report(self, theta: Array) -> Array: ...

    def hidden(self, theta: Array) -> Sequence[str]:
        """Names of quantities that pictures of these numbers do not tell, whatever their errors."""
        return ()

    def slopes(self, theta: Array, pixels: Pixels) -> Array:
        """Derivatives of the 3·N values by θ (3·N x numbers), by differences. A number of one
        colour moves no other, so those of three colours are moved at once.
        """
        light = self.render(theta, pixels)[0, :, 0]
        jacobian = np.zeros((*light.shape, len(theta)))
        moves: dict[str, dict[int, slice]] = {}
        for i, name in enumerate(self.bounds):
            kind, _, colour = name.rpartition("_")
            if colour in COLOURS:
                c = COLOURS.index(colour)
                moves.setdefault(kind, {})[i] = slice(c, c + 1)
            else:
                moves[name] = {i: slice(3)}
        neighbour = neighbours(self, theta)
        for columns in moves.values():
            moved = theta.copy()
            moved[[*columns]] = neighbour[[*columns]]
            difference = self.render(moved, pixels)[0, :, 0] - light
            for i, rows in columns.items():
                jacobian[rows, :, i] = difference[rows] / (moved[i] - theta[i])
        return jacobian.reshape(-1, len(theta))


def neighbours(model: Model, theta: Array) -> Array:
    """Values inside the bounds, a step of a difference quotient away from θ."""
    _, high, begin = np.array([*model.bounds.values()]).T
    step = _STEP * np.where(begin == 0, 1.0, np.abs(begin))
    return np.asarray(np.where(theta + step <= high, theta + step, theta - step))


def report_slopes(model: Model, theta: Array) -> Array:
    """Derivatives of the reported values by θ (quantities x numbers), by differences."""
    columns, values = [], model.report(theta)
    for i, value in enumerate(neighbours(model, theta)):
        moved = theta.copy()
        moved[i] = value
        columns.append((model.report(moved) - values) / (value - theta[i]))
    return np.array(columns).T


class ModelSpec(NamedTuple):
    """A model of `uwaug.fit`."""

    name: str
    separate_veil: bool  # True if the veil has a coefficient of its own, G
    shape: Shape | None  # of the point spread; None without forward scatter
    words: str  # the terms of the model


_SPECS = (
    ModelSpec("haze", False, None, "direct light and veil, one coefficient for both"),
    ModelSpec("veil", True, None, "direct light and veil, a coefficient for each"),
    ModelSpec("gaussian", True, "gaussian", "forward scatter too, a Gaussian"),
    ModelSpec("exponential", True, "exponential", "forward scatter too, an exponential"),
)
MODELS = {spec.name: spec for spec in _SPECS}  # from the fewest numbers to the most


class Coefficients(NamedTuple):
    """Coefficients of a picture; 3 numbers each, but for the width law."""

    beta: Array  # attenuation of the direct light, 1/m
    G: Array  # attenuation of signal and veil, 1/m
    source: Array  # growth of the veil at the lens, G·V(0), 1/m; all that shows of a straight one
    light: Array  # of a white surface at the lens: daylight, exposure and white balance together
    width: float  # σ at the reference distance, px
    exponent: float  # of the width law


@dataclass(frozen=True)
class CoefficientModel(Model):
    """A water by coefficients for each colour.

    θ holds β, share (G/β), source and the logarithm of light of each colour, width and exponent.
    Pictures tell share and source apart better than G and V(0).
    """

    spec: ModelSpec
    geometry: Geometry
    gain: bool  # True if the light is fitted, False if it is that of the clean picture

    @property
    def name(self) -> str:
        return self.spec.name + self.gain * " + gain"

    @cached_property
    def bounds(self) -> dict[str, Bounds]:
        reference, widest = self.geometry.reference, self.geometry.widest
        opaque, scatters = MAX_OPTICAL_DEPTH / reference, self.spec.shape is not None
        kinds = {"beta": Bounds(0.0, opaque, 1 / reference)}
        if self.spec.separate_veil:
            # forward scatter takes no light away
            kinds["share"] = Bounds(0.0, 1.0 if scatters else _MAX_G_OVER_BETA, 0.5)
        kinds["source"] = Bounds(0.0, opaque, 0.2 / reference)
        if self.gain:
            kinds["light"] = Bounds(-math.log(MAX_GAIN), math.log(MAX_GAIN), 0.0)
        bounds = {f"{kind}_{colour}": x for kind, x in kinds.items() for colour in COLOURS}
        if scatters:
            bounds["width"] = Bounds(0.0, widest, 0.1 * widest)
            bounds["exponent"] = Bounds(*EXPONENTS, 1.0)
        return bounds

    def coefficients(self, theta: Array) -> Coefficients:
        values = dict(zip(self.bounds, theta.tolist(), strict=True))

        def three(kind: str, default: float = 0.0) -> Array:
            return np.array([values.get(f"{kind}_{colour}", default) for colour in COLOURS])

        beta, light = three("beta"), np.exp(three("light"))
        width, exponent = values.get("width", 0.0), values.get("exponent", 1.0)
        return Coefficients(
            beta, three("share", 1.0) * beta, three("source"), light, width, exponent
        )

    def start(self, numbers: Mapping[str, float]) -> Array:
        """θ of numbers by the names of `bounds`; the others are where a fit may begin."""
        return np.array([numbers.get(name, bound.begin) for name, bound in self.bounds.items()])

    def medium(self, c: Coefficients) -> Medium:
        """The water as `uwaug.Underwater` takes it: a batch of one, float64."""
        reference, scatters = self.geometry.reference, self.spec.shape is not None
        G = c.G.clip(min=_MIN_G)
        beta = c.beta if self.spec.separate_veil and not scatters else np.maximum(c.beta, G)
        direct = signal = np.diag(c.light)
        rates, veil, note = G, np.diag(c.source / G), "fitted: one rate for each colour"
        b, law = 0.0, PointSpread.none()
        if self.spec.shape is not None:
            b = float((beta - G).mean()) / (1 - Scattering.CALIBRATED.g)
            b = max(b, _MIN_LENGTHS / reference)
            px = c.width / (b * reference) ** c.exponent
            scale = px / Law(unit="paper").pixels(self.geometry.size, WIDE)
            law = PointSpread(float(scale), float(c.exponent), self.spec.shape, "paper")
        elif self.spec.separate_veil:
            # signal and veil share rates: those of direct light, then those of the veil
            rates, none = np.concatenate([beta, G]), np.zeros((3, 3))
            signal, veil = np.concatenate([signal, none], 1), np.concatenate([none, veil], 1)
            note = "fitted: direct light and veil, no forward scatter"
        arrays = {"beta": beta, "direct_weights": direct, "G": rates}
        arrays |= {"signal_weights": signal, "veil_weights": veil, "b_mean": np.array(b)}
        return Medium.of_arrays(arrays, note, law)

    def picture(self, c: Coefficients, pixels: Pixels) -> Tensor:
        soft = pixels.clean
        if self.spec.shape is not None:
            sigma = c.width * (pixels.z / self.geometry.reference) ** c.exponent
            soft = pixels.stacks[self.spec.shape].softened(sigma)
        return self.medium(c).image(pixels.z, pixels.clean, soft)

    def render(self, theta: Array, pixels: Pixels) -> Tensor:
        return self.picture(self.coefficients(theta), pixels)

    @cached_property
    def quantities(self) -> list[Quantity]:
        farthest = self.geometry.farthest
        rate, light = 0.1 / farthest, 0.02  # 1/m and 1: the smallest changes that show
        kinds = [("beta", "1/m", rate, "beta")]
        if self.spec.separate_veil:
            kinds.append(("G", "1/m", rate, "share"))
        kinds += [("veil", "1", light, "source"), ("source", "1/m", light / farthest, "source")]
        if self.gain:
            kinds.append(("gain", "1", light, "light"))
        rows = [
            Quantity(f"{kind}_{colour}", unit, resolution, f"{follows}_{colour}")
            for kind, unit, resolution, follows in kinds
            for colour in COLOURS
        ]
        if self.spec.shape:
            rows.append(Quantity("width", "px", 0.2, "width"))
            rows.append(Quantity("exponent", "1", 0.2, "exponent"))
        return rows

    def report(self, theta: Array) -> Array:
        c = self.coefficients(theta)
        values = {**c._asdict(), "veil": c.source / (c.G + _MIN_G), "gain": c.light}
        kinds = dict.fromkeys(quantity.name.partition("_")[0] for quantity in self.quantities)
        return np.hstack([values[kind] for kind in kinds])

    def hidden(self, theta: Array) -> Sequence[str]:
        """Names of β and the width law, where the blur is hardly told from none."""
        if self.spec.shape is None or self.coefficients(theta).width >= NARROW_PX:
            return ()
        return ("beta_red", "beta_green", "beta_blue", "width", "exponent")
