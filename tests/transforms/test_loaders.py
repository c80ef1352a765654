import json
import multiprocessing
import warnings
from typing import Any

import pytest
import torch
from loading import (
    SIZE,
    Crops,
    DegradeBatch,
    Degraded,
    Epochs,
    Keyed,
    KeyedByEpoch,
    Pairs,
)
from torch import Tensor, nn
from torch.utils.data import DataLoader

from uwaug import RandomUnderwater

pytestmark = [
    # Python ≥ 3.12 warns of every fork with threads
    pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning"),
    # on machines of one core
    pytest.mark.filterwarnings("ignore:This DataLoader will create"),
]
AVAILABLE = multiprocessing.get_all_start_methods()
START = pytest.mark.parametrize("start", [m for m in ("fork", "spawn") if m in AVAILABLE])


@pytest.fixture(scope="module")
def crops(motorcycle: Any) -> Crops:
    return Crops(motorcycle.srgb.float(), motorcycle.distance.float())


def loader(
    dataset: Any, start: str | None = None, workers: int = 2, **options: Any
) -> "DataLoader[Any]":
    context = {"multiprocessing_context": start, "timeout": 60} if workers else {}
    return DataLoader(dataset, **{"batch_size": 4, "num_workers": workers, **context, **options})


@START
def test_classification(start: str, crops: Crops) -> None:
    torch.manual_seed(0)
    augment = RandomUnderwater(["II", "1C"], mixing=(0, 1), p=0.9)
    model = nn.Sequential(
        nn.BatchNorm2d(3), nn.Conv2d(3, 8, 5, 4), nn.ReLU(), nn.Flatten(), nn.LazyLinear(2)
    )
    model(torch.zeros(2, 3, SIZE, SIZE))  # makes the lazy layer
    optimizer = torch.optim.Adam(model.parameters(), 0.01)
    # workers that persist go on with their random numbers: other waters in the next epoch
    data = loader(Degraded(crops, augment), start, persistent_workers=True)
    losses, epochs = [], []
    for _ in range(5):
        seen = []
        for images, labels in data:
            loss = nn.functional.cross_entropy(model(images), labels)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            seen.append((images, labels, loss.item()))
        pictures, truth, values = zip(*seen, strict=True)
        epochs.append(torch.cat(pictures))
        losses.append(sum(values))
        assert torch.cat(truth).tolist() == [label for *_, label in crops]
    assert losses[-1] < losses[0] / 2
    clean = torch.stack([image for image, *_ in crops])
    assert all(images.shape == clean.shape for images in epochs)
    assert not torch.equal(epochs[0], epochs[1])
    touched = (epochs[0] != clean).flatten(1).any(1)
    assert touched.sum() >= len(crops) / 2


@START
def test_paired_restoration(start: str, crops: Crops) -> None:
    torch.manual_seed(1)
    augment = RandomUnderwater(visibility=(2.0, 8.0), g=(0.1, 0.3))
    model = nn.Conv2d(3, 3, 3, padding=1)
    optimizer = torch.optim.Adam(model.parameters(), 0.05)
    data = loader(Pairs(crops, augment), start)
    losses, seeds = [], []
    for _ in range(2):
        first, total = 0, 0.0
        for clean, degraded, records in data:
            loss = nn.functional.l1_loss(model(degraded), clean)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            total += loss.item()
            for i, record in enumerate(map(json.loads, records)):
                image, distance, _ = crops[first + i]
                assert torch.equal(clean[i], image)
                # what a worker has drawn, with one thread, is replayed here bit for bit
                assert torch.equal(augment.transform(image, distance, record), degraded[i])
                seeds.append(record["samples"][0]["field_seed"])
            first += len(clean)
        losses.append(total)
    assert losses[-1] < losses[0]
    # two workers, two epochs, no draw twice
    assert len(seeds) == len(set(seeds)) == 2 * len(crops)


def run(data: "DataLoader[Any]") -> dict[int, Tensor]:
    found = {}
    for indices, images in data:
        found |= dict(zip(indices.tolist(), images, strict=True))
    return found


def test_keys_do_not_depend_on_workers(crops: Crops) -> None:
    dataset = Keyed(crops, RandomUnderwater(mixing=(0, 1), visibility=(2.0, 8.0)))
    before = torch.get_num_threads()
    torch.set_num_threads(2)  # the main process has more than a worker
    expected = run(loader(dataset, workers=0))
    torch.set_num_threads(before)
    one, two = loader(dataset, "fork", 1), loader(dataset, "fork", 2, shuffle=True)
    spawned = loader(dataset, "spawn", 2, batch_size=3)
    for data in (one, two, spawned):
        found = run(data)
        assert found.keys() == expected.keys()
        assert all(torch.equal(found[i], expected[i]) for i in expected)
    dataset.epoch = 1
    later = run(loader(dataset, "fork", 2))
    assert not any(torch.equal(later[i], expected[i]) for i in expected)


@START
def test_a_sampler_brings_the_epoch_to_workers_that_persist(start: str, crops: Crops) -> None:
    dataset = KeyedByEpoch(crops, RandomUnderwater(visibility=(2.0, 8.0)))
    data = loader(dataset, start, sampler=Epochs(len(crops)), persistent_workers=True)
    epochs = [run(data) for _ in range(3)]
    here = loader(dataset, workers=0, sampler=Epochs(len(crops)))
    for found in epochs:
        expected = run(here)
        assert found.keys() == expected.keys() == set(range(len(crops)))
        assert all(torch.equal(found[i], expected[i]) for i in expected)
    assert not any(torch.equal(epochs[0][i], epochs[1][i]) for i in epochs[0])


def test_crops_without_any_known_distance(motorcycle: Any) -> None:
    distance = motorcycle.distance.float().clone()
    distance[:, :, 150:700] = 0.0
    crops = Crops(motorcycle.srgb.float(), distance, count=32)
    silent = [not bool((z > 0).any()) for _, z, _ in crops]
    assert 4 < sum(silent) < 30
    data = loader(Pairs(crops, RandomUnderwater(unknown="skip")), "fork", worker_init_fn=quiet)
    pairs = [(clean, out) for batch in data for clean, out in zip(*batch[:2], strict=True)]
    assert [torch.equal(clean, out) for clean, out in pairs] == silent
    with pytest.raises(ValueError, match="unknown='skip'"):
        list(loader(Pairs(crops, RandomUnderwater(unknown="fill")), "fork", worker_init_fn=quiet))


def quiet(worker: int) -> None:
    """Fill maps of which much is unknown."""
    warnings.simplefilter("ignore")


@pytest.mark.parametrize("workers", [0, 2])
def test_whole_batches_in_collate_fn(workers: int, crops: Crops) -> None:
    torch.manual_seed(2)
    for augment in (RandomUnderwater(p=0.7), RandomUnderwater(same_on_batch=True)):
        data = loader(crops, "fork", workers, collate_fn=DegradeBatch(augment))
        batches = list(data)
        assert all(type(batch) is list and len(batch) == 3 for batch in batches)
        images, distances, labels = (torch.cat(parts) for parts in zip(*batches, strict=True))
        clean, given, wanted = zip(*crops, strict=True)
        assert torch.equal(distances, torch.stack(given))
        assert labels.tolist() == list(wanted)
        assert images.shape == (len(crops), 3, SIZE, SIZE)
        assert not torch.equal(images, torch.stack(clean))
