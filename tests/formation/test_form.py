"""Image formation against the equations: terms, their sum, batches, width laws."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from referees import reference
from referees.terms import check
from scenes import LAW, coefficients, rand, stepped, uniform
from torch import Tensor

from uwaug import Development, Medium, PointSpread, Terms, Underwater, form_image
from uwaug.formation.image import form
from uwaug.formation.setting import Setting


@pytest.mark.parametrize("surfaces", ["grey", "spectral"])
def test_parts_add_up_to_the_image(surfaces: Any) -> None:
    medium = Medium.from_water("7C", surfaces=surfaces, point_spread=PointSpread(2.0))
    J, soft, z = rand(2, 3, 20, 30), rand(2, 3, 20, 30, seed=1), stepped(2, 1, 20, 30)
    z[0, 0, 0, 0] = 0
    parts = medium.parts(z, J, soft).values()
    torch.testing.assert_close(sum(parts), medium.image(z, J, soft), rtol=0, atol=1e-14)
    module, terms = Underwater(medium, None, color_space="linear"), form_image(J, z, medium)
    torch.testing.assert_close(module(J, z), terms.image, rtol=0, atol=1e-12)


@pytest.mark.parametrize("batch", [(3, 1, 1), (3, 3, 3), (1, 1, 3), (1, 3, 1)], ids=str)
def test_batches_broadcast(batch: tuple[int, int, int]) -> None:
    images, maps, media = batch
    image = torch.from_numpy(np.stack([reference.picture(20, 36, seed) for seed in range(images)]))
    z = stepped(maps, 1, 20, 36)
    laws = PointSpread(0.5, 0.5), PointSpread(3.0, 1.0), PointSpread(0.0)
    medium = Medium.stack([coefficients(seed, laws[seed]) for seed in range(media)])
    terms = form_image(image, z, medium)
    assert terms.image.shape == (max(batch), 3, 20, 36)
    check(terms, image, z, medium)
    # without a batch
    alone = form_image(image[0], z[0], medium).image
    assert alone.shape == ((media,) if media > 1 else ()) + (3, 20, 36)


def water(name: str = "3C", **options: Any) -> Medium:
    return Medium.from_water(name, **{"point_spread": LAW, "tolerance": 0, **options})


def spectra(**options: Any) -> Medium:
    return water(surfaces="spectral", **options)


def spread(*law: Any, **unit: Any) -> Medium:
    return coefficients(law=PointSpread(*law, **unit))


def same(z: Tensor) -> Tensor:
    return z


def open_water(z: Tensor) -> Tensor:
    return torch.where(z > 3, math.inf, z)


def one_pixel_of_open_water(z: Tensor) -> Tensor:
    """Its distance stretches the range that the blur is planned for."""
    far = 4 + z
    far[..., 0, 0] = math.inf
    return far


TAILS = PointSpread(0.03 * 35.0, 0.62, "exponential")
# a medium, and what becomes of the distances
MEDIA: dict[str, tuple[Callable[[], Medium], Callable[[Tensor], Tensor]]] = {
    "the lens and open water": (coefficients, lambda z: torch.where(z > 3, math.inf, 0.0).to(z)),
    "absurdly far": (coefficients, lambda z: 1e20 * z),
    "almost at the lens": (coefficients, lambda z: 1e-12 * z),
    "nothing is lost, open water": (uniform(0.5, 0.0), open_water),
    "no light is kept": (lambda: water(g=1.0), same),
    "deep down": (lambda: water(vertical_depth=500.0), same),
    "colours, reduced": (lambda: spectra(tolerance=0.002), same),
    "colours, some open water": (spectra, open_water),
    "colours deep down": (lambda: spectra(vertical_depth=500.0), same),
    "colours, no light is kept": (lambda: spectra(g=1.0), same),
    "optical depth 1e-4": (uniform(1e-4, 3e-5), same),
    "widths of the paper": (lambda: spread(20.0, 0.5, unit="paper"), same),
    "heavy tails": (lambda: spread(1.65, 0.62, "exponential"), same),
    "narrow heavy tails": (lambda: spread(0.6, 0.62, "exponential"), same),
    "wide heavy tails": (lambda: spread(9.0, 0.62, "exponential"), same),
    "one far pixel": (lambda: water("9C", point_spread=PointSpread(2.0, 1.0)),
                      one_pixel_of_open_water),
    "one far pixel, heavy tails": (lambda: water("I", point_spread=TAILS), one_pixel_of_open_water),
    "a blur far wider than the image": (lambda: spread(3000.0, 0.3), same),
    "a steep width law, open water": (lambda: spread(0.5, 3.0), open_water),
    "a flat width law": (lambda: spread(3.0, 0.3), lambda z: (z - 2).clamp(min=0)),
    "a blur without end": (
        uniform(0.5, 0.0, 0.2, 1.0, PointSpread(2.0, 1.0)),
        lambda z: torch.logspace(-1, 9, 20).double().expand_as(z),
    ),
}  # fmt: skip


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("name", MEDIA)
def test_terms_are_right_and_slopes_finite(name: str, dtype: torch.dtype) -> None:
    """At singular points beside those of the stability matrix, and under every law of widths."""
    make, change = MEDIA[name]
    medium, z = make(), change(stepped(1, 1, 16, 20)).to(dtype)
    image = torch.from_numpy(reference.picture(16, 20)).to(dtype)[None]
    leaves = [t.clone().requires_grad_() for t in (image, z, *medium.tensors()[:8])]
    terms = form_image(*leaves[:2], Medium(*leaves[2:], law=medium.law))
    detached = Terms(*(term.detach() for term in (*terms, terms.image)))
    check(detached, image, z.double(), medium)
    (terms.image * rand(1, 3, 16, 20, seed=9).to(dtype)).sum().backward()
    for leaf_name, leaf in zip(("image", "distance", *Medium.TENSORS), leaves, strict=False):
        assert leaf.grad is None or leaf.grad.isfinite().all(), leaf_name
    assert all(leaf.grad is not None for leaf in leaves[:2])


@pytest.mark.parametrize("tolerance", [0.02, 0.0002])
def test_every_tolerance_is_kept(tolerance: float) -> None:
    # a channel that hardly fades scatters for a kilometre, the others for metres
    beta, G, law = (0.5, 0.9, 7.0), (0.004, 0.02, 0.024), PointSpread(1.3, 1.14)
    clear = Medium.from_coefficients(beta, G, (0.3,) * 3, b_mean=0.32, point_spread=law)
    image = torch.from_numpy(reference.picture(60, 30))[None]
    for medium in (clear, coefficients(law=PointSpread(3.0, 1.0))):
        for far in (1.0, math.inf):
            z = stepped(1, 1, 60, 30)
            z[..., -1, :] *= far
            check(form_image(image, z, medium, tolerance=tolerance), image, z, medium, tolerance)


@pytest.mark.parametrize("dtype, precision", [(torch.float32, 3e-5), (torch.float64, 1e-12)])
def test_the_veil_is_as_precise_near_as_far(dtype: torch.dtype, precision: float) -> None:
    # either side of where 1 − e^−x begins to cancel
    medium = coefficients().to(dtype)
    depths = torch.tensor([1e-6, 0.9 / 256, 1.1 / 256, 0.3, 5.0], dtype=dtype)
    z = (depths / float(medium.G.min())).expand(1, 1, 2, 5)
    veil = form_image(torch.rand(1, 3, 2, 5, dtype=dtype), z, medium).backscatter
    wanted = reference.medium_curves(medium, z[0, 0].double().numpy()).veil
    np.testing.assert_allclose(veil[0].double().numpy(), wanted, rtol=precision)


# ---- gradients


@pytest.mark.parametrize("space", ["linear", "srgb"])
def test_gradients_of_image_distance_and_coefficients(space: Any) -> None:
    image, z = 0.1 + 0.8 * rand(1, 3, 4, 5), 0.5 + 3 * rand(1, 1, 4, 5, seed=1)
    given = [t.clone() for t in coefficients().tensors()]
    leaves = [leaf.requires_grad_() for leaf in (image, z, *given[:8])]
    medium = Medium(*given)
    plan = Underwater(medium, (0.4, 4.0), tolerance=0.02).plan((4, 5))

    development = Development(exposure=1.0, saturation=1.2, gamut=0.5)

    def formed(image: Tensor, z: Tensor, *tensors: Tensor) -> Tensor:
        setting = Setting(Medium(*tensors), None, development, color_space=space)
        return form(image, z, setting, plan=plan)

    # weights that are 0 stay, as a sum of exponentials of one channel has no others
    assert torch.autograd.gradcheck(formed, leaves, atol=1e-5)
