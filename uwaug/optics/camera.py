"""Cameras: responses of red, green and blue by wavelength."""

import os
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from uwaug._support.codec import plain
from uwaug._support.types import Array
from uwaug.optics.spectra import WAVELENGTHS, Spectra, read_spectra, spectrum, wavelength_axis

_CHANNELS = ("red", "green", "blue")
_NAMES = ("Nikon 5100 (NPL)", "Sigma SDMerill (NPL)")  # of colour-science, in the folder `cameras`


@plain
@dataclass(frozen=True, init=False, eq=False, repr=False)
class Camera(Spectra):
    """The spectral response of a camera.

    Args:
        wavelengths (N array): wavelengths [nm], strictly ascending, N ≥ 1.
        response (N×3 array): response of R, G, B ≥ 0 to equal power, on any common scale.
        name: shown in messages.

    Attributes are the arguments, the arrays as read-only float64 copies. Between its wavelengths a
    response is linear, and outside of them 0. A ValueError if a channel responds to nothing.

    Examples:
        >>> Camera([450, 550, 600], [[0, 0, 1], [0, 1, 0], [1, 0, 0]], name="laser lines")
        Camera('laser lines', 3 wavelengths, 450–600 nm)
    """

    wavelengths: Array
    response: Array
    name: str

    def __init__(self, wavelengths: ArrayLike, response: ArrayLike, name: str = "custom") -> None:
        axis = wavelength_axis(wavelengths)
        values = spectrum("response", response, axis, channels=(3,))
        _require_response(values, f"camera {name!r}")
        vars(self).update(wavelengths=axis, response=values, name=name)

    def weights(self, wavelengths: ArrayLike) -> Array:
        """Quadrature weights (M, 3) ≥ 0 at wavelengths (M array) [nm], strictly ascending:
        ∫ S_c(λ) f(λ) dλ ≈ Σ_i weights[i, c] f(λ_i), with ∫ S_c = 1, by the rectangle rule. A
        ValueError if a channel has no response there.

        Examples:
            >>> camera = Camera([400, 700], [[0, 1, 1], [1, 1, 0]])
            >>> camera.weights([400, 500, 700]).round(3).tolist()
            [[0.0, 0.222, 0.5], [0.2, 0.333, 0.5], [0.8, 0.444, 0.0]]
        """
        axis = wavelength_axis(wavelengths)
        rows = [np.interp(axis, self.wavelengths, row, left=0, right=0) for row in self.response.T]
        values = np.stack(rows, 1)
        _require_response(values, f"camera {self.name!r} on {axis[0]:g}–{axis[-1]:g} nm")
        areas = values * np.gradient(axis)[:, None] if axis.size > 1 else values
        return np.asarray(areas / areas.sum(axis=0))


def load_camera(camera: "str | os.PathLike[str] | Camera") -> Camera:
    """Load a camera by name or from a file; a ``Camera`` passes through.

    Args:
        camera: "Nikon 5100 (NPL)" or "Sigma SDMerill (NPL)", whatever its case, blanks
            and punctuation; or the path of a CSV file (a string that ends in ``.csv``, or any path
            object) whose rows are wavelength [nm], R, G, B, separated by commas, with or without
            one header line.

    Source of the named cameras: Darrodi et al., *Reference data set for camera spectral sensitivity
    estimation*, JOSA A 32 (2015), measured at NPL, as packaged by colour-science (BSD-3-Clause).
    """
    if isinstance(camera, Camera):
        return camera
    if not isinstance(camera, str | os.PathLike):
        raise TypeError(f"camera must be a name, a CSV file or a Camera, got {camera!r:.80}")
    if not isinstance(camera, str) or camera.lower().endswith(".csv"):
        return _read_csv(Path(camera))
    for name in _NAMES:
        if _letters(name) == _letters(camera):
            return _measured(name)
    raise ValueError(f"camera must be one of {', '.join(_NAMES)}, or a .csv file; got {camera!r}")


def response_at(camera: Camera, axis: bytes) -> Array:
    """Weights (3, N) of a camera at wavelengths, given as an array's bytes; rows sum to 1."""
    return np.ascontiguousarray(camera.weights(np.frombuffer(axis)).T)


# Smallest share of a channel's response that must lie where the water has spectra. At 400–600 nm it
# is .49, and a white plate, 5 m deep and away, is 1.7 times too red.
_MIN_COVERED_SHARE = 0.7


def require_covered(camera: Camera, low: float, high: float) -> None:
    """Refuse a range of wavelengths, nm, that misses most of a channel's response."""
    inside = (low <= WAVELENGTHS) & (high >= WAVELENGTHS)
    shares = camera.weights(WAVELENGTHS)[inside].sum(0).tolist()
    for channel, share in zip(_CHANNELS, shares, strict=True):
        if share < _MIN_COVERED_SHARE:
            sees = f"{share:.0%} of what {channel} of camera {camera.name!r} sees"
            raise ValueError(f"water covers {low:g}–{high:g} nm, {sees}")


def _require_response(values: Array, subject: str) -> None:
    dark = [channel for channel, peak in zip(_CHANNELS, values.max(0), strict=True) if peak == 0]
    if dark:
        raise ValueError(f"{subject} has no response in {' and '.join(dark)}")


def _letters(name: str) -> str:
    return "".join(filter(str.isalnum, name.casefold()))


@cache
def _measured(name: str) -> Camera:
    file = re.sub(r"\W+", "-", name.lower()).strip("-")
    camera = _read_csv(Path(__file__).parent / "cameras" / f"{file}.csv")
    return Camera(camera.wavelengths, camera.response, name)


def _read_csv(path: Path) -> Camera:
    nm, *response = read_spectra(path, {"R": "red", "G": "green", "B": "blue"}).values()
    try:
        return Camera(nm, np.stack(response, 1), path.stem)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
