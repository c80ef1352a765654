"""Train the network of made-up distances: `python -m benchmarks.depth.train --out FILE`.

Its encoder is YOLOX-nano's backbone, from the weights of that (`--encoder FILE`, as NumPy arrays by
the names of its layers), or as it lies in the package; it stays as it is. Its decoder learns from
scenes that are rendered meanwhile, by another process, in chunks of a folder (`--scenes`). Which
scenes a step sees follows from its number alone, so that a run can be made again. Every thousand
steps the mean of late weights is written; a run that was stopped goes on (`--resume`).

`--compare` trains each variant for fewer steps, and judges it.
"""

import argparse
import multiprocessing
import os
import time
from dataclasses import dataclass
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
CHUNK = 64  # scenes of a file
FIRST_CHUNKS = 12  # with which training begins
STEPS_OF_CHUNK = 60  # after which another one joins
OPEN_WEIGHT = 0.3  # of open pixels in the loss of distances
MARGIN = 8  # px that a rendered scene is larger, to be cropped
SHAPES = ((96, 128), (128, 96))  # of what the network sees, as `cue.small_copy` makes it
CHECKPOINT = 1000

ENCODER_WIDTHS = (16, 32, 64, 128, 256)


@dataclass
class Settings:
    """What variants differ in."""

    gradients: float = 0.25
    ranks: float = 0.2
    widths: tuple[int, ...] = (16, 32, 48, 64, 96)
    is_frozen: bool = True


def encoder_of(path: Path) -> cue.Weights:
    """The backbone from a file of YOLOX-nano whose batch norms are folded into its convolutions, by
    the names of the package. Its phases and its bytes, blue first, go into the first kernel.
    """
    with np.load(path) as file:
        arrays = {name: torch.from_numpy(file[name]).float() for name in file.files}

    def layer(*names: str) -> tuple[Tensor, Tensor]:
        parts = [
            torch.cat([arrays[f"{name}.conv.{part}"] for name in names])
            for part in ("weight", "bias")
        ]
        return parts[0], parts[1]

    kernel, bias = layer("stem")
    phases = kernel.view(16, 2, 2, 3, 3, 3).flip(3)  # column, row, channel, window
    stem = 255 * phases.permute(0, 3, 4, 2, 5, 1).reshape(16, 3, 6, 6)
    weights = {"stem": (stem.contiguous(), bias)}
    for stage, blocks in cue.STAGES.items():
        weights[f"{stage}.down.window"] = layer(f"{stage}.0.0")
        weights[f"{stage}.down.points"] = layer(f"{stage}.0.1")
        crossed = f"{stage}.1"
        if stage == "d5":
            weights["d5.pooled.in"], weights["d5.pooled.out"] = layer("d5.1.a"), layer("d5.1.b")
            crossed = "d5.2"
        weights[f"{stage}.split"] = layer(f"{crossed}.a", f"{crossed}.b")
        for block in range(blocks):
            inner = f"{crossed}.m.{block}"
            weights[f"{stage}.{block}.in"] = layer(f"{inner}.a")
            weights[f"{stage}.{block}.window"] = layer(f"{inner}.b.0")
            weights[f"{stage}.{block}.points"] = layer(f"{inner}.b.1")
        weights[f"{stage}.joined"] = layer(f"{crossed}.c")
    return weights


def shipped_encoder() -> cue.Weights:
    """The backbone in the package."""
    stages = {"stem", *cue.STAGES}
    return {n: layer for n, layer in cue.learnt().items() if n.split(".")[0] in stages}


class Layers(nn.Module):
    """Layers to be trained, by name, each with batch normalisation but for some."""

    def __init__(self, shapes: dict[str, tuple[int, ...]], plain: tuple[str, ...] = ()) -> None:
        super().__init__()
        self.convolutions, self.norms = nn.ModuleDict(), nn.ModuleDict()
        for name, (after, before, side, _) in shapes.items():
            key = name.replace(".", "/")
            groups = after if before == 1 else 1
            self.convolutions[key] = nn.Conv2d(
                before * groups,
                after,
                side,
                padding=(side - 1) // 2,
                groups=groups,
                bias=name in plain,
            )
            if name not in plain:
                self.norms[key] = nn.BatchNorm2d(after)

    def forward(self, name: str, x: Tensor, stride: int) -> Tensor:
        """See `cue.Convolve`."""
        key = name.replace(".", "/")
        layer = self.convolutions[key]
        x = conv2d(x, layer.weight, layer.bias, stride, layer.padding, groups=layer.groups)
        return self.norms[key](x) if key in self.norms else x

    @torch.no_grad()
    def folded(self) -> cue.Weights:
        """Kernels and biases with the normalisation in them."""
        weights = {}
        for key, layer in self.convolutions.items():
            kernel, bias = layer.weight.detach(), layer.bias
            if key in self.norms:
                norm = self.norms[key]
                gain = norm.weight / (norm.running_var + norm.eps).sqrt()
                kernel, bias = (
                    kernel * gain[:, None, None, None],
                    norm.bias - norm.running_mean * gain,
                )
            weights[key.replace("/", ".")] = (kernel, bias.detach())
        return weights


