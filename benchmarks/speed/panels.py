"""What the frontier races: for each part of the model, all ways to compute it in one scene.

Each contest swaps one part and keeps the others exact.
"""

import importlib.util
import logging
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import uwaug
from benchmarks import recipe
from benchmarks.harness import (
    DISTANCES,
    WIDEST,
    banded_medium,
    by_loops,
    scene,
    water_medium,
)
from benchmarks.speed import blurs
from uwaug.blur.plan import BlurPlan, plan_blur
from uwaug.onnx import OnnxUnderwater, export_onnx
from uwaug.optics.medium import Medium

BLUR = "ours, default"
ONNX = ("onnx", "onnxscript", "onnxruntime")
LOOPS = "compiled loops"

Method = Callable[[], Any]
Model = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True, eq=False)
class Case:
    """One scene: input in float32, reference in float64."""

    image: Tensor  # (1, 3, H, W)
    z: Tensor  # (1, 1, H, W), m
    sigma: Tensor  # (1, 1, H, W), px
    medium: Medium  # of the default tolerance, float32
    scattered: Tensor  # image blurred exactly, float64
    share: Tensor  # T_G − T_β of 61 bands, float64
    exact: Tensor  # the final image, float64


@dataclass(frozen=True, eq=False)
class Contest:
    """Methods for one part of the model.

    Attributes:
        case: the scene.
        methods: by name.
        ours: the name of our default.
        blurs: whether the methods make the blurred image, and not the final one.
        skipped: what cannot run here, and why.
    """

    case: Case
    methods: dict[str, Method]
    ours: str
    blurs: bool = False
    skipped: tuple[str, ...] = ()


def centre(size: int) -> tuple[Tensor, Tensor]:
    """The middle of the scene, where its detail is, with distances stretched to the full range."""
    image, z = scene(max(size, 512))
    first = (image.shape[-1] - size) // 2
    middle = slice(first, first + size)
    image, z = (t[..., middle, middle].contiguous() for t in (image, z))
    (near, far), (low, high) = DISTANCES, z.aminmax()
    return image, near + (far - near) * (z - low) / (high - low)


@lru_cache(maxsize=4)
def case(size: int, widest: float = WIDEST, water: str = "7C") -> Case:
    image, z = centre(size)
    medium, bands = water_medium(water, widest), water_medium(water, widest, tolerance=0.0)
    sigma = medium.width(z.double())
    scattered, _ = blurs.exact(image, sigma)
    direct, signal = bands.transmission(z.double()), bands.signal(z.double())
    exact = direct * image + (signal - direct) * scattered + bands.backscatter(z.double())
    return Case(
        image, z, sigma.float(), medium.to(torch.float32), scattered, signal - direct, exact
    )


def blur_contest(size: int, widest: float) -> Contest:
    """The blur alone."""
    c = case(size, widest)
    plans = _blur_plans(c, size)
    methods: dict[str, Method] = {}
    for name, plan in plans.items():
        methods[name] = partial(blurs.stack, c.image, c.sigma, plan)
    for name, plan in plans.items():
        if max(plan.cells) > 1:
            full = replace(plan, cells=(1.0,) * len(plan.cells))
            methods[f"{name}, no coarse grids"] = partial(blurs.stack, c.image, c.sigma, full)
    default = plans[BLUR]
    methods["our plan, OpenCV blurs"] = partial(blurs.stack_opencv, c.image, c.sigma, default)
    planes, widths = c.image[0].permute(1, 2, 0).contiguous().numpy(), c.sigma[0, 0].numpy()
    binned = partial(blurs.hard_bins, planes, widths)
    for n in (8, 16, 32, 64):
        methods[f"{n} hard bins, kornia"] = partial(blurs.hard_bins_kornia, c.image, c.sigma, n)
        methods[f"{n} hard bins, OpenCV"] = partial(binned, n, blurs.opencv_gaussian)
    for n in (4, 8, 16):
        methods[f"{n} linear bins, OpenCV"] = partial(blurs.linear_bins, planes, widths, n)
    methods["16 hard bins, scipy"] = partial(binned, 16, blurs.scipy_gaussian)
    methods["16 hard bins, skimage"] = partial(binned, 16, blurs.skimage_gaussian)
    methods["published, 30 bins 15×15"] = partial(recipe.binned_blur, planes, widths)
    methods["two 1-D passes"] = partial(blurs.two_passes, c.image, c.sigma)
    return Contest(c, methods, BLUR, blurs=True)


def _blur_plans(c: Case, size: int) -> dict[str, BlurPlan]:
    low, high = (float(v) for v in c.sigma.aminmax())
    default = uwaug.formation.blur_demand(c.medium, DISTANCES).plan((size, size))
    plans = {}
    for tolerance in (0.01, 0.002, 0.0005, 0.0001):
        plan = plan_blur(low, high, tolerance)
        # the one that is the default, which the strength of forward scatter in this water relaxes,
        # would race itself
        if len(plan.sigmas) != len(default.sigmas) or plan.reach > 1.01 * default.reach:
            plans[f"ours, tolerance {tolerance:g}"] = plan
    plans[BLUR] = default
    return plans


def table_lookup(c: Case, table: Tensor, farthest: float, scattered: Tensor) -> Tensor:
    """Direct, share and veil (3×3 curves) interpolated linearly in a table over 0…farthest."""
    place = (c.z * ((table.shape[1] - 1) / farthest)).flatten().clamp(0, table.shape[1] - 1.001)
    index = place.int()
    left, right = table.index_select(1, index), table.index_select(1, index + 1)
    direct, share, veil = torch.lerp(left, right, place - index).reshape(3, *c.image.shape)
    return veil.addcmul_(share, scattered).addcmul_(direct, c.image)


