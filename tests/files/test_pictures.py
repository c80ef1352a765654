"""What is written is what was read; what cannot be used is refused by name."""

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch
from filing import H, W, metres, pixels, save, words
from imagecodecs import cms_profile
from PIL import ExifTags, Image, ImageCms, ImageOps

from uwaug.files import read_distance, read_picture, write_picture
from uwaug.files.pictures import open_picture

NAMES = {
    "uint8": ("a.png", "a.TIF", "a.npy"),
    "uint16": ("a.png", "a.tif"),
    "float32": ("a.npy", "a.exr"),
}
LOSSLESS = [(kind, name) for kind, names in NAMES.items() for name in names]


def picture(kind: str) -> torch.Tensor:
    """3xHxW, as `read_picture` gives it."""
    if kind == "uint16":
        return torch.from_numpy(words().transpose(2, 0, 1) / np.float32(65535))
    image = torch.from_numpy(pixels().transpose(2, 0, 1).copy())
    return image if kind == "uint8" else image.float() / 255


@pytest.mark.parametrize("kind, name", LOSSLESS)
def test_nothing_is_lost(tmp_path: Path, kind: str, name: str) -> None:
    image = picture(kind)
    write_picture(tmp_path / name, image)
    again = read_picture(tmp_path / name)
    assert again.dtype == image.dtype
    # an EXR holds linear light, to which and from which sRGB is rounded
    torch.testing.assert_close(again, image, rtol=0, atol=1e-6 if name.endswith("exr") else 0)
    first = (tmp_path / name).read_bytes()
    write_picture(tmp_path / name, image)
    assert (tmp_path / name).read_bytes() == first
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_jpeg_loses_little(tmp_path: Path) -> None:
    smooth = torch.linspace(0, 1, 3 * 64 * 64).reshape(3, 64, 64)
    write_picture(tmp_path / "a.jpg", smooth)
    assert (read_picture(tmp_path / "a.jpg") / 255 - smooth).abs().mean() < 0.01
    write_picture(tmp_path / "less.jpg", smooth, quality=40)
    assert (tmp_path / "less.jpg").stat().st_size < (tmp_path / "a.jpg").stat().st_size


def test_other_programs_files(tmp_path: Path) -> None:
    expected = torch.from_numpy(pixels().transpose(2, 0, 1).copy())
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera was held upright
    turned = Image.fromarray(np.ascontiguousarray(np.rot90(pixels())))
    turned.save(tmp_path / "a.png", exif=exif)
    assert torch.equal(read_picture(tmp_path / "a.png"), expected)
    planes = pixels().transpose(2, 0, 1)
    tifffile.imwrite(tmp_path / "a.tif", planes, photometric="rgb", planarconfig="separate")
    assert torch.equal(read_picture(tmp_path / "a.tif"), expected)
    save(tmp_path / "b.png", words())
    assert torch.equal(read_picture(tmp_path / "b.png"), picture("uint16"))


def _profile(primaries: list[float]) -> bytes:
    """Colour profile with these x, y of red, green and blue, white D65 and gamma 2.2."""
    corners = [(x, y, 1.0) for x, y in zip(primaries[::2], primaries[1::2], strict=True)]
    numbers = [number for corner in corners for number in corner]
    white = [0.3127, 0.329, 1.0]
    return bytes(cms_profile("rgb", whitepoint=white, primaries=numbers, gamma=2.2))


def _to_xyz(primaries: list[float]) -> Any:
    """Matrix from light of these primaries to X, Y, Z of white D65."""
    x, y = np.reshape(primaries, (3, 2)).T
    columns = np.stack([x / y, np.ones(3), (1 - x - y) / y])
    return columns * np.linalg.solve(columns, [0.3127 / 0.329, 1, 0.3583 / 0.329])


DISPLAY_P3 = [0.68, 0.32, 0.265, 0.69, 0.15, 0.06]
ADOBE_RGB = [0.64, 0.33, 0.21, 0.71, 0.15, 0.06]
SRGB = [0.64, 0.33, 0.3, 0.6, 0.15, 0.06]


