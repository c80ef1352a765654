"""The tables of benchmarks/README.md and CHOICES.md, from results/*.json, between their markers:
`python -m benchmarks.figures.summary`.
"""

import json
import re
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.harness import RESULTS, ROOT, command
from uwaug._support.atomic import written_whole

PAGES = {
    ROOT / "benchmarks" / "README.md": (
        "accuracy",
        "surfaces",
        "fits",
        "speed",
        "training",
        "detector",
    ),
    ROOT / "benchmarks" / "CHOICES.md": ("chart",),
}
"""Each page, and what stands in it."""

TRUTHS = {
    "Petzold's, in their waters": "Petzold",
    "Henyey–Greenstein, mean cosine .85": "HG 0.85",
    ".90": "HG 0.9",
    ".924": "HG 0.924",
    ".95": "HG 0.95",
    "six pictures, .924": "pictures",
}

Results = dict[str, Any]


def load(name: str) -> Results:
    results: Results = json.loads((RESULTS / f"{name}.json").read_text())
    return results


def table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def accuracy() -> str:
    """How near the model is to what it stands for."""
    model, planner = load("model"), load("planner")
    machine = model["machine"]
    on = f"{machine['processor']}, torch {machine['versions']['torch']}, one thread"
    rows = planner["rows"]
    largest, worst = (max(row[key] for row in rows) for key in ("rmse", "max"))
    unblurred = sum(not row["blurred"] for row in rows)
    ours = load("stability")["counts"]["uwaug"]
    draws = load("draws")
    right = min(ours["value"]["right"], ours["gradient"]["right"])
    conditions = sum(ours["value"].values())
    paragraphs = [
        f"Measured by `python -m benchmarks` ({on}); `python -m benchmarks.figures.summary` writes "
        "the numbers of `benchmarks/results` here.",
        "**Blur**, against each pixel's own Gaussian, on the bundled scene (sRGB values, 3000 "
        "pixels):",
        _blur_table(model),
        "**Curves**, at a tolerance of .002, against 61 bands at any distance (vertical depth 0, "
        "1, 10 m; g 0, .2, 1). Rates of the direct term + rates that signal and veil share, for "
        "all three channels:",
        _curve_table(model),
        "**Image**, in ten waters, three ranges of distance and two width laws: "
        f"{planner['within']} of {len(rows)} pictures have an RMSE within .002 of linear light, "
        f"the tolerance. The largest is {largest:.4f}, that of a single value {worst:.4f}. "
        f"With one blur less, {planner['one_less_breaks']} of "
        f"{planner['with_blurs']} would exceed half of it. {unblurred} need no blur.",
        "**Published implementation**: direct, forward (before its blur) and veil agree with it to "
        "1e-5 where conventions agree.",
        "**Light transport**, mean RMSE of direct and forward-scattered light against our own "
        "Monte Carlo walk over 0.1 to 5 scattering lengths, and in six Monte Carlo pictures "
        "(`python -m benchmarks.accuracy.physics`):",
        _transport_table(load("physics")),
        "**Real photographs** (`python -m benchmarks.accuracy.draws`): 342 of seven sets, beside "
        f"{draws['draws']} draws of each of 40 pictures in air, by the defaults and with one range "
        "changed. Shares by 26 numbers of a picture / by the 12 that the water decides. Recall: "
        "photographs within the range of draws. Coverage: photographs with a draw near. Precision: "
        "draws within the range of photographs. Clipped density: draws that might be photographs. "
        "Clipped coverage: draws that would cover as much if they were photographs. Neon: half of "
        "the pixels have a saturation above .9. Dead: the mean of a channel is below .02. Neutral: "
        "the mean colour is nearly grey. The last three are medians.",
        _photograph_table(draws["photographs"]),
        f"**Stability**: value and gradient are right in {right} of {conditions} hard conditions.",
        "![Methods against hard conditions: value and gradient of each](figures/stability.svg)",
    ]
    return "\n\n".join(paragraphs)


