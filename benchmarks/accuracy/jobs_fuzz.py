"""Damaged files: each gives a picture, or a reason that a person understands.

`python -m benchmarks.accuracy.jobs_fuzz [COUNT]` damages COUNT files, 10 000 by default: pictures
and distances of every format, with flipped bits, blocks of zeros, missing ends. Each is handed to
`uwaug.jobs.Degrader` in a process that is watched. It writes results/jobs_fuzz.json: for each
format how many were refused and how many degraded, the slowest and the largest, and everything that
is wrong: a reason that is no sentence, a half file, a picture of the wrong size, a process that
died or hung.
"""

import argparse
import json
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tifffile
import torch
from PIL import Image

from benchmarks.harness import ROOT, peak_of, save
from uwaug._support.atomic import is_part
from uwaug.io.read import read_picture_file
from uwaug.jobs import Degrader, DistanceFormat, Item, Recipe, Sidecar
from uwaug.jobs.sidecar import sidecar_path

SEED = 11
SIZE = (40, 60)
HANG = 20
"""Seconds, after which a file counts as one that hangs."""

MOST = 400 * 2**20
"""Bytes, above which a file of 40×60 px counts as one that swells."""

UNCLEAR = re.compile(
    r"\b[A-Z]\w*(Error|Exception|Warning)\b|PosixPath|\b0x[0-9a-f]{6,}|<_?\w+[. ]|\bb'|\n"
)
"""What stands in a traceback or a repr, and in no sentence."""

Save = Callable[[Path], object]


class Sample(NamedTuple):
    """A file to be damaged.

    Attributes:
        name: of the file.
        save: writes it.
        distances: whether it holds distances, not a picture.
    """

    name: str
    save: Save
    distances: bool = False


def smooth(channels: int, top: float, dtype: Any) -> Any:
    """HxWxC: a slope and some noise, as pictures are."""
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    slope = (rows + columns) / sum(SIZE)
    noisy = 0.8 * slope[..., None] + 0.2 * rng.random((*SIZE, channels))
    return (noisy * top).astype(dtype)


def metres() -> Any:
    """HxW, 1…5 m."""
    return 1 + 4 * smooth(1, 1, np.float32)[..., 0]


def _exr(path: Path, z: Any) -> None:
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": z}).write(str(path))


def _png16(path: Path, values: Any) -> None:
    from imagecodecs import png_encode

    path.write_bytes(png_encode(values))


def _pfm(path: Path, z: Any) -> None:
    head = f"Pf\n{z.shape[1]} {z.shape[0]}\n-1.0\n"
    path.write_bytes(head.encode() + z[::-1].tobytes())


