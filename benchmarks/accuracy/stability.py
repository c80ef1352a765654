"""Where methods fail: each method under each hard condition, its value and its gradients against
float64.

`python -m benchmarks.accuracy.stability` prints the matrix, draws it and writes
results/stability.json.

Every column but the last two is the whole model with one part done the usual way
(`benchmarks.accuracy.naive`); "published" is held against its own equations. The conditions are in
`referees.conditions`. Where there is no right value, an error that names its argument is right.

A value is right if its RMSE is at most .002 of the picture's peak, which is the model's tolerance,
plus the rounding of the number format; a picture fainter than .001 must be right to 2 % of itself.
Computed with gradients and without.

Gradients are those of a weighted sum of the picture with respect to image, distance, field, rates,
veil, light and width law, each compared as a whole: right if they are off by at most 10 % of their
norm, plus what the tolerance of the value leaves open, .002 per unit of the input (1 m, 1, .5/m,
.5 px). A method without gradients has "none" there, and "n/a" means that it does not know the
condition at all.
"""

import contextlib
import math
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from referees.conditions import WAVELENGTHS, Case, Method, conditions, exact, mixed, spread
from torch import Tensor

import uwaug
from benchmarks.accuracy import naive
from benchmarks.figures import matrix_chart
from benchmarks.harness import ROOT, command, save
from uwaug._support.atomic import written_whole
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear
from uwaug.optics.curves import FARTHEST

TOLERANCE = 0.002
SLACK = 0.1  # of a gradient's norm
UNITS = {"beta": 0.5, "G": 0.5, "scale": 0.5}  # of the input, where it is not 1
FIGURE = ROOT / "benchmarks" / "figures" / "stability.svg"

Verdicts = dict[str, str]  # of "value" and "gradient"
Matrix = dict[str, dict[str, Verdicts]]  # of each condition and method


def ours(case: Case) -> Tensor:
    """Uwaug as it comes; in linear light where gradients are wanted: what is clipped has none."""
    medium = _medium(case)
    if not torch.is_grad_enabled():
        color_space = "srgb" if case.srgb else "linear"
        degrade = uwaug.Underwater(medium, (0.0, math.inf), color_space=color_space)
        return degrade(case.image, case.distance, case.field)
    image = srgb_to_linear(case.image) if case.srgb else case.image
    # +∞ times a field has no gradient
    farthest = min(FARTHEST, torch.finfo(case.dtype).max)
    path = case.distance.clamp(max=farthest) * case.field
    result = uwaug.form_image(image, path, medium).image
    return linear_to_srgb(result) if case.srgb else result


def _medium(case: Case) -> uwaug.Medium:
    medium = _without_blur(case)
    scale, exponent = (
        torch.as_tensor(number).to(medium.beta).expand(len(medium))
        for number in (case.scale, case.exponent)
    )
    return replace(medium, scale=scale, exponent=exponent)


def _without_blur(case: Case) -> uwaug.Medium:
    if case.spectra is None:
        options = {"light": case.light, "b_mean": case.b_mean}
        medium = uwaug.Medium.from_coefficients(case.beta, case.G, case.veil, **options)
        return medium if case.colours is None else _coloured(medium, case.colours)
    s, ascending = case.spectra, sorted(WAVELENGTHS)
    # each channel sees one of the bands alone
    bands = np.arange(450.0, 601.0, 5.0)
    response = np.equal.outer(bands, WAVELENGTHS)
    a, b, kd = (values[::-1] for values in s[:3])
    water = uwaug.Water.jerlov(s.jerlov) if s.jerlov else uwaug.Water(ascending, a, b, kd)
    water = water.at(bands)
    return uwaug.Medium.from_water(
        water,
        camera=uwaug.Camera(bands, response),
        vertical_depth=s.depth,
        g=s.g,
        mu=s.mu,
        tolerance=0,
        point_spread=uwaug.PointSpread.none(),
        surfaces="grey" if case.colours is None else "spectral",
    )


def _coloured(medium: uwaug.Medium, colours: Tensor) -> uwaug.Medium:
    """A medium whose channels see a mixture of the picture's colours, and which gives them back."""
    mix, back = colours.to(medium.beta), torch.linalg.inv(colours).to(medium.beta)
    direct, signal = (
        torch.einsum("ic,bck,cj->bijk", back, weights, mix)
        for weights in (medium.direct_weights, medium.signal_weights)
    )
    veil = back @ medium.veil_weights
    return replace(medium, direct_weights=direct, signal_weights=signal, veil_weights=veil)


METHODS: dict[str, Method] = {**naive.METHODS, "uwaug": ours}