@pytest.mark.parametrize("primaries", [DISPLAY_P3, ADOBE_RGB])
@pytest.mark.parametrize("name, levels", [("a.png", 0.7), ("a.tif", 0.7), ("b.tif", 0.2)])
def test_colour_profiles_become_srgb(
    tmp_path: Path, primaries: list[float], name: str, levels: float
) -> None:
    path, profile = tmp_path / name, _profile(primaries)
    if name == "b.tif":
        tags = [(34675, 7, len(profile), profile, True)]
        save(path, pixels().astype(np.uint16) * 257, photometric="rgb", extratags=tags)
    else:
        Image.fromarray(pixels()).save(path, icc_profile=profile)
    to_srgb = np.linalg.inv(_to_xyz(SRGB)) @ _to_xyz(primaries)
    light = ((pixels() / 255) ** 2.2 @ to_srgb.T).clip(0, 1)
    expected = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    image = read_picture(path)
    shares = image / (255 if image.dtype == torch.uint8 else 1)
    assert np.abs(shares.permute(1, 2, 0).numpy() - expected).max() * 255 < levels


def test_srgb_by_its_profile_stays(tmp_path: Path) -> None:
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    for name, profile in (("a.png", srgb), ("b.tif", srgb), ("c.png", b"no profile")):
        Image.fromarray(pixels()).save(tmp_path / name, icc_profile=profile)
        assert np.array_equal(read_picture(tmp_path / name).permute(1, 2, 0), pixels())
    light = tmp_path / "light.png"
    Image.fromarray(pixels()).save(light, icc_profile=_profile(DISPLAY_P3))
    assert np.array_equal(read_picture(light, "linear").permute(1, 2, 0), pixels())


def _with_chunks(png: Path, *chunks: tuple[bytes, str, tuple[int, ...]]) -> Path:
    """Put chunks, each a kind, the format of its numbers and these, after the head of a PNG."""
    whole, parts = png.read_bytes(), []
    for kind, numbers, values in chunks:
        data = struct.pack(f">{len(values)}{numbers}", *values)
        parts += [struct.pack(">I", len(data)), kind, data]
        parts += [struct.pack(">I", zlib.crc32(kind + data))]
    png.write_bytes(whole[:33] + b"".join(parts) + whole[33:])
    return png


def _gamma(number: int) -> tuple[bytes, str, tuple[int, ...]]:
    return b"gAMA", "I", (number,)


def _corners(*numbers: float) -> tuple[bytes, str, tuple[int, ...]]:
    """The chunk of a white of D65, and these x, y of red, green and blue."""
    return b"cHRM", "I", tuple(round(1e5 * number) for number in (0.3127, 0.329, *numbers))


SRGB_CHUNK = b"sRGB", "B", (0,)
OF_601 = (0.63, 0.34, 0.31, 0.595, 0.155, 0.07)
CODED: list[tuple[list[Any], float | None]] = [
    # chunks, and the power of light that the numbers are; None for sRGB
    ([_gamma(55000)], 0.55),
    ([_gamma(45455)], None),
    ([_gamma(45000), _corners(*OF_601)], None),
    ([_corners(*SRGB), _gamma(100000)], 1.0),
    ([SRGB_CHUNK, _corners(*DISPLAY_P3), _gamma(100000)], None),
    ([(b"cICP", "B", (1, 13, 0, 1)), _gamma(70000)], None),
    ([SRGB_CHUNK, (b"cICP", "B", (1, 1, 0, 1))], 1 / 1.961),
]


@pytest.mark.parametrize("values", [pixels(), pixels()[..., 0], words(), words()[..., 0]])
@pytest.mark.parametrize("chunks, power", CODED)
def test_a_png_says_what_its_numbers_mean(
    tmp_path: Path, values: Any, chunks: list[Any], power: float | None
) -> None:
    path = _with_chunks(save(tmp_path / "a.png", values), *chunks)
    white = np.iinfo(values.dtype).max
    light = (values / white) ** (1 / (power or 1))
    coded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    expected = np.atleast_3d(coded if power else values / white)
    image = read_picture(path)
    shares = image.double() / (255 if image.dtype == torch.uint8 else 1)
    assert np.abs(shares.permute(1, 2, 0).numpy() - expected).max() * white < 0.6
    # what is written is sRGB, and has no such chunk; distances are numbers, not colours
    write_picture(tmp_path / "b.png", image)
    assert torch.equal(read_picture(tmp_path / "b.png"), image)
    if values.ndim == 2:
        kept = torch.from_numpy((values / white).astype(np.float32))
        assert torch.equal(read_distance(path, None)[0], kept)


