"""Water: absorption, scattering and diffuse attenuation as functions of wavelength."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from uwaug import checks
from uwaug.optics.jerlov_tables import JERLOV_TYPES, repaired_table
from uwaug.optics.spectra import Array, Spectra, spectrum, wavelength_axis

__all__ = ["CONTRAST_THRESHOLD", "JERLOV_TYPES", "Water"]

CONTRAST_THRESHOLD = 0.02
"""The contrast at which an object is no longer seen (Koschmieder 1924)."""

_SPECTRA = ("a", "b", "kd")


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Water(Spectra):
    """A water: the spectra that decide what it does to light. Immutable; equality goes by content.

    Args:
        wavelengths (N array): wavelengths [nm], strictly ascending, N ≥ 1.
        a (N array): absorption coefficient a(λ) ≥ 0 [1/m].
        b (N array): scattering coefficient b(λ) ≥ 0 [1/m].
        kd (N array): diffuse attenuation coefficient of downwelling irradiance K_d(λ) ≥ 0 [1/m].
        name: what to call it.
        provenance: where the figures come from, one short statement each.

    Attributes are the arguments, the arrays as read-only float64 copies. Between its wavelengths a
    water is linear.

    Raises:
        TypeError: if an array holds no numbers.
        ValueError: if wavelengths are not ascending nm, lengths differ, or a coefficient is
            negative, NaN or infinite.

    Examples:
        >>> a, b, kd = [1.00, 0.77, 0.72], [13.25, 10.25, 9.50], [2.0, 1.6, 1.5]
        >>> tank = Water([450, 550, 600], a, b, kd, name="tank")
        >>> tank
        Water('tank', 3 wavelengths, 450–600 nm)
        >>> round(tank.visibility(550), 3)
        0.355
    """

    wavelengths: Array
    a: Array
    b: Array
    kd: Array
    name: str
    provenance: tuple[str, ...]

    def __init__(
        self,
        wavelengths: ArrayLike,
        a: ArrayLike,
        b: ArrayLike,
        kd: ArrayLike,
        *,
        name: str = "custom",
        provenance: Sequence[str] = (),
    ) -> None:
        if isinstance(provenance, str):
            got = f"the string {provenance!r:.80}"
            raise TypeError(f"provenance must be a sequence of strings, got {got}")
        axis = wavelength_axis(wavelengths)
        vars(self).update(
            wavelengths=axis,
            a=spectrum("a", a, axis),
            b=spectrum("b", b, axis),
            kd=spectrum("kd", kd, axis),
            name=name,
            provenance=tuple(provenance),
        )

    @property
    def beta(self) -> Array:
        """Beam attenuation coefficient β = a + b [1/m]."""
        return self.a + self.b

    @classmethod
    def jerlov(cls, type: str, source: str = "solonenko2015") -> Self:
        """One of the ten Jerlov water types.

        Args:
            type: one of ``JERLOV_TYPES``; their order is Jerlov's; visibility does not fall at
                every step.
            source: ``"solonenko2015"``, a, b and K_d of all ten types at 300–700 nm; its misprinted
                rows (3C at 675 and 700 nm, 5C at 600–700 nm) take a from Williamson & Hollins 2022,
                b from the paper's own scattering model and K_d from Jerlov 1976.
                ``"williamson2022"``, measured a and b of IB to 5C at 310–700 nm, with K_d from
                Jerlov 1976.

        Returns:
            The water; ``provenance`` says for each quantity, and wavelengths that differ, where the
            values are from.

        Raises:
            ValueError: if the type or the source is unknown, or the source lacks the type.

        References:
            Solonenko and Mobley, *Inherent optical properties of Jerlov water types*, Appl. Opt. 54
                (2015), Tables 4–8.
            Williamson and Hollins, *Measured IOPs of Jerlov water types*, Appl. Opt. 61 (2022).
            Jerlov, *Marine Optics*, Elsevier (1976), Table XXVII. All as packaged by ``jerlov``.

        Examples:
            >>> water = Water.jerlov("5C")
            >>> water
            Water('5C', 17 wavelengths, 300–700 nm)
            >>> water.provenance[1][:53]
            'Jerlov 5C: a at 600–700 nm: Williamson & Hollins 2022'
        """
        table = repaired_table(type, source)
        return cls(table.wavelengths, **table.spectra, name=type, provenance=table.provenance)

    def at(self, wavelengths: ArrayLike) -> Self:
        """This water on other wavelengths, by linear interpolation.

        Args:
            wavelengths (M array): wavelengths [nm], strictly ascending, inside the range of this
                water.

        Raises:
            ValueError: if they are no such axis, or reach outside the range of the data: nothing is
                extrapolated.
        """
        axis = wavelength_axis(wavelengths)
        self._require_inside(axis[0], axis[-1])
        return type(self)(axis, **self._on(axis), name=self.name, provenance=self.provenance)

    def mix(self, other: "Water", t: float) -> Self:
        """The mixture (1 − t)·self + t·other, linear in a, b and K_d: a continuous slider between
        two waters.

        The mixture lives on the wavelengths of both, in the range that both cover, and carries both
        provenances.

        Args:
            other: the water to mix in.
            t: its share, in [0, 1].

        Raises:
            TypeError: if ``other`` is no ``Water``.
            ValueError: if t is outside [0, 1], or the two have no common wavelength range.

        Examples:
            >>> Water.jerlov("II").mix(Water.jerlov("7C"), 0.3)
            Water('0.7·II + 0.3·7C', 17 wavelengths, 300–700 nm)
        """
        checks.instance("other", other, Water, "; see Water.jerlov")
        checks.within("t", t, *checks.DOMAIN["mixing"])
        both = np.union1d(self.wavelengths, other.wavelengths)
        low = max(self.wavelengths[0], other.wavelengths[0])
        high = min(self.wavelengths[-1], other.wavelengths[-1])
        grid = both[(both >= low) & (both <= high)]
        if grid.size == 0:
            raise ValueError(f"{self} and {other} have no common wavelength to mix at")
        mine, theirs = self._on(grid), other._on(grid)
        spectra = {key: (1 - t) * mine[key] + t * theirs[key] for key in _SPECTRA}
        name = f"{1 - t:g}·{_bracketed(self.name)} + {t:g}·{_bracketed(other.name)}"
        provenance = tuple(dict.fromkeys(self.provenance + other.provenance))
        return type(self)(grid, **spectra, name=name, provenance=provenance)

    def visibility(self, wavelength: float | None = None) -> float:
        """Horizontal visibility V [m]: the distance at which contrast falls to 2 %.

        At one wavelength contrast falls as e^(−β z), so V = −ln 0.02 / β. Without a wavelength it
        is the contrast of luminance, what a diver sees: ∫ ȳ e^(−β V) dλ / ∫ ȳ dλ = 0.02 with the
        CIE 1931 observer ȳ over 400–700 nm, or what this water covers of it. A grey water has −ln
        0.02 / β either way. The best transmitted wavelength alone promises 179 m in type I and is
        the red end in 9C; a β averaged over the eye says 35 m in type I, as if red, long gone,
        still took its share. Luminance gives 78 m there, near the clearest water on record.

        Args:
            wavelength: wavelength [nm] inside the range of this water; None for what the eye sees.

        Returns:
            The visibility, inf where nothing is attenuated.

        Raises:
            ValueError: if the wavelength is outside the range, or the water has no sample range in
                400–700 nm.

        References:
            Duntley, *Light in the sea*, JOSA 53 (1963): contrast along a horizontal path falls as
                e^(−c r).
            Zaneveld and Pegau, *Robust underwater visibility parameter*, Opt. Express 11 (2003):
                photopic attenuation.

        Examples:
            >>> {t: round(Water.jerlov(t).visibility(), 1) for t in ("I", "IB", "II", "3C", "9C")}
            {'I': 78.5, 'IB': 32.6, 'II': 8.7, '3C': 3.3, '9C': 1.2}
        """
        if wavelength is None:
            nodes, eye = self._eye()
            rates = np.interp(nodes, self.wavelengths, self.beta)
            return _distance_to(CONTRAST_THRESHOLD, eye, rates)
        self._require_inside(wavelength, wavelength)
        beta = float(np.interp(wavelength, self.wavelengths, self.beta))
        return -math.log(CONTRAST_THRESHOLD) / beta if beta > 0 else math.inf

    def with_visibility(self, metres: float) -> Self:
        """The same kind of water with more or less in it, so that ``visibility()`` is ``metres``: a
        turbidity knob.

        What is dissolved and suspended is scaled by one factor s; pure sea water stays:

            a = a_w + s (a − a_w),  b = b_w + s (b − b_w),
            K_d = K_w + s (K_d − K_w),  K_w = a_w + b_w / 2.

        Scaling everything would scale pure water with it: type 9C brought to the visibility of 1C
        would absorb .06/m at 650 nm, a fifth of what pure water does, where this rule gives .345/m
        and 1C has .344/m. Where a spectrum lies below pure water (noise, or another water table),
        all of it counts as water. K_d is linear in the contents only to first order, and the hue of
        the contents stays: to change that, ``mix``.

        Args:
            metres: the visibility wanted [m], up to that of the pure water inside.

        Raises:
            ValueError: if ``metres`` is no positive number, is more than pure water allows, or
                cannot be reached because nothing but water is there to be scaled; if the spectra
                leave 300–800 nm, where the absorption of pure water is tabulated; or as
                ``visibility()``.

        References:
            a_w: Buiteveld et al. 1994, as used by Williamson and Hollins 2022. b_w: Morel 1974, as
                printed by Boss and Pegau 2001. K_w: Smith and Baker, *Optical properties of the
                clearest natural waters*, 1981.

        Examples:
            >>> round(Water.jerlov("1C").with_visibility(3).visibility(), 9)
            3.0
        """
        checks.positive("metres", metres)
        pure = self._pure()
        factor = self.contents_for(CONTRAST_THRESHOLD, metres)
        if factor == 0:
            most = f"the pure water in {self.name!r} allows, {pure.visibility():.4g} m"
            raise ValueError(f"metres={metres:g} is more than {most}")
        if math.isinf(factor):
            nothing = f"there is nothing to scale to {metres:g} m"
            raise ValueError(f"{self.name!r} is nothing but pure water: {nothing}")
        name = f"{self.name} at {metres:g} m visibility"
        scaled = self.with_contents(factor)
        provenance = (*self.provenance, f"{name}: all but pure water scaled by {factor:.4g}")
        return type(self)(self.wavelengths, **scaled._spectra(), name=name, provenance=provenance)

    def contents_for(self, contrast: float, metres: float) -> float:
        """The factor on what is in the water besides pure water, with which a share `contrast` of
        an object's contrast of luminance is left at `metres`, see `visibility`.

        Args:
            contrast: in (0, 1].
            metres: > 0; infinity leaves the water as it is.

        Returns:
            The factor; 0 where pure water alone leaves less, infinity where nothing but pure water
            is there to be scaled.
        """
        checks.within("contrast", contrast, *checks.DOMAIN["contrast"])
        if math.isinf(metres):
            return 1.0
        nodes, eye = self._eye()
        water = np.interp(nodes, self.wavelengths, self._pure().beta)
        contents = np.interp(nodes, self.wavelengths, self.beta) - water
        seen = eye * np.exp(-water * metres)
        if seen.sum() < contrast:
            return 0.0
        return _distance_to(contrast, seen, contents * metres)

    def with_contents(self, factor: float) -> Self:
        """This water with `factor` times what is in it besides pure water, see
        `with_visibility`.
        """
        checks.within("factor", factor, 0.0)
        pure, spectra = self._pure(), {}
        for key in _SPECTRA:
            whole, still = getattr(self, key), getattr(pure, key)
            spectra[key] = still + factor * (whole - still)
        name = f"{factor:.3g}·contents of {self.name}"
        return type(self)(self.wavelengths, **spectra, name=name, provenance=self.provenance)

    def _spectra(self) -> dict[str, Array]:
        return {key: getattr(self, key) for key in _SPECTRA}

    def _on(self, axis: Array) -> dict[str, Array]:
        return {key: np.interp(axis, self.wavelengths, getattr(self, key)) for key in _SPECTRA}

    def _require_inside(self, low: float, high: float) -> None:
        first, last = self.wavelengths[[0, -1]]
        if not (first <= low and high <= last):
            asked = f"{low:g} nm" if low == high else f"{low:g}–{high:g} nm"
            data = f"the data of {self.name!r}, {first:g}–{last:g} nm"
            raise ValueError(f"{asked} is outside {data}: nothing is extrapolated")

    def _eye(self) -> tuple[Array, Array]:
        """301 wavelengths (1 nm apart on a full range) and the eye's weights, whose sum is 1."""
        low, high = max(self.wavelengths[0], 400.0), min(self.wavelengths[-1], 700.0)
        if low > high:
            cure = "give visibility() a wavelength"
            raise ValueError(f"{self} has no wavelength in 400–700 nm: {cure}")
        nodes = np.linspace(low, high, 301)
        weights = np.interp(nodes, *_observer())
        return nodes, weights / weights.sum()

    def _pure(self) -> "Water":
        """The pure sea water in this water."""
        nm = self.wavelengths
        if nm[0] < 300 or nm[-1] > 800:
            cure = "resample with .at() first"
            raise ValueError(f"pure water is tabulated at 300–800 nm, but {self} leaves it: {cure}")
        absorption, scattering = _pure_water(tuple(nm.tolist()))
        a, b = np.minimum(self.a, absorption), np.minimum(self.b, scattering)
        return Water(nm, a, b, np.minimum(self.kd, a + b / 2))


def _bracketed(name: str) -> str:
    return f"({name})" if " " in name else name


@cache
def _observer() -> tuple[Array, Array]:
    """The CIE 1931 observer: wavelengths and ȳ. A transform asks for it at every picture."""
    import jerlov

    wavelengths, xyz = jerlov.cie_1931_cmf()
    return wavelengths, xyz[:, 1]


@lru_cache(maxsize=16)
def _pure_water(nm: tuple[float, ...]) -> tuple[Array, Array]:
    """Absorption and scattering of pure sea water at these wavelengths."""
    import jerlov

    return jerlov.pure_water_absorption(np.array(nm)), jerlov.pure_water_scattering(np.array(nm))


def _distance_to(contrast: float, weights: Array, rates: Array) -> float:
    """The z ≥ 0 at which Σ weights·e^(−rates·z) falls to `contrast`; inf if it never does."""
    if weights[rates == 0].sum() >= contrast:
        return math.inf
    # the logarithm of the sum is convex and falls, so Newton's steps from 0 never overshoot
    z, step = 0.0, math.inf
    while step > 1e-15 * z:
        terms = weights * np.exp(-rates * z)
        left = float(terms.sum())
        step = math.log(left / contrast) * left / float(terms @ rates)
        z += step
    return z
