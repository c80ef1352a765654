"""A bio-optical model of the contents of a water: chlorophyll, coloured dissolved organic matter
(CDOM) and minerals.

    a = a_w + A_p C^E_p + g e^(−.014 (λ − 440)) + .041 s e^(−.0123 (λ − 443))
    b = b_w + .347 C^.766 (λ/660)^ν + 1.1513 s (400/λ)^1.7
    K_d = √(A² + (.425 μ₀ − .19) A (b − b_w)) / μ₀,  A = a + b_w/2,  μ₀ = .9

with C chlorophyll [mg/m³], g CDOM [1/m at 440 nm], s minerals [g/m³]. Particles that belong to the
phytoplankton are in A_p; ν = (log₁₀ C − .3)/2 in [−1, 0] is 0 for C > 2. From the tables of
Jerlov's types, with the best C, g and s of each, a, b and K_d are off by .03 to .14 (mean RMS of
the logarithm), as the two tables are from each other by .11 to .66. The worst is type III, which
Solonenko & Mobley let scatter 1/m and hardly absorb.

References:
    A_p, E_p: Bricaud et al., J. Geophys. Res. 103 (1998), particles of Case 1 waters, measured at
        .02–25 mg/m³ and 400–700 nm, the range of these waters.
    CDOM: Bricaud et al., Limnol. Oceanogr. 26 (1981).
    Minerals: absorption, Babin et al., J. Geophys. Res. 108 (2003); scattering, the small
        (terrigenic) particles of Haltrin, Appl. Opt. 38 (1999), as in Solonenko & Mobley (1.513 in
        print there, a digit lost).
    Scattering by phytoplankton: Loisel and Morel, Limnol. Oceanogr. 43 (1998); ν: Morel and
        Maritorena, J. Geophys. Res. 106 (2001).
    K_d: Kirk, Limnol. Oceanogr. 29 (1984). Pure water: see `Water.with_contrast`.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Self

import numpy as np

from uwaug._support.codec import plain
from uwaug._support.nouns import Noun, number
from uwaug._support.ranges import Range, as_range, read_range
from uwaug._support.types import Array
from uwaug.optics.spectra import WAVELENGTHS, read_spectra

# Unit of each content. A new content is a line here, a field of `Constituents`, and its terms in
# `optical_properties`.
UNITS = {
    "chlorophyll": "mg/m³",
    "cdom": "1/m at 440 nm",
    "minerals": "g/m³",
}

# waters by the name of a place: blue, grey-green, green, dark green
PLACES = {
    "reef": {"chlorophyll": 0.4, "cdom": 0.03, "minerals": 0.2},
    "harbour": {"chlorophyll": 4.0, "cdom": 0.3, "minerals": 3.0},
    "lake": {"chlorophyll": 10.0, "cdom": 0.4, "minerals": 1.0},
    "fjord": {"chlorophyll": 5.0, "cdom": 0.6, "minerals": 0.2},
}

MAX_CONTENT = 1e4  # largest amount of a content, in its unit
MEAN_COSINE = 0.9  # of daylight below the surface; Solonenko & Mobley have .98 to .85, at coasts
LOST_BY_SCATTERING = 0.425 * MEAN_COSINE - 0.19  # share G(μ₀) of A·(b − b_w) in (μ₀ K_d)²
SCATTERED_BY_PHYTOPLANKTON = 0.347, 0.766  # 1/m at 660 nm and 1 mg/m³; exponent of chlorophyll

# absorption and scattering at `WAVELENGTHS` by one unit of a content, 1/m
CDOM = np.exp(-0.014 * (WAVELENGTHS - 440))
ABSORBED_BY_MINERALS = 0.041 * np.exp(-0.0123 * (WAVELENGTHS - 443))
SCATTERED_BY_MINERALS = 1.1513 * (400 / WAVELENGTHS) ** 1.7


@plain
@dataclass(frozen=True)
class Constituents(Noun):
    """Contents of a water: numbers, or ranges (low, high) from which `RandomUnderwater` draws for
    each picture, uniformly in the logarithm.

    Args:
        chlorophyll, cdom, minerals: amounts, see `Water.from_constituents`.

    Examples:
        >>> lakes = Constituents(chlorophyll=(1, 50), cdom=(0.2, 5), minerals=1)
        >>> lakes.name
        'chlorophyll=1:50,cdom=0.2:5,minerals=1'
        >>> Constituents.parse(lakes.name) == lakes
        True
    """

    chlorophyll: float | tuple[float, float] = number(0.0, 0.0, MAX_CONTENT, logarithmic=True)
    cdom: float | tuple[float, float] = number(0.0, 0.0, MAX_CONTENT, logarithmic=True)
    minerals: float | tuple[float, float] = number(0.0, 0.0, MAX_CONTENT, logarithmic=True)

    def __post_init__(self) -> None:
        for name, unit in UNITS.items():
            low, high = as_range(name, getattr(self, name), 0.0, MAX_CONTENT, unit)
            if low == 0 < high:  # its logarithm is drawn
                raise ValueError(
                    f"{name} must be 0 or lie above it, got a range from 0 to {high:g}"
                )
            object.__setattr__(self, name, low if low == high else (low, high))

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read contents as they are written on a command line, such as "chlorophyll=5,cdom=0.3:1";
        those that are missing are 0. ValueError if one is unknown, named twice, or has no number.
        """
        ranges: dict[str, Range] = {}
        for part in text.split(","):
            name, _, value = part.partition("=")
            name, amount = name.strip().lower(), read_range(value)
            if name not in UNITS or name in ranges or amount is None:
                expected = "a water such as chlorophyll=5,cdom=0.3,minerals=1:10"
                raise ValueError(f"expected {expected}, got {part.strip()!r:.80} in {text!r:.80}")
            ranges[name] = amount
        return cls(**ranges)

    @property
    def name(self) -> str:
        """Contents that are not 0, as `parse` reads them."""
        texts = []
        for name, value in self.amounts.items():
            ends = value if isinstance(value, tuple) else (value,)
            if any(ends):
                texts.append(f"{name}={':'.join(repr(end).removesuffix('.0') for end in ends)}")
        return ",".join(texts) or "chlorophyll=0"

    @property
    def fixed(self) -> bool:
        """True if no content has a range: one water."""
        return not self.random()

    @property
    def amounts(self) -> dict[str, Any]:
        """Amount of each content, or its range."""
        return asdict(self)

    def holds(self, amounts: Mapping[str, float]) -> bool:
        """True if a water with these amounts can be drawn."""
        ends = self._ends
        same = amounts.keys() == ends.keys()
        return same and all(low <= amounts[n] <= high for n, (low, high, _) in ends.items())


