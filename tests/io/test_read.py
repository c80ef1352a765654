"""Every kind of file comes out as it went in, or is refused by name."""

import io
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
import torch
from imagecodecs import png_encode
from PIL import Image

import uwaug.io.read
from uwaug.io.read import read_picture, read_picture_file

RNG = np.random.default_rng(0)
BYTES = RNG.integers(0, 256, (6, 9, 3), dtype=np.uint8)
WORDS = RNG.integers(0, 65536, (6, 9, 3), dtype=np.uint16)
LIGHT = RNG.random((6, 9, 3), dtype=np.float32)
ALPHA8 = RNG.integers(0, 256, (6, 9, 1), dtype=np.uint8)
ALPHA16 = RNG.integers(0, 65536, (6, 9, 1), dtype=np.uint16)

Write = Callable[[Path], object]


def png16(values: np.ndarray) -> Write:
    return lambda path: path.write_bytes(png_encode(values.copy()))


def tiff(values: np.ndarray, **options: object) -> Write:
    return lambda path: tifffile.imwrite(path, values, **options)


def pillow(values: np.ndarray, **options: object) -> Write:
    return lambda path: Image.fromarray(values).save(path, **options)


def npy(values: np.ndarray) -> Write:
    return lambda path: np.save(path, values)


PICTURES: dict[str, tuple[str, Write, np.ndarray]] = {
    "PNG": ("a.png", pillow(BYTES), BYTES),
    "WebP": ("a.webp", pillow(BYTES, lossless=True), BYTES),
    "PNG with alpha": ("a.png", pillow(np.concatenate([BYTES, ALPHA8], 2)), BYTES),
    "PNG of 16 bits": ("a.png", png16(WORDS), WORDS),
    "its alpha too": ("a.png", png16(np.concatenate([WORDS, ALPHA16], 2)), WORDS),
    "TIFF": ("a.tif", tiff(BYTES, photometric="rgb"), BYTES),
    "TIFF of 16 bits": ("a.tif", tiff(WORDS, photometric="rgb", compression="lzw"), WORDS),
    "big-endian": ("a.tif", tiff(WORDS, photometric="rgb", byteorder=">"), WORDS),
    "TIFF of floats": ("a.tif", tiff(LIGHT, photometric="rgb"), LIGHT),
    "planar TIFF": (
        "a.tif",
        tiff(WORDS.transpose(2, 0, 1), photometric="rgb", planarconfig="separate"),
        WORDS,
    ),
    "TIFF with alpha": (
        "a.tif",
        tiff(np.concatenate([BYTES, ALPHA8], 2), photometric="rgb", extrasamples=["unassalpha"]),
        BYTES,
    ),
    "npy": ("a.npy", npy(LIGHT), LIGHT),
    "npy, channels first": ("a.npy", npy(LIGHT.transpose(2, 0, 1)), LIGHT),
    "npy of doubles": ("a.npy", npy(LIGHT.astype(np.float64)), LIGHT),
    "a name that lies": ("a.jpg", png16(WORDS), WORDS),
}


@pytest.mark.parametrize("case", PICTURES)
def test_pictures(case: str, tmp_path: Path) -> None:
    name, write, values = PICTURES[case]
    write(tmp_path / name)
    picture = read_picture(tmp_path / name)
    if values.dtype == np.uint8:
        wanted = torch.from_numpy(values.transpose(2, 0, 1).copy())
    else:
        full = 65535 if values.dtype == np.uint16 else 1
        wanted = torch.from_numpy((values.transpose(2, 0, 1) / full).astype(np.float32))
    torch.testing.assert_close(picture, wanted, rtol=0, atol=1e-7)


def test_jpeg_and_a_palette_of_colours(tmp_path: Path) -> None:
    even = np.tile(np.array([200, 60, 20], dtype=np.uint8), (16, 16, 1))
    Image.fromarray(even).save(tmp_path / "a.jpg", quality=95)
    mean = read_picture(tmp_path / "a.jpg").float().mean((1, 2)).numpy()
    np.testing.assert_allclose(mean, even[0, 0], atol=4)
    palette = Image.fromarray(even).quantize(4)
    # a transparent entry, of which Pillow warns
    palette.save(tmp_path / "a.png", transparency=b"\x80\xff")
    assert read_picture(tmp_path / "a.png")[:, 0, 0].tolist() == [200, 60, 20]


