"""Constants of scattering that go together, and what a phase function says of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from uwaug._support.types import Array
from uwaug.optics.constituents import pure_water

_LOSS = 1 - 0.924  # 1 − ⟨cos θ⟩ of the phase function that g = .05 is calibrated to
_BRIGHTENING = 0.8  # of rays that rise, see `uwaug.light.direction`
_FIRST_DEGREES, _LAST_DEGREES = 1.0, 170.0  # a table begins at the latest, ends at the earliest
_LEAST_ANGLE = 1e-8  # rad
_NODES = 20_001  # of integrals over the logarithm of the angle
_HARBOUR, _HARBOUR_NM = ("NUC 2200", "NUC 2040", "NUC 2240"), 514.0


@dataclass(frozen=True)
class Scattering:
    """Shares of the scattered light: g leaves the line of sight, μ is sent towards the camera, each
    0…1. A picture does not tell them, so whoever makes pictures and whoever fits them must agree.

    With a phase function p(θ), ∫p dω = 1, they are

        g = .05·(1 − ⟨cos θ⟩)/.076,   μ = (⟨(1 − .64 sin²θ)^(−3/2)⟩ − 1 + g)/2.083.

    * g: light that is scattered by a little still carries the picture, so G = a + g·b. By Monte
      Carlo transport g goes with (1 − ⟨cos θ⟩)^1.05, within 12 % (`python -m benchmarks physics`),
      and with (a·z)^.31; the factor is that of `PointSpread.calibrated`.
    * μ: of a level ray in daylight whose radiance rises with s = sin(elevation) as (1 − .8 s)^−2,
      the law of `uwaug.light.direction`, relative to a white vertical plate there. In light that is
      alike from all sides μ would be g. By Monte Carlo transport of an overcast sky with Petzold's
      HAOCE 5, 8 m deep in types II, 1C and 3C, the veil asks for .057, .075 and .065; this is .071.

    Examples:
        >>> from uwaug import Medium, Scattering
        >>> harbour = Scattering.petzold("NUC 2240")
        >>> round(harbour.g, 3), round(harbour.mu, 3)
        (0.048, 0.105)
        >>> medium = Medium.from_water("II", g=harbour.g, mu=harbour.mu)
    """

    g: float
    mu: float

    CALIBRATED: ClassVar["Scattering"]

    @staticmethod
    def of_table(angles: Sequence[float] | Array, values: Sequence[float] | Array) -> "Scattering":
        """Of a phase function or volume scattering function, as measured.

        Args:
            angles (N): scattering angles, degrees, rising from 1° or less to 170° or more.
            values (N): > 0, in any unit. Between angles their logarithms are linear in that of the
                angle, as is below the first; beyond the last they are constant.

        A ValueError if they are none such, or forward light grows without end.
        """
        degrees, values = np.array(angles, float), np.array(values, float)
        if degrees.ndim != 1 or degrees.shape != values.shape or len(degrees) < 2:
            shapes = f"{degrees.shape}, {values.shape}"
            raise ValueError(f"angles and values must be rows (N), got {shapes}")
        first, last = degrees[[0, -1]]
        is_whole = 0 <= first <= _FIRST_DEGREES and _LAST_DEGREES <= last <= 180
        if not (is_whole and (np.diff(degrees) > 0).all()):
            expected = f"from 0…{_FIRST_DEGREES:g}° to {_LAST_DEGREES:g}…180°"
            raise ValueError(f"angles must rise {expected}, got {first:g} to {last:g}")
        if not (np.isfinite(values).all() and values.min() > 0):
            raise ValueError("values must be finite and above 0")
        at, logs = np.log(np.radians(degrees).clip(_LEAST_ANGLE)), np.log(values)
        power = (logs[1] - logs[0]) / (at[1] - at[0])
        if power <= -2:
            raise ValueError(f"values go with θ^{power:.3g} at 0, where light would have no end")
        angle = np.log(_nodes())
        below = logs[0] + power * (angle - at[0])
        values = np.exp(np.where(angle < at[0], below, np.interp(angle, at, logs)))
        return _of(values / _shares(values).sum())

    @staticmethod
    def petzold(station: str | None = None) -> "Scattering":
        """Of Petzold's measurements: his average particle, or one of his eight stations.

        Args:
            station: such as "AUTEC 8" (clear ocean), "HAOCE 11" (coast) or "NUC 2200" (harbour),
                with the water's own scattering; None: the mean of the three in the harbour, less
                pure water, as Mobley takes it for particles everywhere (b_b/b = .0183).
                A KeyError lists all.

        Source: Petzold, *Volume scattering functions for selected ocean waters*, SIO 72-78 (1972);
        Mobley, Gentili et al., Applied Optics 32 (1993) 7484.
        """
        return Scattering.of_table(*_petzold(station))


# For `PointSpread.calibrated` and a subject that fills the view. μ keeps the μ/g of the paper, so
# that the veil stays below a white plate.
Scattering.CALIBRATED = Scattering(g=0.05, mu=0.075)


def _of(phase: Array) -> Scattering:
    shares, angle, k = _shares(phase), _nodes(), _BRIGHTENING**2
    g = 0.05 * float(shares @ (2 * np.sin(angle / 2) ** 2)) / _LOSS
    # mean radiance on the cone at θ about the ray, and of the plate, in that of the level ray
    cone = float(shares @ ((1 - k * np.sin(angle) ** 2) ** -1.5 - 1))
    plate = 2 / k * ((1 - k) ** -0.5 - 1)
    return Scattering(min(g, 1.0), min((cone + g) / plate, 1.0))


def _shares(phase: Array) -> Array:
    """Shares of the light that `_nodes` stand for. Less than 1 if some goes on straight ahead."""
    angle = _nodes()
    step = np.log(angle[-1] / angle[0]) / (_NODES - 1)
    return np.asarray(2 * np.pi * step * phase * np.sin(angle) * angle)


def _nodes() -> Array:
    return np.geomspace(_LEAST_ANGLE, np.pi, _NODES)


def _petzold(station: str | None) -> tuple[Array, Array]:
    import jerlov

    if station is not None:
        measured = jerlov.petzold_scattering(station)
        return measured.angles_deg, measured.vsf
    harbour = [jerlov.petzold_scattering(name) for name in _HARBOUR]
    degrees = harbour[0].angles_deg
    b = float(pure_water(np.array([_HARBOUR_NM]).tobytes())[1][0])
    cosine = np.cos(np.radians(degrees))
    water = b * 3 / (4 * np.pi) * (1 + 0.835 * cosine**2) / (3 + 0.835)  # Morel 1974
    return degrees, np.mean([(one.vsf - water) / (one.b - b) for one in harbour], axis=0)
