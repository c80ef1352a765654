"""Optional packages, which the extras of pyproject.toml install."""

import importlib
from typing import Any


def require(extra: str, *packages: str) -> list[Any]:
    """Import optional packages, or say how to install them.

    Raises:
        ImportError: if one is missing; names it and the extra.
    """
    try:
        return [importlib.import_module(name) for name in packages]
    except ImportError as error:
        cure = f'pip install ".[{extra}]" in a checkout of uwaug'
        raise ImportError(f"{error.name} is missing: {cure}", name=error.name) from error
