"""The blur that the benchmarks take for exact."""

import numpy as np
import pytest
import torch
from blurring import SIZES
from referees import reference
from referees.exact import blur_exact
from scenes import rand
from scipy.ndimage import gaussian_filter

from uwaug.blur.kernels import sampled_parameter


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("sigma", [0.6, 1.0, 3.3, 25.0])
def test_exact_blur_is_scipys_at_constant_width(size, sigma) -> None:
    image = rand(2, *size)
    # of variance sigma²; sigma itself from 1 px on
    parameter = float(sampled_parameter(np.array(sigma)))
    widths = (0, parameter, parameter)
    expected = gaussian_filter(image.numpy(), widths, mode="reflect", truncate=14)
    result = blur_exact(image, torch.full(size, sigma, dtype=torch.float64)).reshape(2, *size)
    np.testing.assert_allclose(result.numpy(), expected, rtol=0, atol=1e-12)


def test_exact_blur_reads_each_pixel_with_its_own_width() -> None:
    image, sigma = rand(3, 20, 26), 0.75 + 5 * rand(20, 26)
    at = torch.tensor([0, 25, 100, 519])
    expected = reference.varying_gaussian(image.numpy(), sigma.numpy(), at.numpy())
    np.testing.assert_allclose(blur_exact(image, sigma, at).numpy(), expected, rtol=0, atol=1e-12)
    assert blur_exact(image, sigma).shape == (3, 520)


def test_exact_blur_of_no_width_is_the_image() -> None:
    image = rand(3, 5, 7)
    assert torch.equal(blur_exact(image, torch.zeros(5, 7)).reshape(3, 5, 7), image)
