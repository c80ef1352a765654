"""Files of the bundled presets, by name. Loads nothing else, so that a shell completes at once."""

import os
from pathlib import Path


def list_presets() -> list[str]:
    """Sorted names of the presets that come with the package."""
    return sorted(_files())


def preset_path(name_or_path: str | os.PathLike[str]) -> Path:
    """File of a preset, from its name or its path, see `uwaug.load_preset`."""
    if not isinstance(name_or_path, str) or name_or_path.endswith(".toml"):
        return Path(name_or_path)
    files = _files()
    if name_or_path not in files:
        expected = f"{', '.join(sorted(files))}, or the path of a .toml file"
        raise ValueError(f"preset must be one of {expected}, got {name_or_path!r}")
    return files[name_or_path]


def _files() -> dict[str, Path]:
    here = Path(__file__).parent.parent
    installed = here / "configs"
    folder = installed if installed.is_dir() else here.parent / "configs"
    return {path.stem: path for path in folder.glob("*.toml")}
