"""An exported file against the module it came from."""

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.extras import require
from uwaug._support.onnx_session import Session
from uwaug.formation.underwater import Underwater
from uwaug.onnx.graph import parameters_of, plan_of
from uwaug.onnx.metadata import Stored, read_metadata, stored_in
from uwaug.optics.medium import Medium

_MOST_CHECKED = 1024  # px: the one large picture of a check is no larger, so that it is quickly run

_EQUAL, _SLOPES = 1e-5, 2e-4
"""Of a picture in single precision to one in double; where its light follows from slopes."""


@dataclass(frozen=True)
class Report:
    """What `check_onnx` found: cases run, the largest difference, and where it was."""

    cases: int
    worst: float
    where: str


class _Case(NamedTuple):
    """A batch to check a file on, in the types that it takes."""

    name: str
    image: Tensor
    distance: Tensor
    field: Tensor


def check_onnx(
    path: str | os.PathLike[str],
    module: Underwater,
    *,
    tolerance: float | None = None,
    progress: Callable[[str], None] | None = None,
) -> Report:
    """Check an exported file against the module it came from.

    `onnx.checker`, then ONNX Runtime with optimisations off and on against float64 eager with the
    same plan, over batches 1, 2, 5, odd, even, non-square, smallest and largest sizes, and
    constant, ramp, step, random, zero, far and infinite distances. A file that takes its parameters
    as inputs is given media of other numbers of rates, and one per image.

    Args:
        path: the file.
        module: what it was exported from.
        tolerance: largest difference of a float image (0…1); uint8 images may differ by one level.
            By default 1e-5; with a lamp or a sun 2e-4, as PyTorch in single precision: their light
            follows from slopes of the distance map, which lose digits.
        progress: is told what is being done.

    Raises:
        ImportError: if the onnx extra is not installed.
        OSError: if the file cannot be read.
        ValueError: naming the worst case, if it exceeds the tolerance; or if the module itself
            hardly changes a picture, so that a graph that returns its input would pass.
    """
    (onnx,) = require("onnx", "onnx")
    metadata = read_metadata(path)
    try:
        onnx.checker.check_model(os.fspath(path), full_check=True)
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError) as error:
        raise ValueError(
            f"{path}: onnx.checker refuses it: {str(error).splitlines()[0]}"
        ) from error
    stored = stored_in(path, metadata)
    options, plan = stored.options, plan_of(module)
    if not checks.alike(asdict(plan), asdict(stored.plan)):
        raise ValueError(
            f"{path}: made for {metadata['uwaug_plan']}, but module asks for {plan} here: "
            "it is from another module or version; export it again"
        )
    media = [module.medium[i] for i in range(len(module.medium))]
    if options.parameters == "inputs":
        media += _unrelated_media(module.medium)
    quantised = options.image == "uint8"
    limit = 1.0 if quantised else tolerance or limit_of(module)
    sessions = {"off": Session(path, 1, optimise=False), "on": Session(path, 1)}
    differences: list[tuple[float, str]] = []
    moved = 0.0
    cases = list(_cases(stored))
    for number, case in enumerate(cases):
        if progress is not None:
            progress(f"checking, case {number + 1} of {len(cases)}")
        medium = _for_batch(media, number, len(case.image))
        rows = {"image": case.image, "distance": case.distance}
        if options.field == "input":
            rows["field"] = case.field
        field = rows["field"].double() if "field" in rows else None
        # uint8 stays uint8, so that its result is rounded and clipped
        image = case.image if quantised else case.image.double()
        with torch.no_grad():
            eager = module.formed(
                image, case.distance.double(), field, medium.to(torch.float64), plan
            )
        moved = max(moved, float((eager.double() - case.image).abs().max()))
        if options.parameters == "inputs":
            for name, value in parameters_of(medium).items():
                rows[name] = value.expand(len(image), *value.shape[1:])
        for state, session in sessions.items():
            where = f"{case.name}, optimisations {state}"
            differences.append((_apart(path, session, rows, eager, where), where))
    worst, where = max(differences)
    if worst > limit:
        raise ValueError(
            f"{path}: differs from float64 eager by {worst:.3g} (limit {limit:g}) at {where}"
        )
    if moved <= 2 * limit:
        danger = "a graph that returns its input would pass"
        raise ValueError(f"module changes a picture by {moved:.2g} at most: {danger}")
    return Report(len(differences), worst, where)


def limit_of(module: Underwater) -> float:
    """The largest difference that passes by default; in linear light a development multiplies it
    as it does the picture.
    """
    lit = module.light is not None and module.light.has_view
    return (_SLOPES if lit else _EQUAL) * module.development.gain


