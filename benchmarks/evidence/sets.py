"""The sets that nets are trained and tested on: crops of public repositories, or a kit of them.

The repositories are not committed. Clone them into one folder, each under its own name:

    git clone https://github.com/OWNER/NAME && git -C NAME checkout COMMIT

with owners, names and commits of `SETS`; the commit is the hash of all that a set holds. A kit is a
folder of crops that were cut of them by the rules below:

    land/*.jpg                 photographs in air
    NAME.npz                   images (Nx48x48x3, uint8), labels (N), light (Nx3), numbers (N) of
                               the pictures and, but for the aquaria, films (N)
    references/NAME_I.jpg      what rivals are shown of buoys, deepfish and fjord
"""

import re
import subprocess
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from PIL import Image

from benchmarks.evidence.tasks import COLOURS, SIDE, Array

BUOYS = "robosub_transdec_dataset"
AQUARIA = "Underwater-Object-Detection-YOLO-V8"
WILD = "deepfish-detection"
LAND = "BSDS500"


class Source(NamedTuple):
    """A public repository."""

    owner: str
    commit: str
    folder: str  # that has to be in it


SETS = {
    BUOYS: Source("beaverauv", "6664557bedc91ad876318029063ce68caef53366", "Images"),
    AQUARIA: Source("Chandra0804", "a54dbe6961dd8cea077fe673ef9e50f779a46afb", "aquarium_pretrain"),
    WILD: Source("facingfrost", "3c46ed90375b98addb75915cf44823a86bbf0b8f", "datasets"),
    LAND: Source("BIDS", "a04b7c6c3a9f0ace74bf205c72a43d32e1c72722", "BSDS500/data/images"),
}
"""By the name of the folder."""

COUNTS = {"buoys": 838, "aquaria": 2072, "deepfish": 1137, "fjord": 1970}
"""Crops of the public sets, and of each the kit has those of the films that choose: all of aquaria.
"""

SHOWN = ("buoys", "deepfish", "fjord")
"""Test sets, of which rivals are shown pictures: so many, of the films that choose."""
SHOWN_PICTURES = 8
SHOWN_SIDE = 240  # px, the longer one

SMALLEST_BUOY = 12
"""px, of both sides of its box."""

LONGEST_SIDES = {"aquaria": (40, 500), "deepfish": (24, 200), "fjord": (22, 200)}
"""px, of the longer side of a fish's box, and how many of a picture count, by chance: schools would
outweigh all else.
"""
MOST = {"aquaria": 4, "deepfish": 3, "fjord": 1}

AQUARIA_FISH = ("0", "4", "6")
"""Fish, sharks and rays; jellyfish, puffins, penguins and starfish are none."""

AROUND = 1.6
"""Times the longer side of its box is the side of a crop: water round it belongs to the question.
"""

BLACK = 10.0
"""Of 255: rows above and below whose mean is darker are letterboxes. They are no part of a picture:
most places without fish would show one.
"""

LEFT_OUT = frozenset({715, *range(101, 510), *range(1500, 1573)})
"""Pictures of buoys: a red one that is labelled green; a grey pool, with one yellow and one green
buoy among 403; rendered ones.
"""

BUOY_FILMS = (1, 101, 510, 557, 646, 721, 940, 1001, 1300, 1573, 1609, 1661)
FJORD_FILMS = (
    *(0, 66, 136, 156, 176, 256, 316, 476, 496, 556, 636, 666, 736, 826),
    *(906, 946, 1066, 1226, 1386, 1506, 1546, 1566, 1616, 1626, 1716, 1746, 1816, 1846),
)
"""The picture with which each film begins, as seen on sheets; in the fjord counted in the order of
the numbers in their names, which its folders share.
"""

CHOOSING = {
    "buoys": frozenset({2, 4, 7, 9, 10}),
    "deepfish": frozenset({7117, 7426, 7434, 7585, 9852, 9866, 9870, 9894, 9907, 9908}),
    "fjord": frozenset({0, 2, 4, 5, 6, 11, 14, 16, 20, 23, 25}),
}
"""Films, or places, by which variants are chosen; the others judge. No two parts share one."""


