from typing import NamedTuple

import numpy as np
import pytest
import torch
from torch import Tensor


class Scene(NamedTuple):
    """Middlebury's motorcycle, 500×741, with the 7 % of unknown pixels set to the farthest distance."""

    srgb: Tensor  # 3×H×W, float64
    linear: Tensor  # 3×H×W
    distance: Tensor  # 1×H×W, metres


@pytest.fixture(scope="session")
def motorcycle() -> Scene:
    from skimage.data import stereo_motorcycle

    left, _, disparity = stereo_motorcycle()
    known = np.isfinite(disparity)
    depth = (
        994.978
        * 0.193001
        / (np.where(known, disparity, disparity[known].min()).astype(np.float64) + 31.086)
    )
    srgb = left.transpose(2, 0, 1) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return Scene(*map(torch.from_numpy, (srgb, linear, depth[None])))
