"""`fit_water`: which Jerlov water lies between a clean and a degraded picture."""

import math
import os
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, Literal, get_args

import numpy as np

from uwaug._support import checks
from uwaug._support.types import Array, ColorSpace
from uwaug.fitting.choice import Tried, choose, tried_of
from uwaug.fitting.inputs import (
    Pictures,
    bits_of,
    distances_apart,
    geometry_of,
    pairs_of,
    require_pixels,
)
from uwaug.fitting.noise import Noise
from uwaug.fitting.one_water import OneWater
from uwaug.fitting.pixels import Pair, Pixels, gather, thinned
from uwaug.fitting.search import Search
from uwaug.fitting.solve import Problem, loss, solve
from uwaug.fitting.spectral import OneType, Optics, SpectralProblem
from uwaug.fitting.structure import MODELS
from uwaug.fitting.threads import one_thread
from uwaug.fitting.uncertainty import spread
from uwaug.fitting.water_report import Found, reported
from uwaug.fitting.water_result import WaterFit
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import JERLOV_TYPES, Water

__all__ = ["fit_water"]

Progress = Callable[[str], None]
OneGain = Literal["fixed", "free"]

_PAPER = {"g": 0.2, "mu": 0.3}
_CALIBRATED = {"g": 0.05, "mu": 0.075}
"""What goes with `PointSpread.calibrated`."""

_SEEN = np.geomspace(0.4, 25.0, 8)
"""Visibilities to begin at, in multiples of the median distance."""

_DEPTHS = (0.5, 3.0, 10.0)
"""Vertical depths to begin at, m."""

_FEW = 1000
"""Pixels of the fits that others begin from."""

_FEWEST = 500
"""Values between noise and white, of all that are fitted, that a fit needs."""

_SURELY = 2.0
"""Standard errors, by which a mixture is neither of its ends."""

_LEAST_SHARE = 0.05
"""Of a type in a mixture: media of the default tolerance make up for .02."""

_PAIRS = tuple(pairwise(JERLOV_TYPES))
_CANDIDATES = (*((name,) for name in JERLOV_TYPES), *_PAIRS)
"""The types, and mixtures of neighbours. Without these, a picture of half 1C and half 3C would be
type 3C, 7 % off in visibility, and one of half III and half 1C would be none. (Those of the best
type alone miss three of eight.)
"""


