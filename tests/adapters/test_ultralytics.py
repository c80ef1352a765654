"""Epochs of a small YOLO. The package is no test extra: it brings 390 MB and a second OpenCV."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

import uwaug
from uwaug import RandomDevelopment, RandomUnderwater, RandomWater

pytest.importorskip("albumentations")

from uwaug.adapters.albumentations import AlbumentationsUnderwater

BOXES = torch.tensor([[0.5, 0.4, 0.25, 0.5], [0.2, 0.25, 0.125, 0.25]])  # x, y, width, height
STILL = ("mosaic", "scale", "translate", "fliplr", "hsv_h", "hsv_s", "hsv_v")
SIDE = 64


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, torchvision: Any) -> Path:
    monkeypatch.setenv("YOLO_CONFIG_DIR", str(tmp_path))
    monkeypatch.setenv("YOLO_OFFLINE", "true")
    monkeypatch.chdir(tmp_path)
    pytest.importorskip("ultralytics", reason="not installed: 390 MB; run by hand")
    random = np.random.default_rng(0)
    for folder in ("images", "labels"):
        (tmp_path / folder).mkdir()
    for number in range(4):
        picture = random.integers(0, 256, (SIDE, SIDE, 3), dtype=np.uint8)
        Image.fromarray(picture).save(tmp_path / "images" / f"{number}.png")
        lines = [f"0 {' '.join(map(str, box.tolist()))}\n" for box in BOXES]
        (tmp_path / "labels" / f"{number}.txt").write_text("".join(lines))
    data = tmp_path / "data.yaml"
    data.write_text(f"path: {tmp_path}\ntrain: images\nval: images\nnames: [fish]\n")
    return data


@pytest.mark.filterwarnings("ignore")
def test_epochs_of_yolo(data: Path) -> None:
    from ultralytics import YOLO
    from ultralytics.models.yolo.detect import DetectionTrainer

    batches = []

    class Recorded(DetectionTrainer):  # type: ignore[misc]
        def preprocess_batch(self, batch: dict[str, Any]) -> Any:
            batches.append(dict(batch))
            return super().preprocess_batch(batch)

        # torchvision's own operators may be missing, see the fixture
        def validate(self) -> Any:
            return {}, 0.0

        def final_eval(self) -> None: ...

    # nothing is random but whether a picture gets water
    augment = RandomUnderwater(
        RandomWater("7C", **{**RandomWater.PLAIN, "vertical_depth": 2}),
        distance=3,
        light=None,
        development=RandomDevelopment(**RandomDevelopment.PLAIN),
    )
    YOLO("yolo26n.yaml").train(
        trainer=Recorded,
        data=data,
        epochs=3,
        imgsz=SIDE,
        batch=2,
        workers=0,
        device="cpu",
        project=data.parent,
        plots=False,
        pretrained=False,
        augmentations=[AlbumentationsUnderwater(augment, channels="bgr", p=0.5)],
        **dict.fromkeys(STILL, 0.0),
    )
    wet = []
    for batch in batches:
        assert torch.allclose(batch["bboxes"], BOXES.repeat(2, 1))
        for file, picture in zip(batch["im_file"], batch["img"], strict=True):
            dry = torch.from_numpy(np.array(Image.open(file))).movedim(-1, 0)
            wet.append(not torch.equal(picture, dry))
            if wet[-1]:
                assert torch.equal(picture, augment(dry, None)[0])
    assert 0 < sum(wet) < len(wet) == 12


@pytest.mark.filterwarnings("ignore")
def test_the_script_of_the_guide(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    guide = Path(uwaug.__file__).parent / "DOES-IT-HELP.md"
    (script,) = re.findall(r"```py\n(.*?)```", guide.read_text(encoding="utf-8"), re.DOTALL)
    small = '{"data": "data.yaml", "epochs": 1, "imgsz": 64, "workers": 0, "device": "cpu"}'
    settings = f'MODEL, TRAINING = "yolo26n.yaml", {small}\nAIR = REAL = "images"\n'
    script, count = re.subn(r"MODEL, TRAINING = .*\nAIR, REAL = .*\n", settings, script)
    assert count == 1
    exec(compile(script, str(guide), "exec"), {"__name__": "__main__"})
    rows = re.findall(r"^\| (.*?) \| \d\.\d\d \| \d\.\d\d \| ", capsys.readouterr().out, re.M)
    assert rows == ["in air", *(f"severity {n}" for n in range(1, 6)), "real"]
