"""A light on a large picture, a band of rows after the other: each is a picture whose centre lies
elsewhere.
"""

from collections.abc import Sequence

from torch import Tensor

from uwaug._support.tiles import RowSource, row_bands, rows_of
from uwaug.light.geometry import HALO
from uwaug.light.light import Light
from uwaug.light.lit import Lit, lit_of
from uwaug.optics.curves import Curves, Sums
from uwaug.optics.medium import Medium


class BandedLight:
    """A light on a large picture, as `Lit` is one on a picture that is held.

    Args:
        light: what shines.
        maps: distance (m), and the field if there is one.
        medium: the water.
        focal_px, centre: of the camera, px.
        gain: of the exposure, where it is known.
    """

    def __init__(
        self,
        light: Light,
        maps: Sequence[Tensor | RowSource],
        medium: Medium,
        focal_px: float | None,
        centre: tuple[float, float] | None,
        gain: Tensor | None = None,
    ) -> None:
        self.light, self.maps, self.medium = light, maps, medium
        self.focal_px, self.gain = focal_px, gain
        height, width = maps[0].shape[-2:]
        self.size = height, width
        self.centre = centre or ((width - 1) / 2, (height - 1) / 2)
        self._last: tuple[slice, Lit] | None = None

    def brightened(self, gain: Tensor) -> "BandedLight":
        """The light as a camera of this gain sees it."""
        return BandedLight(self.light, self.maps, self.medium, self.focal_px, self.centre, gain)

    def part(self, rows: slice, columns: slice) -> Lit:
        """The light on some rows and columns."""
        band, lit = self._band(rows)
        return lit.part(slice(rows.start - band.start, rows.stop - band.start), columns)

    def curves_at(self, points: Tensor, z: Tensor, sums: Sums) -> Curves:
        """What reaches the camera at some pixels (N) of effective distances z (1x1x1xN)."""
        height, width = self.size
        row = points // width
        T: Curves | None = None
        for start, stop in row_bands(height, width):
            inside = (row >= start) & (row < stop)
            if not bool(inside.any()):
                continue
            band, lit = self._band(slice(start, stop))
            here = lit.at(points[inside] - band.start * width).curves(sums, z[..., inside])
            if T is None:
                T = Curves(*(z.new_empty(*part.shape[:-1], len(points)) for part in here))
            for whole, part in zip(T, here, strict=True):
                whole[..., inside] = part
        assert T is not None
        return T

    def _band(self, rows: slice) -> tuple[slice, Lit]:
        """The rows of a band that holds these and what their normals rest on, and its light."""
        least = slice(max(rows.start - HALO, 0), min(rows.stop + HALO, self.size[0]))
        if self._last is not None:
            band, lit = self._last
            if band.start <= least.start and least.stop <= band.stop:
                return band, lit
        (_, step), *_ = row_bands(*self.size)
        stop = min(max(least.stop, least.start + step), self.size[0])
        band = slice(least.start, stop)
        distance, *field = (rows_of(x)(band.start, band.stop)[None] for x in self.maps)
        column, row = self.centre
        centre = column, row - band.start
        factor = field[0] if field else None
        here = lit_of(self.light, distance, factor, self.medium, self.focal_px, centre)
        assert here is not None
        self._last = band, here if self.gain is None else here.brightened(self.gain)
        return self._last
