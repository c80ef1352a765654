import copy
import json
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from augmenting import (
    EVERYTHING,
    OPTIONS,
    H,
    W,
    brightness,
    distances,
    leaves,
    picture,
    result,
    same,
)
from torch import Tensor

from uwaug import RandomUnderwater

# Contracts that hold for all options


@pytest.mark.parametrize("batch", [None, 3], ids=["single", "batch"])
def test_replay_is_bit_exact(options: dict[str, Any], batch: int | None) -> None:
    aug = RandomUnderwater(**options)
    image, *rest = leaves(aug, batch)
    distance = rest[0] if rest else None
    for seed in range(2):
        torch.manual_seed(seed)
        record = aug.make_params(image)
        first = aug.transform(image, distance, record)
        torch.manual_seed(seed)
        drawn = aug(image, distance)[0] if rest else aug(image)
        assert same(first, drawn)
        assert same(first, aug.transform(image, distance, record))
        read = json.loads(json.dumps(record, allow_nan=False))
        assert read == record
        assert same(first, aug.transform(image, distance, read))
        assert same(first, aug.transform(image, distance, pickle.loads(pickle.dumps(record))))
        assert same(first, pickle.loads(pickle.dumps(aug)).transform(image, distance, read))
        for threads in (1, 3):
            before = torch.get_num_threads()
            torch.set_num_threads(threads)
            assert same(first, aug.transform(image, distance, record))
            assert torch.get_num_threads() == threads
            torch.set_num_threads(before)
        assert first.isfinite().all()


REPLAY = """
import json, pickle, sys, torch
augs, inputs = pickle.load(open("augs.pickle", "rb"))
records = json.load(open("records.json"))
results = {}
for name, aug in augs.items():
    image, distance = (*inputs[name], None)[:2]
    results[name] = aug.transform(image, distance, records[name])
torch.save(results, "results.pt")
"""


def test_replay_in_another_process(tmp_path: Path) -> None:
    augs = {name: RandomUnderwater(**o) for name, o in OPTIONS.items() if name != "network"}
    records = {name: aug.make_params(picture(2)) for name, aug in augs.items()}
    (tmp_path / "records.json").write_text(json.dumps(records))
    inputs = {name: leaves(aug, 2) for name, aug in augs.items()}
    (tmp_path / "augs.pickle").write_bytes(pickle.dumps((augs, inputs)))
    subprocess.run([sys.executable, "-c", REPLAY], cwd=tmp_path, check=True)
    for name, theirs in torch.load(tmp_path / "results.pt").items():
        image, *rest = inputs[name]
        ours = augs[name].transform(image, rest[0] if rest else None, records[name])
        assert same(theirs, ours), name


def test_batch_is_its_pictures_one_by_one(options: dict[str, Any]) -> None:
    if options.get("same_on_batch"):
        return
    aug = RandomUnderwater(**options)
    image, *rest = leaves(aug, 3)
    record = aug.make_params(image)
    assert len(record["samples"]) == 3
    whole = aug.transform(image, rest[0] if rest else None, record)
    for i, sample in enumerate(record["samples"]):
        single = aug.transform(image[i], rest[0][i] if rest else None, {"samples": [sample]})
        assert same(whole[i], single)


def test_copies_and_pickles(options: dict[str, Any]) -> None:
    aug = RandomUnderwater(**options)
    for twin in (copy.deepcopy(aug), copy.copy(aug), pickle.loads(pickle.dumps(aug))):
        assert same(result(aug, 2), result(twin, 2))
        assert repr(twin) == repr(aug)


class Classifier(torch.nn.Module):
    """A model that puts its pictures under water itself."""

    def __init__(self, augment: torch.nn.Module) -> None:
        super().__init__()
        self.augment, self.layer = augment, torch.nn.Conv2d(3, 4, 3)

    def forward(self, image: Tensor, distance: Tensor) -> Tensor:
        wet, _ = self.augment(2 * image - image, distance)
        out: Tensor = self.layer(wet)
        return out


@pytest.mark.parametrize("name", ["default", "everything random", "half", "lamps"])
def test_torch_compile_breaks_the_graph_and_draws_the_same(name: str) -> None:
    torch.compiler.reset()
    torch._dynamo.utils.counters.clear()
    model = Classifier(RandomUnderwater(**OPTIONS[name]))
    compiled = torch.compile(model, backend="eager")
    for seed in range(3):
        results = []
        for either in (model, compiled):
            torch.manual_seed(seed)
            results.append(either(picture(2), distances(2) + 1))
        assert same(*results)
    counts = torch._dynamo.utils.counters["stats"]
    assert counts["unique_graphs"] == 2  # before and behind the transform


