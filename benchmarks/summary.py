"""The figures that the README shows, from results/*.json between its markers: `python -m benchmarks.summary`."""

import json
import re
from pathlib import Path
from typing import Any

from benchmarks.harness import RESULTS, command

README = Path(__file__).parent.parent / "README.md"
PANELS = ((256, 1), (512, 1), (1024, 1), (512, 2))  # size, threads


def load(name: str) -> dict[str, Any]:
    results: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text())
    return results


def table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def accuracy() -> str:
    model, planner, stability, physics = (
        load(name) for name in ("model", "planner", "stability", "physics")
    )
    ranges: dict[str, list[str]] = {}
    for row in model["blur"]:
        low, high = (f"{v:g}".removeprefix("0") for v in row["sigma_px"])
        ranges.setdefault(f"{low}–{high} px", []).append(
            f"{row['psnr_db']:.0f} dB, {row['blurs']} blurs"
        )
    curves: dict[str, list[str]] = {}
    for row in model["curves"]:
        worst = max(r["error"] for r in model["curves"] if r["type"] == row["type"])
        if (row["depth_m"], row["g"]) == (1.0, 0.2):
            curves[row["type"]] = [" + ".join(map(str, row["rates"])), f"{worst:.4f}"]
    rows, errors = planner["rows"], physics["errors"]
    ours = stability["counts"]["uwaug"]
    right = min(ours["value"]["right"], ours["gradient"]["right"])
    calibrated, former, paper = (
        errors[n] for n in ("calibrated", "one Gaussian, HG .924 (former)", "paper")
    )
    head = model["machine"]
    return f"""\
Measured by `python -m benchmarks` ({head["processor"]}, torch {
        head["versions"]["torch"]
    }, one thread); the files in \
`benchmarks/results` hold all figures, and `python -m benchmarks.summary` writes them here.

**Blur**, against each pixel's own Gaussian, on the scene above (sRGB values, 3000 pixels):

{
        table(
            ["widths", "tolerance .01", ".002 (default)", ".0005"],
            [[k, *v] for k, v in ranges.items()],
        )
    }

**Curves**, at a tolerance of .002, against 61 bands over 0–20 m (vertical depth 0, 1, 10 m; g 0, .2, 1). Rates are \
those of the direct term + those that signal and veil share; all three channels use them:

{table(["type", "rates at 1 m, g = .2", "largest error"], [[k, *v] for k, v in curves.items()])}

**Image**, in ten waters, three ranges of distance and two width laws: {planner["within"]} of {
        len(rows)
    } pictures \
within the tolerance of .002, the largest RMSE {
        max(r["rmse"] for r in rows):.4f}; one blur less would take \
{planner["one_less_breaks"]} of {planner["with_blurs"]} beyond half of it. \
{sum(not r["blurred"] for r in rows)} need no blur at all.

**Published implementation**: direct, forward (before its blur) and veil agree to 1e-5 where conventions agree.

**Light transport**, mean RMSE of direct and forward-scattered light against our own Monte Carlo walk over 0.1 to 5 \
scattering lengths, and in six Monte Carlo pictures (`python -m benchmarks.physics`):

{
        table(
            ["phase function", "calibrated law", "one Gaussian", "paper's constants"],
            [
                [name, *(f"{law[key]:.4f}" for law in (calibrated, former, paper))]
                for name, key in (
                    ("Petzold's, in their waters", "Petzold"),
                    ("Henyey–Greenstein, mean cosine .85", "HG 0.85"),
                    (".90", "HG 0.9"),
                    (".924", "HG 0.924"),
                    (".95", "HG 0.95"),
                    ("six pictures, .924", "pictures"),
                )
            ],
        )
    }

**Stability**: {right} of {sum(ours["value"].values())} hard conditions right in value and gradient.

![Methods against hard conditions: value and gradient of each](benchmarks/figures/stability.svg)"""


def chart() -> str:
    frontier, scaling = load("frontier"), load("scaling")
    panels = {
        (p["part"], p["size"], p["threads"]): p["verdict"] for p in frontier["panels"].values()
    }

    def cell(part: str, size: int, threads: int) -> str:
        verdict = panels.get((part, size, threads))
        if verdict is None:
            return "–"
        psnr = f"{verdict['psnr_db']:.0f} dB"
        if verdict["on_front"]:
            return psnr
        return f"{psnr}, {100 * verdict['slower_than_front']:.0f} % behind {verdict['beaten_by']}"

    parts = list(dict.fromkeys(part for part, *_ in panels))
    head = ["", *(f"{size}², {threads} thread{'s' * (threads > 1)}" for size, threads in PANELS)]
    front = sum(v["within_10_percent"] for v in panels.values())
    fits = {name: sweep["fits"] for name, sweep in scaling["sweeps"].items()}
    wide = scaling["sweeps"]["widest"]["points"]
    fused = {
        f"{p['x']:g}": p["ms"]["uwaug"]["median_ms"] / p["ms"]["fused C++"]["median_ms"]
        for p in wide
    }
    return f"""\
Every way that we know to compute each part, error of the final image against time, 512², one thread \
(`python -m benchmarks.frontier`). Red is our default, the line the Pareto front:

![PSNR against time for blur, spectra, number formats and runtimes](benchmarks/figures/frontier.png)

The default is on the front or within 10 % of it in {front} of {len(panels)} panels. PSNR of the default, and what is \
as accurate and faster where something is:

{table(head, [[part, *(cell(part, *panel) for panel in PANELS)] for part in parts])}

Time grows with pixels to the power {fits["pixels"]["uwaug"]["exponent"]:.2f}, with the widest blur to the power \
{fits["widest"]["uwaug"]["exponent"]:.2f}. One fused loop in C++, compiled on the spot, without coarse grids, is \
{fused["4"]:.1f} times as fast at 4 px and {1 / fused["64"]:.1f} times as slow at 64 px \
(`python -m benchmarks.scaling`).

![Time and memory against pixels, batch, widest blur and rates](benchmarks/figures/scaling.png)"""


