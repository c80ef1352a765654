"""Tables for the compiled loops: plans for pictures of one size, media and lamps as arrays."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from uwaug._support.cache import Cache
from uwaug._support.types import Array
from uwaug.blur.banded import Kind, Node, mirrored, whole
from uwaug.blur.kernels import HALVING, blur_kernel
from uwaug.blur.plan import V_FLOOR, BlurPlan, place_line
from uwaug.light.backscatter import ASYMMETRY, NODE_WEIGHTS, NODES
from uwaug.light.direction import MAX_RISE, RISE
from uwaug.light.light import LAMP_RADIUS_M, Light
from uwaug.optics.medium import Medium
from uwaug.optics.view import Size, View
from uwaug.optics.weights import Weights

Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Indices = NDArray[np.int64]


class CoarseTable(NamedTuple):
    """One coarse grid of h cells by w, for pictures of HxW."""

    rows: Indices  # of the half picture, mirrored, from as many before the first as cells need
    down_first: Indices  # (h) place in `rows` of the first for each cell
    down: Floats  # (h, taps) weights
    columns: Indices  # this and the next three: the same along rows
    column_margin: int  # columns before the first
    across_first: Indices
    across: Floats
    back_first: Indices  # (W) the first cell of each column
    back: Floats  # (W, 4) weights
    row_first: Indices  # (H) the first cell of each row
    row_back: Floats  # (H, 4)


class StackTable(NamedTuple):
    """All blurs of a plan, sharp first, then narrow, then those on coarse grids."""

    series: Floats  # (K, N) weights of the blurs, as Chebyshev series
    taps: Floats  # (n, reach + 1) middle weight and one half of each narrow blur
    pairs: Indices  # (n) how many weights of each half are used, an even number
    rows: Indices  # in the picture, mirrored, from as many before the first as taps reach
    columns: Indices
    back_first: Indices  # (m, H) the first cell of each row on each grid
    back: Floats  # (m, H, 4) weights


class PlanTable(NamedTuple):
    """A plan for pictures of one size."""

    stack: StackTable
    half_rows: Indices  # in the picture, mirrored, from as many before the first as halving needs
    half_columns: Indices
    coarse: tuple[CoarseTable, ...]
    line: tuple[float, float]  # slope and offset of places, see `place_line`


class DistanceTable(NamedTuple):
    """N functions of the distance, tabulated 128 times in each octave, linear between."""

    first: np.int32  # bits of the first distance, m, in single precision
    rows: Floats  # (NxE, or Nx0) values at E distances


_NOTHING = DistanceTable(np.int32(0), np.zeros((1, 0), np.float32))


class DevelopmentTable(NamedTuple):
    """A development, see `uwaug.formation.development`."""

    dark: np.float32  # variance of the sensor's noise at light 0
    photons: np.float32  # its growth with light
    gain: Floats  # (9) matrix that acts after the noise
    gamut: np.float32  # share of the compression
    tone: np.float32  # exponent of the curve
    tone_offset: np.float32


class MediumTable(NamedTuple):
    """A medium as the loops take it; nine weights are three channels of the scene for each of the
    picture.
    """

    rates: Floats  # (K + L) times −log2(e), those of the direct term first
    direct: Floats  # (9, K) weights
    signal: Floats  # (9, L)
    veil: Floats  # (3, L) for e^−x − 1


class LampsTable(NamedTuple):
    """N lamps as the loops take them; none for daylight. See `uwaug.light`."""

    # (N, 9) position, axis of length 1, cosines of the angles at which the light begins to fade and
    # has faded, and 1 if it shines to all sides
    places: Floats
    radius: np.float32  # square of a lamp's radius, m²
    asymmetry: np.float32  # g of the phase function
    nodes: Floats  # (2, Q) nodes and weights of the quadrature along a ray
    rates: Floats  # (R) times −log2(e)
    arriving: Floats  # (N, 9, R) weights of the light from surfaces
    fog: Floats  # (N, 3, R) and from water
    straight_rates: Floats  # (K) of T_β, times −log2(e)
    # Weights of T_β (S, K) and T_G (S, R), whose ratio is the share of light that comes straight: S
    # is 3, or 1 if all channels share it.
    straight: Floats
    signal: Floats


class WaterTable(NamedTuple):
    """All that weakens or sends light before one picture."""

    medium: MediumTable
    further: DistanceTable
    lamps: LampsTable


class RaysTable(NamedTuple):
    """Rays of a picture, and the direction of its daylight, see `uwaug.light.direction`."""

    middle: Floats  # (2) column and row of the camera's axis
    tangent: np.float32  # of the angle of a pixel there
    directed: bool  # True if the veil depends on the elevation of a ray
    sine: np.float32  # of the elevation of the axis
    cosine: np.float32
    rise: np.float32  # this and the next: constants of the factor
    most: np.float32


# ------------------------------------------------------------------------------ plans

_GRIDS: Cache[CoarseTable] = Cache(32 * 2**20)  # 8 MiB or so for each size in random water


@lru_cache(maxsize=128)  # default draws need 50 to 70 for each size, of 80 kB at 512²
def plan_table(plan: BlurPlan, size: Size) -> PlanTable:
    """The table of a plan for pictures of (height, width) `size`."""
    height, width = size
    order = sorted(range(len(plan.sigmas)), key=lambda k: (plan.cells[k] != 1, plan.sigmas[k] > 0))
    nodes = [Node(plan.sigmas[k], plan.cells[k], plan.reach) for k in order]
    narrow = [node for node in nodes if node.cell == 1 and node.sigma > 0]
    wide = [node for node in nodes if node.cell != 1]
    taps = _taps(narrow)
    margin = taps.shape[1] - 1
    grids = [_grid(node, size) for node in wide]
    # the loops take series of 4, 6, … terms
    series = np.array([plan.coefficients[k] for k in order], np.float32)
    terms = series.shape[1]
    series = np.pad(series, ((0, 0), (0, max(4, terms + terms % 2) - terms)))
    stack = StackTable(
        series=series,
        taps=taps,
        pairs=np.array([_pairs(node) for node in narrow], np.int64),
        rows=_mirrored(margin, 2 * height),
        columns=_mirrored(margin, 2 * width),
        back_first=np.array([grid.row_first for grid in grids], np.int64).reshape(-1, height),
        back=np.array([grid.row_back for grid in grids], np.float32).reshape(-1, height, 4),
    )
    rows, columns = (_mirrored(len(HALVING) // 2, 2 * side) for side in size)
    return PlanTable(stack, rows, columns, tuple(grids), place_line(plan))


def _grid(node: Node, size: Size) -> CoarseTable:
    """A blur on a coarse grid for pictures of one size."""
    grid = _GRIDS.get((node, size))
    if grid is None:
        rows, _, first, down = _shrinking(node, size[0])
        backs = (*_rows_of("enlarge", node, size[1]), *_rows_of("enlarge", node, size[0]))
        grid = CoarseTable(rows, first, down, *_shrinking(node, size[1]), *backs)
        _GRIDS.put((node, size), grid, sum(np.asarray(value).nbytes for value in grid))
    return grid


def _pairs(node: Node) -> int:
    """Pairs of taps beside the middle one; even, as the loops add two at a time."""
    return max(2, 2 * math.ceil(math.ceil(node.reach * node.sigma) / 2))


def _taps(nodes: list[Node]) -> Floats:
    """Middle weight and one half of each kernel, with zeros after it."""
    widest = max(map(_pairs, nodes), default=2)
    taps = np.zeros((len(nodes), widest + 1), np.float32)
    for row, node in zip(taps, nodes, strict=True):
        kernel = blur_kernel(node.sigma, node.reach)[0].numpy()
        half = kernel[len(kernel) // 2 :]
        row[: len(half)] = half
    return taps


def _shrinking(node: Node, size: int) -> tuple[Indices, int, Indices, Floats]:
    """Mirrored places of an axis, and how many of them lie before it; for each cell the first of
    its places, and the weights.
    """
    first, weights = _rows_of("shrink", node, size)
    margin = max(0, -int(first.min()), int(first.max()) + weights.shape[1] - -(-size // 2))
    return _mirrored(margin, size), margin, first + margin, weights


def _rows_of(kind: Kind, node: Node, size: int) -> tuple[Indices, Floats]:
    """First column and weights of every row of a matrix, folded at the ends; 4, 8, … weights."""
    matrix = whole(kind, size, node)
    kernels = matrix.kernels
    if 0 < matrix.turn < 2 * kernels.taps:
        first, dense = matrix.slab(0, matrix.rows)
        dense = np.pad(dense, ((0, 0), (0, -dense.shape[1] % 4)))
        return np.full(matrix.rows, first), dense.astype(np.float32)
    place = (np.arange(matrix.rows) - kernels.shift) % len(kernels.first)
    weights = np.pad(kernels.weights, ((0, 0), (0, -kernels.taps % 4)))[place]
    return kernels.starts(0, matrix.rows), weights.astype(np.float32)


def _mirrored(margin: int, turn: int) -> Indices:
    """Places on an axis, see `mirrored`, and `margin` more at both ends."""
    return mirrored(np.arange(-margin, (turn + 1) // 2 + margin), turn)


# ------------------------------------------------------------------------------ media

# Last bits of a distance in single precision, which lie between two entries of a table; the others
# are the entry. With 128 entries in an octave pictures are right within 1e-6. (Other tables:
# benchmarks/CHOICES.md, loops.)
ENTRY_BITS = 16
_AT_LENS = torch.zeros(1, 1, 1, 1)
_MIN_DISTANCE = 1e-6  # m, and share of the farthest distance: stands for 0, which has no logarithm


def medium_table(media: Weights, n: int) -> MediumTable:
    """The table of one of several media."""
    beta, direct, G, signal, veil = [values[n].astype(np.float32) for values in media[:5]]
    rates = np.concatenate((beta, G)) * np.float32(-math.log2(math.e))
    return MediumTable(rates, direct, signal, -veil)


def places_table(
    row: Weights, plan: BlurPlan, line: tuple[float, float], ends: tuple[float, float]
) -> DistanceTable:
    """Places (−1…1) of the blur's widths, px, in a plan; without entries if it has one width."""
    if len(plan.sigmas) == 1:
        return _NOTHING
    slope, offset = line

    def places(z: Array) -> Array:
        x = row.widths(z) / V_FLOOR
        x = x if plan.shape == "exponential" else V_FLOOR * x * x
        return slope * np.log1p(x) + offset

    return _tabulated(places, ends)


