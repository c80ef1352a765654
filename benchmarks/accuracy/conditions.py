"""Find the conditions of the default draw, and tell what was left out.

    python -m benchmarks.accuracy.conditions --sources FOLDER --cameras FILE [--write FILE]

Draws from wide ranges, each number on its own, are tried on pictures in air (`--sources`, see
`benchmarks.accuracy.draws`) by the search of `uwaug.like`, each on several pictures. They are
weighted so that underwater photographs, and frames of machines' cameras (`--cameras`: a CSV file in
the form of `results/photographs.csv`, whose second column names the camera), are most likely:

    p(photograph) = Σ weight_c · mean of exp(−d²/2h²) over the pictures on which c was tried

with d the distance in twelve numbers, in standard deviations of photographs. Most weights become 0
(the nonparametric estimate of a mixture by maximum likelihood, Laird 1978, by expectation and
maximisation). A picture's own share in its numbers is in the mean, so weights are of conditions
that look like photographs on *any* scene.

Told twice over: conditions found for one half of the sets and cameras, by the other half; then the
conditions found for all, which `--write` writes. With `--photographs FOLDER`, of pictures of your
own, they are found for those, and nothing is told.
"""

import argparse
import csv
from collections.abc import Iterable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

import uwaug
from benchmarks.accuracy.draws import draws, picture_of, sources
from benchmarks.accuracy.like import judged
from benchmarks.accuracy.photographs import (
    Numbers,
    Picture,
    closeness,
    load_photographs,
    numbers_of,
    standardised,
)
from benchmarks.evidence.arms import by_hand
from benchmarks.harness import save
from uwaug.files import read_picture
from uwaug.files.search import pictures_in
from uwaug.transforms.appearance import WATER_FEATURES
from uwaug.transforms.conditions import BETWEEN, COLUMNS, Conditions
from uwaug.transforms.like import Search

TRIED, PICTURES = 4400, 6  # conditions, and pictures on which each is tried
BANDWIDTH = 0.3  # h, in the median distance of photographs to their fifth neighbour
STEPS = 300
LEAST_WEIGHT = 1e-4
CAMERA = 6.0  # photographs for which all frames of a camera stand
FOUND = ("water", "development")  # parts of a draw that a condition gives
NOISE = uwaug.Sensor((1e3, 1e6))
LEAST_WELL = 5e3  # electrons: with fewer, two judges saw coloured grain in six of 40 draws
EACH = 8  # draws of each picture by which conditions are told

MEDIANS = ("sd_RG", "corr_RG", "log_RG", "log_BG", "loc2", "loc6", "dark", "chroma", "L_mean")


class Reference(NamedTuple):
    """Numbers of photographs of several sets, or of frames of several cameras."""

    numbers: Numbers  # Nx26
    groups: NDArray[Any]  # N

    def half(self, which: int) -> "Reference":
        """Every second group, from the first or the second."""
        chosen = np.isin(self.groups, np.unique(self.groups)[which::2])
        return Reference(self.numbers[chosen], self.groups[chosen])


def load_cameras(path: Path, names: list[str]) -> Reference:
    """Numbers of the frames of cameras, in the order of `names`."""
    head, *lines = csv.reader(path.read_text().splitlines())
    places = [head.index(name) for name in names]
    numbers = np.array([[line[place] for place in places] for line in lines], np.float64)
    return Reference(numbers, np.array([line[1] for line in lines]))


def load_folder(folder: Path, names: list[str]) -> Reference:
    """Numbers of the photographs in a folder, in the order of `names`."""
    numbers = [judged(read_picture(path), 256) for path in pictures_in(folder)]
    rows = [[of_picture[name] for name in names] for of_picture in numbers]
    return Reference(np.array(rows), np.array([folder.name] * len(rows)))


def likelihoods(search: Search, wanted: Numbers, photographs: Numbers) -> Numbers:
    """Of each picture that is wanted (Nx12), in each condition that was tried (NxC)."""
    spreads = photographs.std(0)
    apart = np.sort(cdist(*[photographs / spreads] * 2), 1)[:, 5]
    spreads = spreads * BANDWIDTH * np.median(apart) * np.sqrt(2)
    tried = np.array([condition.features for condition in search.pool]) / spreads
    of_pictures = [cdist(wanted / spreads, tried[:, i], "sqeuclidean") for i in range(PICTURES)]
    likely: Numbers = np.mean([np.exp(-squares) for squares in of_pictures], 0)
    return likely


def found(search: Search, photographs: Reference, cameras: Reference | None) -> Conditions:
    """The conditions in which photographs and frames are most likely."""
    names = load_photographs()[1]
    used = [names.index(name) for name in WATER_FEATURES]
    numbers, counts = photographs.numbers, np.ones(len(photographs.numbers))
    if cameras:
        numbers = np.concatenate([numbers, cameras.numbers])
        _, camera, frames = np.unique(cameras.groups, return_inverse=True, return_counts=True)
        counts = np.concatenate([counts, CAMERA / frames[camera]])
    likely = likelihoods(search, numbers[:, used], load_photographs()[0][:, used])
    weights = np.full(len(search.pool), 1 / len(search.pool))
    for _ in range(STEPS):
        weights *= (counts / (likely @ weights + 1e-12)) @ likely / counts.sum()
    kept = np.flatnonzero(weights > LEAST_WEIGHT)
    rows = [{name: deepcopy(search.pool[i].condition[name]) for name in FOUND} for i in kept]
    for row in rows:
        noise = row["development"]["noise"]
        noise["full_well"] = max(noise["full_well"], LEAST_WELL)
    return Conditions(rows, [*weights[kept]], BETWEEN, binding=False)


