"""The picture as a function of a few numbers θ: three ways to say what water it was taken in.

`CoefficientModel` has coefficients for each colour, `TurbidityModel` what several turbidities of
one water share, `SpectralModel` the contents of a Jerlov type, its spectra and the camera's. Each
renders pixels by the functions that form any other image, and knows its slopes, its bounds and what
is reported of it: that is `Model`, all that a fit asks for.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import Array, Shape
from uwaug.blur.stack import mixed, node_weights
from uwaug.fitting.coefficients import (
    MIN_G,
    MIN_SCATTERING,
    Coefficients,
    derivatives,
    render,
)
from uwaug.fitting.data import Geometry, Pixels
from uwaug.optics.camera import Camera
from uwaug.optics.curves import curves, passed
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PAPER_SIZE, PointSpread
from uwaug.optics.scattering import Scattering
from uwaug.optics.surfaces import Surfaces
from uwaug.optics.water import Water

COLOURS = ("red", "green", "blue")
Veil = Literal["none", "shared", "own"]
Law = Literal["paper", "calibrated", "gaussian", "exponential"]
Gain = Literal["fixed", "free", "channels"]
Correction = Literal["auto", "fixed", "free"]
"""Whether something that a camera does is fitted: where pictures tell of it, never, always."""

CameraGain = Literal["fixed", "free", "matrix"]
MAX_OPTICAL_DEPTH = 40.0  # to the median distance: more than any picture survives
_MAX_G_OVER_BETA = 4.0  # where no light is scattered forward and nothing ties the two together
_MAX_VERTICAL_DEPTH = 30.0  # m; below, little is left of any light but blue
_MIN_CONTENTS = 1e-3  # of a type's: nothing but pure water is left
_MAX_CONTENTS = 1e3  # of a type's: the clearest are pure water within the tables' error
EXPONENTS = (0.2, 3.0)  # of a width law: least and largest
_STEP = 1e-5  # of θ, for a difference that stands for the slope of a picture
_RIDGE = 1e-9  # keeps a colour matrix that is not seen from being infinite
_REPORT_STEP = 1e-4  # of θ, for a difference that stands for the slope of what is reported


class Bounds(NamedTuple):
    """Least and largest value of a number that is fitted, and where a fit may begin.

    `log` says that the number is a logarithm, whose error is that of a share.
    """

    low: float
    high: float
    begin: float
    log: bool = False


class Quantity(NamedTuple):
    """What is reported.

    Attributes:
        name, unit: of the quantity.
        resolution: the least change of it that shows in the picture.
        follows: the numbers of θ at whose bounds it is at the end of what it may be.
        signed: whether it may be negative.
    """

    name: str
    unit: str
    resolution: float
    follows: tuple[str, ...]
    signed: bool = False


SHADING = {
    "vignette": Bounds(-0.5, 0.95, 0.0),
    "down": Bounds(-0.9, 0.9, 0.0),
    "right": Bounds(-0.9, 0.9, 0.0),
}
"""What light may lose in the corners, and gain downwards and to the right."""

TONE = {"tone": Bounds(0.25, 4.0, 1.0), "shoulder": Bounds(-0.5, 30.0, 0.0)}
"""c and s of a camera's curve."""


class Model(Protocol):
    """What a fit asks of a picture as a function of θ."""

    @property
    def name(self) -> str:
        """Of the candidate."""

    @property
    def shape(self) -> Shape | None:
        """Of the point spread; None if no light is scattered forward."""

    @property
    def bounds(self) -> Mapping[str, Bounds]:
        """Bounds of each number that is fitted, by name, in the order of θ."""

    @property
    def quantities(self) -> Sequence[Quantity]:
        """What is reported."""

    def render(self, theta: Array, pixels: Pixels) -> Tensor:
        """The pixels (Px3x1xN) in linear light."""

    def jacobian(self, theta: Array, pixels: Pixels) -> tuple[Tensor, Tensor]:
        """The pixels, and their derivatives by θ (Px3x1xNxn)."""

    def report(self, theta: Array) -> Array:
        """The value of each of `quantities`."""

    def report_jacobian(self, theta: Array) -> Array:
        """Derivatives of `report` by θ (quantities x n)."""


