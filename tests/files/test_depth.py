import shlex

import numpy as np
import pytest
import torch
from networks import mean_of_channels
from PIL import Image

from uwaug.distance import Network, from_inverse
from uwaug.files import read_distance, read_picture

OPTIONS = "--mean 0 0 0 --std 1 1 1 --short-side 24 --multiple 1"
PLAIN = OPTIONS.split()


@pytest.fixture
def network(tmp_path, monkeypatch):
    """Three pictures, and a network that takes what is bright for near."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "photos/more").mkdir(parents=True)
    rng = np.random.default_rng(0)
    for name in ("a.png", "b.png", "more/c.png"):
        picture = rng.integers(0, 255, (24, 32, 3), np.uint8)
        Image.fromarray(picture).save(tmp_path / "photos" / name)
    return mean_of_channels("net.onnx")


def test_from_pictures_to_maps_to_water(network, tmp_path, run):
    code, out, err = run("depth", "photos", "--network", network, "--out", "depth", *PLAIN)
    assert (code, err) == (0, "")
    assert "3 of 3 maps written to depth" in out
    options = {"mean": (0, 0, 0), "std": (1, 1, 1), "short_side": 24, "multiple": 1}
    image = read_picture("photos/more/c.png") / 255
    expected = from_inverse(Network(network, **options)(image), 1.0, 5.0)
    kept = from_inverse(read_distance("depth/more/c.png", None), 1.0, 5.0)
    # a step of 16 bits is z²·(1/near − 1/far)/65535
    assert float((kept - expected).abs().max()) < 25 * 0.8 / 65535
    command = shlex.split(out.splitlines()[-1].removeprefix("go on: uwaug "))
    assert run(*command, "--workers", "1")[0] == 0
    assert (tmp_path / "underwater/more/c.png").is_file()


@pytest.mark.parametrize("holds, unit, scale", [("metres", "mm", 1.0), ("relative", None, 1.0)])
def test_metres_and_relative_maps_keep_their_numbers(network, run, holds, unit, scale):
    named = ("--network", network, "--out", "depth", "--holds", holds)
    assert run("depth", "photos/a.png", *named, *PLAIN)[0] == 0
    light = (read_picture("photos/a.png") / 255).mean(0, keepdim=True)
    torch.testing.assert_close(read_distance("depth/a.png", unit), light, atol=6e-4, rtol=0)


def test_maps_of_another_network_never_pass_for_those_of_this_one(network, tmp_path, run):
    named = ("depth", "photos", "--network", network, "--out", "depth", *PLAIN)
    assert run(*named)[0] == 0
    before = (tmp_path / "depth/a.png").read_bytes()
    (tmp_path / "depth/b.png").unlink()
    assert "1 of 3 maps written to depth, 2 were there" in run(*named, "--resume")[1]
    exchanged = ("--std", "-1", "-1", "-1")  # near and far
    code, _, err = run(*named, *exchanged, "--resume")
    assert code == 1
    assert "depth was made with another network: choose another folder" in err
    assert (tmp_path / "depth/a.png").read_bytes() == before
    assert "3 of 3" in run(*named, *exchanged, "--force")[1]
    assert (tmp_path / "depth/a.png").read_bytes() != before


def test_what_goes_wrong_is_named(network, tmp_path, run):
    (tmp_path / "photos/b.png").write_bytes(b"no picture")
    code, out, err = run("depth", "photos", "--network", network, "--out", "depth", *PLAIN)
    assert code == 1
    assert "2 of 3 maps written" in out
    assert "b.png: photos/b.png: cannot be decoded" in err
    (tmp_path / "bad.onnx").write_text("no network")
    code, _, err = run("depth", "photos", "--network", "bad.onnx", "--out", "other")
    assert code == 1
    assert "bad.onnx: ONNX Runtime cannot load it" in err
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "photos/a.jpg")
    code, _, err = run("depth", "photos", "--network", network, "--out", "third", *PLAIN)
    assert code == 2
    assert "photos/a.jpg and photos/a.png would both be written to " in err