@pytest.mark.parametrize("kind", ["jpg", "png", "png of 16 bits", "tif"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation(kind: str, orientation: int, tmp_path: Path) -> None:
    """As Pillow turns the picture."""
    from PIL import ImageOps

    path = tmp_path / f"a.{kind[:3]}"
    bytes = np.kron(BYTES, np.ones((8, 8, 1), dtype=np.uint8))
    exif = Image.Exif()
    exif[0x0112] = orientation
    plain = io.BytesIO()
    options = {"quality": 95} if kind == "jpg" else {}
    form = {"jpg": "JPEG", "tif": "TIFF"}.get(kind, "PNG")
    Image.fromarray(bytes).save(plain, form, exif=exif, **options)
    wanted = np.asarray(ImageOps.exif_transpose(Image.open(plain)))
    if kind == "tif":
        tag = (274, "H", 1, orientation, False)
        tifffile.imwrite(path, bytes * np.uint16(257), photometric="rgb", extratags=[tag])
    elif kind == "png of 16 bits":
        # the chunk with the orientation, between the header and the pixels
        data = png_encode(bytes * np.uint16(257))
        start = plain.getvalue().index(b"eXIf") - 4
        size = int.from_bytes(plain.getvalue()[start : start + 4], "big") + 12
        path.write_bytes(data[:33] + plain.getvalue()[start : start + size] + data[33:])
    else:
        path.write_bytes(plain.getvalue())
    picture = read_picture(path)
    found = picture if picture.dtype == torch.uint8 else picture * 255
    assert found.shape[1:] == wanted.shape[:2]
    np.testing.assert_allclose(found.permute(1, 2, 0).numpy(), wanted, atol=1e-3)


GREYS = Image.fromarray(BYTES[..., 0]).convert("P")
WRONG_PICTURES: dict[str, tuple[str, Write, str]] = {
    "grey": ("a.png", pillow(BYTES[..., 0]), "in colour, got grey: .*save it as RGB"),
    "grey of 16 bits": ("a.png", png16(WORDS[..., 0]), "in colour, got grey"),
    "grey with alpha": ("a.png", pillow(BYTES[..., :2]), "in colour, got grey"),
    "grey npy": ("a.npy", npy(LIGHT[..., 0]), "in colour, got grey"),
    "palette": ("a.png", GREYS.save, "got a palette of greys: .*save it as RGB"),
    "CMYK": ("a.jpg", Image.fromarray(BYTES).convert("CMYK").save, "got CMYK: save it as RGB"),
    "CMYK TIFF": ("a.tif", Image.fromarray(BYTES).convert("CMYK").save, "got CMYK: save"),
    "integers": ("a.npy", npy(BYTES.astype(np.int64)), "got int64: save it as 16 bit"),
    "NaN": ("a.npy", npy(np.full((6, 9, 3), np.nan)), "NaN at 162 and infinite at 0"),
    "a batch": ("a.npy", npy(LIGHT[None]), r"got \(1, 6, 9, 3\): save one picture"),
    "empty": ("a.npy", npy(LIGHT[:0]), "holds no pixels"),
    "pickled": ("a.npy", npy(np.array([{}])), "got a pickle of objects"),
    "text": ("a.png", lambda path: path.write_text("no picture"), "is no picture and no map"),
    "nothing": ("a.png", lambda path: path.write_text(""), "is empty"),
}


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ((58_000, 58_000), "58000 × 58000 px, which is more than 1000 megapixels"),
        ((3, 40_000, 40_000), "40000 × 40000 px"),
        ((30_000, 30_000, 7), "30000 × 30000 px cannot be held in"),
        ((10**9,), "expected \\(H, W\\) or \\(H, W, 3\\), got \\(1000000000,\\)"),
        ((9_000, 9_000), "9000 × 9000 px cannot be held in"),
    ],
)
def test_a_small_archive_of_a_large_array_is_not_unpacked(shape, words, tmp_path, monkeypatch):
    header = io.BytesIO()
    about = {"descr": "|u1", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(header, about)
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", header.getvalue())
    monkeypatch.setattr(np, "load", lambda *_, **__: pytest.fail("it was read"))
    with pytest.raises(ValueError, match=words):
        read_picture(tmp_path / "a.npz")


def test_what_is_left_out_is_said(tmp_path):
    first, *others = (Image.fromarray(values) for values in (BYTES, 255 - BYTES, BYTES))
    for name in ("a.png", "a.webp"):
        first.save(tmp_path / name, save_all=True, append_images=others)
        assert read_picture_file(tmp_path / name).left_out == ("2 more frames",)
    first.save(tmp_path / "a.png", save_all=True, append_images=others[:1])
    assert read_picture_file(tmp_path / "a.png").left_out == ("1 more frame",)
    tifffile.imwrite(tmp_path / "a.tif", np.stack([BYTES] * 3), photometric="rgb")
    assert read_picture_file(tmp_path / "a.tif").left_out == ("2 more pages",)
    np.save(tmp_path / "a.npy", LIGHT.astype(np.float64))
    said = "numbers of float64, which become float32"
    assert read_picture_file(tmp_path / "a.npy").left_out == (said,)
    np.save(tmp_path / "a.npy", LIGHT)
    assert read_picture_file(tmp_path / "a.npy").left_out == ()


def test_a_colour_that_stands_for_transparency_becomes_alpha(tmp_path):
    key = tuple(map(int, BYTES[2, 3]))
    Image.fromarray(BYTES).save(tmp_path / "a.png", transparency=key)
    picture = read_picture_file(tmp_path / "a.png")
    np.testing.assert_array_equal(picture.alpha == 0, (BYTES[2, 3] == BYTES).all(-1))
    np.testing.assert_array_equal(picture.image.numpy().transpose(1, 2, 0), BYTES)


@pytest.mark.parametrize("case", WRONG_PICTURES)
def test_wrong_pictures(case: str, tmp_path: Path) -> None:
    name, write, message = WRONG_PICTURES[case]
    write(tmp_path / name)
    with pytest.raises(ValueError, match=message) as error:
        read_picture(tmp_path / name)
    assert str(error.value).startswith(f"{tmp_path / name}: ")


@pytest.mark.parametrize("case", ["PNG", "PNG of 16 bits", "TIFF of 16 bits", "npy"])
def test_half_a_file(case: str, tmp_path: Path) -> None:
    name, write, _ = PICTURES[case]
    path = tmp_path / name
    write(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError) as error:
        read_picture(path)
    assert str(error.value).startswith(f"{path}: ")


@pytest.mark.parametrize("case", PICTURES)
def test_files_that_are_open(case: str, tmp_path: Path) -> None:
    """As data sets hold them, without a place of their own."""
    name, write, _ = PICTURES[case]
    write(tmp_path / name)
    file = io.BytesIO((tmp_path / name).read_bytes())
    from_path, from_bytes = (read_picture_file(f) for f in (tmp_path / name, file))
    assert torch.equal(from_path.image, from_bytes.image)
    assert from_path.bits == from_bytes.bits
    file = io.BytesIO(b"no picture")
    file.name = "named.png"
    with pytest.raises(ValueError, match=r"named\.png: is no picture"):
        read_picture(file)


@pytest.mark.parametrize("case", PICTURES)
def test_damaged_files(case: str, tmp_path: Path) -> None:
    """A picture, or a sentence that names the file: nothing else is raised."""
    name, write, _ = PICTURES[case]
    path, rng = tmp_path / name, np.random.default_rng(list(PICTURES).index(case))
    write(path)
    whole = np.frombuffer(path.read_bytes(), np.uint8)
    said = []
    for _ in range(20):
        damaged = whole.copy()
        places = rng.integers(0, len(whole), rng.integers(1, 9))
        damaged[places] = rng.integers(0, 256, len(places))
        path.write_bytes(damaged[: rng.integers(len(whole) // 2, len(whole) + 1)].tobytes())
        try:
            read_picture(path)
        except ValueError as error:
            said.append(str(error))
    assert said
    assert all(text.startswith(f"{path}: ") for text in said)


def test_what_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_picture(tmp_path / "no.png")
    with pytest.raises(IsADirectoryError):
        read_picture(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="is no regular file"):
        read_picture(tmp_path / "pipe")


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
def test_pictures_may_be_larger_than_pillow_likes(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = tiff(BYTES, photometric="rgb") if name == "a.tif" else pillow(BYTES)
    write(tmp_path / name)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)
    assert read_picture(tmp_path / name).shape == (3, 6, 9)
    assert Image.MAX_IMAGE_PIXELS == 10  # of others
    monkeypatch.setattr(uwaug.io.read, "_MOST", 50)
    with pytest.raises(ValueError, match=rf"{name}: holds 9 × 6 px, which is more than .* megapix"):
        read_picture(tmp_path / name)
