import json
import pickle
from pathlib import Path
from typing import Any

import albumentations as A
import numpy as np
import pytest
import torch
import yaml
from augmenting import LASERS, TANK, array, brightness, metres
from torch.utils.data import DataLoader, Dataset, get_worker_info

from uwaug import Light, RandomUnderwater
from uwaug.adapters.albumentations import AlbumentationsUnderwater
from uwaug.distance.network import DepthNetwork

AUGMENT = RandomUnderwater(["II", "7C"], contrast=(0.2, 0.4))
TARGETS = {"distance": "mask"}


def pipeline(*transforms: Any, seed: int | None = 0, **options: Any) -> A.Compose:
    return A.Compose([*transforms], additional_targets=TARGETS, seed=seed, **options)


def water(augment: Any = AUGMENT, p: float = 1.0, **options: Any) -> AlbumentationsUnderwater:
    return AlbumentationsUnderwater(augment, p=p, **options)


def ours(image: Any, distance: Any, applied: dict[str, Any]) -> Any:
    """The picture that `RandomUnderwater` makes of a record."""
    taken = torch.from_numpy(image.copy()).permute(2, 0, 1)
    z = torch.from_numpy(distance.copy())[None]
    return AUGMENT.transform(taken, z, applied["record"]).permute(1, 2, 0).numpy()


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_a_picture_is_that_of_its_record(dtype: str) -> None:
    image, distance = array(dtype), metres()
    result = pipeline(water(), save_applied_params=True)(image=image, distance=distance)
    ((_, applied),) = result["applied_transforms"]
    assert result["image"].dtype == dtype
    assert np.array_equal(result["image"], ours(image, distance, applied))
    assert not np.array_equal(result["image"], image)
    assert np.array_equal(image, array(dtype))


def test_the_map_moves_with_the_picture() -> None:
    image, distance = array(), metres()
    moves = [A.HorizontalFlip(p=1), A.Crop(2, 3, 30, 20, p=1)]
    result = pipeline(*moves, water(), save_applied_params=True)(image=image, distance=distance)
    moved = (array()[:, ::-1][3:20, 2:30], metres()[:, ::-1][3:20, 2:30])
    assert np.array_equal(result["distance"], moved[1])
    assert np.array_equal(result["image"], ours(*moved, result["applied_transforms"][-1][1]))


@pytest.mark.parametrize(
    "transforms", [[A.HorizontalFlip(p=1), water()], [A.OneOf([water()], p=1)]]
)
def test_a_map_that_would_stay_behind_is_refused(transforms: list[Any], tmp_path: Path) -> None:
    message = r"distance is no target of the pipeline, .*additional_targets={'distance': 'mask'}"
    for made in (A.Compose(transforms), pickle.loads(pickle.dumps(A.Compose(transforms)))):
        with pytest.raises(ValueError, match=message):
            made(image=array(), distance=metres())
    # targets of another map do not move this one
    with pytest.raises(ValueError, match=message):
        A.Compose(transforms, additional_targets={"depth": "mask"})(
            image=array(), distance=metres()
        )


def test_a_map_that_would_be_changed_as_a_picture_is_refused() -> None:
    made = A.Compose([water()], additional_targets={"distance": "image"})
    with pytest.raises(ValueError, match=r"distance is a picture to the pipeline.*'mask'"):
        made(image=array(), distance=metres())


def test_a_map_that_moves_by_another_name() -> None:
    named = A.Compose([A.HorizontalFlip(p=1), water(distance_key="mask")], seed=0)
    moved = pipeline(A.HorizontalFlip(p=1), water())(image=array(), distance=metres())
    assert np.array_equal(named(image=array(), mask=metres())["image"], moved["image"])
    # without a pipeline nothing moves
    assert water()(image=array(), distance=metres())["image"].shape == array().shape


def test_labels_are_left_alone() -> None:
    mask = (array()[..., 0] > 99).astype(np.uint8)
    boxes, points = np.array([[1.0, 2, 20, 15]]), np.array([[3.0, 4]])
    labelled = pipeline(
        A.NoOp(),  # else Albumentations warns that nothing moves the labels
        water(),
        bbox_params=A.BboxParams("pascal_voc", label_fields=["labels"]),
        keypoint_params=A.KeypointParams("xy"),
    )
    result = labelled(
        image=array(),
        mask=mask,
        masks=[mask],
        distance=metres(),
        bboxes=boxes,
        labels=["fish"],
        keypoints=points,
    )
    assert np.array_equal(result["mask"], mask)
    assert np.array_equal(result["masks"][0], mask)
    assert np.array_equal(result["distance"], metres())
    assert np.allclose(result["bboxes"], boxes)
    assert np.allclose(result["keypoints"], points)
    assert result["labels"] == ["fish"]


