"""What `RandomUnderwater` costs: milliseconds of a picture beside the published recipe, pictures
per second of a GPU where there is one, and of a DataLoader; an ONNX file beside its module.

`python -m benchmarks.speed.throughput` writes results/throughput.json and prints the tables.
"""

import math
import os
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import albumentations
import kornia
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

import uwaug
from benchmarks import recipe
from benchmarks.harness import (
    by_loops,
    command,
    loops,
    printed,
    race,
    save,
    scene,
    use_threads,
)
from benchmarks.speed.panels import exported
from uwaug.distance import MadeUp

BATCH = 4
WARM = 200
"""Pictures after which most plans of the blur are there, as in all of an epoch but its start."""
RECIPE = "recipe, as published (OpenCV)"
TWO_LAMPS = uwaug.Light(
    [
        uwaug.Lamp((side, -0.3, 0.0), power=2.0, aim=(-side / 4, 0.1, 1.0), cone=45.0)
        for side in (0.4, -0.4)
    ],
    daylight=0.5,
)

Augment = Callable[[Tensor, Tensor], Any]


class Recipe:
    """The published recipe with a water and a field of its own for each picture."""

    def __init__(self) -> None:
        self.bands = [recipe.bands(name) for name in uwaug.JERLOV_TYPES[1:]]

    def __call__(self, image: Tensor, distance: Tensor) -> Tensor:
        """Degrade a picture; sRGB values are taken for light."""
        rng = np.random.default_rng(int(torch.randint(2**32, ())))
        bands = self.bands[rng.integers(len(self.bands))]
        picture, z = image.permute(1, 2, 0).contiguous().numpy(), distance[0].numpy()
        result = recipe.published(picture, z, recipe.field(*z.shape, rng), bands)
        return torch.from_numpy(result).permute(2, 0, 1).contiguous()


def augments() -> dict[str, Augment]:
    """What is timed, by name."""
    guessing = uwaug.RandomUnderwater(distance=MadeUp())
    return {
        RECIPE: Recipe(),
        "preset survey, a module": uwaug.load_preset("survey").module(),
        "RandomUnderwater()": uwaug.RandomUnderwater(),
        "the same, distances guessed": lambda image, distance: guessing(image),
    }


def warm(augment: Augment, image: Tensor, distance: Tensor) -> None:
    """Draw so many pictures that plans are seldom new."""
    if not isinstance(augment, Recipe):
        for _ in range(WARM):
            augment(image, distance)


def others() -> dict[str, Augment]:
    """The nearest that other packages have, which know no distances."""
    fog = albumentations.RandomFog(p=1.0)
    contrast = kornia.augmentation.RandomPlasmaContrast(p=1.0)

    def foggy(image: Tensor, distance: Tensor) -> Tensor:
        picture = (image * 255).byte().permute(1, 2, 0).numpy()
        return torch.from_numpy(fog(image=picture)["image"]).permute(2, 0, 1)

    return {
        "none": lambda image, distance: image,
        "Albumentations: RandomFog": foggy,
        "kornia: RandomPlasmaContrast": lambda image, distance: contrast(image[None])[0],
    }


def single(size: int, rounds: int) -> dict[str, Any]:
    """Milliseconds of one picture, one thread, by the loops."""
    use_threads(1)
    image, distance = (values[0] for values in scene(size))
    runners: dict[str, Callable[[], object]] = {}
    for name, augment in augments().items():
        with torch.no_grad(), loops(True):
            warm(augment, image, distance)
        runners[f"{name}, float32"] = lambda augment=augment: augment(image, distance)
        if name != RECIPE:
            picture = (image * 255).byte()
            runners[f"{name}, uint8"] = lambda a=augment, p=picture: a(p, distance)
    with torch.no_grad(), loops(True):
        times = race(runners, rounds, seconds=60)
    recipe = times[f"{RECIPE}, float32"]["median_ms"]
    for name, taken in times.items():
        faster = recipe / taken["median_ms"]
        print(f"{size}²: {name}: {taken['median_ms']:.1f} ms, {faster:.1f} × recipe", flush=True)
    return {"size": size, "ms": times}