class Crops(NamedTuple):
    """Crops with a truth."""

    images: Array  # Nx48x48x3, uint8
    labels: Array  # N
    light: Array  # Nx3: mean linear light of the whole picture, for grey-world
    blocks: Array  # N: ten neighbours in a film share one
    films: Array  # N: film or place
    judges: Array  # N: whether it is of the part that judges, else of the part that chooses


class Sets(NamedTuple):
    """All that the benchmark reads."""

    land: list[Array]  # HxWx3, 0…1
    crops: dict[str, Crops]  # of each name of `COUNTS`
    references: dict[str, list[Array]]  # of each name of `SHOWN`: pictures without labels, HxWx3


class _Picture(NamedTuple):
    """A picture with its boxes."""

    path: Path
    boxes: Array  # Mx4: left, top, right, bottom, px
    chosen: Array  # of these, those that are cut
    labels: Array  # of those
    number: int  # in its film
    film: int  # or place


def load(data: Path) -> Sets:
    """The sets of a folder: a kit, or clones of the public repositories.

    Raises:
        SystemExit: if something is missing, has another state, or holds no crop; with the cure.
    """
    if any((data / f"{name}.npz").exists() for name in COUNTS):
        return _kit(data)
    require(data)
    return cut(data)


def _kit(data: Path) -> Sets:
    crops, references = {}, {}
    for name in COUNTS:
        path = data / f"{name}.npz"
        if not path.exists():
            raise SystemExit(f"{path} is missing: a kit has {', '.join(COUNTS)}")
        arrays = np.load(path)
        labels = arrays["labels"].astype(int)
        films = arrays["films"] if "films" in arrays else np.zeros(len(labels), int)
        judges = ~np.isin(films, list(CHOOSING[name])) if name in CHOOSING else films > 0
        blocks = _blocks(films, arrays["numbers"])
        crops[name] = Crops(arrays["images"], labels, arrays["light"], blocks, films, judges)
    for name in SHOWN:
        paths = [data / f"references/{name}_{i}.jpg" for i in range(SHOWN_PICTURES)]
        missing = [path for path in paths if not path.exists()]
        if missing:
            raise SystemExit(f"{missing[0]} is missing: a kit shows {SHOWN_PICTURES} of each set")
        references[name] = [_read(path) for path in paths]
    return Sets(_land(data / "land"), _filled(crops, data), references)


def cut(data: Path) -> Sets:
    """The sets of clones, whatever their state."""
    pictures = {
        "buoys": list(_buoy_pictures(data / BUOYS)),
        "aquaria": list(_aquarium_pictures(data / AQUARIA / "aquarium_pretrain")),
        "deepfish": list(_deepfish_pictures(data / WILD / "datasets")),
        "fjord": list(_fjord_pictures(data / WILD / "datasets/fish4knowledge")),
    }
    crops = {name: _crops(name, pictures[name]) for name in COUNTS}
    references = {name: _references(name, pictures[name]) for name in SHOWN}
    return Sets(_land(data / LAND / "BSDS500/data/images"), _filled(crops, data), references)


def require(data: Path) -> None:
    """Refuses a folder that lacks a repository, or has another state of it, and says what to do."""
    for name, source in SETS.items():
        folder = data / name
        address = f"https://github.com/{source.owner}/{name}"
        if not folder.is_dir():
            raise SystemExit(
                f"{folder} is missing: git clone {address} {folder}"
                f" && git -C {folder} checkout {source.commit}"
            )
        command = ["git", "-C", str(folder), "rev-parse", "HEAD"]
        head = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
        if head != source.commit or not (folder / source.folder).is_dir():
            cure = f"git -C {folder} checkout {source.commit}"
            raise SystemExit(f"{folder} is at {head or 'no commit'}: {cure}")


