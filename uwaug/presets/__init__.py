"""Presets and a scene that come with the package."""

import lazy_loader

# names of presets are completed in a shell, which waits for no torch
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
