from pathlib import Path

import pytest
import torch

from uwaug.figures import demo as plots
from uwaug.figures import sheet as sheets


def test_texts_of_users_are_no_mathematics(tmp_path):
    texts = "5$ and $\\nothing$"
    figure, axes = sheets.sheet(1, 2, (3, 4), texts, texts)
    sheets.show(axes[0], torch.zeros(3, 3, 4), texts)
    sheets.show_map(axes[1], torch.zeros(1, 3, 4), texts, "viridis", ("0", "", "1"))
    sheets.save(figure, tmp_path / "a.png")
    assert not any(text.get_parse_math() for text in figure.texts)
    assert axes[0].get_title("left") == texts
    figure, _ = sheets.sheet(1, 1, (3, 4), "Ours", "$t^γ$", math=True)
    assert figure.texts[1].get_parse_math()


def test_a_picture_is_written_whole_or_not_at_all(small, tmp_path, monkeypatch):
    figure = plots.draw_contact_sheet(small)
    path = tmp_path / "2-terms.jpg"
    path.write_text("old")

    def fail(target: Path, **_: object) -> None:
        target.write_text("half")
        raise OSError("disk full")

    monkeypatch.setattr(figure, "savefig", fail)
    with pytest.raises(OSError, match="disk full"):
        sheets.save(figure, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
