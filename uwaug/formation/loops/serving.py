"""What the compiled loops take, and what stays with PyTorch."""

import torch
from torch import Tensor

from uwaug._support.torch_func import transformed
from uwaug.formation.loops.loops import ready
from uwaug.formation.loops.switch import Path, followed
from uwaug.optics.medium import Medium

__all__ = ["decodes", "serves", "takes"]


def serves(
    light: Tensor, z: Tensor, medium: Medium, order: str, wanted: Path | None = None
) -> bool:
    """Whether the loops take this input, prepared as for `uwaug.formation.form`, but that the
    medium may be of float64; `wanted` is what a record names.
    """
    if order != "line_of_sight" or not _can_run((light, z), wanted):
        return False
    law = medium.point_spread.numbers().values()
    numbers = (*medium.tensors(), *(v for v in law if isinstance(v, Tensor)))
    if not all(map(_is_small_table, numbers)) or not all(light.shape) or not all(z.shape):
        return False
    recorded = torch.is_grad_enabled() and any(t.requires_grad for t in (light, z, *numbers))
    return not recorded and light.shape[1] == 3


def decodes(image: Tensor, wanted: Path | None) -> bool:
    """Whether the loops decode this picture; `wanted` as for `serves`."""
    recorded = torch.is_grad_enabled() and image.requires_grad
    return not recorded and _can_run((image,), wanted) and all(image.shape)


def takes(tensors: tuple[Tensor, ...]) -> bool:
    """Whether the loops for gradients can read these, and may."""
    return _can_run(tensors, None) and all(all(t.shape) for t in tensors) and ready(gradients=True)


def _can_run(tensors: tuple[Tensor, ...], wanted: Path | None) -> bool:
    if torch.compiler.is_compiling() or followed(wanted) == "eager":
        return False
    tracing = torch.jit.is_tracing()  # type: ignore[attr-defined, no-untyped-call]
    taken = not (tracing or transformed()) and all(map(_is_plain, tensors))
    return taken and ready()


def _is_plain(value: Tensor) -> bool:
    """Whether a tensor has memory that numba can read."""
    return _is_here(value) and value.dtype in (torch.float32, torch.uint8)


def _is_small_table(value: Tensor) -> bool:
    """Whether a tensor can be copied into a table."""
    return _is_here(value) and value.dtype in (torch.float32, torch.float64)


def _is_here(value: Tensor) -> bool:
    return type(value) in (Tensor, torch.nn.Parameter) and value.device.type == "cpu"