def fit_water(
    clean: Pictures,
    observed: Pictures,
    distance: Pictures,
    *,
    camera: "str | os.PathLike[str] | Camera" = "Nikon 5100 (NPL)",
    vertical_depth: float | None = None,
    focal_px: float | None = None,
    point_spread: PointSpread | None = None,
    g: float | None = None,
    mu: float | None = None,
    field: Pictures | None = None,
    mask: Pictures | None = None,
    color_space: ColorSpace = "srgb",
    gain: OneGain = "fixed",
    noise: Noise | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    pixels: int = 5000,
) -> WaterFit:
    """Which Jerlov water a scene lies in: the type, or the mixture of two neighbouring types, and
    how much is in it.

    Each of the ten types, and each mixture of neighbours in the order of `JERLOV_TYPES`, is fitted
    by its contents, by vertical depth and gain if these are free, by its spectra and the camera's,
    through `Medium.from_water`. That which foretells left-out parts of the picture best is taken;
    a type before a mixture, unless the mixture is better by more than one standard error.

    Args:
        clean (3xHxW or Bx3xHxW tensor, or a sequence): the scene without water; uint8 (0…255) or
            floating point (0…1). One serves all observed pictures, which are of one water.
        observed (as clean): the scene in the water, aligned with `clean` to the pixel.
        distance (1xHxW or Bx1xHxW tensor, or a sequence): metres along the ray; pixels that are
            NaN, 0 or negative are left out; +inf is open water.
        camera: as of `Medium.from_water`. A wrong one gives a wrong water.
        vertical_depth: of the scene below the surface, m; None: it is fitted, 0…30 m.
        focal_px: focal length, px: the width law is `PointSpread.calibrated(focal_px)`, which goes
            with g = .05 and μ = .075.
        point_spread: the width law; without it and without `focal_px`, `PointSpread.paper()`.
        g: share of the scattered light that leaves the line of sight; None: .05 with `focal_px`,
            else .2, as of `Medium.from_water`. One picture does not tell g and μ from the water: a
            picture made with .05 and .075 in 3C passes for IA + IB with .2 and .3.
        mu: share of the scattered light that is sent towards the camera; None: .075 with
            `focal_px`, else .3.
        field (as distance): medium field, multiplies the distance.
        mask (as distance): true or > 0 where pixels count.
        color_space: "srgb", or "linear" for linear light. All numbers refer to linear light.
        gain: "fixed": both pictures have one exposure. "free": a factor for each observed picture.
        noise: of the observed pictures; None learns it from a fit that is free in every channel.
        seed: of the pixels that are drawn, and of random starts.
        progress: is called with a line on what is being tried.
        pixels: how many are fitted, spread evenly over the distances; at most 100 000.

    Returns:
        Type, water, visibility and depth, with errors; all types; what cannot be told, in words.

    Raises:
        TypeError, ValueError: if an input does not suit; if fewer than 500 pixels can be used, too
            few lie above the noise, the distances are all alike, or clean and observed are one
            picture.

    On a scene of 500×741 px at 2 to 5 m with 1 % noise in 8 bits, at the types' own visibilities
    and at 6 m (30 m of I and IA), all ten types are found, visibilities within .2 % (.7 % in type
    I), depths within .04 m. With a free gain, one 7C at 6 m passes for a mixture of 5C and 7C, and
    visibilities are within .2 % (1.3 % in I and IA), depths within .06 m otherwise. Mixtures of
    half and half come back within .02. 6 to 8 s on one thread. Types that would need a hundred
    times their contents to be so turbid leave no light to fit.

    Source: spectra: Solonenko and Mobley 2015, see `Water.jerlov`; choice: see `uwaug.fit`.

    Examples:
        >>> import torch, uwaug
        >>> clean, z = torch.rand(3, 60, 80), torch.linspace(1, 6, 4800).reshape(1, 60, 80)
        >>> observed = uwaug.Underwater(uwaug.Medium.from_water("5C"))(clean, z)
        >>> found = uwaug.fitting.fit_water(clean, observed, z, vertical_depth=1.0, pixels=500)
        >>> found.type
        '5C'
    """
    optics = _optics(camera, focal_px, point_spread, g, mu)
    checks.one_of("color_space", color_space, get_args(ColorSpace))
    checks.one_of("gain", gain, get_args(OneGain))
    if vertical_depth is not None:
        checks.within("vertical_depth", vertical_depth, *checks.DOMAIN["vertical_depth"])
    if noise is not None:
        checks.instance("noise", noise, Noise)
    checks.within("pixels", pixels, 500, 100_000)
    pairs = pairs_of(clean, observed, distance, field, mask, color_space)
    require_pixels(pairs)
    distances_apart(pairs)
    say = progress or (lambda _: None)
    search = Search(color_space, True, seed, {}, say, bits_of(observed))
    with one_thread():
        search.say("blurring the clean picture")
        drawn = gather(pairs, [optics.law.shape], int(pixels), np.random.default_rng(seed))
        search.say("learning the noise")
        rival = _rival(pairs, optics)
        few = thinned(search.rough(drawn, noise), _FEW, np.random.default_rng(seed))
        theta = search.begun(Problem(rival, few)).theta
        weighed, known = search.learnt(rival, theta, drawn, noise)
        _require_light(weighed)
        freely = Problem(rival, weighed)
        free = tried_of(freely, solve(freely, theta), seed)
        tried = _each(pairs, weighed, search, optics, vertical_depth, gain)
        return reported(Found(choose(tried), tried, free, known))


