"""Water: absorption, scattering and diffuse attenuation by wavelength."""

import math
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from uwaug._support import checks
from uwaug._support.codec import plain
from uwaug._support.compiled import compiled
from uwaug._support.types import Array
from uwaug.optics.constituents import (
    MAX_CONTENT,
    PLACES,
    UNITS,
    Constituents,
    kd_of,
    optical_properties,
    pure_water,
)
from uwaug.optics.jerlov import JERLOV_TYPES, repaired_table
from uwaug.optics.spectra import (
    WAVELENGTHS,
    Spectra,
    bands_between,
    read_spectra,
    spectrum,
    wavelength_axis,
)

CONTRAST_THRESHOLD = 0.02  # the contrast at which an object is no longer seen (Koschmieder 1924)

_VISIBLE_NM = (400.0, 700.0)
_RED_NM = (580.0, 800.0)  # where any water absorbs about as pure water does, or more
_LEAST_SHARE = 0.5  # of pure water's absorption there, below which a table is doubted
_BIO_OPTICAL = (
    "a, b, K_d: bio-optical model of Bricaud et al. 1998, Loisel & Morel 1998, Haltrin 1999, Babin "
    "et al. 2003 and Kirk 1984"
)
# Smallest K_d as a share of a: light that is absorbed is lost on the way down. It is below 1, as
# measured tables of two sources differ by .12 (type IB at 450 nm).
LEAST_LOSS = 0.85
_LOSS_ROUNDING = 1e-9
_EYE_NODES = 301  # 1 nm apart; with the bands of a medium type I's visibility is 7e-4 off


