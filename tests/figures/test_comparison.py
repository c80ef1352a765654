"""Systems side by side: numbers, files, refusals."""

import csv
import json
import math
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import uwaug
from uwaug.figures.comparison import FULLEST, METRES, phase_congruency_difference

pytest.importorskip("phasecongruency")

FEW = ["akkaynak-2018", "hou-2020", FULLEST]


def scene() -> tuple[Tensor, Tensor]:
    """Squares on a slope."""
    generator = torch.Generator().manual_seed(0)
    squares = torch.rand(3, 8, 10, generator=generator)
    image = squares.repeat_interleave(8, 1).repeat_interleave(8, 2)
    return image, torch.linspace(1, 6, 64 * 80).reshape(1, 64, 80)


@pytest.fixture(scope="module")
def found() -> uwaug.figures.Comparison:
    return uwaug.figures.compare(*scene(), "7C", FEW)


def test_rows_are_what_their_presets_say(found: uwaug.figures.Comparison) -> None:
    image, distance = scene()
    assert [row.system for row in found.rows] == FEW == list(found.pictures)
    for row in found.rows:
        own = row.system == "hou-2020"
        preset = uwaug.load_preset(row.system, water=None if own else "7C")
        degrade = uwaug.Underwater(preset.medium, color_space=preset.color_space)
        picture = degrade(image, distance).clamp(0, 1)
        torch.testing.assert_close(found.pictures[row.system], picture)
        means = torch.tensor([row.red, row.green, row.blue])
        torch.testing.assert_close(means, picture.mean((1, 2)))
        z = torch.tensor(METRES).reshape(1, 1, 2)
        left = uwaug.contrast(preset.medium, z).flatten().tolist()
        assert [row.contrast_2m, row.contrast_5m] == pytest.approx(left, rel=1e-4)
        wide = preset.medium.width(z[None], (64, 80)).flatten().tolist()
        assert [row.blur_2m, row.blur_5m] == pytest.approx(wide, rel=1e-4)
        lost = phase_congruency_difference(image, picture)
        assert row.phase_congruency == pytest.approx(lost, rel=1e-6)
    assert found.fixed == ("hou-2020",)
    assert (found.rows[2].delta_e, found.rows[0].blur_2m) == (0, 0)
    assert found.rows[2].blur_5m > found.rows[2].blur_2m > 0


def test_contrast_is_that_under_the_lamp() -> None:
    image, z = torch.rand(3, 40, 60), torch.full((1, 40, 60), 3.0)
    (row,) = uwaug.figures.compare(image, z, "7C", ["jaffe-1990"]).rows
    preset = uwaug.load_preset("jaffe-1990", water="7C")
    plate, focal_px = torch.full((1, 41, 61), 2.0), 60 * 3**0.5 / 2
    left = uwaug.contrast(preset.medium, plate, light=preset.light, focal_px=focal_px)
    assert row.contrast_2m == pytest.approx(float(left[0, 20, 30]), rel=0.03)
    assert row.contrast_2m != pytest.approx(float(uwaug.contrast(preset.medium, plate)[0, 20, 30]))
    own = uwaug.figures.compare(image, z, "7C", ["jaffe-1990"], focal_px=90.0)
    options = {"light": preset.light, "exposure": preset.exposure, "focal_px": 90.0}
    wanted = uwaug.Underwater(preset.medium, color_space=preset.color_space, **options)(image, z)
    torch.testing.assert_close(own.pictures["jaffe-1990"], wanted.clamp(0, 1))


def test_colour_differences_agree_with_scikit_image(found: uwaug.figures.Comparison) -> None:
    from skimage.color import deltaE_ciede2000, rgb2lab

    labs = {}
    for name, picture in found.pictures.items():
        labs[name] = rgb2lab(picture.double().permute(1, 2, 0).numpy())
    for row in found.rows:
        wanted = deltaE_ciede2000(labs[row.system], labs[FULLEST]).mean()
        assert row.delta_e == pytest.approx(wanted, abs=0.05)


def test_all_published_systems_by_default() -> None:
    found = uwaug.figures.compare(*scene())
    names = [row.system for row in found.rows]
    assert names == uwaug.presets.published_systems()
    for row in found.rows:
        assert np.isfinite(list(asdict(row).values())[1:]).all()
        assert found.pictures[row.system].isfinite().all()
    assert found.water == "II"