def speed() -> str:
    model, throughput, runtime = (load(name) for name in ("model", "throughput", "runtime"))
    rows = []
    for r in model["speed"]:
        ms, times = {k: v["median_ms"] for k, v in r["ms"].items()}, r["times_faster"]
        cells = [
            f"{ms[name]:.0f} ({times[name]:.1f}×)" for name in ("published, OpenCV", "naive kornia")
        ]
        ours = [f"{ms[name]:.1f}" for name in ("uwaug", "uwaug, default")]
        rows.append([f"{r['water']}, {r['size']}² × {r['batch']}", *ours, *cells])
    scale = model["scaling"]
    loader = next(t for t in throughput["throughput"] if (t["size"], t["workers"]) == (256, 1))
    rate = {name: f"{r['median']:.0f}" for name, r in loader["pictures_per_s"].items()}
    parts = next(p for p in throughput["parts"] if p["size"] == 256)["ms_per_picture"]
    share = [
        100 * parts[n]["draw and medium, share of all"]
        for n in ("uwaug, survey", "uwaug, everything random")
    ]
    onnx = table(
        ["threads, size × batch", "ONNX Runtime", "eager", "torch.compile"],
        [
            [
                f"{s['threads']}, {s['size']}² × {s['batch']}",
                f"{s['ms']['ONNX Runtime']['median_ms']:.1f} ({s['of_eager']:.2f} of eager)",
                *(f"{s['ms'][name]['median_ms']:.1f}" for name in ("eager", "compiled")),
            ]
            for s in runtime["speed"]
        ],
    )
    torchvision = ""
    if "torchvision blur + jitter" in rate:
        torchvision = (
            f"; torchvision's GaussianBlur and ColorJitter make {rate['torchvision blur + jitter']}"
        )
    return f"""\
Milliseconds for the whole model, field given, widths .9–4.5 px, one thread, each row a race in one process \
(`python -m benchmarks.model`; medians on a shared machine, so read the ratios). The factors are for a blur that keeps \
60 dB by itself; by default uwaug blurs forward-scattered light, which is faint, less carefully:

{
        table(
            [
                "water, size × batch",
                "uwaug, blur ≥ 60 dB",
                "uwaug, default",
                "published, OpenCV",
                "naive kornia",
            ],
            rows,
        )
    }

A blur of up to 60 px takes {
        scale["60 px / 4 px"]:.2f} times as long as one of up to 4 px. 1024² takes \
{scale["1024² / 256²"]:.1f} times as long as 256². Forward and backward together take \
{
        scale[
            "forward + backward / forward"
        ]:.1f} times forward alone; to fit, `torch.compile(degrade)` is faster still. At \
1024² the peak of memory is {model["memory_times_input"]:.1f} times the input. `import uwaug` adds \
{model["import_s"]:.2f} s to torch and kornia.

`RandomUnderwater` at 256 px, field and random water included, one worker (`python -m benchmarks.throughput`): \
{rate["uwaug, survey"]} pictures per second, {
        rate["uwaug, survey in linear light"]
    } with `color_space="linear"` as \
the published recipe works, which makes {rate["published, OpenCV"]}{
        torchvision
    }. Drawing and making the medium are \
{share[0]:.0f} % of the time for discrete waters, {
        share[1]:.0f} % if everything is drawn from ranges.

The exported file (`python -m benchmarks.runtime`), milliseconds:

{onnx}

An 8-fold lead over the published recipe was the aim, and is missed. The rest is in fusion, which eager PyTorch lacks: \
see the fused loop above."""


def sections() -> dict[str, str]:
    """What belongs between the markers of each name."""
    return {"accuracy": accuracy(), "chart": chart(), "speed": speed()}


def updated(text: str) -> str:
    """The README with the figures of the results."""
    for name, body in sections().items():
        pattern = rf"(<!-- figures: {name} -->\n).*?(<!-- /figures: {name} -->)"
        text, count = re.subn(
            pattern, lambda m, body=body: f"{m[1]}{body}\n{m[2]}", text, flags=re.DOTALL
        )
        if count != 1:
            raise ValueError(
                f"{README.name}: expected the markers of figures: {name} once, found them {count} times"
            )
    return text


def main(quick: bool = False) -> None:
    """Write the README's figures; if quick, only make them."""
    text = updated(README.read_text())
    if not quick:
        part = README.with_suffix(".part")
        part.write_text(text)
        part.replace(README)


if __name__ == "__main__":
    command(main, __doc__)
