"""A small net, trained on the pictures of an arm, and its scores with their intervals."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.evidence.sets import Crops
from benchmarks.evidence.tasks import Array

WIDTHS = (16, 32, 48, 64)
"""Channels of the four convolutions: .05 M parameters."""

BATCH = 64
RESAMPLES = 1000


@contextmanager
def keeper(answered: Path | None) -> Iterator[Path]:
    """The folder that keeps what nets answered, for a run that goes on; or one for this run."""
    with TemporaryDirectory() as temporary:
        folder = answered or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        yield folder


def net(classes: int, places: int = 1) -> nn.Module:
    """Four convolutions of stride 2, means over so many places a side, a line: 17 ms a step."""
    layers: list[nn.Module] = []
    for before, after in zip((3, *WIDTHS[:-1]), WIDTHS, strict=True):
        convolution = nn.Conv2d(before, after, 3, stride=2, padding=1)
        layers += [convolution, nn.BatchNorm2d(after), nn.ReLU()]
    line = nn.Linear(WIDTHS[-1] * places**2, classes)
    model = nn.Sequential(*layers, nn.AdaptiveAvgPool2d(places), nn.Flatten(), line)
    return model.to(memory_format=torch.channels_last)


def mirrored(batch: Tensor) -> Tensor:
    """Half of the pictures from the other side."""
    flipped = torch.rand(len(batch))[:, None, None, None] < 0.5
    return torch.where(flipped, batch.flip(-1), batch)


def trained(
    pictures: Tensor,
    labels: Tensor,
    classes: int,
    steps: int,
    seed: int,
    rate: float = 2e-3,
    places: int = 1,
    seen: Callable[[Tensor], Tensor] = mirrored,
) -> nn.Module:
    """A net after so many steps; weights, order and how batches are seen hang on the seed alone."""
    torch.manual_seed(seed)
    model = net(classes, places).train()
    optimiser = torch.optim.AdamW(model.parameters(), rate)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, max(steps, 2))
    for _ in range(steps):
        picked = torch.randint(len(labels), (BATCH,))
        batch = seen(normalised(pictures[picked]))
        loss = nn.functional.cross_entropy(model(batch), labels[picked])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return model.eval()


def normalised(pictures: Tensor) -> Tensor:
    """Bytes as a net takes them."""
    return pictures.float() / 127.5 - 1


def answers(model: nn.Module, crops: Crops, balanced: bool) -> Array:
    """Scores of each class (NxC), of the pictures or of grey-world's."""
    images = grey_world(crops) if balanced else crops.images
    return logits(model, torch.from_numpy(images).permute(0, 3, 1, 2)).numpy()


@torch.no_grad()
def logits(model: nn.Module, pictures: Tensor) -> Tensor:
    """Scores of each class (NxC), of bytes (Nx3x48x48)."""
    return torch.cat([model(normalised(part)) for part in pictures.split(256)])


def grey_world(crops: Crops) -> Array:
    """Each channel times what makes the whole picture grey, in linear light (exponent 2.2)."""
    gains = crops.light.mean(1, keepdims=True) / np.maximum(crops.light, 1e-3)
    balanced = (crops.images / 255) * gains[:, None, None] ** (1 / 2.2)
    return np.round(255 * np.clip(balanced, 0, 1)).astype(np.uint8)


def score(answers: Array, labels: Array) -> float:
    """Mean recall of the classes; of two classes the area under the curve."""
    return float(scores(answers, labels, np.ones((1, len(labels))))[0])


def scores(answers: Array, labels: Array, weights: Array) -> Array:
    """The same of resamples (R), which have each crop so often (RxN); classes that one lacks do not
    count in it.
    """
    with np.errstate(invalid="ignore"):
        if answers.shape[1] > 2:
            right = answers.argmax(1) == labels
            classes = [labels == label for label in np.unique(labels)]
            recalls = [weights[:, of] @ right[of] / weights[:, of].sum(1) for of in classes]
            return np.nanmean(recalls, 0)
        margin, there = answers[:, 1] - answers[:, 0], labels == 1
        fish, places = margin[there][:, None], margin[~there]
        in_order = (fish > places) + (fish == places) / 2
        of_fish, of_places = weights[:, there], weights[:, ~there]
        pairs = of_fish.sum(1) * of_places.sum(1)
        return ((of_fish @ in_order) * of_places).sum(1) / pairs


def table(answers: Mapping[str, list[Array]], crops: Crops, reference: str) -> dict[str, Any]:
    """Of each arm: its mean score and those of its nets, the parts that choose and judge, recalls
    of more than two classes, and the difference to the reference with intervals of 95 %: over
    blocks of pictures, and over whole films, both over nets, too.
    """

    def scores_of(name: str, weights: Array) -> Array:
        return np.stack([scores(net, crops.labels, weights) for net in answers[name]])

    parts = {"score": np.ones(len(crops.labels)), "choose": ~crops.judges, "judge": crops.judges}
    rows: dict[str, dict[str, Any]] = {}
    for name, nets in answers.items():
        row = {
            part: float(scores_of(name, of[None] * 1.0).mean()) if of.any() else None
            for part, of in parts.items()
        }
        rows[name] = {**row, "nets": [score(net, crops.labels) for net in nets]}
        if nets[0].shape[1] > 2:
            right = np.mean([net.argmax(1) == crops.labels for net in nets], 0)
            classes = np.unique(crops.labels)
            rows[name]["recalls"] = [float(right[crops.labels == c].mean()) for c in classes]
    for row in rows.values():
        row["difference"] = row["score"] - rows[reference]["score"]
    for kind, units in (("blocks", crops.blocks), ("films", crops.films)):
        weights = resampled_units(units)
        resampled = {name: over_nets(scores_of(name, weights)) for name in answers}
        for name, row in rows.items():
            apart = resampled[name] - resampled[reference]
            row[kind] = np.nanpercentile(apart, (2.5, 97.5)).tolist()
    return rows


def resampled_units(units: Any, count: int = RESAMPLES) -> Array:
    """How often resamples of whole units have each of their members (count x N)."""
    _, unit, sizes = np.unique(units, return_inverse=True, return_counts=True)
    picked = np.random.default_rng(0).integers(0, len(sizes), (count, len(sizes)))
    often = np.stack([np.bincount(row, minlength=len(sizes)) for row in picked])
    return often[:, unit.reshape(-1)].astype(float)


def over_nets(scores: Array) -> Array:
    """Mean scores (R) of resamples of nets, other nets in each column (KxR). Nets of other arms are
    resampled alike, as nets of one seed have the same order of pictures.
    """
    picked = np.random.default_rng(0).integers(0, len(scores), scores.shape)
    return np.take_along_axis(scores, picked, 0).mean(0)


def compared(scores: Mapping[str, Array], reference: str) -> dict[str, Any]:
    """Of each arm: its mean score, those of its nets, the difference to the reference, and
    intervals of 95 % of both, over resamples and nets. `scores` of each arm's nets, first of all
    there is, then of resamples (Kx(1+R)).
    """
    means = {arm: of_nets[:, 0].mean() for arm, of_nets in scores.items()}
    resampled = {arm: over_nets(of_nets[:, 1:]) for arm, of_nets in scores.items()}
    rows = {}
    for arm, of_nets in scores.items():
        apart = resampled[arm] - resampled[reference]
        rows[arm] = {
            "score": means[arm],
            "nets": of_nets[:, 0].tolist(),
            "interval": np.percentile(resampled[arm], (2.5, 97.5)).tolist(),
            "difference": means[arm] - means[reference],
            "blocks": np.percentile(apart, (2.5, 97.5)).tolist(),
        }
    return rows