class Right(NamedTuple):
    """What is right in a case.

    Attributes:
        value: the picture.
        weights: of its pixels.
        gradients, floors: for each input, and what they may be off by for the value's tolerance.
    """

    value: Tensor
    weights: Tensor
    gradients: dict[str, Tensor]
    floors: dict[str, float]


def right(case: Case, published: bool = False) -> Right | None:
    """Value and gradients by the model in float64, of inputs that are rounded as those of the
    methods are.
    """
    if case.error:
        return None
    case = case.to(case.dtype).to(torch.float64)
    rng = torch.Generator().manual_seed(1)
    weights = torch.rand(case.image.shape, generator=rng, dtype=torch.float64)
    if not case.image.numel():
        return Right(case.image, weights, {}, {})
    # a sum with random weights hardly changes if the picture is blurred; weights like the picture
    # measure its contrast
    weights = weights + (case.image - case.image.mean()) / case.peak
    image = case.image.clone().requires_grad_()
    value = exact(replace(case, image=image), published)
    if published:  # it has no gradients
        return Right(value.detach(), weights, {}, {})
    gradients = {"image": torch.autograd.grad((value * weights).sum(), image)[0]}
    value, raw = value.detach(), case.raw
    weights_of_raw = weights
    if case.colours is not None:
        weights_of_raw = mixed(torch.linalg.inv(case.colours).T, weights)
    raw_value = exact(raw)
    floors = {"image": TOLERANCE * case.peak * float(weights.norm())}
    step = 1e-6
    for name in case.leaves[1:]:
        leaf = getattr(case, name)
        if name == "G" and bool((leaf == 0).any() and case.distance.isinf().any()):
            continue  # infinite: any finite number will do
        shape = leaf.shape if leaf.ndim == 4 else spread(leaf).shape
        # no pixel and no raw channel reads the parameters of another: one difference quotient
        # serves all of them
        moved = replace(raw, **{name: torch.where(leaf.isfinite(), leaf + step, leaf)})
        slope = (exact(moved) - raw_value) / step * weights_of_raw
        gradients[name] = slope.sum_to_size(shape).reshape(leaf.shape)
        reach = float(weights_of_raw.abs().sum_to_size(shape).norm())
        floors[name] = TOLERANCE * case.peak / UNITS.get(name, 1.0) * reach
    return Right(value, weights, gradients, floors)


def judge(method: Method, case: Case, truth: Right | None) -> Verdicts:
    """Verdict on value and gradient: "right", "off by …", "NaN", "silent" (a picture where an error
    is due), "n/a", "none", "wrong shape", "not repeatable", or the name of an exception.
    """
    try:
        with _deterministic(case.repeat), warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            if truth is None:
                return _without_error(method, case)
            values, gradients = _results(method, case, truth.weights)
    except naive.NotApplicableError:
        return _both("n/a")
    except Exception as error:
        speaks = isinstance(error, (ValueError, TypeError)) and case.error
        named = speaks and case.error in str(error)
        return _both("right" if named else type(error).__name__)
    if not gradients:
        return _both("wrong shape")
    value = _worst([_value(found, truth.value, case) for found in values])
    gradient = _worst([_gradient(found, truth) for found in gradients])
    if case.repeat:
        first, second = gradients
        if not (torch.equal(*values[:2]) and torch.equal(*values[2:])):
            value = "not repeatable"
        if not all(torch.equal(first[name], second[name]) for name in first):
            gradient = "not repeatable"
    return {"value": value, "gradient": gradient}


def _both(verdict: str) -> Verdicts:
    return {"value": verdict, "gradient": verdict}


def _without_error(method: Method, case: Case) -> Verdicts:
    """The verdict on what should have raised an error and comes back."""
    with torch.no_grad():
        plain = _run(method, case, {})
    verdict = "silent" if bool(plain.isfinite().all()) else "NaN"
    out = _run(method, case, _leaves(case, case.leaves))
    return {"value": verdict, "gradient": verdict if out.requires_grad else "none"}


def _results(
    method: Method, case: Case, weights: Tensor
) -> tuple[list[Tensor], list[dict[str, Tensor]]]:
    """Pictures, first those computed without gradients, and gradients; none of a picture of the
    wrong shape.
    """
    times = 1 + case.repeat
    with torch.no_grad():
        values = [_run(method, case, {}) for _ in range(times)]
    gradients: list[dict[str, Tensor]] = []
    if values[0].shape != weights.shape:
        return values, gradients
    runs: list[tuple[str, ...]] = [case.leaves] * times
    if case.alone:
        runs = [(name,) for name in case.leaves]
    for names in runs:
        leaves = _leaves(case, names)
        out = _run(method, case, leaves)
        values.append(out.detach())
        gradients.append(_gradients(out, leaves, weights))
    return values, gradients


