"""The physics referee: our own Monte Carlo random walk (`referees.transport`) against the laws
for g, width and shape of the point spread.

`python -m benchmarks.accuracy.physics` writes results/physics.json and prints the
tables.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain

import numpy as np
import torch
from referees.transport import (
    ABSORPTION,
    FOCAL,
    FREQUENCIES,
    SIZE,
    Array,
    PhaseFunction,
    Spread,
    henyey_greenstein,
    petzold,
    survey,
)
from scipy.optimize import minimize

from benchmarks.harness import ROOT, command, save, use_threads
from uwaug.formation import form_image
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PAPER_SIDE, PointSpread

PICTURES = ROOT / "tests" / "data" / "monte_carlo.npz"
STATIONS = {
    "ocean": ("AUTEC 7", "AUTEC 8", "AUTEC 9"),
    "coast": ("HAOCE 5", "HAOCE 11"),
    "harbour": ("NUC 2240", "NUC 2200", "NUC 2040"),
}
MEAN, CONTRAST = 0.5, 0.25  # of the picture that errors refer to; power ∝ 1/f²

Spreads = dict[str, list[Spread]]
Errors = dict[str, dict[str, float]]


@dataclass(frozen=True)
class Law:
    """What a model claims of the scattered light: g, and a mixture of widths scale·(b·z)^exponent,
    unit tangent.

    Attributes:
        g: share of the scattered light that leaves the line of sight.
        widths: (share, scale, exponent) of each part.
        shape: "gaussian" or "exponential", as in `PointSpread`.
    """

    g: float
    widths: tuple[tuple[float, float, float], ...]
    shape: str = "gaussian"

    def error(self, truth: Spread) -> float:
        """RMSE of direct + forward light on a picture of `MEAN` and `CONTRAST` with power ∝
        1/f².
        """
        transfer = np.zeros_like(FREQUENCIES)
        for share, scale, exponent in self.widths:
            radians = 2 * np.pi * scale * truth.lengths**exponent * FREQUENCIES
            fall = radians if self.shape == "exponential" else 0.5 * radians**2
            transfer += share * np.exp(-fall)
        return _error(truth, self.g, transfer)


def _error(truth: Spread, g: float, transfer: Array) -> float:
    forward = np.exp(-(truth.absorption + g) * truth.lengths) - truth.direct
    wrong = forward * transfer - truth.forward * truth.transfer
    return float(np.sqrt((MEAN * (forward - truth.forward)) ** 2 + CONTRAST**2 * (wrong**2).mean()))


def least_error(truths: Sequence[Spread]) -> float:
    """Mean error of the exact point spread with the best constant g: what no shape or width can
    repair.
    """
    errors = []
    for g in np.linspace(0, 0.3, 301):
        errors.append(float(np.mean([_error(truth, g, truth.transfer) for truth in truths])))
    return min(errors)


_SHIPPED = PointSpread.calibrated()
PAPER = Law(0.2, ((1.0, 0.3 * SIZE / PAPER_SIDE / FOCAL, 1.0),))
# the refit to HG .924 and Petzold, but for a g a little above that of least error: far scenes,
# shown brighter, are then no worse than by the former law
CALIBRATED = Law(0.05, ((1.0, float(_SHIPPED.scale), float(_SHIPPED.exponent)),), _SHIPPED.shape)
FORMER = Law(0.066, ((1.0, 0.080, 0.51),))


def mean_error(law: Law, truths: Sequence[Spread], *, exposed: bool = False) -> float:
    """Mean of `Law.error`; `exposed`: each over the light that arrives, as if every distance were
    exposed alike.
    """
    errors = []
    for truth in truths:
        arrived = truth.direct + truth.forward
        errors.append(law.error(truth) / (arrived if exposed else 1))
    return float(np.mean(errors))


def fit_law(truths: Sequence[Spread], shape: str = "gaussian", parts: int = 1) -> Law:
    """The law of least mean square error: one or two widths, one g."""

    def law(p: Array) -> Law:
        first = (float(np.exp(p[1])), abs(p[2]))
        if parts == 1:
            return Law(abs(p[0]), ((1.0, *first),), shape)
        share = 1 / (1 + float(np.exp(-p[3])))
        second = (float(np.exp(p[4])), abs(p[5]))
        return Law(abs(p[0]), ((share, *first), (1 - share, *second)), shape)

    def loss(p: Array) -> float:
        return 1e4 * float(np.mean([law(p).error(truth) ** 2 for truth in truths]))

    start = [0.06, np.log(0.06), 0.5]
    if parts == 2:
        start = [0.05, np.log(0.01), 0.9, -0.5, np.log(0.11), 0.45]
    options = {"xatol": 1e-3, "fatol": 1e-4, "maxfev": 3000}
    return law(minimize(loss, start, method="Nelder-Mead", options=options).x)


@lru_cache(maxsize=1)
def _pictures() -> tuple[torch.Tensor, Array, list[dict[str, float]]]:
    """The scene without water, what the walk saw of it, and in which waters."""
    with np.load(PICTURES) as data:
        texture = torch.from_numpy(data["J"].astype(float))
        return texture, data["DF"].astype(float), json.loads(str(data["params"]))


def picture_error(law: Law) -> float:
    """Mean RMSE of direct + forward light over the Monte Carlo pictures (HG .924), their noise
    taken out.
    """
    texture, observed, cases = _pictures()
    offset, found = torch.arange(128).double() - 63.5, []
    for light, case in zip(observed, cases, strict=True):
        a, b, f = case["a"], case["b"], case["focal_px"]
        z = case["z"] * torch.sqrt(1 + (offset[:, None] / f) ** 2 + (offset / f) ** 2)[None]
        rates = ((a + b,) * 3, (a + law.g * b,) * 3)
        total = torch.zeros(128, 128, dtype=torch.float64)
        for share, scale, exponent in law.widths:
            blur = PointSpread(scale * f, exponent, law.shape)  # type: ignore[arg-type]
            medium = Medium.from_coefficients(*rates, (0,) * 3, b_mean=b, point_spread=blur)
            terms = form_image(texture.expand(3, -1, -1), z, medium)
            total += share * (terms.direct + terms.forward)[0]
        found.append(float(np.sqrt(((total.numpy() - light) ** 2).mean() - case["noise"] ** 2)))
    return float(np.mean(found))


def rule_for_g(phases: Sequence[PhaseFunction], spreads: Spreads) -> dict[str, float]:
    """Power law g = k·(1 − ⟨cos θ⟩)^p·(a/b)^q·(b z)^r by least squares of logarithms, and its
    deviation as a factor.
    """
    rows, logs = [], []
    for phase in phases:
        for s in spreads[phase.name]:
            rows.append([1, np.log(1 - phase.mean_cosine), np.log(s.absorption), np.log(s.lengths)])
            logs.append(np.log(s.figures["g"]))
    system = np.array(rows)
    solution = np.linalg.lstsq(system, np.array(logs), rcond=None)[0]
    off = system @ solution - logs
    return {
        "k": float(np.exp(solution[0])),
        "p_cosine": float(solution[1]),
        "q_absorption": float(solution[2]),
        "r_lengths": float(solution[3]),
        "deviation_factor": float(np.exp(off.std())),
    }


def laws(
    both: Sequence[Spread], petzolds: Sequence[Spread], hg: Sequence[Spread]
) -> dict[str, Law]:
    """Laws, given and refitted. The refits serve HG .924 and Petzold's stations, in their own
    waters, alike.
    """
    return {
        "direct only": Law(1.0, ((1.0, 0.0, 1.0),)),
        "paper": PAPER,
        "paper, px of a 128 px picture": Law(PAPER.g, ((1.0, 0.3 / (0.866 * 128), 1.0),)),
        "calibrated": CALIBRATED,
        "one Gaussian, HG .924 (former)": FORMER,
        "one Gaussian, refitted": fit_law(both),
        "exponential, refitted": fit_law(both, "exponential"),
        "two Gaussians, refitted": fit_law(both, parts=2),
        "one Gaussian, Petzold alone": fit_law(petzolds),
        "exponential, Petzold alone": fit_law(petzolds, "exponential"),
        "exponential, HG 0.924 alone": fit_law(hg, "exponential"),
    }


def compare(spreads: Spreads, own: Spreads) -> tuple[dict[str, Law], Errors]:
    """Laws, and the mean error of each on Henyey–Greenstein, on Petzold's waters and in
    pictures.
    """
    sets = {name: row for name, row in spreads.items() if name.startswith("HG")}
    sets |= own
    sets["Petzold"] = petzolds = list(chain.from_iterable(own.values()))
    hg = spreads["HG 0.924"]
    found = laws([*hg, *petzolds], petzolds, hg)
    errors: Errors = {}
    for name, law in found.items():
        row = {key: mean_error(law, truths) for key, truths in sets.items()}
        for key in ("HG 0.924", "Petzold"):
            row[f"{key}, exposed"] = mean_error(law, sets[key], exposed=True)
        row["pictures"] = picture_error(law)
        errors[name] = row
    least = {key: least_error(truths) for key, truths in sets.items()}
    errors["exact shape, best constant g"] = least
    return found, errors


def _walks_as_json(spreads: Sequence[Spread]) -> list[dict[str, float]]:
    rows = []
    for s in spreads:
        figures = {name: float(f"{value:.5g}") for name, value in s.figures.items()}
        rows.append({"bz": s.lengths, "a/b": s.absorption, **figures})
    return rows


def main(quick: bool = False) -> None:
    """Run all parts and save the figures."""
    use_threads(1)
    stations = {group: names[:1] for group, names in STATIONS.items()} if quick else STATIONS
    phases = [henyey_greenstein(g) for g in ((0.924,) if quick else (0.85, 0.9, 0.924, 0.95))]
    for names in stations.values():
        phases += map(petzold, names)
    spreads = survey(phases, 10_000 if quick else 400_000)
    rule = rule_for_g(phases, spreads)
    print(f"g = k·(1 − ⟨cos⟩)^p·(a/b)^q·(bz)^r: {rule}")
    own: Spreads = {}
    for group, names in stations.items():
        walks = chain.from_iterable(spreads[name] for name in names)
        own[group] = [s for s in walks if s.absorption not in ABSORPTION]
    found, errors = compare(spreads, own)
    for name, row in errors.items():
        print(name, *(f"{key}: {error:.4f}" for key, error in row.items()), sep="; ", flush=True)
    if quick:
        return
    each: dict[str, dict[str, list[float]]] = {}
    for name, truths in spreads.items():
        fits = {shape: fit_law(truths, shape) for shape in ("gaussian", "exponential")}
        each[name] = {shape: [law.g, *law.widths[0][1:]] for shape, law in fits.items()}
    results = {
        "picture": {"mean": MEAN, "contrast": CONTRAST, "size_px": SIZE, "focal_px": FOCAL},
        "mean_cosine": {phase.name: phase.mean_cosine for phase in phases},
        "walks": {name: _walks_as_json(row) for name, row in spreads.items()},
        "rule_for_g": rule,
        "laws": {
            name: {"g": law.g, "shape": law.shape, "share_scale_exponent": law.widths}
            for name, law in found.items()
        },
        "each": each,
        "errors": errors,
    }
    print(save("physics", results))


if __name__ == "__main__":
    command(main, __doc__)
