"""Guesses of near and far in a picture, by a small network of our own.

`python -m benchmarks.depth.train --minutes 35 --out FILE` has trained it from scratch on rendered
scenes with procedural textures. It has seen no photograph.
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
"""File of kernels and biases of `LAYERS` in turn, as little-endian float16."""

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
"""Channels in, channels out and side of the kernel, by layer. ReLU follows all layers but "answer",
"whole" and "to_…".
"""

_COPY_PIXELS = 12288
"""Pixels of the small copy that the network sees."""

Convolve = Callable[[str, Tensor, int], Tensor]
"""Function (name, input, stride) → output of a layer."""


def answer(pictures: Tensor, convolve: Convolve) -> Tensor:
    """Run the network on pictures (Bx3xHxW, sRGB in 0…1, sides multiples of 16).

    Returns (Bx2xH/2xW/2): the relative distance in the logarithm, and the logit of open water.
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
    for name, skip in (("eighth", eighth), ("quarter", quarter), ("half", half)):
        finer = interpolate(convolve(f"to_{name}", x, 1), skip.shape[2:], mode="bilinear")
        x = convolve(f"at_{name}", (finer + skip).relu(), 1)
    return convolve("answer", x, 1)


Weights = dict[str, tuple[Tensor, Tensor]]
"""Kernel and bias of each layer."""


def is_rectified(layer: str) -> bool:
    """True if ReLU follows a layer."""
    return layer not in ("answer", "whole") and not layer.startswith("to_")


def small_copy(picture: Tensor) -> Tensor:
    """Shrink a picture (3xHxW) to some 12,000 pixels, sides multiples of 16, on the processor. The
    scale of its values stays.
    """
    scale = math.sqrt(_COPY_PIXELS / picture[0].numel())
    sides = [min(max(16 * round(side * scale / 16), 16), 512) for side in picture.shape[1:]]
    stride = max(1, int(0.25 / scale))  # four samples along each side of a small pixel will do
    sampled = picture[:, ::stride, ::stride].float()
    return interpolate(sampled[None], sides, mode="area")[0].cpu()


def layers_of(weights: Weights) -> Convolve:
    """Make the layers for `answer` from their weights."""

    def convolve(name: str, x: Tensor, stride: int) -> Tensor:
        kernel, bias = weights[name]
        x = conv2d(x, kernel, bias, stride, kernel.shape[-1] // 2)
        return x.relu_() if is_rectified(name) else x

    return convolve


@torch.no_grad()
def relative(picture: Tensor, weights: Weights) -> tuple[Tensor, Tensor]:
    """Guess distances of a picture (3xHxW, sRGB in 0…1). A mirrored picture gets them mirrored.

    Returns (H/2xW/2 each): logarithms of distance, up to scale and shift; and the probability of
    open water, sky or a plain backdrop.
    """
    outputs = answer(torch.stack([picture, picture.flip(2)]), layers_of(weights))
    log, is_open = 0.5 * (outputs[0] + outputs[1].flip(2))
    return log, is_open.sigmoid()


@cache
def learnt() -> Weights:
    """Weights that come with the package, read once."""
    numbers, weights, start = np.fromfile(WEIGHTS, "<f2").astype(np.float32), {}, 0
    for name, (before, after, side) in LAYERS.items():
        middle = start + before * after * side * side
        kernel = torch.from_numpy(numbers[start:middle]).view(after, before, side, side)
        # channels last take a fifth less time
        kernel = kernel.contiguous(memory_format=torch.channels_last)
        start = middle + after
        weights[name] = (kernel, torch.from_numpy(numbers[middle:start]))
    return weights
