"""The API reference as HTML: `python .ci/reference.py FOLDER`, with the extras `test` and `docs`.

A page for each room, of the names that `uwaug/__init__.pyi` or the room's `__all__` makes public.
"""

import importlib
import inspect
import pkgutil
import sys
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import torch
from numpy.typing import ArrayLike

import uwaug
from uwaug._support.types import Array


def load(room: ModuleType) -> None:
    """All that a room loads at first use, and none of the files that only lie in it."""
    names = getattr(room, "__all__", None)
    if names is None:
        for file in pkgutil.iter_modules(room.__path__, f"{room.__name__}."):
            importlib.import_module(file.name)
        return
    for name in names:
        setattr(room, name, getattr(room, name))
        if inspect.ismodule(getattr(room, name)):
            load(getattr(room, name))
    room.__path__ = []


in_full = inspect.formatannotation
SHORT = {
    in_full(ArrayLike): "ArrayLike",
    in_full(ArrayLike).removeprefix("Union[")[:-1]: "ArrayLike",  # beside None
    in_full(Array): "Array",
}


def in_short(annotation: Any, *args: Any) -> str:
    """A type by the names that code has for it."""
    words = in_full(annotation, *args)
    for full, name in SHORT.items():
        words = words.replace(full, name)
    return words


try:
    import torchvision  # noqa: F401  deepinv needs it
except RuntimeError:  # built for a torch with CUDA, beside one without: see tests/conftest.py
    for operator in ("nms", "qnms"):
        signature = "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"
        torch.library.define(f"torchvision::{operator}", signature)
load(uwaug)
inspect.formatannotation = in_short
import pdoc  # noqa: E402  only now: it takes over what formats types

warnings.simplefilter("error")
pdoc.render.configure(docformat="google")
pdoc.pdoc("uwaug", output_directory=Path(sys.argv[1]))
