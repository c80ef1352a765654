import json
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from uwaug import KeepVisible, RandomDevelopment, RandomUnderwater, RandomWater
from uwaug.distance import MadeUp, Plane

A = pytest.importorskip("albumentations")

from uwaug.adapters.albumentations import AlbumentationsUnderwater  # noqa: E402

NOISELESS = RandomDevelopment(noise=None)  # alike in all frames of a film
AUGMENT = RandomUnderwater(RandomWater(["II", "7C"], contrast=(0.2, 0.4)), development=NOISELESS)
TARGETS = {"distance": "mask"}
H, W = 24, 33
MASK = np.zeros((H, W), np.uint8)  # AlbumentationsX moves a map only beside a mask


def array(dtype: str = "uint8") -> Any:
    values = np.random.default_rng(0).integers(0, 256, (H, W, 3), dtype=np.uint8)
    return values if dtype == "uint8" else values.astype(np.float32) / 255


def metres() -> Any:
    return np.linspace(1, 4, H * W, dtype=np.float32).reshape(H, W)


def pipeline(*transforms: Any, seed: int | None = 0, **options: Any) -> Any:
    return A.Compose([*transforms], additional_targets=TARGETS, seed=seed, **options)


def water(augment: Any = AUGMENT, p: float = 1.0, **options: Any) -> AlbumentationsUnderwater:
    return AlbumentationsUnderwater(augment, p=p, **options)


def ours(image: Any, distance: Any, record: Any) -> Any:
    """The picture that `RandomUnderwater` makes of a record."""
    taken = torch.from_numpy(image.copy()).permute(2, 0, 1)
    z = torch.from_numpy(distance.copy())[None]
    return AUGMENT.transform(taken, z, record).permute(1, 2, 0).numpy()


def record_of(made: Any) -> Any:
    """The draw of a pipeline's last call; AlbumentationsX has it beside other things."""
    applied = made.transforms[-1].get_applied_params()
    return applied.get("params", applied)["record"]


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_picture_and_map_move_together(dtype: str) -> None:
    moves = [A.HorizontalFlip(p=1), A.Crop(2, 3, 30, 20, p=1)]
    made = pipeline(*moves, water(), save_applied_params=True)
    result = made(image=array(dtype), mask=MASK, distance=metres())
    moved = (array(dtype)[:, ::-1][3:20, 2:30], metres()[:, ::-1][3:20, 2:30])
    assert result["image"].dtype == dtype
    assert np.array_equal(result["distance"], moved[1])
    record = record_of(made)
    assert np.array_equal(result["image"], ours(*moved, record))
    assert not np.array_equal(result["image"], moved[0])


@pytest.mark.parametrize("shape", [(H, W), (H, W, 1), (H, W, 3)])
@pytest.mark.parametrize("white", [255, 65535])
def test_grey_and_16_bits_are_taken_as_in_files(shape: tuple[int, ...], white: int) -> None:
    kind = np.uint8 if white == 255 else np.uint16
    values = np.random.default_rng(0).integers(0, white + 1, shape, dtype=kind)
    colour = np.broadcast_to(values.reshape(H, W, -1), (H, W, 3))
    record = AUGMENT.make_params(torch.empty(3, H, W))
    expected = ours(colour if white == 255 else colour / np.float32(65535), metres(), record)
    if white == 65535:
        expected = np.rint(expected.clip(0, 1) * 65535)
    targets = {"image": values, "distance": metres()}
    made = water().apply_with_params({"record": record}, **targets)["image"]
    assert made.dtype == kind
    assert np.array_equal(made, expected)
    film = {"images": np.stack([values] * 2), "distances": np.stack([metres()] * 2)}
    for frame in water().apply_with_params({"record": record}, **film)["images"]:
        assert np.abs(frame.astype(int) - made).max() <= white // 255


@pytest.mark.parametrize("shape", [(H, W), (H, W, 1)])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_a_grey_camera_sees_the_luminance_of_the_light(shape: Any, dtype: str) -> None:
    values = np.random.default_rng(0).random(shape)
    white = 1 if dtype == "float32" else np.iinfo(dtype).max
    values = (values * white).astype(dtype)
    augment = replace(AUGMENT, distance=Plane((2.0, 4.0)))
    record = augment.make_params(torch.empty(3, H, W))
    maker = water(augment, channels="grey")
    mask = np.random.default_rng(1).random((H, W, 1)).astype(np.float32)
    targets = {"image": values, "mask": mask}
    result = maker.apply_with_params({"record": record}, **targets)
    assert result["mask"] is mask
    assert (result["image"].shape, result["image"].dtype) == (shape, dtype)
    wet = water(augment).apply_with_params({"record": record}, image=values)["image"] / white
    light = np.where(wet <= 0.04045, wet / 12.92, ((wet + 0.055) / 1.055) ** 2.4)
    grey = light @ [0.2126, 0.7152, 0.0722]
    expected = np.where(grey <= 0.0031308, 12.92 * grey, 1.055 * grey ** (1 / 2.4) - 0.055)
    off = np.abs(result["image"].reshape(H, W) / white - expected).max()
    assert off < {"uint8": 0.51 / 255, "uint16": 2 / 65535, "float32": 1e-5}[dtype]
    film = np.stack([values] * 2)
    assert maker.apply_with_params({"record": record}, images=film)["images"].shape == film.shape
    with pytest.raises(ValueError, match=r"image must be grey, .* got \(24, 33, 3\)"):
        maker(image=array())


