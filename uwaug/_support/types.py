"""Names for types that several rooms share."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Shape = Literal["gaussian", "exponential"]  # of a point spread
ColorSpace = Literal["srgb", "linear"]  # of a picture's values
