"""What options of `uwaug degrade` say of maps, and of what is written."""

from pathlib import Path

import numpy as np
import pytest
import torch
from filing import H, W, metres, save, save_pair

from uwaug.distance.convert import along_ray, from_disparity
from uwaug.io.pictures import read_picture
from uwaug.jobs.depth import Depth

WATER = ("--water", "3C")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Where each test works: a picture, and its distances."""
    monkeypatch.chdir(tmp_path)
    save_pair("a.png")
    return tmp_path


def test_disparities_of_another_size_are_px_of_the_picture(folder):
    depth = Depth("disparity", focal_px=20, baseline_m=0.4, offset_px=1.5, unknown="fill")
    image = read_picture("a.png")
    save("z.npy", np.full((H // 2, W // 2), 5.0, np.float32))
    found, (note,) = depth.read(Path("z.npy"), image)
    assert "resampled" in note
    everywhere = from_disparity(torch.full((1, H, W), 10.0), 20, 0.4, 1.5)
    torch.testing.assert_close(found, along_ray(everywhere, 20))
    holed = metres()
    holed[0, :2] = 0, -1
    save("z.npy", holed)
    values = depth.read(Path("z.npy"), image).values
    assert values.isnan().sum() == values[0, 0, :2].isnan().sum() == 2


def test_a_map_of_a_turned_picture_is_noted(folder):
    image = read_picture("a.png")
    (note,) = Depth().read(Path("z.npy"), image, turned=True).notes
    assert "turned as its EXIF says" in note
    assert Depth().read(3.0, image, turned=True).notes == []
    with pytest.raises(ValueError, match=r"distance=3 is metres, but distance_kind is 'inverse'"):
        Depth("inverse").read(3.0, image)


@pytest.mark.parametrize("out", [["v.heic"], ["v.jpg", "--variants", "2"], ["run.v2"]])
def test_a_file_that_cannot_be_the_output_is_no_folder(run, out):
    arguments = ("degrade", "a.png", "--distance", "3", *WATER, "--out", *out)
    code, _, err = run(*arguments)
    assert (code, f"--out {out[0]}: expected the file of one picture" in err) == (2, True)
    assert not Path(out[0]).exists()
    Path(out[0]).mkdir()
    assert run(*arguments)[0] == 0


@pytest.mark.parametrize(
    "options",
    [
        ["--planar", "--focal-px", "9"],
        ["--distance-unit", "mm"],
        ["--distance-kind", "inverse"],
        ["--distance-kind", "disparity", "--focal-px", "9", "--baseline", ".1"],
    ],
)
def test_what_says_something_of_maps_needs_maps(run, options):
    arguments = ("a.png", "--distance", "3", *WATER, "--out", "out")
    code, _, err = run("degrade", *arguments, *options)
    name = options[0].removeprefix("--").replace("-", "_")
    assert (code, f"{name} would do nothing: the distance is a number" in err) == (2, True)
    assert not Path("out").exists()
