from pathlib import Path

import pytest

from uwaug import plots, sheets


def test_a_picture_is_written_whole_or_not_at_all(small, tmp_path, monkeypatch):
    figure = plots.draw_contact_sheet(small).figure
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