@plain
@dataclass(frozen=True, init=False, eq=False, repr=False)
class Water(Spectra):
    """The spectra of a water. Immutable; equality goes by content.

    Args:
        wavelengths (N array): wavelengths [nm], strictly ascending, N ≥ 1.
        a (N array): absorption coefficient a(λ) ≥ 0 [1/m].
        b (N array): scattering coefficient b(λ) ≥ 0 [1/m].
        kd (N array): diffuse attenuation coefficient of downwelling irradiance K_d(λ) ≥ 0 [1/m].
        name: shown in messages and notes.
        provenance: sources of the figures, a short statement each.

    Attributes are the arguments, the arrays as read-only float64 copies. Between its wavelengths a
    water is linear.

    Raises:
        TypeError, ValueError: if an array is no such spectrum, or K_d is less than a.

    Examples:
        >>> a, b, kd = [1.00, 0.77, 0.72], [13.25, 10.25, 9.50], [2.0, 1.6, 1.5]
        >>> tank = Water([450, 550, 600], a, b, kd, name="tank")
        >>> tank
        Water('tank', 3 wavelengths, 450–600 nm)
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
            raise TypeError(f"provenance must be a list of strings, got {provenance!r:.80}")
        axis = wavelength_axis(wavelengths)
        rates = {key: spectrum(key, x, axis) for key, x in (("a", a), ("b", b), ("kd", kd))}
        vars(self).update(wavelengths=axis, **rates, name=name, provenance=tuple(provenance))
        low = self.kd < (LEAST_LOSS - _LOSS_ROUNDING) * self.a
        if low.any():
            raise ValueError(f"kd must be a at least; it is less at {axis[low][:8].tolist()} nm")

    @property
    def beta(self) -> Array:
        """Beam attenuation coefficient β = a + b [1/m]."""
        return self.a + self.b

    @classmethod
    def jerlov(cls, type: str, source: str = "solonenko2015") -> Self:
        """One of the ten Jerlov water types.

        Args:
            type: one of ``JERLOV_TYPES``, in any case.
            source: "solonenko2015", a, b and K_d of all ten types at 300–700 nm (Appl. Opt. 54,
                Tables 4–8), whose misprinted rows are replaced, see ``provenance``. Or
                "williamson2022", measured a and b of IB to 5C at 310–700 nm (Appl. Opt. 61), with
                K_d from Jerlov, *Marine Optics*, 1976.

        Examples:
            >>> Water.jerlov("5C").provenance[1][:53]
            'Jerlov 5C: a at 600–700 nm: Williamson & Hollins 2022'
        """
        type = type.upper() if str(type).upper() in JERLOV_TYPES else type
        wavelengths, spectra, provenance = repaired_table(type, source)
        return cls(wavelengths, **spectra, name=type, provenance=provenance)

    @classmethod
    def from_constituents(cls, *, name: str | None = None, **contents: float) -> Self:
        """A water with these contents, at 400–700 nm: greens and browns that no Jerlov type has.

        Args:
            name: shown in messages and notes; None for the contents, as `load_water` reads them.
            contents: amounts up to 1e4 by the names of `uwaug.Constituents`, which says what they
                are; those missing are 0.

        Examples:
            >>> lake = Water.from_constituents(chlorophyll=12, cdom=0.8, minerals=2)
            >>> lake, round(lake.visibility(), 1)
            (Water('chlorophyll=12,cdom=0.8,minerals=2', 61 wavelengths, 400–700 nm), 1.0)
        """
        for content, amount in contents.items():
            checks.one_of("content", content, UNITS)
            checks.within(content, amount, 0.0, MAX_CONTENT)
        return cls.of_amounts(Constituents(**contents).amounts, name)

    @classmethod
    def of_amounts(cls, amounts: Mapping[str, float], name: str | None = None) -> Self:
        """As `from_constituents`, of the amounts of all contents, unchecked."""
        name = name or checks.unchecked(Constituents, **amounts).name
        water = object.__new__(cls)
        return water._derived(WAVELENGTHS, optical_properties(amounts), name, (_BIO_OPTICAL,))

    def at(self, wavelengths: ArrayLike) -> Self:
        """The same water on other wavelengths (M), nm, strictly ascending, by linear interpolation.
        ValueError where they are no such axis, or leave its range: nothing is extrapolated.
        """
        if np.array_equal(wavelengths, self.wavelengths):
            return self
        axis = wavelength_axis(wavelengths)
        (low, high), (first, last) = axis[[0, -1]], self.wavelengths[[0, -1]]
        if not (first <= low and high <= last):
            data = f"the data of {self.name!r}, {first:g}–{last:g} nm"
            raise ValueError(f"{low:g}–{high:g} nm is outside {data}: nothing is extrapolated")
        return self._derived(axis, self._table(axis), self.name, self.provenance)

    def mix(self, other: "Water", t: float) -> Self:
        """The mixture (1 − t)·self + t·other, linear in a, b and K_d, with t in 0…1.

        It has the wavelengths of both waters, in the range that both cover (ValueError if there is
        none), and both provenances.

        Examples:
            >>> Water.jerlov("II").mix(Water.jerlov("7C"), 0.3)
            Water('0.7·II + 0.3·7C', 17 wavelengths, 300–700 nm)
        """
        checks.instance("other", other, Water, "; see Water.jerlov")
        checks.within("t", t, *checks.DOMAIN["mixing"])
        if self == other:
            return self
        mine, theirs = self.wavelengths, other.wavelengths
        grid = np.union1d(mine, theirs)
        grid = grid[(grid >= max(mine[0], theirs[0])) & (grid <= min(mine[-1], theirs[-1]))]
        if not grid.size:
            raise ValueError(f"{self} and {other} have no common wavelength to mix at")
        mixture = (1 - t) * self._table(grid) + t * other._table(grid)
        names = [f"({w.name})" if " " in w.name else w.name for w in (self, other)]
        name = f"{1 - t:.2g}·{names[0]} + {t:.2g}·{names[1]}"
        provenance = tuple(dict.fromkeys(self.provenance + other.provenance))
        return self._derived(grid, mixture, name, provenance)

    def visibility(self) -> float:
        """Horizontal visibility V [m]: the distance at which contrast falls to 2 %.

        Contrast is that of luminance: ∫ ȳ e^(−β V) dλ / ∫ ȳ dλ = 0.02 with the CIE 1931 observer ȳ
        over the part of 400–700 nm that this water covers (ValueError if there is none). It is inf
        where nothing is attenuated.

        Sources: Duntley, JOSA 53 (1963); Zaneveld and Pegau, Opt. Express 11 (2003).

        Examples:
            >>> {t: round(Water.jerlov(t).visibility(), 1) for t in ("I", "IB", "II", "3C", "9C")}
            {'I': 78.5, 'IB': 32.6, 'II': 8.7, '3C': 3.3, '9C': 1.2}
        """
        return _distance_to(CONTRAST_THRESHOLD, *self._at_eye(self.beta))

    def contrast(self, metres: float) -> float:
        """Share of its luminance contrast that an object at this distance [m] keeps, 0…1: 2 % at
        the ``visibility()``.

        It is the contrast with the open water behind the object, as of a Secchi disc. That of
        patterns on an object, ``uwaug.contrast_left``, depends on depth, g and μ as well.
        """
        checks.within("metres", metres, *checks.DOMAIN["distance"])
        return self._luminance(self.beta, metres)

    def metres_for(self, contrast: float) -> float:
        """Distance [m] at which an object keeps this share, above 0, of its luminance contrast; inf
        where nothing is attenuated. The inverse of ``contrast(metres)``.
        """
        checks.positive("contrast", contrast)
        checks.within("contrast", contrast, 0.0, 1.0)
        return _distance_to(contrast, *self._at_eye(self.beta))

    def with_contrast(self, contrast: float, metres: float) -> Self:
        """The same kind of water with more or less in it, so that an object at a distance of
        ``metres`` keeps this share of its luminance contrast; .02 at 4 m is a visibility of 4 m.

        All that is dissolved and suspended is scaled by one factor s; pure sea water stays:

            a = a_w + s (a − a_w),  b = b_w + s (b − b_w),
            K_d = K_w + s (K_d − K_w),  K_w = a_w + b_w / 2.

        ValueError if ``contrast`` is more than pure water allows, or nothing but water is there to
        be scaled; if a number is not positive; if the spectra leave 300–800 nm.

        Sources: a_w: Buiteveld et al. 1994. b_w: Morel 1974. K_w: Smith and Baker 1981.

        Examples:
            >>> hazy = Water.jerlov("1C").with_contrast(0.5, metres=3)
            >>> hazy, round(hazy.contrast(3), 9)
            (Water('1C with 0.5 of the contrast at 3 m', 65 wavelengths, 300–700 nm), 0.5)
        """
        checks.positive("metres", metres)
        checks.positive("contrast", contrast)
        name = f"{self.name} with {contrast:g} of the contrast at {metres:g} m"
        fine = self._fine()
        largest = fine._luminance(fine._pure()[:2].sum(0), metres)
        if contrast > largest:
            raise ValueError(f"{name}: the pure water in it leaves {largest:.4g}")
        factor = self.contents_for(contrast, metres)
        if math.isinf(factor):
            raise ValueError(f"{name}: it is but pure water to the eye, nothing to scale")
        provenance = (*self.provenance, f"{name}: all but pure water scaled by {factor:.4g}")
        return self._scaled(factor, name, provenance)

    def contents_for(self, contrast: float, metres: float) -> float:
        """Factor s of ``with_contrast``: 0 where pure water alone leaves no more, infinity where
        nothing but pure water is there to be scaled, 1 at an infinite distance.
        """
        if math.isinf(metres):
            return 1.0
        fine = self._fine()
        pure, axis = fine._pure()[:2].sum(0), fine.wavelengths
        seen = eye(float(axis[0]), float(axis[-1]))
        return _contents_for(contrast, metres, *seen, axis, pure, fine.beta - pure)

    def daylight(self, depth: float) -> float:
        """Share of the surface's luminance that is left at a vertical depth [m]."""
        checks.within("depth", depth, *checks.DOMAIN["vertical_depth"])
        return self._luminance(self.kd, depth)

    def depth_of_daylight(self, share: float) -> float:
        """Vertical depth [m] at which this share of the surface's luminance is left."""
        checks.within("share", share, 0.0, 1.0)
        return _distance_to(share, *self._at_eye(self.kd))

    def with_contents(self, factor: float) -> Self:
        """The same water with `factor` times its contents, see `with_contrast`."""
        checks.within("factor", factor, 0.0)
        if factor == 1:
            return self
        share = f"{factor:.2g}"
        name = self.name if share == "1" else f"{share}·contents of {self.name}"
        return self._scaled(factor, name, self.provenance)

    def _at_eye(self, rates: Array) -> tuple[Array, Array]:
        """The eye's weights, whose sum is 1, and rates at its wavelengths."""
        nodes, weights = eye(float(self.wavelengths[0]), float(self.wavelengths[-1]))
        return weights, np.interp(nodes, self.wavelengths, rates)

    def _luminance(self, rates: Array, metres: float) -> float:
        weights, rates = self._at_eye(rates)
        return float(weights @ np.exp(rates * -metres))

    def _pure(self) -> Array:
        """a, b and K_d (3, N) of the pure sea water in this water."""
        absorption, scattering = pure_water(self.wavelengths.tobytes())  # an array is no key
        a, b = np.minimum(self.a, absorption), np.minimum(self.b, scattering)
        return np.array([a, b, np.minimum(self.kd, a + b / 2)])

    def _scaled(self, factor: float, name: str, provenance: tuple[str, ...]) -> Self:
        fine = self._fine()
        pure = fine._pure()
        with np.errstate(over="ignore"):
            table = pure + factor * (fine._table(fine.wavelengths) - pure)
        if not np.isfinite(table).all():
            raise ValueError(f"{name} is out of reach: it needs {factor:.4g} times its contents")
        # where K_d is below a, the difference grows with the contents
        table[2] = np.maximum(table[2], LEAST_LOSS * table[0])
        return self._derived(fine.wavelengths, table, name, provenance)

    def _fine(self) -> Self:
        # at the bands of a medium, too, between which pure water is about linear: so it makes no
        # difference whether it is scaled or taken to these bands first
        bands = bands_between(float(self.wavelengths[0]), float(self.wavelengths[-1]))
        if np.array_equal(self.wavelengths, bands):
            return self
        return self.at(np.union1d(self.wavelengths, bands))

    # without checks of spectra, which would take most of a transform's time
    def _derived(self, axis: Array, table: Array, name: str, provenance: tuple[str, ...]) -> Self:
        table.flags.writeable = False
        axis.flags.writeable = False
        rates = dict(zip(("a", "b", "kd"), table, strict=True))
        text = {"name": name, "provenance": provenance}
        return checks.unchecked(type(self), wavelengths=axis, **rates, **text)

    def _table(self, axis: Array) -> Array:
        """a, b and K_d (3, N) on an axis inside the water's range."""
        rows = [self.a, self.b, self.kd]
        if not np.array_equal(axis, self.wavelengths):
            rows = [np.interp(axis, self.wavelengths, row) for row in rows]
        return np.array(rows)


