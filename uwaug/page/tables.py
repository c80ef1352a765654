"""Numbers of the model for the page: spectra, the plan of the blur, constants and defaults."""

import base64
from itertools import accumulate
from typing import Any

import torch

from uwaug._support.codec import to_plain
from uwaug.blur.kernels import MARGIN, blur_kernel, enlarge_kernels, per_cell, shrink_kernels
from uwaug.blur.plan import BlurPlan, place_line, plan_blur
from uwaug.distance import cue
from uwaug.formation import development
from uwaug.formation.colour import LUMINANCE
from uwaug.light import direction
from uwaug.optics import constituents
from uwaug.optics.camera import load_camera, response_at
from uwaug.optics.curves import FARTHEST
from uwaug.optics.jerlov import IN_WORDS, JERLOV_TYPES
from uwaug.optics.point_spread import LENGTHS, PointSpread
from uwaug.optics.spectra import WAVELENGTHS
from uwaug.optics.surfaces import reflectances
from uwaug.optics.view import WIDE, WIDE_DEGREES
from uwaug.optics.water import CONTRAST_THRESHOLD, LEAST_LOSS, Water, eye
from uwaug.transforms import random_water
from uwaug.transforms.appearance import WATER_FEATURES
from uwaug.transforms.conditions import photographed
from uwaug.transforms.measured import SAMPLED
from uwaug.transforms.random_light import RandomLight
from uwaug.transforms.random_underwater import SEVERITIES
from uwaug.transforms.random_water import RandomWater

_WIDTHS_PX = (0.0, 400.0)  # of the blurs; wider ones are as good as the mean of a picture
_LONGEST_PX = 1024.0  # side of a picture for which the widest blurs are planned

# planned error, for 13 blurs; at .002 pictures would be up to 3 grey levels from `uwaug degrade`
_BLUR_RMSE = 0.0005

PIXELS = 1_000_000
"""Most pixels of a picture on the page. Each takes some 170 bytes, 72 of them for its blurs."""


def plan_of_page() -> BlurPlan:
    """Plan of the blurs of every picture on the page."""
    return plan_blur(*_WIDTHS_PX, _BLUR_RMSE, "exponential", _LONGEST_PX)


def tables() -> dict[str, Any]:
    """All numbers, as JSON holds them."""
    axis, law = WAVELENGTHS.tobytes(), PointSpread.calibrated()
    waters = {name: Water.jerlov(name).at(WAVELENGTHS) for name in JERLOV_TYPES}
    at_1, exponents = constituents.phytoplankton()
    stored = {
        "bands": WAVELENGTHS,
        "waters": {name: {"a": x.a, "b": x.b, "kd": x.kd} for name, x in waters.items()},
        "words": IN_WORDS,
        "places": constituents.PLACES,
        "pure": dict(zip("ab", constituents.pure_water(axis), strict=True)),
        "contents": {
            "phytoplankton": at_1,
            "exponents": exponents,
            "cdom": constituents.CDOM,
            "absorbed": constituents.ABSORBED_BY_MINERALS,
            "scattered": constituents.SCATTERED_BY_MINERALS,
            "byPhytoplankton": constituents.SCATTERED_BY_PHYTOPLANKTON,
        },
        "sun": constituents.MEAN_COSINE,
        "lostByScattering": constituents.LOST_BY_SCATTERING,
        "leastLoss": LEAST_LOSS,
        "eye": eye(*WAVELENGTHS[[0, -1]].tolist())[1],
        "sensor": response_at(load_camera(RandomWater.camera), axis),
        "reflectances": reflectances(axis),
        "farthest": FARTHEST,
        "law": {"scale": law.scale * WIDE.focal(1), "exponent": law.exponent, "ends": LENGTHS},
        "luminance": LUMINANCE,
        "reflectance": development.MID_GREY,
        "dimmest": random_water.DIMMEST,
        "much": random_water.MOST_CONTENTS,
        "mostContents": 2**random_water.MOST_STOPS,
        "direction": {"view": WIDE_DEGREES, "rise": direction.RISE, "most": direction.MAX_RISE},
        "meter": {
            "count": development.METERED,
            "looks": SAMPLED,
            "steps": development.STEPS,
            "turn": development.TURN,
            "gains": development.GAINS,
            "most": development.MOST,
            "burnt": development.BURNT,
            "chroma": development.CHROMA,
            "xyz": development.XYZ,
            "leastLight": development.LEAST_LIGHT,
        },
        "tone": {"grey": development.MID_GREY, "toe": development.TOE},
        "vividFrom": development.GAMUT_FROM,
        "pixels": PIXELS,
        "plan": _plan(plan_of_page()),
        "draws": _draws(),
        "appearance": WATER_FEATURES,
        "cue": _cue(),
    }
    plain: dict[str, Any] = _rounded(to_plain(stored))
    return plain


def _cue() -> dict[str, Any]:
    layers = cue.learnt()
    numbers = torch.cat([part.flatten() for layer in layers.values() for part in layer])
    return {
        "shapes": [(name, *kernel.shape[:3]) for name, (kernel, _) in layers.items()],
        "weights": base64.b64encode(numbers.numpy().astype("<f2").tobytes()).decode(),
        "stages": cue.STAGES,
        "pooled": cue.POOLED_PX,
        "pixels": cue.PIXELS,
    }


def _plan(plan: BlurPlan) -> dict[str, Any]:
    slope, offset = place_line(plan)
    nodes = zip(plan.sigmas, plan.cells, strict=True)
    blurs = [_blur(sigma, cell, plan.reach) for sigma, cell in nodes if sigma > 0]
    line = {"slope": slope, "offset": offset, "coefficients": plan.coefficients}
    return {**line, "blurs": blurs, "margin": MARGIN}


def _blur(sigma: float, cell: float, reach: float) -> dict[str, Any]:
    if cell == 1:
        kernel = blur_kernel(sigma, reach)
        first = torch.tensor([-(kernel.shape[1] // 2)])
        return {"shrink": {"a": 1, "q": 1, "first": first, "kernels": kernel}}
    a, q = per_cell(cell)
    shrink = shrink_kernels(torch.arange(a), a, q, sigma, reach)
    enlarge = enlarge_kernels(torch.arange(q), a, q)
    return {
        name: {"a": a, "q": q, "first": first, "kernels": kernels}
        for name, (first, kernels) in (("shrink", shrink), ("enlarge", enlarge))
    }


def _draws() -> dict[str, Any]:
    rows, conditions = [], photographed()
    for row in conditions.rows:
        (contents,), others = row["water"]["waters"], {**row["water"], **row["development"]}
        rows.append({**contents, **{n: x for n, x in others.items() if isinstance(x, float)}})
    return {
        "conditions": rows,
        "sums": list(accumulate(conditions.weights or ())),
        "between": conditions.between,
        "contents": list(constituents.UNITS),
        "severities": list(SEVERITIES.values()),
        "g": RandomWater.g,
        # median distances, at the last of which so much contrast is left: it falls exponentially
        "visible": random_water.VISIBLE,
        "left": CONTRAST_THRESHOLD,
        "pitch": RandomLight.pitch,
    }


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _rounded(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.8g}") if isinstance(value, float) else value
