"""What a fit has found, in words: which model, how well it explains the pictures, what they cannot
tell and why.
"""

import torch

from uwaug.fitting.choice import Tried, best_of
from uwaug.fitting.one_water import OneWater
from uwaug.fitting.report import THIN, Parameter, dependent, explains
from uwaug.fitting.structure import COLOURS
from uwaug.fitting.uncertainty import Spread

__all__ = ["verdict"]

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

_CAUSES = (
    ". The model misses something, such as wrong distances, another exposure, uneven water or "
    "light, or more than one rate for a colour"
)
"""Of residuals that depend on each other."""


def verdict(
    chosen: Tried[OneWater],
    tried: list[Tried[OneWater]],
    parameters: dict[str, Parameter],
    spread: Spread,
    explained: float,
    rms: float,
    gain: float | None,
) -> str:
    """A few sentences. gain: of the observed pictures, if one explains them much better."""
    structure = chosen.structure
    lines = [_choice(chosen, tried)]
    lines.append(explains(rms, explained, "the variance of the observed pixels"))
    doubt = dependent(spread, _CAUSES)
    if explained < _POOR and doubt:
        lines.append(
            "That is little: are the pictures aligned, of one exposure (gain), and in metres?"
        )
    lines += doubt
    if gain is not None:
        lines.append(
            f"A gain of {gain:.3g} explains the pictures much better: were both taken with one "
            "exposure? If not, see the argument gain."
        )
    lines += _odd_units(parameters, structure)
    lines += _wide(chosen)
    lines += _unknown(parameters, structure, spread)
    lines += _at_bounds(parameters)
    lines += _absorption(parameters, structure)
    if structure.geometry.unit != "m":
        lines.append(
            "The scale of the distances is unknown, and so is that of the rates: β times the scale "
            "is what a picture shows."
        )
    if not chosen.solution.converged:
        lines.append("The fit stopped before it settled: give a start, or fewer free numbers.")
    return "\n".join(lines)


def _choice(chosen: Tried[OneWater], tried: list[Tried[OneWater]]) -> str:
    words = chosen.structure.model.words
    if len(tried) == 1:
        return f"Model {chosen.name!r}: {words}."
    best = best_of(tried)
    if best is chosen:
        return f"Model {chosen.name!r}: {words}. It foretells left-out pixels best."
    return (
        f"Model {chosen.name!r}: {words}. The fewest numbers within one standard error of the "
        f"best, {best.name!r}."
    )


def _unknown(parameters: dict[str, Parameter], structure: OneWater, spread: Spread) -> list[str]:
    lines = []
    if (
        spread.unseen.size
        or spread.idle.any()
        or (spread.singular.size and spread.singular[-1] < _ALIKE)
    ):
        lines.append("Some numbers do nearly the same to these pictures: see the correlation.")
    names = [name for name, one in parameters.items() if one.state == "not identified"]
    if not names:
        return lines
    lines.insert(0, f"Not identified: {', '.join(names)}.")
    far = structure.geometry.farthest
    for colour in COLOURS:
        beta = parameters.get(f"beta_{colour}")
        G = parameters.get(f"G_{colour}", beta)
        source = parameters.get(f"source_{colour}")
        if f"veil_{colour}" not in names or G is None or source is None or source.value is None:
            continue
        depth = 0.0 if G.value is None else G.value * far
        if depth < THIN:
            lines.append(
                f"In {colour} the veil still grows as a straight line at {far:.3g} "
                f"{structure.geometry.unit}: its growth (source) is seen, where it ends is not."
            )
    return lines


def _at_bounds(parameters: dict[str, Parameter]) -> list[str]:
    names = [name for name, one in parameters.items() if one.state == "at bound"]
    if not names:
        return []
    cure = "the interval has one open side"
    return [f"At the end of what they may be: {', '.join(names)}; {cure}."]


def _absorption(parameters: dict[str, Parameter], structure: OneWater) -> list[str]:
    """Whether a share g that was taken for known makes absorption negative."""
    negative = []
    for colour in COLOURS:
        a = parameters.get(f"a_{colour}")
        if a is not None and a.value is not None and a.value < 0:
            negative.append(colour)
    if not negative:
        return []
    return [
        f"Absorption is negative in {', '.join(negative)}: g = {structure.g:g} is more than these "
        "pictures allow, or the model does not suit them."
    ]


def _odd_units(parameters: dict[str, Parameter], structure: OneWater) -> list[str]:
    """Whether the distances seem to be in something else than metres."""
    rates = [parameters[f"beta_{colour}"].value or 0.0 for colour in COLOURS]
    near = structure.geometry.reference < _NEAREST
    if structure.geometry.unit != "m" or not (near or max(rates) > _FASTEST):
        return []
    return [
        f"The median distance is {structure.geometry.reference:.3g} m and the largest β "
        f"{max(rates):.3g}/m: are the distances in metres?"
    ]


def _wide(chosen: Tried[OneWater]) -> list[str]:
    """Whether the blur reaches the widest that a fit holds."""
    structure = chosen.structure
    natural = structure.natural(torch.from_numpy(chosen.solution.theta))
    if natural.width is None or natural.exponent is None:
        return []
    geometry = structure.geometry
    far = (geometry.farthest / geometry.reference) ** float(natural.exponent[0])
    if float(natural.width[0]) * far < _ALMOST * geometry.widest:
        return []
    return [
        f"The blur reaches the widest that a fit holds, {geometry.widest:.3g} px: width law, β and "
        "G may be off by more than their errors."
    ]
