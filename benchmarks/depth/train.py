"""Train the network of made-up distances: `python -m benchmarks.depth.train --out FILE`.

One thread trains, another process renders scenes all the while. `--pairs FOLDER` (`pairs.py`) adds
real pictures with distances, of all sources but those that `--without` names. Every few minutes
the mean of late weights is written, so that a stopped run is of use. `--compare` trains each
variant for some minutes on the same scenes, and judges it.
"""

import argparse
import contextlib
import itertools
import multiprocessing
import os
import queue
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import (
    binary_cross_entropy_with_logits,
    conv2d,
    softplus,
)

from benchmarks.depth import measures, pairs, scenes
from uwaug.distance import cue

Array = np.ndarray[Any, Any]

BATCH = 16
LEARNING_RATE = 3e-3
MOST_SCENES = 4000  # kept in memory; then new ones replace old ones
REAL_SHARE = 0.12
CHECKPOINT_MINUTES = 3.0
OPEN_WEIGHT = 0.3  # of open pixels in the loss of distances


@dataclass
class Settings:
    """What variants differ in."""

    real_share: float = REAL_SHARE
    gradients: float = 0.25
    ranks: float = 0.0
    widths: dict[str, tuple[int, int, int]] = field(default_factory=lambda: dict(cue.LAYERS))


class Trained(nn.Module):
    """The layers of the network, with batch normalisation before each ReLU."""

    def __init__(self, layers: dict[str, tuple[int, int, int]]) -> None:
        super().__init__()
        self.convolutions, self.norms = nn.ModuleDict(), nn.ModuleDict()
        for name, (before, after, side) in layers.items():
            normal = cue.is_rectified(name)
            self.convolutions[name] = nn.Conv2d(
                before, after, side, padding=side // 2, bias=not normal
            )
            if normal:
                self.norms[name] = nn.BatchNorm2d(after)

    def forward(self, pictures: Tensor) -> Tensor:
        """See `cue.answer`."""

        def convolve(name: str, x: Tensor, stride: int) -> Tensor:
            layer = self.convolutions[name]
            x = conv2d(x, layer.weight, layer.bias, stride, layer.padding)
            return self.norms[name](x).relu() if name in self.norms else x

        return cue.answer(pictures, convolve)

    @torch.no_grad()
    def folded(self) -> dict[str, tuple[Tensor, Tensor]]:
        """Kernels and biases with the normalisation in them."""
        weights = {}
        for name, layer in self.convolutions.items():
            kernel, bias = layer.weight, layer.bias
            if name in self.norms:
                norm = self.norms[name]
                gain = norm.weight / (norm.running_var + norm.eps).sqrt()
                kernel = kernel * gain[:, None, None, None]
                bias = norm.bias - norm.running_mean * gain
            weights[name] = (kernel.detach().half().float(), bias.detach().half().float())
        return weights


def write(weights: dict[str, tuple[Tensor, Tensor]], path: Path) -> None:
    """In the order of layers, as float16."""
    numbers = torch.cat([part.flatten() for layer in weights.values() for part in layer])
    partial = path.with_suffix(".part")
    partial.write_bytes(numbers.half().numpy().tobytes())
    partial.replace(path)


def _render(scenes_made: Any, seed: int) -> None:
    os.nice(1)
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    for number in itertools.cycle((0, 1, 0, 2)):
        shape = scenes.SHAPES[number]
        made = [scenes.scene(rng, shape) for _ in range(8)]
        while True:
            if not multiprocessing.parent_process().is_alive():  # killed, so nobody stops this one
                return
            with contextlib.suppress(queue.Full):
                scenes_made.put((shape, made), timeout=2)
                break