def _table(bands: Medium, entries: int) -> Tensor:
    """The curves (9xN) at equal steps of distance."""
    z = torch.linspace(0, DISTANCES[1], entries, dtype=torch.float64)
    direct, signal, veil = bands.transmission(z), bands.signal(z), bands.backscatter(z)
    return torch.cat([direct[0], signal[0] - direct[0], veil[0]]).float()


def _rates(medium: Medium) -> str:
    return f"{medium.beta.shape[1]} + {medium.G.shape[1]} rates"


def spectra_contest(size: int, water: str) -> Contest:
    """All that a pixel does by itself: curves, veil, sum; the blurred image is given, exact."""
    c = case(size, WIDEST, water)
    scattered = c.scattered.float()
    media: dict[str, Medium] = {}
    for tolerance in np.geomspace(0.5, 1e-5, 120):
        medium = water_medium(water, tolerance=float(tolerance))
        media.setdefault(_rates(medium), medium)
    default = _rates(c.medium)
    ours = f"ours, default ({default})"
    media[ours] = c.medium
    del media[default]  # the first tolerance that gave as many
    media["7 bands"] = banded_medium(water, recipe.WAVELENGTHS)
    media["61 bands"] = bands = water_medium(water, tolerance=0.0)
    three = recipe.three_wavelengths(water)
    media["3 wavelengths"] = Medium.from_coefficients(**three)
    methods: dict[str, Method] = {}
    for name, medium in media.items():
        methods[name] = partial(medium.to(torch.float32).image, c.z, c.image, scattered)
    for n in (32, 256, 2048):
        table = _table(bands, n)
        methods[f"table of {n}"] = partial(table_lookup, c, table, DISTANCES[1], scattered)
    return Contest(c, methods, ours)


def number_contest(size: int) -> Contest:
    """The whole model on images and distances of each type."""
    c = case(size)
    methods: dict[str, Method] = {}
    for tolerance in (0.002, 1e-5):
        medium = water_medium("7C", tolerance=tolerance)
        for dtype in (torch.float64, torch.float32):
            degrade = uwaug.Underwater(medium.to(dtype), DISTANCES, tolerance, "linear")
            name = f"{str(dtype).removeprefix('torch.')}, tolerance {tolerance:g}"
            methods[name] = partial(degrade, c.image.to(dtype), c.z.to(dtype))
    return Contest(c, methods, "float32, tolerance 0.002")


def runtime_contest(size: int, backward: bool, threads: int, quick: bool) -> Contest:
    """The whole model, forward or forward and backward (to image and distance), as each runtime
    runs it.

    Eager is our default, as uwaug is without numba: `measure_eager` sees to that.
    """
    c = case(size)
    degrade = uwaug.Underwater(c.medium, DISTANCES, color_space="linear")
    models: dict[str, Model] = {
        "eager": degrade,
        "eager, no distance_range": uwaug.Underwater(c.medium, None, color_space="linear"),
        "naive kornia, 3 wavelengths": naive,
    }
    missing = [name for name in ONNX if importlib.util.find_spec(name) is None]
    skipped = []
    if quick:
        skipped = ["torch.compile (takes too long for --quick)"]
    else:
        torch.compiler.reset()
        models["torch.compile"] = torch.compile(degrade, fullgraph=True)
    if missing or quick:
        reason = f"{', '.join(missing)} missing" if missing else "too long for --quick"
        skipped.append(f"ONNX Runtime ({reason})")
    elif not backward:
        models["ONNX Runtime"] = exported(degrade, threads)
    if importlib.util.find_spec("numba") is None:
        skipped.append("compiled loops (numba missing)")
    elif not backward:
        models[LOOPS] = by_loops(degrade)
    once = forward_and_backward if backward else forward
    methods: dict[str, Method] = {}
    for name, model in models.items():
        methods[name] = partial(once, model, c)
    return Contest(c, methods, "eager", skipped=tuple(skipped))


def forward(model: Model, c: Case) -> Tensor:
    with torch.no_grad():
        return model(c.image, c.z)


def forward_and_backward(model: Model, c: Case) -> Tensor:
    image, z = (t.clone().requires_grad_() for t in (c.image, c.z))
    out = model(image, z)
    out.sum().backward()
    return out.detach()


def naive(image: Tensor, z: Tensor) -> Tensor:
    """The recipe as one writes it with kornia: three wavelengths, 30 hard bins, source order."""
    three = recipe.three_wavelengths("7C")
    channels = {name: value.float() for name, value in three.items()}
    field, phi = torch.ones_like(z), WIDEST / DISTANCES[1]
    with warnings.catch_warnings():
        # it reads the ends of its bins from tensors that record gradients
        warnings.simplefilter("ignore")
        return recipe.naive_kornia(image, z, field, channels, phi)


def exported(degrade: uwaug.Underwater, threads: int) -> Model:
    """The module as ONNX Runtime runs it."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter, about itself
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)
        path = export_onnx(degrade, Path(folder) / "model.onnx")
        run = OnnxUnderwater(path, threads)
        run(torch.zeros(1, 3, 8, 8), torch.ones(1, 1, 8, 8))  # reads the file, which is then gone
    return run
