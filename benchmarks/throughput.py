"""Pictures per second from DataLoaders: `RandomUnderwater` against nothing, torchvision and the published recipe.

`python -m benchmarks.throughput` writes results/throughput.json and prints the table.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

import uwaug
from benchmarks import baselines
from benchmarks.harness import command, race, save, scene, use_threads
from uwaug import transforms

BATCH = 4
EVERYTHING = {
    "mixing": (0.0, 1.0), "visibility": (2.0, 10.0), "vertical_depth": (0.5, 5.0), "g": (0.1, 0.3), "mu": (0.2, 0.4),
    "blur_factor": (0.5, 2.0),
}  # fmt: skip
OURS: dict[str, dict[str, Any]] = {
    "uwaug, survey": {},
    "uwaug, survey in linear light": {"color_space": "linear"},  # as the published recipe has it
    "uwaug, everything random": EVERYTHING,
}
PUBLISHED = "published, OpenCV"
TORCHVISION = "torchvision blur + jitter"
Augment = Callable[[Tensor, Tensor], Tensor]


class Published:
    """The published recipe with a water and a field of its own for each picture."""

    def __init__(self) -> None:
        response = uwaug.load_camera("Nikon 5100 (NPL)")
        rgb = [4, 3, 1]  # 600, 550, 450 nm
        self.bands = []
        for name in uwaug.JERLOV_TYPES[1:]:
            water = uwaug.Water.jerlov(name).at(np.arange(400, 701, 50))
            a, b, kd = (v.astype(np.float32) for v in (water.a, water.b, water.kd))
            light, G = np.exp(-kd), a + np.float32(0.2) * b
            self.bands.append(
                {
                    "response": response.weights(water.wavelengths).astype(np.float32),
                    "beta": a + b,
                    "G": G,
                    "light": light,
                    "light_rgb": light[rgb],
                    "veil": np.float32(0.3) * b * light / G,
                    "phi": 0.3 * float(b.mean()),
                }
            )
        self.amplitudes: dict[tuple[int, int], np.ndarray] = {}

    def field(self, height: int, width: int, rng: np.random.Generator) -> np.ndarray:
        """Periodic Gaussian random field of the picture's size, scaled to 0.7…1.3 and divided by its mean."""
        if (height, width) not in self.amplitudes:
            k = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
            k[0, 0] = np.inf
            self.amplitudes[height, width] = (k**-2).astype(np.float32)
        noise = rng.standard_normal((height, width), dtype=np.float32)
        field = np.fft.irfft2(
            np.fft.rfft2(noise) * self.amplitudes[height, width], s=(height, width)
        )
        field = 0.7 + 0.6 * (field - field.min()) / (field.max() - field.min())
        return (field / field.mean()).astype(np.float32, copy=False)

    def __call__(self, image: Tensor, distance: Tensor) -> Tensor:
        """Degrade a picture; sRGB values are taken for light."""
        rng = np.random.default_rng(int(torch.randint(2**32, ())))
        bands = self.bands[rng.integers(len(self.bands))]
        picture, z = image.permute(1, 2, 0).contiguous().numpy(), distance[0].numpy()
        result = baselines.published(picture, z, self.field(*z.shape, rng), **bands)
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
    except RuntimeError:  # built for another torch: its Python part misses two operators, which augmentation does not use
        torch.library.define(
            "torchvision::nms", "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"
        )
        torch.library.define(
            "torchvision::qnms", "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"
        )
        from torchvision.transforms import v2
    # as in contrastive learning
    both = v2.Compose([v2.GaussianBlur(23, (0.1, 2.0)), v2.ColorJitter(0.4, 0.4, 0.4, 0.1)])
    return lambda image, distance: both(image)


class Pictures(Dataset[Tensor]):
    """A picture in memory, a distance map, and what is done to them."""

    def __init__(self, size: int, augment: Augment) -> None:
        self.pair, self.augment = tuple(t[0] for t in scene(size)), augment

    def __getitem__(self, index: int) -> Tensor:
        return self.augment(*self.pair)


class First(Sampler[int]):
    """The first `count` indices; `count` may change between epochs."""

    count = 0

    def __init__(self) -> None:
        pass

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[int]:
        return iter(range(self.count))


def _start(worker: int) -> None:
    use_threads(1)


