import itertools
import math
from collections.abc import Iterator

import pytest
import torch
from referees.terms import TERMS
from scenes import coefficients, rand, stepped, tracked
from torch import Tensor

from uwaug.formation.demand import blur_demand
from uwaug.formation.model import form_image
from uwaug.formation.underwater import Underwater
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
@pytest.mark.parametrize("grad", [False, True])
def test_half_precision_is_computed_in_single(dtype, grad) -> None:
    image = rand(2, 3, 20, 24).to(dtype)
    z = stepped(2, 1, 20, 24).to(dtype)
    field = (0.7 + 0.6 * rand(2, 1, 20, 24)).to(dtype)
    image.requires_grad_(grad)
    terms = form_image(image, z, coefficients(), field)
    single = form_image(image.float(), z.float(), coefficients(), field.float())
    for name in TERMS:
        half, rounded = getattr(terms, name), getattr(single, name).to(dtype)
        assert half.dtype == dtype
        torch.testing.assert_close(half, rounded, rtol=0, atol=0)
    if grad:
        terms.image.sum().backward()
        assert image.grad.dtype == dtype
        assert image.grad.isfinite().all()


def test_the_result_has_the_type_of_the_image() -> None:
    image, z = rand(1, 3, 8, 8), stepped(1, 1, 8, 8)
    for dtype, other in itertools.product((torch.float16, torch.float32, torch.float64), repeat=2):
        medium = coefficients().to(torch.float32 if other == torch.float16 else other)
        result = form_image(image.to(dtype), z.to(other), medium)
        assert result.image.dtype == dtype


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
@pytest.mark.parametrize("grad", [False, True])
def test_autocast_changes_nothing(dtype, grad) -> None:
    image = rand(1, 3, 40, 33, dtype=torch.float32).requires_grad_(grad)
    z = stepped(1, 1, 40, 33).float()
    medium = Medium.stack([coefficients(), coefficients(5)])
    expected = form_image(image, z, medium).image
    with torch.autocast("cpu", dtype):
        result = form_image(image, z, medium).image
    assert torch.equal(result, expected)


@pytest.mark.parametrize("grad", [False, True])
def test_layout_does_not_matter(grad) -> None:
    image, z = rand(2, 3, 30, 22), stepped(2, 1, 30, 22)
    medium = tracked(coefficients()) if grad else coefficients()
    expected = form_image(image, z, medium).image
    last = {"memory_format": torch.channels_last}
    padded = torch.nn.functional.pad(image, (3, 4, 1, 2))
    permuted = image.permute(0, 2, 3, 1).contiguous()
    layouts = {
        "channels last": (image.contiguous(**last), z.contiguous(**last)),
        "transposed": (image.mT.contiguous().mT, z.mT.contiguous().mT),
        "sliced": (padded[..., 1:-2, 3:-4], z.repeat(1, 2, 1, 1)[:, 1:]),
        "channels from the back": (permuted.permute(0, 3, 1, 2), z),
    }
    for name, (x, y) in layouts.items():
        assert not (x.is_contiguous() and y.is_contiguous()), name
        torch.testing.assert_close(form_image(x, y, medium).image, expected, rtol=0, atol=1e-13)
    grey = image[:, :1].expand(-1, 3, -1, -1)
    expanded, copied = (form_image(g, z, medium).image for g in (grey, grey.contiguous()))
    torch.testing.assert_close(expanded, copied, rtol=0, atol=1e-13)