def samples() -> dict[str, Sample]:
    """One of each format."""
    bits8, bits16 = smooth(3, 255, np.uint8), smooth(3, 65535, np.uint16)
    light, alpha = smooth(3, 1, np.float32), smooth(4, 255, np.uint8)
    z = metres()
    mm = (z * 1000).astype(np.uint16)
    shown = Image.fromarray(bits8)
    exif = Image.Exif()
    exif[0x010F] = "maker"
    rgb = {"photometric": "rgb"}
    return {
        "PNG": Sample("a.png", shown.save),
        "PNG with alpha": Sample("a.png", Image.fromarray(alpha).save),
        "PNG of a palette": Sample("a.png", shown.quantize(64).save),
        "PNG of 16 bits": Sample("a.png", lambda path: _png16(path, bits16)),
        "JPEG": Sample("a.jpg", lambda path: shown.save(path, exif=exif)),
        "JPEG, progressive": Sample("a.jpg", lambda path: shown.save(path, progressive=True)),
        "WebP": Sample("a.webp", lambda path: shown.save(path, exif=exif)),
        "WebP, lossless": Sample("a.webp", lambda path: shown.save(path, lossless=True)),
        "TIFF": Sample("a.tif", lambda path: tifffile.imwrite(path, bits8, **rgb)),
        "TIFF, LZW": Sample(
            "a.tif", lambda path: tifffile.imwrite(path, bits8, compression="lzw", **rgb)
        ),
        "TIFF of 16 bits, deflate": Sample(
            "a.tif", lambda path: tifffile.imwrite(path, bits16, compression="zlib", **rgb)
        ),
        "TIFF of floats": Sample("a.tif", lambda path: tifffile.imwrite(path, light, **rgb)),
        ".npy": Sample("a.npy", lambda path: np.save(path, light)),
        "distances in .npy": Sample("z.npy", lambda path: np.save(path, z), True),
        "distances in .npz": Sample("z.npz", lambda path: np.savez(path, z=z), True),
        "distances in .npz, packed": Sample(
            "z.npz", lambda path: np.savez_compressed(path, z=z), True
        ),
        "distances in PNG": Sample("z.png", Image.fromarray(mm).save, True),
        "distances in TIFF": Sample(
            "z.tif", lambda path: tifffile.imwrite(path, z, compression="zlib"), True
        ),
        "distances in PFM": Sample("z.pfm", lambda path: _pfm(path, z), True),
        "distances in EXR": Sample("z.exr", lambda path: _exr(path, z), True),
    }


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """A copy with something wrong: mostly where formats keep their sizes, at the beginning."""
    kind = rng.choice(["bit", "head", "bits", "block", "end", "twice"])
    values = np.frombuffer(content, np.uint8).copy()
    count = len(values)
    if kind == "end":
        return content[: int(rng.integers(count))]
    if kind == "twice":
        place = int(rng.integers(count))
        return content[:place] + content[max(0, place - 16) :]
    if kind == "block":
        place = int(rng.integers(count))
        values[place : place + int(rng.integers(1, 64))] = rng.choice([0, 255])
        return values.tobytes()
    flips = 8 if kind == "bits" else 1
    places = rng.integers(min(count, 128) if kind == "head" else count, size=flips)
    values[places] ^= np.uint8(1) << rng.integers(8, size=flips).astype(np.uint8)
    return values.tobytes()


def attempt(sample: Sample, content: bytes, folder: Path) -> dict[str, Any]:
    """Degrade a damaged file; say what came of it, and what is wrong with that."""
    (folder / sample.name).write_bytes(content)
    picture, distance = folder / sample.name, folder / "good.npy"
    if sample.distances:
        picture, distance = folder / "good.png", folder / sample.name
    output = folder / "out" / f"result{picture.suffix}"
    unit = "mm" if sample.name == "z.png" else "m"
    recipe = Recipe(water="3C", distance=DistanceFormat(unit=unit, unknown="fill"))
    found: list[Any] = []
    began = time.perf_counter()
    item = Item("a", picture, distance, output)
    peak = peak_of(lambda: found.append(Degrader(recipe, force=True)(item)))
    (outcome,) = found
    seconds = time.perf_counter() - began
    wrong = _wrong_refusal(outcome, folder) if outcome.reason else _wrong_picture(item)
    if peak > MOST:
        wrong = f"{peak / 2**20:.0f} MiB"
    for path in (output, sidecar_path(output)):
        path.unlink(missing_ok=True)
    reason = None if outcome.reason is None else outcome.reason.replace(str(folder), "")
    return {
        "status": outcome.status,
        "reason": reason,
        "seconds": seconds,
        "mib": peak / 2**20,
        "wrong": wrong,
    }


def _wrong_refusal(outcome: Any, folder: Path) -> str | None:
    said = outcome.reason.replace(str(folder), "")
    if UNCLEAR.search(said):
        return "no sentence"
    if str(folder) not in outcome.reason:
        return "names no file"
    out = folder / "out"
    left = [path.name for path in out.iterdir()] if out.exists() else []
    return f"left {', '.join(left)}" if left else None


