"""What the tests of pictures in files share."""

from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from imagecodecs import png_encode
from PIL import Image

from uwaug.files.folder import MANIFEST

H, W = 12, 16


def pixels(height: int = H, width: int = W, channels: int = 3, seed: int = 0) -> Any:
    """HxWxC, uint8."""
    rng = np.random.default_rng(seed)
    return rng.integers(0, 256, (height, width, channels), dtype=np.uint8)


def words(channels: int = 3) -> Any:
    """HxWxC, uint16; their low bytes say something."""
    return np.random.default_rng(0).integers(0, 65536, (H, W, channels), dtype=np.uint16)


def metres(height: int = H, width: int = W) -> Any:
    """HxW, float32, 1…4 m."""
    return np.linspace(1, 4, height * width, dtype=np.float32).reshape(height, width)


def save(path: str | Path, values: Any, **options: Any) -> Path:
    """Write a picture or a map, by the end of its name."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, values)
    elif path.suffix == ".tif":
        tifffile.imwrite(path, values, **options)
    elif values.dtype == np.uint16 and values.ndim == 3:
        path.write_bytes(png_encode(values))
    else:
        Image.fromarray(values).save(path, **options)
    return path


def content(folder: str | Path) -> dict[str, bytes]:
    """All files in a folder but the manifests of runs, by their names."""
    found = {}
    for path in sorted(Path(folder).rglob("*")):
        if path.is_file() and path.name != MANIFEST:
            found[path.relative_to(folder).as_posix()] = path.read_bytes()
    return found