@pytest.mark.parametrize(
    "chunk, message",
    [
        ((b"cICP", "B", (9, 18, 0, 1)), "cICP must be sRGB .*, got 9/18/0/1"),
        ((b"cICP", "B", (1, 13, 0, 0)), "got 1/13/0/0"),
        (_corners(*ADOBE_RGB), r"Rec. 709, got 0\.64, 0\.33, 0\.21, .*: convert it first"),
    ],
)
def test_colours_of_a_png_that_are_refused(tmp_path: Path, chunk: Any, message: str) -> None:
    path = _with_chunks(save(tmp_path / "a.png", pixels()), chunk)
    with pytest.raises(ValueError, match=message):
        read_picture(path)


@pytest.mark.parametrize("options", [{"tile": (16, 16)}, {"rowsperstrip": 8}])
def test_jpeg_in_a_tiff(tmp_path: Path, options: dict[str, Any]) -> None:
    rows, columns = np.mgrid[:40, :56]
    smooth = np.stack([4 * columns, 6 * rows, 255 - 2 * rows - 2 * columns], -1).astype(np.uint8)
    path = save(tmp_path / "a.tif", smooth, photometric="rgb", compression="jpeg", **options)
    with tifffile.TiffFile(path) as file:
        assert file.pages.first.tags["PhotometricInterpretation"].value == 6
    made = read_picture(path).permute(1, 2, 0).numpy().astype(int)
    assert np.abs(made - smooth).mean() < 3
    assert np.abs(made - np.asarray(Image.open(path))).max() <= 3


@pytest.mark.parametrize("values", [pixels()[..., 0], words()[..., 0], words()[..., 0] >> 4])
def test_a_tiff_with_white_as_0(tmp_path: Path, values: Any) -> None:
    bits = 12 if values.max() < 4096 and values.dtype == np.uint16 else 8 * values.itemsize
    packed = {"bitspersample": bits} if bits == 12 else {}
    path = save(tmp_path / "a.tif", values, photometric="miniswhite", **packed)
    white = (1 << bits) - 1
    image = read_picture(path)[0]
    levels = image if bits == 8 else (image * 65535).round()
    assert torch.equal(levels.int(), torch.from_numpy(white - values.astype(np.int32)))
    with pytest.raises(ValueError, match="got MINISWHITE"):
        read_distance(path, None)


CAMERA = {"Make": "Nauticam", "Model": "X", "DateTime": "2021:03:04 05:06:07"}
PLACE = {1: "S", 2: (12.0, 30.0, 1.5)}


def _taken(orientation: int = 1) -> bytes:
    """EXIF of a camera, with a maker's note, and a thumbnail."""
    exif = _exif(orientation)
    exif.update({ExifTags.Base[name]: text for name, text in CAMERA.items()})
    inner = {"FocalLength": 18.0, "FocalLengthIn35mmFilm": 27, "DateTimeOriginal": "2021:03:04"}
    exif[ExifTags.IFD.Exif] = {
        **{ExifTags.Base[name]: value for name, value in inner.items()},
        **{ExifTags.Base.MakerNote: b"a small picture", ExifTags.Base.ColorSpace: 65535},
        ExifTags.IFD.Interop: {ExifTags.Interop.InteropIndex: "R03"},
    }
    exif[ExifTags.IFD.GPSInfo] = PLACE
    return exif.tobytes()