def terms_table(medium: Medium, z: Floats) -> DistanceTable:
    """Light (3) of a medium's further terms by distance; without entries if there are none."""
    if not medium.further_terms(_AT_LENS):
        return _NOTHING

    def light(z: Array) -> Array:
        at, total = torch.from_numpy(z)[None, None, None], np.zeros((3, len(z)))
        for term in medium.to(at).further_terms(at).values():
            total += term.detach().expand(1, 3, 1, len(z))[0, :, 0].numpy()
        return total

    return _tabulated(light, (float(z.min()), float(z.max())))


def _tabulated(function: Callable[[Array], Array], ends: tuple[float, float]) -> DistanceTable:
    """The table of a function of distances (E), between two ends, m, to values (E) or (N, E)."""
    low = max(ends[0], _MIN_DISTANCE * ends[1], _MIN_DISTANCE)
    high = max(ends[1], _MIN_DISTANCE)
    first, last = np.array([low, high], np.float32).view(np.int32) >> ENTRY_BITS
    entries = np.arange(first, last + 2, dtype=np.int32) << ENTRY_BITS
    rows = np.atleast_2d(function(entries.view(np.float32).astype(np.float64)))
    return DistanceTable(entries[0], rows.astype(np.float32))


def lamps_table(light: Light | None, row: Weights) -> LampsTable:
    """The table of lamps over a water of one row, from `uwaug.Medium.under_lamp`."""
    if light is None or not light.lamps:
        return _NO_LAMPS
    colours = [np.diag(lamp.power * np.array(lamp.color)) for lamp in light.lamps]
    of_lamps = [row.brightened(colour[None]) for colour in colours]
    # one share for each channel; for surfaces with spectra, one for all
    straight, signal = (x.reshape(3, 3, -1).sum(1) for x in (row.direct, row.signal))
    if row.signal[0].reshape(3, 3, -1)[~np.eye(3, dtype=bool)].any():  # channels mix
        straight, signal = straight.sum(0, keepdims=True), signal.sum(0, keepdims=True)
    places = [(*lamp.position, *lamp.axis, *lamp.fade, lamp.cone is None) for lamp in light.lamps]
    return LampsTable(
        places=_floats(places),
        radius=np.float32(LAMP_RADIUS_M**2),
        asymmetry=np.float32(ASYMMETRY),
        nodes=_floats([NODES, NODE_WEIGHTS]),
        rates=_floats(-math.log2(math.e) * row.G[0]),
        arriving=_floats([weights.signal[0] for weights in of_lamps]),
        fog=_floats([weights.veil[0] for weights in of_lamps]),
        straight_rates=_floats(-math.log2(math.e) * row.beta[0]),
        straight=_floats(straight),
        signal=_floats(signal),
    )


def _floats(values: Any) -> Floats:
    return np.ascontiguousarray(values, np.float32)


def rays_tables(view: View, light: Light | None, size: Size) -> list[RaysTable]:
    """Tables of the rays of pictures of one size: one, or one for each pitch."""
    middle, tangent = _floats(view.middle(size)), np.float32(1 / view.focal(size[1]))
    rise, most = np.float32(RISE), np.float32(MAX_RISE)
    pitch = None if light is None else light.pitch
    if pitch is None:
        return [RaysTable(middle, tangent, False, _0, _0, rise, most)]
    pitches = pitch.detach().flatten().tolist() if isinstance(pitch, torch.Tensor) else [pitch]
    tables = []
    for angle in map(math.radians, pitches):
        sine, cosine = np.float32(math.sin(angle)), np.float32(math.cos(angle))
        tables.append(RaysTable(middle, tangent, True, sine, cosine, rise, most))
    return tables


_NONE = [np.zeros((0,) * axes, np.float32) for axes in range(4)]
_0 = np.float32(0)
_NO_LAMPS = LampsTable._make([_NONE[2], _0, _0, *[_NONE[n] for n in (2, 1, 3, 3, 1, 2, 2)]])
