"""Every kind of map comes out as it went in, in metres, or is refused by name."""

import io
import re
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import tifffile
import torch
from imagecodecs import png_encode
from PIL import Image

from uwaug.distance.convert import along_ray, from_disparity
from uwaug.io import DistanceFormat, read_distance, read_mask

RNG = np.random.default_rng(0)
BYTES = RNG.integers(0, 256, (6, 9, 3), dtype=np.uint8)
METRES = np.array([[0.0, np.nan, 1.5, 2.0, 0.5], [3.25, np.inf, 4.0, 5.5, 3]], dtype=np.float32)
MILLIMETRES = np.array(
    [[0, 1500, 2000, 2500, 3250], [3250, 4000, 5500, 6000, 900]], dtype=np.uint16
)
NOTHING = np.zeros_like(METRES)

Write = Callable[[Path], object]


def png16(values: np.ndarray) -> Write:
    return lambda path: path.write_bytes(png_encode(values.copy()))


def tiff(values: np.ndarray) -> Write:
    return lambda path: tifffile.imwrite(path, values)


def pillow(values: np.ndarray) -> Write:
    return lambda path: Image.fromarray(values).save(path)


def npy(values: np.ndarray) -> Write:
    return lambda path: np.save(path, values)


def pfm(path: Path) -> None:
    """From the bottom row up, little-endian."""
    path.write_bytes(b"Pf\n5 2\n-1.0\n" + METRES[::-1].astype("<f4").tobytes())


def pgm(maximum: int) -> Write:
    """Millimetres of 16 bits, big-endian."""
    header = f"P5\n5 2\n{maximum}\n".encode()
    return lambda path: path.write_bytes(header + MILLIMETRES.astype(">u2").tobytes())


def exr(**channels: np.ndarray) -> Write:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    return lambda path: OpenEXR.File(header, channels).write(str(path))


DISTANCES: dict[str, tuple[str, Write, str]] = {
    "npy": ("z.npy", npy(METRES), "m"),
    "npy of doubles": ("z.npy", npy(METRES[None].astype(np.float64)), "m"),
    "npy, last axis": ("z.npy", npy(METRES[..., None]), "m"),
    "npz": ("z.npz", lambda path: np.savez(path, METRES), "m"),
    "in cm": ("z.npy", npy(METRES * 100), "cm"),
    "in µm": ("z.npy", npy(METRES * 1e6), "um"),
    "TIFF of floats": ("z.tif", tiff(METRES), "m"),
    "PFM": ("z.pfm", pfm, "m"),
    "PGM": ("z.pgm", pgm(65535), "mm"),
    "EXR": ("z.exr", exr(depth=METRES), "m"),
    "EXR with colours": ("z.exr", exr(R=NOTHING, G=NOTHING, B=NOTHING, Z=METRES), "m"),
    "PNG": ("z.png", png16(MILLIMETRES), "mm"),
    "TIFF": ("z.tif", tiff(MILLIMETRES), "mm"),
}


@pytest.mark.parametrize("case", DISTANCES)
def test_distances(case: str, tmp_path: Path) -> None:
    name, write, unit = DISTANCES[case]
    write(tmp_path / name)
    wanted = MILLIMETRES / 1000 if unit == "mm" else METRES
    expected = torch.from_numpy(wanted.astype(np.float32))[None]
    found = read_distance(tmp_path / name, unit)
    torch.testing.assert_close(found, expected, rtol=1e-6, atol=0, equal_nan=True)


WRONG_DISTANCES: dict[str, tuple[str, Write, str, str]] = {
    "mm": ("z.png", png16(MILLIMETRES), "m", "is 3250 m if .*try unit='mm'"),
    "mm in floats": ("z.npy", npy(MILLIMETRES.astype(np.float32)), "m", "try unit='mm'"),
    "µm": ("z.npy", npy(METRES * 1e6), "mm", "try unit='um'"),
    "8 bits": ("z.png", pillow(BYTES[..., 0]), "m", "got uint8: relative depth?"),
    "colours": ("z.png", pillow(BYTES), "m", "distances in one channel, got colour"),
    "flow": ("z.npy", npy(np.stack([METRES, METRES], 2)), "m", "got grey with a second channel"),
    "PGM of fewer grey levels": ("z.pgm", pgm(10_000), "mm", "no binary PGM with a maximum"),
    "complex": ("z.npy", npy(NOTHING * 1j), "m", "numbers of type complex64"),
    "unknown": ("z.npy", npy(NOTHING), "m", "no pixel has a distance > 0"),
    "two": ("z.npz", lambda path: np.savez(path, a=METRES, b=METRES), "m", "array, got a, b"),
    "channels": ("z.exr", exr(R=METRES, G=METRES, B=METRES), "m", "none of them Z: save one"),
    "an unknown unit": ("z.npy", npy(METRES), "ft", "unit must be one of m, cm, mm, um"),
}


@pytest.mark.parametrize("case", WRONG_DISTANCES)
def test_wrong_distances(case: str, tmp_path: Path) -> None:
    name, write, unit, message = WRONG_DISTANCES[case]
    write(tmp_path / name)
    with pytest.raises(ValueError, match=message) as error:
        read_distance(tmp_path / name, unit)
    assert unit == "ft" or str(error.value).startswith(f"{tmp_path / name}: ")


