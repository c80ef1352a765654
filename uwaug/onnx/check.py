"""Checks of an exported file against its module."""

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from uwaug._support.extras import require
from uwaug._support.onnx_session import Session
from uwaug.blur.plan import BlurPlan
from uwaug.formation.image import form
from uwaug.formation.inputs import effective_distance
from uwaug.formation.setting import Setting
from uwaug.formation.underwater import Underwater
from uwaug.light import Light
from uwaug.onnx.run import coefficients_of, module_of, read_metadata
from uwaug.optics.medium import Medium

_TOLERANCE = 2e-5  # largest difference of a picture in single precision from one in double
_LARGEST_PX = 512  # largest side of the one large picture of a check


@dataclass(frozen=True)
class Report:
    """Result of `check_onnx`: number of cases, the largest difference, and its case."""

    cases: int
    worst: float
    where: str

    def __str__(self) -> str:
        return f"{self.cases} cases, largest difference {self.worst:.2g} ({self.where})"


def check_onnx(
    path: str | os.PathLike[str],
    module: Underwater | None = None,
    *,
    progress: Callable[[str], None] | None = None,
) -> Report:
    """Check an exported file against its module: ONNX Runtime, with optimisations off and on,
    against PyTorch in float64, for batches, sizes and distances of all kinds.

    Args:
        path, module: the file, and its module; None for the one that its metadata describe.
        progress: a function that is told each step.

    Raises:
        ImportError: if the onnx extra is not installed.
        ValueError: naming the worst case, if a picture differs by more than 2e-5 (times the factor
            by which its development brightens; under lamps, of its brightest value); or if the
            module hardly changes a picture.
    """
    (onnx,) = require("onnx", "onnx")
    metadata = read_metadata(path)
    try:
        onnx.checker.check_model(os.fspath(path), full_check=True)
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError) as error:
        raise ValueError(f"{path}: onnx.checker refuses it: {error}") from error
    module = module_of(path, metadata) if module is None else module
    takes_coefficients = metadata["uwaug_coefficients"] == "inputs"
    own = module.setting
    media = [own.medium[i] for i in range(len(own.medium))]
    if takes_coefficients:
        media += _unrelated_media(own.medium)
    limit = _TOLERANCE * max(own.development.brightening, 1.0)
    sessions = {"off": Session(path, 1, optimise=False), "on": Session(path, 1)}
    differences: list[tuple[float, str]] = []
    change = 0.0
    cases = list(_cases(module))
    for number, (case, image, distance) in enumerate(cases):
        if progress:
            progress(f"checking, case {number + 1} of {len(cases)}")
        # all media in turn, one for each image of a batch
        in_turn = [media[(number + i) % len(media)] for i in range(len(image))]
        medium = media[0] if len(media) == 1 else Medium.stack(in_turn)
        inputs = {"image": image, "distance": distance}
        if own.development.noise is not None:
            seeded = torch.Generator().manual_seed(number)
            inputs["noise"] = torch.randn(image.shape, generator=seeded, dtype=torch.float32)
        light = own.light
        if light is not None and takes_coefficients:
            light = _varied(light, number, len(image))
        exact = _exact(replace(own, medium=medium, light=light), plan_of(module), inputs)
        change = max(change, float((exact - image).abs().max()))
        # a near lamp goes far beyond white, where single precision has digits less
        brightest = max(1.0, float(exact.max())) if light is not None and light.lamps else 1.0
        if takes_coefficients:
            inputs |= coefficients_of(medium.expand(len(image)), light)
        for state, session in sessions.items():
            name = f"{case}, optimisations {state}"
            off = _difference(path, session, inputs, exact, name)
            differences.append((off / brightest, name))
    worst, where = max(differences)
    if worst > limit:
        got = f"{worst:.3g} (limit {limit:g}) at {where}"
        raise ValueError(f"{path}: differs from float64 eager by {got}")
    if change <= 2 * limit:
        raise ValueError(f"module changes pictures by {change:.2g} at most: too little to check")
    return Report(len(differences), worst, where)


def plan_of(module: Underwater) -> BlurPlan:
    """Plan of a module with `sides`, for pictures of any size."""
    plan = module.plan((1, 1))
    assert plan is not None
    return plan


