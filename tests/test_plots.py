from itertools import combinations

import pytest

from uwaug import plots


@pytest.mark.parametrize("name", plots.PICTURES)
def test_no_text_overlaps_or_leaves_the_picture(small, name, monkeypatch):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    drawn, draw = [], Text.draw

    def remembered(text, renderer):
        drawn.append(text)
        draw(text, renderer)

    monkeypatch.setattr(Text, "draw", remembered)
    figure = plots.PICTURES[name](small).figure
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    boxes = {}
    for i, text in enumerate(drawn):
        if text.get_text() and text.get_visible():
            boxes[text.get_text(), i] = text.get_window_extent()
    assert len(boxes) > 10
    for (label, _), box in boxes.items():
        assert box.x0 >= 0, label
        assert box.y0 >= 0, label
        assert box.x1 <= figure.bbox.x1, label
        assert box.y1 <= figure.bbox.y1, label
    for ((first, _), a), ((second, _), b) in combinations(boxes.items(), 2):
        assert not (a.x0 < b.x1 and b.x0 < a.x1 and a.y0 < b.y1 and b.y0 < a.y1), (first, second)