@contextlib.contextmanager
def _deterministic(wanted: bool) -> Iterator[None]:
    before = torch.are_deterministic_algorithms_enabled()
    torch.use_deterministic_algorithms(before or wanted)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(before)


def _leaves(case: Case, names: tuple[str, ...]) -> dict[str, Tensor]:
    return {n: getattr(case, n).to(case.dtype).clone().requires_grad_() for n in names}


def _run(method: Method, case: Case, leaves: dict[str, Tensor]) -> Tensor:
    inputs = replace(case.to(case.dtype), **leaves)
    if case.layout == "channels last":
        inputs = replace(inputs, image=inputs.image.to(memory_format=torch.channels_last))
    elif case.layout == "sliced":
        laid = {}
        for name in ("image", "distance", "field"):
            padded = torch.nn.functional.pad(getattr(inputs, name), (3, 2, 1, 2))
            laid[name] = padded[..., 1:-2, 3:-2]
        inputs = replace(inputs, **laid)
    with torch.autocast("cpu", enabled=case.autocast):
        return method(inputs)


def _gradients(out: Tensor, leaves: dict[str, Tensor], weights: Tensor) -> dict[str, Tensor]:
    nothing = {name: torch.zeros_like(leaf) for name, leaf in leaves.items()}
    if not out.requires_grad:
        return nothing if len(leaves) == 1 else {}
    total = (out.double() * weights).sum()
    found = torch.autograd.grad(total, list(leaves.values()), allow_unused=True)
    known = {n: g for n, g in zip(leaves, found, strict=True) if g is not None}
    return {**nothing, **known}


def _worst(verdicts: list[str]) -> str:
    bad = [verdict for verdict in verdicts if verdict != "right"]
    if "NaN" in bad:
        return "NaN"
    return max(bad, key=_amount, default="right")


def _amount(verdict: str) -> float:
    known = verdict.startswith("off by ")
    return float(verdict.removeprefix("off by ")) if known else 0.0


def _value(out: Tensor, truth: Tensor, case: Case) -> str:
    if not truth.numel():
        return "right"
    difference = out.double() - truth
    if not bool(difference.isfinite().all()):
        return "NaN"
    error, brightest = float(difference.square().mean().sqrt()), float(truth.abs().max())
    rounding = max(1e-5, torch.finfo(case.dtype).eps) * max(1.0, brightest)
    # below 1e-30 single precision knows only zero
    faint = error / brightest if 1e-30 < brightest < 1e-3 else 0.0
    if error <= TOLERANCE * case.peak + rounding and faint <= 0.02:
        return "right"
    return f"off by {max(error, faint):.2g}"


def _gradient(given: dict[str, Tensor], truth: Right) -> str:
    if not given:
        return "none"
    if not all(bool(g.isfinite().all()) for g in given.values()):
        return "NaN"
    excess, worst = 0.0, 0.0
    for name, gradient in given.items():
        if name not in truth.gradients:
            continue
        wanted, floor = truth.gradients[name], truth.floors[name]
        error, norm = float((gradient.double() - wanted).norm()), float(wanted.norm())
        excess = max(excess, error - SLACK * norm - floor)
        worst = max(worst, error / max(norm, floor, 1e-30))
    return "right" if excess <= 0 else f"off by {worst:.2g}"


def matrix() -> Matrix:
    """The verdicts on every method under every condition."""
    cases: dict[str, Case] = {}
    for group in conditions().values():
        cases |= group
    result: Matrix = {}
    for condition, case in cases.items():
        usual, published = right(case), right(case, published=True)
        row = result[condition] = {}
        for name, method in METHODS.items():
            row[name] = judge(method, case, published if name == "published" else usual)
    return result


def counted(result: Matrix) -> dict[str, dict[str, dict[str, int]]]:
    """{method: {"value" or "gradient": {kind of verdict: conditions}}}."""
    return {
        method: {
            what: dict(Counter(matrix_chart.kind(row[method][what]) for row in result.values()))
            for what in ("value", "gradient")
        }
        for method in next(iter(result.values()))
    }


def main(quick: bool = False) -> None:
    """Print, draw and save the matrix."""
    result = matrix()
    for condition, row in result.items():
        cells = (f"{method}: {v['value']} / {v['gradient']};" for method, v in row.items())
        print(f"{condition:24}" + " ".join(cells))
    counts = counted(result)
    for method, of in counts.items():
        print(f"{method:16}", of)
    if not quick:
        groups = {group: list(cases) for group, cases in conditions().items()}
        with written_whole(FIGURE) as part:
            part.write_text(matrix_chart.svg(groups, result))
        print(FIGURE)
        print(save("stability", {"counts": counts, "matrix": result}))


if __name__ == "__main__":
    command(main, __doc__)
