"""What the tests of presets share."""

import re
from pathlib import Path

import torch

from uwaug import Medium
from uwaug.presets.files import bundled_preset


def edited(tmp_path: Path, name: str, pattern: str, replacement: str) -> Path:
    """A bundled preset with its first match of a pattern replaced, as a file of one's own."""
    text = bundled_preset(name).read_text(encoding="utf-8")
    text, count = re.subn(pattern, replacement, text, count=1, flags=re.MULTILINE)
    assert count == 1
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


def same(first: Medium, second: Medium) -> bool:
    """Whether two media agree in every bit."""
    return all(torch.equal(x, y) for x, y in zip(first.tensors(), second.tensors(), strict=True))