class Pool:
    """Scenes rendered by another process, by shape."""

    def __init__(self, seed: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._queue = context.Queue(maxsize=16)
        self._process = context.Process(target=_render, args=(self._queue, seed), daemon=True)
        self._process.start()
        self._rng = np.random.default_rng(seed)
        self.of_shape: dict[tuple[int, int], list[Any]] = {shape: [] for shape in scenes.SHAPES}
        self.count = 0

    def take_in(self, least: int = 0) -> None:
        """What has been rendered meanwhile; wait until there are `least`."""
        while True:
            try:
                shape, made = self._queue.get(block=self.count < least)
            except queue.Empty:
                return
            self.count += len(made)
            for scene in made:
                stored = self.of_shape[shape]
                if sum(map(len, self.of_shape.values())) < MOST_SCENES:
                    stored.append(scene)
                else:
                    stored[self._rng.integers(len(stored))] = scene

    def stop(self) -> None:
        """End the other process."""
        self._process.terminate()


def _cropped(rng: np.random.Generator, shape: tuple[int, int], *maps: Array) -> list[Array]:
    """A part of a picture and its maps, perhaps mirrored, at another size: nearest pixels of maps,
    the mean of two by two of them for the picture.
    """
    height, width = maps[0].shape[:2]
    share = rng.uniform(0.6, 1)
    wanted = shape[1] / shape[0] * np.exp(rng.uniform(-0.12, 0.12))
    h = share * min(height, width / wanted)
    w = min(h * wanted, width)
    top, left = rng.uniform(0, height - h), rng.uniform(0, width - w)

    def part(values: Array, rows: int, columns: int) -> Array:
        y = (top + (np.arange(rows) + 0.5) * h / rows).astype(int).clip(0, height - 1)
        x = (left + (np.arange(columns) + 0.5) * w / columns).astype(int).clip(0, width - 1)
        return values[y][:, x]

    picture = part(maps[0], 2 * shape[0], 2 * shape[1]).astype(np.float32) / 255
    picture = picture.reshape(shape[0], 2, shape[1], 2, 3).mean((1, 3))
    parts = [picture, *(part(values, shape[0] // 2, shape[1] // 2) for values in maps[1:])]
    return [values[:, ::-1] for values in parts] if rng.uniform() < 0.5 else parts


def _jittered(rng: np.random.Generator, picture: Array) -> Array:
    picture = picture ** float(np.exp(rng.normal(0, 0.25)))
    picture = picture * np.exp(rng.normal(0, 0.15) + rng.normal(0, 0.1, 3)).astype(np.float32)
    if rng.uniform() < 0.15:
        picture = np.repeat(picture.mean(-1, keepdims=True), 3, -1)
    if rng.uniform() < 0.3:
        picture = picture + 0.02 * rng.standard_normal(picture.shape, np.float32)
    return picture.clip(0, 1)


def batch(
    rng: np.random.Generator, pool: Pool, real: list[pairs.Pair], share: float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Pictures (Bx3xHxW); at half the size logarithms, their weights and what is open (BxHxW)."""
    shape = scenes.SHAPES[rng.choice(3, p=[0.5, 0.25, 0.25])]
    rows = []
    for _ in range(BATCH):
        if real and rng.uniform() < share:
            pair = real[rng.integers(len(real))]
            picture, log = _cropped(rng, shape, pair.picture, pair.log)
            is_measured = np.isfinite(log)
            log, weight, is_open = np.where(is_measured, log, 0), 1.0 * is_measured, 0 * log
        else:
            stored = pool.of_shape[shape]
            picture, log, is_open = _cropped(rng, shape, *stored[rng.integers(len(stored))])
            weight = np.where(is_open, OPEN_WEIGHT, 1)
        picture = _jittered(rng, picture).transpose(2, 0, 1)
        rows.append([picture, log, weight, is_open])
    stacked = (np.stack(column).astype(np.float32) for column in zip(*rows, strict=True))
    pictures, logs, weights, is_open = map(torch.from_numpy, stacked)
    return pictures, logs, weights, is_open.nan_to_num()


def _standardised(log: Tensor, weight: Tensor) -> Tensor:
    """With a mean of 0 and a mean deviation of 1, where that is not tiny."""
    total = weight.sum((1, 2), keepdim=True).clamp(min=1)
    log = log - (log * weight).sum((1, 2), keepdim=True) / total
    deviation = (log.abs() * weight).sum((1, 2), keepdim=True) / total
    return log / (deviation + 0.02)


def loss(
    answered: Tensor, log: Tensor, weight: Tensor, is_open: Tensor, settings: Settings
) -> Tensor:
    """Of logarithms up to scale and shift, of their steps, and of what is open."""
    guess, truth = _standardised(answered[:, 0], weight), _standardised(log, weight)
    error = (guess - truth).clamp(-6, 6)
    total = (error.abs() * weight).sum() / weight.sum()
    for k in (1, 2, 4):
        for e, w in ((error, weight), (error.mT, weight.mT)):
            both = w[..., k:] * w[..., :-k]
            steps = ((e[..., k:] - e[..., :-k]).abs() * both).sum() / weight.sum()
            total = total + settings.gradients * steps
    if settings.ranks:
        places = torch.randint(guess[0].numel(), (2, 400))
        g, t, w = (x.flatten(1)[:, places] for x in (guess, truth, weight))
        apart = t[:, 0] - t[:, 1]
        counts = (apart.abs() > 0.1) * (w[:, 0] * w[:, 1] > 0)
        wrong = softplus(-4 * (g[:, 0] - g[:, 1]) * apart.sign()) * counts
        total = total + settings.ranks * wrong.sum() / counts.sum().clamp(min=1)
    sure = (weight > 0).float()
    opened = binary_cross_entropy_with_logits(answered[:, 1], is_open, sure, reduction="sum")
    return total + 0.3 * opened / sure.sum()


def train(
    pool: Pool,
    real: list[pairs.Pair],
    minutes: float,
    settings: Settings | None = None,
    out: Path | None = None,
) -> dict[str, tuple[Tensor, Tensor]]:
    """Train from scratch for so many minutes of a processor, and return folded weights."""
    settings = settings or Settings()
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    network = Trained(settings.widths).to(memory_format=torch.channels_last)
    decay = torch.optim.swa_utils.get_ema_multi_avg_fn(0.998)
    mean = torch.optim.swa_utils.AveragedModel(network, multi_avg_fn=decay, use_buffers=True)
    optimiser = torch.optim.AdamW(network.parameters(), LEARNING_RATE, weight_decay=1e-3)
    began, written, losses = time.process_time(), 0.0, []

    def said() -> None:
        count = f"{len(losses) * BATCH} pictures of {pool.count} scenes"
        print(f"{spent:.1f} min, {count}, loss {np.mean(losses[-200:]):.3f}", flush=True)

    while (spent := (time.process_time() - began) / 60) < minutes:
        pool.take_in()
        fading = 0.02 + 0.98 * (0.5 + 0.5 * np.cos(np.pi * spent / minutes))
        for group in optimiser.param_groups:
            group["lr"] = LEARNING_RATE * min(1, (len(losses) + 1) / 100) * fading
        pictures, *truth = batch(rng, pool, real, settings.real_share)
        value = loss(network(pictures), *truth, settings)
        optimiser.zero_grad()
        value.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimiser.step()
        mean.update_parameters(network)
        losses.append(value.item())
        if out and spent - written > CHECKPOINT_MINUTES:
            written = spent
            write(mean.module.folded(), out)
            said()
    said()
    return mean.module.folded()


_NARROW = {
    name: (before if before == 5 else before // 2, after if after == 2 else after // 2, side)
    for name, (before, after, side) in cue.LAYERS.items()
}

VARIANTS = {
    "as it is": Settings(),
    "no real pairs": Settings(real_share=0.0),
    "with order of pairs": Settings(ranks=0.5),
    "without steps": Settings(gradients=0.0),
    "half as wide": Settings(widths=_NARROW),
}


def main(
    quick: bool,
    out: Path | None = None,
    folder: Path | None = None,
    without: tuple[str, ...] = (),
    minutes: float = 120.0,
    compare: bool = False,
    judge: tuple[Path, ...] = (),
) -> None:
    """Train, write and judge."""
    torch.set_num_threads(1)
    read = pairs.read(folder) if folder else []
    real = [pair for pair in read if pair.source not in without]
    judging = [pair for pair in read if pair.source in without]
    judging += [pair for place in judge for pair in pairs.read(place)]
    print(f"{len(real)} real pairs, {len(judging)} kept to judge by")
    pool = Pool(seed=int(time.time()))
    try:
        pool.take_in(least=40 if quick else 600)
        for name, settings in VARIANTS.items() if compare else [("as it is", Settings())]:
            weights = train(pool, real, 0.05 if quick else minutes, settings, out)
            if out and not compare:
                write(weights, out)
            if judging:
                print(name, measures.judged(measures.by_weights(weights), judging), flush=True)
    finally:
        pool.stop()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="seconds, to see that it runs")
    parser.add_argument("--out", type=Path, help="the weights to write")
    parser.add_argument("--pairs", type=Path, help="real pictures with distances")
    parser.add_argument("--without", nargs="*", default=(), help="sources to judge by instead")
    parser.add_argument("--judge", type=Path, nargs="*", default=(), help="more to judge by")
    parser.add_argument("--minutes", type=float, default=120.0, help="of a processor's time")
    parser.add_argument("--compare", action="store_true", help="each variant for `minutes`")
    given = parser.parse_args()
    main(
        given.quick,
        given.out,
        given.pairs,
        tuple(given.without),
        given.minutes,
        given.compare,
        tuple(given.judge),
    )