def _photograph_table(rows: Results) -> str:
    pairs = ["recall", "coverage", "precision", "clipped density", "clipped coverage"]
    shares, medians = ["neon", "dead", "neutral"], ["chroma", "lightness", "log₂ R/G"]
    # of neon and dead the photographs themselves must be asked: their numbers do not say
    shown = [["photographs", *["–"] * len(pairs), "0.06", "0.01", "0.07", "30", "49", "−1.9"]]
    for name, row in rows.items():
        cells = [
            " / ".join(f"{row[f'{measure}, {kind}']['mean']:.2f}" for kind in ("all", "water"))
            for measure in pairs
        ]
        cells += [f"{row[share]['mean']:.2f}" for share in shares]
        cells += [f"{row[median]['mean']:.3g}".replace("-", "−") for median in medians]
        shown.append([name, *cells])
    return table(["", *pairs, *shares, *medians], shown)


def _blur_table(model: Results) -> str:
    rows: dict[str, list[str]] = {}
    for found in model["blur"]:
        low, high = (f"{v:g}".removeprefix("0") for v in found["sigma_px"])
        cells = rows.setdefault(f"{low}–{high} px", [])
        cells.append(f"{found['psnr_db']:.0f} dB, {found['blurs']} blurs")
    head = ["widths", "tolerance .01", ".002 (default)", ".0005"]
    return table(head, [[widths, *cells] for widths, cells in rows.items()])


def _curve_table(model: Results) -> str:
    errors: dict[str, list[float]] = {}
    for found in model["curves"]:
        errors.setdefault(found["type"], []).append(found["error"])
    rows = []
    for found in model["curves"]:
        if (found["depth_m"], found["g"]) == (1.0, 0.2):
            name = found["type"]
            rates = " + ".join(map(str, found["rates"]))
            rows.append([name, rates, f"{max(errors[name]):.4f}"])
    return table(["type", "rates at 1 m, g = .2", "largest error"], rows)


def _transport_table(physics: Results) -> str:
    laws = {
        "calibrated law": physics["errors"]["calibrated"],
        "one Gaussian": physics["errors"]["one Gaussian, HG .924 (former)"],
        "paper's constants": physics["errors"]["paper"],
    }
    rows = []
    for name, key in TRUTHS.items():
        rows.append([name, *(f"{errors[key]:.4f}" for errors in laws.values())])
    return table(["phase function", *laws], rows)


def surfaces() -> str:
    """How near colours come to those of real spectra."""
    found = load("surfaces")
    methods = found["errors"]["ColorChecker"]
    rows = []
    for method in methods:
        row = ['`surfaces="spectral"`' if method == "basis" else method]
        for errors in found["errors"].values():
            row += [f"{errors[method][key]:.4f}" for key in ("mean", "worst")]
        rows.append(row)
    head = ["method", *(f"{name}, {key}" for name in found["errors"] for key in ("mean", "worst"))]
    places = found["places"]["ColorChecker"]
    paragraphs = [
        "**Colours** (`python -m benchmarks.accuracy.surfaces`), against the spectra of the 24 "
        "patches of the ColorChecker and of 99 CIE 2017 samples in 61 bands: RMSE in units of a "
        f"white plate at the same place, in {places} places of ten waters (0 to 25 m deep, 0 to "
        "8 m away) where such a plate keeps 1/64 of its light. All but the last have the camera's "
        "colour matrix, so that one number and three wavelengths fairly multiply raw channels. The "
        "last multiplies sRGB values, as published systems do, and uwaug with grey surfaces:",
        table(head, rows),
        "![Red, green, skin and white against depth: truth, uwaug, one number a channel]"
        "(figures/surfaces.png)",
    ]
    return "\n\n".join(paragraphs)


