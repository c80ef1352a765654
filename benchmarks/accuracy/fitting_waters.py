"""What `uwaug degrade --water` has made: does `fit_water` name it, with the defaults of both?"""

from typing import Any

import torch

from benchmarks.accuracy.fitting_scenes import view
from uwaug.fitting import WaterFit, fit_water
from uwaug.jobs import Recipe
from uwaug.optics import JERLOV_TYPES

FLAGS: tuple[dict[str, float], ...] = (
    {},
    {"visibility": 6.0, "vertical_depth": 8.0},
    {"vertical_depth": 8.0},
)
"""None; --visibility and --depth; --depth. There is too little in type I to see 6 m in it."""

SIZE = 370  # px, width


def waters(quick: bool = False) -> dict[str, Any]:
    """The picture of each type, with each of the flags, and what is found."""
    scene = view(SIZE)
    clean, z = (255 * scene.srgb).round().to(torch.uint8), scene.distance.float()
    rows = []
    for type in ("1C",) if quick else JERLOV_TYPES:
        for flags in FLAGS:
            if type == "I" and "visibility" in flags:
                continue
            degraded = Recipe(water=type, options=flags).open().degrade(clean, z, None, 0)
            used = degraded.drawn["samples"][0]["used"]
            row = _row(type, used, fit_water(clean, degraded.image, z))
            rows.append(row)
            print(row, flush=True)
    return {"scene": list(clean.shape[-2:]), "rows": rows, **_summary(rows)}


def _row(type: str, used: dict[str, float], fit: WaterFit) -> dict[str, Any]:
    """What was made, what was found, and how far off that is, in its own standard errors."""
    row: dict[str, Any] = {"type": type, "found": fit.type, "doubt": "No " in fit.message}
    row["alike"] = [x.name for x in fit.types if not x.told_apart and x.name != fit.type]
    for name in ("visibility", "vertical_depth"):
        number = fit.parameters[name]
        row[name] = {"truth": used[name], "value": number.value, "error": number.error}
        if number.value is not None and number.error is not None:
            row[name]["off"] = abs(number.value - used[name]) / number.error
    return row


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Of all pictures: how many are named right, and how far off the numbers are."""
    right = [row for row in rows if row["found"] == row["type"]]
    summary: dict[str, Any] = {"pictures": len(rows), "right": len(right)}
    for name in ("visibility", "vertical_depth"):
        numbers = [row[name] for row in right if "off" in row[name]]
        summary[name] = {
            "known": len(numbers),
            "within_2_errors": sum(x["off"] <= 2 for x in numbers),
            "worst_share": max(abs(x["value"] / x["truth"] - 1) for x in numbers),
            "worst_error_share": max(x["error"] / x["truth"] for x in numbers),
        }
    return summary