def square(light: uwaug.Light | None) -> uwaug.Underwater:
    """A metered module of one water, for 512²."""
    medium = uwaug.Medium.from_water("7C", g=0.2, point_spread=uwaug.PointSpread.paper())
    metered = uwaug.Development(metered=True)
    sides = (512, 512)
    return uwaug.Underwater(medium, (0.5, 10.0), sides=sides, development=metered, light=light)


def film(light: uwaug.Light | None) -> uwaug.Underwater:
    """Preset calibrated, for 640×480."""
    preset = replace(uwaug.load_preset("calibrated", water="7C"), light=light)
    return preset.module(sides=(480, 480))


def file_against_loops(
    module: Callable[[uwaug.Light | None], uwaug.Underwater], size: tuple[int, int], rounds: int
) -> dict[str, Any]:
    """An ONNX file beside its module by the compiled loops, by daylight and under two lamps, at
    (height, width) `size`: one thread, all in one race.
    """
    use_threads(1)
    image, distance = (values[..., : size[0], :] for values in scene(size[1]))
    engines = {}
    for name, light in {"daylight": None, "two lamps": TWO_LAMPS}.items():
        lit = module(light)
        engines[f"loops, {name}"] = partial(by_loops(lit), image, distance)
        engines[f"file, {name}"] = partial(exported(lit, 1), image, distance)
    with torch.no_grad():
        times = race(engines, rounds, seconds=60)
    ms = {name: taken["median_ms"] for name, taken in times.items()}
    ratios = {
        f"{first} / {second}": ms[first] / ms[second]
        for first, second in (
            ("file, daylight", "loops, daylight"),
            ("file, two lamps", "loops, two lamps"),
            ("file, two lamps", "file, daylight"),
            ("loops, two lamps", "loops, daylight"),
        )
    }
    for name, ratio in ratios.items():
        print(f"{size[1]}×{size[0]}: {name}: {ratio:.2f}", flush=True)
    return {"ms": times, "ratios": ratios}


def frames(light: uwaug.Light | None, rounds: int = 100) -> dict[str, float]:
    """Frames a second, 640×480, of an ONNX file of preset calibrated, by threads. The least time
    counts, as whatever else runs on the machine only adds to it.
    """
    module = film(light)
    image, distance = (values[..., :480, :] for values in scene(640))
    counts = sorted({1, min(4, os.cpu_count() or 1)})
    runs = {str(threads): exported(module, threads) for threads in counts}
    least = dict.fromkeys(runs, math.inf)
    for _ in range(rounds):
        for threads, run in runs.items():
            began = time.perf_counter()
            run(image, distance)
            least[threads] = min(least[threads], time.perf_counter() - began)
    rates = {threads: 1 / seconds for threads, seconds in least.items()}
    for threads, rate in rates.items():
        print(f"ONNX file, {light}, 640×480, {threads} threads: {rate:.0f}/s", flush=True)
    return rates


def lamps(size: int, count: int) -> dict[str, float]:
    """How many times as long pictures take that lamps light as the same by daylight, and default
    draws on average; one thread, its own time.
    """
    use_threads(1)
    image, distance = (values[0] for values in scene(size))
    lights = (None, uwaug.RandomLight(share=1.0))
    share, ratios = uwaug.RandomLight().share, {}
    for fast in (True, False):
        augments = [uwaug.RandomUnderwater(light=light) for light in lights]
        taken = [0.0, 0.0]
        with torch.no_grad(), loops(fast):
            for augment in augments:
                warm(augment, image, distance)
            for index in range(count):
                for lit, augment in enumerate(augments):
                    keyed = augment.at(0, 0, index)
                    keyed(image, distance)
                    began = time.thread_time()
                    keyed(image, distance)
                    taken[lit] += time.thread_time() - began
        times = taken[1] / taken[0]
        engine = "loops" if fast else "PyTorch"
        ratios[f"{engine}, lit by lamps"] = times
        ratios[f"{engine}, default"] = 1 + share * (times - 1)
        print(f"{size}²: {engine}: {times:.2f} times as long by lamps", flush=True)
    return ratios


