"""The public sets: where they are, that they are what they were, and crops of them.

They are not committed. Clone them into one folder, each under its own name:

    git clone https://github.com/OWNER/NAME && git -C NAME checkout COMMIT

with owners, names and commits of `SETS`. The commit is the hash of all that a set holds.

The lists of the first run are lost. Sizes of crops, the boxes of a picture that count, and what is
a grey pool are written anew here; `FIRST_RUN` has its numbers of crops, to hold against.
"""

import hashlib
import subprocess
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
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
    at_least: int  # files under it


SETS = {
    BUOYS: Source("beaverauv", "6664557bedc91ad876318029063ce68caef53366", "Images", 1696),
    AQUARIA: Source(
        "Chandra0804", "a54dbe6961dd8cea077fe673ef9e50f779a46afb", "aquarium_pretrain/train", 800
    ),
    WILD: Source(
        "facingfrost", "3c46ed90375b98addb75915cf44823a86bbf0b8f", "datasets/fish4knowledge", 800
    ),
    LAND: Source("BIDS", "a04b7c6c3a9f0ace74bf205c72a43d32e1c72722", "BSDS500/data/images", 500),
}
"""By the name of the folder. Texts of these commits were read, not their pictures: how labels are
written, what classes are called. A listing has 1696 pictures of buoys; it leaves out aquaria, fjord
and land, whose numbers are guesses from what the first run used, and from 500 in BSDS500's name.
"""

FIRST_RUN = {"buoys": 838, "grey pool": 403, "aquaria": 2153, "DeepFish": 1155, "fjord": 1767}
"""Crops that it had of each."""

SMALLEST = 12
"""px, of the sides of a box."""

MOST = 4
"""Boxes of one picture that count, the largest: schools would outweigh all else."""

AROUND = 1.6
"""Times the longer side of its box is the side of a crop: water round it belongs to the question.
"""

GREY = 0.5
"""Linear red of the whole picture over the mean of green and blue, above which water is grey."""

LEFT_OUT = frozenset({715, *range(1500, 1573)})
"""Pictures of buoys: a red one that is labelled green; rendered ones."""


class Crops(NamedTuple):
    """Crops with a truth."""

    images: Array  # Nx48x48x3, uint8
    labels: Array  # N
    light: Array  # Nx3: mean linear light of the whole picture, for grey-world
    blocks: Array  # N: ten neighbours in a film share one, which the bootstrap draws whole
    judges: Array  # N: whether it is of the part that judges, else of the part that chooses


class _Picture(NamedTuple):
    """A picture with its boxes."""

    path: Path
    boxes: Array  # Mx4: left, top, right, bottom, px
    labels: Array  # M
    sequence: str  # film or place: no two parts share one
    block: str


def require(data: Path) -> None:
    """Refuses a folder that lacks a set, or has another state of it, and says what to do."""
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
        if head != source.commit:
            cure = f"git -C {folder} checkout {source.commit}"
            raise SystemExit(f"{folder} is at {head or 'no commit'}: {cure}")
        place = folder / source.folder
        there = sum(path.is_file() for path in place.rglob("*"))
        if there < source.at_least:
            raise SystemExit(
                f"{place} has {there} files, expected {source.at_least} or more; which commit"
                f" has them says git -C {folder} log -- {source.folder}; put it into SETS"
            )


def photographs_of_land(data: Path) -> list[Array]:
    """Pictures in air (HxWx3, 0…1)."""
    paths = sorted((data / LAND / "BSDS500/data/images").rglob("*.jpg"))
    return [_read(path) / 255 for path in paths]


def buoys(data: Path) -> tuple[Crops, Crops]:
    """In coloured water, and in the grey pool."""
    crops = _crops(_buoy_pictures(data / BUOYS), empty=False)
    red, green, blue = crops.light.T
    grey = red > GREY * (green + blue) / 2
    return _part(crops, ~grey), _part(crops, grey)


def aquaria(data: Path) -> Crops:
    """Fish and as many places without, in zoos."""
    folder = data / AQUARIA / "aquarium_pretrain"
    parts = [folder / name for name in ("train", "valid", "test")]
    return _crops(_fish_pictures(parts, "0"), empty=True)


