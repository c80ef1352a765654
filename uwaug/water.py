"""Water: absorption, scattering and diffuse attenuation as functions of wavelength."""

import math
import re
import warnings
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

JERLOV_TYPES = ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C")
"""The Jerlov water types in the order of their classification: the open ocean, then the coast, clear to turbid."""

CONTRAST_THRESHOLD = 0.02
"""The contrast at which an object is no longer seen (Koschmieder 1924)."""

_SOURCES = {
    "solonenko2015": "Solonenko & Mobley 2015, doi:10.1364/AO.54.005392",
    "williamson2022": "Williamson & Hollins 2022, doi:10.1364/AO.470464",
}
_MISPRINT = "misprinted in Solonenko & Mobley 2015, Table 7"
_FLAGS = {
    "suspect": "suspect: disagrees with the particle concentrations of the paper's own Table 3",
    "reconstructed": f"reconstructed from Eq. (8) and Table 3 of the paper ({_MISPRINT})",
    "model_extrapolation": "extrapolated by the paper's model (measured at 412–715 nm)",
}
_REPAIRS = {"a": ("williamson2022", "Williamson & Hollins 2022"), "kd": ("jerlov1976", "Jerlov 1976, Table XXVII")}
_LABELS = {"a": "a", "b": "b", "kd": "K_d"}


class Spectra:
    """Value semantics for a frozen dataclass of arrays: compared, hashed, copied and pickled by content."""

    name: str
    wavelengths: Array

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(np.array_equal(x, y) for x, y in zip(vars(self).values(), vars(other).values(), strict=True))

    def __hash__(self) -> int:
        return hash((self.name, *self.wavelengths.tolist()))

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        # Rebuilt by the constructor, because unpickled arrays are writable.
        return partial(type(self), **vars(self)), ()

    def __repr__(self) -> str:
        low, high = self.wavelengths[[0, -1]]
        return f"{type(self).__name__}({self.name!r}, {self.wavelengths.size} wavelengths, {low:g}–{high:g} nm)"


def _frozen_array(name: str, values: ArrayLike) -> Array:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name} must be an array of numbers, got {values!r:.80}") from error
    array.flags.writeable = False
    return array


def wavelength_axis(values: ArrayLike) -> Array:
    """A read-only, strictly ascending wavelength axis in nm.

    Raises:
        TypeError: if the values are no numbers.
        ValueError: if the axis is empty, not 1-D, not strictly ascending or not in nm (100…3000).
    """
    axis = _frozen_array("wavelengths", values)
    if axis.ndim != 1 or axis.size == 0:
        raise ValueError(f"wavelengths must be 1-D with at least one sample, got shape {axis.shape}")
    if bad := np.count_nonzero(~np.isfinite(axis)):
        raise ValueError(f"wavelengths must be finite, got {bad} NaN or infinite values")
    if (drops := np.flatnonzero(np.diff(axis) <= 0)).size:
        left, right = axis[drops[0] : drops[0] + 2]
        raise ValueError(f"wavelengths must be strictly ascending, but {left:g} is followed by {right:g}: sort them")
    low, high = axis[[0, -1]]
    if not (low >= 100 and high <= 3000):
        units = (("micrometres", 1e3), ("metres", 1e9), ("ångströms", 0.1))
        hints = [f"; they look like {u}: multiply by {f:g}" for u, f in units if low * f >= 100 and high * f <= 3000]
        raise ValueError(f"wavelengths must be in nm, between 100 and 3000, got {low:g}…{high:g}{''.join(hints[:1])}")
    return axis


