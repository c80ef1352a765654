"""Nonlinear least squares on pixels: where a fit begins, how it proceeds, where it ends."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from uwaug._support.deterministic import reproducible
from uwaug._support.types import Array
from uwaug.fitting.coefficients import Coefficients, render, veil_growth
from uwaug.fitting.data import Pixels
from uwaug.fitting.models import COLOURS, CoefficientModel, Model

M = TypeVar("M", bound=Model)
ROBUST = 2.0  # standard deviations of noise, from where on a residual counts less than its square
_INSIDE = 1e-4  # of a number's range: a fit begins at least so far from its bounds
_MAX_LOGIT = 16.0  # logarithm of the odds; e^−16 of a number's range is its end
_AT_BOUND = 1e-6  # of a number's range: nearer to its end, it is there
_CONVERGED = 1e-7  # relative change of cost or numbers at which a fit ends
# Optical depths β·z at the reference distance, of the grid that a guess is taken from.
_DEPTHS = np.geomspace(0.05, 12.0, 24)
_G_OVER_BETA = (0.1, 0.3, 0.6, 1.0)  # of the same grid
_SCOUTS = 2000  # pixels that decide between starts
_APART = 0.5  # of random starts: each number is multiplied by up to e^±_APART


@contextmanager
def one_thread() -> Iterator[None]:
    """Run on one thread, NumPy's and SciPy's linear algebra too: the same numbers on any machine,
    and less time. (Two threads that wait for each other take 3 to 6 times as long for matrices of a
    dozen columns where other processes run as well.)
    """
    from threadpoolctl import threadpool_limits

    # slopes need what inference mode leaves out
    with (
        reproducible(),
        threadpool_limits(1, user_api="blas"),
        torch.inference_mode(False),
        torch.enable_grad(),
        # a mode for devices costs a tenth of the time where nothing asks for it
        nullcontext() if torch.get_default_device().type == "cpu" else torch.device("cpu"),
    ):
        yield


@dataclass(frozen=True, eq=False)
class Objective(Generic[M]):
    """A model and the pixels that it is to explain.

    Attributes:
        model: what is fitted.
        pixels: what it is fitted to.
        held: the value of each number that stays as it is, by its place.
    """

    model: M
    pixels: Pixels
    held: Mapping[int, float] = field(default_factory=dict)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest value of each number."""
        bounds = self.model.bounds.values()
        return np.array([bound.low for bound in bounds]), np.array([bound.high for bound in bounds])

    @property
    def free(self) -> Array:
        """Which numbers are not held."""
        return np.array([i not in self.held for i in range(len(self.model.bounds))])

    def render(self, theta: Array) -> Tensor:
        """The pixels (Px3x1xN) in linear light."""
        return self.model.render(theta, self.pixels)

    def residual(self, theta: Array) -> Array:
        """Model − observation in standard deviations of the noise (P·3·N)."""
        return self._weighed(self.render(theta))

    def _weighed(self, light: Tensor) -> Array:
        return (self.pixels.weights * (light - self.pixels.observed)).flatten().numpy()

    def linearised(self, theta: Array) -> tuple[Array, Array]:
        """The residual and its Jacobian (P·3·N × numbers)."""
        light, slopes = self.model.jacobian(theta, self.pixels)
        jacobian = self.pixels.weights[..., None] * slopes
        return self._weighed(light), jacobian.reshape(-1, len(theta)).numpy()


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a fit ended.

    Attributes:
        theta: the numbers.
        cost: half of the summed loss.
        at_bound: −1 or 1 where a number is at its least or largest value, else 0.
        residual, jacobian: there.
        history: the cost after each evaluation.
        converged: whether it ended because nothing changed any more.
    """

    theta: Array
    cost: float
    at_bound: Array
    residual: Array
    jacobian: Array
    history: list[float] = field(default_factory=list)
    converged: bool = True


def loss(residual: Array) -> Array:
    """What each residual adds to twice the cost: its square, or less where it is large."""
    return np.asarray(2 * ROBUST**2 * (np.sqrt(1 + (residual / ROBUST) ** 2) - 1))


def influence(residual: Array) -> tuple[Array, Array]:
    """The first two derivatives of half the loss."""
    root = np.sqrt(1 + (residual / ROBUST) ** 2)
    return residual / root, 1 / root**3


def logit_prefit(objective: Objective[M], start: Array, most: int = 40) -> Array:
    """Numbers near the least cost, from a start that may be far.

    Each number goes by the logarithm of its distances from its bounds, so that steps are shares of
    it. (Without, one start in twelve lets a rate overshoot to where its light is gone, and nothing
    calls it back: 22 of 276 starts up to e^±1 away, against none of 35 in seven such waters.)
    """
    from scipy.optimize import least_squares

    low, high = objective.bounds
    span = high - low
    # at an end itself, its slope would be lost
    inside = np.clip((start - low) / span, _INSIDE, 0.9)

    def theta(logit: Array) -> Array:
        return np.asarray(low + span / (1 + np.exp(-logit)))

    def jacobian(logit: Array) -> Array:
        share = 1 / (1 + np.exp(-logit))
        return objective.linearised(theta(logit))[1] * (span * share * (1 - share))

    result = least_squares(
        lambda logit: objective.residual(theta(logit)),
        np.clip(np.log(inside / (1 - inside)), -_MAX_LOGIT, _MAX_LOGIT),
        jacobian,
        bounds=(-_MAX_LOGIT - 1, _MAX_LOGIT + 1),
        loss="soft_l1",
        f_scale=ROBUST,
        max_nfev=most,
        ftol=1e-5,
        xtol=1e-5,
        gtol=1e-5,
    )
    return theta(result.x)


def solve(objective: Objective[M], start: Array, most: int = 60) -> Solution:
    """The least cost that can be reached from `start`, inside the bounds. Plain bounds, not
    logarithms: a number at its bound is seen to be there.
    """
    from scipy.optimize import least_squares

    free = objective.free
    low, high = (limit[free] for limit in objective.bounds)
    margin = _INSIDE * (high - low)
    whole = np.array(start, dtype=float)
    for place, value in objective.held.items():
        whole[place] = value
    history: list[float] = []
    last: dict[bytes, tuple[Array, Array]] = {}

    def at(numbers: Array) -> Array:
        theta = whole.copy()
        theta[free] = numbers
        return theta

    def residual(numbers: Array) -> Array:
        values = objective.residual(at(numbers))
        history.append(float(loss(values).sum() / 2))
        return values

    def jacobian(numbers: Array) -> Array:
        last.clear()
        last[numbers.tobytes()] = objective.linearised(at(numbers))
        return last[numbers.tobytes()][1][:, free]

    result = least_squares(
        residual,
        np.clip(whole[free], low + margin, high - margin),
        jacobian,
        bounds=(low, high),
        x_scale="jac",
        loss="soft_l1",
        f_scale=ROBUST,
        max_nfev=most,
        ftol=_CONVERGED,
        xtol=_CONVERGED,
        gtol=_CONVERGED,
    )
    # the method stays inside, if only just
    reached = result.active_mask
    reached = np.where(result.x - low < _AT_BOUND * (high - low), -1, reached)
    reached = np.where(high - result.x < _AT_BOUND * (high - low), 1, reached)
    numbers = np.select([reached < 0, reached > 0], [low, high], result.x)
    if numbers.tobytes() not in last:
        jacobian(numbers)
    values, derivative = last[numbers.tobytes()]
    at_bound = np.zeros(len(whole), dtype=int)
    at_bound[free] = reached
    return Solution(
        theta=at(numbers),
        cost=float(loss(values).sum() / 2),
        at_bound=at_bound,
        residual=values,
        jacobian=derivative,
        history=history,
        converged=result.status > 0,
    )


def starting_points(
    objective: Objective[CoefficientModel],
    near: Sequence[Mapping[str, float]] = (),
    start: Mapping[str, float] | None = None,
) -> list[Array]:
    """Places θ to begin at: a guess, and what others know.

    Args:
        objective: what is fitted.
        near: numbers of θ by name that come from other fits.
        start: numbers that the caller knows, by the names of `CoefficientModel.fixable`; they come
            first.
    """
    model = objective.model
    first = guess(model, objective.pixels)
    starts = [model.start({**first, **numbers}, {}) for numbers in ({}, *near)]
    return [model.start(first, start), *starts] if start else starts


def multistart(
    objective: Objective[CoefficientModel], starts: Sequence[Array], seed: int, more: int = 1
) -> Solution:
    """The least cost from any of `starts` and from `more` random places around the first of them.

    Few pixels decide which, all of them where it ends. From there each colour is guessed once more,
    with the width law that was reached: a colour that was taken for opaque, a veil and no scene,
    has nothing to call it back (1 start in 9 ended so).
    """
    model, rng = objective.model, np.random.default_rng(seed)
    low, high = objective.bounds
    for _ in range(more):
        factor = np.exp(rng.uniform(-_APART, _APART, len(low)))
        starts = [*starts, np.clip(starts[0] * factor, low, high)]
    few = replace(objective, pixels=objective.pixels.subsample(_SCOUTS, rng))
    ends = [solve(few, logit_prefit(few, theta), most=20) for theta in starts]
    nearest = min(ends, key=lambda end: end.cost)
    numbers = dict(zip(model.bounds, nearest.theta.tolist(), strict=True))
    again = model.start(guess(model, few.pixels, numbers), {})
    nearest = min(nearest, solve(few, again, most=20), key=lambda end: end.cost)
    solution = solve(objective, nearest.theta)
    return replace(solution, history=[*nearest.history, *solution.history])


def guess(
    model: CoefficientModel, pixels: Pixels, numbers: Mapping[str, float] | None = None
) -> dict[str, float]:
    """For each colour, the best of a grid of β and G/β, whose veil follows by linear least squares;
    everything else as in `numbers` of θ by name, or at its beginning.
    """
    values = {name: bound.begin for name, bound in model.bounds.items()}
    values |= numbers or {}
    few = pixels.subsample(_SCOUTS // 2, 0)
    beta = torch.from_numpy(_DEPTHS / model.geometry.reference)
    shares = _G_OVER_BETA if model.spec.veil == "own" else (1.0,)
    others = model.coefficients(torch.tensor([values[name] for name in model.bounds]).double())
    others = others._replace(shading=None, tone=None)
    errors, slopes = [], []
    for share in shares:
        for rate in beta:
            b = rate.expand(len(few), 3)
            c = others._replace(beta=b, G=share * b, veil_slope=torch.zeros_like(b))
            error, slope = _best_veil(c, few, model)
            errors.append(error)
            slopes.append(slope)
    error, veil_slope = torch.stack(errors), torch.stack(slopes)  # (shares·rates, 3)
    for i, colour in enumerate(COLOURS):
        place = int(error[:, i].argmin())
        values[f"beta_{colour}"] = float(beta[place % len(beta)])
        values[f"share_{colour}"] = shares[place // len(beta)]
        values[f"source_{colour}"] = float(veil_slope[place, i])
    return values


def _best_veil(c: Coefficients, pixels: Pixels, model: CoefficientModel) -> tuple[Tensor, Tensor]:
    """The squared error of each colour with the veil that suits it best, and its slope (3 each)."""
    w = pixels.weights**2
    scene = render(c, pixels, model.shape)
    residual = pixels.observed - scene
    slope = torch.zeros(3, dtype=torch.float64)
    if model.spec.veil != "none":
        # a picture is linear in its veil
        veil = c.gain[:, :, None, None] * veil_growth(c.G, pixels)
        along, across = (w * veil * residual).sum((0, 2, 3)), (w * veil * veil).sum((0, 2, 3))
        slope = (along / across.clamp(min=1e-300)).clamp(min=0.0)
        residual = residual - slope[:, None, None] * veil
    return (w * residual * residual).sum((0, 2, 3)), slope
