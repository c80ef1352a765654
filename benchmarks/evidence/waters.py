"""From one water to another: nets trained on labelled crops of one water, tested in others.

    python -m benchmarks.evidence.waters --data FOLDER

*Fish*: is there one in the crop? Trained on half of the places of DeepFish (mangroves, reefs) or on
half of the films of a green fjord; tested on the other half, at home, and on the other set.
*Colours* of buoys: trained on some tanks, tested on others. `benchmarks.evidence.sets` says what a
folder holds; its parts that choose and judge are both used, as nothing is chosen.

Nets see every crop four times: as it is, and three draws of an arm on top. Crops that are prepared
are so last, and in tests, too. Histograms are those of pictures that are shown of the other sets.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from skimage.exposure import equalize_adapthist, match_histograms
from torch import Tensor
from torch.nn.functional import interpolate

import uwaug
from benchmarks.evidence import sets, tasks
from benchmarks.evidence.arms import ARMS, DEFAULTS, Arm, degraded, drawn, jitter, none, ours
from benchmarks.evidence.net import answers, grey_world, keeper, table, trained
from benchmarks.evidence.sets import Crops, Sets
from benchmarks.evidence.tasks import Array
from benchmarks.evidence.training import printed
from benchmarks.harness import save

STEPS = 800  # of 64 crops
DRAWS = 3  # of an arm on top of each crop
AS_THEY_ARE = "as they are"
HOME = "at home"
PRESET = 'load_preset("wet")'
COSTED = 32  # crops, brought to COSTED_SIDE px, by which arms are timed
COSTED_SIDE = 256

DIRECTIONS = {"deepfish": ("fjord",), "fjord": ("deepfish",), "buoys": ()}
"""Sets that are trained on, by halves, and the other sets on which their nets are tested."""


def preset() -> Arm:
    """The preset for wet pictures, without those that it leaves as they are."""
    augment = replace(uwaug.load_preset("wet"), p=1.0)
    return lambda images, distances: augment(images)


def preset_or_jitter() -> Arm:
    """Either, for half of the pictures."""
    water = preset()

    def arm(images: Tensor, distances: Tensor) -> Tensor:
        is_jittered = torch.rand(len(images), 1, 1, 1) < 0.5
        return torch.where(is_jittered, jitter(images, distances), water(images, distances))

    return arm


def offset(images: Tensor, distances: Tensor) -> Tensor:
    """Depth-Jitter's idea in our words: each picture's own veil, as it is at the far end, and its
    water from 1 m nearer to 2 m farther.
    """
    is_far = (distances >= distances.flatten(1).quantile(0.85, 1)[:, None, None, None]).float()
    light = images.clamp(0, 1) ** 2.2
    veil = (light * is_far).sum((2, 3), keepdim=True) / is_far.sum((2, 3), keepdim=True)
    rates = drawn([0.15], [0.9], len(images)) * drawn([0.7] * 3, [1.4] * 3, len(images))
    left = torch.exp(-rates * drawn([-1.0], [2.0], len(images)))
    return (light * left + veil * (1 - left)).clamp(0, 1) ** (1 / 2.2)


def histograms(shown: list[Array]) -> Arm:
    """Each picture with the histograms of one that is shown, drawn."""

    def arm(images: Tensor, distances: Tensor) -> Tensor:
        picked = torch.randint(len(shown), (len(images),)).tolist()
        pairs = zip(images.permute(0, 2, 3, 1).numpy(), picked, strict=True)
        matched = [match_histograms(x, shown[i] / 255, channel_axis=2) for x, i in pairs]
        return torch.from_numpy(np.stack(matched)).permute(0, 3, 1, 2).float()

    return arm


def clahe(crops: Crops) -> Array:
    """Histograms equalised by tiles (Nx48x48x3, uint8)."""
    equalised = np.stack([equalize_adapthist(image) for image in crops.images])
    return np.round(255 * equalised).astype(np.uint8)


ON_TOP: dict[str, Callable[[list[Array]], Arm]] = {
    AS_THEY_ARE: lambda shown: none,
    "jitter, blur": lambda shown: jitter,
    "by hand": lambda shown: ARMS["by hand"](),
    "histograms of others": histograms,
    "Depth-Jitter's idea": lambda shown: offset,
    DEFAULTS: lambda shown: ours(),
    PRESET: lambda shown: preset(),
    f"{PRESET}, or jitter": lambda shown: preset_or_jitter(),
}
"""What is put on top, by pictures of the tests, without labels, for those that want some."""

PREPARED: dict[str, tuple[str, Callable[[Crops], Array]]] = {
    "CLAHE": (AS_THEY_ARE, clahe),
    "grey-world": (AS_THEY_ARE, grey_world),
    f"{PRESET}, then CLAHE": (PRESET, clahe),
    f"{PRESET}, then grey-world": (PRESET, grey_world),
}
"""What is put on top, and what is done to all crops, in training and in tests."""


def halves(films: Any) -> Array:
    """Which half, 0 or 1, each crop is of: halves have about as many crops, and share no film."""
    names, film, counts = np.unique(films, return_inverse=True, return_counts=True)
    sizes, half_of = np.zeros(2), np.zeros(len(names), int)
    for place in np.argsort(-counts, kind="stable"):
        half_of[place] = np.argmin(sizes)
        sizes[half_of[place]] += counts[place]
    return half_of[film.reshape(-1)]


def half(crops: Crops, which: int) -> Crops:
    """One of the halves."""
    chosen = halves(crops.films) == which
    return Crops(*(None if values is None else values[chosen] for values in crops))


def of_draws(crops: Crops, images: Array) -> Crops:
    """Crops with draws of them, whose pictures' light has changed as that of the crops has."""
    times = len(images) // len(crops.images)
    of_crops, of_images = (
        ((x / 255) ** 2.2).mean((1, 2)).clip(min=1e-3) for x in (crops.images, images)
    )
    light = np.tile(crops.light / of_crops, (times, 1)) * of_images
    return crops._replace(images=images, light=light)


