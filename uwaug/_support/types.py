"""Names for types that several rooms share."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Shape = Literal["gaussian", "exponential"]
"""Of a point spread."""

Order = Literal["line_of_sight", "source"]
"""Blur, then weight with the curves of the pixel that looks; or weight, then blur."""

ColorSpace = Literal["srgb", "linear"]
"""What the values of a picture are: sRGB, or linear light as they stand."""
