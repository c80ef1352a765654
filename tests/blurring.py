"""What the tests of the blur share."""

import torch

from uwaug.blur.plan import BlurPlan
from uwaug.blur.stack import varying_blur

RANGES = [(0.9, 4.5), (0.75, 15.0), (2.0, 60.0)]
SIZES = [(1, 1), (1, 9), (9, 1), (2, 3), (7, 5), (33, 31), (64, 48)]


def node(sigma: float, cell: float = 1.0, reach: float = 4.0) -> BlurPlan:
    """One fixed blur."""
    return BlurPlan(sigma, sigma, (sigma,), (cell,), ((1.0,),), reach, 1e-3)


def blur(image: torch.Tensor, plan: BlurPlan, sigma: float = 1.0) -> torch.Tensor:
    """Every pixel under the same width, by a plan."""
    return constant(image, sigma, plan=plan)


def constant(image: torch.Tensor, sigma: float, **kwargs: float) -> torch.Tensor:
    """Every pixel under the same width."""
    widths = image.new_full((len(image), 1, *image.shape[-2:]), sigma)
    return varying_blur(image, widths, **kwargs)
