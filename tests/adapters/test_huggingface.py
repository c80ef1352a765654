import copy
import io
import pickle
from typing import Any

import datasets
import numpy as np
import pytest
import torch
from augmenting import H, W, array, metres, picture
from PIL import Image
from torch.utils.data import DataLoader

from uwaug import RandomUnderwater
from uwaug.adapters.huggingface import HuggingFaceUnderwater

pytestmark = [
    # Python ≥ 3.12 warns of every fork with threads
    pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:This DataLoader will create"),
]
AUGMENT = RandomUnderwater(["II", "7C"], contrast=(0.2, 0.4))
KEYED: dict[str, Any] = {"seed": 3, "id_key": "path"}
COUNT = 4


def dataset(depth: Any = None, feature: Any = None) -> datasets.Dataset:
    """Four times one picture, with names."""
    depth = Image.fromarray(metres()) if depth is None else depth
    columns = {
        "image": [Image.fromarray(array())] * COUNT,
        "depth_map": [depth] * COUNT,
        "path": [f"reef/{i}.png" for i in range(COUNT)],
    }
    features = datasets.Features(
        image=datasets.Image(),
        depth_map=feature or datasets.Image(),
        path=datasets.Value("string"),
    )
    return datasets.Dataset.from_dict(columns, features)


def expected() -> Any:
    """What `RandomUnderwater` makes of the first picture."""
    made = AUGMENT.at(3, 0, "reef/0.png")(picture(dtype=torch.uint8), torch.tensor(metres())[None])
    return made[0].permute(1, 2, 0).numpy()


@pytest.mark.parametrize(
    "unit, depth, feature",
    [
        ("m", Image.fromarray(metres()), None),
        (1 / 1000, Image.fromarray(np.rint(1000 * metres()).astype(np.uint16)), None),
        ("mm", (1000 * metres()).tolist(), datasets.Array2D((H, W), "float32")),
    ],
    ids=["F", "I;16", "array"],
)
def test_pictures_of_all_kinds_of_maps(unit: Any, depth: Any, feature: Any) -> None:
    water = HuggingFaceUnderwater(AUGMENT, unit=unit, **KEYED)
    plain = dataset(depth, feature)
    degraded = plain.with_transform(water)
    batch = degraded[:2]
    assert [type(image) for image in batch["image"]] == [Image.Image] * 2
    # millimetres are rounded
    assert np.abs(np.asarray(batch["image"][0]).astype(int) - expected()).max() <= 1
    assert np.asarray(degraded[0]["image"]).tobytes() == batch["image"][0].tobytes()
    assert batch["path"] == plain[:2]["path"]
    assert np.array_equal(batch["depth_map"][0], plain[0]["depth_map"])
    assert batch["image"][0].tobytes() != batch["image"][1].tobytes()


def test_alpha_palettes_and_notes_of_a_picture() -> None:
    water = HuggingFaceUnderwater(AUGMENT, **KEYED)
    plain = Image.fromarray(array())
    plain.info["icc_profile"] = b"profile"
    clear = plain.copy()
    clear.putalpha(77)
    palette = plain.quantize(16)
    maps, names = [metres()] * 3, ["reef/0.png"] * 3
    one, other, third = water({"image": [plain, clear, palette], "depth_map": maps, "path": names})[
        "image"
    ]
    assert np.array_equal(one, expected())
    assert one.info["icc_profile"] == b"profile"
    assert other.mode == "RGBA"
    assert np.array_equal(np.asarray(other)[..., :3], expected())
    assert other.getchannel("A").getextrema() == (77, 77)
    assert third.mode == "RGB"
    palette.info["transparency"] = 255  # a colour that no pixel has
    palette = water({"image": [palette], "depth_map": maps[:1], "path": names[:1]})["image"][0]
    palette.save(io.BytesIO(), "PNG")


def test_arrays_and_tensors_come_back_as_such() -> None:
    water = HuggingFaceUnderwater(AUGMENT, **KEYED)
    images = [array(), picture(dtype=torch.uint8), array("float32")]
    batch = {"image": images, "depth_map": [metres()] * 3, "path": ["reef/0.png"] * 3}
    first, second, third = water(batch)["image"]
    assert np.array_equal(first, expected())
    assert torch.equal(second, torch.from_numpy(expected()).permute(2, 0, 1))
    assert third.dtype == np.float32
    assert np.abs(255 * third - expected()).max() < 2
    swapped = {"image": [array(">f4")], "depth_map": [metres()], "path": ["reef/0.png"]}
    assert np.array_equal(water(swapped)["image"][0], third)


def of_one(batch: Any) -> Any:
    """Pictures of a batch as bytes, by their names."""
    return {item["path"]: item["image"].tobytes() for item in batch}


