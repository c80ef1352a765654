"""All that a draw may know of a picture."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.formation.development import metering_points

SAMPLED = 2048
"""Pixels of which the median distance is taken: it is right within 2 %."""


class Measured(NamedTuple):
    """All that a draw may know of a picture, its distances and its camera.

    Attributes:
        width: px.
        darkest, brightest: values, of 0…1.
        nearest, farthest, median: distances, m; the last two of all but open water, and infinite
            where there is nothing else.
        metered: whether an exposure makes up for the light that is lost above the scene.
        lamps: whether lamps shine from places in metres, which no scene may be scaled beside.
        exposure: stops on which a meter has settled, for all frames of a film; None: to be metered.
        white_balance: factors of red, green and blue, likewise.
        moved: m by which field and snow of a film have drifted to the right.
    """

    width: int
    darkest: float
    brightest: float
    nearest: float
    farthest: float
    median: float
    metered: bool = False
    lamps: bool = False
    exposure: float | None = None
    white_balance: tuple[float, float, float] | None = None
    moved: float = 0.0

    def of_film(self, measured: Mapping[str, Any], moved: float) -> "Measured":
        """The same, with what is measured once for all frames of a film."""
        if not measured and not moved:
            return self
        balance = measured.get("white_balance")  # a list, as JSON holds it
        settled = {**measured, "white_balance": balance and tuple(balance)}
        return self._replace(**settled, moved=moved)

    def scaled(self, scale: float) -> "Measured":
        """The same scene, so many times as large."""
        if scale == 1:
            return self
        lengths = {name: getattr(self, name) * scale for name in _LENGTHS}
        return self._replace(**lengths)


_LENGTHS = ("nearest", "farthest", "median", "moved")


def measured(pictures: Tensor, z: Tensor, *, metered: bool, lamps: bool) -> list[Measured]:
    """What is known of pictures (Bx3xHxW) and their distances (Bx1xHxW, m): all that the host waits
    for where they are on a device.
    """
    points = metering_points(z.shape[-2], z.shape[-1], z.device)[:SAMPLED]
    values, metres = pictures.detach().flatten(1), z.detach().flatten(1)
    rows_of = _rows_of_host if checks.on_host(z) else _rows_of_device
    white, looks = 1.0 if pictures.is_floating_point() else 255.0, []
    for i, (darkest, brightest, nearest, farthest, median) in enumerate(
        rows_of(values, metres, points)
    ):
        if math.isinf(median):  # all open water, or only where it was looked
            median = _median(metres[i].cpu().numpy())
        ends = darkest / white, brightest / white, nearest, farthest
        looks.append(Measured(z.shape[-1], *ends, median, metered, lamps))
    return looks


def _rows_of_host(values: Tensor, metres: Tensor, points: Tensor) -> list[list[float]]:
    """Ends of values, ends and median of distances. Along a dimension PyTorch takes 15 times as
    long on a CPU as over all of a picture.
    """
    rows = []
    for picture, far in zip(values, metres, strict=True):
        nearest, farthest = checks.extent(far)
        if math.isinf(farthest):
            farthest = checks.extent(far.nan_to_num(posinf=0.0))[1] or math.inf
        median = _median(far.index_select(0, points).numpy())
        rows.append([*checks.extent(picture), nearest, farthest, median])
    return rows


def _rows_of_device(values: Tensor, metres: Tensor, points: Tensor) -> list[list[float]]:
    """The same, in one transfer."""
    solid = torch.where(metres.isfinite(), metres, -math.inf).amax(1).abs()
    some = metres.index_select(1, points).sort(1).values  # open water and NaN come last
    middle = some.isfinite().sum(1, keepdim=True) // 2
    median = some.gather(1, middle.clamp(max=some.shape[1] - 1))[:, 0]
    columns = (values.amin(1), values.amax(1), metres.amin(1), solid, median)
    kind = torch.promote_types(metres.dtype, torch.float32)
    rows: list[list[float]] = torch.stack([x.to(kind) for x in columns], 1).cpu().tolist()
    return rows


def _median(metres: Any) -> float:
    """The median of distances (N), of two in the middle the farther one; infinite if all are."""
    solid = metres[np.isfinite(metres)]
    middle = solid.size // 2
    return float(np.partition(solid, middle)[middle]) if solid.size else math.inf