def optical_properties(amounts: Mapping[str, float]) -> Array:
    """a, b and K_d (3, N) [1/m] at `WAVELENGTHS` of a water with these amounts of contents."""
    absorption, scattering = pure_water(WAVELENGTHS.tobytes())
    a = absorption + amounts["cdom"] * CDOM + amounts["minerals"] * ABSORBED_BY_MINERALS
    by_particles = amounts["minerals"] * SCATTERED_BY_MINERALS
    chlorophyll = amounts["chlorophyll"]
    if chlorophyll > 0:
        at_1, exponents = phytoplankton()
        a += at_1 * chlorophyll**exponents
        at_660, exponent = SCATTERED_BY_PHYTOPLANKTON
        slope = min(max((math.log10(chlorophyll) - 0.3) / 2, -1.0), 0.0)
        by_particles += at_660 * chlorophyll**exponent * (WAVELENGTHS / 660) ** slope
    return np.array([a, scattering + by_particles, kd_of(a, scattering, by_particles)])


def kd_of(a: Array, by_molecules: Array, by_particles: Array) -> Array:
    """K_d [1/m] by Kirk 1984, of absorption and of scattering by molecules and particles [1/m]."""
    # molecules scatter half of the light backwards, which is lost as if it were absorbed
    loss = a + by_molecules / 2
    kd: Array = np.sqrt(loss * loss + LOST_BY_SCATTERING * loss * by_particles) / MEAN_COSINE
    return kd


@cache
def phytoplankton() -> tuple[Array, Array]:
    """Absorption, 1/m, at 1 mg/m³ of chlorophyll and its exponent, at `WAVELENGTHS` (N each)."""
    path = Path(__file__).parent / "phytoplankton.csv"
    nm, *columns = read_spectra(path, {"A": "absorption", "E": "exponent"}).values()
    at_1, exponents = (np.interp(WAVELENGTHS, nm, column) for column in columns)
    return at_1, exponents


@lru_cache(maxsize=16)
def pure_water(axis: bytes) -> Array:
    """Absorption and scattering (2, N) of pure sea water at wavelengths [nm], an array's bytes."""
    nm = np.frombuffer(axis)
    if nm[0] < 300 or nm[-1] > 800:
        raise ValueError(f"pure water is tabulated at 300–800 nm, got {nm[0]:g}–{nm[-1]:g} nm")
    table = read_spectra(Path(__file__).parent / "waters" / "pure.csv", {"a": "absorption"})
    absorption = np.interp(nm, table["wavelength"], table["a"])
    # of sea water, salinity 37: Boss & Pegau 2001, Eq. (4) and (5), over all directions
    at_90 = 1.38 * (nm / 500.0) ** -4.32 * (1 + 0.3) * 1e-4
    return np.array([absorption, 2.0 * (2.0 * math.pi * at_90 * (1 + _ANISOTROPY / 3.0))])


# scattering of water grows with it times cos² of the angle, for a depolarisation of .09
_ANISOTROPY = (1 - 0.09) / (1 + 0.09)
