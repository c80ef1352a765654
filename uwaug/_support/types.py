"""Names for types that several rooms share."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Shape = Literal["gaussian", "exponential"]
"""Of a point spread."""

ColorSpace = Literal["srgb", "linear"]
"""What the values of a picture are: sRGB, or linear light as they stand."""