def load_water(water: "str | os.PathLike[str] | Water") -> Water:
    """Load a water by name, by its contents or from a file; a ``Water`` passes through.

    Args:
        water: a Jerlov type, "3C" or "Jerlov 3C"; a place, "reef", "harbour", "lake" or "fjord"; a
            mixture of two Jerlov types, "0.7*3C+0.3*7C"; contents such as
            "chlorophyll=5,cdom=0.3,minerals=1" (see `Water.from_constituents`); or the path of a
            CSV file (a string that ends in ``.csv``, or any path object) whose rows are wavelength
            [nm], a, b, K_d [1/m], separated by commas or semicolons, with or without one header
            line. A column c may replace b, which is c − a. Without K_d, it follows from a and
            b.

    Raises:
        TypeError, ValueError: if it is none of these, or the file no such table (with the line).

    Examples:
        >>> load_water("7c"), load_water("chlorophyll=5,cdom=0.3").name
        (Water('7C', 17 wavelengths, 300–700 nm), 'chlorophyll=5,cdom=0.3')
    """
    if isinstance(water, Water):
        return water
    if not isinstance(water, str | os.PathLike):
        raise TypeError(f"water must be a Jerlov type, a file or a uwaug.Water, got {water!r:.80}")
    if not isinstance(water, str) or water.lower().endswith(".csv"):
        return _read_csv(Path(water))
    if "*" in water:
        return _mixture(water)
    if water.lower() in PLACES:
        return Water.from_constituents(name=water.lower(), **PLACES[water.lower()])
    if "=" not in water:
        type = re.sub("^jerlov[ _-]*", "", water, flags=re.IGNORECASE)  # as sheets have it
        kinds = (*JERLOV_TYPES, *PLACES, "contents such as 'chlorophyll=5'", "a .csv file")
        checks.one_of("water", type.upper(), kinds)
        return Water.jerlov(type)
    contents = Constituents.parse(water)
    if not contents.fixed:
        raise ValueError(f"water must have one number for each content, got {water!r}")
    return Water.from_constituents(name=contents.name, **contents.amounts)


