"""The tables of benchmarks/README.md, from results/*.json, between their markers:
`python -m benchmarks.figures.summary`.
"""

import json
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from benchmarks.accuracy.conditions import EACH
from benchmarks.harness import RESULTS, ROOT, command
from uwaug._support.atomic import written_whole

PAGE = ROOT / "benchmarks" / "README.md"

TRUTHS = {
    "Petzold's, in their waters": "Petzold",
    "Henyey–Greenstein, mean cosine .85": "HG 0.85",
    ".90": "HG 0.9",
    ".924": "HG 0.924",
    ".95": "HG 0.95",
    "six pictures, .924": "pictures",
}

"""The draws that stand beside photographs."""

Results = dict[str, Any]


def load(name: str) -> Results:
    results: Results = json.loads((RESULTS / f"{name}.json").read_text())
    return results


def table(head: list[str], rows: list[list[str]]) -> str:
    first, *lines = ("| " + " | ".join(cells) + " |" for cells in (head, *rows))
    return "\n".join([first, "|---" * len(head) + "|", *lines])


def accuracy() -> str:
    """How near the model is to what it stands for."""
    model, planner, conditions = load("model"), load("planner"), load("conditions")
    machine = model["machine"]
    on = f"{machine['processor']}, torch {machine['versions']['torch']}, one thread"
    rows = planner["rows"]
    largest, worst = (max(row[key] for row in rows) for key in ("rmse", "max"))
    default = [row for row in model["blur"] if row["tolerance"] == 0.002]
    low, high = min(row["blurs"] for row in default), max(row["blurs"] for row in default)
    psnr = min(row["psnr_db"] for row in default)
    error = max(row["error"] for row in model["curves"])
    paragraphs = [
        f"By `python -m benchmarks` ({on}).",
        f"**Blur**, by {low} to {high} blurs, is within {psnr:.0f} dB of each pixel's own Gaussian "
        f"of .75 to 60 px. **Curves** are within {error:.4f} of sums over 61 bands. The **image** "
        f"has an RMSE of {largest:.4f} of linear light at most, in {len(rows)} cases; a single "
        f"value is {worst:.4f} off.",
        "**Light transport** (`physics`): mean RMSE of direct and forward-scattered light against "
        "Monte Carlo transport over 0.1 to 5 scattering lengths, and in six Monte Carlo pictures:",
        _transport_table(load("physics")),
        f"**Real photographs** (`conditions`): 342 of seven sets, and 32 machines' cameras, beside "
        f"{EACH} draws of each of 40 pictures in air, by 26 numbers of a picture / by the 12 that "
        "water decides. Recall: photographs within the range of draws. Coverage: photographs with "
        "a draw among their neighbours. Precision: draws within the range of photographs. Cameras: "
        "frames reached, mean over cameras (of how many none). Medians: of draws (of photographs).",
        _photograph_table(conditions["photographs"]),
    ]
    return "\n\n".join(paragraphs)


def _photograph_table(rows: Results) -> str:
    measures = ("recall", "coverage", "precision")
    medians = {"sd_RG": "red / green", "loc2": "fine structure", "dark": "dark channel"}
    shown = []
    for name, row in rows.items():
        cells = [" / ".join(f"{share:.2f}" for share in row[measure]) for measure in measures]
        cells.append(f"{row['cameras']:.2f} ({row['cameras not reached']})")
        cells += [f"{row[key][1]:.2f} ({row[key][0]:.2f})".replace("-", "−") for key in medians]
        shown.append([name, *cells])
    return table(["", *measures, "cameras", *medians.values()], shown)


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
        means = [f"{errors[method]['mean']:.4f}" for errors in found["errors"].values()]
        worst = max(errors[method]["worst"] for errors in found["errors"].values())
        name = '`surfaces="spectral"`' if method == "basis" else method
        rows.append([name, *means, f"{worst:.3f}"])
    head = ["method", *found["errors"], "worst"]
    places = found["places"]["ColorChecker"]
    paragraphs = [
        "**Colours** (`surfaces`): RMSE of 24 patches of the ColorChecker and of 99 CIE 2017 "
        f"samples against their spectra in 61 bands, white = 1, in {places} places of ten waters. "
        "The last multiplies sRGB values, as published systems do; all others have the camera's "
        "colour matrix:",
        table(head, rows),
        "![Red, green, skin and white against depth: truth, uwaug, one number a channel]"
        "(figures/surfaces.png)",
    ]
    return "\n\n".join(paragraphs)