def spectrum(name: str, values: ArrayLike, axis: Array, channels: tuple[int, ...] = ()) -> Array:
    """A read-only spectrum ≥ 0 on a wavelength axis (N), of shape (N, *channels).

    Raises:
        TypeError: if the values are no numbers.
        ValueError: if the shape is another, or a value is NaN, infinite or negative.
    """
    array = _frozen_array(name, values)
    if array.shape != (expected := (*axis.shape, *channels)):
        raise ValueError(f"{name} must have one row per wavelength, shape {expected}, got {array.shape}")
    for bad, what, cure in (
        (~np.isfinite(array), "NaN or infinite", "fill them or leave these wavelengths out"),
        (array < 0, "negative", "set measurement noise to 0"),
    ):
        if bad.any():
            nm = axis[bad.reshape(axis.size, -1).any(axis=1)]
            where = ", ".join(f"{at:g}" for at in nm[:8]) + (", …" if nm.size > 8 else "")
            raise ValueError(f"{name} has {bad.sum()} {what} of {bad.size} values, at {where} nm: {cure}")
    return array


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

    Attributes are the arguments, the arrays as read-only float64 copies. Between its wavelengths a water is linear.

    Raises:
        TypeError: if an array holds no numbers.
        ValueError: if wavelengths are not ascending nm, lengths differ, or a coefficient is negative, NaN or infinite.

    Examples:
        >>> tank = Water([450, 550, 600], a=[1.00, 0.77, 0.72], b=[13.25, 10.25, 9.50], kd=[2.0, 1.6, 1.5], name="tank")
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
            raise TypeError(f"provenance must be a sequence of strings, got the string {provenance!r:.80}")
        axis = wavelength_axis(wavelengths)
        spectra = {key: spectrum(key, values, axis) for key, values in (("a", a), ("b", b), ("kd", kd))}
        vars(self).update(wavelengths=axis, **spectra, name=name, provenance=tuple(provenance))

    @property
    def beta(self) -> Array:
        """Beam attenuation coefficient β = a + b [1/m]."""
        return self.a + self.b

    @classmethod
    def jerlov(cls, type: str, source: str = "solonenko2015") -> Self:
        """One of the ten Jerlov water types.

        Args:
            type: one of ``JERLOV_TYPES``; their order is Jerlov's, visibility does not fall at every step of it.
            source: ``"solonenko2015"``, a, b and K_d of all ten types at 300–700 nm; its misprinted rows (3C at 675 and
                700 nm, 5C at 600–700 nm) take a from Williamson & Hollins 2022, b from the paper's own scattering
                model and K_d from Jerlov 1976. ``"williamson2022"``, measured a and b of IB to 5C at 310–700 nm, with
                K_d from Jerlov 1976.

        Returns:
            The water; ``provenance`` says for each quantity, and wavelengths that differ, where the values are from.

        Raises:
            ValueError: if the type or the source is unknown, or the source lacks the type.

        References:
            Solonenko and Mobley, *Inherent optical properties of Jerlov water types*, Appl. Opt. 54 (2015), Tables 4–8.
            Williamson and Hollins, *Measured IOPs of Jerlov water types*, Appl. Opt. 61 (2022).
            Jerlov, *Marine Optics*, Elsevier (1976), Table XXVII. All as packaged by ``jerlov``.

        Examples:
            >>> water = Water.jerlov("5C")
            >>> water
            Water('5C', 17 wavelengths, 300–700 nm)
            >>> water.provenance[1]
            'Jerlov 5C: a at 600–700 nm: Williamson & Hollins 2022 (misprinted in Solonenko & Mobley 2015, Table 7)'
        """
        import jerlov

        if source not in _SOURCES:
            raise ValueError(f"source must be one of {', '.join(_SOURCES)}, got {source!r}")
        if type not in (types := jerlov.SOURCES[source].water_types):
            raise ValueError(f"type must be one of {', '.join(types)} with source {source!r}, got {type!r}")

        grid = jerlov.water(type, source=source).wavelengths
        if source == "williamson2022":
            # The K_d to go with it was printed for 310–700 nm; what the package holds beyond is extrapolated.
            grid = grid[(grid >= 310) & (grid <= 700)]
        spectra, notes = {}, []
        for key, label in _LABELS.items():
            spectra[key], flags = _tabulated(type, source, key, grid)
            gaps = np.isnan(spectra[key])
            if not gaps.all():
                notes.append(f"{label}: {_SOURCES[source]}")
            if gaps.any():
                repair, cited = _REPAIRS[key]
                spectra[key][gaps], _ = _tabulated(type, repair, key, grid[gaps])
                flags[f"{cited} ({'not in this source' if gaps.all() else _MISPRINT})"] = grid[gaps].tolist()
            notes += [f"{label} at {min(nm):g}–{max(nm):g} nm: {_FLAGS.get(flag, flag)}" for flag, nm in flags.items()]
        return cls(grid, **spectra, name=type, provenance=[f"Jerlov {type}: {note}" for note in notes])

    def at(self, wavelengths: ArrayLike) -> Self:
        """This water on other wavelengths, by linear interpolation.

        Args:
            wavelengths (M array): wavelengths [nm], strictly ascending, inside the range of this water.

        Raises:
            ValueError: if they are no such axis, or reach outside the range of the data: nothing is extrapolated.
        """
        axis = wavelength_axis(wavelengths)
        self._require_inside(axis[0], axis[-1])
        return type(self)(axis, **self._on(axis), name=self.name, provenance=self.provenance)

    def mix(self, other: "Water", t: float) -> Self:
        """The mixture (1 − t)·self + t·other, linear in a, b and K_d: a continuous slider between two waters.

        The mixture lives on the wavelengths of both, in the range that both cover, and carries both provenances.

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
        if not isinstance(other, Water):
            raise TypeError(f"other must be a Water, such as Water.jerlov('7C'), got {other!r:.80}")
        if not 0 <= t <= 1:
            raise ValueError(f"t must be in [0, 1], the share of the other water, got {t!r}")
        both = np.union1d(self.wavelengths, other.wavelengths)
        low = max(self.wavelengths[0], other.wavelengths[0])
        high = min(self.wavelengths[-1], other.wavelengths[-1])
        grid = both[(both >= low) & (both <= high)]
        if grid.size == 0:
            raise ValueError(f"{self} and {other} have no common wavelength to mix at")
        mine, theirs = self._on(grid), other._on(grid)
        spectra = {key: (1 - t) * mine[key] + t * theirs[key] for key in mine}
        names = (f"({name})" if " " in name else name for name in (self.name, other.name))
        name = " + ".join(f"{share:g}·{part}" for share, part in zip((1 - t, t), names, strict=True))
        provenance = tuple(dict.fromkeys(self.provenance + other.provenance))
        return type(self)(grid, **spectra, name=name, provenance=provenance)

    def visibility(self, wavelength: float | None = None) -> float:
        """Horizontal visibility V [m]: the distance at which contrast falls to 2 %.

        At one wavelength contrast falls as e^(−β z), so V = −ln 0.02 / β. Without a wavelength it is the contrast of
        luminance, what a diver sees: ∫ ȳ e^(−β V) dλ / ∫ ȳ dλ = 0.02 with the CIE 1931 observer ȳ over 400–700 nm, or
        what this water covers of it. A grey water has −ln 0.02 / β either way. The best transmitted wavelength alone
        promises 179 m in type I and is the red end in 9C; a β averaged over the eye says 35 m in type I, as if red,
        long gone, still took its share. Luminance gives 78 m there, near the clearest water on record.

        Args:
            wavelength: wavelength [nm] inside the range of this water; None for what the eye sees.

        Returns:
            The visibility, inf where nothing is attenuated.

        Raises:
            ValueError: if the wavelength is outside the range, or the water has no sample range in 400–700 nm.

        References:
            Duntley, *Light in the sea*, JOSA 53 (1963): contrast along a horizontal path falls as e^(−c r).
            Zaneveld and Pegau, *Robust underwater visibility parameter*, Opt. Express 11 (2003): photopic attenuation.

        Examples:
            >>> {t: round(Water.jerlov(t).visibility(), 1) for t in ("I", "IB", "II", "3C", "9C")}
            {'I': 78.5, 'IB': 32.6, 'II': 8.7, '3C': 3.3, '9C': 1.2}
        """
        if wavelength is None:
            nodes, eye = self._eye()
            return _distance_to_threshold(eye, np.interp(nodes, self.wavelengths, self.beta))
        self._require_inside(wavelength, wavelength)
        beta = float(np.interp(wavelength, self.wavelengths, self.beta))
        return -math.log(CONTRAST_THRESHOLD) / beta if beta > 0 else math.inf

    def with_visibility(self, metres: float) -> Self:
        """The same kind of water with more or less in it, so that ``visibility()`` is ``metres``: a turbidity knob.

        What is dissolved and suspended is scaled by one factor s; pure sea water stays:

            a = a_w + s (a − a_w),  b = b_w + s (b − b_w),  K_d = K_w + s (K_d − K_w),  K_w = a_w + b_w / 2.

        Scaling everything would scale pure water with it: type 9C brought to the visibility of 1C would absorb .06/m
        at 650 nm, a fifth of what pure water does, where this rule gives .345/m and 1C has .344/m. Where a spectrum
        lies below pure water (noise, or another water table), all of it counts as water. K_d is linear in the
        contents only to first order, and the hue of the contents stays: to change that, ``mix``.

        Args:
            metres: the visibility wanted [m], up to that of the pure water inside.

        Raises:
            ValueError: if ``metres`` is no positive number, is more than pure water allows, or cannot be reached
                because nothing but water is there to be scaled; if the spectra leave 300–800 nm, where the absorption
                of pure water is tabulated; or as ``visibility()``.

        References:
            a_w: Buiteveld et al. 1994, as used by Williamson and Hollins 2022. b_w: Morel 1974, as printed by
            Boss and Pegau 2001. K_w: Smith and Baker, *Optical properties of the clearest natural waters*, 1981.

        Examples:
            >>> round(Water.jerlov("1C").with_visibility(3).visibility(), 9)
            3.0
        """
        if not (metres > 0 and math.isfinite(metres)):
            raise ValueError(f"metres must be a positive, finite visibility, got {metres!r}")
        pure = self._pure()
        nodes, eye = self._eye()
        water = np.interp(nodes, self.wavelengths, pure.beta)
        contents = np.interp(nodes, self.wavelengths, self.beta) - water
        seen = eye * np.exp(-water * metres)
        if seen.sum() < CONTRAST_THRESHOLD:
            raise ValueError(
                f"metres={metres:g} is more than the pure water in {self.name!r} allows, {pure.visibility():.4g} m"
            )
        s = _distance_to_threshold(seen, contents * metres)
        if math.isinf(s):
            raise ValueError(f"{self.name!r} is nothing but pure water: there is nothing to scale to {metres:g} m")
        spectra = {key: getattr(pure, key) + s * (getattr(self, key) - getattr(pure, key)) for key in _LABELS}
        name = f"{self.name} at {metres:g} m visibility"
        provenance = (*self.provenance, f"{name}: all but pure water scaled by {s:.4g}")
        return type(self)(self.wavelengths, **spectra, name=name, provenance=provenance)

    def _on(self, axis: Array) -> dict[str, Array]:
        return {key: np.interp(axis, self.wavelengths, getattr(self, key)) for key in _LABELS}

    def _require_inside(self, low: float, high: float) -> None:
        first, last = self.wavelengths[[0, -1]]
        if not (first <= low and high <= last):
            asked = f"{low:g} nm" if low == high else f"{low:g}–{high:g} nm"
            raise ValueError(
                f"{asked} is outside the data of {self.name!r}, {first:g}–{last:g} nm: nothing is extrapolated"
            )

    def _eye(self) -> tuple[Array, Array]:
        """301 wavelengths (1 nm on a full range) and the eye's weight of each; the weights sum to 1."""
        low, high = max(self.wavelengths[0], 400.0), min(self.wavelengths[-1], 700.0)
        if low > high:
            raise ValueError(f"{self} has no wavelength in 400–700 nm: give visibility() a wavelength")
        nodes = np.linspace(low, high, 301)
        weights = np.interp(nodes, *_observer())
        return nodes, weights / weights.sum()

    def _pure(self) -> "Water":
        """The pure sea water in this water."""
        nm = self.wavelengths
        if nm[0] < 300 or nm[-1] > 800:
            raise ValueError(f"pure water is tabulated at 300–800 nm, but {self} leaves it: resample with .at() first")
        absorption, scattering = _pure_water(tuple(nm.tolist()))
        a, b = np.minimum(self.a, absorption), np.minimum(self.b, scattering)
        return Water(nm, a, b, np.minimum(self.kd, a + b / 2))


