"""Guesses of near and far in a picture, by a small network.

Its encoder is the backbone of YOLOX-nano, as its authors trained it on COCO (`cue.LICENSE`). Its
decoder was trained on rendered scenes alone, by `python -m benchmarks.depth.train`.
"""

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import conv2d, interpolate, max_pool2d, silu

FILE = Path(__file__).with_name("cue.npz")  # kernels and biases by the names of layers, float16
STAGES = {"d2": 1, "d3": 3, "d4": 3, "d5": 1}  # blocks in each stage, at half the size of the last
POOLED_PX = (5, 9, 13)  # windows of the last stage
PIXELS = 12288  # of the copy that the network sees

Convolve = Callable[[str, Tensor, int], Tensor]  # (name, input, stride) → output of a layer
Weights = dict[str, tuple[Tensor, Tensor]]  # kernel and bias of each layer


def encoded(pictures: Tensor, convolve: Convolve) -> list[Tensor]:
    """Encode pictures (Bx3xHxW, sRGB in 0…1, sides multiples of 32): features at 1/2 to 1/32 of
    their size. The backbone of YOLOX-nano (Ge et al., arXiv:2107.08430).
    """

    def layer(name: str, x: Tensor, stride: int = 1) -> Tensor:
        return silu(convolve(name, x, stride), inplace=True)

    def separable(name: str, x: Tensor, stride: int = 1) -> Tensor:
        return layer(f"{name}.points", layer(f"{name}.window", x, stride))

    x = layer("stem", pictures, 2)
    features = [x]
    for stage, blocks in STAGES.items():
        x = separable(f"{stage}.down", x, 2)
        if stage == "d5":
            x = layer(f"{stage}.pooled.in", x)
            windows = [max_pool2d(x, side, 1, side // 2) for side in POOLED_PX]
            x = layer(f"{stage}.pooled.out", torch.cat([x, *windows], 1))
        deep, passed = layer(f"{stage}.split", x).chunk(2, 1)
        for block in range(blocks):
            change = separable(f"{stage}.{block}", layer(f"{stage}.{block}.in", deep))
            deep = change if stage == "d5" else deep + change
        x = layer(f"{stage}.joined", torch.cat([deep, passed], 1))
        features.append(x)
    return features


def decoded(features: list[Tensor], convolve: Convolve) -> Tensor:
    """Decode features of the encoder to Bx2xH/2xW/2: the logarithm of the distance, up to scale and
    shift, and the logit of open water.
    """
    sides = []
    for level, feature in enumerate(features):
        count, _, height, width = feature.shape
        rows, columns = (
            torch.linspace(-1, 1, side, dtype=feature.dtype, device=feature.device)
            for side in (height, width)
        )
        down = rows[:, None].expand(count, 1, height, width)
        across = columns.expand(count, 1, height, width)
        sides.append(convolve(f"side{level}", torch.cat([feature, down, across], 1), 1))
    means = torch.cat([feature.mean((2, 3), keepdim=True) for feature in features[:-3:-1]], 1)
    whole = convolve("whole.out", convolve("whole.in", means, 1).relu(), 1)
    last = len(features) - 1
    x = convolve(f"at{last}", (sides[-1] + whole).relu(), 1).relu()
    for level in reversed(range(last)):
        like = sides[level].shape[2:]
        finer = interpolate(convolve(f"up{level}", x, 1), like, mode="bilinear")
        x = convolve(f"at{level}", (finer + sides[level]).relu(), 1).relu()
    return convolve("answer", x, 1)


def small_copy(picture: Tensor) -> Tensor:
    """Shrink a picture (3xHxW) to some `PIXELS`, on the host; its sides are multiples of 32."""
    scale = math.sqrt(PIXELS / picture[0].numel())
    sides = [min(max(32 * round(side * scale / 32), 32), 512) for side in picture.shape[1:]]
    every = max(1, int(0.5 / scale))  # two samples along each side of a small pixel will do
    sampled = picture[:, ::every, ::every].float()
    mode = "area" if scale < 1 else "bilinear"
    return interpolate(sampled[None], sides, mode=mode)[0].cpu()


def layers_of(weights: Weights) -> Convolve:
    """Return convolutions with these weights; kernels of one channel act on each channel apart."""

    def convolve(name: str, x: Tensor, stride: int) -> Tensor:
        kernel, bias = weights[name]
        around = (kernel.shape[-1] - 1) // 2
        return conv2d(x, kernel, bias, stride, around, groups=x.shape[1] // kernel.shape[1])

    return convolve


@torch.no_grad()
def relative(picture: Tensor, weights: Weights) -> tuple[Tensor, Tensor]:
    """Guess from a picture (3xHxW, sRGB in 0…1), H/2xW/2 each: logarithms of distance, up to scale
    and shift; and the probability of open water, sky or a plain backdrop.
    """
    convolve = layers_of(weights)
    pictures = picture[None].contiguous(memory_format=torch.channels_last)
    log, is_open = decoded(encoded(pictures, convolve), convolve)[0]
    return log, is_open.sigmoid()


@cache
def learnt(path: Path = FILE) -> Weights:
    """Read the weights of a file, once."""
    with np.load(path) as file:
        arrays = {name: torch.from_numpy(file[name].astype(np.float32)) for name in file.files}
    return {
        # channels last take a fifth less time
        name: (kernel.contiguous(memory_format=torch.channels_last), arrays[f"{name}.bias"])
        for name, kernel in arrays.items()
        if not name.endswith(".bias")
    }
