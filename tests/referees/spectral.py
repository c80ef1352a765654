"""Pictures rendered one wavelength after the other: a scene whose colours have spectra in 61 bands,
and what a camera and its colour matrix make of the sum.

Of uwaug it takes only a water's spectra. Reflectances and cameras are those of colour-science.
"""

from typing import NamedTuple

import numpy as np

from uwaug.optics.water import Water

_options = np.get_printoptions()
import colour  # noqa: E402

np.set_printoptions(**_options)  # which colour sets for the whole process

BANDS = np.arange(400.0, 701.0, 5.0)  # nm
NIKON, SIGMA = colour.MSDS_CAMERA_SENSITIVITIES
BASIS = colour.recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019.values[4:65].T

Array = np.ndarray


class Eye(NamedTuple):
    """A camera that develops.

    Attributes:
        sensor (3x61): weights of each band in each channel; rows sum to 1.
        matrix (3x3): from raw channels to those of the picture.
        basis (3x61): what surfaces reflect that it shows in air as pure R, G and B.
    """

    sensor: Array
    matrix: Array
    basis: Array


def eye(name: str = NIKON, share: float = 1.0) -> Eye:
    """A camera with a share of the colour matrix that is right for the basis."""
    table = colour.MSDS_CAMERA_SENSITIVITIES[name]
    columns = table.values.T
    response = [np.interp(BANDS, table.wavelengths, x, left=0, right=0) for x in columns]
    sensor = np.array([channel / channel.sum() for channel in response])
    basis = BASIS
    raw = np.array([[(channel * reflects).sum() for reflects in basis] for channel in sensor])
    matrix = (1 - share) * np.eye(3) + share * np.linalg.inv(raw)
    # the colour that the basis needs so that the camera shows R, G or B
    needed = np.linalg.inv(matrix @ raw)
    return Eye(sensor, matrix, needed.T @ basis)


class Water61(NamedTuple):
    """β, G, b, light E and μ·b·E of a water in each band."""

    beta: Array
    G: Array
    b: Array
    light: Array
    glow: Array


def bands_of(water: Water, *, depth: float, g: float, mu: float) -> Water61:
    """A water in 61 bands."""
    bulk = water.at(BANDS)
    light = np.exp(-bulk.kd * depth)
    return Water61(bulk.a + bulk.b, bulk.a + g * bulk.b, bulk.b, light, mu * bulk.b * light)


def curves(
    water: Water61, z: Array, camera: Eye, spectrum: Array | None = None
) -> tuple[Array, Array, Array]:
    """T_β and T_G (3x3x…: channel of the picture, of the scene) and the veil (3x…) at distances,
    band by band.
    """
    direct, signal = np.zeros((2, 3, 3, *np.shape(z)))
    veil = np.zeros((3, *np.shape(z)))
    for n in range(61):
        beta, G = water.beta[n], water.G[n]
        seen = camera.matrix @ camera.sensor[:, n]
        mixes = np.multiply.outer(seen, camera.basis[:, n]) * water.light[n]
        direct += np.multiply.outer(mixes, np.exp(-beta * z))
        signal += np.multiply.outer(mixes, np.exp(-G * z))
        column = -np.expm1(-G * z) / G if G > 0 else z
        veil += np.multiply.outer(seen * water.glow[n], column)
    return direct, signal, veil