class Network(nn.Module):
    """The network as it is trained."""

    def __init__(self, encoder: cue.Weights, settings: Settings) -> None:
        super().__init__()
        self.encoder, self.frozen = None, encoder
        if not settings.is_frozen:
            self.encoder = Layers({name: kernel.shape for name, (kernel, _) in encoder.items()})
        widths = settings.widths
        shapes = {
            "whole.in": (64, sum(ENCODER_WIDTHS[-2:]), 1, 1),
            "whole.out": (widths[-1], 64, 1, 1),
            "answer": (2, widths[0], 3, 3),
        }
        for level, (before, width) in enumerate(zip(ENCODER_WIDTHS, widths, strict=True)):
            shapes[f"side{level}"] = (width, before + 2, 1, 1)
            shapes[f"at{level}"] = (width, width, 3, 3)
            if level + 1 < len(widths):
                shapes[f"up{level}"] = (width, widths[level + 1], 1, 1)
        self.decoder = Layers(shapes, plain=("whole.in", "whole.out", "answer"))

    def forward(self, pictures: Tensor) -> Tensor:
        """See `cue.decoded`."""
        if self.encoder is None:
            with torch.no_grad():
                features = cue.encoded(pictures, cue.layers_of(self.frozen))
        else:
            features = cue.encoded(pictures, self.encoder)
        return cue.decoded(features, self.decoder)

    def folded(self) -> cue.Weights:
        """The weights of both."""
        encoder = self.frozen if self.encoder is None else self.encoder.folded()
        return {**encoder, **self.decoder.folded()}


def write(weights: cue.Weights, path: Path) -> None:
    """As float16."""
    arrays = {}
    for name, (kernel, bias) in weights.items():
        arrays[name], arrays[f"{name}.bias"] = kernel.half().numpy(), bias.half().numpy()
    partial = path.with_suffix(".part.npz")
    np.savez(partial, **arrays)
    partial.replace(path)


def render(folder: Path, count: int) -> None:
    """Render chunks of scenes, by their numbers, that are not there yet."""
    os.nice(1)
    torch.set_num_threads(1)
    for number in range(count):
        path = folder / f"{number:04d}.npz"
        if path.exists():
            continue
        if multiprocessing.parent_process() and not multiprocessing.parent_process().is_alive():
            return  # killed, so nobody stops this one
        rng = np.random.default_rng((number, 1))
        shape = [side + MARGIN for side in scenes.SHAPES[number % len(scenes.SHAPES)]]
        made = [scenes.scene(rng, (shape[0], shape[1])) for _ in range(CHUNK)]
        rgb, log, is_open = (np.stack(maps) for maps in zip(*made, strict=True))
        partial = path.with_suffix(".part.npz")
        np.savez(partial, rgb=rgb, log=log, is_open=is_open)
        partial.replace(path)


