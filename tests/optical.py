"""What the tests of waters and media share."""

import numpy as np
import torch
from referees import reference

from uwaug.optics.medium import Medium
from uwaug.optics.water import Water

# finer near 0, where curves bend
Z = np.concatenate([[0.0], np.geomspace(1e-4, 1, 200), np.linspace(1, 20, 200)[1:]])
CURVES = ("transmission", "signal", "backscatter")


def errors(medium: Medium, water: Water, z: np.ndarray = Z, **kwargs: float) -> list[float]:
    """How far each of a medium's curves is at most from the integral over the spectrum."""
    exact = reference.spectral_curves(water, z, **kwargs)
    found = []
    for name, curve in zip(CURVES, exact, strict=True):
        ours = getattr(medium, name)(torch.from_numpy(z))[0].numpy()
        found.append(float(np.abs(ours - curve).max()))
    return found


def values(water, nm):
    """A water's a, b and K_d at one of its wavelengths."""
    (index,) = np.flatnonzero(water.wavelengths == nm)
    return water.a[index], water.b[index], water.kd[index]