def reached(drawn: Numbers, cameras: Reference) -> tuple[float, int]:
    """Share of the frames of a camera that have a draw as near as photographs have their fifth
    neighbour, by the numbers of water: mean over cameras, and those of which no frame has.
    """
    real, names, groups = load_photographs()
    water = [names.index(name) for name in WATER_FEATURES]
    photographs, draws_of_it = standardised(real, drawn, groups)
    frames = standardised(real, cameras.numbers, groups)[1]
    radius = np.median(np.sort(cdist(*[photographs[:, water]] * 2), 1)[:, 5])
    near = cdist(frames[:, water], draws_of_it[:, water]).min(1) < radius
    shares = [near[cameras.groups == camera].mean() for camera in np.unique(cameras.groups)]
    return float(np.mean(shares)), int(np.equal(shares, 0).sum())


def told(
    pictures: Iterable[Picture], photographs: Reference, cameras: Reference | None
) -> dict[str, Any]:
    """How near draws lie to photographs and cameras; medians of photographs and of draws."""
    rows = [numbers_of(picture) for picture in pictures]
    names = load_photographs()[1]
    drawn = np.array([[row[name] for name in names] for row in rows])
    shares = closeness(rows, list(np.unique(photographs.groups))).round(3).tolist()
    result: dict[str, Any] = dict(zip(("recall", "coverage", "precision"), shares, strict=False))
    if cameras:
        result["cameras"], result["cameras not reached"] = reached(drawn, cameras)
    for name in MEDIANS:
        place = names.index(name)
        of_both = photographs.numbers[:, place], drawn[:, place]
        result[name] = [round(float(np.median(values)), 3) for values in of_both]
    return result


def drawn_by_hand(folder: Path | None) -> Iterator[Picture]:
    """Draws of the rival in ten lines, see `benchmarks.evidence.arms`."""
    torch.manual_seed(9)
    for image, distance in sources(folder):
        for _ in range(EACH):
            (out,) = by_hand(image[None], distance[None])
            yield picture_of(out)


def line_of(weight: float, condition: Any) -> list[str]:
    """A condition, as the file holds it."""
    water, development = condition["water"], condition["development"]
    numbers = {**water["waters"][0], **water, **development, **development["noise"]}
    return [f"{(numbers | {'weight': weight})[name]:.3g}" for name in COLUMNS]


def main(
    quick: bool = False,
    folder: Path | None = None,
    cameras_csv: Path | None = None,
    path: Path | None = None,
    own: Path | None = None,
) -> None:
    """Find, tell, save, and write."""
    torch.set_num_threads(1)
    numbers, names, groups = load_photographs()
    photographs = load_folder(own, names) if own else Reference(numbers, groups)
    cameras = load_cameras(cameras_csv, names) if cameras_csv else None
    scenes = list(sources(folder))
    order = np.random.default_rng(0).permutation(len(scenes))
    images, maps = zip(*(scenes[i] for i in order), strict=True)
    # with lamps tried, too, and left to `RandomLight`, cameras are reached less (.64 for .69)
    day, camera = uwaug.RandomLight(share=0.0), uwaug.RandomDevelopment(noise=NOISE)
    wide = uwaug.RandomUnderwater(light=day, development=camera, conditions=None)
    search = Search(wide, list(images), list(maps), seed=0)
    search.draw(20 if quick else TRIED, PICTURES)
    results = dict[str, Any]()

    def tell(name: str, pictures: Iterable[Picture], *of: Any) -> None:
        results[name] = told(pictures, *of)
        print(name, results[name], flush=True)

    def draws_in(conditions: Conditions | None) -> Iterator[Picture]:
        return draws(uwaug.RandomUnderwater(conditions=conditions), folder, EACH, 9)

    every = photographs, cameras
    for half in () if own else (0, 1):
        learnt, left_out = (
            (photographs.half(part), cameras and cameras.half(part)) for part in (half, 1 - half)
        )
        tell(f"half {1 - half}, left out", draws_in(found(search, *learnt)), *left_out)
    conditions = found(search, *every)
    if not own:
        tell("by hand", drawn_by_hand(folder), *every)
        tell("ranges alone", draws_in(None), *every)
        tell("conditions of all", draws_in(conditions), *every)
    if folder and not quick and not own:
        counts = {"tried": TRIED, "conditions": len(conditions.rows)}
        save("conditions", {**counts, "photographs": results})
    if path:
        lines = map(line_of, conditions.weights or (), conditions.rows)
        with path.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([COLUMNS, *lines])


if __name__ == "__main__":
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--quick", action="store_true", help="a smoke test, nothing written")
    parser.add_argument("--sources", type=Path)
    parser.add_argument("--cameras", type=Path)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--photographs", type=Path)
    given = parser.parse_args()
    main(given.quick, given.sources, given.cameras, given.write, given.photographs)