def chart() -> str:
    """Where the defaults stand among all that we know, and how time grows."""
    verdicts = {}
    for panel in load("frontier")["panels"].values():
        verdicts[panel["part"], panel["size"], panel["threads"]] = panel["verdict"]
    near = sum(verdict["within_10_percent"] for verdict in verdicts.values())
    paragraphs = [
        "`python -m benchmarks.speed.frontier` tries every way that we know to compute each part: "
        "error of the final image against time, 512², one thread. Our default is red, the line is "
        "the Pareto front:",
        "![PSNR against time for blur, spectra, number formats and runtimes](figures/frontier.png)",
        f"The default is on the front or within 10 % of it in {near} of {len(verdicts)} panels. "
        "PSNR of the default without the loops, and the fastest method, if any, that is as "
        "accurate:",
        _verdict_table(verdicts),
    ]
    return "\n\n".join(paragraphs)


def _verdict_table(verdicts: dict[tuple[str, int, int], Results]) -> str:
    head, settings = [""], dict.fromkeys((size, threads) for _, size, threads in verdicts)
    for size, threads in settings:
        head.append(f"{size}², {threads} thread{'s' * (threads > 1)}")
    rows = []
    for part in dict.fromkeys(part for part, *_ in verdicts):
        row = [part]
        for size, threads in settings:
            row.append(_stands(verdicts.get((part, size, threads))))
        rows.append(row)
    return table(head, rows)


def _stands(verdict: Results | None) -> str:
    if verdict is None:
        return "–"
    psnr = f"{verdict['psnr_db']:.0f} dB"
    if verdict["on_front"]:
        return psnr
    return f"{psnr}, {100 * verdict['slower_than_front']:.0f} % behind {verdict['beaten_by']}"


def speed() -> str:
    """Milliseconds, and pictures per second."""
    model = load("model")
    scale = model["scaling"]
    both = scale["forward + backward / forward"]
    paragraphs = [
        "Milliseconds for the whole model (`python -m benchmarks.speed.model`), field given, "
        "widths .9–4.5 px, one thread. Each row is a race in one process, medians on a shared "
        "machine, so read the ratios. The factors are for a blur that keeps 60 dB by itself; by "
        "default uwaug blurs forward-scattered light, which is faint, less carefully:",
        _speed_table(model),
        f"A blur of up to 60 px takes {scale['60 px / 4 px']:.2f} times as long as one of up to "
        f"4 px. 1024² takes {scale['1024² / 256²']:.1f} times as long as 256². Forward and "
        f"backward together take {both:.1f} times forward alone; to fit, `torch.compile(degrade)` "
        f"is faster still. At 1024² the peak of memory is {model['memory_times_input']:.1f} times "
        f"the input. `import uwaug` adds {model['import_s']:.2f} s to torch and kornia.",
        "One picture with a field (`python -m benchmarks.speed.throughput`), one thread, by the "
        "loops: milliseconds, and how many times as fast as the recipe:",
        _transform_table(load("throughput")),
        _loaders(load("throughput")),
        _lamps(load("throughput")),
        _batches(load("throughput")),
    ]
    return "\n\n".join(paragraphs)


def _speed_table(model: Results) -> str:
    ours = ("uwaug", "uwaug, default", "uwaug, loops")
    others = ("published, OpenCV", "naive kornia")
    rows = []
    for found in model["speed"]:
        ms, times = found["ms"], found["times_faster"]
        row = [f"{found['water']}, {found['size']}² × {found['batch']}"]
        row += [f"{ms[name]['median_ms']:.1f}" for name in ours]
        row += [f"{ms[name]['median_ms']:.0f} ({times[name]:.1f}×)" for name in others]
        rows.append(row)
    head = ["water, size × batch", "uwaug, blur ≥ 60 dB", "default", "loops", *others]
    return table(head, rows)


def _transform_table(throughput: Results) -> str:
    sizes = throughput["single"]
    recipe = [one["ms"]["recipe, as published (OpenCV), float32"]["median_ms"] for one in sizes]
    rows = []
    for name in sizes[0]["ms"]:
        row = [name]
        for one, other in zip(sizes, recipe, strict=True):
            ms = one["ms"][name]["median_ms"]
            row.append(f"{ms:.1f} ({other / ms:.1f}×)")
        rows.append(row)
    return table(["", *(f"{one['size']}²" for one in sizes)], rows)


