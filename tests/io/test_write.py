"""What is written is what was read, in every format."""

from pathlib import Path

import numpy as np
import pytest
import tifffile
import torch
from imagecodecs import png_encode
from PIL import Image

from uwaug.io.read import PictureFile, read_picture_file
from uwaug.io.write import FORMATS, format_of, lost, write_picture

RNG = np.random.default_rng(0)
BYTES = RNG.integers(0, 256, (6, 9, 3), dtype=np.uint8)
WORDS = RNG.integers(0, 65536, (6, 9, 3), dtype=np.uint16)
LIGHT = RNG.random((6, 9, 3), dtype=np.float32)
ALPHA = RNG.integers(0, 256, (6, 9, 1), dtype=np.uint8)
PROFILE = b"\0" * 36 + b"acsp" + b"\0" * 88


def source(values, **kept) -> PictureFile:
    picture = torch.from_numpy(values.transpose(2, 0, 1).copy())
    bits = {"u1": 8, "u2": 16, "f4": 32}[values.dtype.str[1:]]
    if bits == 16:
        picture = torch.from_numpy(values.transpose(2, 0, 1).astype(np.float32) / 65535)
    return PictureFile(picture, bits, **kept)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("a.png", BYTES),
        ("a.png", WORDS),
        ("a.tif", BYTES),
        ("a.TIFF", WORDS),
        ("a.tiff", LIGHT),
        ("a.npy", LIGHT),
        ("a.npy", BYTES),
    ],
)
def test_nothing_is_lost(tmp_path, name, values):
    one = source(values)
    write_picture(tmp_path / name, one.image, one)
    again = read_picture_file(tmp_path / name)
    assert torch.equal(again.image, one.image)
    assert again.bits == one.bits
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["a.jpg", "a.jpeg", "a.webp"])
def test_lossy_formats_lose_little(tmp_path, name):
    smooth = np.linspace(0, 255, 96 * 96 * 3).reshape(96, 96, 3).astype(np.uint8)
    one = source(smooth)
    write_picture(tmp_path / name, one.image, one)
    again = read_picture_file(tmp_path / name).image
    assert (again.float() - one.image.float()).abs().mean() < 3


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.webp", "a.npy"])
def test_alpha_is_kept(tmp_path, name):
    one = source(BYTES, alpha=ALPHA[..., 0])
    write_picture(tmp_path / name, one.image, one)
    again = read_picture_file(tmp_path / name)
    np.testing.assert_array_equal(again.alpha, ALPHA[..., 0])


def test_alpha_follows_the_bits(tmp_path):
    one = source(WORDS, alpha=(ALPHA[..., 0].astype(np.uint16) * 257))
    write_picture(tmp_path / "a.webp", one.image, one)
    np.testing.assert_array_equal(read_picture_file(tmp_path / "a.webp").alpha, ALPHA[..., 0])
    write_picture(tmp_path / "a.jpg", one.image, one)
    assert read_picture_file(tmp_path / "a.jpg").alpha is None
    light = source(LIGHT, alpha=ALPHA[..., 0])
    write_picture(tmp_path / "a.tif", light.image, light)
    np.testing.assert_allclose(read_picture_file(tmp_path / "a.tif").alpha, ALPHA[..., 0] / 255)


def test_more_bits_than_a_format_holds_are_rounded(tmp_path):
    for values in (WORDS, LIGHT):
        one = source(values)
        write_picture(tmp_path / "a.webp", one.image, one)
        assert read_picture_file(tmp_path / "a.webp").bits == 8
    one = source(LIGHT)
    write_picture(tmp_path / "a.png", one.image, one)
    again = read_picture_file(tmp_path / "a.png")
    assert again.bits == 16
    assert (again.image - one.image).abs().max() <= 0.5 / 65535 + 1e-7


