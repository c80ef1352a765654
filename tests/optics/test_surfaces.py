"""Surfaces with spectra: media of 3×3 weights against sums over 61 bands."""

from typing import Any

import numpy as np
import pytest
import torch
from referees import reference, spectral
from referees.spectral import NIKON, SIGMA
from refusing import refusals

from uwaug import JERLOV_TYPES, Camera, Medium, Water, form_image
from uwaug.optics.surfaces import reflectances

Z = np.concatenate([[0.0], np.geomspace(1e-3, 30, 160)])
SCATTERING = {"g": 0.2, "mu": 0.3}


def medium_of(water: str | Water = "3C", **options: Any) -> Medium:
    known = {"surfaces": "spectral", "vertical_depth": 0.0, **SCATTERING}
    return Medium.from_water(water, **{**known, **options})


def three_by_three(values: np.ndarray) -> np.ndarray:
    """Numbers of three channels (1x3xN) as diagonal matrices (1x3x3xN); matrices stay."""
    return values if values.ndim == 4 else np.eye(3)[:, :, None] * values[:, :, None]


def errors(medium: Medium, exact: tuple[np.ndarray, ...], z: np.ndarray = Z) -> list[float]:
    """How far each of the three curves is from the exact one, at most."""
    metres = torch.from_numpy(z)
    ours = [f(metres).numpy() for f in (medium.transmission, medium.signal)]
    pairs = zip(map(three_by_three, ours), exact[:2], strict=True)
    apart = [float(np.abs(curve[0] - right).max()) for curve, right in pairs]
    veil = medium.backscatter(metres)[0].numpy()
    return [*apart, float(np.abs(veil - exact[2]).max())]


def test_the_basis_is_that_of_colour_science() -> None:
    basis = reflectances(spectral.BANDS.tobytes())
    np.testing.assert_allclose(basis.sum(0), 1, rtol=0, atol=1e-7)
    assert basis.min() > 0
    np.testing.assert_allclose(basis, spectral.BASIS, rtol=0, atol=1e-9)
    between = reflectances(np.array([452.5]).tobytes())[:, 0]
    np.testing.assert_allclose(between, basis[:, 10:12].mean(1), rtol=0, atol=1e-12)


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_air_changes_nothing(share: float) -> None:
    air = torch.zeros(1, 1, 6, 7, dtype=torch.float64)
    image = torch.from_numpy(reference.picture(6, 7))[None]
    for tolerance in (0.002, 0.0):
        medium = medium_of(color_matrix=share, tolerance=tolerance)
        seen = form_image(image, air, medium).image
        torch.testing.assert_close(seen, image, rtol=0, atol=1e-6)  # the basis sums to 1 ± 3e-8


GREY_WATER = Water([400, 700], a=[0.1, 0.1], b=[0.3, 0.3], kd=[0.15, 0.15], name="grey")
CASES = [
    *((Water.jerlov(name), NIKON, 1.0) for name in JERLOV_TYPES if name not in ("II", "5C")),
    *((Water.jerlov(name), SIGMA, 1.0) for name in ("II", "5C")),
    *((Water.jerlov("1C"), NIKON, share) for share in (0.0, 0.5)),
    (GREY_WATER, NIKON, 1.0),
]


@pytest.mark.parametrize("water, camera, share", CASES)
def test_curves_are_those_of_the_bands(water: Water, camera: str, share: float) -> None:
    for depth in (0.0, 4.0, 25.0):
        bands = spectral.bands_of(water, depth=depth, **SCATTERING)
        exact = spectral.curves(bands, Z, spectral.eye(camera, share))
        options = {"camera": camera, "vertical_depth": depth, "color_matrix": share}
        medium = medium_of(water, **options)
        assert max(errors(medium, exact)) <= 0.002 * 1.02
        # three numbers serve where channels do not mix
        assert depth > 4 or medium.is_spectral == (water is not GREY_WATER)
        # without reduction, to rounding of the table
        every_band = medium_of(water, tolerance=0, **options)
        assert max(errors(every_band, exact)) <= (1e-8 if every_band.is_spectral else 0.002)


def test_grey_stacks_with_spectral() -> None:
    parts = [Medium.from_water("1C"), medium_of("7C"), Medium.from_water("I")]
    batch = Medium.stack(parts)
    image = torch.from_numpy(reference.picture(12, 15))[None]
    z = torch.linspace(0.5, 4, 180).double().reshape(1, 1, 12, 15)
    together = form_image(image, z, batch)
    for n, part in enumerate(parts):
        alone = form_image(image, z, part)
        for name in ("direct", "backscatter"):
            torch.testing.assert_close(getattr(together, name)[n : n + 1], getattr(alone, name))
        torch.testing.assert_close(together.image[n : n + 1], alone.image, rtol=0, atol=0.004)
        same, ours = (medium.signal(torch.tensor(2.0))[0] for medium in (batch[n], part))
        torch.testing.assert_close(same, ours if part.is_spectral else torch.diag(ours))


COARSE = Water.jerlov("3C").at(np.arange(400.0, 651.0, 25.0))
SHORT = COARSE.at(COARSE.wavelengths[:-2])
GREY = Camera([400, 700], [[1, 1, 1], [2, 2, 2.001]])

test_what_is_refused = refusals(
    (medium_of, SHORT, "400–600 nm, 49% of what red"),
    (Medium.from_water, SHORT, "49% of what red"),
    (lambda: medium_of(camera=GREY), "cannot tell three colours apart"),
    error=ValueError,
)


def test_a_water_may_end_where_red_sees_little() -> None:
    assert medium_of(COARSE).is_spectral


@pytest.mark.parametrize("tolerance", [0.0, 0.002])
def test_a_lamp_lights_surfaces_with_spectra(tolerance: float) -> None:
    water = spectral.bands_of(Water.jerlov("5C"), depth=0.0, **SCATTERING)
    under = medium_of("5C", vertical_depth=9.0, tolerance=tolerance).under_lamp()
    exact = spectral.curves(water, Z, spectral.eye())
    for name, curve in (("transmission", exact[0]), ("signal", exact[1])):
        ours = getattr(under, name)(torch.from_numpy(Z))[0].numpy()
        np.testing.assert_allclose(ours, curve, rtol=0, atol=max(1e-8, 1.02 * tolerance))
    eye = spectral.eye()
    wanted = eye.matrix @ eye.sensor * water.b @ np.exp(-np.outer(water.G, Z))
    scattered = under.veil_weights[0] @ torch.exp(-under.G[0, :, None] * torch.from_numpy(Z))
    np.testing.assert_allclose(scattered.numpy(), wanted, rtol=0, atol=1e-7 + 3 * tolerance)