@pytest.mark.parametrize("kind", ["mask", "masks"])
def test_a_mask_is_no_map_where_none_are_read(kind: str) -> None:
    mask = metres() if kind == "mask" else np.stack([metres()] * 2)
    made = A.Compose([A.HorizontalFlip(p=1), water(replace(AUGMENT, distance=MadeUp()))], seed=0)
    result = made(image=array(), **{kind: mask})
    assert np.array_equal(np.asarray(result[kind]), mask[..., ::-1])
    assert not np.array_equal(result["image"], array()[:, ::-1])


def test_boxes_that_water_hides_go() -> None:
    augment = RandomUnderwater(RandomWater("II", contrast=None))
    far = np.full((H, W), 40, np.float32)
    far[:, :16] = 0.5
    boxes = [[0.0, 0, 16, H], [18, 2, 30, 20], [18, 2, 18.2, 2.2], [12, 1, 15, 9]]
    params = A.BboxParams("pascal_voc", label_fields=["names"])
    names = ["near", "far", "sliver", "small"]
    data = {"image": array(), "mask": MASK, "distance": far, "bboxes": boxes, "names": names}
    for limit, kept in ((None, names), (0.05, ["near", "small"]), (1.0, [])):
        made = pipeline(
            A.HorizontalFlip(p=1), water(augment, min_contrast=limit), bbox_params=params
        )
        result = made(**data)
        assert list(result["names"]) == kept
        if kept:
            small = result["bboxes"][kept.index("small")]
            assert list(small) == pytest.approx([W - 15, 1, W - 12, 9], abs=1e-3)
    # as torchvision's transform judges them
    keep = KeepVisible(augment, min_contrast=0.05)
    picture = torch.from_numpy(array()).movedim(-1, 0)
    *_, target = keep(picture, torch.from_numpy(far)[None], {"boxes": torch.tensor(boxes)})
    assert len(target["boxes"]) == 2


def test_boxes_go_where_nothing_else_moves_them_and_the_dry_keep_theirs() -> None:
    augment = RandomUnderwater(RandomWater("7C", contrast=None), distance=30.0)
    params = A.BboxParams("yolo", label_fields=["names"])
    data = {"image": array(), "bboxes": [[0.5, 0.5, 0.4, 0.4]], "names": [3]}
    made = A.Compose([A.NoOp(), water(augment, 0.5, min_contrast=0.05)], bbox_params=params, seed=0)
    for _ in range(20):
        result = made(**data)
        is_dry = np.array_equal(result["image"], array())
        assert len(result["bboxes"]) == len(result["names"]) == is_dry
    read = A.from_dict(json.loads(json.dumps(A.to_dict(made))))
    assert read.transforms[-1].min_contrast == 0.05
    assert made(image=array(), bboxes=np.empty((0, 4)), names=[])["names"] == []


def test_the_pipeline_seeds_the_draws() -> None:
    def drawn(seed: int) -> list[bytes]:
        made, data = pipeline(water(p=0.5), seed=seed), {"mask": MASK, "distance": metres()}
        return [made(image=array(), **data)["image"].tobytes() for _ in range(8)]

    first, again, other = drawn(1), drawn(1), drawn(2)
    assert first == again != other
    untouched = first.count(array().tobytes())
    assert 0 < untouched < 8
    assert len(set(first)) == 9 - untouched


def test_replay_takes_the_new_map() -> None:
    replayed = A.ReplayCompose([A.HorizontalFlip(p=0.5), water()], additional_targets=TARGETS)
    result = replayed(image=array(), mask=MASK, distance=metres())
    replay = json.loads(json.dumps(result["replay"]))
    again = A.ReplayCompose.replay(replay, image=array(), mask=MASK, distance=metres())
    assert np.array_equal(again["image"], result["image"])
    farther = A.ReplayCompose.replay(replay, image=array(), mask=MASK, distance=metres() + 3)
    assert not np.array_equal(farther["image"], result["image"])


