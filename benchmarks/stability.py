"""Where methods fail: each method under each hard condition, its value and its gradients against float64.

`python -m benchmarks.stability` prints the matrix, draws it and writes results/stability.json.

Every column but the last two is the whole model with one part done the usual way (`benchmarks.naive`); "published" is
held against its own equations. The conditions are in `benchmarks.conditions`. Where there is no right value, an error
that names its argument is right.

A value is right if its RMSE is at most .002 of the picture's peak, which is the model's tolerance, plus the rounding of
the number format; a picture fainter than .001 must be right to 2 % of itself. Computed with gradients and without.

Gradients are those of a weighted sum of the picture with respect to image, distance, field, rates, veil, light and
width law, each compared as a whole: right if they are off by at most 10 % of their norm, plus what the tolerance of the
value leaves open, .002 per unit of the input (1 m, 1, .5/m, .5 px). A method without gradients has "none" there, and
"n/a" means that it does not know the condition at all.
"""

import contextlib
import math
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

import uwaug
from benchmarks import matrix_chart, naive
from benchmarks.conditions import WAVELENGTHS, Case, Method, conditions, exact, spread
from benchmarks.harness import command, save
from uwaug.colour import linear_to_srgb, srgb_to_linear

TOLERANCE = 0.002
SLACK = 0.1  # of a gradient's norm
UNITS = {"beta": 0.5, "G": 0.5, "scale": 0.5}  # of the input, where it is not 1
FIGURE = Path(__file__).parent / "figures" / "stability.svg"
Verdicts = dict[str, str]  # of "value" and "gradient"


def ours(case: Case) -> Tensor:
    """Uwaug as it comes: `Underwater` where no gradients are wanted, else `form_image`."""
    if case.spectra is None:
        law = uwaug.PointSpread(case.scale, case.exponent)
        medium = uwaug.Medium.from_coefficients(
            case.beta, case.G, case.veil, light=case.light, b_mean=case.b_mean, point_spread=law
        )
    else:
        s, ascending = case.spectra, sorted(WAVELENGTHS)
        lines = uwaug.Camera(ascending, [[w == line for line in WAVELENGTHS] for w in ascending])
        a, b, kd = (v[::-1] for v in s[:3])
        water = uwaug.Water.jerlov(s.jerlov) if s.jerlov else uwaug.Water(ascending, a, b, kd)
        medium = uwaug.Medium.from_water(
            water, camera=lines, vertical_depth=s.depth, g=s.g, mu=s.mu, tolerance=0, wavelengths=ascending,
            point_spread=uwaug.PointSpread(case.scale, case.exponent),
        )  # fmt: skip
    if not torch.is_grad_enabled():
        degrade = uwaug.Underwater(
            medium, (0.0, math.inf), color_space="srgb" if case.srgb else "linear"
        )
        return degrade(case.image, case.distance, case.field)
    image = srgb_to_linear(case.image) if case.srgb else case.image
    result = uwaug.form_image(image, case.distance, medium, case.field).image
    return linear_to_srgb(result) if case.srgb else result


METHODS: dict[str, Method] = {**naive.METHODS, "uwaug": ours}


class Right(NamedTuple):
    """What is right in a case: the picture; how its pixels are weighted; for each input the gradient, and its floor."""

    value: Tensor
    weights: Tensor
    gradients: dict[str, Tensor]
    floors: dict[str, float]


def right(case: Case, published: bool = False) -> Right | None:
    """Value and gradients by the model in float64, of inputs that are rounded as those of the methods are."""
    if case.error:
        return None
    case = case.to(case.dtype).to(torch.float64)
    weights = torch.rand(
        case.image.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64
    )
    if not case.image.numel():
        return Right(case.image, weights, {}, {})
    # a sum with random weights hardly changes if the picture is blurred; weights like the picture measure its contrast
    weights = weights + (case.image - case.image.mean()) / case.peak
    image = case.image.clone().requires_grad_()
    value = exact(replace(case, image=image), published)
    if published:  # it has no gradients
        return Right(value.detach(), weights, {}, {})
    gradients = {"image": torch.autograd.grad((value * weights).sum(), image)[0]}
    value = value.detach()
    floors = {"image": TOLERANCE * case.peak * float(weights.norm())}
    step = 1e-6
    for name in case.leaves[1:]:
        leaf = getattr(case, name)
        if name == "G" and bool((leaf == 0).any() and case.distance.isinf().any()):
            continue  # infinite: any finite number will do
        shape = leaf.shape if leaf.ndim == 4 else spread(leaf).shape
        # no pixel and no channel reads the parameters of another: one difference quotient serves all
        moved = replace(case, **{name: torch.where(leaf.isfinite(), leaf + step, leaf)})
        slope = (exact(moved) - value) / step * weights
        gradients[name] = slope.sum_to_size(shape).reshape(leaf.shape)
        floors[name] = (
            TOLERANCE
            * case.peak
            / UNITS.get(name, 1.0)
            * float(weights.abs().sum_to_size(shape).norm())
        )
    return Right(value, weights, gradients, floors)


