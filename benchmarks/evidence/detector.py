"""Does water in training help a detector that has seen none?

    python -m benchmarks.evidence.detector --kit FOLDER --choose    length and step, by the dry arm
    python -m benchmarks.evidence.detector --kit FOLDER             all arms, and the table

A detector trained in air (YOLOX-nano, COCO) is tuned on pictures in air with boxes, as each arm
degrades them, and finds persons in real pictures under water. The kit is a folder with the pictures
and `kit.py`, which loads them, and `yolox_nano.py`, the net with its weights.

All arms have the same pictures, made-up distances, windows, order and steps. Those that are shown
underwater pictures get five of the set `divers`, without boxes: no arm is scored on these five.
Only the half of the films that chooses is in the kit.
"""

import argparse
import importlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import albumentations
import numpy as np
import torch
from PIL import Image
from torch import Tensor, nn
from torch.nn.functional import affine_grid, grid_sample, interpolate

import uwaug
from benchmarks.evidence.arms import ARMS, DEFAULTS, SHOWN, Arm, tensors
from benchmarks.evidence.boxes import average_precisions, loss_of, matched
from benchmarks.evidence.net import compared, keeper, resampled_units
from benchmarks.evidence.tasks import Array, Pool, made_up
from benchmarks.harness import save

SIDE = 256
"""px: of the square that the net sees, in training and in tests."""

PAD = 114 / 255
"""Grey around a picture, as the net has learnt it."""

BATCH = 8
DRAWS = 2  # of each picture and its distances
WINDOWS = (0.7, 1.4)  # sizes at which pictures are seen, of their own
LEAST_LEFT = 0.4  # share of a box that a window must hold
TRIALS = 300  # of `uwaug.like`

TESTS = ("choose/divers", "choose/swimmers", "choose/pools", "land/val")
SHOWN_PICTURES = 5
UNTUNED = "not tuned"


STEPS = 300
LONGER = {"p=0.5": 2}  # times as many, as half of its pictures are dry
RATES = (1e-4, 3e-4)
RATE = RATES[0]
"""Relative to the weights, as batch norms are folded in. The best of the dry arm on land/val before
any other was trained: .505 against .481 (.486 not tuned). AdamW (3e-5, 6e-5, 1e-4) had .481, .451
and .422, and of swimmers .23, seen once; SGD 0. With boxes of persons alone AdamW had .33 and .35.
"""


class Scene(NamedTuple):
    """A picture in air with what is in it."""

    image: Tensor  # 3xHxW, 0…1, or bytes
    boxes: Tensor  # Nx4: left, top, right, bottom, px
    classes: Tensor  # N


def fog() -> Arm:
    """Albumentations' fog as it comes."""
    seed = int(torch.randint(2**31, ()))
    augment = albumentations.Compose([albumentations.RandomFog(p=1.0)], seed=seed)

    def arm(images: Tensor, distances: Tensor) -> Tensor:
        levels = images.mul(255).round().byte().permute(0, 2, 3, 1).numpy()
        return torch.stack([*tensors([augment(image=picture)["image"] for picture in levels])])

    return arm


NAMES = (
    *("no water", "jitter, blur", "by hand", "RandomFog", "Li 2020"),
    *(DEFAULTS, "p=0.5", "uwaug.like", "SLURPP 2025", "colour transfer"),
)

VISIBLE = "KeepVisible(RandomUnderwater())"
OF_BOXES = (*NAMES, VISIBLE)
"""What is told of boxes; `NAMES` change pictures alone."""