def test_pictures_of_one_call_share_the_water() -> None:
    both = A.Compose([water()], additional_targets={**TARGETS, "right": "image"})
    result = both(image=array(), right=array(), distance=metres())
    assert np.array_equal(result["image"], result["right"])
    clip = pipeline(water())(images=np.stack([array(), array()]), distance=metres())["images"]
    assert np.array_equal(clip[0], clip[1])
    assert not np.array_equal(clip[0], array())


def test_the_pipeline_seeds_the_draws() -> None:
    def drawn(seed: int) -> list[Any]:
        made = pipeline(water(p=0.5), seed=seed)
        return [made(image=array(), distance=metres())["image"] for _ in range(8)]

    first, again, other = drawn(1), drawn(1), drawn(2)
    torch.manual_seed(5)  # ours has no say
    assert all(map(np.array_equal, first, again))
    assert not all(map(np.array_equal, first, other))
    untouched = sum(np.array_equal(image, array()) for image in first)
    assert 0 < untouched < 8
    assert len({image.tobytes() for image in first}) == 9 - untouched


def test_replay_is_bit_exact_and_takes_the_new_map() -> None:
    replayed = A.ReplayCompose([A.HorizontalFlip(p=0.5), water()], additional_targets=TARGETS)
    result = replayed(image=array(), distance=metres())
    replay = json.loads(json.dumps(result["replay"]))
    again = A.ReplayCompose.replay(replay, image=array(), distance=metres())
    assert np.array_equal(again["image"], result["image"])
    farther = A.ReplayCompose.replay(replay, image=array(), distance=metres() + 3)
    assert not np.array_equal(farther["image"], result["image"])


SPECTRUM = ([400.0, 700.0], [1.0, 0.4])
DEVELOPMENT = {
    "compensation": (-1.0, 1.0),
    "white_balance": 0.5,
    "saturation": (0.8, 1.2),
    "black_point": 0.3,
    "gamut": 1.0,
    "tone": 1.1,
}
LAMP = Light.lamp((0.4, 0.0, 0.0), (-0.1, 0.0, 1.0), 3.0, spectrum=SPECTRUM)


def test_a_developed_picture_is_that_of_its_record() -> None:
    """The camera's options reach the picture, and its record."""
    augment = RandomUnderwater("II", surfaces="spectral", **DEVELOPMENT)
    made = pipeline(water(augment), save_applied_params=True)
    result = made(image=array(), distance=metres())
    ((_, applied),) = result["applied_transforms"]
    (sample,) = applied["record"]["samples"]
    assert {sample["white_balance"], sample["gamut"]} == {0.5, 1.0}
    taken, z = torch.from_numpy(array()).permute(2, 0, 1), torch.from_numpy(metres())[None]
    expected = augment.transform(taken, z, applied["record"]).permute(1, 2, 0).numpy()
    assert np.array_equal(result["image"], expected)
    plain = RandomUnderwater("II", surfaces="spectral", **dict.fromkeys(DEVELOPMENT))
    undeveloped = pipeline(water(plain))(image=array(), distance=metres())["image"]
    assert not np.array_equal(result["image"], undeveloped)


@pytest.mark.parametrize(
    "augment",
    [
        RandomUnderwater(),
        RandomUnderwater.survey(cameras=["Nikon 5100 (NPL)", LASERS], mixing=(0, 1)),
        RandomUnderwater([TANK, "7C"], visibility=(2.0, 9.0), distance=(1.0, 4.0), unknown=2.0),
        RandomUnderwater.from_preset("calibrated"),
        RandomUnderwater("II", light=(LAMP, Light.ambient(0.2) + Light.parallel(40, -20))),
        RandomUnderwater("II", surfaces="spectral", color_matrix=(0.2, 0.9), **DEVELOPMENT),
    ],
    ids=["default", "survey", "own", "preset", "lights", "developed"],
)
def test_written_and_read(augment: RandomUnderwater) -> None:
    made = pipeline(water(augment, unit="cm", channels="bgr"))
    for read in (
        A.from_dict(json.loads(json.dumps(A.to_dict(made)))),
        A.from_dict(yaml.safe_load(yaml.safe_dump(A.to_dict(made)))),
        pickle.loads(pickle.dumps(made)),
    ):
        assert repr(read.transforms) == repr(made.transforms)
        read.set_random_seed(3)
        made.set_random_seed(3)
        data = {"image": array(), "distance": 100 * metres()}
        assert np.array_equal(read(**data)["image"], made(**data)["image"])


