"""Text of a figure as it is drawn."""

from collections.abc import Callable
from itertools import combinations
from typing import Any

import pytest


def require_room(
    draw: Callable[[], Any], monkeypatch: pytest.MonkeyPatch, margin: float = 0.0
) -> int:
    """Refuse a figure whose text overlaps or comes nearer to its sides, left, right and top, than a
    margin, px; return how many texts it has.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    drawn, draw_text = [], Text.draw

    def remembered(text: Text, renderer: Any) -> None:
        drawn.append(text)
        draw_text(text, renderer)

    monkeypatch.setattr(Text, "draw", remembered)
    figure = draw()
    FigureCanvasAgg(figure).draw()
    texts = [text for text in drawn if text.get_text() and text.get_visible()]
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts]
    for label, box in boxes:
        assert box.x0 >= margin, label
        assert box.y0 >= 0, label
        assert box.x1 <= figure.bbox.x1 - margin, label
        assert box.y1 <= figure.bbox.y1 - margin, label
    for (first, a), (second, b) in combinations(boxes, 2):
        assert not (a.x0 < b.x1 and b.x0 < a.x1 and a.y0 < b.y1 and b.y0 < a.y1), (first, second)
    return len(boxes)
