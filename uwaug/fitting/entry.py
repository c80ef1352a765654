"""`fit`: which water lies between a clean and a degraded picture."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import get_args

import numpy as np

from uwaug._support import checks
from uwaug._support.types import ColorSpace
from uwaug.fitting.choice import choose
from uwaug.fitting.finish import finished
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
from uwaug.fitting.pixels import gather
from uwaug.fitting.result import Fit
from uwaug.fitting.search import Search
from uwaug.fitting.structure import COLOURS, MODELS, Gain, Geometry
from uwaug.fitting.threads import one_thread

__all__ = ["fit"]

Progress = Callable[[str], None]

_SHARES = {"paper": 0.2}
"""g of the laws that have one of their own; `_SHARE` for the others."""
_SHARE = 0.05


def fit(
    clean: Pictures,
    observed: Pictures,
    distance: Pictures,
    *,
    field: Pictures | None = None,
    model: str = "auto",
    fixed: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    mask: Pictures | None = None,
    color_space: ColorSpace = "srgb",
    gain: Gain = "fixed",
    noise: Noise | None = None,
    robust: bool = True,
    seed: int = 0,
    progress: Progress | None = None,
    focal_px: float | None = None,
    g: float | None = None,
    pixels: int = 20_000,
    relative: bool = False,
) -> Fit:
    """Recover a water from pictures of one scene without it and in it.

    Args:
        clean (3xHxW or Bx3xHxW tensor, or a sequence): the scene without water; uint8 (0…255) or
            floating point (0…1). One serves all observed pictures.
        observed (as clean): the scene in the water, aligned with `clean` to the pixel.
        distance (1xHxW or Bx1xHxW tensor, or a sequence): metres along the ray; pixels that are
            NaN, 0 or negative are left out; +inf is open water.
        field (as distance): medium field, multiplies the distance.
        model: "auto" tries all and takes the one of the fewest numbers that foretells pixels which
            it was not fitted to as well as any (one-standard-error rule, on blocks of the picture).
            Or one of them: "attenuation" (direct light alone), "haze" (direct light and veil, one
            coefficient), "veil" (a coefficient for each), and with forward scatter "paper",
            "calibrated" (their width laws), "gaussian", "exponential" (a width law of their own).
        fixed: numbers that are known, by the names in `Fit.parameters`, such as {"G_red": .3}:
            beta, G, veil of a colour, width, exponent.
        start: where to begin, by the same names; everything else is guessed.
        mask (as distance): true or > 0 where pixels count.
        color_space: "srgb", or "linear" for linear light. All numbers refer to linear light.
        gain: "fixed": both pictures have one exposure. "free": a factor for each observed picture.
            "channels": one for each of its colours, as where the scene lies deep.
        noise: of the observed pictures; None learns it from the residuals.
        robust: let residuals beyond two standard deviations count less than their squares.
        seed: of the pixels that are drawn, and of random starts.
        progress: is called with a line on what is being tried.
        focal_px: focal length, px; "calibrated" needs it, and is not tried without.
        g: share of the scattered light that leaves the line of sight: with it a and b follow from β
            and G. None: .2 with the paper's law, else .05.
        pixels: how many are fitted, spread evenly over the distances; at most 100 000.
        relative: the distances are of unknown scale: rates are in 1/unit, not 1/m.

    Returns:
        The fit: numbers, errors, what the pictures cannot tell.

    Raises:
        TypeError, ValueError: if an input does not suit; if fewer than 500 pixels can be used, the
            distances are all alike, or clean and observed are one picture.

    Source: sandwich covariance: White 1982, over clusters, Liang and Zeger 1986; one-standard-error
    rule: Breiman et al. 1984.

    Examples:
        >>> import torch, uwaug
        >>> clean, z = torch.rand(3, 60, 80), torch.linspace(1, 6, 4800).reshape(1, 60, 80)
        >>> beta, veil = (0.5, 0.2, 0.3), (0.1, 0.3, 0.4)
        >>> water = uwaug.Medium.from_coefficients(beta, beta, veil)
        >>> observed = uwaug.Underwater(water)(clean, z)
        >>> found = uwaug.fit(clean, observed, z, model="haze")
        >>> round(found.parameters["beta_red"].value, 2)
        0.5
    """
    if model != "auto":
        checks.one_of("model", model, ("auto", *MODELS))
    checks.one_of("color_space", color_space, get_args(ColorSpace))
    checks.one_of("gain", gain, get_args(Gain))
    if noise is not None:
        checks.instance("noise", noise, Noise)
    if focal_px is not None:
        checks.positive("focal_px", focal_px, "px")
    elif model == "calibrated":
        raise ValueError("focal_px: the calibrated width law needs the focal length in px")
    if g is not None:
        checks.within("g", g, 0.0, 0.99)
    checks.within("pixels", pixels, 500, 100_000)
    checks.within("seed", seed, 0)
    pairs = pairs_of(clean, observed, distance, field, mask, color_space, relative=relative)
    require_pixels(pairs)
    distances_apart(pairs)
    geometry = geometry_of(pairs, focal_px, relative=relative)
    structures = _structures(model, geometry, gain, g, fixed or {})
    begin = _checked("start", start or {}, structures)
    say = progress or (lambda _: None)
    search = Search(color_space, bool(robust), int(seed), begin, say, bits_of(observed))
    with one_thread():
        search.say("blurring the clean picture")
        shapes = sorted({one.shape for one in structures if one.shape is not None})
        drawn = gather(pairs, shapes, int(pixels), np.random.default_rng(seed))
        weighed, found = search.weighed(structures, drawn, noise)
        tried = search.each(structures, weighed)
        chosen = choose(tried)
        if gain != "fixed" and model == "auto":
            search.say("fitting without a gain")
            tried += search.each([replace(chosen.structure, gain="fixed")], weighed)
            chosen = choose([chosen, tried[-1]])
        return finished(chosen, tried, found, pairs, search.gain_of(chosen))


def _structures(
    model: str, geometry: Geometry, gain: Gain, g: float | None, fixed: Mapping[str, float]
) -> list[OneWater]:
    """The candidates in which all that is fixed has a place."""
    found = []
    for one in MODELS.values():
        if model in ("auto", one.name) and (one.law != "calibrated" or geometry.focal_px):
            share = _SHARES.get(one.law or "", _SHARE) if g is None else g
            found.append(OneWater(one, geometry, gain, float(share), {}))
    known = _checked("fixed", fixed, found)
    fixable = []
    for structure in found:
        candidate = replace(structure, fixed=known)
        if set(known) <= set(structure.fixable) and candidate.bounds:
            fixable.append(candidate)
    if not fixable:
        raise ValueError(f"fixed: nothing is left to be fitted, got {', '.join(known)}")
    return fixable


def _checked(
    name: str, given: Mapping[str, float], structures: Sequence[OneWater]
) -> dict[str, float]:
    """Numbers by name, as a candidate knows them."""
    if not isinstance(given, Mapping):
        raise TypeError(f"{name} must be a dict of numbers, got {type(given).__name__}")
    names = [set(one.fixable) for one in structures]
    if not any(set(given) <= known for known in names):
        wanted = ", ".join(structures[-1].fixable)
        raise ValueError(f"{name}: expected some of {wanted}, got {', '.join(map(str, given))}")
    for key, value in given.items():
        least = 0.2 if key == "exponent" else 0.0
        most = structures[-1].geometry.widest if key == "width" else 1e6
        checks.within(f"{name}[{key!r}]", value, least, most)
    for colour in COLOURS:
        beta, G = given.get(f"beta_{colour}"), given.get(f"G_{colour}")
        if beta is not None and G is not None and beta < G and structures[-1].model.law:
            raise ValueError(f"{name}: expected G_{colour} ≤ beta_{colour}, got {G} and {beta}")
    return {key: float(value) for key, value in given.items()}
