"""Rates and weights of a medium from the spectra of a water and a camera."""

from functools import lru_cache

import numpy as np

from uwaug._support.types import Array
from uwaug.optics.camera import Camera, require_covered, response_at
from uwaug.optics.quadrature import distances_of, reduce_rates
from uwaug.optics.spectra import bands_between
from uwaug.optics.surfaces import measure, reflectances, through_camera
from uwaug.optics.water import Water

# Smallest G, 1/m. It stands for 0, where the veil has the limit μ·b·E·z, and over 20 m is off by
# 1e-5 of that. A smaller one loses digits in V(0) − V(z), the difference of two large numbers.
_MIN_G = 1e-6
_BRIGHT_VEIL = 1.05  # V(0) above which the notes say that the veil is brighter than a white plate


@lru_cache(maxsize=16)
def _at_bands(camera: Camera, axis: bytes) -> tuple[Array, Array]:
    """Response of a camera at bands, nm, which must hold most of it, and reflectances (3xM)."""
    wavelengths = np.frombuffer(axis)
    require_covered(camera, float(wavelengths[0]), float(wavelengths[-1]))
    return response_at(camera, axis), reflectances(axis)


def default_bands(water: Water) -> Array:
    """Bands of `WAVELENGTHS` that a water covers; refuses a water that covers none."""
    low, high = float(water.wavelengths[0]), float(water.wavelengths[-1])
    bands = bands_between(low, high)
    if len(bands) == 0:
        raise ValueError(f"water covers {low:g}–{high:g} nm: no band of 400–700 nm")
    return bands


def attenuations(a: Array, b: Array, g: float | Array) -> tuple[Array, Array]:
    return a + b, np.maximum(a + g * b, _MIN_G)


def reduced(
    water: Water,
    camera: Camera,
    vertical_depth: float,
    g: float,
    mu: float,
    color_matrix: float | None,
    tolerance: float,
    *,
    lamps: bool,
) -> tuple[dict[str, Array], str]:
    """Arrays of a medium of one row by name, but for its width law, and a note on it. Arguments as
    of `Medium.from_water`, unchecked; no color_matrix for grey surfaces. In the light of `lamps`,
    too, if there are any.
    """
    spectra = water.at(default_bands(water))
    b = spectra.b
    sensor, reflected = _at_bands(camera, spectra.wavelengths.tobytes())
    basis, response = None, sensor
    if color_matrix is not None:
        response, basis = through_camera(sensor, reflected, color_matrix)
    beta, G = attenuations(spectra.a, b, g)
    light = np.exp(-spectra.kd * vertical_depth)
    veil = response * (mu * b * light / G)
    measured = measure(response, basis)
    lit, share = measured * light, tolerance
    if basis is not None and not _mixes(lit, np.stack([beta, G]), tolerance / 2):
        # diagonals serve, and leave half of the tolerance
        lit, share = response * light, tolerance / 2
    arrays, error = _reduced_curves(beta, G, lit, veil, share)
    if lamps:
        # b over its mean is about 1, so that the tolerance is relative to it
        b_scale = float(b.mean()) or 1.0
        dry, _ = _reduced_curves(beta, G, measured, response * b / b_scale, tolerance)
        dry["veil_weights"] = b_scale * dry["veil_weights"]
        arrays |= {f"lamp_{name}": array for name, array in dry.items()}
    rates = f"{len(arrays['beta'])} + {len(arrays['G'])} rates, curves within {error:.1g}"
    note = f"{water.name}: {rates}, {vertical_depth:g} m deep, g = {g:g}, μ = {mu:g}"
    note += "" if basis is None else ", surfaces = spectral"
    if (brightest := float(veil.sum(1).max())) > _BRIGHT_VEIL:
        note += f"; veil of {brightest:.2g} times white"
    return {**arrays, "b_mean": np.array((sensor @ b).mean())}, note


def _reduced_curves(
    beta: Array, G: Array, lit: Array, veil: Array, tolerance: float
) -> tuple[dict[str, Array], float]:
    """Rates and weights of curves by name, and their largest error, from the weights of each band:
    of T_β and T_G (3xM or 9xM) and of V (3xM).
    """
    G_weights = np.concatenate([lit, veil])
    if np.array_equal(beta, G):
        # two reductions would differ, and the difference would be scattered forward
        G_rates, weights, error = reduce_rates(beta, G_weights, tolerance)
        beta_rates, direct = G_rates, weights[:-3]
    else:
        beta_rates, direct, direct_error = reduce_rates(beta, lit, tolerance)
        G_rates, weights, error = reduce_rates(G, G_weights, tolerance)
        error = max(error, direct_error)
    return {
        "beta": beta_rates,
        "direct_weights": direct,
        "G": G_rates,
        "signal_weights": weights[:-3],
        "veil_weights": weights[-3:],
    }, error


def _mixes(lit: Array, rates: Array, tolerance: float) -> bool:
    """True if a channel takes more than a tolerance from the other two at some distance, by the
    weights of the nine curves (9xN) and rates β and G (2xN), 1/m.
    """
    off_diagonal = lit[[1, 2, 3, 5, 6, 7]]
    at_lens = np.abs(off_diagonal.sum(1)).reshape(3, 2).sum(1)
    if (at_lens > tolerance).any():
        return True
    with np.errstate(over="ignore", invalid="ignore"):
        curves = (off_diagonal @ np.exp(-rate[:, None] * distances_of(rate)) for rate in rates)
        exchanged = [np.abs(curve).reshape(3, 2, -1).sum(1) for curve in curves]
    return max(float(light.max()) for light in exchanged) > tolerance