def chart() -> str:
    """Where the defaults stand among all that we know."""
    verdicts: dict[str, list[Results]] = {}
    for panel in load("frontier")["panels"].values():
        verdicts.setdefault(panel["part"], []).append(panel["verdict"])
    every = [verdict for of_part in verdicts.values() for verdict in of_part]
    near = sum(verdict["within_10_percent"] for verdict in every)
    rows = []
    for part, of_part in verdicts.items():
        rivals = {verdict["beaten_by"]: None for verdict in of_part if verdict["beaten_by"]}
        excess = [100 * verdict["slower_than_front"] for verdict in of_part]
        if rivals:
            rows.append([part, f"{min(excess):.0f} to {max(excess):.0f} %", ", ".join(rivals)])
    paragraphs = [
        "`python -m benchmarks frontier` tries every way that we know to compute each part: error "
        "of the final image against time. The default, in PyTorch, is red:",
        "![PSNR against time for blur, spectra, number formats and runtimes](figures/frontier.png)",
        f"It is on the Pareto front or within 10 % of it in {near} of {len(every)} panels, of "
        "which seven are drawn. Parts in which something as accurate is faster:",
        table(["part", "the default is slower by", "than"], rows),
    ]
    return "\n\n".join(paragraphs)


def stability() -> str:
    """In how many hard conditions each method is right."""
    counts = load("stability")["counts"]
    conditions = sum(counts["uwaug"]["value"].values())

    def best(of: Iterable[str], what: str) -> str:
        """The method with most right among these."""
        right, name = max((counts[name][what].get("right", 0), name) for name in of)
        return f"{right} of {conditions - counts[name][what].get('none', 0)} {what}s"

    others = counts.keys() - {"uwaug", "published"}
    paragraphs = [
        f"`python -m benchmarks stability` judges methods in {conditions} hard conditions. Right "
        f"are {best(['uwaug'], 'value')} and {best(['uwaug'], 'gradient')} of uwaug; "
        f"{best(['published'], 'value')} of published code; of other ways to compute a part "
        f"{best(others, 'value')} and {best(others, 'gradient')} at best:",
        "![Methods against hard conditions: value and gradient of each](figures/stability.svg)",
    ]
    return "\n\n".join(paragraphs)


def speed() -> str:
    """Milliseconds, and pictures per second."""
    throughput = load("throughput")
    first, lit = throughput["first_picture_s"], throughput["lamps"]["512"]
    paragraphs = [
        "`throughput`: milliseconds for a float32 picture with measured distances and a field, one "
        "thread, by the loops; and pictures/s of a DataLoader with two workers:",
        _times_and_rates(throughput["single"], throughput["loader"]),
        f"The first draw of a process takes {first:.1f} s. Lamps take "
        f"{lit['loops, lit by lamps']:.1f} times as long as daylight by the loops and "
        f"{lit['PyTorch, lit by lamps']:.1f} times by PyTorch.",
        _device(throughput["device"]),
    ]
    return "\n\n".join(paragraphs)


def _times_and_rates(single: list[Results], loader: Results) -> str:
    rows = []
    for name in next(iter(loader.values())):
        times = [size["ms"].get(f"{name}, float32") for size in single]
        cells = [f"{time['median_ms']:.1f}" if time else "–" for time in times]
        cells += [f"{rates[name]:.0f}" for rates in loader.values()]
        rows.append([name, *cells])
    head = [f"{size['size']}², ms" for size in single] + [f"{size}², /s" for size in loader]
    return table(["", *head], rows)


