"""`WaterFit`: the Jerlov water that was recovered from pictures."""

from dataclasses import dataclass
from typing import NamedTuple

from uwaug.fitting.noise import Noise
from uwaug.fitting.report import Parameter, errors_of, table
from uwaug.optics.medium import Medium
from uwaug.optics.water import Water

__all__ = ["JerlovType", "WaterFit"]


class JerlovType(NamedTuple):
    """A type, or a mixture of two, that was tried.

    Attributes:
        name: of the type; of a mixture, as "II + III".
        visibility: of what was fitted, m.
        vertical_depth: m.
        error: root of the mean held-out loss, in standard deviations of the noise.
        behind: how far the summed held-out loss lies behind the least.
        behind_error: standard error of that.
        told_apart: whether it lies more than one standard error behind.
    """

    name: str
    visibility: float
    vertical_depth: float
    error: float
    behind: float
    behind_error: float
    told_apart: bool


@dataclass(frozen=True, eq=False)
class WaterFit:
    """The Jerlov water that was recovered from pictures; made by `uwaug.fitting.fit_water`.

    Attributes:
        type: the Jerlov type, such as "3C"; a mixture of neighbours, as "II + III".
        water: its spectra with as much in it as was found, as `uwaug.RandomUnderwater` takes it:
            `RandomUnderwater(waters=[fit.water])`.
        medium: the water with camera, depth, g, μ and width law, as `uwaug.Underwater` takes it.
        parameters: each number by name: value, standard error, 95 % interval, unit, state.
            visibility [m]; contents, the factor of `Water.with_contents`; mixing, the share of the
            second type, 0…1; vertical_depth [m]; gain_1, …, the exposure of each observed picture.
        types: the ten types and those mixtures that are neither of their ends, best first.
        message: in words: which water, what it is not told apart from, how well it explains the
            pictures, what they cannot tell.
        noise: of the observed pictures.
        rms: of the residual, in linear light.
    """

    type: str
    water: Water
    medium: Medium
    parameters: dict[str, Parameter]
    types: tuple[JerlovType, ...]
    message: str
    noise: Noise
    rms: float

    @property
    def visibility(self) -> float | None:
        """As `Water.visibility` [m]; None if the pictures do not tell."""
        return self.parameters["visibility"].value

    @property
    def vertical_depth(self) -> float | None:
        """Below the surface [m]; None if the pictures do not tell."""
        return self.parameters["vertical_depth"].value

    @property
    def mixing(self) -> float | None:
        """The share of the second type, 0…1; None of a single type."""
        return self.parameters["mixing"].value if "mixing" in self.parameters else None

    @property
    def gain(self) -> tuple[float | None, ...]:
        """The exposure of each observed picture, as multiples of the clean one's; empty if it was
        not fitted.
        """
        found = []
        for name, one in self.parameters.items():
            if name.startswith("gain"):
                found.append(one.value)
        return tuple(found)

    @property
    def errors(self) -> dict[str, float]:
        """The standard errors that are known, by name."""
        return errors_of(self.parameters)

    def summary(self) -> str:
        """The fit as text: verdict, numbers, types."""
        parts = [self.message, "", table(self.parameters), ""]
        parts.append("  type        visibility   vertical depth   held-out error   behind the best")
        for one in self.types:
            mark = "*" if one.name == self.type else " "
            behind = f"{one.behind:.4g} ± {one.behind_error:.2g}" if one.behind else "best"
            behind += "" if one.told_apart or not one.behind else ", not told apart"
            depths = f"{one.visibility:9.4g} m {one.vertical_depth:14.3g} m"
            parts.append(f"{mark} {one.name:10} {depths} {one.error:16.4f}   {behind}")
        return "\n".join(parts)

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        seen = "?" if self.visibility is None else f"{self.visibility:.3g}"
        return f"WaterFit({self.type!r}, visibility {seen} m)"