@pytest.mark.parametrize("values", [BYTES, WORDS])
@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.webp", "a.tif"])
def test_profiles_are_kept(tmp_path, name, values):
    one = source(values, profile=PROFILE)
    write_picture(tmp_path / name, one.image, one)
    assert read_picture_file(tmp_path / name).profile == PROFILE


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.webp"])
def test_exif_is_kept_but_for_orientation(tmp_path, name):
    exif = Image.Exif()
    exif[0x010F] = "Camera"
    exif[0x0112] = 6  # turned by a quarter
    Image.fromarray(BYTES).save(tmp_path / "in.jpg", exif=exif, quality=95)
    one = read_picture_file(tmp_path / "in.jpg")
    assert one.image.shape == (3, 9, 6)
    write_picture(tmp_path / name, one.image, one)
    again = read_picture_file(tmp_path / name)
    assert again.image.shape == (3, 9, 6)
    assert (one.turned, again.turned) == (True, False)
    with Image.open(tmp_path / name) as image:
        assert dict(image.getexif()) == {0x010F: "Camera"}


def test_a_png_of_16_bits_keeps_all_of_it(tmp_path):
    exif = Image.Exif()
    exif[0x010F] = "Camera"
    one = source(WORDS, exif=exif.tobytes(), profile=PROFILE)
    write_picture(tmp_path / "a.png", one.image, one)
    again = read_picture_file(tmp_path / "a.png")
    assert torch.equal(again.image, one.image)
    assert (again.bits, again.profile) == (16, PROFILE)
    with Image.open(tmp_path / "a.png") as image:
        image.load()  # checks the sums
        assert dict(image.getexif()) == {0x010F: "Camera"}


@pytest.mark.parametrize("channels", [3, 4])
def test_an_array_keeps_its_order(tmp_path, channels):
    values = np.concatenate([BYTES, ALPHA], 2)[..., :channels]
    for array in (values, values.transpose(2, 0, 1)):
        np.save(tmp_path / "a.npy", array)
        one = read_picture_file(tmp_path / "a.npy")
        write_picture(tmp_path / "b.npy", one.image, one)
        np.testing.assert_array_equal(np.load(tmp_path / "b.npy"), array)


def test_what_is_lost_is_said():
    one = source(WORDS, alpha=ALPHA[..., 0], exif=b"II", profile=PROFILE)
    assert lost(one, "JPEG") == ["16 bits (it has 8)", "alpha"]
    assert lost(one, "WEBP") == ["16 bits (it has 8)"]
    assert lost(one, "PNG") == []
    assert lost(one, "TIFF") == ["EXIF"]
    assert lost(one, "NPY") == ["EXIF", "colour profile"]
    assert lost(source(LIGHT), "PNG") == ["32 bits (it has 16)"]


def test_the_same_bytes_each_time(tmp_path):
    for suffix in FORMATS:
        one = source(BYTES)
        files = []
        for name in ("a", "b"):
            path = tmp_path / f"{name}{suffix}"
            write_picture(path, one.image, one)
            files.append(path.read_bytes())
        assert files[0] == files[1], suffix


def test_transparent_palettes(tmp_path):
    image = Image.fromarray(BYTES).convert("P")
    image.info["transparency"] = 0
    image.save(tmp_path / "a.png", transparency=0)
    alpha = read_picture_file(tmp_path / "a.png").alpha
    np.testing.assert_array_equal(alpha == 0, np.asarray(image) == 0)
    Image.fromarray(BYTES).convert("P").save(tmp_path / "b.png")
    assert read_picture_file(tmp_path / "b.png").alpha is None


def test_alpha_of_16_bits_and_turned(tmp_path):
    both = np.concatenate([WORDS, ALPHA.astype(np.uint16) * 257], 2)
    (tmp_path / "a.png").write_bytes(png_encode(both))
    np.testing.assert_array_equal(read_picture_file(tmp_path / "a.png").alpha, both[..., 3])
    options = {"photometric": "rgb", "extrasamples": ["unassalpha"]}
    tifffile.imwrite(tmp_path / "a.tif", both, extratags=[(0x0112, 3, 1, 6, True)], **options)
    turned = read_picture_file(tmp_path / "a.tif")
    assert turned.alpha.shape == turned.image.shape[1:] == (9, 6)


def test_unknown_formats(tmp_path):
    for name in ("a.gif", "a", "a.bmp"):
        with pytest.raises(ValueError, match=r"expected a name that ends in \.png"):
            format_of(tmp_path / name)
    one = source(BYTES)
    with pytest.raises(FileNotFoundError):
        write_picture(Path("/nowhere/a.png"), one.image, one)