def _mixture(text: str) -> Water:
    parts = [part.partition("*")[::2] for part in text.split("+")]
    try:
        (first_share, first), (share, second) = ((float(share), name) for share, name in parts)
    except ValueError:
        first_share = share = math.nan
    if not (first_share >= 0 and share >= 0 and abs(first_share + share - 1) < 1e-6):
        expected = "two types whose shares add up to 1, such as 0.7*3C+0.3*7C"
        raise ValueError(f"water must mix {expected}, got {text!r:.80}")
    water, other = (Water.jerlov(name.strip()) for name in (first, second))
    mixture = water.mix(other, share)
    table = mixture._table(mixture.wavelengths)
    return mixture._derived(mixture.wavelengths, table, text, mixture.provenance)


def _read_csv(path: Path) -> Water:
    a, b, c, kd = ("a", "absorption"), ("b", "scattering"), ("c", "attenuation"), ("K_d", "kd")
    tables = map(dict, ((a, b, kd), (a, c, kd), (a, b), (a, c)))
    cure = "; c may stand for b = c − a, and K_d be left out. Without a and b take a Jerlov type"
    spectra = read_spectra(path, *tables, per_metre=True, cure=cure)
    sources = [f"{', '.join([*spectra][1:])}: {path.name}"]
    try:
        if "c" in spectra:
            sources.append("b: c − a")
            spectra["b"] = spectra["c"] - spectra["a"]
        if "K_d" not in spectra:
            sources.append("K_d: of a and b by Kirk 1984")
            _, molecules = pure_water(wavelength_axis(spectra["wavelength"]).tobytes())
            particles = np.maximum(spectra["b"] - molecules, 0)
            spectra["K_d"] = kd_of(spectra["a"], molecules, particles)
        columns = (spectra[name] for name in ("wavelength", "a", "b", "K_d"))
        water = Water(*columns, name=path.stem, provenance=sources)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    _doubt(water, path)
    return water


