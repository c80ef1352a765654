"""Cameras: how strongly red, green and blue respond to each wavelength."""

import ast
import csv
import importlib.util
import os
import re
import unicodedata
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uwaug._support.atomic import require_regular
from uwaug._support.types import Array
from uwaug.optics.spectra import Spectra, spectrum, wavelength_axis

__all__ = ["Camera", "load_camera", "response_at"]

_CHANNELS = ("red", "green", "blue")
_DATASET = Path("characterisation", "datasets", "cameras", "dslr", "sensitivities.py")
_NO_TABLE = "not a table of numbers"
_FIGURES = re.compile(r"[-+.,;:eE\d\s]{0,80}")
_HEADING = re.compile(r"[-+.\d\s]*|[^\W\d]{1,12}([ _][\w().%/]{1,8})?")
_TABLE = "DATA_CAMERA_SENSITIVITIES_DSLR"


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Camera(Spectra):
    """The spectral response of a camera. Immutable; equality goes by content.

    Args:
        wavelengths (N array): wavelengths [nm], strictly ascending, N ≥ 1.
        response (N×3 array): response of R, G, B ≥ 0 to equal power, on any common scale.
        name: what to call it.

    Attributes are the arguments, the arrays as read-only float64 copies. Between its wavelengths a
    response is linear.

    Raises:
        TypeError: if an array holds no numbers.
        ValueError: if wavelengths are not ascending nm, the response has another shape, is
            negative, NaN or infinite, or a channel responds to nothing.

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

    def at(self, wavelengths: ArrayLike) -> Array:
        """The response at other wavelengths (M, 3), by linear interpolation; 0 outside the range of
        the data.

        Args:
            wavelengths (M array): wavelengths [nm], strictly ascending.
        """
        axis = wavelength_axis(wavelengths)
        responses = np.empty((axis.size, 3))
        for channel, response in enumerate(self.response.T):
            responses[:, channel] = np.interp(axis, self.wavelengths, response, left=0, right=0)
        return responses

    def weights(self, wavelengths: ArrayLike) -> Array:
        """Quadrature weights: ∫ S_c(λ) f(λ) dλ ≈ Σ_i weights[i, c] f(λ_i), with ∫ S_c = 1.

        The rectangle rule: each sample stands for half the way to either neighbour, the first and
        last for a whole step (``numpy.gradient``). On a uniform grid the weights are the normalised
        samples.

        Args:
            wavelengths (M array): wavelengths [nm], strictly ascending.

        Returns:
            Weights (M, 3) ≥ 0; each column sums to 1.

        Raises:
            ValueError: if a channel has no response on these wavelengths.

        Examples:
            >>> camera = Camera([400, 700], [[0, 1, 1], [1, 1, 0]])
            >>> camera.weights([400, 500, 700]).round(3).tolist()
            [[0.0, 0.222, 0.5], [0.2, 0.333, 0.5], [0.8, 0.444, 0.0]]
        """
        axis = wavelength_axis(wavelengths)
        values = self.at(axis)
        _require_response(values, f"camera {self.name!r} on {axis[0]:g}–{axis[-1]:g} nm")
        areas = values * np.gradient(axis)[:, None] if axis.size > 1 else values
        return np.asarray(areas / areas.sum(axis=0))


def load_camera(camera: "str | os.PathLike[str] | Camera") -> Camera:
    """A camera by name or from a file; a ``Camera`` passes through.

    Args:
        camera: a name in colour-science's ``MSDS_CAMERA_SENSITIVITIES``, upper and lower case,
            accents, blanks and punctuation aside; or the path of a CSV file (a string that ends in
            ``.csv``, or any path object) whose rows are wavelength [nm], R, G, B, separated by
            commas, with or without one header line.

    Raises:
        TypeError: if ``camera`` is none of these.
        ValueError: if the name is unknown, or the file is no such table; the message names the
            line.
        OSError: if the file cannot be read.

    References:
        The named cameras: Darrodi et al., *Reference data set for camera spectral sensitivity
            estimation*, JOSA A 32 (2015), measured at NPL, as packaged by colour-science
            (BSD-3-Clause).

    Examples:
        >>> load_camera("nikon 5100 (npl)")
        Camera('Nikon 5100 (NPL)', 81 wavelengths, 380–780 nm)
    """
    if isinstance(camera, Camera):
        return camera
    if not isinstance(camera, str | os.PathLike):
        raise TypeError(
            f"camera must be a name, the path of a CSV file or a Camera, got {camera!r:.80}"
        )
    if not isinstance(camera, str) or camera.lower().endswith(".csv"):
        return _read_csv(Path(camera))
    known = _colour_science_cameras()
    for name, entry in known.items():
        if _plain(name) == _plain(camera):
            return entry
    names = ", ".join(map(repr, known))
    raise ValueError(
        f"no camera is called {camera!r}; there are {names}, or give the path of a .csv file"
    )


@lru_cache(maxsize=16)
def response_at(camera: Camera, axis: bytes) -> Array:
    """The camera's weights (3, N) at wavelengths, given as the bytes of their array; rows sum to
    1.
    """
    return camera.weights(np.frombuffer(axis)).T


def _require_response(values: Array, whose: str) -> None:
    peaks = dict(zip(_CHANNELS, values.max(axis=0), strict=True))
    dark = [channel for channel, peak in peaks.items() if peak == 0]
    if dark:
        raise ValueError(f"{whose} has no response in {' and '.join(dark)}")


def _plain(name: str) -> str:
    decomposed = unicodedata.normalize("NFKD", name).casefold()
    return "".join(filter(str.isalnum, decomposed))


@cache
def _colour_science_cameras() -> dict[str, Camera]:
    # `import colour` takes .6 s after torch, loads 1100 modules (SciPy, matplotlib) and sets
    # NumPy's print options for the whole process. Its camera table is a literal: read from the
    # source file it takes 2 to 10 ms.
    spec = importlib.util.find_spec("colour")
    for root in (spec and spec.submodule_search_locations) or ():
        source = Path(root) / _DATASET
        tables = _literal(source, _TABLE) if source.is_file() else None
        if tables is not None:
            return {name: Camera(list(t), list(t.values()), name) for name, t in tables.items()}

    with np.printoptions():  # a release that keeps the table elsewhere
        import colour

    cameras = colour.MSDS_CAMERA_SENSITIVITIES
    return {name: Camera(c.wavelengths, c.values, name) for name, c in cameras.items()}


def _literal(source: Path, name: str) -> Any:
    """The value of an annotated literal in a source file; None if it has no such name."""
    for node in ast.parse(source.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.AnnAssign) and node.value and ast.unparse(node.target) == name:
            return ast.literal_eval(node.value)
    return None


def _read_csv(path: Path) -> Camera:
    require_regular(path)
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        reader = csv.reader(file)
        try:
            table = _table(reader, path)
        except csv.Error as error:
            raise ValueError(f"{path}, line {reader.line_num}: {_NO_TABLE}: {error}") from None
    if not table:
        raise ValueError(f"{path}: no rows of wavelength, R, G, B")
    values = np.array(table)
    try:
        return Camera(values[:, 0], values[:, 1:], path.stem)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _table(reader: Any, path: Path) -> list[list[float]]:
    table: list[list[float]] = []
    first = True
    for row in reader:
        if not any(cell.strip() for cell in row):
            continue
        numbers = _numbers(row, f"{path}, line {reader.line_num}", header=first)
        table += [numbers] if numbers else []
        first = False
    return table


def _numbers(row: list[str], where: str, *, header: bool) -> list[float]:
    """The four numbers of a row; none if it is the header, where there may be one."""
    if len(row) != 4:
        expected = "wavelength, R, G, B separated by commas"
        raise ValueError(f"{where}: expected {expected}, got {_quoted(row)}")
    try:
        return [float(cell) for cell in row]
    except ValueError:
        if not header:
            raise ValueError(f"{where}: expected four numbers, got {_quoted(row)}") from None
    if [cell.strip()[:1].lower() for cell in row[1:]] != ["r", "g", "b"]:
        raise ValueError(f"{where}: columns must be wavelength, R, G, B, not {_quoted(row)}")
    return []


def _quoted(row: list[str]) -> str:
    """A row as a message may show it. What is neither numbers nor a header is not shown: the path
    may come from a preset of somebody else, and name a file that is none of theirs.
    """
    figures = all(_FIGURES.fullmatch(cell) for cell in row)
    header = len(row) == 4 and all(_HEADING.fullmatch(cell) for cell in row)
    return f"{row!r:.80}" if figures or header else f"a line that is {_NO_TABLE}"
