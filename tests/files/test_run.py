"""Runs over folders: their bytes, what they leave alone, and what stops them."""

import csv
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from deadly import Deadly
from filing import content, metres, pixels, save, words
from PIL import Image

from uwaug import Lamp, Light, Medium, RandomDevelopment, RandomUnderwater, RandomWater, Sensor
from uwaug.files import Recipe, Row, degrade, propose, read_picture, read_record, read_table, replay
from uwaug.files.pool import on_processes
from uwaug.files.record import write_record
from uwaug.transforms.samples import key_of

H, W = 24, 32
WATER = RandomUnderwater(RandomWater("II", contrast=None))
RECIPE = Recipe(RandomUnderwater(RandomWater(["II", "7C"], contrast=(0.3, 0.5))), seed=4)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    here = Path(__file__).parent.parent
    monkeypatch.setenv("PYTHONPATH", f"{here.parent}{os.pathsep}{here}")
    for number in range(4):
        save(f"all/{number}.png", pixels(H, W, seed=number))
        save(f"depth/{number}.npy", metres(H, W))
    return tmp_path


def rows() -> list[Row]:
    return propose("all", "depth")


def statuses(summary: Any) -> list[str]:
    return [result.status for result in summary.results]


def test_what_a_run_has_written_is_no_picture_of_the_next() -> None:
    def names() -> list[str]:
        return [row.name for row in propose("all")]

    degrade(RECIPE, rows(), "all/under", sheet=True)
    assert names() == [f"{number}.png" for number in range(4)]
    save("all/sheet.jpg", pixels())  # is no run's
    assert "sheet.jpg" in names()
    with pytest.raises(ValueError, match="no pictures in all/under:"):
        propose("all/under")


# What is written


def test_a_picture_is_that_of_the_transform() -> None:
    recipe = Recipe(WATER, variants=2)
    summary = degrade(recipe, rows()[:1], "out")
    assert [result.place for result in summary.results] == ["0_1.png", "0_2.png"]
    image, z = read_picture("all/0.png"), torch.from_numpy(metres(H, W))[None]
    for variant in range(2):
        path = Path(f"out/0_{variant + 1}.png")
        generator = torch.Generator().manual_seed(key_of(0, variant, "0.png"))
        params = WATER.make_params(image, generator)
        record = read_record(Path(f"{path}.json"))
        assert record["params"] == params
        assert record["contrast"] == summary.results[variant].contrast
        left = WATER.contrast_left(image, z, params)
        assert record["contrast"] == pytest.approx(float(left.mean()), abs=1e-4)
        made = WATER.transform(image, z, params).int()
        assert (read_picture(path).int() - made).abs().max() <= 1
    names = {f"0_{n}.png{end}" for n in (1, 2) for end in ("", ".json")}
    assert content("out").keys() == names | {"index.csv", "table.csv"}


def test_bytes_depend_on_neither_workers_nor_order_nor_threads() -> None:
    mixed = rows()
    random.Random(0).shuffle(mixed)
    before = torch.get_num_threads()
    told: list[Any] = []
    degrade(RECIPE, rows(), "one", progress=lambda *counts: told.append(counts))
    assert told == [(0, 4), (1, 4), (2, 4), (3, 4), (4, 4)]
    degrade(RECIPE, mixed, "two", workers=2)
    assert torch.get_num_threads() == before
    one, two = content("one"), content("two")
    for name in ("index.csv", "table.csv"):
        lines = [sorted(folder.pop(name).splitlines()) for folder in (one, two)]
        assert lines[0] == lines[1]
    assert one == two
    assert len({one[f"{number}.png"] for number in range(4)}) == 4


def test_the_table_beside_the_results_makes_the_same_bytes() -> None:
    save("more/7.jpg", pixels(H, W))
    mixed = [*rows(), Row("deep/a.npy", Path("more/7.jpg"), Path("depth/0.npy").absolute())]
    mixed = [row for row in mixed if row.name != "0.png"]
    degrade(RECIPE, mixed, "out/here")
    again = read_table("out/here/table.csv")
    assert [row.name for row in again] == ["1.png", "2.png", "3.png", "deep/a.npy"]
    degrade(RECIPE, again, "there")
    here, there = content("out/here"), content("there")
    assert [here.pop("table.csv") != there.pop("table.csv"), here == there] == [True, True]
    assert statuses(degrade(RECIPE, again, "out/here", resume=True)) == ["skipped"] * 4


