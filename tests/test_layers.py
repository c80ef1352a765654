"""The house: rooms know what lies below them, and nothing else."""

import ast
from collections.abc import Iterator
from pathlib import Path

import uwaug

PACKAGE = Path(uwaug.__file__).parent

LAYERS = (
    "_support",
    "optics blur distance",
    "light",
    "formation fast",
    "fitting onnx",
    "transforms",
    "presets published",
    "figures",
    "files adapters page",
    "cli",
)
TWINS = {("fast", "formation"), ("formation", "fast")}
"""The compiled loops are one floor with what they stand for, behind one gate."""


def arrows() -> Iterator[tuple[str, str, str]]:
    """Each import of one room by another, lazy and typing-only ones too: file, room, other room."""
    for path in sorted(PACKAGE.glob("*/**/*.py")):
        file = path.relative_to(PACKAGE)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module == "uwaug":
                names = [f"uwaug.{alias.name}" for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module or ""]
            elif isinstance(node, ast.ImportFrom):
                raise AssertionError(f"{file}: a relative import hides its room")
            for name in names:
                package, _, rest = name.partition(".")
                other = rest.split(".")[0]
                if package == "uwaug" and other not in (file.parts[0], "__version__"):
                    yield str(file), file.parts[0], other


def test_every_folder_is_a_room_with_a_floor() -> None:
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders == set(" ".join(LAYERS).split())
    files = {path.name for path in PACKAGE.glob("*.py*")}
    assert files == {"__init__.py", "__init__.pyi", "__main__.py"}


def test_rooms_import_downwards_only() -> None:
    floors = {room: n for n, rooms in enumerate(LAYERS) for room in rooms.split()}
    # the package's face knows every room but the command line, which alone may import it
    face = floors["cli"] - 1
    climbs = [
        (file, room, other)
        for file, room, other in arrows()
        if floors.get(other, face) >= floors[room] and (room, other) not in TWINS
    ]
    assert climbs == []
