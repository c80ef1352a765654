"""Optional packages, which the extras of pyproject.toml install."""

import importlib
from typing import Any


def install(extra: str) -> str:
    """Tell how to install an extra."""
    return f'pip install ".[{extra}]" in a checkout of uwaug'


def require(extra: str, *packages: str) -> list[Any]:
    """Import optional packages, or tell in an ImportError how to install them."""
    try:
        return [importlib.import_module(name) for name in packages]
    except ImportError as error:
        raise ImportError(f"{error.name} is missing: {install(extra)}", name=error.name) from error
