"""Which maps does `uwaug.distance.doubts` question? True ones, and the same falsified.

Of each map 20 crops (half to all of a side; half of them mirrored) are judged one by one,
as they are and falsified. Maps are the bundled scene's; `--folder` adds `NAME_rgb.png` with
`NAME_depth_mm.png` (16 bits, 0 = unknown).
"""

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.harness import save
from uwaug.distance import doubts
from uwaug.files.pictures import read_distance, read_picture
from uwaug.presets.scene import motorcycle

CROPS = 20
TOGETHER = 8  # crops of one map, judged as a run


def _scaled(inverse: Tensor) -> Tensor:
    """From 0 to 1, as networks' maps are normalised; unknown pixels stay."""
    known = inverse[inverse > 0]
    low, high = known.min(), known.max()
    return torch.where(inverse > 0, (inverse - low) / (high - low), 0.0)


def _inverted(z: Tensor) -> Tensor:
    return torch.where(z > 0, 1 / z.clamp(min=1e-6), 0.0)


def _holed(z: Tensor) -> Tensor:
    holed = z.clone()
    holed[:, : int(0.7 * z.shape[1])] = 0
    return holed


FALSIFIED: dict[str, tuple[str, Callable[[Tensor], Tensor]]] = {
    "true": ("", lambda z: z),
    "upside down": ("", lambda z: z.flip(-2)),
    "disparity": ("disparity", lambda z: 200 * _inverted(z)),
    "1/z": ("disparity", _inverted),
    "disparity, whole pixels": ("whole", lambda z: (200 * _inverted(z)).round()),
    "inverse, 0…1": ("relative", lambda z: _scaled(_inverted(z))),
    "inverse, 8 bits": ("whole", lambda z: (255 * _scaled(_inverted(z))).round()),
    "relative, 0…1": ("relative", _scaled),
    "divided by its largest": ("relative", lambda z: z / z.max()),
    "standardised": ("relative", lambda z: (z - z.mean()) / z.std()),
    "mm": ("whole", lambda z: (1000 * z).round()),
    "cm": ("centimetres", lambda z: 100 * z),
    "km": ("kilometres", lambda z: z / 1000),
    "70 % holes": ("unknown", _holed),
    "another aspect": ("aspect", lambda z: z[..., : int(0.8 * z.shape[-1])]),
}
"""What is done to a map, by name, and a word of the sentence that is wanted."""


def maps(folder: Path | None) -> Iterator[tuple[str, Tensor, Tensor]]:
    """Names, pictures (3xHxW) and distances (1xHxW, m)."""
    scene = motorcycle()
    yield "motorcycle", scene.image, scene.distance
    for path in sorted(folder.glob("*_rgb.png")) if folder else ():
        name = path.name.removesuffix("_rgb.png")
        depth = read_distance(path.with_name(f"{name}_depth_mm.png"), "mm")
        if "motorcycle" not in name:
            yield name, read_picture(path), depth


def crops(
    image: Tensor, z: Tensor, count: int, rng: np.random.Generator
) -> Iterator[tuple[Tensor, Tensor]]:
    """Parts of a picture and of its map."""
    height, width = z.shape[-2:]
    for _ in range(count):
        share = rng.uniform(0.5, 1.0)
        h, w = int(share * height), int(share * width)
        top, left = (int(rng.integers(0, n + 1)) for n in (height - h, width - w))
        part, own = (x[:, top : top + h, left : left + w] for x in (image, z))
        yield (part.flip(-1), own.flip(-1)) if rng.random() < 0.5 else (part, own)


def main(quick: bool, folder: Path | None = None) -> dict[str, Any]:
    """Count what is caught, and what is doubted without a cause."""
    rng, count = np.random.default_rng(0), 4 if quick else CROPS
    cases: dict[str, dict[str, list[bool]]] = {}
    spent = []

    def judge(name: str, word: str, pairs: list[tuple[Tensor, Tensor]]) -> None:
        case = cases.setdefault(name, {"caught": [], "together": [], "other": []})
        for image, z in pairs:
            began = time.perf_counter()
            said = doubts(z, image)
            spent.append(time.perf_counter() - began)
            case["caught"].append(any(word in one for one in said) if word else bool(said))
            case["other"].append(bool(said) and not any(word in one for one in said))
        joint = doubts([z for _, z in pairs[:TOGETHER]], [image for image, _ in pairs[:TOGETHER]])
        case["together"].append(any(word in one for one in joint) if word else bool(joint))

    for _, image, z in maps(folder):
        parts = list(crops(image, z, count, rng))
        for name, (word, falsified) in FALSIFIED.items():
            flipped = name == "upside down"
            judge(name, word, [(x.flip(-2) if flipped else x, falsified(y)) for x, y in parts])
    rows = {
        name: {key: float(np.mean(votes)) for key, votes in case.items()}
        | {"count": len(case["caught"])}
        for name, case in cases.items()
    }
    for name, row in rows.items():
        print(f"{name:26}{row['caught']:6.2f}{row['together']:6.2f}{row['other']:6.2f}")
    found = {"cases": rows, "milliseconds": 1000 * float(np.median(spent))}
    print(f"{found['milliseconds']:.1f} ms a map")
    if not quick:
        save("doubts", found)
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="little of everything, not written")
    parser.add_argument("--folder", type=Path, help="more maps")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    main(arguments.quick, arguments.folder)