class ByCoefficients(ABC):
    """A `Model` whose pictures depend on coefficients of each pair alone."""

    spec: "ModelSpec"

    @property
    def shape(self) -> Shape | None:
        """Of the point spread; None if no light is scattered forward."""
        return self.spec.shape

    @abstractmethod
    def coefficients(self, theta: Tensor) -> Coefficients:
        """What pictures depend on; differentiable."""

    @abstractmethod
    def reported(self, theta: Tensor) -> Tensor:
        """The value of each quantity; differentiable."""

    def render(self, theta: Array, pixels: Pixels) -> Tensor:
        """The pixels (Px3x1xN) in linear light."""
        return render(self.coefficients(torch.from_numpy(theta)), pixels, self.shape)

    def jacobian(self, theta: Array, pixels: Pixels) -> tuple[Tensor, Tensor]:
        """The pixels, and their derivatives by θ (Px3x1xNxn)."""
        numbers = torch.from_numpy(theta)
        light, slopes = derivatives(self.coefficients(numbers), pixels, self.shape)

        def coefficients(numbers: Tensor) -> Tensor:
            return self.coefficients(numbers).stacked()

        by_theta: Tensor = torch.func.jacrev(coefficients)(numbers)  # 6xPx3xn
        return light, torch.einsum("kpciN,kpcn->pciNn", slopes, by_theta)

    def report(self, theta: Array) -> Array:
        """The value of each of `quantities`."""
        return np.asarray(self.reported(torch.from_numpy(theta)))

    def report_jacobian(self, theta: Array) -> Array:
        """Derivatives of `report` by θ (quantities x n)."""
        slopes = torch.func.jacrev(self.reported)(torch.from_numpy(theta))
        return np.asarray(slopes.nan_to_num(0.0, 0.0, 0.0))


# ---- one water


@dataclass(frozen=True)
class ModelSpec:
    """One of the candidates.

    Attributes:
        name: what it is called.
        veil: whether there is one, and whether its coefficient G is that of the direct light or one
            of its own.
        law: of the forward scatter, or None.
        words: what it models.
    """

    name: str
    veil: Veil
    law: Law | None
    words: str

    @property
    def shape(self) -> Shape | None:
        """Of the point spread; None if no light is scattered forward."""
        if self.law is None:
            return None
        return "exponential" if self.law in ("exponential", "calibrated") else "gaussian"

    @property
    def own_law(self) -> bool:
        """Whether width and exponent are numbers of their own."""
        return self.law in ("gaussian", "exponential")

    @property
    def g(self) -> float:
        """Share of the scattered light that leaves the line of sight, if nobody knows better."""
        return (Scattering.PAPER if self.law == "paper" else Scattering.CALIBRATED).g


_TOO = "forward scatter too"
_SPECS = (
    ModelSpec("attenuation", "none", None, "direct light alone"),
    ModelSpec("haze", "shared", None, "direct light and veil, one coefficient for both"),
    ModelSpec("veil", "own", None, "direct light and veil, a coefficient for each"),
    ModelSpec("paper", "own", "paper", f"{_TOO}, the paper's width law"),
    ModelSpec("calibrated", "own", "calibrated", f"{_TOO}, the calibrated width law"),
    ModelSpec("gaussian", "own", "gaussian", f"{_TOO}, a Gaussian with a law of its own"),
    ModelSpec("exponential", "own", "exponential", f"{_TOO}, an exponential of its own"),
)
MODELS = {spec.name: spec for spec in _SPECS}  # by name, from the fewest numbers to the most
_FITTED = {f"G_{colour}": f"share_{colour}" for colour in COLOURS}
# Numbers that are fitted in place of those that are reported: G as a share of β, and the veil by
# its slope at the lens, are told apart better than G and V(0).
_FITTED |= {f"veil_{colour}": f"source_{colour}" for colour in COLOURS}


