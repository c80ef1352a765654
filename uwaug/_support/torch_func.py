"""Whether `torch.func` or forward-mode differentiation is at work, and values under them."""

from contextlib import AbstractContextManager

import numpy as np
import torch
from torch import Tensor
from torch.autograd import forward_ad

from uwaug._support.types import Array


def transformed() -> bool:
    """Whether `torch.func` or forward mode is at work: no tensor says so of itself."""
    if torch.compiler.is_compiling():
        return False
    active: bool = torch._C._are_functorch_transforms_active()
    return active or forward_ad._current_level >= 0


def untransformed() -> AbstractContextManager[None]:
    """Where tensors are made that no transform may wrap, such as constants."""
    context: AbstractContextManager[None] = torch._C._DisableFuncTorch()
    return context


def mapped(x: Tensor) -> bool:
    """Whether a tensor is mapped over, also as `torch.autograd.grad` does with a batch of them."""
    legacy: bool = torch._C._functorch.is_legacy_batchedtensor(x)
    return legacy or transformed()


def values(x: Tensor) -> Array:
    """The values of a tensor (N), which may be a transform's: those have no memory to look at."""
    if transformed():
        return np.array([float(value) for value in x.detach()])
    return np.asarray(x.detach().cpu().numpy())


def refuse_mapped(name: str, x: Tensor) -> None:
    """Refuse a tensor that `torch.func.vmap` runs over."""
    if transformed() and torch._C._functorch.is_batchedtensor(x):
        raise NotImplementedError(
            f"{name} is mapped over by torch.func.vmap, and its values have to be looked at: give "
            "a batch instead, (B, …) tensors and Medium.stack"
        )