def test_p_0_returns_the_input() -> None:
    for options in ({}, {"same_on_batch": True}, {"distance": (1.0, 2.0)}):
        aug = RandomUnderwater(p=0.0, **options)
        for batch in (None, 3):
            image = picture(batch, torch.uint8)
            assert aug(image, distances(batch))[0] is image
            assert aug({"image": image, "distance": distances(batch)})["image"] is image
    calls = []
    aug = RandomUnderwater(p=0.0, distance=calls.append)
    image = picture(3)
    assert aug(image) is image
    assert not calls


def test_p_leaves_some_pictures_alone() -> None:
    seen = []
    aug = RandomUnderwater(p=0.5, distance=lambda x: seen.append(len(x)) or brightness(x) + 1)
    image = picture(40)
    record = aug.make_params(image)
    applied = torch.tensor([s["applied"] for s in record["samples"]])
    assert 5 < applied.sum() < 35
    out = aug.transform(image, None, record)
    assert torch.equal((out != image).flatten(1).any(1), applied)
    assert seen == [applied.sum()]


def test_same_on_batch() -> None:
    aug = RandomUnderwater(same_on_batch=True, **EVERYTHING)
    image, distance = picture().repeat(3, 1, 1, 1), (distances() + 1).repeat(3, 1, 1, 1)
    assert len(aug.make_params(image)["samples"]) == 1
    out, _ = aug(image, distance)
    assert torch.equal(out[0], out[1])
    assert torch.equal(out[0], out[2])
    out, _ = RandomUnderwater(**EVERYTHING)(image, distance)
    assert not torch.equal(out[0], out[1])


def test_record_of_one_picture_serves_a_batch() -> None:
    aug = RandomUnderwater(**EVERYTHING)
    image, distance = picture(3), distances(3) + 1
    record = aug.make_params(image[0])
    out = aug.transform(image, distance, record)
    for i in range(3):
        assert same(out[i], aug.transform(image[i], distance[i], record))


def test_one_map_serves_a_batch() -> None:
    aug = RandomUnderwater()
    image, distance = picture(3), distances() + 1
    record = aug.make_params(image)
    whole = aug.transform(image, distance.expand(3, 1, H, W), record)
    assert same(whole, aug.transform(image, distance, record))
    assert same(whole, aug.transform(image, distance[None], record))


def test_empty_batches_and_tiny_pictures() -> None:
    aug = RandomUnderwater(**EVERYTHING)
    image = picture(0)
    assert aug(image, distances(0))[0] is image
    for size in ((1, 1), (1, 9), (7, 1), (2, 3)):
        out, _ = aug(torch.rand(3, *size), torch.rand(1, *size) + 0.5)
        assert out.shape == (3, *size)
        assert out.isfinite().all()


def test_map_or_plane_or_network() -> None:
    image, distance = picture(), distances() + 1
    aug = RandomUnderwater(distance=3.0)
    plane = aug.at(0, 0, 0)(image)
    assert isinstance(plane, Tensor)
    # in a dict a map goes before; in a tuple nothing is taken for one
    assert not torch.equal(aug.at(0, 0, 0)({"image": image, "distance": distance})["image"], plane)
    assert same(aug.at(0, 0, 0)({"image": image})["image"], plane)
    assert same(aug.at(0, 0, 0)({"image": image, "distance": None})["image"], plane)
    assert same(aug.at(0, 0, 0)(image, distance)[0], plane)
    assert same(RandomUnderwater().at(0, 0, 0)(image, torch.full((1, H, W), 3.0))[0], plane)
    network = RandomUnderwater(distance=brightness, distance_kind="relative")
    expected = RandomUnderwater(distance_kind="relative").at(0, 0, 0)(image, brightness(image))[0]
    assert same(network.at(0, 0, 0)(image), expected)
    assert torch.equal(network.at(0, 0, 0)(image[None])[0], expected)
    seen: list[Tensor] = []
    network = RandomUnderwater(distance=lambda x: seen.append(x) or brightness(x) + 1)
    network(picture(dtype=torch.uint8))
    assert seen[0].shape == (3, H, W)
    assert seen[0].is_floating_point()
    assert seen[0].max() <= 1
    module = torch.nn.Conv2d(3, 1, 1)
    out = RandomUnderwater(distance=torch.nn.Sequential(module, torch.nn.Softplus()))(image)
    assert out.isfinite().all()
    assert not out.requires_grad
