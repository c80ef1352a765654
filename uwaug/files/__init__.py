"""Pictures, distance maps and labels in files, and runs over folders of them."""

import lazy_loader

# command lines ask formats of labels what they read, and wait for no torch
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