def _varied(light: Light, number: int, batch: int) -> Light:
    factor = 2.0 ** (number % 3 - 1)
    lamps = tuple(replace(lamp, power=factor * lamp.power) for lamp in light.lamps)
    pitch = None if light.pitch is None else torch.linspace(-60.0, 60.0, batch + 2)[1:-1]
    return replace(light, lamps=lamps, pitch=pitch)


@torch.no_grad()
def _exact(setting: Setting, plan: BlurPlan, inputs: dict[str, Tensor]) -> Tensor:
    image, distance, *noise = (x.double() for x in inputs.values())
    z = effective_distance(distance, None, torch.float64)
    setting = replace(setting, medium=setting.medium.to(torch.float64))
    return form(image, z, setting, plan=plan, normals=noise[0] if noise else None)


def _difference(
    path: Any, session: Session, inputs: dict[str, Tensor], exact: Tensor, case: str
) -> float:
    """Largest difference of a file's result; inf if it holds NaN."""
    try:
        result = session(inputs)
    except Exception as error:  # ONNX Runtime's have no common base
        raise ValueError(f"{path}: fails at {case}: {error}") from error
    if result.shape != exact.shape:
        raise ValueError(f"{path}: gives {result.shape}, not {exact.shape}, at {case}")
    difference = float((result.double() - exact).abs().max())
    return math.inf if math.isnan(difference) else difference


def _cases(module: Underwater) -> Iterator[tuple[str, Tensor, Tensor]]:
    """Name, pictures and distances, in float32, of each batch on which a file is checked."""
    assert module.distance_range is not None
    assert module.sides is not None
    rng = torch.Generator().manual_seed(0)
    near, far = module.distance_range[0], min(module.distance_range[1], 100.0)
    # the ends of the plan's sizes, as far as they run quickly
    small, large = (min(max(side, 8), 144) for side in module.sides)
    widest = min(module.sides[1], _LARGEST_PX)
    for kind, batch, height, width in (
        ("random", 1, 1, 1),
        ("step", 2, 1, 9),
        ("random", 5, 7, 5),
        ("open water behind", 1, small, small + 16),
        ("constant", 5, small + 1, small),
        ("the lens", 2, 65, 33),
        ("beyond the range", 1, large, large + 1),
        ("beyond white", 2, 99, 133),
        # the widest blurs show in the largest pictures alone
        ("ramp", 1, widest, widest),
    ):
        shape = (batch, 1, height, width)
        image = torch.rand(batch, 3, height, width, generator=rng, dtype=torch.float32)
        image *= 1.8 if kind == "beyond white" else 1.0
        ramp = torch.linspace(0, 1, width, dtype=torch.float32).expand(shape)
        between = near + (far - near) * ramp
        random = torch.rand(shape, generator=rng, dtype=torch.float32)
        distance = {
            "constant": torch.full_like(ramp, 0.7 * near + 0.3 * far),
            "step": torch.where(ramp > 0.5, far, near),
            "random": near + (far - near) * random,
            "the lens": torch.zeros_like(ramp),
            "beyond the range": 3 * far + between,
            "open water behind": torch.where(ramp > 0.5, torch.inf, between),
        }.get(kind, between)
        yield f"{kind}, {batch}×{height}×{width}", image, distance


def _unrelated_media(medium: Medium) -> list[Medium]:
    """Media of one and of five rates, with other width laws, that a file accepts."""

    def unrelated(count: int, scale: float, exponent: float) -> Medium:
        rates = torch.linspace(0.1, 1.0, count, dtype=torch.float64)[None]
        of_channel = torch.linspace(0.6, 1.0, 3, dtype=torch.float64)[None, :, None]
        weights = of_channel.expand(1, 3, count) / count
        signal = weights
        if medium.is_spectral:  # some of them negative
            signal = (1.4 * torch.eye(3, dtype=torch.float64) - 0.2)[..., None] * weights[:, None]
        return replace(
            medium[0].without_lamps().to(torch.float64),
            beta=rates,
            direct_weights=signal,
            G=0.4 * rates,
            signal_weights=signal,
            veil_weights=0.3 * weights,
            b_mean=rates.new_tensor([0.7]),
            scale=rates.new_tensor([scale * float(medium.scale.max())]),
            exponent=rates.new_tensor([exponent]),
            notes=("check",),
        )

    return [unrelated(1, 1.5, 1.0), unrelated(5, 2.5, 0.6)]