def test_frames_of_a_folder_share_a_draw() -> None:
    for folder in ("one", "other"):
        for number in range(3):
            save(f"films/{folder}/{number}.png", pixels(H, W, seed=number))
    augment = RandomUnderwater(distance=3.0, development=RandomDevelopment(noise=Sensor(2000)))
    step = (0.02, 0.0, -0.1)
    recipe = Recipe(augment, variants=2, motion=step)
    frames = propose("films", sequence=True)
    assert degrade(recipe, frames, "wet").failures == []
    assert degrade(recipe, frames[::-1], "again", workers=2).failures == []
    pictures = [path for path in content("wet") if path.endswith(".png")]
    assert all(content("wet")[path] == content("again")[path] for path in pictures)
    clips: dict[Any, Any] = {}
    for path in Path("wet").rglob("*.png.json"):
        record = read_record(path)
        (sample,) = record["params"]["samples"]
        frame = int(Path(record["row"]["name"]).stem)
        assert sample.pop("moved") == pytest.approx(0.004 * frame)
        assert sample.pop("motion") == pytest.approx([frame * way for way in step])
        # the noise of a sensor is that of a frame
        noise = sample["development"]["noise"]
        noise["seed"] = (noise["seed"] - frame) % 2**32
        clips.setdefault((path.parent.name, record["variant"]), []).append(sample)
    assert len(clips) == 4
    assert all(samples == [samples[0]] * 3 for samples in clips.values())
    replay("wet/one/2_1.png.json", "frame.png")
    assert Path("frame.png").read_bytes() == Path("wet/one/2_1.png").read_bytes()


def test_a_film_is_settled_on_a_frame_that_serves() -> None:
    maps = Path("maps/film")
    for number in range(8):
        # fades in; the middle frame is of a gap
        light = 0 if number == 4 else min(number, 3) / 3
        save(f"fade/film/{number}.png", (light * pixels(H, W, seed=number)).astype(np.uint8))
        save(maps / f"{number}.npy", metres(H, W))
    save(maps / "0.npy", 0 * metres(H, W))
    save(maps / "5.npy", np.full((H, W), np.inf, np.float32))
    Path("fade/film/6.png").write_bytes(b"")
    recipe = Recipe(RandomUnderwater("II"))
    found = propose("fade", "maps", sequence=True)
    assert statuses(degrade(recipe, found, "wet")).count("written") == 6
    degrade(recipe, found[::-1], "again", workers=2)
    clips = []
    for path in sorted(Path("wet").rglob("*.png.json")):
        assert path.read_bytes() == Path("again", path.relative_to("wet")).read_bytes()
        record = read_record(path)
        (sample,) = record["params"]["samples"]
        clips.append(sample.pop("measured"))
    del sample["moved"], sample["motion"]
    z = torch.from_numpy(metres(H, W))[None]
    settled = recipe.transform.for_clip({"samples": [sample]}, read_picture("fade/film/7.png"), z)
    assert clips == [json.loads(json.dumps(settled["samples"][0]["measured"]))] * 6
    assert set(statuses(degrade(recipe, found, "wet", resume=True))) == {"skipped", "failed"}
    for number in range(8):
        save(maps / f"{number}.npy", 0 * metres(H, W))
    first, *_ = degrade(recipe, found, "none").failures
    assert "no frame serves to settle the film's draw: film/4.png: distance must be" in first


