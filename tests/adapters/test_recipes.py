"""The guide's own code, and the lines for trainers in README."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

import uwaug

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
GUIDE = Path(uwaug.__file__).parent / "adapters" / "README.md"


@pytest.mark.parametrize(
    "package, said", [("deepinv", "tensor(True)\n"), ("datasets", "torch.Size([3, 32, 48])\n")]
)
def test_recipes(
    package: str, said: str, torchvision: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those whose packages no test of guides asks for."""
    pytest.importorskip(package)
    blocks = re.findall(r"```py\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    (block,) = (block for block in blocks if block.startswith(f"import {package}"))
    exec(compile(block, str(GUIDE), "exec"), {})
    assert capsys.readouterr().out == said


def line_for(trainer: str) -> str:
    """What README tells to write; what stands before the water is a flip."""
    return re.findall(rf"^\| {trainer} \| `(.*?)`", README, re.MULTILINE)[0]


PICTURE = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
METRES = np.linspace(1, 4, 24 * 32, dtype=np.float32).reshape(24, 32)
MASK = (METRES > 2).astype(np.uint8)


def test_the_line_for_albumentations() -> None:
    A = pytest.importorskip("albumentations")
    from uwaug.adapters.albumentations import AlbumentationsUnderwater

    code = line_for("Albumentations").replace("…", "A.HorizontalFlip(p=1)")
    pipeline = eval(code, {"A": A, "AlbumentationsUnderwater": AlbumentationsUnderwater})
    pipeline.set_random_seed(0)
    results = [pipeline(image=PICTURE, distance=METRES, mask=MASK) for _ in range(8)]
    wet = [not np.array_equal(result["image"], PICTURE[:, ::-1]) for result in results]
    assert 0 < sum(wet) < 8
    assert all(np.array_equal(result["distance"], METRES[:, ::-1]) for result in results)


def test_the_line_for_torchvision(torchvision: Any) -> None:
    v2, tv = torchvision.transforms.v2, torchvision.tv_tensors
    code = line_for("torchvision").replace("…", "v2.RandomHorizontalFlip(p=1), v2.ToDtype(one)")
    one = {tv.Image: torch.float32, "others": None}
    names = {"v2": v2, "uwaug": uwaug, "mean": [0, 0, 0], "std": [1, 1, 1], "one": one}
    pipeline = eval(code, names)
    image = torch.from_numpy(PICTURE).movedim(-1, 0) / 255
    metres, mask = torch.from_numpy(METRES)[None], torch.from_numpy(MASK)[None]
    box = tv.BoundingBoxes([[2, 3, 12, 13]], format="XYXY", canvas_size=(24, 32))
    target = {"mask": tv.Mask(mask), "box": box}
    sample = {"image": tv.Image(image), "distance": tv.Mask(metres), "target": target}
    torch.manual_seed(0)
    results = [pipeline(sample) for _ in range(8)]
    assert 0 < sum(not torch.equal(result["image"], image.flip(-1)) for result in results) < 8
    for result in results:
        assert torch.equal(result["distance"], metres.flip(-1))
        assert torch.equal(result["target"]["mask"], mask.flip(-1))
        assert result["target"]["box"].tolist() == [[20, 3, 30, 13]]


def test_kornias_containers_pass_no_map() -> None:
    from kornia.augmentation import AugmentationSequential, RandomHorizontalFlip

    images, maps = torch.rand(2, 3, 24, 32), torch.rand(2, 1, 24, 32) + 1
    flip, keys, water = RandomHorizontalFlip(p=1.0), ["input", "mask"], uwaug.RandomUnderwater()
    with pytest.raises(ValueError, match="kornia's containers pass a picture alone"):
        AugmentationSequential(flip, water, data_keys=keys)(images, maps)
    wet, moved = water(*AugmentationSequential(flip, data_keys=keys)(images, maps))
    assert torch.equal(moved, maps.flip(-1))
    assert not torch.equal(wet, images.flip(-1))


@pytest.mark.parametrize("layout", ["BTCHW", "BCTHW"])
def test_kornias_frames_do_not_get_a_water_each(layout: str) -> None:
    from kornia.augmentation import RandomHorizontalFlip, VideoSequential

    clip, water = torch.rand(2, 3, 3, 20, 28), uwaug.RandomUnderwater(distance=2.0)
    flip, options = RandomHorizontalFlip(p=1.0), {"data_format": layout}
    for members in ([flip, water], [torch.nn.Sequential(water)]):
        with pytest.raises(ValueError, match=r"VideoSequential .* each frame its own .*Video"):
            VideoSequential(*members, **options)(clip)
    wet = VideoSequential(water, **options, same_on_frame=False)(clip)  # as was asked for
    assert not torch.equal(wet, clip)
    assert not torch.equal(water(VideoSequential(flip, **options)(clip)[0]), clip[0])


def test_the_line_for_ultralytics() -> None:
    A = pytest.importorskip("albumentations")
    from uwaug.adapters.albumentations import AlbumentationsUnderwater

    names = {"A": A, "AlbumentationsUnderwater": AlbumentationsUnderwater, "uwaug": uwaug}
    names |= {"MadeUp": uwaug.distance.MadeUp}
    names |= {"model": SimpleNamespace(train=lambda data, augmentations: augmentations)}
    transforms = eval(line_for("Ultralytics"), names)
    assert any(isinstance(t, A.DualTransform) for t in transforms)  # else no boxes are passed
    # Ultralytics writes the list, and reads it again
    written = [A.to_dict(t) for t in transforms]
    boxes = A.BboxParams("yolo", label_fields=["class_labels"])
    pipeline = A.Compose([A.from_dict(t) for t in written], bbox_params=boxes)
    pipeline.set_random_seed(0)
    data = {"bboxes": np.array([[0.5, 0.5, 0.9, 0.9]]), "class_labels": np.array([[1.0]])}
    wet = [not np.array_equal(pipeline(image=PICTURE, **data)["image"], PICTURE) for _ in range(8)]
    assert 0 < sum(wet) < 8
    assert pipeline.transforms[-1].min_contrast == 0.05
