"""Pictures and maps as people bring them: shapes, kinds of numbers, names, layers of renderers."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch
from filing import metres, pixels, save
from PIL import ExifTags, Image

from uwaug import RandomDevelopment, RandomUnderwater, RandomWater
from uwaug.files import (
    Recipe,
    degrade,
    propose,
    read_distance,
    read_picture,
    read_record,
    replay,
)
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear

H, W = 24, 32
Run = Callable[..., tuple[int, str, str]]
Z, GREY = metres(H, W), pixels(H, W)[..., 0]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def save_exr(path: str, layers: dict[str, Any]) -> str:
    exr = pytest.importorskip("OpenEXR")
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    exr.File({"type": exr.scanlineimage}, layers).write(path)
    return path


# Pictures


def opaque(values: Any) -> Any:
    return np.concatenate([values, np.full_like(values[..., :1], 255)], -1)


@pytest.mark.parametrize(
    "name, values, options",
    [
        ("a.png", GREY, {}),
        ("a.jpg", np.full((H, W), 90, np.uint8), {}),
        ("a.npy", GREY, {}),
        ("a.tif", GREY, {"photometric": "minisblack"}),
        ("a.png", np.stack([GREY, np.full_like(GREY, 255)], -1), {}),
        ("a.png", GREY.astype(np.uint16) * 257, {}),
        ("a.tif", GREY.astype(np.uint16) * 257, {"photometric": "minisblack"}),
    ],
)
def test_grey_is_red_green_and_blue(name: str, values: Any, options: dict[str, Any]) -> None:
    image = read_picture(save(name, values, **options))
    expected = torch.from_numpy(values if values.ndim == 2 else values[..., 0]).expand(3, H, W)
    expected = expected if values.dtype == np.uint8 else expected.float() / 65535
    assert torch.equal(image, expected)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.npy"])
def test_an_alpha_that_hides_nothing_is_none(name: str) -> None:
    options = {"photometric": "rgb", "extrasamples": ["unassalpha"]} if "tif" in name else {}
    image = read_picture(save(name, opaque(pixels(H, W)), **options))
    assert torch.equal(image, torch.from_numpy(pixels(H, W)).permute(2, 0, 1))


LIGHT = srgb_to_linear(torch.from_numpy(pixels(H, W) / np.float32(255))).numpy()


def in_adobe_rgb() -> str:
    exif = Image.Exif()
    exif[ExifTags.IFD.Exif] = {ExifTags.IFD.Interop: {ExifTags.Interop.InteropIndex: "R03"}}
    Image.fromarray(pixels(H, W)).save("a.jpg", exif=exif)
    return "a.jpg"


def of_two_sizes() -> str:
    with tifffile.TiffWriter("a.tif") as file:
        for side in (8, H):
            file.write(pixels(side, side), photometric="rgb")
    return "a.tif"


def in_acescg() -> str:
    exr = pytest.importorskip("OpenEXR")
    acescg = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
    header = {"type": exr.scanlineimage, "chromaticities": acescg}
    exr.File(header, {"RGB": LIGHT}).write("a.exr")
    return "a.exr"


def layers(**layers: Any) -> Callable[[], str]:
    return lambda: save_exr("a.exr", {name.replace("_", "."): of for name, of in layers.items()})


@pytest.mark.parametrize(
    "read, made, message",
    [
        (read_picture, lambda: save("a.npy", Z), r"one channel of floating point is a map"),
        (read_picture, layers(Z=Z), "expected one layer RGB or RGBA, got Z"),
        (read_picture, in_acescg, r"got 0\.713, .* convert it first"),
        (read_picture, in_adobe_rgb, "Adobe RGB, without a profile"),
        (read_picture, of_two_sizes, "holds 2 pictures"),
        (read_distance, layers(Far_Depth_Z=Z, Near_Depth_Z=Z / 2), "one layer Z or Y, got Far"),
        (read_distance, layers(X=Z, Y=Z, Z=Z), "expected one layer Z or Y, got X, Y, Z"),
    ],
)
def test_what_may_be_something_else_is_refused(read: Any, made: Any, message: str) -> None:
    path = made()
    with pytest.raises(ValueError, match=rf"{re.escape(str(path))}: .*{message}"):
        read(path)


# Linear light


WATER = RandomWater("3C", contrast=0.5)
RECIPE = Recipe(RandomUnderwater(WATER, distance=2.0))


def exr_pixels(path: str) -> Any:
    return read_picture(path, "linear")


def test_an_exr_stays_linear_light() -> None:
    bright = LIGHT.copy()
    bright[0, 0] = 50  # a lamp
    degrade(RECIPE, propose(save_exr("a.exr", {"RGB": bright})), "wet")
    record = read_record(Path("wet/a.exr.json"))
    assert record["color_space"] == "linear"
    linear = RandomUnderwater(
        WATER, distance=2.0, development=RandomDevelopment(color_space="linear")
    )
    image = torch.from_numpy(bright).permute(2, 0, 1)
    expected = linear.transform(image, None, record["params"])
    assert expected.max() > 1
    assert torch.equal(exr_pixels("wet/a.exr"), expected)
    replay("wet/a.exr.json", "again.exr")
    assert Path("again.exr").read_bytes() == Path("wet/a.exr").read_bytes()
    replay("wet/a.exr.json", "shown.png")
    shown = linear_to_srgb(expected.clamp(0, 1))
    assert (read_picture("shown.png") - shown).abs().max() < 1e-4


def test_light_and_coded_pictures_become_each_other() -> None:
    save("a.png", pixels(H, W))
    save_exr("light/a.exr", {"RGB": LIGHT})
    assert (read_picture("light/a.exr") - read_picture("a.png") / 255).abs().max() < 1e-6
    (row,) = propose("a.png")
    degrade(RECIPE, [row._replace(name="a.exr")], "wet")  # the name says the format
    replay("wet/a.exr.json", "wet.png")
    made = read_picture("wet.png") / 255
    assert (read_picture("wet/a.exr") - made).abs().max() < 0.5 / 255 + 1e-5


def test_a_folder_of_a_renderer() -> None:
    for name in "ab":
        save_exr(f"render/{name}.exr", {"RGBA": opaque(LIGHT).clip(0, 1), "Z": Z})
        save_exr(f"depth/{name}.exr", {"V": Z})
        save_exr(f"apart/{name}.exr", {"RGB": LIGHT})
    recipe = Recipe(RandomUnderwater(WATER))
    degrade(recipe, propose("render", "render"), "own")
    degrade(recipe, propose("apart", "depth"), "other")
    for name in "ab":
        assert torch.equal(exr_pixels(f"own/{name}.exr"), exr_pixels(f"other/{name}.exr"))


# Maps


@pytest.mark.parametrize(
    "name, values",
    [
        ("z.npy", Z[..., None]),
        ("z.npy", Z[None]),
        ("z.npy", Z[None, None]),
        ("z.npy", Z[None, ..., None]),
        ("z.npy", np.repeat(Z[..., None], 3, 2)),
        ("z.tif", Z[None]),
    ],
)
def test_shapes_that_say_nothing(name: str, values: Any) -> None:
    assert torch.equal(read_distance(save(name, values)), torch.from_numpy(Z)[None])


@pytest.mark.parametrize("name", ["z.npy", "z.tif"])
def test_bytes_of_any_order(name: str) -> None:
    values = np.rint(1000 * Z).astype(">u2")
    options = {"byteorder": ">"} if "tif" in name else {}
    z = read_distance(save(name, values, **options), "mm")
    assert torch.equal(z[0], torch.from_numpy((values * 0.001).astype(np.float32)))
    shares = read_distance(name, None)[0]
    assert torch.equal(shares, torch.from_numpy((values / 65535).astype(np.float32)))


def test_arrays_of_an_archive() -> None:
    archives: list[dict[str, Any]] = [
        {"arr_0": Z},
        {"Depth": Z, "mask": Z > 2},
        {"z": Z, "rgb": LIGHT},
    ]
    for arrays in archives:
        np.savez("z.npz", **arrays)
        assert torch.equal(read_distance("z.npz"), torch.from_numpy(Z)[None])
    np.savez("z.npz", a=Z, b=Z)
    with pytest.raises(ValueError, match=r"z\.npz: .*expected one array called depth, got a, b"):
        read_distance("z.npz")
    with pytest.raises(ValueError, match=r"z\.npz: expected a file that ends in \.npy, \.exr"):
        read_picture("z.npz")


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_channels_that_are_equal_are_one(channels: int) -> None:
    alike = np.repeat(GREY[..., None], 3, 2)
    values = {1: GREY, 2: opaque(alike)[..., 2:], 3: alike, 4: opaque(alike)}[channels]
    expected = torch.from_numpy(GREY / np.float32(255))[None]
    assert torch.equal(read_distance(save("z.png", values), None), expected)
    if channels > 2:
        values[3, 4, 1] ^= 1
        with pytest.raises(ValueError, match=r"z\.png: expected one channel .* packed in them"):
            read_distance(save("z.png", values), None)


@pytest.mark.parametrize("kind", ["uint16", "int16", "int32", "int64", "uint32", "uint64"])
def test_whole_numbers_of_any_width(kind: str) -> None:
    values, most = np.rint(1000 * Z).astype(kind), np.iinfo(kind).max
    values[0, :3] = 0, most, most if kind.startswith("u") else -1
    z = read_distance(save("z.npy", values), "mm")
    expected = torch.from_numpy((values * 0.001).astype(np.float32))
    assert torch.equal(z[0, 0, 3:], expected[0, 3:])
    assert not (z[0, 0, :3] > 0).any()
    assert torch.equal(z[0, 1:], expected[1:])


def test_wide_numbers_have_no_white() -> None:
    values = np.arange(H * W).reshape(H, W)
    for kind in ("int16", "int32", "uint32"):
        z = read_distance(save("z.npy", values.astype(kind)), None)
        assert torch.equal(z[0], torch.from_numpy(values).float())


@pytest.mark.parametrize(
    "layers",
    [
        {"RGB": LIGHT, "Z": Z},
        {"Z": Z, "mask": 0 * Z},
        {"Y": Z},
        {"V": Z},
        {"RGB": np.repeat(Z[..., None], 3, 2)},
    ],
)
def test_distances_of_renderers(layers: dict[str, Any]) -> None:
    assert torch.equal(read_distance(save_exr("z.exr", layers)), torch.from_numpy(Z)[None])


# What is said before and after a run


MM, FAR = np.rint(1000 * Z).astype(np.uint16), (Z - Z.min()) / np.ptp(Z)
INVERSE = np.linspace(0.3, 1, H * W, dtype=np.float32).reshape(H, W)
ZEROS = np.pad(np.zeros((3, 5), bool), ((0, H - 3), (0, W - 5)), constant_values=True)
DISPARITY = np.rint(16 * np.linspace(12, 30, 96)[:, None] + np.zeros((96, 128))).astype(np.uint16)
DISPARITY[10:20, 10:30] = 0
MAPS = {
    "mm.png": np.where(GREY > 240, 0, MM).astype(np.uint16),
    "full.png": np.where(GREY > 240, 65535, MM).astype(np.uint16),
    "far.png": np.rint(65535 * FAR).astype(np.uint16),
    "bytes.png": np.full((H, W), 9, np.uint8),
    "shares.npy": np.maximum(FAR, 0.01),
    "zeros.npy": INVERSE * ZEROS,
    "disparity.png": DISPARITY,
}
RELATIVE, BY_INVERSE = "--set distance.kind=Relative", "--set distance.kind=Inverse"
FILLED = "--unit mm --holes behind"
UNIT = "is the unit mm (--unit mm), or are they relative (--set distance.kind=Inverse)?"
ADVICE: list[tuple[str, str, int, str]] = [
    # map, flags, exit code, and what is said
    ("mm.png", "", 1, UNIT),
    ("mm.png", "--unit mm", 1, "--holes behind"),
    ("mm.png", FILLED, 0, ""),
    ("full.png", "", 1, UNIT),
    ("full.png", "--unit mm", 1, "--holes behind"),
    ("full.png", FILLED, 0, ""),
    ("far.png", "", 1, UNIT),
    ("far.png", "--unit mm", 1, "--holes behind"),
    ("far.png", RELATIVE, 0, ""),
    ("far.png", f"{BY_INVERSE} --holes fill", 0, ""),
    ("bytes.png", "", 1, "8 bits are too few"),
    ("shares.npy", "", 0, "distances lie in 0…1, which looks relative: "),
    ("shares.npy", RELATIVE, 0, ""),
    ("zeros.npy", BY_INVERSE, 0, "2 pictures, such as 0.png, have maps with 0, or another end"),
    ("zeros.npy", f"{BY_INVERSE} --holes far", 0, ""),
    ("zeros.npy", f"{BY_INVERSE} --sequence", 0, "each frame's map is stretched from near to far"),
    ("disparity.png", BY_INVERSE, 0, "have maps with 0, or another end"),
]


@pytest.mark.parametrize("name, flags, ends, words", ADVICE)
def test_advice_on_maps(run: Run, name: str, flags: str, ends: int, words: str) -> None:
    values, (stem, end) = MAPS[name], name.split(".")
    for number in range(2):
        save(f"photos/{number}.png", pixels(*values.shape[:2], seed=number))
        save(f"{stem}/{number}.{end}", np.roll(values, number, 1))
    line = ("photos", "--distance", stem, *flags.split(), "--workers", "1", "--out", "wet")
    code, out, err = run("degrade", *line)
    assert code == ends, err
    assert words in out + err
    others = {"--unit mm", "--holes behind", "distance.kind", "looks relative", "have maps with 0"}
    others -= {other for other in others if other in words or other in flags}
    if not words:
        assert not any(other in out + err for other in others)
    # a run that would refuse all of them does not begin
    assert Path("wet").exists() == (ends == 0)


def test_a_picture_of_one_row() -> None:
    assert read_picture(save("a.png", pixels(1, W))).shape == (3, 1, W)