@pytest.mark.parametrize("kind", ["uint8", "uint16"])
@pytest.mark.parametrize("source", ["a.png", "a.jpg", "a.tif"])
@pytest.mark.parametrize("result", ["b.png", "b.jpg", "b.tif"])
def test_exif_goes_with_the_result(tmp_path: Path, source: str, result: str, kind: str) -> None:
    profile = _profile(ADOBE_RGB)
    Image.fromarray(pixels()).save(tmp_path / source, exif=_taken(6), icc_profile=profile)
    exif = open_picture(tmp_path / source).exif
    write_picture(tmp_path / result, picture(kind), exif=exif)
    again = open_picture(tmp_path / result)
    assert (again.orientation, again.exif) == (1, exif)
    assert again.image.shape == (3, H, W)
    if not result.endswith("jpg"):
        assert torch.equal(again.image, picture(kind))
    kept = Image.Exif()
    kept.load(exif)
    assert {ExifTags.TAGS[tag]: kept[tag] for tag in kept if isinstance(kept[tag], str)} == CAMERA
    inner = {ExifTags.TAGS[t] for t in kept.get_ifd(ExifTags.IFD.Exif)}
    assert inner == {"FocalLength", "FocalLengthIn35mmFilm", "DateTimeOriginal"}
    assert kept.get_ifd(ExifTags.IFD.GPSInfo) == PLACE


def test_a_thumbnail_stays_dry_for_no_one(tmp_path: Path) -> None:
    small = io.BytesIO()
    Image.fromarray(pixels()).save(small, "JPEG")
    # IFD0 without entries, then IFD1 with the place and length of a thumbnail
    number = len(small.getvalue())
    tags = struct.pack("<HHHIIHHIII", 2, 0x201, 4, 1, 44, 0x202, 4, 1, number, 0)
    block = b"Exif\0\0II*\0" + struct.pack("<IHI", 8, 0, 14) + tags + small.getvalue()
    Image.fromarray(pixels()).save(tmp_path / "a.jpg", exif=block)
    assert small.getvalue() in (tmp_path / "a.jpg").read_bytes()
    write_picture(tmp_path / "b.jpg", picture("uint8"), exif=open_picture(tmp_path / "a.jpg").exif)
    assert b"Exif" not in (tmp_path / "b.jpg").read_bytes()


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif"])
def test_pictures_are_upright(tmp_path: Path, name: str, orientation: int) -> None:
    values = np.zeros((16, 8, 3), np.uint8)
    values[:8, :4], values[8:, :4] = 200, 100
    Image.fromarray(values).save(tmp_path / name, exif=_exif(orientation))
    upright = ImageOps.exif_transpose(_with_exif(Image.fromarray(values), orientation))
    expected = torch.from_numpy(np.array(upright).transpose(2, 0, 1))
    error = (read_picture(tmp_path / name).int() - expected.int()).abs()
    assert error.max() <= (4 if "jpg" in name else 0)
    assert open_picture(tmp_path / name).orientation == orientation


def _exif(orientation: int) -> Image.Exif:
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    return exif


def _with_exif(image: Image.Image, orientation: int) -> Image.Image:
    image.getexif().update(_exif(orientation))
    return image


@pytest.mark.parametrize("unit, scale", [("m", 1.0), ("cm", 0.01), ("mm", 0.001), (0.25, 0.25)])
@pytest.mark.parametrize("name", ["z.npy", "z.tif", "z.png"])
def test_distances_in_all_units(tmp_path: Path, name: str, unit: Any, scale: float) -> None:
    counts = np.rint(metres() / scale).astype(np.uint16)
    z = read_distance(save(tmp_path / name, counts), unit)
    assert z.shape == (1, H, W)
    assert torch.equal(z, torch.from_numpy((counts * scale).astype(np.float32))[None])


def test_distances_as_they_are(tmp_path: Path) -> None:
    values = metres()
    values[0, :3] = (0, np.nan, np.inf)
    z = read_distance(save(tmp_path / "z.npy", values))
    assert np.array_equal(z[0], values, equal_nan=True)


def _png(mode: str, alpha: int = 255, **options: Any) -> bytes:
    file = io.BytesIO()
    image = Image.fromarray(pixels()).convert(mode)
    if mode == "RGBA":
        image.putalpha(alpha)
    image.save(file, "PNG", **options)
    return file.getvalue()


def _npy(values: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, values, allow_pickle=True)
    return file.getvalue()


