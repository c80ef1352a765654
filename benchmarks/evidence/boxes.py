"""What a detector is tuned by, and what it is scored by."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from benchmarks.evidence.tasks import Array

STRIDES = (8, 16, 32)
REACH = 2.5  # strides from the middle of a box to an anchor that may find it
MOST_ANCHORS = 10  # of one box
FAR = 1e5  # cost of an anchor outside a box or far from its middle


def loss_of(answers: Tensor, truths: Sequence[Sequence[Tensor]], side: int) -> Tensor:
    """YOLOX's loss (Ge et al. 2021, without L1) of answers (BxAx(5+C): middle, size, logits of
    object and classes); of each picture the boxes (Nx4, corners, px) and their classes (N).
    """
    centres, strides = anchors(side)
    corners = torch.cat(
        [answers[..., :2] - answers[..., 2:4] / 2, answers[..., :2] + answers[..., 2:4] / 2], -1
    )
    logits = answers[..., 4:]
    there = torch.zeros_like(logits[..., 0])
    total, count = logits.new_zeros(()), 0
    for place, (boxes, classes) in enumerate(truths):
        if not len(boxes):
            continue
        own, of = assigned(
            corners[place].detach(), logits[place].detach(), boxes, classes, centres, strides
        )
        there[place, own] = 1
        overlaps = overlap(corners[place, own], boxes[of], paired=True)
        wanted = torch.zeros_like(logits[place, own, 1:])
        wanted[torch.arange(len(own)), classes[of]] = overlaps.detach()
        kinds = binary_cross_entropy_with_logits(logits[place, own, 1:], wanted, reduction="sum")
        total = total + 5 * (1 - overlaps**2).sum() + kinds
        count += len(own)
    objects = binary_cross_entropy_with_logits(logits[..., 0], there, reduction="sum")
    return (total + objects) / max(count, 1)


def anchors(side: int) -> tuple[Tensor, Tensor]:
    """Middles (Ax2, px) and strides (A) of the places where a net of this input answers."""
    middles, strides = [], []
    for stride in STRIDES:
        steps = (torch.arange(side // stride) + 0.5) * stride
        y, x = torch.meshgrid(steps, steps, indexing="ij")
        middles.append(torch.stack([x, y], -1).reshape(-1, 2))
        strides.append(torch.full((len(middles[-1]),), float(stride)))
    return torch.cat(middles), torch.cat(strides)


def assigned(
    corners: Tensor, logits: Tensor, boxes: Tensor, classes: Tensor, middles: Tensor, near: Tensor
) -> tuple[Tensor, Tensor]:
    """SimOTA: anchors that have to find something, and which box (each M)."""
    x, y = middles.T[:, None]
    inside = (x > boxes[:, :1]) & (y > boxes[:, 1:2]) & (x < boxes[:, 2:3]) & (y < boxes[:, 3:])
    apart = ((boxes[:, None, :2] + boxes[:, None, 2:]) / 2 - middles).abs().amax(-1)
    close = apart < REACH * near
    overlaps = overlap(boxes, corners) * (inside | close)
    chances = (logits[:, :1].sigmoid() * logits[:, 1:].sigmoid()).sqrt().clamp(1e-7, 1 - 1e-7)
    absent = -torch.log1p(-chances)
    kinds = absent.sum(1) - chances.log().T[classes] - absent.T[classes]
    cost = kinds - 3 * torch.log(overlaps + 1e-8) + FAR * ~(inside & close)
    cost = cost + 10 * FAR * ~(inside | close)
    counts = overlaps.topk(min(MOST_ANCHORS, len(corners)), 1).values.sum(1).int().clamp(min=1)
    taken = torch.zeros_like(cost, dtype=torch.bool)
    for row, count in enumerate(counts.tolist()):
        taken[row, cost[row].topk(count, largest=False).indices] = True
    own = taken.any(0).nonzero()[:, 0]
    return own, torch.where(taken, cost, torch.inf)[:, own].argmin(0)


def overlap(first: Tensor, second: Tensor, paired: bool = False) -> Tensor:
    """Intersection over union of boxes (Nx4, Mx4, corners): NxM, or of pairs N."""
    if not paired:
        first = first[:, None]
    sides = torch.minimum(first[..., 2:], second[..., 2:]) - torch.maximum(
        first[..., :2], second[..., :2]
    )
    common = sides.clamp(min=0).prod(-1)
    areas = [(x[..., 2:] - x[..., :2]).clamp(min=0).prod(-1) for x in (first, second)]
    return common / (areas[0] + areas[1] - common + 1e-9)


def matched(
    sample: Any, found: Array, overlaps: Callable[[Array, Array], tuple[Array, ...]]
) -> Array:
    """Scores of boxes found in a picture (Mx5: corners, score) and whether each hits (Kx2): the
    best free box that it overlaps by half. What lies half in an ignored region counts neither way.
    """
    found = found[np.argsort(-found[:, 4], kind="stable")]
    of_truths = overlaps(found[:, :4], sample.boxes)[1]
    common, _, areas = overlaps(found[:, :4], sample.ignore)
    ignored = (common >= 0.5 * areas[:, None]).any(1)
    free, rows = np.ones(len(sample.boxes), bool), []
    for shares, passed, score in zip(of_truths, ignored, found[:, 4], strict=True):
        shares = np.where(free, shares, -1)
        hit = len(shares) > 0 and shares.max() >= 0.5
        if hit:
            free[shares.argmax()] = False
        if hit or not passed:
            rows.append((score, hit))
    return np.array(rows, float).reshape(-1, 2)


def average_precisions(hits: Sequence[Array], counts: Array, weights: Array) -> Array:
    """AP at 101 recalls of resamples (R) that have each picture so often (RxN); `hits` of each
    picture as by `matched`, `counts` of its true boxes (N).
    """
    places = np.repeat(np.arange(len(hits)), [len(rows) for rows in hits])
    scores, right = np.concatenate(hits).T
    order = np.argsort(-scores, kind="stable")
    often = weights[:, places[order]]
    true = np.cumsum(often * right[order], 1)
    recalls = true / (weights @ counts)[:, None]
    precisions = true / np.maximum(np.cumsum(often, 1), 1e-9)
    precisions = np.maximum.accumulate(precisions[:, ::-1], 1)[:, ::-1]
    precisions = np.pad(precisions, ((0, 0), (0, 1)))  # beyond the last recall
    levels = np.linspace(0, 1, 101)
    return np.array(
        [
            row[np.searchsorted(of, levels)].mean()
            for row, of in zip(precisions, recalls, strict=True)
        ]
    )
