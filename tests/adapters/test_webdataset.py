import gc
import io
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import webdataset as wds
from augmenting import array, metres, picture
from PIL import Image

from uwaug import RandomUnderwater
from uwaug.adapters.webdataset import WebDatasetUnderwater

pytestmark = [
    # Python ≥ 3.12 warns of every fork with threads
    pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:This DataLoader will create"),
    # WebDataset closes no shard
    pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning"),
]
AUGMENT = RandomUnderwater(["II", "7C"], contrast=(0.2, 0.4))
NAMES = [f"reef/{i:04}" for i in range(6)]


@pytest.fixture(autouse=True)
def shards_are_closed() -> Iterator[None]:
    """While the warning is ignored, and not in another test."""
    yield
    gc.collect()


def png(values: Any) -> bytes:
    file = io.BytesIO()
    Image.fromarray(values).save(file, "PNG")
    return file.getvalue()


@pytest.fixture(scope="module")
def shards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same six samples in shards of three and of two."""
    folder = tmp_path_factory.mktemp("shards")
    for size in (3, 2):
        for first in range(0, len(NAMES), size):
            with wds.TarWriter(str(folder / f"{size}-{first}.tar")) as tar:
                for name in NAMES[first : first + size]:
                    tar.write(
                        {
                            "__key__": name,
                            "png": png(array()),
                            "depth.npy": metres(),
                            "mm.png": png(np.rint(1000 * metres()).astype(np.uint16)),
                            "cls": 7,
                        }
                    )
    return folder


def stream(folder: Path, water: Any, size: int = 3, decode: Any = "pil", **options: Any) -> Any:
    urls = sorted(str(path) for path in folder.glob(f"{size}-*.tar"))
    data = wds.WebDataset(urls, shardshuffle=False, empty_check=False)
    return data.decode(decode, **options).map(water)


def made(samples: Any) -> dict[str, bytes]:
    """Pictures as bytes, by their names."""
    return {sample["__key__"]: np.asarray(sample["png"]).tobytes() for sample in samples}


def expected(name: str, epoch: int = 0) -> Any:
    """What `RandomUnderwater` makes of a picture."""
    z = torch.tensor(metres())[None]
    return AUGMENT.at(3, epoch, name)(picture(dtype=torch.uint8), z)[0]


@pytest.mark.parametrize("decode", ["pil", "rgb8", "torchrgb8", "rgb", "torch"])
def test_pictures_as_they_are_decoded(shards: Path, decode: str) -> None:
    plain = next(iter(stream(shards, dict, decode=decode)))
    sample = next(iter(stream(shards, WebDatasetUnderwater(AUGMENT, seed=3), decode=decode)))
    assert type(sample["png"]) is (Image.Image if decode == "pil" else type(plain["png"]))
    image = sample["png"] if decode.startswith("torch") else np.asarray(sample["png"])
    assert image.dtype == getattr(plain["png"], "dtype", np.uint8)
    found = image if decode.startswith("torch") else torch.tensor(image).permute(2, 0, 1)
    if found.dtype == torch.uint8:
        assert torch.equal(found, expected(NAMES[0]))
    else:
        assert (255 * found - expected(NAMES[0])).abs().max() < 2
    assert sample["cls"] == 7
    assert np.array_equal(sample["depth.npy"], metres())


def test_a_png_of_millimetres(shards: Path) -> None:
    water = WebDatasetUnderwater(AUGMENT, seed=3, distance_key="mm.png", unit="mm")
    sample = next(iter(stream(shards, water, only=["png"])))
    difference = np.asarray(sample["png"]).astype(int).transpose(2, 0, 1)
    assert np.abs(difference - expected(NAMES[0]).numpy()).max() <= 1
    with pytest.raises(ValueError, match="sample 'reef/0000': distance must have more than 8 bits"):
        next(iter(stream(shards, water)))


@pytest.mark.parametrize("workers", [0, 2])
def test_shards_shuffles_and_workers_change_nothing(shards: Path, workers: int) -> None:
    water = WebDatasetUnderwater(AUGMENT, seed=3)
    whole = made(stream(shards, pickle.loads(pickle.dumps(water))))
    assert whole[NAMES[4]] == np.asarray(expected(NAMES[4]).permute(1, 2, 0)).tobytes()
    assert len(set(whole.values())) == len(NAMES)
    shuffled = stream(shards, water, size=2).shuffle(6)
    options = {"multiprocessing_context": "fork", "persistent_workers": True} if workers else {}
    loader = wds.WebLoader(shuffled, batch_size=None, num_workers=workers, **options)
    for epoch in (0, 2, 0):
        water.set_epoch(epoch)
        found = made(loader)
        assert found[NAMES[1]] == expected(NAMES[1], epoch).permute(1, 2, 0).numpy().tobytes()
        assert (found == whole) == (epoch == 0)


def test_no_map(shards: Path) -> None:
    water = WebDatasetUnderwater(RandomUnderwater("7C", distance=3.0), seed=3, distance_key="z")
    assert len(set(made(stream(shards, water)).values())) == len(NAMES)


@pytest.mark.parametrize(
    "options, changes, message",
    [
        ({"image_key": "jpg"}, {}, "sample 'a' has no 'jpg', only '__key__', 'png', 'npy'"),
        ({"distance_key": "z;depth"}, {}, "sample 'a' has no 'z;depth', only"),
        ({}, {"png": png(array())}, "got bytes, so decode it first"),
        ({}, {"png": Image.new("L", (3, 3))}, "sample 'a': image: expected a picture in colour"),
        ({}, {"npy": b"numbers"}, "7 bytes that Pillow cannot read"),
        ({"seed": 0}, {"__key__": None}, "seed needs the name of each picture"),
    ],
)
def test_refusals(options: dict[str, Any], changes: dict[str, Any], message: str) -> None:
    sample = {"__key__": "a", "png": array(), "npy": metres(), **changes}
    with pytest.raises((ValueError, TypeError), match=message):
        WebDatasetUnderwater(AUGMENT, **options)(sample)