def _loaders(throughput: Results) -> str:
    rows = [
        [name, *(f"{rates[name]:.0f}" for rates in throughput["loader"].values())]
        for name in next(iter(throughput["loader"].values()))
    ]
    calls, first = throughput["calls"], throughput["first_picture_s"]
    sizes = (f"{size}², pictures/s" for size in throughput["loader"])
    return (
        f"A draw takes {calls['eager']} Python calls by PyTorch and {calls['loops']} by the loops "
        f"once plans are there. The first of a process takes {first:.1f} s after torch. A "
        "DataLoader with two workers:\n\n" + table(["", *sizes], rows)
    )


def _lamps(throughput: Results) -> str:
    """What lamps cost."""
    sizes = throughput["lamps"]
    rows = [
        [name, *(f"{ratios[name]:.2f}" for ratios in sizes.values())]
        for name in next(iter(sizes.values()))
    ]
    text = "Pictures that lamps light and default draws, times as long as by daylight (means of "
    return f"{text}the same draws, one thread):\n\n" + table(["", *(f"{s}²" for s in sizes)], rows)


def _batches(throughput: Results) -> str:
    """Batches on the CPU, and on a GPU if there was one."""
    ((size, rates),) = throughput["batches"].items()
    rows: dict[str, list[str]] = {}
    for name, ms in rates.items():
        rows.setdefault(name.rpartition(",")[0], []).append(f"{ms:.2f}")
    head = list(dict.fromkeys(name.rpartition(", ")[2] for name in rates))
    text = f"`RandomUnderwater()` on batches of {size}² on the CPU, ms a picture:\n\n"
    text += table(["", *head], [[name, *cells] for name, cells in rows.items()])
    if not throughput["device"]:
        return text + "\n\nNo GPU was there to measure batches on a device."
    names = next(iter(throughput["device"].values()))
    shown = [[case, *(f"{r[n]:.0f}" for n in names)] for case, r in throughput["device"].items()]
    return text + "\n\nOn a GPU, bytes in and out, pictures/s:\n\n" + table(["", *names], shown)


def fits() -> str:
    """What the guide says of fits."""
    found = load("fitting_recovery")
    off = ", ".join(
        f"{name} {100 * share:.2f} %" for name, share in found["median_relative_error"].items()
    )
    return (
        f"**Fits** (`python -m benchmarks.accuracy.fitting_recovery`): {found['runs']} random "
        f"waters, 250×370, 1 % noise, 8 bits, model `auto`. {found['covered_percent']:.0f} % of "
        f"{found['numbers']} intervals hold the truth. Median errors are {off}. `auto` picks the "
        f"model that made the picture in {found['right_model_percent']:.0f} %."
    )


def training() -> str:
    """What training gains."""
    evidence = load("evidence")
    sets = {"buoys": "colour", "deepfish": "DeepFish", "fjord": "fjord"}
    titles = [title for name in sets for title in (name, f"{name}, grey-world")]
    head = [cell for name in sets.values() for cell in (name, "by grey-world")]
    tables = [evidence["tables"][title] for title in titles]
    rows = [[arm, *(_gain(rows[arm]) for rows in tables)] for arm in tables[0]]
    crops, nets = evidence["crops"], evidence["nets"]
    return (
        f"{nets} net{'s' * (nets > 1)} an arm; {crops['buoys']} buoys, {crops['deepfish']} crops "
        f"of DeepFish, {crops['fjord']} of the fjord. In brackets what it has more than the "
        "defaults, bold where both intervals of 95 %, over blocks and over films, leave out 0:\n\n"
        + table(["trained with", *head], rows)
    )


