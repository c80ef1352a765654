"""The page in Chromium, from a file, opened once, against `uwaug degrade` with the command that it
copies.
"""

import base64
import io
import json
import os
import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from uwaug.cli.app import app
from uwaug.files import write_picture
from uwaug.page.write import write_page
from uwaug.presets.scene import motorcycle

DRAWS = "#draws button"


def command(line: str) -> None:
    done = CliRunner().invoke(app, shlex.split(line))
    assert done.exit_code == 0, done.output


def pixels(path: str) -> Any:
    return np.array(Image.open(path)).astype(int)


class Shown:
    """A page in a tab."""

    def __init__(self, tab: Any, page: Path) -> None:
        self.tab = tab
        self.asked: list[str] = []
        self.errors: list[str] = []
        self.files: list[Any] = []
        tab.on("request", lambda request: self.asked.append(request.url))
        tab.on("pageerror", lambda error: self.errors.append(str(error)))
        tab.on("download", lambda file: self.files.append(file))  # noqa: PLW0108 it takes no builtin
        tab.goto(f"file://{page}")
        self.wait()

    def wait(self) -> None:
        """Until a whole picture is painted."""
        self.tab.wait_for_selector("#progress", state="hidden")
        self.tab.wait_for_selector("#view[aria-busy=false]")

    def set(self, **settings: Any) -> None:
        """What an address says."""
        self.tab.evaluate(f"location.hash = {json.dumps(urlencode(settings))}")
        self.wait()

    def take(self, *names: str) -> str:
        """Choose files; what is said against them."""
        self.tab.set_input_files("#files", list(names))
        self.tab.wait_for_timeout(100)
        self.wait()
        text: str = self.tab.inner_text("#files-error")
        return text

    def picture(self, canvas: str = "#after") -> Any:
        url = self.tab.eval_on_selector(canvas, "canvas => canvas.toDataURL()")
        data = base64.b64decode(url.partition(",")[2])
        return np.array(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)

    def code(self, language: str = "command") -> str:
        self.tab.select_option("#language", language)
        text: str = self.tab.inner_text("#code")
        return text


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    """The page of a photograph and its map in mm, which lie beside it."""
    names = ("chromium", "chromium-browser", "google-chrome")
    program = next(filter(None, map(shutil.which, names)), None)
    if program is None and "CI" in os.environ:
        pytest.fail("there is no Chromium")
    if program is None:
        pytest.skip("there is no Chromium")
    from playwright.sync_api import sync_playwright

    folder, scene = tmp_path_factory.mktemp("page"), motorcycle()
    write_picture(folder / "photo.png", (scene.image[:, ::5, ::5] * 255).byte())
    millimetres = (scene.distance[0, ::5, ::5] * 1000).round().numpy().astype(np.uint16)
    millimetres[0] = 0  # the sky
    Image.fromarray(millimetres).save(folder / "depth.png")
    quiet = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-background-networking"]
    with pytest.MonkeyPatch.context() as patch, sync_playwright() as playwright:
        patch.chdir(folder)
        command("page --out bundled.html")
        assert Path("bundled.html").stat().st_size < 3.6e6  # small enough to mail
        command("page --image photo.png --distance depth.png --unit mm --holes far --out page.html")
        browser = playwright.chromium.launch(executable_path=program, args=quiet)
        tab = browser.new_page(viewport={"width": 1300, "height": 900})
        yield Shown(tab, folder / "page.html")


@pytest.fixture
def shown(opened: Shown) -> Iterator[Shown]:
    """The page as it begins. Nothing goes wrong in it, and nothing leaves the machine."""
    opened.set()
    yield opened
    assert opened.errors == []
    assert all(url.startswith(("file:", "data:", "blob:")) for url in opened.asked)


