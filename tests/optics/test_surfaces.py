"""Surfaces with spectra: media of 3×3 weights against sums over 61 bands."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from referees import reference, spectral
from referees.spectral import NIKON, SIGMA

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


@pytest.mark.parametrize("water", JERLOV_TYPES)
def test_curves_are_those_of_the_bands(water: str) -> None:
    camera = SIGMA if water in ("II", "5C") else NIKON
    for depth in (0.0, 25.0):
        bands = spectral.bands_of(Water.jerlov(water), depth=depth, **SCATTERING)
        exact = spectral.curves(bands, Z, spectral.eye(camera))
        medium = medium_of(water, camera=camera, vertical_depth=depth)
        assert max(errors(medium, exact)) <= 0.002 * 1.02
        # without reduction, to rounding of the table
        every_band = medium_of(water, camera=camera, vertical_depth=depth, tolerance=0)
        assert max(errors(every_band, exact)) <= (1e-8 if every_band.is_spectral else 0.002)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_share_of_the_matrix(share: float) -> None:
    eye = spectral.eye(NIKON, share)
    exact = spectral.curves(spectral.bands_of(Water.jerlov("1C"), depth=4.0, **SCATTERING), Z, eye)
    options = {"color_matrix": share, "vertical_depth": 4.0}
    assert max(errors(medium_of("1C", **options), exact)) <= 0.002 * 1.02
    assert max(errors(medium_of("1C", tolerance=0, **options), exact)) <= 1e-8


def test_three_numbers_serve_where_channels_do_not_mix() -> None:
    grey = Water([400, 700], a=[0.1, 0.1], b=[0.3, 0.3], kd=[0.15, 0.15])
    medium = medium_of(grey, vertical_depth=3.0)
    assert not medium.is_spectral
    exact = spectral.curves(spectral.bands_of(grey, depth=3.0, **SCATTERING), Z, spectral.eye())
    assert max(errors(medium, exact)) <= 0.002
    assert medium_of("3C").is_spectral


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


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: medium_of(COARSE.at(COARSE.wavelengths[:-2])), "400–600 nm, 49% of what red"),
        (lambda: Medium.from_water(COARSE.at(COARSE.wavelengths[:-2])), "49% of what red"),
        (
            lambda: medium_of(camera=Camera([400, 700], [[1, 1, 1], [2, 2, 2.001]])),
            "cannot tell three colours apart",
        ),
    ],
)
def test_what_is_refused(call: Callable[[], object], words: str) -> None:
    medium_of(COARSE)
    with pytest.raises(ValueError, match=words):
        call()


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