def made(name: str, shown: list[Array], scenes: list[Scene], maps: list[Tensor]) -> Arm:
    """An arm by its name; `shown` are pictures under water, for those that want some."""
    if name == "RandomFog":
        return fog()
    if name == VISIBLE:
        return uwaug.KeepVisible(uwaug.RandomUnderwater())
    if name in ARMS:
        return ARMS[name]()
    some = range(0, len(scenes), len(scenes) // 8)
    pairs = [torch.cat([scenes[place].image, maps[place]])[None] for place in some]
    small = torch.cat([interpolate(pair, (192, 256)) for pair in pairs])
    images, distances = small.split((3, 1), 1)
    return SHOWN[name](shown, Pool(images, distances, torch.arange(len(images))), TRIALS)


def scenes_of(samples: Sequence[Any]) -> list[Scene]:
    """Samples of the kit, their longer sides of SIDE px."""
    scenes = []
    for sample in samples:
        scale = SIDE / max(sample.image.shape[:2])
        height, width = (int(scale * side) for side in sample.image.shape[:2])
        small = Image.fromarray(sample.image).resize((width, height), Image.Resampling.BILINEAR)
        image = torch.from_numpy(np.array(small)).permute(2, 0, 1) / 255
        boxes = torch.from_numpy(sample.boxes * scale).float()
        scenes.append(Scene(image, boxes, torch.from_numpy(sample.classes)))
    return scenes


def degraded(arm: Arm, scenes: list[Scene], maps: list[Tensor]) -> list[Scene]:
    """Draws of all scenes, one after another, in the upper left of squares (bytes)."""
    drawn = []
    for index, distance in enumerate(maps):
        image, boxes, classes = scenes[index % len(scenes)]
        if isinstance(arm, uwaug.KeepVisible):
            image, _, seen = arm(image, distance, {"boxes": boxes, "labels": classes})
            boxes, classes = seen["boxes"], seen["labels"]
        else:
            image = arm(image[None], distance[None])[0]
        square = torch.full((3, SIDE, SIDE), round(255 * PAD), dtype=torch.uint8)
        square[:, : image.shape[1], : image.shape[2]] = image.clamp(0, 1).mul(255).round().byte()
        drawn.append(Scene(square, boxes, classes))
    return drawn


def window(
    square: Tensor, boxes: Tensor, classes: Tensor, rng: np.random.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """A square (bytes) larger or smaller, elsewhere, in half of the cases mirrored: 0…1, and what
    is still in it.
    """
    scale = float(np.exp(rng.uniform(*np.log(WINDOWS))))
    shift = torch.from_numpy(rng.uniform(-1, 1, 2) * abs(1 - scale)).float()
    sign = torch.tensor([float(rng.choice([-1, 1])), 1.0])
    # the middle of a square is 0, its ends are -1 and 1
    theta = torch.stack([*torch.diag(sign / scale), -sign * shift / scale]).T[None]
    grid = affine_grid(theta, [1, 3, SIDE, SIDE], align_corners=False)
    picture = grid_sample(square[None] / 255 - PAD, grid, align_corners=False)[0] + PAD
    corners = (2 * boxes.reshape(-1, 2, 2) / SIDE - 1) * sign * scale + shift
    corners = (corners + 1) * SIDE / 2
    moved = torch.cat([corners.amin(1), corners.amax(1)], 1)
    inside = moved.clamp(0, SIDE)
    before, after = ((x[:, 2:] - x[:, :2]).prod(1) for x in (moved, inside))
    kept = after > LEAST_LEFT * before
    return picture, inside[kept], classes[kept]


def tuned(
    net: nn.Module, drawn: list[Scene], count: int, rate: float, seed: int, steps: int
) -> float:
    """Tune a net in place on the draws of so many scenes; their order and the windows hang on the
    seed alone. Returns seconds.
    """
    began = time.process_time()
    rng = np.random.default_rng(seed)
    order = np.concatenate([rng.permutation(count) for _ in range(steps * BATCH // count + 1)])
    draws = rng.integers(len(drawn) // count, size=len(order))
    net.train()
    optimiser = torch.optim.Adafactor(net.parameters(), rate)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, steps, cycle_momentum=False)
    for step in range(steps):
        pictures, truths = [], []
        for place in range(step * BATCH, (step + 1) * BATCH):
            square, boxes, classes = drawn[draws[place] * count + order[place]]
            picture, *truth = window(square, boxes, classes, rng)
            pictures.append(picture.flip(0) * 255)  # BGR
            truths.append(truth)
        batch = torch.stack(pictures).to(memory_format=torch.channels_last)
        loss = loss_of(net(batch), truths, SIDE)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    net.eval()
    return time.process_time() - began


class Bench(NamedTuple):
    """All that is in a kit, and what follows from it."""

    yolox: Any  # the module of the net
    overlap: Callable[[Array, Array], tuple[Array, ...]]
    scenes: list[Scene]
    maps: list[Tensor]  # of all scenes, DRAWS times: 1xHxW, m
    tests: dict[str, list[Any]]
    blocks: dict[str, list[str]]
    shown: list[Array]

    @classmethod
    def of(cls, folder: Path) -> "Bench":
        """Of a kit."""
        kit, yolox = (module(folder, name) for name in ("kit", "yolox_nano"))
        scenes, rng = scenes_of(kit.load("land/train", folder)), np.random.default_rng(0)
        maps = [torch.from_numpy(made_up(x.image, rng)).float()[None] for x in scenes * DRAWS]
        tests = {name: kit.load(name, folder, one=0) for name in TESTS}
        groups = json.loads((folder / "choose/groups.json").read_text())
        blocks = {
            name: [groups.get(Path(name).name, {}).get(x.name, x.name) for x in samples]
            for name, samples in tests.items()
        }
        divers, series = tests[TESTS[0]], blocks[TESTS[0]]
        alone = [place for place, block in enumerate(series) if series.count(block) == 1]
        picked = [alone[i] for i in np.linspace(0, len(alone) - 1, SHOWN_PICTURES).astype(int)]
        shown = [divers[place].image for place in picked]
        for place in reversed(picked):
            del divers[place], series[place]
        return cls(yolox, kit.overlap, scenes, maps, tests, blocks, shown)

    def found(self, net: nn.Module) -> dict[str, Array]:
        """Persons in each test set (Nx6): the picture's place, a box, its score."""
        answers = {}
        for name, samples in self.tests.items():
            boxes = [self.yolox.detect(net, x.image, SIDE, classes=[0])[:, :5] for x in samples]
            places = np.repeat(np.arange(len(boxes)), [len(rows) for rows in boxes])
            answers[name] = np.concatenate([places[:, None], np.concatenate(boxes)], 1)
        return answers

    def scores(self, name: str, found: Array, weights: Array) -> Array:
        """AP50 of resamples (R) that have each picture so often (RxN)."""
        hits = [
            matched(sample, found[found[:, 0] == place, 1:], self.overlap)
            for place, sample in enumerate(self.tests[name])
        ]
        counts = np.array([len(sample.boxes) for sample in self.tests[name]])
        return average_precisions(hits, counts, weights)

    def kept(self, path: Path, ask: Callable[[], dict[str, Array]]) -> dict[str, Array]:
        """What a net finds in each test set, kept in a file and asked once."""
        if not path.exists():
            found: dict[str, Any] = {n.replace("/", " "): rows for n, rows in ask().items()}
            np.savez(path, **found)
        with np.load(path) as rows:
            return {name: rows[name.replace("/", " ")] for name in self.tests}

    def table(
        self, name: str, answers: dict[str, list[dict[str, Array]]], reference: str
    ) -> dict[str, Any]:
        """Of each arm: AP50 in a test set, and the difference to the reference."""
        often = resampled_units(self.blocks[name])
        weights = np.concatenate([np.ones_like(often[:1]), often])
        scores = {
            arm: np.stack([self.scores(name, net[name], weights) for net in nets])
            for arm, nets in answers.items()
        }
        return compared(scores, reference)


def main(
    kit: Path, arms: Sequence[str] = OF_BOXES, nets: int = 1, answered: Path | None = None
) -> dict[str, Any]:
    """Tune, score, save and print. What a net finds is kept in `answered`, and asked once."""
    torch.set_num_threads(1)
    with keeper(answered) as folder:
        bench = Bench.of(kit)
        answers = {UNTUNED: [bench.found(bench.yolox.load())]}
        for arm, seed in product(arms, range(nets)):
            ask = partial(asked, bench, arm, RATE, seed)
            of_net = bench.kept(folder / f"{arm}, {seed}.npz", ask)
            answers.setdefault(arm, []).append(of_net)
    reference = DEFAULTS if DEFAULTS in answers else UNTUNED
    tables = {name: bench.table(name, answers, reference) for name in TESTS}
    counts = {
        name: {"pictures": len(some), "boxes": sum(len(x.boxes) for x in some)}
        for name, some in bench.tests.items()
    }
    how = {"steps": STEPS, "rate": RATE, "batch": BATCH, "side": SIDE}
    results = {**how, "sets": counts, "tables": tables}
    save("detector", results)
    for name, rows in tables.items():
        print(name, *(f"{arm} {row['score']:.3f}" for arm, row in rows.items()), sep="; ")
    return results


def asked(bench: Bench, arm: str, rate: float, seed: int) -> dict[str, Array]:
    """What a net finds that has been tuned on the pictures of an arm."""
    torch.manual_seed(seed)
    began = time.process_time()
    change = made(arm, bench.shown, bench.scenes, bench.maps)
    drawn = degraded(change, bench.scenes, bench.maps)
    drawing = time.process_time() - began
    net = bench.yolox.load().to(memory_format=torch.channels_last)
    steps = STEPS * LONGER.get(arm, 1)
    seconds = tuned(net, drawn, len(bench.scenes), rate, seed, steps)
    found = bench.found(net)
    print(f"{arm}, {seed}: {drawing:.0f} + {seconds:.0f} s;", *said(bench, found), flush=True)
    return found


def said(bench: Bench, found: dict[str, Array]) -> list[str]:
    """Scores in words."""
    once = {name: np.ones((1, len(rows))) for name, rows in bench.tests.items()}
    return [f"{name} {bench.scores(name, found[name], once[name])[0]:.3f}" for name in found]


def choose(kit: Path) -> None:
    """What the dry arm loses in air, by step: it looks at land alone."""
    torch.set_num_threads(1)
    bench = Bench.of(kit)
    bench = bench._replace(tests={TESTS[-1]: bench.tests[TESTS[-1]]})
    print(UNTUNED, *said(bench, bench.found(bench.yolox.load())), flush=True)
    for rate in RATES:
        print(rate, flush=True)
        asked(bench, "no water", rate, 0)


def module(folder: Path, name: str = "kit") -> Any:
    """A module of a kit."""
    sys.path.insert(0, str(folder))
    return importlib.import_module(name)


def parser(about: str | None, arms: Sequence[str] = NAMES) -> argparse.ArgumentParser:
    """Of a command that takes a kit."""
    formatter = argparse.RawDescriptionHelpFormatter
    flags = argparse.ArgumentParser(description=about, formatter_class=formatter)
    flags.add_argument("--kit", type=Path, required=True, help="its folder")
    flags.add_argument("--arms", nargs="+", choices=arms, default=arms, metavar="ARM")
    flags.add_argument("--nets", type=int, default=1, help="of each arm")
    flags.add_argument("--answered", type=Path, help="a folder that keeps what nets answered")
    return flags


if __name__ == "__main__":
    flags = parser(__doc__, OF_BOXES)
    flags.add_argument("--choose", action="store_true", help="length and step, by the dry arm")
    given = flags.parse_args()
    if given.choose:
        choose(given.kit)
    else:
        main(given.kit, given.arms, given.nets, given.answered)
