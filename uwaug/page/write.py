"""Writer of the page: code, style, tables and a scene in one HTML file."""

import base64
import io
import json
import re
import zlib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from uwaug._support.atomic import written_whole
from uwaug.page.tables import tables
from uwaug.presets.scene import Scene

_OPEN_CODE = 65535  # of open water in whole numbers of 16 bits

# files of the worker, which become one script with unique names
_WORKER = ("model.js", "maps.js", "holes.js", "like.js", "worker.js")


def write_page(
    path: str | Path, scene: Scene, source: Mapping[str, Any], water: str | None = None
) -> None:
    """Write a page that shows a scene first.

    Args:
        path: of the HTML file; written whole, or not at all.
        scene: of `tables.PIXELS` at most, see `uwaug.presets.scene.own_scene`.
        source: origin of the scene, for commands that the page shows: "picture" and "distance",
            names of files, or metres; "unit", m; "holes"; "unsaved": the page must save the files
            first; "guessed": distances are made up; "width" of the picture, px.
        water: the Jerlov type to begin with.
    """
    parts = {
        "style.css": _text("style.css"),
        " ".join(_WORKER): _plain(*_WORKER),
        "tables": _json(tables()),
        "scene": _json({**_stored(scene), "water": water, "files": {"holds": "metres", **source}}),
        "page.js": _plain("page.js"),
    }
    page = re.sub(r"/\* ([\w. ]+) \*/", lambda mark: parts[mark[1]], _text("index.html"))
    with written_whole(path) as part:
        part.write_text(page, encoding="utf-8")


def _text(name: str) -> str:
    return files("uwaug.page").joinpath(name).read_text(encoding="utf-8")


def _plain(*names: str) -> str:
    return re.sub(r"^export ", "", "\n".join(map(_text, names)), flags=re.MULTILINE)


def _json(value: Any) -> str:
    # a script ends at </script>, and <!-- would keep it from ending
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")


def _stored(scene: Scene) -> dict[str, Any]:
    pixels = (scene.image * 255).round().byte().permute(1, 2, 0).numpy()
    webp = io.BytesIO()
    Image.fromarray(pixels).save(webp, "WEBP", lossless=True)
    z = scene.distance.double().numpy()
    finite = z[np.isfinite(z)]
    near, far = (float(finite.min()), float(finite.max())) if finite.size else (1.0, 1.0)
    step = max(np.log(far / near) / (_OPEN_CODE - 1), 1e-9)
    with np.errstate(invalid="ignore"):
        codes = np.where(np.isfinite(z), np.rint(np.log(z / near) / step), _OPEN_CODE)
    steps = np.diff(codes.astype("<u2").ravel(), prepend=np.uint16(0))  # half the bytes
    return {
        "picture": base64.b64encode(webp.getvalue()).decode(),
        "distance": base64.b64encode(zlib.compress(steps.tobytes(), 9)).decode(),
        "near": near,
        "step": float(step),
    }
