"""Pictures per second from DataLoaders: `RandomUnderwater` against nothing, torchvision and the
published recipe.

`python -m benchmarks.speed.throughput` writes results/throughput.json and prints the table.
"""

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import numpy as np
import torch
from referees import published
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

import uwaug
from benchmarks.harness import command, printed, race, save, scene, use_threads
from uwaug.formation import scene as forming
from uwaug.transforms import random_underwater as transforms
from uwaug.transforms.random_underwater import SURVEY

BATCH = 4
EVERYTHING = {
    "mixing": (0.0, 1.0),
    "visibility": (2.0, 10.0),
    "vertical_depth": (0.5, 5.0),
    "g": (0.1, 0.3),
    "mu": (0.2, 0.4),
    "blur_factor": (0.5, 2.0),
}
OURS: dict[str, dict[str, Any]] = {
    "uwaug, default": {},
    "uwaug, survey": SURVEY,
    # as the published recipe has it
    "uwaug, survey in linear light": {**SURVEY, "color_space": "linear"},
    "uwaug, everything random": EVERYTHING,
}
PUBLISHED = "published, OpenCV"
TORCHVISION = "torchvision blur + jitter"
# the parts of a picture's time, and what is timed for each
PARTS: dict[str, tuple[tuple[Any, str], ...]] = {
    "all": ((transforms.RandomUnderwater, "forward"),),
    "draw": ((transforms.RandomUnderwater, "_draw"),),
    "checks": (
        (transforms, "plain_image"),
        (transforms, "maps_for"),
        (forming, "require_values"),
        (forming, "choose"),
    ),
    "decode": ((forming, "_decoded"),),
    "distance": ((transforms, "to_metres"),),
    "medium": ((transforms.RandomUnderwater, "_setup"),),
    "field": ((transforms, "random_field"),),
    "exposure": ((forming.Scene, "_metered"),),
    "image": (
        (forming, "plan_for"),
        (forming.Scene, "_rendered"),
        (forming, "render"),
    ),
    "encode": ((forming, "encoded"),),
}
Augment = Callable[[Tensor, Tensor], Tensor]


class Published:
    """The published recipe with a water and a field of its own for each picture."""

    def __init__(self) -> None:
        self.bands = [published.bands(name) for name in uwaug.JERLOV_TYPES[1:]]

    def __call__(self, image: Tensor, distance: Tensor) -> Tensor:
        """Degrade a picture; sRGB values are taken for light."""
        rng = np.random.default_rng(int(torch.randint(2**32, ())))
        bands = self.bands[rng.integers(len(self.bands))]
        picture, z = image.permute(1, 2, 0).contiguous().numpy(), distance[0].numpy()
        result = published.published(picture, z, published.field(*z.shape, rng), bands)
        return torch.from_numpy(result).permute(2, 0, 1).contiguous()


class Ours:
    """`RandomUnderwater`, image out."""

    def __init__(self, **options: Any) -> None:
        self.augment = uwaug.RandomUnderwater(**options)

    def __call__(self, image: Tensor, distance: Tensor) -> Tensor:
        """Degrade a picture."""
        return self.augment(image, distance)[0]  # type: ignore[no-any-return]


def _torchvision() -> Augment | None:
    try:
        from torchvision.transforms import v2
    except ImportError:
        return None
    except RuntimeError:
        # built for another torch: its Python part misses two operators, which augmentation does
        # not use
        boxes = "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"
        torch.library.define("torchvision::nms", boxes)
        torch.library.define("torchvision::qnms", boxes)
        from torchvision.transforms import v2
    # as in contrastive learning
    both = v2.Compose([v2.GaussianBlur(23, (0.1, 2.0)), v2.ColorJitter(0.4, 0.4, 0.4, 0.1)])
    return lambda image, distance: both(image)


class Pictures(Dataset[Tensor]):
    """A picture in memory, a distance map, and what is done to them."""

    def __init__(self, size: int, augment: Augment) -> None:
        image, distance = scene(size)
        self.image, self.distance, self.augment = image[0], distance[0], augment

    def __getitem__(self, index: int) -> Tensor:
        return self.augment(self.image, self.distance)


class First(Sampler[int]):
    """The first `count` indices; `count` may change between epochs."""

    count = 0

    def __init__(self) -> None:
        pass

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[int]:
        return iter(range(self.count))


class Contestant:
    """An augmentation in a loader with workers of its own that live through the whole race."""

    def __init__(self, augment: Augment, size: int, workers: int) -> None:
        self.sampler = First()
        self.share = workers * BATCH
        self.loader = DataLoader(
            Pictures(size, augment),
            BATCH,
            sampler=self.sampler,
            num_workers=workers,
            persistent_workers=True,
            worker_init_fn=_start,
            multiprocessing_context="fork",
        )

    def run(self) -> None:
        """One epoch."""
        for _ in self.loader:
            pass

    def settle(self, pictures: int, seconds: float) -> None:
        """Run to the steady state, and choose epochs of so many seconds.

        Plans, matrices and media that each worker makes at its first pictures are not in the race.
        """
        self.sampler.count = pictures
        self.run()
        began = time.perf_counter()
        self.sampler.count = 2 * self.share
        self.run()
        rate = self.sampler.count / (time.perf_counter() - began)
        self.sampler.count = self.share * min(max(round(seconds * rate / self.share), 2), 64)

    def rates(self, times: dict[str, float]) -> dict[str, float]:
        """Pictures per second."""
        count = self.sampler.count
        return {
            "median": 1e3 * count / times["median_ms"],
            "q1": 1e3 * count / times["q3_ms"],
            "q3": 1e3 * count / times["q1_ms"],
            "rounds": times["rounds"],
            "pictures_per_round": count,
        }


