"""`uwaug.contrast_left` against Monte Carlo light transport: how much of a pattern's modulation is left.

`contrast_left` is that of detail finer than the blur. What is measured is that of patterns of a period:
in Monte Carlo pictures (Henyey–Greenstein, mean cosine .924), and from random walks with that and
with Petzold's phase functions. Without veil, which makes every difference smaller.
"""

import json
from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
import torch
from referees.transport import (
    ABSORPTION,
    FREQUENCIES,
    Array,
    Spread,
    henyey_greenstein,
    petzold,
    survey,
)
from scipy.fft import dctn, idctn

from benchmarks.accuracy.physics import CALIBRATED, PICTURES, STATIONS
from benchmarks.harness import command, save, use_threads
from uwaug.formation import contrast_left
from uwaug.optics.medium import Medium

PERIODS_PX = (2, 3, 4, 6, 8, 16)  # of the pictures: .52° a px
PERIODS_DEG = (0.5, 1.0, 1.5, 2.0, 4.0, 8.0)
HALF_OCTAVE = 2**0.25


def medium_of(absorption: float, scattering: float) -> Medium:
    """Grey water without veil, with the g of the calibrated law."""
    beta, arrives = absorption + scattering, absorption + CALIBRATED.g * scattering
    return Medium.from_coefficients((beta,) * 3, (arrives,) * 3, (0.0,) * 3)


def pictures() -> list[dict[str, Any]]:
    """Each Monte Carlo picture: the share that `contrast_left` says, and the shares that its patterns
    have, by period.
    """
    with np.load(PICTURES) as data:
        texture, observed = data["J"].astype(float), data["DF"].astype(float)
        cases = json.loads(str(data["params"]))
    offset = torch.arange(128).double() - 63.5
    rows = []
    for light, case in zip(observed, cases, strict=True):
        slopes = (offset[:, None] / case["focal_px"]) ** 2 + (offset / case["focal_px"]) ** 2
        z = case["z"] * torch.sqrt(1 + slopes)[None]
        medium = medium_of(case["a"], case["b"])
        said = contrast_left(z, medium)[0].numpy()
        arrives = medium.signal(z)[0, 0].numpy() * texture
        brighter = light.sum() / arrives.sum()
        measured = []
        for period in PERIODS_PX:
            pattern, seen = _band(said * arrives, period), _band(light, period)
            # how many times the modulation that `contrast_left` says
            times = (pattern * seen).sum() / (pattern**2).sum() / brighter
            measured.append(float(times * said.mean()))
        lengths, ratio = case["b"] * case["z"], case["a"] / case["b"]
        rows.append({"bz": lengths, "a/b": ratio, "said": float(said.mean()), "measured": measured})
    return rows


def _band(picture: Array, period: float) -> Array:
    """What a picture has half an octave around a period, px. It is continued by its mirror images,
    as the scene of the pictures is.
    """
    cycles = np.arange(len(picture)) / (2 * len(picture))
    frequency = np.hypot(cycles[:, None], cycles) * period
    inside = (frequency >= 1 / HALF_OCTAVE) & (frequency < HALF_OCTAVE)
    found: Array = idctn(dctn(picture, norm="ortho") * inside, norm="ortho")
    return found


def walks(spreads: Sequence[Spread]) -> dict[str, list[float]]:
    """Measured minus said, by period: mean and largest."""
    off = []
    for truth in spreads:
        medium = medium_of(truth.absorption, 1.0)
        said = float(contrast_left(torch.full((1, 1, 1), truth.lengths).double(), medium))
        frequencies = 1 / np.tan(np.radians(PERIODS_DEG))
        left = truth.direct + truth.forward * np.interp(frequencies, FREQUENCIES, truth.transfer)
        off.append(left / (truth.direct + truth.forward) - said)
    columns = np.array(off)
    return {"mean": columns.mean(0).tolist(), "largest": columns.max(0).tolist()}


def main(quick: bool = False) -> dict[str, Any]:
    """Measure, print and save."""
    use_threads(1)
    seen = pictures()
    print("pictures: b·z, a/b, contrast; measured at", *PERIODS_PX, "px of .52°")
    for row in seen:
        measured = " ".join(f"{value:.3f}" for value in row["measured"])
        print(f"{row['bz']:4.1f} {row['a/b']:4.1f} {row['said']:8.3f}   {measured}")
    groups = {"HG 0.924": [henyey_greenstein(0.924)]}
    for group, names in STATIONS.items():
        groups[f"Petzold, {group}"] = [petzold(name) for name in (names[:1] if quick else names)]
    table = {}
    print("walks: measured − said, mean (largest), at", *PERIODS_DEG, "°")
    for group, phases in groups.items():
        spreads = list(chain.from_iterable(survey(phases, 2_000 if quick else 100_000).values()))
        own = [one for one in spreads if group == "HG 0.924" or one.absorption not in ABSORPTION]
        table[group] = walks(own)
        pairs = zip(table[group]["mean"], table[group]["largest"], strict=True)
        print(f"{group:16s}", *(f"{mean:.3f} ({most:.3f})" for mean, most in pairs))
    periods = {"periods_px": PERIODS_PX, "px_deg": 0.52, "periods_deg": PERIODS_DEG}
    results = {**periods, "pictures": seen, "walks": table}
    if not quick:
        print(save("contrast", results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