def test_odd_scenes_are_told_of() -> None:
    save("depth/1.npy", 50 * metres(H, W))
    recipe = Recipe(RandomUnderwater(RandomWater("7C", contrast=0.4)))
    summary = degrade(recipe, rows()[:2], "out")
    odd, *_ = summary.asked
    expected = "odd scenes: 1, such as 1.png: pure water has less than a contrast of 0.4 at "
    assert odd.startswith(expected)
    assert degrade(recipe, rows()[:2], "out", resume=True).asked == summary.asked
    for number, result in enumerate(summary.results):
        record = read_record(Path(f"out/{result.place}.json"))
        # whatever the water, metres are those of the map
        median = float(np.median(np.load(f"depth/{number}.npy")))
        assert record["clarity"]["metres"] == pytest.approx(median, rel=0.01)
        assert record["odd"] == result.odd


def test_a_picture_is_blank_where_most_of_it_is_lost() -> None:
    shares = (0.4, 0.5, 0.6)
    for number, share in enumerate(shares):
        z = np.full((H, W), 0.3, np.float32)
        z[:, : round(share * W)] = 50
        z[: H // 2] = np.inf  # open water, of which nothing can be lost
        save(f"depth/{number}.npy", z)
    summary = degrade(Recipe(RandomUnderwater("9C", light=None)), rows()[:3], "out")
    lost = [read_record(Path(f"out/{number}.png.json"))["lost"] for number in range(3)]
    assert lost == pytest.approx(list(shares), abs=0.03)
    (question,) = summary.asked
    assert question.startswith("1 pictures, such as 2.png, are lost in the water for the most part")


@pytest.mark.parametrize("end", ["png", "tif"])
def test_pictures_of_12_bits_in_16_are_told_of(end: str) -> None:
    bits = {"12": words() >> 4, "10": words() >> 6, "16": words(), "dark": words() >> 3}
    bits["none"] = 0 * words()
    for name, values in bits.items():
        save(f"raw/{name}.{end}", values)
    save("raw/8.png", pixels() >> 4)  # which is dark, as far as one can tell
    recipe = Recipe(RandomUnderwater("II", distance=1.0))
    summary = degrade(recipe, propose("raw"), "out")
    assert {r.row.picture.stem for r in summary.results if "dark" in r.asked} == {"10", "12"}
    told = f"2 pictures, such as 10.{end}, of 16 bits, hold no number above 4095: have they 12 bits"
    assert any(question.startswith(told) for question in summary.asked)


def test_formats_and_names() -> None:
    odd = 'ü 🐟, "a".tif'
    save(f"many/{odd}", words()), save("many/b.jpg", pixels()), save("many/sub/c.png", words())
    save("z.npy", metres())
    degrade(RECIPE, propose("many", "z.npy"), "out")
    made = {name for name in content("out") if "json" not in name}
    assert made == {odd, "b.jpg", "sub/c.png", "index.csv", "table.csv"}
    assert read_picture("out/sub/c.png").dtype == torch.float32
    with open("out/index.csv", encoding="utf-8", newline="") as file:
        assert odd in [line["name"] for line in csv.DictReader(file)]
    assert read_record(Path(f"out/{odd}.json"))["row"]["name"] == odd
    assert read_picture("out/b.jpg").dtype == torch.uint8


def test_labels() -> None:
    Path("labels").mkdir()
    for number in range(4):  # an object above, which is near, and one below
        Path(f"labels/{number}.txt").write_text("0 .5 .1 1 .2\n1 .5 .9 1 .2\n")
        save(f"depth/{number}.npy", np.repeat(np.linspace(0.2, 20, H), W).reshape(H, W))
    recipe, labelled = Recipe(WATER, min_contrast=0.05), propose("all", "depth", "labels")
    summary = degrade(recipe, labelled, "out", workers=2)
    assert summary.objects == (8, 4)
    assert Path("out/labels/3.txt").read_text() == "0 .5 .1 1 .2\n"
    assert Path("out/images/3.png").exists()
    (seen, hidden) = read_record(Path("out/images/3.png.json"))["objects"]
    assert (seen["key"], seen["kept"], hidden["key"], hidden["kept"]) == (1, True, 2, False)
    assert seen["contrast"] > 0.05 > hidden["contrast"]
    before = content("out")
    again = degrade(recipe, labelled, "out", resume=True)
    assert (again.count("skipped"), again.objects) == (4, (8, 4))
    after = content("out")
    assert after.pop("index.csv") != before.pop("index.csv")
    assert after == before


def test_a_water_file_that_has_changed() -> None:
    text = "wavelength,a,b,K_d\n400,.1,.2,.1\n700,.6,.2,.6\n"
    Path("water.csv").write_text(text)
    recipe = Recipe(RandomUnderwater(RandomWater("water.csv", contrast=None)))
    degrade(recipe, rows()[:1], "out")
    Path("water.csv").write_text(text.replace(".6", ".9"))
    with pytest.raises(FileExistsError, match="out was made with another options_file"):
        degrade(recipe, rows()[:2], "out", resume=True)
    with pytest.raises(ValueError, match=r"water\.csv is gone, or has changed since out"):
        replay("out/0.png.json", "again.png")
    Path("water.csv").write_text(text)
    replay("out/0.png.json", "again.png")
    assert content(".")["again.png"] == content(".")["out/0.png"]


def test_a_sheet() -> None:
    degrade(RECIPE, rows(), "out", sheet=True)
    with Image.open("out/sheet.jpg") as sheet:
        cells = np.asarray(sheet, dtype=float)[12:, 12:].reshape(2, 246, 6, 252, 3).swapaxes(1, 2)
    # the second pair, before and after, and what was drawn above what was made
    for cell, path in zip(cells[0, 2:4], ("all/1.png", "out/1.png"), strict=True):
        picture = read_picture(path).permute(1, 2, 0).numpy()
        assert np.abs(cell[58:230, 4:236].mean((0, 1)) - picture.mean((0, 1))).max() < 8
        assert cell[:, 244:].mean() > 250
    before, after = cells[0, 2:4, :36, :240]
    assert before.min() > 240 > 100 > after.min()


BOXES = [(24, 18, 120, 54), (24, 120, 216, 162)]  # near, above; far, below: x1, y1, x2, y2


def test_a_sheet_shows_kept_and_dropped_boxes() -> None:
    Path("labels").mkdir()
    lines = (
        f"0 {(x1 + x2) / 480} {(y1 + y2) / 360} {(x2 - x1) / 240} {(y2 - y1) / 180}\n"
        for x1, y1, x2, y2 in BOXES
    )
    Path("labels/a.txt").write_text("".join(lines))
    save("dark/a.png", np.full((180, 240, 3), 30, np.uint8))
    save("far/a.npy", np.repeat(np.linspace(0.2, 30, 180), 240).reshape(180, 240))
    recipe = Recipe(RandomUnderwater(RandomWater("II", visibility=15)), min_contrast=0.05)
    summary = degrade(recipe, propose("dark", "far", "labels"), "out", sheet=True)
    assert summary.objects == (2, 1)
    with Image.open("out/sheet.jpg") as sheet:
        drawn = np.asarray(sheet, dtype=int)
    picture = drawn[-12 - 180 : -12, -12 - 240 : -12]  # the second of a row
    is_red = (picture[..., 0] > 150) & (picture[..., 1] < 90)
    is_yellow = (picture[..., 0] > 150) & (picture[..., 1] > 150) & (picture[..., 2] < 110)
    for is_drawn, box in zip((is_yellow, is_red), BOXES, strict=True):
        rows, columns = is_drawn.nonzero()
        ends = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
        assert np.abs(np.subtract(ends, box)).max() <= 1


# Once more


def test_replay() -> None:
    degrade(RECIPE, rows(), "out")
    replay("out/2.png.json", "again.png")
    assert Path("again.png").read_bytes() == Path("out/2.png").read_bytes()
    with pytest.raises(FileExistsError, match=r"force=True \(--force\) writes over it"):
        replay("out/2.png.json", "again.png")
    Path("all/2.png").rename("moved.png")
    with pytest.raises(FileNotFoundError):
        replay("out/2.png.json", "again.png", force=True)
    replay("out/2.png.json", "again.png", picture="moved.png", force=True)
    assert Path("again.png").read_bytes() == Path("out/2.png").read_bytes()
    with pytest.raises(ValueError, match="is read, and would be written over"):
        replay("out/2.png.json", "moved.png", picture="moved.png", force=True)
    save("depth/2.npy", 2 * metres(H, W))
    with pytest.raises(ValueError, match=r"depth/2\.npy has changed since .*2\.png\.json was"):
        replay("out/2.png.json", "again.png", picture="moved.png", force=True)


def test_records_of_another_version_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    degrade(RECIPE, rows()[:1], "new")
    record = read_record(Path("new/0.png.json"))
    replay("new/0.png.json", "same.png")  # silent: a warning would be an error
    for name in ("uwaug", "torch", "numba"):
        write_record(Path("old.json"), {**record, name: "0.0.1"})
        with pytest.warns(UserWarning, match=rf"old.json was written by .*{name} 0\.0\.1"):
            replay("old.json", "again.png", force=True)
    numba = pytest.importorskip("numba")
    assert record["numba"] == numba.__version__
    monkeypatch.setenv("UWAUG_FAST", "0")
    with pytest.warns(UserWarning, match=r"0\.png\.json was written by .* and numba "):
        replay("new/0.png.json", "again.png", force=True)
    assert (read_picture("again.png").int() - read_picture("new/0.png").int()).abs().max() <= 1


def test_a_medium_under_lamps_is_made_again_from_its_record() -> None:
    medium = Medium.from_water("3C", vertical_depth=5, surfaces="spectral")
    light = Light((Lamp((0.4, -0.3, 0.0), 3.0),), daylight=0.1)
    degrade(Recipe(RandomUnderwater(medium, light=light)), rows()[:1], "new")
    replay("new/0.png.json", "again.png")
    assert Path("new/0.png").read_bytes() == Path("again.png").read_bytes()


@pytest.mark.parametrize("text", ["", "[]", "{}", "[" * 100_000])
def test_what_is_no_record(text: str) -> None:
    Path("a.json").write_text(text)
    with pytest.raises(ValueError, match=r"a\.json: is no record of a picture"):
        replay("a.json", "again.png")


@pytest.mark.skipif(sys.platform != "linux", reason="names are bytes on Linux alone")
def test_a_name_that_is_not_utf_8_fails_alone(run: Callable[..., tuple[int, str, str]]) -> None:
    name = os.fsdecode(b"all/caf\xe9.png")
    save("all/0.png", pixels()).rename(name)
    code, out, err = run("degrade", "all", "--distance", "3", "--out", "out", "--workers", "1")
    assert (code, "3 of 4 pictures" in out) == (1, True)
    assert "caf\\xe9.png: the name of its file, or of a folder, is not UTF-8: rename it" in err
    with open("out/index.csv", encoding="utf-8", newline="") as file:
        rows = {row["name"]: row["status"] for row in csv.DictReader(file)}
    assert rows["caf\\xe9.png"] == "failed"
    assert [*rows.values()].count("written") == 3


def test_one_bad_picture_does_not_stop_the_rest() -> None:
    Path("all/1.png").write_bytes(b"")
    save("depth/3.npy", metres(9, 9))
    summary = degrade(RECIPE, rows(), "out")
    assert statuses(summary) == ["written", "failed", "written", "failed"]
    first, second = summary.failures
    assert first.startswith("1.png: all/1.png: cannot be decoded")
    assert second.startswith("3.png: distance is (9, 9) but image is (24, 32)")
    with open("out/index.csv", newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["status"] for line in lines] == statuses(summary)
    assert lines[3]["reason"] == second.removeprefix("3.png: ")
    assert [line["result"] for line in lines] == ["0.png", "1.png", "2.png", "3.png"]
    assert not Path("out/1.png").exists()


@pytest.mark.parametrize(
    "options, maps, out, message",
    [
        ({}, None, "out", "distance is missing: 4 of 4 pictures have no map, such as 0.png"),
        ({}, "depth", "all", "is read, and would be written over"),
        ({}, "depth", "out.png", r"out \(--out\) must be a folder, got out.png"),
        ({"unit": "mm"}, "mm", "mm", "mm/0.png is read, and would be written over"),
        ({"min_contrast": 0.1}, "depth", "out", "are of labels, of which none are given"),
        ({"classes": "data.yaml"}, "depth", "out", "are of labels, of which none are given"),
        ({"transform": {"water": "II"}}, "depth", "out", "must be a uwaug.RandomUnderwater"),
        ({"unit": "inch"}, "depth", "out", "unit must be one of m, cm, mm"),
        ({"variants": 0}, "depth", "out", "variants must be 1 or more"),
        ({"motion": 2}, "depth", "out", "motion must be three numbers"),
        ({"quality": 0}, "depth", "out", "quality must be in"),
    ],
)
def test_refusals(options: dict[str, Any], maps: str | None, out: str, message: str) -> None:
    for number in range(4):
        save(f"mm/{number}.png", (1000 * metres(H, W)).astype(np.uint16))
    before = content(".")
    with pytest.raises((ValueError, TypeError), match=message):
        degrade(Recipe(**{"transform": WATER, **options}), propose("all", maps), out)
    assert content(".") == before


# What is stopped


def test_two_results_in_one_file_are_refused() -> None:
    save("all/0.tif", pixels(H, W))
    with pytest.raises(ValueError, match=r"would both be written to .*maps/0_\w+\.npy: rename one"):
        degrade(Recipe(WATER, maps="npy"), propose("all", "depth/0.npy"), "out")
    save("all/sheet.jpg", pixels(H, W))
    with pytest.raises(ValueError, match=r"--sheet and all/sheet\.jpg would both be written"):
        degrade(Recipe(RandomUnderwater(distance=2)), propose("all"), "out", sheet=True)
    assert not Path("out").exists()


def test_a_process_that_dies_takes_no_other_job_with_it() -> None:
    jobs = [str(number) for number in range(8)]
    jobs[3] = "deadly"
    expected = [f"did {job}" for job in jobs]
    expected[3] = "died over deadly"
    assert list(on_processes(Deadly(), jobs, 2)) == expected


COMMAND = """
from uwaug.files import *
from test_run import RECIPE
if __name__ == "__main__":
    print(degrade(RECIPE, propose("all", "z.npy"), "out", workers=2, resume={resume}).failures)
"""


def start(resume: bool) -> "subprocess.Popen[bytes]":
    Path("command.py").write_text(COMMAND.format(resume=resume))
    paths = [os.environ["PYTHONPATH"], str(Path(__file__).parent)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    return subprocess.Popen([sys.executable, "command.py"], env=environment, start_new_session=True)


def wait_for(what: Callable[[], bool], seconds: float = 600) -> None:
    """Until it is so; workers may have to compile the loops first, on a machine that is busy."""
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end
        time.sleep(0.01)


def living(leader: int) -> Iterator[int]:
    """The processes of a group that have not ended. Linux."""
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            state, _, group = (entry / "stat").read_text().rsplit(")", 1)[1].split()[:3]
        except OSError:
            continue
        if int(group) == leader and state != "Z":
            yield int(entry.name)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc")
def test_killed_and_resumed() -> None:
    for number in range(12):
        save(f"all/{number}.png", pixels(120, 160, seed=number))
    save("z.npy", metres(120, 160))
    degrade(RECIPE, propose("all", "z.npy"), "whole")
    process = start(resume=False)
    wait_for(lambda: len(list(Path("out").glob("*.png"))) >= 3)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    # its workers end with it
    wait_for(lambda: not any(living(process.pid)), 20)
    assert len(list(Path("out").glob("*.png"))) < 12
    (Path("out") / f".uwaug-{'0' * 16}.part").touch()
    assert start(resume=True).wait() == 0
    found, whole = content("out"), content("whole")
    lines = found.pop("index.csv").decode()
    assert set(re.findall("skipped|written|failed", lines)) == {"skipped", "written"}
    whole.pop("index.csv")
    assert found == whole
