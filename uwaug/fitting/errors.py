"""Errors of a fit: the covariance of its numbers over other pictures of the same kind, the
residuals by distance, and sentences on both. `parameter` alone decides if a number is reported or
"not identified".
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from torch import Tensor

from uwaug._support.types import Array
from uwaug.fitting.data import Geometry, Places
from uwaug.fitting.model import COLOURS, NORMAL, VISIBLE_LIGHT, Model, Quantity, report_slopes
from uwaug.fitting.result import Fit, Parameter, Remainder
from uwaug.fitting.solve import M, Objective, Solution, influence
from uwaug.formation.setting import Setting
from uwaug.optics.curves import FARTHEST

# Standard error, as a share of the number at either end of its interval, above which the number is
# not identified, unless the error is less than what shows in a picture.
#
# The ends ask for an error below a quarter of a symmetric number. Of 672 numbers of 76 random
# waters that pass, one was more than half off, by less than shows. Of 37 more that pass if the
# number itself is the measure, 14 were.
_MAX_ERROR_SHARE = 0.5
_FLAT_EIGENVALUE = 1e-9  # share of the largest eigenvalue, below which a direction does not show
_UNMOVED_SHARE = 1e-4  # of a slope, that may lie along directions that do not show
_TENTHS = 10  # parts of the distances, each with a mean residual
THIN_OPTICAL_DEPTH = 0.3  # G·z at the far end, below which a veil is still a straight line
_SURE_ERRORS = 5.0  # standard errors of independent noise, beyond which a mean residual is real
_DEPENDENT_EFFECT = 1.5  # design effect, above which neighbouring residuals depend on each other


class Covariance(NamedTuple):
    """Covariance of the fitted numbers."""

    matrix: Array
    length: Array  # lengths of the Jacobian's columns; 0 if a number does nothing
    hidden: Array  # (numbers x directions): changes of numbers times length that do not show at all
    design_effect: float  # ratio of the errors to those of independent residuals

    def shows(self, slope: Array) -> bool:
        """True if a quantity with these slopes by the numbers shows in the pictures."""
        if (self.length[slope != 0] == 0).any():
            return False
        scaled = np.divide(slope, self.length, out=np.zeros_like(slope), where=self.length > 0)
        hidden = np.abs(scaled @ self.hidden)
        return bool((hidden <= _UNMOVED_SHARE * np.linalg.norm(scaled)).all())


def sandwich(
    jacobian: Array, score: Array, curvature: Array, blocks: Places, offsets: Array | None = None
) -> Covariance:
    """Sandwich estimate H⁻¹·S·H⁻¹ of the covariance (White 1982; over blocks, Liang and Zeger
    1986): H from the slopes, S from the scores of blocks of the picture, whose residuals may depend
    on each other. In no direction is it less than for independent pixels.

    Args:
        jacobian (N x numbers): derivatives of the residuals.
        score, curvature (N): first two derivatives of half of each residual's loss.
        blocks (N): number of the block of each residual.
        offsets (NxK): changes of the residuals by K independent errors that no block tells.
    """
    from scipy.linalg import eigh

    length = np.sqrt((jacobian**2).sum(0))
    used = length > 0
    scaled = jacobian[:, used] / length[used]
    values, vectors = np.linalg.eigh(scaled.T @ (curvature[:, None] * scaled))
    visible = values > _FLAT_EIGENVALUE * max(values.max(initial=0.0), 1e-300)
    root = vectors[:, visible] / np.sqrt(values[visible])  # root @ root.T is H⁻¹
    scores = scaled @ root * score[:, None]
    sums = np.zeros((int(blocks.max()) + 1, scores.shape[1]))
    np.add.at(sums, blocks, scores)
    count = len(np.unique(blocks[score != 0]))
    # the fit has made the sums of scores smaller than they are elsewhere; few blocks bear no more
    freedom = max(count - scores.shape[1], count / 2, 1)
    of_blocks = count / freedom * sums.T @ sums
    independent = scores.T @ scores + _FLAT_EIGENVALUE * np.eye(scores.shape[1])
    # a hundred blocks give a rough estimate: where it is less than that of pixels, it is by chance
    ratios, directions = eigh(of_blocks, independent)
    wider = independent @ directions * np.sqrt(ratios.clip(min=1.0))
    inner = root @ wider @ wider.T @ root.T
    design_effect = np.median(np.diag(inner) / np.diag(root @ independent @ root.T)) ** 0.5
    if offsets is not None:
        moved = root @ (scaled @ root).T @ (curvature[:, None] * offsets)
        inner = inner + moved @ moved.T
    matrix = np.zeros((len(length), len(length)))
    matrix[np.ix_(used, used)] = inner / np.outer(length[used], length[used])
    hidden = np.zeros((len(length), int((~visible).sum())))
    hidden[used] = vectors[:, ~visible]
    return Covariance(matrix, length, hidden, float(design_effect))


def covariance_of(
    objective: Objective[M], solution: Solution, lost: Sequence[Tensor] = ()
) -> Covariance:
    """Covariance of all numbers of a fit, over blocks of its pictures; `lost` (Bx3xHxW, linear
    light) are errors of their files, which follow the scene, so that no block tells them.
    """
    from scipy.linalg import block_diag

    pixels, residual = objective.pixels, objective.residual(solution.theta)
    weights = pixels.weights[0, :, 0].numpy()
    errors = [np.full_like(weights, objective.model.offset)]
    for light in lost:
        errors.append(light.transpose(0, 1).flatten(1)[:, pixels.places].double().numpy())
    # each error of each colour by itself
    columns = [(error * weights)[..., None] * np.eye(3)[:, None] for error in errors]
    offsets = np.concatenate(columns, 2).reshape(3 * weights.shape[1], -1)
    score, curvature = influence(residual)
    # numbers whose spread is known are off by it, or by more where the fit finds so: of few
    # numbers, what it finds would be too little
    own = np.abs(residual[len(offsets) :]).clip(min=1)
    score[len(offsets) :] = 0
    blocks = np.pad(pixels.blocks_of_values, (0, len(own)))
    offsets = block_diag(offsets, np.diag(own))
    return sandwich(objective.jacobian(solution.theta), score, curvature, blocks, offsets)


def parameters(
    model: Model, solution: Solution, covariance: Covariance
) -> tuple[dict[str, Parameter], Array]:
    """Every reported quantity by name, by the delta method; and the covariance of all."""
    theta = solution.theta
    at_bound = {name for name, end in zip(model.bounds, solution.at_bound, strict=True) if end}
    slopes = report_slopes(model, theta)
    matrix, hidden = slopes @ covariance.matrix @ slopes.T, model.hidden(theta)
    rows = {}
    quantities = zip(model.quantities, model.report(theta), slopes, np.diag(matrix), strict=True)
    for quantity, value, slope, variance in quantities:
        if not slope.any():
            number = Parameter(float(value), None, None, None, quantity.unit, "fixed")
        else:
            error, is_at_bound = math.sqrt(max(variance, 0.0)), quantity.follows in at_bound
            shows = covariance.shows(slope) and quantity.name not in hidden
            number = parameter(quantity, float(value), error, shows=shows, at_bound=is_at_bound)
        rows[quantity.name] = number
    return rows, matrix


def parameter(
    quantity: Quantity, value: float, error: float, *, shows: bool = True, at_bound: bool = False
) -> Parameter:
    """A number ≥ 0 with its standard error, or "not identified": where it does not show in the
    pictures, as others make up for it; or its error is larger than half of the number at either end
    of its interval, and larger than what shows in a picture.
    """
    low, high = max(value - NORMAL * error, 0.0), value + NORMAL * error
    half = (high - low) / (2 * NORMAL)
    if not (shows and half <= max(quantity.resolution, _MAX_ERROR_SHARE * min(value, low))):
        return Parameter(None, None, None, None, quantity.unit, "not identified")
    if at_bound:
        return Parameter(value, None, low, high, quantity.unit, "at bound")
    return Parameter(value, error, low, high, quantity.unit, "free")


def remainder(objective: Objective[M], theta: Array) -> list[Remainder]:
    """Mean of observed − fitted in each tenth of the pixels by distance, and in open water."""
    pixels = objective.pixels
    residual = (pixels.observed - objective.model.render(theta, pixels))[0, :, 0].numpy()
    used = pixels.weights[0, :, 0].numpy() > 0
    z = pixels.z.flatten().numpy()
    order = np.argsort(z, kind="stable")
    finite = order[z[order] < FARTHEST]
    rows = []
    for part in [*np.array_split(finite, _TENTHS), order[len(finite) :]]:
        values = [residual[c, part][used[c, part]] for c in range(3)]
        if min(len(x) for x in values) > 1:
            means = tuple(float(x.mean()) for x in values)
            errors = tuple(float(x.std() / math.sqrt(len(x))) for x in values)
            rows.append(Remainder(float(np.median(z[part])), means, errors))
    return rows


def fit_of(
    objective: Objective[M],
    solution: Solution,
    covariance: Covariance,
    setting: Setting,
    geometry: Geometry,
) -> Fit:
    """The public result: numbers, errors and residuals, and the notes that all fits share."""
    numbers, matrix = parameters(objective.model, solution, covariance)
    pixels = objective.pixels
    residual = objective.model.render(solution.theta, pixels) - pixels.observed
    return Fit(
        model=objective.model.name,
        parameters=numbers,
        covariance=matrix,
        setting=setting,
        geometry=geometry,
        rms=float(residual[pixels.weights > 0].square().mean().sqrt()),
        notes=tuple(unknown(numbers)),
        remainder=tuple(remainder(objective, solution.theta)),
    )


# ---- sentences


def left_over(remainder: Sequence[Remainder], design_effect: float, rms: float) -> list[str]:
    """The sentence, if any, on residuals that are off at one distance, or alike in neighbours."""
    worst, example = 0.0, ""
    for row in remainder:
        for colour, mean, error in zip(COLOURS, row.mean, row.error, strict=True):
            if abs(mean) > max(VISIBLE_LIGHT, _SURE_ERRORS * error, worst):
                worst, side = abs(mean), "brighter" if mean > 0 else "darker"
                example = f"; {colour} is {worst:.2g} {side} than fitted at {row.distance:.3g} m"
    are_alike = design_effect > _DEPENDENT_EFFECT and rms > VISIBLE_LIGHT
    if not example and not are_alike:
        return []
    return [
        f"What is left is not noise: errors are {design_effect:.1f} times those of independent "
        f"pixels{example}. Numbers may be off by more, for distances, alignment, uneven light, "
        "JPEG, more than one rate for a colour, or a haze that was added to encoded values, whose "
        'cure is color_space="linear" (--color-space linear).'
    ]


def straight_line(numbers: Mapping[str, Parameter], G: Array, farthest: float) -> list[str]:
    """The sentence, if any, on colours whose veil, of rate G (3, 1/m), is straight to the end (m)
    and not identified.
    """
    endless = [x for x in COLOURS if numbers[f"veil_{x}"].value is None]
    rates = dict(zip(COLOURS, G.tolist(), strict=True))
    straight = [x for x in endless if rates[x] * farthest < THIN_OPTICAL_DEPTH]
    if not straight:
        return []
    return [
        f"In {', '.join(straight)} the veil still grows as a straight line at {farthest:.3g} m: "
        "its growth (source) is seen, where it ends is not."
    ]


def unknown(parameters: Mapping[str, Parameter]) -> list[str]:
    words = {"not identified": "Not identified", "at bound": "At the end of what they may be"}
    sentences = []
    for state, beginning in words.items():
        names = [name for name, number in parameters.items() if number.state == state]
        if names:
            sentences.append(f"{beginning}: {', '.join(names)}.")
    return sentences
