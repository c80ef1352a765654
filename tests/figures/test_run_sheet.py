"""Which pictures of a run are on its sheet, and how."""

import numpy as np
import pytest
from filing import save
from PIL import Image

from uwaug.figures.run_sheet import _brief, draw_sheet, shown_of


def test_what_is_shown_is_spread_over_the_run():
    assert shown_of(1, 1) == {0}
    assert shown_of(4, 1) == {0, 1, 2, 3}
    assert shown_of(1000, 1) == {0, 111, 222, 333, 444, 555, 666, 777, 888, 999}
    # of five scenes in three waters each, the first and the last: all three waters
    assert shown_of(5, 3) == {0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 13, 14}
    # no more than three of many variants
    assert shown_of(2, 50) == {0, 1, 2, 50, 51, 52}


def test_a_picture_is_drawn_once_beside_what_was_made_of_it(tmp_path):
    pytest.importorskip("matplotlib")
    groups = []
    for number in range(3):
        shade = np.full((30, 40, 3), 80 * (number + 1), np.uint8)
        files = [save(tmp_path / f"{number}{variant}.png", shade) for variant in range(3)]
        groups.append([(file.name, file) for file in files])
    # one of the three was not made
    groups[1].pop()
    draw_sheet(groups, tmp_path / "sheet.jpg")
    with Image.open(tmp_path / "sheet.jpg") as sheet:
        values = np.asarray(sheet.convert("L")).astype(int)
    # columns of three: 3 rows, with 3, 2 and 3 pictures of their shades
    for number, count in enumerate((3, 2, 3)):
        areas = (abs(values - 80 * (number + 1)) < 4).sum()
        assert areas == pytest.approx(count * areas_of_one(values), rel=0.1)


def test_titles_are_to_be_read_without_a_calculation(tmp_path, monkeypatch):
    from uwaug.figures import sheet as sheets

    drawn = "0.12·contents of chlorophyll=5.406,cdom=0.5,minerals=2.482"
    assert _brief(drawn) == "chl 0.65, CDOM 0.06, min 0.3"
    assert _brief("0.53·contents of III") == "0.53·III"
    titles, headings = [], []
    sheet, show = sheets.sheet, sheets.show

    def headed(*args, **kwargs):
        headings.append(args[3])
        return sheet(*args, **kwargs)

    def titled(axis, picture, label):
        titles.append(label)
        show(axis, picture, label)

    monkeypatch.setattr(sheets, "sheet", headed)
    monkeypatch.setattr(sheets, "show", titled)
    files = [save(tmp_path / f"{i}.png", np.full((30, 40, 3), 9, np.uint8)) for i in range(2)]
    group = [("a.png", files[0]), (f"8.5 m\n{drawn}", files[1])]
    for count in (3, 1):
        draw_sheet([group], tmp_path / "sheet.jpg", count)
    assert headings == ["1 of 3 pictures", "All pictures"]
    assert titles[:2] == ["a.png", "→ 8.5 m\nchl 0.65, CDOM 0.06, min 0.3"]


def areas_of_one(values) -> float:
    """Pixels of a cell: there are three of the first shade."""
    return (abs(values - 80) < 4).sum() / 3
