"""Terms of `form_image` against the reference."""

import math

import numpy as np
import torch
from torch import Tensor

from referees import reference
from uwaug.formation.image import Terms
from uwaug.optics.medium import Medium


def expected(image: Tensor, z: Tensor, medium: Medium, row: int = 0) -> tuple[np.ndarray, ...]:
    """The terms of one image (3, H, W) at effective distances (H, W), by a blur that is exact at
    every pixel.
    """
    z = z.double().numpy()
    scale, exponent = float(medium.scale[row]), float(medium.exponent[row])
    if medium.law.unit == "paper":
        scale *= min(z.shape) / 518
    sigma = scale * np.minimum(float(medium.b_mean[row]) * z, 1e6) ** exponent
    curves = reference.medium_curves(medium, z, row)
    image = image.double().numpy()
    return reference.terms(image, z, curves, np.minimum(sigma, 1e4), medium.law.shape)


def check(terms: Terms, image: Tensor, z: Tensor, medium: Medium, tolerance: float = 0.002) -> None:
    """Every term of every image of a batch against the reference: forward to the tolerance, the
    others to rounding; and their sum against the image.
    """
    rounding = 1e-12 if terms.direct.dtype == torch.float64 else 3e-6
    for i, (direct, forward, veil, whole) in enumerate(
        zip(terms.direct, terms.forward, terms.backscatter, terms.image, strict=True)
    ):
        j, distance = (v[i if len(v) > 1 else 0] for v in (image, z))
        exact = expected(j, distance[0], medium, i if len(medium) > 1 else 0)
        peak = max(1.0, float(j.abs().max()))
        for part, wanted in ((direct, exact[0]), (veil, exact[2])):
            ours = part.double().numpy()
            np.testing.assert_allclose(ours, wanted, rtol=rounding, atol=rounding * peak)
        squares = (forward.double().numpy() - exact[1]) ** 2
        assert math.sqrt(squares.mean()) <= tolerance * peak
        torch.testing.assert_close(whole, direct + forward + veil, rtol=0, atol=rounding * peak)