def test_inputs_are_left_alone() -> None:
    image = rand(2, 3, 12, 12)
    z = stepped(2, 1, 12, 12)
    field = rand(2, 1, 12, 12)
    medium = coefficients()
    z[0, 0, 0, 0] = math.inf
    inputs = (image, z, field, *medium.tensors())
    copies = [t.clone() for t in inputs]
    form_image(image, z, medium, field)
    assert all(torch.equal(a, b) for a, b in zip(copies, inputs, strict=True))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_values_that_would_spread_are_refused(value: float) -> None:
    image = rand(1, 3, 8, 9)
    image[0, 1, 2, 3] = value
    counts = "NaN at 1 and infinite at 0" if math.isnan(value) else "NaN at 0 and infinite at 1"
    with pytest.raises(ValueError, match=f"image is {counts} of 216 values: expected finite"):
        form_image(image, stepped(1, 1, 8, 9), coefficients())
    for color_space in ("srgb", "linear"):
        degrade = Underwater(coefficients(), color_space=color_space)
        with pytest.raises(ValueError, match=f"image is {counts} of 216 values"):
            degrade(image.float(), stepped(1, 1, 8, 9).float())


@pytest.mark.parametrize("size", [(1, 1), (8, 9), (200, 3), (130, 170)])
def test_millimetres_are_refused(size: tuple[int, int]) -> None:
    image, z = rand(1, 3, *size), 1.2 + stepped(1, 1, *size)
    open_water = (1000 * z).masked_fill(rand(1, 1, *size, seed=2) < 0.4, math.inf)
    open_water[..., 0, 0] = 2000.0
    for wrong in (1000 * z, open_water):
        with pytest.raises(ValueError, match=r"distance must be in metres.*divide by 1000"):
            form_image(image, wrong, coefficients())
    with pytest.raises(ValueError, match=r"distance must be in metres.*divide by 1000"):
        Underwater(coefficients())(image.float(), 1000 * z.float())


def test_far_distances_are_no_millimetres() -> None:
    image = rand(1, 3, 40, 50)
    for far in (1000.0, 1e7, 1e9, math.inf):
        form_image(image, torch.full((1, 1, 40, 50), far), coefficients())
    # mountains behind a near scene, and unknown pixels at the lens
    z = torch.full((1, 1, 40, 50), 3.0)
    z[..., :8, :], z[..., 30:, :] = 5000.0, 0.0
    z[..., 8:14, :] = math.inf
    form_image(image, z, coefficients())


def test_normalised_pictures_are_refused() -> None:
    image, z = rand(1, 3, 8, 9, dtype=torch.float32), stepped(1, 1, 8, 9).float()
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    normalised = (image - mean.view(3, 1, 1)) / std.view(3, 1, 1)
    with pytest.raises(ValueError, match=r"image falls to -.*; place it before Normalize"):
        Underwater(coefficients())(normalised, z)
    Underwater(coefficients())(image - 0.1, z)  # as resampling overshoots
    Underwater(coefficients(), color_space="linear")(normalised, z)


@pytest.fixture
def deterministic() -> Iterator[None]:
    torch.use_deterministic_algorithms(True)
    yield
    torch.use_deterministic_algorithms(False)


@pytest.mark.usefixtures("deterministic")
def test_deterministic_algorithms() -> None:
    grads = []
    for _ in range(2):
        image, z = rand(2, 3, 40, 40).requires_grad_(), stepped(2, 1, 40, 40).requires_grad_()
        medium = tracked(coefficients(law=PointSpread(4.0, 0.5)))
        form_image(image, z, medium).image.square().sum().backward()
        form_image(image.detach(), z.detach(), coefficients())
        grads.append((image.grad, z.grad))
    assert all(torch.equal(a, b) for a, b in zip(*grads, strict=True))


@pytest.mark.parametrize("order", ["line_of_sight", "source"])
def test_gradcheck(order) -> None:
    medium = coefficients()
    plan = blur_demand(medium, (0.2, 8.0), 0.01).plan((4, 5))

    def evaluate(
        image: Tensor, z: Tensor, field: Tensor, scale: Tensor, exponent: Tensor, *tensors: Tensor
    ) -> Tensor:
        learned = Medium(*tensors, PointSpread(scale, exponent))
        return form_image(image, z, learned, field, order=order, plan=plan).image

    inputs = [
        rand(1, 3, 4, 5),
        stepped(1, 1, 4, 5),
        0.7 + 0.6 * rand(1, 1, 4, 5),
        torch.tensor([1.2]),
        torch.tensor([0.8]),
        *medium.tensors(),
    ]
    assert torch.autograd.gradcheck(evaluate, [t.double().clone().requires_grad_() for t in inputs])