def _filled(crops: dict[str, Crops], data: Path) -> dict[str, Crops]:
    for name, part in crops.items():
        if len(np.unique(part.labels)) < 2:
            raise SystemExit(f"{data}: no crops of {name} with labels that differ")
    return crops


def _land(folder: Path) -> list[Array]:
    photographs = [_read(path) / 255 for path in sorted(folder.rglob("*.jpg"))]
    if not photographs:
        raise SystemExit(f"{folder}: no photographs in air")
    return photographs


def _buoy_pictures(folder: Path) -> Iterator[_Picture]:
    for path in sorted((folder / "Annotations").glob("*.xml"), key=lambda path: int(path.stem)):
        number, boxes, labels = int(path.stem), [], []
        for thing in ElementTree.parse(path).iter("object"):
            colour = thing.findtext("name", "").removeprefix("buoy_")
            if colour in COLOURS and number not in LEFT_OUT:
                corners = ("xmin", "ymin", "xmax", "ymax")
                boxes.append([float(thing.findtext(f"bndbox/{name}", "0")) for name in corners])
                labels.append(COLOURS.index(colour))
        if boxes:
            corners = np.array(boxes)
            chosen = np.flatnonzero((corners[:, 2:] - corners[:, :2]).min(1) >= SMALLEST_BUOY)
            image = folder / "Images" / f"{number}.jpg"
            film = _film(BUOY_FILMS, number)
            yield _Picture(image, corners, chosen, np.array(labels)[chosen], number, film)


def _aquarium_pictures(folder: Path) -> Iterator[_Picture]:
    paths = [path for part in ("train", "valid", "test") for path in _texts(folder / part)]
    for number, path in enumerate(paths):
        yield from _fish(path, "aquaria", number, 0)


def _deepfish_pictures(folder: Path) -> Iterator[_Picture]:
    """Of the part that is called val, the only one with labels besides train; names begin with the
    place.
    """
    for number, path in enumerate(sorted((folder / "labels/val").glob("*.txt"))):
        yield from _fish(path, "deepfish", number, int(path.name.split("_")[0]))


def _fjord_pictures(folder: Path) -> Iterator[_Picture]:
    """Of all parts: they share films, by chance."""
    paths = [path for part in ("train", "valid", "test") for path in _texts(folder / part)]
    numbered = sorted(paths, key=lambda path: (_leading_number(path), path.name))
    for number, path in enumerate(numbered):
        yield from _fish(path, "fjord", number, _film(FJORD_FILMS, number))


def _texts(part: Path) -> list[Path]:
    return sorted((part / "labels").glob("*.txt"))


def _leading_number(path: Path) -> int:
    digits = re.match(r"\d+", path.name)
    if digits is None:
        raise SystemExit(f"{path}: expected a name that begins with a number")
    return int(digits[0])


def _film(beginnings: tuple[int, ...], number: int) -> int:
    return int(np.searchsorted(beginnings, number, "right")) - 1


def _fish(path: Path, name: str, number: int, film: int) -> Iterator[_Picture]:
    """A picture by its file of labels, "class x y width height" in shares of the picture; none if
    it has no fish of the sizes that count. Boxes of other classes are no place without fish.
    """
    parts = ["images" if part == "labels" else part for part in path.parts]
    image = Path(*parts).with_suffix(".jpg")
    rows = [line.split()[:5] for line in path.read_text().splitlines() if line.strip()]
    if not rows:
        return
    if not image.exists():
        raise SystemExit(f"{image} is missing, {path} has its labels")
    with Image.open(image) as file:
        width, height = file.size
    x, y, w, h = np.array([row[1:] for row in rows], float).T
    boxes = np.stack([x - w / 2, y - h / 2, x + w / 2, y + h / 2], 1)
    boxes *= [width, height, width, height]
    is_fish = np.array([name != "aquaria" or row[0] in AQUARIA_FISH for row in rows])
    longest = (boxes[:, 2:] - boxes[:, :2]).max(1)
    low, high = LONGEST_SIDES[name]
    fish = np.flatnonzero(is_fish & (low <= longest) & (longest <= high))
    if len(fish):
        chosen = _rng(path).permutation(fish)[: MOST[name]]
        yield _Picture(image, boxes, chosen, np.ones(len(chosen), int), number, film)