def device(size: int, count: int, rounds: int) -> dict[str, float]:
    """Pictures per second on a GPU, bytes in and out, beside direct light and a veil alone and a
    copy of the pixels.
    """
    image, distance = (values[:1].cuda() for values in scene(size))
    pictures = (image * 255).byte().expand(count, -1, -1, -1).contiguous()
    maps = distance.expand(count, -1, -1, -1).contiguous()
    augment = uwaug.RandomUnderwater()
    beta, veil = (torch.rand(3, 1, 1, device="cuda") for _ in range(2))

    def plain() -> Tensor:
        left = torch.exp(-beta * maps)
        light = (pictures / 255) ** 2.2 * left + veil * (1 - left)
        return (light.clamp(0, 1) ** (1 / 2.2) * 255).round().byte()

    contestants: dict[str, Callable[[], object]] = {
        "RandomUnderwater()": lambda: augment(pictures, maps),
        "direct and veil alone": plain,
        "a copy of the pixels": pictures.clone,
    }
    rates = {}
    for name, run in contestants.items():
        for _ in range(3):
            run()
        torch.cuda.synchronize()
        began = time.perf_counter()
        for _ in range(rounds):
            run()
        torch.cuda.synchronize()
        rates[name] = count * rounds / (time.perf_counter() - began)
        print(f"{size}², batch of {count}: {name}: {rates[name]:.0f}/s", flush=True)
    return rates


class Pictures(Dataset[Any]):
    """A picture in memory, a distance map, and what is done to them."""

    def __init__(self, size: int, augment: Augment, count: int) -> None:
        self.image, self.distance = (values[0] for values in scene(size))
        self.augment, self.count = augment, count

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> Any:
        return self.augment(self.image, self.distance)


def loader(size: int, workers: int, count: int) -> dict[str, float]:
    """Pictures per second of a DataLoader, the loops in its workers."""
    contestants = {**others(), **augments()}
    rates = {}
    with loops(True):
        for name, augment in contestants.items():
            pictures = Pictures(size, augment, count)
            batches = DataLoader(pictures, BATCH, num_workers=workers, persistent_workers=True)
            for _ in batches:  # workers start, and make their plans
                pass
            began = time.perf_counter()
            for _ in batches:
                pass
            rates[name] = count / (time.perf_counter() - began)
            print(f"{size}², {workers} workers: {name}: {rates[name]:.0f}/s", flush=True)
    return rates


FIRST = """
import time, torch
began = time.perf_counter()
import uwaug
uwaug.RandomUnderwater()(torch.rand(3, 256, 256), torch.rand(1, 256, 256) * 4 + 1)
print(time.perf_counter() - began)
"""


def main(quick: bool = False) -> None:
    """Run all parts and save the figures."""
    sizes = (64,) if quick else (256, 512, 1024)
    results = {
        "single": [single(size, 2 if quick else 40) for size in sizes],
        "device": {
            f"{size}², batch of {count}": device(size, count, 2 if quick else 20)
            for size in sizes[:2]
            for count in (64, 256)
            if torch.cuda.is_available()
        },
        "lamps": {str(size): lamps(size, 2 if quick else 150) for size in sizes if size < 1024},
        "first_picture_s": float(printed(FIRST, UWAUG_FAST="1")),
        "loader": {
            str(size): loader(size, 2, 16 if quick else 400) for size in sizes if size < 1024
        },
    }
    print(f"first picture {results['first_picture_s']:.1f} s")
    if not quick:
        # exports take minutes
        results["file"] = {
            "512×512": file_against_loops(square, (512, 512), 40),
            "640×480": file_against_loops(film, (480, 640), 40),
            "640×480/s": frames(None),
            "640×480, two lamps/s": frames(TWO_LAMPS),
        }
        print(save("throughput", results))


if __name__ == "__main__":
    command(main, __doc__)