def asked(
    arm: str, crops: Crops, tests: dict[str, Crops], shown: list[Array], seed: int
) -> dict[str, Array]:
    """Answers of a net that was trained on crops as they are and with an arm on top."""
    torch.manual_seed(seed)
    on_top, prepared = PREPARED.get(arm, (arm, lambda crops: crops.images))
    pool = tasks.fish_pool(crops.images, crops.labels, np.random.default_rng(seed))
    dry, labels = degraded(none, pool, 1, seed)
    wet, of_wet = degraded(ON_TOP[on_top](shown), pool, DRAWS, seed + 1)
    truth = torch.cat([labels, of_wet])
    drawn_crops = of_draws(crops, torch.cat([dry, wet]).permute(0, 2, 3, 1).numpy())
    pictures = torch.from_numpy(prepared(drawn_crops)).permute(0, 3, 1, 2)
    tests = {name: test._replace(images=prepared(test)) for name, test in tests.items()}
    net = trained(pictures, truth, int(truth.max()) + 1, STEPS, seed)
    return {name: answers(net, test, balanced=False) for name, test in tests.items()}


def measured(real: Sets, arms: list[str], nets: int, answered: Path) -> dict[str, Any]:
    """A table for each set that was trained on and each test. Answers are kept in a folder."""
    tables = dict[str, Any]()
    for name, others in DIRECTIONS.items():
        learnt = half(real.crops[name], 0)
        tests = {HOME: half(real.crops[name], 1)} | {other: real.crops[other] for other in others}
        shown = [picture for other in others or [name] for picture in real.references[other]]
        of_tests: dict[str, dict[str, list[Array]]] = {test: {} for test in tests}
        for arm in arms:
            for seed in range(nets):
                path = answered / f"{name}, {arm}, {seed}.npz".replace("/", " ")
                if not path.exists():
                    given: dict[str, Any] = asked(arm, learnt, tests, shown, seed)
                    np.savez(path, **given)
                for test, of_net in np.load(path).items():
                    of_tests[test].setdefault(arm, []).append(of_net)
        for test, of_arms in of_tests.items():
            tables[f"{name} → {test}"] = table(of_arms, tests[test], AS_THEY_ARE)
            printed(f"{name} → {test}", tables[f"{name} → {test}"], AS_THEY_ARE)
    return tables


def costs(real: Sets, arms: list[str]) -> dict[str, float]:
    """Milliseconds that an arm takes for a picture whose distances are there."""
    crops = torch.from_numpy(real.crops["fjord"].images[:COSTED]).permute(0, 3, 1, 2) / 255
    images = interpolate(crops, (COSTED_SIDE, COSTED_SIDE), mode="bilinear")
    distances = images.new_full((len(images), 1, COSTED_SIDE, COSTED_SIDE), 3.0)
    taken = {}
    for arm in filter(ON_TOP.__contains__, arms):
        on_top = ON_TOP[arm](real.references["fjord"])
        on_top(images, distances)  # compiles
        began = time.process_time()
        on_top(images, distances)
        taken[arm] = 1000 * (time.process_time() - began) / COSTED
    return taken


def main() -> None:
    """From the command line."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--nets", type=int, default=3, help="of each arm")
    names = [*ON_TOP, *PREPARED]
    parser.add_argument("--arms", nargs="+", choices=names, default=names, metavar="ARM")
    parser.add_argument("--answered", type=Path, help="a folder that keeps what nets answered")
    given = parser.parse_args()
    torch.set_num_threads(1)
    real = sets.load(given.data)
    with keeper(given.answered) as folder:
        tables = measured(real, given.arms, given.nets, folder)
    spent = costs(real, given.arms)
    print(*(f"{arm}: {ms:.1f} ms" for arm, ms in spent.items()), sep="\n")
    save("waters", {"nets": given.nets, "steps": STEPS, "ms": spent, "tables": tables})


if __name__ == "__main__":
    main()