@cache
def _observer() -> tuple[Array, Array]:
    """The CIE 1931 observer: wavelengths and ȳ. Cached, as a transform scales a water for every picture."""
    import jerlov

    wavelengths, xyz = jerlov.cie_1931_cmf()
    return wavelengths, xyz[:, 1]


@lru_cache(maxsize=16)
def _pure_water(nm: tuple[float, ...]) -> tuple[Array, Array]:
    """Absorption and scattering of pure sea water at these wavelengths."""
    import jerlov

    return jerlov.pure_water_absorption(np.array(nm)), jerlov.pure_water_scattering(np.array(nm))


def _distance_to_threshold(weights: Array, rates: Array) -> float:
    """The z ≥ 0 at which Σ weights·e^(−rates·z) falls to the contrast threshold; inf if it never does."""
    if weights[rates == 0].sum() >= CONTRAST_THRESHOLD:
        return math.inf
    # The logarithm of the sum is convex and falls, so Newton's steps from 0 never overshoot: done when they vanish.
    z, step = 0.0, math.inf
    while step > 1e-15 * z:
        terms = weights * np.exp(-rates * z)
        contrast = float(terms.sum())
        step = math.log(contrast / CONTRAST_THRESHOLD) * contrast / float(terms @ rates)
        z += step
    return z


def _tabulated(type: str, source: str, key: str, grid: Array) -> tuple[Array, dict[str, list[float]]]:
    """One quantity from the package ``jerlov``, NaN where it has none, and the wavelengths of each flag it raises."""
    import jerlov

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", jerlov.ProvenanceWarning)
        try:
            values = getattr(jerlov.water(type, source=source), key)(grid)
        except jerlov.MissingQuantityError:
            values = np.full(grid.size, np.nan)
    flags: dict[str, list[float]] = defaultdict(list)
    for warning in caught:
        for flag, nm in re.findall(r"(\w+) at ([\d.]+) nm", str(warning.message)):
            flags[flag].append(float(nm))
    flags.pop("missing", None)
    return values, flags