GOOD = {
    "image": torch.rand(2, 3, 6, 8),
    "distance": 1 + torch.rand(2, 1, 6, 8),
    "medium": coefficients(),
}


MIXED = torch.rand(2, 1, 6, 8)


MIXED[0, 0, :2, 0] = math.nan


MIXED[1, 0, :3, 0] = -1


@pytest.mark.parametrize(
    "change, error, match",
    [
        ({"image": (255 * GOOD["image"]).byte()}, TypeError, r"image.*uint8.*0…255"),
        ({"image": GOOD["image"].numpy()}, TypeError, "image.*ndarray"),
        ({"distance": GOOD["distance"].long()}, TypeError, "distance.*int64"),
        ({"distance": 3.0}, TypeError, "distance.*float"),
        ({"distance": None}, TypeError, "distance.*NoneType"),
        ({"field": 1.0}, TypeError, "field.*float"),
        ({"medium": Water.jerlov("II")}, TypeError, "medium.*Water"),
        ({"image": torch.rand(6, 8)}, ValueError, r"image.*\(6, 8\)"),
        ({"image": torch.rand(1, 2, 3, 6, 8)}, ValueError, r"image.*\(1, 2, 3, 6, 8\)"),
        ({"image": torch.rand(2, 1, 6, 8)}, ValueError, r"image must.*3.*\(2, 1, 6, 8\)"),
        ({"image": torch.rand(2, 6, 8, 3)}, ValueError, r"image must.*3.*\(2, 6, 8, 3\)"),
        ({"distance": torch.rand(2, 6, 8)}, ValueError, r"distance must.*1.*\(2, 6, 8\)"),
        ({"distance": torch.rand(2, 3, 6, 8)}, ValueError, r"distance must.*1.*\(2, 3, 6, 8\)"),
        ({"distance": torch.rand(6, 8)}, ValueError, r"distance.*\(6, 8\)"),
        ({"distance": torch.rand(2, 1, 8, 6)}, ValueError, r"distance.*\(8, 6\).*\(6, 8\)"),
        ({"field": torch.rand(2, 1, 6, 9)}, ValueError, r"field.*\(6, 9\).*\(6, 8\)"),
        ({"field": torch.rand(2, 3, 6, 8)}, ValueError, r"field must.*1.*\(2, 3, 6, 8\)"),
        ({"distance": torch.rand(3, 1, 6, 8)}, ValueError, "batch.*'image': 2, 'distance': 3"),
        ({"medium": Medium.stack([coefficients()] * 3)}, ValueError, "batch.*'medium': 3"),
        ({"field": torch.rand(3, 1, 6, 8)}, ValueError, "field"),
        ({"distance": MIXED}, ValueError, "distance is NaN at 2 and negative at 3 of 96 pixels"),
        ({"distance": -GOOD["distance"]}, ValueError, "distance.*negative"),
        ({"distance": torch.full((2, 1, 6, 8), -math.inf)}, ValueError, "distance.*negative"),
        ({"field": -torch.rand(2, 1, 6, 8)}, ValueError, "field.*negative"),
        ({"field": MIXED}, ValueError, "field"),
        ({"field": torch.full((2, 1, 6, 8), math.inf)}, ValueError, "field.*inf"),
        ({"order": "backwards"}, ValueError, "order.*backwards"),
        ({"tolerance": 0.0}, ValueError, "tolerance.*0"),
        ({"tolerance": -1.0}, ValueError, "tolerance.*-1"),
        ({"tolerance": math.nan}, ValueError, "tolerance.*nan"),
        ({"tolerance": 2.0}, ValueError, "tolerance.*2"),
    ],
)
def test_form_image_rejects(change, error, match) -> None:
    with pytest.raises(error, match=match):
        form_image(**{**GOOD, **change})
