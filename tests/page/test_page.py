"""The page in Chromium, from a file, against `uwaug degrade` with the command that it copies."""

import base64
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
import pytest
from PIL import Image

import uwaug
from uwaug.files import write_picture
from uwaug.page.write import write_page
from uwaug.presets.scene import motorcycle

WATERS = (*uwaug.JERLOV_TYPES[2:], "mixture", "contents")
SETTINGS: tuple[dict[str, Any], ...] = (
    {"contrast": 0.2, "vertical_depth": 6, "exposure": -1, "tone": 1.5, "color_matrix": 0.7},
    {"contrast": 0.5, "vertical_depth": 2, "white_balance": 0.8, "saturation": 1.3, "gamut": 1},
    {"nature": 1, "vertical_depth": 1, "g": 0.1, "mu": 0.1, "blur": 2, "times": 0.5},
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    names = ("chromium", "chromium-browser", "google-chrome")
    program = next(filter(None, map(shutil.which, names)), None)
    if program is None and "CI" in os.environ:
        pytest.fail("there is no Chromium")
    if program is None:
        pytest.skip("there is no Chromium")
    from playwright.sync_api import sync_playwright

    quiet = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-background-networking"]
    with sync_playwright() as playwright:
        yield playwright.chromium.launch(executable_path=program, args=quiet)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A photograph, its map in mm, and the page of both."""
    folder = tmp_path_factory.mktemp("page")
    scene = motorcycle()
    write_picture(folder / "photo.png", (scene.image[:, ::3, ::3] * 255).byte())
    millimetres = (scene.distance[0, ::3, ::3] * 1000).round().numpy().astype(np.uint16)
    Image.fromarray(millimetres).save(folder / "depth.png")
    flags = "--image photo.png --distance depth.png --unit mm --out page.html"
    uwaug_command(folder, f"page {flags}")
    return folder


def uwaug_command(folder: Path, line: str) -> None:
    command = [sys.executable, "-m", "uwaug", *shlex.split(line)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


class Shown:
    """A page in a tab."""

    def __init__(self, browser: Any, folder: Path, **settings: Any) -> None:
        self.tab = browser.new_page(viewport={"width": 1300, "height": 900})
        self.asked: list[str] = []
        self.errors: list[str] = []
        self.tab.on("request", lambda request: self.asked.append(request.url))
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.goto(f"file://{folder}/page.html#{urlencode(settings)}")
        self.wait()

    def wait(self) -> None:
        """Until a whole picture is painted."""
        self.tab.wait_for_selector("#progress", state="hidden")
        self.tab.wait_for_selector("#view[aria-busy=false]")

    def draws(self) -> None:
        """Until twelve draws are painted."""
        last = "#draws button:nth-child(12):not(:disabled) canvas[width]"
        self.tab.wait_for_selector(last, timeout=120_000)

    def picture(self, canvas: str = "#after") -> Any:
        url = self.tab.eval_on_selector(canvas, "canvas => canvas.toDataURL()")
        data = base64.b64decode(url.partition(",")[2])
        return np.array(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)

    def status(self) -> str:
        text: str = self.tab.inner_text("#status")
        return text

    def code(self, language: str) -> str:
        self.tab.select_option("#language", language)
        text: str = self.tab.inner_text("#code")
        return text


def test_the_name_of_a_file_does_not_leave_its_script(small: Any, tmp_path: Path) -> None:
    pages = []
    for name in ("a.png", "a</script><!--<script>b.png"):
        write_page(tmp_path / "page.html", small, {"picture": name})
        pages.append((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert pages[0].count("<") == pages[1].count("<")
    assert json.loads(re.findall(r'"picture":("[^"]*u003c[^"]*")', pages[1])[0]) == name


def test_pictures_are_those_of_the_copied_command(browser: Any, folder: Path) -> None:
    from typer.testing import CliRunner

    from uwaug.cli.app import app

    for water in WATERS:
        for number, settings in enumerate(SETTINGS):
            said = {"water": water, **settings}
            if water == "mixture":
                said |= {"water": "3C", "other": "7C", "share": 0.4}
            shown = Shown(browser, folder, **said)
            out = folder / f"{water}-{number}.png"
            words = shlex.split(shown.code("command"))[1:]
            words = [str(folder / w) if w in ("photo.png", "depth.png") else w for w in words]
            words[-1] = str(out)
            done = CliRunner().invoke(app, words)
            assert done.exit_code == 0, done.output
            off = np.abs(shown.picture() - np.array(Image.open(out)).astype(int))
            # `degrade` plans its blur to .002, the page to .0005
            assert (off > 2).mean() < 1e-3, (water, settings)
            assert off.max() <= 5, (water, settings)
            assert np.sqrt(((off / 255) ** 2).mean()) < 0.002, (water, settings)
            assert all(url.startswith(("file:", "data:", "blob:")) for url in shown.asked)
            assert shown.errors == []
            shown.tab.close()


def test_python_and_toml_say_the_same(browser: Any, folder: Path) -> None:
    shown = Shown(browser, folder, water="7C", full_well=3000, nature=1, **{"times": 0.8})
    first = re.sub(r", noise = \{.*?\}", "", shown.code("command"))
    uwaug_command(folder, first.removeprefix("uwaug ") + " --force")
    told = Image.open(folder / "wet.png").tobytes()
    code = re.sub(r',\s*"noise": \{.*?\}', "", shown.code("Python"), flags=re.DOTALL)
    subprocess.run([sys.executable, "-c", code], cwd=folder, check=True)
    assert Image.open(folder / "wet.png").tobytes() == told
    toml = re.sub(r", noise = \{.*?\}", "", shown.code("TOML"))
    (folder / "this.toml").write_text(toml)
    line = toml.splitlines()[0].removeprefix("# uwaug ")
    uwaug_command(folder, line.replace("wet.png", "toml.png"))
    assert Image.open(folder / "toml.png").tobytes() == told
    shown.tab.close()


def test_controls(browser: Any, folder: Path) -> None:
    shown = Shown(browser, folder)
    before = shown.picture()
    shown.tab.focus("#contrast")
    for _ in range(20):
        shown.tab.keyboard.press("ArrowLeft")
    shown.wait()
    after = shown.picture()
    assert after.std() < before.std()
    shown.tab.wait_for_timeout(700)  # it is written when all is at rest
    assert "contrast=" in shown.tab.url
    assert float(re.findall(r"--contrast ([\d.]+)", shown.code("command"))[0]) < 0.4
    shown.tab.click("summary")
    shown.tab.uncheck("#terms label:nth-of-type(3) input")
    shown.wait()
    assert shown.picture().mean() < after.mean()
    shown.tab.hover("#view", position={"x": 100, "y": 100})
    assert re.fullmatch(r"[\d.]+ m away, [\d.]+ % .*", shown.tab.inner_text("#readout"))
    shown.tab.focus("#view")
    shown.tab.keyboard.press("Home")
    assert shown.tab.get_attribute("#view", "aria-valuenow") == "0"
    shown.tab.keyboard.press("PageUp")
    assert shown.tab.get_attribute("#view", "aria-valuetext") == "20 % in air"
    shown.tab.check("#hold-vertical_depth")
    shown.draws()  # those of the start
    shown.tab.click("#draw")
    shown.draws()
    labels = shown.tab.locator("#draws button").all_inner_texts()
    assert len(labels) == 12
    assert all(label.endswith("3.0 m") for label in labels)
    code = shown.code("command for draws")
    assert "vertical_depth=3" in code
    assert "--water" not in code
    assert "--variants 12" in code
    assert shown.errors == []
    shown.tab.close()


def test_each_water_is_as_in_nature_unless_asked(browser: Any, folder: Path) -> None:
    shown = Shown(browser, folder)
    shown.draws()

    def spread(number: int) -> float:
        shown.tab.wait_for_timeout(1000)  # small pictures follow when all is at rest
        shown.tab.wait_for_selector("#severities button:nth-child(5) canvas[width]")
        std: float = shown.picture(f"#waters button:nth-child({number}) canvas").mean(-1).std()
        return std

    assert spread(1) > 2 * spread(10)
    shown.tab.click("#waters button:nth-child(2)")
    assert "--water IA --contrast none" in shown.code("command")
    shown.tab.check("#same")
    shown.tab.wait_for_timeout(5000)
    assert spread(3) == pytest.approx(spread(10), rel=0.5)
    shown.tab.click("#waters button:nth-child(3)")
    assert "--water IB --contrast 0.4" in shown.code("command")
    shown.tab.click("#undo")
    assert "--water IA --contrast none" in shown.code("command")
    shown.tab.click("#presets button:nth-child(2)")
    assert "chlorophyll=" in shown.code("command")
    shown.tab.click("#reset")
    assert "--water 3C --contrast 0.4" in shown.code("command")
    assert shown.errors == []
    shown.tab.close()


@pytest.mark.parametrize("width", [360, 820, 1440])
def test_all_that_is_pressed_is_24_px_high_and_wide(browser: Any, folder: Path, width: int) -> None:
    shown = Shown(browser, folder, water="contents")
    shown.tab.set_viewport_size({"width": width, "height": 800})
    shown.tab.click("summary")
    pressed = "button, input, select, summary, [tabindex]"
    boxes = shown.tab.eval_on_selector_all(
        pressed,
        """all => all.filter(one => one.checkVisibility()).map(one => {
            const { width, height } = one.getBoundingClientRect();
            return [one.id || one.textContent, width, height]; })""",
    )
    assert len(boxes) > 50
    assert [box for box in boxes if min(box[1:]) < 24] == []
    assert shown.tab.evaluate("document.documentElement.scrollWidth") <= width
    shown.tab.close()


def test_a_real_picture_beside_and_a_draw_that_looks_like_it(browser: Any, folder: Path) -> None:
    green = {"water": "contents", "chlorophyll": 10, "cdom": 0.3, "white_balance": 0}
    shown = Shown(browser, folder, contrast=0.15, **green)
    Image.fromarray(shown.picture().astype(np.uint8)).save(folder / "a reef.png")
    shown.tab.click("#reset")
    shown.wait()
    before = shown.picture()
    shown.tab.set_input_files("#real", [str(folder / "a reef.png")])
    shown.tab.wait_for_selector("#reference")
    view, real = (shown.tab.locator(name).bounding_box() for name in ("#view", "#reference"))
    assert view["height"] == pytest.approx(real["height"], abs=1)
    assert view["y"] == real["y"]
    assert "--like 'a reef.png' --variants 12" in shown.code("command for draws")
    shown.tab.click("#like")
    shown.tab.wait_for_selector("#like:not(:disabled)", timeout=240_000)
    shown.wait()
    nearest, usual = map(
        float, re.findall(r"([\d.]+) away.*most draws ([\d.]+)", shown.status())[0]
    )
    assert nearest < 0.5 * usual
    real_one = np.array(Image.open(folder / "a reef.png")).astype(int)
    assert abs(shown.picture() - real_one).mean() < 0.6 * abs(before - real_one).mean()
    assert shown.errors == []
    shown.tab.close()


def test_own_files(browser: Any, folder: Path) -> None:
    shown = Shown(browser, folder)
    first = shown.picture()

    def take(*names: str) -> str:
        shown.tab.set_input_files("#files", [str(folder / name) for name in names])
        shown.tab.wait_for_timeout(100)
        shown.wait()
        text: str = shown.tab.inner_text("#files-error")
        return text

    assert take("photo.png") == ""  # made up
    shown.tab.select_option("#left", "depths")
    assert re.fullmatch(r"yellow .* m, violet .* m, made up", shown.tab.inner_text("#left-tag"))
    near, far = shown.picture("#depths")[-1].mean(0), shown.picture("#depths")[0].mean(0)
    assert near[0] > far[0]  # yellow below, violet above
    assert "photo-scene.png --distance photo-scene.npy" in shown.code("command")
    assert shown.tab.is_visible("#unsaved")
    assert take("depth.png") == ""  # the map of the picture before
    assert np.abs(shown.picture() - first).max() <= 1  # the page's own copy of the same
    depth = np.array(Image.open(folder / "depth.png")).astype(np.float32)
    np.save(folder / "metres.npy", depth / 1000)
    shown.tab.select_option("#unit", "m")
    assert take("photo.png", "metres.npy") == ""
    assert np.abs(shown.picture() - first).max() <= 1
    np.save(folder / "inverse.npy", 1 / depth)
    shown.tab.select_option("#holds", "inverse")
    assert take("photo.png", "inverse.npy") == ""
    assert 'kind = "Inverse"' in shown.code("command")
    shown.tab.select_option("#holds", "metres")
    assert take("photo.png") == ""
    choose = "box => (box.value = '3', box.dispatchEvent(new Event('change')), view.ariaBusy)"
    assert shown.tab.eval_on_selector("#without", choose) == "true"  # from then on
    shown.wait()
    assert "--distance 3" in shown.code("command")

    depth[5, 5] = 0
    np.save(folder / "holes.npy", depth / 1000)
    np.save(folder / "small.npy", depth[9:])
    np.save(folder / "mm.npy", depth + 1)
    Image.fromarray((depth / 40).astype(np.uint8)).save(folder / "grey.png")
    (folder / "broken.png").write_bytes(b"\x89PNG no picture")
    for names, words in (
        (("photo.png", "holes.npy"), "1 pixels have no distance: choose what the gaps get"),
        (("photo.png", "small.npy"), "the map is 247×158 px, the picture 247×167"),
        (("photo.png", "mm.npy"), "is the unit mm"),
        (("photo.png", "grey.png"), "8 bits are too few"),
        (("broken.png",), "cannot be decoded"),
        (("depth.png", "mm.npy"), "choose one picture"),
    ):
        assert words in take(*names), names
    take("photo.png", "holes.npy")
    shown.tab.select_option("#holes", "behind")
    assert take("photo.png", "holes.npy") == ""
    assert 'holes = "behind"' in shown.code("command")
    assert np.abs(shown.picture() - first).max() <= 20  # in that one pixel
    assert shown.errors == []
    shown.tab.close()
    shown = Shown(browser, folder)
    Image.open(folder / "photo.png").convert("L").save(folder / "mono.png")
    assert take("mono.png") == ""
    assert "mono-scene.png" in shown.code("command")
    shown.tab.close()


def test_a_page_of_the_bundled_scene(browser: Any, tmp_path: Path) -> None:
    uwaug_command(tmp_path, "page --out page.html")
    assert (tmp_path / "page.html").stat().st_size < 2.6e6
    shown = Shown(browser, tmp_path, times=1.5)
    # what it has saved is what the copied command reads
    files: list[Any] = []
    # playwright takes no method of a builtin
    shown.tab.on("download", lambda file: files.append(file))  # noqa: PLW0108
    shown.tab.click("#save-scene")
    while len(files) < 2:
        shown.tab.wait_for_timeout(100)
    for file in files:
        file.save_as(tmp_path / file.suggested_filename)
    uwaug_command(tmp_path, shown.code("command").removeprefix("uwaug "))
    wet = np.array(Image.open(tmp_path / "wet.png")).astype(int)
    assert wet.shape == (500, 741, 3)
    assert (np.abs(shown.picture() - wet) > 2).mean() < 1e-3
    shown.tab.close()