def test_a_network_is_written_by_its_path(tmp_path: Path) -> None:
    (tmp_path / "network.onnx").touch()
    network = DepthNetwork(tmp_path / "network.onnx", short_side=98)
    augment = RandomUnderwater(distance=network, distance_kind="inverse")
    read = A.from_dict(json.loads(json.dumps(A.to_dict(water(augment)))))
    assert read.augment.distance.path == tmp_path / "network.onnx"
    assert read.augment.distance.short_side == 98


def test_no_other_function_is_written() -> None:
    for made in (water(RandomUnderwater(distance=brightness)), water(lookup=brightness)):
        assert "brightness" in repr(made)
        with pytest.raises(NotImplementedError, match="keep the pipeline in code"):
            A.to_dict(made)


def test_maps_from_files_and_functions(tmp_path: Path) -> None:
    path = tmp_path / "reef.npy"
    np.save(path, 100 * metres())
    found = water(unit="cm", lookup=lambda passed: tmp_path / f"{passed['name']}.npy")
    results = [
        pipeline(water())(image=array(), distance=metres()),
        A.Compose([water(unit="cm")], seed=0)(image=array(), distance=path),
        A.Compose([found], seed=0)(image=array(), name="reef"),
    ]
    for result in results[1:]:
        # 100 times a number is rounded
        assert np.abs(result["image"].astype(int) - results[0]["image"]).max() <= 1


def test_ultralytics_passes_a_picture_alone_in_the_order_of_opencv() -> None:
    augment = RandomUnderwater("7C", distance=(2.0, 6.0))
    image = array()
    rgb = A.Compose([water(augment)], seed=0)(image=image)["image"]
    bgr = A.Compose([water(augment, channels="bgr")], seed=0)(image=image[..., ::-1])["image"]
    assert np.array_equal(bgr[..., ::-1], rgb)


class Reefs(Dataset[bytes]):
    """Four times the same picture, in a water of its own each time that it is read."""

    def __init__(self) -> None:
        self.pipeline = pipeline(water(), seed=None)

    def __len__(self) -> int:
        return 4

    def __getitem__(self, index: int) -> bytes:
        made: bytes = self.pipeline(image=array(), distance=metres())["image"].tobytes()
        return made


def seed_worker(number: int) -> None:
    """As the README has it."""
    dataset = get_worker_info().dataset
    dataset.pipeline.set_random_seed(torch.initial_seed())


# Python ≥ 3.12 warns of every fork with threads
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:This DataLoader will create")
def test_each_worker_and_epoch_has_waters_of_its_own() -> None:
    def passes(seed: int) -> list[bytes]:
        torch.manual_seed(seed)
        options = {"batch_size": None, "multiprocessing_context": "fork"}
        loader = DataLoader(Reefs(), num_workers=2, worker_init_fn=seed_worker, **options)
        return [*loader, *loader]

    first = passes(0)
    assert len(set(first)) == 8
    assert first == passes(0) != passes(1)


@pytest.mark.parametrize(
    "options, data, message",
    [
        ({"augment": RandomUnderwater(p=0.5)}, {}, "augment.p must be 1, got 0.5"),
        ({"augment": "7C"}, {}, "augment must be a uwaug.RandomUnderwater, got str"),
        ({"channels": "rgba"}, {}, "channels must be one of rgb, bgr"),
        ({"unit": "inch"}, {}, "unit must be one of m, cm, mm, um"),
        ({"p": 2}, {}, "p must be in"),
        ({}, {}, "there is no 'distance', only 'image': pass it"),
        ({"unit": -0.5}, {}, "unit must be"),
        ({}, {"distance": metres()[:9]}, "distance"),
        ({}, {"distance": 1000 * metres()}, "farther than one sees: try unit='mm'"),
        ({}, {"image": array()[..., :1], "distance": metres()}, r"array \(H, W, 3\)"),
    ],
)
def test_refusals(options: dict[str, Any], data: dict[str, Any], message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=message):
        water(**options)(**{"image": array(), **data})
