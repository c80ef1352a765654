"""The guide's own code."""

import re
from pathlib import Path

import pytest

import uwaug

GUIDE = Path(uwaug.__file__).parent / "adapters" / "README.md"
BLOCKS = re.findall(r"```py(?:thon)?\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize(
    "package, block", [*zip(("albumentations", "datasets", "numpy"), BLOCKS, strict=True)]
)
def test_recipes(package: str, block: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip(package)
    found: dict[str, object] = {}
    exec(compile(block, str(GUIDE), "exec"), found)
    if package == "datasets":
        assert capsys.readouterr().out == "torch.Size([3, 32, 48])\n"
    if package == "numpy":  # WebDataset's: draws follow the name
        sample = {"__key__": "a", "jpg": found["picture"], "depth.npy": found["depth"]}
        first, again, other = (
            found["underwater"]({**sample, "__key__": key})["jpg"] for key in "aab"
        )
        assert (first == again).all()
        assert not (first == other).all()
