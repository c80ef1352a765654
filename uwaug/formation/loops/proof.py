"""A small picture by which the loops are compiled, and held against PyTorch before they are used.

The loops have the laws and terms of the model once more. Where one of these was changed and the
loops were not, or a damaged file was loaded, they make another picture than PyTorch; and nothing
else would tell.
"""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from uwaug.blur.plan import BlurPlan
from uwaug.formation.colour import decoded
from uwaug.formation.development import NEUTRAL, Development
from uwaug.formation.loops.render import decode
from uwaug.formation.scene import Scene
from uwaug.formation.setup import Setup
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

_HEIGHT, _WIDTH = 16, 24
"""px."""

_PLAN = BlurPlan(
    sigma_min=0.0,
    sigma_max=9.0,
    sigmas=(0.0, 1.0, 6.0),
    cells=(1.0, 1.0, 4.0),
    coefficients=((0.5, -0.4), (0.3, 0.1), (0.2, 0.3)),
    reach=3.0,
    error=0.0,
    shape="exponential",
)
"""A sharp, a narrow and a coarse blur; the share of each depends on the width."""

_LAW = PointSpread(0.8, 0.9, shape="exponential")

_APART = 1e-4
"""Of white, or of the largest gradient: 50 times what rounding does."""


class LoopsDifferError(Exception):
    """The loops do not compute what PyTorch computes."""


def prove() -> None:
    """Run all kernels that form pictures.

    Raises:
        LoopsDifferError: if they do not make what PyTorch makes.
    """
    image, z = _scene()
    for values in (image, (255 * image).to(torch.uint8)):
        _compare("decoded light", decode(values, srgb=True), decoded(values, "srgb"))
    camera = Development(white_balance=0.5, black_point=0.5, gamut=1.0, tone=1.5)
    for medium, development in ((_grey(), NEUTRAL), (_spectral(), camera)):
        setup = Setup(medium, exposure="auto", development=development)
        scene = Scene.of(image, z, setup, recorded="eager", plan=_PLAN)
        _compare("picture", replace(scene, engine="fused").picture(), scene.picture())


def prove_gradients() -> None:
    """Run all kernels that take gradients.

    Raises:
        LoopsDifferError: if they do not make what PyTorch makes.
    """
    with torch.inference_mode(False), torch.enable_grad():
        image, z = (values.requires_grad_() for values in _scene())
        medium = _grey()
        numbers = [t.requires_grad_() for t in medium.tensors()]
        setup = Setup(Medium.of_tensors(numbers, _LAW), color_space="linear")
        scene = Scene.of(image, z, setup, recorded="eager", plan=_PLAN)
        ours, exact = (
            torch.autograd.grad(
                by.picture().square().sum(), [image, z, *numbers], retain_graph=True
            )
            for by in (replace(scene, engine="fused-gradients"), scene)
        )
    for mine, other in zip(ours, exact, strict=True):
        _compare("gradient", mine / other.abs().max(), other / other.abs().max())


def _compare(what: str, loops: Tensor, torch_alone: Tensor) -> None:
    apart = float((loops.detach() - torch_alone.detach()).abs().max())
    if not apart <= _APART:
        raise LoopsDifferError(
            f"the compiled loops make another {what} than PyTorch, {apart:.2g} apart: has a law or "
            "a term been changed? See uwaug/formation/loops/README.md"
        )


def _scene() -> tuple[Tensor, Tensor]:
    """An sRGB picture (1x3xHxW) of 0…1, and distances (1x1xHxW) from the lens to 12 m."""
    count = _HEIGHT * _WIDTH
    colours = 0.5 + 0.5 * np.sin(0.37 * np.arange(3.0 * count) ** 2)  # no neighbours are alike
    metres = 12 * np.linspace(0, 1, count) ** 2
    image, z = (torch.from_numpy(values.astype(np.float32)) for values in (colours, metres))
    return image.reshape(1, 3, _HEIGHT, _WIDTH), z.reshape(1, 1, _HEIGHT, _WIDTH)


def _grey() -> Medium:
    medium = Medium.from_coefficients(
        (0.6, 0.3, 0.2), (0.4, 0.2, 0.1), (0.1, 0.3, 0.4), b_mean=0.3, point_spread=_LAW
    )
    return medium.to(torch.float32)


def _spectral() -> Medium:
    """Channels that mix, as those of surfaces with spectra."""
    grey = _grey()
    like = grey.beta
    mixing = 1.2 * torch.eye(3, dtype=like.dtype, device=like.device) - 0.1
    beta, direct, G, signal, veil, b_mean = grey.tensors()
    weights = (mixing[:, :, None] * w[:, None] for w in (direct, signal))
    direct, signal = weights
    return Medium.of_tensors([beta, direct, G, signal, veil, b_mean], _LAW)
