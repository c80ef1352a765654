"""Files of the bundled presets, by name. Loads nothing else, so that a shell completes at once."""

import os
from pathlib import Path


def list_presets() -> list[str]:
    """Sorted names of the presets that come with the package."""
    return sorted(_files())


def bundled_preset(name: str) -> Path:
    """File of a preset that comes with the package."""
    files = _files()
    if name not in files:
        raise ValueError(f"no preset is called {name!r}; there are {', '.join(sorted(files))}")
    return files[name]


def preset_path(name_or_path: str | os.PathLike[str]) -> Path:
    """File of a preset, from its name or its path, see `uwaug.load_preset`."""
    if not isinstance(name_or_path, str) or name_or_path.endswith(".toml"):
        return Path(name_or_path)
    try:
        return bundled_preset(name_or_path)
    except ValueError as error:
        raise ValueError(f"{error}; or give the path of a .toml file") from None


def _files() -> dict[str, Path]:
    here = Path(__file__).parent.parent
    installed = here / "configs"
    folder = installed if installed.is_dir() else here.parent / "configs"
    return {path.stem: path for path in folder.glob("*.toml")}
