"""The medium that a preset's file comes to."""

from typing import Any

import numpy as np
import torch

from uwaug.optics.bands import attenuations, surface_light
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.presets.schema import Config

__all__ = ["medium_of"]


def medium_of(
    config: Config,
    spectral: dict[str, Any] | None,
    water: str | None,
    tolerance: float,
    generator: torch.Generator | None,
) -> tuple[Medium, float]:
    """The medium, and how deep the scene lies, m.

    Args:
        config: of the file.
        spectral: water, camera, g and mu; None for what has no spectra.
        water: name of the type among those of the table `channels`; None for the file's.
        tolerance: as for `Medium.from_water`.
        generator: draws what the file holds as a range; None takes the middle.
    """
    psf = config.point_spread
    law = PointSpread(psf.scale_px, psf.exponent, psf.shape, psf.short_side_px)
    depth = config.medium.vertical_depth_m
    if generator is not None and config.medium.depth_range_m is not None:
        low, high = config.medium.depth_range_m
        depth = low + (high - low) * _draws(1, generator)[0]
    if config.channels is not None:
        return _of_channels(config, water, depth, generator), depth
    if spectral is None:
        return _of_coefficients(config, law, depth), depth
    medium = Medium.from_water(
        spectral["waters"],
        spectral["cameras"],
        vertical_depth=depth,
        g=spectral["g"],
        mu=spectral["mu"],
        point_spread=law,
        tolerance=tolerance,
        downwelling=config.medium.downwelling,
        dims=config.medium.dims,
        veil_rate=config.medium.veil_rate,
        forward=config.medium.forward,
    )
    if config.veil is None:
        return medium, depth
    veil = torch.tensor(_veil(config, generator), dtype=torch.float64)
    if config.medium.dims != "direct":
        # dimmed as the picture is, each wavelength by its own
        veil = veil * medium.signal_weights.sum(-1)
    return medium.with_veil(veil, curve="signal"), depth


def _of_channels(
    config: Config, water: str | None, depth: float, generator: torch.Generator | None
) -> Medium:
    channels, veil = config.channels, np.array(_veil(config, generator))
    assert channels is not None
    if channels.left is not None:
        return Medium.from_transmission(channels.left, veil.tolist())
    kind = channels.type if water is None else water
    if channels.beta_per_m is not None:
        beta = np.array(channels.beta_per_m[kind])
    else:
        assert channels.left_per_m is not None
        beta = -np.log(np.array(channels.left_per_m[kind]))
    left = np.exp(-beta * depth) if config.medium.downwelling == "beam" else np.ones(3)
    left = left * channels.surface_light
    light = np.ones(3) if config.medium.dims == "veil" else left
    ambient = np.ones(3) if config.medium.dims == "direct" else left
    rates = beta.tolist()
    return Medium.from_coefficients(rates, rates, (veil * ambient).tolist(), light=light.tolist())


def _of_coefficients(config: Config, law: PointSpread, depth: float) -> Medium:
    a, b, printed, kd = (np.array(values) for values in vars(config.coefficients).values())
    # the g of each channel that gives G as printed, which is rounded
    g = np.divide(printed - a, b, out=np.zeros(3), where=b > 0)
    beta, G = attenuations(a, b, g)
    light, veil, _ = surface_light(beta, G, b, kd, vertical_depth=depth, mu=config.medium.mu)
    return Medium.from_coefficients(
        beta.tolist(),
        G.tolist(),
        veil.tolist(),
        b_mean=float(b.mean()),
        point_spread=law,
        light=light.tolist(),
    )


def _veil(config: Config, generator: torch.Generator | None) -> list[float]:
    """V(0) before it is dimmed: the middle of its range, or drawn."""
    assert config.veil is not None
    shares = [0.5] * 3 if generator is None else _draws(3, generator)
    veil = []
    for low, high, share in zip(config.veil.low, config.veil.high, shares, strict=True):
        veil.append(low + (high - low) * share)
    return veil


def _draws(count: int, generator: torch.Generator) -> list[float]:
    """Uniform in 0…1."""
    return torch.rand(count, generator=generator, dtype=torch.float64).tolist()
