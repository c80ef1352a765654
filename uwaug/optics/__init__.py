"""Waters and cameras, which know wavelengths, and the medium that comes of them, which is curves of
distance and a width law.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
