"""Systems that others have published, an equation each: `akkaynak_2018(image, z, "7C")`.

All take a picture (3xHxW or Bx3xHxW, sRGB: floating point 0…1, or uint8) and distances along the
ray (1xHxW or Bx1xHxW, m; +inf is open water), and give a picture of the same type, clipped to 0…1.
In equations the picture is light: decoded sRGB where the source works with radiances, and sRGB
values where the source takes them for light.

Water and camera are arguments of `uwaug.load_water` and `uwaug.load_camera`. Each docstring names
its source, what the source leaves open, and what is ours. Few of the originals were at hand.

Examples:
    >>> import torch, uwaug
    >>> image, z = torch.rand(3, 32, 48), torch.full((1, 32, 48), 3.0)
    >>> uwaug.published.akkaynak_2018(image, z, "7C", vertical_depth=5.0).shape
    torch.Size([3, 32, 48])
"""

from typing import TYPE_CHECKING

from uwaug.published import models as models
from uwaug.published.equation import FUNCTIONS
from uwaug.published.equation import picture as picture
from uwaug.published.equation import system as system
from uwaug.published.equation import systems as systems
from uwaug.published.equation import takes_spectra as takes_spectra

if TYPE_CHECKING:  # signatures of the names that the next line brings
    from uwaug.published.models import *  # noqa: F403

globals().update(FUNCTIONS)
__all__ = sorted(["picture", "system", "systems", "takes_spectra", *FUNCTIONS])  # noqa: PLE0605
