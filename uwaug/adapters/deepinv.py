"""`Underwater` as the forward operator of inverse problems in deepinv."""

from typing import Any

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.extras import install
from uwaug.formation.underwater import Underwater
from uwaug.optics.medium import Medium

try:
    from deepinv.physics import Physics
except ImportError as missing:
    raise ImportError(f"{missing.name} is missing: {install('deepinv')}") from missing


class UnderwaterPhysics(Physics):  # type: ignore[misc]
    """Forward operator y = N(A(x)), where A is the water between a scene and the camera.

    Args:
        water: an `Underwater` module, learnable or not; or a `Medium`, for `Underwater(medium)`.
            `color_space="linear"` suits noise of photons, and is not clipped.
        distance (Bx1xHxW or 1xHxW tensor): along the ray, m. A buffer: `update(distance=…)`,
            `update_parameters(distance=…)` and `physics(x, distance=…)` replace it. To change the
            water, set `physics.water`.
        options: of `deepinv.physics.Physics`, such as `noise_model`.

    A is not linear: there is no `A_adjoint`. `A_vjp` is by autograd, in image and parameters.
    `A_dagger` descends from the observed picture, or from `x_init`. Pictures x and y are as those
    of `Underwater`, floating point.

    Examples:
        >>> import deepinv, torch, uwaug
        >>> noise = deepinv.physics.GaussianNoise(0.01)
        >>> medium = uwaug.Medium.from_water("3C")
        >>> physics = UnderwaterPhysics(medium, torch.full((1, 1, 32, 48), 3.0), noise_model=noise)
        >>> physics(torch.rand(2, 3, 32, 48)).shape
        torch.Size([2, 3, 32, 48])
    """

    def __init__(self, water: Underwater | Medium, distance: Tensor, **options: Any) -> None:
        super().__init__(**options)
        checks.floating("distance", distance)
        self.water = water if isinstance(water, Underwater) else Underwater(water)
        self.register_buffer("distance", distance)

    def A(self, x: Tensor, distance: Tensor | None = None, **params: Any) -> Tensor:
        """Picture under water, without noise."""
        self.update_parameters(distance=distance, **params)
        return self.water(x, self.distance)

    def A_vjp(self, x: Tensor, v: Tensor) -> Tensor:
        """Product vᵀJ of a picture v and the Jacobian J of A at x."""
        # Physics takes it by torch.func, whose tensors Underwater cannot read
        tensors = (x, v, self.distance, *self.parameters())
        create_graph = torch.is_grad_enabled() and any(t.requires_grad for t in tensors)
        with torch.enable_grad():
            scene = x if x.requires_grad else x.detach().requires_grad_()
            (product,) = torch.autograd.grad(self.A(scene), scene, v, create_graph=create_graph)
        return product

    def A_dagger(self, y: Tensor, x_init: Tensor | None = None) -> Tensor:
        """Scene that looks like y under water, by gradient descent; see `Physics`."""
        return super().A_dagger(y, y if x_init is None else x_init)  # type: ignore[no-any-return]