@pytest.mark.parametrize("workers", [0, 2])
def test_names_and_epochs_seed_the_draws(workers: int) -> None:
    water = HuggingFaceUnderwater(AUGMENT, **KEYED)
    # a copy of the data set, which copies its transform
    shuffled = copy.deepcopy(dataset().with_transform(water)).shuffle(seed=1)
    options = {"multiprocessing_context": "fork", "persistent_workers": True} if workers else {}
    loader = DataLoader(shuffled, num_workers=workers, collate_fn=of_one, **options)
    passes: list[dict[str, bytes]] = []
    for epoch in (0, 0, 1):
        water.set_epoch(epoch)
        passes.append({name: made for batch in loader for name, made in batch.items()})
    assert passes[0] == passes[1] == of_one(dataset().with_transform(pickled(AUGMENT)))
    assert not set(passes[0].values()) & set(passes[2].values())
    assert len(set(passes[0].values())) == COUNT


def pickled(augment: RandomUnderwater) -> Any:
    return pickle.loads(pickle.dumps(HuggingFaceUnderwater(augment, **KEYED)))


def test_without_a_seed_torch_draws() -> None:
    degraded = dataset().with_transform(HuggingFaceUnderwater(AUGMENT))
    runs = []
    for seed in (0, 0, 1):
        torch.manual_seed(seed)
        runs.append([image.tobytes() for image in degraded[:]["image"]])
    assert runs[0] == runs[1] != runs[2]
    assert len(set(runs[0])) == COUNT


def test_numbers_that_are_no_metres_may_be_large() -> None:
    augment = RandomUnderwater("7C", distance_kind="inverse", near=1.0, far=5.0)
    inverse = 1e5 / metres()
    assert HuggingFaceUnderwater(augment)({"image": [array()], "depth_map": [inverse]})["image"]


def test_pairs_for_restoration() -> None:
    pairs = dataset().with_transform(HuggingFaceUnderwater(AUGMENT, output_key="water", **KEYED))
    pair = pairs[0]
    assert np.array_equal(pair["image"], array())
    assert np.array_equal(pair["water"], expected())


def test_no_map_and_a_stream() -> None:
    water = HuggingFaceUnderwater(RandomUnderwater("7C", distance=3.0), **KEYED)
    alone = dataset().remove_columns("depth_map")
    made = alone.with_transform(water)[0]["image"]
    streamed = next(iter(alone.to_iterable_dataset().map(water, batched=True)))["image"]
    assert np.array_equal(streamed, made)
    assert not np.array_equal(made, array())


@pytest.mark.parametrize(
    "options, changes, message",
    [
        ({"seed": 1}, {}, "seed and id_key go together, got seed=1 and id_key=None"),
        ({"unit": "inch"}, {}, "unit must be one of m, cm, mm, um, a number of metres, got 'inch'"),
        ({"image_key": "picture"}, {}, "the batch has no 'picture', only 'image', 'depth_map'"),
        ({"distance_key": "depth"}, {}, "the batch has no 'depth', only"),
        ({}, {"image": Image.new("L", (W, H))}, "expected a picture in colour, got grey"),
        ({}, {"image": Image.new("CMYK", (W, H))}, "got CMYK: save it as RGB"),
        ({}, {"image": None}, "image must be an array, a tensor or a Pillow picture, got NoneType"),
        ({}, {"image": array()[..., 0]}, r"image must be an array \(H, W, 3\), got \(24, 33\)"),
        ({}, {"depth_map": Image.new("L", (W, H))}, "more than 8 bits, got uint8"),
        ({}, {"depth_map": Image.new("RGB", (W, H))}, "distance must"),
        ({}, {"depth_map": metres()[1:]}, "distance"),
        ({}, {"depth_map": 1000 * metres()}, r"distance: its median is .* in m, .*try unit='mm'"),
        ({"unit": "mm"}, {"depth_map": 1e6 * metres()}, "if it is in mm, .*: try unit='um'"),
        ({}, {"depth_map": "a.png"}, "distance must be a map of numbers, got str"),
        (
            {},
            {"depth_map": 0 * metres()},
            "picture 1 of 2, counted from 0: distance must be above 0 m",
        ),
    ],
)
def test_refusals(options: dict[str, Any], changes: dict[str, Any], message: str) -> None:
    good = {"image": Image.fromarray(array()), "depth_map": metres()}
    bad = {**good, **changes}
    with pytest.raises((ValueError, TypeError), match=message):
        HuggingFaceUnderwater(AUGMENT, **options)({key: [good[key], bad[key]] for key in good})


def test_eight_bits_with_a_step() -> None:
    steps = np.rint(25 * metres()).astype(np.uint8)
    water = HuggingFaceUnderwater(AUGMENT, unit=1 / 25, **KEYED)
    batch = {"image": [array()], "depth_map": [steps], "path": ["reef/0.png"]}
    assert np.abs(water(batch)["image"][0].astype(int) - expected()).max() <= 5
