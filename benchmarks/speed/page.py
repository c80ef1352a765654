"""The page of `uwaug page` in Chromium: how long from a slider to the picture, how much memory, and
how far its pictures are from those of `uwaug degrade`, on the bundled scene (741×500).

`RandomUnderwater` with the same settings, one thread, is timed beside it. Nothing else may run: one
quiet core. It needs Chromium, and writes its screenshots into `benchmarks/figures`.
"""

import base64
import io
import re
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
from PIL import Image
from torch.nn.functional import interpolate

import uwaug
from benchmarks.harness import RESULTS, command, loops, save, use_threads
from uwaug.page.write import write_page
from uwaug.presets.scene import Scene, motorcycle

WATERS = ("IB", "II", "III", "1C", "3C", "5C", "7C", "9C", "0.6*3C+0.4*9C", "0.5*II+0.5*7C")
SETTINGS: tuple[dict[str, float], ...] = (
    {"contrast": 0.2, "vertical_depth": 6, "exposure": -1, "tone": 1.5, "color_matrix": 0.7},
    {"contrast": 0.4, "vertical_depth": 2, "white_balance": 0.8, "saturation": 1.3, "gamut": 1},
    {"contrast": 0.7, "vertical_depth": 9, "exposure": 0.4, "tone": 1, "color_matrix": 0},
)
DEFAULTS = {
    "exposure": 0.0,
    "white_balance": 0.3,
    "saturation": 1.0,
    "gamut": 0.85,
    "tone": 1.2,
    "color_matrix": 0.4,
    "mu": 0.03,
}
MOVES = 20  # of a slider
FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-quic")


def twin(water: str, settings: dict[str, float]) -> uwaug.RandomUnderwater:
    """The transform with these settings of the page."""
    camera = DEFAULTS | settings
    return uwaug.RandomUnderwater(
        uwaug.RandomWater(
            water,
            contrast=settings["contrast"],
            vertical_depth=settings["vertical_depth"],
            mu=camera["mu"],
            field=None,
            color_matrix=camera["color_matrix"],
        ),
        light=uwaug.RandomLight(share=0.0, pitch=0.0),  # no lamps, and level
        development=uwaug.RandomDevelopment(
            camera["exposure"],
            white_balance=camera["white_balance"],
            saturation=camera["saturation"],
            gamut=camera["gamut"],
            tone=camera["tone"],
            noise=None,
        ),
    )


def opened(browser: Any, path: Path, **settings: Any) -> tuple[Any, float]:
    """A tab with a page, and the seconds until its first picture."""
    tab = browser.new_page(viewport={"width": 1440, "height": 1040})
    began = time.perf_counter()
    tab.goto(f"file://{path}#{urlencode(settings)}")
    settled(tab)
    return tab, time.perf_counter() - began


def settled(tab: Any) -> None:
    """Wait for a whole picture."""
    tab.wait_for_selector("#view[aria-busy=false]", timeout=60_000)


def drawn(tab: Any) -> None:
    """Wait for the small pictures."""
    for row in ("#draws button:nth-child(12):not(:disabled)", "#severities button:nth-child(5)"):
        tab.wait_for_selector(f"{row} canvas[width]", timeout=60_000)
    tab.wait_for_timeout(1000)


def levels(browser: Any, path: Path, scene: Scene, count: int) -> dict[str, Any]:
    """How far pictures are from `RandomUnderwater`'s, in levels of 255."""
    image, rows = (scene.image * 255).round().byte(), []
    for water in WATERS[:count]:
        for settings in SETTINGS:
            parts = re.match(r"[\d.]+\*(\w+)\+([\d.]+)\*(\w+)", water)
            named = {"water": water}
            if parts:
                named = dict(zip(("water", "share", "other"), parts.groups(), strict=True))
            tab, _ = opened(browser, path, **named, **settings)
            url = tab.evaluate("document.getElementById('after').toDataURL()")
            tab.close()
            data = base64.b64decode(url.partition(",")[2])
            shown = np.array(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)
            truth, _ = twin(water, settings)(image, scene.distance)
            off = np.abs(shown - truth.permute(1, 2, 0).numpy())
            row = {"water": water, **settings, "largest": int(off.max())}
            row |= {"beyond_2": float((off > 2).mean())}
            rows.append(row | {"rmse": float(np.sqrt(((off / 255) ** 2).mean()))})
    beyond = max(row["beyond_2"] for row in rows)
    within = sum(row["largest"] <= 2 for row in rows)
    worst = max(row["largest"] for row in rows)
    rmse = max(row["rmse"] for row in rows)
    print(
        f"{within} of {len(rows)} within 2 levels, worst {worst}; {beyond:.2%} beyond; {rmse:.4f}"
    )
    return {"rows": rows, "within_2": within, "largest": worst, "beyond_2": beyond, "rmse": rmse}


