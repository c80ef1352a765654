"""Are draws of `RandomUnderwater(distance=MadeUp())` taken for photographs of the sea?

    python -m benchmarks.accuracy.blind --photographs FOLDER --sources FOLDER --out PAGES
    python -m benchmarks.accuracy.blind --out PAGES --verdicts FILE…

The first line mixes 60 photographs taken under water and 60 draws on pictures in air (or on clear,
near photographs of the sea, so that content cannot tell), and writes them as numbered pages of
twenty, all cut to one shape, as shapes would tell; `PAGES/key.json` says which is which. Show the
pages, and nothing else, to someone who has not seen this project. A verdict is a line: the number,
`C` (as for light, colour and haze, taken under water; what is shown does not matter), `O`
(plausible, but odd) or `G` (gives itself away), and a reason. The second line counts.
"""

import argparse
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageOps

import uwaug
from uwaug.distance import MadeUp
from uwaug.files import read_picture

PAGE, ACROSS = 20, 5
SIDE, WIDTH, HEIGHT = (220, 165), 224, 184  # px, of a picture and of its place


def write_pages(photographs: Path, sources: Path, out: Path, seed: int, count: int) -> None:
    """Pages of both kinds, in an order that a seed draws, and the key to them."""
    rng = np.random.default_rng(seed)
    air = sorted(sources.glob("*.jpg"))
    names = {path.name for path in air}  # of underwater subjects, which are not shown as they are
    real = [path for path in sorted(photographs.glob("*.jpg")) if path.name not in names]
    pictures = [Image.open(real[i]).convert("RGB") for i in rng.permutation(len(real))[:count]]
    kinds = ["photograph"] * len(pictures) + ["draw"] * count
    augment = uwaug.RandomUnderwater(distance=MadeUp())
    for index in range(count):
        image = read_picture(air[rng.integers(len(air))])
        drawn = augment.at(seed=seed, epoch=0, index=index)(image)
        pictures.append(Image.fromarray(drawn.movedim(0, -1).numpy()))
    order = rng.permutation(len(pictures)).tolist()
    out.mkdir(parents=True)
    for first in range(0, len(order), PAGE):
        page = Image.new("RGB", (ACROSS * WIDTH, PAGE // ACROSS * HEIGHT), "white")
        pen = ImageDraw.Draw(page)
        for place, which in enumerate(order[first : first + PAGE]):
            x, y = place % ACROSS * WIDTH, place // ACROSS * HEIGHT
            page.paste(ImageOps.fit(pictures[which], SIDE), (x, y + 14))
            pen.text((x + 2, y + 1), str(first + place + 1), "black")
        page.save(out / f"page{first // PAGE + 1}.png")
    (out / "key.json").write_text(json.dumps([kinds[which] for which in order]))


def count(out: Path, verdicts: Sequence[Path]) -> None:
    """How many of each kind each judge called what, and why draws gave themselves away."""
    kinds = json.loads((out / "key.json").read_text())
    for path in verdicts:
        lines = [line.split(maxsplit=2) for line in path.read_text().splitlines() if line.strip()]
        for kind in ("photograph", "draw"):
            of_kind = [line for line in lines if kinds[int(line[0]) - 1] == kind]
            reasons = Counter(" ".join(line[2:]) for line in of_kind if line[1] == "G")
            print(path.name, kind, dict(Counter(line[1] for line in of_kind)), dict(reasons))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--photographs", type=Path)
    parser.add_argument("--sources", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--verdicts", type=Path, nargs="+")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=60, help="of each kind")
    given = parser.parse_args()
    if given.verdicts:
        count(given.out, given.verdicts)
    elif given.photographs and given.sources:
        write_pages(given.photographs, given.sources, given.out, given.seed, given.count)
    else:
        parser.error("give --photographs and --sources, or --verdicts")