@dataclass(frozen=True)
class CoefficientModel(ByCoefficients):
    """One water for all pairs, with coefficients for each colour.

    Attributes:
        spec: the candidate.
        geometry: of the pictures.
        gain: "fixed": the exposure is that of the clean picture. "free": one factor for each
            picture. "channels": one for each of its colours, which is also what is left of each
            colour at the scene's depth.
        g: share of the scattered light that leaves the line of sight; gives a and b from β and G.
        fixed: numbers that are known, by the names of `quantities`.
        shading: whether the picture is darker in its corners or to one side.
        tone: whether the camera has a curve of its own.
    """

    spec: ModelSpec
    geometry: Geometry
    gain: Gain
    g: float
    fixed: Mapping[str, float]
    shading: bool = False
    tone: bool = False

    @property
    def name(self) -> str:
        """Of the candidate."""
        faults = {"gain": self.gain != "fixed", "shading": self.shading, "tone": self.tone}
        return " + ".join([self.spec.name, *(name for name, there in faults.items() if there)])

    @property
    def fixable(self) -> tuple[str, ...]:
        """The names of numbers that may be given instead of fitted."""
        kinds = {"none": ["beta"], "shared": ["beta", "veil"], "own": ["beta", "G", "veil"]}
        names = [f"{kind}_{colour}" for kind in kinds[self.spec.veil] for colour in COLOURS]
        return (*names, *(("width", "exponent") if self.spec.own_law else ()))

    def start(self, numbers: Mapping[str, float], known: Mapping[str, float]) -> Array:
        """θ where a fit begins: what is `known`, by the names of `fixable`, else `numbers`."""
        begin = {**numbers, **{name: x for name, x in known.items() if name in self.bounds}}
        for colour in COLOURS:
            beta = begin.get(f"beta_{colour}", self.fixed.get(f"beta_{colour}", 1.0))
            G = begin.get(f"share_{colour}", 1.0) * beta
            if f"G_{colour}" in known:
                G = known[f"G_{colour}"]
                begin[f"share_{colour}"] = G / max(beta, 1e-9)
            if f"veil_{colour}" in known:
                begin[f"source_{colour}"] = G * known[f"veil_{colour}"]
        return np.array([begin[name] for name in self.bounds])

    @cached_property
    def bounds(self) -> dict[str, Bounds]:
        """Bounds of each number that is fitted, by name, in the order of θ."""
        thickest = MAX_OPTICAL_DEPTH / self.geometry.reference
        typical, widest = 1 / self.geometry.reference, self.geometry.widest
        largest = _MAX_G_OVER_BETA if self.spec.law is None else 1.0
        bounds = {}
        for colour in COLOURS:
            # forward scatter takes no light away: with a G that is known, beta is no less
            least = self.fixed.get(f"G_{colour}", 0.0) if self.spec.law is not None else 0.0
            bounds[f"beta_{colour}"] = Bounds(least, max(thickest, 2 * least), max(typical, least))
        if self.spec.veil == "own":
            bounds |= {f"share_{colour}": Bounds(0.0, largest, 0.5) for colour in COLOURS}
        if self.spec.veil != "none":
            slope = Bounds(0.0, thickest, 0.2 * typical)
            bounds |= {f"source_{colour}": slope for colour in COLOURS}
        if self.spec.own_law:
            bounds["width"] = Bounds(0.0, widest, 0.1 * widest)
            bounds["exponent"] = Bounds(*EXPONENTS, 1.0)
        bounds |= {name: Bounds(1e-3, 1e3, 1.0) for name in self._gains}
        bounds |= {name: (SHADING | TONE)[name] for name in self._of_camera}
        fixed = {_FITTED.get(name, name) for name in self.fixed}
        return {name: x for name, x in bounds.items() if name not in fixed}

    @property
    def _gains(self) -> list[str]:
        pictures = range(1, self.geometry.pairs + 1)
        if self.gain == "free":
            return [f"gain_{i}" for i in pictures]
        if self.gain == "channels":
            return [f"gain_{i}_{colour}" for i in pictures for colour in COLOURS]
        return []

    @property
    def _of_camera(self) -> list[str]:
        """The numbers of its camera, which all pictures share."""
        return self.shading * [*SHADING] + self.tone * [*TONE]

    def coefficients(self, theta: Tensor) -> Coefficients:
        """What pictures depend on; differentiable."""
        numbers, pairs = self._numbers(theta), self.geometry.pairs
        beta = torch.stack([numbers[f"beta_{colour}"] for colour in COLOURS])
        G, veil_slope = beta, torch.zeros_like(beta)
        if self.spec.veil == "own":
            rows = []
            for c, colour in enumerate(COLOURS):
                rate = numbers.get(f"G_{colour}")
                rows.append(numbers[f"share_{colour}"] * beta[c] if rate is None else rate)
            G = torch.stack(rows)
        if self.spec.veil != "none":
            rows = []
            for c, colour in enumerate(COLOURS):
                veil = numbers.get(f"veil_{colour}")
                rows.append(numbers[f"source_{colour}"] if veil is None else G[c] * veil)
            veil_slope = torch.stack(rows)
        width, exponent = numbers.get("width"), numbers.get("exponent")
        if self.spec.law in ("paper", "calibrated"):
            law = PointSpread.paper()
            law = replace(law, scale=law.scale * self.geometry.short_side / PAPER_SIZE)
            if self.spec.law == "calibrated":
                assert self.geometry.focal_px is not None
                law = PointSpread.calibrated(self.geometry.focal_px)
            lengths = ((beta - G) / (1 - self.g)).mean() * self.geometry.reference
            exponent = torch.as_tensor(law.exponent, dtype=beta.dtype)
            width = law.scale * lengths.clamp(min=MIN_SCATTERING) ** exponent
        gain = beta.new_ones(pairs, 3)
        if self._gains:
            gain = torch.stack([numbers[name] for name in self._gains]).reshape(pairs, -1)
        return Coefficients(
            beta=beta.expand(pairs, 3),
            G=G.expand(pairs, 3),
            veil_slope=veil_slope.expand(pairs, 3),
            width=None if width is None else width.expand(pairs),
            exponent=None if exponent is None else exponent.expand(pairs),
            gain=gain.expand(pairs, 3),
            shading=_together(numbers, SHADING, pairs) if self.shading else None,
            tone=numbers["tone"].expand(pairs) if self.tone else None,
            shoulder=numbers["shoulder"].expand(pairs) if self.tone else None,
        )

    def _numbers(self, theta: Tensor) -> dict[str, Tensor]:
        """Each number by name, fitted or fixed."""
        fixed = {name: theta.new_tensor(x) for name, x in self.fixed.items()}
        return fixed | {name: theta[i] for i, name in enumerate(self.bounds)}

    def media(self, c: Coefficients) -> Medium:
        """A batch of media that any picture can be formed in."""
        b = (c.beta - c.G) / (1 - self.g)
        return c.media(b.mean(1), self.shape, self.geometry)

    @cached_property
    def quantities(self) -> list[Quantity]:
        """What is reported: those that are fitted or fixed, and what follows from them."""
        rows = []
        for kind, unit, resolution, *follows in self._kinds:
            for colour in COLOURS:
                names = tuple(f"{name}_{colour}" for name in follows)
                rows.append(Quantity(f"{kind}_{colour}", unit, resolution, names))
        if self.spec.own_law:
            rows.append(Quantity("width", "px", 0.2, ("width",)))
            rows.append(Quantity("exponent", "1", 0.2, ("exponent",)))
        cameras = [*self._gains, *self._of_camera]
        rows += [Quantity(x, "1", 0.02, (x,), self.bounds[x].low < 0) for x in cameras]
        return rows

    @property
    def _kinds(self) -> list[tuple[Any, ...]]:
        """What is reported of each colour: kind, unit, resolution, what it follows."""
        distance, unit = self.geometry.farthest, f"1/{self.geometry.unit}"
        rate = 0.1 / distance
        kinds: list[tuple[Any, ...]] = [("beta", unit, rate, "beta")]
        if self.spec.veil == "own":
            kinds.append(("G", unit, rate, "share"))
        if self.spec.veil != "none":
            kinds += [("veil", "1", 0.02, "source"), ("source", unit, 0.02 / distance, "source")]
        if self.spec.law is not None:
            kinds += [("a", unit, rate), ("b", unit, rate, "share")]
        return kinds

    def reported(self, theta: Tensor) -> Tensor:
        """The value of each of `quantities`; differentiable."""
        c, numbers = self.coefficients(theta), self._numbers(theta)
        beta, G, veil_slope = c.beta[0], c.G[0], c.veil_slope[0]
        b = (beta - G) / (1 - self.g)
        kinds = {"beta": beta, "G": G, "veil": veil_slope / (G + MIN_G), "source": veil_slope}
        kinds |= {"a": beta - b, "b": b}
        rows = [kinds[kind] for kind, *_ in self._kinds]
        names = [quantity.name for quantity in self.quantities[3 * len(rows) :]]
        return torch.cat([*rows, *(numbers[name][None] for name in names)])