def times(browser: Any, path: Path, scene: Scene, moves: int) -> dict[str, Any]:
    """Medians [ms] from a slider's move to the painted picture, beside the package's own time."""
    tab, first = opened(browser, path)
    measured: dict[str, Any] = {"first": 1e3 * first}
    move = """([event, at]) => new Promise(done => {
        const slider = document.getElementById("contrast"), view = document.getElementById("view");
        const begun = performance.now();
        slider.value = at;
        slider.dispatchEvent(new Event("input"));
        if (event === "change") slider.dispatchEvent(new Event("change"));
        new MutationObserver((_, seen) => { if (view.ariaBusy === "false") {
            seen.disconnect(); requestAnimationFrame(() => done(performance.now() - begun)); } })
            .observe(view, { attributes: true, attributeFilter: ["aria-busy"] });
    })"""
    drawn(tab)
    for name, event in (("whole", "change"), ("half", "input")):
        taken = []
        for n in range(moves):
            taken.append(tab.evaluate(move, [event, 0.3 + 0.02 * n]))
            tab.wait_for_timeout(50)
        measured[name] = float(np.median(taken))
    tab.close()
    use_threads(1)
    image = (scene.image * 255).round().byte()
    for name in ("loops", "PyTorch"):
        taken = []
        with loops(name == "loops"):
            for _ in range(moves):
                augment = twin("3C", {"contrast": 0.4, "vertical_depth": 3.0})
                began = time.perf_counter()
                augment(image, scene.distance)
                taken.append(1e3 * (time.perf_counter() - began))
        measured[name] = float(np.median(taken))
    print(", ".join(f"{name} {ms:.0f} ms" for name, ms in measured.items()))
    return measured


def memory(browser: Any, folder: Path) -> float:
    """Bytes that a pixel takes: of a page of a megapixel against one of a tenth of it."""
    sizes = {}
    for name, (height, width) in {"small": (250, 400), "large": (800, 1250)}.items():
        maps = (motorcycle().image, motorcycle().distance)
        image, z = (interpolate(x[None], (height, width))[0].float() for x in maps)
        write_page(folder / f"{name}.html", Scene(image, z), {"picture": "a.png", "distance": "3"})
        tab, _ = opened(browser, folder / f"{name}.html")
        tab.wait_for_timeout(3000)
        session = browser.new_browser_cdp_session()
        processes = session.send("SystemInfo.getProcessInfo")["processInfo"]
        status = [Path(f"/proc/{p['id']}/status") for p in processes if p["type"] == "renderer"]
        kilobytes = [int(re.findall(r"RssAnon:\s+(\d+)", path.read_text())[0]) for path in status]
        sizes[name] = 1024 * max(kilobytes)
        tab.close()
    each = (sizes["large"] - sizes["small"]) / (800 * 1250 - 250 * 400)
    print(f"{each:.0f} bytes a pixel")
    return float(each)


def main(quick: bool = False) -> None:
    """Measure, print and save."""
    program = shutil.which("chromium")
    if program is None:
        print("skipped: there is no Chromium")
        return
    from playwright.sync_api import sync_playwright

    scene = motorcycle()
    with tempfile.TemporaryDirectory() as place, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(FLAGS))
        path = Path(place) / "page.html"
        write_page(path, scene, {"picture": "motorcycle.png", "distance": "3"})
        found = {
            "ms": times(browser, path, scene, 3 if quick else MOVES),
            "levels": levels(browser, path, scene, 1 if quick else len(WATERS)),
        }
        if quick:
            return
        found["bytes_a_pixel"] = memory(browser, Path(place))
        tab, _ = opened(browser, path, contrast=0.4)
        drawn(tab)
        tab.evaluate("scrollTo(0, 0)")
        shot = Image.open(io.BytesIO(tab.screenshot())).convert("RGB")
        shot.thumbnail((1000, 1000))
        shot.save(RESULTS.parent / "figures" / "page.jpg", quality=82)
    save("page", found)


if __name__ == "__main__":
    command(main, __doc__)
