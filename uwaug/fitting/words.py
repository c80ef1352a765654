"""What a fit says: its sentences, and its tables as text."""

from collections.abc import Mapping, Sequence

from uwaug.fitting.model import COLOURS
from uwaug.fitting.result import VISIBLE_LIGHT, Fit, Parameter, Remainder

THIN_OPTICAL_DEPTH = 0.3  # G·z at the far end, below which a veil is still a straight line
_SURE_ERRORS = 5.0  # standard errors of independent noise, beyond which a mean residual is real
_DEPENDENT_EFFECT = 1.5  # design effect, above which neighbouring residuals depend on each other
_MAX_DIGITS = 12  # of the ends of an interval
# of numbers whose name and unit are not enough, by kind
_MEANINGS = {
    "veil": "of white, V(0)",
    "source": "of white, G·V(0)",
    "gain": "times the light of clean",
    "exponent": "of σ over distance",
    "contents": "times those of the type",
}


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
    causes = "distances, alignment, uneven light, JPEG, or more than one rate for a colour"
    return [
        f"What is left is not noise: errors are {design_effect:.1f} times those of independent "
        f"pixels{example}. The model misses something, such as {causes}: numbers may be off by "
        "more."
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
    """Sentences on numbers that pictures do not tell, or that are at the end of their range."""
    words = {"not identified": "Not identified", "at bound": "At the end of what they may be"}
    sentences = []
    for state, beginning in words.items():
        names = [name for name, number in parameters.items() if number.state == state]
        if names:
            sentences.append(f"{beginning}: {', '.join(names)}.")
    return sentences


def summary(fit: Fit) -> str:
    """Notes, parameters, candidates, residuals by distance."""
    rows = [["", "value", "std. error", "95 % interval", "unit"]]
    for name, number in fit.parameters.items():
        value = "not identified" if number.value is None else f"{number.value:.4g}"
        error = "" if number.error is None else f"{number.error:.2g}"
        rows.append([name, value, error, _interval(number), _meaning(fit, name)])
    parts = [*fit.notes, *_aligned(rows)]
    if len(fit.candidates) > 1:
        # errors are in standard deviations of the noise, what lies behind in their squares
        rows = [["  model", "numbers", "error [σ]", "behind the best [σ²]", ""]]
        for x in fit.candidates:
            mark = "*" if x.chosen else " "
            behind = f"{x.behind:.4g} ± {x.behind_error:.2g}"
            values = ", ".join(f"{name} {value:.4g}" for name, value in x.values.items())
            rows.append([f"{mark} {x.name}", str(x.numbers), f"{x.error:.4f}", behind, values])
        parts += _aligned(rows)
    if fit.remainder:
        rows = [["observed − fitted", *COLOURS, "of linear light"]]
        for part in fit.remainder:
            cells = [f"{m:+.4f} ± {e:.4f}" for m, e in zip(part.mean, part.error, strict=True)]
            rows.append([f"at {part.distance:.3g} m", *cells, ""])
        parts += _aligned(rows)
    return "\n".join(parts)


def _meaning(fit: Fit, name: str) -> str:
    number, kind, geometry = fit.parameters[name], name.partition("_")[0], fit.geometry
    meaning = _MEANINGS.get(kind, "")
    if kind == "width":
        meaning = f"σ at {geometry.reference:.3g} m"
    if kind in ("beta", "G"):
        meaning = f"one rate for {geometry.nearest:.3g} to {geometry.farthest:.3g} m"
    if kind == "beta" and fit.model in ("haze", "veil"):
        meaning += ", of direct and forward light together"
    unit = number.unit if number.unit != "1" or not meaning else ""
    state = f"({number.state})" if number.state in ("at bound", "fixed") else ""
    return "  ".join(filter(None, (unit, meaning, state)))


def _interval(number: Parameter) -> str:
    if number.low is None or number.high is None:
        return ""
    for digits in range(4, _MAX_DIGITS):
        low, high = f"{number.low:.{digits}g}", f"{number.high:.{digits}g}"
        if low != high:
            break
    return f"{low} … {high}"


def _aligned(rows: list[list[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [""]
    for first, *numbers, last in rows:
        cells = [cell.rjust(width) for cell, width in zip(numbers, widths[1:], strict=False)]
        lines.append("  ".join(["", first.ljust(widths[0]), *cells, last]).rstrip())
    return lines