def test_distances_of_open_water_alone(tmp_path: Path) -> None:
    np.save(tmp_path / "z.npy", np.full((4, 5), 1e9))
    assert read_distance(tmp_path / "z.npy").shape == (1, 4, 5)


def test_exr_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    exr(Z=METRES)(tmp_path / "z.exr")
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(ValueError, match=r'z\.exr: OpenEXR is missing: pip install "\.\[exr\]"'):
        read_distance(tmp_path / "z.exr")


def test_masks(tmp_path: Path) -> None:
    wanted = RNG.random((6, 9)) > 0.5
    np.save(tmp_path / "a.npy", wanted)
    Image.fromarray(wanted.astype(np.uint8) * 255).save(tmp_path / "a.png")
    Image.fromarray(wanted).save(tmp_path / "b.png")
    for name in ("a.npy", "a.png", "b.png"):
        found = read_mask(tmp_path / name)
        assert found.dtype == torch.bool
        assert (found[0].numpy() == wanted).all(), name
    Image.fromarray(BYTES).save(tmp_path / "c.png")
    with pytest.raises(ValueError, match="a mask in one channel, got colour"):
        read_mask(tmp_path / "c.png")


# What numbers mean


def test_maps_in_open_files(tmp_path: Path) -> None:
    for case in ("npy", "EXR", "TIFF", "PNG"):
        name, write, unit = DISTANCES[case]
        write(tmp_path / name)
        file = io.BytesIO((tmp_path / name).read_bytes())
        expected = read_distance(tmp_path / name, unit)
        torch.testing.assert_close(read_distance(file, unit), expected, equal_nan=True)


def saved(path: Path, values: np.ndarray) -> Path:
    np.save(path, values)
    return path


def test_disparities_of_another_size_are_px_of_the_picture(tmp_path: Path) -> None:
    format = DistanceFormat("disparity", focal_px=20, baseline_m=0.4, offset_px=1.5)
    path = saved(tmp_path / "z.npy", np.full((6, 8), 5.0, np.float32))
    values, (note,) = format.read(path, (12, 16))
    assert note == "distances of 8×6 px, resampled to 16×12"
    everywhere = from_disparity(torch.full((1, 12, 16), 10.0), 20, 0.4, 1.5)
    torch.testing.assert_close(values, along_ray(everywhere, 20))
    holed = np.full((12, 16), 5.0, np.float32)
    holed[0, :2] = 0, -1
    values, _ = format.read(saved(path, holed), (12, 16))
    assert values.isnan().sum() == values[0, 0, :2].isnan().sum() == 2


def test_relative_maps_are_shares_of_the_largest_number(tmp_path: Path) -> None:
    for dtype, most in ((np.uint8, 255), (np.uint16, 65535)):
        t = np.array([[0, most // 2, most]], dtype)
        values, _ = DistanceFormat("relative").read(saved(tmp_path / "t.npy", t), (1, 3))
        np.testing.assert_allclose(values[0], t / most, rtol=1e-6)


def test_notes_of_a_map(tmp_path: Path) -> None:
    z = np.linspace(1, 4, 192, dtype=np.float32).reshape(12, 16)
    path = saved(tmp_path / "z.npy", z)
    _, (note,) = DistanceFormat().read(path, (12, 16), turned=True)
    assert "turned as its EXIF says" in note
    for factor, median in ((100, "2[45]."), (0.01, "0.02[45].?")):
        _, (note,) = DistanceFormat().read(saved(path, z * factor), (12, 16))
        assert re.fullmatch(rf"median distance {median} m: is the file in another unit\?", note)
    z[:6] = 0
    for unknown, done in (
        ("behind", "filled with what is behind"),
        ("fill", "filled with what is around"),
        ("far", "taken for open water"),
        (3.5, "taken for 3.5 m"),
    ):
        _, (note,) = DistanceFormat(unknown=unknown).read(saved(path, z), (12, 16))
        assert note == f"50 % of the distances are unknown: {done}"
    assert DistanceFormat(unknown="fill").metres(path, (12, 16))[1] == []  # the caller fills them


@pytest.mark.parametrize("size", [(16, 12), (12, 12)])
def test_maps_of_another_view(size: tuple[int, int], tmp_path: Path) -> None:
    path = saved(tmp_path / "z.npy", np.ones(size, np.float32))
    got = f"z.npy: is {size[1]}×{size[0]} but the picture 16×12: they must be of one view"
    with pytest.raises(ValueError, match=got):
        DistanceFormat().read(path, (12, 16))


@pytest.mark.parametrize(
    "options, message",
    [
        ({"kind": "far"}, "distance_kind must be"),
        ({"unit": "miles"}, "distance_unit must be"),
        ({"unknown": "ignore"}, "unknown must be"),
        ({"kind": "disparity"}, "focal_px is missing"),
        ({"kind": "disparity", "focal_px": 9}, "baseline_m is missing"),
        ({"planar": True}, "focal_px is missing"),
        ({"planar": True, "kind": "relative", "focal_px": 9}, "planar would do nothing"),
        ({"baseline_m": 0.1}, "baseline_m would do nothing: distance_kind is 'metric'"),
        ({"offset_px": 3}, "offset_px would do nothing"),
        ({"kind": "relative", "unit": "mm"}, "distance_unit would do nothing"),
        ({"network": "n.onnx"}, "a depth network gives inverse depth, got kind 'metric'"),
    ],
)
def test_formats_that_are_none(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DistanceFormat(**options)
