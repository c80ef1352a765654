"""What looks near and what looks far in a picture: a small network of our own.

It was trained from scratch by `python -m benchmarks.depth.train --minutes 35 --out FILE`, on scenes
that are rendered, with procedural textures: it has seen no photograph.
"""

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import conv2d, interpolate

WEIGHTS = Path(__file__).with_name("cue.f16")
"""Kernels and biases of `LAYERS` in turn, as little-endian float16."""

LAYERS = {
    "half1": (5, 16, 3),
    "half2": (16, 16, 3),
    "quarter1": (16, 32, 3),
    "quarter2": (32, 32, 3),
    "eighth1": (32, 64, 3),
    "eighth2": (64, 64, 3),
    "sixteenth1": (64, 128, 3),
    "sixteenth2": (128, 128, 3),
    "whole": (128, 128, 1),
    "to_eighth": (128, 64, 1),
    "at_eighth": (64, 64, 3),
    "to_quarter": (64, 32, 1),
    "at_quarter": (32, 32, 3),
    "to_half": (32, 16, 1),
    "at_half": (16, 16, 3),
    "answer": (16, 2, 3),
}
"""Channels in and out and the side of the kernel. All are followed by ReLU, but "answer", "whole"
and "to_…".
"""

_PIXELS = 12288
"""Of the copy that the network sees."""

Convolve = Callable[[str, Tensor, int], Tensor]
"""A layer by name, of an input, with a stride."""


def answer(pictures: Tensor, convolve: Convolve) -> Tensor:
    """The network: pictures (Bx3xHxW, sRGB in 0…1, sides multiples of 16) to how far (relative, in
    the logarithm) and how open (a logit) each place is (Bx2xH/2xW/2).
    """
    count, _, height, width = pictures.shape
    rows, columns = (pictures.new_tensor(np.linspace(-1, 1, side)) for side in (height, width))
    down = rows[:, None].expand(count, 1, height, width)
    across = columns.expand(count, 1, height, width)
    half = convolve("half1", torch.cat([4 * (pictures - 0.45), down, across], 1), 2)
    half = convolve("half2", half, 1)
    quarter = convolve("quarter2", convolve("quarter1", half, 2), 1)
    eighth = convolve("eighth2", convolve("eighth1", quarter, 2), 1)
    x = convolve("sixteenth2", convolve("sixteenth1", eighth, 2), 1)
    x = x + convolve("whole", x.mean((2, 3), keepdim=True), 1)
    for name, like in (("eighth", eighth), ("quarter", quarter), ("half", half)):
        finer = interpolate(convolve(f"to_{name}", x, 1), like.shape[2:], mode="bilinear")
        x = convolve(f"at_{name}", (finer + like).relu(), 1)
    return convolve("answer", x, 1)


Weights = dict[str, tuple[Tensor, Tensor]]
"""Kernel and bias of each layer."""


def is_rectified(layer: str) -> bool:
    """Whether ReLU follows a layer."""
    return layer not in ("answer", "whole") and not layer.startswith("to_")


def small_copy(picture: Tensor) -> Tensor:
    """A picture (3xHxW) as the network sees it: some 12,000 pixels, sides multiples of 16; on the
    processor, with whites as they were.
    """
    scale = math.sqrt(_PIXELS / picture[0].numel())
    sides = [min(max(16 * round(side * scale / 16), 16), 512) for side in picture.shape[1:]]
    every = max(1, int(0.25 / scale))  # four samples along each side of a small pixel will do
    sampled = picture[:, ::every, ::every].float()
    return interpolate(sampled[None], sides, mode="area")[0].cpu()


def layers_of(weights: Weights) -> Convolve:
    """The layers with such weights, as `answer` takes them."""

    def convolve(name: str, x: Tensor, stride: int) -> Tensor:
        kernel, bias = weights[name]
        x = conv2d(x, kernel, bias, stride, kernel.shape[-1] // 2)
        return x.relu_() if is_rectified(name) else x

    return convolve


@torch.no_grad()
def relative(picture: Tensor, weights: Weights) -> tuple[Tensor, Tensor]:
    """How far each place of a picture (3xHxW, sRGB in 0…1) is, in the logarithm, up to scale and
    shift; and with what probability it is open: sky, water, a plain backdrop. Both have half its
    sides. Of a mirrored picture the mirrored map, as it is asked both ways round.
    """
    ways = answer(torch.stack([picture, picture.flip(2)]), layers_of(weights))
    log, is_open = 0.5 * (ways[0] + ways[1].flip(2))
    return log, is_open.sigmoid()


@cache
def learnt() -> Weights:
    """The weights of the wheel, read once."""
    numbers, weights, start = np.fromfile(WEIGHTS, "<f2").astype(np.float32), {}, 0
    for name, (before, after, side) in LAYERS.items():
        middle = start + before * after * side * side
        kernel = torch.from_numpy(numbers[start:middle]).view(after, before, side, side)
        # channels last take a fifth less time
        kernel = kernel.contiguous(memory_format=torch.channels_last)
        start = middle + after
        weights[name] = (kernel, torch.from_numpy(numbers[middle:start]))
    return weights
