import pytest
import torch

from uwaug.onnx.strips import PICTURE, strips_of


@pytest.mark.parametrize(
    ("batch", "size"),
    [
        (1, (1, 1)),
        (1, (17, 3)),
        (3, (256, 256)),
        (1, (1, 70_001)),
        (1, (70_001, 1)),
        (2, (363, 517)),
        (1, (2160, 3840)),
        (1, (3000, 4000)),
        (1, (33, 40_000)),
    ],
)
def test_strips_cover_a_picture_once(batch, size) -> None:
    h, w = size
    rows, places = strips_of(batch, size)
    count, height = rows.shape
    assert (count - 1) * height < h <= count * height
    assert height % 16 == 0
    # about as large as wanted, where a period of rows is
    assert batch * height * w < 65_536 + 16 * batch * w
    number = torch.arange(batch * 3 * h).reshape(batch, 3, h, 1)
    strips = torch.stack([PICTURE.of(number, strip) for strip in rows])
    assert torch.equal(strips.flatten()[places], number[..., 0])
