import math
from typing import Any

import numpy as np
import pytest
import torch
from scenes import rand
from torch import Tensor
from uwaug.distance.complete import _membrane

from uwaug.distance.convert import fill_unknown

NAN, INF = math.nan, math.inf
pytestmark = pytest.mark.filterwarnings("ignore:distance is unknown")


def slope(height: int, width: int) -> Tensor:
    """A plane of the scene that leans away: 2 to 8 m."""
    rows = torch.linspace(0.5, 0.2, height, dtype=torch.float64)[:, None]
    columns = torch.linspace(0.0, -0.075, width, dtype=torch.float64)
    return (1 / (rows + columns))[None]


def disc(height: int, width: int, radius: float) -> Tensor:
    """A round hole in the middle."""
    y, x = torch.arange(height)[:, None] - height / 2, torch.arange(width) - width / 2
    return torch.hypot(y, x)[None] < radius


def nearest(distance: Tensor) -> Tensor:
    """Every hole filled with the value of the nearest known pixel."""
    from scipy.ndimage import distance_transform_edt

    holes = distance.isnan().numpy()[0]
    _, (rows, columns) = distance_transform_edt(holes, return_indices=True)
    return distance[:, rows, columns]


def test_a_plane_is_continued_across_a_wide_hole() -> None:
    z = slope(240, 320)
    holed = z.masked_fill(disc(240, 320, 80.0), NAN)
    error = (fill_unknown(holed) / z - 1).abs()
    assert error.max() < 0.04
    assert error.max() < 0.1 * (nearest(holed) / z - 1).abs().max()


def test_wide_holes_have_no_seams() -> None:
    # six walls around a hole, as far apart as they get
    y, x = torch.meshgrid(torch.arange(-50.0, 50.0), torch.arange(-50.0, 50.0), indexing="ij")
    sector = (6 * (torch.atan2(y, x) / math.tau + 0.5)).long() % 2
    z = torch.where(sector == 1, 2.0, 8.0)[None].masked_fill(torch.hypot(y, x) < 40, NAN)
    inside = torch.hypot(y, x) < 30

    def steepest(filled: Tensor) -> float:
        steps = (1 / filled[0]).diff(dim=-1).abs()
        return steps[inside[:, 1:]].max().item()

    assert steepest(nearest(z)) == pytest.approx(1 / 2 - 1 / 8)
    assert steepest(fill_unknown(z)) < 0.06 * (1 / 2 - 1 / 8)


def test_thin_holes_keep_edges_sharp() -> None:
    z = torch.full((1, 30, 40), 2.0)
    z[..., 20:] = 6.0
    z[..., 16:24] = NAN
    z[:, 10:14, :10] = NAN
    filled = fill_unknown(z)
    assert filled.unique().tolist() == [2.0, 6.0]
    assert torch.equal(filled, nearest(z))


def test_a_real_scene(motorcycle: Any) -> None:
    """Smooth random holes that hide 15 % of it."""
    from scipy.ndimage import gaussian_filter

    z = motorcycle.distance
    wavy = gaussian_filter(np.random.default_rng(0).standard_normal(z.shape[1:]), 40)
    hole = torch.from_numpy(wavy > np.quantile(wavy, 0.85))[None]
    holed = z.masked_fill(hole, NAN)

    def error(filled: Tensor) -> float:
        return (filled / z).log()[hole].square().mean().sqrt().item()

    assert error(fill_unknown(holed)) < 0.85 * error(nearest(holed))


def exact(distance: Tensor) -> Tensor:
    """The membrane over 1/z, by a sparse solver."""
    from scipy.sparse import lil_matrix
    from scipy.sparse.linalg import spsolve

    known = ~distance[0].isnan().numpy()
    height, width = known.shape
    system = lil_matrix((known.size, known.size))
    right = np.zeros(known.size)
    for i, j in np.ndindex(height, width):
        here = i * width + j
        if known[i, j]:
            system[here, here], right[here] = 1.0, 1 / distance[0, i, j]
            continue
        for y, x in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            if 0 <= y < height and 0 <= x < width:
                system[here, here] += 1
                system[here, y * width + x] -= 1
    return torch.from_numpy(1 / spsolve(system.tocsr(), right)).view(1, height, width)


