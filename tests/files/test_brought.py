"""Pictures and maps as people bring them: shapes, kinds of numbers, names, layers of renderers."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from filing import content, metres, pixels, save
from PIL import Image

from uwaug import RandomDevelopment, RandomUnderwater, RandomWater
from uwaug.distance import Metres
from uwaug.files import (
    Recipe,
    degrade,
    find_items,
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


def save_exr(path: str, **channels: Any) -> str:
    """Write channels, of whose names __ stands for a dot."""
    exr = pytest.importorskip("OpenEXR")
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    layers = {name.replace("__", "."): values for name, values in channels.items()}
    exr.File({"type": exr.scanlineimage}, layers).write(path)
    return path


def same(one: str, other: str) -> bool:
    return {n: b for n, b in content(one).items() if n.endswith("png")} == {
        n: b for n, b in content(other).items() if n.endswith("png")
    }


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


def test_a_map_is_no_picture() -> None:
    save("a.npy", Z)
    with pytest.raises(ValueError, match=r"a\.npy: one channel of floating point is a map"):
        read_picture("a.npy")
    with pytest.raises(ValueError, match=r"a\.exr: .*expected one layer of RGB, got Z"):
        read_picture(save_exr("a.exr", Z=Z))


LIGHT = srgb_to_linear(torch.from_numpy(pixels(H, W) / np.float32(255))).numpy()
VECTOR = {"X": Z, "Y": Z, "Z": Z / 9}


@pytest.mark.parametrize(
    "layers, layer",
    [
        ({"Depth.Z": Z, "Denoising Depth.Z": Z / 2}, Z),
        ({"Depth.Z": Z, **{f"Normal.{axis}": values for axis, values in VECTOR.items()}}, Z),
        ({f"Position.{axis}": values for axis, values in VECTOR.items()}, None),
    ],
)
def test_distances_among_the_layers_of_a_render(layers: dict[str, Any], layer: Any) -> None:
    save_exr("a.exr", RGB=LIGHT, **{f"View.{name}": values for name, values in layers.items()})
    if layer is None:
        with pytest.raises(ValueError, match="expected one layer of Z, got RGB, View"):
            read_distance("a.exr")
    else:
        assert torch.equal(read_distance("a.exr"), torch.from_numpy(layer)[None])


def test_layers_of_colour_that_may_be_the_picture_are_refused() -> None:
    save_exr("a.exr", albedo=LIGHT / 2, beauty=LIGHT, Z=Z)
    with pytest.raises(ValueError, match="expected one layer of RGB, got Z, albedo, beauty"):
        read_picture("a.exr")
    save_exr("b.exr", **{"Background.Combined": LIGHT / 2, "Composite.Combined": LIGHT, "Z": Z})
    assert torch.equal(read_picture("b.exr", "linear"), torch.from_numpy(LIGHT).permute(2, 0, 1))


def test_bits_that_are_not_used_are_told(run: Run) -> None:
    words = pixels(H, W).astype(np.uint16)
    save("photos/a.png", 16 * words)  # 12 bits
    save("photos/b.png", 257 * words)
    save("photos/c.png", pixels(H, W) // 20)  # dark, but of 8 bits
    code, out, _ = run("degrade", "photos", "--distance", "2", "--out", "wet", "--workers", "1")
    assert code == 0
    assert "1 pictures, such as a.png, of 16 bits, reach less than 1/8 of white" in out


def test_zeros_of_a_map_that_nobody_looked_at_before_are_told(run: Run) -> None:
    for number in range(20):
        save(f"photos/{number:02}.png", pixels(H, W))
        inverse = np.linspace(0.3, 1, H * W, dtype=np.float32).reshape(H, W)
        inverse[:3, :5] = 0 if number == 4 else inverse[:3, :5]
        save(f"maps/{number:02}.npy", inverse)
    flags = ("--distance", "maps", "--set", "distance.kind=Inverse", "--workers", "1")
    code, out, _ = run("degrade", "photos", *flags, "--out", "wet")
    assert code == 0
    assert "1 pictures, such as 04.png, have maps with 0" in out
    assert (
        "have maps with 0"
        not in run("degrade", "photos", *flags, "--holes", "far", "--out", "2")[1]
    )
    code, out, _ = run("degrade", "photos", *flags, "--sequence", "--out", "film")
    assert "each frame's map is stretched from near to far on its own" in out


def test_grey_pictures_are_told_of(run: Run) -> None:
    save("photos/a.png", pixels(H, W))
    save("photos/b.png", GREY)
    code, out, _ = run("degrade", "photos", "--distance", "2", "--out", "wet", "--workers", "1")
    assert code == 0
    assert "1 of 2 pictures looked at are grey, such as b.png: R = G = B" in out
    assert np.asarray(Image.open("wet/b.png")).shape == (H, W, 3)


# Linear light


WATER = RandomWater("3C", contrast=0.5)
RECIPE = Recipe(RandomUnderwater(WATER, distance=2.0))


def exr_pixels(path: str) -> Any:
    return read_picture(path, "linear")


def test_an_exr_stays_linear_light() -> None:
    bright = 4 * LIGHT
    items = find_items(Path(save_exr("a.exr", RGB=bright)).resolve())
    degrade(RECIPE, items, "wet.exr")
    record = read_record(Path("wet.exr.json"))
    assert record["color_space"] == "linear"
    linear = RandomUnderwater(
        WATER, distance=2.0, development=RandomDevelopment(color_space="linear")
    )
    image = torch.from_numpy(bright).permute(2, 0, 1)
    expected = linear.transform(image, None, record["params"])
    assert expected.max() > 1
    assert torch.equal(exr_pixels("wet.exr"), expected)
    replay("wet.exr.json", "again.exr")
    assert Path("again.exr").read_bytes() == Path("wet.exr").read_bytes()
    replay("wet.exr.json", "shown.png")
    shown = linear_to_srgb(expected.clamp(0, 1))
    assert (read_picture("shown.png") - shown).abs().max() < 1e-4


def test_light_and_coded_pictures_become_each_other() -> None:
    save("a.png", pixels(H, W))
    save_exr("light/a.exr", RGB=LIGHT)
    assert (read_picture("light/a.exr") - read_picture("a.png") / 255).abs().max() < 1e-6
    degrade(RECIPE, find_items("a.png"), "wet.exr")
    degrade(RECIPE, find_items("a.png"), "wet.png")
    made = read_picture("wet.png") / 255
    assert (read_picture("wet.exr") - made).abs().max() < 0.5 / 255 + 1e-5


def test_a_folder_of_a_renderer() -> None:
    for name in "ab":
        save_exr(f"render/{name}.exr", RGBA=opaque(LIGHT).clip(0, 1), Z=Z)
        save_exr(f"depth/{name}.exr", V=Z)
        save_exr(f"apart/{name}.exr", RGB=LIGHT)
    recipe = Recipe(RandomUnderwater(WATER))
    degrade(recipe, find_items("render", "render"), "own")
    degrade(recipe, find_items("apart", "depth"), "other")
    for name in "ab":
        assert torch.equal(exr_pixels(f"own/{name}.exr"), exr_pixels(f"other/{name}.exr"))
    # maps beside pictures are none
    save("render/c.png", pixels(H, W))
    save_exr("render/c_depth.exr", V=Z)
    assert [item.name for item in find_items("render")] == ["a.exr", "b.exr", "c.png"]
    with pytest.raises(ValueError, match="no pictures in depth"):
        find_items("depth")


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


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_channels_that_are_equal_are_one(channels: int) -> None:
    alike = np.repeat(GREY[..., None], 3, 2)
    values = {1: GREY, 2: opaque(alike)[..., 2:], 3: alike, 4: opaque(alike)}[channels]
    expected = torch.from_numpy(GREY / np.float32(255))[None]
    assert torch.equal(read_distance(save("z.png", values), None), expected)
    if channels > 2:
        values[3, 4, 1] ^= 1
        with pytest.raises(ValueError, match=r"z\.png: .* a map in colours is no distance"):
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
        {"V": Z},
        {"RGB": np.repeat(Z[..., None], 3, 2)},
        {"ViewLayer__Combined__R": 0 * Z, "ViewLayer__Depth__Z": Z, "ViewLayer__Normal__Z": 0 * Z},
        {"RGBA": opaque(LIGHT), "Depth__V": Z},
    ],
)
def test_distances_of_renderers(layers: dict[str, Any]) -> None:
    assert torch.equal(read_distance(save_exr("z.exr", **layers)), torch.from_numpy(Z)[None])


def test_colours_of_renderers() -> None:
    bands = {f"ViewLayer__Combined__{c}": LIGHT[..., k].copy() for k, c in enumerate("RGB")}
    normal = {f"ViewLayer__Normal__{c}": 0 * Z for c in "XYZ"}
    path = save_exr("a.exr", **normal, **bands, ViewLayer__Depth__Z=Z)
    assert torch.equal(exr_pixels(path), torch.from_numpy(LIGHT).permute(2, 0, 1))


def test_advice_ends_at_the_right_maps(run: Run) -> None:
    """Maps that are stretched over 16 bits, and those in mm with an unknown 65535."""
    far = np.rint(65535 * (Z - Z.min()) / np.ptp(Z)).astype(np.uint16)
    mm = np.where(GREY > 240, 65535, np.rint(1000 * Z)).astype(np.uint16)
    for name in "abcd":
        save(f"photos/{name}.png", pixels(H, W))
        save(f"far/{name}.png", far)
        save(f"mm/{name}.png", mm)
        save(f"nought/{name}.png", np.where(GREY > 240, 0, mm))
    flags = ("--workers", "1", "--out")
    code, _, err = run("degrade", "photos", "--distance", "far", *flags, "wet")
    assert code == 1
    assert "relative distances do: --set distance.kind=Inverse where large is near" in err
    code, _, err = run("degrade", "photos", "--distance", "far", "--unit", "mm", *flags, "wet")
    assert code == 1
    assert "if they are relative, 0…1" in err
    code, _, err = run("degrade", "photos", "--distance", "mm", *flags, "wet")
    assert (code, "is the unit mm (--unit mm)?" in err, "distance.kind" in err) == (1, True, False)
    code, _, err = run("degrade", "photos", "--distance", "mm", "--unit", "mm", *flags, "wet")
    assert (code, "--holes behind" in err) == (1, True)
    holes = ("--unit", "mm", "--holes", "behind", *flags)
    assert run("degrade", "photos", "--distance", "mm", *holes, "wet")[0] == 0
    assert run("degrade", "photos", "--distance", "nought", *holes, "other")[0] == 0
    assert same("wet", "other")


def plane(number: int) -> Any:
    """The disparity of a floor, 96x128 px; of each picture another."""
    return np.linspace(12, 30 + number, 96, dtype=np.float32)[:, None] + np.zeros((96, 128), "f")


def test_disparities_are_not_taken_for_millimetres(run: Run) -> None:
    for number in range(4):
        disparity = np.rint(16 * plane(number)).astype(np.uint16)
        disparity[10:20, 10:30] = 0
        save(f"photos/{number}.png", pixels(96, 128))
        save(f"pixels/{number}.png", disparity)
    flags = ("--set", "distance.kind=Inverse", "--workers", "1", "--out")
    code, out, _ = run("degrade", "photos", "--distance", "pixels", *flags, "wet")
    assert code == 0
    assert "1.6 % of a map are 0, a gap away from all other values: unknown? --holes" in out
    assert "--unit mm" not in out


# Names


@pytest.mark.parametrize(
    "pictures, pattern, expected",
    [
        ("photos", "{stem}_z.png", {"a.jpg": "photos/a_z.png"}),
        ("photos", "maps/{stem}_z.png", {"a.jpg": "maps/a_z.png", "r/b.jpg": "maps/r/b_z.png"}),
        ("photos", "maps/{stem}_z", {"a.jpg": "maps/a_z.png", "r/b.jpg": "maps/r/b_z.png"}),
        ("seq", "{stem:rgb=depth}.png", {"rgb_0.jpg": "seq/depth_0.png"}),
        ("seq", "maps/{stem:rgb=depth}.png", {"rgb_0.jpg": "maps/depth_0.png"}),
        ("set", "set/{stem:rgb=depth}.png", {"s/rgb/0.png": "set/s/depth/0.png"}),
        ("ds", "ds/z/{stem}_z.png", {"images/train/0.png": "ds/z/train/0_z.png"}),
    ],
)
def test_names_that_differ(pictures: str, pattern: str, expected: dict[str, str]) -> None:
    for name in (
        *("photos/a.jpg", "photos/a_z.png", "photos/r/b.jpg", "maps/a_z.png", "maps/r/b_z.png"),
        *("seq/rgb_0.jpg", "seq/depth_0.png", "maps/depth_0.png"),
        *("set/s/rgb/0.png", "set/s/depth/0.png", "ds/images/train/0.png", "ds/z/train/0_z.png"),
    ):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).touch()
    for place in (pattern, str(Path.cwd() / pattern) if "/" in pattern else pattern):
        items = {item.name: item.distance for item in find_items(pictures, place)}
        for name, path in expected.items():
            distance = items[name]
            assert distance is not None
            assert distance.resolve() == Path(path).resolve()
        assert not any(
            Path(pictures, name).resolve() == Path(path).resolve()
            for name in items
            for path in expected.values()
        )  # maps are no pictures


def test_maps_without_pictures_are_no_pictures_of_a_pattern() -> None:
    for name in ("rgb_0", "depth_0", "depth_1"):
        save(f"seq/{name}.png", pixels(H, W))
    assert [item.name for item in find_items("seq", "{stem:rgb=depth}.png")] == ["rgb_0.png"]


def test_names_that_begin_with_a_dot_are_none() -> None:
    for name in ("a.png", "._a.png", ".trash/b.png", "r/.c.png"):
        save(f"photos/{name}", pixels(H, W))
    assert [item.name for item in find_items("photos")] == ["a.png"]
    assert [item.name for item in find_items("photos/._a.png")] == ["._a.png"]


@pytest.mark.parametrize(
    "name, cure",
    [
        ("a.HEIC", "magick mogrify"),
        ("a.jfif", "magick mogrify"),
        ("a.pgm", "magick mogrify"),
        ("a.nef", "darktable-cli"),
        ("a.mp4", "ffmpeg -i FILM"),
    ],
)
def test_other_formats_come_with_a_cure(name: str, cure: str, run: Run) -> None:
    Path("photos").mkdir()
    Path("photos", name).touch()
    for source in ("photos", f"photos/{name}"):
        code, _, err = run("degrade", source, "--out", "wet")
        assert (code > 0, err.count("\n"), cure in err) == (True, 1, True)


# Sizes


def test_small_maps_in_files(run: Run) -> None:
    y, x = np.mgrid[:96, :128] / 96
    z = (2 + y + x).astype(np.float32)
    save("photos/a.png", np.repeat((60 * z[..., None]).astype(np.uint8), 3, 2) // 2)
    save("maps/a.npy", z)
    save("small/a.npy", z[2::4, 2::4])
    flags = ("--water", "3C", "--contrast", ".5", "--workers", "1", "--out")
    outs = [
        run("degrade", "photos", "--distance", d, *flags, f"wet-{d}") for d in ("maps", "small")
    ]
    assert [code for code, _, _ in outs] == [0, 0]
    word = "a map is 32×24 px and its picture 128×96 px: it is brought to the picture's size"
    assert [word in out for _, out, _ in outs] == [False, True]
    made = [read_picture(f"wet-{d}/a.png").int() for d in ("maps", "small")]
    assert (made[0] - made[1]).abs().float().mean() < 1
    save("turned/a.npy", z.T.copy())
    code, _, err = run("degrade", "photos", "--distance", "turned", *flags, "no")
    assert (code, "crop, turn and pad both alike" in err) == (1, True)


def test_metres_of_a_sky_in_files() -> None:
    for name, value in (("sky", 1e10), ("inf", np.inf)):
        z = np.where(np.arange(H)[:, None] < 0.58 * H, value, Z).astype(np.float32)
        save(f"{name}/a.npy", z)
    save("photos/a.png", pixels(H, W))
    recipe = Recipe(RandomUnderwater(WATER, distance=Metres()))
    for name in ("sky", "inf"):
        degrade(recipe, find_items("photos", name), f"wet-{name}")
    assert same("wet-sky", "wet-inf")


def test_a_film_is_one_witness(run: Run) -> None:
    for number in range(8):
        save(f"film/{number}.png", pixels(96, 128, seed=number))
        save(f"maps/{number}.npy", plane(number) / 10)
    flags = ("--distance", "maps", "--workers", "1", "--out")
    assert "look like disparity" in run("degrade", "film", *flags, "a")[1]
    assert "look like disparity" not in run("degrade", "film", "--sequence", *flags, "b")[1]


def test_a_picture_of_one_row() -> None:
    assert read_picture(save("a.png", pixels(1, W))).shape == (3, 1, W)
