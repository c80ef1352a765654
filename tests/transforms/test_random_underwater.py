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
    LIGHTS,
    OPTIONS,
    H,
    W,
    brightness,
    distances,
    leaves,
    picture,
    same,
)
from torch import Tensor

import uwaug
from uwaug import RandomUnderwater
from uwaug.transforms import collate_records

# Contracts that hold for all options


def mapped(rest: list[Tensor], i: int | None = None) -> Tensor | None:
    """The maps of a batch, or the i-th, where there are any."""
    if not rest:
        return None
    return rest[0] if i is None else rest[0][i]


def test_replay_is_bit_exact(options: dict[str, Any]) -> None:
    aug = RandomUnderwater(**options)
    image, *rest = leaves(aug, 3)
    torch.manual_seed(5)
    record = aug.make_params(image)
    first = aug.transform(image, mapped(rest), record)
    assert first.isfinite().all()
    torch.manual_seed(5)
    drawn = aug(image, *rest)
    assert same(first, drawn[0] if rest else drawn)
    read = json.loads(json.dumps(record, allow_nan=False))
    assert read == record
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        twin = pickle.loads(pickle.dumps(aug))
        assert same(first, twin.transform(image, mapped(rest), pickle.loads(pickle.dumps(record))))
        resolved = json.loads(json.dumps(aug.resolve(image, mapped(rest), read)))
        assert same(first, aug.transform(image, mapped(rest), resolved))
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)
    assert "used" not in record["samples"][0]


def test_batch_is_its_pictures_one_by_one(options: dict[str, Any]) -> None:
    aug = RandomUnderwater(**{**options, "same_on_batch": False})
    image, *rest = leaves(aug, 3)
    records = [aug.make_params(one) for one in image]
    pictures = [
        aug.transform(one, mapped(rest, i), record)
        for i, (one, record) in enumerate(zip(image, records, strict=True))
    ]
    batch = collate_records([json.dumps(records[0]), *records[1:]])
    assert same(aug.transform(image, mapped(rest), batch), torch.stack(pictures))


REPLAY = """
import json, pickle, torch
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
        assert same(theirs, augs[name].transform(image, mapped(rest), records[name])), name


# the curve from light to sRGB is steep at black
ROUNDING = {torch.float16: 6e-4, torch.bfloat16: 5e-3, torch.float32: 2e-5, torch.float64: 0}
DTYPES = [("default", dtype, b) for dtype in (torch.uint8, *ROUNDING) for b in (None, 2)]


@pytest.mark.parametrize(
    "name, dtype, batch", [*((name, torch.float32, None) for name in OPTIONS), *DTYPES]
)
def test_types(name: str, dtype: torch.dtype, batch: int | None) -> None:
    aug = RandomUnderwater(**{"distance": 3.0, **OPTIONS[name]})
    image = picture(batch, dtype)
    record = aug.make_params(image)
    out = aug.transform(image, None, record)
    assert out.dtype == dtype
    assert out.shape == image.shape
    assert out.is_contiguous()
    if dtype == torch.uint8:
        exact = aug.transform(image / 255, None, record)
        assert same(out, (exact * 255).round().clamp(0, 255).byte())
    else:
        exact = aug.transform(image.double(), None, record)
        assert (out.double() - exact).abs().max() <= ROUNDING[dtype]


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


def test_a_record_names_what_computed_the_picture() -> None:
    pytest.importorskip("numba")
    image, distance = picture(), distances() + 1

    def path(picture: Tensor, **options: Any) -> list[str]:
        aug = RandomUnderwater(**options)
        record = aug.make_params(picture)
        resolved = aug.resolve(picture, distance, record)
        made = aug.transform(picture, distance, record)
        assert same(made, aug.transform(picture, distance, resolved))
        return [params["samples"][0]["path"] for params in (record, resolved)]

    uwaug.fused.use(True)
    try:
        assert path(image) == ["fused", "fused"]
        assert path(image.double()) == ["fused", "eager"]  # a draw sees no more than the shape
        assert path(image, light=LIGHTS[0]) == ["eager", "eager"]
        assert path(image, order="source") == ["eager", "eager"]
        left = RandomUnderwater(unknown="skip")
        record = left.resolve(image, 0 * distance, left.make_params(image))
        assert "path" not in record["samples"][0]
        # as records of lamps said before 0.2
        lamp = RandomUnderwater(light=LIGHTS[0])
        record = lamp.make_params(image)
        expected = lamp.transform(image, distance, record)
        record["samples"][0]["path"] = "fused"
        difference = lamp.transform(image, distance, record) - expected
        assert difference.abs().max() < 1e-5
    finally:
        uwaug.fused.use(None)
    uwaug.fused.use(False)
    try:
        assert path(image) == ["eager", "eager"]
    finally:
        uwaug.fused.use(None)


# Which pictures, which draws


def test_p_0_returns_the_input() -> None:
    for options in ({}, {"same_on_batch": True}, {"distance": (1.0, 2.0)}):
        aug = RandomUnderwater(p=0.0, **options)
        for batch in (None, 3):
            image = picture(batch, torch.uint8)
            assert aug(image, distances(batch))[0] is image
            assert aug({"image": image, "distance": distances(batch)})["image"] is image
    calls: list[Tensor] = []
    image = picture(3)
    assert RandomUnderwater(p=0.0, distance=calls.append)(image) is image
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


def test_one_record_and_one_map_serve_a_batch() -> None:
    aug = RandomUnderwater(**EVERYTHING)
    image, distance = picture(3), distances() + 1
    record = aug.make_params(image[0])
    whole = aug.transform(image, distance, record)
    assert same(whole, aug.transform(image, distance[None], record))
    assert same(whole, aug.transform(image, distance.expand(3, 1, H, W), record))
    for i in range(3):
        assert same(whole[i], aug.transform(image[i], distance, record))


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
