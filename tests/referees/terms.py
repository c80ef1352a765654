"""Terms of `form_image` against the reference."""

import math

import numpy as np
import torch
from torch import Tensor

from referees import reference
from uwaug.formation.scene import Terms
from uwaug.optics.medium import Medium

TERMS = ("direct", "forward", "backscatter")


def expected(
    image: Tensor, z: Tensor, medium: Medium, row: int = 0, order: str = "line_of_sight"
) -> tuple[np.ndarray, ...]:
    """The terms of one image (3, H, W) at effective distances (H, W), by a blur that is exact at
    every pixel.
    """
    z = z.double().numpy()
    law = medium.point_spread
    scale, exponent = _of_row(law.scale, row), _of_row(law.exponent, row)
    if law.reference_size is not None:
        scale *= min(z.shape) / law.reference_size
    sigma = scale * np.minimum(float(medium.b_mean[row]) * z, 1e6) ** exponent
    curves = reference.medium_curves(medium, z, row)
    return reference.terms(
        image.double().numpy(), z, curves, np.minimum(sigma, 1e4), order, law.shape
    )


def _of_row(value: float | Tensor, row: int) -> float:
    if not isinstance(value, Tensor):
        return value
    return float(value.reshape(-1)[row if value.numel() > 1 else 0])


def check(
    terms: Terms,
    image: Tensor,
    z: Tensor,
    medium: Medium,
    order: str = "line_of_sight",
    tolerance: float = 0.002,
):
    """Every term of every image of a batch against the reference: forward to the tolerance, the
    others to rounding.
    """
    rounding = 1e-12 if terms.direct.dtype == torch.float64 else 3e-6
    for i, parts in enumerate(zip(terms.direct, terms.forward, terms.backscatter, strict=True)):
        j, distance = (v[i if len(v) > 1 else 0] for v in (image, z))
        row = i if len(medium) > 1 else 0
        direct, forward, veil = expected(j, distance[0], medium, row, order)
        peak = max(1.0, float(j.abs().max()))
        for part, exact in ((parts[0], direct), (parts[2], veil)):
            ours = part.double().numpy()
            np.testing.assert_allclose(ours, exact, rtol=rounding, atol=rounding * peak)
        squares = (parts[1].double().numpy() - forward) ** 2
        assert math.sqrt(squares.mean()) <= tolerance * peak
