"""Sentences on what a fit has found."""

from collections.abc import Mapping, Sequence

from uwaug.fitting.model import COLOURS, VISIBLE_LIGHT
from uwaug.fitting.result import Parameter, Remainder

THIN_OPTICAL_DEPTH = 0.3  # G·z at the far end, below which a veil is still a straight line
_SURE_ERRORS = 5.0  # standard errors of independent noise, beyond which a mean residual is real
_DEPENDENT_EFFECT = 1.5  # design effect, above which neighbouring residuals depend on each other


def left_over(remainder: Sequence[Remainder], design_effect: float, rms: float) -> list[str]:
    """The sentence, if any, on residuals that are off at one distance, or alike in neighbours."""
    worst, example = 0.0, ""
    for row in remainder:
        for colour, mean, error in zip(COLOURS, row.mean, row.error, strict=True):
            if abs(mean) > max(VISIBLE_LIGHT, _SURE_ERRORS * error, worst):
                worst, side = abs(mean), "brighter" if mean > 0 else "darker"
                example = f"; {colour} is {worst:.2g} {side} than fitted at {row.distance:.3g} m"
    are_alike = design_effect > _DEPENDENT_EFFECT and rms > VISIBLE_LIGHT
    if not example and not are_alike:
        return []
    return [
        f"What is left is not noise: errors are {design_effect:.1f} times those of independent "
        f"pixels{example}. Numbers may be off by more, for distances, alignment, uneven light, "
        "JPEG, or more than one rate for a colour."
    ]


def straight_line(rates: Mapping[str, float], farthest: float) -> list[str]:
    """The sentence, if any, on colours whose veil, of rate G (1/m), is straight to the end (m)."""
    straight = [colour for colour, G in rates.items() if G * farthest < THIN_OPTICAL_DEPTH]
    if not straight:
        return []
    return [
        f"In {', '.join(straight)} the veil still grows as a straight line at {farthest:.3g} m: "
        "its growth (source) is seen, where it ends is not."
    ]


def unknown(parameters: Mapping[str, Parameter]) -> list[str]:
    words = {"not identified": "Not identified", "at bound": "At the end of what they may be"}
    sentences = []
    for state, beginning in words.items():
        names = [name for name, number in parameters.items() if number.state == state]
        if names:
            sentences.append(f"{beginning}: {', '.join(names)}.")
    return sentences