def detector() -> str:
    """What training gains for a detector, and where markers are read."""
    found, markers = load("detector"), load("markers")
    titles = ["divers", "swimmers", "pools", "air"]
    head = [
        f"{title} ({of['pictures']} pictures, {of['boxes']} persons)"
        for title, of in zip(titles, found["sets"].values(), strict=True)
    ]
    tables = list(found["tables"].values())
    rows = [[arm, *(_spread(of[arm]) for of in tables)] for arm in tables[0]]
    nets = max(len(row["nets"]) for row in tables[0].values())
    halves = ", ".join(
        f"{name} at {of['half']:.0f} ({of['interval'][0]:.0f}–{of['interval'][1]:.0f})"
        for name, of in markers["curves"].items()
    )
    return (
        f"{nets} net{'s' * (nets > 1)} an arm, {found['steps']} steps of {found['batch']} pictures "
        f"at {found['side']} px. AP50 of persons, in brackets what it has more than the defaults, "
        "and its interval of 95 % over blocks, bold where that leaves out 0:\n\n"
        + table(["tuned on", *head], rows)
        + f"\n\n**Markers**, half as many read as at high contrast: {halves} of 255 levels.\n\n"
        "![Share of tags that are read against contrast: film and uwaug](figures/markers.png)\n\n"
        + _readers(markers["readers"])
    )


def _readers(found: Results) -> str:
    """What small nets read of a film."""
    counts, tables = found["tags"], found["tables"]
    below, above = f"below {found['faint']} levels", f"{found['faint']} and more"
    titles = {"all": "film", "faint": below, "clear": above, "green": "by stretched green"}
    rows = []
    for arm in tables["all"]:
        nets = found["air"].get(arm)  # OpenCV's was not asked
        air = f"{sum(nets) / len(nets):.3f}" if nets else "–"
        rows.append([arm, *(_spread(tables[part][arm]) for part in titles), air])
    head = [f"{title} ({counts[part]} tags)" for part, title in titles.items()]
    nets = max(len(row["nets"]) for row in tables["all"].values())
    return (
        f"**Nets that read markers**: {nets} net{'s' * (nets > 1)} an arm, {found['steps']} steps "
        f"of 64 crops of boards in {found['scenes']} pictures. Shares of the film's tags that are "
        "read, of 30 that each might be, and differences as above. Nets are told where a tag is, "
        "OpenCV finds it:\n\n" + table(["trained on", *head, "boards in air"], rows)
    )


def _spread(row: Results) -> str:
    if not any(row["blocks"]):  # the defaults themselves
        return f"{row['score']:.3f}"
    low, high = row["blocks"]
    difference = f"{row['difference']:+.3f}"
    difference = f"**{difference}**" if low > 0 or high < 0 else difference
    return f"{row['score']:.3f} ({difference}; {low:+.2f}…{high:+.2f})".replace("-", "−")


def _gain(row: Results) -> str:
    if not any(row["blocks"]):  # the defaults themselves
        return f"{row['score']:.2f}"
    certain = all(row[kind][0] > 0 or row[kind][1] < 0 for kind in ("blocks", "films"))
    difference = f"{row['difference']:+.2f}".replace("-", "−")
    return f"{row['score']:.2f} ({f'**{difference}**' if certain else difference})"


SECTIONS: dict[str, Callable[[], str]] = {
    "accuracy": accuracy,
    "surfaces": surfaces,
    "fits": fits,
    "chart": chart,
    "speed": speed,
    "training": training,
    "detector": detector,
}
"""What belongs between the markers of each name."""


def updated(text: str, names: Sequence[str]) -> str:
    """A page with the figures of the results."""
    for name in names:
        pattern = rf"(<!-- figures: {name} -->\n).*?(<!-- /figures: {name} -->)"

        def filled(markers: re.Match[str], body: str = SECTIONS[name]()) -> str:
            return f"{markers[1]}{body}\n{markers[2]}"

        text, count = re.subn(pattern, filled, text, flags=re.DOTALL)
        if count != 1:
            wanted = f"expected the markers of figures: {name} once, found them {count} times"
            raise ValueError(wanted)
    return text


def main(quick: bool = False) -> None:
    """Write the tables; if quick, only make them."""
    for page, names in PAGES.items():
        text = updated(page.read_text(), names)
        if not quick:
            with written_whole(page) as part:
                part.write_text(text)


if __name__ == "__main__":
    command(main, __doc__)