def test_written_and_read() -> None:
    made = A.Compose([water(scale=0.01, channels="bgr", distance_key="mask")])
    data = {"image": array(), "mask": 100 * metres()}
    written = A.from_dict(json.loads(json.dumps(A.to_dict(made))))
    for read in (written, pickle.loads(pickle.dumps(made))):
        read.set_random_seed(3)
        made.set_random_seed(3)
        assert np.array_equal(read(**data)["image"], made(**data)["image"])


def test_pictures_without_maps_in_the_order_of_opencv() -> None:
    augment = RandomUnderwater("7C", distance=Plane((2.0, 6.0)))
    rgb = A.Compose([water(augment)], seed=0)(image=array())["image"]
    bgr = A.Compose([water(augment, channels="bgr")], seed=0)(image=array()[..., ::-1])["image"]
    assert np.array_equal(bgr[..., ::-1], rgb)


def test_each_picture_of_a_pair_has_its_own_map() -> None:
    kinds = {"image2": "image", "right": "image", "distance2": "mask", "distance_right": "mask"}
    made = A.Compose(
        [A.HorizontalFlip(p=1), water()],
        additional_targets=TARGETS | kinds,
        seed=1,
        save_applied_params=True,
    )
    images = {"image": array(), "image2": array(), "right": array()}
    maps = {"distance": metres(), "distance2": 2 * metres(), "distance_right": metres()[::-1]}
    result = made(**images, mask=MASK, **maps)
    for name, z in zip(images, maps.values(), strict=True):
        expected = ours(array()[:, ::-1], z[:, ::-1], record_of(made))
        assert np.array_equal(result[name], expected)
    assert not np.array_equal(result["image"], result["image2"])
    maps.pop("distance2")
    with pytest.raises(ValueError, match="distance2 is missing, for image2"):
        made(**images, mask=MASK, **maps)


def test_several_images_are_a_film() -> None:
    frames = np.stack([array(), array()[:, ::-1], array()[::-1]])
    maps = np.stack([metres(), 3 * metres(), 5 * metres()])
    made = A.Compose(
        [A.HorizontalFlip(p=1), water()],
        additional_targets={"distances": "masks"},
        seed=1,
        save_applied_params=True,
    )
    result = made(images=frames, masks=np.stack([MASK] * 3), distances=maps)
    batch = torch.from_numpy(frames[:, :, ::-1].copy()).movedim(-1, 1)
    z = torch.from_numpy(maps[:, :, ::-1].copy())[:, None]
    film = AUGMENT.for_clip(record_of(made), batch[1], z[1])  # settled on the middle one
    expected = AUGMENT.transform(batch, z, film).movedim(1, -1).numpy()
    assert np.array_equal(result["images"], expected)
    images = np.stack([array()] * 3)
    still = A.Compose([water(distance_key="mask")], seed=2)
    same = still(images=images, masks=np.stack([metres()] * 3))["images"]
    assert np.array_equal(same[0], same[2])
    # a map that all frames share
    shared = A.Compose([water()], additional_targets={"distances": "mask"}, seed=2)
    assert np.array_equal(shared(images=images, mask=MASK, distances=metres())["images"], same)


FILM = {"distance": metres(), "images": array()[None]}


@pytest.mark.parametrize(
    "options, data, words",
    [
        ({"augment": RandomUnderwater(p=0.5)}, {}, "augment.p must be 1"),
        ({"channels": "rgba"}, {}, "channels must be"),
        ({"scale": -0.5}, {}, "scale must be"),
        ({"p": 2}, {}, "p must be"),
        ({"min_contrast": 5}, {}, "min_contrast must be"),
        ({"min_contrast": 0.1}, {"distance": metres(), "bboxes": [[0, 0, 9, 9]]}, "bbox_params"),
        ({}, {}, "distance is missing, for image"),
        ({}, FILM, "distances is missing, for images"),
        ({}, {**FILM, "distances": metres()[None, :9]}, "height and width must agree"),
        ({}, {"distance": metres()[:9]}, "height and width must agree"),
        ({}, {"distance": 1000 * metres()}, "divide by 1000"),
    ],
)
def test_refusals(options: dict[str, Any], data: dict[str, Any], words: str) -> None:
    with pytest.raises((ValueError, TypeError), match=words):
        water(**options)(**{"image": array(), **data})


@pytest.mark.parametrize("targets", [{}, {"distance": "image"}])
def test_a_map_that_would_not_move_is_refused(targets: dict[str, str]) -> None:
    with pytest.raises(ValueError, match="distance would not move with image"):
        A.Compose([water()], additional_targets=targets)(
            image=array(), mask=MASK, distance=metres()
        )
    with pytest.raises(ValueError, match=r"distances would not move with images: .*'masks'"):
        A.Compose([water()])(images=array()[None], distances=metres()[None])
