"""A small net, trained on the pictures of an arm, and its scores with their intervals."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from scipy.stats import rankdata
from torch import Tensor, nn

from benchmarks.evidence.sets import Crops
from benchmarks.evidence.tasks import Array

WIDTHS = (16, 32, 48, 64)
"""Channels of the four convolutions: .05 M parameters."""

BATCH = 64
RESAMPLES = 1000


def net(classes: int) -> nn.Module:
    """Four convolutions, each halving the sides, a mean over what is left, a line."""
    layers: list[nn.Module] = []
    for before, after in zip((3, *WIDTHS[:-1]), WIDTHS, strict=True):
        block = [nn.Conv2d(before, after, 3, padding=1), nn.BatchNorm2d(after), nn.ReLU()]
        layers += [*block, nn.MaxPool2d(2)]
    return nn.Sequential(*layers, nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(64, classes))


def trained(pictures: Tensor, labels: Tensor, classes: int, steps: int, seed: int) -> nn.Module:
    """A net after so many steps; weights, order and flips hang on the seed alone."""
    torch.manual_seed(seed)
    model = net(classes).train()
    optimiser = torch.optim.AdamW(model.parameters(), 2e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 2e-3, max(steps, 2))
    for _ in range(steps):
        picked = torch.randint(len(labels), (BATCH,))
        flipped = torch.rand(BATCH)[:, None, None, None] < 0.5
        batch = normalised(pictures[picked])
        batch = torch.where(flipped, batch.flip(-1), batch)
        loss = nn.functional.cross_entropy(model(batch), labels[picked])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return model.eval()


def normalised(pictures: Tensor) -> Tensor:
    """Bytes as a net takes them."""
    return pictures.float() / 127.5 - 1


@torch.no_grad()
def answers(model: nn.Module, crops: Crops, balanced: bool) -> Array:
    """Scores of each class (NxC), of the pictures or of grey-world's."""
    images = grey_world(crops) if balanced else crops.images
    pictures = torch.from_numpy(images).permute(0, 3, 1, 2)
    return torch.cat([model(normalised(part)) for part in pictures.split(256)]).numpy()


def grey_world(crops: Crops) -> Array:
    """Each channel times what makes the whole picture grey, in linear light (exponent 2.2)."""
    gains = crops.light.mean(1, keepdims=True) / np.maximum(crops.light, 1e-3)
    balanced = (crops.images / 255) * gains[:, None, None] ** (1 / 2.2)
    return np.round(255 * np.clip(balanced, 0, 1)).astype(np.uint8)


def score(answers: Array, labels: Array) -> float:
    """Mean recall of the classes; of two classes the area under the curve."""
    if answers.shape[1] > 2:
        right = answers.argmax(1) == labels
        return float(np.mean([right[labels == label].mean() for label in np.unique(labels)]))
    positive = labels == 1
    there = int(positive.sum())
    if there in (0, len(labels)):
        return float("nan")
    ranks = rankdata(answers[:, 1] - answers[:, 0])
    least = there * (there + 1) / 2
    return float((ranks[positive].sum() - least) / (there * (len(labels) - there)))


def table(
    answers: Mapping[str, list[Array]], crops: Crops, reference: str, rng: np.random.Generator
) -> dict[str, Any]:
    """Of each arm: mean score and those of its seeds, recalls or not, the parts that choose and
    judge, and the difference to the reference with its interval of 95 %, over blocks of pictures.
    """

    def mean_score(name: str, of: Array) -> float:
        return float(np.mean([score(seed[of], crops.labels[of]) for seed in answers[name]]))

    everything = np.arange(len(crops.labels))
    parts = {"choose": everything[~crops.judges], "judge": everything[crops.judges]}
    members = [np.flatnonzero(crops.blocks == block) for block in np.unique(crops.blocks)]
    resampled: dict[str, list[float]] = {name: [] for name in answers}
    for _ in range(RESAMPLES if len(everything) > 200 else 50):
        of = np.concatenate([members[i] for i in rng.integers(0, len(members), len(members))])
        for name in answers:
            resampled[name].append(mean_score(name, of))
    found = {}
    for name in answers:
        apart = np.subtract(resampled[name], resampled[reference])
        found[name] = {
            "score": mean_score(name, everything),
            "seeds": [score(seed, crops.labels) for seed in answers[name]],
            **{part: mean_score(name, of) if len(of) else None for part, of in parts.items()},
            "difference": mean_score(name, everything) - mean_score(reference, everything),
            "interval": np.nanpercentile(apart, (2.5, 97.5)).tolist(),
        }
        if answers[name][0].shape[1] > 2:
            right = np.mean([seed.argmax(1) == crops.labels for seed in answers[name]], 0)
            classes = np.unique(crops.labels)
            found[name]["recalls"] = [float(right[crops.labels == c].mean()) for c in classes]
    return found
