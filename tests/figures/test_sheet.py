import numpy as np
import pytest
import torch
from PIL import Image

from uwaug.figures import sheet as sheets

LONG = "a name of many words, " * 40


def ink(drawn, left, top, right, bottom):
    """Dark pixels within a box."""
    return int((np.asarray(drawn.convert("L"))[top:bottom, left:right] < 128).sum())


def test_pictures_stand_in_rows_below_their_words():
    red, blue = torch.zeros(2, 3, 10, 20)
    red[0], blue[2] = 1, 1
    bytes_of_green = torch.tensor([0, 255, 0], dtype=torch.uint8)[:, None, None].expand(3, 10, 10)
    rows = [[(red, "red"), (blue, "")], [(bytes_of_green, "two\nlines")]]
    drawn = sheets.sheet(rows, (100, 50), "Heading", "Caption")
    pixels = np.asarray(drawn).astype(int)
    boxes = []
    for channel in range(3):
        pure = (pixels == np.eye(3)[channel] * 255).all(2)
        y, x = pure.nonzero()
        boxes.append((int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1))
    (rx, ry, _, rb), (gx, gy, gr, gb), (bx, by, _, _) = boxes
    assert (rx, ry) == (gx, by) == (bx - 112, ry)
    assert (gr - gx, gb - gy, rb - ry) == (50, 50, 50)  # as large as its cell lets it be
    assert ink(drawn, rx, ry - 15, rx + 100, ry) > 20
    assert ink(drawn, bx, ry - 15, bx + 100, ry) == 0
    assert ink(drawn, gx, gy - 30, gx + 100, gy - 15) > 20
    assert drawn.height - gb == drawn.width - bx - 100 == rx  # the same margin on all sides


@pytest.mark.parametrize(
    "words", ["mcglamery-1980 of ten long words, many letters", "$x$ ﬁ 魚.png"]
)
def test_words_stay_within_their_cell(words):
    white = torch.ones(3, 20, 30)
    drawn = sheets.sheet([[(white, words), (white, "")]], (300, 300), caption=LONG)
    high = drawn.height - 200 - 12
    assert ink(drawn, 12, high - 22, 312, high) > 50
    assert ink(drawn, 312, high - 20, drawn.width, high) == 0
    assert ink(drawn, drawn.width - 12, 0, drawn.width, drawn.height) == 0


def test_letters_that_the_font_lacks_are_replaced():
    white = torch.ones(3, 20, 30)
    texts = [f"{c}a" for c in (*sheets._LETTERS, "\uffff")]
    drawn = [sheets._font(20).getmask(text).getbbox() for text in texts]
    assert drawn[-1] not in drawn[:-1]
    shown = [sheets.sheet([[(white, words)]]) for words in ("10×2 é.png", "10x2 ?.png")]
    assert shown[0] == shown[1]


def test_ends_of_a_span_have_the_first_and_the_last_colour():
    z = torch.tensor([[[0.0, 1.0, 2.0, 3.0, torch.inf]]])
    picture = sheets.coloured(z, (1.0, 3.0), ("#ff0000", "#0000ff"))
    wanted = torch.tensor([[1, 1, 0.5, 0, 0], [0] * 5, [0, 0, 0.5, 1, 1]]).double()
    torch.testing.assert_close(picture[:, 0], wanted)


def test_boxes_are_a_line_wide_on_the_sheet() -> None:
    inside = slice(450, 1350), slice(600, 1800)
    mask = np.zeros((1800, 2400), bool)
    mask[450, 900] = mask[900, 600] = mask[1349, 901] = mask[1000, 1799] = True
    for kind, ink in ((torch.float32, 1), (torch.uint8, 255)):
        pictures = torch.zeros(3, 3, 1800, 2400, dtype=kind)
        for picture, pixels in zip(pictures, (inside, mask, mask & False), strict=True):
            sheets.draw_box(picture, pixels, "yellow", (240, 180))
        assert torch.equal(pictures[0], pictures[1])
        assert not pictures[2].any()
        expected = [(600, 0), (10, ink), (1180, 0), (10, ink), (600, 0)]
        line = torch.cat([torch.full((count,), value, dtype=kind) for count, value in expected])
        assert torch.equal(pictures[0][:, 900], torch.stack([line, line, 0 * line]))


def test_a_sheet_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "2-terms.jpg"
    path.write_text("old")
    drawn = Image.new("RGB", (8, 8))
    monkeypatch.setattr(drawn, "save", lambda target, *_, **__: target.write_text("half") / 0)
    with pytest.raises(ZeroDivisionError):
        sheets.save(drawn, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