class Pool:
    """Scenes that another process renders, a chunk after the other."""

    def __init__(self, folder: Path, steps: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.chunks = folder, []
        count = FIRST_CHUNKS + steps // STEPS_OF_CHUNK
        context = multiprocessing.get_context("spawn")
        self._process = context.Process(target=render, args=(folder, count), daemon=True)
        self._process.start()

    def at(self, step: int) -> list[tuple[Array, Array, Array]]:
        """The chunks that a step draws from; waits until they are there."""
        count = FIRST_CHUNKS + step // STEPS_OF_CHUNK
        while len(self.chunks) < count:
            path = self.folder / f"{len(self.chunks):04d}.npz"
            while not path.exists():
                time.sleep(0.5)
            with np.load(path) as file:
                self.chunks.append((file["rgb"], file["log"], file["is_open"]))
        return self.chunks[:count]

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


def batch(step: int, pool: Pool) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Pictures (Bx3xHxW); at half the size logarithms, their weights and what is open (BxHxW)."""
    rng = np.random.default_rng((step, 2))
    which = int(rng.integers(len(scenes.SHAPES)))
    chunks = pool.at(step)[which :: len(scenes.SHAPES)]
    rows = []
    for _ in range(BATCH):
        number = rng.integers(CHUNK)
        maps = [values[number] for values in chunks[rng.integers(len(chunks))]]
        picture, log, is_open = _cropped(rng, SHAPES[which], *maps)
        picture = _jittered(rng, picture).transpose(2, 0, 1)
        rows.append([picture, log, np.where(is_open, OPEN_WEIGHT, 1), is_open])
    stacked = (np.stack(column).astype(np.float32) for column in zip(*rows, strict=True))
    pictures, logs, weights, is_open = map(torch.from_numpy, stacked)
    return pictures.contiguous(memory_format=torch.channels_last), logs, weights, is_open


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
    encoder: cue.Weights,
    steps: int,
    settings: Settings,
    out: Path,
    resume: bool = False,
) -> cue.Weights:
    """Train the decoder and return folded weights, which are written to `out` now and then."""
    torch.manual_seed(0)
    network = Network(encoder, settings).to(memory_format=torch.channels_last)
    decay = torch.optim.swa_utils.get_ema_multi_avg_fn(0.998)
    mean = torch.optim.swa_utils.AveragedModel(network, multi_avg_fn=decay, use_buffers=True)
    optimiser = torch.optim.AdamW(network.parameters(), LEARNING_RATE, weight_decay=1e-3)
    stopped, first, losses, spent = out.with_suffix(".state.pt"), 0, [], 0.0
    if resume and stopped.exists():
        states = torch.load(stopped)
        first, spent = states["step"], states["spent"]
        for part, state in zip((network, mean, optimiser), states["parts"], strict=True):
            part.load_state_dict(state)
    began = time.process_time() - spent
    for step in range(first, steps):
        fading = 0.02 + 0.98 * (0.5 + 0.5 * np.cos(np.pi * step / steps))
        for group in optimiser.param_groups:
            group["lr"] = LEARNING_RATE * min(1, (step + 1) / 100) * fading
        torch.manual_seed(step)
        pictures, *truth = batch(step, pool)
        network.train()
        value = loss(network(pictures), *truth, settings)
        optimiser.zero_grad()
        value.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimiser.step()
        if step == 200:
            mean.n_averaged.zero_()  # what came before is forgotten
        mean.update_parameters(network)
        losses.append(value.item())
        if (step + 1) % CHECKPOINT == 0 or step + 1 == steps:
            spent = time.process_time() - began
            parts = [part.state_dict() for part in (network, mean, optimiser)]
            torch.save({"step": step + 1, "spent": spent, "parts": parts}, stopped)
            write(mean.module.folded(), out)
            said = f"{step + 1} steps, {spent / 60:.1f} min, {len(pool.chunks) * CHUNK} scenes"
            print(f"{said}, loss {np.mean(losses[-500:]):.4f}", flush=True)
    return mean.module.folded()


VARIANTS = {
    "as it is": Settings(),
    "from scratch": Settings(is_frozen=False),
    "without order of pairs": Settings(ranks=0.0),
    "without steps": Settings(gradients=0.0),
}


def main(
    quick: bool,
    out: Path,
    scenes_in: Path,
    encoder: Path | None = None,
    steps: int = 12000,
    compare: tuple[str, ...] = (),
    judge: tuple[Path, ...] = (),
    resume: bool = False,
) -> None:
    """Train, write and judge."""
    torch.set_num_threads(1)
    judging = [pair for place in judge for pair in pairs.read(place)]
    steps = 5 if quick else steps
    backbone = encoder_of(encoder) if encoder else shipped_encoder()
    pool = Pool(scenes_in, steps)
    try:
        for name, settings in VARIANTS.items():
            if name not in (compare or ("as it is",)):
                continue
            to = out.with_stem(f"{out.stem} {name}") if compare else out
            train(pool, backbone, steps, settings, to, resume)
            if judging:
                way = measures.by_weights(cue.learnt(to))
                print(name, measures.judged(way, judging), flush=True)
    finally:
        pool.stop()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a minute, to see that it runs")
    parser.add_argument("--out", type=Path, required=True, help="the weights to write")
    parser.add_argument("--scenes", type=Path, required=True, help="folder of rendered scenes")
    parser.add_argument("--encoder", type=Path, help="weights of YOLOX-nano, .npz")
    parser.add_argument("--judge", type=Path, nargs="*", default=(), help="pairs to judge by")
    parser.add_argument("--steps", type=int, default=12000)
    parser.add_argument(
        "--compare",
        nargs="*",
        default=(),
        choices=list(VARIANTS),
        help="variants, each for `steps`",
    )
    parser.add_argument("--resume", action="store_true", help="go on where it stopped")
    given = parser.parse_args()
    main(
        given.quick,
        given.out,
        given.scenes,
        given.encoder,
        given.steps,
        tuple(given.compare),
        tuple(given.judge),
        given.resume,
    )
