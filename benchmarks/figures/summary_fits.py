"""What the guide says of fits, from results/fitting.json."""

from typing import Any

import numpy as np

Results = dict[str, Any]

_SPOKEN = {True: "yes", False: "no"}


def fits(results: Results) -> list[str]:
    """Paragraphs and tables."""
    return [
        _recovery(results["recovery"]["all"], results["choice"]["right_percent"]),
        _bias(results["bias"]["removed"]),
        "**Errors on purpose**, whether they are noticed:",
        _errors(results["errors"]),
        _disturbances(results["disturbances"]),
        _transport(results["transport"]),
        _speed(results["speed"]),
    ]


def _recovery(found: Results, right: Results) -> str:
    off = found["median_relative_error"]
    shows, hidden = right["shows"], right["hidden"]
    return (
        f"**Fits** (`python -m benchmarks.accuracy.fitting`): {found['runs']} random waters, "
        f"250×370, 1 % noise, 8 bits, model `auto`. "
        f"{found['within_2_errors_percent']:.0f} % of the numbers "
        f"that are identified lie within two standard errors of the truth, and "
        f"{found['covered_percent']:.0f} % of the 95 % intervals hold it. Median error: β "
        f"{100 * off['beta']:.2f} %, G {100 * off['G']:.2f} %, veil {100 * off['veil']:.2f} %. "
        f"{found['same_minimum_percent']:.0f} % of the runs end at one minimum from three random "
        f"starts. `auto` picks the model that made the picture in {shows[0]:.0f} % of {shows[1]} "
        f"pictures where it shows, and a simpler one in {hidden[0]:.0f} % of {hidden[1]} where it "
        "does not."
    )


def _bias(found: Results) -> str:
    parts = []
    for name, shown in (("beta", "β"), ("G", "G"), ("veil", "veil")):
        without, with_it = (100 * found[name][f"median_{one}"] for one in ("without", "with"))
        parts.append(f"{shown} {without:.0f} % against {with_it:.2f} %")
    return (
        "**Forward scatter that is left out**, as other fits do (DeepSeeColor, SeaSplat, Osmosis): "
        f"median error in ten Jerlov waters without it, and with it: {', '.join(parts)}."
    )


def _errors(found: Results) -> str:
    lines = ["| what is wrong | standard errors × | said | RMS of the residual |"]
    lines.append("| --- | --- | --- | --- |")
    for name, row in found.items():
        said = _SPOKEN[row["says_so"]]
        lines.append(f"| {name} | {row['widened']:.1f} | {said} | {row['rms']:.4f} |")
    return "\n".join(lines)


def _disturbances(found: Results) -> str:
    lines = [
        "**What cameras, files and maps do**, at 167×247 with β (.62 .41 .48), G (.30 .15 .20), "
        "veil (.10 .28 .33) and a Gaussian blur: of nine numbers, how many 95 % intervals hold the "
        'truth, how many are "not identified", how far off the worst is, what was fitted, and the '
        f"verdict. {found['share_percent']:.0f} % of all hold or are not identified. The "
        "thresholds of what is suspected were chosen on these pictures.",
        "",
        "| disturbance | hold | not identified | worst | model | verdict |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for row in found["rows"]:
        cells = [row["name"], f"{row['hold']} of {row['known']}", str(row["not_identified"] or "")]
        cells += [f"{100 * row['worst']:.0f} %", row["model"], row["verdict"]]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _transport(found: Results) -> str:
    ours, known = [], []
    for water in found.values():
        ours += water["fits"]["auto"]["residual"]
        known += water["known_law"]
    return (
        "Three exponentials stand in for spectra so well that residuals tell little of it, and "
        "their coefficients are then those of the picture, not of the bands. On Monte Carlo "
        f"pictures a fit leaves {min(ours):.4f} to {max(ours):.4f} beyond the noise, the "
        f"calibrated law with the true coefficients {min(known):.4f} to {max(known):.4f}."
    )


def _speed(found: Results) -> str:
    auto, single = found["auto, 1"], found["exponential, 1"]
    adam, whole = found["adam"], found["whole"]
    slowest = max(row["seconds"] for name, row in adam.items() if name.endswith("1e-06"))
    beta = 100 * np.abs(whole["bias"]["beta"])
    return (
        f"500×741, one thread: `auto` {auto['seconds']:.0f} s, one model of 11 numbers "
        f"{single['seconds']:.1f} s. From one start the solver takes "
        f"{adam['solver_seconds']:.1f} s, Adam on the same residual up to {slowest:.0f} s; "
        f"DeepSeeColor's parameterisation, {whole['steps']} steps of Adam, "
        f"{whole['seconds']:.0f} s, with β off by {beta.min():.0f} to {beta.max():.0f} %."
    )