def _together(numbers: Mapping[str, Tensor], names: Iterable[str], pairs: int) -> Tensor:
    """Numbers that all pairs share, side by side (PxK)."""
    return torch.stack([numbers[name] for name in names]).expand(pairs, -1)


# ---- one water at several turbidities


@dataclass(frozen=True)
class TurbidityModel(ByCoefficients):
    """Waters that differ in what scatters: what is dissolved stays, what scatters grows.

        β = a + b,  G = a + g·b,  G·V(0) = m·b,  σ = scale·(b̄ z)^exponent

    a, m (μ times the light at the scene) of each colour, g and the width law are those of all
    pictures, b of each colour is that of each level of turbidity.

    Attributes:
        spec: the candidate; if no light is scattered forward, G is that of the veil alone.
        geometry: of the pictures.
        level: of turbidity, of each picture, counted from 0.
        levels: how many there are.
    """

    spec: ModelSpec
    geometry: Geometry
    level: tuple[int, ...]
    levels: int

    @property
    def name(self) -> str:
        """Of the candidate."""
        return self.spec.name

    @cached_property
    def bounds(self) -> dict[str, Bounds]:
        """Bounds of each number that is fitted, by name, in the order of θ."""
        reference, widest = self.geometry.reference, self.geometry.widest
        thickest = MAX_OPTICAL_DEPTH / reference
        bounds = {f"a_{colour}": Bounds(0.0, thickest, 0.3 / reference) for colour in COLOURS}
        for i in range(self.levels):
            for colour in COLOURS:
                bounds[f"b_{colour}_{i + 1}"] = Bounds(0.0, thickest, 1 / reference)
        bounds |= {f"m_{colour}": Bounds(0.0, 10.0, 0.1) for colour in COLOURS}
        bounds["g"] = Bounds(0.0, 1.0, 0.1)
        if self.shape is not None:
            # the widest blur at .1 scattering lengths
            bounds["scale"] = Bounds(0.0, 10 * widest, 0.1 * widest)
            bounds["exponent"] = Bounds(*EXPONENTS, 1.0)
        return bounds

    @cached_property
    def quantities(self) -> list[Quantity]:
        """What is reported: the numbers themselves."""
        rate = (f"1/{self.geometry.unit}", 0.1 / self.geometry.farthest)
        kinds = {"a": rate, "b": rate, "m": ("1", 0.02), "g": ("1", 0.05)}
        kinds |= {"scale": ("px", 0.2), "exponent": ("1", 0.2)}
        return [Quantity(name, *kinds[name.split("_")[0]], (name,)) for name in self.bounds]

    def reported(self, theta: Tensor) -> Tensor:
        """The value of each of `quantities`: θ itself."""
        return 1 * theta

    def scattering(self, theta: Tensor) -> Tensor:
        """The b of each level (levelsx3)."""
        return theta[3 : 3 + 3 * self.levels].reshape(self.levels, 3)

    def coefficients(self, theta: Tensor) -> Coefficients:
        """What pictures depend on; differentiable."""
        return self.at(theta, self.scattering(theta)[torch.tensor(self.level)])

    def at(self, theta: Tensor, b: Tensor) -> Coefficients:
        """The coefficients of waters of any scattering (Px3)."""
        after = 3 + 3 * self.levels
        a, m, g = theta[:3], theta[after : after + 3], theta[after + 3]
        width = exponent = None
        if self.shape is not None:
            lengths = b.mean(1).clamp(min=MIN_SCATTERING) * self.geometry.reference
            exponent = theta[after + 5].expand(len(b))
            width = theta[after + 4] * lengths**exponent
        return Coefficients(a + b, a + g * b, m * b, width, exponent, torch.ones_like(b))

    def media(self, theta: Tensor, b: Tensor) -> Medium:
        """A batch of media of any scattering (Px3)."""
        return self.at(theta, b).media(b.mean(1), self.shape, self.geometry)

    def start(self, alone: Sequence[Coefficients]) -> Array:
        """θ from the coefficients of each level, fitted alone."""
        share, reference = self.bounds["g"].begin, self.geometry.reference
        beta, G, veil_slope = (
            torch.cat([getattr(c, name)[:1] for c in alone]) for name in ("beta", "G", "veil_slope")
        )
        b = ((beta - G) / (1 - share)).clamp(min=0.01 / reference)
        a = (beta - b).clamp(min=0.0).median(0).values
        m = (veil_slope / b).median(0).values
        parts = [a, b.flatten(), m, torch.tensor([share])]
        if self.shape is not None:
            exponent = self.bounds["exponent"].begin
            scales = [
                c.width[0] / (row.mean() * reference) ** exponent
                for c, row in zip(alone, b, strict=True)
                if c.width is not None
            ]
            parts += [torch.stack(scales).median()[None], torch.tensor([exponent])]
        return np.asarray(torch.cat([part.double() for part in parts]))