def _apart(
    path: str | os.PathLike[str],
    session: Session,
    rows: dict[str, Tensor],
    eager: Tensor,
    where: str,
) -> float:
    """The largest difference of the result of a file from eager's; inf if it holds NaN."""
    try:
        out = session(rows)
    except Exception as error:  # of ONNX Runtime, see Session
        raise ValueError(f"{path}: fails at {where}: {str(error).splitlines()[0]}") from error
    if out.shape != eager.shape:
        raise ValueError(f"{path}: gives {tuple(out.shape)}, not {tuple(eager.shape)}, at {where}")
    apart = float((out.double() - eager.double()).abs().max())
    return math.inf if math.isnan(apart) else apart


def _cases(stored: Stored) -> Iterator[_Case]:
    """Batches, sizes and distances on which a file is checked."""
    rng = torch.Generator().manual_seed(0)
    near, far = stored.distance_range[0], min(stored.distance_range[1], 100.0)

    def case(name: str, image: Tensor, distance: Tensor, field: Tensor) -> _Case:
        if stored.options.image == "uint8":
            image = (image * 255).round().to(torch.uint8)
        batch, _, h, w = image.shape
        return _Case(f"{name}, {batch}×{h}×{w}", image, distance, field)

    # the ends of what the plan serves, as far as they are quickly run
    small, large = (min(max(side, 8), 144) for side in stored.sides)
    sizes = (
        (1, 1, 1),
        (2, 1, 9),
        (5, 7, 5),
        (1, small, small + 16),
        (5, small + 1, small),
        (2, 65, 33),
        (1, large, large + 1),
    )
    for batch, h, w in sizes:
        shape = (batch, 1, h, w)
        image = (1.2 * torch.rand(batch, 3, h, w, generator=rng, dtype=torch.float32) - 0.1).clamp(
            0, 1
        )
        field = 0.7 + 0.6 * torch.rand(shape, generator=rng, dtype=torch.float32)
        ramp = torch.linspace(0, 1, w, dtype=torch.float32).expand(shape)
        within = {
            "constant": torch.full_like(field, 0.3),
            "ramp": ramp,
            "step": torch.where(ramp > 0.5, 1.0, 0.0),
            "random": torch.rand(shape, generator=rng, dtype=torch.float32),
        }
        distances = {name: near + (far - near) * t for name, t in within.items()}
        distances["the lens"] = torch.zeros_like(field)
        distances["beyond the range"] = torch.full_like(field, 3 * far)
        distances["open water behind"] = torch.where(ramp > 0.5, torch.inf, distances["ramp"])
        for name, distance in distances.items():
            yield case(name, image, distance, field)
    if stored.setup.light is None:
        # several strips (see `uwaug.onnx.strips`), of which the last is not full; beyond white
        top = 1.0 if stored.options.image == "uint8" else 1.8
        image = top * torch.rand(2, 3, 199, 233, generator=rng, dtype=torch.float32)
        parts = torch.rand(2, 2, 1, 199, 233, generator=rng, dtype=torch.float32)
        yield case("strips", image, near + (far - near) * parts[0], 0.7 + 0.6 * parts[1])
    if stored.sides[1] > large:
        # the widest blurs show in the largest pictures alone
        side = min(stored.sides[1], _MOST_CHECKED)
        image = torch.rand(1, 3, side, side, generator=rng, dtype=torch.float32)
        ramp = torch.linspace(0, 1, side, dtype=torch.float32).expand(1, 1, side, side)
        yield case("ramp", image, near + (far - near) * ramp, torch.ones_like(ramp))


def _unrelated_media(medium: Medium) -> list[Medium]:
    """Media of one and of five rates, with other width laws, all of the kind that a file with
    `medium` takes.
    """

    def unrelated(k: int, scale: float, exponent: float) -> Medium:
        rates = torch.linspace(0.1, 1.0, k, dtype=torch.float64)[None]
        weights = (
            torch.linspace(0.6, 1.0, 3, dtype=torch.float64)[None, :, None].expand(1, 3, k) / k
        )
        law = replace(medium.point_spread, scale=scale, exponent=exponent)
        signal = weights
        if medium.is_spectral:  # some of them negative
            mixing = 1.4 * torch.eye(3, dtype=torch.float64) - 0.2
            signal = mixing[:, :, None] * weights[:, None]
        return Medium(
            rates,
            signal,
            0.4 * rates,
            signal,
            0.3 * weights,
            rates.new_tensor([0.7]),
            law,
            ("check",),
        )

    return [unrelated(1, 1.5, 1.0), unrelated(5, 2.5, 0.6)]


def _for_batch(media: list[Medium], number: int, batch: int) -> Medium:
    """The medium of a case: all media in turn, one for each image of a batch."""
    if len(media) == 1:
        return media[0]
    return Medium.stack([media[(number + i) % len(media)] for i in range(batch)])
