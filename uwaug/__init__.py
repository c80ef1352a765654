"""Underwater pictures that do not exist: a differentiable, batched, spectral model of how water
degrades an image.

Public names are listed in `__init__.pyi`, each with its room; a room is loaded at first use.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