# ---- the contents of a Jerlov type


@dataclass(frozen=True, eq=False)
class SpectralModel:
    """All pairs were taken in one Jerlov type, or in a mixture of two, with more or less in it.

    Attributes:
        waters: one type or two.
        camera, surfaces, scattering, point_spread: what is known, see `Medium.from_water`.
        depth: the vertical depth, m; None if it is fitted.
        sizes: height and width of each observed picture, px.
        geometry: of the pictures.
        gain: "fixed": the exposure is that of the clean picture. "free": one factor for each
            picture. "matrix": each picture was developed by a colour matrix and a black of its own,
            which are no numbers of θ: they are those that fit the pixels best.
    """

    waters: tuple[Water, ...]
    camera: Camera
    surfaces: Surfaces
    scattering: Scattering
    point_spread: PointSpread
    depth: float | None
    sizes: tuple[tuple[int, int], ...]
    geometry: Geometry
    gain: CameraGain

    @property
    def name(self) -> str:
        """Of the type, or of both."""
        return " + ".join(water.name for water in self.waters)

    @property
    def shape(self) -> Shape:
        """Of the point spread."""
        return self.point_spread.shape

    @cached_property
    def bounds(self) -> dict[str, Bounds]:
        """Bounds of each number that is fitted, by name, in the order of θ; contents by their
        logarithm.
        """
        unseen, reference = math.exp(-MAX_OPTICAL_DEPTH), self.geometry.reference
        most = max(water.contents_for(unseen, reference) for water in self.waters)
        high = math.log(min(max(most, 1.0), _MAX_CONTENTS))
        bounds = {"contents": Bounds(math.log(_MIN_CONTENTS), high, 0.0, log=True)}
        if len(self.waters) == 2:
            bounds["mixing"] = Bounds(0.0, 1.0, 0.5)
        if self.depth is None:
            bounds["vertical_depth"] = Bounds(0.0, _MAX_VERTICAL_DEPTH, 3.0)
        if self.gain == "free":
            bounds |= {f"gain_{i + 1}": Bounds(1e-3, 1e3, 1.0) for i in range(len(self.sizes))}
        return bounds

    def _numbers(self, theta: Array) -> dict[str, float]:
        return dict(zip(self.bounds, theta.tolist(), strict=True))

    def water(self, theta: Array) -> Water:
        """The water of these numbers."""
        numbers, water = self._numbers(theta), self.waters[0]
        if len(self.waters) == 2:
            water = water.mix(self.waters[1], min(max(numbers["mixing"], 0.0), 1.0))
        return water.with_contents(math.exp(numbers["contents"]))

    def vertical_depth(self, theta: Array) -> float:
        """Below the surface, m, fitted or known."""
        if self.depth is not None:
            return self.depth
        return max(self._numbers(theta)["vertical_depth"], 0.0)

    def medium(self, theta: Array, tolerance: float = 0.0) -> Medium:
        """The medium of these numbers; by default with all bands: fewer rates jump as numbers
        change.
        """
        return Medium.from_water(
            self.water(theta),
            self.camera,
            vertical_depth=self.vertical_depth(theta),
            g=self.scattering.g,
            mu=self.scattering.mu,
            point_spread=self.point_spread,
            tolerance=tolerance,
            surfaces=self.surfaces,
        )

    def gains(self, theta: Array) -> Tensor:
        """Of each picture, where they are fitted."""
        return torch.from_numpy(theta[-len(self.sizes) :])

    def sigma(self, medium: Medium, z: Tensor) -> Tensor:
        """Widths (Px1x1xN) of the forward scatter, px, at distances of that shape."""
        lengths, law = medium.lengths(z), medium.point_spread
        return torch.cat([law.sigma(lengths[i : i + 1], size) for i, size in enumerate(self.sizes)])

    def render(self, theta: Array, pixels: Pixels, tolerance: float = 0.0) -> Tensor:
        """The pixels (Px3x1xN) in linear light."""
        medium, grid = self.medium(theta, tolerance), pixels.grid
        direct, scatter, veil = (
            curve @ (grid.weights if curve.ndim == 4 else grid.weights[:, None])
            for curve in curves(medium.sums(exact_at_lens=True), grid.z)
        )
        plan, blurs, _ = pixels.stacks[self.shape]
        blur = mixed(blurs, node_weights(self.sigma(medium, pixels.z), plan))
        light = passed(direct, pixels.clean) + passed(scatter, blur) + veil
        return self.as_taken(light, self.gains(theta), pixels.observed, pixels.weights)

    def as_taken(self, light: Tensor, gains: Tensor, observed: Tensor, weights: Tensor) -> Tensor:
        """Light as the cameras of the observed pixels have taken it; see `developed` for shapes.

        gains (P): of the pictures, if they are fitted.
        """
        if self.gain == "free":
            light = gains.reshape(-1, 1, 1, 1) * light
        elif self.gain == "matrix":
            light = developed(light, observed, weights)
        # a file holds no negative light, which surfaces with spectra have
        return light.masked_fill((observed == 0) & (light < 0), 0.0)

    def jacobian(self, theta: Array, pixels: Pixels) -> tuple[Tensor, Tensor]:
        """The pixels, and their derivatives by θ (Px3x1xNxn), by differences."""
        here = self.render(theta, pixels)
        columns = []
        for i, bound in enumerate(self.bounds.values()):
            moved = theta.copy()
            # into the range
            moved[i] += _STEP if theta[i] + _STEP <= bound.high else -_STEP
            columns.append((self.render(moved, pixels) - here) / (moved[i] - theta[i]))
        return here, torch.stack(columns, -1)

    @cached_property
    def quantities(self) -> list[Quantity]:
        """What is reported: visibility, contents, vertical depth, mixing, gains."""
        rows = [
            Quantity("visibility", "m", 0.0, tuple({"contents", "mixing"} & self.bounds.keys())),
            Quantity("contents", "1", 0.05, ("contents",)),
            Quantity("vertical_depth", "m", 0.5, ("vertical_depth",)),
        ]
        return rows + [
            Quantity(name, "1", 0.05, (name,))
            for name in self.bounds
            if name.startswith(("gain", "mix"))
        ]

    def report(self, theta: Array) -> Array:
        """The value of each of `quantities`."""
        numbers = self._numbers(theta)
        numbers["visibility"] = self.water(theta).visibility()
        numbers["contents"] = math.exp(numbers["contents"])
        numbers["vertical_depth"] = self.vertical_depth(theta)
        return np.array([numbers[quantity.name] for quantity in self.quantities])

    def report_jacobian(self, theta: Array) -> Array:
        """Derivatives of `report` by θ (quantities x n), by differences."""
        columns = []
        for i, bound in enumerate(self.bounds.values()):
            up, down = theta.copy(), theta.copy()
            up[i] = min(theta[i] + _REPORT_STEP, bound.high)
            down[i] = max(theta[i] - _REPORT_STEP, bound.low)
            columns.append((self.report(up) - self.report(down)) / (up[i] - down[i]))
        return np.array(columns).T


def developed(light: Tensor, observed: Tensor, weights: Tensor) -> Tensor:
    """Light by the colour matrix and the black of each picture that bring it nearest to the
    observed pixels; all are Px3x1xN, or weights Px1x1xN.
    """
    terms = torch.cat([light, torch.ones_like(light[:, :1])], 1)[:, :, 0].mT  # PxNx4
    observed = observed[:, :, 0, :, None]
    weights = weights[:, :, 0, :, None] * (observed != 0)  # 0 may stand for negative light
    columns = weights * terms[:, None]  # Px3xNx4
    # what weighs nothing everywhere leaves a matrix that is singular
    normal = columns.mT @ columns + _RIDGE * torch.eye(4, dtype=light.dtype)
    matrix = torch.linalg.solve(normal, columns.mT @ (weights * observed))  # Px3x4x1
    fitted: Tensor = (terms[:, None] @ matrix)[..., 0][:, :, None]
    return fitted
