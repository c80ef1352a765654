"""Waters and cameras by wavelength, and the medium that they make: curves and a width law."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
