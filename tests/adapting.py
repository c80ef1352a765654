"""What the tests of the adapters share."""

import numpy as np
from augmenting import H, W, distances, picture
from numpy.typing import NDArray

AnyArray = NDArray[np.generic]


def array(dtype: str = "uint8") -> AnyArray:
    """A picture, HxWx3; the same at every call."""
    image = np.ascontiguousarray(picture().permute(1, 2, 0).numpy())
    return np.rint(255 * image).astype(np.uint8) if dtype == "uint8" else image.astype(dtype)


def metres() -> NDArray[np.float32]:
    """Its map, HxW: 1…5 m."""
    found: NDArray[np.float32] = 1 + 4 * distances()[0].numpy()
    return found


assert array().shape == (H, W, 3)