def test_the_name_of_a_file_does_not_leave_its_script(small: Any, tmp_path: Path) -> None:
    pages = []
    for name in ("a.png", "a</script><!--<script>b.png"):
        write_page(tmp_path / "page.html", small, {"picture": name})
        pages.append((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert pages[0].count("<") == pages[1].count("<")
    assert json.loads(re.findall(r'"picture":("[^"]*u003c[^"]*")', pages[1])[0]) == name


@pytest.mark.parametrize(
    "settings",
    [
        {"water": "3C", "other": "7C", "share": 0.4, "gamut": 1, "saturation": 1.3, "exposure": -1},
        {"water": "9C", "nature": 1, "g": 0.1, "mu": 0.1, "blur": 2, "times": 0.5, "tone": 1.5},
        {"water": "contents", "chlorophyll": 9, "white_balance": 0.8, "color_matrix": 0.7},
    ],
)
def test_pictures_are_those_of_what_is_copied(shown: Shown, settings: dict[str, Any]) -> None:
    shown.set(**settings)
    command(shown.code().removeprefix("uwaug ") + " --force")
    off = np.abs(shown.picture() - pixels("wet/photo.png"))
    # `degrade` plans its blur to .002, the page to .0005
    assert (off > 2).mean() < 1e-3
    assert off.max() <= 5
    assert np.sqrt(((off / 255) ** 2).mean()) < 0.002
    told = pixels("wet/photo.png")
    exec(shown.code("Python"), {})
    assert np.array_equal(pixels("wet.png"), told)
    Path("this.toml").write_text(shown.code("TOML"))
    line = shown.code("TOML").splitlines()[0].removeprefix("# uwaug ")
    command(f"{line} --force")
    assert np.array_equal(pixels("wet/photo.png"), told)


def test_controls(shown: Shown) -> None:
    before = shown.picture()
    shown.tab.focus("#contrast")
    for _ in range(20):
        shown.tab.keyboard.press("ArrowLeft")
    shown.wait()
    after = shown.picture()
    assert after.std() < before.std()
    assert float(re.findall(r"--contrast ([\d.]+)", shown.code())[0]) < 0.4
    shown.tab.eval_on_selector("details", "details => details.open = true")
    shown.tab.uncheck("#terms label:nth-of-type(3) input")
    shown.wait()
    assert shown.picture().mean() < after.mean()
    shown.tab.check("#terms label:nth-of-type(3) input")
    shown.tab.hover("#view", position={"x": 100, "y": 100})
    assert re.fullmatch(r"[\d.]+ m away, [\d.]+ % .*", shown.tab.inner_text("#readout"))
    shown.tab.focus("#view")
    shown.tab.keyboard.press("Home")
    shown.tab.keyboard.press("PageUp")
    assert shown.tab.get_attribute("#view", "aria-valuetext") == "20 % in air"
    shown.tab.check("#hold-vertical_depth")
    shown.tab.click("#draw")
    shown.tab.wait_for_selector(f"{DRAWS}:nth-child(12):not(:disabled)", timeout=120_000)
    labels = shown.tab.locator(DRAWS).all_inner_texts()
    assert len(labels) == 12
    assert all(label.endswith("3.0 m") for label in labels)
    code = shown.code("command for draws")
    assert "vertical_depth=3" in code
    assert "--water" not in code
    assert "--variants 12" in code
    # half a second after the last change
    shown.tab.wait_for_url(re.compile("contrast="), timeout=10_000)


def test_each_water_is_as_in_nature_unless_asked(shown: Shown) -> None:
    def spread(number: int) -> float:
        std: float = shown.picture(f"#waters button:nth-child({number}) canvas").mean(-1).std()
        return std

    shown.tab.wait_for_selector("#severities button:nth-child(5) canvas[width]")
    assert spread(1) > 2 * spread(10)
    for pressed, said in (
        ("#waters button:nth-child(2)", "--water IA --contrast none"),
        ("#same", ""),
        ("#waters button:nth-child(3)", "--water IB --contrast 0.4"),
        ("#undo", "--water IA --contrast none"),
        ("#presets button:nth-child(2)", "chlorophyll="),
        ("#reset", "--water 3C --contrast 0.4"),
    ):
        shown.tab.click(pressed)
        assert said in shown.code()
    while spread(1) > 1.6 * spread(10):  # small pictures follow when all is at rest
        shown.tab.wait_for_timeout(100)
    assert shown.tab.inner_text("#as") == "all of the same clarity"


def test_a_real_picture_beside_and_a_draw_that_looks_like_it(shown: Shown) -> None:
    before = shown.picture()
    shown.set(water="contents", chlorophyll=8, cdom=0.8, white_balance=0, contrast=0.1)
    real = shown.picture()
    Image.fromarray(real.astype(np.uint8)).save("a reef.png")
    shown.tab.click("#reset")
    shown.tab.set_input_files("#real", ["a reef.png"])
    shown.tab.wait_for_selector("#reference")
    view, beside = (shown.tab.locator(name).bounding_box() for name in ("#view", "#reference"))
    assert view["height"] == pytest.approx(beside["height"], abs=1)
    assert "--like 'a reef.png' --variants 12" in shown.code("command for draws")
    shown.tab.click("#like")
    shown.tab.wait_for_selector("#like:not(:disabled)", timeout=240_000)
    shown.wait()
    away = re.findall(r"([\d.]+) away.*most draws ([\d.]+)", shown.tab.inner_text("#status"))
    nearest, usual = map(float, away[0])
    assert nearest < 0.5 * usual
    assert abs(shown.picture() - real).mean() < 0.6 * abs(before - real).mean()


def test_own_files(shown: Shown) -> None:
    first = shown.picture()
    assert shown.take("photo.png") == ""  # made up
    shown.tab.select_option("#left", "depths")
    assert re.fullmatch(r"yellow .* m, violet .* m, made up", shown.tab.inner_text("#left-tag"))
    near, far = shown.picture("#depths")[-1].mean(0), shown.picture("#depths")[0].mean(0)
    assert near[0] > far[0]  # yellow below, violet above
    # what it saves is what the copied command reads
    shown.tab.click("#save-scene")
    while len(shown.files) < 2:
        shown.tab.wait_for_timeout(50)
    for file in shown.files:
        file.save_as(file.suggested_filename)
    assert "photo-scene.png --distance photo-scene.npy" in shown.code()
    command(shown.code().removeprefix("uwaug ") + " --force")
    assert (np.abs(shown.picture() - pixels("wet/photo-scene.png")) > 2).mean() < 1e-3
    assert "choose what the gaps get" in shown.take("depth.png")  # the map of the picture before
    shown.tab.select_option("#holes", "far")
    shown.wait()
    assert np.abs(shown.picture() - first).max() <= 1  # the page's own copy of the same
    metres = pixels("depth.png").astype(np.float32) / 1000
    metres[metres == 0] = 99
    np.save("inverse.npy", 1 / metres)
    shown.tab.select_option("#holds", "inverse")
    assert shown.take("photo.png", "inverse.npy") == ""
    assert 'kind = "Inverse"' in shown.code()
    shown.tab.select_option("#holds", "metres")
    shown.tab.select_option("#unit", "m")
    metres[5, 5] = 0
    np.save("holes.npy", metres)
    np.save("small.npy", metres[9:])
    shown.tab.select_option("#holes", "error")
    Image.fromarray(metres.astype(np.uint8)).save("grey.png")
    Path("broken.png").write_bytes(b"\x89PNG no picture")
    for names, words in (
        (("broken.png",), "cannot be decoded"),
        (("depth.png", "small.npy"), "choose one picture"),
        (("photo.png", "small.npy"), "of another aspect"),
        (("photo.png", "grey.png"), "8 bits are too few"),
        (("photo.png", "holes.npy"), "1 pixels have no distance: choose what the gaps get"),
    ):
        assert words in shown.take(*names), names
    shown.tab.select_option("#holes", "behind")
    assert shown.take("photo.png", "holes.npy") == ""
    assert 'holes = "behind"' in shown.code()
    assert np.abs(shown.picture() - first).max() <= 20  # in that one pixel
    assert shown.take("photo.png") == ""
    choose = "box => (box.value = '3', box.dispatchEvent(new Event('change')), view.ariaBusy)"
    assert shown.tab.eval_on_selector("#without", choose) == "true"  # from then on
    shown.wait()
    assert "--distance 3" in shown.code()
