"""`VeilFit`: a veil that was estimated from pictures alone."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import Array
from uwaug.fitting.report import NORMAL, THIN, VAGUE, Parameter, errors_of, not_identified, table
from uwaug.fitting.structure import COLOURS
from uwaug.optics.medium import Medium

__all__ = ["VeilFit", "veil_found"]

_CLEAR = 1.0
"""Optical depth G·z at the far end, below which surfaces that are not quite black bend a veil as
much as its end does.
"""


@dataclass(frozen=True, eq=False)
class VeilFit:
    """A veil that was estimated from pictures alone; made by `uwaug.fitting.fit_veil`.

    Attributes:
        parameters: each number by name: value, standard error, 95 % interval, unit, state. veil,
            V(0); G [1/m]; source, the growth of the veil at the lens, G·V(0) [1/m]; of each colour.
        medium: the veil as a water. That the direct light fades as the veil does, β = G, is
            assumed: pictures without a clean one do not tell.
        message: in words: that it is an estimate, and what the pictures cannot tell.
        farthest: distance that the veil is seen to, m; infinity if there is open water.
    """

    parameters: dict[str, Parameter]
    medium: Medium
    message: str
    farthest: float

    @property
    def veil(self) -> Tensor:
        """V(0) of each channel (3); NaN where it is not identified."""
        return self._values("veil")

    @property
    def G(self) -> Tensor:
        """Of each channel (3), 1/m; NaN where it is not identified."""
        return self._values("G")

    @property
    def source(self) -> Tensor:
        """Growth of the veil at the lens, of each channel (3), 1/m."""
        return self._values("source")

    @property
    def errors(self) -> dict[str, float]:
        """The standard errors that are known, by name."""
        return errors_of(self.parameters)

    def _values(self, kind: str) -> Tensor:
        known = []
        for colour in COLOURS:
            value = self.parameters[f"{kind}_{colour}"].value
            known.append(np.nan if value is None else value)
        return torch.tensor(known, dtype=torch.float64)

    def backscatter(self, z: Tensor) -> Tensor:
        """The veil in front of points at these distances, m; shapes as of `Medium.backscatter`.

        It is known where V(0) and G are not, as far as `farthest`.
        """
        return self.medium.backscatter(z)

    def summary(self) -> str:
        """The estimate as text: verdict and numbers."""
        return f"{self.message}\n\n{table(self.parameters)}"

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        shown = ", ".join("?" if one.isnan() else f"{float(one):.3g}" for one in self.veil)
        return f"VeilFit(V(0) = {shown})"


def veil_found(numbers: Array, repeats: Array, ways: Array, farthest: float) -> VeilFit:
    """What is reported.

    Args:
        numbers (3x2): source and G of each channel.
        repeats (Rx3x2): the same of R draws of blocks.
        ways (2x3x2): the same of two other ways to count what lies above the curve.
        farthest: distance that the veil is seen to, m.
    """
    values, drawn, others = _kinds(numbers), _kinds(repeats), _kinds(ways)
    G = values["G"]
    parameters = {}
    for kind, value in values.items():
        error = np.hypot(drawn[kind].std(0), 0.5 * np.ptp(others[kind], 0))
        for c, colour in enumerate(COLOURS):
            straight = kind != "source" and G[c] * farthest < THIN
            parameter = _parameter(kind, float(value[c]), float(error[c]), straight=straight)
            parameters[f"{kind}_{colour}"] = parameter
    return VeilFit(
        parameters=parameters,
        medium=Medium.from_coefficients(list(G), list(G), list(values["veil"])),
        message=_message(parameters, G, farthest),
        farthest=farthest,
    )


def _kinds(numbers: Array) -> dict[str, Array]:
    """What is reported, by kind, from source and G in the last place."""
    source, G = numbers[..., 0], numbers[..., 1]
    return {"veil": source / G, "G": G, "source": source}


def _parameter(kind: str, value: float, error: float, *, straight: bool) -> Parameter:
    unit = "1" if kind == "veil" else "1/m"
    if straight or not error <= max(VAGUE * value, 1e-6):
        return not_identified(unit)
    low, high = max(value - NORMAL * error, 0.0), value + NORMAL * error
    return Parameter(value, error, low, high, unit, "free")


def _message(parameters: dict[str, Parameter], G: Array, farthest: float) -> str:
    lines = [
        "An estimate: the darkest pixels at each distance are taken for black. What their surfaces "
        "reflect counts as veil, and is hardly part of the errors."
    ]
    clear = []
    for c, colour in enumerate(COLOURS):
        if parameters[f"veil_{colour}"].state != "not identified":
            if G[c] * farthest < _CLEAR:
                clear.append(colour)
        elif G[c] * farthest < THIN:
            lines.append(
                f"Not identified: veil and G of {colour}. The veil still grows as a straight line "
                f"at {farthest:.3g} m: its growth (source) is seen, where it ends is not."
            )
        else:
            lines.append(f"Not identified: veil of {colour}. Its error is more than half of it.")
    if clear:
        lines.append(
            f"In {', '.join(clear)} the veil is far from its end at {farthest:.3g} m: V(0) may be "
            "off by half, and G more; up to there the veil itself (backscatter) is better known."
        )
    return "\n".join(lines)