def test_a_water_of_ones_own(tmp_path: Path) -> None:
    """Spectra reach the systems that take them; one that knows Jerlov types keeps its own."""
    path = tmp_path / "II.csv"  # and is no Jerlov type for being called so
    path.write_text("wavelength,a,b,kd\n400,.9,2,1\n550,.6,2,.8\n700,1,2,1.2\n")
    systems = [FULLEST, "akkaynak-2018", "li-2020", "hou-2020"]
    knows = {name: uwaug.load_preset(name) for name in systems}
    found = uwaug.figures.compare(*scene(), path, systems)
    assert set(found.fixed) == {name for name, preset in knows.items() if preset.spectral is None}
    own = uwaug.load_preset(FULLEST, water=path)
    expected = uwaug.Underwater(own.medium, color_space=own.color_space)(*scene())
    assert torch.allclose(found.pictures[FULLEST], expected.clamp(0, 1), atol=2e-3)
    contents = uwaug.figures.compare(*scene(), "chlorophyll=9,cdom=1", [FULLEST])
    assert contents.water == "chlorophyll=9,cdom=1"
    assert contents.rows[0].contrast_5m != found.rows[0].contrast_5m


def test_information_falls_as_water_thickens() -> None:
    image, distance = scene()
    lost = []
    for name in ("I", "II", "5C", "9C"):
        picture = uwaug.Underwater(uwaug.Medium.from_water(name))(image, distance)
        lost.append(phase_congruency_difference(image, picture))
    assert lost == sorted(lost)
    assert lost[0] < 0.2 < 0.8 < lost[-1]
    assert phase_congruency_difference(image, image) == 0
    noise = torch.rand(3, 60, 80, generator=torch.Generator().manual_seed(0))
    assert math.isnan(phase_congruency_difference(noise, image[..., :60, :80])), "nothing to lose"
    assert phase_congruency_difference(image, torch.full_like(image, 0.5)) == 1


def test_information_ignores_contrast() -> None:
    image, _ = scene()
    faded = 0.3 + 0.4 * image
    blurred = torch.nn.functional.avg_pool2d(image[None], 9, 1, 4)[0]
    kept = phase_congruency_difference(image, faded)
    assert kept < 0.1 * phase_congruency_difference(image, blurred)


def test_tables(found: uwaug.figures.Comparison, tmp_path: Path) -> None:
    wanted = [asdict(row) for row in found.rows]
    found.save(tmp_path / "a.json")
    read = json.loads((tmp_path / "a.json").read_text())
    assert (read["water"], read["fullest"], read["systems"]) == ("7C", FULLEST, wanted)
    found.save(tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["system"] for row in rows] == FEW
    assert float(rows[0]["delta_e"]) == found.rows[0].delta_e
    lines = str(found).splitlines()
    assert len(lines) == 4
    assert len({len(line) for line in lines}) == 1
    with pytest.raises(ValueError, match="ending must be one of"):
        found.save(tmp_path / "a.txt")


def test_uint8_is_the_same_scene() -> None:
    image, distance = scene()
    levels = (image * 255).round().to(torch.uint8)
    one = uwaug.figures.compare(levels, distance, "II", [FULLEST])
    other = uwaug.figures.compare(levels / 255, distance, "II", [FULLEST])
    assert one.rows == other.rows


def test_wrong_arguments() -> None:
    image, distance = scene()
    for arguments, said in (
        ((image, distance, "10C"), "water must be one of I, IA"),
        ((image[None], distance), "image must be one picture"),
        ((image, distance[:, 1:]), "height and width must agree"),
        ((image, distance, "II", []), "systems: expected at least one"),
        ((image, distance, "II", [FULLEST, FULLEST]), "each once"),
        ((image, distance, "II", ["nobody-1900"]), "no preset is called 'nobody-1900'"),
        ((image * 255, distance), "divide a 0…255 image"),
    ):
        with pytest.raises(ValueError, match=said):
            uwaug.figures.compare(*arguments)
    with pytest.raises(TypeError, match=r"systems must be names, such as \['jaffe-1990'\]"):
        uwaug.figures.compare(image, distance, "II", "jaffe-1990")


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "phasecongruency", None)
    with pytest.raises(ImportError, match=r'pip install "\.\[compare\]"'):
        uwaug.figures.compare(*scene())