def rates(size: int, workers: int, rounds: int, seconds: float) -> dict[str, Any]:
    """Pictures per second of every contestant, each with workers of its own that live through the whole race."""
    contestants: dict[str, Augment | None] = {
        "none": lambda image, distance: image,
        **{name: Ours(**options) for name, options in OURS.items()},
        TORCHVISION: _torchvision(),
        PUBLISHED: Published(),
    }
    runners, counts = {}, {}
    for name, augment in contestants.items():
        if augment is None:
            continue
        sampler = First()
        loader = DataLoader(
            Pictures(size, augment),
            BATCH,
            sampler=sampler,
            num_workers=workers,
            persistent_workers=True,
            worker_init_fn=_start,
            multiprocessing_context="fork",
        )

        def run(loader: DataLoader[Tensor] = loader) -> None:
            for _ in loader:
                pass

        # the steady state: plans, matrices and media that each worker makes at its first pictures are not in the race
        sampler.count = workers * (16 if name == PUBLISHED else 80)
        run()
        began = time.perf_counter()
        sampler.count = 2 * workers * BATCH
        run()
        rate = sampler.count / (time.perf_counter() - began)
        share = workers * BATCH
        sampler.count = counts[name] = share * min(max(round(seconds * rate / share), 2), 64)
        runners[name] = run
    result = race(runners, rounds, seconds=120)
    per_second = {
        name: {
            "median": 1e3 * counts[name] / t["median_ms"],
            "q1": 1e3 * counts[name] / t["q3_ms"],
            "q3": 1e3 * counts[name] / t["q1_ms"],
            "rounds": t["rounds"],
            "pictures_per_round": counts[name],
        }
        for name, t in result.items()
    }
    ratios = {name: per_second[name]["median"] / per_second[PUBLISHED]["median"] for name in OURS}
    skipped = [name for name, augment in contestants.items() if augment is None]
    print(
        f"{size}², {workers} worker{'s'[: workers - 1]}: "
        + ", ".join(f"{name} {v['median']:.0f}/s" for name, v in per_second.items())
        + "; "
        + ", ".join(f"{name} {ratio:.1f} × published" for name, ratio in ratios.items())
        + (f"; skipped: {', '.join(skipped)} (not installed)" if skipped else ""),
        flush=True,
    )
    return {
        "size": size,
        "workers": workers,
        "pictures_per_s": per_second,
        "times_published": ratios,
        "skipped": skipped,
    }


def shares(size: int, pictures: int) -> dict[str, Any]:
    """Milliseconds per picture and their parts, in this process, one thread."""
    use_threads(1)
    image, distance = (t[0] for t in scene(size))
    rows = {}
    for name, options in OURS.items():
        augment = uwaug.RandomUnderwater(**options)
        spent: dict[str, float] = {}

        def timed(
            part: str, function: Callable[..., Any], spent: dict[str, float] = spent
        ) -> Callable[..., Any]:
            def call(*args: Any, **kwargs: Any) -> Any:
                began = time.perf_counter()
                result = function(*args, **kwargs)
                spent[part] = spent.get(part, 0.0) + time.perf_counter() - began
                return result

            return call

        parts = {
            "medium": "_medium",
            "field": "gaussian_random_field",
            "distance": "_metres",
            "image": "form",
        }
        parts |= {"decode": "srgb_to_linear", "encode": "linear_to_srgb", "checks": "check"}
        originals = {attribute: getattr(transforms, attribute) for attribute in parts.values()}
        for _ in range(40):
            augment(image, distance)
        try:
            for part, attribute in parts.items():
                setattr(transforms, attribute, timed(part, originals[attribute]))
            augment.make_params = timed("draw", augment.make_params)  # type: ignore[method-assign]
            whole = timed("all", augment)
            for _ in range(pictures):
                whole(image, distance)
        finally:
            for attribute, original in originals.items():
                setattr(transforms, attribute, original)
        row: dict[str, Any] = {
            part: 1e3 * value / pictures for part, value in sorted(spent.items())
        }
        row["draw and medium, share of all"] = (row["draw"] + row["medium"]) / row["all"]
        rows[name] = row
        print(
            f"{size}², {name}: "
            + ", ".join(f"{k} {v:.2f}" for k, v in row.items() if k in ("all", "draw", *parts))
            + f" ms; draw and medium are {100 * row['draw and medium, share of all']:.0f} %",
            flush=True,
        )
    return {"size": size, "ms_per_picture": rows}


def first_pictures(size: int, count: int = 20) -> dict[str, Any]:
    """What a fresh worker's first pictures cost, before plans, matrices and media are there to be shared."""
    rows = {}
    for name in OURS:
        code = f"from benchmarks.throughput import _first; _first({size}, {name!r}, {count})"
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        )
        rows[name] = json.loads(done.stdout)
        print(
            f"{size}², {name}: first picture {rows[name]['first']:.0f} ms, first {count} {rows[name]['sum']:.0f} ms, "
            f"any later {count} {rows[name]['later']:.0f} ms",
            flush=True,
        )
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
    sizes, rounds, seconds = ((256,), 2, 0.2) if quick else ((224, 256, 512), 7, 0.4)
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes that are started here
    results = {
        "throughput": [
            rates(size, workers, rounds, seconds) for size in sizes for workers in (1, 2)
        ],
        "parts": [shares(size, 20 if quick else 200) for size in sizes],
        "first": [first_pictures(size) for size in sizes],
    }
    if not quick:
        print(save("throughput", results))


if __name__ == "__main__":
    command(main, __doc__)
