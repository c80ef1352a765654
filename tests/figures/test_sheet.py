import pytest
import torch

from uwaug.figures import sheet as sheets
from uwaug.presets.scene import Scene

TEXT = "$\\nothing$.png"


@pytest.fixture
def drawn():
    scene = Scene(torch.zeros(3, 3, 4), torch.ones(1, 3, 4), note=TEXT)
    return sheets.sheet(scene, 2, TEXT, TEXT)


def test_texts_of_users_are_no_mathematics(drawn, tmp_path):
    figure, axes = drawn
    sheets.show(axes[0], torch.zeros(3, 3, 4), TEXT)
    sheets.show_map(axes[1], torch.zeros(1, 3, 4), TEXT, "viridis", (0, 1))
    sheets.save(figure, tmp_path / "a.png")
    assert [text.get_text() for text in figure.texts] == [TEXT, f"{TEXT}\n{TEXT}"]
    assert axes[0].get_title("left") == TEXT


def test_a_picture_is_written_whole_or_not_at_all(drawn, tmp_path, monkeypatch):
    figure, _ = drawn
    path = tmp_path / "2-terms.jpg"
    path.write_text("old")

    def fail(target, **_):
        target.write_text("half")
        raise OSError("disk full")

    monkeypatch.setattr(figure, "savefig", fail)
    with pytest.raises(OSError, match="disk full"):
        sheets.save(figure, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