@pytest.mark.parametrize("touching", [False, True], ids=["inside", "at the border"])
def test_is_nearly_the_membrane(touching: bool) -> None:
    generator = torch.Generator().manual_seed(0)
    coarse = 2 + 6 * torch.rand(1, 1, 4, 5, generator=generator, dtype=torch.float64)
    z = torch.nn.functional.interpolate(coarse, (48, 60), mode="bicubic")[0].clamp(1, 9)
    hole = disc(48, 60, 16.0)
    if touching:
        hole = hole.roll(20, -1) & (torch.arange(60) > 20)
    holed = z.masked_fill(hole, NAN)
    inverse = (1 / z).masked_fill(hole, 0.0)
    error = 1 / _membrane(inverse[None], ~hole[None])[0] / exact(holed) - 1
    assert error.abs().max() < 0.03
    assert error[hole].square().mean().sqrt() < 0.01


@pytest.mark.parametrize("size", [(1, 1), (1, 50), (50, 1), (33, 47)])
@pytest.mark.parametrize("share", [0.5, 0.99])
def test_stays_between_what_is_known(size: tuple[int, int], share: float) -> None:
    for seed in range(5):
        z = 1 + 9 * rand(1, *size, seed=seed)
        known = rand(1, *size, seed=seed + 100) >= share
        known[0, seed % size[0], seed % size[1]] = True
        filled = fill_unknown(z.masked_fill(~known, NAN))
        assert torch.equal(filled[known], z[known])
        least, largest = z[known].aminmax()
        assert filled.min() >= least * (1 - 1e-12)
        assert filled.max() <= largest * (1 + 1e-12)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_batch_is_its_maps_one_by_one(dtype: torch.dtype) -> None:
    z = (1 + 5 * rand(3, 2, 1, 41, 53)).to(dtype)
    z[0, 0, :, 4:30, 10:44] = NAN  # one with a wide hole, one with thin ones, one with none
    z[1, 1, :, ::5] = 0.0
    z[2, 0] = -1.0
    z[2, 0, 0, 7, 9] = 3.0
    filled = fill_unknown(z)
    assert filled.dtype == dtype
    for where in np.ndindex(3, 2):
        assert torch.equal(filled[where], fill_unknown(z[where]))
    assert torch.equal(filled[2, 0], torch.full((1, 41, 53), 3.0, dtype=dtype))
    assert torch.equal(filled, fill_unknown(z))


def test_open_water_and_absurd_distances() -> None:
    hole = disc(40, 50, 15.0)
    z = torch.full((1, 40, 50), INF)
    assert fill_unknown(z.masked_fill(hole, NAN)).isinf().all()
    z[..., 25:] = 2.0
    filled = fill_unknown(z.masked_fill(hole, NAN))
    assert not filled.isnan().any()
    assert filled.min() >= 2 - 1e-6
    assert filled[0, 20, 25:].isfinite().all()
    for value in (1e-12, 1e30):
        z = torch.full((1, 40, 50), value).masked_fill(hole, NAN)
        assert not fill_unknown(z).isnan().any()
        assert (fill_unknown(z) > 0).all()


def test_gradients() -> None:
    hole = disc(30, 30, 11.0)
    z = (1 + 5 * rand(1, 30, 30)).masked_fill(hole, NAN)
    corner = z[:, 18:, 18:].clone().requires_grad_()  # what is known and what is not

    def filled(part: Tensor) -> Tensor:
        whole = z.clone()
        whole[:, 18:, 18:] = torch.where(part.isnan(), NAN, part)
        return fill_unknown(whole)[:, 10:20, 10:20]

    known = torch.where(corner.isnan(), 0.0, corner).detach().requires_grad_()
    lost = corner.isnan().detach()
    assert torch.autograd.gradcheck(lambda v: filled(v.masked_fill(lost, NAN)), known)
    z[..., :4] = INF
    z.requires_grad_()
    (slope_,) = torch.autograd.grad(fill_unknown(z)[hole].sum(), z)
    assert slope_.isfinite().all()
    assert (slope_[hole] == 0).all()