def _device(rates: Results) -> str:
    """Batches on a GPU if there was one."""
    if not rates:
        return "No GPU was measured."
    names = next(iter(rates.values()))
    shown = [[case, *(f"{of[name]:.0f}" for name in names)] for case, of in rates.items()]
    return "On a GPU, bytes in and out, pictures/s:\n\n" + table(["", *names], shown)


def fits() -> str:
    """What the guide says of fits."""
    found = load("fitting_recovery")
    off = ", ".join(
        f"{name} {100 * share:.2f} %" for name, share in found["median_relative_error"].items()
    )
    return (
        f"**Fits** (`fitting_recovery`): {found['runs']} random waters, 250×370, 1 % noise, "
        f"8 bits, model `auto`. {found['covered_percent']:.0f} % of {found['numbers']} intervals "
        f"hold the truth. Median errors are {off}. `auto` picks the model that made the picture in "
        f"{found['right_model_percent']:.0f} %. " + _files(found["files"])
    )


def _files(found: dict[str, Any]) -> str:
    """How many intervals hold the truth, by the files that pictures come from."""
    cells = []
    for name, row in found.items():
        told = 100 * row["numbers"] / sum(row["states"].values())
        cells.append(f"{row['covered_percent']:.0f} % from {name} ({told:.0f} % identified)")
    setting = "125×185, .5 % noise, the right model, both from files"
    return f"Of smaller pictures ({setting}): {', '.join(cells)}."


def training() -> str:
    """What training gains."""
    evidence = load("evidence")
    crops, nets = evidence["crops"], evidence["nets"]
    columns = {
        f"colour ({crops['buoys']} buoys)": "buoys",
        "by grey-world": "buoys, grey-world",
        f"fish, DeepFish ({crops['deepfish']} crops)": "deepfish",
        f"fish, fjord ({crops['fjord']} crops)": "fjord",
    }
    return f"{nets} nets an arm. Bold: the interval over films, too, leaves out 0.\n\n" + _gains(
        "trained with", {head: evidence["tables"][key] for head, key in columns.items()}
    )


def wet() -> str:
    """What water on top gains for nets that are trained on wet pictures."""
    crops, persons, tags = load("waters"), load("wet_persons"), load("wet_tags")
    costs = ", ".join(f"{arm} {ms:.1f}" for arm, ms in crops["ms"].items() if ms)
    return (
        f"{crops['nets']} nets an arm; bold: apart from nothing on top, over films, too.\n\n"
        + _apart(crops["tables"], ("blocks", "films"))
        + f"\n\nMilliseconds of a picture of 256², one thread: {costs}.\n\n"
        f"**Persons**, AP50 of YOLOX-nano, {persons['nets']} nets an arm:\n\n"
        + _apart(persons["tables"], ("blocks",))
        + f"\n\n**Markers**, share that {tags['nets']} nets read which have learnt a film's:\n\n"
        + _apart(tags["tables"], ("blocks",))
    )


def detector() -> str:
    """What training gains for a detector, and where markers are read."""
    found, markers = load("detector"), load("markers")
    columns = {}
    for key, rows in found["tables"].items():
        title = key.split("/")[1].replace("val", "air")
        columns[f"{title} ({found['sets'][key]['pictures']} pictures)"] = rows
    nets = max(len(row["nets"]) for row in next(iter(columns.values())).values())
    return (
        f"{nets} nets an arm, {found['steps']} steps of {found['batch']} pictures at "
        f"{found['side']} px. AP50 of persons:\n\n"
        + _gains("tuned on", columns, ("blocks",))
        + "\n\n**Markers** that OpenCV reads:\n\n"
        "![Share of tags that are read against contrast: film and uwaug](figures/markers.png)\n\n"
        + _readers(markers["readers"])
    )