def _tiff(values: Any, **options: Any) -> bytes:
    file = io.BytesIO()
    tifffile.imwrite(file, values, **options)
    return file.getvalue()


def _animated() -> bytes:
    file, image = io.BytesIO(), Image.fromarray(pixels())
    image.save(file, "PNG", save_all=True, append_images=[Image.fromarray(pixels(seed=1))])
    return file.getvalue()


def _palette() -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels()).convert("P").save(file, "TIFF")
    return file.getvalue()


WHOLE = _png("RGB")
REFUSED: list[tuple[str, bytes, str]] = [
    ("a.png", _png("RGBA", alpha=254), "without alpha"),
    ("a.png", _png("P"), "got P"),
    ("a.png", WHOLE[: len(WHOLE) // 2], "cannot be decoded"),
    ("a.png", b"", "cannot be decoded"),
    ("a.gif", WHOLE, r"a file that ends in \.npy"),
    ("a.png", _png("L", transparency=7), "got a transparent colour"),
    ("a.npy", _npy(np.zeros((2, 12, 16, 3), np.uint8)), "got shape .2, 12, 16, 3."),
    ("a.npy", _npy(np.array([{}])), "cannot be decoded"),
    ("a.npy", _npy(pixels().astype(np.int32)), "8 or 16 bits, .* got int32"),
    ("a.npy", _npy(metres())[:200], "cannot be decoded"),
    ("a.npy", _npy(np.empty((0, 4, 3))), "holds no pixels"),
    ("a.tif", _tiff(pixels(), photometric="ycbcr"), "expected RGB or grey, got YCBCR"),
    ("a.tif", _tiff(pixels(channels=4), photometric="separated"), "RGB or grey, got CMYK"),
    ("a.tif", _palette(), "RGB or grey, got PALETTE"),
    ("a.tif", _tiff(pixels(channels=4), photometric="rgb"), "got shape .12, 16, 4."),
    ("a.tif", _tiff(np.stack([pixels()] * 3), photometric="rgb"), "holds 3 pictures"),
    ("a.tif", _tiff(np.stack([words(1)[..., 0]] * 3), imagej=True), "holds 3 pictures"),
    ("a.png", _animated(), "holds 2 pictures"),
]


@pytest.mark.parametrize("name, data, message", REFUSED)
def test_pictures_that_are_refused(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ValueError, match=message) as refused:
        read_picture(tmp_path / name)
    assert str(tmp_path / name) in str(refused.value)


@pytest.mark.parametrize(
    "values, unit, message",
    [
        (pixels(), "m", "expected one channel .* packed"),
        (pixels()[..., 0], "mm", "8 bits are too few for distances in mm"),
        (1000 * metres(), "m", "farther than one sees: is the unit mm"),
        (metres(), "inch", "unit must be one of m, cm, mm"),
        (metres(), -1, "unit must be finite and > 0 m"),
    ],
)
def test_maps_that_are_refused(tmp_path: Path, values: Any, unit: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read_distance(save(tmp_path / "z.npy", values), unit)


def test_a_picture_that_would_fill_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 50)
    for name in ("a.png", "a.tif"):
        path = save(tmp_path / name, pixels(), **({"photometric": "rgb"} if "tif" in name else {}))
        with pytest.raises(ValueError, match="cannot be decoded"):
            read_picture(path)


def test_no_file_is_none(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_picture(tmp_path / "a.png")
    with pytest.raises(ValueError, match="ends in"):
        write_picture(tmp_path / "a.bmp", picture("uint8"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("text, number", [("-9999", -9999.0), ("0 ", 0), ("1.5", 1.5)])
def test_gdals_nodata_is_unknown(tmp_path: Path, text: str, number: float) -> None:
    values = metres()
    values[2:5, 3] = number
    path = save(tmp_path / "z.tif", values, extratags=[(42113, "s", 0, text, True)])
    expected = torch.from_numpy(np.where(values == number, np.nan, values))[None]
    for unit in ("m", None):
        assert torch.equal(read_distance(path, unit).nan_to_num(-1), expected.nan_to_num(-1))
