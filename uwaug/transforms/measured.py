"""All that a draw may know of a picture."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.formation.development import metering_points

SAMPLED = 2048
"""Pixels of which the median distance is taken: it is right within 2 %."""


class Measured(NamedTuple):
    """All that a draw may know of a picture and its distances.

    Attributes:
        width: px.
        darkest, brightest: values, of 0…1.
        nearest, farthest, median: distances, m; the last two of all but open water, and infinite
            where there is nothing else.
        exposure: stops on which a meter has settled, for all frames of a film; None: to be metered.
        white_balance: factors of red, green and blue, likewise.
    """

    width: int
    darkest: float
    brightest: float
    nearest: float
    farthest: float
    median: float
    exposure: float | None = None
    white_balance: tuple[float, float, float] | None = None

    def of_film(self, once: Mapping[str, Any]) -> "Measured":
        """The same, with what is measured once for all frames of a film."""
        balance = once.get("white_balance")  # a list, as JSON holds it
        return self._replace(**{**once, "white_balance": balance and tuple(balance)})


def measured(pictures: Tensor, z: Tensor) -> list[Measured]:
    """What is known of pictures (Bx3xHxW) and their distances (Bx1xHxW, m): all that the host waits
    for where they are on a device.
    """
    values, metres = pictures.detach().flatten(1), z.detach().flatten(1)
    points = metering_points(z.shape[-2], z.shape[-1], z.device)[:SAMPLED]
    (darkest, brightest), (nearest, farthest) = _ends(values), _ends(metres)
    if not checks.on_host(z) or bool(farthest.isinf().any()):
        farthest = torch.where(metres.isfinite(), metres, -math.inf).amax(1).abs()
    columns = (darkest, brightest, nearest, farthest, _median(metres.index_select(1, points)))
    kind = torch.promote_types(z.dtype, torch.float32)
    rows = torch.stack([column.to(kind) for column in columns], 1).cpu().tolist()
    white = 1.0 if pictures.is_floating_point() else 255.0
    looks = []
    for i, (dark, bright, near, far, median) in enumerate(rows):
        if math.isinf(median):  # all open water, or only where it was looked
            median = float(_median(metres[i : i + 1]))
        looks.append(Measured(z.shape[-1], dark / white, bright / white, near, far, median))
    return looks


def _ends(rows: Tensor) -> tuple[Tensor, Tensor]:
    """The least and the largest value (B) of each row (BxN)."""
    if not checks.on_host(rows):
        return rows.amin(1), rows.amax(1)
    # along a dimension PyTorch takes 15 times as long on a CPU
    least, largest = zip(*(row.aminmax() for row in rows), strict=True)
    return torch.stack(least), torch.stack(largest)


def _median(metres: Tensor) -> Tensor:
    """The median (B) of each row of distances (BxN), of two in the middle the farther one; open
    water does not count, and is the median where there is nothing else.
    """
    # nanmedian takes the lesser of two
    nearness = torch.where(metres.isfinite(), -metres, math.nan)
    return -nearness.nanmedian(1).values.nan_to_num(nan=-math.inf)