def _doubt(water: Water, path: Path) -> None:
    """Warn of a table that absorbs less than pure water does where any water absorbs as much."""
    is_red = (water.wavelengths >= _RED_NM[0]) & (water.wavelengths <= _RED_NM[1])
    if not is_red.any():
        return
    red, absorbed = water.wavelengths[is_red], water.a[is_red]
    least = pure_water(red.tobytes())[0]
    place = (absorbed / least).argmin()
    if absorbed[place] < _LEAST_SHARE * least[place]:
        given = f"a is {absorbed[place]:.3g} at {red[place]:g} nm"
        cure = "in 1/cm, times 100; of contents alone, add that of water"
        warnings.warn(f"{path}: {given}, pure water's {least[place]:.3g} 1/m: {cure}", stacklevel=4)


@compiled
def _distance_to(share: float, weights: Array, rates: Array) -> float:
    """Distance z ≥ 0 at which Σ weights·e^(−rates·z) falls to `share`; inf if it never does."""
    if (weights * (rates <= 0)).sum() >= share:
        return math.inf
    # the logarithm of the sum is convex and falls, so Newton's steps from 0 never overshoot
    fading = weights * rates
    z, step = 0.0, math.inf
    while step > 1e-15 * z:
        transmitted = np.exp(-rates * z)
        total = (weights * transmitted).sum()
        step = math.log(total / share) * total / (fading * transmitted).sum()
        z += step
    return float(max(z, 0.0))  # rounding may take the sum at 0 below the share


@compiled
def _contents_for(
    contrast: float,
    metres: float,
    nodes: Array,
    weights: Array,
    wavelengths: Array,
    pure: Array,
    contents: Array,
) -> float:
    luminance = weights * np.exp(np.interp(nodes, wavelengths, pure) * -metres)
    if luminance.sum() <= contrast:
        return 0.0
    return _distance_to(contrast, luminance, np.interp(nodes, wavelengths, contents) * metres)


@lru_cache(maxsize=16)
def eye(low: float, high: float) -> tuple[Array, Array]:
    """Wavelengths between two that the eye sees, nm, and weights by the CIE 1931 observer's ȳ."""
    if low > _VISIBLE_NM[1] or high < _VISIBLE_NM[0]:
        raise ValueError(f"water: {low:g}–{high:g} nm has no wavelength in 400–700 nm")
    nodes = np.linspace(max(low, _VISIBLE_NM[0]), min(high, _VISIBLE_NM[1]), _EYE_NODES)
    observer = read_spectra(Path(__file__).parent / "observer.csv", {"y": "luminance"})
    weights = np.interp(nodes, observer["wavelength"], observer["y"])
    return nodes, weights / weights.sum()
