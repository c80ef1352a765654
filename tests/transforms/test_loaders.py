import io
import json
import multiprocessing
from typing import Any

import pytest
import torch
from augmenting import distances, picture
from loading import Crops, Keyed, Pairs, Recorded
from torch import Tensor
from torch.utils.data import DataLoader

from uwaug import RandomLight, RandomUnderwater, RandomWater, fast

pytestmark = [
    # Python ≥ 3.12 warns of every fork with threads
    pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning"),
    # on machines of one core
    pytest.mark.filterwarnings("ignore:This DataLoader will create"),
    pytest.mark.skipif(
        not {"fork", "spawn"} <= set(multiprocessing.get_all_start_methods()), reason="no fork"
    ),
]


@pytest.fixture(scope="module")
def crops() -> Crops:
    fast.warm_up()  # workers that are forked need not load the loops each
    return list(zip(picture(16), 1 + 4 * distances(16), strict=True))


def loader(
    dataset: Any, start: str = "fork", workers: int = 2, **options: Any
) -> "DataLoader[Any]":
    context = {"multiprocessing_context": start, "timeout": 60} if workers else {}
    return DataLoader(dataset, **{"batch_size": 4, "num_workers": workers, **context, **options})


@pytest.mark.parametrize("persistent", [False, True])
def test_workers_and_epochs_draw_anew_and_records_replay(persistent: bool, crops: Crops) -> None:
    torch.manual_seed(1)
    water = RandomWater(["II", "1C"], mixing=(0, 1), contrast=(0.2, 0.4), g=(0.1, 0.3))
    augment = RandomUnderwater(water)
    data = loader(Pairs(crops, augment), persistent_workers=persistent)
    seeds = []
    for _ in range(2):
        clean, degraded, records = zip(*data, strict=True)
        pairs = zip(crops, torch.cat(clean), torch.cat(degraded), sum(records, ()), strict=True)
        for (image, distance), given, made, text in pairs:
            assert torch.equal(given, image)
            # what a worker has drawn, with one thread, is replayed here bit for bit
            record = json.loads(text)
            assert torch.equal(augment.transform(image, distance, record), made)
            seeds.append(record["samples"][0]["water"]["field_seed"])
    # two workers, two epochs, no draw twice
    assert len(seeds) == len(set(seeds)) == 2 * len(crops)


def run(data: "DataLoader[Any]") -> dict[int, Tensor]:
    made = {}
    for indices, images in data:
        made |= dict(zip(indices.tolist(), images, strict=True))
    return made


def equal(one: dict[int, Tensor], other: dict[int, Tensor]) -> bool:
    return one.keys() == other.keys() and all(torch.equal(one[i], other[i]) for i in one)


def test_keys_do_not_depend_on_workers(crops: Crops) -> None:
    dataset = Keyed(crops, RandomUnderwater(RandomWater(["II", "3C"], mixing=(0, 1))))
    before = torch.get_num_threads()
    torch.set_num_threads(2)  # the main process has more than a worker
    expected = run(loader(dataset, workers=0))
    torch.set_num_threads(before)
    assert equal(run(loader(dataset, shuffle=True)), expected)
    # dataset and transform are sent as pickles
    assert equal(run(loader(dataset, "spawn", workers=1, batch_size=3)), expected)
    dataset.epoch = 1
    later = run(loader(dataset, workers=0))
    assert not any(torch.equal(later[i], expected[i]) for i in expected)


@pytest.mark.parametrize("workers", [0, 2])
def test_records_of_a_batch_become_one(workers: int, crops: Crops) -> None:
    # with lamps or without, degraded or not: keys of records differ
    augment = RandomUnderwater(p=0.7, light=RandomLight(share=0.5))
    for clean, wet, item in loader(Recorded(crops, augment), workers=workers, shuffle=True):
        record = json.loads(json.dumps(item["record"]))
        assert len(record["samples"]) == len(clean)
        zs = torch.stack([crops[index][1] for index in item["index"]])
        assert (augment.transform(clean, zs, record) - wet).abs().max() <= 1e-6
        file = io.BytesIO()
        torch.save(item["record"], file)
        file.seek(0)
        assert torch.load(file) == record