def _each(
    pairs: Sequence[Pair],
    pixels: Pixels,
    search: Search,
    optics: Optics,
    depth: float | None,
    gain: OneGain,
) -> list[Tried[Any]]:
    """The types, and the mixtures that are none of them, fitted."""
    few = thinned(pixels, _FEW, np.random.default_rng(search.seed))
    tried, least = [], math.inf
    for names in _CANDIDATES:
        search.say(f"fitting {' + '.join(names)}")
        structure = OneType(
            waters=tuple(Water.jerlov(name) for name in names),
            optics=optics,
            depth=depth,
            sizes=tuple(pair.size for pair in pairs),
            reference=pixels.reference,
            gain=gain == "free",
        )
        roughly = SpectralProblem(structure, few)
        near = solve(roughly, _begin(roughly))
        mixture = len(names) == 2
        if mixture and near.cost > least:
            continue
        problem = SpectralProblem(structure, pixels)
        one = tried_of(problem, solve(problem, near.theta), search.seed)
        if not mixture:
            least = min(least, near.cost)
        if not mixture or _mixed(one):
            tried.append(one)
    return tried


def _require_light(pixels: Pixels) -> None:
    """Refuse pictures of which too few values lie above the noise and below white."""
    found = int((pixels.weights > 0).sum())
    if found < _FEWEST:
        cure = "raise the exposure, or give the noise if it is known"
        got = f"{found} of {pixels.weights.numel()} values that are fitted"
        expected = f"expected {_FEWEST}"
        raise ValueError(f"observed: only {got} lie above the noise, {expected}: {cure}")


def _mixed(tried: Tried[Any]) -> bool:
    """Whether a mixture is surely neither of its ends, which are candidates of their own."""
    place = list(tried.structure.bounds).index("mixing")
    share = tried.solution.theta[place]
    error = np.sqrt(spread(tried.problem, tried.solution).covariance[place, place])
    margin = max(_SURELY * error, _LEAST_SHARE)
    return bool(margin < share < 1 - margin)


def _optics(
    camera: "str | os.PathLike[str] | Camera",
    focal_px: float | None,
    point_spread: PointSpread | None,
    g: float | None,
    mu: float | None,
) -> Optics:
    law, numbers = PointSpread.paper(), _PAPER
    if focal_px is not None:
        if point_spread is not None:
            raise ValueError("point_spread and focal_px: expected one of the two, got both")
        law, numbers = PointSpread.calibrated(focal_px), _CALIBRATED
    if point_spread is not None:
        checks.instance("point_spread", point_spread, PointSpread)
        law = point_spread
    numbers = {"g": numbers["g"] if g is None else g, "mu": numbers["mu"] if mu is None else mu}
    for name, value in numbers.items():
        checks.within(name, value, *checks.DOMAIN[name])
    return Optics(load_camera(camera), law=law, **numbers)


def _rival(pairs: Sequence[Pair], optics: Optics) -> OneWater:
    """A model that is free in every channel."""
    geometry = geometry_of(pairs, None, relative=False)
    return OneWater(MODELS[optics.law.shape], geometry, "channels", optics.g, {})


def _begin(problem: SpectralProblem) -> Array:
    """The best of a grid of visibilities and depths, at gains by linear least squares."""
    structure: OneType = problem.structure
    water = structure.waters[0]
    best, least = np.zeros(0), math.inf
    low, high = problem.limits
    for metres in _SEEN * structure.reference:
        contents = max(water.contents_for(0.02, metres), 1e-3)
        for depth in _DEPTHS if structure.depth is None else (0.0,):
            numbers = {"contents": math.log(contents), "mixing": 0.5, "vertical_depth": depth}
            theta = np.array([numbers.get(name, 1.0) for name in structure.bounds])
            theta = np.clip(theta, low, high)
            if structure.gain:
                theta[-len(structure.sizes) :] = _gains(problem, theta)
            cost = float(loss(problem.residual(theta), problem.robust).sum())
            if cost < least:
                best, least = theta, cost
    return best


def _gains(problem: SpectralProblem, theta: Array) -> Array:
    pixels = problem.pixels
    light = problem.model(theta) * pixels.weights
    seen = pixels.observed * pixels.weights
    gain = (light * seen).sum((1, 2, 3)) / (light * light).sum((1, 2, 3)).clamp(min=1e-300)
    return gain.clamp(1e-3, 1e3).numpy()