def _wrong_picture(item: Item) -> str | None:
    read, written = (read_picture_file(file).image for file in (item.input, item.output))
    record = Sidecar.read(sidecar_path(item.output))
    if read.shape != written.shape:
        return f"{tuple(read.shape)} became {tuple(written.shape)}"
    if not bool(written.isfinite().all()):
        return "not finite"
    if record.bytes != item.output.stat().st_size:
        return "the record is of another file"
    parts = [path.name for path in item.output.parent.iterdir() if is_part(path.name)]
    return f"left {', '.join(parts)}" if parts else None


def _child(kind: str, first: int, count: int) -> None:
    """Print a line of JSON for each damaged file of a kind."""
    torch.set_num_threads(1)
    # ends the process: a decoder in C hears nothing else
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    sample = samples()[kind]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sample.save(folder / sample.name)
        content = (folder / sample.name).read_bytes()
        Image.fromarray(smooth(3, 255, np.uint8)).save(folder / "good.png")
        np.save(folder / "good.npy", metres())
        whole = attempt(sample, content, folder)
        if whole["status"] != "done":
            raise ValueError(f"{kind}: the whole file is refused: {whole['reason']}")
        for number in range(first, count):
            signal.alarm(HANG)
            rng = np.random.default_rng([SEED, _number(kind), number])
            print(json.dumps(attempt(sample, damaged(content, rng), folder)), flush=True)
        signal.alarm(0)


def _number(kind: str) -> int:
    return list(samples()).index(kind)


def attempts(kind: str, count: int) -> Iterator[dict[str, Any]]:
    """What came of `count` damaged files of a kind; a process that dies is started again."""
    done = 0
    while done < count:
        code = (
            f"from benchmarks.accuracy.jobs_fuzz import _child; _child({kind!r}, {done}, {count})"
        )
        with subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", code],
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        ) as process:
            assert process.stdout is not None
            before = done
            for line in process.stdout:
                # some decoders print
                if line.startswith("{"):
                    done += 1
                    yield json.loads(line)
        if process.returncode == 1 and done == before:
            raise RuntimeError(f"{kind}: no file could be tried")
        if done < count:
            yield {
                "status": "died",
                "reason": None,
                "seconds": 0.0,
                "mib": 0.0,
                "wrong": f"file {done}: the process ended with {process.returncode}",
            }
            done += 1


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Of one format."""
    reasons = Counter(_alike(one["reason"]) for one in found if one["reason"])
    wrong = [{"what": one["wrong"], "reason": one["reason"]} for one in found if one["wrong"]]
    return {
        "files": len(found),
        "refused": sum(one["status"] == "failed" for one in found),
        "degraded": sum(one["status"] == "done" for one in found),
        "died": sum(one["status"] == "died" for one in found),
        "slowest_s": max(one["seconds"] for one in found),
        "largest_mib": max(one["mib"] for one in found),
        "reasons": dict(reasons.most_common(8)),
        "wrong": wrong,
    }


def _alike(reason: str) -> str:
    return re.sub(r"\d+", "#", reason)[:160]


def main(quick: bool = False, count: int = 10_000) -> dict[str, Any]:
    """Print and save all; return what is saved (nothing is, if quick)."""
    kinds, formats = list(samples()), {}
    each = 2 if quick else -(-count // len(kinds))
    for kind in kinds[::5] if quick else kinds:
        one = formats[kind] = summary(list(attempts(kind, each)))
        told = f"{one['refused']} refused, {one['degraded']} degraded, {len(one['wrong'])} wrong"
        print(f"{kind}: {told}, at most {one['slowest_s']:.2f} s, {one['largest_mib']:.0f} MiB")
        for what in one["wrong"][:5]:
            print(f"   {what}", flush=True)
    results = {"seed": SEED, "files": sum(one["files"] for one in formats.values())}
    results |= {"wrong": sum(len(one["wrong"]) for one in formats.values()), "formats": formats}
    if not quick:
        print(save("jobs_fuzz", results))
    return results


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", nargs="?", type=int, default=10_000)
    parser.add_argument("--quick", action="store_true", help="a smoke test, nothing written")
    arguments = parser.parse_args()
    main(arguments.quick, arguments.count)
