"""What a fit has found, in words: which model, how well it explains the pictures, what they cannot
tell and why. Each check is a predicate and its sentence; four tables at the end say which of them a
result goes through, in their order.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from uwaug.fitting.data import widest_blur
from uwaug.fitting.errors import ClusterCovariance
from uwaug.fitting.models import COLOURS, CoefficientModel, SpectralModel, TurbidityModel
from uwaug.fitting.results import JerlovType, Line, Parameter
from uwaug.fitting.selection import FittedModel, best_of

_THIN = 0.3
"""Optical depth G·z at the far end, below which a veil is still a straight line."""

_HALF_GROWN = 1.0
"""Optical depth G·z at the far end, below which surfaces that are not quite black bend a veil as
much as its end does.
"""

_DEPENDENT = 1.5
"""Ratio of standard errors over clusters to those of independent residuals, above which the model
misses something.
"""

_POOR = 0.8
"""Share of the observed variance, below which a model does not explain a picture."""

_NEAREST = 0.05
"""m, median distance; nearer scenes are rare."""

_FASTEST = 30.0
"""1/m; no natural water attenuates more."""

_ALMOST = 0.95
"""Of the widest blur."""

_ALIKE = 0.03
"""Smallest singular value of the scaled Jacobian where two numbers do nearly the same."""

_UNLIKELY = 0.05 / 3
"""Probability, below which scattering does not follow turbidity; there are three colours."""

_UNLIKE = 1.25
"""Ratio of held-out errors to those of coefficients that are free in every channel: above, no
Jerlov water explains a picture. Jerlov waters reach 1.002, a wrong g or μ 1.2, grey water, wrong
cameras and wrong exposures 1.5 to 5.
"""

_NOT_QUITE = 1.02
"""Ratio above which none is quite right."""

_UNSEEN = 0.001
"""RMS of linear light: the default tolerance of a medium puts pictures .0007 off."""

_CLAMPED = 0.01
"""Share of the pixels at which blurs are wider than any that was made."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a diagnosis is made from.

    Attributes:
        parameters: what is reported.
        fitted: the candidate that was taken; None of a veil without a clean picture.
        tried: all candidates.
        covariance: of the one that was taken.
        gain: of the observed pictures, if one explains them much better than none.
        lines: scattering against turbidity, by colour.
        candidates: what is reported of the Jerlov types.
        free: a model that is free in every channel, which Jerlov types are compared with.
        G, farthest: of the veil of each colour, 1/m, and the distance that it is seen to, m.
    """

    parameters: Mapping[str, Parameter]
    fitted: FittedModel[Any] | None = None
    tried: Sequence[FittedModel[Any]] = ()
    covariance: ClusterCovariance | None = None
    gain: float | None = None
    lines: Mapping[str, Line] = field(default_factory=dict)
    candidates: Sequence[JerlovType] = ()
    free: FittedModel[Any] | None = None
    G: Sequence[float] = ()
    farthest: float = 0.0

    @property
    def taken(self) -> FittedModel[Any]:
        """The candidate, where there is one."""
        assert self.fitted is not None
        return self.fitted

    def named(self, state: str) -> list[str]:
        """The names of the parameters in a state."""
        return [name for name, number in self.parameters.items() if number.state == state]


Check = Callable[[Evidence], str | None]


def diagnosis(checks: Sequence[Check], evidence: Evidence) -> str:
    """The sentences that hold, a line each."""
    return "\n".join(sentence for check in checks if (sentence := check(evidence)))


def straight(G: float, farthest: float) -> bool:
    """Whether a veil still grows as a straight line at the far end, so that its end is not seen."""
    return G * farthest < _THIN


# ---- of coefficients


def _which_model(e: Evidence) -> str:
    model: CoefficientModel = e.taken.model
    words = f"Model {model.name!r}: {model.spec.words}."
    if len(e.tried) == 1:
        return words
    best = best_of(e.tried)
    if best is e.taken:
        return f"{words} It foretells left-out pixels best."
    return f"{words} The fewest numbers within one standard error of the best, {best.name!r}."


def _residual(e: Evidence) -> str:
    share = f"{100 * np.floor(1e4 * e.taken.explained) / 1e4:.4g} %"
    return (
        f"The residual is {e.taken.rms:.2g} RMS of linear light; {share} of the variance of the "
        "observed pixels is explained."
    )


def _design_effect(e: Evidence) -> float:
    return 1.0 if e.covariance is None else e.covariance.design_effect


def _poor(e: Evidence) -> str | None:
    if e.taken.explained >= _POOR or _design_effect(e) <= _DEPENDENT:
        return None
    return "That is little: are the pictures aligned, of one exposure (gain), and in metres?"


def _dependent(e: Evidence) -> str | None:
    if _design_effect(e) <= _DEPENDENT:
        return None
    return (
        f"Residuals of neighbouring pixels depend on each other: errors are "
        f"{_design_effect(e):.1f} times those of independent noise. The model misses something, "
        "such as wrong distances, another exposure, uneven water or light, or more than one rate "
        "for a colour"
    )


def _gain(e: Evidence) -> str | None:
    if e.gain is None:
        return None
    return (
        f"A gain of {e.gain:.3g} explains the pictures much better: were both taken with one "
        "exposure? If not, see the argument gain."
    )


def _odd_units(e: Evidence) -> str | None:
    geometry = e.taken.model.geometry
    rates = [e.parameters[f"beta_{colour}"].value or 0.0 for colour in COLOURS]
    if geometry.unit != "m" or (geometry.reference >= _NEAREST and max(rates) <= _FASTEST):
        return None
    return (
        f"The median distance is {geometry.reference:.3g} m and the largest β {max(rates):.3g}/m: "
        "are the distances in metres?"
    )


def _widest_blur(e: Evidence) -> str | None:
    geometry = e.taken.model.geometry
    c = e.taken.model.coefficients(torch.from_numpy(e.taken.theta))
    if c.width is None or c.exponent is None:
        return None
    far = (geometry.farthest / geometry.reference) ** float(c.exponent[0])
    if float(c.width[0]) * far < _ALMOST * geometry.widest:
        return None
    return (
        f"The blur reaches the widest that a fit holds, {geometry.widest:.3g} px: width law, β and "
        "G may be off by more than their errors."
    )


def _not_identified(e: Evidence) -> str | None:
    names = e.named("not identified")
    return f"Not identified: {', '.join(names)}." if names else None


def _alike(e: Evidence) -> str | None:
    covariance = e.covariance
    if covariance is None or not (
        covariance.null_space.size
        or covariance.idle.any()
        or (covariance.singular.size and covariance.singular[-1] < _ALIKE)
    ):
        return None
    return "Some numbers do nearly the same to these pictures: see the correlation."


def _straight_veil(e: Evidence) -> str | None:
    geometry, colours = e.taken.model.geometry, []
    for colour in COLOURS:
        G = e.parameters.get(f"G_{colour}", e.parameters[f"beta_{colour}"])
        source = e.parameters.get(f"source_{colour}")
        lost = f"veil_{colour}" in e.named("not identified")
        seen = source is not None and source.value is not None
        if lost and seen and straight(G.value or 0.0, geometry.farthest):
            colours.append(colour)
    if not colours:
        return None
    return (
        f"In {', '.join(colours)} the veil still grows as a straight line at "
        f"{geometry.farthest:.3g} {geometry.unit}: its growth (source) is seen, where it ends is "
        "not."
    )


def _at_bounds(e: Evidence) -> str | None:
    names = e.named("at bound")
    if not names:
        return None
    return f"At the end of what they may be: {', '.join(names)}; the interval has one open side."


def _negative_absorption(e: Evidence) -> str | None:
    colours = [c for c in COLOURS if f"a_{c}" in e.parameters]
    negative = [c for c in colours if (e.parameters[f"a_{c}"].value or 0.0) < 0]
    if not negative:
        return None
    return (
        f"Absorption is negative in {', '.join(negative)}: g = {e.taken.model.g:g} is more than "
        "these pictures allow, or the model does not suit them."
    )


def _no_scale(e: Evidence) -> str | None:
    if e.taken.model.geometry.unit == "m":
        return None
    return (
        "The scale of the distances is unknown, and so is that of the rates: β times the scale is "
        "what a picture shows."
    )


def _unsettled(e: Evidence) -> str | None:
    if e.taken.solution.converged:
        return None
    return "The fit stopped before it settled: give a start, or fewer free numbers."


# ---- of a series of turbidities


def _which_series(e: Evidence) -> str:
    model: TurbidityModel = e.taken.model
    return f"Model {model.name!r}. {_residual(e)}"


def _untested(e: Evidence) -> str | None:
    colours = [colour for colour, line in e.lines.items() if line.probability is None]
    if not colours:
        return None
    return (
        f"In {', '.join(colours)} two turbidities or fewer have a known b, which lie on any line: "
        "a third would test it."
    )


def _follows_turbidity(e: Evidence) -> str | None:
    odds = {c: x.probability for c, x in e.lines.items() if x.probability is not None}
    off = [colour for colour, probability in odds.items() if probability < _UNLIKELY]
    if off:
        return f"Scattering does not follow turbidity on a line in {', '.join(off)}."
    return "Scattering follows turbidity on a line, within its errors." if odds else None


# ---- of a Jerlov water


def _which_water(e: Evidence) -> str:
    model: SpectralModel = e.taken.model
    mixed = len(model.waters) == 2
    words = f"A mixture of Jerlov types {model.name}" if mixed else f"Jerlov type {model.name}"
    seen = e.parameters["visibility"]
    if seen.value is None:
        return f"{words}."
    error = "" if seen.error is None else f" ± {seen.error:.2g}"
    return f"{words}, visibility {seen.value:.4g}{error} m."


def _types_alike(e: Evidence) -> str:
    alike = [x.name for x in e.candidates if not x.told_apart and x.name != e.taken.name]
    if not alike:
        return "All others foretell left-out pixels worse by more than one standard error."
    return f"Within one standard error, these foretell as well: {', '.join(alike)}."


def _no_jerlov_water(e: Evidence) -> str | None:
    assert e.free is not None
    best, free = best_of(e.tried), e.free
    ratio = best.error / max(free.error, 1e-9)
    behind, error = best.delta_loss(free)
    missed = max(best.rms**2 - free.rms**2, 0.0) ** 0.5
    if ratio < _NOT_QUITE or behind < 2 * error or missed < _UNSEEN:
        return None
    than = f"left-out pixels are {ratio:.3g} times as far off as with coefficients free in every"
    causes = "camera, g, μ, exposure (gain), white balance, and distances in metres"
    if ratio < _UNLIKE:
        return f"No type is quite right: {than} channel. Errors do not count that; check {causes}."
    return (
        f"No Jerlov water explains this picture: {than} channel, for which see uwaug.fit. Do not "
        f"rely on type and numbers; check {causes}."
    )


def _clamped(e: Evidence) -> str | None:
    model: SpectralModel = e.taken.model
    pixels = e.taken.objective.pixels
    widest = max(widest_blur(size) for size in model.sizes)
    used = (pixels.weights > 0).any(1, keepdim=True)
    sigma = model.sigma(model.medium(e.taken.theta), pixels.z)
    share = float((sigma[used] > widest).double().mean())
    if share < _CLAMPED:
        return None
    return (
        f"At {100 * share:.0f} % of the pixels the width law asks for more than the widest blur, "
        f"{widest:.3g} px, which may bias type and numbers: leave the far ones out with a mask."
    )


# ---- of a veil without a clean picture


def _estimate(e: Evidence) -> str:
    return (
        "An estimate: the darkest pixels at each distance are taken for black. What their surfaces "
        "reflect counts as veil, and is hardly part of the errors."
    )


def _straight_dark(e: Evidence) -> str | None:
    colours = [c for c, G in zip(COLOURS, e.G, strict=True) if straight(G, e.farthest)]
    if not colours:
        return None
    return (
        f"In {', '.join(colours)} the veil still grows as a straight line at {e.farthest:.3g} m: "
        "its growth (source) is seen, where it ends is not."
    )


def _half_grown(e: Evidence) -> str | None:
    colours = [
        colour
        for colour, G in zip(COLOURS, e.G, strict=True)
        if e.parameters[f"veil_{colour}"].value is not None and G * e.farthest < _HALF_GROWN
    ]
    if not colours:
        return None
    return (
        f"In {', '.join(colours)} the veil is far from its end at {e.farthest:.3g} m: V(0) may be "
        "off by half, and G more; up to there the veil itself (backscatter) is better known."
    )


FIT: tuple[Check, ...] = (
    _which_model,
    _residual,
    _poor,
    _dependent,
    _gain,
    _odd_units,
    _widest_blur,
    _not_identified,
    _alike,
    _straight_veil,
    _at_bounds,
    _negative_absorption,
    _no_scale,
    _unsettled,
)
SERIES: tuple[Check, ...] = (
    _which_series,
    _untested,
    _follows_turbidity,
    _dependent,
    _not_identified,
    _at_bounds,
    _unsettled,
)
WATER: tuple[Check, ...] = (
    _which_water,
    _types_alike,
    _residual,
    _no_jerlov_water,
    _not_identified,
    _at_bounds,
    _clamped,
    _unsettled,
)
VEIL: tuple[Check, ...] = (_estimate, _not_identified, _straight_dark, _half_grown)