def _readers(found: Results) -> str:
    """What small nets read of a film."""
    tables = found["tables"]
    columns = {f"film ({found['tags']['all']} tags)": tables["all"]}
    columns["by stretched green"] = tables["green"]
    nets = max(len(row["nets"]) for row in tables["all"].values())
    return (
        f"**Nets that read markers**: {nets} an arm, {found['steps']} steps of 64 crops of boards "
        f"in {found['scenes']} pictures. Shares of the film's tags that are read, one of 30 "
        "each; nets are told where a tag is, OpenCV finds it:\n\n"
        + _gains("trained on", columns, ("blocks",))
    )


def restore() -> str:
    """What nets give back."""
    found = load("restore")
    columns = {title: rows for title, rows in found["tables"].items() if title.count(",") == 1}
    nets = max(len(row["nets"]) for row in next(iter(columns.values())).values())
    return (
        f"{nets} nets an arm, {found['steps']} steps, {found['pairs']} pairs. Intervals are over "
        "blocks and nets.\n\n" + _gains("restored by", columns, ("blocks",))
    )


def _digits(row: Results) -> int:
    """Of a share, and of a ΔE."""
    return 2 if row["score"] < 2 else 1


def _gains(title: str, columns: Results, intervals: Sequence[str] = ("blocks", "films")) -> str:
    """Arms by columns."""
    rows = []
    for arm in next(iter(columns.values())):
        if arm.endswith("=None"):  # single changes, all of them level
            continue
        cells = [_gain(scores[arm], intervals) for scores in columns.values()]
        rows.append([arm, *cells])
    return table([title, *columns], rows)


def _gain(row: Results, intervals: Sequence[str]) -> str:
    if not any(row["blocks"]):  # the defaults themselves
        return f"{row['score']:.{_digits(row)}f}"
    certain, digits = _is_certain(row, intervals), _digits(row)
    difference = f"{row['difference']:+.{digits}f}".replace("-", "−")
    return f"{row['score']:.{digits}f} ({f'**{difference}**' if certain else difference})"


def _is_certain(row: Results, intervals: Sequence[str]) -> bool:
    return all(row[kind][0] > 0 or row[kind][1] < 0 for kind in intervals)


def _apart(columns: Results, intervals: Sequence[str]) -> str:
    """Scores of arms, bold where an interval of their gain leaves out 0."""
    rows = []
    for arm in next(iter(columns.values())):
        cells = [(f"{scores[arm]['score']:.2f}", scores[arm]) for scores in columns.values()]
        rows.append([arm, *(f"**{x}**" if _is_certain(row, intervals) else x for x, row in cells)])
    titles = [title.replace("choose/", "").replace("land/val", "air") for title in columns]
    return table(["on top", *titles], rows)


SECTIONS: dict[str, Callable[[], str]] = {
    "chart": chart,
    "stability": stability,
    "accuracy": accuracy,
    "surfaces": surfaces,
    "fits": fits,
    "speed": speed,
    "training": training,
    "wet": wet,
    "detector": detector,
    "restore": restore,
}
"""What belongs between the markers of each name."""


def updated(text: str) -> str:
    """The page with the figures of the results."""
    for name, section in SECTIONS.items():
        pattern = rf"(<!-- figures: {name} -->\n).*?(<!-- /figures: {name} -->)"

        def filled(markers: re.Match[str], body: str = section()) -> str:
            return f"{markers[1]}{body}\n{markers[2]}"

        text, count = re.subn(pattern, filled, text, flags=re.DOTALL)
        if count != 1:
            wanted = f"expected the markers of figures: {name} once, found them {count} times"
            raise ValueError(wanted)
    return text


def main(quick: bool = False) -> None:
    """Write the tables; if quick, only make them."""
    text = updated(PAGE.read_text())
    if not quick:
        with written_whole(PAGE) as part:
            part.write_text(text)


if __name__ == "__main__":
    command(main, __doc__)