def _start(worker: int) -> None:
    use_threads(1)


def rates(size: int, workers: int, rounds: int, seconds: float) -> dict[str, Any]:
    """Pictures per second of every contestant."""
    augments: dict[str, Augment | None] = {
        "none": lambda image, distance: image,
        **{name: Ours(**options) for name, options in OURS.items()},
        TORCHVISION: _torchvision(),
        PUBLISHED: Published(),
    }
    skipped = [name for name, augment in augments.items() if augment is None]
    contestants: dict[str, Contestant] = {}
    for name, augment in augments.items():
        if augment is not None:
            contestant = contestants[name] = Contestant(augment, size, workers)
            contestant.settle(workers * (16 if name == PUBLISHED else 80), seconds)
    runners = {name: contestant.run for name, contestant in contestants.items()}
    times = race(runners, rounds, seconds=120)
    found = {name: contestants[name].rates(taken) for name, taken in times.items()}
    ratios = {name: found[name]["median"] / found[PUBLISHED]["median"] for name in OURS}
    said = [f"{name} {values['median']:.0f}/s" for name, values in found.items()]
    against = [f"{name} {ratio:.1f} × published" for name, ratio in ratios.items()]
    left_out = f"; skipped: {', '.join(skipped)} (not installed)" if skipped else ""
    which = f"{size}², {workers} worker{'s' * (workers > 1)}"
    print(f"{which}: {', '.join(said)}; {', '.join(against)}{left_out}", flush=True)
    return {
        "size": size,
        "workers": workers,
        "pictures_per_s": found,
        "times_published": ratios,
        "skipped": skipped,
    }


@contextlib.contextmanager
def timed() -> Iterator[dict[str, float]]:
    """Seconds that each of `PARTS` takes meanwhile; a part that is not called is not in it."""
    spent: dict[str, float] = {}

    def watched(part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            result = function(*args, **kwargs)
            spent[part] = spent.get(part, 0.0) + time.perf_counter() - began
            return result

        return call

    with contextlib.ExitStack() as patches:
        for part, places in PARTS.items():
            for owner, name in places:
                function = watched(part, getattr(owner, name))
                patches.enter_context(mock.patch.object(owner, name, function))
        yield spent


def shares(size: int, pictures: int) -> dict[str, Any]:
    """Milliseconds per picture and their parts, in this process, one thread."""
    use_threads(1)
    image, distance = (t[0] for t in scene(size))
    rows = {}
    for name, options in OURS.items():
        augment = uwaug.RandomUnderwater(**options)
        for _ in range(40):
            augment(image, distance)
        with timed() as spent:
            for _ in range(pictures):
                augment(image, distance)
        row = {part: 1e3 * seconds / pictures for part, seconds in sorted(spent.items())}
        said = ", ".join(f"{part} {value:.2f}" for part, value in row.items())
        share = (row["draw"] + row["medium"]) / row["all"]
        rows[name] = {**row, "draw and medium, share of all": share}
        print(f"{size}², {name}: {said} ms; draw and medium are {100 * share:.0f} %", flush=True)
    return {"size": size, "ms_per_picture": rows}


def first_pictures(size: int, count: int) -> dict[str, Any]:
    """What a fresh worker's first pictures cost, before plans, matrices and media are there to be
    shared.
    """
    rows = {}
    for name in OURS:
        call = f"_first({size}, {name!r}, {count})"
        row = json.loads(printed(f"from benchmarks.speed.throughput import _first; {call}"))
        first, later = f"first {count} {row['sum']:.0f} ms", f"any later {count}"
        one = f"first picture {row['first']:.0f} ms"
        print(f"{size}², {name}: {one}, {first}, {later} {row['later']:.0f} ms", flush=True)
        rows[name] = row
    return {"size": size, "count": count, "ms": rows}


def _first(size: int, name: str, count: int) -> None:
    use_threads(1)
    torch.manual_seed(0)
    image, distance = (t[0] for t in scene(size))
    augment = uwaug.RandomUnderwater(**OURS[name])
    times = []
    for _ in range(10 * count):
        began = time.perf_counter()
        augment(image, distance)
        times.append(1e3 * (time.perf_counter() - began))
    later = float(np.median(times[-5 * count :])) * count
    print(json.dumps({"first": times[0], "sum": sum(times[:count]), "later": later}))


def main(quick: bool = False) -> None:
    """Run all parts and save the figures."""
    sizes, rounds, seconds = ((64,), 1, 0.05) if quick else ((224, 256, 512), 7, 0.4)
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes that are started here
    throughput = []
    for size in sizes:
        for workers in (2,) if quick else (1, 2):
            throughput.append(rates(size, workers, rounds, seconds))
    results = {
        "throughput": throughput,
        # in a small picture, the medium is what takes the time
        "parts": [shares(size, 20 if quick else 200) for size in (32, *sizes)],
        "first": [first_pictures(size, 2 if quick else 20) for size in sizes],
    }
    if not quick:
        print(save("throughput", results))


if __name__ == "__main__":
    command(main, __doc__)