def judge(method: Method, case: Case, truth: Right | None) -> Verdicts:
    """Verdict on value and gradient: "right", "off by …", "NaN", "silent" (a picture where an error is due), "n/a",
    "none", "wrong shape", "not repeatable", or the name of an exception.
    """
    try:
        with _deterministic(case.repeat), warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            with torch.no_grad():
                plain, *again = (_run(method, case, {}) for _ in range(1 + case.repeat))
            if truth is None:
                verdict = "silent" if bool(plain.isfinite().all()) else "NaN"
                out = _run(method, case, _leaves(case, case.leaves))
                return {"value": verdict, "gradient": verdict if out.requires_grad else "none"}
            if plain.shape != truth.value.shape:
                return {"value": "wrong shape", "gradient": "wrong shape"}
            values, gradients = [plain], []
            for names in (
                ((n,) for n in case.leaves) if case.alone else (case.leaves,) * (1 + case.repeat)
            ):
                leaves = _leaves(case, names)
                out = _run(method, case, leaves)
                values.append(out.detach())
                gradients.append(_gradients(out, leaves, truth.weights))
    except naive.NotApplicableError:
        return {"value": "n/a", "gradient": "n/a"}
    except Exception as error:
        named = (
            isinstance(error, (ValueError, TypeError)) and case.error and case.error in str(error)
        )
        verdict = "right" if named else type(error).__name__
        return {"value": verdict, "gradient": verdict}
    value = _worst([_value(v, truth.value, case) for v in values])
    gradient = _worst([_gradient(g, truth) for g in gradients])
    if case.repeat and not (torch.equal(plain, again[0]) and torch.equal(values[-2], values[-1])):
        value = "not repeatable"
    if case.repeat and any(not torch.equal(g, gradients[1][n]) for n, g in gradients[0].items()):
        gradient = "not repeatable"
    return {"value": value, "gradient": gradient}


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
        pad = torch.nn.functional.pad
        laid = {
            n: pad(getattr(inputs, n), (3, 2, 1, 2))[..., 1:-2, 3:-2]
            for n in ("image", "distance", "field")
        }
        inputs = replace(inputs, **laid)
    with torch.autocast("cpu", enabled=case.autocast):
        return method(inputs)


def _gradients(out: Tensor, leaves: dict[str, Tensor], weights: Tensor) -> dict[str, Tensor]:
    if not out.requires_grad:
        return {n: torch.zeros_like(v) for n, v in leaves.items()} if len(leaves) == 1 else {}
    grads = torch.autograd.grad(
        (out.double() * weights).sum(), list(leaves.values()), allow_unused=True
    )
    return {
        n: torch.zeros_like(v) if g is None else g
        for (n, v), g in zip(leaves.items(), grads, strict=True)
    }


def _worst(verdicts: list[str]) -> str:
    bad = [v for v in verdicts if v != "right"]
    if not bad or "NaN" in bad:
        return "NaN" if bad else "right"
    return max(
        bad, key=lambda v: float(v.removeprefix("off by ")) if v.startswith("off by ") else 0.0
    )


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


def matrix() -> dict[str, dict[str, Verdicts]]:
    """{condition: {method: verdicts}}."""
    result = {}
    for name, case in (pair for group in conditions().values() for pair in group.items()):
        truths = {m: right(case, published=m == "published") for m in ("published", "")}
        result[name] = {m: judge(f, case, truths.get(m, truths[""])) for m, f in METHODS.items()}
    return result


def counted(result: dict[str, dict[str, Verdicts]]) -> dict[str, dict[str, dict[str, int]]]:
    """{method: {"value" or "gradient": {kind of verdict: conditions}}}."""
    return {
        m: {
            k: dict(Counter(matrix_chart.kind(row[m][k]) for row in result.values()))
            for k in ("value", "gradient")
        }
        for m in next(iter(result.values()))
    }


def main(quick: bool = False) -> None:
    """Print, draw and save the matrix."""
    result = matrix()
    for condition, row in result.items():
        print(
            f"{condition:24}"
            + " ".join(f"{m}: {v['value']} / {v['gradient']};" for m, v in row.items())
        )
    counts = counted(result)
    for method, of in counts.items():
        print(
            f"{method:16}",
            "; ".join(f"{k}: {', '.join(f'{n} {v}' for v, n in of[k].items())}" for k in of),
        )
    if not quick:
        FIGURE.write_text(matrix_chart.svg({g: list(c) for g, c in conditions().items()}, result))
        print(FIGURE)
        print(save("stability", {"counts": counts, "matrix": result}))


if __name__ == "__main__":
    command(main, __doc__)