def wild(data: Path) -> tuple[Crops, Crops]:
    """Fish and as many places without: DeepFish's part for tests, and the fjord."""
    folder = data / WILD / "datasets"
    deepfish = _fish_pictures([folder / "labels" / "test"], "0")
    fjord = _fish_pictures([folder / "fish4knowledge"], None)
    return _crops(deepfish, empty=True), _crops(fjord, empty=True)


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
            image = folder / "Images" / f"{number}.jpg"
            # numbers go on through a run of a robot; runs have no names
            block, sequence = str(number // 10), str(number // 100)
            yield _Picture(image, np.array(boxes), np.array(labels), sequence, block)


def _fish_pictures(folders: list[Path], fish: str | None) -> Iterator[_Picture]:
    """Pictures by their files of labels, "class x y width height" in shares of the picture.

    All classes are fish where `fish` is None; of others, the boxes count as no place without fish.
    """
    paths = [path for folder in folders for path in sorted(folder.rglob("*.txt"))]
    for index, path in enumerate(path for path in paths if "labels" in path.parts):
        parts = ["images" if part == "labels" else part for part in path.parts]
        image = Path(*parts).with_suffix(".jpg")
        if not image.exists():
            continue
        with Image.open(image) as file:
            width, height = file.size
        rows = [line.split()[:5] for line in path.read_text().splitlines() if line.strip()]
        if not rows:
            continue
        labels = np.array([1 if fish in (None, row[0]) else 0 for row in rows])
        x, y, w, h = np.array([row[1:] for row in rows], float).T
        boxes = np.stack([x - w / 2, y - h / 2, x + w / 2, y + h / 2], 1)
        sized = boxes * [width, height, width, height]
        # DeepFish's names begin with the habitat, others with the film or a number
        sequence = path.name.split("_")[0]
        habitat = sequence if len(sequence) == 4 and "_f0" in path.name else str(index // 100)
        yield _Picture(image, sized, labels, habitat, str(index // 10))


def _crops(pictures: Iterator[_Picture], empty: bool) -> Crops:
    """Crops of the largest boxes; if `empty`, of fish alone, and of as many places without any."""
    images, labels, light, blocks, judges = [], [], [], [], []
    for picture in pictures:
        pixels, sides = None, (picture.boxes[:, 2:] - picture.boxes[:, :2])
        fits = (sides.min(1) >= SMALLEST) & ((picture.labels == 1) | (not empty))
        largest = np.argsort(-sides.prod(1), kind="stable")
        rng = np.random.default_rng(zlib.crc32(picture.path.name.encode()))
        for index in [index for index in largest if fits[index]][:MOST]:
            if pixels is None:
                pixels = _read(picture.path)
                mean = ((pixels / 255) ** 2.2).mean((0, 1))
            box = picture.boxes[index]
            side = min(AROUND * sides[index].max(), *pixels.shape[:2])
            places = [((box[:2] + box[2:] - side) / 2, picture.labels[index])]
            if empty:
                places += _elsewhere(picture.boxes, side, pixels, rng)
            for place, label in places:
                images.append(_cut(pixels, place, side))
                labels.append(label)
                light.append(mean)
                blocks.append(picture.block)
                judges.append(hashlib.sha256(picture.sequence.encode()).digest()[-1] % 2 == 0)
    _, numbers = np.unique(blocks, return_inverse=True)
    shape = (-1, SIDE, SIDE, 3)
    return Crops(
        np.array(images, np.uint8).reshape(shape),
        np.array(labels, int),
        np.array(light, float).reshape(-1, 3),
        numbers,
        np.array(judges, bool),
    )


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
    """A square of a picture, moved into it where it hangs out, at 48x48 px."""
    height, width = pixels.shape[:2]
    left, top = np.clip(place, 0, [width - side, height - side])
    box = (left, top, left + side, top + side)
    square = Image.fromarray(pixels).resize((SIDE, SIDE), Image.Resampling.BOX, box)
    return np.array(square)


def _part(crops: Crops, of: Any) -> Crops:
    return Crops(*(values[of] for values in crops))


def _read(path: Path) -> Array:
    return np.array(Image.open(path).convert("RGB"))