def _crops(name: str, pictures: Iterable[_Picture]) -> Crops:
    """Crops of the chosen boxes; of fish, and of a place without any for each, of its size."""
    images, labels, light, numbers, films = [], [], [], [], []
    for picture in pictures:
        pixels, boxes = _framed(name, picture)
        mean = ((pixels / 255) ** 2.2).mean((0, 1))
        rng = _rng(picture.path)
        for box, label in zip(boxes[picture.chosen], picture.labels, strict=True):
            side = min(AROUND * (box[2:] - box[:2]).max(), *pixels.shape[:2])
            places = [((box[:2] + box[2:] - side) / 2, label)]
            if name != "buoys":
                places += _elsewhere(boxes, side, pixels, rng)
            for place, there in places:
                images.append(_cut(pixels, place, side))
                labels.append(there)
                light.append(mean)
                numbers.append(picture.number)
                films.append(picture.film)
    of_films = np.array(films, int)
    return Crops(
        np.array(images, np.uint8).reshape(-1, SIDE, SIDE, 3),
        np.array(labels, int),
        np.array(light, float).reshape(-1, 3),
        _blocks(of_films, np.array(numbers, int)),
        of_films,
        ~np.isin(of_films, list(CHOOSING.get(name, {0}))),
    )


def _framed(name: str, picture: _Picture) -> tuple[Array, Array]:
    """Pixels of a picture and its boxes; of wild water without letterboxes."""
    pixels = _read(picture.path)
    if name not in ("deepfish", "fjord"):
        return pixels, picture.boxes
    bright = np.flatnonzero(pixels.mean((1, 2)) >= BLACK)
    if not len(bright):
        return pixels, picture.boxes
    top, bottom = bright[0], bright[-1] + 1
    return pixels[top:bottom], picture.boxes - [0, top, 0, top]


def _elsewhere(
    boxes: Array, side: float, pixels: Array, rng: np.random.Generator
) -> list[tuple[Array, int]]:
    """One place of this side that touches no box; none where 50 tries find none."""
    height, width = pixels.shape[:2]
    for _ in range(50):
        place = rng.uniform(0, 1, 2) * (width - side, height - side)
        if not ((boxes[:, :2] < place + side) & (boxes[:, 2:] > place)).all(1).any():
            return [(place, 0)]
    return []


def _cut(pixels: Array, place: Array, side: float) -> Array:
    """A square of a picture, moved into it where it hangs out, at 48x48 px. Bilinear: boxes make
    mosaics of small ones.
    """
    height, width = pixels.shape[:2]
    left, top = np.clip(place, 0, [width - side, height - side])
    box = (left, top, left + side, top + side)
    square = Image.fromarray(pixels).resize((SIDE, SIDE), Image.Resampling.BILINEAR, box)
    return np.array(square)


def _references(name: str, pictures: list[_Picture]) -> list[Array]:
    """Pictures of the films that choose, at equal steps, small."""
    choosing = [picture for picture in pictures if picture.film in CHOOSING[name]]
    if not choosing:
        raise SystemExit(f"{name}: no picture of the films that choose")
    shown = []
    for index in np.linspace(0, len(choosing) - 1, SHOWN_PICTURES).round().astype(int):
        small = Image.fromarray(_framed(name, choosing[index])[0])
        small.thumbnail((SHOWN_SIDE, SHOWN_SIDE))
        shown.append(np.array(small))
    return shown


def _blocks(films: Array, numbers: Array) -> Array:
    """Ten neighbours in a film share one."""
    pairs = np.stack([films, numbers // 10], 1)
    return np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1)


def _rng(path: Path) -> np.random.Generator:
    """By the name of a file."""
    return np.random.default_rng(zlib.crc32(path.name.encode()))


def _read(path: Path) -> Array:
    return np.array(Image.open(path).convert("RGB"))
